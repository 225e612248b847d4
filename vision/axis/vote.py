"""The exhaustive vote over heading and elevation of the corridor's axis.

Each line adds the log-likelihood that it passes through the axis rather than somewhere at random, cut off at zero: a
parabola over heading, centred where the line meets the horizon. The vote's peaks are the candidates for the axis; how
broad the best one is says how uncertain its heading is.
"""

from __future__ import annotations

from math import atan2, cos, exp, hypot, log, pi, radians, sin, sqrt
from typing import NamedTuple

import numpy as np

from vision.compiled import compiled
from vision.lines.segments import LineGeometry
from vision.types import FloatArray

N_BINS = 720
BIN_RAD = pi / N_BINS
PEAK_BINS = 4  # a peak exceeds everything within a degree
ALIGN_STD_RAD = radians(0.10)  # lines along a real corridor are parallel to about this
INLIER_ODDS = 0.25  # share of lines expected to run along the corridor
VERTICAL_SINE = (
    0.10  # a plane this close to vertical may be a door post's, which has no information on the axis
)
STEEP_SINE = 0.3  # and one up to here has less weight: streaks on a wall, leaning objects
VOTE_TEMPERATURE = 0.8  # edges of one door or skirting board have a common error: so many lines count as one
RIVAL_DISTANCE_RAD = radians(8.0)
HEADING_PRIOR_STD_RAD = radians(30.0)  # the camera looks along the corridor rather than across
MAX_HEADING_RAD = radians(60.0)  # without a prediction, what is farther off is taken for a transverse axis
PRIOR_FLOOR_STD_RAD = radians(1.0)
PRIOR_DOUBT = 0.01  # a filter can be wrong: strong evidence wins against it


class HeadingVote(NamedTuple):
    """Score of every heading, and the best peak among them.

    Parameters
    ----------
    marginal
        Each heading's score at its best elevation (N_BINS,), log-likelihood over lines at random.
    ranked
        The same with the prior added, minus infinity where there is no peak (N_BINS,).
    best_bin, best_elevation, best_score
        Bin of the best peak, index of its elevation, and its ranked score.
    """

    marginal: FloatArray
    ranked: FloatArray
    best_bin: int
    best_elevation: int
    best_score: float


class RivalPeak(NamedTuple):
    """The second-best peak of a vote, and how broad the best one is.

    Parameters
    ----------
    bin, score
        Bin of the second-best peak and its ranked score.
    best_variance
        Variance of the heading about the best peak, rad^2, taking the vote for a likelihood.
    """

    bin: int
    score: float
    best_variance: float


@compiled
def line_std(alpha: float, beta: float, sigma: float, arc: float) -> float:
    """Return the standard deviation of a corridor line's residual ``n . d``.

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
    return sqrt((sigma * alpha) ** 2 + (rotation * beta) ** 2 + ALIGN_STD_RAD * ALIGN_STD_RAD)


@compiled
def bin_heading(b: int) -> float:
    """Return the heading (rad) at the middle of a bin."""
    return -0.5 * pi + (b + 0.5) * BIN_RAD


@compiled
def vote(lines: LineGeometry, elevation: FloatArray, elevation_std: float) -> FloatArray:
    """Add up the lines' truncated log-likelihoods of every heading and elevation of the axis.

    Parameters
    ----------
    lines
        The picture's lines, level frame.
    elevation
        Elevations to try (m,), radians.
    elevation_std
        Half the step between them.

    Returns
    -------
    ndarray
        Scores (m, N_BINS), log-likelihood over lines at random.
    """
    normal, centre, direction = lines.normal, lines.centre, lines.direction
    sigma, arc = lines.sigma_rad, lines.arc_rad
    scores = np.zeros((len(elevation), N_BINS))
    for i in range(len(sigma)):
        nx = normal[i, 0]
        ny = normal[i, 1]
        nz = normal[i, 2]
        if abs(nz) < VERTICAL_SINE:
            continue
        trust = min(abs(nz) / STEEP_SINE, 1.0)
        a = max(hypot(nx, ny), 1e-9)
        g = atan2(-ny, nx)
        for k in range(len(elevation)):
            e = elevation[k]
            cosine = nz * np.tan(e) / a
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
                r_std = line_std(alpha, beta, sigma[i], arc[i])
                slope = max(abs(nx * sin(psi) + ny * cos(psi)) * cos(e), 1e-6)
                variance = (r_std * r_std + (nz * elevation_std) ** 2) / (
                    slope * slope
                ) + BIN_RAD * BIN_RAD / 3.0
                top = log(INLIER_ODDS * pi / (2.5066 * sqrt(variance)))
                if top <= 0.0:
                    continue
                reach = sqrt(2.0 * top * variance)
                first = int(np.ceil((psi - reach + 0.5 * pi) / BIN_RAD - 0.5))
                last = int(np.floor((psi + reach + 0.5 * pi) / BIN_RAD - 0.5))
                for b in range(max(first, 0), min(last, N_BINS - 1) + 1):
                    offset = bin_heading(b) - psi
                    scores[k, b] += trust * (top - 0.5 * offset * offset / variance)
    return scores


@compiled
def _log_prior(heading: float, prior_heading: float, prior_std: float) -> float:
    if prior_heading != prior_heading:
        if abs(heading) > MAX_HEADING_RAD:
            return -np.inf
        return -0.5 * (heading / HEADING_PRIOR_STD_RAD) ** 2
    z = ((heading - prior_heading + 0.5 * pi) % pi - 0.5 * pi) / hypot(prior_std, PRIOR_FLOOR_STD_RAD)
    return log(PRIOR_DOUBT + exp(-0.5 * z * z))


@compiled
def find_best_heading(
    scores: FloatArray, elevation: FloatArray, elevation_std: float, prior_heading: float, prior_std: float
) -> HeadingVote:
    """Find the best peak of a vote.

    Parameters
    ----------
    scores
        Result of `vote`, (m, N_BINS).
    elevation, elevation_std
        The elevations it tried (m,) relative to the expected one, and the standard deviation of that, radians.
    prior_heading, prior_std
        A filter's prediction, radians; NaN: none.
    """
    marginal, ranked = np.empty(N_BINS), np.empty(N_BINS)
    for b in range(N_BINS):
        top = -np.inf
        for k in range(len(elevation)):
            z = elevation[k] / elevation_std
            top = max(top, scores[k, b] - 0.5 * z * z)
        marginal[b] = top
    best_bin, best_elevation, best_score = 0, 0, -np.inf
    for b in range(N_BINS):
        ranked[b] = -np.inf
        peak = True
        for c in range(max(b - PEAK_BINS, 0), min(b + PEAK_BINS, N_BINS - 1) + 1):
            peak &= marginal[c] <= marginal[b]
        if not peak:
            continue
        ranked[b] = marginal[b] + _log_prior(bin_heading(b), prior_heading, prior_std)
        if ranked[b] > best_score:
            best_score = ranked[b]
            best_bin = b
    for k in range(len(elevation)):
        z = elevation[k] / elevation_std
        if scores[k, best_bin] - 0.5 * z * z == marginal[best_bin]:
            best_elevation = k
    return HeadingVote(marginal, ranked, best_bin, best_elevation, best_score)


@compiled
def find_rival(voted: HeadingVote, heading: float) -> RivalPeak:
    """Find the second-best peak, at least 8 degrees from a heading (rad), and how broad the best one is.

    Nearer than that the vote is taken as a likelihood: where it is broad or split, the heading is uncertain, whatever
    the fit to one of its peaks says.
    """
    marginal, ranked = voted.marginal, voted.ranked
    second = 0
    second_score = -np.inf
    top = -np.inf
    for b in range(N_BINS):
        offset = (bin_heading(b) - heading + 0.5 * pi) % pi - 0.5 * pi
        if abs(offset) > RIVAL_DISTANCE_RAD:
            if ranked[b] > second_score:
                second_score = ranked[b]
                second = b
        else:
            top = max(top, marginal[b])
    total = 0.0
    variance = 0.0
    for b in range(N_BINS):
        offset = (bin_heading(b) - heading + 0.5 * pi) % pi - 0.5 * pi
        if abs(offset) <= RIVAL_DISTANCE_RAD:
            likelihood = exp((marginal[b] - top) / VOTE_TEMPERATURE)
            total += likelihood
            variance += likelihood * offset * offset
    return RivalPeak(second, second_score, max(variance / total - BIN_RAD * BIN_RAD / 12.0, 0.0))
