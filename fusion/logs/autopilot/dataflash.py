"""ArduPilot DataFlash logs (.BIN): IMU, attitude, position, velocity and height sensors; no pictures.

ArduPilot works in FRD and NED; only the velocity is turned, from the world into the body. Times are those of the
autopilot's clock, which starts at zero when it boots. The log describes its own messages; they are read column by
column (see `fusion.logs.autopilot.dataflash_parse`), for pymavlink takes minutes on a log of hours.

Message by message: https://ardupilot.org/copter/docs/logmessages.html
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from mmap import ACCESS_READ, mmap
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from fusion.flight import AttitudeStream, FloatArray, ImuStream, RangeStream, TimeArray, VectorStream
from fusion.logs.contents import Kind, LogContents, Topic
from fusion.logs.samples import BoolArray
from fusion.logs.series import (
    MAX_POSITION,
    MAX_VELOCITY,
    Series,
    SeriesLog,
    Stream,
    Where,
    attitude_stream,
    imu_stream,
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

# In the order of preference. Old logs number their sensors and filters in the name, new ones in a column.
IMUS = {"IMU": 0, "IMU2": 1, "IMU3": 2}
FILTER_QUATERNIONS = ("XKQ", "XKQ1", "XKQ2", "NKQ", "NKQ1", "NKQ2")
FILTERS = ("XKF1", "XKF6", "NKF1", "NKF6")
RANGE = "RFND"
NAMES = (*IMUS, *FILTER_QUATERNIONS, "ATT", "AHR2", *FILTERS, RANGE)
INSTANCE = ("I", "C", "Instance")  # columns that number a sensor or a filter's core
MAX_INSTANCES = 8

GYRO = ("GyrX", "GyrY", "GyrZ")
ACCEL = ("AccX", "AccY", "AccZ")
QUATERNION = ("Q1", "Q2", "Q3", "Q4")
EULER = ("Roll", "Pitch", "Yaw")  # degrees
VELOCITY = ("VN", "VE", "VD")
POSITION = ("PN", "PE", "PD")

# Distances are metres in every version. Until 4.0 a message held two sensors, numbered in the names of its columns.
RANGE_SUFFIXES = ("", "1", "2")
DOWNWARD = 25  # RFND.Orient, ROTATION_PITCH_270
GOOD = 4  # RFND.Stat; less is no data, or out of reach
INVALID_SIGNAL = 0  # RFND.Quality, percent; -1 is one that is not known


@dataclass(frozen=True, slots=True, eq=False)
class _Table:
    """One message's samples, of one instance."""

    file: Path
    data: npt.NDArray[np.uint8]
    fmt: Format
    label: str
    starts: IndexArray

    def has(self, *columns: str) -> bool:
        """Whether it has all of these columns, in numbers."""
        names = self.fmt.dtype.names or ()
        return all(column in names and self.fmt.dtype[column].kind != "V" for column in columns)

    def numbers(self, columns: tuple[str, ...]) -> FloatArray:
        """Columns (n, k)."""
        from fusion.logs.autopilot.dataflash_parse import read_columns

        return read_columns(self.data, self.fmt, self.starts, columns)

    def t_ns(self) -> TimeArray:
        """Read the times (n,); logs from before 2014 count milliseconds."""
        from fusion.logs.autopilot.dataflash_parse import read_column

        column, tick_ns = ("TimeUS", 1_000) if self.has("TimeUS") else ("TimeMS", 1_000_000)
        return nanoseconds(read_column(self.data, self.fmt, self.starts, column), tick_ns)

    def where(self, problems: list[str]) -> Where:
        """Where to report what is wrong with it."""
        return Where(self.file, self.label, problems)


def recognises(path: Path) -> bool:
    """Whether a file begins with a DataFlash message."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return file.read(len(MAGIC)) == MAGIC


def open_log(path: Path) -> LogContents:
    """Find the messages of use in a DataFlash log.

    Raises
    ------
    InputError
        Where it holds none of them.
    """
    problems: list[str] = []
    tables = _tables(path, problems)
    series = [
        *_imus(tables),
        *_attitudes(tables),
        *_positions(tables),
        *_velocities(tables),
        *_ranges(tables),
    ]
    if not series:
        raise InputError(
            "holds no IMU, attitude or filter messages",
            file=path,
            remedy="set LOG_BITMASK to log IMU and attitude, or copy the whole file",
        )
    return SeriesLog(path, FORMAT, series, problems)


def _tables(path: Path, problems: list[str]) -> list[_Table]:
    from fusion.logs.autopilot.dataflash_parse import find_formats, find_messages

    try:
        with path.open("rb") as file:
            mapped = mmap(file.fileno(), 0, access=ACCESS_READ)
    except (OSError, ValueError) as error:
        raise InputError(f"cannot be read: {error}", file=path, remedy="check the file") from error
    formats = find_formats(mapped)
    data = np.frombuffer(mapped, dtype=np.uint8)
    names = [name for name in NAMES if name in formats]
    starts, lost = find_messages(data, formats, names)
    if lost:
        problems.append(f"{lost} of {len(data)} bytes belong to no whole message and were skipped")
    tables: list[_Table] = []
    for name in names:
        table = _Table(path, data, formats[name], name, starts[name])
        if len(table.starts) and (table.has("TimeUS") or table.has("TimeMS")):
            tables += _instances(table)
    return tables


def _instances(table: _Table) -> list[_Table]:
    """Split a message by the sensor or filter that it is of."""
    from fusion.logs.autopilot.dataflash_parse import read_column

    name = table.fmt.name
    column = next((column for column in INSTANCE if table.has(column)), None)
    if column is None:
        label = f"IMU[{IMUS[name]}]" if name in IMUS else name
        return [_Table(table.file, table.data, table.fmt, label, table.starts)]
    number = read_column(table.data, table.fmt, table.starts, column).astype(np.int64)
    known = [k for k in np.unique(number).tolist() if 0 <= k < MAX_INSTANCES]
    return [
        _Table(table.file, table.data, table.fmt, f"{name}[{k}]", table.starts[number == k]) for k in known
    ]


def _having(tables: list[_Table], names: tuple[str, ...], *columns: str) -> list[_Table]:
    """Tables of these messages in their order, as far as they have the columns."""
    return [table for name in names for table in tables if table.fmt.name == name and table.has(*columns)]


def _one(table: _Table, kind: Kind, note: str, read: Callable[[_Table, list[str]], Stream]) -> Series:
    return Series(Topic(table.label, kind, table.t_ns(), note), partial(read, table))


def _imus(tables: list[_Table]) -> list[Series]:
    found = _having(tables, tuple(IMUS), *GYRO, *ACCEL)
    return [_one(table, Kind.IMU, "calibrated", _read_imu) for table in found]


def _attitudes(tables: list[_Table]) -> list[Series]:
    filters = _having(tables, FILTER_QUATERNIONS, *QUATERNION)
    note = "of the filter, in the axes of the IMU (AHRS_TRIM not applied)"
    found = [_one(table, Kind.ATTITUDE, note, _read_quaternions) for table in filters]
    note = "from roll, pitch and yaw in degrees"
    found += [_one(table, Kind.ATTITUDE, note, _read_angles) for table in _having(tables, ("ATT",), *EULER)]
    backups = _having(tables, ("AHR2",), *QUATERNION)
    return found + [_one(table, Kind.ATTITUDE, "backup filter", _read_quaternions) for table in backups]


def _positions(tables: list[_Table]) -> list[Series]:
    found = _having(tables, FILTERS, *POSITION)
    return [_one(table, Kind.POSITION, "NED, from the filter's origin", _read_position) for table in found]


def _velocities(tables: list[_Table]) -> list[Series]:
    found = _having(tables, FILTERS, *VELOCITY, *EULER)
    note = "NED, turned into the body by the same filter's attitude"
    return [_one(table, Kind.VELOCITY, note, _read_velocity) for table in found]


def _read_imu(table: _Table, problems: list[str]) -> ImuStream:
    return imu_stream(table.t_ns(), table.numbers(GYRO), table.numbers(ACCEL), table.where(problems))


def _read_quaternions(table: _Table, problems: list[str]) -> AttitudeStream:
    return attitude_stream(table.t_ns(), table.numbers(QUATERNION), table.where(problems))


def _angles(table: _Table) -> FloatArray:
    return quaternions(*np.radians(table.numbers(EULER)).T)


def _read_angles(table: _Table, problems: list[str]) -> AttitudeStream:
    return attitude_stream(table.t_ns(), _angles(table), table.where(problems))


def _read_position(table: _Table, problems: list[str]) -> VectorStream:
    return vector_stream(table.t_ns(), table.numbers(POSITION), table.where(problems), MAX_POSITION)


def _read_velocity(table: _Table, problems: list[str]) -> VectorStream:
    velocity_m_s = into_body(_angles(table), table.numbers(VELOCITY))
    return vector_stream(table.t_ns(), velocity_m_s, table.where(problems), MAX_VELOCITY)


def _ranges(tables: list[_Table]) -> list[Series]:
    """Range finders that look down, or of which the log does not say where they look."""
    found = []
    for table in (table for table in tables if table.fmt.name == RANGE):
        for suffix in (suffix for suffix in RANGE_SUFFIXES if table.has(f"Dist{suffix}")):
            if not (_looks_down(table, suffix) & (table.numbers((f"Dist{suffix}",))[:, 0] > 0.0)).any():
                continue
            name = f"{table.label}.Dist{suffix}" if suffix else table.label
            told = table.has(f"Orient{suffix}")
            note = "looks down" if told else "taken to look down: the log does not tell"
            read = partial(_read_range, suffix)
            found.append(_one(replace(table, label=name), Kind.RANGE, note, read))
    return found


def _looks_down(table: _Table, suffix: str) -> BoolArray:
    column = f"Orient{suffix}"
    if not table.has(column):
        return np.ones(len(table.starts), dtype=bool)
    return np.asarray(table.numbers((column,))[:, 0] == DOWNWARD)


def _read_range(suffix: str, table: _Table, problems: list[str]) -> RangeStream:
    trusted = _looks_down(table, suffix)
    if table.has(f"Stat{suffix}"):
        trusted &= table.numbers((f"Stat{suffix}",))[:, 0] == GOOD
    if table.has("Quality"):
        trusted &= table.numbers(("Quality",))[:, 0] != INVALID_SIGNAL
    distance_m = table.numbers((f"Dist{suffix}",))[:, 0]
    return range_stream(table.t_ns(), distance_m, table.where(problems), trusted=trusted)
