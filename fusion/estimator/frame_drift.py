"""Drift of the frames against gyroscope and IMU yaw: lines fitted to the differences over spans up to now.

`fusion.estimator.hypotheses` judges by them who is wrong.
"""

from __future__ import annotations

from math import hypot, inf, isfinite, pi, remainder, sqrt
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fusion.estimator.imu_yaw_check import InertialNoise, YawProbabilities
from fusion.estimator.kernels import FloatArray
from vision.rotations import wrap_axis

# Over which slopes are fitted: the shorter the sooner, the longer the finer.
SPANS_S = (0.5, 1.0, 1.7, 3.0, 6.0)
SPAN_NS = round(SPANS_S[-1] * 1e9)
MIN_POINTS = 6
MIN_LINKED = 0.75  # share of the frames; fewer, and nobody can say what they follow
TIME_STD_S = 0.03  # of the frames' stamps against the gyroscope's, where a flight has not shown it
MAX_MISFIT = 9.0  # of one frame
MAX_FITS = 4
WANDER_LIKE_TURN = 1 / 15  # mean square about its line of a random walk over unit time, of unit density
WALKED_END = 2 / 15  # variance of the end of a line fitted to such a walk


class HeadingComparison(NamedTuple):
    """A frame's heading and its sigma beside what gyroscope (bias not subtracted) and IMU yaw (or NaN) then said.

    ``linked``: no jump of the picture lies between it and the frames that the filter used. ``walk``: how its errors
    wander, rad/sqrt(s), where they last for longer than a frame. ``bias_rad_s``: the gyroscope's bias as it was then
    known, and its variance. ``stamp_std_s``: by how much the frame's stamp may be off besides.
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
    """A difference of two headings: how fast it grows, rad/s, its sigma, its value now and that value's sigma.

    The rate's sigma is that by the frames' errors alone; that of the value now counts how the gyroscope wanders, too.
    The value is to frames as they are stamped, early or late.
    ``misfit`` is the mean of the ``n`` squared residuals over their variances: 1 where it grows steadily.
    ``stamp_s``, ``stamp_variance``: by how much the frames are stamped early, as the differences alone show it, s.
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
    """What the sources say over one span; variances are of rates, (rad/s)^2.

    Parameters
    ----------
    gyro, yaw
        Slope of the frames' heading minus the dead-reckoned one (bias taken off), and minus the IMU's yaw; yaw is
        None where there is none.
    gyro_variance, bias_variance, yaw_variance
        By the noise and scale of the gyroscope, by its bias, and by the errors of the IMU's yaw.
    bias_rad_s
        The bias that was taken off.
    jumped
        Whether the frames themselves jumped, by more than the gyroscope turned meanwhile.
    frames_rejected
        Whether frames were rejected lately: a gyroscope that jumped by less has done no harm.
    yaw_probabilities
        Prior probabilities of what ails the IMU's yaw.
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
    """Append a frame unless it follows the last too closely; drop what is older than the span."""
    if comparisons and new.t_ns - comparisons[-1].t_ns < spacing_ns:
        return comparisons
    first = next((i for i, s in enumerate(comparisons) if new.t_ns - s.t_ns <= SPAN_NS), len(comparisons))
    return (*comparisons[first:], new)


def gyro_jump_between_frames(
    comparisons: tuple[HeadingComparison, ...], new: HeadingComparison, bias_rad_s: float
) -> float:
    """Return the size of a jump of the gyroscope since the last frame, rad; 0 without one, or if nothing shows it.

    A frame cannot tell one end of the corridor from the other. An IMU yaw may jump where the gyroscope does not
    (steel, a reset), but not stand still while the vehicle turns: of the two, the one that turned less is right.
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
    """Fit a line to differences, less those that lie off it by more than three sigmas; None: too few.

    Frames whose stamps are off by c differ by c times the rate of turning besides: c is fitted too, of which nothing
    is known but that it is `TIME_STD_S` or less.

    Parameters
    ----------
    t_s
        Times before now (n,), the last 0.
    difference_rad, std_rad
        Differences and the frames' sigmas (n,).
    turn_rad_s
        Rate of turning (n,).
    walk, gyro_walk
        How the frames' errors and the gyroscope wander, rad/sqrt(s).
    """
    terms = np.stack((np.ones(len(t_s)), t_s, turn_rad_s))
    line = _robust_line(terms, difference_rad, std_rad)
    if line is None:
        return None
    fitted, cov, off, keep = line
    span_s, turn_now = float(-t_s[0]), float(turn_rad_s[-1])
    squares = (off / std_rad) ** 2
    misfit = float(np.minimum(squares, MAX_MISFIT).mean())
    # Where the differences are not on a line, nothing constant is wrong.
    spread = max(1.0, float(squares @ keep) / len(t_s))
    rate_variance, c_variance = float(cov[1, 1]), float(cov[2, 2])
    rate_std = sqrt(rate_variance * spread + walked_rate_variance(walk, span_s))
    now, rate, stamp_s = fitted.tolist()
    # The filter takes frames at their stamps: its difference now is that of the frames, the turn's share included.
    at_now = np.array((1.0, 0.0, turn_now))
    now_variance = float(at_now @ cov @ at_now) + WALKED_END * (walk**2 + gyro_walk**2) * span_s
    found = Slope(rate, rate_std, now + stamp_s * turn_now, sqrt(now_variance), misfit, len(t_s))
    known = 1.0 / c_variance - TIME_STD_S**-2  # what the differences alone show of it
    if not known > 0.0:
        return found
    wander = WANDER_LIKE_TURN * (walk**2 + gyro_walk**2) * span_s  # it looks in part like a turn seen late
    stamp_variance = (spread + wander * float(keep @ std_rad**-2)) / known
    return found._replace(stamp_s=stamp_s / (c_variance * known), stamp_variance=stamp_variance)


def _robust_line(
    terms: FloatArray, difference_rad: FloatArray, std_rad: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, npt.NDArray[np.bool_]] | None:
    """Fit differences (n,) by terms (3, n), the last with a prior; those more than three sigmas off are left out.

    Returns
    -------
    fitted, cov, off, keep
        Coefficients (3,), their covariance (3, 3), absolute residuals (n,), and which frames were kept (n,); None
        where they are too few.
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
        # A frame at an end draws the line to itself: the variance of its residual is less by its leverage.
        leverage = np.add.reduce(weighted * (cov @ terms))
        squares = off**2 / np.maximum(1.0 + np.where(keep, -leverage, leverage), 1e-9)
        before, worst = keep, int(np.argmax(squares / std_rad**2))
        if attempt == 0 and squares[worst] > 9.0 * std_rad[worst] ** 2:
            keep = np.arange(n) != worst  # it would hide behind the scatter that it makes
            continue
        scatter2 = max(float(np.sort(squares)[n // 2]) / 0.67**2, 1e-18)  # by the median
        keep = squares <= 9.0 * np.maximum(std_rad**2, scatter2)
        if (keep == before).all():
            break
    return fitted, cov, off, keep


def walked_rate_variance(walk: float, span_s: float) -> float:
    """Variance, (rad/s)^2, of the slope of a line that is fitted to a random walk of this density over a span."""
    return 1.2 * walk * walk / span_s


class Drift:
    """How frames have drifted from gyroscope and IMU yaw, over any span up to now.

    Parameters
    ----------
    comparisons
        Frames, the newest of which is at the filter's time.
    psi_rad
        The filter's heading now: differences are to it, carried back by the gyroscope.
    noise
        Of the inertial sensors.
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
        """Return what they showed over the last ``span_s``.

        The bias is that from the start of the span: the filter's own has since taken up some of what is looked for.
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
        # A step of the camera's clock that is suspected may lie between any two frames.
        by_step = float(self._stamp_std[seen].max() * (abs(turn[0]) + abs(turn[-1]))) / span_s
        gyro = gyro._replace(rate_std=hypot(gyro.rate_std, by_step))
        by_scale = noise.gyro_scale_std * float(self._raw[seen][0]) / span_s
        gyro_variance = walked_rate_variance(noise.gyro_walk, span_s) + by_scale**2
        known = Evidence(gyro, None, gyro_variance, bias_variance, bias_rad_s=bias)
        if not np.isfinite(self._yaw[seen]).all():
            return known
        yaw = slope_of(t, _unwrapped(self._to_yaw[seen]), std, turn, self._walk, noise.gyro_walk)
        if yaw is None:
            return known
        # The slope of a line that is fitted to n white errors over a span T has variance 12 sigma^2 / (n T^2).
        white = 12.0 * noise.yaw_std**2 / (n * span_s**2)
        jumping = max(yaw.rate_std**2 - gyro.rate_std**2, 0.0)  # a yaw that jumps drifts at no constant rate
        yaw_variance = walked_rate_variance(noise.yaw_walk, span_s) + white + jumping
        return known._replace(yaw=yaw, yaw_variance=yaw_variance)


def _unwrapped(difference: FloatArray) -> FloatArray:
    """Differences of axes, the last within a quarter turn, the others within one of the last."""
    last = wrap_axis(float(difference[-1]))
    return last + (difference - last + 0.5 * pi) % pi - 0.5 * pi
