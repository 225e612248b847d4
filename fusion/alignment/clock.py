"""Time offset between camera and inertial sensors, and the ratio of the turns that each of them measured.

The model, for a frame stamped t while the vehicle flies along one corridor:

    heading(t) = ratio * yaw(t + offset) + drift * t + constant + errors

The constant differs from corridor to corridor and is known only up to half a turn, because a corridor looks the same
from both ends. Errors are white (the frame's) plus a random walk (the gyroscope's, and what successive frames have in
common). The gyroscope's share of the walk is noise of the regressor, which would make the ratio too small; it is
removed as in total least squares, by regressing on the yaw less the walk estimated from the residuals.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import radians

import numpy as np
import numpy.typing as npt

from fusion.alignment.markov import Noise, Process, find_noise, solve, weights
from fusion.alignment.turning import Turning
from fusion.alignment.views import Sightings
from vision.rotations import wrap_axis

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]
IntArray = npt.NDArray[np.int64]

COARSE_STEP_S = 0.01
PAIR_S = (0.2, 0.8)  # spacing of the frames compared in the coarse search
MIN_PAIRS = 12
COARSE_SIGMA_RAD = radians(1.0)
COARSE_ROUNDS = 4
MIN_SIGMA_RAD = radians(0.15)
RIVAL_APART_S = 0.3
N_RIVALS = 4
MIN_LEAD = 8.0  # in log-likelihood, of the best offset over its rivals
MIN_OVERLAP = 0.5  # share of the pairs that the inertial stream must cover at an offset
RATIO_RANGE = (0.3, 3.0)  # plausible ratios of turns
FIT_RATIO_RANGE = (0.001, 1000.0)  # for gyroscopes in any unit
MIN_RATIO_SIGMA = 8.0  # below it, the frames show no turn
USABLE_STD_S = 0.02
EDGE_S = 0.05

LEVEL_FRAMES = 15
NEW_LEVEL_FRAMES = 6
GATE_RAD = radians(5.0)
DRIFT_RAD_S = radians(0.6)  # drift of a level while no frame belongs to it
MAX_GATE_RAD = radians(20.0)

MIN_CLOCK_FRAMES = 12
ROUNDS = 12
NOISE_EVERY = 3
REACH_S = 0.25  # largest distance of the fine fit from its candidate
# A yaw rate between closer points would be mostly gyroscope noise, and look like a steep slope.
HALF_SLOPE_S = 0.1
OFFSET, RATIO, DRIFT = range(3)  # columns of the fit, before the constants
START_DENSITY = 0.005
MAX_STEP_S = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class Coarse:
    """A candidate of the coarse search; ``lead`` is its log-likelihood over that of unrelated turns."""

    offset_s: float
    ratio: float
    drift_rad_s: float
    evidence: float
    lead: float


@dataclass(frozen=True, slots=True, eq=False)
class ClockFit:
    """Time offset and ratio of turns, with standard deviations.

    Parameters
    ----------
    offset_s, offset_std_s
        To be added to the frames' stamps to bring them to the inertial sensors' clock.
    ratio, ratio_std
        Turns that vision saw over turns of the inertial sensors.
    drift_rad_s
        Negative bias of the inertial yaw rate.
    n_frames, n_corridors
        Number of frames used, and of constants fitted.
    turned_rad
        Standard deviation of the yaw over the frames, drift and constants removed.
    white_rad, walk_density
        Noise found: of a frame, and of the walk, rad/sqrt(s).
    samples
        The frames used.
    """

    offset_s: float
    offset_std_s: float
    ratio: float
    ratio_std: float
    drift_rad_s: float
    n_frames: int
    n_corridors: int
    turned_rad: float
    white_rad: float
    walk_density: float
    samples: _Samples


@dataclass(frozen=True, slots=True, eq=False)
class ClockSearch:
    """Result of the search for the time offset.

    Parameters
    ----------
    fit
        The best fit; None if too few frames could be compared.
    determined
        Whether the flight determines the offset.
    rival_s
        Another offset that explains the flight equally well; None if there is none.
    reversed
        Whether vision and inertial sensors turn in opposite directions.
    at_edge
        Whether the best offset is at the end of the searched range.
    compared
        Whether there were enough frames to compare.
    """

    fit: ClockFit | None
    determined: bool
    rival_s: float | None = None
    reversed: bool = False
    at_edge: bool = False
    compared: bool = False


def find_clock(sightings: Sightings, turning: Turning, reach_s: float) -> ClockSearch:
    """Search the offset within ``+-reach_s``, and judge whether the flight determines it."""
    coarse = coarse_offsets(sightings, turning, reach_s)
    if not coarse:
        return ClockSearch(None, False)
    level = [one for one in coarse if one.evidence > coarse[0].evidence - MIN_LEAD]
    best = next((one for one in level if one.ratio > 0.0), None)
    if best is None:
        return ClockSearch(None, False, reversed=coarse[0].lead > MIN_LEAD, compared=True)
    rival = next((one.offset_s for one in level if one is not best), None)
    fit = fine_fit(sightings, turning, best)
    if fit is None:
        return ClockSearch(None, False, rival, compared=True)
    at_edge = abs(fit.offset_s) > reach_s - EDGE_S
    moved = fit.ratio > MIN_RATIO_SIGMA * fit.ratio_std and RATIO_RANGE[0] < fit.ratio < RATIO_RANGE[1]
    determined = rival is None and not at_edge and moved and fit.offset_std_s < USABLE_STD_S
    return ClockSearch(fit, determined, rival, at_edge=at_edge, compared=True)


def coarse_offsets(sightings: Sightings, turning: Turning, reach_s: float) -> tuple[Coarse, ...]:
    """Compare turns between frames some tenths of a second apart with the yaw's, at all offsets.

    Returns
    -------
    tuple of Coarse
        The best offset first, then rivals at least `RIVAL_APART_S` away; empty if there is too little to compare.
    """
    t, heading = sightings.t_s[sightings.seen], sightings.heading_rad[sightings.seen]
    partner = np.searchsorted(t, t + PAIR_S[0])
    first = np.flatnonzero(partner < len(t))
    second = partner[first]
    close = t[second] - t[first] <= PAIR_S[1]
    first, second = first[close], second[close]
    if len(first) < MIN_PAIRS:
        return ()
    turned, span = wrap_axis(heading[second] - heading[first]), t[second] - t[first]
    offsets = np.arange(-reach_s, reach_s + 0.5 * COARSE_STEP_S, COARSE_STEP_S)
    yaw = turning.yaw_at(t[None, :] + offsets[:, None])
    yawed = yaw[:, second] - yaw[:, first]
    covered = np.isfinite(yawed)
    n_covered = covered.sum(axis=1)
    enough = n_covered >= max(MIN_PAIRS, MIN_OVERLAP * n_covered.max())
    if not enough.any():
        return ()
    yawed = np.where(covered, yawed, 0.0)
    ratio, drift, z = _robust_slopes(yawed, turned, span, covered, COARSE_SIGMA_RAD)
    best = int(np.argmin(np.where(enough, _loss(z, covered), np.inf)))
    # The scale of the loss follows from the best offset, where the two agree best.
    spread = 1.48 * COARSE_SIGMA_RAD * float(np.median(np.abs(z[best][covered[best]])))
    sigma = max(spread, MIN_SIGMA_RAD)
    ratio, drift, z = _robust_slopes(yawed, turned, span, covered, sigma)
    # Overlapping pairs are not independent: so many count as one.
    independent = n_covered * np.minimum(1.0, np.median(np.diff(t)) / np.median(span))
    evidence = np.where(enough, -_loss(z, covered) * independent[best], -np.inf)
    none = turned[None, :] / sigma
    unrelated = -float(_loss(none, covered[best : best + 1])[0] * independent[best])
    found: list[Coarse] = []
    free = np.ones(len(offsets), bool)
    while len(found) < N_RIVALS and np.isfinite(evidence[free]).any():
        k = int(np.flatnonzero(free)[np.argmax(evidence[free])])
        inner = 0 < k < len(offsets) - 1
        if not found or (inner and evidence[k] >= max(evidence[k - 1], evidence[k + 1])):
            lead = float(evidence[k] - unrelated)
            found.append(
                Coarse(float(offsets[k]), float(ratio[k]), float(drift[k]), float(evidence[k]), lead)
            )
        free &= np.abs(offsets - offsets[k]) > (RIVAL_APART_S if len(found) == 1 else COARSE_STEP_S)
    return tuple(found)


def _loss(z: FloatArray, covered: BoolArray) -> FloatArray:
    """Mean of Cauchy's loss over the pairs covered, at each offset."""
    return np.asarray((covered * np.log1p(z * z)).sum(axis=1) / np.maximum(covered.sum(axis=1), 1))


def _robust_slopes(
    yawed: FloatArray, turned: FloatArray, span: FloatArray, covered: BoolArray, sigma: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Fit ``turned ~ ratio * yawed + drift * span`` at each offset (rows) by Cauchy's loss: ratio, drift, residuals.

    Residuals are over ``sigma``.
    """
    weight = covered.astype(float)
    for _ in range(COARSE_ROUNDS):
        a = (weight * yawed * yawed).sum(axis=1)
        b = (weight * yawed * span).sum(axis=1)
        c = (weight * span * span).sum(axis=1)
        p, q = (weight * yawed * turned).sum(axis=1), (weight * span * turned).sum(axis=1)
        determinant = np.maximum(a * c - b * b, 1e-12)
        ratio, drift = (c * p - b * q) / determinant, (a * q - b * p) / determinant
        z = (turned - ratio[:, None] * yawed - drift[:, None] * span) / sigma
        weight = covered / (1.0 + z * z)
    return ratio, drift, z


def corridors_of(t_s: FloatArray, constant_rad: FloatArray) -> tuple[IntArray, FloatArray]:
    """Assign frames to corridors, in each of which heading less yaw is constant.

    Parameters
    ----------
    t_s
        Times (n,).
    constant_rad
        Heading less the part explained by the yaw (n,), known up to half a turn.

    Returns
    -------
    corridor
        Number (n,), -1 for frames that belong to no level.
    unwrapped
        ``constant_rad`` (n,) shifted by half turns to its level.
    """
    n = len(t_s)
    corridor, unwrapped = np.full(n, -1, np.int64), constant_rad.copy()
    level: list[int] = []
    strays: list[int] = []
    number = -1
    for k in range(n):
        if level:
            recent = level[-LEVEL_FRAMES:]
            middle = float(np.median(unwrapped[recent]))
            away = wrap_axis(float(constant_rad[k]) - middle)
            gate = min(GATE_RAD + DRIFT_RAD_S * float(t_s[k] - t_s[recent[-1]]), MAX_GATE_RAD)
            if abs(away) < gate:
                unwrapped[k], corridor[k] = middle + away, number
                level.append(k)
                strays = []
                continue
        strays.append(k)
        fresh = _new_level(t_s, constant_rad, strays)
        if fresh is not None:
            number, level, strays = number + 1, fresh, []
            reference = constant_rad[fresh[-1]]
            unwrapped[fresh] = reference + wrap_axis(constant_rad[fresh] - reference)
            corridor[fresh] = number
    return corridor, unwrapped


def _new_level(t_s: FloatArray, constant_rad: FloatArray, strays: list[int]) -> list[int] | None:
    """Return the stray frames that form a new level, once enough of the last ones agree."""
    recent = strays[-2 * NEW_LEVEL_FRAMES :]
    away = np.abs(wrap_axis(constant_rad[recent] - constant_rad[recent[-1]]))
    near = [k for k, a in zip(recent, away.tolist(), strict=True) if a < 0.5 * GATE_RAD]
    return near if len(near) >= NEW_LEVEL_FRAMES else None


def fine_fit(sightings: Sightings, turning: Turning, start: Coarse) -> ClockFit | None:
    """Fit offset, ratio and drift, starting at a candidate; None if too few frames belong to a corridor."""
    seen = sightings.seen
    t, heading, white = sightings.t_s[seen], sightings.heading_rad[seen], sightings.heading_std_rad[seen] ** 2
    reach = np.array([-REACH_S, 0.0, REACH_S])
    inside = np.isfinite(turning.yaw_at(t[:, None] + start.offset_s + reach)).all(axis=1)
    t, heading, white = t[inside], heading[inside], white[inside]
    explained = start.ratio * turning.yaw_at(t + start.offset_s) + start.drift_rad_s * t
    corridor, constant = corridors_of(t, heading - explained)
    keep = corridor >= 0
    if keep.sum() < MIN_CLOCK_FRAMES:
        return None
    samples = _Samples(t[keep], (constant + explained)[keep], white[keep], corridor[keep])
    return _gauss_newton(samples, turning, start)


@dataclass(frozen=True, slots=True, eq=False)
class _Samples:
    """Frames that belong to a corridor: times, headings, variances, corridors, weights; all (n,)."""

    t_s: FloatArray
    heading_rad: FloatArray
    white: FloatArray
    corridor: IntArray

    def only(self, keep: BoolArray) -> _Samples:
        """Return the frames for which ``keep`` (n,) is true."""
        return _Samples(self.t_s[keep], self.heading_rad[keep], self.white[keep], self.corridor[keep])

    def centred(self, values: FloatArray) -> FloatArray:
        """Values (n,) less their mean in each corridor."""
        _, number = np.unique(self.corridor, return_inverse=True)
        return np.asarray(values - (np.bincount(number, values) / np.bincount(number))[number])

    def walk(self, density: float) -> Process:
        """Return a random walk of this density in each corridor, rad/sqrt(s)."""
        return Process.walk(self.t_s, self.corridor, density)


def _gauss_newton(samples: _Samples, turning: Turning, start: Coarse) -> ClockFit | None:
    """Iterate the fit, with estimates of noise and outliers."""
    offset, ratio = start.offset_s, start.ratio
    scale, density = 1.0, max(START_DENSITY, turning.noise_density)
    values = np.array([0.0, ratio, 0.0])
    weight = np.ones(len(samples.t_s))
    for step in range(ROUNDS):
        # The walk absorbs the constants: it starts at an arbitrary value in each corridor.
        yaw = samples.centred(turning.yaw_at(samples.t_s + offset))
        slope = ratio * turning.rate_at(samples.t_s + offset, HALF_SLOPE_S)
        design = np.stack([slope, yaw, samples.centred(samples.t_s)], axis=1)
        target = samples.centred(samples.heading_rad)
        if step % NOISE_EVERY == 0:
            scale, density = find_noise(design, target, samples.white / weight, samples.walk, scale, density)
        noise = Noise(scale * samples.white / weight, samples.walk(density))
        walked = samples.centred(noise.process_of(target - design[:, RATIO:] @ values[RATIO:]))
        share = min(1.0, (ratio * turning.noise_density / density) ** 2)
        instrument = design.copy()
        instrument[:, RATIO] += share * walked / ratio
        values, covariance = solve(design, target, noise, instrument)
        residual = target - design @ values
        offset += float(np.clip(values[OFFSET], -MAX_STEP_S, MAX_STEP_S))
        ratio = float(np.clip(values[RATIO], *FIT_RATIO_RANGE))
        if abs(offset - start.offset_s) > REACH_S - HALF_SLOPE_S:
            return None
        if step < ROUNDS - 1 and step % NOISE_EVERY == NOISE_EVERY - 1:
            weight = weights(noise, residual, weight)
            keep = weight > 0.0
            samples, weight = samples.only(keep), weight[keep]
            if len(weight) < MIN_CLOCK_FRAMES:
                return None
    std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    return ClockFit(
        offset_s=offset,
        offset_std_s=float(std[OFFSET]),
        ratio=float(values[RATIO]),
        ratio_std=float(std[RATIO]),
        drift_rad_s=float(values[DRIFT]),
        n_frames=len(weight),
        n_corridors=len(np.unique(samples.corridor)),
        turned_rad=float(np.std(yaw)),
        white_rad=float(np.sqrt(scale * np.median(samples.white))),
        walk_density=density,
        samples=samples,
    )
