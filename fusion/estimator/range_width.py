"""The corridor's width in metres, from distances to the floor and the frames' width per height.

A frame measures the corridor's width per height of the camera above the floor. A downward range sensor measures that
height as ``h = d cos(roll) cos(pitch)``. Their product is constant along a corridor at any height. Medians reject
outliers: of the last `HEIGHTS` heights for single wrong readings, and of the last `WIDTHS` widths for a table or a
step below. There is no width if the interquartile range of the widths exceeds `AGREEING_SPREAD` of the median, or if
the newest ones are larger than it: the vehicle has probably left a table, over which it started. Widths below
`WIDTH_M` are those of a table close below, or of a sensor that is stuck at its minimum; they are not used, and
reported if they last.
"""

from __future__ import annotations

from math import isfinite, nan
from statistics import median
from typing import NamedTuple

from fusion.estimator.config import FusionConfig
from fusion.estimator.faults import Fault, Notice
from fusion.estimator.sample_times import SampleTimes

MAX_DISTANCE_M = 100.0
MIN_DOWN = 0.7  # cosine of the tilt; at larger tilts the beam may hit a wall
HEIGHTS = 5
HEIGHT_AGE_S = 0.3  # oldest reading used; a vehicle climbs at most 0.3 m in that time
WIDTH_STEP_S = 0.1
WIDTHS = 61  # at least WIDTH_STEP_S apart: 6 s; an obstacle below must last for less than half of that
MIN_WIDTHS = 8
AGREEING_SPREAD = 0.25  # largest interquartile range of the widths, over their median
WIDTH_M = (
    1.0,
    50.0,
)  # the lower bound is 4 sigma from `fusion.estimator.lateral.gaussian_sum`'s prior on half widths
GROWN = 1.125  # newest widths over the median; an object below the vehicle only shortens the range
WIDTH_MEMORY_FRAMES = 100


class RangeSample(NamedTuple):
    """A distance to the floor, metres along the body's z, from the camera's position."""

    t_ns: int
    distance_m: float

    def fault(self) -> str:
        """Return the reason why it cannot be used; empty if it can."""
        if self.distance_m > MAX_DISTANCE_M:
            return "range_out_of_range"
        return "" if self.distance_m > 0.0 else "range_not_positive"  # NaN fails too


class Heights(NamedTuple):
    """The last readings: times and heights above the floor, oldest first."""

    t_ns: tuple[int, ...] = ()
    height_m: tuple[float, ...] = ()


class Widths(NamedTuple):
    """Widths from the last frames, oldest first, and the estimated width; NaN while unknown.

    ``narrow_m`` are those below `WIDTH_M` since the last one within.
    """

    t_ns: int | None = None
    recent_m: tuple[float, ...] = ()
    width_m: float = nan
    narrow_m: tuple[float, ...] = ()


class Width(NamedTuple):
    """Estimate of the corridor's width.

    Parameters
    ----------
    times
        Times of the ranges.
    heights, widths
        Heights from the last ranges, and widths from the frames in this corridor.
    per_height, n_frames
        Mean width per height of the camera above the floor, and the number of frames in it.
    set_width_m
        Width set by the caller in flight: 0 for unknown, None if it was not set.
    """

    times: SampleTimes = SampleTimes()
    heights: Heights = Heights()
    widths: Widths = Widths()
    per_height: float = nan
    n_frames: int = 0
    set_width_m: float | None = None

    def with_set_width(self, width_m: float | None) -> Width:
        """Set the width in place of the configured one; None: unknown."""
        return self._replace(set_width_m=0.0 if width_m is None else width_m)

    def half_m(self, config: FusionConfig) -> float:
        """Return half the corridor's width, metres; NaN if neither it nor the camera's height is set or measured."""
        set_width_m = config.corridor_width_m if self.set_width_m is None else self.set_width_m
        if set_width_m:
            return 0.5 * set_width_m
        if config.camera_height_m is not None:
            return 0.5 * config.camera_height_m * self.per_height
        return 0.5 * self.widths.width_m

    def with_range(self, sample: RangeSample, down_z: float) -> Width:
        """Add a range; ``down_z`` is cos(roll) cos(pitch)."""
        heights = with_range(self.heights, sample.t_ns, sample.distance_m, down_z)
        return self._replace(times=self.times.with_sample(sample.t_ns), heights=heights)

    def with_frame(self, t_ns: int, per_height: float) -> Width:
        """Add a frame's width per height; NaN if it was not measured."""
        if not (isfinite(per_height) and per_height > 0.0):
            return self
        n = min(self.n_frames + 1, WIDTH_MEMORY_FRAMES)
        old = self.per_height if n > 1 else per_height
        change = max(-0.2 * old, min(0.2 * old, per_height - old))
        widths = with_width(self.widths, t_ns, per_height * height_at(self.heights, t_ns))
        return self._replace(n_frames=n, per_height=old + change / n, widths=widths)

    def corridor_changed(self) -> Width:
        """Forget the width; keep the heights."""
        return self._replace(per_height=nan, n_frames=0, widths=Widths())

    def clock_set_back(self) -> Width:
        """Forget the heights, and the times of ranges and widths."""
        widths = self.widths._replace(t_ns=None)
        return self._replace(times=self.times.clock_set_back(), heights=Heights(), widths=widths)

    def notice(self, config: FusionConfig) -> Notice | None:
        """Report widths that are too small, if the width is taken from the range sensor."""
        set_width_m = config.corridor_width_m if self.set_width_m is None else self.set_width_m
        narrow_m = self.widths.narrow_m
        if set_width_m or config.camera_height_m is not None or len(narrow_m) < MIN_WIDTHS:
            return None
        text = f"range sensor sees no floor, or the corridor is only {median(narrow_m):.2f} m wide: set its width"
        return Notice(Fault.RANGE_TOO_SHORT, text)

    def silence(self, t_ns: int, config: FusionConfig) -> str:
        """Report a range sensor that has fallen silent; empty if it has not."""
        return "range sensor is silent" if self.times.is_silent(t_ns, config) else ""


def with_range(heights: Heights, t_ns: int, distance_m: float, down_z: float) -> Heights:
    """Add a distance along the body's z.

    Parameters
    ----------
    heights
        Heights so far.
    t_ns, distance_m
        Time of the measurement, and the distance to the floor.
    down_z
        z of gravity's direction in the body: cos(roll) cos(pitch).
    """
    if down_z < MIN_DOWN:
        return heights
    return Heights((*heights.t_ns, t_ns)[-HEIGHTS:], (*heights.height_m, distance_m * down_z)[-HEIGHTS:])


def height_at(heights: Heights, t_ns: int) -> float:
    """Return the height above the floor, metres; NaN if the last reading is too old."""
    oldest_ns = t_ns - round(HEIGHT_AGE_S * 1e9)
    fresh = [h for then_ns, h in zip(heights.t_ns, heights.height_m, strict=True) if then_ns >= oldest_ns]
    return median(fresh) if fresh else nan


def with_width(widths: Widths, t_ns: int, width_m: float) -> Widths:
    """Add a width, the product of a frame's width per height and the height at its time."""
    if not 0.0 < width_m < WIDTH_M[1]:  # NaN fails too
        return widths
    if widths.t_ns is not None and t_ns - widths.t_ns < round(WIDTH_STEP_S * 1e9):
        return widths
    if width_m < WIDTH_M[0]:
        return widths._replace(t_ns=t_ns, narrow_m=(*widths.narrow_m, width_m)[-MIN_WIDTHS:])
    recent = (*widths.recent_m, width_m)[-WIDTHS:]
    return Widths(t_ns, recent, _agreed(recent))


def _agreed(recent_m: tuple[float, ...]) -> float:
    """Return the median of the widths; NaN if they are too few, do not agree or have grown."""
    n = len(recent_m)
    if n < MIN_WIDTHS:
        return nan
    ordered = sorted(recent_m)
    middle = median(ordered)
    if median(recent_m[-MIN_WIDTHS:]) > GROWN * middle:
        return nan
    spread = ordered[(3 * n) // 4] - ordered[n // 4]
    return middle if isfinite(middle) and spread <= AGREEING_SPREAD * middle else nan
