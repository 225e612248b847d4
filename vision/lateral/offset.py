"""Lateral offset from the corners where the two walls meet floor and ceiling, scale-free.

A line on the left wall at height z below the camera has, in the cross-section, the slope ``t = z / w_L`` below the
horizontal, one at the same height on the right wall ``z / w_R``; so the pair gives ``y / (W / 2) = (w_L - w_R) / (w_L
+ w_R) = (t_R - t_L) / (t_R + t_L)``.

Which two lines are the corners is the question: skirting boards, wainscots, furniture and joints of the floor run
along the corridor too. `vision.lateral.corner_pairs` gathers what speaks for every pair of candidates below the
camera and above it; here a pair of the floor, one of the ceiling, or both together, are weighed. The weighted sum is
the logarithm of the odds that these are the corners rather than nothing to be relied on, and the offset is answered
where it holds nearly all of the probability.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, hypot, isfinite, log, nan, sqrt

import numpy as np
import numpy.typing as npt

from vision.axis.vanishing_point import AxisFit
from vision.compiled import compiled
from vision.lateral.corner_candidates import LINE, SLOPE
from vision.lateral.corner_pairs import (
    ASIDE,
    CROWD,
    LEFT,
    LENGTHS,
    N_PAIR,
    OFFSET,
    OFFSET_STD,
    RIGHT,
    WIDTH,
    survey_lines,
)
from vision.lines.segments import LineSet

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

JOINT_WINDOW = 0.06
MIN_CEILING, MAX_CEILING = 0.1, 6.0  # camera to ceiling over camera to floor

SAME_OFFSET = 0.08  # hypotheses nearer than this are one answer
MIN_PROBABILITY = 0.97
MIN_WIDTH_SHARE = 0.3  # of the answer, for the floor's pair to give the width
MIN_STD = 0.004
SCATTER_SHARE = 0.64  # of the hypotheses' variance: they err together only in part
DOUBT = 0.02  # variance for what probability is left to others
PRIOR_SLACK = 0.03
PRIOR_FLOOR = 0.1  # lets strong evidence win

# columns of hypotheses
H_OFFSET, H_STD, H_TILT, H_SCORE, H_FLOOR, H_CEILING = range(6)

# Weights of the evidence of a floor's and a ceiling's pair, by maximum likelihood on simulated corridors
# (`benchmarks/lateral_weights.py` fits them anew); how far aside one flies is no matter of the simulator, and set.
WEIGHTS = np.array(
    [
        (1.444, 0.0),  # LENGTHS
        (0.323, 1.404),  # COVERAGES
        (0.662, 0.944),  # ENDINGS
        (0.0, -0.794),  # CROSSEDS
        (-1.014, -0.501),  # LENGTH_GAP
        (-0.884, -1.654),  # ENDING_GAP
        (-0.780, -0.991),  # CROSSING_GAP
        (-0.803, 0.0),  # BEYOND_GAP
        (0.744, 0.573),  # SAME_POLARITY
        (-2.001, -1.039),  # CONTRAST_GAP
        (1.186, 0.415),  # SPANS
        (1.431, 0.0),  # BOARDS
        (1.627, 1.123),  # VOTES
        (-1.5, -1.5),  # ASIDE
        (-0.460, -0.290),  # WIDE
        (-1.432, -0.969),  # WIDE_SQUARED
        (-0.307, -0.521),  # CROWD
    ]
).T.copy()
# Logarithms of the odds of a floor's pair alone and a ceiling's alone, of a ceiling's added to a floor's, and by the
# logarithm of the number of ceilings to choose from
BIASES = np.array([-1.274, -0.373, -0.338, -0.464])


@dataclass(frozen=True, slots=True, eq=False)
class LateralFit:
    """Where in the cross-section the camera is.

    Parameters
    ----------
    offset_norm, offset_norm_std
        Offset right of the centre line over half the width.
    width_per_height
        Corridor width over camera height above the floor; NaN where only the ceiling was seen.
    wall_lines
        Indices (k,) of the lines taken for the corners of wall and floor, wall and ceiling.
    """

    offset_norm: float
    offset_norm_std: float
    width_per_height: float
    wall_lines: npt.NDArray[np.intp]


@compiled
def _tilt(row: FloatArray, corners: FloatArray, quadrant: int) -> float:
    """Return by how much a radian of roll moves the offset of a pair."""
    tl, tr = corners[quadrant, int(row[LEFT]), SLOPE], corners[quadrant + 1, int(row[RIGHT]), SLOPE]
    change: float = 2.0 * (tl * (1.0 + tr * tr) + tr * (1.0 + tl * tl)) / (tl + tr) ** 2
    return change if quadrant else -change


@compiled
def _hypotheses(
    floor: FloatArray, ceiling: FloatArray, corners: FloatArray, weights: FloatArray, biases: FloatArray
) -> FloatArray:
    """Return the hypotheses (k, 6): a pair of the floor, of the ceiling, or both."""
    n, m = len(floor), len(ceiling)
    rows = np.empty((n * (m + 1) + m, 6))
    score, tilt = np.zeros(m), np.empty(m)
    count = 0
    for c in range(m):
        for k in range(LENGTHS, N_PAIR):
            score[c] += weights[1, k - LENGTHS] * ceiling[c, k]
        tilt[c] = _tilt(ceiling[c], corners, 2)
        row = rows[count]
        count += 1
        row[H_OFFSET], row[H_STD], row[H_TILT] = ceiling[c, OFFSET], ceiling[c, OFFSET_STD], tilt[c]
        row[H_SCORE], row[H_FLOOR], row[H_CEILING] = score[c] + biases[1], -1, c
        for k in range(ASIDE, CROWD):  # together with the floor it is the floor's width that counts
            score[c] -= weights[1, k - LENGTHS] * ceiling[c, k]
    for f in range(n):
        alone = biases[0]
        for k in range(LENGTHS, N_PAIR):
            alone += weights[0, k - LENGTHS] * floor[f, k]
        turn = _tilt(floor[f], corners, 0)
        first = count
        row = rows[count]
        count += 1
        row[H_OFFSET], row[H_STD], row[H_TILT] = floor[f, OFFSET], floor[f, OFFSET_STD], turn
        row[H_SCORE], row[H_FLOOR], row[H_CEILING] = alone, f, -1
        precision = 1.0 / floor[f, OFFSET_STD] ** 2
        for c in range(m):
            height = floor[f, WIDTH] / ceiling[c, WIDTH]
            apart = abs(floor[f, OFFSET] - ceiling[c, OFFSET])
            if apart > JOINT_WINDOW or not MIN_CEILING < height < MAX_CEILING:
                continue
            row = rows[count]
            count += 1
            share = precision / (precision + 1.0 / ceiling[c, OFFSET_STD] ** 2)
            row[H_OFFSET] = share * floor[f, OFFSET] + (1.0 - share) * ceiling[c, OFFSET]
            row[H_STD] = sqrt(share) * floor[f, OFFSET_STD]
            row[H_TILT] = share * turn + (1.0 - share) * tilt[c]
            row[H_SCORE], row[H_FLOOR], row[H_CEILING] = alone + score[c] + biases[2], f, c
        for k in range(first, count):
            rows[k, H_SCORE] += biases[3] * log(float(count - first))
    return rows[:count]


@compiled
def _settle(
    rows: FloatArray, n_floor: int, prior: float, prior_std: float
) -> tuple[float, float, float, float, float, int, int, float]:
    """Find the offset that most of the probability is for.

    Returns offset, its scatter among the hypotheses, their own mean std, change by roll, probability, the likeliest
    pair of the floor and of the ceiling (-1: none), and the floor pair's share of the probability.
    """
    n = len(rows)
    evidence, likely = np.empty(n), np.empty(n)
    best, most, total = 0, 0.0, 1.0  # the odds of nothing to be relied on
    for k in range(n):
        evidence[k] = likely[k] = exp(min(rows[k, H_SCORE], 100.0))
        if isfinite(prior):
            z = (rows[k, H_OFFSET] - prior) / hypot(prior_std, PRIOR_SLACK)
            likely[k] *= PRIOR_FLOOR + (1.0 - PRIOR_FLOOR) * exp(-0.5 * z * z)
        total += likely[k]
        if likely[k] > most:
            best, most = k, likely[k]
    offset = rows[best, H_OFFSET]
    for _ in range(2):
        moment = weight = 0.0
        for k in range(n):
            if abs(rows[k, H_OFFSET] - offset) < SAME_OFFSET:
                moment += evidence[k] * rows[k, H_OFFSET]
                weight += evidence[k]
        offset = moment / weight
    share = np.zeros(n_floor + 1)  # of each floor's pair; the last for none
    weight = probability = scatter = std = tilt = most = 0.0
    ceiling = -1
    for k in range(n):
        if abs(rows[k, H_OFFSET] - offset) >= SAME_OFFSET:
            continue
        weight += evidence[k]
        probability += likely[k] / total
        scatter += evidence[k] * (rows[k, H_OFFSET] - offset) ** 2
        std += evidence[k] * rows[k, H_STD]
        tilt += evidence[k] * rows[k, H_TILT]
        share[int(rows[k, H_FLOOR])] += evidence[k]
        if likely[k] > most:
            ceiling, most = int(rows[k, H_CEILING]), likely[k]
    floor = int(np.argmax(share[:n_floor])) if n_floor else -1
    return (
        offset,
        sqrt(scatter / weight),
        std / weight,
        tilt / weight,
        probability,
        floor,
        ceiling,
        share[floor] / weight if n_floor else 0.0,
    )


def fit_lateral(
    lines: LineSet,
    axis: AxisFit,
    R_level_camera: FloatArray,
    roll_std_rad: float,
    prior_offset_norm: float = nan,
    prior_offset_norm_std: float = nan,
) -> LateralFit | None:
    """Find the lateral offset; None where the walls do not tell.

    Parameters
    ----------
    lines, axis
        The segments and the corridor's axis among them.
    R_level_camera
        Rotation (3, 3) from the optical frame to the level frame.
    roll_std_rad
        Standard deviation of the level frame's roll: it tilts left against right.
    prior_offset_norm, prior_offset_norm_std
        A filter's prediction, to choose between hypotheses; NaN: none.
    """
    corners, floor, ceiling = survey_lines(lines, axis, R_level_camera)
    if not len(floor) and not len(ceiling):
        return None
    rows = _hypotheses(floor, ceiling, corners, WEIGHTS, BIASES)
    offset, scatter, std, tilt, probability, f, c, floor_share = _settle(
        rows, len(floor), prior_offset_norm, prior_offset_norm_std
    )
    if probability < MIN_PROBABILITY:
        return None
    variance = (
        SCATTER_SHARE * scatter**2
        + std**2
        + (roll_std_rad * tilt) ** 2
        + MIN_STD**2
        + DOUBT * (1.0 - probability)
    )
    walls: list[int] = []
    width_per_height = nan
    if floor_share > MIN_WIDTH_SHARE:
        width_per_height = float(floor[f, WIDTH])
        walls += [int(corners[side, int(floor[f, LEFT + side]), LINE]) for side in (0, 1)]
    if c >= 0:
        walls += [int(corners[2 + side, int(ceiling[c, LEFT + side]), LINE]) for side in (0, 1)]
    return LateralFit(offset, sqrt(variance), width_per_height, np.array(walls, dtype=np.intp))
