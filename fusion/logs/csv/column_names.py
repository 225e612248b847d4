"""What the columns of a CSV are called: maps found from the header, where its names are ones in common use."""

from __future__ import annotations

import re
from typing import Any

import numpy as np

from fusion.flight import Remark
from fusion.logs.csv.column_map import READY_MAPS, ColumnMap
from fusion.logs.csv.table import Layout
from fusion.logs.samples import Problems, WithProblems

# {} stands for the axis. Names are compared in lower case, dots and blanks as underscores, without units.
_VECTORS = {
    "gyro": "w_rs_s_{} gyro_{} gyr_{} gyroscope_{} angular_velocity_{} ang_vel_{} omega_{} w_{} g{} w{} gyro{} "
    "{}gyro angularvelocity_{} angvel_{} angular_rate_{} rotation_rate_{} rate_{}",
    "accel": "a_rs_s_{} accel_{} acc_{} accelerometer_{} linear_acceleration_{} lin_acc_{} a_{} a{} acc{} accel{} "
    "{}acc acceleration_{} specific_force_{}",
    "velocity": "v_rs_r_{} velocity_{} vel_{} v_{} v{} twist_linear_{}",
    "position": "p_rs_r_{} position_{} pos_{} p_{} p{} t{} t_{} pose_position_{} {}",
}
_QUATERNIONS = ("q_rs_{}", "q_{}", "q{}", "quat_{}", "quaternion_{}", "orientation_{}", "pose_orientation_{}")
_NUMBERED_QUATERNION = ["q0", "q1", "q2", "q3"]  # w first; an attitude that then turns otherwise is refused
_RANGES = ("range", "rangefinder", "tof", "distance_to_floor", "distance_to_ground")
_UNITS = {
    "gyro": {
        "rad_s": "rad/s",
        "deg_s": "deg/s",
        "dps": "deg/s",
        "mrad_s": "mrad/s",
        "mdps": "mdeg/s",
        "mdeg_s": "mdeg/s",
    },
    "accel": {"m_s2": "m/s2", "g": "g", "mg": "mg", "cm_s2": "cm/s2"},
    "velocity": {"m_s": "m/s", "dm_s": "dm/s", "cm_s": "cm/s", "mm_s": "mm/s"},
    "position": {"m": "m", "dm": "dm", "cm": "cm", "mm": "mm"},
    "euler": {"rad": "rad", "deg": "deg", "mdeg": "mdeg"},
    "range": {"m": "m", "dm": "dm", "cm": "cm", "mm": "mm"},
}
_SENSORS = {"gyro": "gyro", "accel": "accel", "magnet": "", "gravity": "", "orientation": ""}
_TUM = ColumnMap(time=1, position=(2, 3, 4), quaternion=(8, 5, 6, 7))
_SIGNS = {
    "betaflight": {"gyroadc[0]", "gyroadc[1]", "gyroadc[2]"},
    "tello": {"pitch", "roll", "yaw", "vgx", "vgy", "vgz"},
    "crazyflie": {"gyro.x", "gyro.y", "gyro.z"},
    "ardrone_ros": {"rotx", "roty", "rotz", "altd"},
    "ardrone": {"phi", "theta", "psi", "vx", "vy", "vz"},
}


def ready_map_of(layout: Layout) -> str | None:
    """Name the ready map whose columns a file has."""
    names = {name.lower() for name in layout.names}
    return next((key for key in READY_MAPS if _SIGNS[key] <= names), None)


def map_of_names(layout: Layout) -> WithProblems[ColumnMap | None]:
    """Make a map of the columns whose names are known, and say what unit was assumed; None where there are none.

    A vector's unit is that in brackets behind its names or at their end (``gyro_x_deg_s``); else SI.
    """
    if not layout.has_names and is_tum(layout):
        said = Remark(
            f"{layout.path.name}: taken for a TUM trajectory: time, position, quaternion x, y, z, w"
        )
        return WithProblems(_TUM, (said,))
    known = [_normal(name, unit) for name, unit in zip(layout.names, layout.units, strict=True)]
    found: dict[str, Any] = {}
    problems: Problems = ()

    def take(role: str, patterns: list[list[str]], assumed: str, what: str | None = None) -> None:
        nonlocal problems
        columns, unit = _find(known, patterns, role)
        if not columns:
            return
        names = tuple(layout.names[i] for i in columns)
        found[role] = names[0] if role == "range" else names
        if unit:
            found[f"{role}_unit"] = unit
        elif assumed:
            problems += (
                Remark(f"{layout.path.name}: no unit is given for {what or names[0]}, {assumed} taken"),
            )

    sensor = _sensor_of(layout)
    for role, patterns in _VECTORS.items():
        # Phones write a file for each sensor, whose columns are called x, y, z.
        told = patterns.split() if sensor is None else [p for p in patterns.split() if p != "{}"]
        told += ["{}"] if role == sensor else []
        axes = [[pattern.format(axis) for axis in "xyz"] for pattern in told]
        take(role, axes, ColumnMap.model_fields[f"{role}_unit"].default, role)
    take(
        "quaternion", [*([p.format(part) for part in "wxyz"] for p in _QUATERNIONS), _NUMBERED_QUATERNION], ""
    )
    if "quaternion" not in found:
        take("euler", [["roll", "pitch", "yaw"], ["roll", "pitch", "heading"]], "rad", "roll, pitch and yaw")
    take("range", [[name] for name in _RANGES], "m")
    return WithProblems(ColumnMap(**found) if found else None, problems)


def is_tum(layout: Layout) -> bool:
    """Whether rows without names are a trajectory: time, position, a unit quaternion, and perhaps covariances."""
    try:
        q = np.array([row[4:8] for row in layout.sample], dtype=float)
    except ValueError:
        return False
    if q.ndim != 2 or q.shape[1] != 4:
        return False
    return bool((np.abs(np.linalg.norm(q, axis=1) - 1.0) < 0.01).all())


def _sensor_of(layout: Layout) -> str | None:
    """Return which sensor a file is named after, as ``Gyroscope.csv`` of phones is; None where it is not."""
    stem = layout.path.stem.lower()
    return next((role for word, role in _SENSORS.items() if word in stem), None)


def names_the_world(columns: ColumnMap) -> str | None:
    """Return the velocity's name where it says that it is along the world's axes, as EuRoC's ``v_RS_R_x`` does."""
    names = [name for name in columns.velocity or () if isinstance(name, str)]
    return next((name for name in names if re.search(r"v_rs_r|world", name, re.IGNORECASE)), None)


def has_asl_names(columns: ColumnMap) -> bool:
    """Whether any column goes by a name of the ASL / EuRoC layout, whose axes are x ahead, y left, z up."""
    roles = ("gyro", "accel", "quaternion", "velocity", "position")
    return any("_rs_" in str(name).lower() for role in roles for name in columns.columns_of(role))


def _find(known: list[tuple[str, str]], patterns: list[list[str]], role: str) -> tuple[list[int], str]:
    """Return the columns of the first pattern that a file has, and their unit, if any; none where it has none."""
    return (
        _find_spelled(known, patterns, role)
        or _find_spelled(
            [(name.replace("_", ""), unit) for name, unit in known],
            [[name.replace("_", "") for name in names] for names in patterns if names[0] not in "xyz"],
            role,
        )
        or ([], "")
    )


def _find_spelled(
    known: list[tuple[str, str]], patterns: list[list[str]], role: str
) -> tuple[list[int], str] | None:
    units = _UNITS.get(role, {})
    place_of = {name: i for i, (name, _) in reversed(list(enumerate(known)))}  # the first of a name counts
    for names in patterns:
        for ending in ("", *units):
            wanted = [f"{name}_{ending}" if ending else name for name in names]
            places = [place_of.get(name) for name in wanted]
            columns = [i for i in places if i is not None]
            if len(columns) == len(wanted):
                return columns, units.get(ending) or units.get(known[columns[0]][1], "")
    return None


def _normal(name: str, unit: str) -> tuple[str, str]:
    """Bring a column's name and its unit into one spelling: ``field.angular_velocity.x``, ``rad s^-1``."""
    name = re.sub(r"[\s.\-]+", "_", name.strip().lower()).removeprefix("field_").removeprefix("_")
    unit = unit.lower().replace("²", "2").replace("^", "").replace("°", "deg").replace("degrees", "deg")
    unit = re.sub(r"[\s*·]+", " ", unit).strip()
    unit = re.sub(r"\bs-(\d)", r"/s\1", unit).replace(" /", "/").replace("/s1", "/s")
    return name, unit.replace("/", "_")
