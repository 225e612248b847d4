"""Yaw error of the camera's calibration, estimated from the axis's elevations and the vehicle's roll.

A camera whose yaw or principal point differs from the calibration by an angle beta shifts every heading by beta,
which turns do not reveal. When the vehicle rolls by phi, however, the axis's elevation changes by ``beta sin(phi)``.
So beta is the slope of elevation over sin(phi) (`running_slope.RunningSlope`). Running means are subtracted from
both: a ramp or a lasting attitude error also changes the elevation, possibly together with a slow roll. Errors of the
attitude are correlated over seconds, those of frames hardly.

The error is reported if it is significant and larger than `MAX_CAMERA_YAW_RAD`.
"""

from __future__ import annotations

from math import radians, sin
from typing import NamedTuple

from fusion.estimator.installation.running_slope import PRIOR_WINDOWS, RunningSlope

MAX_ELEVATION_RAD = 0.3  # a larger one is not that of a corridor's axis
MIN_ROLL_STD = 0.02  # rad; smallest scatter of the roll for which the slope is observable
WINDOW = 3  # blocks
MAX_CAMERA_YAW_RAD = radians(3)


class CameraYaw(NamedTuple):
    """Estimate of the camera's yaw error: regression of elevation over the roll's sine."""

    line: RunningSlope = RunningSlope(WINDOW, MIN_ROLL_STD)

    @property
    def angle_rad(self) -> float:
        """Angle by which the camera points to the right of its calibrated direction."""
        return self.line.slope

    @property
    def std_rad(self) -> float:
        """Sigma of the angle; infinite while unknown."""
        return self.line.std

    @property
    def is_off(self) -> bool:
        """Whether the angle is significant and larger than an installation's tolerance."""
        return self.line.is_beyond(MAX_CAMERA_YAW_RAD, PRIOR_WINDOWS + self.line.n_blocks / WINDOW)

    def with_elevation(self, t_ns: int, elevation_rad: float, std_rad: float, roll_rad: float) -> CameraYaw:
        """Add the elevation of a frame's axis above the IMU's horizon and the vehicle's roll.

        The sigma contains the errors of frame and attitude.
        """
        # NaN fails too.
        if not (abs(elevation_rad) < MAX_ELEVATION_RAD and 1e-4 < std_rad < MAX_ELEVATION_RAD):
            return self
        return CameraYaw(self.line.with_point(t_ns, sin(roll_rad), elevation_rad, std_rad))
