"""Rows of text tables, the part that every reader of a table shares: blocks, fields, numbers, and what is damaged.

A file is read in blocks of a few megabytes, so that a log of hours costs little more than its numbers. numpy parses a
block whole; only where it refuses are rows looked at one by one. A last line that lacks its line break and looks
shorter than the one before was cut, and is left out.
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
_LONGEST_SIGN = 3  # bytes of UTF-8 that a cut may take from one
_SIGNS_1252 = (b"\xb0", b"\xb2", b"\xb5")  # of degrees, squares and micro, by which units are known
_BLOCK_CHARACTERS = 1 << 23
_MAX_LINE = 1 << 20
_PIECE_ROWS = 2048
_WORDS = {"true": "1", "false": "0", "null": "nan", "none": "nan"}


def parse_time(text: str) -> int | None:
    """Whole number that fits 64 bits, such as nanoseconds; None if the text is something else."""
    if not re.fullmatch(r"[+-]?0*[0-9]{1,19}", text):
        return None
    number = int(text)
    return number if abs(number) < 2**63 else None


def is_number(text: str) -> bool:
    """Whether Python reads a text as a number."""
    try:
        float(text)
    except ValueError:
        return False
    return True


def split_fields(line: str, separator: str, *, quoted: bool = True) -> list[str]:
    """Take a line apart, blanks around its fields left out; a blank as separator stands for any number of them."""
    if separator == " ":
        return line.split()
    if not quoted:
        return [field.strip() for field in line.split(separator)]
    return [field.strip() for field in next(csv.reader([line], delimiter=separator))]


def encoding_of(head: bytes) -> str:
    """Return how a text is encoded by its first bytes: UTF-16 as Excel's Unicode text is, UTF-8, else as of old."""
    little, big = head.startswith(b"\xff\xfe") and head[3:4] == b"\0", head.startswith(b"\xfe\xff\0")
    if little or big:
        return "utf-16"
    try:
        # A sign may be cut at the end; zeros and the like are left to who reads the rows.
        head[: -_LONGEST_SIGN or None].decode("utf-8")
    except UnicodeDecodeError:
        return "cp1252" if any(head.count(sign) for sign in _SIGNS_1252) else "utf-8-sig"
    return "utf-8-sig"


def read_head(path: Path) -> list[str]:
    """Read the first lines of a text file, up to 64 kB.

    Raises
    ------
    InputError
        If it cannot be read or holds nothing but blanks.
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
        del lines[-1]  # may be cut
    if not any(line.strip() for line in lines):
        raise InputError("is empty", file=path, remedy="the file was not written whole; copy it again")
    return lines


def is_row(line: str) -> bool:
    """Whether a line is neither blank nor a comment."""
    return bool(line) and not line.isspace() and line.lstrip()[0] != "#"


class Block(NamedTuple):
    """Some rows of a file in a row; ``cut`` where a last line that was cut short is left out after them."""

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
        Between fields; by their number a cut line is known.
    skip_lines
        Lines before the first row.
    tidy
        Applied to the text of each block before it is taken apart.
    leave_out_cut
        Whether a last line that seems cut is left out.

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
    """Whether the last line, which has no line break, seems cut; a false alarm costs one row."""
    if last.count(separator) != before.count(separator):
        return last.count(separator) < before.count(separator)

    def digits_after_point(line: str) -> int:
        return len(line.rsplit(separator, 1)[-1].partition(".")[2].strip())

    return digits_after_point(last) < digits_after_point(before)


@dataclass(frozen=True, slots=True)
class RowFormat:
    """What to read of each row.

    Parameters
    ----------
    separator
        Between fields.
    first, others
        Indices of the columns: one of times or names, and those of numbers.
    first_type
        Of the first: ``i8``, ``f8`` or ``O`` for text.
    width
        Number of fields that a row must have; None for any number.
    quoted
        Whether a field may stand in double quotes.
    keep_bad_fields
        Where a field is not a number: whether it becomes NaN and is noted, and ``true``, ``false``, ``null`` and
        ``none`` are understood; otherwise its whole row is dropped.
    """

    separator: str
    first: int
    others: tuple[int, ...]
    first_type: str = "i8"
    width: int | None = None
    quoted: bool = True
    keep_bad_fields: bool = False

    @property
    def dtype(self) -> np.dtype[np.void]:
        """Of a parsed row: the first column ``t``, the others ``v`` (k,)."""
        return np.dtype([("t", self.first_type), ("v", "f8", (len(self.others),))])


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """What was read of a file.

    Parameters
    ----------
    number
        Number (n,) of each row among all rows of the file; dropped rows leave gaps.
    first
        The first column (n,): integers, floats or texts.
    values
        The others (n, k); a field that is empty is NaN.
    damaged, first_damaged
        How many rows were dropped, and the first of them.
    bad_fields
        Text of the fields that became NaN though they were not empty, by the index of their column.
    cut
        Whether the last line was cut short and left out.
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
        # One damaged row must not cost the speed of a whole block.
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
    """Some parsed rows, numbered among the lines given; how many lines were damaged, the first, and bad fields."""

    data: npt.NDArray[np.void]
    number: npt.NDArray[np.int64]
    damaged: int = 0
    first_damaged: str = ""
    bad_fields: tuple[tuple[int, str], ...] = ()


def _parse_fast(lines: list[str], fmt: RowFormat) -> npt.NDArray[np.void] | None:
    """Parse rows by numpy; None if it does not take them."""
    columns = (fmt.first, *fmt.others)
    takes_all = columns == tuple(range(fmt.width or 0))  # then numpy sees to it that no row is longer
    if fmt.width is not None and not takes_all and not _all_of_width(lines, fmt):
        return None
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # an integer read through a float would lose its last digits
        try:
            return np.loadtxt(
                lines,
                dtype=fmt.dtype,
                delimiter=fmt.separator,
                usecols=None if takes_all else columns,
                comments=None,
                quotechar='"' if fmt.quoted else None,
                ndmin=1,
            )
        except (ValueError, OverflowError, IndexError, Warning):
            return None


def _all_of_width(lines: list[str], fmt: RowFormat) -> bool:
    return all('"' not in line and line.count(fmt.separator) + 1 == fmt.width for line in lines)


def _parse_slowly(lines: Sequence[str], fmt: RowFormat) -> _Part:
    """Parse row by row, so that only what is damaged is lost."""
    converters: dict[str, Callable[[str], int | float | str]] = {"i8": _whole, "f8": float, "O": str}
    convert = converters[fmt.first_type]
    rows: list[tuple[int | float | str, list[float]]] = []
    kept: list[int] = []
    first_damaged = ""
    bad_fields: list[tuple[int, str]] = []
    for number, line in enumerate(lines):
        try:
            fields = split_fields(line, fmt.separator, quoted=fmt.quoted)
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
    """Write a field as Python reads it as a number: nothing is NaN, and so are, if asked for, words for it."""
    return "nan" if not text else _WORDS.get(text.lower(), text) if words else text


def _whole(text: str) -> int:
    number = parse_time(text)
    if number is None:
        raise ValueError(text)
    return number
