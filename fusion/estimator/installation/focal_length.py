"""Error of the camera's focal length, estimated from the frames' headings and the gyroscope's angle.

If the configured focal length is too short by a part e, the tangent of each heading h is measured too large by e, and
h by e sin(2 h) / 2. So e is the slope of the difference of heading and gyroscope's angle over sin(2 h) / 2
(`running_slope.RunningSlope`). Two slopes are fitted: with the measured h, and with h propagated by
the gyroscope from the mean of the last seconds. Errors of the frames, such as a wrong axis, are also in the measured
h and increase the first slope. A bend turns the gyroscope but not the measured heading, and decreases the second one.
A wrong focal length changes both equally, and so does a scale error of the gyroscope.

The error is reported if both slopes have the same sign, are significant, and exceed `MAX_SHARE` and `SCALE_SIGMA`
sigmas of the gyroscope's scale. So that the time before a zoom in flight does not hide it for minutes, both are also
fitted to the last `RECENT` blocks alone.
"""

from __future__ import annotations

from math import expm1, radians, sin, sqrt
from typing import NamedTuple

from fusion.estimator.installation.running_slope import LEVEL_S, RunningSlope
from vision.rotations import wrap_axis

MAX_JUMP_RAD = 0.35  # a larger difference from the mean of the last seconds is another axis
MIN_HEADING_STD = radians(2)  # smallest scatter of headings for which the slope is observable
WINDOW = 6  # blocks, 3 s: about the duration of a bend
RECENT = 40  # blocks, 20 s
MIN_WINDOWS = 5.0  # with turns, 15 s: in fewer, a bend may correlate with the turns by chance
MAX_SHARE = 0.03
MAX_ZOOM = 0.08  # in few windows, bends may pass for smaller errors
SCALE_SIGMA = 3.0  # tolerated scale error of the gyroscope, in sigmas


class Slopes(NamedTuple):
    """Regressions of the difference, with h as measured and as propagated by the gyroscope."""

    by_frames: RunningSlope = RunningSlope(WINDOW, MIN_HEADING_STD)
    by_gyro: RunningSlope = RunningSlope(WINDOW, MIN_HEADING_STD)

    @property
    def share(self) -> float:
        """Part by which the camera measures turns larger than the gyroscope: the smaller of the two slopes."""
        return min(self.by_frames.slope, self.by_gyro.slope, key=abs)

    def is_off(self, limit: float) -> bool:
        """Whether the error is significant and larger than a limit."""
        alike = self.by_frames.slope * self.by_gyro.slope > 0.0
        return alike and all(
            line.windows > MIN_WINDOWS and line.is_beyond(limit, line.windows) for line in self
        )

    def interrupted(self) -> Slopes:
        """Restart the running means."""
        return Slopes(self.by_frames.interrupted(), self.by_gyro.interrupted())

    def with_point(self, t_ns: int, by_frames: float, by_gyro: float, off: float, std: float) -> Slopes:
        """Add a difference and its sigma at both kinds of sin(2 h) / 2."""
        return Slopes(
            self.by_frames.with_point(t_ns, by_frames, off, std),
            self.by_gyro.with_point(t_ns, by_gyro, off, std),
        )


class FocalLength(NamedTuple):
    """Estimate of the focal length's error.

    Parameters
    ----------
    level
        Time of the last heading, and running means of both kinds of sin(2 h) / 2 and of the difference; None before
        the first.
    lasting, recent
        Slopes over minutes, which resolve small errors, and over `RECENT` blocks, which show a zoom in flight.
    """

    level: tuple[int, float, float, float] | None = None
    lasting: Slopes = Slopes()
    recent: Slopes = Slopes(*(RunningSlope(WINDOW, MIN_HEADING_STD, RECENT) for _ in range(2)))

    def error(self, gyro_scale_std: float) -> float:
        """Return the part by which the camera measures turns larger than the gyroscope; 0 if it may be right.

        An error is significant, and larger than those of a calibration and of the gyroscope's scale.
        """
        limit = max(MAX_SHARE, SCALE_SIGMA * gyro_scale_std)
        checks = ((self.recent, max(MAX_ZOOM, limit)), (self.lasting, limit))
        return next((slopes.share for slopes, most in checks if slopes.is_off(most)), 0.0)

    def interrupted(self) -> FocalLength:
        """Restart the running means after a change of the clock or of the source that propagates the heading."""
        return FocalLength(None, self.lasting.interrupted(), self.recent.interrupted())

    def with_heading(self, t_ns: int, heading_rad: float, gyro_rad: float, variance: float) -> FocalLength:
        """Add a heading, modulo half a turn, and its variance, with the gyroscope's angle at its time."""
        seen, difference = 0.5 * sin(2.0 * heading_rad), heading_rad - gyro_rad
        then_ns, mean_seen, mean_propagated, mean = self.level or (t_ns, seen, seen, difference)
        off = wrap_axis(difference - mean)
        if abs(off) > MAX_JUMP_RAD:
            return self.interrupted()
        propagated = 0.5 * sin(2.0 * (gyro_rad + mean))
        share = -expm1(-max(t_ns - then_ns, 0) * 1e-9 / LEVEL_S)
        level = (
            t_ns,
            mean_seen + share * (seen - mean_seen),
            mean_propagated + share * (propagated - mean_propagated),
            mean + share * off,
        )
        point = (t_ns, seen - mean_seen, propagated - mean_propagated, off, sqrt(variance))
        return FocalLength(level, self.lasting.with_point(*point), self.recent.with_point(*point))
