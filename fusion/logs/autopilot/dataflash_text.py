"""DataFlash logs as text (``.log`` of Mission Planner and ``mavlogdump``): packed into their binary form.

Each line is a message: its name, then its fields, in the units of their names. FMT lines define the fields of the
others, as in the binary log.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from fusion.logs.autopilot.dataflash_parse import TYPES, ByteArray, Format
from fusion.logs.csv.rows import encoding_of
from vision import InputError

SUFFIXES = frozenset({".log", ".txt"})
_HEAD_BYTES = 4096
_FMT_FIELDS = 6  # FMT, type, length, name, format, columns ...


def recognises(path: Path) -> bool:
    """Whether a text begins with a message definition."""
    if not path.is_file() or path.suffix.lower() not in SUFFIXES:
        return False
    with path.open("rb") as file:
        head = file.read(_HEAD_BYTES)
    lines = head.decode(encoding_of(head), errors="replace").splitlines()
    return any(line.startswith("FMT,") for line in lines[:20])


def read_messages(path: Path, names: tuple[str, ...]) -> tuple[dict[str, tuple[Format, ByteArray]], int]:
    """Read the messages of some names.

    Parameters
    ----------
    path
        The log.
    names
        Names of the requested messages.

    Returns
    -------
    messages, damaged
        Format of each and its concatenated bytes; number of damaged lines.

    Raises
    ------
    InputError
        If the file cannot be read.
    """
    formats: dict[str, Format] = {}
    rows: dict[str, list[list[str]]] = {}
    damaged = 0
    for fields in _lines(path):
        name = fields[0]
        if name == "FMT" and len(fields) >= _FMT_FIELDS:
            fmt = _format(fields)
            if fmt is not None and fmt.name in names:
                formats.setdefault(fmt.name, fmt)
        elif name in formats:
            if len(fields) - 1 == len(formats[name].scales):
                rows.setdefault(name, []).append(fields[1:])
            else:
                damaged += 1
    found: dict[str, tuple[Format, ByteArray]] = {}
    for name, lines in rows.items():
        packed, bad = _packed(formats[name], lines)
        found[name] = formats[name], packed
        damaged += bad
    return found, damaged


def _lines(path: Path) -> Iterator[list[str]]:
    try:
        with path.open(encoding="utf-8-sig", errors="replace") as file:
            for line in file:
                fields = [field.strip() for field in line.split(",")]
                if len(fields) > 1:
                    yield fields
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", file=path, remedy="check the file") from error


def _format(fields: list[str]) -> Format | None:
    """Read a definition; None if it is inconsistent. Its length is that of its fields, packed."""
    number, _, name, letters, *columns = fields[1:]
    known = all(letter in TYPES for letter in letters) and len(columns) == len(letters) == len(set(columns))
    if not known or not number.isdigit() or int(number) > 255:
        return None
    kinds = [TYPES[letter] for letter in letters]
    dtype = np.dtype(
        [("header", "V3"), *((column, kind) for column, (kind, _) in zip(columns, kinds, strict=True))]
    )
    scales = {column: scale for column, (_, scale) in zip(columns, kinds, strict=True)}
    return Format(int(number), dtype.itemsize, name, dtype, scales)


def _packed(fmt: Format, lines: list[list[str]]) -> tuple[ByteArray, int]:
    """Pack the fields of lines as in the binary log; lines with invalid numbers are left out and counted."""
    columns = dict(zip(fmt.scales, zip(*lines, strict=True), strict=True))
    good = np.ones(len(lines), dtype=bool)
    values = {}
    for column, texts in columns.items():
        kind = fmt.dtype[column].kind
        if kind == "V":  # text, not used
            continue
        numbers = np.array([_number(text) for text in texts])
        if kind != "f":
            numbers = np.rint(numbers / fmt.scales[column])
            limits = np.iinfo(fmt.dtype[column])
            good &= (numbers >= limits.min) & (numbers <= limits.max)  # NaN is not
        values[column] = numbers
    rows = np.zeros(int(np.count_nonzero(good)), dtype=fmt.dtype)
    for column, numbers in values.items():
        rows[column] = numbers[good]
    return rows.view(np.uint8), int(np.count_nonzero(~good))


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return float("nan")
