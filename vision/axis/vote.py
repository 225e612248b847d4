"""Exhaustive vote over heading and elevation of the corridor's axis.

At the elevation e a line's plane contains the axis direction at up to two headings psi_0. Near each, the residual
``n . d`` is linear in the heading, with the variance s^2 in units of heading. The line adds the logarithm of its
likelihood ratio, a Gaussian inlier (prior probability `INLIER_ODDS`) against a uniform heading, truncated at zero:

    max(0, 1/2 log(MAX_VARIANCE / s^2) - (psi - psi_0)^2 / (2 s^2))

s^2 contains the line's measurement error, the non-parallelism of real corridor lines, the spacing of the elevations
and the bin width. Steep planes get less weight, and nearly vertical ones none, as they may be those of door posts.
`vision.axis.peaks` searches the sum for the axis.
"""

from __future__ import annotations

from math import atan2, cos, hypot, log, pi, radians, sqrt

import numpy as np

from vision.compiled import compiled, compiled_inner
from vision.lines.line_set import LineGeometry
from vision.types import FloatArray

N_BINS = 720
BIN_RAD = pi / N_BINS
ALIGN_STD_RAD = radians(0.07)  # lines along a real corridor are parallel to about this
INLIER_ODDS = 0.25  # share of lines expected to run along the corridor
MAX_VARIANCE = (INLIER_ODDS * pi) ** 2 / (2.0 * pi)  # of a line's heading, rad^2: above, no evidence
VERTICAL_SINE = 0.10  # planes this close to vertical may be door posts'; they carry no evidence of the axis
STEEP_SINE = 0.3  # planes up to here have less weight: streaks on a wall, leaning objects
MAX_HEADING_RAD = radians(60.0)  # without a prediction, a larger one is taken for a transverse direction


@compiled_inner
def line_variance(alpha: float, beta: float, sigma: float, arc: float) -> float:
    """Return the variance of a corridor line's residual ``n . d``.

    Parameters
    ----------
    alpha, beta
        Components of the axis d along the line's middle and along its direction.
    sigma
        Standard deviation of the angle by which the line's middle is off its plane, radians.
    arc
        Angle that the line subtends, radians.
    """
    rotation = 3.4641 * sigma / arc
    return (sigma * alpha) ** 2 + (rotation * beta) ** 2 + ALIGN_STD_RAD * ALIGN_STD_RAD


@compiled
def bin_heading(b: int) -> float:
    """Return the heading (rad) at the middle of a bin."""
    return -0.5 * pi + (b + 0.5) * BIN_RAD


@compiled_inner
def _add_parabola(row: FloatArray, heading: float, variance: float, trust: float) -> None:
    """Add one line's log-likelihood ratio over headings (N_BINS,), where it is positive."""
    top = 0.5 * log(MAX_VARIANCE / variance)
    reach = sqrt(2.0 * top * variance)
    first = max(int(np.ceil((heading - reach + 0.5 * pi) / BIN_RAD - 0.5)), 0)
    last = min(int(np.floor((heading + reach + 0.5 * pi) / BIN_RAD - 0.5)), N_BINS - 1)
    bend, start = 0.5 * trust / variance, bin_heading(first) - heading
    for b in range(last - first + 1):  # starting at zero, so that it vectorises
        offset = start + b * BIN_RAD
        row[first + b] += trust * top - bend * offset * offset


@compiled
def vote(
    lines: LineGeometry, elevation: FloatArray, elevation_std: FloatArray, max_heading: float
) -> FloatArray:
    """Sum the lines' truncated log-likelihood ratios for every heading and elevation of the axis.

    Parameters
    ----------
    lines
        The picture's lines, level frame.
    elevation
        Elevations to try (m,), radians.
    elevation_std
        Standard deviation (m,) of the elevations that each grid value represents.
    max_heading
        Headings beyond this are left out; `MAX_HEADING_RAD` without a prediction, else a right angle.

    Returns
    -------
    ndarray
        Scores (2, m, N_BINS), log-likelihood ratios against random lines: of the lines below the axis, and above it.
    """
    normal, centre, direction = lines.normal, lines.centre, lines.direction
    sigma, arc = lines.sigma_rad, lines.arc_rad
    scores = np.zeros((2, len(elevation), N_BINS))
    least_cosine = cos(max_heading)
    tangent, cosine_e = np.tan(elevation), np.cos(elevation)
    for i in range(len(sigma)):
        nx = normal[i, 0]
        ny = normal[i, 1]
        nz = normal[i, 2]
        if abs(nz) < VERTICAL_SINE:
            continue
        trust = min(abs(nz) / STEEP_SINE, 1.0)
        a = max(hypot(nx, ny), 1e-9)
        # cosine and sine of the normal's own heading; the axis is to either side of it
        cg, sg = nx / a, -ny / a
        for k in range(len(elevation)):
            cosine = nz * tangent[k] / a
            if abs(cosine) >= 1.0:
                continue
            sine = sqrt(1.0 - cosine * cosine)
            ce, se = cosine_e[k], tangent[k] * cosine_e[k]
            for side in (1.0, -1.0):
                cp = cg * cosine - side * sg * sine
                if cp < least_cosine:
                    continue
                sp = sg * cosine + side * cg * sine
                dx = ce * cp
                dy = -ce * sp
                dz = -se
                alpha = centre[i, 0] * dx + centre[i, 1] * dy + centre[i, 2] * dz
                beta = direction[i, 0] * dx + direction[i, 1] * dy + direction[i, 2] * dz
                slope = max(abs(nx * sp + ny * cp) * ce, 1e-6)
                blurred = line_variance(alpha, beta, sigma[i], arc[i]) + (nz * elevation_std[k]) ** 2
                variance = blurred / (slope * slope) + BIN_RAD * BIN_RAD / 3.0
                if variance >= MAX_VARIANCE:
                    continue
                down = ce * centre[i, 2] + se * (centre[i, 0] * cp - centre[i, 1] * sp)
                _add_parabola(scores[0 if down > 0.0 else 1, k], atan2(sp, cp), variance, trust)
    return scores
