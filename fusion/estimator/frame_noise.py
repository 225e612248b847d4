"""Noise of the frames' headings, estimated from their differences to the gyroscope's.

The variance of the difference of two headings, less what the vehicle turned between them, grows with the time l
between them as s (R1 + R2) (1 - exp(-l / tau)) + q^2 l: s is the variance of the frames' errors over what the frames
state, tau their correlation time, q the gyroscope's noise density: a structure function, related to the Allan
variance. Innovations of successive frames show only the product of s and 1 - exp(-l / tau): frames with correlated
errors would seem better than they are.

The growth with l also separates a gyroscope that is noisier than its setting (vibration, a log with only some of its
samples) from frames that are worse than their stated sigma.

A gyroscope with a fault turns by little from one frame to the next, so that the fault is not taken for noise.
"""

from __future__ import annotations

from bisect import bisect_left
from math import exp, expm1, log, pi, sqrt
from typing import NamedTuple

import numpy as np

from fusion.estimator.kernels import FloatArray

LAGS_S = (0.033, 0.1, 0.3, 1.0)  # between headings that are compared
SPACING_NS = 27_000_000  # of the headings that are kept
SPAN_NS = 1_050_000_000
LAG_TOLERANCE = 0.35  # of a lag, either way
MEMORY_S = 15.0
MAX_TERM = 9.0  # of a squared difference over its expectation: beyond is a gross error
FIT_NS = 250_000_000
LASTING_S = 0.1
PRIOR_LOG_SCALE, PRIOR_LOG_TIME = 0.35, 4.0  # standard deviations about what is stated
PRIOR_LOG_GYRO = 0.5
POOR_FIT = 3.0  # log-likelihood and prior less than the best possible: from there on the gyroscope is doubted
GYRO_SCALES = np.exp(np.linspace(np.log(1.5), np.log(100.0), 12))
SCALES = np.exp(np.linspace(np.log(0.04), np.log(25.0), 25))
TIMES_S = np.exp(np.linspace(np.log(0.004), np.log(15.0), 25))


class Heading(NamedTuple):
    """A frame's heading less the dead-reckoned one, and its stated variance."""

    t_ns: int
    difference_rad: float
    variance: float


class Differences(NamedTuple):
    """Sums over the differences at one lag, the older the less.

    Weight, lag, differences over the stated sigma, their squares, and the gyroscope's share of those.
    """

    weight: float = 0.0
    lag_s: float = 0.0
    sum: float = 0.0
    squares: float = 0.0
    turned: float = 0.0


class FrameNoise(NamedTuple):
    """What is known of the noise of frames' headings.

    Parameters
    ----------
    scale
        Variance of their errors over what they state.
    correlation_s
        Time over which errors resemble each other; NaN: as the settings say.
    gyro_scale
        Variance of the gyroscope's noise over what the settings say; 1 unless frames show that it is larger.
    headings, lags
        The last second's headings, and what they differed by.
    fitted_ns
        When scale and time were found last.
    """

    scale: float = 1.0
    correlation_s: float = float("nan")
    gyro_scale: float = 1.0
    headings: tuple[Heading, ...] = ()
    lags: tuple[Differences, ...] = (Differences(),) * len(LAGS_S)
    fitted_ns: int | None = None

    def interrupted(self) -> FrameNoise:
        """Compare no heading to come with those before."""
        return self._replace(headings=())

    def with_heading(
        self, t_ns: int, difference_rad: float, variance: float, gyro_noise: float, stated_time_s: float
    ) -> FrameNoise:
        """Take in a frame that was used.

        Parameters
        ----------
        t_ns, difference_rad, variance
            As in `Heading`.
        gyro_noise
            Of what carries the heading, rad/s/sqrt(Hz).
        stated_time_s
            Correlation time that the settings say.
        """
        kept = self.headings
        if kept and t_ns - kept[-1].t_ns < SPACING_NS:
            return self
        dt_s = min((t_ns - kept[-1].t_ns) * 1e-9, 1.0) if kept else 0.0
        kept = kept[bisect_left(kept, t_ns - SPAN_NS, key=_time) :]
        new = Heading(t_ns, difference_rad, variance)
        fade = exp(-dt_s / MEMORY_S)
        density = gyro_noise * gyro_noise
        lags = tuple(
            _with_difference(d, fade, _at_lag(kept, t_ns, lag), new, density, self)
            for d, lag in zip(self.lags, LAGS_S, strict=True)
        )
        noise = self._replace(headings=(*kept, new), lags=lags)
        if noise.fitted_ns is None:
            return noise._replace(fitted_ns=t_ns, correlation_s=stated_time_s)
        if t_ns - noise.fitted_ns < FIT_NS:
            return noise
        interval_s = (t_ns - kept[0].t_ns) * 1e-9 / len(kept) if kept else LAGS_S[-1]
        scale, time_s, gyro_scale = fit(lags, stated_time_s, interval_s)
        return noise._replace(scale=scale, correlation_s=time_s, gyro_scale=gyro_scale, fitted_ns=t_ns)


def white_and_walk(variance: float, time_s: float, interval_s: float) -> tuple[float, float]:
    """Return the sigma of white errors and the density of a random walk, rad/sqrt(s), that act alike over a second.

    Errors of a first-order process of correlation time ``time_s`` are white to whoever looks for longer, and a random
    walk of density ``sqrt(2 variance / time_s)`` to whoever looks for less.
    """
    rho = exp(-max(1e-3, interval_s) / min(time_s, LASTING_S)) if time_s > 0.0 else 0.0
    walk = sqrt(2.0 * variance / time_s) if time_s > LASTING_S else 0.0
    return sqrt(variance * (1.0 + rho) / (1.0 - rho)), walk


def _time(heading: Heading) -> int:
    return heading.t_ns


def _at_lag(kept: tuple[Heading, ...], t_ns: int, lag_s: float) -> Heading | None:
    """Return the heading nearest to a time before; None where none is near enough."""
    wanted = t_ns - round(lag_s * 1e9)
    after = bisect_left(kept, wanted, key=_time)
    near = kept[max(after - 1, 0) : after + 1]
    best = min(near, key=lambda h: abs(h.t_ns - wanted), default=None)
    return None if best is None or abs(best.t_ns - wanted) > LAG_TOLERANCE * lag_s * 1e9 else best


def _with_difference(
    d: Differences,
    fade: float,
    then: Heading | None,
    now: Heading,
    density: float,
    noise: FrameNoise,
) -> Differences:
    weight, lag, total, squares, turned = (fade * value for value in d)
    if then is None:
        return Differences(weight, lag, total, squares, turned)
    lag_s = (now.t_ns - then.t_ns) * 1e-9
    stated = now.variance + then.variance
    step = (now.difference_rad - then.difference_rad + 0.5 * pi) % pi - 0.5 * pi
    share = density * lag_s / stated
    # Gross errors that passed the gate are white: beside errors that change slowly they would look like a short
    # correlation time, were they not bounded by what is expected at this lag.
    changed = -expm1(-lag_s / noise.correlation_s) if noise.correlation_s > 0.0 else 1.0  # NaN fails too
    most = sqrt(MAX_TERM * (max(noise.scale, 1.0) * changed + noise.gyro_scale * share))
    z = min(max(step / sqrt(stated), -most), most)
    return Differences(weight + 1.0, lag + lag_s, total + z, squares + z * z, turned + share)


def fit(lags: tuple[Differences, ...], stated_time_s: float, interval_s: float) -> tuple[float, float, float]:
    """Scale and correlation time of the frames' errors, and scale of the gyroscope's noise, that explain differences.

    What is stated is the prior; the gyroscope is as stated unless no scale and time explain them.
    ``interval_s`` is the time between headings. A mean of n squares of variance v has standard deviation
    v sqrt(2 / n); n is less where spans overlap.
    """
    stated = max(stated_time_s, float(TIMES_S[0]))
    prior = 0.5 * (np.log(SCALES) / PRIOR_LOG_SCALE) ** 2
    prior = prior[:, None] + 0.5 * (np.log(TIMES_S / stated) / PRIOR_LOG_TIME)[None, :] ** 2
    used = [d for d in lags if d.weight > 1.0]

    def costs(gyro_scale: float) -> tuple[FloatArray, float]:
        """Return those of frames' scale and time, and the least with spans as often as headings come."""
        cost, spaced = prior, prior + 0.5 * (log(gyro_scale) / PRIOR_LOG_GYRO) ** 2
        for d in used:
            lag_s, share = d.lag_s / d.weight, gyro_scale * d.turned / d.weight
            mean = max(d.squares / d.weight - (d.sum / d.weight) ** 2, 1e-6)  # a steady drift is no scatter
            n, n_spaced = (d.weight * min(1.0, 2.0 * s / lag_s) for s in (LAGS_S[0], interval_s))
            expected = SCALES[:, None] * (1.0 - np.exp(-lag_s / TIMES_S))[None, :] + share
            misfit = mean / expected - 1.0 + np.log(expected / mean)
            cost, spaced = cost + 0.5 * n * misfit, spaced + 0.5 * n_spaced * misfit
        return cost, float(spaced.min())

    gyro_scale, (cost, least) = 1.0, costs(1.0)
    if least > POOR_FIT:
        for other in GYRO_SCALES.tolist():
            other_cost, other_least = costs(other)
            if other_least < least:
                gyro_scale, cost, least = other, other_cost, other_least
    w = np.exp(-(cost - cost.min()))
    w /= w.sum()
    scale = float(np.exp((w.sum(axis=1) * np.log(SCALES)).sum()))
    return scale, float(np.exp((w.sum(axis=0) * np.log(TIMES_S)).sum())), gyro_scale
