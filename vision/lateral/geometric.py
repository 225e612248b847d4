"""Likelihood of the lateral offset by corner lines: all pairs of corner candidates as a Gaussian mixture.

`vision.lateral.offset` gives an estimate where one offset has nearly all of the probability. Here every pair of the
floor, of the ceiling, and of both together remains a component, so that a filter can distinguish corners from brick
courses, tiles and rails over time and motion.

Weights are odds, as in `vision.lateral.hypotheses`. For each pair of the floor, all pairs of the ceiling within
`JOINT_WINDOW` of its offset are replaced by one Gaussian with their total odds, mean and variance, and the two are
averaged by inverse variance. With cumulative sums over the ceiling's pairs, sorted by offset, the cost does not grow
with the number of pairs that agree.
"""

from __future__ import annotations

from math import exp, hypot, log

import numpy as np

from vision.compiled import compiled_inner
from vision.lateral.corner_pairs import N_EVIDENCE, PictureCorners, rising_order
from vision.lateral.hypotheses import (
    JOINT_WINDOW,
    MAX_LOG_ODDS,
    POSITION_TERMS,
    OffsetWeights,
    add_weighted,
    roll_slope_of,
)
from vision.lateral.mixture import fields_of_components
from vision.types import FloatArray, IntArray

MIN_CANNOT_TELL = 0.75  # a line along the corridor may not be a corner, and such errors persist over frames
CORNER_STD_NORM = 0.02  # of the corner relative to the line that represents it
MIN_VARIANCE = 1e-8

# columns of components, see `vision.lateral.mixture`
WEIGHT, OFFSET, VARIANCE, WIDTH = range(4)
# columns of the cumulative sums over the ceiling's pairs
ODDS, MOMENT, SQUARE, ROLL_SLOPE = range(4)


@compiled_inner
def _odds(log_odds: float) -> float:
    return exp(min(log_odds, MAX_LOG_ODDS))


@compiled_inner
def _ceiling_components(
    picture: PictureCorners, weights: OffsetWeights, roll_std: float, order: IntArray, rows: FloatArray
) -> FloatArray:
    """Fill ``rows`` (m, 4) with the ceiling's pairs alone; return their cumulative sums (m + 1, 4)."""
    pairs, corners = picture.ceiling.pair, picture.candidates.corners
    m = len(pairs)
    evidence = picture.ceiling.evidence.view(np.float64).reshape(m, N_EVIDENCE)
    sums = np.zeros((m + 1, 4))
    for place in range(m):
        c = order[place]
        pair = pairs[c]
        score = add_weighted(0.0, weights.ceiling, evidence[c])
        slope = roll_slope_of(pair, corners[2], corners[3], False)
        variance = pair.offset_std**2
        row = rows[place]
        row[WEIGHT], row[OFFSET] = _odds(score + weights.bias[0].ceiling), pair.offset
        row[VARIANCE], row[WIDTH] = variance + (roll_std * slope) ** 2, np.nan
        for k in POSITION_TERMS:
            score -= weights.ceiling[k] * evidence[c, k]
        odds = _odds(score)
        before, after = sums[place], sums[place + 1]
        after[ODDS] = before[ODDS] + odds
        after[MOMENT] = before[MOMENT] + odds * pair.offset
        after[SQUARE] = before[SQUARE] + odds * (variance + pair.offset**2)
        after[ROLL_SLOPE] = before[ROLL_SLOPE] + odds * slope
    return sums


@compiled_inner
def corner_components(picture: PictureCorners, weights: OffsetWeights, roll_std: float) -> FloatArray:
    """Return every pair of corners as a component (k, 4) of a mixture, see `vision.lateral.mixture`.

    Their weights are odds against the null hypothesis, that no pair can be relied on.
    """
    corners, bias = picture.candidates.corners, weights.bias[0]
    pairs = picture.floor.pair
    n, m = len(pairs), len(picture.ceiling.pair)
    evidence = picture.floor.evidence.view(np.float64).reshape(n, N_EVIDENCE)
    rows = np.zeros((2 * n + m, 4))
    # Contiguous, like the other array that is sorted, so that the sort is compiled once.
    offsets = picture.ceiling.pair["offset"].copy()
    order = rising_order(offsets)
    offsets = offsets[order]
    sums = _ceiling_components(picture, weights, roll_std, order, rows)
    for f in range(n):
        pair = pairs[f]
        first = np.searchsorted(offsets, pair.offset - JOINT_WINDOW)
        last = np.searchsorted(offsets, pair.offset + JOINT_WINDOW)
        alone = add_weighted(bias.floor, weights.floor, evidence[f]) + bias.choice * log(last - first + 1.0)
        slope, variance = roll_slope_of(pair, corners[0], corners[1], True), pair.offset_std**2
        single, joint = rows[m + f], rows[m + n + f]
        single[WEIGHT], single[OFFSET] = _odds(alone), pair.offset
        single[VARIANCE], single[WIDTH] = variance + (roll_std * slope) ** 2, pair.width
        odds = sums[last, ODDS] - sums[first, ODDS]
        if not odds > 0.0:
            continue
        offset = (sums[last, MOMENT] - sums[first, MOMENT]) / odds
        above = max((sums[last, SQUARE] - sums[first, SQUARE]) / odds - offset * offset, MIN_VARIANCE)
        share = above / (above + variance)
        slope = share * slope + (1.0 - share) * (sums[last, ROLL_SLOPE] - sums[first, ROLL_SLOPE]) / odds
        joint[WEIGHT] = _odds(alone + bias.joint + log(odds))
        joint[OFFSET] = share * pair.offset + (1.0 - share) * offset
        joint[VARIANCE], joint[WIDTH] = share * variance + (roll_std * slope) ** 2, pair.width
    return rows


@compiled_inner
def fields_of_corners(picture: PictureCorners, weights: OffsetWeights, roll_std: float) -> FloatArray:
    """Return the likelihood of the lateral offset by pairs of corners, as a mixture's fields (4, k).

    Parameters
    ----------
    picture
        Candidates for corners and their pairs.
    weights
        Weights of the evidence.
    roll_std
        Standard deviation of the level frame's roll, radians.
    """
    fields = fields_of_components(corner_components(picture, weights, roll_std), 1.0, 0.0)
    total_weight = 0.0
    for k in range(fields.shape[1]):
        total_weight += fields[0, k]
    scale = (1.0 - MIN_CANNOT_TELL) / total_weight if total_weight > 1.0 - MIN_CANNOT_TELL else 1.0
    for k in range(fields.shape[1]):
        fields[0, k] *= scale
        fields[2, k] = hypot(fields[2, k], CORNER_STD_NORM)
    return fields
