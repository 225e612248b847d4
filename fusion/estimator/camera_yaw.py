"""Yaw error of the camera's calibration, estimated from the axis's elevations and the vehicle's roll.

A camera whose yaw or principal point differs from the calibration makes every heading wrong by that angle, and no
turn shows it; but when the vehicle rolls, the axis seems to rise or sink by the angle times the roll's sine. The
angle is the slope of a line through elevations over the roll's sine (`fusion.estimator.running_slope.RunningSlope`).
Both are less their means of the last seconds: a ramp, or an attitude that is off for long, changes the elevations
too, and a slow roll by chance in the same way. Errors of an attitude may follow the motion for seconds, those of
frames are hardly correlated.
"""

from __future__ import annotations

from math import radians, sin
from typing import NamedTuple

from fusion.estimator.running_slope import PRIOR_WINDOWS, RunningSlope

MAX_ELEVATION_RAD = 0.3  # more is no axis of a corridor
MIN_ROLL_STD = 0.02  # rad; with less, elevations show nothing
WINDOW = 3  # blocks
MAX_CAMERA_YAW_RAD = radians(3)


class CameraYaw(NamedTuple):
    """What elevations have shown so far: the line through them over the roll's sine."""

    line: RunningSlope = RunningSlope(WINDOW, MIN_ROLL_STD)

    @property
    def angle_rad(self) -> float:
        """By how much the camera points to the right of what is told."""
        return self.line.slope

    @property
    def std_rad(self) -> float:
        """Its sigma; infinite while nothing is known."""
        return self.line.std

    @property
    def is_off(self) -> bool:
        """Whether it surely points to one side by more than an installation may."""
        return self.line.is_beyond(MAX_CAMERA_YAW_RAD, PRIOR_WINDOWS + self.line.n_blocks / WINDOW)

    def with_elevation(self, t_ns: int, elevation_rad: float, std_rad: float, roll_rad: float) -> CameraYaw:
        """Take the elevation of a frame's axis above the IMU's horizon, its sigma, and the vehicle's roll.

        The sigma is that of both, frame and attitude.
        """
        # NaN fails too.
        if not (abs(elevation_rad) < MAX_ELEVATION_RAD and 1e-4 < std_rad < MAX_ELEVATION_RAD):
            return self
        return CameraYaw(self.line.with_point(t_ns, sin(roll_rad), elevation_rad, std_rad))
