"""Statistics of a camera's pictures, from a few of them: size, brightness, and whether they can be decoded."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fusion.files import replacing
from fusion.flight import FrameStream, GreyImage
from vision import InputError

SAMPLED = 5
SUFFIXES = (".png", ".jpg")
TRIES = 10  # pictures to try at the beginning


@dataclass(frozen=True, slots=True)
class PictureFindings:
    """Statistics of a few pictures spread over the log.

    Parameters
    ----------
    sampled, unreadable
        Number of pictures tried, and of those that cannot be decoded.
    sizes
        Widths and heights in pixels, each once.
    first_index
        Index of the first that can be decoded; None if none can.
    brightness, contrast
        Mean and standard deviation of its grey levels, 0 to 255.
    """

    sampled: int
    unreadable: int
    sizes: tuple[tuple[int, int], ...]
    first_index: int | None
    brightness: float | None
    contrast: float | None


def inspect_pictures(frames: FrameStream) -> tuple[PictureFindings, GreyImage | None]:
    """Describe a stream of pictures, and return the first that can be decoded."""
    count = len(frames.t_ns)
    first_index, first = None, None
    sizes: list[tuple[int, int]] = []
    tried = unreadable = 0
    for index in range(min(TRIES, count)):
        picture = _decode(frames, index)
        tried += 1
        if picture is not None:
            first_index, first = index, picture
            sizes.append(_size(picture))
            break
        unreadable += 1
    if first_index is not None:
        spread = np.unique(np.linspace(first_index, count - 1, SAMPLED).astype(int))
        for index in spread[spread > first_index]:
            picture = _decode(frames, int(index))
            tried += 1
            if picture is None:
                unreadable += 1
            elif _size(picture) not in sizes:
                sizes.append(_size(picture))
    found = PictureFindings(
        tried,
        unreadable,
        tuple(sizes),
        first_index,
        None if first is None else float(first.mean()),
        None if first is None else float(first.std()),
    )
    return found, first


def _decode(frames: FrameStream, index: int) -> GreyImage | None:
    try:
        return frames.read(index)
    except InputError:
        return None


def _size(picture: GreyImage) -> tuple[int, int]:
    return picture.shape[1], picture.shape[0]


def check_picture_file(path: Path) -> None:
    """Raise `InputError` if a picture cannot be written to this file."""
    if path.suffix.lower() not in SUFFIXES:
        raise InputError("is not a picture name", file=path, remedy=f"end it in {' or '.join(SUFFIXES)}")
    if path.is_dir() or not path.absolute().parent.is_dir():
        raise InputError("cannot be written", file=path, remedy="give a file in a folder that exists")


def write_picture(picture: GreyImage | None, path: Path) -> None:
    """Write a grey picture (h, w) atomically.

    Raises
    ------
    InputError
        If there is none, or the file cannot be written.
    """
    import cv2

    check_picture_file(path)
    if picture is None:
        raise InputError("there is no picture to write", file=path, remedy="leave --picture out")
    _, encoded = cv2.imencode(path.suffix.lower(), picture)
    with replacing(path) as draft:
        draft.write_bytes(encoded.tobytes())
