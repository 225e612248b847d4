"""The inner arithmetic of `fusion.estimator.lateral_offset`, compiled; what the numbers mean is said there.

Hypotheses are rows of ``x`` (k, 4) and ``P`` (k, 4, 4); components of a frame's evidence are rows (m, 3) of weight,
offset and variance.
"""

from __future__ import annotations

from math import exp, log, pi, sqrt

import numpy as np
import numpy.typing as npt

from vision.compiled import compiled

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

Y, V, C, S = range(4)
N_LATERAL = 4


@compiled
def moved(
    x: FloatArray, P: FloatArray, F: FloatArray, Q: FloatArray, x_out: FloatArray, P_out: FloatArray
) -> None:
    """Carry hypotheses on: F x and F P F' + s^2 Q, with each its own s: ``Q`` (4, 4) is in metres."""
    FP = np.empty((N_LATERAL, N_LATERAL))
    for h in range(len(x)):
        scale = x[h, S] ** 2 + P[h, S, S]
        for i in range(N_LATERAL):
            total = 0.0
            for j in range(N_LATERAL):
                total += F[i, j] * x[h, j]
            x_out[h, i] = total
            for j in range(N_LATERAL):
                total = 0.0
                for k in range(N_LATERAL):
                    total += F[i, k] * P[h, k, j]
                FP[i, j] = total
        for i in range(N_LATERAL):
            for j in range(i + 1):
                total = scale * Q[i, j]
                for k in range(N_LATERAL):
                    total += 0.5 * (FP[i, k] * F[j, k] + FP[j, k] * F[i, k])
                P_out[h, i, j] = P_out[h, j, i] = total


@compiled
def corrected(x: FloatArray, P: FloatArray, H: FloatArray, residual: float, variance: float) -> None:
    """Update one hypothesis (4,), (4, 4) in place by a scalar measurement (Joseph's form)."""
    n = len(x)
    HP, K = np.empty(n), np.empty(n)
    innovation = variance
    for i in range(n):
        total = 0.0
        for j in range(n):
            total += P[i, j] * H[j]
        HP[i] = total
        innovation += H[i] * total
    for i in range(n):
        K[i] = HP[i] / innovation
        x[i] += K[i] * residual
    A, AH = np.empty((n, n)), np.empty(n)
    for i in range(n):
        AH[i] = 0.0
        for j in range(n):
            A[i, j] = P[i, j] - K[i] * HP[j]
            AH[i] += A[i, j] * H[j]
    for i in range(n):
        for j in range(i + 1):
            value = 0.5 * (A[i, j] - AH[i] * K[j] + A[j, i] - AH[j] * K[i]) + variance * K[i] * K[j]
            P[i, j] = P[j, i] = value


@compiled
def associate(
    x: FloatArray,
    P: FloatArray,
    weight: FloatArray,
    evidence: FloatArray,
    H: FloatArray,
    slack: float,
    temper: float,
    inflation: float,
) -> float:
    """Update hypotheses and weights in place by a frame; return the normalised innovation squared of the likeliest.

    ``weight`` (k + 1,) ends with that of the offset being unknown. Weights come out multiplied by the likelihood to
    the power of ``temper``, not normalised. NaN where no evidence is near the likeliest hypothesis.
    """
    k, m = len(x), len(evidence)
    blind = 1.0
    for j in range(m):
        blind -= evidence[j, 0]
    blind = max(blind, 0.0)
    share = np.empty(m)
    best, nis = -1, np.nan
    for h in range(k):
        if best < 0 or weight[h] > weight[best]:
            best = h
    for h in range(k):
        expected, spread = 0.0, slack
        for i in range(N_LATERAL):
            expected += H[i] * x[h, i]
            for j in range(N_LATERAL):
                spread += H[i] * P[h, i, j] * H[j]
        told = 0.0
        for j in range(m):
            S_j = spread + evidence[j, 2]
            z = (evidence[j, 1] - expected) ** 2 / S_j
            share[j] = evidence[j, 0] * exp(-0.5 * z) / sqrt(2.0 * pi * S_j)
            told += share[j]
        likelihood = 0.5 * blind + told
        weight[h] *= max(likelihood, 1e-12) ** temper
        belief = told / max(likelihood, 1e-300)
        if not belief > 0.01:
            continue
        mean = square = variance = 0.0
        for j in range(m):
            b = share[j] / told
            mean += b * evidence[j, 1]
            square += b * evidence[j, 1] ** 2
            variance += b * evidence[j, 2]
        variance = variance + slack + max(square - mean * mean, 0.0)
        residual = mean - expected
        if h == best:
            nis = residual * residual / (spread - slack + variance)
        corrected(x[h], P[h], H, residual, variance * inflation / belief)
    weight[k] *= 0.5**temper
    return nis


@compiled
def absorb(
    x: FloatArray, P: FloatArray, weight: FloatArray, y: float, variance: float, mass: float, near: float
) -> bool:
    """Give ``mass`` to the nearest hypothesis that explains an offset; return whether there is one."""
    nearest, least = -1, np.inf
    for h in range(len(x)):
        apart = abs(y - x[h, Y])
        if apart < max(near, 3.0 * sqrt(P[h, Y, Y] + variance)) and apart < least:
            nearest, least = h, apart
    if nearest < 0:
        return False
    weight[nearest] += mass
    return True


@compiled
def merged(
    x: FloatArray, P: FloatArray, weight: FloatArray, order: IntArray, near: float, keep: IntArray
) -> int:
    """Merge hypotheses that have become one, in place, likeliest first; ``keep`` are those left, returned how many.

    Two are one where their offsets and velocities are alike within their own sigmas, or both within ``near``.
    """
    gone = np.zeros(len(x), np.bool_)
    count = 0
    for a in range(len(order)):
        i = order[a]
        if gone[i]:
            continue
        for b in range(a + 1, len(order)):
            j = order[b]
            if gone[j]:
                continue
            dy, dv = x[j, Y] - x[i, Y], x[j, V] - x[i, V]
            vy = P[i, Y, Y] + P[j, Y, Y] + near * near
            vv = P[i, V, V] + P[j, V, V] + near * near
            if dy * dy > vy or dv * dv > 2.0 * vv:
                continue
            gone[j] = True
            total = weight[i] + weight[j]
            if not total > 0.0:
                continue
            p, q = weight[i] / total, weight[j] / total
            d = np.empty(N_LATERAL)
            for r in range(N_LATERAL):
                d[r] = x[j, r] - x[i, r]
            for r in range(N_LATERAL):
                for c in range(N_LATERAL):
                    P[i, r, c] = p * P[i, r, c] + q * P[j, r, c] + p * q * d[r] * d[c]
                x[i, r] += q * d[r]
            weight[i] = total
        keep[count] = i
        count += 1
    return count
