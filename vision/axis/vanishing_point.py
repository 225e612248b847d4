"""The corridor's axis from line segments: an exhaustive vote over heading, then a robust least-squares fit.

Each segment spans a plane with the camera's centre; for a line along the corridor this plane contains the axis. The
axis at heading psi and elevation e (positive up) is ``d = (cos e cos psi, -cos e sin psi, -sin e)`` in the level
frame. A line with plane normal n has the residual ``n . d``, which is zero for a corridor line.

1. The vote (`vision.axis.vote`) covers all headings, and the elevations within the uncertainty of tilt and mount. It
   needs neither an initial guess nor random sampling. `vision.axis.peaks` selects the best peak and its rival.
2. Gauss-Newton refines psi and e from there, with Geman-McClure weights ``w = 1 / (1 + z^2 / c^2)^2`` of the
   normalised residuals z and the prior of the elevation. The scale c decreases from 4 to 2 times the lines' scatter.
3. Inliers have a residual below 3 sigma. The covariance of the fit is scaled by their scatter and by Student's t
   factor for few distinct lines, and widened by the vote's excess variance.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import atan2, cos, isfinite, isnan, nan, pi, radians, sin, sqrt
from typing import NamedTuple

import numpy as np

from vision.axis.elevation import FINEST_STD_RAD, elevation_information, elevations_to_try
from vision.axis.peaks import RIVAL_DISTANCE_RAD, find_best_heading, find_rival, split_variance
from vision.axis.vote import MAX_HEADING_RAD, VERTICAL_SINE, bin_heading, line_variance, vote
from vision.compiled import compiled, compiled_inner
from vision.lines.line_set import LineGeometry, LineSet, rotate_lines
from vision.lines.segments import MIN_LENGTH_PX
from vision.types import BoolArray, FloatArray

MAX_REFINEMENT_RAD = radians(4.0)
INLIER_SIGMA = 3.0
# First and last scale c of the Geman-McClure weights, and the residual over c beyond which the weight is zero
FIRST_ROBUST_SIGMA, ROBUST_SIGMA = 4.0, 2.0
NEGLIGIBLE = 5.0
GAUSSIAN_CHI2 = 0.58  # weighted mean of the squared normalised residuals if they are standard Gaussian
MAX_SCATTER = 1.5  # limits the scale where lines scatter more, so that few right lines still decide
MIN_SCALE = 0.3  # of the covariance, however well the lines agree
MIN_FREEDOM = 3  # degrees of freedom: with two, Student's t has no variance
LEVEL_COSINE = cos(radians(15.0))  # of a line's normal with the vertical
DIRECTIONS = 45  # in half a turn about the axis


class _Refined(NamedTuple):
    """The axis after the least-squares fit.

    Parameters
    ----------
    heading, elevation
        Of the axis in the level frame, radians.
    information_heading, information_both, information_elevation
        Elements of the information matrix of the two, rad^-2.
    chi2, weight
        Weighted sum of the squared residuals, and the sum of the weights.
    residual
        Each line's residual over its standard deviation (n,).
    """

    heading: float
    elevation: float
    information_heading: float
    information_both: float
    information_elevation: float
    chi2: float
    weight: float
    residual: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class AxisFit:
    """The best axis, its covariance and its rival.

    Parameters
    ----------
    heading_rad, elevation_rad
        The fit, in the level frame.
    covariance
        Of heading and elevation (2, 2), rad^2.
    split_variance
        Of the heading, rad^2, due to a second direction near the axis (`vision.axis.peaks.split_variance`).
    score, score_of_all
        Log-likelihood ratio of the best peak against random lines, and the same without the limit for lines in one
        plane (`vision.axis.peaks.corridor_score`).
    second_heading_rad, second_score
        The best peak at least 8 degrees away.
    residual
        Each line's residual over its standard deviation (n,).
    inlier
        Lines (n,) along the axis.
    crossing
        Inliers (n,) that extend past the vanishing point on both sides. A single edge cannot: they consist of two
        edges, such as the floor's on the left and the ceiling's on the right.
    inlier_share
        Share of the inliers in the length of all lines that are not vertical.
    n_distinct
        Number of distinct directions of the inliers about the axis, 4 degrees apart.
    """

    heading_rad: float
    elevation_rad: float
    covariance: FloatArray
    split_variance: float
    score: float
    score_of_all: float
    second_heading_rad: float
    second_score: float
    residual: FloatArray
    inlier: BoolArray
    crossing: BoolArray
    inlier_share: float
    n_distinct: int


@compiled_inner
def _refine(lines: LineGeometry, psi: float, e: float, prior_e: float, prior_e_std: float) -> _Refined:
    """Fit the axis by Gauss-Newton with Geman-McClure weights, from heading psi and elevation e.

    The weights decrease smoothly, so that a small change of a line does not make it enter or leave the fit.
    """
    normal, centre, direction = lines.normal, lines.centre, lines.direction
    sigma, arc = lines.sigma_rad, lines.arc_rad
    n = len(sigma)
    residual = np.empty(n)
    h00 = h01 = h11 = chi2 = total = 0.0
    for iteration in range(12):
        scatter = sqrt(chi2 / (GAUSSIAN_CHI2 * total)) if total > 0.0 else 1.0
        robust_sigma = ROBUST_SIGMA * min(max(scatter, 1.0), MAX_SCATTER)
        scale = max(robust_sigma, FIRST_ROBUST_SIGMA - 0.5 * iteration)
        h00 = h01 = h11 = g0 = g1 = 0.0
        chi2 = total = 0.0
        cp = cos(psi)
        sp = sin(psi)
        ce = cos(e)
        se = sin(e)
        for i in range(n):
            nx = normal[i, 0]
            ny = normal[i, 1]
            nz = normal[i, 2]
            r = ce * (nx * cp - ny * sp) - nz * se
            alpha = ce * (centre[i, 0] * cp - centre[i, 1] * sp) - centre[i, 2] * se
            beta = ce * (direction[i, 0] * cp - direction[i, 1] * sp) - direction[i, 2] * se
            std = sqrt(line_variance(alpha, beta, sigma[i], arc[i]))
            z = r / std
            residual[i] = z
            if abs(nz) < VERTICAL_SINE or abs(z) >= NEGLIGIBLE * scale:
                continue
            w = 1.0 / (1.0 + (z / scale) ** 2) ** 2
            j0 = -ce * (nx * sp + ny * cp) / std
            j1 = (-se * (nx * cp - ny * sp) - nz * ce) / std
            h00 += w * j0 * j0
            h01 += w * j0 * j1
            h11 += w * j1 * j1
            g0 += w * j0 * z
            g1 += w * j1 * z
            chi2 += w * z * z
            total += w
        prior_information = elevation_information(e - prior_e, prior_e_std)
        h11 += prior_information
        g1 += (e - prior_e) * prior_information
        determinant = h00 * h11 - h01 * h01
        if determinant <= 0.0 or h00 <= 0.0:
            break
        step_psi = -(h11 * g0 - h01 * g1) / determinant
        step_e = -(h00 * g1 - h01 * g0) / determinant
        psi += min(max(step_psi, -0.05), 0.05)
        e += min(max(step_e, -0.05), 0.05)
        if iteration >= 4 and abs(step_psi) < 1e-7 and abs(step_e) < 1e-7:
            break
    return _Refined(psi, e, h00, h01, h11, chi2, total, residual)


@compiled_inner
def _count_distinct(normal: FloatArray, inlier: BoolArray, psi: float, e: float) -> int:
    """Count distinct directions of the inliers about the axis; pieces of one edge and its two sides count once."""
    cp, sp, ce, se = cos(psi), sin(psi), cos(e), sin(e)
    seen = np.zeros(DIRECTIONS, np.bool_)
    count = 0
    for i in range(len(inlier)):
        if not inlier[i]:
            continue
        across = normal[i, 0] * sp + normal[i, 1] * cp
        down = normal[i, 2] * ce + (normal[i, 0] * cp - normal[i, 1] * sp) * se
        b = int((atan2(down, across) / pi + 1.0) * DIRECTIONS) % DIRECTIONS
        count += not seen[b]
        seen[b] = True
    return count


@compiled_inner
def _angle_ahead(lines: LineGeometry, i: int, psi: float, e: float) -> float:
    """Return the angle along line i from its middle to the vanishing point."""
    c, d = lines.centre, lines.direction
    ce, se, cp, sp = cos(e), sin(e), cos(psi), sin(psi)
    along = ce * (d[i, 0] * cp - d[i, 1] * sp) - d[i, 2] * se
    ahead = ce * (c[i, 0] * cp - c[i, 1] * sp) - c[i, 2] * se
    return atan2(along, ahead)


@compiled_inner
def _lines_along(
    lines: LineGeometry, length: FloatArray, fit: _Refined
) -> tuple[BoolArray, BoolArray, float]:
    """Return which lines run along the axis, which of them extend past the vanishing point on both sides, (n,).

    The third value is the inliers' share in the length of all lines that are not vertical.
    """
    n = len(length)
    inlier, crossing = np.zeros(n, np.bool_), np.zeros(n, np.bool_)
    along = leaning = 0.0
    for i in range(n):
        if abs(lines.normal[i, 2]) < VERTICAL_SINE:
            continue
        leaning += length[i]
        if abs(fit.residual[i]) < INLIER_SIGMA:
            inlier[i] = True
            along += length[i]
            # Level lines are left out: they rather run across, at the camera's height. Both parts of a crossing line
            # must have the least length of a line.
            if abs(lines.normal[i, 2]) < LEVEL_COSINE:
                ahead = abs(_angle_ahead(lines, i, fit.heading, fit.elevation))
                crossing[i] = (0.5 - ahead / lines.arc_rad[i]) * length[i] > MIN_LENGTH_PX
    return inlier, crossing, along / max(leaning, 1.0)


@compiled_inner
def _without(lines: LineGeometry, left_out: BoolArray) -> LineGeometry:
    """Return the lines but those left out (n,)."""
    kept = np.flatnonzero(~left_out)
    return LineGeometry(
        lines.normal[kept],
        lines.centre[kept],
        lines.direction[kept],
        lines.sigma_rad[kept],
        lines.arc_rad[kept],
    )


class _Found(NamedTuple):
    """Result of `_find` in compiled code; fields as in `AxisFit`, in radians. The heading is NaN without an axis."""

    heading: float
    elevation: float
    covariance: FloatArray
    split_variance: float
    score: float
    score_of_all: float
    second_heading: float
    second_score: float
    residual: FloatArray
    inlier: BoolArray
    crossing: BoolArray
    inlier_share: float
    n_distinct: int


@compiled
def _covariance(fit: _Refined, excess_variance: float, n_distinct: int) -> FloatArray:
    """Return the covariance (2, 2) of heading and elevation; infinite where the information matrix is singular.

    It is the inverse information of the fit, with the vote's excess variance added to the heading's. It is scaled by
    the residuals' own variance, so errors follow Student's t distribution: with f degrees of freedom, the number of
    distinct lines less two, the variance has the factor f / (f - 2).
    """
    h00, h01, h11 = fit.information_heading, fit.information_both, fit.information_elevation
    covariance = np.empty((2, 2))
    determinant = h00 * h11 - h01 * h01
    if not determinant > 0.0:
        covariance[:] = np.inf
        return covariance
    freedom = max(n_distinct - 2, MIN_FREEDOM)
    misfit = fit.chi2 / max(fit.weight - 2.0, 1.0)
    scale = max(MIN_SCALE, misfit) / determinant
    wider = sqrt(1.0 + excess_variance / (h11 * scale))
    scale *= freedom / (freedom - 2.0)
    covariance[0, 0], covariance[1, 1] = h11 * scale * wider * wider, h00 * scale
    covariance[0, 1] = covariance[1, 0] = -h01 * scale * wider
    return covariance


@compiled
def _find(
    in_camera: LineGeometry,
    length: FloatArray,
    R_level_camera: FloatArray,
    elevation: float,
    elevation_std: float,
    prior_heading: float,
    prior_heading_std: float,
) -> _Found:
    """Find the axis from lines, all in one compiled function: passing arrays costs more than some steps.

    Parameters
    ----------
    in_camera, length
        The picture's lines, optical frame; lengths (n,) in pixels.
    R_level_camera, elevation, elevation_std, prior_heading, prior_heading_std
        As in `fit_axis`.
    """
    lines = rotate_lines(in_camera, R_level_camera)
    n = len(length)
    no_line = np.zeros(n, np.bool_)
    none = _Found(
        np.nan, np.nan, np.empty((2, 2)), 0.0, 0.0, 0.0, np.nan, 0.0, np.zeros(n), no_line, no_line, 0.0, 0
    )
    steps, step_std = elevations_to_try(elevation_std)
    max_heading = 0.5 * pi if prior_heading == prior_heading else MAX_HEADING_RAD + RIVAL_DISTANCE_RAD
    scores = vote(lines, elevation + steps, step_std, max_heading)
    voted = find_best_heading(scores, steps, elevation_std, prior_heading, prior_heading_std)
    if not voted.best_score > 0.0:
        return none
    start = bin_heading(voted.best_bin)
    fit = _refine(lines, start, elevation + steps[voted.best_elevation], elevation, elevation_std)
    if abs(fit.heading - start) > MAX_REFINEMENT_RAD:
        return none  # the fit left its peak: there is no axis, only many stray lines
    # Between grid elevations one axis may split into several peaks: vote again at the fitted elevation.
    at_axis = vote(lines, np.array([fit.elevation]), np.array([FINEST_STD_RAD]), max_heading)
    rival = find_rival(voted, at_axis[0, 0] + at_axis[1, 0], fit.heading, fit.elevation - elevation)
    inlier, crossing, share = _lines_along(lines, length, fit)
    n_distinct = _count_distinct(lines.normal, inlier, fit.heading, fit.elevation)
    covariance = _covariance(fit, rival.excess_variance, n_distinct)
    score_of_all = voted.marginal[voted.best_bin] + voted.log_prior[voted.best_bin]
    rest = vote(_without(lines, inlier), np.array([fit.elevation]), np.array([FINEST_STD_RAD]), max_heading)
    return _Found(
        fit.heading,
        fit.elevation,
        covariance,
        split_variance(rest[0, 0] + rest[1, 0], fit.heading, score_of_all),
        voted.best_score,
        score_of_all,
        bin_heading(rival.bin),
        rival.score,
        fit.residual,
        inlier,
        crossing,
        share,
        n_distinct,
    )


def axis_direction(heading_rad: float, elevation_rad: float) -> FloatArray:
    """Return the unit vector (3,) along the corridor in the level frame, for a heading and an elevation."""
    level = cos(elevation_rad)
    return np.array([level * cos(heading_rad), -level * sin(heading_rad), -sin(elevation_rad)])


def corridor_frame(R_level_camera: FloatArray, heading_rad: float, elevation_rad: float) -> FloatArray:
    """Return the rotation (3, 3) from the optical frame to axes along the corridor, to its right, and down."""
    ce, se, cp, sp = cos(elevation_rad), sin(elevation_rad), cos(heading_rad), sin(heading_rad)
    R_corridor_level = np.array([[ce * cp, -ce * sp, -se], [sp, cp, 0.0], [se * cp, -se * sp, ce]])
    return np.asarray(R_corridor_level @ R_level_camera, dtype=float)


def fit_axis(
    lines: LineSet,
    R_level_camera: FloatArray,
    elevation_rad: float = 0.0,
    elevation_std_rad: float = radians(3.0),
    prior_heading_rad: float = nan,
    prior_heading_std_rad: float = nan,
) -> AxisFit | None:
    """Find the corridor's axis among the lines; None where no line votes.

    Parameters
    ----------
    lines
        Segments of the picture.
    R_level_camera
        Rotation (3, 3) from the optical frame to the level frame.
    elevation_rad, elevation_std_rad
        Prior of the axis's elevation, with tilt and mounting errors.
    prior_heading_rad, prior_heading_std_rad
        A filter's prediction, which selects between peaks; NaN: none, the camera is assumed to look along the
        corridor.
    """
    if len(lines) == 0:
        return None
    found = _find(
        lines.geometry(),
        lines.length_px,
        R_level_camera,
        elevation_rad,
        elevation_std_rad,
        prior_heading_rad,
        prior_heading_std_rad,
    )
    if not isfinite(found.covariance[0, 0]) or isnan(found.heading):
        return None
    return AxisFit(
        heading_rad=found.heading,
        elevation_rad=found.elevation,
        covariance=found.covariance,
        split_variance=found.split_variance,
        score=found.score,
        score_of_all=found.score_of_all,
        second_heading_rad=found.second_heading,
        second_score=found.second_score,
        residual=found.residual,
        inlier=found.inlier,
        crossing=found.crossing,
        inlier_share=found.inlier_share,
        n_distinct=found.n_distinct,
    )
