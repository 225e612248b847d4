"""Logs of flights, one module per format, each turning what it finds into a `fusion.flight.Flight`.

A format is a module with two functions, ``recognises(path)`` and ``load(path, camera)``; adding one means
writing the module and naming it in `FORMATS`. A module is imported only when a log is loaded.
"""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Protocol, cast

from fusion.flight import Flight
from vision import Camera, InputError

FORMATS = {"ASL / EuRoC folder (mav0/cam0 ...)": "fusion.logs.asl"}


class LogFormat(Protocol):
    """What a module in `FORMATS` provides."""

    def recognises(self, path: Path) -> bool:
        """Say whether this existing file or folder is of the format, without reading more than needed."""

    def load(self, path: Path, camera: Camera | Path | None) -> Flight:
        """Read it whole."""


def load_flight(path: str | Path, camera: Camera | str | Path | None = None) -> Flight:
    """Read a logged flight of any supported format.

    Parameters
    ----------
    path
        An ASL / EuRoC flight folder or the ``mav0`` in it.
    camera
        Calibration to use instead of the log's own: a `Camera`, or a file in EuRoC's or Kalibr's form whose
        extrinsic then refers to the log's body axes.

    Returns
    -------
    Flight
        In SI units, body FRD, world z down. What was dropped or mended stands in ``problems``.

    Raises
    ------
    InputError
        Where the log cannot be used: one line naming file, field, value and remedy.
    """
    path = Path(path)
    if not path.exists():
        raise InputError("there is no such file or folder", file=path, remedy="check the path")
    if isinstance(camera, str):
        camera = Path(camera)
    for module in FORMATS.values():
        log_format = cast(LogFormat, import_module(module))
        if log_format.recognises(path):
            return log_format.load(path, camera)
    raise InputError("is not a flight of a known format", file=path, remedy="give " + " or ".join(FORMATS))
