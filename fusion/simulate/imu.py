"""Readings of the vehicle's sensors along a `Trajectory`: IMU, attitude filter and range sensor, with errors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fusion.simulate.config import AttitudeConfig, ImuConfig, RangeConfig
from fusion.simulate.motion import Trajectory, Truth

FloatArray = npt.NDArray[np.float64]

ROTORS = 4


@dataclass(frozen=True, slots=True, eq=False)
class ImuSamples:
    """Readings in body FRD (n, 3), and the true biases in them (n, 3)."""

    t_s: FloatArray
    gyro_rad_s: FloatArray
    accel_m_s2: FloatArray
    gyro_bias_rad_s: FloatArray
    accel_bias_m_s2: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class AttitudeSamples:
    """The attitude filter's quaternions (n, 4), w x y z, body FRD to world z down."""

    t_s: FloatArray
    q_world_body: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class RangeSamples:
    """Distances (n,) to the floor along the body's z."""

    t_s: FloatArray
    distance_m: FloatArray


def sample_times(duration_s: float, rate_hz: float) -> FloatArray:
    """Return times from 0 to the duration, both included if they coincide with a sample."""
    return np.arange(int(np.floor(duration_s * rate_hz + 1e-9)) + 1) / rate_hz


def _walk(rng: np.random.Generator, n: int, step: float, start_std: float, density: float) -> FloatArray:
    """Random walks (n, 3): the variance grows by the density squared per second, from the start's."""
    start = rng.normal(0.0, start_std, 3) if start_std > 0 else np.zeros(3)
    steps = rng.normal(0.0, 1.0, (n, 3)) * (density * np.sqrt(step))
    steps[0] = 0.0
    return np.asarray(start + np.cumsum(steps, axis=0))


def read_imu(truth: Truth, config: ImuConfig, seed: int) -> ImuSamples:
    """Add errors to the readings of perfect sensors at the truth's times.

    Scale errors and misalignment act on the true values, ``(I + E) x``, followed by bias, white noise (density d
    sampled at rate f has the standard deviation ``d sqrt(f)``) and the rotors' vibration.
    """
    rng = np.random.default_rng((seed, 6))
    n, step = len(truth.t_s), 1 / config.rate_hz
    gyro_bias = _walk(rng, n, step, config.gyro_bias_std_rad_s, config.gyro_random_walk)
    accel_bias = _walk(rng, n, step, config.accel_bias_std_m_s2, config.accel_random_walk)
    white = rng.normal(0.0, np.sqrt(config.rate_hz), (2, n, 3))
    rate, force = _distorted(truth, config, np.random.default_rng((seed, 12)))
    if config.vibration_m_s2 > 0:
        force = force + rotor_vibration(truth.t_s, config, np.random.default_rng((seed, 13)))
    return ImuSamples(
        truth.t_s,
        rate + gyro_bias + config.gyro_noise_density * white[0],
        force + accel_bias + config.accel_noise_density * white[1],
        gyro_bias,
        accel_bias,
    )


def _distorted(truth: Truth, config: ImuConfig, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Rates and specific forces (n, 3) each, through the sensors' scale errors and misalignment."""
    gyro_scale, accel_scale = rng.normal(0.0, 1.0, (2, 3))
    skew = rng.normal(0.0, config.misalignment_std_rad, (2, 3, 3)) * (1 - np.eye(3))
    gyro = np.eye(3) + np.diag(config.gyro_scale_std * gyro_scale) + skew[0]
    accel = np.eye(3) + np.diag(config.accel_scale_std * accel_scale) + skew[1]
    if config.gyro_scale_std == config.accel_scale_std == config.misalignment_std_rad == 0:
        return truth.rate_rad_s, truth.specific_force_m_s2
    return truth.rate_rad_s @ gyro.T, truth.specific_force_m_s2 @ accel.T


def rotor_vibration(t_s: FloatArray, config: ImuConfig, rng: np.random.Generator) -> FloatArray:
    """Specific force (n, 3) of four rotors' unbalance: harmonics of their speeds, sampled without a filter.

    Frequencies above half the sampling rate are aliased, as in a flight controller's raw log. The speeds vary by
    some per cent. Each axis has the root mean square ``vibration_m_s2``, the vertical one twice that.
    """
    step = 1 / config.rate_hz
    total = np.zeros((len(t_s), 3))
    for _ in range(ROTORS):
        wander = np.cumsum(rng.normal(0.0, 1.0, len(t_s))) * np.sqrt(step)
        wander = 0.03 * np.sin(wander / 2.0)  # bounded, because a controller regulates the speed
        speed = config.rotor_hz * rng.uniform(0.95, 1.05) * (1 + wander)
        phase = 2 * np.pi * np.cumsum(speed) * step
        for harmonic in range(1, config.vibration_harmonics + 1):
            turns, weight = rng.uniform(0, 2 * np.pi, 3), rng.uniform(0.5, 1.0, 3) / harmonic
            total += weight * np.sin(harmonic * phase[:, None] + turns)
    size = np.sqrt(np.mean(total**2, axis=0))
    return np.asarray(total / size * config.vibration_m_s2 * np.array([1.0, 1.0, 2.0]))


def read_attitude(
    trajectory: Trajectory, config: AttitudeConfig, imu: ImuSamples | None, seed: int
) -> AttitudeSamples:
    """Read an attitude filter: tilt errors are stationary, yaw errors as configured."""
    rng = np.random.default_rng((seed, 7))
    t = sample_times(trajectory.duration_s, config.rate_hz)
    step = 1 / config.rate_hz
    tilt = _wander(rng, len(t), step, config.tilt_std_rad, config.tilt_time_s)
    offset = rng.uniform(-np.pi, np.pi)
    yaw_error = np.full(len(t), offset if config.yaw_offset_rad is None else config.yaw_offset_rad)
    drift = config.yaw_drift_rad_s * t
    drift += np.cumsum(rng.normal(0.0, 1.0, len(t))) * (config.yaw_walk * np.sqrt(step))
    magnetic = _disturbance(t, config)
    if config.yaw_follows_gyro and imu is not None:
        yaw_error += np.interp(t, imu.t_s, _integrated_yaw_error(trajectory, imu, drift, magnetic, t, config))
    else:
        yaw_error += drift + magnetic
    R = trajectory.rotations(t)
    return AttitudeSamples(t, quaternions(_error_rotation(tilt, yaw_error) @ R))


def read_range(
    trajectory: Trajectory, config: RangeConfig, p_body_sensor_m: FloatArray, seed: int
) -> RangeSamples:
    """Read a range sensor at ``p_body_sensor_m`` (3,) that points along the body's z at a bare floor."""
    rng = np.random.default_rng((seed, 8))
    truth = trajectory.truth(sample_times(trajectory.duration_s, config.rate_hz))
    down = truth.R_world_body[:, 2]  # rows: the vertical in the body
    rise = np.tan(trajectory.rooms[0].slope_rad)
    along = truth.R_world_body[:, 0]
    height_m = -(truth.p_world_m[:, 2] + down @ p_body_sensor_m)
    height_m -= rise * (truth.p_world_m[:, 0] + along @ p_body_sensor_m)
    noise_m = config.noise_std_m * rng.normal(0.0, 1.0, len(height_m))
    return RangeSamples(truth.t_s, height_m / (down[:, 2] + rise * along[:, 2]) + noise_m)


def _wander(rng: np.random.Generator, n: int, step: float, std: float, time_s: float) -> FloatArray:
    """Two stationary first-order Gauss-Markov processes (n, 2)."""
    keep = float(np.exp(-step / time_s))
    values = rng.normal(0.0, 1.0, (n, 2))
    values[1:] *= np.sqrt(1 - keep * keep)
    for k in range(1, n):
        values[k] += keep * values[k - 1]
    return std * values


def _disturbance(t: FloatArray, config: AttitudeConfig) -> FloatArray:
    """Magnetic disturbance of the yaw: comes and goes within about half a second."""
    if config.disturbance_s <= 0:
        return np.zeros(len(t))
    rise = 1 / (1 + np.exp(-np.clip((t - config.disturbance_start_s) / 0.15, -50, 50)))
    end = config.disturbance_start_s + config.disturbance_s
    fall = 1 / (1 + np.exp(-np.clip((t - end) / 0.15, -50, 50)))
    return np.asarray(config.disturbance_rad * (rise - fall))


def _integrated_yaw_error(
    trajectory: Trajectory,
    imu: ImuSamples,
    drift: FloatArray,
    magnetic: FloatArray,
    t: FloatArray,
    config: AttitudeConfig,
) -> FloatArray:
    """Yaw error (at the IMU's times) of a filter that integrates the gyroscope and follows a compass slowly."""
    truth = trajectory.truth(imu.t_s)
    level = truth.R_world_body[:, 2]  # rows: the vertical in the body
    # the filter has estimated its gyroscope's bias before the flight
    wrong = imu.gyro_rad_s - imu.gyro_bias_rad_s[0] - truth.rate_rad_s
    pull = np.interp(imu.t_s, t, drift + magnetic) / config.compass_time_s
    error_rate = np.einsum("ni,ni->n", wrong, level) + pull
    step = float(imu.t_s[1] - imu.t_s[0])
    keep = 1 - step / config.compass_time_s
    error = np.zeros(len(imu.t_s))
    for k in range(1, len(error)):
        error[k] = keep * error[k - 1] + step * error_rate[k - 1]
    return error


def _error_rotation(tilt: FloatArray, yaw_error: FloatArray) -> FloatArray:
    """Rotations (n, 3, 3) of the world: a small turn about two level axes, then one about the vertical."""
    n = len(yaw_error)
    a, b = tilt.T
    lean = np.zeros((n, 3, 3))
    lean[:, 0] = np.stack([np.cos(b), np.sin(a) * np.sin(b), np.cos(a) * np.sin(b)], axis=1)
    lean[:, 1] = np.stack([np.zeros(n), np.cos(a), -np.sin(a)], axis=1)
    lean[:, 2] = np.stack([-np.sin(b), np.sin(a) * np.cos(b), np.cos(a) * np.cos(b)], axis=1)
    turn = np.zeros((n, 3, 3))
    turn[:, 0, 0], turn[:, 0, 1] = np.cos(yaw_error), -np.sin(yaw_error)
    turn[:, 1, 0], turn[:, 1, 1], turn[:, 2, 2] = np.sin(yaw_error), np.cos(yaw_error), 1.0
    return np.asarray(turn @ lean)


def quaternions(R: FloatArray) -> FloatArray:
    """Return unit quaternions (n, 4), w x y z with w not negative, of rotations (n, 3, 3)."""
    from scipy.spatial.transform import Rotation

    q = np.roll(Rotation.from_matrix(R).as_quat(), 1, axis=1)
    return np.asarray(q * np.where(q[:, :1] < 0, -1.0, 1.0))
