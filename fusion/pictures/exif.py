"""Metadata of a picture file: its size and focal length, without decoding."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from math import atan, hypot
from pathlib import Path
from typing import Any

from vision import InputError
from vision.images import read_image
from vision.limits import check_is_file

FILM_DIAGONAL_MM = hypot(36.0, 24.0)
FILM_RANGE_MM = (5.0, 300.0)  # 0 means unknown; other values are implausible here
CROP_TOLERANCE = 0.01
EXIF_FORMATS = ("JPEG", "MPO", "TIFF", "WEBP")

_ORIENTATION, _EXIF = 0x0112, 0x8769
_WIDTH, _HEIGHT, _FILM_MM = 0xA002, 0xA003, 0xA405


@dataclass(frozen=True, slots=True)
class PictureHeader:
    """Size of a picture as it will be decoded, and its focal length.

    Parameters
    ----------
    width_px, height_px
        After the rotation declared by the camera.
    film_mm
        EXIF's focal length on 35 mm film; None if missing, or if the picture was cropped.
    """

    width_px: int
    height_px: int
    film_mm: float | None = None

    @property
    def horizontal_fov_rad(self) -> float | None:
        """Field of view by ``film_mm``, which refers to the diagonals of film and picture."""
        if self.film_mm is None:
            return None
        diagonal_px = hypot(self.width_px, self.height_px)
        return 2.0 * atan(0.5 * self.width_px / diagonal_px * FILM_DIAGONAL_MM / self.film_mm)


def read_header(path: Path) -> PictureHeader | None:
    """Read a picture's size and focal length, if possible without decoding.

    Returns
    -------
    PictureHeader or None
        None if the picture cannot be read.
    """
    from PIL import Image

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # warnings about size or content: the picture is not decoded here
            check_is_file(path)
            with Image.open(path) as image:
                if image.format not in EXIF_FORMATS:  # for a PNG, Pillow would decode the whole picture
                    return PictureHeader(*image.size)
                return _of_image(image.size, image.getexif())
    except (OSError, ValueError, SyntaxError, TypeError, Image.DecompressionBombError):
        pass
    try:
        height, width = read_image(path).shape
    except InputError:
        return None
    return PictureHeader(width, height)


def _of_image(size: tuple[int, int], exif: Any) -> PictureHeader:
    width, height = size[::-1] if exif.get(_ORIENTATION) in (5, 6, 7, 8) else size
    details = exif.get_ifd(_EXIF)
    film_mm = _number(details.get(_FILM_MM))
    taken = [_number(details.get(_WIDTH)), _number(details.get(_HEIGHT))]
    if film_mm is None or not FILM_RANGE_MM[0] <= film_mm <= FILM_RANGE_MM[1]:
        return PictureHeader(width, height)
    if taken[0] and taken[1]:
        shape, shape_taken = (max(pair) / min(pair) for pair in ((width, height), (taken[0], taken[1])))
        if abs(shape / shape_taken - 1.0) > CROP_TOLERANCE:
            return PictureHeader(width, height)
    return PictureHeader(width, height, film_mm)


def _number(value: Any) -> float | None:
    try:
        return float(value)
    except (TypeError, ValueError, ZeroDivisionError):
        return None
