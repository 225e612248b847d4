"""Heading and lateral offset from single frames of a corridor.

`measure_frame` turns a picture and a `Camera` into a `FrameMeasurement`. Frames, signs and units are those of
`vision.measurement`. Importing the package is cheap: the compiled line finder loads at its first use.

Begin reading at `vision.frame`, which lists the steps and calls the packages in order: `vision.lines` finds line
segments, `vision.axis` finds the corridor's axis, `vision.lateral` finds the corridor's corners and the lateral
offset. `vision.cameras` relates pixels to rays. `vision.paper` is the published article's own method. Nothing here
imports `fusion`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from vision.cameras.camera import Camera
from vision.errors import InputError
from vision.measurement import (
    Attitude,
    FrameMeasurement,
    LineClass,
    Position,
    Prior,
    Reason,
)

if TYPE_CHECKING:
    from vision.frame import extract_lines, measure_frame, measure_lines, warm_up
    from vision.images import read_image

__all__ = [
    "Attitude",
    "Camera",
    "FrameMeasurement",
    "InputError",
    "LineClass",
    "Position",
    "Prior",
    "Reason",
    "extract_lines",
    "measure_frame",
    "measure_lines",
    "read_image",
    "warm_up",
]


def __getattr__(name: str) -> Any:
    if name in ("extract_lines", "measure_frame", "measure_lines", "warm_up"):
        from vision import frame

        return getattr(frame, name)
    if name == "read_image":
        from vision.images import read_image

        return read_image
    raise AttributeError(f"module 'vision' has no attribute {name!r}")
