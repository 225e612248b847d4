"""Drift of the frames against gyroscope and IMU yaw: lines fitted to the differences over spans up to now.

Over a span, the difference of the frames' heading to that of another source is modelled as::

    d(t) = d_0 + m t + c omega(t) + noise

with m the drift, and c the time by which frames are stamped early, at the turn rate omega. The fit is weighted least
squares with rejection of outliers; the prior of c is `TIME_STD_S`. `fusion.estimator.hypotheses` isolates the fault
from the slopes m. Sources: frames minus gyroscope less bias, and frames minus IMU yaw.
"""

from __future__ import annotations

from math import hypot, inf, isfinite, pi, remainder, sqrt
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fusion.estimator.imu_yaw_check import InertialNoise, YawProbabilities
from fusion.estimator.kernels import FloatArray
from vision.rotations import wrap_axis

# Spans of the fits: short ones respond sooner, long ones resolve smaller drifts.
SPANS_S = (0.5, 1.0, 1.7, 3.0, 6.0)
SPAN_NS = round(SPANS_S[-1] * 1e9)
MIN_POINTS = 6
MIN_LINKED = 0.75  # smallest share of frames that are linked; fewer may follow another axis
TIME_STD_S = 0.03  # prior sigma of the frames' stamps against the gyroscope's
MAX_MISFIT = 9.0  # upper bound of one frame's squared normalised residual
MAX_FITS = 4
# Of a line fitted to a unit random walk over unit time: mean squared residual, and variance at its end.
WALK_RESIDUAL_VARIANCE, WALK_END_VARIANCE = 1 / 15, 2 / 15


class HeadingComparison(NamedTuple):
    """A frame's heading and sigma, with the gyroscope's angle (bias not subtracted) and the IMU yaw (or NaN).

    ``linked``: no jump of the picture lies between it and the frames that the filter used. ``walk``: random walk of
    its correlated errors, rad/sqrt(s). ``bias_rad_s``, ``bias_variance``: the gyroscope's bias as estimated then.
    ``stamp_std_s``: further sigma of the frame's stamp.
    """

    t_ns: int
    heading_rad: float
    std_rad: float
    raw_theta_rad: float
    yaw_rad: float
    linked: bool
    walk: float = 0.0
    bias_rad_s: float = 0.0
    bias_variance: float = 0.0
    stamp_std_s: float = 0.0


class Slope(NamedTuple):
    """A line fitted to a difference of two headings: rate, rad/s, and its sigma, value now and its sigma.

    The rate's sigma contains the frames' errors only; that of the value now also the gyroscope's random walk. The
    value is for frames as they are stamped. ``misfit`` is the mean of the ``n`` squared normalised residuals: about 1
    for a steady drift. ``stamp_s``, ``stamp_variance``: time by which the frames are stamped early, from the
    differences without the prior, s.
    """

    rate_rad_s: float
    rate_std: float
    now_rad: float
    now_std: float
    misfit: float = 1.0
    n: int = 0
    stamp_s: float = 0.0
    stamp_variance: float = inf


class Evidence(NamedTuple):
    """Evidence of one span; variances are of rates, (rad/s)^2.

    Parameters
    ----------
    gyro, yaw
        Slope of the frames' heading minus the dead-reckoned one (bias subtracted), and minus the IMU's yaw; yaw is
        None without an IMU yaw.
    gyro_variance, bias_variance, yaw_variance
        From the gyroscope's noise and scale, from its bias, and from the errors of the IMU's yaw.
    bias_rad_s
        The subtracted bias.
    jumped
        Whether the frames themselves jumped by more than the gyroscope turned.
    frames_rejected
        Whether frames were rejected lately; without rejections, a spike of the gyroscope has had no effect.
    yaw_probabilities
        Prior probabilities of faults of the IMU's yaw.
    """

    gyro: Slope | None = None
    yaw: Slope | None = None
    gyro_variance: float = 0.0
    bias_variance: float = 0.0
    yaw_variance: float = 0.0
    bias_rad_s: float = 0.0
    jumped: bool = False
    frames_rejected: bool = True
    yaw_probabilities: YawProbabilities = YawProbabilities()


def add_comparison(
    comparisons: tuple[HeadingComparison, ...], new: HeadingComparison, spacing_ns: int
) -> tuple[HeadingComparison, ...]:
    """Append a frame unless it follows the last one too closely; drop those older than the longest span."""
    if comparisons and new.t_ns - comparisons[-1].t_ns < spacing_ns:
        return comparisons
    first = next((i for i, s in enumerate(comparisons) if new.t_ns - s.t_ns <= SPAN_NS), len(comparisons))
    return (*comparisons[first:], new)


def gyro_jump_between_frames(
    comparisons: tuple[HeadingComparison, ...], new: HeadingComparison, bias_rad_s: float
) -> float:
    """Return the size of a jump of the gyroscope in a gap between frames, rad; 0 if there is none or no IMU yaw.

    Frames are ambiguous by half a turn and cannot show it. An IMU yaw may jump while the gyroscope does not (steel, a
    reset), but it does not stand still while the vehicle turns: of the two, the one that turned less is right.
    """
    if not comparisons or new.t_ns - comparisons[-1].t_ns < SPANS_S[0] * 1e9:
        return 0.0
    last = comparisons[-1]
    gyro = new.raw_theta_rad - last.raw_theta_rad - bias_rad_s * (new.t_ns - last.t_ns) * 1e-9
    apart = new.yaw_rad - last.yaw_rad
    if not isfinite(apart):
        return 0.0
    yaw = remainder(apart, 2.0 * pi)
    jump = remainder(gyro - yaw, 2.0 * pi)
    return jump if abs(jump) > 0.5 * pi and abs(gyro) > abs(yaw) + 0.5 * pi else 0.0


def slope_of(
    t_s: FloatArray,
    difference_rad: FloatArray,
    std_rad: FloatArray,
    turn_rad_s: FloatArray,
    walk: float,
    gyro_walk: float,
) -> Slope | None:
    """Fit the module's model to differences, without outliers beyond three sigmas; None if too few remain.

    Parameters
    ----------
    t_s
        Times relative to now (n,); the last is 0.
    difference_rad, std_rad
        Differences and the frames' sigmas (n,).
    turn_rad_s
        Turn rate (n,).
    walk, gyro_walk
        Random walks of the frames' errors and of the gyroscope, rad/sqrt(s).
    """
    terms = np.stack((np.ones(len(t_s)), t_s, turn_rad_s))
    line = _robust_line(terms, difference_rad, std_rad)
    if line is None:
        return None
    fitted, cov, off, keep = line
    span_s, turn_now = float(-t_s[0]), float(turn_rad_s[-1])
    squares = (off / std_rad) ** 2
    misfit = float(np.minimum(squares, MAX_MISFIT).mean())
    # A poor fit means that the drift is not constant, so the rate is less certain.
    spread = max(1.0, float(squares @ keep) / len(t_s))
    rate_variance, c_variance = float(cov[1, 1]), float(cov[2, 2])
    rate_std = sqrt(rate_variance * spread + walk_slope_variance(walk, span_s))
    now, rate, stamp_s = fitted.tolist()
    # The filter uses frames at their stamps, so the value now includes the effect of the stamp's error.
    at_now = np.array((1.0, 0.0, turn_now))
    now_variance = float(at_now @ cov @ at_now) + WALK_END_VARIANCE * (walk**2 + gyro_walk**2) * span_s
    found = Slope(rate, rate_std, now + stamp_s * turn_now, sqrt(now_variance), misfit, len(t_s))
    known = 1.0 / c_variance - TIME_STD_S**-2  # information of the differences alone, without the prior
    if not known > 0.0:
        return found
    # Random walks can pass for a stamp's error.
    walk_variance = WALK_RESIDUAL_VARIANCE * (walk**2 + gyro_walk**2) * span_s
    stamp_variance = (spread + walk_variance * float(keep @ std_rad**-2)) / known
    return found._replace(stamp_s=stamp_s / (c_variance * known), stamp_variance=stamp_variance)


def _robust_line(
    terms: FloatArray, difference_rad: FloatArray, std_rad: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, npt.NDArray[np.bool_]] | None:
    """Fit differences (n,) by terms (3, n), the last with a prior, by iterated rejection beyond three sigmas.

    Returns
    -------
    fitted, cov, off, keep
        Coefficients (3,), their covariance (3, 3), absolute residuals (n,), and which frames were kept (n,); None
        if too few remain.
    """
    n = len(std_rad)
    weighted = terms * std_rad**-2
    keep: npt.NDArray[np.bool_] = np.ones(n, np.bool_)
    for attempt in range(MAX_FITS):
        if int(np.count_nonzero(keep)) < MIN_POINTS:
            return None
        kept = weighted * keep
        information = kept @ terms.T
        information[2, 2] += TIME_STD_S**-2
        try:
            cov: FloatArray = np.asarray(np.linalg.inv(information), dtype=float)
        except np.linalg.LinAlgError:
            return None
        fitted = cov @ (kept @ difference_rad)
        off: FloatArray = np.abs(difference_rad - fitted @ terms)
        # The leverage of a point reduces the variance of its own residual.
        leverage = np.add.reduce(weighted * (cov @ terms))
        squares = off**2 / np.maximum(1.0 + np.where(keep, -leverage, leverage), 1e-9)
        before, worst = keep, int(np.argmax(squares / std_rad**2))
        if attempt == 0 and squares[worst] > 9.0 * std_rad[worst] ** 2:
            keep = np.arange(n) != worst  # first drop the worst: it would inflate the scatter that tests it
            continue
        scatter2 = max(float(np.sort(squares)[n // 2]) / 0.67**2, 1e-18)  # by the median
        keep = squares <= 9.0 * np.maximum(std_rad**2, scatter2)
        if (keep == before).all():
            break
    return fitted, cov, off, keep


def walk_slope_variance(walk: float, span_s: float) -> float:
    """Return the variance of the slope fitted to a random walk of this density over a span, (rad/s)^2."""
    return 1.2 * walk * walk / span_s


class Drift:
    """Drift of the frames from gyroscope and IMU yaw, over any span up to now.

    Parameters
    ----------
    comparisons
        Frames; the newest is at the filter's time.
    psi_rad
        The filter's heading now; propagated back by the gyroscope, it is the reference of the differences.
    noise
        Noise of the inertial sensors.
    """

    def __init__(
        self, comparisons: tuple[HeadingComparison, ...], psi_rad: float, noise: InertialNoise
    ) -> None:
        last = comparisons[-1]
        self._walk, self._noise = last.walk, noise
        columns = np.array([(s.t_ns - last.t_ns, *s[1:]) for s in comparisons], dtype=np.float64).T
        t_ns, self._heading, self._std, raw, self._yaw, linked, _ = columns[:7]
        self._bias, self._bias_variance, self._stamp_std = columns[7:]
        self._t, self._linked = t_ns * 1e-9, linked > 0.0
        self._raw = raw - last.raw_theta_rad
        self._to_gyro, self._to_yaw = self._heading - psi_rad - self._raw, self._heading - self._yaw
        rate = np.diff(self._raw) / np.diff(self._t)  # np.gradient takes as long as all else together
        self._turn = np.concatenate((rate[:1], 0.5 * (rate[1:] + rate[:-1]), rate[-1:]))

    def over(self, span_s: float) -> Evidence:
        """Return the evidence of the last ``span_s``.

        The bias is that estimated at the start of the span: the filter's present one has absorbed some of the drift.
        """
        noise, first = self._noise, int(np.searchsorted(self._t, -span_s))
        linked = self._linked[first:]
        n = int(np.count_nonzero(linked))
        if n < max(MIN_POINTS, MIN_LINKED * len(linked)):
            return Evidence()
        seen = slice(first, None) if n == len(linked) else first + np.flatnonzero(linked)
        t, std, turn = self._t[seen], self._std[seen], self._turn[seen]
        if t[0] == 0.0:
            return Evidence()
        bias, bias_variance = float(self._bias[seen][0]), float(self._bias_variance[seen][0])
        gyro = slope_of(t, _unwrapped(self._to_gyro[seen] + bias * t), std, turn, self._walk, noise.gyro_walk)
        if gyro is None:
            return Evidence()
        span_s = float(-t[0])
        # A suspected step of the camera's clock may lie between any two frames.
        by_step = float(self._stamp_std[seen].max() * (abs(turn[0]) + abs(turn[-1]))) / span_s
        gyro = gyro._replace(rate_std=hypot(gyro.rate_std, by_step))
        by_scale = noise.gyro_scale_std * float(self._raw[seen][0]) / span_s
        gyro_variance = walk_slope_variance(noise.gyro_walk, span_s) + by_scale**2
        known = Evidence(gyro, None, gyro_variance, bias_variance, bias_rad_s=bias)
        if not np.isfinite(self._yaw[seen]).all():
            return known
        yaw = slope_of(t, _unwrapped(self._to_yaw[seen]), std, turn, self._walk, noise.gyro_walk)
        if yaw is None:
            return known
        # The slope of a line fitted to n white errors over a span T has variance 12 sigma^2 / (n T^2).
        white = 12.0 * noise.yaw_std**2 / (n * span_s**2)
        jumping = max(yaw.rate_std**2 - gyro.rate_std**2, 0.0)  # a yaw that jumps drifts at no constant rate
        yaw_variance = walk_slope_variance(noise.yaw_walk, span_s) + white + jumping
        return known._replace(yaw=yaw, yaw_variance=yaw_variance)


def _unwrapped(difference: FloatArray) -> FloatArray:
    """Unwrap differences of axes (modulo half a turn): the last within a quarter turn, the others near it."""
    last = wrap_axis(float(difference[-1]))
    return last + (difference - last + 0.5 * pi) % pi - 0.5 * pi
