"""MAVLink telemetry logs (.tlog), received by a ground station; IMU, attitude, position, velocity, height sensors.

Messages are in FRD and NED; only the velocity is rotated, from the world into the body. Their units differ:
``HIGHRES_IMU`` has rad/s and m/s^2, the others thousandths of rad/s and of standard gravity. pymavlink's definitions
give the layout and the units of each message. Times are those of the vehicle's clock, which starts at zero when it
boots: radio delays vary too much to use the recording computer's clock. The offset to Unix time is in the notes.

Messages: https://mavlink.io/en/messages/common.html
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from fusion.flight import AttitudeStream, FloatArray, ImuStream, RangeStream, TimeArray, VectorStream
from fusion.logs.autopilot.table import DOWNWARD, MessageTable, map_file, series_of
from fusion.logs.contents import Kind, LogContents
from fusion.logs.imu_series import imu_stream
from fusion.logs.samples import BoolArray, Problems, WithProblems, counted, unwrapped
from fusion.logs.series import (
    CLOCK_BACK_NS,
    Series,
    SeriesLog,
    Stream,
    nanoseconds,
    range_stream,
    velocity_stream,
)
from vision import InputError

if TYPE_CHECKING:
    from fusion.logs.autopilot.tlog_parse import Packets

FORMAT = "MAVLink tlog"
MAGICS = (0xFE, 0xFD)
HEAD_BYTES = 9  # time and magic
LONGEST_PACKET = 300  # bytes after the time
LONGEST_PAUSE_US = 3_600_000_000
EARLIEST_US, LATEST_US = 10**15, 4 * 10**15  # 2001 and 2096: plausible times of a recording computer
UNIX_US = 10**15  # larger times count from 1970, smaller ones from boot, as in MAVLink

# In the order of preference.
IMUS = ("HIGHRES_IMU", "SCALED_IMU", "RAW_IMU", "SCALED_IMU2", "SCALED_IMU3")
ATTITUDES = ("ATTITUDE_QUATERNION", "ATTITUDE")
POSITION = "LOCAL_POSITION_NED"
CLOCK = "SYSTEM_TIME"
RANGE = "DISTANCE_SENSOR"
NAMES = (*IMUS, *ATTITUDES, POSITION, RANGE, CLOCK)

GYRO = ("xgyro", "ygyro", "zgyro")
ACCEL = ("xacc", "yacc", "zacc")
QUATERNION = ("q1", "q2", "q3", "q4")
EULER = ("roll", "pitch", "yaw")
XYZ = ("x", "y", "z")
VELOCITY = ("vx", "vy", "vz")
GYRO_UPDATED, ACCEL_UPDATED = 0x38, 0x07  # bits of HIGHRES_IMU.fields_updated
SCALES = {"mG": 9.80665e-3, "mrad/s": 1e-3, "m/s/s": 1.0, "rad/s": 1.0, "cm": 0.01}
DISTANCES = ("current_distance", "min_distance", "max_distance")
INVALID_SIGNAL = 1  # of DISTANCE_SENSOR.signal_quality; 0: unknown
ONE_G_M_S2 = (3.0, 30.0)  # range of the median of a working accelerometer in flight


@dataclass(frozen=True, slots=True, eq=False)
class _Table(MessageTable):
    """Samples of one message from one sender, at the times of the vehicle's clock."""

    name: str
    rows: npt.NDArray[np.void]
    units: dict[str, str]
    clock: str

    def has(self, *columns: str) -> bool:
        """Whether the message has all of these columns."""
        return all(name in (self.rows.dtype.names or ()) for name in columns)

    def numbers(self, *columns: str) -> FloatArray:
        """Columns (n, k), in SI units if the definitions declare a unit."""
        with np.errstate(invalid="ignore"):  # a damaged float may be a signalling NaN
            values = [
                self.rows[name].astype(float) * SCALES.get(self.units.get(name, ""), 1.0) for name in columns
            ]
        return np.stack(values, axis=1)


@dataclass(frozen=True, slots=True, eq=False)
class _Raw:
    """Packets of one message from one sender, as sent; ``place`` (n,) is the number among all packets of the file."""

    name: str
    kind: Any
    place: npt.NDArray[np.int64]
    rows: npt.NDArray[np.void]
    received_us: npt.NDArray[np.uint64]
    wrapped_ns: TimeArray  # added for overflows of the millisecond counter

    def boot_ns(self) -> TimeArray | None:
        """Return the times (n,) since the vehicle booted; None if the message has Unix time."""
        if "time_boot_ms" in (self.rows.dtype.names or ()):
            return nanoseconds(self.rows["time_boot_ms"], 1_000_000) + self.wrapped_ns
        unix = float(np.median(self.rows["time_usec"])) > UNIX_US
        return None if unix else nanoseconds(self.rows["time_usec"], 1_000)

    def between(self, first: int, last: int) -> _Raw:
        """Return the packets between two places."""
        kept = (self.place >= first) & (self.place <= last)
        return replace(
            self,
            place=self.place[kept],
            rows=self.rows[kept],
            received_us=self.received_us[kept],
            wrapped_ns=self.wrapped_ns[kept],
        )


def recognises(path: Path) -> bool:
    """Whether a file begins with a time and the start of a MAVLink packet."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        head = file.read(HEAD_BYTES + LONGEST_PACKET)
    if len(head) < HEAD_BYTES or head[8] not in MAGICS:
        return False
    first_us = int.from_bytes(head[:8], "big")
    if EARLIEST_US < first_us < LATEST_US:
        return True
    # A computer without a clock starts at 1970; then a packet must follow the end of the first one.
    if len(head) < 2 * HEAD_BYTES:
        return False
    overhead = 8 if head[8] == MAGICS[0] else 12 + 13 * (head[10] & 1)
    next_at = 8 + overhead + head[9]
    following = head[next_at : next_at + HEAD_BYTES]
    if first_us > EARLIEST_US or len(following) < HEAD_BYTES or following[8] not in MAGICS:
        return False
    return 0 <= int.from_bytes(following[:8], "big") - first_us < LONGEST_PAUSE_US


def open_log(path: Path) -> LogContents:
    """Find the usable messages in a telemetry log.

    Raises
    ------
    InputError
        If pymavlink is not installed, or the log contains none of them.
    """
    tables, problems = _tables(path)
    series = _series(tables)
    if not series:
        raise InputError(
            "contains no IMU, attitude or position messages",
            file=path,
            remedy="ask the vehicle for RAW_IMU and ATTITUDE at a high rate, or copy the whole file",
        )
    return SeriesLog(path, FORMAT, series, problems)


def _definitions(path: Path) -> dict[int, Any]:
    """Return pymavlink's definitions of the common and ArduPilot's messages, by number."""
    try:
        from pymavlink.dialects.v20 import ardupilotmega
    except ImportError:
        raise InputError(
            "is a MAVLink log, which pymavlink describes",
            file=path,
            remedy="pip install 'corridor-fusion[ardupilot]'",
        ) from None
    return dict(ardupilotmega.mavlink_map)


def _tables(path: Path) -> WithProblems[list[_Table]]:
    from fusion.logs.autopilot.tlog_parse import find_packets

    known = _definitions(path)
    classes = {number: kind for number, kind in known.items() if kind.msgname in NAMES}
    data = np.frombuffer(map_file(path), dtype=np.uint8)
    packets = find_packets(data, {number: kind.crc_extra for number, kind in known.items()}, classes)
    problems: Problems = ()
    if packets.damaged:
        problems += (f"{counted(packets.damaged, 'message')} with a wrong checksum dropped",)
    if packets.unknown:
        problems += (f"{counted(packets.unknown, 'message')} of a kind that is not known left out",)
    if packets.lost:
        problems += (f"{packets.lost} of {len(data)} bytes belong to no whole message and were skipped",)
    senders = np.unique(packets.sender).tolist()
    tables: list[_Table] = []
    for sender in senders:
        suffix = f"[{sender // 256}.{sender % 256}]" if len(senders) > 1 else ""
        raws = _raws(data, packets, sender, classes)
        raws, restarts = _of_one_boot(raws, suffix)
        problems += restarts
        tables += _on_one_clock(path, raws, suffix)
    return WithProblems(tables, problems)


def _raws(data: npt.NDArray[np.uint8], packets: Packets, sender: int, classes: dict[int, Any]) -> list[_Raw]:
    from fusion.logs.autopilot.tlog_parse import payloads, received_us

    raws = []
    for number, kind in classes.items():
        place = np.flatnonzero((packets.sender == sender) & (packets.identifier == number))
        rows = payloads(data, packets.payload[place], packets.length[place], _dtype(kind))
        if len(place):
            received = received_us(data, packets.record[place])
            raws.append(_Raw(kind.msgname, kind, place, rows, received, np.zeros(len(place), np.int64)))
    return _on_counting(raws)


def _on_counting(raws: list[_Raw]) -> list[_Raw]:
    """Unwrap ``time_boot_ms``, which overflows after 49.7 days; all messages share one counter."""
    counted_ms = [raw for raw in raws if "time_boot_ms" in (raw.rows.dtype.names or ())]
    if not counted_ms:
        return raws
    place = np.concatenate([raw.place for raw in counted_ms])
    ticks = np.concatenate([raw.rows["time_boot_ms"] for raw in counted_ms]).astype(np.int64)
    order = np.argsort(place)
    wrapped_ns = np.empty_like(ticks)
    wrapped_ns[order] = (unwrapped(ticks[order]) - ticks[order]) * 1_000_000
    parts = np.split(wrapped_ns, np.cumsum([len(raw.place) for raw in counted_ms])[:-1])
    on = {raw.name: replace(raw, wrapped_ns=part) for raw, part in zip(counted_ms, parts, strict=True)}
    return [on.get(raw.name, raw) for raw in raws]


def _dtype(kind: Any) -> np.dtype[np.void]:
    """Layout of a message's payload in the packet."""
    letters = kind.native_format.decode().lstrip("<")
    fields = []
    for name, letter, length in zip(kind.ordered_fieldnames, letters, kind.array_lengths, strict=True):
        number = np.dtype(letter).newbyteorder("<")
        fields.append((name, number, (length,)) if length else (name, number))
    return np.dtype(fields)


def _of_one_boot(raws: list[_Raw], suffix: str) -> WithProblems[list[_Raw]]:
    """Messages of the longest stretch between two reboots of the vehicle: each reboot resets the clock."""
    timed = [(raw.place, t_ns) for raw in raws if (t_ns := raw.boot_ns()) is not None]
    if not timed:
        return WithProblems(raws)
    place = np.concatenate([part for part, _ in timed])
    order = np.argsort(place)
    place, t_ns = place[order], np.concatenate([part for _, part in timed])[order]
    cuts = np.flatnonzero(np.diff(t_ns) < -CLOCK_BACK_NS) + 1
    if cuts.size == 0:
        return WithProblems(raws)
    edges = [0, *cuts.tolist(), len(place)]
    longest = int(np.argmax(np.diff(edges)))
    first, last = place[edges[longest]], place[edges[longest + 1] - 1]
    problem = (
        f"the vehicle's clock{suffix} went back {counted(len(cuts), 'time')}, as when it restarts; only the "
        f"longest of {len(cuts) + 1} stretches is used"
    )
    kept = [raw.between(first, last) for raw in raws]
    return WithProblems([raw for raw in kept if len(raw.place)], (problem,))


def _on_one_clock(path: Path, raws: list[_Raw], suffix: str) -> list[_Table]:
    """Map all messages to the vehicle's clock since boot, if any message has it."""
    offset_us: int | None = None  # Unix time less the vehicle's
    late = [
        raw.received_us.astype(np.int64) - t_ns // 1000 for raw in raws if (t_ns := raw.boot_ns()) is not None
    ]
    has_clock = any(float(np.median(raw.received_us)) > EARLIEST_US for raw in raws)
    if late and has_clock:
        offset_us = int(min(part.min() for part in late))  # the least delayed message
    source = "the recording computer's clock"
    for raw in raws:
        if raw.name == CLOCK:
            unix_us = raw.rows["time_unix_usec"].astype(np.int64)
            known = unix_us > UNIX_US
            if known.any():
                boot_us = raw.rows["time_boot_ms"].astype(np.int64)[known] * 1000
                offset_us, source = int(np.median(unix_us[known] - boot_us)), CLOCK
    clock = "the vehicle's clock"
    if offset_us is not None:
        clock += f"; add {offset_us * 1e-6:.3f} s for Unix time by {source}"
    tables = []
    for raw in raws:
        t_ns = raw.boot_ns()
        clock_note = clock
        if t_ns is None and offset_us is not None:
            t_ns = nanoseconds(raw.rows["time_usec"], 1000) - offset_us * 1000
            clock_note += ", subtracted here"
        elif t_ns is None:
            t_ns, clock_note = nanoseconds(raw.rows["time_usec"], 1000), "Unix time by the vehicle's clock"
        if raw.name != CLOCK:
            units = dict(raw.kind.fieldunits_by_name)
            tables += _instances(_Table(path, raw.name + suffix, t_ns, raw.name, raw.rows, units, clock_note))
    return tables


def _instances(table: _Table) -> list[_Table]:
    """Split a message by its sensor number, if it has one."""
    if not table.has("id"):
        return [table]
    number = table.rows["id"]
    return [
        replace(
            table,
            label=f"{table.label}[{k}]" if k else table.label,
            t_ns=table.t_ns[number == k],
            rows=table.rows[number == k],
        )
        for k in np.unique(number).tolist()
    ]


def _series(tables: list[_Table]) -> list[Series]:
    def of(*names: str) -> list[_Table]:
        return [table for name in names for table in tables if table.name == name]

    found = []
    for table in of(*IMUS):
        units = ", ".join(dict.fromkeys([table.units["xgyro"], table.units["xacc"]]))
        found.append(_one(table, Kind.IMU, f"sent in {units}", _read_imu))
    attitudes = of(*ATTITUDES)
    found += [_one(table, Kind.ATTITUDE, "body FRD to NED", _read_attitude) for table in attitudes]
    found += [_one(table, Kind.POSITION, "NED", lambda t: t.position(XYZ)) for table in of(POSITION)]
    for table in of(POSITION):
        sender = table.label.removeprefix(table.name)
        own = [attitude for attitude in attitudes if attitude.label == attitude.name + sender]
        if own:
            note = f"NED, turned into the body by {own[0].label}"
            found.append(_one(table, Kind.VELOCITY, note, partial(_read_velocity, own[0])))
    found += [
        _one(table, Kind.RANGE, "looks down", _read_range) for table in of(RANGE) if _looks_down(table).any()
    ]
    return found


def _one(table: _Table, kind: Kind, note: str, read: Callable[[_Table], WithProblems[Stream]]) -> Series:
    return series_of(table, kind, f"{note}; {table.clock}", read)


def _read_imu(table: _Table) -> WithProblems[ImuStream]:
    gyro_rad_s, accel_m_s2 = table.numbers(*GYRO), table.numbers(*ACCEL)
    if table.name == "HIGHRES_IMU":
        updated = table.rows["fields_updated"].astype(np.int64)
        for values, bits in ((gyro_rad_s, GYRO_UPDATED), (accel_m_s2, ACCEL_UPDATED)):
            fresh = (updated & bits) == bits
            values[~fresh & fresh.any()] = np.nan  # repeated values, unless the flags are never set
    weight_m_s2 = float(np.median(np.linalg.norm(np.nan_to_num(accel_m_s2), axis=1)))
    if table.name == "RAW_IMU" and weight_m_s2 > 0.0 and not ONE_G_M_S2[0] < weight_m_s2 < ONE_G_M_S2[1]:
        raise InputError(
            f"{table.label} contains a sensor's raw counts: at rest {weight_m_s2 / 9.80665:.3g} g if they were mG",
            file=table.file,
            remedy="choose another IMU message, or ask the vehicle for SCALED_IMU",
        )
    return imu_stream(table.t_ns, gyro_rad_s, accel_m_s2, table.where())


def _read_attitude(table: _Table) -> WithProblems[AttitudeStream]:
    if table.name == "ATTITUDE":
        return table.attitude_from_angles(EULER)
    return table.attitude(QUATERNION)


def _read_velocity(attitude: _Table, table: _Table) -> WithProblems[VectorStream]:
    turning = _read_attitude(attitude).value  # its problems are reported when it is read itself
    return velocity_stream(table.t_ns, table.numbers(*VELOCITY), turning, table.where())


def _looks_down(table: _Table) -> BoolArray:
    return np.asarray(table.rows["orientation"] == DOWNWARD)


def _read_range(table: _Table) -> WithProblems[RangeStream]:
    distance_m, low_m, high_m = table.numbers(*DISTANCES).T
    trusted = _looks_down(table) & (table.rows["signal_quality"] != INVALID_SIGNAL)
    return range_stream(table.t_ns, distance_m, table.where(), limits_m=(low_m, high_m), trusted=trusted)
