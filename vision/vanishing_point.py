"""The corridor's axis from line segments: an exhaustive vote over heading, then a robust least-squares fit.

Each segment spans a plane with the camera's centre; a line along the corridor has the axis in its plane.
Turned level by roll and pitch, that makes each line vote for one heading. The vote is over all headings
(and over elevations, as far as tilt and mount are uncertain), so there is no initial guess and no random
sampling to be unlucky with. Each line counts by the log-likelihood that it passes through the axis rather
than somewhere at random, cut off at zero.

The axis at heading psi and elevation e (positive up) is ``d = (cos e cos psi, -cos e sin psi, -sin e)`` in
the level frame; the residual of a line with plane normal n is ``n . d``, zero for a corridor line.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import atan2, cos, hypot, log, nan, pi, radians, sin, sqrt

import numpy as np
import numpy.typing as npt

from vision.compiled import compiled
from vision.lines import LineSet

FloatArray = npt.NDArray[np.float64]

N_BINS = 720
BIN_RAD = pi / N_BINS
PEAK_BINS = 4
MAX_REFINEMENT_RAD = radians(4.0)
SLICE_STEP_RAD = radians(1.0)
MAX_SLICES = 21
ALIGN_STD_RAD = radians(0.10)  # lines along a real corridor are parallel to about this
INLIER_ODDS = 0.25  # share of lines expected to run along the corridor
VERTICAL_SINE = 0.10  # a plane this close to vertical may be a door post's: it says nothing about the axis
STEEP_SINE = 0.3  # and one up to here is trusted less: streaks on a wall, leaning things
INLIER_SIGMA = 3.0
CORRELATION = 1.8  # the edges of one door or board err together: so many lines speak as one
VOTE_TEMPERATURE = 1.1  # the same for the vote
RIVAL_DISTANCE_RAD = radians(8.0)
HEADING_PRIOR_STD_RAD = radians(30.0)  # the camera looks along the corridor rather than across
MAX_HEADING_RAD = radians(60.0)  # without a filter's word, what is farther off is taken for a transverse axis


@dataclass(frozen=True, slots=True, eq=False)
class AxisFit:
    """The best axis, its covariance and its rival.

    Parameters
    ----------
    heading_rad, elevation_rad
        The fit, in the level frame.
    covariance
        Of heading and elevation (2, 2), rad^2.
    score
        Log-likelihood of the best vote over lines at random.
    second_heading_rad, second_score
        The best vote at least 8 degrees away.
    residual
        Each line's residual over its standard deviation (n,).
    inlier
        Lines (n,) that run along the axis.
    """

    heading_rad: float
    elevation_rad: float
    covariance: FloatArray
    score: float
    second_heading_rad: float
    second_score: float
    residual: FloatArray
    inlier: npt.NDArray[np.bool_]


@compiled
def _line_std(alpha: float, beta: float, sigma: float, arc: float, align: float) -> float:
    """Return the standard deviation of ``n . d``; alpha, beta: components of d along the line's middle, direction."""
    rotation = 3.4641 * sigma / arc
    return sqrt((sigma * alpha) ** 2 + (rotation * beta) ** 2 + align * align)


@compiled
def _vote(
    normal: FloatArray,
    centre: FloatArray,
    direction: FloatArray,
    sigma: FloatArray,
    arc: FloatArray,
    elevation: FloatArray,
    elevation_std: float,
    scores: FloatArray,
) -> None:
    """Fill ``scores`` (elevations, N_BINS) with the lines' truncated log-likelihoods."""
    scores[:] = 0.0
    for i in range(len(sigma)):
        nx = normal[i, 0]
        ny = normal[i, 1]
        nz = normal[i, 2]
        if abs(nz) < VERTICAL_SINE:
            continue
        trust = min(abs(nz) / STEEP_SINE, 1.0)
        a = hypot(nx, ny)
        g = atan2(-ny, nx)
        for k in range(len(elevation)):
            e = elevation[k]
            cosine = nz * np.tan(e) / max(a, 1e-9)
            if abs(cosine) >= 1.0:
                continue
            half = np.arccos(cosine)
            for side in range(2):
                psi = g + half if side == 0 else g - half
                if psi > pi:
                    psi -= 2 * pi
                if psi < -pi:
                    psi += 2 * pi
                if abs(psi) > 0.5 * pi:
                    continue
                dx = cos(e) * cos(psi)
                dy = -cos(e) * sin(psi)
                dz = -sin(e)
                alpha = centre[i, 0] * dx + centre[i, 1] * dy + centre[i, 2] * dz
                beta = direction[i, 0] * dx + direction[i, 1] * dy + direction[i, 2] * dz
                r_std = _line_std(alpha, beta, sigma[i], arc[i], ALIGN_STD_RAD)
                slope = abs(-nx * sin(psi) - ny * cos(psi)) * cos(e)
                std = sqrt(r_std * r_std + (nz * elevation_std) ** 2) / max(slope, 1e-6)
                std = sqrt(std * std + BIN_RAD * BIN_RAD / 3.0)
                top = log(INLIER_ODDS * pi / (2.5066 * std))
                if top <= 0.0:
                    continue
                reach = std * sqrt(2.0 * top)
                first = int(np.ceil((psi - reach + 0.5 * pi) / BIN_RAD - 0.5))
                last = int(np.floor((psi + reach + 0.5 * pi) / BIN_RAD - 0.5))
                for b in range(max(first, 0), min(last, N_BINS - 1) + 1):
                    z = (-0.5 * pi + (b + 0.5) * BIN_RAD - psi) / std
                    scores[k, b] += trust * (top - 0.5 * z * z)


@compiled
def _refine(
    normal: FloatArray,
    centre: FloatArray,
    direction: FloatArray,
    sigma: FloatArray,
    arc: FloatArray,
    psi: float,
    e: float,
    prior_e: float,
    prior_e_std: float,
    residual: FloatArray,
    out: FloatArray,
) -> None:
    """Fit robustly from (psi, e); ``out`` = psi, e, information (3 numbers), weighted chi-square, sum of weights."""
    n = len(sigma)
    for iteration in range(12):
        cut = max(INLIER_SIGMA, 6.0 - iteration)
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
            std = _line_std(alpha, beta, sigma[i], arc[i], ALIGN_STD_RAD)
            z = r / std
            residual[i] = z
            if abs(nz) < VERTICAL_SINE or abs(z) >= cut:
                continue
            w = 1.0 - (z / cut) ** 2
            w = w * w
            j0 = -ce * (nx * sp + ny * cp) / std
            j1 = (-se * (nx * cp - ny * sp) - nz * ce) / std
            h00 += w * j0 * j0
            h01 += w * j0 * j1
            h11 += w * j1 * j1
            g0 += w * j0 * z
            g1 += w * j1 * z
            chi2 += w * z * z
            total += w
        prior_information = 1.0 / (prior_e_std * prior_e_std)
        h11 += prior_information
        g1 += (e - prior_e) * prior_information
        determinant = h00 * h11 - h01 * h01
        out[2] = h00
        out[3] = h01
        out[4] = h11
        out[5] = chi2
        out[6] = total
        if determinant <= 0.0 or h00 <= 0.0:
            break
        step_psi = -(h11 * g0 - h01 * g1) / determinant
        step_e = -(h00 * g1 - h01 * g0) / determinant
        psi += min(max(step_psi, -0.05), 0.05)
        e += min(max(step_e, -0.05), 0.05)
        if iteration >= 4 and abs(step_psi) < 1e-7 and abs(step_e) < 1e-7:
            break
    out[0] = psi
    out[1] = e


def axis_direction(heading_rad: float, elevation_rad: float) -> FloatArray:
    """Return the unit vector (3,) in the level frame along a corridor seen at this heading and elevation."""
    level = cos(elevation_rad)
    return np.array([level * cos(heading_rad), -level * sin(heading_rad), -sin(elevation_rad)])


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
        What is known of the axis's elevation: tilt error and mount together.
    prior_heading_rad, prior_heading_std_rad
        A filter's prediction, to choose between peaks; NaN: the camera looks along rather than across.
    """
    if len(lines) == 0:
        return None
    normal = lines.normal @ R_level_camera.T
    centre = lines.centre @ R_level_camera.T
    direction = lines.direction @ R_level_camera.T
    half_slices = min(int(2.0 * elevation_std_rad / SLICE_STEP_RAD), (MAX_SLICES - 1) // 2)
    steps: FloatArray = np.arange(-half_slices, half_slices + 1, dtype=np.float64) * SLICE_STEP_RAD
    slice_std = min(elevation_std_rad, 0.4 * SLICE_STEP_RAD)
    scores = np.empty((len(steps), N_BINS))
    _vote(normal, centre, direction, lines.sigma_rad, lines.arc_rad, elevation_rad + steps, slice_std, scores)
    scores -= 0.5 * (steps[:, None] / elevation_std_rad) ** 2
    headings: FloatArray = -0.5 * pi + (np.arange(N_BINS, dtype=np.float64) + 0.5) * BIN_RAD
    ranked = scores + _log_prior(headings, prior_heading_rad, prior_heading_std_rad)
    ranked[~_local_maxima(scores)] = -np.inf  # the flank of a peak beyond the allowed range is none
    k, b = np.unravel_index(int(np.argmax(ranked)), scores.shape)
    if not ranked[k, b] > 0.0:
        return None
    residual = np.empty(len(lines))
    out = np.empty(7)
    _refine(
        normal,
        centre,
        direction,
        lines.sigma_rad,
        lines.arc_rad,
        float(headings[b]),
        elevation_rad + float(steps[k]),
        elevation_rad,
        elevation_std_rad,
        residual,
        out,
    )
    information = np.array([[out[2], out[3]], [out[3], out[4]]])
    if not np.linalg.det(information) > 0.0:
        return None
    if abs(out[0] - headings[b]) > MAX_REFINEMENT_RAD:
        return None  # the fit left the peak it started from: there was no axis, only a crowd
    offset = (headings - out[0] + 0.5 * pi) % pi - 0.5 * pi
    best_of_elevation = ranked.max(axis=0)
    rivals = np.where(np.abs(offset) > RIVAL_DISTANCE_RAD, best_of_elevation, -np.inf)
    second = int(np.argmax(rivals))
    covariance = np.linalg.inv(information) * max(
        1.0, CORRELATION * float(out[5]) / max(float(out[6]) - 2.0, 1.0)
    )
    # The fit knows its own peak only; where the vote is broad or split within the rivals' distance, so is the heading.
    spread = _vote_variance(scores.max(axis=0), offset)
    if spread > covariance[0, 0]:
        wider = np.array([sqrt(spread / covariance[0, 0]), 1.0])
        covariance = covariance * np.outer(wider, wider)
    return AxisFit(
        heading_rad=float(out[0]),
        elevation_rad=float(out[1]),
        covariance=covariance,
        score=float(ranked[k, b]),
        second_heading_rad=float(headings[second]),
        second_score=float(rivals[second]),
        residual=residual,
        inlier=(np.abs(residual) < INLIER_SIGMA) & (np.abs(normal[:, 2]) >= VERTICAL_SINE),
    )


def _vote_variance(scores: FloatArray, offset_rad: FloatArray) -> float:
    """Variance of the heading about the fit, by the vote within the rivals' distance taken as a likelihood."""
    near = np.abs(offset_rad) <= RIVAL_DISTANCE_RAD
    likelihood = np.exp((scores[near] - scores[near].max()) / VOTE_TEMPERATURE)
    return max(float(likelihood @ offset_rad[near] ** 2 / likelihood.sum()) - BIN_RAD**2 / 12.0, 0.0)


def _local_maxima(scores: FloatArray) -> npt.NDArray[np.bool_]:
    """Mark the headings whose score, over all elevations, nothing within a degree exceeds."""
    best = scores.max(axis=0)
    padded = np.pad(best, PEAK_BINS, mode="edge")
    neighbourhood = np.lib.stride_tricks.sliding_window_view(padded, 2 * PEAK_BINS + 1).max(axis=1)
    return np.asarray((best >= neighbourhood)[None, :] & (scores >= best), np.bool_)


def _log_prior(headings: FloatArray, heading_rad: float, std_rad: float) -> FloatArray:
    if heading_rad != heading_rad:
        log_prior = -0.5 * (headings / HEADING_PRIOR_STD_RAD) ** 2
        return np.where(np.abs(headings) <= MAX_HEADING_RAD, log_prior, -np.inf)
    # The filter can be wrong: a floor under its Gaussian lets strong evidence win against it.
    z = ((headings - heading_rad + 0.5 * pi) % pi - 0.5 * pi) / hypot(std_rad, radians(1.0))
    return np.asarray(np.log(0.01 + np.exp(-0.5 * z * z)))
