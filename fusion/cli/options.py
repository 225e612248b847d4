"""Options that several commands share."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer


class Method(StrEnum):
    """Method for the vanishing point of a frame."""

    GEOMETRIC = "geometric"
    PAPER = "paper"


CameraOption = Annotated[
    Path | None,
    typer.Option(
        "--camera",
        metavar="CAM.yaml",
        help="Calibration: EuRoC, Kalibr, ROS camera_info or OpenCV, YAML or JSON, pinhole or fisheye.",
    ),
]
ConfigOption = Annotated[
    Path | None, typer.Option("--config", metavar="F.toml", help="Settings; others keep their defaults.")
]
MethodOption = Annotated[
    Method,
    typer.Option(
        "--method",
        help="geometric: sub-pixel lines and gravity; paper: the article's k-means method, for comparison.",
    ),
]
