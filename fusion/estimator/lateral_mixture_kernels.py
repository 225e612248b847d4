"""Compiled update of the hypotheses of the lateral offset by a frame, and their readout.

Hypotheses and weights are those of `fusion.estimator.lateral_kernels`. Components of a frame's evidence are rows
(m, 3) of weight, offset and variance.
"""

from __future__ import annotations

from math import erf, exp, pi, sqrt

import numpy as np

from fusion.estimator.lateral_kernels import N_LATERAL, C, S, V, Y, corrected
from vision.compiled import compiled, compiled_inner
from vision.types import FloatArray, IntArray

MIN_LIKELIHOOD = 1e-12
MIN_BELIEF = 0.01  # of a hypothesis in any component, for an update to be worth while
EXPLAINED_SIGMA = 3.0
MERGE_SIGMA2 = 1.0
MERGE_VELOCITY_SIGMA2 = 2.0
PLACE_NORM = 0.1  # half widths within which components are one place
MAX_SPREAD_NORM = 0.2  # further off is another place, no matter how far


@compiled
def spread_about(evidence: FloatArray, expected: float) -> float:
    """Second moment of a frame's likelihood about an offset, within its likeliest place.

    The likeliest place are the components within `PLACE_NORM` of the one about which the most weight lies. At most
    `MAX_SPREAD_NORM` squared; negative where the frame has no component.
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
    """Offset H x of the likeliest hypothesis; NaN where there is none."""
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
    """Update hypotheses and weights by a frame, in place.

    Returned are the belief of the hypothesis that was the likeliest before, and the `spread_about` the one
    that is the likeliest now.

    ``slack`` is a variance that every component has besides. Weights come out multiplied by the likelihood to the
    power of ``temper`` and normalised.
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


@compiled_inner
def copy_hypothesis(x: FloatArray, P: FloatArray, x_out: FloatArray, P_out: FloatArray) -> None:
    """Copy one: a loop compiles in a tenth of the time that an assignment of arrays takes, for its error message."""
    for i in range(N_LATERAL):
        x_out[i] = x[i]
        for j in range(N_LATERAL):
            P_out[i, j] = P[i, j]


@compiled_inner
def sort_falling(values: FloatArray, which: IntArray) -> None:
    """Sort indices (n,), a few dozen at most, in place so that their values fall; those alike stay in order."""
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
    """Merge what has become one and drop what hardly counts; what they held is unknown.

    Parameters
    ----------
    x, P, weight
        Hypotheses, changed; ``weight`` (k + 1,).
    near
        As in `merge`.
    lost_variance, max_offset
        A hypothesis less certain than this, or beyond this, is none.
    max_count, min_weight
        So many are kept, the likeliest, if they weigh more than this.
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
    """Take in a frame: `associate`, forget, `spawn` and `reduce`; the hypotheses given are left as they are.

    Parameters
    ----------
    x, P, weight, evidence, side, aside_m, start, near
        As in `spawn`.
    slack
        As in `associate`.
    shares
        How much of the frame is new for the weights and for the state; the share of all weights that is forgotten.
    limits
        ``lost_variance`` to ``min_weight`` of `reduce`.

    Returns
    -------
    tuple
        Hypotheses, covariances, weights; belief and second moment as of `associate`.
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
    mean: FloatArray, cov: FloatArray, weight: FloatArray, tolerance: float, lasting: float, scale: float
) -> tuple[float, float, float, float, float]:
    """Offset and rate of the hypotheses within ``tolerance`` of the likeliest; at least one.

    Each offset has the variance ``lasting`` besides, and the standard deviation ``scale`` times itself.

    Returns
    -------
    tuple
        Offset and its standard deviation, rate and its own, and the probability that the offset lies within the
        tolerance.
    """
    k = len(mean)
    best = 0
    for h in range(k):
        if weight[h] > weight[best]:
            best = h
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
        variance = cov[h, Y, Y] + lasting + (scale * mean[h, Y]) ** 2
        if abs(mean[h, Y] - mean[best, Y]) < tolerance:
            y_variance += weight[h] / total * (variance + apart * apart)
            v_variance += weight[h] / total * (cov[h, V, V] + (mean[h, V] - v) ** 2)
        wide = sqrt(2.0 * variance)
        probability += 0.5 * weight[h] * (erf((tolerance - apart) / wide) + erf((tolerance + apart) / wide))
    return y, sqrt(y_variance), v, sqrt(v_variance), probability
