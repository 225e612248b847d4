"""Find the messages in a DataFlash log with compiled code: two hours of log have tens of millions of them.

A message is the bytes A3 95, its type, and the number of bytes that the log's FMT message of that type declares.
There is no checksum: a message is valid if another one or the end of the file follows.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from mmap import mmap

import numpy as np
import numpy.typing as npt

from vision.compiled import compiled

ByteArray = npt.NDArray[np.uint8]
IndexArray = npt.NDArray[np.int64]

FMT_TYPE = 128
FMT_LENGTH = 89
HEADER_LENGTH = 3

# Format characters: numpy's type, and the factor to the unit.
TYPES: dict[str, tuple[str, float]] = {
    "a": ("V64", 1.0), "b": ("<i1", 1.0), "B": ("<u1", 1.0), "h": ("<i2", 1.0), "H": ("<u2", 1.0),
    "i": ("<i4", 1.0), "I": ("<u4", 1.0), "f": ("<f4", 1.0), "d": ("<f8", 1.0), "g": ("<f2", 1.0),
    "n": ("V4", 1.0), "N": ("V16", 1.0), "Z": ("V64", 1.0), "c": ("<i2", 0.01), "C": ("<u2", 0.01),
    "e": ("<i4", 0.01), "E": ("<u4", 0.01), "L": ("<i4", 1e-7), "M": ("<u1", 1.0),
    "q": ("<i8", 1.0), "Q": ("<u8", 1.0),
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Format:
    """Format of a type of message, from its FMT message."""

    number: int
    length: int
    name: str
    dtype: np.dtype[np.void]
    scales: dict[str, float]


def find_formats(data: mmap | bytes) -> dict[str, Format]:
    """All valid FMT messages, by name; the first of a name is used."""
    found: dict[str, Format] = {}
    for match in re.finditer(b"\xa3\x95\x80", data):
        fmt = _format(bytes(data[match.end() : match.start() + FMT_LENGTH]))
        if fmt is not None:
            found.setdefault(fmt.name, fmt)
    return found


def _format(raw: bytes) -> Format | None:
    """Read an FMT message after its header; None if it is inconsistent."""
    if len(raw) < FMT_LENGTH - HEADER_LENGTH:
        return None
    number, length = raw[0], raw[1]
    try:
        name, letters, labels = (
            part.rstrip(b"\0").decode("ascii") for part in (raw[2:6], raw[6:22], raw[22:86])
        )
    except UnicodeDecodeError:
        return None
    columns = labels.split(",") if labels else []
    if not re.fullmatch(r"\w+", name) or len(columns) != len(letters) or len(set(columns)) < len(columns):
        return None
    if any(letter not in TYPES for letter in letters) or not all(columns):
        return None
    fields = [(column, TYPES[letter][0]) for column, letter in zip(columns, letters, strict=True)]
    dtype = np.dtype([("header", "V3"), *fields])
    if dtype.itemsize != length:
        return None
    scales = {column: TYPES[letter][1] for column, letter in zip(columns, letters, strict=True)}
    return Format(number, length, name, dtype, scales)


def find_messages(
    data: ByteArray, formats: dict[str, Format], names: list[str]
) -> tuple[dict[str, IndexArray], int]:
    """Positions of the messages of some names, and the number of bytes that belong to no message."""
    lengths = np.zeros(256, dtype=np.int64)
    lengths[FMT_TYPE] = FMT_LENGTH
    for fmt in formats.values():
        lengths[fmt.number] = fmt.length
    slots = np.full(256, -1, dtype=np.int64)
    for slot, name in enumerate(names):
        slots[formats[name].number] = slot
    nowhere = np.empty((len(names), 0), dtype=np.int64)
    counts = np.zeros(len(names), dtype=np.int64)
    lost = int(_scan(data, lengths, slots, counts, nowhere))
    starts = np.empty((len(names), int(counts.max(initial=0))), dtype=np.int64)
    filled = np.zeros_like(counts)
    if starts.shape[1]:
        _scan(data, lengths, slots, filled, starts)
    return {name: starts[slot, : counts[slot]] for slot, name in enumerate(names)}, lost


@compiled
def _scan(
    data: ByteArray, lengths: IndexArray, slots: IndexArray, counts: IndexArray, starts: IndexArray
) -> int:
    """Count messages by slot and, if ``starts`` has room, store their positions; return the number of lost bytes."""
    size = data.size
    keep = starts.shape[1] > 0
    lost = 0
    at = 0
    while at + 3 <= size:
        length = lengths[data[at + 2]] if data[at] == 0xA3 and data[at + 1] == 0x95 else 0
        end = at + length
        whole = length > 0 and end <= size
        followed = end + 2 > size or (data[end] == 0xA3 and data[end + 1] == 0x95) if whole else False
        if not followed:
            at += 1
            lost += 1
            continue
        slot = slots[data[at + 2]]
        if slot >= 0:
            if keep:
                starts[slot, counts[slot]] = at
            counts[slot] += 1
        at = end
    return lost + size - at


@compiled
def _copy(data: ByteArray, starts: IndexArray, first: int, rows: ByteArray) -> None:
    for i in range(rows.shape[0]):
        for j in range(rows.shape[1]):
            rows[i, j] = data[starts[i] + first + j]


def read_columns(
    data: ByteArray, fmt: Format, starts: IndexArray, columns: tuple[str, ...]
) -> npt.NDArray[np.float64]:
    """Read columns of messages, in the units of their names.

    Parameters
    ----------
    data
        Bytes of the log.
    fmt
        Format of the message.
    starts
        Positions of the messages (n,).
    columns
        Their names, k of them.

    Returns
    -------
    array
        Values (n, k).
    """
    values = np.empty((len(starts), len(columns)))
    for k, column in enumerate(columns):
        with np.errstate(invalid="ignore"):  # a damaged float may be a signalling NaN
            values[:, k] = read_column(data, fmt, starts, column)
    values *= [fmt.scales[column] for column in columns]
    return values


def read_column(data: ByteArray, fmt: Format, starts: IndexArray, column: str) -> npt.NDArray[np.generic]:
    """Read one column of messages as stored.

    Parameters
    ----------
    data, fmt, starts
        As for `read_columns`.
    column
        Its name.

    Returns
    -------
    array
        Values (n,), of the message's type.
    """
    kind, first = fmt.dtype.fields[column][:2]  # type: ignore[index]
    rows = np.empty((len(starts), kind.itemsize), dtype=np.uint8)
    _copy(data, starts, int(first), rows)
    return rows.view(kind)[:, 0] if len(starts) else np.empty(0, kind)
