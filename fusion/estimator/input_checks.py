"""Checks of the caller's arguments: returns plain numbers, or raises an error that names the argument.

Also checks the bounds of a frame's measurement: a field beyond them is set to NaN, that is, not measured.
"""

from __future__ import annotations

from dataclasses import fields, replace
from math import inf, isfinite, nan, pi
from operator import index
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from fusion.estimator.config import FusionConfig
from fusion.estimator.models import Vector
from vision.errors import InputError
from vision.lateral.mixture import OffsetMixture
from vision.lateral.parallax import are_profiles
from vision.measurement import FrameMeasurement, Reason

MAX_TIME_NS = 2**62  # 146 years; sums of such times fit into 64 bits
MAX_OFFSET_NORM = 3.0  # a camera between the walls is within 1
MAX_OFFSET_STD = 10.0
MAX_WIDTH_PER_HEIGHT = 1000.0
MAX_ASPECT = 100.0  # of height over width of a corridor, and of its inverse
MAX_ELEVATION_RAD = 0.5  # calibration errors of a camera's mount are smaller
MAX_ROLL_CORRECTION_RAD = 0.5
MAX_ANGLE_STD_RAD = pi
_NUMBERS = tuple(field.name for field in fields(FrameMeasurement) if field.type in ("float", float))


def whole_nanoseconds(t_ns: object) -> int:
    """Return a time as an int.

    Raises
    ------
    InputError
        If it is not an integer (for instance seconds as a float) or does not fit.
    """
    if type(t_ns) is not int:
        try:
            t_ns = index(t_ns)  # type: ignore[arg-type]  # numpy's integers have one, floats do not
        except TypeError:
            raise InputError(
                f"t_ns = {t_ns!r} is not an integer",
                remedy="give nanoseconds as an int: round(seconds * 1e9)",
            ) from None
    if not -MAX_TIME_NS < t_ns < MAX_TIME_NS:
        raise InputError(f"t_ns = {t_ns} is beyond 64 bits", remedy="give nanoseconds since any epoch")
    return t_ns


def float_list(values: npt.ArrayLike, count: int, name: str) -> list[float]:
    """Return ``count`` floats, finite or not.

    Raises
    ------
    InputError
        If the shape is different, or the values are not numbers.
    """
    try:
        found = np.asarray(values, dtype=float)
    except (TypeError, ValueError):
        raise InputError(f"{name} = {values!r} is not {count} numbers") from None
    if found.shape != (count,):
        raise InputError(f"{name} has shape {found.shape}, not ({count},)", remedy="give one sample per call")
    numbers: list[float] = found.tolist()
    return numbers


def vector(values: npt.ArrayLike, name: str) -> Vector:
    """Return three floats, finite or not; errors as in `float_list`."""
    # The usual types without numpy, in half the time.
    listed: Any = values.tolist() if type(values) is np.ndarray and values.shape == (3,) else values
    try:
        x, y, z = listed
        return float(x), float(y), float(z)
    except (TypeError, ValueError):
        x, y, z = float_list(values, 3, name)
        return x, y, z


def number(value: object, name: str) -> float:
    """Return a float, finite or not.

    Raises
    ------
    InputError
        If it is not a number.
    """
    try:
        return float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"{name} = {value!r} is not a number") from None


def checked_config(config: object) -> FusionConfig:
    """Return the settings, the defaults for None; raise `InputError` if they are of another type."""
    if config is None:
        return FusionConfig()
    if not isinstance(config, FusionConfig):
        raise InputError(
            f"config is of type {type(config).__name__}",
            remedy="give a FusionConfig: FusionConfig(**settings)",
        )
    return config


def checked_measurement(measurement: object) -> FrameMeasurement:
    """Return a frame's measurement; raise `InputError` if it or one of its numbers is of another type."""
    if not isinstance(measurement, FrameMeasurement):
        raise InputError(
            f"measurement is of type {type(measurement).__name__}",
            remedy="give a FrameMeasurement; for a frame without a picture call add_unreadable_frame",
        )
    for name in _NUMBERS:
        value = getattr(measurement, name)
        if type(value) is not float and not isinstance(value, (int, float, np.integer, np.floating)):
            raise InputError(
                f"{name} = {value!r} is not a number", remedy="give NaN for what was not measured"
            )
    return measurement


class _Bound(NamedTuple):
    """A value and its sigma, their bounds, and the name under which a rejection is counted."""

    value: str
    std: str
    largest: float
    largest_std: float
    counted: str
    smallest: float = -inf


_BOUNDS = (
    _Bound("lateral_offset_norm", "lateral_offset_norm_std", MAX_OFFSET_NORM, MAX_OFFSET_STD, "frame_offset"),
    _Bound("elevation_rad", "elevation_std_rad", MAX_ELEVATION_RAD, MAX_ANGLE_STD_RAD, "frame_elevation"),
    _Bound(
        "roll_correction_rad",
        "roll_correction_std_rad",
        MAX_ROLL_CORRECTION_RAD,
        MAX_ANGLE_STD_RAD,
        "frame_roll",
    ),
    _Bound("width_per_height", "", MAX_WIDTH_PER_HEIGHT, inf, "frame_width", 0.0),
    _Bound(
        "corridor_aspect", "corridor_aspect_std", MAX_ASPECT, MAX_ASPECT, "frame_aspect", 1.0 / MAX_ASPECT
    ),
)


def within_bounds(m: FrameMeasurement) -> tuple[FrameMeasurement, tuple[str, ...]]:
    """Return a measurement without impossible values, and the names of the counters of rejected fields.

    A heading beyond half a turn rejects the frame; other fields are set to NaN themselves, parts of the
    heading's sigma to 0. NaN is no fault: it means that a field was not measured. Arrays are copied, so that the
    caller may reuse its own, and made contiguous, so that no code is compiled for another layout in flight.
    """
    changes: dict[str, Any] = {}
    counted = []
    for bound in _BOUNDS:
        if _is_beyond(m, bound):
            changes |= dict.fromkeys((bound.value, bound.std) if bound.std else (bound.value,), nan)
            counted.append(bound.counted)
    if len(m.offset_evidence):
        sound = [mixture for mixture in map(_usable_mixture, m.offset_evidence) if mixture is not None]
        changes["offset_evidence"] = tuple(sound)
        if len(sound) < len(m.offset_evidence):
            counted.append("frame_offset")
    if m.wall_profiles is not None:
        is_usable = are_profiles(m.wall_profiles)
        changes["wall_profiles"] = np.array(m.wall_profiles, order="C") if is_usable else None
        if not is_usable:
            counted.append("frame_walls")
    for name in ("heading_lasting_std_rad", "heading_split_std_rad"):
        if getattr(m, name) != 0.0 and not 0.0 < getattr(m, name) < m.heading_std_rad:  # NaN fails too
            changes[name] = 0.0  # no part of the heading's sigma
    if m.accepted and abs(m.heading_rad) > pi:  # not so for NaN, which is rejected as unmeasured
        changes |= {"accepted": False, "reason": Reason.UNCERTAIN, "heading_rad": nan}
        counted.append("frame_heading")
    if not changes:
        return m, ()
    return replace(m, **changes), tuple(f"{name}_out_of_range" for name in dict.fromkeys(counted))


def _is_beyond(m: FrameMeasurement, bound: _Bound) -> bool:
    value, std = getattr(m, bound.value), getattr(m, bound.std) if bound.std else 0.0
    beyond: bool = abs(value) > bound.largest or value <= bound.smallest or std > bound.largest_std
    return beyond


def _usable_mixture(mixture: OffsetMixture) -> OffsetMixture | None:
    """Return a copy of a mixture as float64 arrays (k,); None if it cannot be used; widths may be NaN."""
    try:
        fields = np.array(
            [mixture.weight, mixture.offset_norm, mixture.std_norm, mixture.width_per_height], order="C"
        )
    except (AttributeError, TypeError, ValueError):  # no mixture, or fields of several lengths
        return None
    if fields.ndim != 2 or fields.dtype.kind not in "fiu":
        return None
    weight, offset, std, width = fields.astype(np.float64)
    within = (weight >= 0.0) & (abs(offset) <= MAX_OFFSET_NORM) & (std > 0.0) & (std <= MAX_OFFSET_STD)
    return OffsetMixture(weight, offset, std, width) if within.all() and isfinite(weight.sum()) else None
