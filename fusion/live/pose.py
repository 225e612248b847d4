"""The vehicle's position and yaw in the frame of the first corridor, continuous through turns for an autopilot.

The estimate's heading and offset are relative to the corridor being flown, and both jump where another one begins.
Here the x axis is the centre line of the first corridor for the whole flight, so yaw and position are continuous.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, isfinite, nan, pi, sin

import numpy as np
import numpy.typing as npt

from fusion.estimator.estimate import Estimate
from vision.rotations import wrap

STEP_RAD = pi / 90  # smaller jumps of the yaw are not counted, as for `Estimate.reset_count`
UNKNOWN_OFFSET_STD_M = 1.0
UNKNOWN_SPEED_M_S = 1.0  # standard deviation of an unmeasured speed along the corridor
SPEED_STD_M_S, SPEED_TIME_S = 0.1, 1.0  # error of a measured speed, and its correlation time
MAX_STEP_S = 0.5


@dataclass(frozen=True, slots=True)
class Pose:
    """Yaw and position from the first corridor's axis, x along it, y right of its centre line.

    Parameters
    ----------
    yaw_rad, yaw_std_rad
        Positive turned right.
    reset_counter
        Increases when yaw or position jumps, modulo 256.
    x_m, y_m
        Dead-reckoned along each corridor, measured across it.
    variance_m2
        Of x and y, (2,).
    """

    yaw_rad: float
    yaw_std_rad: float
    reset_counter: int
    x_m: float
    y_m: float
    variance_m2: tuple[float, float]


class PoseTracker:
    """Integrates an estimator's estimates in the order in which they are sent."""

    def __init__(self) -> None:
        self.reset_counter = 0
        self._steps_rad: float | None = None  # sum of all jumps of the yaw
        self._reset_count = self._lateral_count = 0
        self._t_ns: int | None = None
        self._corridor = 0
        self._turn_rad = 0.0
        self._along_m, self._along_variance_m2, self._drift_s = 0.0, 0.0, 0.0
        self._across_m, self._across_std_m = nan, UNKNOWN_OFFSET_STD_M
        self._origin_m = np.zeros(2)  # of the present corridor's axis
        self._origin_covariance = np.zeros((2, 2))

    def follow(self, e: Estimate) -> Pose:
        """Process the next estimate."""
        self._count_yaw_steps(e)
        self._move_along(e)
        if e.corridor_index != self._corridor:
            self._enter(e)
        self._move_across(e)
        place = self._place()
        variance = np.diag(self._covariance()).tolist()
        return Pose(
            wrap(e.heading_rad + e.corridor_turn_rad),
            e.heading_std_rad,
            self.reset_counter,
            float(place[0]),
            float(place[1]),
            (variance[0], variance[1]),
        )

    def _count_yaw_steps(self, e: Estimate) -> None:
        """Count jumps of the yaw; in a new corridor, heading and turn jump by opposite amounts."""
        if e.reset_count == self._reset_count and self._steps_rad is not None:
            return
        steps = e.reset_heading_total_rad + e.corridor_turn_rad
        if self._steps_rad is not None and abs(wrap(steps - self._steps_rad)) > STEP_RAD:
            self.reset_counter = (self.reset_counter + 1) % 256
        self._steps_rad, self._reset_count = steps, e.reset_count

    def _move_along(self, e: Estimate) -> None:
        dt_s = 0.0 if self._t_ns is None else min(max((e.timestamp_ns - self._t_ns) * 1e-9, 0.0), MAX_STEP_S)
        self._t_ns = e.timestamp_ns
        if isfinite(e.along_velocity_m_s):
            self._along_m += dt_s * e.along_velocity_m_s
            self._along_variance_m2 += 2.0 * SPEED_STD_M_S**2 * SPEED_TIME_S * dt_s
        else:  # the speed is unknown
            before_s, self._drift_s = self._drift_s, self._drift_s + dt_s
            self._along_variance_m2 += UNKNOWN_SPEED_M_S**2 * (self._drift_s**2 - before_s**2)

    def _move_across(self, e: Estimate) -> None:
        known = isfinite(e.lateral_offset_m)
        self._across_std_m = e.lateral_offset_std_m if known else UNKNOWN_OFFSET_STD_M
        if not known:
            return
        if isfinite(self._across_m) and e.lateral_reset_count != self._lateral_count:
            self.reset_counter = (self.reset_counter + 1) % 256
        elif (
            not isfinite(self._across_m) and self._corridor
        ):  # first offset in a new corridor: shifts its axis
            self._origin_m -= self._right() * e.lateral_offset_m
        self._across_m, self._lateral_count = e.lateral_offset_m, e.lateral_reset_count

    def _enter(self, e: Estimate) -> None:
        """Place the new corridor's axis through the vehicle until the lateral offset is known."""
        self._origin_covariance = self._covariance()
        self._origin_m = self._place()
        self._along_m, self._along_variance_m2, self._drift_s = 0.0, 0.0, 0.0
        self._across_m = nan
        self._corridor, self._turn_rad = e.corridor_index, e.corridor_turn_rad

    def _ahead(self) -> npt.NDArray[np.float64]:
        return np.array([cos(self._turn_rad), sin(self._turn_rad)])

    def _right(self) -> npt.NDArray[np.float64]:
        return np.array([-sin(self._turn_rad), cos(self._turn_rad)])

    def _place(self) -> npt.NDArray[np.float64]:
        across_m = self._across_m if isfinite(self._across_m) else 0.0
        return self._origin_m + self._ahead() * self._along_m + self._right() * across_m

    def _covariance(self) -> npt.NDArray[np.float64]:
        a, r = self._ahead(), self._right()
        own = np.outer(a, a) * self._along_variance_m2 + np.outer(r, r) * self._across_std_m**2
        return np.asarray(self._origin_covariance + own)
