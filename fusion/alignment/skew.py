"""How much faster one of two clocks runs: an offset that grows through the flight.

A camera's nominal rate that is not quite its own, or a driver that counts the samples of a sensor, stamps later and
later, or earlier and earlier. No constant offset explains the turns then.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf

import numpy as np

from fusion.alignment.clock import HALF_SLOPE_S, ClockFit, ClockSearch, coarse_offsets, find_clock
from fusion.alignment.markov import Noise, solve
from fusion.alignment.turning import Turning
from fusion.alignment.views import Sightings

MIN_SKEW = 5e-4  # less shifts the ends of ten minutes by what a delay that wanders does
WORTH_TRYING, SURE_SIGMA = 2.0, 5.0
MAX_SKEW = 0.03
ROUNDS = 4  # of correcting the stamps and fitting anew
STEPS = 4  # of Gauss-Newton in each
GRID_S = 0.3  # that the ends of the flight move by from one skew tried to the next
MAX_TRIED = 41
MIN_GAIN = 8.0  # in log-likelihood, of a skew over none


@dataclass(frozen=True, slots=True, eq=False)
class SkewedClock:
    """The offset of clocks of which one runs faster.

    Parameters
    ----------
    search
        The look for the offset, at stamps that were corrected by ``skew``.
    skew, skew_std
        Frames' stamps, counted from the first, are to be multiplied by ``1 + skew``; 0 where that is not significant.
    """

    search: ClockSearch
    skew: float = 0.0
    skew_std: float = inf


def find_skewed_clock(
    sightings: Sightings, turning: Turning, reach_s: float, *, thorough: bool = True
) -> SkewedClock:
    """Look for the offset as `fusion.alignment.clock.find_clock` does, and for a skew of the clocks.

    Parameters
    ----------
    sightings, turning, reach_s
        As there.
    thorough
        Whether to try skews that hide the offset altogether, where none is found.
    """
    search = find_clock(sightings, turning, reach_s)
    skew = 0.0
    if thorough and not search.determined and not search.reversed:
        skew = _likeliest_skew(sightings, turning, reach_s)
        if skew:
            search = find_clock(at_skew(sightings, skew), turning, reach_s)
    std = inf
    for _ in range(ROUNDS):
        if search.fit is None or not search.determined:
            break
        change, std = _skew_left(search.fit, turning)
        # A skew looks like noise to a fit without it: whether it is sure is asked of the fit that has it.
        if abs(change) < (1.0 if skew else WORTH_TRYING) * std or abs(skew + change) > MAX_SKEW:
            break
        skew += change * (1.0 + skew)
        search = find_clock(at_skew(sightings, skew), turning, reach_s)
    if not search.determined or abs(skew) < max(MIN_SKEW, SURE_SIGMA * std):
        return SkewedClock(find_clock(sightings, turning, reach_s) if skew else search, skew_std=std)
    return SkewedClock(search, skew, std)


def at_skew(sightings: Sightings, skew: float) -> Sightings:
    """Return sightings whose stamps are corrected by a skew."""
    return replace(sightings, t_s=sightings.t_s * (1.0 + skew))


def _skew_left(fit: ClockFit, turning: Turning) -> tuple[float, float]:
    """Skew that the frames of a fit still show, and its standard deviation, with the noise that the fit found."""
    samples = fit.samples
    middle_s = float(np.mean(samples.t_s[[0, -1]]))
    from_middle_s = samples.t_s - middle_s
    scale = fit.white_rad**2 / float(np.median(samples.white))
    noise = Noise(scale * samples.white, samples.walk(fit.walk_density))
    target = samples.centred(samples.heading_rad)
    values = np.array([fit.ratio, fit.drift_rad_s, 0.0, 0.0])  # ratio, drift, offset, skew
    for _ in range(STEPS):
        at_s = samples.t_s + fit.offset_s + values[2] + values[3] * from_middle_s
        slope = values[0] * turning.rate_at(at_s, HALF_SLOPE_S)
        yaw = samples.centred(turning.yaw_at(at_s))
        if not np.isfinite(slope).all():  # beyond the stream's ends
            return 0.0, inf
        shift = np.stack([slope, slope * from_middle_s], axis=1)
        design = np.column_stack([yaw, samples.centred(samples.t_s), shift])
        # Linearised about what is there: the offset's and the skew's share of the target is put back.
        values, covariance = solve(design, target + shift @ values[2:], noise)
    return float(values[3]), float(np.sqrt(max(covariance[3, 3], 0.0)))


def _likeliest_skew(sightings: Sightings, turning: Turning, reach_s: float) -> float:
    """Skew at which turns fit best by a coarse search; 0 where none is clearly better than none."""
    half_s = 0.5 * float(np.ptp(sightings.t_s[sightings.seen])) if sightings.seen.any() else 0.0
    if half_s <= 0.0:
        return 0.0
    count = min(MAX_TRIED // 2, int(MAX_SKEW * half_s / GRID_S))
    tried = np.arange(-count, count + 1) * (GRID_S / half_s)
    lead = []
    for skew in tried.tolist():
        coarse = coarse_offsets(at_skew(sightings, skew), turning, reach_s)
        lead.append(coarse[0].lead if coarse and coarse[0].ratio > 0.0 else -np.inf)
    best = int(np.argmax(lead))
    return float(tried[best]) if lead[best] > lead[count] + MIN_GAIN else 0.0
