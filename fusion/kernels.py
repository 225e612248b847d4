"""The filter's inner arithmetic, compiled: calling numpy takes ten times as long as a 5 by 5 product itself.

What the numbers mean is said in `fusion.models`, whose functions stand before these. Every function returns new
arrays. Covariances come out symmetric to the last bit: each pair of entries is computed once, or averaged.
"""

from __future__ import annotations

from math import cos, exp, expm1, sin

import numpy as np
import numpy.typing as npt

from vision.compiled import compiled

FloatArray = npt.NDArray[np.float64]

PSI, BIAS, OFFSET, Y, V = range(5)
N_STATES = 5


@compiled
def propagated(
    x: FloatArray, dt: float, turned: float, v_time_s: float, forward: float, sideways: float
) -> FloatArray:
    """See `fusion.models.propagate`."""
    change = turned - x[BIAS] * dt
    middle = x[PSI] + 0.5 * change
    out = x.copy()
    out[PSI] += change
    out[Y] += (forward * sin(middle) + sideways * cos(middle)) * dt - v_time_s * expm1(-dt / v_time_s) * x[V]
    out[V] *= exp(-dt / v_time_s)
    return out


@compiled
def _wander(x: float, v_std: float, time_s: float) -> tuple[float, float, float]:
    """Covariance of (y, v) gained by a Gauss-Markov velocity over ``x`` correlation times."""
    fall = -expm1(-x)
    if x < 0.05:  # the closed form cancels to third order
        yy = x**3 * (2 / 3 - x / 2 + 7 * x * x / 30 - x**3 / 12 + 31 * x**4 / 1260)
    else:
        yy = 2 * x - 2 * fall - fall * fall
    return (v_std * time_s) ** 2 * yy, v_std**2 * time_s * fall * fall, -(v_std**2) * expm1(-2 * x)


@compiled
def discretised(
    dt: float,
    heading: float,
    bias: float,
    offset: float,
    v_std: float,
    v_time_s: float,
    c: float,
    heading_variance: float,
) -> tuple[FloatArray, FloatArray]:
    """See `fusion.models.transition`."""
    n2, b2, o2 = heading**2, bias**2, offset**2
    F = np.eye(N_STATES)
    F[PSI, BIAS] = -dt
    F[Y, PSI] = c * dt
    F[Y, BIAS] = -c * dt * dt / 2
    F[Y, V] = -v_time_s * expm1(-dt / v_time_s)
    F[V, V] = exp(-dt / v_time_s)
    Q = np.zeros((N_STATES, N_STATES))
    Q[PSI, PSI] = n2 * dt + b2 * dt**3 / 3 + heading_variance
    Q[BIAS, BIAS] = b2 * dt
    Q[OFFSET, OFFSET] = o2 * dt
    Q[PSI, BIAS] = Q[BIAS, PSI] = -b2 * dt * dt / 2
    Q[Y, PSI] = c * (n2 * dt**2 / 2 + b2 * dt**4 / 8)
    Q[Y, BIAS] = -c * b2 * dt**3 / 6
    Q[PSI, Y], Q[BIAS, Y] = Q[Y, PSI], Q[Y, BIAS]
    q_yy, q_yv, q_vv = _wander(dt / v_time_s, v_std, v_time_s)
    Q[Y, Y] = q_yy + c * c * (n2 * dt**3 / 3 + b2 * dt**5 / 20)
    Q[Y, V] = Q[V, Y] = q_yv
    Q[V, V] = q_vv
    return F, Q


@compiled
def predicted(P: FloatArray, F: FloatArray, Q: FloatArray) -> FloatArray:
    """Covariance (n, n) after a transition: F P F' + Q."""
    n = P.shape[0]
    FP, out = np.empty((n, n)), np.empty((n, n))
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
            out[i, j] = out[j, i] = total
    return out


@compiled
def stepped(
    x: FloatArray,
    P: FloatArray,
    dt: float,
    turned: float,
    heading: float,
    bias: float,
    offset: float,
    v_std: float,
    v_time_s: float,
    forward: float,
    sideways: float,
    heading_variance: float,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """See `fusion.models.step`."""
    middle = x[PSI] + 0.5 * (turned - x[BIAS] * dt)
    c = forward * cos(middle) - sideways * sin(middle)
    F, Q = discretised(dt, heading, bias, offset, v_std, v_time_s, c, heading_variance)
    return propagated(x, dt, turned, v_time_s, forward, sideways), F, predicted(P, F, Q)


@compiled
def spread(P: FloatArray, H: FloatArray) -> float:
    """Variance of a scalar that depends on the state by H (n,): H P H'."""
    total = 0.0
    for i in range(H.shape[0]):
        if H[i] != 0.0:
            for j in range(H.shape[0]):
                total += H[i] * P[i, j] * H[j]
    return total


@compiled
def updated(
    x: FloatArray, P: FloatArray, H: FloatArray, residual: float, variance: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """State (n,), covariance (n, n) and gain (n,) after a scalar measurement.

    The covariance is Joseph's form, (I - K H) P (I - K H)' + R K K', positive whatever the gain.
    """
    n = x.shape[0]
    K, HP = np.empty(n), np.empty(n)
    S = variance
    for i in range(n):
        total = 0.0
        for j in range(n):
            total += P[i, j] * H[j]
        HP[i] = total
        S += H[i] * total
    x_new, A, out = np.empty(n), np.empty((n, n)), np.empty((n, n))
    for i in range(n):
        K[i] = HP[i] / S
        x_new[i] = x[i] + K[i] * residual
    for i in range(n):  # A = (I - K H) P
        for j in range(n):
            A[i, j] = P[i, j] - K[i] * HP[j]
    for i in range(n):
        AH_i = 0.0
        for k in range(n):
            AH_i += A[i, k] * H[k]
        for j in range(n):
            out[i, j] = A[i, j] - AH_i * K[j] + variance * K[i] * K[j]
    for i in range(n):
        for j in range(i):
            out[i, j] = out[j, i] = 0.5 * (out[i, j] + out[j, i])
    return x_new, out, K
