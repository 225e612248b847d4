"""Bounds on what a file may ask for: every reader goes through these, so that no input takes all memory or time.

A calibration or a settings file takes some kilobytes, a picture some megapixels. What is far beyond that is refused
before it is unpacked or taken apart.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from errno import EISDIR
from os import strerror
from pathlib import Path
from stat import S_ISDIR, S_ISREG
from typing import Any

from vision.errors import InputError

MAX_TEXT_BYTES = 200_000  # of a calibration or of settings
MAX_DEPTH = 16  # of tables in tables
MAX_VALUES = 50_000
MAX_ALIASES = 10  # in YAML; each may stand for a copy of all that came before
MAX_NAME_PARTS = 500  # of a dotted name in TOML
MAX_PIXELS = 40_000_000  # of a picture; 8K video has 33 million
MAX_SIDE_PX = 1 << 16

_ALIAS = re.compile(r"(?<![^\s\[{,])\*[^\s,\[\]{}*]+")


def check_is_file(path: Path) -> None:
    """Raise `InputError` where a path is no regular file: a pipe or a device may never end.

    Raises
    ------
    InputError
        Also where the path cannot be one of any file.
    OSError
        Where there is no such file, it may not be looked at, or is a folder.
    """
    try:
        mode = path.stat().st_mode
    except ValueError as error:  # a null byte
        raise InputError(f"is not a path: {error}", file=repr(str(path)), remedy="correct it") from error
    if S_ISDIR(mode):
        raise IsADirectoryError(EISDIR, strerror(EISDIR), str(path))
    if not S_ISREG(mode):
        raise InputError("is a pipe or a device", file=path, remedy="give a file")


def read_text(path: Path, what: str) -> str:
    """Read a small text file as UTF-8, a byte order mark left out.

    Parameters
    ----------
    path
        The file.
    what
        What it should be, for the complaint: ``a calibration``.

    Raises
    ------
    InputError
        Where it is no file, or too large.
    OSError, UnicodeDecodeError
        Where it cannot be read.
    """
    check_is_file(path)
    with path.open("rb") as file:
        data = file.read(MAX_TEXT_BYTES + 1)
    if len(data) > MAX_TEXT_BYTES:
        problem = f"has {path.stat().st_size} bytes, too many for {what}"
        raise InputError(problem, file=path, remedy=f"give a text file of up to {MAX_TEXT_BYTES} bytes")
    return data.decode("utf-8-sig")


def check_yaml(text: str) -> None:
    """Raise `ValueError` where a YAML text repeats parts of itself so often that they may grow without bound."""
    if len(_ALIAS.findall(text)) > MAX_ALIASES:
        raise ValueError(f"more than {MAX_ALIASES} aliases (*name)")


def check_toml(text: str) -> None:
    """Raise `ValueError` where a name in a TOML text has so many parts that reading it would not end."""
    if re.search(r"\d{400}", text):
        raise ValueError("a number of hundreds of digits")
    for line in text.splitlines():
        if line.count(".") > MAX_NAME_PARTS and any(
            part.count(".") > MAX_NAME_PARTS for part in re.split(r"[^\w.\"' \t-]", line)
        ):
            raise ValueError(f"a name of more than {MAX_NAME_PARTS} parts")


def check_values(content: Any) -> None:
    """Raise `ValueError` where a file's values are nested too deeply, too many, or whole numbers beyond 64 bits.

    Parts that YAML's aliases repeat count as often as they stand.
    """
    left, waiting = MAX_VALUES, [(content, 0)]
    while waiting:
        value, depth = waiting.pop()
        left -= 1
        if left < 0:
            raise ValueError(f"more than {MAX_VALUES} values")
        if depth > MAX_DEPTH:
            raise ValueError(f"tables nested more than {MAX_DEPTH} deep")
        if isinstance(value, int) and not -(2**63) <= value < 2**64:
            raise ValueError("a whole number of more than 64 bits")
        if isinstance(value, Mapping):
            waiting += [(item, depth + 1) for pair in value.items() for item in pair]
        elif isinstance(value, list | tuple | set):
            waiting += [(item, depth + 1) for item in value]


def check_pixels(width_px: int, height_px: int) -> None:
    """Raise `InputError` where a picture of this size is too large to be one of a flight's camera."""
    if width_px * height_px > MAX_PIXELS or max(width_px, height_px) > MAX_SIDE_PX:
        problem = f"picture of {width_px}x{height_px} pixels"
        raise InputError(problem, remedy=f"pictures may have up to {MAX_PIXELS // 1_000_000} million")
