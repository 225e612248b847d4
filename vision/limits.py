"""Limits on input files, used by every reader, so that no input exhausts memory or time.

A calibration or a settings file has some kilobytes, a picture some megapixels. Much larger input is rejected before
it is unpacked or parsed.
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
MAX_DEPTH = 16  # of nested tables
MAX_VALUES = 50_000
MAX_ALIASES = 10  # in YAML; each may expand to a copy of everything before it
MAX_NAME_PARTS = 500  # of a dotted name in TOML
MAX_PIXELS = 40_000_000  # of a picture; 8K video has 33 million
MAX_SIDE_PX = 1 << 16

_ALIAS = re.compile(r"(?<![^\s\[{,])\*[^\s,\[\]{}*]+")


def check_is_file(path: Path) -> None:
    """Raise `InputError` where a path is not a regular file: reading a pipe or a device may never end.

    Raises
    ------
    InputError
        Also where the path is not valid.
    OSError
        Where the file does not exist, is not accessible, or is a folder.
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
    """Read a small text file as UTF-8, without its byte order mark.

    Parameters
    ----------
    path
        The file.
    what
        Expected content, for the error message: ``a calibration``.

    Raises
    ------
    InputError
        Where it is not a regular file, or too large.
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
    """Raise `ValueError` where a YAML text has so many aliases that expanding them may exhaust memory."""
    if len(_ALIAS.findall(text)) > MAX_ALIASES:
        raise ValueError(f"more than {MAX_ALIASES} aliases (*name)")


def check_toml(text: str) -> None:
    """Raise `ValueError` where a dotted name in a TOML text has so many parts that parsing would not end."""
    if re.search(r"\d{400}", text):
        raise ValueError("a number of hundreds of digits")
    for line in text.splitlines():
        if line.count(".") > MAX_NAME_PARTS and any(
            part.count(".") > MAX_NAME_PARTS for part in re.split(r"[^\w.\"' \t-]", line)
        ):
            raise ValueError(f"a name of more than {MAX_NAME_PARTS} parts")


def check_values(content: Any) -> None:
    """Raise `ValueError` where a file has too many values, too deep nesting, or integers of more than 64 bits.

    Values repeated by YAML aliases count each time.
    """
    remaining, stack = MAX_VALUES, [(content, 0)]
    while stack:
        value, depth = stack.pop()
        remaining -= 1
        if remaining < 0:
            raise ValueError(f"more than {MAX_VALUES} values")
        if depth > MAX_DEPTH:
            raise ValueError(f"tables nested more than {MAX_DEPTH} deep")
        if isinstance(value, int) and not -(2**63) <= value < 2**64:
            raise ValueError("a whole number of more than 64 bits")
        if isinstance(value, Mapping):
            stack += [(item, depth + 1) for pair in value.items() for item in pair]
        elif isinstance(value, list | tuple | set):
            stack += [(item, depth + 1) for item in value]


def check_pixels(width_px: int, height_px: int) -> None:
    """Raise `InputError` where a picture is too large to come from a flight's camera."""
    if width_px * height_px > MAX_PIXELS or max(width_px, height_px) > MAX_SIDE_PX:
        most = f"{MAX_PIXELS // 1_000_000} million pixels, and {MAX_SIDE_PX} a side"
        raise InputError(
            f"picture of {width_px}x{height_px} pixels is too large: at most {most}", remedy="scale it down"
        )
