"""Checks of the IMU's yaw: whether its errors are independent of the gyroscope's, and whether it is disturbed.

**Independence.** An attitude filter's yaw usually contains the gyroscope's errors; fused as independent, it makes the
filter overconfident. Over spans of a few seconds, frames show the drift g of dead reckoning and y of the IMU's yaw.
The means of ``(g^2 - r) / T``, ``(y^2 - r) / T`` and ``(g y - r) / T``, with r the frames' own variance and T the
span, estimate the variances per second of both and their common part. The yaw is independent if the common part is
below `MAX_SHARED` of the gyroscope's configured variance, and its own below `MAX_YAW_WALK` squared of the configured
one (`is_independent`). Such a yaw (a good compass, a second gyroscope) is fused, which helps while no frame is used.

**Disturbance.** Steel or motor currents can disturb an independent yaw, at once or over seconds. Its difference to
the gyroscope then changes by more than `DISTURBED_SIGMA` (`find_disturbance`). The effect on the heading is undone,
and the yaw is not used until both have agreed for `UNDISTURBED_NS`.

**Probabilities.** `YawProbabilities` are the priors of `fusion.estimator.hypotheses`: that the yaw is disturbed, and
that it repeats the gyroscope's errors. The latter follows by Bayes' rule from means of yaw minus gyroscope over
adjoining blocks: a repeated error cancels in the difference, an independent one adds ``2/3 q^2 T``.
"""

from __future__ import annotations

from math import exp, isfinite, log, nan, pi, radians, remainder, sqrt
from typing import NamedTuple

from vision.rotations import wrap, wrap_axis

BLOCK_NS = 500_000_000
MIN_FRAMES = 3  # per block
MIN_SPAN_S, MAX_SPAN_S = 2.0, 8.0
STEP_RAD = radians(4)  # a larger change over a span is a disturbance and no random walk
MEMORY = 40.0  # spans
MIN_SPANS = 8.0
MAX_SHARED = 0.5  # part of the gyroscope's variance that the IMU's yaw may share
MAX_YAW_WALK = 1.5  # density of the IMU yaw's random walk, over the configured one
TRACE_NS = 3_000_000_000  # longest time over which yaw and gyroscope are compared
TRACE_STEP_NS = 100_000_000
UNDISTURBED_NS = 2_000_000_000
DISTURBED_SIGMA = 4.5  # high, because there are many comparisons
DISTURBED_MEMORY = 1 / 20  # gain per judgement: five seconds
MIN_PROBABILITY, MAX_PROBABILITY = 0.005, 0.9  # bounds, since the yaw's quality may change
MAX_LOG_RATIO = 6.0  # bound of one block's log likelihood ratio


class Block(NamedTuple):
    """Frames of half a second: time, heading minus dead reckoning and minus IMU yaw, variance of both means."""

    t_ns: int
    gyro_rad: float
    yaw_rad: float
    variance: float


class YawDriftStatistics(NamedTuple):
    """Drift of gyroscope and IMU yaw, as measured by frames; variances are per second, rad^2/s.

    Parameters
    ----------
    first, n, sums
        The block being filled: its first frame, number of frames, sums of differences to the first and of variances.
    reference
        The block that the next one is compared with.
    spans
        Number of comparisons in the means, at most `MEMORY`.
    gyro, yaw, shared
        Variances per second of the dead-reckoned heading and of the IMU's yaw, and their covariance.
    """

    first: Block | None = None
    n: int = 0
    sums: tuple[float, float, float] = (0.0, 0.0, 0.0)
    reference: Block | None = None
    spans: float = 0.0
    gyro: float = 0.0
    yaw: float = 0.0
    shared: float = 0.0

    def interrupted(self) -> YawDriftStatistics:
        """Drop the running comparison after a change of the axis."""
        return self._replace(first=None, reference=None)


def with_difference(
    w: YawDriftStatistics, t_ns: int, gyro_rad: float, yaw_rad: float, variance: float
) -> YawDriftStatistics:
    """Add an accepted frame.

    Parameters
    ----------
    gyro_rad, yaw_rad
        The frame's heading minus the dead-reckoned heading, and minus the IMU's yaw at the frame's time.
    variance
        Variance of the frame's heading.
    """
    if w.first is not None and t_ns - w.first.t_ns >= BLOCK_NS:
        if w.n >= MIN_FRAMES:
            w = _compare(w, _mean(w.first, w))
        w = w._replace(first=None)
    if w.first is None:
        return w._replace(first=Block(t_ns, gyro_rad, yaw_rad, variance), n=1, sums=(0.0, 0.0, variance))
    g, y, v = w.sums
    sums = (
        g + wrap_axis(gyro_rad - w.first.gyro_rad),
        y + wrap_axis(yaw_rad - w.first.yaw_rad),
        v + variance,
    )
    return w._replace(n=w.n + 1, sums=sums)


def _mean(first: Block, w: YawDriftStatistics) -> Block:
    g, y, v = w.sums
    return Block(first.t_ns, first.gyro_rad + g / w.n, first.yaw_rad + y / w.n, v / w.n**2)


def _compare(w: YawDriftStatistics, block: Block) -> YawDriftStatistics:
    old = w.reference
    if old is None:
        return w._replace(reference=block)
    span_s = (block.t_ns - old.t_ns) * 1e-9
    if span_s < MIN_SPAN_S:
        return w
    g, y = wrap_axis(block.gyro_rad - old.gyro_rad), wrap_axis(block.yaw_rad - old.yaw_rad)
    if span_s > MAX_SPAN_S or max(abs(g), abs(y)) > STEP_RAD:
        return w._replace(reference=block)
    noise = block.variance + old.variance  # the frames' own errors are in both differences
    spans = min(w.spans + 1.0, MEMORY)

    def toward(old_value: float, product: float) -> float:
        return old_value + ((product - noise) / span_s - old_value) / spans

    return w._replace(
        reference=block,
        spans=spans,
        gyro=toward(w.gyro, g * g),
        yaw=toward(w.yaw, y * y),
        shared=toward(w.shared, g * y),
    )


def is_independent(w: YawDriftStatistics, gyro_density: float, yaw_density: float) -> bool:
    """Whether the IMU's yaw is independent of the gyroscope and not noisier than configured.

    ``gyro_density`` and ``yaw_density`` are the configured densities of both, rad/sqrt(s).
    """
    if w.spans < MIN_SPANS:
        return False
    # Standard error of the covariance of independent errors.
    error = sqrt(max(w.gyro, 0.0) * max(w.yaw, 0.0) / w.spans)
    return w.shared + error < MAX_SHARED * gyro_density**2 and w.yaw < (MAX_YAW_WALK * yaw_density) ** 2


class Trace(NamedTuple):
    """IMU yaw and filter's heading at one time, both less the gyroscope's angle; the bias and its variance."""

    t_ns: int
    yaw_rad: float
    heading_rad: float
    bias_rad_s: float
    bias_variance: float


class YawDisturbance(NamedTuple):
    """Change of heading and bias since ``since_ns``, beyond the prediction by the gyroscope alone."""

    since_ns: int
    heading_rad: float
    bias_rad_s: float


def find_disturbance(
    traces: tuple[Trace, ...], now: Trace, variance_per_s: float, yaw_variance: float
) -> YawDisturbance | None:
    """Find the start of a significant change of IMU yaw minus gyroscope; None if there is none.

    ``variance_per_s`` is the random walk of both, ``yaw_variance`` the white noise of the yaw. The bias is that of
    the earlier time, because a slow disturbance shifts the estimated bias too.
    """
    for old in traces:
        span_s = (now.t_ns - old.t_ns) * 1e-9
        drift = -old.bias_rad_s * span_s
        variance = (variance_per_s + old.bias_variance * span_s) * span_s + 2.0 * yaw_variance
        if wrap(now.yaw_rad - old.yaw_rad - drift) ** 2 > DISTURBED_SIGMA**2 * variance:
            moved = now.heading_rad - old.heading_rad - drift
            return YawDisturbance(old.t_ns, moved, now.bias_rad_s - old.bias_rad_s)
    return None


def is_due(traces: tuple[Trace, ...], t_ns: int) -> bool:
    """Whether the next trace is due."""
    return not traces or t_ns - traces[-1].t_ns >= TRACE_STEP_NS


def with_trace(traces: tuple[Trace, ...], now: Trace) -> tuple[Trace, ...]:
    """Append a trace and drop old ones."""
    return (*(old for old in traces if now.t_ns - old.t_ns <= TRACE_NS), now)


def shifted_by(step_rad: float, traces: tuple[Trace, ...]) -> tuple[Trace, ...]:
    """Shift the traces by a step of the yaw that the offset has absorbed."""
    return tuple(old._replace(yaw_rad=old.yaw_rad + step_rad) for old in traces)


def is_undisturbed(traces: tuple[Trace, ...]) -> bool:
    """Whether yaw and gyroscope have agreed for `UNDISTURBED_NS`."""
    return bool(traces) and traces[-1].t_ns - traces[0].t_ns >= UNDISTURBED_NS


class InertialNoise(NamedTuple):
    """Random walks of gyroscope and IMU yaw, rad/sqrt(s), the yaw's white noise, rad, the gyroscope's scale error."""

    gyro_walk: float
    yaw_walk: float
    yaw_std: float
    gyro_scale_std: float = 0.0


class GyroAndYaw(NamedTuple):
    """Gyroscope (bias not subtracted) and IMU yaw at one time, and the bias that the filter subtracts."""

    t_ns: int
    raw_theta_rad: float
    yaw_rad: float
    bias_rad_s: float
    bias_variance: float


class YawMean(NamedTuple):
    """Mean of ``n`` differences of IMU yaw and gyroscope since ``began_ns``, and the mean of the block before."""

    reference: GyroAndYaw
    began_ns: int
    n: int = 0
    mean_rad: float = 0.0
    n_before: int = 0
    before_rad: float = nan


class YawProbabilities(NamedTuple):
    """Probabilities that the IMU's yaw is disturbed at present, and that it repeats the gyroscope's errors.

    Both are learned in flight from an initial guess: attitude filters and buildings differ.
    """

    disturbed: float = 0.05
    repeating: float = 0.2
    mean: YawMean | None = None

    def with_judgement(self, disturbed: float) -> YawProbabilities:
        """Update the part of the time in which the yaw is disturbed, with the probability of one judgement."""
        share = self.disturbed + DISTURBED_MEMORY * (disturbed - self.disturbed)
        return self._replace(disturbed=max(share, MIN_PROBABILITY))

    def compared(self, now: GyroAndYaw, noise: InertialNoise) -> YawProbabilities:
        """Compare IMU yaw and gyroscope without frames: common errors cancel in their difference."""
        mean = self.mean
        if not isfinite(now.yaw_rad):
            return self._replace(mean=None)
        if mean is None or now.t_ns - mean.began_ns > 2 * BLOCK_NS:
            return self._replace(mean=YawMean(now, now.t_ns, 1))
        turned = now.raw_theta_rad - mean.reference.raw_theta_rad
        apart = remainder(now.yaw_rad - mean.reference.yaw_rad - turned, 2.0 * pi)
        if now.t_ns - mean.began_ns < BLOCK_NS:
            n = mean.n + 1
            return self._replace(
                mean=mean._replace(n=n, mean_rad=mean.mean_rad + (apart - mean.mean_rad) / n)
            )
        repeating = _repeats(self.repeating, mean, now, noise) if mean.n_before else self.repeating
        mean = YawMean(mean.reference, now.t_ns, 1, apart, mean.n, mean.mean_rad)
        return self._replace(repeating=repeating, mean=mean)


def _repeats(prior: float, mean: YawMean, now: GyroAndYaw, noise: InertialNoise) -> float:
    """Return the probability that the IMU's yaw repeats the gyroscope's errors, from means over two adjoining blocks.

    Means of a random walk of density q over adjoining spans T differ with the variance 2/3 q^2 T.
    """
    span_s = BLOCK_NS * 1e-9
    step = remainder(mean.mean_rad - mean.before_rad + now.bias_rad_s * span_s, 2.0 * pi)
    white = noise.yaw_std**2 * (1.0 / mean.n + 1.0 / mean.n_before)
    alike = white + now.bias_variance * span_s**2 + 2.0 / 3.0 * noise.yaw_walk**2 * span_s
    by_gyro = 2.0 / 3.0 * noise.gyro_walk**2 * span_s
    log_ratio = log_normal(step, alike) - log_normal(step, alike + by_gyro)
    ratio = exp(max(log_ratio, -MAX_LOG_RATIO))
    repeating = prior * ratio / (prior * ratio + 1.0 - prior)
    return min(max(repeating, MIN_PROBABILITY), MAX_PROBABILITY)


def log_normal(x: float, variance: float) -> float:
    """Return the log density of a normal distribution with mean zero."""
    return -0.5 * (x * x / variance + log(2.0 * pi * variance))
