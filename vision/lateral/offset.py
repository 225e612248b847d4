"""Lateral offset from the corners where the two walls meet floor and ceiling, scale-free.

In the corridor's cross-section, a line on the left wall at height z below the camera is seen at the slope ``t_L = z /
w_L`` below the horizontal, one at the same height on the right wall at ``t_R = z / w_R``, where w_L and w_R are the
distances to the walls. The pair gives the offset ``y / (W / 2) = (w_L - w_R) / (w_L + w_R) = (t_R - t_L) / (t_R +
t_L)``.

Which two lines are the corners is the question: skirting boards, wainscots, furniture and joints of the floor run
along the corridor too. `vision.lateral.corner_pairs` collects the evidence for every pair of candidates,
`vision.lateral.hypotheses` turns it into probabilities. From lines alone the offset is answered where one has nearly
all of the probability (`fit_lateral`). Where the picture's regions tell as well, both kinds of evidence are
multiplied, and what they say together is answered, as exactly as it is known (`combined_offset`).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, isfinite, log, nan, sqrt

import numpy as np
import numpy.typing as npt

from vision.axis.vanishing_point import AxisFit
from vision.compiled import compiled, compiled_inner
from vision.lateral.corner_candidates import MAX_CORNERS
from vision.lateral.corner_pairs import arrays_of, corners_of_arrays
from vision.lateral.geometric import fields_of_corners
from vision.lateral.hypotheses import (
    WEIGHTS,
    OffsetEstimate,
    OffsetWeights,
    most_probable_offset,
    offset_hypotheses,
    prediction_factor,
    width_log_odds,
)
from vision.lateral.line_directions import PictureLines
from vision.lateral.mixture import OffsetMixture, fields_of_both
from vision.lines.line_set import LineSet
from vision.types import FloatArray

MAX_MIXTURE_CORNERS = 24  # in a quadrant: among bricks and tiles the corners are not among the longest lines
MIN_PROBABILITY = 0.97
MIN_WIDTH_SHARE = 0.3  # of the answer, for the floor's pair to give the width
MIN_STD = 0.004
SCATTER_SHARE = 0.64  # of the hypotheses' variance: they err together only in part
DOUBT = 0.02  # variance for what probability is left to others
# Of what lines and regions say together. On random simulated corridors (300 single pictures of scenes drawn anew)
# an error is within 1.95 of these standard deviations in nine of ten answers.
MODE_HALF_WIDTH = 0.12  # components nearer than this to their mean are one answer
MIN_JOINT_PROBABILITY = 0.7
JOINT_DOUBT = 0.03
MAX_STD_NORM = 0.12  # of an answer: a wider one is none
SAME_WIDTH = (
    0.06  # in the logarithm: where lines and regions differ by more, one of them took a stripe for a corner
)


@dataclass(frozen=True, slots=True)
class PictureOffset:
    """The lateral offset that one picture tells.

    Parameters
    ----------
    offset_norm, offset_norm_std
        Offset right of the centre line over half the width.
    width_per_height
        Corridor width over camera height above the floor; NaN where the picture does not tell.
    """

    offset_norm: float
    offset_norm_std: float
    width_per_height: float


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
def _estimate_offset(
    lines: PictureLines,
    R_axis_camera: FloatArray,
    down: FloatArray,
    diagonal_px: float,
    weights: OffsetWeights,
    prior: float,
    prior_std: float,
    prior_width: float,
    roll_std: float,
    max_corners: tuple[int, int],
) -> tuple[OffsetEstimate, float, npt.NDArray[np.intp], FloatArray]:
    """Go all the way from lines to the offset in compiled code: handing arrays over costs more than some steps.

    Returns
    -------
    tuple
        The estimate, the corridor's width over the camera's height (NaN where the floor's pair does not tell), and
        the lines (k,) that stand for the corners; and the fields (4, n) of the mixture.
    """
    many, few = max_corners  # as arguments they are of one type: as constants all would be compiled for each
    wide = picture = corners_of_arrays(lines, R_axis_camera, down, diagonal_px, many)
    for count in wide.candidates.n_candidates:
        if count > few:
            picture = corners_of_arrays(lines, R_axis_camera, down, diagonal_px, few)
            break
    hypotheses = offset_hypotheses(picture, weights)
    known = width_log_odds(picture.floor.pair["width"].copy(), prior_width, weights)
    found = most_probable_offset(hypotheses, known, prior, prior_std)
    corners = picture.candidates.corners
    width = nan
    wall_lines = np.empty(4, np.intp)
    count = 0
    if found.floor_share > MIN_WIDTH_SHARE:
        pair = picture.floor.pair[found.floor]
        width = pair.width
        wall_lines[0], wall_lines[1] = corners[0, pair.left].line, corners[1, pair.right].line
        count = 2
    if found.ceiling >= 0:
        pair = picture.ceiling.pair[found.ceiling]
        wall_lines[count], wall_lines[count + 1] = corners[2, pair.left].line, corners[3, pair.right].line
        count += 2
    return found, width, wall_lines[:count], fields_of_corners(wide, weights, roll_std)


def fit_lateral(
    lines: LineSet,
    axis: AxisFit,
    R_level_camera: FloatArray,
    roll_std_rad: float,
    prior_offset_norm: float = nan,
    prior_offset_norm_std: float = nan,
    prior_width_per_height: float = nan,
) -> tuple[LateralFit | None, OffsetMixture]:
    """Find the lateral offset, and all that the lines say about it.

    Parameters
    ----------
    lines, axis
        The segments and the corridor's axis among them.
    R_level_camera
        Rotation (3, 3) from the optical frame to the level frame.
    roll_std_rad
        Standard deviation of the level frame's roll: it tilts left against right.
    prior_offset_norm, prior_offset_norm_std
        A filter's prediction, to choose between hypotheses; NaN: none. The mixture does not know of it.
    prior_width_per_height
        Corridor width over camera height as seen so far, for the same; NaN: unknown.

    Returns
    -------
    fit, mixture
        The answer, None where one picture does not tell, and the mixture of all hypotheses.
    """
    found, width_per_height, wall_lines, fields = _estimate_offset(
        *arrays_of(lines, axis, R_level_camera),
        WEIGHTS,
        prior_offset_norm,
        prior_offset_norm_std,
        prior_width_per_height,
        roll_std_rad,
        (MAX_MIXTURE_CORNERS, MAX_CORNERS),
    )
    mixture = OffsetMixture(*fields)
    if not found.probability >= MIN_PROBABILITY:  # NaN fails too
        return None, mixture
    variance = (
        SCATTER_SHARE * found.scatter**2
        + found.std**2
        + (roll_std_rad * found.roll_slope) ** 2
        + MIN_STD**2
        + DOUBT * (1.0 - found.probability)
    )
    return LateralFit(found.offset, sqrt(variance), width_per_height, wall_lines), mixture


@compiled_inner
def _most_probable_group(both: FloatArray, factor: FloatArray) -> tuple[float, float, float]:
    """Find the offset that most of a mixture's probability is for.

    Parameters
    ----------
    both
        The mixture's fields (4, n), at least one.
    factor
        What is known beforehand of each component (n,): it chooses and does not move the answer.

    Returns
    -------
    tuple
        Probability, mean and variance of the components about the offset.
    """
    weight, offset, std = both[0], both[1], both[2]
    n = len(weight)
    mode, most, blind, total, moment = 0, -1.0, 1.0, 0.0, 0.0
    for k in range(n):
        blind -= weight[k]
        total += weight[k] * factor[k]
        moment += weight[k] * factor[k] * offset[k]
        density = 0.0
        for j in range(n):
            z = (offset[k] - offset[j]) / std[j]
            density += weight[j] * factor[j] / std[j] * exp(-0.5 * z * z)
        if density > most:
            mode, most = k, density
    best = (0.0, offset[mode], 0.0)
    # From the mode, and from the mean: a wide distribution may have peaks at either side.
    for start in (offset[mode], moment / max(total, 1e-12)):
        found = _group_about(start, both, factor)
        if found[0] > best[0]:
            best = found
    return best[0] / (total + max(blind, 0.0)), best[1], best[2]


@compiled_inner
def _group_about(start: float, both: FloatArray, factor: FloatArray) -> tuple[float, float, float]:
    """Return weight, mean and variance of the components of one answer, sought from an offset on."""
    weight, offset, std = both[0], both[1], both[2]
    mean = start
    for _ in range(3):
        moment = share = 0.0
        for k in range(len(weight)):
            if abs(offset[k] - mean) < MODE_HALF_WIDTH:
                moment += weight[k] * offset[k]
                share += weight[k]
        mean = moment / max(share, 1e-12)
    total = share = variance = 0.0
    for k in range(len(weight)):
        if abs(offset[k] - mean) < MODE_HALF_WIDTH:
            total += weight[k] * factor[k]
            share += weight[k]
            variance += weight[k] * (std[k] ** 2 + (offset[k] - mean) ** 2)
    return total, mean, variance / max(share, 1e-12)


@compiled_inner
def _width_about(fields: FloatArray, offset_norm: float) -> float:
    """Return the mean width per height of a mixture's components about an offset; NaN where none tells it."""
    weight, offset, width = fields[0], fields[1], fields[3]
    moment = share = 0.0
    for k in range(len(weight)):
        if isfinite(width[k]) and abs(offset[k] - offset_norm) < MODE_HALF_WIDTH:
            moment += weight[k] * width[k]
            share += weight[k]
    return moment / share if share > 0.0 else nan


@compiled
def _answer(
    lines: FloatArray,
    regions: FloatArray,
    prior: float,
    prior_std: float,
    prior_width: float,
    weights: OffsetWeights,
) -> tuple[float, float, float, float, float]:
    """Return what `combined_offset` answers with, of mixtures' fields.

    Returns
    -------
    tuple
        Probability, mean and variance of the likeliest offset, and the width about it by lines and by regions; a
        probability of zero where neither tells anything.
    """
    both = fields_of_both(lines, regions)
    if both.shape[1] == 0:
        return 0.0, nan, nan, nan, nan
    factor = width_log_odds(both[3], prior_width, weights)
    for k in range(len(factor)):
        factor[k] = exp(factor[k]) * prediction_factor(both[1, k], prior, prior_std)
    probability, mean, variance = _most_probable_group(both, factor)
    return probability, mean, variance, _width_about(lines, mean), _width_about(regions, mean)


def combined_offset(
    lines: OffsetMixture,
    regions: OffsetMixture,
    prior_offset_norm: float = nan,
    prior_offset_norm_std: float = nan,
    prior_width_per_height: float = nan,
) -> PictureOffset | None:
    """Answer with the offset that lines and regions together are most sure of; None where none is probable enough.

    The width is answered only where both see the same: an offset survives a pair of carpet stripes taken for the
    corners, as they are symmetric, but the width does not.

    Parameters
    ----------
    lines, regions
        What either kind of evidence says.
    prior_offset_norm, prior_offset_norm_std, prior_width_per_height
        As in `fit_lateral`.
    """
    known = (prior_offset_norm, prior_offset_norm_std, prior_width_per_height)
    probability, mean, variance, width, other = _answer(lines.fields(), regions.fields(), *known, WEIGHTS)
    if not probability >= MIN_JOINT_PROBABILITY:
        return None
    std = sqrt(variance + MIN_STD**2 + JOINT_DOUBT * (1.0 - min(probability, 1.0)))
    if std > MAX_STD_NORM:
        return None
    agree = width > 0.0 and other > 0.0 and abs(log(width / other)) < SAME_WIDTH
    return PictureOffset(
        offset_norm=mean,
        offset_norm_std=std,
        width_per_height=width if agree else nan,
    )
