"""Skew of two clocks: a time offset that grows through the flight.

If a camera's nominal rate differs from its true one, or a driver derives times from counted samples, the time stamps
become later and later, or earlier and earlier. No constant offset then explains the turns.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf

import numpy as np

from fusion.alignment.clock import HALF_SLOPE_S, ClockFit, ClockSearch, coarse_offsets, find_clock
from fusion.alignment.markov import Noise, solve
from fusion.alignment.turning import Turning
from fusion.alignment.views import Sightings

MIN_SKEW = 5e-4  # over ten minutes, less is within the variation of a camera's delay
WORTH_TRYING, SURE_SIGMA = 2.0, 5.0
MAX_SKEW = 0.03
ROUNDS = 4  # of correcting the stamps and fitting again
STEPS = 4  # of Gauss-Newton in each round
GRID_S = 0.3  # shift of the flight's ends from one trial skew to the next
MAX_TRIED = 41
MIN_GAIN = 8.0  # in log-likelihood, of a skew over none


@dataclass(frozen=True, slots=True, eq=False)
class SkewedClock:
    """Time offset of two clocks, one of which runs faster.

    Parameters
    ----------
    search
        The search for the offset, with stamps corrected by ``skew``.
    skew, skew_std
        Frames' stamps, relative to the first, are multiplied by ``1 + skew``; 0 if not significant.
    """

    search: ClockSearch
    skew: float = 0.0
    skew_std: float = inf


def find_skewed_clock(
    sightings: Sightings, turning: Turning, reach_s: float, *, thorough: bool = True
) -> SkewedClock:
    """Search the offset as `fusion.alignment.clock.find_clock` does, and a skew of the clocks.

    Parameters
    ----------
    sightings, turning, reach_s
        As there.
    thorough
        Whether to try large skews if no offset is found without them.
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
        # A fit without skew takes it for noise, so its significance is judged by the fit that includes it.
        if abs(change) < (1.0 if skew else WORTH_TRYING) * std or abs(skew + change) > MAX_SKEW:
            break
        skew += change * (1.0 + skew)
        search = find_clock(at_skew(sightings, skew), turning, reach_s)
    if not search.determined or abs(skew) < max(MIN_SKEW, SURE_SIGMA * std):
        return SkewedClock(find_clock(sightings, turning, reach_s) if skew else search, skew_std=std)
    return SkewedClock(search, skew, std)


def at_skew(sightings: Sightings, skew: float) -> Sightings:
    """Return sightings with stamps corrected by a skew."""
    return replace(sightings, t_s=sightings.t_s * (1.0 + skew))


def _skew_left(fit: ClockFit, turning: Turning) -> tuple[float, float]:
    """Residual skew of a fit's frames and its standard deviation, with the noise that the fit estimated."""
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
        if not np.isfinite(slope).all():  # outside the stream
            return 0.0, inf
        shift = np.stack([slope, slope * from_middle_s], axis=1)
        design = np.column_stack([yaw, samples.centred(samples.t_s), shift])
        # Linearised about the present offset and skew, so their share of the target is added back.
        values, covariance = solve(design, target + shift @ values[2:], noise)
    return float(values[3]), float(np.sqrt(max(covariance[3, 3], 0.0)))


def _likeliest_skew(sightings: Sightings, turning: Turning, reach_s: float) -> float:
    """Skew with the best fit of a coarse search; 0 unless it is clearly better than no skew."""
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
