"""Sigma of the heading for a camera that may have slipped in its mount.

Frames that drift from gyroscope and IMU yaw alike show a bend of the corridor or a slip of the camera. The heading
follows them as in a bend. After a slip by D it is wrong by D, also when the slip has ended. With the prior
probability `SLIPPED`, and D normally distributed about zero with `SLIP_STD_RAD`, the error's mean square is taken as
``SLIPPED D^2 exp(-D^2 / (2 SLIP_STD_RAD^2))``: a mount gives way by some degrees, a corridor bends by any angle.
D is measured against the IMU's yaw, since the gyroscope's bias may have absorbed a part of the drift.
Frames that jump and stay there may likewise show a blow to the camera, or that the axis before was wrong.
"""

from __future__ import annotations

from math import exp, radians, sqrt
from typing import NamedTuple

from fusion.estimator.frame_drift import HeadingComparison
from vision.rotations import wrap_axis

SLIPPED = 0.15  # prior probability that such a drift is a slip
SLIP_STD_RAD = radians(12)
PAUSE_NS = 10_000_000_000  # a drift that is found again within this time is the same one
MEMORY_S = 100.0  # most flights with a bend have no slip, and need their sigma again


class MountSlip(NamedTuple):
    """Angle by which frames have drifted from gyroscope and IMU yaw.

    Parameters
    ----------
    angle_rad
        The angle; it fades with `MEMORY_S`.
    before_rad, apart_rad
        The angle of the drifts before the present one, and the frames' heading less the IMU's yaw when it began.
    last_ns
        Time when a drift was found last; None before the first.
    """

    angle_rad: float = 0.0
    before_rad: float = 0.0
    apart_rad: float = 0.0
    last_ns: int | None = None

    @property
    def std_rad(self) -> float:
        """Sigma of the heading's error by a slip."""
        angle = abs(self.angle_rad)
        return angle * sqrt(SLIPPED) * exp(-0.25 * (angle / SLIP_STD_RAD) ** 2)

    def faded(self, elapsed_s: float) -> MountSlip:
        """Fade over a time."""
        if not self.angle_rad:
            return self
        kept = exp(-elapsed_s / MEMORY_S)
        return self._replace(angle_rad=kept * self.angle_rad, before_rad=kept * self.before_rad)

    def with_jump(self, angle_rad: float) -> MountSlip:
        """Add a jump of the frames."""
        return MountSlip(self.angle_rad + angle_rad)

    def with_drift(self, comparisons: tuple[HeadingComparison, ...]) -> MountSlip:
        """Add a drift found over these frames, the newest last."""
        first, now = comparisons[0], comparisons[-1]
        before, apart = self.before_rad, self.apart_rad
        if self.last_ns is None or now.t_ns - self.last_ns > PAUSE_NS:
            before, apart = self.angle_rad, first.heading_rad - first.yaw_rad
        angle = wrap_axis(now.heading_rad - now.yaw_rad - apart)
        return MountSlip(before + angle, before, apart, now.t_ns)
