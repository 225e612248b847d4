"""Selection of the corridor's axis among the peaks of a vote, and the second-best direction.

The log-prior of the elevation (`vision.axis.elevation`) is added to the vote. The score of a heading is its maximum
over the elevations (profile likelihood): lines on the left and right meet in one point only at the right elevation.
The peaks of this score are the candidates. The log-prior of the heading is added to each: a Gaussian about the
camera's direction or about a filter's prediction, the latter mixed with a small outlier share. The evidence of lines
in one plane is limited (`corridor_score`), because parallel joints in one plane do not prove a corridor.

The best peak is the axis. The best one at least 8 degrees away is its rival, which `vision.axis.acceptance` compares
with it. Where the score has more mass near the best peak than the peak's own Gaussian, that excess variance is added
to the heading's. Lines that are no inliers may agree on another direction a few degrees away: then the walls are not
parallel, or the corridor bends, and `split_variance` is added too.
"""

from __future__ import annotations

from math import cos, exp, hypot, log, pi, radians
from typing import NamedTuple

import numpy as np

from vision.axis.elevation import FINE_STEP_RAD, elevation_log_prior
from vision.axis.vote import BIN_RAD, MAX_HEADING_RAD, N_BINS, bin_heading
from vision.compiled import compiled, compiled_inner
from vision.types import FloatArray

PEAK_BINS = 4  # a peak is the maximum within one degree to both sides
RIVAL_DISTANCE_RAD = radians(8.0)
RIVAL_BINS = int(RIVAL_DISTANCE_RAD / BIN_RAD)
VOTE_TEMPERATURE = 0.8  # divides the score: edges of one door or skirting board have common errors
NEGLIGIBLE = 15.0  # difference of log-likelihoods
SUBDIVISIONS = 8  # of a bin
MIN_COSINE = 0.3  # lower limit of the heading's cosine where the tilt error is computed from the elevation
HEADING_PRIOR_STD_RAD = radians(30.0)  # the camera looks along the corridor rather than across
PRIOR_FLOOR_STD_RAD = radians(1.0)
PRIOR_OUTLIER_SHARE = 0.01  # probability that the prediction is wrong: strong evidence overrides it
# Log-likelihood of lines that are all below the axis, or all above it. In simulated corridors with floor joints at an
# angle to the walls, 18 accepts the floor's direction in one of 70; 10 rejects one of 20 corridors that show mostly
# floor.
MAX_ONE_SIDED = 14.0
MIN_EXCESS = 3.0  # log-likelihood ratio; of few lines, chance alone reaches a tenth of the score
SPLIT_RAD = radians(6.0)  # of the axis, where the lines of another wall, or of what is behind a bend, agree
STRAY_RAD = radians(8.0), radians(20.0)  # of the axis, where only stray lines agree
STRAY_SHARE, SPLIT_SHARE = 0.1, 0.2  # of the axis's score: where a split begins to count, and counts in full


class HeadingVote(NamedTuple):
    """Score of every heading, and the best peak.

    Parameters
    ----------
    scores, elevation, elevation_std
        The vote (2, m, N_BINS), its elevations (m,) relative to the predicted one, and the standard deviation of the
        prediction, radians.
    marginal
        Each heading's score at its best elevation (N_BINS,), log-likelihood ratio against random lines.
    log_prior
        Log-prior of each heading (N_BINS,), minus infinity where there is no peak.
    best_bin, best_elevation, best_score
        Bin of the best peak, index of its elevation, and its score by `corridor_score` and the priors.
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
    """The second-best peak of a vote, and the excess variance about the best one.

    Parameters
    ----------
    bin, score
        Bin of the second-best peak and its score by `corridor_score` and the prior.
    excess_variance
        Variance of the heading near the best peak, with the vote as log-likelihood, minus the peak's own, rad^2.
    """

    bin: int
    score: float
    excess_variance: float


@compiled
def corridor_score(below: float, above: float) -> float:
    """Return the evidence that a direction is a corridor's, from the scores of the lines below and above the axis.

    Parallel lines in one plane are no proof of a corridor: floor joints may be laid at any angle to the walls. All of
    them together count as one coincidence, with limited evidence; a corridor has lines in other planes as well.
    """
    return min(below, above) + min(max(below, above), MAX_ONE_SIDED)


@compiled_inner
def _log_prior(heading: float, prior_heading: float, prior_std: float) -> float:
    by_view = -0.5 * (heading / HEADING_PRIOR_STD_RAD) ** 2 if abs(heading) <= MAX_HEADING_RAD else -np.inf
    if prior_heading != prior_heading:
        return by_view
    z = ((heading - prior_heading + 0.5 * pi) % pi - 0.5 * pi) / hypot(prior_std, PRIOR_FLOOR_STD_RAD)
    # The outlier share uses the prior without a prediction: a uniform one would favour directions across the view.
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
    """Return the index of a heading's best elevation, and its score there.

    ``elevation`` and ``std`` are a Gaussian prior of it, from the elevation of another heading.
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
        Its elevations (m,) relative to the predicted one, and the standard deviation of the prediction, radians.
    prior_heading, prior_std
        A filter's predicted heading, radians; NaN: none.
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
        # At a wrong elevation the lines of one axis form several peaks: the highest one nearby fixes the elevation.
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
    """Return the variance about a heading (rad^2) in excess of the peak's own.

    ``marginal`` is used as a log-likelihood. It is a sum of parabolas, so interpolation by parabolas makes the result
    independent of the bins' positions. The peak's own variance follows from its curvature.
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
            # mean of three second differences: truncated parabolas have kinks
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
def split_variance(rest: FloatArray, heading: float, score: float) -> float:
    """Return the variance of the heading (rad^2) due to a second direction of the corridor near the axis.

    It is that between the two directions, weighted by their scores. It counts from the second one's score less what
    stray lines reach further away.

    Parameters
    ----------
    rest
        Vote (N_BINS,) of the lines that are no inliers.
    heading, score
        The axis, and its score without limit.
    """
    best, near, right, left = 0.0, 0.0, 0.0, 0.0
    for b in range(N_BINS):
        apart = (bin_heading(b) - heading + 0.5 * pi) % pi - 0.5 * pi
        if abs(apart) < SPLIT_RAD and rest[b] > best:
            best, near = rest[b], apart
        elif STRAY_RAD[0] < apart < STRAY_RAD[1]:
            right = max(right, rest[b])
        elif STRAY_RAD[0] < -apart < STRAY_RAD[1]:
            left = max(left, rest[b])
    score = max(score, 1.0)
    excess = best - 0.5 * (left + right) - max(STRAY_SHARE * score, MIN_EXCESS)
    counts = min(max(excess / ((SPLIT_SHARE - STRAY_SHARE) * score), 0.0), 1.0)
    return counts * near * near * best / (best + score)


@compiled
def find_rival(voted: HeadingVote, at_axis: FloatArray, heading: float, elevation: float) -> RivalPeak:
    """Find the second-best peak, at least 8 degrees from the axis, and the excess variance within 8 degrees of it.

    Where the vote is split between headings within 8 degrees, the heading is uncertain even if the fit to one of
    them is precise. The rival's elevation is not free: a tilt error that raises the axis raises all level directions,
    by ``elevation * cos(rival heading) / cos(heading)``.

    Parameters
    ----------
    voted
        Result of `find_best_heading`.
    at_axis
        The vote (N_BINS,) at the axis's fitted elevation.
    heading, elevation
        The refined axis, radians; the elevation relative to the predicted one.
    """
    second = 0
    second_score = -np.inf
    for b in range(N_BINS):
        if voted.log_prior[b] == -np.inf:
            continue
        offset = (bin_heading(b) - heading + 0.5 * pi) % pi - 0.5 * pi
        if abs(offset) <= RIVAL_DISTANCE_RAD:
            continue
        raised = elevation * cos(bin_heading(b)) / max(cos(heading), MIN_COSINE)
        score = _score_near(voted.scores, b, voted.elevation, raised, voted.elevation_std)[1]
        score += voted.log_prior[b]
        if score > second_score:
            second_score = score
            second = b
    marginal = np.maximum(voted.marginal, at_axis + elevation_log_prior(elevation, voted.elevation_std))
    return RivalPeak(second, second_score, _excess_variance(marginal, heading))
