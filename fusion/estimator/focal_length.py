"""Whether the focal length is wrong: takes headings and the gyroscope's angle, returns by how much.

If the focal length is set too short by a share e, the tangent of each heading h is measured too large by e, and h by
e sin(2 h) / 2. So e is the slope of a line through headings less the gyroscope's angle over sin(2 h) / 2
(`fusion.estimator.running_slope.RunningSlope`). It is fitted twice: with h as measured, and with h as the gyroscope
carries it from the mean of the last seconds. Errors of the frames, a wrong axis among them, are in the measured h
too: they make the first slope larger. A bend that the vehicle follows turns the gyroscope but not the camera's view:
it makes the second one smaller. A wrong focal length changes both alike, and so does a wrong scale of the gyroscope.
"""

from __future__ import annotations

from math import expm1, radians, sin, sqrt
from typing import NamedTuple

from fusion.estimator.running_slope import LEVEL_S, RunningSlope
from vision.rotations import wrap_axis

MAX_JUMP_RAD = 0.35  # of a difference from the mean of the last seconds; more is another axis
MIN_HEADING_STD = radians(2)  # with less, a slope is that of errors
WINDOW = 6  # blocks: a bend lasts for seconds
MIN_WINDOWS = 5.0  # of turning, 15 s: in fewer, a bend may happen to go along with the turns
MAX_SHARE = 0.03
SCALE_SIGMA = 3.0  # by which the scale of a good gyroscope may be off


class FocalLength(NamedTuple):
    """What headings have shown so far.

    Parameters
    ----------
    level
        Time of the last heading, and means of sin(2 h) / 2 of both kinds and of the difference until then; None
        before the first.
    by_frames, by_gyro
        Lines through the differences, h as seen and as the gyroscope carries it.
    """

    level: tuple[int, float, float, float] | None = None
    by_frames: RunningSlope = RunningSlope(WINDOW, MIN_HEADING_STD)
    by_gyro: RunningSlope = RunningSlope(WINDOW, MIN_HEADING_STD)

    @property
    def share(self) -> float:
        """By how much the camera sees more of a turn than the gyroscope."""
        return min(self.by_frames.slope, self.by_gyro.slope, key=abs)

    def is_off(self, gyro_scale_std: float) -> bool:
        """Whether the error is significant and larger than those of a calibration and of the gyroscope's scale."""
        limit = max(MAX_SHARE, SCALE_SIGMA * gyro_scale_std)
        lines = (self.by_frames, self.by_gyro)
        alike = self.by_frames.slope * self.by_gyro.slope > 0.0
        return alike and all(
            line.windows > MIN_WINDOWS and line.is_beyond(limit, line.windows) for line in lines
        )

    def interrupted(self) -> FocalLength:
        """Forget the last seconds: time has moved, or something else carries the heading."""
        return FocalLength(None, self.by_frames.interrupted(), self.by_gyro.interrupted())

    def with_heading(self, t_ns: int, heading_rad: float, gyro_rad: float, variance: float) -> FocalLength:
        """Add a heading, modulo half a turn, its variance, and the angle that the gyroscope has turned by then."""
        seen, difference = 0.5 * sin(2.0 * heading_rad), heading_rad - gyro_rad
        then_ns, mean_seen, mean_carried, mean = self.level or (t_ns, seen, seen, difference)
        off = wrap_axis(difference - mean)
        if abs(off) > MAX_JUMP_RAD:
            return self.interrupted()
        carried = 0.5 * sin(2.0 * (gyro_rad + mean))
        share = -expm1(-max(t_ns - then_ns, 0) * 1e-9 / LEVEL_S)
        level = (
            t_ns,
            mean_seen + share * (seen - mean_seen),
            mean_carried + share * (carried - mean_carried),
            mean + share * off,
        )
        std = sqrt(variance)
        return FocalLength(
            level,
            self.by_frames.with_point(t_ns, seen - mean_seen, off, std),
            self.by_gyro.with_point(t_ns, carried - mean_carried, off, std),
        )
