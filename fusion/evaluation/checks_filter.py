"""Checks of the filter: agreement of frames with its prediction, and time without frames."""

from __future__ import annotations

from math import degrees, isfinite

import numpy as np

from fusion.estimator.tables import Table
from fusion.evaluation.verdict import CheckRule, Finding, Limits, level_of, nothing_to_judge, worst_of
from fusion.flight import Flight, FloatArray
from fusion.result.result import FusionResult
from fusion.result.summary import Level
from fusion.result.table_rows import held_back_at_junctions, runs

MIN_COMPARED_FRAMES = 10  # for a meaningful median


def _share_over_gate(result: FusionResult, flight: Flight, limits: Limits) -> Finding:
    ratio = _test_ratios(result)
    if not ratio.size:
        return nothing_to_judge("No frame was compared with the filter.")
    share = float(np.mean(ratio > 1.0))
    return Finding(f"{share:.1%} of {ratio.size}", share)


def _test_ratios(result: FusionResult) -> FloatArray:
    """Return the test ratios of frames compared with their own corridor's axis."""
    ratio = result.frames["test_ratio"]
    own: FloatArray = ratio[np.isfinite(ratio) & ~held_back_at_junctions(result.estimates, result.frames)]
    return own


INNOVATIONS_OVER_GATE = CheckRule(
    name="Innovations over the gate",
    measure=_share_over_gate,
    pass_fail=lambda limits: limits.over_gate_share,
    limit=lambda limits: (
        f"pass to {limits.over_gate_share[0]:.0%}, fail above {limits.over_gate_share[1]:.0%}"
    ),
    good="Frames and prediction agree.",
    bad="Frames often disagree with the prediction: one of the two is wrong.",
    remedy="Check the focal length, the camera mounting and the time offset, then gyro_noise_density.",
)


def _longest_coast(result: FusionResult, flight: Flight, limits: Limits) -> Finding:
    table = result.estimates
    tracking = np.flatnonzero(table["status"] == "tracking")
    if not tracking.size:
        return Finding(
            "Never tracking",
            level=Level.FAIL,
            meaning="The filter was never initialised.",
            action="Look at the rejected frames below for the cause.",
        )
    age = table["vision_age_s"][tracking[0] :]
    longest = float(np.nanmax(age)) if np.isfinite(age).any() else float("nan")
    level = level_of(longest, limits.coast_s)
    when = (table["timestamp_ns"][tracking[0] + int(np.nanargmax(age))] - table["timestamp_ns"][0]) / 1e9
    lost = _seconds_in(table, "lost")
    text = f"{longest:.1f} s, ending at {when:.1f} s" if level is not Level.PASS else f"{longest:.1f} s"
    if lost > 0:
        text += f"; lost for {lost:.1f} s"
        level = worst_of(level, Level.WARN)
    return Finding(text, longest, level=level)


def _seconds_in(table: Table, status: str) -> float:
    t = table["timestamp_ns"]
    spans = runs(table["status"] == status)
    return float(sum(t[min(b, len(t) - 1)] - t[a] for a, b in spans)) / 1e9


LONGEST_COAST = CheckRule(
    name="Longest time without a used frame",
    measure=_longest_coast,
    limit=lambda limits: f"pass to {limits.coast_s[0]:g} s, fail above {limits.coast_s[1]:g} s",
    good="There was no long time without a used frame.",
    bad="During this time the heading comes from the inertial sensors alone, and its sigma grows.",
    remedy="Look at the frames at that time. Fly slower there, or add light.",
)


def _across_the_corridor(result: FusionResult, flight: Flight, limits: Limits) -> Finding:
    table = result.estimates
    tracking = table["status"] == "tracking"
    if not np.any(tracking):
        return nothing_to_judge("The filter never tracked.")
    across = tracking & (np.abs(table["heading_rad"]) > limits.across_rad)
    t = table["timestamp_ns"]
    spans = [(float(t[min(b, len(t) - 1)] - t[a]) / 1e9, a) for a, b in runs(across)]
    longest, start = max(spans, default=(0.0, 0))
    if longest < limits.across_s:
        return Finding(f"Across it for at most {longest:.1f} s", longest, level=Level.PASS)
    text = f"Across it for {longest:.1f} s from {(t[start] - t[0]) / 1e9:.1f} s"
    return Finding(text, longest, level=Level.WARN)


ALONG_THE_CORRIDOR = CheckRule(
    name="Flying along the corridor",
    measure=_across_the_corridor,
    limit=lambda limits: (
        f"warn from {limits.across_s:g} s turned by more than {degrees(limits.across_rad):g}°"
    ),
    good="The vehicle flies along the estimated axis.",
    bad="The vehicle may have entered another corridor without the filter noticing it.",
    remedy="Look at the frames at that time: in which direction do their lines run?",
)


def _share_with_offset(result: FusionResult, flight: Flight, limits: Limits) -> Finding:
    table = result.estimates
    tracking = table["status"] == "tracking"
    if not tracking.any():
        return nothing_to_judge("The filter never tracked.")
    known = np.nan_to_num(table["lateral_offset_norm_std"][tracking], nan=np.inf) < limits.offset_known_norm
    share = float(np.mean(known))
    level = Level.PASS if share >= limits.offset_known_share else Level.WARN
    return Finding(f"{share:.0%} of the time", share, level=level)


OFFSET_KNOWN = CheckRule(
    name="Offset known",
    measure=_share_with_offset,
    limit=lambda limits: (
        f"pass from {limits.offset_known_share:.0%} of the time, "
        f"sigma under {limits.offset_known_norm:.0%} of half the width"
    ),
    good="The edges of the walls were visible often enough.",
    bad="The edges of the walls were visible too rarely to track the offset. The heading does not need them.",
    remedy="Do not control by the offset where its band is wide. A lower view shows more of the floor's edges.",
)


def _innovations_over_sigma(result: FusionResult, flight: Flight, limits: Limits) -> Finding:
    ratio = innovation_ratio(result)
    if not isfinite(ratio):
        return nothing_to_judge("Too few frames were compared with the filter.")
    return Finding(f"{ratio:.2f} times", ratio)


def innovation_ratio(result: FusionResult) -> float:
    """Robust ratio of the innovations to their predicted sigma; 1 if the filter is consistent.

    The test ratio is the innovation's square over the gate's; unlike the root mean square,
    the median of the normalised innovation does not depend on the gate.
    """
    ratio = _test_ratios(result)
    if ratio.size < MIN_COMPARED_FRAMES:
        return float("nan")
    return float(np.median(np.sqrt(ratio)) * result.config.heading_gate_sigma / 0.6745)


INNOVATIONS_OVER_SIGMA = CheckRule(
    name="Innovations against their sigma",
    measure=_innovations_over_sigma,
    pass_fail=lambda limits: limits.innovation_ratio,
    limit=lambda limits: (
        f"pass to {limits.innovation_ratio[0]:g} times, fail above {limits.innovation_ratio[1]:g}"
    ),
    # Well below one is normal: a frame's sigma is inflated for its correlation with the last one.
    good="Frames differ from the prediction by no more than expected from their sigma.",
    bad="The filter is overconfident: its two-sigma band is too narrow.",
    remedy="Check the camera's time offset, then increase gyro_noise_density.",
)
