"""The vehicle's rotation by its inertial sensors alone: yaw and tilt as curves over time."""

from __future__ import annotations

from dataclasses import dataclass
from math import asin, atan2, sqrt

import numpy as np
import numpy.typing as npt

from fusion.estimator.models import level_yaw_rates
from fusion.estimator.tilt import tilt_along
from fusion.flight import AttitudeStream, Flight, ImuStream, TimeArray
from vision.errors import InputError
from vision.measurement import Attitude
from vision.rotations import down_of, yaw_of

FloatArray = npt.NDArray[np.float64]

GYRO_GAP_S = 0.1
ATTITUDE_GAP_S = 0.5
GAP_STEPS = 3.0  # of the stream's median step
SECOND_DIFFERENCE_MEDIAN = 0.6745 * sqrt(6.0)  # median of |a - 2b + c| for noise of one unit


@dataclass(frozen=True, slots=True, eq=False)
class Turning:
    """Yaw and tilt at the samples of an inertial stream; n samples.

    Parameters
    ----------
    t_s
        Times (n,), seconds from the flight's origin.
    yaw_rad
        Yaw turned about the vertical (n,), unwrapped, from an arbitrary zero.
    down
        Gravity's direction in the body (n, 3).
    tilt_std_rad
        Standard deviation of roll and pitch (n,).
    gap_s
        Longest step that is bridged.
    by_gyro
        Whether the yaw comes from the gyroscope; otherwise from the attitude stream.
    noise_density
        Of the gyroscope's yaw rate, rad/s/sqrt(Hz); 0 if the yaw is the attitude's.
    """

    t_s: FloatArray
    yaw_rad: FloatArray
    down: FloatArray
    tilt_std_rad: FloatArray
    gap_s: float
    by_gyro: bool
    noise_density: float

    @property
    def level_std_rad(self) -> float:
        """Median standard deviation of roll and pitch."""
        return float(np.median(self.tilt_std_rad))

    def yaw_at(self, t_s: FloatArray) -> FloatArray:
        """Yaw at times of any shape; NaN outside the stream and in its gaps."""
        index = np.clip(np.searchsorted(self.t_s, t_s), 1, len(self.t_s) - 1)
        before, after = self.t_s[index - 1], self.t_s[index]
        share = (t_s - before) / (after - before)
        value = self.yaw_rad[index - 1] * (1.0 - share) + self.yaw_rad[index] * share
        bad = (t_s < self.t_s[0]) | (t_s > self.t_s[-1]) | (after - before > self.gap_s)
        return np.where(bad, np.nan, value)

    def rate_at(self, t_s: FloatArray, half_width_s: float) -> FloatArray:
        """Yaw rate at times of any shape, as the slope between two points of the curve; NaN as for the yaw."""
        rise = self.yaw_at(t_s + half_width_s) - self.yaw_at(t_s - half_width_s)
        return np.asarray(rise / (2.0 * half_width_s))

    def attitude_at(self, t_s: float) -> Attitude | None:
        """Roll and pitch at a time; None outside the stream."""
        if not self.t_s[0] <= t_s <= self.t_s[-1]:
            return None
        index = min(max(int(np.searchsorted(self.t_s, t_s)), 1), len(self.t_s) - 1)
        before, after = float(self.t_s[index - 1]), float(self.t_s[index])
        share = (t_s - before) / (after - before)
        x, y, z = (self.down[index - 1] * (1.0 - share) + self.down[index] * share).tolist()
        std_rad = float(max(self.tilt_std_rad[index - 1], self.tilt_std_rad[index]))
        return Attitude(atan2(y, z), -asin(max(-1.0, min(1.0, x / sqrt(x * x + y * y + z * z)))), std_rad)


def seconds(t_ns: TimeArray, origin_ns: int) -> FloatArray:
    """Turn times (n,) into seconds from an origin."""
    return np.asarray((t_ns - origin_ns) * 1e-9, np.float64)


def turning_of(flight: Flight, origin_ns: int, attitude_std_rad: float) -> Turning:
    """Integrate a flight's gyroscope, tilt-compensated as the estimator does; or take its attitude's yaw.

    Parameters
    ----------
    flight
        With a gyroscope or an attitude stream.
    origin_ns
        Time that counts as zero.
    attitude_std_rad
        Of roll and pitch of an attitude stream.

    Raises
    ------
    InputError
        If the flight has neither.
    """
    imu, attitude = flight.imu, flight.attitude
    if imu is not None and len(imu.t_ns) > 1:
        return _of_gyro(imu, attitude, origin_ns, attitude_std_rad)
    if attitude is not None and len(attitude.t_ns) > 1:
        return _of_attitude(attitude, origin_ns, attitude_std_rad)
    raise InputError(
        f"flight {flight.name} has neither gyroscope nor attitude",
        remedy="there is nothing to align the camera with: give a log with an IMU",
    )


def _of_gyro(
    imu: ImuStream, attitude: AttitudeStream | None, origin_ns: int, attitude_std_rad: float
) -> Turning:
    attitude = attitude or AttitudeStream(np.empty(0, np.int64), np.empty((0, 4)))
    down, std = tilt_along(
        imu.t_ns, imu.gyro_rad_s, imu.accel_m_s2, attitude.t_ns, attitude.q_world_body, attitude_std_rad
    )
    rate = level_yaw_rates(imu.gyro_rad_s, down)
    t_s = seconds(imu.t_ns, origin_ns)
    step_s = np.diff(t_s)
    yaw = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * step_s)])
    median_s = float(np.median(step_s))
    noise = imu.gyro_noise_density or _noise_density(rate, median_s)
    return Turning(t_s, yaw, down, std, max(GYRO_GAP_S, GAP_STEPS * median_s), True, noise)


def _noise_density(rate_rad_s: FloatArray, step_s: float) -> float:
    """White noise of a rate, from its second differences, which contain little of the motion."""
    if len(rate_rad_s) < 3:
        return 0.0
    return float(np.median(np.abs(np.diff(rate_rad_s, 2)))) / SECOND_DIFFERENCE_MEDIAN * sqrt(step_s)


def _of_attitude(attitude: AttitudeStream, origin_ns: int, attitude_std_rad: float) -> Turning:
    yaw, down = np.unwrap(yaw_of(attitude.q_world_body)), down_of(attitude.q_world_body)
    t_s = seconds(attitude.t_ns, origin_ns)
    gap_s = max(ATTITUDE_GAP_S, GAP_STEPS * float(np.median(np.diff(t_s))))
    return Turning(t_s, yaw, down, np.full(len(t_s), attitude_std_rad), gap_s, False, 0.0)
