"""Heading, covariance, yaw offset and lateral offset along a run of samples, in one compiled call."""

from __future__ import annotations

from functools import cache
from math import isfinite

import numpy as np

from fusion.estimator.imu_yaw import NOTHING, OFFSET_ONLY, UNLIKE
from fusion.estimator.kernels import BIAS, N_STATES, PSI, YAW_OFFSET, predicted_variance, stepped, updated
from fusion.estimator.lateral.kernels import extended_path
from fusion.estimator.models import FloatArray
from fusion.estimator.propagation import LONG_TURN_RAD, SCALE_TIME_S
from fusion.estimator.resets import STEP_RAD
from fusion.flight import TimeArray
from vision.compiled import compiled, compiled_inner
from vision.rotations import wrap
from vision.types import BoolArray

N_PROPAGATED = 21
THETA, RAW_THETA, PATH_S, RATE = 0, 1, 3, 15  # columns of ``propagated``, see `process_samples`
SMALL_STEP_RAD = 0.5 * STEP_RAD  # a larger correction, which may count as a jump, is left to the engine
_wrap = compiled_inner(wrap)


@cache
def compile_gyro_run() -> None:
    """Compile the run, or load it from the cache, before the first sample."""
    n = N_STATES
    rows, squares = np.empty((1, n)), np.empty((1, n, n))
    propagated, makes_step = np.empty((1, N_PROPAGATED)), np.empty(1, np.bool_)
    out = (
        rows,
        squares,
        squares.copy(),
        np.empty((n, n)),
        rows.copy(),
        squares.copy(),
        propagated,
        makes_step,
    )
    samples = (np.array([1_000_000]), np.ones(1, np.bool_), np.zeros((1, 8)))
    times, yaw = (0, 0, 1_000_000_000, 0), (NOTHING, 0.0, 1.0, 1.0)
    x, P, first = np.zeros(n), np.eye(n), np.zeros(N_PROPAGATED)
    process_samples(samples, x, P, first, times, (0.0,) * 4, (1.0,) * 3, yaw, out)


@compiled
def process_samples(
    samples: tuple[TimeArray, BoolArray, FloatArray],
    x: FloatArray,
    P: FloatArray,
    first: FloatArray,
    times_ns: tuple[int, int, int, int],
    numbers: tuple[float, float, float, float],
    noise: tuple[float, float, float],
    yaw: tuple[int, float, float, float],
    out: tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, BoolArray],
) -> int:
    """Process samples as the engine does in `Mode.GYRO`; return how many were processed.

    It stops before a gap in the gyroscope's samples, and before a yaw that the gate rejects.

    Parameters
    ----------
    samples
        ``t_ns``, ``is_gyro`` and ``steps`` of `fusion.estimator.sensing.GoodSamples`.
    x, P
        State (3,) and covariance (3, 3) of the filter.
    first
        Other propagated values (21,): dead-reckoned heading, the same with the bias, yaw since the last attitude;
        the six fields of the path and the four of the acceleration; age of the evidence; angle since the last
        gyroscope sample, level yaw rate; yaw and mean interval of the attitudes; residual, test ratio and variance
        of the last yaw.
    times_ns
        Times of the state and of the last gyroscope sample, the longest gap, and the time of the last attitude.
    numbers
        Roll correction, variance of the scale, squared density of the noise beyond the configured one, rad^2/s, and
        dead-reckoned heading at the last accepted frame.
    noise
        Densities of the process noise.
    yaw
        The first four fields of `fusion.estimator.imu_yaw.YawUpdates`.
    out
        Output, see `GyroRun`: x (n, 3), F (n, 3, 3), P (n, 3, 3), Q (3, 3), x_prior, P_prior, propagated (n, 21),
        makes_step (n,).
    """
    t_ns, is_gyro, steps = samples
    last_ns, gyro_ns, grace_ns, attitude_ns = times_ns
    roll, scale_variance, extra_noise, seen_theta = numbers
    heading_noise, bias_noise, offset_noise = noise
    x_out, F_out, P_out, Q, x_prior, P_prior, propagated, makes_step = out
    identity = np.eye(N_STATES)
    before = first
    for k in range(len(t_ns)):
        dt_s, gyro = (t_ns[k] - last_ns) * 1e-9, is_gyro[k]
        if t_ns[k] - gyro_ns > grace_ns or dt_s < 0.0 or (gyro and not dt_s > 0.0):
            return k
        row = propagated[k]
        row[:] = before
        x_prior[k], P_prior[k], F_out[k], makes_step[k] = x, P, identity, False
        if dt_s > 0.0:
            rate, done = before[RATE], before[RATE - 1]
            turned = rate * dt_s
            if gyro:
                turned = 0.5 * (rate + steps[k, 0]) * (t_ns[k] - gyro_ns) * 1e-9 - done
                if done != 0.0 and abs(turned - 0.5 * (rate + steps[k, 0]) * dt_s) > SMALL_STEP_RAD:
                    return k
            corrected = turned - x[BIAS] * dt_s
            since = before[THETA] - seen_theta
            variance = _scale_variance(scale_variance, corrected, dt_s, since) + extra_noise * dt_s
            stepped(
                x,
                P,
                x_prior[k],
                F_out[k],
                Q,
                P_prior[k],
                dt_s,
                turned,
                heading_noise,
                bias_noise,
                offset_noise,
                variance,
            )
            _extend(row, dt_s, x[PSI], steps[k], roll)
            row[0], row[1], row[2] = row[0] + corrected, row[1] + turned, row[2] + corrected
            row[RATE - 1] += turned
            makes_step[k] = True
        x_out[k], P_out[k] = x_prior[k], P_prior[k]
        if gyro:
            row[RATE - 1], row[RATE] = 0.0, steps[k, 0]
            gyro_ns = t_ns[k]
        else:
            if yaw[0] == UNLIKE or t_ns[k] <= attitude_ns:
                return k
            _note_yaw(row, steps[k, 0], (t_ns[k] - attitude_ns) * 1e-9)
            attitude_ns = t_ns[k]
            if yaw[0] != NOTHING:
                if not _fuse_yaw(x_prior[k], P_prior[k], steps[k, 0], yaw, row, x_out[k], P_out[k]):
                    return k
                makes_step[k] = True
        x, P, before, last_ns = x_out[k], P_out[k], row, t_ns[k]
    return len(t_ns)


@compiled_inner
def _scale_variance(scale_variance: float, turned: float, dt_s: float, before: float) -> float:
    """Do as `fusion.estimator.propagation.Propagation` for the error of the gyroscope's scale."""
    variance = scale_variance * SCALE_TIME_S * turned * turned / dt_s
    if abs(before) > LONG_TURN_RAD:
        return max(variance, scale_variance * turned * (2.0 * before + turned))
    return variance


@compiled_inner
def _extend(row: FloatArray, dt_s: float, heading_rad: float, step: FloatArray, roll: float) -> None:
    """Extend the path of the lateral offset by a step."""
    path = (row[3], row[4], row[5], row[6], row[7], row[8])
    accel = (row[9], row[10], row[11], int(row[12]))
    force, down = (step[1], step[2], step[3]), (step[4], step[5], step[6])
    path, accel = extended_path(path, accel, dt_s, heading_rad, force, down, roll, step[7])
    row[3], row[4], row[5], row[6], row[7], row[8] = path
    row[9], row[10], row[11], row[12] = accel
    row[13] += dt_s


@compiled_inner
def _note_yaw(row: FloatArray, yaw_rad: float, interval_s: float) -> None:
    """Note the yaw and the interval of an attitude, as `fusion.estimator.sample_times.SampleTimes` does."""
    mean_s = row[17]
    row[2], row[16] = 0.0, yaw_rad
    row[17] = 0.8 * mean_s + 0.2 * min(interval_s, 3 * mean_s) if isfinite(mean_s) else interval_s


@compiled_inner
def _fuse_yaw(
    x: FloatArray,
    P: FloatArray,
    yaw_rad: float,
    yaw: tuple[int, float, float, float],
    row: FloatArray,
    x_out: FloatArray,
    P_out: FloatArray,
) -> bool:
    """Update with a yaw as `fusion.estimator.imu_yaw.fuse_imu_yaw` does; return False if that would do more."""
    use, turn_rad, variance, sigma = yaw
    H, K = np.zeros(N_STATES), np.empty((N_STATES, 1))
    H[YAW_OFFSET] = 1.0
    if use == OFFSET_ONLY:
        variance += P[PSI, PSI]
    else:
        H[PSI] = 1.0
    residual = _wrap(yaw_rad - x[PSI] - turn_rad - x[YAW_OFFSET])
    expected = predicted_variance(P, H)
    ratio = residual * residual / (sigma * sigma * (expected + variance))
    if not isfinite(residual) or not variance > 0.0 or ratio > 1.0:
        return False
    updated(x, P, H, residual, variance, x_out, P_out, K)
    row[18], row[19], row[20] = residual, ratio, expected + variance
    return bool(abs(x_out[PSI] - x[PSI]) <= SMALL_STEP_RAD)
