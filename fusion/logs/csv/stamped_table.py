"""CSV files of a fixed form: integer nanoseconds, then known columns of numbers, as in ASL / EuRoC ``data.csv``.

The columns are found by their names in the header, or else by their order. The files may be truncated, unsorted or
damaged; damaged rows are dropped and reported.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fusion.flight import FloatArray, TimeArray
from fusion.logs.csv.column_names import named_columns
from fusion.logs.csv.rows import RowFormat, is_number, is_row, read_blocks, read_head, read_rows
from fusion.logs.csv.table import has_decimal_comma, name_and_unit
from fusion.logs.samples import MIN_STEP_NS, NOT_NANOSECONDS, Problems, WithProblems, counted, in_order
from vision import InputError

#: A time at the start of a row, and the separator after it, if any.
STAMP = re.compile(r'\s*"?([+-]?\d+)"? *([,;|\t]| (?=\S)|$)')
_LOOKED_AT = 20  # first rows, which show whether the columns are the expected ones


@dataclass(frozen=True, slots=True, eq=False)
class CsvTable:
    """Rows of one file in the order of time.

    Parameters
    ----------
    t_ns
        Times (n,), strictly increasing, at least one.
    values
        The other columns (n, k); empty fields are NaN.
    """

    t_ns: TimeArray
    values: FloatArray


@dataclass(frozen=True, slots=True)
class Head:
    """Head of a file.

    Parameters
    ----------
    names, units
        Of the columns, from the header; empty if there is none.
    lines
        Number of lines before the rows.
    separator
        Between fields: the sign after the time.
    sample
        The first rows, split into fields.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    lines: int
    separator: str
    sample: tuple[tuple[str, ...], ...]


def read_table(
    path: Path,
    columns: Sequence[str],
    *,
    label: str,
    min_step_ns: int = MIN_STEP_NS,
    by_name: bool = False,
    roles: Sequence[str] = (),
) -> WithProblems[CsvTable]:
    """Read ``timestamp, columns ...``; damaged rows are dropped.

    Parameters
    ----------
    path
        The file.
    columns
        Names of the columns after the time.
    label
        Name of the file in problems, such as ``imu0/data.csv``.
    min_step_ns
        A median time step below it means that the times are not nanoseconds.
    by_name
        Find the columns by exactly these names in the file's header, if it has one, instead of by their order.
    roles
        Quantities of the columns, such as ``gyro``, in their order: columns with names in common use are found by
        them and converted to SI, and only these are returned.

    Raises
    ------
    InputError
        If no usable rows are left, or the columns or times are not as expected.
    """
    head = read_table_head(path)
    places, factors = tuple(range(1, len(columns) + 1)), np.ones(len(columns))
    width = len(columns) + 1
    if head.names and by_name:
        missing = [name for name in columns if name not in head.names]
        if missing:
            raise InputError(
                f"has no column {', '.join(missing)}", file=path, remedy="name it in the first line"
            )
        places, width = tuple(head.names.index(name) for name in columns), len(head.names)
    elif head.names and (found := _places_by_role(path, head, roles, columns)) is not None:
        places, factors = found
        width = len(head.names)
    check_columns(path, head, width, ("timestamp", *columns))
    fmt = RowFormat(head.separator, 0, places, width=width)
    tidy = _with_decimal_points if has_decimal_comma(head.separator, head.sample) else None
    rows = read_rows(read_blocks(path, head.separator, skip_lines=head.lines, tidy=tidy), fmt)
    if len(rows.first) == 0:
        raise InputError(
            f"has no row of {width} numbers", file=path, remedy="check that it is the right file"
        )
    problems: Problems = ()
    if rows.cut:
        problems += (f"{label}: the last line is cut short, dropped",)
    if rows.damaged:
        what = f"{counted(rows.damaged, 'row')} not of {width} numbers dropped"
        problems += (f"{label}: {what}, the first is {rows.first_damaged[:60]!r}",)
    t_ns = rows.first.astype("i8", copy=False)
    index, disorder = in_order(t_ns, label, min_step_ns, file=path)
    return WithProblems(CsvTable(t_ns[index], rows.values[index] * factors), problems + disorder)


def _with_decimal_points(text: str) -> str:
    return text.replace(",", ".")


def _places_by_role(
    path: Path, head: Head, roles: Sequence[str], columns: Sequence[str]
) -> tuple[tuple[int, ...], FloatArray] | None:
    """Find the columns by the names in the header; None if it has no known name in another place than the usual."""
    if 2 * sum(len(fields) != len(head.names) for fields in head.sample) > len(head.sample):
        return None
    found, factors = named_columns(("", *head.names[1:]), head.units, roles)
    places = tuple(place for place in found if place is not None)
    if places and len(places) == len(found):
        return places, factors
    moved = [place for usual, place in enumerate(found, 1) if place not in (None, usual)]
    if moved:
        missing = [name for name, place in zip(columns, found, strict=False) if place is None]
        raise InputError(
            f"has {head.names[moved[0]]} in column {moved[0] + 1}, but no column {', '.join(missing)}",
            file=path,
            remedy=f"name every column once in the first line, as in timestamp,{','.join(columns)}",
        )
    return None


def read_table_head(path: Path) -> Head:
    """Read the head of a file and its first rows.

    Raises
    ------
    InputError
        If it cannot be read, or has no row.
    """
    lines = read_head(path)
    titles: list[str] = []
    start, first = 0, True
    for number, line in enumerate(lines):
        if line and not line.isspace():
            if not line.lstrip().startswith("#") and not (first and _has_column_names(line)):
                start = number
                break
            first = False
            titles.append(line.lstrip("# "))
    else:
        raise InputError(
            "has a header but no rows", file=path, remedy="the log is empty; take the folder away"
        )
    rows = [line for line in lines[start:] if is_row(line)][:_LOOKED_AT]
    stamps = Counter(found[2] for row in rows if (found := STAMP.match(row)) and found[2])
    separator = stamps.most_common(1)[0][0] if stamps else ","
    title = next((line for line in reversed(titles) if separator in line.strip()), None)
    named = [name_and_unit(name) for name in _fields(title, separator)] if title is not None else []
    return Head(
        tuple(name for name, _ in named),
        tuple(unit for _, unit in named),
        start,
        separator,
        tuple(tuple(_fields(row, separator)) for row in rows),
    )


def _fields(line: str, separator: str) -> list[str]:
    fields = line.split() if separator == " " else line.split(separator)
    return [field.strip().strip('"') for field in fields]


def _has_column_names(line: str) -> bool:
    """Whether a first line contains column names: letters in place of the time."""
    return re.match(r'\s*"?#?\s*[A-Za-z_]', line) is not None and not is_number(re.split(r"[,;|\t]", line)[0])


def check_columns(path: Path, head: Head, width: int, columns: Sequence[str]) -> None:
    """Reject a file whose rows are not as expected.

    Parameters
    ----------
    path, head
        The file, and its head.
    width
        Expected number of columns.
    columns
        Their names, for the message.

    Raises
    ------
    InputError
        If most of the first rows have a wrong number of columns or no integer time.
    """
    rows = head.sample
    wrong = [len(fields) for fields in rows if len(fields) != width]
    if 2 * len(wrong) > len(rows):
        raise InputError(
            f"has rows of {counted(wrong[0], 'column')} instead of {width}",
            file=path,
            remedy=f"the columns are {', '.join(columns)}",
        )
    times = [fields[0] for fields in rows]
    floats = [t for t in times if is_number(t) and not re.fullmatch(r"[+-]?\d+", t) and t.lower() != "nan"]
    if 2 * len(floats) > len(rows):
        raise InputError(
            f"timestamp {floats[0]} is not a whole number",
            file=path,
            remedy=f"{NOT_NANOSECONDS}; multiply seconds by 1e9",
        )
