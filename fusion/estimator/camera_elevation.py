"""The camera's mounting pitch: a scalar Kalman filter of the frames' elevations."""

from __future__ import annotations

from math import hypot, isfinite, pi, radians, sqrt
from typing import NamedTuple

from vision.measurement import Attitude, FrameMeasurement

WEIGHT = 30.0  # factor on the variance: errors of the attitude are correlated for seconds
FLOOR_RAD = radians(0.25)


class Elevation(NamedTuple):
    """Elevation of the vanishing point above the horizon of the IMU, rad: mean and variance."""

    mean_rad: float = 0.0
    variance: float = (3.0 * pi / 180) ** 2

    @property
    def std_rad(self) -> float:
        """Standard deviation, at least `FLOOR_RAD`."""
        return max(sqrt(self.variance), FLOOR_RAD)

    def with_frame(self, m: FrameMeasurement, attitude: Attitude | None) -> Elevation:
        """Update with a frame's elevation, if it has one and the attitude was known."""
        if not (isfinite(m.elevation_rad) and m.elevation_std_rad > 0.0) or attitude is None:
            return self
        R = WEIGHT * hypot(m.elevation_std_rad, attitude.std_rad) ** 2
        gain = self.variance / (self.variance + R)
        return Elevation(
            self.mean_rad + gain * (m.elevation_rad - self.mean_rad), (1.0 - gain) * self.variance
        )
