"""What the columns of a CSV are called: maps found from the header, where its names are ones in common use."""

from __future__ import annotations

import re
from typing import Any

from fusion.logs.csv.column_map import READY_MAPS, ColumnMap
from fusion.logs.csv.table import Layout

# {} stands for the axis. Names are compared in lower case, dots and blanks as underscores, without units.
_VECTORS = {
    "gyro": "w_rs_s_{} gyro_{} gyr_{} gyroscope_{} angular_velocity_{} omega_{} w_{} g{} w{} gyro{} {}gyro",
    "accel": "a_rs_s_{} accel_{} acc_{} accelerometer_{} linear_acceleration_{} a_{} a{} acc{} accel{} {}acc",
    "velocity": "v_rs_r_{} velocity_{} vel_{} v_{} v{} twist_linear_{}",
    "position": "p_rs_r_{} position_{} pos_{} p_{} p{} pose_position_{} {}",
}
_QUATERNIONS = ("q_rs_{}", "q_{}", "q{}", "quat_{}", "quaternion_{}", "orientation_{}", "pose_orientation_{}")
_RANGES = ("range", "rangefinder", "tof", "distance_to_floor", "distance_to_ground")
_UNITS = {
    "gyro": {"rad_s": "rad/s", "deg_s": "deg/s", "dps": "deg/s", "mrad_s": "mrad/s"},
    "accel": {"m_s2": "m/s2", "g": "g", "mg": "mg", "cm_s2": "cm/s2"},
    "velocity": {"m_s": "m/s", "dm_s": "dm/s", "cm_s": "cm/s", "mm_s": "mm/s"},
    "position": {"m": "m", "dm": "dm", "cm": "cm", "mm": "mm"},
    "euler": {"rad": "rad", "deg": "deg", "mdeg": "mdeg"},
    "range": {"m": "m", "dm": "dm", "cm": "cm", "mm": "mm"},
}
_SIGNS = {
    "tello": {"pitch", "roll", "yaw", "vgx", "vgy", "vgz"},
    "ardrone_ros": {"rotx", "roty", "rotz", "altd"},
    "ardrone": {"phi", "theta", "psi", "vx", "vy", "vz"},
}


def ready_map_of(layout: Layout) -> str | None:
    """Name the ready map whose columns a file has."""
    names = {name.lower() for name in layout.names}
    return next((key for key in READY_MAPS if _SIGNS[key] <= names), None)


def map_of_names(layout: Layout, notes: list[str]) -> ColumnMap | None:
    """Make a map of the columns whose names are known; ``notes`` say what unit was assumed. None: there are none.

    A vector's unit is that in brackets behind its names or at their end (``gyro_x_deg_s``); else SI.
    """
    known = [_normal(name, unit) for name, unit in zip(layout.names, layout.units, strict=True)]
    found: dict[str, Any] = {}
    for role, patterns in _VECTORS.items():
        unit = _find(
            known, layout, [[p.format(axis) for axis in "xyz"] for p in patterns.split()], role, found
        )
        if unit == "" and role in found:
            default = ColumnMap.model_fields[f"{role}_unit"].default
            notes.append(f"{layout.path.name}: no unit is given for {role}, {default} taken")
    _find(known, layout, [[p.format(part) for part in "wxyz"] for p in _QUATERNIONS], "quaternion", found)
    if "quaternion" not in found:
        unit = _find(known, layout, [["roll", "pitch", "yaw"]], "euler", found)
        if unit == "" and "euler" in found:
            notes.append(f"{layout.path.name}: no unit is given for roll, pitch and yaw, rad taken")
    unit = _find(known, layout, [[name] for name in _RANGES], "range", found)
    if "range" in found:
        (found["range"],) = found["range"]
        if unit == "":
            notes.append(f"{layout.path.name}: no unit is given for {found['range']}, m taken")
    return ColumnMap(**found) if found else None


def _find(
    known: list[tuple[str, str]], layout: Layout, patterns: list[list[str]], role: str, found: dict[str, Any]
) -> str:
    """Put the columns of the first pattern that a file has under ``role``; return their unit, if any."""
    units = _UNITS.get(role, {})
    for names in patterns:
        for ending in ("", *units):
            wanted = [f"{name}_{ending}" if ending else name for name in names]
            places = [next((i for i, (name, _) in enumerate(known) if name == w), None) for w in wanted]
            if None in places:
                continue
            columns = [int(i) for i in places if i is not None]
            unit = units.get(ending) or units.get(known[columns[0]][1], "")
            found[role] = tuple(layout.names[i] for i in columns)
            if unit:
                found[f"{role}_unit"] = unit
            return unit
    return ""


def _normal(name: str, unit: str) -> tuple[str, str]:
    """Bring a column's name and its unit into one spelling: ``field.angular_velocity.x``, ``rad s^-1``."""
    name = re.sub(r"[\s.\-]+", "_", name.strip().lower()).removeprefix("field_").removeprefix("_")
    unit = unit.lower().replace("²", "2").replace("^", "").replace("°", "deg").replace("degrees", "deg")
    unit = re.sub(r"[\s*·]+", " ", unit).strip()
    unit = re.sub(r"\bs-(\d)", r"/s\1", unit).replace(" /", "/").replace("/s1", "/s")
    return name, unit.replace("/", "_")
