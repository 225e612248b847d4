"""Cause of a disagreement between frames and inertial sensors, and the setting that corrects it.

The other checks detect the disagreement. This one compares the turns in the frames, used or not, with those of the
gyroscope: their sign, timing and size.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fusion.alignment import turns_of_frames
from fusion.alignment.clock import ClockFit
from fusion.alignment.opposite import opposite_remedy
from fusion.alignment.skew import SkewedClock
from fusion.evaluation.checks_filter import INNOVATIONS_OVER_GATE, INNOVATIONS_OVER_SIGMA
from fusion.evaluation.checks_frames import CAMERA_TIME, FRAMES_USED, REJECTIONS
from fusion.evaluation.checks_input import GYRO_BIAS
from fusion.evaluation.checks_truth import HEADING_ERROR
from fusion.evaluation.verdict import worst_of
from fusion.flight import Flight
from fusion.logs.csv.column_map import ColumnMap
from fusion.logs.manifest.manifest import Manifest
from fusion.logs.manifest.sources import ManifestLog
from fusion.logs.units import is_counts, unit_of_size
from fusion.result.result import FusionResult
from fusion.result.summary import Check, Level
from vision import InputError

NAME = "Likely cause"
SYMPTOMS = frozenset(
    rule.name
    for rule in (
        HEADING_ERROR,
        FRAMES_USED,
        REJECTIONS,
        INNOVATIONS_OVER_GATE,
        INNOVATIONS_OVER_SIGMA,
        CAMERA_TIME,
    )
)
LIMIT = "looked for where frames and inertial sensors do not fit"
MIN_OFFSET_S = 0.02
SCALE_DIFFERS = 0.1
LENS_SCALES = (0.6, 1.6)  # plausible errors of a focal length; beyond them the gyroscope's scale is wrong
SURE_SIGMA = 5.0
_MEASURED = ("ok", "gate")  # reasons of frames with a heading
_NO_GYROSCOPE = (
    "no gyroscope",
    "Between pictures, the heading comes from the IMU's yaw, with all of its jumps.",
    "Log the gyroscope.",
)


def likely_cause(result: FusionResult, flight: Flight, checks: Sequence[Check]) -> Check | None:
    """Return the cause of other checks' findings, as a check; None if nothing is wrong or no cause is found.

    Parameters
    ----------
    result, flight
        Result of `fusion.fuse_flight`, and its flight.
    checks
        The other checks.
    """
    levels = [check.level for check in checks if check.name in SYMPTOMS]
    if worst_of(Level.NOT_JUDGED, *levels) not in (Level.WARN, Level.FAIL):
        return None
    # The bias absorbs the disagreement; its check must not precede the cause.
    level = worst_of(*levels, *(check.level for check in checks if check.name == GYRO_BIAS.name))
    frames, delay_s = result.frames, result.config.camera_delay_s
    measured = np.isin(frames["reason"], _MEASURED)
    try:
        clock = turns_of_frames(
            flight,
            frames["timestamp_ns"] - round(delay_s * 1e9),
            np.where(measured, frames["heading_rad"], np.nan),
            frames["heading_std_rad"],
        )
    except InputError:
        return None
    cause: tuple[str, str, str] | None = None
    found = clock.search
    if found.reversed:
        cause = _opposite(flight)
    elif found.fit is not None and found.rival_s is None and not found.at_edge:
        cause = _skewed(clock, flight) or _late(found.fit, delay_s) or _scaled(found.fit, flight)
    if cause is None and flight.imu is None and _contradicted(checks):
        cause = _NO_GYROSCOPE
    if cause is None:
        return None
    value, meaning, action = cause
    return Check(NAME, level, value, LIMIT, meaning, action)


def _contradicted(checks: Sequence[Check]) -> bool:
    return any(check.name == INNOVATIONS_OVER_GATE.name and check.level is not Level.PASS for check in checks)


def _opposite(flight: Flight) -> tuple[str, str, str]:
    source = "gyroscope" if flight.imu is not None else "attitude"
    return (
        "turns are opposite",
        f"Vision and the {source} show turns in opposite directions.",
        opposite_remedy(flight),
    )


def _skewed(clock: SkewedClock, flight: Flight) -> tuple[str, str, str] | None:
    if not clock.skew or clock.search.fit is None:
        return None
    way, percent = "slower" if clock.skew > 0.0 else "faster", 100.0 * abs(clock.skew)
    offset_s = clock.search.fit.offset_s
    before = flight.manifest.camera.clock_rate if isinstance(flight.manifest, Manifest) else 1.0
    return (
        f"frames' clock {percent:.2f} ± {100.0 * clock.skew_std:.2f} % {way}",
        "The clocks of camera and inertial sensors run at different rates, which no offset corrects.",
        f"Set clock_rate = {before * (1.0 + clock.skew):.5f} for [camera] in flight.toml and add {offset_s:.3f} to "
        "its clock_offset_s, or run `corridor align --write`.",
    )


def _late(fit: ClockFit, delay_s: float) -> tuple[str, str, str] | None:
    offset_s, std_s = fit.offset_s, fit.offset_std_s
    if abs(offset_s) < max(MIN_OFFSET_S, SURE_SIGMA * std_s):
        return None
    way = "early" if offset_s > 0 else "late"
    value = f"frames {1e3 * abs(offset_s):.0f} ± {1e3 * std_s:.0f} ms too {way}"
    meaning = "The pictures show turns at other times than the inertial sensors."
    if delay_s:
        right_s = round(delay_s - offset_s, 3) + 0.0
        return value, meaning, f"Set camera_delay_s = {right_s:g} instead of {delay_s:g}."
    action = (
        f"Add {offset_s:.3f} to clock_offset_s for [camera] in flight.toml, or run `corridor align --write`."
    )
    return value, meaning, action


def _scaled(fit: ClockFit, flight: Flight) -> tuple[str, str, str] | None:
    if abs(fit.ratio - 1.0) < max(SCALE_DIFFERS, SURE_SIGMA * fit.ratio_std):
        return None
    value = f"pictures turn {fit.ratio:.2f} times as much as the gyroscope"
    columns = flight.manifest.imu.columns if isinstance(flight.manifest, Manifest) else None
    # The scale of the counts was guessed, but the lens was calibrated.
    in_counts = isinstance(columns, ColumnMap) and is_counts(columns.gyro_unit)
    if LENS_SCALES[0] < fit.ratio < LENS_SCALES[1] and not in_counts:
        return (
            value,
            "The calibration's focal length does not fit these pictures.",
            "Run `corridor align --write` on the flight: it estimates focal_scale for [camera].",
        )
    return (
        value,
        "The gyroscope has another unit than assumed, or other axes.",
        _unit_remedy(fit.ratio, flight),
    )


def _unit_remedy(ratio: float, flight: Flight) -> str:
    """Name the unit with which the gyroscope agrees with the pictures."""
    if not isinstance(flight.manifest, Manifest):
        return f"Multiply the gyroscope by {ratio:.4g}."
    advice = ManifestLog(flight.manifest).advice()
    unit, _ = unit_of_size(ratio * advice.taken.get("gyro_unit", 1.0), "deg/s")
    remedy = advice.unit("imu", "gyro_unit", unit, f"{ratio:.4g}")
    return remedy[0].upper() + remedy[1:] + "."
