"""CSV files of any form, read by a column map: the user's, a predefined one, or one found from the header.

Units are converted to SI and axes to FRD with z down. If neither map nor manifest declares the body's axes, gravity
decides between FRD and FLU, and a problem reports the choice.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from fusion.flight import (
    AttitudeStream,
    FloatArray,
    ImuStream,
    RangeStream,
    Remark,
    TimeArray,
    VectorStream,
)
from fusion.logs.contents import Kind, LogContents, Topic, UndecidedError
from fusion.logs.csv.column_map import READY_MAPS, ColumnMap, Frame
from fusion.logs.csv.column_names import (
    check_axes,
    has_asl_names,
    map_of_names,
    ready_map_of,
    world_velocity_name,
)
from fusion.logs.csv.table import Layout, read_layout
from fusion.logs.csv.time_units import is_time_name
from fusion.logs.csv.times import ROLES, read_timed, time_columns
from fusion.logs.imu_series import imu_stream
from fusion.logs.samples import Problems, WithProblems
from fusion.logs.series import (
    MAX_POSITION,
    MAX_VELOCITY,
    Series,
    SeriesLog,
    Stream,
    Where,
    attitude_stream,
    quaternions,
    range_stream,
    vector_stream,
    velocity_stream,
)
from fusion.logs.units import in_si
from fusion.logs.velocity_axes import Axes, axes_of_velocity
from vision import InputError

SUFFIXES = frozenset({".csv", ".tsv"})
TEXT_SUFFIXES = frozenset({".txt", ".log"})

_FLIP = np.array([1.0, -1.0, -1.0])  # FLU to FRD, and a world with z up to one with z down
_Q_FLIP = np.array([1.0, 1.0, -1.0, -1.0])  # the same on both sides of a quaternion
_Q_NED_ENU = (0.0, np.sqrt(0.5), np.sqrt(0.5), 0.0)
_Q_FLU_FRD = (0.0, 1.0, 0.0, 0.0)
_HALF_TURN = 3.3  # rad; in degrees, a tilt that every flight reaches
_NOT_DAMAGED = 0.01  # share of the rows
_UPRIGHT_M_S2 = 5.0
MAX_LISTED = 12  # names of columns
_NOT_STATED = "the file does not say"

_EXAMPLE = (
    'name them in flight.toml, as in [imu.columns] time = "t", gyro = ["gx", "gy", "gz"], gyro_unit = "deg/s", or '
    '[attitude.columns] quaternion = ["w", "x", "y", "z"]'
)
_NUMBERED_EXAMPLE = (
    "give the numbers of the columns, from 1, in flight.toml, as in [imu.columns] time = 1, gyro = [2, 3, 4], "
    'gyro_unit = "deg/s", or add a header'
)


def recognises(path: Path) -> bool:
    """Whether a file is a CSV by its extension, or a text with known columns."""
    suffix = path.suffix.lower()
    if not path.is_file() or suffix not in SUFFIXES | TEXT_SUFFIXES:
        return False
    if suffix in SUFFIXES:
        return True
    try:
        layout = read_layout(path)
    except InputError:
        return False
    return ready_map_of(layout) is not None or map_of_names(layout).value is not None


def open_log(path: Path) -> LogContents:
    """Open a CSV whose columns have known names."""
    return open_columns(path)


def open_columns(
    path: Path, columns: ColumnMap | str | None = None, frame: Frame | None = None
) -> LogContents:
    """Open a CSV by a column map.

    Parameters
    ----------
    path
        The file.
    columns
        The map, the name of a predefined one, or None to use the header.
    frame
        Axes, which override those of the map.

    Raises
    ------
    InputError
        If the file cannot be read, a column is missing, or the meaning of the columns is unknown.
    """
    layout = read_layout(
        path, *(() if not isinstance(columns, ColumnMap) else (columns.separator, columns.header))
    )
    (found, what), assumed = _map(layout, columns)
    table, problems = _Table.read(layout, found, frame)
    series = []
    for kind, roles, read in _READERS:
        if any(role in table.parts for role in roles):
            series.append(Series(Topic(kind.value, kind, table.t_ns, table.note(kind)), partial(read, table)))
    if not series and "accel" in table.parts:
        listed = ", ".join(layout.names[:20]) if layout.has_names else f"{len(layout.names)} without names"
        raise InputError(
            f"has an accelerometer, but no known gyroscope: {listed}", file=path, remedy=_EXAMPLE
        )
    log = CsvLog(path, what, series, assumed + problems + _unread_columns(layout, found))
    log.units_taken = found.units_taken
    log.body_frame = "flu" if table.body_frame().value in ("flu", "enu") else "frd"
    return log


class CsvLog(SeriesLog):
    """`LogContents` of a CSV; ``body_frame`` is its assumed axes, `ColumnMap.units_taken` its assumed units."""

    units_taken: Mapping[str, float]


def _unread_columns(layout: Layout, columns: ColumnMap) -> Problems:
    """Name the columns that are not read."""
    named = {layout.find(name, role) for role in ROLES for name in columns.columns_of(role)}
    named |= set(time_columns(layout, columns))
    unread = [
        name
        for index, name in enumerate(layout.names)
        if name and index not in named and not (columns.time is None and is_time_name(name) is not None)
    ]
    if not unread:
        return ()
    more = f" and {len(unread) - MAX_LISTED} more" if len(unread) > MAX_LISTED else ""
    listed = ", ".join(unread[:MAX_LISTED])
    return (Remark(f"{layout.path.name}: columns that are not read: {listed}{more}"),)


def _map(layout: Layout, columns: ColumnMap | str | None) -> WithProblems[tuple[ColumnMap, str]]:
    """Return the map to use, and the name of the format."""
    if isinstance(columns, ColumnMap):
        if not any(columns.columns_of(role) for role in ROLES):
            check_axes(layout)
            guessed, problems = map_of_names(layout, columns.model_fields_set)
            if guessed is None:
                raise InputError(
                    "the column map names no data",
                    file=layout.path,
                    remedy=_EXAMPLE if layout.has_names else _NUMBERED_EXAMPLE,
                )
            changed = guessed.model_copy(update=columns.model_dump(exclude_unset=True))
            return WithProblems((changed, "CSV"), problems)
        return WithProblems((columns, "CSV"))
    ready = columns or ready_map_of(layout)
    if ready is not None:
        return WithProblems((_present(READY_MAPS[ready], layout), f"CSV ({ready})"))
    check_axes(layout)
    guessed, problems = map_of_names(layout)
    if guessed is None:
        if not layout.has_names:
            problem = f"has no header, so the meaning of its {len(layout.names)} columns is not known"
            raise InputError(problem, file=layout.path, remedy=_NUMBERED_EXAMPLE)
        listed = ", ".join(layout.names[:20])
        raise InputError(f"its columns are not known by name: {listed}", file=layout.path, remedy=_EXAMPLE)
    return WithProblems((guessed, "CSV"), problems)


def _present(ready: ColumnMap, layout: Layout) -> ColumnMap:
    """Remove from a predefined map the columns that a file lacks, because recorders differ; but not all of them."""
    absent = [
        role
        for role in ROLES
        if any(isinstance(name, str) and layout.find_column(name) is None for name in ready.columns_of(role))
    ]
    named = [role for role in ROLES if ready.columns_of(role)]
    return ready if absent == named else ready.model_copy(update=dict.fromkeys(absent))


@dataclass(frozen=True, slots=True, eq=False)
class _Table:
    """The columns that a map names, in SI units but along the file's own axes."""

    path: Path
    columns: ColumnMap
    frame: Frame | None
    t_ns: TimeArray
    parts: dict[str, FloatArray]

    @classmethod
    def read(cls, layout: Layout, columns: ColumnMap, frame: Frame | None) -> WithProblems[_Table]:
        """Read them all in one pass."""
        wanted: dict[str, list[int]] = {}
        for role in ROLES:
            names = columns.columns_of(role)
            if names:
                wanted[role] = [layout.find(name, f"columns.{role}") for name in names]
        order = [index for indices in wanted.values() for index in indices]
        timed, problems = read_timed(layout, columns, order)
        parts: dict[str, FloatArray] = {}
        start = 0
        for role, indices in wanted.items():
            unit = columns.unit_of(role)
            values = timed.rows.values[:, start : start + len(indices)]
            parts[role] = values * in_si(unit) if unit is not None else values
            start += len(indices)
        if "accel" in parts:
            parts["accel"] = parts["accel"] * columns.accel_sign
        if "euler" in parts and columns.euler_unit == "rad" and _are_degrees(parts["euler"]):
            if "euler_unit" in columns.model_fields_set:
                raise InputError(
                    "roll and pitch go beyond half a turn: they are in degrees, not radians",
                    file=layout.path,
                    remedy='set euler_unit = "deg" in [attitude.columns] of flight.toml',
                )
            parts["euler"] = parts["euler"] * in_si("deg")
            problems += (Remark(f"{layout.path.name}: roll and pitch go beyond half a turn: degrees taken"),)
        if "quaternion" in parts and not parts["quaternion"].any():
            del parts["quaternion"]
            problems += (Remark(f"{layout.path.name}: its quaternions are zero in every row, left out"),)
        return WithProblems(cls(layout.path, columns, frame, timed.t_ns, parts), problems)

    def note(self, kind: Kind) -> str:
        """Declare the axes, if known."""
        if kind is Kind.RANGE:
            return f"in {self.columns.range_unit}, taken to look down"
        frame = (
            self.frame
            or (self.columns.velocity_frame if kind is Kind.VELOCITY else None)
            or self.columns.frame
        )
        return f"axes {frame}" if frame else ""

    def where(self, kind: Kind) -> Where:
        """Return the name of a stream for messages."""
        return Where(self.path, f"{self.path.name} ({kind.value})")

    def body_frame(self) -> WithProblems[Frame]:
        """Return the body's axes: the map's, or else those found from gravity, with a problem that reports them."""
        declared = self.frame or self.columns.frame
        if declared is not None:
            return WithProblems(declared)
        frame, why = self._likely_frame()
        problem = f"{self.path.name}: axes assumed {frame} ({why}); set frame in flight.toml"
        return WithProblems(frame, (problem if why == _NOT_STATED else Remark(problem),))

    def _likely_frame(self) -> tuple[Frame, str]:
        """Return the axes by gravity, or else those usual with the columns' names, and the reason."""
        accel = self.parts.get("accel", np.zeros((0, 3)))
        accel = accel[np.isfinite(accel).all(axis=1)]
        usual = np.median(accel, axis=0) if len(accel) else np.zeros(3)
        if abs(usual[2]) > _UPRIGHT_M_S2:
            return ("flu", "the accelerometer reads gravity along +z") if usual[2] > 0.0 else (
                "frd", "the accelerometer reads gravity along -z"
            )  # fmt: skip
        if np.linalg.norm(usual) > _UPRIGHT_M_S2:
            # These are not a vehicle's axes, so the calibration gives the IMU's mounting; Kalibr uses ROS's axes.
            return "flu", "the accelerometer reads gravity along another axis than z"
        if has_asl_names(self.columns):
            return "flu", "by its names, which are those of ASL / EuRoC logs"
        return "frd", _NOT_STATED

    def imu(self) -> WithProblems[ImuStream]:
        """Gyroscope and accelerometer, body FRD."""
        gyro = self.parts["gyro"]
        accel = self.parts.get("accel")
        frame, problems = self.body_frame()
        flip = _FLIP if frame in ("flu", "enu") else np.ones(3)
        where = self.where(Kind.IMU)
        if accel is not None:
            imu, more = imu_stream(self.t_ns, gyro * flip, accel * flip, where)
        else:
            # A column that does not exist is not reported as missing in every row.
            imu, more = imu_stream(self.t_ns, gyro * flip, np.zeros_like(gyro), where)
            imu = replace(imu, accel_m_s2=np.full_like(imu.gyro_rad_s, np.nan))
        return WithProblems(imu, problems + more)

    def attitude(self) -> WithProblems[AttitudeStream]:
        """Body FRD to world z down."""
        frame, problems = self.body_frame()
        if "gyro" in self.parts:
            problems = ()  # reported with the IMU
        q = self._quaternions()
        if frame == "flu":
            q = q * _Q_FLIP
        elif frame == "enu":
            q = _product(_product(np.array([_Q_NED_ENU]), q), np.array([_Q_FLU_FRD]))
        attitude, more = attitude_stream(self.t_ns, q, self.where(Kind.ATTITUDE))
        return WithProblems(attitude, problems + more)

    def position(self) -> WithProblems[VectorStream]:
        """World, z down."""
        xyz = _world(self.parts["position"], self.body_frame().value)
        return vector_stream(self.t_ns, xyz, self.where(Kind.POSITION), MAX_POSITION)

    def velocity(self) -> WithProblems[VectorStream]:
        """Body FRD."""
        (axes, frame), problems = self._velocity_axes()
        where = self.where(Kind.VELOCITY)
        v = self.parts["velocity"]
        if axes is Axes.BODY:
            flip = frame in ("flu", "enu")
            stream, more = vector_stream(self.t_ns, v * _FLIP if flip else v, where, MAX_VELOCITY)
            return WithProblems(stream, problems + more)
        if not self._has_attitude:
            raise InputError(
                f"velocity is along the world's axes ({frame}), and no column gives the attitude",
                file=self.path,
                remedy="name the attitude's columns too, or leave the stream out: [velocity] use = false",
            )
        attitude = self.attitude().value  # its problems are reported when it is read itself
        stream, more = velocity_stream(self.t_ns, _world(v, frame), attitude, where)
        return WithProblems(stream, problems + more)

    def _velocity_axes(self) -> WithProblems[tuple[Axes, Frame]]:
        """Return the axes of the velocity: as declared, by its name, or else by comparison with the pose.

        Raises
        ------
        UndecidedError
            If they remain undecided and matter.
        """
        pose_frame, declared = self.body_frame().value, self.frame or self.columns.velocity_frame
        name = world_velocity_name(self.columns)
        if name is not None and self.columns.velocity_frame is None:
            problem = f"{self.path.name}: velocity taken along the world's axes, as its name {name} says"
            return WithProblems((Axes.WORLD, pose_frame), (Remark(problem),))
        if declared in ("ned", "enu") or (declared is None and self.columns.frame in ("ned", "enu")):
            is_same_up = (declared in ("flu", "enu")) == (pose_frame in ("flu", "enu"))
            return WithProblems((Axes.WORLD, pose_frame if declared is None or is_same_up else declared))
        found: Axes | None = Axes.BODY
        if self._has_attitude and self.columns.velocity_frame is None:
            pose = self.parts.get("position"), self._quaternions()
            found = axes_of_velocity(self.t_ns, *pose, self.parts["velocity"])
        declared = declared or self.columns.frame
        if found is None and declared is None:
            raise UndecidedError(
                "velocity may be along the body's axes or the world's, and the pose does not tell",
                file=self.path,
                remedy='say it in flight.toml: [velocity] frame = "frd" or "flu" of the body, "ned" or "enu" of the '
                "world; or [velocity] use = false",
            )
        if found is not Axes.WORLD:
            return WithProblems((Axes.BODY, declared or pose_frame))
        problem = (
            f"{self.path.name}: velocity taken along the world's axes, as its positions move; set velocity_frame "
            "under [velocity.columns] in flight.toml if it is not"
        )
        return WithProblems((Axes.WORLD, pose_frame), (Remark(problem),))

    @property
    def _has_attitude(self) -> bool:
        return "quaternion" in self.parts or "euler" in self.parts

    def _quaternions(self) -> FloatArray:
        """Attitude (n, 4), w x y z, along the file's own axes."""
        if "quaternion" in self.parts:
            return self.parts["quaternion"]
        return quaternions(*self.parts["euler"].T)

    def range(self) -> WithProblems[RangeStream]:
        """Distance to the floor along the body's z."""
        limits, where = self.columns.range_limits, self.where(Kind.RANGE)
        if limits is None:
            return range_stream(self.t_ns, self.parts["range"][:, 0], where)
        low, high = (limit * in_si(self.columns.range_unit) for limit in limits)
        return range_stream(self.t_ns, self.parts["range"][:, 0], where, limits_m=(low, high))


_READERS: tuple[tuple[Kind, tuple[str, ...], Callable[[_Table], WithProblems[Stream]]], ...] = (
    (Kind.IMU, ("gyro",), _Table.imu),
    (Kind.ATTITUDE, ("quaternion", "euler"), _Table.attitude),
    (Kind.POSITION, ("position",), _Table.position),
    (Kind.VELOCITY, ("velocity",), _Table.velocity),
    (Kind.RANGE, ("range",), _Table.range),
)


def _are_degrees(euler: FloatArray) -> bool:
    """Whether roll, pitch and yaw (n, 3) are too large for radians; damaged rows are ignored."""
    tilt = np.abs(euler[:, :2])
    return bool(np.mean(np.any(tilt > _HALF_TURN, axis=1)) > _NOT_DAMAGED)


def _world(xyz: FloatArray, frame: Frame) -> FloatArray:
    """Convert vectors (n, 3) of a world to one with z down."""
    if frame == "enu":
        return np.asarray(xyz[:, [1, 0, 2]] * np.array([1.0, 1.0, -1.0]))
    return xyz * _FLIP if frame == "flu" else xyz


def _product(a: FloatArray, b: FloatArray) -> FloatArray:
    """Hamilton product of quaternions (n, 4) or (1, 4)."""
    aw, ax, ay, az = a.T
    bw, bx, by, bz = b.T
    return np.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ],
        axis=1,
    )
