"""Compiled prediction and scalar update of the lateral offset's hypotheses; see `gaussian_sum`.

Hypotheses are rows of ``x`` (k, 4) and ``P`` (k, 4, 4); the last element of ``weight`` (k + 1,) is the probability
that the offset is unknown. Covariances are exactly symmetric: each pair of entries is computed once. The update of
the sum by a frame is in `mixture_kernels`.
"""

from __future__ import annotations

from math import cos, exp, expm1, sin, sqrt

import numpy as np

from fusion.estimator.kernels import Vector
from vision.compiled import compiled
from vision.types import FloatArray

Y, V, C, S = range(4)
N_LATERAL = 4
ACCEL_SHARE = 0.9  # part of a path that accelerometer samples must cover for it to be used
MAX_SILENCE_S = 0.1  # longest time for which the accelerometer's last sample is held
ROUGHNESS_SAMPLES = 100  # memory of the accelerometer's noise density

PathNumbers = tuple[float, float, float, float, float, float]
MotionNoise = tuple[float, float, float, float, float, float, float]
AccelerationNumbers = tuple[float, float, float, int]


@compiled
def levelled(force: Vector, down: Vector, roll_rad: float) -> tuple[float, float]:
    """Return the specific force forward and right in the level frame, m/s^2.

    Parameters
    ----------
    force
        Specific force, body FRD.
    down
        Unit vector of gravity's direction in the body.
    roll_rad
        Correction of the level frame's roll, from the frames' verticals.
    """
    dx, dy, dz = down
    fx, fy, fz = force
    horizontal = max(sqrt(dy * dy + dz * dz), 0.09)
    right = (dz * fy - dy * fz) / horizontal
    along = dx * fx + dy * fy + dz * fz
    forward = (fx - dx * along) / horizontal
    return forward, right - roll_rad * along


@compiled
def extended_path(
    path: PathNumbers,
    accel: AccelerationNumbers,
    dt_s: float,
    heading_rad: float,
    force: Vector,
    down: Vector,
    roll_rad: float,
    follows_force: float,
) -> tuple[PathNumbers, AccelerationNumbers]:
    """Extend a path by ``dt_s``, with the specific force at the end of the step; NaN without a sample.

    ``path`` and ``accel`` are the fields of a `gaussian_sum.Path` and ``Acceleration``; ``follows_force`` is 1 if the
    accelerometer corrects the tilt, else 0; the other arguments are as in `levelled`.
    """
    t_s, accel_s, a1, a2, noise, leaning_s = path
    last, silent_s, density2, n = accel
    if force[0] == force[0]:
        forward, right = levelled(force, down, roll_rad)
        a = sin(heading_rad) * forward + cos(heading_rad) * right
        mean = 0.5 * (a + last) if n else a
        if n:
            n = min(n + 1, ROUGHNESS_SAMPLES)
            density2 += (0.5 * (a - last) ** 2 * (silent_s + dt_s) - density2) / n
        else:
            n = 1
        last, silent_s = a, 0.0
    else:
        mean = last
        silent_s += dt_s
    if n and silent_s <= MAX_SILENCE_S:
        accel_s += dt_s
        a2 += (a1 + 0.5 * mean * dt_s) * dt_s
        a1 += mean * dt_s
        noise += density2 * dt_s
    else:
        a2 += a1 * dt_s
    leaning_s += follows_force * dt_s
    return (t_s + dt_s, accel_s, a1, a2, noise, leaning_s), (last, silent_s, density2, n)


@compiled
def moved(
    x: FloatArray, P: FloatArray, F: FloatArray, Q: FloatArray, x_out: FloatArray, P_out: FloatArray
) -> None:
    """Predict hypotheses: F x and F P F' + Q."""
    n = N_LATERAL
    FP = np.empty((n, n))
    for h in range(len(x)):
        for i in range(n):
            total = 0.0
            for j in range(n):
                total += F[i, j] * x[h, j]
            x_out[h, i] = total
            for j in range(n):
                total = 0.0
                for k in range(n):
                    total += F[i, k] * P[h, k, j]
                FP[i, j] = total
        for i in range(n):
            for j in range(i + 1):
                total = Q[i, j]
                for k in range(n):
                    total += 0.5 * (FP[i, k] * F[j, k] + FP[j, k] * F[i, k])
                P_out[h, i, j] = P_out[h, j, i] = total


@compiled
def fill_transition(
    path: PathNumbers,
    noise: MotionNoise,
    backward: bool,
    F: FloatArray,
    Q: FloatArray,
) -> None:
    """Fill in F (4, 4) and Q (4, 4) of a path of non-zero length; see `gaussian_sum.transition`.

    Parameters
    ----------
    path
        The fields of a `gaussian_sum.Path`.
    noise
        One over the half width, accel_noise, accel_bias_walk, leaning_walk, rough_limit, velocity_std_m_s and
        velocity_time_s of an `OffsetModel`.
    backward
        Whether the transition is from the end of the path to its start.
    F, Q
        Output.
    """
    t, accel_s, a1, a2, rough, leaning_s = path
    scale, accel_noise, bias_walk, leaning_walk, rough_limit, v_std, tau = noise
    F[:], Q[:] = 0.0, 0.0
    for k in range(N_LATERAL):
        F[k, k] = 1.0
    n2, b2 = scale**2 * (rough / t + accel_noise**2), (scale * bias_walk) ** 2
    b2 += (scale * leaning_walk) ** 2 * leaning_s / t
    sign = -1.0 if backward else 1.0
    Q[C, C] = b2 * t
    if accel_s < ACCEL_SHARE * t or n2 > (scale * rough_limit) ** 2:
        x, std = t / tau, scale * v_std
        fall = -expm1(-x)
        yy = 2 * x - 2 * fall - fall * fall if x > 0.05 else x**3 * (2 / 3 - x / 2 + 7 * x * x / 30)
        F[Y, V], F[V, V] = sign * tau * fall, exp(-x)  # a stationary process is the same in either direction
        Q[Y, Y] = (std * tau) ** 2 * yy
        Q[Y, V] = Q[V, Y] = sign * std**2 * tau * fall * fall
        Q[V, V] = -(std**2) * expm1(-2 * x)
        return
    F[Y, V], F[Y, C], F[V, C] = sign * t, -0.5 * t * t, -sign * t
    F[V, S] = sign * a1
    F[Y, S] = t * a1 - a2 if backward else a2
    # The noise of the reversed transition, F^-1 Q F^-T, equals the forward one with time reversed.
    Q[Y, Y] = n2 * t**3 / 3 + b2 * t**5 / 20
    Q[Y, V] = Q[V, Y] = sign * (n2 * t**2 / 2 + b2 * t**4 / 8)
    Q[V, V] = n2 * t + b2 * t**3 / 3
    Q[Y, C] = Q[C, Y] = -b2 * t**3 / 6
    Q[V, C] = Q[C, V] = -sign * b2 * t**2 / 2


@compiled
def propagated_along(
    x: FloatArray,
    P: FloatArray,
    path: PathNumbers,
    noise: MotionNoise,
    backward: bool,
) -> tuple[FloatArray, FloatArray]:
    """Return hypotheses (k, 4), (k, 4, 4) predicted along a path, or backward along it; see `fill_transition`."""
    F, Q = np.empty((N_LATERAL, N_LATERAL)), np.empty((N_LATERAL, N_LATERAL))
    fill_transition(path, noise, backward, F, Q)
    x_out, P_out = np.empty_like(x), np.empty_like(P)
    moved(x, P, F, Q, x_out, P_out)
    return x_out, P_out


@compiled
def corrected(x: FloatArray, P: FloatArray, H: FloatArray, residual: float, variance: float) -> None:
    """Update one hypothesis (4,), (4, 4) in place by a scalar measurement, in Joseph's form."""
    n = N_LATERAL
    HP, K, AH, A = np.empty(n), np.empty(n), np.zeros(n), np.empty((n, n))
    innovation = variance
    for i in range(n):
        HP[i] = 0.0
        for j in range(n):
            HP[i] += P[i, j] * H[j]
        innovation += H[i] * HP[i]
    for i in range(n):
        K[i] = HP[i] / innovation
        x[i] += K[i] * residual
    for i in range(n):
        for j in range(n):
            A[i, j] = P[i, j] - K[i] * HP[j]
            AH[i] += A[i, j] * H[j]
    for i in range(n):
        for j in range(i + 1):
            both = A[i, j] - AH[i] * K[j] + A[j, i] - AH[j] * K[i]
            P[i, j] = P[j, i] = 0.5 * both + variance * K[i] * K[j]


@compiled
def correct_all(
    x: FloatArray, P: FloatArray, H: FloatArray, z: float, variance: float, max_sigma: float
) -> None:
    """Update every hypothesis in place by one scalar measurement.

    If the residual of a hypothesis exceeds ``max_sigma`` standard deviations, the variance is inflated until it
    equals ``max_sigma``: outliers count the less, the further off they are.
    """
    for h in range(len(x)):
        residual, expected_variance = z, 0.0
        for i in range(N_LATERAL):
            residual -= H[i] * x[h, i]
            for j in range(N_LATERAL):
                expected_variance += H[i] * P[h, i, j] * H[j]
        inflated = max(variance, (residual / max_sigma) ** 2 - expected_variance)
        corrected(x[h], P[h], H, residual, inflated)
