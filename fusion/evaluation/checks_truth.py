"""Checks against what the flight really did, where that is known."""

from __future__ import annotations

from math import degrees
from typing import TYPE_CHECKING

from fusion.evaluation.errors import evaluate
from fusion.evaluation.verdict import Check, Level, Limits, level_of, not_judged, worst_of
from fusion.flight import Flight

if TYPE_CHECKING:
    from fusion.offline.fuse import FusionResult


def check_heading(result: FusionResult, flight: Flight, limits: Limits) -> Check:
    """Judge the filter's heading by its RMSE."""
    good, bad = (degrees(v) for v in limits.heading_rmse_rad)
    name, limit = "Heading against truth", f"pass to {good:g}°, fail above {bad:g}° RMSE"
    rmse = None if flight.truth is None else evaluate(result.estimates, flight.truth)["heading"]["rmse_rad"]
    if rmse is None:
        why = (
            "The flight has no truth." if flight.truth is None else "No row could be compared with the truth."
        )
        return not_judged(name, limit, why)
    level = level_of(rmse, limits.heading_rmse_rad)
    if level is Level.PASS:
        return Check(name, level, f"{degrees(rmse):.2f}° RMSE", limit, "Good enough to steer by.")
    meaning = "The heading is further off than steering in a corridor allows."
    return Check(
        name,
        level,
        f"{degrees(rmse):.2f}° RMSE",
        limit,
        meaning,
        "See the error plot for when it goes wrong.",
    )


def check_offset(result: FusionResult, flight: Flight, limits: Limits) -> Check:
    """Judge the filter's lateral offset by its RMSE, in metres where both sides have them."""
    name = "Offset against truth"
    good, bad = (100 * v for v in limits.offset_rmse_m)
    limit = f"pass to {good:g} cm, fail above {bad:g} cm RMSE"
    if flight.truth is None:
        return not_judged(name, limit, "The flight has no truth.")
    errors = evaluate(result.estimates, flight.truth)
    metres, norm = errors["lateral_offset_m"]["rmse_m"], errors["lateral_offset_norm"]["rmse_norm"]
    if metres is not None:
        level, value = level_of(metres, limits.offset_rmse_m), f"{100 * metres:.1f} cm RMSE"
    elif norm is not None:
        level, value = level_of(norm, limits.offset_rmse_norm), f"{norm:.1%} of half the width, RMSE"
        limit = f"pass to {limits.offset_rmse_norm[0]:.0%}, fail above {limits.offset_rmse_norm[1]:.0%}"
    else:
        return not_judged(name, limit, "No row could be compared with the truth.")
    if level is Level.PASS:
        return Check(name, level, value, limit, "Good enough to keep clear of the walls.")
    meaning = "The place between the walls is not known well enough to keep clear of them."
    return Check(
        name,
        level,
        value,
        limit,
        meaning,
        "See whether the wall edges in the pictures below are the right ones.",
    )


def check_sigma(result: FusionResult, flight: Flight, limits: Limits) -> Check:
    """Judge whether the heading's sigma can be believed."""
    good, bad = limits.truth_sigma_p90
    name = "Errors against their sigma"
    limit = (
        f"90th percentile: pass to {good:g}, fail above {bad:g}, ideal 1.64; "
        f"mean NEES: {limits.truth_nees[0]:g}, {limits.truth_nees[1]:g}, ideal 1"
    )
    if flight.truth is None:
        return not_judged(name, limit, "The flight has no truth.")
    heading = evaluate(result.estimates, flight.truth)["heading"]
    p90 = heading["error_over_sigma_p90"]
    if p90 is None:
        return not_judged(name, limit, "No row could be compared with the truth.")
    # A few gross errors leave the percentile as it is, but not the mean.
    level = worst_of(level_of(p90, limits.truth_sigma_p90), level_of(heading["nees_mean"], limits.truth_nees))
    value = f"{p90:.2f} sigma, mean NEES {heading['nees_mean']:.2f}"
    if level is Level.PASS:
        return Check(name, level, value, limit, "The two-sigma band can be believed.")
    meaning = "The true heading lies outside the band more often than it should."
    return Check(
        name, level, value, limit, meaning, "Widen the band when using it, or raise the noises it comes from."
    )
