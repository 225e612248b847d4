"""Rows of text tables, shared by all readers of tables: blocks, fields, numbers, and damaged rows.

A file is read in blocks of a few megabytes, so that a log of hours needs little more memory than its numbers. numpy
parses whole blocks; rows are parsed one by one only if it fails. A last line without a line break that seems shorter
than the one before is truncated, and is left out.
"""

from __future__ import annotations

import csv
import re
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fusion.flight import FloatArray
from vision import InputError
from vision.limits import check_is_file

_HEAD_BYTES = 1 << 16
_LONGEST_SIGN = 3  # bytes of a UTF-8 character that may be cut off
_SIGNS_1252 = (b"\xb0", b"\xb2", b"\xb5")  # of degrees, squares and micro, in units
_BLOCK_CHARACTERS = 1 << 23
_MAX_LINE = 1 << 20
_PIECE_ROWS = 2048
_WORDS = {"true": "1", "false": "0", "null": "nan", "none": "nan"}


def parse_time(text: str) -> int | None:
    """Integer that fits 64 bits, such as nanoseconds; None for any other text."""
    if not re.fullmatch(r"[+-]?0*[0-9]{1,19}", text):
        return None
    number = int(text)
    return number if abs(number) < 2**63 else None


def is_number(text: str) -> bool:
    """Whether Python can read a text as a number."""
    try:
        float(text)
    except ValueError:
        return False
    return True


def split_fields(line: str, separator: str) -> list[str]:
    """Split a line into stripped fields; a blank as separator stands for any number of blanks."""
    if separator == " ":
        return line.split()
    return [field.strip() for field in next(csv.reader([line], delimiter=separator))]


def encoding_of(head: bytes) -> str:
    """Return a text's encoding, by its first bytes: UTF-16 (Excel's Unicode text), UTF-8, or else Windows-1252."""
    little, big = head.startswith(b"\xff\xfe") and head[3:4] == b"\0", head.startswith(b"\xfe\xff\0")
    if little or big:
        return "utf-16"
    try:
        # The last character may be cut; zero bytes are handled when the rows are read.
        head[: -_LONGEST_SIGN or None].decode("utf-8")
    except UnicodeDecodeError:
        return "cp1252" if any(head.count(sign) for sign in _SIGNS_1252) else "utf-8-sig"
    return "utf-8-sig"


def read_head(path: Path) -> list[str]:
    """Read the first lines of a text file, up to 64 kB.

    Raises
    ------
    InputError
        If it cannot be read or contains only blanks.
    """
    try:
        check_is_file(path)
        with path.open("rb") as file:
            head = file.read(_HEAD_BYTES)
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", file=path, remedy="check the file") from error
    text = head.decode(encoding_of(head), errors="replace")
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    if len(head) == _HEAD_BYTES and len(lines) > 1:
        del lines[-1]  # may be truncated
    if not any(line.strip() for line in lines):
        raise InputError("is empty", file=path, remedy="the file was not written whole; copy it again")
    return lines


def is_row(line: str) -> bool:
    """Whether a line is neither blank nor a comment."""
    return bool(line) and not line.isspace() and line.lstrip()[0] != "#"


class Block(NamedTuple):
    """Consecutive rows of a file; ``cut`` if a truncated last line after them is left out."""

    rows: list[str]
    cut: bool = False


def read_blocks(
    path: Path,
    separator: str,
    *,
    skip_lines: int = 0,
    tidy: Callable[[str], str] | None = None,
    leave_out_cut: bool = True,
) -> Iterator[Block]:
    """Yield the rows of a file without blank lines and comments, a few megabytes at a time.

    Parameters
    ----------
    path
        The file.
    separator
        Between fields; their number shows whether a line is truncated.
    skip_lines
        Lines before the first row.
    tidy
        Applied to the text of each block before it is split.
    leave_out_cut
        Whether a last line that seems truncated is left out.

    Raises
    ------
    InputError
        If the file cannot be read.
    """

    def rows_of(text: str) -> list[str]:
        lines = (tidy(text) if tidy is not None else text).split("\n")
        if separator == " ":
            return [" ".join(line.split()) for line in lines if is_row(line)]
        return [line for line in lines if is_row(line)]

    rest, before = "", ""
    try:
        with path.open("rb") as raw:
            encoding = encoding_of(raw.read(_HEAD_BYTES))
        with path.open(encoding=encoding, errors="replace", newline=None) as file:
            for _ in range(skip_lines):
                file.readline()
            while text := file.read(_BLOCK_CHARACTERS):
                if len(rest) > _MAX_LINE:
                    raise InputError(f"has a line of more than {_MAX_LINE} characters", file=path)
                whole, line_end, rest = (rest + text).rpartition("\n")
                rows = rows_of(whole + line_end)
                if rows:
                    before = rows[-1]
                    yield Block(rows)
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", file=path, remedy="check the file") from error
    last = rows_of(rest)
    if last and before and leave_out_cut and _is_cut(last[0], before, separator):
        yield Block([], cut=True)
    elif last:
        yield Block(last)


def _is_cut(last: str, before: str, separator: str) -> bool:
    """Whether the last line, which has no line break, seems truncated; a false alarm costs one row."""
    if last.count(separator) != before.count(separator):
        return last.count(separator) < before.count(separator)

    def digits_after_point(line: str) -> int:
        return len(line.rsplit(separator, 1)[-1].partition(".")[2].strip())

    return digits_after_point(last) < digits_after_point(before)


@dataclass(frozen=True, slots=True)
class RowFormat:
    """Format of the rows, and the columns to read.

    Parameters
    ----------
    separator
        Between fields, which may be in double quotes.
    first, others
        Indices of the columns: one of times or names, and those of numbers.
    first_type
        Of the first: ``i8``, ``f8`` or ``O`` for text.
    width
        Required number of fields in a row; None for any number.
    keep_bad_fields
        If true, a field that is not a number becomes NaN and is recorded, and ``true``, ``false``, ``null`` and
        ``none`` are accepted; otherwise its whole row is dropped.
    """

    separator: str
    first: int
    others: tuple[int, ...]
    first_type: str = "i8"
    width: int | None = None
    keep_bad_fields: bool = False

    @property
    def dtype(self) -> np.dtype[np.void]:
        """Type of a parsed row: the first column ``t``, the others ``v`` (k,)."""
        return np.dtype([("t", self.first_type), ("v", "f8", (len(self.others),))])


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """Parsed rows of a file.

    Parameters
    ----------
    number
        Number (n,) of each row among all rows of the file; dropped rows leave gaps.
    first
        The first column (n,): integers, floats or texts.
    values
        The other columns (n, k); empty fields are NaN.
    damaged, first_damaged
        Number of dropped rows, and the first of them.
    bad_fields
        Text of non-empty fields that became NaN, by the index of their column.
    cut
        Whether the last line was truncated and left out.
    """

    number: npt.NDArray[np.int64]
    first: npt.NDArray[np.generic]
    values: FloatArray
    damaged: int
    first_damaged: str
    bad_fields: dict[int, list[str]]
    cut: bool


def read_rows(blocks: Iterable[Block], fmt: RowFormat) -> Rows:
    """Parse the rows of a file, dropping those that are damaged; ``blocks`` are as `read_blocks` yields them."""
    parts: list[_Part] = []
    done, cut = 0, False
    for block in blocks:
        cut = cut or block.cut
        whole = _parse_fast(block.rows, fmt)
        # One damaged row must not slow down a whole block.
        step = _PIECE_ROWS if whole is None else max(len(block.rows), 1)
        for start in range(0, len(block.rows), step):
            lines = block.rows[start : start + step]
            data = _parse_fast(lines, fmt) if whole is None else whole
            part = _parse_slowly(lines, fmt) if data is None else _Part(data, np.arange(len(lines)))
            parts.append(part._replace(number=part.number + done))
            done += len(lines)
    data = np.concatenate([part.data for part in parts]) if parts else np.zeros(0, fmt.dtype)
    number = np.concatenate([part.number for part in parts]) if parts else np.zeros(0, np.int64)
    damaged = sum(part.damaged for part in parts)
    first_damaged = next((part.first_damaged for part in parts if part.damaged), "")
    bad_fields: dict[int, list[str]] = {}
    for column, text in (found for part in parts for found in part.bad_fields):
        bad_fields.setdefault(column, []).append(text)
    return Rows(number, data["t"], data["v"], damaged, first_damaged, bad_fields, cut)


class _Part(NamedTuple):
    """Some parsed rows, numbered among the given lines; number of damaged lines, the first, and bad fields."""

    data: npt.NDArray[np.void]
    number: npt.NDArray[np.int64]
    damaged: int = 0
    first_damaged: str = ""
    bad_fields: tuple[tuple[int, str], ...] = ()


def _parse_fast(lines: list[str], fmt: RowFormat) -> npt.NDArray[np.void] | None:
    """Parse rows by numpy; None if it fails."""
    columns = (fmt.first, *fmt.others)
    takes_all = columns == tuple(range(fmt.width or 0))  # then numpy rejects longer rows
    if fmt.width is not None and not takes_all and not _all_of_width(lines, fmt):
        return None
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # an integer read as a float would lose its last digits
        try:
            return np.loadtxt(
                lines,
                dtype=fmt.dtype,
                delimiter=fmt.separator,
                usecols=None if takes_all else columns,
                comments=None,
                quotechar='"',
                ndmin=1,
            )
        except (ValueError, OverflowError, IndexError, Warning):
            return None


def _all_of_width(lines: list[str], fmt: RowFormat) -> bool:
    return all('"' not in line and line.count(fmt.separator) + 1 == fmt.width for line in lines)


def _parse_slowly(lines: Sequence[str], fmt: RowFormat) -> _Part:
    """Parse row by row, so that only damaged rows are lost."""
    converters: dict[str, Callable[[str], int | float | str]] = {"i8": _integer, "f8": float, "O": str}
    convert = converters[fmt.first_type]
    rows: list[tuple[int | float | str, list[float]]] = []
    kept: list[int] = []
    first_damaged = ""
    bad_fields: list[tuple[int, str]] = []
    for number, line in enumerate(lines):
        try:
            fields = split_fields(line, fmt.separator)
            if fmt.width is not None and len(fields) != fmt.width:
                raise ValueError(line)
            first = convert(fields[fmt.first])
            bad = [
                (column, fields[column])
                for column in (fmt.others if fmt.keep_bad_fields else ())
                if not is_number(_as_number(fields[column]))
            ]
            wrong = {column for column, _ in bad}
            values = [
                np.nan if column in wrong else float(_as_number(fields[column], words=fmt.keep_bad_fields))
                for column in fmt.others
            ]
        except (ValueError, IndexError, csv.Error, StopIteration):
            first_damaged = first_damaged or line
            continue
        rows.append((first, values))
        kept.append(number)
        bad_fields += bad
    data = np.array(rows, dtype=fmt.dtype)
    damaged = len(lines) - len(kept)
    return _Part(data, np.array(kept, dtype=np.int64), damaged, first_damaged, tuple(bad_fields))


def _as_number(text: str, *, words: bool = True) -> str:
    """Return a field as text that Python reads as a number: NaN if empty or, if requested, a word for NaN."""
    return "nan" if not text else _WORDS.get(text.lower(), text) if words else text


def _integer(text: str) -> int:
    number = parse_time(text)
    if number is None:
        raise ValueError(text)
    return number
