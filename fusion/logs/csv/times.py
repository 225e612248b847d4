"""Rows of a CSV with their times: detects the column of the time stamps and its unit."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from fusion.flight import Remark, TimeArray
from fusion.logs.csv.column_map import ColumnMap, TimeUnit
from fusion.logs.csv.rows import Rows, is_number
from fusion.logs.csv.table import Layout, read_columns, read_layout
from fusion.logs.csv.time_units import (
    MISSING,
    NS,
    dates_to_ns,
    guess_unit,
    in_words,
    is_date,
    is_time_name,
    to_ns,
    unit_named,
)
from fusion.logs.samples import WithProblems, counted, unwrapped
from vision import InputError

ROLES = ("gyro", "accel", "quaternion", "euler", "velocity", "position", "range")


@dataclass(frozen=True, slots=True, eq=False)
class FrameTimes:
    """Times of pictures from a CSV.

    Parameters
    ----------
    row
        Number (n,) of each row among all rows of the file.
    t_ns
        Time (n,) of each, in the file's order.
    names
        File name of each; None if the file has no such column.
    """

    row: npt.NDArray[np.int64]
    t_ns: TimeArray
    names: tuple[str, ...] | None


def read_times(path: Path, columns: ColumnMap | str | None) -> WithProblems[FrameTimes]:
    """Read the times of pictures and, if there is a column for them, their file names.

    Raises
    ------
    InputError
        If the file has no time stamps.
    """
    column_map = columns if isinstance(columns, ColumnMap) else ColumnMap()
    layout = read_layout(path, column_map.separator, column_map.header)
    names = _picture_column(layout, column_map)
    timed, problems = read_timed(layout, column_map, [], avoid=names)
    number = timed.rows.number
    if names is None:
        return WithProblems(FrameTimes(number, timed.t_ns, None), problems)
    files = read_columns(layout, names, [], "O").value  # its problems are the same as those of the times
    at = np.searchsorted(files.number, number)
    listed = tuple(str(files.first[i]).strip() for i in at)
    return WithProblems(FrameTimes(number, timed.t_ns, listed), problems)


def _picture_column(layout: Layout, column_map: ColumnMap) -> int | None:
    """Find the column of file names: the map's, or else the first with extensions of pictures."""
    from fusion.logs.pictures.camera_folder import PICTURE_SUFFIXES

    if column_map.picture is not None:
        return layout.find(column_map.picture, "columns.picture")
    for index in range(len(layout.names)):
        fields = [row[index] for row in layout.sample if index < len(row)]
        pictures = sum(Path(field).suffix.lower() in PICTURE_SUFFIXES for field in fields)
        if 2 * pictures > len(fields):
            return index
    return None


@dataclass(frozen=True, slots=True, eq=False)
class TimedRows:
    """Rows of a file and their times (n,) in nanoseconds, in the file's order."""

    t_ns: TimeArray
    rows: Rows


def read_timed(
    layout: Layout, columns: ColumnMap, others: list[int], avoid: int | None = None
) -> WithProblems[TimedRows]:
    """Read the time column, in nanoseconds, with others; drops damaged rows and those without a time.

    Parameters
    ----------
    layout, columns
        Layout of the file, and the column map, if given.
    others
        Indices of further columns of numbers.
    avoid
        A column to exclude as the time.

    Raises
    ------
    InputError
        If no column holds times, or they are too coarse.
    """
    index, *nanoseconds = time_columns(layout, columns, avoid)
    if nanoseconds:
        return _read_pair(layout, index, nanoseconds[0], others)
    unit = columns.time_unit or unit_named(_title(layout, index), layout.units[index])
    fields = [row[index] for row in layout.sample if index < len(row)]
    time_type = _time_type(fields, unit)
    if time_type == "f8" and not any(is_number(field.replace(",", ".")) for field in fields):
        raise _no_times(layout, index, fields[0])
    data, problems = read_columns(layout, index, others, time_type)
    if data.first.dtype.kind == "O":
        unit = "iso"
    elif unit is None:
        unit = guess_unit(data.first)
        problems += (
            Remark(
                f"{layout.path.name}: times assumed to be in {in_words(unit)}; set time_unit if they are not"
            ),
        )
    ticks = data.first
    t_ns = to_ns(unwrapped(ticks.astype(np.int64)) if ticks.dtype.kind == "i" else ticks, unit)
    good = t_ns != MISSING
    if not good.any():
        raise _no_times(layout, index, str(data.first[0]))
    if len(t_ns) > 20 and 2 * len(np.unique(t_ns[good])) < np.count_nonzero(good):
        raise InputError(
            f"times in column {_title(layout, index)!r} repeat: they are too coarse to stamp samples",
            file=layout.path,
            remedy="name another column, time under columns in flight.toml, or log the time of each row",
        )
    if not good.all():
        problems += (
            f"{layout.path.name}: {counted(int(np.count_nonzero(~good)), 'row')} without a time dropped",
        )
    kept = replace(data, number=data.number[good], first=data.first[good], values=data.values[good])
    return WithProblems(TimedRows(t_ns[good], kept), problems)


def _seconds_and_nanoseconds(layout: Layout) -> tuple[int, int] | None:
    """Find two columns that form a time, such as ROS 2's ``sec`` and ``nanosec``."""
    places: dict[str, dict[str, int]] = {}
    for index, name in enumerate(layout.names):
        found = re.fullmatch(r"(.*?)(n|nano)?(?:sec|secs|seconds)", name.strip().lower())
        if found is not None:
            places.setdefault(found[1], {}).setdefault("ns" if found[2] else "s", index)
    pairs = [(both["s"], both["ns"]) for both in places.values() if len(both) > 1]
    return pairs[0] if pairs else None


def _read_pair(layout: Layout, seconds: int, nanoseconds: int, others: list[int]) -> WithProblems[TimedRows]:
    data, problems = read_columns(layout, seconds, [*others, nanoseconds], "i8")
    t_ns = data.first.astype(np.int64) * NS["s"] + np.rint(data.values[:, -1]).astype(np.int64)
    return WithProblems(TimedRows(t_ns, replace(data, values=data.values[:, :-1])), problems)


def _no_times(layout: Layout, index: int, example: str) -> InputError:
    return InputError(
        f"column {_title(layout, index)!r} contains no times, such as {example!r}",
        file=layout.path,
        remedy="name the column of the time stamps, time under columns, and its time_unit; dates are written "
        "2020-09-13 12:43:20.5, 2020/09/13 ..., 13.09.2020 ..., 09/13/2020 12:43:20 PM, or without the day",
    )


def _time_type(fields: list[str], unit: TimeUnit | None) -> str:
    """Type to read times as: integers keep every digit."""
    whole = sum(field.lstrip("+-").isdigit() for field in fields)
    if unit == "iso":
        return "O"
    if 2 * whole > len(fields):
        return "i8"
    dates = sum(is_date(field) for field in fields)
    return "O" if 2 * dates > len(fields) else "f8"


def _is_rising(layout: Layout, index: int) -> bool:
    """Whether a column increases from row to row like times, and is not a row counter."""
    fields = np.array([row[index] if index < len(row) else "" for row in layout.sample], dtype=object)
    if layout.decimal_comma:
        fields = np.array([field.replace(",", ".") for field in fields], dtype=object)
    if sum(is_date(field) for field in fields) == len(fields):
        values = dates_to_ns(fields).astype(np.float64)
    elif all(is_number(field) for field in fields):
        values = fields.astype(np.float64)
    else:
        return False
    steps = np.diff(values)
    return len(steps) > 1 and bool((steps > 0.0).all()) and not bool((steps == 1.0).all())


def _title(layout: Layout, index: int) -> str:
    return layout.names[index] or str(index + 1)


def time_columns(layout: Layout, columns: ColumnMap, avoid: int | None = None) -> tuple[int, ...]:
    """Return the column of the time stamps, or those of their seconds and nanoseconds.

    Raises
    ------
    InputError
        If none is named, has a known name, or is the only increasing one.
    """
    pair = None if columns.time is not None else _seconds_and_nanoseconds(layout)
    return pair if pair is not None else (_time_column(layout, columns, avoid),)


def _time_column(layout: Layout, columns: ColumnMap, avoid: int | None) -> int:
    if columns.time is not None:
        return layout.find(columns.time, "columns.time")
    ranked = [(rank, i) for i, name in enumerate(layout.names) if (rank := is_time_name(name)) is not None]
    if ranked:
        return min(ranked)[1]
    rising = [i for i in range(len(layout.names)) if i != avoid and _is_rising(layout, i)]
    if not layout.has_names and not any(columns.columns_of(role) for role in ROLES):
        return (rising or [i for i in range(len(layout.names) + 1) if i != avoid])[0]
    if len(rising) == 1:
        return rising[0]
    listed = ", ".join(layout.names[:20]) if layout.has_names else f"{len(layout.names)} without names"
    raise InputError(
        f"has no column of time stamps: {listed}",
        file=layout.path,
        remedy='name it, as in [imu.columns] time = "t", or log the time of each row',
    )
