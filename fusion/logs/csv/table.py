"""Tables of numbers in text files as people have them: any separator, header or none, units in brackets, key:value.

Files are read in blocks of a few megabytes and parsed by numpy column by column, so that a log of hours costs little
more than its numbers; only blocks that numpy refuses are looked at row by row, and what is damaged is dropped.
"""

from __future__ import annotations

import csv
import re
import warnings
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path

import numpy as np
import numpy.typing as npt

from fusion.flight import FloatArray
from fusion.logs.samples import counted
from vision import InputError

_HEAD_BYTES = 1 << 16
_BLOCK_BYTES = 1 << 23
_PIECE_ROWS = 2048
_SEPARATORS = (";", "\t", "|", ",", " ")  # a comma may be the decimal point of what semicolons part
_KEY = re.compile(r"[A-Za-z_]\w*:")
_STAMP_BEFORE_KEYS = re.compile(r"^([^A-Za-z;]*?\d[^A-Za-z;]*?)[,;\s]+(?=[A-Za-z_]\w*:)", re.MULTILINE)
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?|nan|[+-]?inf", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class Layout:
    """How a file is written.

    Parameters
    ----------
    path
        The file.
    separator
        Between fields.
    names
        Of the columns, without units; empty strings where there is no header.
    units
        What stood in brackets behind each name.
    header_lines
        Lines before the first row.
    keyed
        Whether each field says its own name, as in ``pitch:0;roll:1;``.
    decimal_comma
        Whether numbers have a comma for the point.
    sample
        The first rows, fields apart.
    """

    path: Path
    separator: str
    names: tuple[str, ...]
    units: tuple[str, ...]
    header_lines: int
    keyed: bool
    decimal_comma: bool
    sample: tuple[tuple[str, ...], ...]

    @property
    def has_names(self) -> bool:
        """Whether columns can be found by name."""
        return any(self.names)

    def find(self, column: str | int, key: str) -> int:
        """Return the index of a column by its name or number, the first being 1.

        Raises
        ------
        InputError
            Naming ``key``, the place in the map, and the columns that there are.
        """
        if isinstance(column, int):
            if column <= len(self.names):
                return column - 1
            raise InputError(
                f"has {counted(len(self.names), 'column')}, none of number {column} ({key})",
                file=self.path,
                remedy="the first column is 1",
            )
        number = self.look_for(column)
        if number is not None:
            return number
        if not self.has_names:
            raise InputError(
                f"has no header, so no column {column!r} ({key})",
                file=self.path,
                remedy="give columns by number, the first is 1",
            )
        near = get_close_matches(column, self.names, n=1, cutoff=0.5)
        listed = ", ".join(self.names[:20])
        remedy = f"did you mean {near[0]}?" if near else f"the columns are {listed}"
        raise InputError(f"has no column {column!r} ({key})", file=self.path, remedy=remedy)

    def look_for(self, name: str) -> int | None:
        """Return the index of a column by its name, in whatever case; None where there is none."""
        plain = _plain(name)[0]
        for wanted, there in ((plain, self.names), (plain.lower(), [n.lower() for n in self.names])):
            if wanted and wanted in there:
                return list(there).index(wanted)
        return None


def _plain(name: str) -> tuple[str, str]:
    """Split a column's name from the unit behind it: ``gyro x [deg/s]``."""
    match = re.fullmatch(r"\s*(.*?)\s*[\[(]\s*(.*?)\s*[\])]\s*", name)
    return (match[1], match[2]) if match and match[1] else (name.strip(), "")


def read_layout(path: Path, separator: str | None = None, header: bool | None = None) -> Layout:
    """Find out how a file is written from its first lines.

    Parameters
    ----------
    path
        The file.
    separator, header
        Where the user says; else found.

    Raises
    ------
    InputError
        Where it cannot be read, is empty, or no text.
    """
    try:
        with path.open("rb") as file:
            head = file.read(_HEAD_BYTES)
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", file=path, remedy="check the file") from error
    if b"\0" in head:
        raise InputError("is no text file", file=path, remedy="give a CSV file")
    text = head.decode("utf-8-sig", errors="replace")
    lines = text.splitlines()
    if len(head) == _HEAD_BYTES and len(lines) > 1:
        del lines[-1]  # may be cut
    rows = [line for line in lines if line.strip() and not line.lstrip().startswith("#")]
    if not rows:
        raise InputError("is empty", file=path, remedy="the file was not written whole; copy it again")
    keyed = len(_KEY.findall(rows[0])) >= 3
    if keyed:
        return _keyed_layout(path, rows[0])
    separator = separator or _separator(rows[-20:])
    first = _fields(rows[0], separator)
    named = header if header is not None else not any(_is_number(field, separator) for field in first)
    comment = next((line for line in reversed(lines[: lines.index(rows[0])]) if separator in line), None)
    titles = first if named else [""] * len(first)
    if not named and comment is not None and len(_fields(comment.lstrip("# "), separator)) == len(first):
        titles = _fields(comment.lstrip("# "), separator)
    sample = [tuple(_fields(row, separator)) for row in rows[int(named) :][:50]]
    if not sample:
        raise InputError("has a header but no rows", file=path, remedy="the log is empty; leave it out")
    plain = [_plain(title) for title in titles]
    return Layout(
        path,
        separator,
        tuple(name for name, _ in plain),
        tuple(unit for _, unit in plain),
        header_lines=lines.index(rows[0]) + int(named),
        keyed=False,
        decimal_comma=separator != ","
        and any(re.fullmatch(r"[+-]?\d+,\d+", f) for row in sample for f in row),
        sample=tuple(sample),
    )


def _keyed_layout(path: Path, row: str) -> Layout:
    stamped = _STAMP_BEFORE_KEYS.match(row.strip()) is not None
    names = [key.rstrip(":") for key in _KEY.findall(row)]
    names = ["timestamp", *names] if stamped else names
    values = tuple(field.strip() for field in _without_keys(row.strip()).split(";"))[: len(names)]
    return Layout(path, ";", tuple(names), ("",) * len(names), 0, True, False, (values,))


def _without_keys(text: str) -> str:
    return _KEY.sub("", _STAMP_BEFORE_KEYS.sub(r"\1;", text))


def _fields(line: str, separator: str) -> list[str]:
    if separator == " ":
        return line.split()
    return [field.strip() for field in next(csv.reader([line], delimiter=separator))]


def _is_number(field: str, separator: str) -> bool:
    return _NUMBER.fullmatch(field if separator == "," else field.replace(",", ".", 1)) is not None


def _separator(rows: Sequence[str]) -> str:
    """Return the separator that most rows have equally often; a comma where there is one column."""
    for separator in _SEPARATORS:
        width, times = Counter(len(_fields(row, separator)) for row in rows).most_common(1)[0]
        if width > 1 and 2 * times > len(rows):
            return separator
    return ","


@dataclass(frozen=True, slots=True, eq=False)
class Columns:
    """Some columns of a file.

    Parameters
    ----------
    row
        Number (n,) of each row in the file, without header and empty lines; dropped rows leave gaps.
    first
        The first column (n,): integers where the file has whole numbers, else floats, or texts.
    values
        The others (n, k), NaN where a field is empty.
    """

    row: npt.NDArray[np.int64]
    first: npt.NDArray[np.generic]
    values: FloatArray


def read_columns(
    layout: Layout, first: int, others: Sequence[int], first_type: str, problems: list[str]
) -> Columns:
    """Read columns of a file, dropping rows that are damaged and saying so.

    Parameters
    ----------
    layout
        Of the file.
    first, others
        Indices of the columns.
    first_type
        Of the first column: ``i8``, ``f8`` or ``O`` for text.
    problems
        Sentences are appended here.

    Raises
    ------
    InputError
        Where no row is left.
    """
    dtype = np.dtype([("t", first_type), ("v", "f8", (len(others),))])
    parts: list[npt.NDArray[np.void]] = []
    numbers: list[npt.NDArray[np.int64]] = []
    broken: list[str] = []
    n_broken, done = 0, 0
    usecols = (first, *others)
    for block in _blocks(layout, problems):
        whole = _parse_fast(block, dtype, layout.separator, usecols)
        # One damaged row must not cost the speed of a whole block.
        pieces = (
            [block[i : i + _PIECE_ROWS] for i in range(0, len(block), _PIECE_ROWS)]
            if whole is None
            else [block]
        )
        for lines in pieces:
            part = whole if whole is not None else _parse_fast(lines, dtype, layout.separator, usecols)
            kept = np.arange(len(lines))
            if part is None:
                part, kept, bad = _parse_slowly(lines, dtype, layout.separator, usecols)
                n_broken += len(bad)
                broken = broken or bad[:1]
            parts.append(part)
            numbers.append(kept + done)
            done += len(lines)
    data = np.concatenate(parts) if parts else np.zeros(0, dtype)
    if not len(data):
        names = ", ".join(name or f"column {i + 1}" for i, name in enumerate(layout.names))
        raise InputError(
            "has no row of the numbers wanted", file=layout.path, remedy=f"its columns are {names}"
        )
    if n_broken:
        what = f"{counted(n_broken, 'row')} damaged, dropped"
        problems.append(f"{layout.path.name}: {what}, the first is {broken[0][:60]!r}")
    return Columns(np.concatenate(numbers), data["t"], data["v"])


def _blocks(layout: Layout, problems: list[str]) -> Iterator[list[str]]:
    """Yield the rows of a file, a few megabytes at a time."""
    skip, rest, before = layout.header_lines, "", ""
    try:
        with layout.path.open(encoding="utf-8-sig", errors="replace", newline=None) as file:
            for _ in range(skip):
                file.readline()
            while block := file.read(_BLOCK_BYTES):
                whole, line_end, cut = (rest + block).rpartition("\n")
                rest = cut
                lines = _rows(layout, whole + line_end)
                if lines:
                    before = lines[-1]
                    yield lines
    except OSError as error:
        raise InputError(
            f"cannot be read: {error.strerror}", file=layout.path, remedy="check the file"
        ) from error
    last = _rows(layout, rest)
    if last and before and _is_cut(last[0], before, layout.separator):
        problems.append(f"{layout.path.name}: the last line is cut short, dropped")
    elif last:
        yield last


def _rows(layout: Layout, text: str) -> list[str]:
    if layout.keyed:
        text = _without_keys(text)
    if layout.decimal_comma:
        text = text.replace(",", ".")
    if layout.separator == " ":
        return [
            " ".join(line.split()) for line in text.split("\n") if line.strip() and line.lstrip()[0] != "#"
        ]
    return [line for line in text.split("\n") if line and not line.isspace() and line.lstrip()[0] != "#"]


def _is_cut(last: str, before: str, separator: str) -> bool:
    """Whether the last line, which has no line break, seems cut; a false alarm costs one row."""
    if last.count(separator) != before.count(separator):
        return last.count(separator) < before.count(separator)

    def after_point(line: str) -> int:
        return len(line.rsplit(separator, 1)[-1].partition(".")[2].strip())

    return after_point(last) < after_point(before)


def _parse_fast(
    lines: list[str], dtype: np.dtype[np.void], separator: str, usecols: tuple[int, ...]
) -> npt.NDArray[np.void] | None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # an integer read through a float would lose its last digits
        try:
            return np.loadtxt(
                lines,
                dtype=dtype,
                delimiter=separator,
                usecols=usecols,
                comments=None,
                quotechar='"',
                ndmin=1,
            )
        except (ValueError, OverflowError, IndexError, Warning):
            return None


def _parse_slowly(
    lines: list[str], dtype: np.dtype[np.void], separator: str, usecols: tuple[int, ...]
) -> tuple[npt.NDArray[np.void], npt.NDArray[np.int64], list[str]]:
    """Parse row by row: what is good, its row numbers, and what is broken."""
    convert = {"i": int, "f": float}.get(dtype["t"].kind, str)
    rows: list[tuple[object, list[float]]] = []
    kept: list[int] = []
    broken: list[str] = []
    for number, line in enumerate(lines):
        try:
            fields = _fields(line, separator)
            first = convert(fields[usecols[0]])
            values = [float(fields[i]) if fields[i] else np.nan for i in usecols[1:]]
            if isinstance(first, int) and abs(first) >= 2**63:
                raise ValueError(first)
        except (ValueError, IndexError, csv.Error, StopIteration):
            broken.append(line)
            continue
        rows.append((first, values))
        kept.append(number)
    return np.array(rows, dtype=dtype), np.array(kept, dtype=np.int64), broken
