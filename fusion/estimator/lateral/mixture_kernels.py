"""Compiled update of the lateral offset's hypotheses by a frame, and the moments that are reported.

The model is described in `gaussian_sum`. Hypotheses and weights are laid out as in
`kernels`. The components of a frame's likelihood are rows (m, 3) of weight, offset and
variance.
"""

from __future__ import annotations

from math import erf, exp, pi, sqrt

import numpy as np

from fusion.estimator.lateral.kernels import N_LATERAL, C, S, V, Y, corrected
from vision.compiled import compiled, compiled_inner
from vision.types import FloatArray, IntArray

MIN_LIKELIHOOD = 1e-12
MIN_BELIEF = 0.01  # association probability below which a hypothesis is not updated
EXPLAINED_SIGMA = 3.0  # a hypothesis within this distance explains a component
MERGE_SIGMA2 = 1.0  # squared distances within which hypotheses are merged
MERGE_VELOCITY_SIGMA2 = 2.0
PLACE_NORM = 0.1  # half widths; components closer than this form one peak
MAX_SPREAD_NORM = 0.2  # upper bound of the root of the second moment


@compiled
def spread_about(evidence: FloatArray, expected: float) -> float:
    """Return the second moment about an offset of the highest peak of a frame's likelihood.

    A peak consists of the components within `PLACE_NORM` of one of them; the highest has the most weight. The result
    is at most `MAX_SPREAD_NORM` squared, and negative if the frame has no component.
    """
    most, spread2 = 0.0, -1.0
    for i in range(len(evidence)):
        weight = square = 0.0
        for j in range(len(evidence)):
            if abs(evidence[j, 1] - evidence[i, 1]) < PLACE_NORM:
                weight += evidence[j, 0]
                square += evidence[j, 0] * ((evidence[j, 1] - expected) ** 2 + evidence[j, 2])
        if weight > most:
            most, spread2 = weight, min(square / weight, MAX_SPREAD_NORM**2)
    return spread2


@compiled_inner
def expected_offset(x: FloatArray, weight: FloatArray, H: FloatArray) -> float:
    """Return the offset H x of the most probable hypothesis; NaN if there is none."""
    best = -1
    for h in range(len(x)):
        if best < 0 or weight[h] > weight[best]:
            best = h
    if best < 0:
        return np.nan
    expected = 0.0
    for i in range(N_LATERAL):
        expected += H[i] * x[best, i]
    return expected


@compiled_inner
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
    """Update hypotheses and weights by a frame, in place, by probabilistic data association.

    Returns the association probability of the hypothesis that was the most probable one before, and `spread_about`
    the one that is now.

    ``slack`` is added to the variance of every component. Weights are multiplied by the likelihood to the power of
    ``temper`` and normalised; the variance of the state update is multiplied by ``inflation``.
    """
    k, m = len(x), len(evidence)
    blind = 1.0
    for j in range(m):
        blind -= evidence[j, 0]
    blind = max(blind, 0.0)
    share = np.empty(m)
    best, best_belief = -1, 0.0
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
        explained = 0.0
        for j in range(m):
            S_j = spread + evidence[j, 2]
            z = (evidence[j, 1] - expected) ** 2 / S_j
            share[j] = evidence[j, 0] * exp(-0.5 * z) / sqrt(2.0 * pi * S_j)
            explained += share[j]
        likelihood = max(0.5 * blind + explained, MIN_LIKELIHOOD)
        weight[h] *= likelihood**temper
        total += weight[h]
        belief = explained / likelihood
        if h == best:
            best_belief = belief
        if belief < MIN_BELIEF:
            continue
        mean = square = variance = 0.0
        for j in range(m):
            b = share[j] / explained
            mean += b * evidence[j, 1]
            square += b * evidence[j, 1] ** 2
            variance += b * evidence[j, 2]
        variance += slack + max(square - mean * mean, 0.0)
        corrected(x[h], P[h], H, mean - expected, variance * inflation / belief)
    weight[k] *= 0.5**temper
    total += weight[k]
    for h in range(k + 1):
        weight[h] /= total
    return best_belief, spread_about(evidence, expected_offset(x, weight, H))


@compiled_inner
def spawn(
    x: FloatArray,
    P: FloatArray,
    weight: FloatArray,
    evidence: FloatArray,
    side: float,
    aside_m: float,
    start: tuple[float, float, float, float, float],
    share: float,
    near: float,
    x_out: FloatArray,
    P_out: FloatArray,
    weight_out: FloatArray,
) -> int:
    """Move weight of the unknown to a frame's components: to a hypothesis that explains one, or else to a new one.

    Parameters
    ----------
    x, P, weight
        Hypotheses; weights are changed.
    evidence
        Components; the offset of each is ``side`` times that of a hypothesis, plus ``aside_m`` times its s.
    start
        Prior of a new hypothesis (5,): variance of y in addition to the component's, variances of v and c, mean and
        variance of s.
    share
        Part of the unknown's weight that is distributed to the components.
    near
        A hypothesis closer than this explains a component.
    x_out, P_out, weight_out
        New hypotheses (m, 4), (m, 4, 4) and weights (m,).

    Returns
    -------
    int
        Number of new hypotheses.
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
    """Merge similar hypotheses in place, the most probable first, preserving mean and covariance.

    Two are merged if offset and velocity agree within their sigmas or ``near``. ``order`` (k,) sorts them by falling
    weight. ``keep`` (k,) is filled with the remaining indices; their number is returned.
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


@compiled_inner
def copy_hypothesis(x: FloatArray, P: FloatArray, x_out: FloatArray, P_out: FloatArray) -> None:
    """Copy one hypothesis; loops compile in a tenth of the time of an array assignment."""
    for i in range(N_LATERAL):
        x_out[i] = x[i]
        for j in range(N_LATERAL):
            P_out[i, j] = P[i, j]


@compiled_inner
def sort_falling(values: FloatArray, which: IntArray) -> None:
    """Sort indices (n,), a few dozen at most, in place by falling value; the sort is stable."""
    for a in range(1, len(which)):
        index = which[a]
        b = a
        while b > 0 and values[which[b - 1]] < values[index]:
            which[b] = which[b - 1]
            b -= 1
        which[b] = index


@compiled
def reduce(
    x: FloatArray,
    P: FloatArray,
    weight: FloatArray,
    near: float,
    lost_variance: float,
    max_offset: float,
    max_count: int,
    min_weight: float,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Merge similar hypotheses and drop improbable ones; their weight goes to the unknown.

    Parameters
    ----------
    x, P, weight
        Hypotheses, changed; ``weight`` (k + 1,).
    near
        As in `merge`.
    lost_variance, max_offset
        A hypothesis with a larger variance or offset is dropped.
    max_count, min_weight
        Largest number of hypotheses kept, and the smallest weight.
    """
    k = len(x)
    order, keep = np.empty(k, np.int64), np.empty(k, np.int64)
    for h in range(k):
        order[h] = h
        if P[h, Y, Y] > lost_variance or abs(x[h, Y]) > max_offset:
            weight[h] = 0.0
    sort_falling(weight, order)
    n = merge(x, P, weight, order, near, keep)
    sort_falling(weight, keep[:n])
    n = min(n, max_count)
    while n > 0 and not weight[keep[n - 1]] > min_weight:
        n -= 1
    x_out, P_out = np.empty((n, N_LATERAL)), np.empty((n, N_LATERAL, N_LATERAL))
    weight_out = np.empty(n + 1)
    left = 1.0
    for i in range(n):
        copy_hypothesis(x[keep[i]], P[keep[i]], x_out[i], P_out[i])
        weight_out[i] = weight[keep[i]]
        left -= weight_out[i]
    weight_out[n] = max(left, 0.0)
    return x_out, P_out, weight_out


@compiled
def update_with_frame(
    x: FloatArray,
    P: FloatArray,
    weight: FloatArray,
    evidence: FloatArray,
    side: float,
    aside_m: float,
    slack: float,
    shares: tuple[float, float, float],
    start: tuple[float, float, float, float, float],
    near: float,
    limits: tuple[float, float, int, float],
) -> tuple[FloatArray, FloatArray, FloatArray, float, float]:
    """Update by a frame: `associate`, forget, `spawn` and `reduce`; the inputs are not changed.

    Parameters
    ----------
    x, P, weight, evidence, side, aside_m, start, near
        As in `spawn`.
    slack
        As in `associate`.
    shares
        Independent part of the frame, for the weights and for the state; the part of all weights that is forgotten.
    limits
        ``lost_variance`` to ``min_weight`` of `reduce`.

    Returns
    -------
    tuple
        Hypotheses, covariances, weights; association probability and second moment as in `associate`.
    """
    k, m = len(x), len(evidence)
    all_x, all_P = np.empty((k + m, N_LATERAL)), np.empty((k + m, N_LATERAL, N_LATERAL))
    old, new_weight = np.empty(k + 1), np.empty(m)
    for h in range(k + 1):
        old[h] = weight[h]
        if h < k:
            copy_hypothesis(x[h], P[h], all_x[h], all_P[h])
    H = np.zeros(N_LATERAL)
    H[Y], H[S] = side, aside_m
    belief, spread2 = associate(all_x[:k], all_P[:k], old, evidence, H, slack, shares[0], 1.0 / shares[1])
    for h in range(k):
        old[k] += shares[2] * old[h]
        old[h] *= 1.0 - shares[2]
    known_x, known_P, new_x, new_P = all_x[:k], all_P[:k], all_x[k:], all_P[k:]
    n = spawn(
        known_x, known_P, old, evidence, side, aside_m, start, shares[0], near, new_x, new_P, new_weight
    )
    all_weight = np.empty(k + n + 1)
    for h in range(k + n):
        all_weight[h] = old[h] if h < k else new_weight[h - k]
    all_weight[k + n] = old[k]
    x_out, P_out, weight_out = reduce(all_x[: k + n], all_P[: k + n], all_weight, near, *limits)
    return x_out, P_out, weight_out, belief, spread2


@compiled
def summarised(
    mean: FloatArray,
    cov: FloatArray,
    weight: FloatArray,
    tolerance: float,
    lasting: tuple[float, float],
    scale: float,
) -> tuple[float, float, float, float, float]:
    """Return the moments of the hypotheses within ``tolerance`` of the most probable one; at least one.

    The variance ``lasting + (scale y)^2`` is added to that of each offset y, with the first value of ``lasting`` for
    the probability and the second one for the standard deviation.

    Returns
    -------
    tuple
        Offset and its standard deviation, rate and its standard deviation, and the probability that the offset is
        within the tolerance.
    """
    k = len(mean)
    best = 0
    for h in range(k):
        if weight[h] > weight[best]:
            best = h
    usual, whole = lasting
    total = y = v = 0.0
    for h in range(k):
        if abs(mean[h, Y] - mean[best, Y]) < tolerance:
            total += weight[h]
            y += weight[h] * mean[h, Y]
            v += weight[h] * mean[h, V]
    y, v = y / total, v / total
    y_variance = v_variance = probability = 0.0
    for h in range(k):
        apart = mean[h, Y] - y
        variance = cov[h, Y, Y] + usual + (scale * mean[h, Y]) ** 2
        if abs(mean[h, Y] - mean[best, Y]) < tolerance:
            y_variance += weight[h] / total * (variance - usual + whole + apart * apart)
            v_variance += weight[h] / total * (cov[h, V, V] + (mean[h, V] - v) ** 2)
        wide = sqrt(2.0 * variance)
        probability += 0.5 * weight[h] * (erf((tolerance - apart) / wide) + erf((tolerance + apart) / wide))
    return y, sqrt(y_variance), v, sqrt(v_variance), probability
