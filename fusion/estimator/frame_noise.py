"""Noise of the frames' headings and of the gyroscope, estimated from the differences between the two.

The difference of two headings a time l apart, less the gyroscope's turn between them, has the variance (a structure
function, related to the Allan variance)::

    D(l) = s (R1 + R2) (1 - exp(-l / tau)) + q^2 l

with R1, R2 the stated variances, s their scale, tau the correlation time of the frames' errors, and q the gyroscope's
noise density. Squared differences are averaged at the lags `LAGS_S`; s and tau are the posterior means over a grid,
with a log-normal prior about the stated values. Innovations of successive frames alone would show only the product
s (1 - exp(-l / tau)), so frames with correlated errors would seem more accurate than they are.

The growth with l also separates a gyroscope that is noisier than configured (vibration, a log with only part of its
samples) from frames that are worse than their stated sigma: q is only scaled if no s and tau fit (`POOR_FIT`). The
drift of a faulty gyroscope between frames is small, so a fault does not count as noise.
"""

from __future__ import annotations

from bisect import bisect_left
from math import exp, expm1, log, pi, sqrt
from typing import NamedTuple

import numpy as np

from fusion.estimator.kernels import FloatArray

LAGS_S = (0.033, 0.1, 0.3, 1.0)  # between compared headings
SPACING_NS = 27_000_000  # smallest interval of stored headings
SPAN_NS = 1_050_000_000
LAG_TOLERANCE = 0.35  # relative tolerance of a lag
MEMORY_S = 15.0
MAX_TERM = 9.0  # squared differences are clipped at this multiple of their expectation
FIT_NS = 250_000_000  # between fits
LASTING_S = 0.1  # errors with a longer correlation time are modelled as a random walk
PRIOR_LOG_SCALE, PRIOR_LOG_TIME = 0.35, 2.0  # prior sigmas of the logarithms, about the stated values
PRIOR_LOG_GYRO = 0.5
POOR_FIT = 3.0  # loss of log posterior against a perfect fit above which the gyroscope's noise is scaled
GYRO_SCALES = np.exp(np.linspace(np.log(1.5), np.log(100.0), 12))
SCALES = np.exp(np.linspace(np.log(0.04), np.log(25.0), 25))
TIMES_S = np.exp(np.linspace(np.log(0.004), np.log(15.0), 25))


class Heading(NamedTuple):
    """A frame's heading less the dead-reckoned one, and its stated variance."""

    t_ns: int
    difference_rad: float
    variance: float


class Differences(NamedTuple):
    """Fading sums over the differences at one lag.

    Weight, lag, normalised differences, their squares, and the gyroscope's expected part of the squares.
    """

    weight: float = 0.0
    lag_s: float = 0.0
    sum: float = 0.0
    squares: float = 0.0
    turned: float = 0.0


class FrameNoise(NamedTuple):
    """Estimated noise of the frames' headings.

    Parameters
    ----------
    scale
        Ratio s of the error variance to the stated one.
    correlation_s
        Correlation time of the errors; NaN for the configured one.
    gyro_scale
        Ratio of the gyroscope's noise variance to the configured one; 1 unless the frames show a larger one.
    headings, lags
        Headings of the last second, and the sums of their differences.
    fitted_ns
        Time of the last fit.
    """

    scale: float = 1.0
    correlation_s: float = float("nan")
    gyro_scale: float = 1.0
    headings: tuple[Heading, ...] = ()
    lags: tuple[Differences, ...] = (Differences(),) * len(LAGS_S)
    fitted_ns: int | None = None

    def interrupted(self) -> FrameNoise:
        """Drop the stored headings, so that later ones are not compared with them."""
        return self._replace(headings=())

    def with_heading(
        self, t_ns: int, difference_rad: float, variance: float, gyro_noise: float, stated_time_s: float
    ) -> FrameNoise:
        """Add an accepted frame.

        Parameters
        ----------
        t_ns, difference_rad, variance
            As in `Heading`.
        gyro_noise
            Configured noise density of the gyroscope, rad/s/sqrt(Hz).
        stated_time_s
            Configured correlation time.
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
    """Return the sigma of white noise and the density of a random walk, rad/sqrt(s), equivalent over about a second.

    A first-order process of correlation time ``time_s`` is nearly white over longer times, and a random walk of
    density ``sqrt(2 variance / time_s)`` over shorter ones.
    """
    rho = exp(-max(1e-3, interval_s) / min(time_s, LASTING_S)) if time_s > 0.0 else 0.0
    walk = sqrt(2.0 * variance / time_s) if time_s > LASTING_S else 0.0
    return sqrt(variance * (1.0 + rho) / (1.0 - rho)), walk


def _time(heading: Heading) -> int:
    return heading.t_ns


def _at_lag(kept: tuple[Heading, ...], t_ns: int, lag_s: float) -> Heading | None:
    """Return the stored heading nearest to ``t_ns - lag_s``; None if none is within the tolerance."""
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
    """Return scale and correlation time of the frames' errors, and the scale of the gyroscope's noise, by a grid fit.

    The stated values are the prior. The gyroscope's scale is 1 unless no scale and time fit. ``interval_s`` is the
    time between headings. A mean of n squares of expectation v has the standard deviation v sqrt(2 / n); n is reduced
    for overlapping spans.
    """
    stated = max(stated_time_s, float(TIMES_S[0]))
    prior = 0.5 * (np.log(SCALES) / PRIOR_LOG_SCALE) ** 2
    prior = prior[:, None] + 0.5 * (np.log(TIMES_S / stated) / PRIOR_LOG_TIME)[None, :] ** 2
    used = [d for d in lags if d.weight > 1.0]

    def costs(gyro_scale: float) -> tuple[FloatArray, float]:
        """Return the costs over the grid, and the smallest one with n counted at the headings' rate."""
        cost, spaced = prior, prior + 0.5 * (log(gyro_scale) / PRIOR_LOG_GYRO) ** 2
        for d in used:
            lag_s, share = d.lag_s / d.weight, gyro_scale * d.turned / d.weight
            mean = max(d.squares / d.weight - (d.sum / d.weight) ** 2, 1e-6)  # without the steady drift
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
