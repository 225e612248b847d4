"""Checks against ground truth, if there is one."""

from __future__ import annotations

from math import degrees

from fusion.evaluation.errors import evaluate
from fusion.evaluation.verdict import CheckRule, Finding, Limits, level_of, nothing_to_judge, worst_of
from fusion.flight import Flight
from fusion.result.result import FusionResult

_NO_TRUTH = "The flight has no truth."
_NOTHING_COMPARED = "No row could be compared with the truth."


def _heading_rmse(result: FusionResult, flight: Flight, limits: Limits) -> Finding:
    if flight.truth is None:
        return nothing_to_judge(_NO_TRUTH)
    rmse = evaluate(result.estimates, flight.truth).heading.rmse
    if rmse is None:
        return nothing_to_judge(_NOTHING_COMPARED)
    return Finding(f"{degrees(rmse):.2f}° RMSE", rmse)


def _heading_limit(limits: Limits) -> str:
    good, bad = (degrees(v) for v in limits.heading_rmse_rad)
    return f"pass to {good:g}°, fail above {bad:g}° RMSE"


HEADING_ERROR = CheckRule(
    name="Heading against truth",
    measure=_heading_rmse,
    pass_fail=lambda limits: limits.heading_rmse_rad,
    limit=_heading_limit,
    good="Accurate enough for control.",
    bad="The heading error is too large for control in a corridor.",
    remedy="See in the error plot when it occurs.",
)


def _offset_rmse(result: FusionResult, flight: Flight, limits: Limits) -> Finding:
    """In metres if both have them."""
    if flight.truth is None:
        return nothing_to_judge(_NO_TRUTH)
    errors = evaluate(result.estimates, flight.truth)
    metres = None if errors.lateral_offset_m is None else errors.lateral_offset_m.rmse
    norm = None if errors.lateral_offset_norm is None else errors.lateral_offset_norm.rmse
    if metres is not None:
        return Finding(f"{100 * metres:.1f} cm RMSE", metres)
    if norm is None:
        return nothing_to_judge(_NOTHING_COMPARED)
    good, bad = limits.offset_rmse_norm
    return Finding(
        f"{norm:.1%} of half the width, RMSE",
        norm,
        level=level_of(norm, limits.offset_rmse_norm),
        limit=f"pass to {good:.0%}, fail above {bad:.0%}",
    )


def _offset_limit(limits: Limits) -> str:
    good, bad = (100 * v for v in limits.offset_rmse_m)
    return f"pass to {good:g} cm, fail above {bad:g} cm RMSE"


OFFSET_ERROR = CheckRule(
    name="Offset against truth",
    measure=_offset_rmse,
    pass_fail=lambda limits: limits.offset_rmse_m,
    limit=_offset_limit,
    good="Accurate enough to keep clear of the walls.",
    bad="The offset is not accurate enough to keep clear of the walls.",
    remedy="Check whether the yellow lines in the pictures below are on both walls, at the same height.",
)


def _errors_over_sigma(result: FusionResult, flight: Flight, limits: Limits) -> Finding:
    if flight.truth is None:
        return nothing_to_judge(_NO_TRUTH)
    heading = evaluate(result.estimates, flight.truth).heading
    p90, nees = heading.error_over_sigma_p90, heading.nees_mean
    if p90 is None or nees is None:
        return nothing_to_judge(_NOTHING_COMPARED)
    # A few gross errors change the mean, but not the percentile.
    level = worst_of(level_of(p90, limits.truth_sigma_p90), level_of(nees, limits.truth_nees))
    return Finding(f"{p90:.2f} sigma, mean NEES {nees:.2f}", p90, level=level)


ERRORS_OVER_SIGMA = CheckRule(
    name="Errors against their sigma",
    measure=_errors_over_sigma,
    limit=lambda limits: (
        f"90th percentile: pass to {limits.truth_sigma_p90[0]:g}, fail above {limits.truth_sigma_p90[1]:g}, "
        f"ideal 1.64; mean NEES: {limits.truth_nees[0]:g}, {limits.truth_nees[1]:g}, ideal 1"
    ),
    good="The filter is consistent: the two-sigma band holds.",
    bad="The true heading is outside the two-sigma band more often than it should be.",
    remedy="Use a wider band, or increase the noise densities in the configuration.",
)
