"""PX4 logs (ULog), read with pyulog: IMU, attitude, position, velocity and height sensors; no pictures.

PX4 uses FRD and NED throughout, so only the velocity is rotated, from the world into the body by the logged
attitude. Times are those of the autopilot's clock, which starts at zero when it boots. A sample of
``sensor_combined`` or ``vehicle_imu`` is the mean over an interval; its time here is the middle of that interval.

Format: https://docs.px4.io/main/en/dev_log/ulog_file_format.html
"""

from __future__ import annotations

import contextlib
import io
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from fusion.flight import FloatArray, ImuStream, RangeStream, TimeArray, VectorStream
from fusion.logs.autopilot.table import DOWNWARD, MessageTable, begins_with, series_of
from fusion.logs.contents import Kind, LogContents
from fusion.logs.imu_series import imu_stream, joined_imu
from fusion.logs.samples import BoolArray, Problems, WithProblems, counted
from fusion.logs.series import (
    MAX_POSITION,
    Series,
    SeriesLog,
    nanoseconds,
    range_stream,
    vector_stream,
    velocity_stream,
)
from vision import InputError

if TYPE_CHECKING:
    from pyulog import ULog

MAGIC = b"ULog\x01\x12\x35"
FORMAT = "PX4 ULog"

ATTITUDE = "vehicle_attitude"
LOCAL_POSITION = "vehicle_local_position"
RANGE = "distance_sensor"
NAMES = ("sensor_combined", "vehicle_imu", "sensor_gyro", "sensor_accel", ATTITUDE, LOCAL_POSITION, RANGE)

GYRO_RAD = tuple(f"gyro_rad[{axis}]" for axis in range(3))
ACCEL_M_S2 = tuple(f"accelerometer_m_s2[{axis}]" for axis in range(3))
DELTA_ANGLE = tuple(f"delta_angle[{axis}]" for axis in range(3))
DELTA_VELOCITY = tuple(f"delta_velocity[{axis}]" for axis in range(3))
INTERVALS = ("delta_angle_dt", "delta_velocity_dt")  # microseconds
QUATERNION = tuple(f"q[{part}]" for part in range(4))
XYZ = POSITION = ("x", "y", "z")
VELOCITY = ("vx", "vy", "vz")
DISTANCE, DISTANCE_LIMITS = "current_distance", ("min_distance", "max_distance")  # metres

INVALID_SIGNAL = 0  # percent; -1: unknown

NO_ACCEL = 0x7FFFFFFF  # accelerometer_timestamp_relative of a sample without acceleration
LONGEST_INTERVAL_US = 1e6
MAX_LATE_US = 10_000_000  # between taking and logging a sample
HEADER_BYTES = 3  # of a message
REREADS = 8  # times the file's size that pyulog may read before an endless loop is assumed


@dataclass(frozen=True, slots=True, eq=False)
class _Table(MessageTable):
    """Columns of one message and instance."""

    name: str
    columns: dict[str, npt.NDArray[np.generic]]

    def numbers(self, *columns: str) -> FloatArray:
        """Columns (n, k) as floats."""
        with np.errstate(invalid="ignore"):  # a damaged float may be a signalling NaN
            return np.stack([self.columns[name].astype(float) for name in columns], axis=1)

    def has(self, *columns: str) -> bool:
        """Whether all of these columns exist."""
        return all(name in self.columns for name in columns)

    def trusted(self, *flags: str) -> BoolArray:
        """Rows (n,) whose logged flags are all set."""
        up = np.ones(len(self.t_ns), dtype=bool)
        for flag in flags:
            if flag in self.columns:
                up &= self.columns[flag] != 0
        return up


def _sample_times(columns: dict[str, npt.NDArray[np.generic]]) -> TimeArray:
    """Time of measurement of each sample (n,), or of logging if the former is missing."""
    logged = columns["timestamp"].astype(np.uint64)
    if "timestamp_sample" in columns:
        taken = columns["timestamp_sample"].astype(np.uint64)
        # Some companion computers write a time of another clock, or zero.
        late_us = logged.astype(np.int64) - taken.astype(np.int64)
        logged = np.where((taken > 0) & (np.abs(late_us) < MAX_LATE_US), taken, logged)
    return nanoseconds(logged, 1000)


class _BoundedReader(io.BufferedReader):
    """A file that reports its end once far more than its size was read.

    pyulog seeks back over damaged bytes; at a truncated end it may loop forever.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(io.FileIO(path, "rb"), 1 << 20)
        self.left = REREADS * path.stat().st_size + 65536
        self.is_truncated = False  # a message is truncated

    def read(self, size: int | None = -1, /) -> bytes:
        """Read bytes, and detect a truncated message; returns nothing once too much was read."""
        data = super().read(size)
        self.left -= len(data) + 1
        if size is not None and len(data) < size and (data or size != HEADER_BYTES):
            self.is_truncated = True
        return data if self.left > 0 else b""


def recognises(path: Path) -> bool:
    """Whether a file begins like a ULog."""
    return begins_with(path, MAGIC)


def open_log(path: Path) -> LogContents:
    """Read the usable topics of a ULog.

    Raises
    ------
    InputError
        If pyulog is not installed, or the file holds none of them.
    """
    log, problems = _parse(path)
    found: dict[tuple[str, int], _Table] = {}
    for data in log.data_list:
        if (data.name, data.multi_id) not in found and "timestamp" in data.data:
            label = data.name if data.multi_id == 0 else f"{data.name}[{data.multi_id}]"
            found[data.name, data.multi_id] = _Table(
                path, label, _sample_times(data.data), data.name, data.data
            )
    tables = [table for _, table in sorted(found.items(), key=lambda item: item[0])]
    local, distrusted = _local_positions(tables)
    series = [*_imus(tables), *_attitudes(tables), *local, *_ranges(tables)]
    if not series:
        raise InputError(
            "contains no IMU, attitude or position",
            file=path,
            remedy=f"log at least sensor_combined and {ATTITUDE} (SDLOG_PROFILE), or copy the whole file",
        )
    return SeriesLog(path, FORMAT, series, problems + distrusted)


def _parse(path: Path) -> WithProblems[ULog]:
    try:
        from pyulog import ULog
    except ImportError:
        raise InputError(
            "is a PX4 log, which pyulog reads", file=path, remedy="pip install 'corridor-fusion[px4]'"
        ) from None
    try:
        with _BoundedReader(path) as file, contextlib.redirect_stdout(io.StringIO()):
            log = ULog(file, list(NAMES))
    except OSError as error:
        raise InputError(f"cannot be read: {error}", file=path, remedy="check the file") from error
    except Exception as error:  # pyulog raises any exception on damaged files
        raise InputError(
            f"is damaged in its definitions ({type(error).__name__}: {error})",
            file=path,
            remedy="copy the log from the vehicle again",
        ) from error
    problems: Problems = ()
    if log.file_corruption or file.left <= 0:
        problems += ("parts of the file are damaged and were skipped",)
    if file.is_truncated:
        problems += ("the file ends in the middle of a message: it was cut short",)
    if log.has_data_appended:
        problems += ("data were appended after the log was closed (after a crash of the autopilot)",)
    if log.dropouts:
        total_s = sum(dropout.duration for dropout in log.dropouts) * 1e-3
        longest_s = max(dropout.duration for dropout in log.dropouts) * 1e-3
        problems += (
            f"the logger could not keep up: {counted(len(log.dropouts), 'dropout')}, {total_s:.3g} s in all, "
            f"the longest {longest_s:.3g} s",
        )
    return WithProblems(log, problems)


def _instances(tables: list[_Table], name: str, *columns: str) -> list[_Table]:
    """All instances of a message with these columns and with samples."""
    return [table for table in tables if table.name == name and table.has(*columns) and len(table.t_ns)]


def _imus(tables: list[_Table]) -> list[Series]:
    found: list[Series] = []
    for table in _instances(tables, "sensor_combined", *GYRO_RAD, *ACCEL_M_S2):
        if table.has("gyro_integral_dt"):
            interval = table.column("gyro_integral_dt")
            is_seconds = table.columns["gyro_integral_dt"].dtype.kind == "f"  # of logs from before 2017
            table = replace(table, t_ns=_middle(table.t_ns, interval * 1e6 if is_seconds else interval))
        note = "calibrated; the IMU that the autopilot flew by"
        found.append(series_of(table, Kind.IMU, note, _read_combined))
    for table in _instances(tables, "vehicle_imu", *DELTA_ANGLE, *DELTA_VELOCITY, *INTERVALS):
        table = replace(table, t_ns=_middle(table.t_ns, table.column(INTERVALS[0])))
        found.append(series_of(table, Kind.IMU, "calibrated, integrated", _read_integrated))
    accels = {table.label: table for table in _instances(tables, "sensor_accel", *XYZ)}
    for table in _instances(tables, "sensor_gyro", *XYZ):
        accel = accels.get(table.label.replace("gyro", "accel"))
        note = "raw, not calibrated" if accel else "raw, not calibrated, no acceleration"
        found.append(series_of(table, Kind.IMU, note, partial(_read_raw, accel)))
    return found


def _middle(t_ns: TimeArray, interval_us: FloatArray) -> TimeArray:
    """Convert the ends of intervals to their middles; damaged intervals count as zero."""
    sound = (interval_us > 0.0) & (interval_us < LONGEST_INTERVAL_US)
    return np.asarray(t_ns - np.where(sound, interval_us * 500.0, 0.0).astype(np.int64))


def _read_combined(table: _Table) -> WithProblems[ImuStream]:
    accel_m_s2 = table.numbers(*ACCEL_M_S2)
    if table.has("accelerometer_timestamp_relative"):
        accel_m_s2[table.columns["accelerometer_timestamp_relative"] == NO_ACCEL] = np.nan
    return imu_stream(table.t_ns, table.numbers(*GYRO_RAD), accel_m_s2, table.where())


def _read_integrated(table: _Table) -> WithProblems[ImuStream]:
    interval_us = table.numbers(*INTERVALS)
    interval_s = np.where(interval_us > 0.0, interval_us * 1e-6, np.nan)
    gyro_rad_s = table.numbers(*DELTA_ANGLE) / interval_s[:, :1]
    accel_m_s2 = table.numbers(*DELTA_VELOCITY) / interval_s[:, 1:]
    return imu_stream(table.t_ns, gyro_rad_s, accel_m_s2, table.where())


def _read_raw(accel: _Table | None, table: _Table) -> WithProblems[ImuStream]:
    """``sensor_gyro`` with the acceleration of the sensor of the same number, interpolated."""
    samples = None if accel is None else VectorStream(accel.t_ns, accel.numbers(*XYZ))
    where = table.where()
    return joined_imu(table.t_ns, table.numbers(*XYZ), samples, where, accel.where() if accel else where)


def _attitudes(tables: list[_Table]) -> list[Series]:
    return [
        series_of(table, Kind.ATTITUDE, "body FRD to NED", lambda t: t.attitude(QUATERNION))
        for table in _instances(tables, ATTITUDE, *QUATERNION)
    ]


def _local_positions(tables: list[_Table]) -> WithProblems[list[Series]]:
    """Positions and velocities; left out, with a problem, if the autopilot never marked them valid."""
    attitudes = _instances(tables, ATTITUDE, *QUATERNION)
    found: list[Series] = []
    problems: Problems = ()
    for table in _instances(tables, LOCAL_POSITION, *POSITION):
        if table.trusted("xy_valid", "z_valid").any():
            note = "NED, from where the autopilot started"
            found.append(series_of(table, Kind.POSITION, note, _read_position))
        else:
            problems += (f"{table.label}: the autopilot never trusted its position, left out",)
    for table in _instances(tables, LOCAL_POSITION, *VELOCITY):
        if not table.trusted("v_xy_valid", "v_z_valid").any():
            problems += (f"{table.label}: the autopilot never trusted its velocity, left out",)
        elif not attitudes:
            problems += (f"{table.label}: its velocity is left out, no {ATTITUDE} to turn it into the body",)
        else:
            note = f"NED, turned into the body by {attitudes[0].label}"
            found.append(series_of(table, Kind.VELOCITY, note, partial(_read_velocity, attitudes[0])))
    return WithProblems(found, problems)


def _read_position(table: _Table) -> WithProblems[VectorStream]:
    position_m = np.where(table.trusted("xy_valid", "z_valid")[:, None], table.numbers(*POSITION), np.nan)
    what = "a position that the autopilot did not trust"
    return vector_stream(table.t_ns, position_m, table.where(), MAX_POSITION, what)


def _read_velocity(attitude: _Table, table: _Table) -> WithProblems[VectorStream]:
    velocity_m_s = np.where(
        table.trusted("v_xy_valid", "v_z_valid")[:, None], table.numbers(*VELOCITY), np.nan
    )
    turning = attitude.attitude(QUATERNION).value  # its problems are reported when it is read itself
    return velocity_stream(table.t_ns, velocity_m_s, turning, table.where())


def _ranges(tables: list[_Table]) -> list[Series]:
    """Distance sensors that look down; others carry no information about the floor."""
    found = _instances(tables, RANGE, DISTANCE, "orientation")
    down = [table for table in found if (table.columns["orientation"] == DOWNWARD).any()]
    return [series_of(table, Kind.RANGE, "looks down", _read_range) for table in down]


def _read_range(table: _Table) -> WithProblems[RangeStream]:
    trusted = table.columns["orientation"] == DOWNWARD
    if table.has("signal_quality"):
        trusted &= table.columns["signal_quality"] != INVALID_SIGNAL
    low_m, high_m = (table.column(name) if table.has(name) else np.nan for name in DISTANCE_LIMITS)
    distance_m = table.column(DISTANCE)
    return range_stream(table.t_ns, distance_m, table.where(), limits_m=(low_m, high_m), trusted=trusted)
