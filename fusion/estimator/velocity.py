"""The velocity stream: level speeds from a body velocity and the tilt, held for half a second."""

from __future__ import annotations

from math import isfinite
from typing import NamedTuple

from fusion.estimator.config import FusionConfig
from fusion.estimator.models import Vector
from fusion.estimator.sample_times import SampleTimes

HELD_S = 0.5
MAX_SPEED_M_S = 100.0


class VelocitySample(NamedTuple):
    """A velocity (3,) in the body, FRD, metres per second, for instance from optical flow or wheels."""

    t_ns: int
    v_body_m_s: Vector

    def fault(self) -> str:
        """Return the reason why it cannot be used; empty if it can."""
        x, y, z = self.v_body_m_s
        if not (isfinite(x) and isfinite(y) and isfinite(z)):
            return "velocity_not_finite"
        return "" if max(abs(x), abs(y), abs(z)) <= MAX_SPEED_M_S else "velocity_out_of_range"


class Velocity(NamedTuple):
    """Level speeds ahead and to the right, metres per second, and the times of the samples."""

    times: SampleTimes = SampleTimes()
    forward_m_s: float = 0.0
    sideways_m_s: float = 0.0

    def is_known(self, t_ns: int) -> bool:
        """Whether the last sample is recent enough at a time."""
        return self.times.age_s(t_ns) <= HELD_S

    def clock_set_back(self) -> Velocity:
        """Drop the last sample."""
        return self._replace(times=self.times.clock_set_back())

    def silence(self, t_ns: int, config: FusionConfig) -> str:
        """Report a source that has fallen silent; empty if it has not."""
        return "velocity is silent" if self.times.is_silent(t_ns, config) else ""


def with_velocity(velocity: Velocity, sample: VelocitySample, down: Vector) -> Velocity:
    """Rotate a body velocity into the level frame by gravity's direction; the yaw is not needed."""
    dx, dy, dz = down
    vx, vy, vz = sample.v_body_m_s
    horizontal = max((dy * dy + dz * dz) ** 0.5, 0.09)
    right = (dz * vy - dy * vz) / horizontal
    forward = vx * horizontal - dx * (dy * vy + dz * vz) / horizontal
    return Velocity(velocity.times.with_sample(sample.t_ns), forward, right)
