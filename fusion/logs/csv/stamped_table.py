"""CSV files of a fixed form: integer nanoseconds, then numbers in a known order, as in ASL / EuRoC ``data.csv``.

The files may be truncated, unsorted or damaged; damaged rows are dropped and reported.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from fusion.flight import FloatArray, TimeArray
from fusion.logs.csv.rows import RowFormat, is_number, is_row, read_blocks, read_head, read_rows
from fusion.logs.samples import MIN_STEP_NS, NOT_NANOSECONDS, Problems, WithProblems, counted, in_order
from vision import InputError

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
    """Head of a file: the columns' names, if any, the number of lines before the rows, and the first rows."""

    names: tuple[str, ...] | None
    lines: int
    sample: tuple[str, ...]


def read_table(
    path: Path,
    columns: Sequence[str],
    *,
    label: str,
    min_step_ns: int = MIN_STEP_NS,
    by_name: bool = False,
) -> WithProblems[CsvTable]:
    """Read ``timestamp, columns ...``; damaged rows are dropped.

    Parameters
    ----------
    path
        The file; comment lines start with ``#``, and the first line may contain column names.
    columns
        Names of the columns after the time, for messages.
    label
        Name of the file in problems, such as ``imu0/data.csv``.
    min_step_ns
        A median time step below it means that the times are not nanoseconds.
    by_name
        Find the columns by the names in the file's header, if it has one, instead of by their order.

    Raises
    ------
    InputError
        If no usable rows are left, or the columns or times are not as expected.
    """
    head = read_table_head(path)
    order: list[int] | None = None
    width = len(columns) + 1
    if by_name and head.names is not None:
        missing = [name for name in columns if name not in head.names]
        if missing:
            raise InputError(
                f"has no column {', '.join(missing)}", file=path, remedy="name it in the first line"
            )
        order = [head.names.index(name) - 1 for name in columns]
        width = len(head.names)
    check_columns(path, head, width, ("timestamp", *columns))
    fmt = RowFormat(",", 0, tuple(range(1, width)), width=width, quoted=False)
    rows = read_rows(read_blocks(path, ",", skip_lines=head.lines), fmt)
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
    values = rows.values[index] if order is None else rows.values[index][:, order]
    return WithProblems(CsvTable(t_ns[index], values), problems + disorder)


def read_table_head(path: Path) -> Head:
    """Read the head of a file and its first rows.

    Raises
    ------
    InputError
        If it cannot be read, or has no row.
    """
    lines = read_head(path)
    names: tuple[str, ...] | None = None
    start, first = 0, True
    for number, line in enumerate(lines):
        if line and not line.isspace():
            if not line.lstrip().startswith("#") and not (first and _has_column_names(line)):
                start = number
                break
            first = False
            if "," in line:  # names, not a remark; without units in brackets
                names = tuple(re.sub(r"\s*\[.*", "", name).strip() for name in line.lstrip("# ").split(","))
    else:
        raise InputError(
            "has a header but no rows", file=path, remedy="the log is empty; take the folder away"
        )
    rows = [line for line in lines[start:] if is_row(line)]
    return Head(names, start, tuple(rows[:_LOOKED_AT]))


def _has_column_names(line: str) -> bool:
    """Whether a first line contains column names: letters in place of the time."""
    return re.match(r"\s*[A-Za-z_]", line) is not None and not is_number(line.split(",")[0])


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
    rows = [row.split(",") for row in head.sample]
    wrong = [len(fields) for fields in rows if len(fields) != width]
    if 2 * len(wrong) > len(rows):
        raise InputError(
            f"has rows of {counted(wrong[0], 'column')} instead of {width}",
            file=path,
            remedy=f"the columns are {', '.join(columns)}",
        )
    times = [fields[0].strip() for fields in rows]
    floats = [t for t in times if is_number(t) and not re.fullmatch(r"[+-]?\d+", t) and t.lower() != "nan"]
    if 2 * len(floats) > len(rows):
        raise InputError(
            f"timestamp {floats[0]} is not a whole number",
            file=path,
            remedy=f"{NOT_NANOSECONDS}; multiply seconds by 1e9",
        )
