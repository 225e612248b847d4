"""Tables of numbers in text files of any form: any separator, optional header, units in brackets, key:value.

`read_layout` detects the layout of a file, `read_columns` reads some of its columns.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from fusion.logs.csv.rows import RowFormat, Rows, is_row, read_blocks, read_head, read_rows, split_fields
from fusion.logs.csv.time_units import is_date
from fusion.logs.samples import Problems, WithProblems, counted
from fusion.settings.sentences import did_you_mean
from vision import InputError

_SEPARATORS = (";", "\t", "|", ",", " ")  # a comma may be the decimal point between semicolons
_KEY = re.compile(r"\b[A-Za-z_]\w*:")
_STAMP_BEFORE_KEYS = re.compile(
    r"^(?=[^A-Za-z;]*\d)([^A-Za-z;]*?[^A-Za-z;,\s])[,;\s]++(?=[A-Za-z_]\w*:)", re.MULTILINE
)
_DATE_AND_TIME = re.compile(
    r"\b(\d{4}[-/.]\d{1,2}[-/.]\d{1,2}|\d{1,2}\.\d{1,2}\.\d{4}) (\d{1,2}:\d{2}:\d{2})"
)
_MAX_NAME = 200  # of a column
_UNIT_WORDS = (
    "s|sec|seconds|ms|us|µs|ns|rad|radians|mrad|deg|degrees?|°|dps|m|dm|cm|mm|km|g|mg|°?c|pa|hpa|mbar|ut|µt|gauss|"
    "v|mv|a|hz|%"
)
_UNIT_PART = rf"(?:{_UNIT_WORDS})(?:[\^*]*-?\d|[²³])?"
_UNIT = re.compile(rf"(?:{_UNIT_PART}(?:[\s/*·]+{_UNIT_PART})*|-|1|none|utc|unix)?", re.IGNORECASE)
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?|nan|[+-]?inf", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class Layout:
    """Layout of a file.

    Parameters
    ----------
    path
        The file.
    separator
        Between fields.
    names
        Of the columns, without units; empty strings if there is no header.
    units
        Text in brackets after each name.
    header_lines
        Lines before the first row.
    keyed
        Whether each field contains its name, as in ``pitch:0;roll:1;``.
    decimal_comma
        Whether numbers have a decimal comma.
    sample
        The first rows, split into fields.
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
            With ``key``, the place in the map, and the existing columns.
        """
        if isinstance(column, int):
            if column <= len(self.names):
                return column - 1
            raise InputError(
                f"has {counted(len(self.names), 'column')}, none of number {column} ({key})",
                file=self.path,
                remedy="the first column is 1",
            )
        number = self.find_column(column)
        if number is not None:
            return number
        if not self.has_names:
            raise InputError(
                f"has no header, so no column {column!r} ({key})",
                file=self.path,
                remedy="give columns by number, the first is 1",
            )
        listed = ", ".join(self.names[:20])
        remedy = did_you_mean(column, self.names) or f"the columns are {listed}"
        raise InputError(f"has no column {column!r} ({key})", file=self.path, remedy=remedy)

    def find_column(self, name: str) -> int | None:
        """Return the index of a column by its name, ignoring case; None if there is no such column."""
        plain = name_and_unit(name)[0]
        for wanted, there in ((plain, self.names), (plain.lower(), [n.lower() for n in self.names])):
            if wanted and wanted in there:
                return list(there).index(wanted)
        return None


def name_and_unit(name: str) -> tuple[str, str]:
    """Split a column's name and the unit after it: ``gyro x [deg/s]``."""
    if len(name) > _MAX_NAME:
        return name.strip(), ""
    match = re.fullmatch(r"\s*(.*?)\s*[\[(]\s*(.*?)\s*[\])]\s*", name)
    if match is None or not match[1] or match[2].isdigit():  # a number is an index, as in gyroADC[0]
        return name.strip(), ""
    return match[1], match[2]


def read_layout(path: Path, separator: str | None = None, header: bool | None = None) -> Layout:
    """Detect the layout of a file from its first lines.

    Parameters
    ----------
    path
        The file.
    separator, header
        As given by the user; None: detected.

    Raises
    ------
    InputError
        If it cannot be read, is empty, or is not a text.
    """
    lines = [_dates_joined(line) for line in read_head(path)]
    if any("\0" in line for line in lines):
        raise InputError("is not a text file", file=path, remedy="give a CSV file")
    rows = [line for line in lines if is_row(line)]
    if not rows:
        raise InputError("is empty", file=path, remedy="the file was not written whole; copy it again")
    keyed = len(_KEY.findall(rows[0])) >= 3
    if keyed:
        return _keyed_layout(path, rows[0])
    separator = separator or _separator(rows[-20:])
    rows = _without_preamble(rows, separator)
    first = split_fields(rows[0], separator)
    named = not any(_is_number(f, separator) or is_date(f) for f in first) if header is None else header
    comment = next((line for line in reversed(lines[: lines.index(rows[0])]) if separator in line), None)
    titles = first if named else [""] * len(first)
    if not named and comment is not None:
        fields = split_fields(comment.lstrip("# "), separator)
        fields += [""] * (len(first) - len(fields) if not any(first[len(fields) :]) else 0)  # trailing comma
        titles = fields if len(fields) == len(first) else titles
    units = split_fields(rows[1], separator) if named and len(rows) > 2 else []
    has_units = len(units) == len(titles) and all(is_unit(field) for field in units)
    has_units &= any(sign.isalpha() or sign in "°%" for field in units for sign in field)
    skipped = int(named) + int(has_units)
    sample = [tuple(split_fields(row, separator)) for row in rows[skipped:][:50]]
    if not sample:
        raise InputError("has a header but no rows", file=path, remedy="the log is empty; leave it out")
    plain = [name_and_unit(title) for title in titles]
    if has_units:
        plain = [(name, unit.strip("[]() ")) for (name, _), unit in zip(plain, units, strict=True)]
    return Layout(
        path,
        separator,
        tuple(name for name, _ in plain),
        tuple(unit for _, unit in plain),
        header_lines=lines.index(rows[0]) + skipped,
        keyed=False,
        decimal_comma=has_decimal_comma(separator, sample),
        sample=tuple(sample),
    )


def has_decimal_comma(separator: str, sample: Iterable[Iterable[str]]) -> bool:
    """Whether numbers in the first rows have a decimal comma."""
    return separator != "," and any(re.fullmatch(r"[+-]?\d+,\d+", f) for row in sample for f in row)


def is_unit(field: str) -> bool:
    """Whether a field of a second title line is a unit: ``rad/s``, ``[m/s^2]``, or empty."""
    return _UNIT.fullmatch(field.strip().strip("[]()").strip()) is not None


def _dates_joined(text: str) -> str:
    """Join date and time of day by a T, because blanks may separate the columns."""
    return _DATE_AND_TIME.sub(r"\1T\2", text)


def _without_preamble(rows: list[str], separator: str) -> list[str]:
    """Skip lines of another width before the table, such as settings with their values."""
    widths = [len(split_fields(row, separator)) for row in rows]
    if widths[-1] == 1:
        return rows
    start = next((k for k in range(len(rows) - 1, -1, -1) if widths[k] != widths[-1]), -1) + 1
    # Damaged rows within the table are not a preamble.
    numbers = sum(_is_number(split_fields(row, separator)[0], separator) for row in rows[:start])
    return rows if numbers or start >= len(rows) - 1 else rows[start:]


def _keyed_layout(path: Path, row: str) -> Layout:
    stamped = _STAMP_BEFORE_KEYS.match(row.strip()) is not None
    names = [key.rstrip(":") for key in _KEY.findall(row)]
    names = ["timestamp", *names] if stamped else names
    values = tuple(field.strip() for field in _without_keys(row.strip()).split(";"))[: len(names)]
    return Layout(path, ";", tuple(names), ("",) * len(names), 0, True, False, (values,))


def _without_keys(text: str) -> str:
    return _KEY.sub("", _STAMP_BEFORE_KEYS.sub(r"\1;", text))


def _is_number(field: str, separator: str) -> bool:
    return _NUMBER.fullmatch(field if separator == "," else field.replace(",", ".", 1)) is not None


def _separator(rows: Sequence[str]) -> str:
    """Return the separator with the most consistent count per row; a comma if there is only one column."""
    for separator in _SEPARATORS:
        width, times = Counter(len(split_fields(row, separator)) for row in rows).most_common(1)[0]
        if width > 1 and 2 * times > len(rows):
            return separator
    return ","


def read_columns(layout: Layout, first: int, others: Sequence[int], first_type: str) -> WithProblems[Rows]:
    """Read columns of a file; damaged rows are dropped and reported.

    Parameters
    ----------
    layout
        Of the file.
    first, others
        Indices of the columns.
    first_type
        Of the first column: ``i8``, ``f8`` or ``O`` for text.

    Raises
    ------
    InputError
        If no row is left.
    """

    def tidy(text: str) -> str:
        text = _without_keys(text) if layout.keyed else text
        text = _dates_joined(text) if layout.separator == " " else text
        return text.replace(",", ".") if layout.decimal_comma else text

    blocks = read_blocks(layout.path, layout.separator, skip_lines=layout.header_lines, tidy=tidy)
    rows = read_rows(blocks, RowFormat(layout.separator, first, tuple(others), first_type))
    if not len(rows.first):
        names = ", ".join(name or f"column {i + 1}" for i, name in enumerate(layout.names))
        raise InputError(
            "has no row of the numbers wanted", file=layout.path, remedy=f"its columns are {names}"
        )
    problems: Problems = ()
    if rows.cut:
        problems += (f"{layout.path.name}: the last line is cut short, dropped",)
    if rows.damaged:
        what = f"{counted(rows.damaged, 'row')} damaged, dropped"
        problems += (f"{layout.path.name}: {what}, the first is {rows.first_damaged[:60]!r}",)
    return WithProblems(rows, problems)
