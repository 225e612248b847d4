"""ArduPilot DataFlash logs (.BIN): IMU, attitude, position, velocity and height sensors; no pictures.

ArduPilot uses FRD and NED; only the velocity is rotated, from the world into the body. Times are those of the
autopilot's clock, which starts at zero when it boots. The log describes its own messages; they are read column by
column (see `fusion.logs.autopilot.dataflash_parse`), because pymavlink takes minutes on a log of hours.

Messages: https://ardupilot.org/copter/docs/logmessages.html
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from math import pi
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from fusion.flight import FloatArray, RangeStream, VectorStream
from fusion.logs.autopilot import dataflash_text
from fusion.logs.autopilot.table import DOWNWARD, MessageTable, begins_with, map_file, series_of
from fusion.logs.contents import Kind, LogContents
from fusion.logs.samples import BoolArray, Problems, WithProblems, counted
from fusion.logs.series import (
    MAX_VELOCITY,
    Series,
    SeriesLog,
    into_body,
    nanoseconds,
    quaternions,
    range_stream,
    vector_stream,
)
from vision import InputError

if TYPE_CHECKING:
    from fusion.logs.autopilot.dataflash_parse import Format, IndexArray

MAGIC = b"\xa3\x95"
FORMAT = "ArduPilot DataFlash log"

# In the order of preference. Old logs number sensors and filters in the message's name, new ones in a column.
IMUS = {"IMU": 0, "IMU2": 1, "IMU3": 2}
FILTER_QUATERNIONS = ("XKQ", "XKQ1", "XKQ2", "NKQ", "NKQ1", "NKQ2")
FILTERS = ("XKF1", "XKF6", "NKF1", "NKF6")
RANGE = "RFND"
NAMES = (*IMUS, *FILTER_QUATERNIONS, "ATT", "AHR2", *FILTERS, RANGE)
INSTANCE = ("I", "C", "Instance")  # columns with the number of a sensor or a filter's core
MAX_INSTANCES = 8

GYRO = ("GyrX", "GyrY", "GyrZ")
ACCEL = ("AccX", "AccY", "AccZ")
QUATERNION = ("Q1", "Q2", "Q3", "Q4")
EULER = ("Roll", "Pitch", "Yaw")  # degrees
DEGREE = pi / 180.0
VELOCITY = ("VN", "VE", "VD")
POSITION = ("PN", "PE", "PD")

# Distances are metres in every version. Up to 4.0, a message had two sensors, numbered in its columns' names.
RANGE_SUFFIXES = ("", "1", "2")
GOOD = 4  # RFND.Stat; smaller: no data, or out of range
INVALID_SIGNAL = 0  # RFND.Quality, percent; -1: unknown


@dataclass(frozen=True, slots=True, eq=False)
class _Table(MessageTable):
    """Samples of one message and instance; ``starts`` (n,) are their positions in the log's bytes."""

    data: npt.NDArray[np.uint8]
    fmt: Format
    starts: IndexArray

    def has(self, *columns: str) -> bool:
        """Whether it has all of these columns, as numbers."""
        return _has(self.fmt, *columns)

    def numbers(self, *columns: str) -> FloatArray:
        """Columns (n, k)."""
        from fusion.logs.autopilot.dataflash_parse import read_columns

        return read_columns(self.data, self.fmt, self.starts, columns)


def _has(fmt: Format, *columns: str) -> bool:
    names = fmt.dtype.names or ()
    return all(column in names and fmt.dtype[column].kind != "V" for column in columns)


def recognises(path: Path) -> bool:
    """Whether a file begins with a DataFlash message, or with a message definition as text."""
    return begins_with(path, MAGIC) or dataflash_text.recognises(path)


def open_log(path: Path) -> LogContents:
    """Find the usable messages in a DataFlash log.

    Raises
    ------
    InputError
        If it contains none of them.
    """
    tables, problems = _tables(path)
    series = [
        *_imus(tables),
        *_attitudes(tables),
        *_positions(tables),
        *_velocities(tables),
        *_ranges(tables),
    ]
    if not series:
        raise InputError(
            "contains no IMU, attitude or filter messages",
            file=path,
            remedy="set LOG_BITMASK to log IMU and attitude, or copy the whole file",
        )
    return SeriesLog(path, FORMAT, series, problems)


def _tables(path: Path) -> WithProblems[list[_Table]]:
    from fusion.logs.autopilot.dataflash_parse import find_formats, find_messages

    if dataflash_text.recognises(path):
        return _tables_of_text(path)
    mapped = map_file(path)
    formats = find_formats(mapped)
    data = np.frombuffer(mapped, dtype=np.uint8)
    names = [name for name in NAMES if name in formats]
    starts, lost = find_messages(data, formats, names)
    problems: Problems = ()
    if lost:
        problems += (f"{lost} of {len(data)} bytes belong to no whole message and were skipped",)
    tables: list[_Table] = []
    for name in names:
        if len(starts[name]) and _is_timed(formats[name]):
            tables += _instances(path, data, formats[name], starts[name])
    return WithProblems(tables, problems)


def _tables_of_text(path: Path) -> WithProblems[list[_Table]]:
    messages, damaged = dataflash_text.read_messages(path, NAMES)
    problems = (f"{counted(damaged, 'line')} damaged, dropped",) if damaged else ()
    tables: list[_Table] = []
    for name in (name for name in NAMES if name in messages):
        fmt, data = messages[name]
        if len(data) and _is_timed(fmt):
            tables += _instances(path, data, fmt, np.arange(0, len(data), fmt.length))
    return WithProblems(tables, problems)


def _is_timed(fmt: Format) -> bool:
    return _has(fmt, "TimeUS") or _has(fmt, "TimeMS")


def _instances(path: Path, data: npt.NDArray[np.uint8], fmt: Format, starts: IndexArray) -> list[_Table]:
    """Split a message by the sensor or filter instance."""
    from fusion.logs.autopilot.dataflash_parse import read_column

    # Logs from before 2014 have milliseconds.
    column, tick_ns = ("TimeUS", 1_000) if _has(fmt, "TimeUS") else ("TimeMS", 1_000_000)
    t_ns = nanoseconds(read_column(data, fmt, starts, column), tick_ns)
    instance = next((column for column in INSTANCE if _has(fmt, column)), None)
    if instance is None:
        label = f"IMU[{IMUS[fmt.name]}]" if fmt.name in IMUS else fmt.name
        return [_Table(path, label, t_ns, data, fmt, starts)]
    number = read_column(data, fmt, starts, instance).astype(np.int64)
    known = [k for k in np.unique(number).tolist() if 0 <= k < MAX_INSTANCES]
    return [
        _Table(path, f"{fmt.name}[{k}]", t_ns[number == k], data, fmt, starts[number == k]) for k in known
    ]


def _having(tables: list[_Table], names: tuple[str, ...], *columns: str) -> list[_Table]:
    """Tables of these messages in their order, if they have the columns."""
    return [table for name in names for table in tables if table.fmt.name == name and table.has(*columns)]


def _imus(tables: list[_Table]) -> list[Series]:
    found = _having(tables, tuple(IMUS), *GYRO, *ACCEL)
    return [series_of(table, Kind.IMU, "calibrated", lambda t: t.imu(GYRO, ACCEL)) for table in found]


def _attitudes(tables: list[_Table]) -> list[Series]:
    filters = _having(tables, FILTER_QUATERNIONS, *QUATERNION)
    note = "of the filter, in the axes of the IMU (AHRS_TRIM not applied)"
    found = [series_of(table, Kind.ATTITUDE, note, lambda t: t.attitude(QUATERNION)) for table in filters]
    note = "from roll, pitch and yaw in degrees"
    found += [
        series_of(table, Kind.ATTITUDE, note, lambda t: t.attitude_from_angles(EULER, DEGREE))
        for table in _having(tables, ("ATT",), *EULER)
    ]
    found += [
        series_of(table, Kind.ATTITUDE, "backup filter", lambda t: t.attitude(QUATERNION))
        for table in _having(tables, ("AHR2",), *QUATERNION)
    ]
    return found


def _positions(tables: list[_Table]) -> list[Series]:
    note = "NED, from the filter's origin"
    found = _having(tables, FILTERS, *POSITION)
    return [series_of(table, Kind.POSITION, note, lambda t: t.position(POSITION)) for table in found]


def _velocities(tables: list[_Table]) -> list[Series]:
    found = _having(tables, FILTERS, *VELOCITY, *EULER)
    note = "NED, turned into the body by the same filter's attitude"
    return [series_of(table, Kind.VELOCITY, note, _read_velocity) for table in found]


def _read_velocity(table: _Table) -> WithProblems[VectorStream]:
    q_world_body = quaternions(*(table.numbers(*EULER) * DEGREE).T)
    velocity_m_s = into_body(q_world_body, table.numbers(*VELOCITY))
    return vector_stream(table.t_ns, velocity_m_s, table.where(), MAX_VELOCITY)


def _ranges(tables: list[_Table]) -> list[Series]:
    """Range finders that look down, or whose orientation is not logged."""
    found = []
    for table in (table for table in tables if table.fmt.name == RANGE):
        for suffix in (suffix for suffix in RANGE_SUFFIXES if table.has(f"Dist{suffix}")):
            if not (_looks_down(table, suffix) & (table.column(f"Dist{suffix}") > 0.0)).any():
                continue
            name = f"{table.label}.Dist{suffix}" if suffix else table.label
            declared = table.has(f"Orient{suffix}")
            note = "looks down" if declared else "taken to look down: the log does not tell"
            read = partial(_read_range, suffix)
            found.append(series_of(replace(table, label=name), Kind.RANGE, note, read))
    return found


def _looks_down(table: _Table, suffix: str) -> BoolArray:
    column = f"Orient{suffix}"
    if not table.has(column):
        return np.ones(len(table.starts), dtype=bool)
    return np.asarray(table.column(column) == DOWNWARD)


def _read_range(suffix: str, table: _Table) -> WithProblems[RangeStream]:
    trusted = _looks_down(table, suffix)
    if table.has(f"Stat{suffix}"):
        trusted &= table.column(f"Stat{suffix}") == GOOD
    if table.has("Quality"):
        trusted &= table.column("Quality") != INVALID_SIGNAL
    return range_stream(table.t_ns, table.column(f"Dist{suffix}"), table.where(), trusted=trusted)
