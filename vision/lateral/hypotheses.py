"""Hypotheses of the lateral offset, one for each choice of corner pairs, and their probabilities.

A hypothesis h is a pair of the floor's corners, a pair of the ceiling's, or one of each. Its log-odds against the
null hypothesis, that no pair can be relied on, are linear in the evidence x of its pairs (`EVIDENCE`), as in logistic
regression; the weights v were fitted on simulated corridors:

    log o_h = bias + v . x,    P_h = o_h / (1 + sum_g o_g)

A joint hypothesis of floor and ceiling averages both offsets by inverse variance. A filter's prediction of offset or
width multiplies the odds, with a lower limit so that strong evidence can override it. The probabilities of all
hypotheses within `SAME_OFFSET` of the best one are added, and the estimate is their mean, weighted by the odds
without the prediction.
"""

from __future__ import annotations

from math import exp, hypot, isfinite, log, nan, sqrt
from typing import NamedTuple

import numpy as np

from vision.compiled import compiled, compiled_inner
from vision.lateral.corner_pairs import EVIDENCE, N_EVIDENCE, TYPICAL_WIDTH, PictureCorners
from vision.types import FloatArray, Record, RecordArray

JOINT_WINDOW = 0.06  # in lateral offset: floor and ceiling must agree to this
MIN_CEILING, MAX_CEILING = 0.1, 6.0  # camera to ceiling over camera to floor
SAME_OFFSET = 0.08  # hypotheses nearer than this count as one offset
PRIOR_EXTRA_STD = 0.03  # of the predicted offset
PRIOR_FLOOR = 0.1  # least factor of a prediction: strong evidence overrides it
WIDTH_STD = 0.1  # of the logarithm of a known width per height: the camera's height varies
MAX_LOG_ODDS = 100.0  # keeps the exponential finite

HYPOTHESIS = np.dtype(
    [
        ("offset", np.float64),  # lateral offset over half the corridor's width, positive right
        ("offset_std", np.float64),
        ("roll_slope", np.float64),  # derivative of the offset with respect to roll, per radian
        ("log_odds", np.float64),  # against the hypothesis that no pair can be relied on
        ("floor", np.int64),  # index of the floor's pair, -1 without
        ("ceiling", np.int64),  # index of the ceiling's pair, -1 without
    ],
    align=True,
)
"""A hypothesis about the corners."""


BIAS = np.dtype(
    [
        ("floor", np.float64),  # log-odds of a floor's pair
        ("ceiling", np.float64),  # log-odds of a ceiling's pair alone
        ("joint", np.float64),  # added where a ceiling's pair joins a floor's
        ("choice", np.float64),  # times the logarithm of the number of hypotheses with the same floor's pair
    ],
    align=True,
)
"""Log-odds of a hypothesis at zero evidence."""


class OffsetWeights(NamedTuple):
    """Weights of the evidence, and the log-odds at zero evidence.

    Parameters
    ----------
    floor, ceiling
        Weights (N_EVIDENCE,) in the order of `EVIDENCE`'s fields, of a floor's and a ceiling's pair.
    bias
        Array (1,) of `BIAS`.
    """

    floor: FloatArray
    ceiling: FloatArray
    bias: RecordArray


# Maximum likelihood on simulated corridors, see `benchmarks/lateral_weights.py`. The weight of `near_wall` is set by
# hand: the simulator is no evidence of how near to walls vehicles are flown.
_FLOOR_AND_CEILING = {
    "lengths": (1.444, 0.0),
    "coverages": (0.323, 1.404),
    "vertical_ends": (0.662, 0.944),
    "transverse_crossings": (0.0, -0.794),
    "length_gap": (-1.014, -0.501),
    "vertical_ends_gap": (-0.884, -1.654),
    "vertical_crossings_gap": (-0.780, -0.991),
    "beyond_gap": (-0.803, 0.0),
    "same_polarity": (0.744, 0.573),
    "contrast_gap": (-2.001, -1.039),
    "spans": (1.186, 0.415),
    "skirtings": (1.431, 0.0),
    "symmetry": (1.627, 1.123),
    "near_wall": (-1.5, -1.5),
    "log_width": (-0.460, -0.290),
    "log_width_squared": (-1.432, -0.969),
    "log_pairs": (-0.307, -0.521),
}
WEIGHTS = OffsetWeights(
    floor=np.array([_FLOOR_AND_CEILING[name][0] for name in EVIDENCE.names or ()]),
    ceiling=np.array([_FLOOR_AND_CEILING[name][1] for name in EVIDENCE.names or ()]),
    bias=np.array([(-1.274, -0.373, -0.338, -0.464)], BIAS),
)

POSITION_TERMS = tuple(
    (EVIDENCE.names or ()).index(name) for name in ("near_wall", "log_width", "log_width_squared")
)
"""Evidence on position and corridor width: a joint hypothesis uses only the floor's, else it would count twice."""

LOG_WIDTH, LOG_WIDTH_SQUARED = POSITION_TERMS[1:]


class OffsetEstimate(NamedTuple):
    """The most probable offset; means are weighted by the odds of the hypotheses that agree on it.

    Parameters
    ----------
    offset
        Lateral offset over half the corridor's width.
    scatter, std
        Standard deviation of the hypotheses' offsets about it, and mean of their own standard deviations.
    roll_slope
        Derivative of the offset with respect to roll, per radian.
    probability
        Sum of these hypotheses' probabilities.
    floor, ceiling
        Index of the likeliest pair of the floor and of the ceiling, -1: none.
    floor_share
        Share of the floor's pair in these hypotheses' odds.
    """

    offset: float
    scatter: float
    std: float
    roll_slope: float
    probability: float
    floor: int
    ceiling: int
    floor_share: float


@compiled_inner
def roll_slope_of(pair: Record, left: Record, right: Record, floor: bool) -> float:
    """Return the derivative of a pair's offset with respect to roll, per radian."""
    tl, tr = left[pair.left].slope, right[pair.right].slope
    slope: float = 2.0 * (tl * (1.0 + tr * tr) + tr * (1.0 + tl * tl)) / (tl + tr) ** 2
    return -slope if floor else slope


@compiled_inner
def add_weighted(start: float, weights: FloatArray, evidence: FloatArray) -> float:
    """Return ``start`` plus the weighted sum of a pair's evidence."""
    for k in range(N_EVIDENCE):
        start += weights[k] * evidence[k]
    return start


@compiled
def offset_hypotheses(picture: PictureCorners, weights: OffsetWeights) -> RecordArray:
    """Return every hypothesis of the lateral offset in a picture.

    Returns
    -------
    ndarray
        Array (k,) of `HYPOTHESIS`: the ceiling's pairs alone first; then, for each pair of the floor, that pair
        alone and with every pair of the ceiling that agrees with it.
    """
    corners, bias = picture.candidates.corners, weights.bias[0]
    floor, ceiling = picture.floor.pair, picture.ceiling.pair
    n, m = len(floor), len(ceiling)
    floor_evidence = picture.floor.evidence.view(np.float64).reshape(n, N_EVIDENCE)
    ceiling_evidence = picture.ceiling.evidence.view(np.float64).reshape(m, N_EVIDENCE)
    rows = np.empty(n * (m + 1) + m, HYPOTHESIS)
    score, slope = np.zeros(m), np.empty(m)
    count = 0
    for c in range(m):
        score[c] = add_weighted(0.0, weights.ceiling, ceiling_evidence[c])
        slope[c] = roll_slope_of(ceiling[c], corners[2], corners[3], False)
        row = rows[count]
        count += 1
        row.offset, row.offset_std, row.roll_slope = ceiling[c].offset, ceiling[c].offset_std, slope[c]
        row.log_odds, row.floor, row.ceiling = score[c] + bias.ceiling, -1, c
        for k in POSITION_TERMS:
            score[c] -= weights.ceiling[k] * ceiling_evidence[c, k]
    for f in range(n):
        pair = floor[f]
        alone = add_weighted(bias.floor, weights.floor, floor_evidence[f])
        floor_slope = roll_slope_of(pair, corners[0], corners[1], True)
        first = count
        row = rows[count]
        count += 1
        row.offset, row.offset_std, row.roll_slope = pair.offset, pair.offset_std, floor_slope
        row.log_odds, row.floor, row.ceiling = alone, f, -1
        precision = 1.0 / pair.offset_std**2
        for c in range(m):
            height = pair.width / ceiling[c].width
            difference = abs(pair.offset - ceiling[c].offset)
            if difference > JOINT_WINDOW or not MIN_CEILING < height < MAX_CEILING:
                continue
            row = rows[count]
            count += 1
            share = precision / (precision + 1.0 / ceiling[c].offset_std ** 2)
            row.offset = share * pair.offset + (1.0 - share) * ceiling[c].offset
            row.offset_std = sqrt(share) * pair.offset_std
            row.roll_slope = share * floor_slope + (1.0 - share) * slope[c]
            row.log_odds, row.floor, row.ceiling = alone + score[c] + bias.joint, f, c
        for k in range(first, count):
            rows[k].log_odds += bias.choice * log(float(count - first))
    return rows[:count]


@compiled
def width_log_odds(width: FloatArray, prior_width: float, weights: OffsetWeights) -> FloatArray:
    """Return the log-odds (n,) that a known corridor width adds to each hypothesis.

    That is the logarithm of the density of the hypothesis' width given the known one, over its density in corridors
    in general, which the weights of `log_width` and `log_width_squared` already contain. Zero without a known width.

    Parameters
    ----------
    width
        Corridor width over the camera's height (n,) by each hypothesis; NaN where it does not give one.
    prior_width
        The known width over height; NaN: unknown.
    weights
        Weights of the evidence.
    """
    out = np.zeros(len(width))
    if not prior_width > 0.0:  # NaN fails too
        return out
    curvature, slope = -2.0 * weights.floor[LOG_WIDTH_SQUARED], weights.floor[LOG_WIDTH]
    usual, usual_std = slope / curvature, 1.0 / sqrt(curvature)
    for f in range(len(width)):
        if not width[f] > 0.0:
            continue
        z = log(width[f] / prior_width) / WIDTH_STD
        known = (1.0 - PRIOR_FLOOR) * exp(-0.5 * z * z) / WIDTH_STD
        y = (log(width[f] / TYPICAL_WIDTH[0]) - usual) / usual_std
        unknown = exp(-0.5 * y * y) / usual_std
        out[f] = log(known / unknown + PRIOR_FLOOR)
    return out


@compiled
def prediction_factor(offset: float, prior: float, prior_std: float) -> float:
    """Return the factor by which a filter's prediction of the offset multiplies a hypothesis' odds; 1 without one."""
    if not isfinite(prior):
        return 1.0
    z = (offset - prior) / hypot(prior_std, PRIOR_EXTRA_STD)
    return PRIOR_FLOOR + (1.0 - PRIOR_FLOOR) * exp(-0.5 * z * z)


@compiled
def most_probable_offset(
    hypotheses: RecordArray, floor_log_odds: FloatArray, prior: float, prior_std: float
) -> OffsetEstimate:
    """Find the most probable offset.

    Parameters
    ----------
    hypotheses
        Array (k,) of `HYPOTHESIS`.
    floor_log_odds
        Prior log-odds (n,) of the floor's pairs, see `width_log_odds`.
    prior, prior_std
        A filter's prediction of the offset, which selects between hypotheses; NaN: none.

    Returns
    -------
    OffsetEstimate
        Its probability is 0 where there is no hypothesis.
    """
    n = len(hypotheses)
    if n == 0:
        return OffsetEstimate(nan, nan, nan, nan, 0.0, -1, -1, 0.0)
    evidence, likely = np.empty(n), np.empty(n)
    best, most, total = 0, 0.0, 1.0  # the null hypothesis has odds of 1
    for k in range(n):
        row = hypotheses[k]
        evidence[k] = exp(min(row.log_odds, MAX_LOG_ODDS))
        likely[k] = evidence[k] * exp(floor_log_odds[row.floor]) if row.floor >= 0 else evidence[k]
        likely[k] *= prediction_factor(row.offset, prior, prior_std)
        total += likely[k]
        if likely[k] > most:
            best, most = k, likely[k]
    offset = hypotheses[best].offset
    for _ in range(2):
        moment = weight = 0.0
        for k in range(n):
            if abs(hypotheses[k].offset - offset) < SAME_OFFSET:
                moment += evidence[k] * hypotheses[k].offset
                weight += evidence[k]
        offset = moment / weight
    n_floor = len(floor_log_odds)
    share = np.zeros(n_floor + 1)  # of each floor's pair; the last is for hypotheses without one
    weight = probability = scatter = std = roll_slope = most = 0.0
    ceiling = -1
    for k in range(n):
        row = hypotheses[k]
        if abs(row.offset - offset) >= SAME_OFFSET:
            continue
        weight += evidence[k]
        probability += likely[k] / total
        scatter += evidence[k] * (row.offset - offset) ** 2
        std += evidence[k] * row.offset_std
        roll_slope += evidence[k] * row.roll_slope
        share[row.floor] += evidence[k]
        if likely[k] > most:
            ceiling, most = row.ceiling, likely[k]
    floor = int(np.argmax(share[:n_floor])) if n_floor else -1
    return OffsetEstimate(
        offset,
        sqrt(scatter / weight),
        std / weight,
        roll_slope / weight,
        probability,
        floor,
        ceiling,
        share[floor] / weight if n_floor else 0.0,
    )
