"""The corridor's width in metres from a range sensor that looks down, one robust step after another.

A frame tells the corridor's width per height of the camera above the floor; the sensor tells that height. Their
product is the same along a whole corridor, whatever the height, and that is what makes it robust: single wrong
readings go in the median of the last few heights, a table or a step below in the median of the widths of several
seconds, and where the widths do not agree with one another there is no width at all.

All values are immutable; each function returns a new one.
"""

from __future__ import annotations

from math import isfinite, nan
from statistics import median
from typing import NamedTuple

MAX_DISTANCE_M = 100.0
MIN_DOWN = 0.7  # cosine of the tilt; further over, the beam may well meet a wall
HEIGHTS = 5
HEIGHT_AGE_S = 0.3  # of the readings that make a height; a vehicle climbs 0.3 m in that time at most
WIDTH_STEP_S = 0.1
WIDTHS = 61  # of WIDTH_STEP_S and more apart: 6 s, of which an obstacle below may last less than half
MIN_WIDTHS = 8
AGREEING_SPREAD = 0.25  # between the quartiles of the widths, over their median
WIDTH_M = (0.4, 50.0)


class Heights(NamedTuple):
    """The last readings: times and heights above the floor, oldest first."""

    t_ns: tuple[int, ...] = ()
    height_m: tuple[float, ...] = ()


class Widths(NamedTuple):
    """Widths that the last frames gave, oldest first, and what is made of them; NaN while it is nothing."""

    t_ns: int | None = None
    recent_m: tuple[float, ...] = ()
    width_m: float = nan


def with_range(heights: Heights, t_ns: int, distance_m: float, down_z: float) -> Heights:
    """Take a distance along the body's z.

    Parameters
    ----------
    heights
        Those so far.
    t_ns, distance_m
        When it was measured, and the distance to the floor.
    down_z
        z of gravity's direction in the body, which is cos(roll) cos(pitch).
    """
    if down_z < MIN_DOWN:
        return heights
    return Heights((*heights.t_ns, t_ns)[-HEIGHTS:], (*heights.height_m, distance_m * down_z)[-HEIGHTS:])


def height_at(heights: Heights, t_ns: int) -> float:
    """Height above the floor, metres; NaN where the last reading is too old."""
    oldest_ns = t_ns - round(HEIGHT_AGE_S * 1e9)
    fresh = [h for then_ns, h in zip(heights.t_ns, heights.height_m, strict=True) if then_ns >= oldest_ns]
    return median(fresh) if fresh else nan


def with_width(widths: Widths, t_ns: int, width_m: float) -> Widths:
    """Take the width that a frame and the height at its time give."""
    if not WIDTH_M[0] < width_m < WIDTH_M[1]:  # NaN fails too
        return widths
    if widths.t_ns is not None and t_ns - widths.t_ns < round(WIDTH_STEP_S * 1e9):
        return widths
    recent = (*widths.recent_m, width_m)[-WIDTHS:]
    return Widths(t_ns, recent, _agreed(recent))


def _agreed(recent_m: tuple[float, ...]) -> float:
    """Return the median of widths that agree; NaN for too few or others."""
    n = len(recent_m)
    if n < MIN_WIDTHS:
        return nan
    ordered = sorted(recent_m)
    middle = median(ordered)
    spread = ordered[(3 * n) // 4] - ordered[n // 4]
    return middle if isfinite(middle) and spread <= AGREEING_SPREAD * middle else nan
