"""The geometric evidence for the lateral offset: all pairs of candidates for corners, as a mixture.

`vision.lateral.offset` answers where one offset holds nearly all of the probability. Here every pair of the floor, of the
ceiling, and of both together, keeps its share: brick courses, tiles and rails then stand beside the corners until
time and motion tell them apart. Twice as many candidates are taken, for among bricks the corners are not the longest.

The joint hypotheses are those of `vision.lateral.offset` but that, for each pair of the floor, all pairs of the ceiling
at its offset are summed to one; sorted sums make that as cheap as the pairs themselves.
"""

from __future__ import annotations

from math import exp, log

import numpy as np
import numpy.typing as npt

from vision.axis.vanishing_point import AxisFit
from vision.compiled import compiled
from vision.lateral.corner_pairs import (
    ASIDE,
    CROWD,
    LENGTHS,
    N_PAIR,
    OFFSET,
    OFFSET_STD,
    WIDTH,
    survey_lines,
)
from vision.lateral.mixture import OffsetMixture, cannot_tell, mixture_of_rows
from vision.lateral.offset import BIASES, JOINT_WINDOW, MIN_STD, WEIGHTS, tilt_of_pair
from vision.lines.segments import LineSet

FloatArray = npt.NDArray[np.float64]

MAX_CANDIDATES = 24  # in a quadrant
CANNOT_TELL = 0.1  # at least, whatever the lines look like: what runs along a corridor need not be its corner
MAX_SCORE = 100.0  # beyond the range of exp

# columns of sums over pairs of the ceiling
SUM_ODDS, SUM_OFFSET, SUM_SQUARE, SUM_TILT = range(4)


@compiled
def _scores(pairs: FloatArray, weights: FloatArray, shared: FloatArray) -> FloatArray:
    """Weighted evidence (n,) of pairs; ``shared`` (n,) is the part that the floor tells where both are seen."""
    score = np.zeros(len(pairs))
    for p in range(len(pairs)):
        shared[p] = 0.0
        for k in range(LENGTHS, N_PAIR):
            value = weights[k - LENGTHS] * pairs[p, k]
            score[p] += value
            if ASIDE <= k < CROWD:
                shared[p] += value
    return score


@compiled
def components(
    floor: FloatArray,
    ceiling: FloatArray,
    corners: FloatArray,
    roll_std: float,
    weights: FloatArray,
    biases: FloatArray,
) -> FloatArray:
    """Return components (2 n + m, 4) as `vision.lateral.mixture` counts them, weights as odds against "cannot tell"."""
    n, m = len(floor), len(ceiling)
    rows = np.empty((2 * n + m, 4))
    shared = np.empty(max(n, m))
    score = _scores(ceiling, weights[1], shared)
    order = np.argsort(ceiling[:, OFFSET])
    offsets = ceiling[order, OFFSET]
    sums = np.zeros((m + 1, 4))
    for place in range(m):
        c = order[place]
        tilt = tilt_of_pair(ceiling[c], corners, 2)
        variance = ceiling[c, OFFSET_STD] ** 2
        row = rows[c]
        row[0], row[1] = exp(min(score[c] + biases[1], MAX_SCORE)), ceiling[c, OFFSET]
        row[2], row[3] = variance + (roll_std * tilt) ** 2, np.nan
        odds = exp(min(score[c] - shared[c], MAX_SCORE))
        sums[place + 1, SUM_ODDS] = sums[place, SUM_ODDS] + odds
        sums[place + 1, SUM_OFFSET] = sums[place, SUM_OFFSET] + odds * ceiling[c, OFFSET]
        sums[place + 1, SUM_SQUARE] = sums[place, SUM_SQUARE] + odds * (variance + ceiling[c, OFFSET] ** 2)
        sums[place + 1, SUM_TILT] = sums[place, SUM_TILT] + odds * tilt
    alone = _scores(floor, weights[0], shared)
    for f in range(n):
        first = np.searchsorted(offsets, floor[f, OFFSET] - JOINT_WINDOW)
        last = np.searchsorted(offsets, floor[f, OFFSET] + JOINT_WINDOW)
        choice = biases[3] * log(float(last - first + 1))
        tilt = tilt_of_pair(floor[f], corners, 0)
        variance = floor[f, OFFSET_STD] ** 2
        single, joint = rows[m + f], rows[m + n + f]
        single[0] = exp(min(alone[f] + biases[0] + choice, MAX_SCORE))
        single[1], single[2], single[3] = floor[f, OFFSET], variance + (roll_std * tilt) ** 2, floor[f, WIDTH]
        joint[:] = single
        joint[0] = 0.0
        odds = sums[last, SUM_ODDS] - sums[first, SUM_ODDS]
        if not odds > 0.0:
            continue
        above = (sums[last, SUM_OFFSET] - sums[first, SUM_OFFSET]) / odds
        above_variance = max(
            (sums[last, SUM_SQUARE] - sums[first, SUM_SQUARE]) / odds - above * above, 1e-8
        )
        share = above_variance / (above_variance + variance)
        joint[0] = exp(min(alone[f] + biases[0] + biases[2] + choice + log(odds), MAX_SCORE))
        joint[1] = share * floor[f, OFFSET] + (1.0 - share) * above
        tilt = share * tilt + (1.0 - share) * (sums[last, SUM_TILT] - sums[first, SUM_TILT]) / odds
        joint[2] = share * variance + (roll_std * tilt) ** 2
    return rows


def geometric_mixture(
    lines: LineSet, axis: AxisFit, R_level_camera: FloatArray, roll_std_rad: float
) -> OffsetMixture:
    """Return what the lines say about the lateral offset.

    Parameters
    ----------
    lines, axis
        The segments and the corridor's axis among them.
    R_level_camera
        Rotation (3, 3) from the optical frame to the level frame.
    roll_std_rad
        Standard deviation of the level frame's roll: it tilts left against right.
    """
    corners, floor, ceiling = survey_lines(lines, axis, R_level_camera, MAX_CANDIDATES)
    if not len(floor) and not len(ceiling):
        return cannot_tell()
    rows = components(floor, ceiling, corners, roll_std_rad, WEIGHTS, BIASES)
    return mixture_of_rows(rows, 1.0, MIN_STD**2).less_sure(CANNOT_TELL)
