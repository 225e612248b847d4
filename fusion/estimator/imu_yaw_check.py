"""Check whether the IMU's yaw is independent of the gyroscope, by the frames.

An attitude filter's yaw usually contains the gyroscope's error; fused as independent, it makes the filter
overconfident. Frames show over a few seconds how far dead reckoning and IMU yaw have each drifted. If the two errors
are correlated, the yaw is not independent. An independent yaw (a good compass, a second gyroscope) is fused, and
helps while no frame is used.

Steel or a motor's current may disturb even an independent yaw, at once or over seconds. It then deviates from the
gyroscope faster than the noises of both allow. Its effect on the heading is undone, and it is not used until the two
agree again.
"""

from __future__ import annotations

from math import exp, isfinite, log, nan, pi, radians, remainder, sqrt
from typing import NamedTuple

from vision.rotations import wrap, wrap_axis

BLOCK_NS = 500_000_000
MIN_FRAMES = 3  # of a block
MIN_SPAN_S, MAX_SPAN_S = 2.0, 8.0
STEP_RAD = radians(4)  # more than that over a span is a disturbance, not wander
MEMORY = 40.0  # spans
MIN_SPANS = 8.0
MAX_SHARED = 0.5  # part of the gyroscope's wander that the IMU's yaw may repeat
MAX_WANDER = 1.5  # of the IMU's yaw, over what the configuration takes it for
TRACE_NS = 3_000_000_000  # how far back yaw and gyroscope are compared
TRACE_STEP_NS = 100_000_000
CALM_NS = 2_000_000_000
DISTURBED_SIGMA = 4.5  # less, and the many comparisons would find chance
DISTURBED_MEMORY = 1 / 20  # of a look: five seconds
LEAST_DOUBT, MOST_DOUBT = 0.005, 0.9  # of the IMU's yaw: what it is may change
MOST_NATS = 6.0  # that one block tells


class Block(NamedTuple):
    """Frames of half a second: when, heading minus dead reckoning and minus IMU yaw, variance of both means."""

    t_ns: int
    gyro_rad: float
    yaw_rad: float
    variance: float


class YawDriftStatistics(NamedTuple):
    """What the frames have shown so far; variances are per second, rad^2/s.

    Parameters
    ----------
    first, n, sums
        The block being filled: its first frame, how many, and sums of differences to the first and of variances.
    reference
        The block that the next is compared with.
    spans
        How many comparisons have been made, as far as they are remembered.
    gyro, yaw, shared
        Wander of the dead-reckoned heading, of the IMU's yaw, and what they have in common.
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
        """Return the watch with the running comparison dropped: the axis has changed."""
        return self._replace(first=None, reference=None)


def with_difference(
    w: YawDriftStatistics, t_ns: int, gyro_rad: float, yaw_rad: float, variance: float
) -> YawDriftStatistics:
    """Take in a frame that the filter accepted.

    Parameters
    ----------
    gyro_rad, yaw_rad
        The frame's heading minus the dead-reckoned heading, and minus the IMU's yaw at the frame's time.
    variance
        Of the frame's heading.
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
    """Whether the IMU's yaw strays on its own, and no more than ``yaw_density`` (rad/sqrt(s)) allows.

    ``gyro_density`` is the gyroscope's noise as configured, rad/sqrt(s).
    """
    if w.spans < MIN_SPANS:
        return False
    error = sqrt(max(w.gyro, 0.0) * max(w.yaw, 0.0) / w.spans)  # of the common part, where there is none
    return w.shared + error < MAX_SHARED * gyro_density**2 and w.yaw < (MAX_WANDER * yaw_density) ** 2


class Trace(NamedTuple):
    """IMU yaw and filter's heading at one time, less the turns that the gyroscope has measured; bias and variance."""

    t_ns: int
    yaw_rad: float
    heading_rad: float
    bias_rad_s: float
    bias_variance: float


class YawDisturbance(NamedTuple):
    """How far heading and bias have come, since ``since_ns``, from where the gyroscope alone would have them."""

    since_ns: int
    heading_rad: float
    bias_rad_s: float


def find_disturbance(
    traces: tuple[Trace, ...], now: Trace, variance_per_s: float, yaw_variance: float
) -> YawDisturbance | None:
    """Find since when the IMU's yaw departs from the gyroscope by more than noise allows; None: it does not.

    ``variance_per_s`` is that by which both may wander, ``yaw_variance`` that of one yaw's noise. The bias is that of
    the earlier time: a yaw that is pulled away slowly takes the bias along too.
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
    """Whether it is time to look again."""
    return not traces or t_ns - traces[-1].t_ns >= TRACE_STEP_NS


def with_trace(traces: tuple[Trace, ...], now: Trace) -> tuple[Trace, ...]:
    """Append a trace and drop old ones."""
    return (*(old for old in traces if now.t_ns - old.t_ns <= TRACE_NS), now)


def stepped_by(step_rad: float, traces: tuple[Trace, ...]) -> tuple[Trace, ...]:
    """Go on after a step that the offset has taken up: it is as if the yaw had always been there."""
    return tuple(old._replace(yaw_rad=old.yaw_rad + step_rad) for old in traces)


def is_calm(traces: tuple[Trace, ...]) -> bool:
    """Whether yaw and gyroscope have agreed for a while."""
    return bool(traces) and traces[-1].t_ns - traces[0].t_ns >= CALM_NS


class InertialNoise(NamedTuple):
    """How gyroscope and IMU yaw wander, rad/sqrt(s), the yaw's white noise, rad, and the gyroscope's scale error."""

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
    """Mean of ``n`` differences of IMU yaw and gyroscope since ``began_ns``, and the mean of those before."""

    reference: GyroAndYaw
    began_ns: int
    n: int = 0
    mean_rad: float = 0.0
    n_before: int = 0
    before_rad: float = nan


class YawProbabilities(NamedTuple):
    """Probabilities that steel pulls the IMU's yaw away now, and that it always repeats the gyroscope's errors.

    Attitude filters differ, and so do buildings: from the start's guess on, both are learned in flight.
    """

    disturbed: float = 0.05
    repeating: float = 0.2
    mean: YawMean | None = None

    def with_look(self, disturbed: float) -> YawProbabilities:
        """Update the share of the time in which it is disturbed, with the probability of one look."""
        share = self.disturbed + DISTURBED_MEMORY * (disturbed - self.disturbed)
        return self._replace(disturbed=max(share, LEAST_DOUBT))

    def compared(self, now: GyroAndYaw, noise: InertialNoise) -> YawProbabilities:
        """Compare IMU yaw and gyroscope, without frames: an error that both make is not in their difference."""
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
    """Probability that the IMU's yaw repeats the gyroscope's errors, by means over two adjoining blocks.

    Of a random walk of density q, the means over adjoining spans T differ by a variance of 2/3 q^2 T.
    """
    span_s = BLOCK_NS * 1e-9
    step = remainder(mean.mean_rad - mean.before_rad + now.bias_rad_s * span_s, 2.0 * pi)
    white = noise.yaw_std**2 * (1.0 / mean.n + 1.0 / mean.n_before)
    alike = white + now.bias_variance * span_s**2 + 2.0 / 3.0 * noise.yaw_walk**2 * span_s
    by_gyro = 2.0 / 3.0 * noise.gyro_walk**2 * span_s
    nats = log_normal(step, alike) - log_normal(step, alike + by_gyro)
    ratio = exp(max(nats, -MOST_NATS))
    repeating = prior * ratio / (prior * ratio + 1.0 - prior)
    return min(max(repeating, LEAST_DOUBT), MOST_DOUBT)


def log_normal(x: float, variance: float) -> float:
    """Log density of a normal distribution of mean zero."""
    return -0.5 * (x * x / variance + log(2.0 * pi * variance))
