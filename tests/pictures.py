"""Pictures on disk as tests read them: decoded by OpenCV itself, apart from the project's own reader."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from fusion.flight import Flight, FrameStream
from fusion.logs.pictures.camera_folder import PictureFiles
from vision.images import GreyImage


def read_grey(path: str | Path) -> GreyImage:
    """Decode a picture, grey (h, w)."""
    return _decode(path, cv2.IMREAD_GRAYSCALE)


def read_colour(path: str | Path) -> GreyImage:
    """Decode a picture, BGR (h, w, 3)."""
    return _decode(path, cv2.IMREAD_COLOR)


def _decode(path: str | Path, flags: int) -> GreyImage:
    picture = cv2.imread(str(path), flags)
    assert picture is not None, f"{path} does not decode"
    return np.asarray(picture, dtype=np.uint8)


def picture_paths(flight: Flight | FrameStream) -> tuple[Path, ...]:
    """Files of a flight whose frames are files."""
    source = (flight.frames if isinstance(flight, Flight) else flight).source
    assert isinstance(source, PictureFiles)
    return source.paths
