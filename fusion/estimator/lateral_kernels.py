"""The inner arithmetic of `fusion.estimator.lateral_offset`, compiled; what the numbers mean is said there.

Hypotheses are rows of ``x`` (k, 4) and ``P`` (k, 4, 4); ``weight`` (k + 1,) ends with that of the offset being
unknown. Components of a frame's evidence are rows (m, 3) of weight, offset and variance. Covariances come out
symmetric to the last bit: each pair of entries is computed once.
"""

from __future__ import annotations

from math import exp, pi, sqrt

import numpy as np

from vision.compiled import compiled
from vision.types import FloatArray, IntArray

Y, V, C, S = range(4)
N_LATERAL = 4
MIN_LIKELIHOOD = 1e-12
MIN_BELIEF = 0.01  # of a hypothesis in any component, for an update to be worth while
EXPLAINED_SIGMA = 3.0
MERGE_SIGMA2 = 1.0
MERGE_VELOCITY_SIGMA2 = 2.0


@compiled
def moved(
    x: FloatArray, P: FloatArray, F: FloatArray, Q: FloatArray, x_out: FloatArray, P_out: FloatArray
) -> None:
    """Carry hypotheses on: F x and F P F' + Q."""
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

    One that is further than ``max_sigma`` from what a hypothesis expects has there the variance with which it is as
    far as that: the further off, the less it counts.
    """
    for h in range(len(x)):
        residual, expected_variance = z, 0.0
        for i in range(N_LATERAL):
            residual -= H[i] * x[h, i]
            for j in range(N_LATERAL):
                expected_variance += H[i] * P[h, i, j] * H[j]
        doubted = max(variance, (residual / max_sigma) ** 2 - expected_variance)
        corrected(x[h], P[h], H, residual, doubted)


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
) -> tuple[float, float]:
    """Update hypotheses and weights by a frame, in place; return the likeliest's belief in it, and its residual.

    ``slack`` is a variance that every component has besides. Weights come out multiplied by the likelihood to the
    power of ``temper`` and normalised.
    """
    k, m = len(x), len(evidence)
    blind = 1.0
    for j in range(m):
        blind -= evidence[j, 0]
    blind = max(blind, 0.0)
    share = np.empty(m)
    best, best_belief, best_residual = -1, 0.0, 0.0
    for h in range(k):
        if best < 0 or weight[h] > weight[best]:
            best = h
    total = 0.0
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
        likelihood = max(0.5 * blind + told, MIN_LIKELIHOOD)
        weight[h] *= likelihood**temper
        total += weight[h]
        belief = told / likelihood
        if h == best:
            best_belief = belief
        if belief < MIN_BELIEF:
            continue
        mean = square = variance = 0.0
        for j in range(m):
            b = share[j] / told
            mean += b * evidence[j, 1]
            square += b * evidence[j, 1] ** 2
            variance += b * evidence[j, 2]
        if h == best:
            best_residual = mean - expected
        variance += slack + max(square - mean * mean, 0.0)
        corrected(x[h], P[h], H, mean - expected, variance * inflation / belief)
    weight[k] *= 0.5**temper
    total += weight[k]
    for h in range(k + 1):
        weight[h] /= total
    return best_belief, best_residual


@compiled
def spawn(
    x: FloatArray,
    P: FloatArray,
    weight: FloatArray,
    evidence: FloatArray,
    side: float,
    aside_m: float,
    start: FloatArray,
    share: float,
    near: float,
    x_out: FloatArray,
    P_out: FloatArray,
    weight_out: FloatArray,
) -> int:
    """Let the unknown's weight move to a frame's components: a hypothesis that explains one takes it, or a new one.

    Parameters
    ----------
    x, P, weight
        Hypotheses; weights are changed.
    evidence
        Components; the offset of each is ``side`` times that of a hypothesis, plus ``aside_m`` times its s.
    start
        Variance of y besides the component's, variances of v and c, mean and variance of s (5,) of a new hypothesis.
    share
        Of the unknown's weight that is up for the components.
    near
        A hypothesis nearer than this explains a component.
    x_out, P_out, weight_out
        New hypotheses (m, 4), (m, 4, 4) and weights (m,).

    Returns
    -------
    int
        How many are new.
    """
    k, count = len(x), 0
    free = share * weight[k]
    for j in range(len(evidence)):
        mass = free * evidence[j, 0]
        weight[k] -= mass
        y = side * (evidence[j, 1] - aside_m * start[3])
        variance = evidence[j, 2] + start[0] + aside_m * aside_m * start[4]
        nearest, least = -1, np.inf
        for h in range(k):
            apart = abs(y - x[h, Y])
            reach = max(near, EXPLAINED_SIGMA * sqrt(P[h, Y, Y] + variance))
            if apart < reach and apart < least:
                nearest, least = h, apart
        if nearest >= 0:
            weight[nearest] += mass
            continue
        x_out[count] = 0.0
        P_out[count] = 0.0
        x_out[count, Y], x_out[count, S] = y, start[3]
        P_out[count, Y, Y], P_out[count, V, V] = variance, start[1]
        P_out[count, C, C], P_out[count, S, S] = start[2], start[4]
        weight_out[count] = mass
        count += 1
    return count


@compiled
def merge(
    x: FloatArray, P: FloatArray, weight: FloatArray, order: IntArray, near: float, keep: IntArray
) -> int:
    """Merge hypotheses that have become one, in place, likeliest first.

    Two are one where both offset and velocity are alike, within their sigmas or ``near``; ``order`` (k,) is that of
    falling weight. ``keep`` (k,) is filled with the indices left; returned is how many.
    """
    n = N_LATERAL
    gone = np.zeros(len(x), np.bool_)
    d = np.empty(n)
    count = 0
    for a in range(len(order)):
        i = order[a]
        if gone[i]:
            continue
        for b in range(a + 1, len(order)):
            j = order[b]
            if gone[j]:
                continue
            y_variance = P[i, Y, Y] + P[j, Y, Y] + near * near
            v_variance = P[i, V, V] + P[j, V, V] + near * near
            if (x[j, Y] - x[i, Y]) ** 2 > MERGE_SIGMA2 * y_variance:
                continue
            if (x[j, V] - x[i, V]) ** 2 > MERGE_VELOCITY_SIGMA2 * v_variance:
                continue
            gone[j] = True
            total = weight[i] + weight[j]
            if not total > 0.0:
                continue
            p, q = weight[i] / total, weight[j] / total
            for r in range(n):
                d[r] = x[j, r] - x[i, r]
            for r in range(n):
                for c in range(r + 1):
                    P[i, r, c] = P[i, c, r] = p * P[i, r, c] + q * P[j, r, c] + p * q * d[r] * d[c]
                x[i, r] += q * d[r]
            weight[i] = total
        keep[count] = i
        count += 1
    return count
