"""Names of CSV columns: column maps found from a header with names in common use."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from typing import Any

import numpy as np

from fusion.flight import FloatArray, Remark
from fusion.logs.csv.column_map import READY_MAPS, ColumnMap
from fusion.logs.csv.table import Layout
from fusion.logs.samples import Problems, WithProblems
from fusion.logs.units import in_si
from vision import InputError

# {} stands for the axis. Names are compared in lower case, with underscores for dots and blanks, without units.
_VECTORS = {
    "gyro": "w_rs_s_{} gyro_{} gyr_{} gyroscope_{} angular_velocity_{} ang_vel_{} omega_{} w_{} g{} w{} gyro{} "
    "{}gyro angularvelocity_{} angvel_{} angular_rate_{} rotation_rate_{} rate_{}",
    "accel": "a_rs_s_{} accel_{} acc_{} accelerometer_{} linear_acceleration_{} lin_acc_{} a_{} a{} acc{} accel{} "
    "{}acc acceleration_{} specific_force_{}",
    "velocity": "v_rs_r_{} velocity_{} vel_{} v_{} v{} twist_linear_{}",
    "position": "p_rs_r_{} position_{} pos_{} p_{} p{} t{} t_{} pose_position_{} {}",
}
_QUATERNIONS = ("q_rs_{}", "q_{}", "q{}", "quat_{}", "quaternion_{}", "orientation_{}", "pose_orientation_{}")
_NUMBERED_QUATERNION = ["q0", "q1", "q2", "q3"]  # w first; rejected later if it contradicts the gyroscope
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
# Sets of columns, any of which shows that a file is of this kind.
_SIGNS = {
    "px4": (
        {"timestamp", "gyro_rad[0]", "gyro_rad[1]", "gyro_rad[2]"},
        {"timestamp", "q[0]", "q[1]", "q[2]", "q[3]"},
    ),
    "betaflight": ({"gyroadc[0]", "gyroadc[1]", "gyroadc[2]"},),
    "tello": ({"pitch", "roll", "yaw", "vgx", "vgy", "vgz"},),
    "crazyflie": ({"gyro.x", "gyro.y", "gyro.z"},),
    "ardrone_ros": ({"rotx", "roty", "rotz", "altd"},),
    "ardrone": ({"phi", "theta", "psi", "vx", "vy", "vz"},),
}


def ready_map_of(layout: Layout) -> str | None:
    """Name the predefined map whose columns a file has."""
    names = {name.lower() for name in layout.names}
    return next((key for key in READY_MAPS if any(signs <= names for signs in _SIGNS[key])), None)


def map_of_names(layout: Layout, stated: Collection[str] = ()) -> WithProblems[ColumnMap | None]:
    """Make a map of the columns with known names, and report the assumed units; None if there are none.

    A vector's unit is in brackets after its names or at their end (``gyro_x_deg_s``), or else SI; ``stated`` names
    the entries of the map that the user sets.
    """
    if not layout.has_names and is_tum(layout):
        remark = Remark(
            f"{layout.path.name}: taken for a TUM trajectory: time, position, quaternion x, y, z, w"
        )
        return WithProblems(_TUM, (remark,))
    known = _known(layout)
    found: dict[str, Any] = {}
    problems: Problems = ()

    def take(role: str, patterns: list[list[str]], assumed: str, what: str | None = None) -> None:
        nonlocal problems
        columns, unit = _find(known, patterns, role)
        if not columns:
            return
        names = tuple(layout.names[i] for i in columns)
        given = layout.units[columns[0]].strip()
        is_stated = f"{role}_unit" in stated
        if given and not unit and role in _UNITS and role != "position" and not is_stated:
            raise InputError(
                f"column {names[0]} is in {given}, a unit that is not known",
                file=layout.path,
                remedy=f"known are {', '.join(dict.fromkeys(_UNITS[role].values()))}: convert the column and name "
                f"its unit, or set {role}_unit under the columns in flight.toml",
            )
        found[role] = names[0] if role == "range" else names
        if unit:
            found[f"{role}_unit"] = unit
        elif assumed and not is_stated:
            problems += (
                Remark(f"{layout.path.name}: no unit is given for {what or names[0]}, {assumed} assumed"),
            )

    for role in _VECTORS:
        take(role, _axes(layout, role), ColumnMap.model_fields[f"{role}_unit"].default, role)
    take("quaternion", _patterns("quaternion", bare=False), "")
    if "quaternion" not in found:
        take("euler", [["roll", "pitch", "yaw"], ["roll", "pitch", "heading"]], "rad", "roll, pitch and yaw")
    take("range", [[name] for name in _RANGES], "m")
    return WithProblems(ColumnMap(**found) if found else None, problems)


def named_columns(
    names: Sequence[str], units: Sequence[str], roles: Sequence[str]
) -> tuple[list[int | None], FloatArray]:
    """Find the columns of some quantities in a header.

    Parameters
    ----------
    names, units
        Of the columns.
    roles
        Quantities such as ``gyro``, in order; a single one may have bare names of axes, such as ``x``.

    Returns
    -------
    tuple of list and array
        Index of each quantity's columns, in the order x, y, z or w, x, y, z, None if a column has no known name or
        not alone; factors of their units to SI, 1 if none is given.
    """
    known = [_normal(name, unit) for name, unit in zip(names, units, strict=True)]
    count = Counter(name for name, _ in known)
    known = [(name if count[name] == 1 else "", unit) for name, unit in known]
    places: list[int | None] = []
    factors: list[float] = []
    for role in roles:
        found = max(_spellings(known, _patterns(role, bare=len(roles) == 1), role), key=_places_found)
        places += found[1]
        first = found[1][0]
        unit = found[2] or ("" if first is None else _UNITS.get(role, {}).get(known[first][1], ""))
        factors += [in_si(unit) if unit else 1.0] * len(found[1])
    return places, np.array(factors)


def _patterns(role: str, *, bare: bool) -> list[list[str]]:
    """Return the possible names of a quantity's columns."""
    if role == "range":
        return [[name] for name in (*_RANGES, "distance")]
    axes = "wxyz" if role == "quaternion" else "xyz"
    known = _QUATERNIONS if role == "quaternion" else [p for p in _VECTORS[role].split() if p != "{}"]
    patterns = [[pattern.format(axis) for axis in axes] for pattern in (*known, *(["{}"] if bare else []))]
    return [*patterns, _NUMBERED_QUATERNION] if role == "quaternion" else patterns


def _places_found(spelling: tuple[list[str], list[int | None], str]) -> int:
    return sum(place is not None for place in spelling[1])


def check_axes(layout: Layout) -> None:
    """Raise `InputError` if two axes of gyroscope or accelerometer have known names, but the third does not."""
    known = _known(layout)
    for role, sensor in (("gyro", "gyroscope"), ("accel", "accelerometer")):
        patterns = _axes(layout, role)
        if _find(known, patterns, role)[0]:
            continue
        for wanted, places, _ in _spellings(known, patterns, role):
            there = [layout.names[i] for i in places if i is not None]
            if len(there) == 2:
                missing = wanted[places.index(None)]
                raise InputError(
                    f"has {there[0]} and {there[1]} of the {sensor}, but no column {missing}",
                    file=layout.path,
                    remedy=f"rename the column of the third axis to {missing}, or name all columns to read under "
                    "[imu.columns] in flight.toml",
                )


def is_tum(layout: Layout) -> bool:
    """Whether rows without names are a trajectory: time, position, unit quaternion, and optional covariances."""
    try:
        q = np.array([row[4:8] for row in layout.sample], dtype=float)
    except ValueError:
        return False
    if q.ndim != 2 or q.shape[1] != 4:
        return False
    return bool((np.abs(np.linalg.norm(q, axis=1) - 1.0) < 0.01).all())


def _known(layout: Layout) -> list[tuple[str, str]]:
    return [_normal(name, unit) for name, unit in zip(layout.names, layout.units, strict=True)]


def _axes(layout: Layout, role: str) -> list[list[str]]:
    """Return the possible names of a vector's three columns."""
    # Phones write a file per sensor, with columns x, y, z.
    sensor = _sensor_of(layout)
    patterns = [p for p in _VECTORS[role].split() if sensor is None or p != "{}"]
    patterns += ["{}"] if role == sensor else []
    return [[pattern.format(axis) for axis in "xyz"] for pattern in patterns]


def _sensor_of(layout: Layout) -> str | None:
    """Return the sensor that a file is named after, such as a phone's ``Gyroscope.csv``; None if there is none."""
    stem = layout.path.stem.lower()
    return next((role for word, role in _SENSORS.items() if word in stem), None)


def world_velocity_name(columns: ColumnMap) -> str | None:
    """Return the velocity's name if it means the world's axes, as EuRoC's ``v_RS_R_x``; else None."""
    names = [name for name in columns.velocity or () if isinstance(name, str)]
    return next((name for name in names if re.search(r"v_rs_r|world", name, re.IGNORECASE)), None)


def has_asl_names(columns: ColumnMap) -> bool:
    """Whether any column has a name of the ASL / EuRoC layout, with axes x forward, y left, z up."""
    roles = ("gyro", "accel", "quaternion", "velocity", "position")
    return any("_rs_" in str(name).lower() for role in roles for name in columns.columns_of(role))


def _find(known: list[tuple[str, str]], patterns: list[list[str]], role: str) -> tuple[list[int], str]:
    """Return the columns of the first pattern that a file has, and their unit, if any; none if it has none."""
    for _, places, unit in _spellings(known, patterns, role):
        columns = [i for i in places if i is not None]
        if len(columns) == len(places):
            return columns, unit or _UNITS.get(role, {}).get(known[columns[0]][1], "")
    return [], ""


def _spellings(
    known: list[tuple[str, str]], patterns: list[list[str]], role: str
) -> Iterator[tuple[list[str], list[int | None], str]]:
    """Yield each spelling of the names, the matching columns, and the unit at the end of the names."""
    units = _UNITS.get(role, {})
    joined = [[name.replace("_", "") for name in names] for names in patterns if names[0] not in "xyz"]
    for sought, there in ((patterns, known), (joined, [(name.replace("_", ""), "") for name, _ in known])):
        place_of = {name: i for i, (name, _) in reversed(list(enumerate(there)))}  # the first one is used
        for names in sought:
            for ending in ("", *units):
                wanted = [f"{name}_{ending}" if ending else name for name in names]
                yield wanted, [place_of.get(name) for name in wanted], units.get(ending, "")


def _normal(name: str, unit: str) -> tuple[str, str]:
    """Normalise the spelling of a column's name and unit: ``field.angular_velocity.x``, ``rad s^-1``."""
    name = re.sub(r"[\s.\-]+", "_", name.strip().lower()).removeprefix("field_").removeprefix("_")
    unit = unit.lower().replace("²", "2").replace("^", "").replace("°", "deg").replace("degrees", "deg")
    unit = re.sub(r"[\s*·]+", " ", unit).strip()
    unit = re.sub(r"\b(?:sec|second)s?\b", "s", unit)
    unit = re.sub(r"\bs-(\d)", r"/s\1", unit).replace(" /", "/").replace("/s1", "/s")
    return name, unit.replace("/", "_")
