"""Options that several commands share."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer


class Method(StrEnum):
    """How a frame's vanishing point is found."""

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
    Path | None, typer.Option("--config", metavar="F.toml", help="Settings; the rest keep defaults.")
]
MethodOption = Annotated[
    Method,
    typer.Option(
        "--method",
        help="geometric: sub-pixel lines, gravity-aided; paper: the article's k-means chain, for comparison.",
    ),
]
