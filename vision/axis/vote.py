"""The exhaustive vote over heading and elevation, and what its shape tells.

Each line counts by the log-likelihood that it passes through the axis rather than somewhere at random, cut off at
zero: a parabola over heading, centred where the line meets the horizon.
"""

from __future__ import annotations

from math import atan2, cos, exp, hypot, log, pi, radians, sin, sqrt

import numpy as np
import numpy.typing as npt

from vision.compiled import compiled

FloatArray = npt.NDArray[np.float64]

N_BINS = 720
BIN_RAD = pi / N_BINS
PEAK_BINS = 4  # a peak exceeds everything within a degree
ALIGN_STD_RAD = radians(0.10)  # lines along a real corridor are parallel to about this
INLIER_ODDS = 0.25  # share of lines expected to run along the corridor
VERTICAL_SINE = 0.10  # a plane this close to vertical may be a door post's: it says nothing about the axis
STEEP_SINE = 0.3  # and one up to here is trusted less: streaks on a wall, leaning things
VOTE_TEMPERATURE = 0.8  # the edges of one door or board err together: so many lines speak as one
RIVAL_DISTANCE_RAD = radians(8.0)
HEADING_PRIOR_STD_RAD = radians(30.0)  # the camera looks along the corridor rather than across
MAX_HEADING_RAD = radians(60.0)  # without a filter's word, what is farther off is taken for a transverse axis
PRIOR_FLOOR_STD_RAD = radians(1.0)
PRIOR_DOUBT = 0.01  # a filter can be wrong: strong evidence wins against it

# columns of `weigh`'s result
BEST_BIN, BEST_SLICE, BEST_SCORE = range(3)


@compiled
def line_std(alpha: float, beta: float, sigma: float, arc: float) -> float:
    """Return the standard deviation of ``n . d``; alpha, beta: components of d along the line's middle, direction."""
    rotation = 3.4641 * sigma / arc
    return sqrt((sigma * alpha) ** 2 + (rotation * beta) ** 2 + ALIGN_STD_RAD * ALIGN_STD_RAD)


@compiled
def bin_heading(b: int) -> float:
    """Return the heading (rad) at the middle of a bin."""
    return -0.5 * pi + (b + 0.5) * BIN_RAD


@compiled
def vote(
    normal: FloatArray,
    centre: FloatArray,
    direction: FloatArray,
    sigma: FloatArray,
    arc: FloatArray,
    elevation: FloatArray,
    elevation_std: float,
    scores: FloatArray,
) -> None:
    """Fill ``scores`` (elevations, N_BINS) with the sum of the lines' truncated log-likelihoods.

    Lines (n, 3) are given in the level frame as in `vision.lines.segments.LineSet`; ``elevation_std`` is the half
    width of a slice.
    """
    scores[:] = 0.0
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


@compiled
def _log_prior(heading: float, prior_heading: float, prior_std: float) -> float:
    if prior_heading != prior_heading:
        if abs(heading) > MAX_HEADING_RAD:
            return -np.inf
        return -0.5 * (heading / HEADING_PRIOR_STD_RAD) ** 2
    z = ((heading - prior_heading + 0.5 * pi) % pi - 0.5 * pi) / hypot(prior_std, PRIOR_FLOOR_STD_RAD)
    return log(PRIOR_DOUBT + exp(-0.5 * z * z))


@compiled
def weigh(
    scores: FloatArray,
    elevation: FloatArray,
    elevation_std: float,
    prior_heading: float,
    prior_std: float,
    marginal: FloatArray,
    ranked: FloatArray,
    best: FloatArray,
) -> None:
    """Find the best peak; NaN as ``prior_heading``: no filter.

    Parameters
    ----------
    scores, elevation, elevation_std
        As `vote` left them; ``elevation`` relative to the expected one, with its standard deviation.
    prior_heading, prior_std
        A filter's prediction.
    marginal
        Filled (N_BINS,): each heading's score at its best elevation.
    ranked
        Filled (N_BINS,): the same with the prior, minus infinity where there is no peak.
    best
        Filled (3,): bin, slice and ranked score of the best peak.
    """
    for b in range(N_BINS):
        top = -np.inf
        for k in range(len(elevation)):
            z = elevation[k] / elevation_std
            top = max(top, scores[k, b] - 0.5 * z * z)
        marginal[b] = top
    best[BEST_SCORE] = -np.inf
    for b in range(N_BINS):
        ranked[b] = -np.inf
        peak = True
        for c in range(max(b - PEAK_BINS, 0), min(b + PEAK_BINS, N_BINS - 1) + 1):
            peak &= marginal[c] <= marginal[b]
        if not peak:
            continue
        ranked[b] = marginal[b] + _log_prior(bin_heading(b), prior_heading, prior_std)
        if ranked[b] > best[BEST_SCORE]:
            best[BEST_SCORE] = ranked[b]
            best[BEST_BIN] = b
    for k in range(len(elevation)):
        z = elevation[k] / elevation_std
        if scores[k, int(best[BEST_BIN])] - 0.5 * z * z == marginal[int(best[BEST_BIN])]:
            best[BEST_SLICE] = k


@compiled
def rival_and_variance(marginal: FloatArray, ranked: FloatArray, heading: float) -> tuple[int, float, float]:
    """Return the second-best peak (bin and ranked score), and the heading's variance (rad^2) by the vote.

    The rival is at least 8 degrees away. Nearer than that the vote is taken as a likelihood: where it is broad or
    split, the heading is uncertain, whatever the fit to one of its peaks says.
    """
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
    return second, second_score, max(variance / total - BIN_RAD * BIN_RAD / 12.0, 0.0)
