"""The checks on a fused flight, one per thing that goes wrong, each with what it means and what to do."""

from __future__ import annotations

from collections.abc import Callable
from math import degrees
from typing import TYPE_CHECKING

import numpy as np

from fusion.estimator.tables import Table
from fusion.evaluation.checks_frames import check_camera_time, check_frames_used, check_rejections
from fusion.evaluation.checks_input import (
    check_gaps,
    check_gyro_bias,
    check_imu_yaw,
    check_rates,
    check_reading,
)
from fusion.evaluation.checks_truth import check_heading, check_offset, check_sigma
from fusion.evaluation.verdict import Check, Level, Limits, level_of, not_judged, worst_of
from fusion.flight import Flight
from fusion.report.series import runs

if TYPE_CHECKING:
    from fusion.offline.fuse import FusionResult


def run_checks(result: FusionResult, flight: Flight, limits: Limits | None = None) -> tuple[Check, ...]:
    """Run every check on a fused flight, in the order in which a reader should look at them."""
    limits = limits or Limits()
    checks: tuple[Callable[[FusionResult, Flight, Limits], Check], ...] = (
        check_heading,
        check_offset,
        check_frames_used,
        check_rejections,
        _innovations,
        _longest_coast,
        _along_the_corridor,
        _offset_known,
        _sigma_by_innovations,
        check_sigma,
        check_camera_time,
        check_gyro_bias,
        check_imu_yaw,
        check_rates,
        check_gaps,
        check_reading,
    )
    return tuple(check(result, flight, limits) for check in checks)


def _innovations(result: FusionResult, flight: Flight, limits: Limits) -> Check:
    name = "Innovations over the gate"
    limit = f"pass to {limits.over_gate_share[0]:.0%}, fail above {limits.over_gate_share[1]:.0%}"
    ratio = result.frames["test_ratio"]
    ratio = ratio[np.isfinite(ratio)]
    if not ratio.size:
        return not_judged(name, limit, "No frame was compared with the filter.")
    share = float(np.mean(ratio > 1.0))
    level = level_of(share, limits.over_gate_share)
    if level is Level.PASS:
        meaning, action = "Frames and prediction tell the same story.", ""
    else:
        meaning = "Frames often contradict the prediction, so one of the two is wrong."
        action = (
            "Check focal length, camera mounting and time offset; then the gyro noise in the configuration."
        )
    return Check(name, level, f"{share:.1%} of {ratio.size}", limit, meaning, action)


def _longest_coast(result: FusionResult, flight: Flight, limits: Limits) -> Check:
    name = "Longest time without a used frame"
    limit = f"pass to {limits.coast_s[0]:g} s, fail above {limits.coast_s[1]:g} s"
    table = result.estimates
    tracking = np.flatnonzero(table["status"] == "tracking")
    if not tracking.size:
        meaning, action = "The filter never started.", "Look at the rejected frames below for the cause."
        return Check(name, Level.FAIL, "Never tracking", limit, meaning, action)
    age = table["vision_age_s"][tracking[0] :]
    longest = float(np.nanmax(age)) if np.isfinite(age).any() else float("nan")
    level = level_of(longest, limits.coast_s)
    when = (table["timestamp_ns"][tracking[0] + int(np.nanargmax(age))] - table["timestamp_ns"][0]) / 1e9
    lost = _seconds_in(table, "lost")
    value = f"{longest:.1f} s, ending at {when:.1f} s" if level is not Level.PASS else f"{longest:.1f} s"
    if lost > 0:
        value += f"; lost for {lost:.1f} s"
        level = worst_of(level, Level.WARN)
    if level is Level.PASS:
        return Check(name, level, value, limit, "Vision was never away for long.")
    meaning = "Meanwhile the heading rests on inertial sensors alone and its sigma grows."
    return Check(
        name, level, value, limit, meaning, "See the frames at that time; fly slower or add light there."
    )


def _along_the_corridor(result: FusionResult, flight: Flight, limits: Limits) -> Check:
    turned, least_s = degrees(limits.across_rad), limits.across_s
    name, limit = "Flying along the corridor", f"warn from {least_s:g} s turned by more than {turned:g}°"
    table = result.estimates
    across = (table["status"] == "tracking") & (np.abs(table["heading_rad"]) > limits.across_rad)
    if not np.any(table["status"] == "tracking"):
        return not_judged(name, limit, "The filter never tracked.")
    t = table["timestamp_ns"]
    spans = [(float(t[min(b, len(t) - 1)] - t[a]) / 1e9, a) for a, b in runs(across)]
    longest, start = max(spans, default=(0.0, 0))
    if longest < least_s:
        return Check(
            name, Level.PASS, f"Across it for {longest:.1f} s at most", limit, "The axis is the right one."
        )
    value = f"Across it for {longest:.1f} s from {(t[start] - t[0]) / 1e9:.1f} s"
    meaning = "The vehicle may have entered another corridor unnoticed, and steers by the old one's axis."
    return Check(
        name,
        Level.WARN,
        value,
        limit,
        meaning,
        "Look at the frames of that time: which way do their lines run?",
    )


def _offset_known(result: FusionResult, flight: Flight, limits: Limits) -> Check:
    name = "Offset known"
    limit = (
        f"pass from {limits.offset_known_share:.0%} of the time, "
        f"sigma under {limits.offset_known_norm:.0%} of half the width"
    )
    table = result.estimates
    tracking = table["status"] == "tracking"
    if not tracking.any():
        return not_judged(name, limit, "The filter never tracked.")
    known = np.nan_to_num(table["lateral_offset_norm_std"][tracking], nan=np.inf) < limits.offset_known_norm
    share = float(np.mean(known))
    if share >= limits.offset_known_share:
        return Check(
            name,
            Level.PASS,
            f"{share:.0%} of the time",
            limit,
            "The edges of the walls were seen often enough.",
        )
    meaning = (
        "The edges of the walls were seen too seldom to hold the offset; the heading does not need them."
    )
    action = (
        "Do not steer by the offset where its band is wide; a lower view shows more of the floor's edges."
    )
    return Check(name, Level.WARN, f"{share:.0%} of the time", limit, meaning, action)


def _seconds_in(table: Table, status: str) -> float:
    t = table["timestamp_ns"]
    spans = runs(table["status"] == status)
    return float(sum(t[min(b, len(t) - 1)] - t[a] for a, b in spans)) / 1e9


def _sigma_by_innovations(result: FusionResult, flight: Flight, limits: Limits) -> Check:
    good, bad = limits.innovation_ratio
    name, limit = "Innovations against their sigma", f"pass to {good:g} times, fail above {bad:g}"
    ratio = innovation_ratio(result)
    level = level_of(ratio, limits.innovation_ratio)
    if level is Level.NOT_JUDGED:
        return not_judged(name, limit, "Too few frames were compared with the filter.")
    value = f"{ratio:.2f} times"
    if level is Level.PASS:
        # Well below one is as it should be: a frame's sigma is widened for what it shares with the last one.
        return Check(name, level, value, limit, "Frames differ from the prediction by no more than expected.")
    meaning = "The filter is surer of itself than its frames warrant: its two-sigma band is too narrow."
    action = "Check the camera's time offset, then raise the gyro noise in the configuration."
    return Check(name, level, value, limit, meaning, action)


def innovation_ratio(result: FusionResult) -> float:
    """Robust ratio of innovations to the sigma that the filter expected of them; 1 where it is honest.

    The test ratio is the innovation's square over the gate's; the median of the normalised innovation, unlike
    its root mean square, does not depend on where the gate cuts.
    """
    ratio = result.frames["test_ratio"]
    ratio = ratio[np.isfinite(ratio)]
    if ratio.size < 10:
        return float("nan")
    return float(np.median(np.sqrt(ratio)) * gate_sigmas(result) / 0.6745)


def gate_sigmas(result: FusionResult) -> float:
    """How many sigmas wide the gate of the frames' yaw is."""
    return float(result.config.heading_gate_sigma)
