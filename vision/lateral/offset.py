"""Scale-free lateral offset from the corners where the two walls meet floor and ceiling.

In the corridor's cross-section, a line at the depth z below the camera is seen at the slope ``t_L = z / w_L`` below
the horizontal on the left wall and at ``t_R = z / w_R`` on the right wall, where w_L and w_R are the distances to the
walls. A pair of lines at one height, such as both corners with the floor, gives the offset over the half width:

    y / (W / 2) = (w_L - w_R) / (w_L + w_R) = (t_R - t_L) / (t_R + t_L)

The difficulty is to find the two corners: skirting boards, wainscots, furniture and floor joints are parallel to
them. `vision.lateral.corner_pairs` computes the evidence for every pair of candidates, and
`vision.lateral.hypotheses` turns it into probabilities. `fit_lateral` uses lines alone; it gives an estimate where
one offset has at least `MIN_PROBABILITY` of the probability. `combined_offset` multiplies the likelihoods by lines
and by the network (`vision.lateral.learned`, called regions here); it gives an estimate where one mode has at least
`MIN_JOINT_PROBABILITY`.
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
from vision.lateral.mixture import OffsetMixture, fields_of_product
from vision.lines.line_set import LineSet
from vision.types import FloatArray

MAX_MIXTURE_CORNERS = 24  # in a quadrant: among bricks and tiles the corners are not among the longest lines
MIN_PROBABILITY = 0.97
MIN_WIDTH_SHARE = 0.3  # of the mode's evidence, for the floor's pair to give the width
MIN_STD = 0.004
SCATTER_SHARE = 0.64  # of the hypotheses' variance: their errors are only partly common
REMAINDER_VARIANCE = 0.02  # times the probability of all other offsets, added to the variance
# For lines and regions together. On random simulated corridors (300 single pictures, each of a new scene) nine of ten
# errors are within 1.95 of these standard deviations.
MODE_HALF_WIDTH = 0.12  # components nearer than this to their mean form one mode
MIN_JOINT_PROBABILITY = 0.7
JOINT_REMAINDER_VARIANCE = 0.03
MAX_STD_NORM = 0.12  # with a larger one there is no estimate
SAME_WIDTH = 0.06  # of the logarithm: if lines and regions differ by more, one mistook a stripe for a corner


@dataclass(frozen=True, slots=True)
class PictureOffset:
    """Lateral offset from one picture, by lines and regions together.

    Parameters
    ----------
    offset_norm, offset_norm_std
        Offset right of the centre line over half the width.
    width_per_height
        Corridor width over camera height above the floor; NaN where it was not measured.
    """

    offset_norm: float
    offset_norm_std: float
    width_per_height: float


@dataclass(frozen=True, slots=True, eq=False)
class LateralFit:
    """Lateral offset from one picture, by lines alone.

    Parameters
    ----------
    offset_norm, offset_norm_std
        Offset right of the centre line over half the width.
    width_per_height
        Corridor width over camera height above the floor; NaN where only the ceiling was seen.
    wall_lines
        Indices (k,) of the corner lines used, floor first.
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
    """Estimate the offset from lines, all in one compiled function: passing arrays costs more than some steps.

    Returns
    -------
    tuple
        The estimate, the corridor's width over the camera's height (NaN without a floor's pair), the indices (k,) of
        the corner lines, and the fields (4, n) of the mixture.
    """
    many, few = max_corners  # arguments, not constants: everything would be compiled once for each constant
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
    """Estimate the lateral offset from lines, with the mixture of all hypotheses.

    The variance of the estimate is the sum of ``SCATTER_SHARE`` of the scatter of the agreeing hypotheses, their own
    variance, that by roll, ``MIN_STD`` squared, and ``REMAINDER_VARIANCE`` times the probability of other offsets.

    Parameters
    ----------
    lines, axis
        The segments and the corridor's axis among them.
    R_level_camera
        Rotation (3, 3) from the optical frame to the level frame.
    roll_std_rad
        Standard deviation of the level frame's roll; roll raises one wall's lines and lowers the other's.
    prior_offset_norm, prior_offset_norm_std
        A filter's prediction, which selects between hypotheses; NaN: none. It does not affect the mixture.
    prior_width_per_height
        Corridor width over camera height from earlier frames, used likewise; NaN: unknown.

    Returns
    -------
    fit, mixture
        The estimate, None where it is ambiguous, and the mixture of all hypotheses.
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
        + REMAINDER_VARIANCE * (1.0 - found.probability)
    )
    return LateralFit(found.offset, sqrt(variance), width_per_height, wall_lines), mixture


@compiled_inner
def _most_probable_mode(product: FloatArray, factor: FloatArray) -> tuple[float, float, float]:
    """Find the mode with most of a mixture's probability.

    Parameters
    ----------
    product
        The mixture's fields (4, n), at least one component.
    factor
        Prior odds (n,) of each component: they select the mode, but do not shift its mean.

    Returns
    -------
    tuple
        Probability, mean and variance of the mode's components.
    """
    weight, offset, std = product[0], product[1], product[2]
    n = len(weight)
    mode, most, cannot_tell, total, moment = 0, -1.0, 1.0, 0.0, 0.0
    for k in range(n):
        cannot_tell -= weight[k]
        total += weight[k] * factor[k]
        moment += weight[k] * factor[k] * offset[k]
        density = 0.0
        for j in range(n):
            z = (offset[k] - offset[j]) / std[j]
            density += weight[j] * factor[j] / std[j] * exp(-0.5 * z * z)
        if density > most:
            mode, most = k, density
    best = (0.0, offset[mode], 0.0)
    # Start from the highest density and from the mean: a wide distribution may have peaks at both sides.
    for start in (offset[mode], moment / max(total, 1e-12)):
        found = _mode_about(start, product, factor)
        if found[0] > best[0]:
            best = found
    return best[0] / (total + max(cannot_tell, 0.0)), best[1], best[2]


@compiled_inner
def _mode_about(start: float, product: FloatArray, factor: FloatArray) -> tuple[float, float, float]:
    """Return weight, mean and variance of the mode found by mean shift from a start offset."""
    weight, offset, std = product[0], product[1], product[2]
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
    """Return the mean width per height of a mixture's components about an offset; NaN where all are unknown."""
    weight, offset, width = fields[0], fields[1], fields[3]
    moment = share = 0.0
    for k in range(len(weight)):
        if isfinite(width[k]) and abs(offset[k] - offset_norm) < MODE_HALF_WIDTH:
            moment += weight[k] * width[k]
            share += weight[k]
    return moment / share if share > 0.0 else nan


@compiled
def _joint_estimate(
    lines: FloatArray,
    regions: FloatArray,
    prior: float,
    prior_std: float,
    prior_width: float,
    weights: OffsetWeights,
) -> tuple[float, float, float, float, float]:
    """Compute the estimate of `combined_offset` from the fields of two mixtures.

    Returns
    -------
    tuple
        Probability, mean and variance of the likeliest mode, and the width about it by lines and by regions; the
        probability is zero where both mixtures are empty.
    """
    product = fields_of_product(lines, regions)
    if product.shape[1] == 0:
        return 0.0, nan, nan, nan, nan
    factor = width_log_odds(product[3], prior_width, weights)
    for k in range(len(factor)):
        factor[k] = exp(factor[k]) * prediction_factor(product[1, k], prior, prior_std)
    probability, mean, variance = _most_probable_mode(product, factor)
    return probability, mean, variance, _width_about(lines, mean), _width_about(regions, mean)


def combined_offset(
    lines: OffsetMixture,
    regions: OffsetMixture,
    prior_offset_norm: float = nan,
    prior_offset_norm_std: float = nan,
    prior_width_per_height: float = nan,
) -> PictureOffset | None:
    """Estimate the offset from lines and regions together; None where no mode is probable enough.

    The width is given only where both agree on it: a symmetric pair of carpet stripes mistaken for the corners gives
    the right offset, but a wrong width.

    Parameters
    ----------
    lines, regions
        Likelihoods by the two kinds of evidence.
    prior_offset_norm, prior_offset_norm_std, prior_width_per_height
        As in `fit_lateral`.
    """
    known = (prior_offset_norm, prior_offset_norm_std, prior_width_per_height)
    probability, mean, variance, width, other = _joint_estimate(
        lines.fields(), regions.fields(), *known, WEIGHTS
    )
    if not probability >= MIN_JOINT_PROBABILITY:
        return None
    std = sqrt(variance + MIN_STD**2 + JOINT_REMAINDER_VARIANCE * (1.0 - min(probability, 1.0)))
    if std > MAX_STD_NORM:
        return None
    agree = width > 0.0 and other > 0.0 and abs(log(width / other)) < SAME_WIDTH
    return PictureOffset(
        offset_norm=mean,
        offset_norm_std=std,
        width_per_height=width if agree else nan,
    )
