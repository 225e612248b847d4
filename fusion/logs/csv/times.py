"""Rows of a CSV with their times: the column of time stamps found, its unit too, dates and all."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from fusion.flight import TimeArray
from fusion.logs.csv.column_map import ColumnMap, TimeUnit
from fusion.logs.csv.table import Columns, Layout, read_columns, read_layout
from fusion.logs.csv.time_units import MISSING, guess_unit, is_time_name, said, to_ns, unit_named
from fusion.logs.samples import counted
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
        Time (n,) of each, as they stand.
    names
        File name of each; None where the file has no such column.
    """

    row: npt.NDArray[np.int64]
    t_ns: TimeArray
    names: tuple[str, ...] | None


def read_times(path: Path, columns: ColumnMap | str | None, problems: list[str]) -> FrameTimes:
    """Read when pictures were taken, and, where a column gives them, their file names.

    Raises
    ------
    InputError
        Where the file has no time stamps.
    """
    told = columns if isinstance(columns, ColumnMap) else ColumnMap()
    layout = read_layout(path, told.separator, told.header)
    names = _picture_column(layout, told)
    t_ns, data = read_timed(layout, told, [], problems, avoid=names)
    if names is None:
        return FrameTimes(data.row, t_ns, None)
    files = read_columns(layout, names, [], "O", [])
    at = np.searchsorted(files.row, data.row)
    return FrameTimes(data.row, t_ns, tuple(str(files.first[i]).strip() for i in at))


def _picture_column(layout: Layout, told: ColumnMap) -> int | None:
    """Find the column of file names: as told, else the first whose fields end as pictures do."""
    from fusion.logs.pictures.camera_folder import PICTURE_SUFFIXES

    if told.picture is not None:
        return layout.find(told.picture, "columns.picture")
    for index in range(len(layout.names)):
        fields = [row[index] for row in layout.sample if index < len(row)]
        pictures = sum(Path(field).suffix.lower() in PICTURE_SUFFIXES for field in fields)
        if 2 * pictures > len(fields):
            return index
    return None


def read_timed(
    layout: Layout, columns: ColumnMap, others: list[int], problems: list[str], avoid: int | None = None
) -> tuple[TimeArray, Columns]:
    """Read the time column, in nanoseconds, with others; rows whose time is none are dropped with the damaged.

    Parameters
    ----------
    layout, columns
        Of the file, and which column is the time, if that is told.
    others
        Indices of further columns of numbers.
    problems
        Sentences are appended here.
    avoid
        A column that is not the time.

    Raises
    ------
    InputError
        Where no column holds times, or they are too coarse.
    """
    index = _time_column(layout, columns, avoid)
    unit = columns.time_unit or unit_named(_title(layout, index), layout.units[index])
    fields = [row[index] for row in layout.sample if index < len(row)]
    data = read_columns(layout, index, others, _time_type(fields, unit, layout), problems)
    if data.first.dtype.kind == "O":
        unit = "iso"
    elif unit is None:
        unit = guess_unit(data.first)
        problems.append(
            f"{layout.path.name}: times taken for {said(unit)}; time_unit in flight.toml says otherwise"
        )
    t_ns = to_ns(data.first, unit)
    good = t_ns != MISSING
    if not good.any():
        raise InputError(
            f"column {_title(layout, index)!r} holds no times, such as {str(data.first[0])!r}",
            file=layout.path,
            remedy="name the column of the time stamps, time under columns, and its time_unit",
        )
    if len(t_ns) > 20 and 2 * len(np.unique(t_ns[good])) < np.count_nonzero(good):
        raise InputError(
            f"times in column {_title(layout, index)!r} repeat: they are too coarse to stamp samples",
            file=layout.path,
            remedy="name another column, time under columns in flight.toml, or log the time of each row",
        )
    if not good.all():
        problems.append(
            f"{layout.path.name}: {counted(int(np.count_nonzero(~good)), 'row')} without a time dropped"
        )
    return t_ns[good], Columns(data.row[good], data.first[good], data.values[good])


def _time_type(fields: list[str], unit: TimeUnit | None, layout: Layout) -> str:
    """Type to read times as: whole numbers keep every digit."""
    whole = sum(field.lstrip("+-").isdigit() for field in fields)
    if unit == "iso":
        return "O"
    if 2 * whole > len(fields):
        return "i8"
    dates = sum(field[:4].isdigit() and field[4:5] == "-" for field in fields)
    return "O" if 2 * dates > len(fields) else "f8"


def _title(layout: Layout, index: int) -> str:
    return layout.names[index] or str(index + 1)


def _time_column(layout: Layout, columns: ColumnMap, avoid: int | None) -> int:
    if columns.time is not None:
        return layout.find(columns.time, "columns.time")
    ranked = [(rank, i) for i, name in enumerate(layout.names) if (rank := is_time_name(name)) is not None]
    if ranked:
        return min(ranked)[1]
    if not layout.has_names and not any(getattr(columns, role) for role in ROLES):
        return next(i for i in range(len(layout.names) + 1) if i != avoid)
    listed = ", ".join(layout.names[:20]) if layout.has_names else f"{len(layout.names)} without names"
    raise InputError(
        f"has no column of time stamps: {listed}",
        file=layout.path,
        remedy='name it, as in [imu.columns] time = "t", or log the time of each row',
    )
