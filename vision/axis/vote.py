"""The exhaustive vote over heading and elevation of the corridor's axis.

At every elevation each line adds the log-likelihood that it passes through the axis rather than somewhere at random,
cut off at zero: a parabola over heading, centred where the line meets that elevation. To the sum comes the logarithm
of the elevation's prior, a mixture of two Gaussians: level corridors, whose axis is off the horizon by the level
frame's error only, and a small share of sloping ones. The heading's score is that of its best elevation (profile
likelihood): left and right lines meet in one point only where the elevation is right.

The peaks are the candidates for the axis. What the score has beside its best peak says by how much more its heading
is uncertain than the fit to that peak's lines.
"""

from __future__ import annotations

from math import atan2, cos, exp, hypot, log, pi, radians, sqrt
from typing import NamedTuple

import numpy as np

from vision.compiled import compiled, compiled_inner
from vision.lines.line_set import LineGeometry
from vision.types import FloatArray

N_BINS = 720
BIN_RAD = pi / N_BINS
PEAK_BINS = 4  # a peak exceeds everything within a degree
ALIGN_STD_RAD = radians(0.07)  # lines along a real corridor are parallel to about this
INLIER_ODDS = 0.25  # share of lines expected to run along the corridor
MAX_VARIANCE = (INLIER_ODDS * pi) ** 2 / (2.0 * pi)  # of a line's heading, rad^2, to tell more than chance
VERTICAL_SINE = (
    0.10  # a plane this close to vertical may be a door post's, which has no information on the axis
)
STEEP_SINE = 0.3  # and one up to here has less weight: streaks on a wall, leaning objects
VOTE_TEMPERATURE = 0.8  # edges of one door or skirting board have a common error: so many lines count as one
NEGLIGIBLE = 15.0  # in the logarithm
SUBDIVISIONS = 8  # of a bin
MIN_COSINE = 0.3  # of a heading, for its elevation to tell the tilt error
RIVAL_DISTANCE_RAD = radians(8.0)
RIVAL_BINS = int(RIVAL_DISTANCE_RAD / BIN_RAD)
HEADING_PRIOR_STD_RAD = radians(30.0)  # the camera looks along the corridor rather than across
MAX_HEADING_RAD = radians(60.0)  # without a prediction, what is farther off is taken for a transverse axis
SLOPE_STD_RAD = radians(2.5)  # of the elevation of ramps and of floors that are not level
SLOPE_SHARE = 0.02  # of corridors
FINE_STEP_RAD, COARSE_STEP_RAD = radians(0.5), radians(1.0)  # between elevations to try
STD_OF_SPACING = 0.4
FINEST_STD_RAD = STD_OF_SPACING * FINE_STEP_RAD
FINE_REACH_RAD, MAX_REACH_RAD = radians(1.0), radians(10.0)
PRIOR_FLOOR_STD_RAD = radians(1.0)
PRIOR_DOUBT = 0.01  # a filter can be wrong: strong evidence wins against it
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


@compiled
def vote(
    lines: LineGeometry, elevation: FloatArray, elevation_std: FloatArray, max_heading: float
) -> FloatArray:
    """Add up the lines' truncated log-likelihoods of every heading and elevation of the axis.

    Parameters
    ----------
    lines
        The picture's lines, level frame.
    elevation
        Elevations to try (m,), radians.
    elevation_std
        Standard deviation (m,) of those that each stands for.
    max_heading
        Headings beyond this are left out; `MAX_HEADING_RAD` without a prediction, else a right angle.

    Returns
    -------
    ndarray
        Scores (2, m, N_BINS), log-likelihood over lines at random: of the lines below the axis, and of those above.
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
                top = 0.5 * log(MAX_VARIANCE / variance)
                psi = atan2(sp, cp)
                reach = sqrt(2.0 * top * variance)
                first = max(int(np.ceil((psi - reach + 0.5 * pi) / BIN_RAD - 0.5)), 0)
                last = min(int(np.floor((psi + reach + 0.5 * pi) / BIN_RAD - 0.5)), N_BINS - 1)
                down = ce * centre[i, 2] + se * (centre[i, 0] * cp - centre[i, 1] * sp)
                row = scores[0 if down > 0.0 else 1, k]
                bend, start = 0.5 * trust / variance, bin_heading(first) - psi
                for b in range(last - first + 1):  # from zero: then it vectorises
                    offset = start + b * BIN_RAD
                    row[first + b] += trust * top - bend * offset * offset
    return scores


@compiled
def corridor_score(below: float, above: float) -> float:
    """Return the evidence that a direction is a corridor's, from that of the lines below and above the axis.

    Lines of one direction in one plane need no corridor: a floor may be laid at any angle to the walls, and its
    joints are as many as one likes. That they are there is a coincidence of limited improbability, which is all that
    they say. A corridor has lines in other planes, too.
    """
    return min(below, above) + min(max(below, above), MAX_ONE_SIDED)


@compiled_inner
def _log_prior(heading: float, prior_heading: float, prior_std: float) -> float:
    by_view = -0.5 * (heading / HEADING_PRIOR_STD_RAD) ** 2 if abs(heading) <= MAX_HEADING_RAD else -np.inf
    if prior_heading != prior_heading:
        return by_view
    z = ((heading - prior_heading + 0.5 * pi) % pi - 0.5 * pi) / hypot(prior_std, PRIOR_FLOOR_STD_RAD)
    # Where the prediction is wrong, a heading is as likely as without one: else it would be across the view.
    return log(PRIOR_DOUBT * exp(by_view) + exp(-0.5 * z * z))


@compiled
def elevations_to_try(std: float) -> tuple[FloatArray, FloatArray]:
    """Return elevations (m,) about the expected one, closer together where corridors are level, and their stds.

    Parameters
    ----------
    std
        Standard deviation of the elevation.

    Returns
    -------
    elevation, elevation_std
        Relative to the expected one, and the standard deviation of those that each stands for.
    """
    reach = min(2.0 * hypot(std, SLOPE_STD_RAD), MAX_REACH_RAD)
    n_fine = int(np.ceil(FINE_REACH_RAD / FINE_STEP_RAD))
    n = n_fine + max(int(np.ceil((reach - FINE_REACH_RAD) / COARSE_STEP_RAD)), 0)
    elevation, elevation_std = np.empty(2 * n - 1), np.empty(2 * n - 1)
    for k in range(n):
        up = k * FINE_STEP_RAD if k < n_fine else FINE_REACH_RAD + (k - n_fine) * COARSE_STEP_RAD
        elevation[n - 1 + k], elevation[n - 1 - k] = up, -up
    last = 2 * n - 2
    for k in range(2 * n - 1):
        # half the distance between its neighbours, or to its only one
        low, high = max(k - 1, 0), min(k + 1, last)
        spacing = (elevation[high] - elevation[low]) / max(high - low, 1)
        elevation_std[k] = min(std, STD_OF_SPACING * spacing) if last > 0 else std
    return elevation, elevation_std


@compiled
def elevation_log_prior(elevation: float, std: float) -> float:
    """Return the log of the elevation's prior density over that of a Gaussian's peak.

    Most corridors are level: then the axis's elevation is the error of the level frame, Gaussian with ``std``. A few
    slope: that adds their own elevation, and the sum is Gaussian, too. The prior is the mixture of both.
    """
    z = elevation / std
    wide = hypot(std, SLOPE_STD_RAD)
    y = elevation / wide
    return log((1.0 - SLOPE_SHARE) * exp(-0.5 * z * z) + SLOPE_SHARE * std / wide * exp(-0.5 * y * y))


@compiled
def elevation_information(elevation: float, std: float) -> float:
    """Return the information (rad^-2) of the Gaussian whose gradient there is that of `elevation_log_prior`.

    It is the mean of both Gaussians' information by their share of the density: iterated, it finds the maximum of
    the posterior (expectation-maximisation).
    """
    z = elevation / std
    wide = hypot(std, SLOPE_STD_RAD)
    y = elevation / wide
    level = (1.0 - SLOPE_SHARE) * exp(-0.5 * z * z) / std
    sloping = SLOPE_SHARE * exp(-0.5 * y * y) / wide
    return (level / (std * std) + sloping / (wide * wide)) / (level + sloping)


@compiled_inner
def _highest(scores: FloatArray, b: int, reach: int) -> int:
    """Return the bin of the highest score (N_BINS,) within reach of bin b; b itself where none exceeds it."""
    highest = b
    for c in range(max(b - reach, 0), min(b + reach, N_BINS - 1) + 1):
        if scores[c] > scores[highest]:
            highest = c
    return highest


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
        if _highest(marginal, b, PEAK_BINS) == b:
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
    reach = RIVAL_BINS
    middle = int((heading + 0.5 * pi) / BIN_RAD)
    best, top = middle, -np.inf
    for b in range(middle - reach, middle + reach + 1):
        if marginal[b % N_BINS] > top:
            best, top = b, marginal[b % N_BINS]
    total = variance = curvature = 0.0
    for b in range(middle - reach, middle + reach + 1):
        before, here, after = marginal[(b - 1) % N_BINS], marginal[b % N_BINS], marginal[(b + 1) % N_BINS]
        rise, bend = 0.5 * (after - before), 0.5 * (after + before) - here
        if abs(b - best) <= 1:
            curvature -= (
                2.0 * bend / (3.0 * BIN_RAD * BIN_RAD)
            )  # mean of three: the lines' cut-offs are kinks
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
