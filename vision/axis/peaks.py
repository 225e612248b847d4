"""The corridor's axis among the peaks of a vote, and the direction that rivals it.

To the vote comes the logarithm of the elevation's prior, a mixture of two Gaussians (`vision.axis.elevation`): level
corridors, whose axis is off the horizon by the level frame's error only, and a small share of sloping ones. The
heading's score is that of its best elevation (profile likelihood): left and right lines meet in one point only where
the elevation is right.

The peaks are the candidates for the axis. What the score has beside its best peak says by how much more its heading
is uncertain than the fit to that peak's lines.
"""

from __future__ import annotations

from math import cos, exp, hypot, log, pi, radians
from typing import NamedTuple

import numpy as np

from vision.axis.elevation import FINE_STEP_RAD, elevation_log_prior
from vision.axis.vote import BIN_RAD, MAX_HEADING_RAD, N_BINS, bin_heading
from vision.compiled import compiled, compiled_inner
from vision.types import FloatArray

PEAK_BINS = 4  # a peak exceeds everything within a degree
RIVAL_DISTANCE_RAD = radians(8.0)
RIVAL_BINS = int(RIVAL_DISTANCE_RAD / BIN_RAD)
VOTE_TEMPERATURE = 0.8  # edges of one door or skirting board have a common error: so many lines count as one
NEGLIGIBLE = 15.0  # in the logarithm
SUBDIVISIONS = 8  # of a bin
MIN_COSINE = 0.3  # of a heading, for its elevation to tell the tilt error
HEADING_PRIOR_STD_RAD = radians(30.0)  # the camera looks along the corridor rather than across
PRIOR_FLOOR_STD_RAD = radians(1.0)
PRIOR_OUTLIER_SHARE = 0.01  # a filter can be wrong: strong evidence wins against it
# Log-likelihood of lines that all lie below the axis, or above it. Of simulated corridors whose floor is laid at an
# angle, 18 accepts one in 70 by the floor; 10 rejects one corridor in 20 of those with little but the floor in view.
MAX_ONE_SIDED = 14.0


class HeadingVote(NamedTuple):
    """Score of every heading, and the best peak among them.

    Parameters
    ----------
    scores, elevation, elevation_std
        The vote (2, m, N_BINS), the elevations it tried (m,) relative to the expected one, and the standard deviation
        of that, radians.
    marginal
        Each heading's score at its best elevation (N_BINS,), log-likelihood over lines at random.
    log_prior
        Of each heading (N_BINS,), minus infinity where there is no peak.
    best_bin, best_elevation, best_score
        Bin of the best peak, index of its elevation, and its score by `corridor_score` and the prior.
    """

    scores: FloatArray
    elevation: FloatArray
    elevation_std: float
    marginal: FloatArray
    log_prior: FloatArray
    best_bin: int
    best_elevation: int
    best_score: float


class RivalPeak(NamedTuple):
    """The second-best peak of a vote, and what there is beside the best one.

    Parameters
    ----------
    bin, score
        Bin of the second-best peak and its score by `corridor_score` and the prior.
    excess_variance
        By how much the heading's variance about the best peak exceeds that peak's own, rad^2, taking the vote for a
        likelihood.
    """

    bin: int
    score: float
    excess_variance: float


@compiled
def corridor_score(below: float, above: float) -> float:
    """Return the evidence that a direction is a corridor's, from that of the lines below and above the axis.

    Lines of one direction in one plane need no corridor: a floor may be laid at any angle to the walls, and has many
    parallel joints. However many there are, they count as one coincidence, which has a limited improbability. A
    corridor has lines in other planes, too.
    """
    return min(below, above) + min(max(below, above), MAX_ONE_SIDED)


@compiled_inner
def _log_prior(heading: float, prior_heading: float, prior_std: float) -> float:
    by_view = -0.5 * (heading / HEADING_PRIOR_STD_RAD) ** 2 if abs(heading) <= MAX_HEADING_RAD else -np.inf
    if prior_heading != prior_heading:
        return by_view
    z = ((heading - prior_heading + 0.5 * pi) % pi - 0.5 * pi) / hypot(prior_std, PRIOR_FLOOR_STD_RAD)
    # Where the prediction is wrong, a heading is as likely as without one: else it would be across the view.
    return log(PRIOR_OUTLIER_SHARE * exp(by_view) + exp(-0.5 * z * z))


@compiled_inner
def _highest(scores: FloatArray, b: int, reach: int) -> int:
    """Return the bin of the highest score (N_BINS,) within reach of bin b; b itself where none exceeds it."""
    highest = b
    for c in range(max(b - reach, 0), min(b + reach, N_BINS - 1) + 1):
        if scores[c] > scores[highest]:
            highest = c
    return highest


@compiled_inner
def _is_peak(scores: FloatArray, b: int) -> bool:
    """Whether no score (N_BINS,) within `PEAK_BINS` of bin b exceeds its own."""
    c, last = max(b - PEAK_BINS, 0), min(b + PEAK_BINS, N_BINS - 1)
    while c <= last and not scores[c] > scores[b]:
        c += 1
    return c > last


@compiled_inner
def _score_near(
    scores: FloatArray, b: int, elevations: FloatArray, elevation: float, std: float
) -> tuple[int, float]:
    """Return where a heading has most evidence near an elevation, and its score there.

    ``elevation`` with its standard deviation is what another heading says of the tilt error.
    """
    best, highest, score = 0, -np.inf, -np.inf
    std = hypot(std, 0.5 * FINE_STEP_RAD)
    for k in range(len(elevations)):
        z = (elevations[k] - elevation) / std
        below, above = scores[0, k, b], scores[1, k, b]
        if below + above - 0.5 * z * z > highest:
            highest = below + above - 0.5 * z * z
            best, score = k, corridor_score(below, above) - 0.5 * z * z
    return best, score


@compiled_inner
def find_best_heading(
    scores: FloatArray, elevation: FloatArray, elevation_std: float, prior_heading: float, prior_std: float
) -> HeadingVote:
    """Find the best peak of a vote.

    Parameters
    ----------
    scores
        Result of `vote`, (2, m, N_BINS).
    elevation, elevation_std
        The elevations it tried (m,) relative to the expected one, and the standard deviation of that, radians.
    prior_heading, prior_std
        A filter's prediction, radians; NaN: none.
    """
    marginal, log_prior = np.empty(N_BINS), np.empty(N_BINS)
    prior = np.array([elevation_log_prior(e, elevation_std) for e in elevation])
    marginal[:] = -np.inf
    for k in range(len(elevation)):
        below, above, level_prior = scores[0, k], scores[1, k], prior[k]
        for b in range(N_BINS):
            score = below[b] + above[b] + level_prior
            marginal[b] = score if score > marginal[b] else marginal[b]
    ranked = np.full(N_BINS, -np.inf)
    for b in range(N_BINS):
        log_prior[b] = -np.inf
        if _is_peak(marginal, b):
            log_prior[b] = _log_prior(bin_heading(b), prior_heading, prior_std)
            ranked[b] = marginal[b] + log_prior[b]
    best_bin, best_elevation, best_score = 0, 0, -np.inf
    for b in range(N_BINS):
        if ranked[b] == -np.inf:
            continue
        # At another elevation the lines of one axis have several peaks: the highest says what the elevation is.
        highest = _highest(ranked, b, RIVAL_BINS)
        k = 0
        while scores[0, k, highest] + scores[1, k, highest] + prior[k] != marginal[highest]:
            k += 1
        if highest == b:
            score = corridor_score(scores[0, k, b], scores[1, k, b])
        else:
            k, score = _score_near(scores, b, elevation, elevation[k], elevation_std)
        score += prior[k] + log_prior[b]
        if score > best_score:
            best_bin, best_elevation, best_score = b, k, score
    return HeadingVote(
        scores, elevation, elevation_std, marginal, log_prior, best_bin, best_elevation, best_score
    )


@compiled_inner
def _excess_variance(marginal: FloatArray, heading: float) -> float:
    """Return by how much (rad^2) the variance about a heading exceeds that of the peak there.

    ``marginal`` is taken for the logarithm of a likelihood. From bin to bin it is interpolated by parabolas, which it
    consists of, so that it does not matter where the bins lie. The peak itself is the Gaussian of its curvature.
    """
    middle = int((heading + 0.5 * pi) / BIN_RAD)
    best, top = middle, -np.inf
    for b in range(middle - RIVAL_BINS, middle + RIVAL_BINS + 1):
        if marginal[b % N_BINS] > top:
            best, top = b, marginal[b % N_BINS]
    total = variance = curvature = 0.0
    for b in range(middle - RIVAL_BINS, middle + RIVAL_BINS + 1):
        before, here, after = marginal[(b - 1) % N_BINS], marginal[b % N_BINS], marginal[(b + 1) % N_BINS]
        rise, bend = 0.5 * (after - before), 0.5 * (after + before) - here
        if abs(b - best) <= 1:
            # the mean of three: the lines' cut-offs are kinks
            curvature -= 2.0 * bend / (3.0 * BIN_RAD * BIN_RAD)
        if here < top - NEGLIGIBLE * VOTE_TEMPERATURE:
            continue
        for i in range(SUBDIVISIONS):
            u = (i + 0.5) / SUBDIVISIONS - 0.5
            likelihood = exp((here - top + (rise + bend * u) * u) / VOTE_TEMPERATURE)
            total += likelihood
            variance += likelihood * (bin_heading(b) + u * BIN_RAD - heading) ** 2
    if curvature <= 0.0:
        return RIVAL_DISTANCE_RAD**2
    return max(variance / total - VOTE_TEMPERATURE / curvature, 0.0)


@compiled
def find_rival(voted: HeadingVote, at_axis: FloatArray, heading: float, elevation: float) -> RivalPeak:
    """Find the second-best peak, at least 8 degrees from the axis, and what the vote has nearer beside its peak.

    Where the vote is split between headings nearer than that, the heading is uncertain, whatever the fit to one of
    its peaks says. A rival does not choose an elevation of its own: a tilt error that lifts the axis lifts every
    level direction with it.

    Parameters
    ----------
    voted
        Result of `find_best_heading`.
    at_axis
        The vote (N_BINS,) at the axis's own elevation.
    heading, elevation
        The axis after its refinement, radians; the elevation relative to the expected one.
    """
    second = 0
    second_score = -np.inf
    for b in range(N_BINS):
        if voted.log_prior[b] == -np.inf:
            continue
        offset = (bin_heading(b) - heading + 0.5 * pi) % pi - 0.5 * pi
        if abs(offset) <= RIVAL_DISTANCE_RAD:
            continue
        lifted = elevation * cos(bin_heading(b)) / max(cos(heading), MIN_COSINE)
        score = _score_near(voted.scores, b, voted.elevation, lifted, voted.elevation_std)[1]
        score += voted.log_prior[b]
        if score > second_score:
            second_score = score
            second = b
    marginal = np.maximum(voted.marginal, at_axis + elevation_log_prior(elevation, voted.elevation_std))
    return RivalPeak(second, second_score, _excess_variance(marginal, heading))
