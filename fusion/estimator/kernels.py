"""Compiled arithmetic of the heading filter and the tilt; functions only write to arrays named ``_out``.

A call of numpy takes ten times as long as a 3 by 3 product itself, and returning a new array from compiled code costs
more than filling one of the caller's. The models are described in `fusion.estimator.models` and
`fusion.estimator.tilt`. Covariances are exactly symmetric: each pair is computed once, or averaged.
"""

from __future__ import annotations

from math import nan, sqrt

import numpy as np

from vision.compiled import compiled, compiled_inner
from vision.types import FloatArray as FloatArray

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]

PSI, BIAS, YAW_OFFSET = range(3)
N_STATES = 3
NO_FORCE = (nan, nan, nan)  # without an accelerometer sample
STATE_NAMES = ("heading_rad", "gyro_bias_rad_s", "imu_yaw_offset_rad")


@compiled
def discretised(
    F_out: FloatArray,
    Q_out: FloatArray,
    dt: float,
    heading: float,
    bias: float,
    offset: float,
    heading_variance: float,
) -> None:
    """Discretise the process model exactly over ``dt``: transition F and noise Q, (3, 3) each.

    ``heading`` to ``offset`` are those of `fusion.estimator.models.ProcessNoise`; ``heading_variance`` is additional
    variance of the heading in this step, rad^2 (a gap in the gyroscope's samples).
    """
    n2, b2, o2 = heading**2, bias**2, offset**2
    F, Q = F_out, Q_out
    F[:], Q[:] = 0.0, 0.0
    F[PSI, PSI] = F[BIAS, BIAS] = F[YAW_OFFSET, YAW_OFFSET] = 1.0
    F[PSI, BIAS] = -dt
    Q[PSI, PSI] = n2 * dt + b2 * dt**3 / 3 + heading_variance
    Q[BIAS, BIAS] = b2 * dt
    Q[YAW_OFFSET, YAW_OFFSET] = o2 * dt
    Q[PSI, BIAS] = Q[BIAS, PSI] = -b2 * dt * dt / 2


@compiled
def predicted(P: FloatArray, F: FloatArray, Q: FloatArray, P_out: FloatArray) -> None:
    """Compute the covariance (n, n) after a transition: F P F' + Q."""
    n = P.shape[0]
    FP = np.empty((n, n))
    for i in range(n):
        for j in range(n):
            total = 0.0
            for k in range(n):
                total += F[i, k] * P[k, j]
            FP[i, j] = total
    for i in range(n):
        for j in range(i + 1):
            total = 0.5 * (Q[i, j] + Q[j, i])
            for k in range(n):
                total += 0.5 * (FP[i, k] * F[j, k] + FP[j, k] * F[i, k])
            P_out[i, j] = P_out[j, i] = total


@compiled
def stepped(
    x: FloatArray,
    P: FloatArray,
    x_out: FloatArray,
    F_out: FloatArray,
    Q_out: FloatArray,
    P_out: FloatArray,
    dt: float,
    turned: float,
    heading: float,
    bias: float,
    offset: float,
    heading_variance: float,
) -> None:
    """Compute state (3,), covariance (3, 3), F and Q after ``dt`` in which the level frame turned by ``turned``.

    The bias is not subtracted from ``turned``; the other arguments are as in `discretised`.
    """
    discretised(F_out, Q_out, dt, heading, bias, offset, heading_variance)
    for i in range(x.shape[0]):
        x_out[i] = x[i]
    x_out[PSI] += turned - x[BIAS] * dt
    predicted(P, F_out, Q_out, P_out)


@compiled
def predicted_variance(P: FloatArray, H: FloatArray) -> float:
    """Return the variance of a predicted scalar measurement with H (n,): H P H'."""
    total = 0.0
    for i in range(H.shape[0]):
        if H[i] != 0.0:
            for j in range(H.shape[0]):
                total += H[i] * P[i, j] * H[j]
    return total


@compiled
def updated(
    x: FloatArray,
    P: FloatArray,
    H: FloatArray,
    residual: float,
    variance: float,
    x_out: FloatArray,
    P_out: FloatArray,
    K_out: FloatArray,
) -> None:
    """Compute state (n,), covariance (n, n) and gain (n, 1) after a scalar measurement.

    The covariance update is Joseph's form, (I - K H) P (I - K H)' + R K K', positive semidefinite for any gain.
    """
    n = x.shape[0]
    HP, K = np.empty(n), K_out[:, 0]
    S = variance
    for i in range(n):
        total = 0.0
        for j in range(n):
            total += P[i, j] * H[j]
        HP[i] = total
        S += H[i] * total
    A = np.empty((n, n))
    for i in range(n):
        K[i] = HP[i] / S
        x_out[i] = x[i] + K[i] * residual
    for i in range(n):  # A = (I - K H) P
        for j in range(n):
            A[i, j] = P[i, j] - K[i] * HP[j]
    for i in range(n):
        AH_i = 0.0
        for k in range(n):
            AH_i += A[i, k] * H[k]
        for j in range(n):
            P_out[i, j] = A[i, j] - AH_i * K[j] + variance * K[i] * K[j]
    for i in range(n):
        for j in range(i):
            P_out[i, j] = P_out[j, i] = 0.5 * (P_out[i, j] + P_out[j, i])


@compiled_inner
def turned_down(down: Vector, rate: Vector, dt: float) -> Vector:
    """Propagate the direction of gravity (3,) by a body rate: down' = down x rate, to second order in the angle."""
    gx, gy, gz = down
    p, q, r = rate
    ux, uy, uz = p * dt, q * dt, r * dt
    sx, sy, sz = gy * uz - gz * uy, gz * ux - gx * uz, gx * uy - gy * ux
    gx += sx + 0.5 * (sy * uz - sz * uy)
    gy += sy + 0.5 * (sz * ux - sx * uz)
    gz += sz + 0.5 * (sx * uy - sy * ux)
    length = sqrt(gx * gx + gy * gy + gz * gz)
    return gx / length, gy / length, gz / length


@compiled_inner
def corrected_down(
    down: Vector, bias: Vector, rate: Vector, dt: float, force: Vector, gain: float, bias_gain: float
) -> tuple[Vector, Vector]:
    """Propagate gravity's direction (3,) and bias (3,), corrected by the force; see `fusion.estimator.tilt`."""
    gx, gy, gz = down
    bx, by, bz = bias
    p, q, r = rate
    ax, ay, az = force
    length = sqrt(ax * ax + ay * ay + az * az)
    # Rotation that takes the estimate to the measurement: estimate x measured.
    ex, ey, ez = (gz * ay - gy * az) / length, (gx * az - gz * ax) / length, (gy * ax - gx * ay) / length
    step = bias_gain * dt
    bias = (bx + step * ex, by + step * ey, bz + step * ez)
    bx, by, bz = bias
    return turned_down(down, (p - gain * ex - bx, q - gain * ey - by, r - gain * ez - bz), dt), bias
