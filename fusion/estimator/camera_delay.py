"""Delay of the frames' time stamps, estimated in flight from dead reckoning and accepted frames.

A frame stamped d later than configured shows the heading of d ago, so its heading lags while the vehicle turns. The
heading filter mistakes the lag for an error of its heading; what remains in the innovations grows with changes of the
rate. The measured rate is no valid regressor: its noise is also in the heading's error, and their product would look
like a delay. The delay is therefore not a state of the Kalman filter, but estimated by an instrumental variable
(T. Soderstrom, P. Stoica, "Comparison of some instrumental variable methods", Automatica 17, 1981):

- A Kalman filter of the corridor's axis in the dead-reckoned frame and of the gyroscope's bias gives the innovations
  i of the frames and, by the sensitivity of its state, their derivative G with respect to the delay.
- The instrument w is a change of the rate, measured from a tenth of a second after the frame onwards. Its noise is
  independent of that in i and G, so E[w i] = E[w G] d, independently of the noise.
- With e = sum(w i / S), g = sum(w G / S) and v = sum(w^2 / S), S the innovations' variance, e has the mean g d and
  the variance v. With the prior sigma p of d from the configuration, the estimate is ``d = p^2 g e / (p^2 g^2 + v)``
  with the variance ``p^2 v / (p^2 g^2 + v)``. Without turns, w and G are uncorrelated, g is small against the root of
  v, and the prior remains.

The sensitivity of the main filter's heading and bias to the delay is propagated (as in the two-stage filter of B.
Friedland, "Treatment of bias in recursive filtering", IEEE Transactions on Automatic Control 14, 1969). It adds to
the heading's sigma, and the heading is corrected when the estimate of the delay changes.

A frame is used half a second after it was taken, when the rates are known; below five frames a second there may be no
information. The estimate needs changes of the rate: a turn at constant rate looks like another heading. The rate is
taken as constant over the delay, which is accurate for errors up to about 50 ms. Only the frame's heading is moved to
the corrected time; it was measured with the roll and pitch at the stamp.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import hypot, nan, sqrt
from typing import TYPE_CHECKING, NamedTuple

from fusion.estimator.config import FusionConfig
from fusion.estimator.models import BIAS, PSI
from fusion.estimator.noise_adaptation import correlation, equivalent_white_variance
from vision.rotations import wrap_axis

if TYPE_CHECKING:
    from fusion.estimator.ekf import CorridorEKF

MAX_LATE_S = 0.1
STEP_NS = 20_000_000
RATE_NS = 100_000_000  # window of the rate about a frame
RECENT_NS = 40_000_000  # window of the rate at the newest sample
GUARD_NS = 100_000_000  # from a frame to its instrument: outside the window of the rate for every delay
PART_NS = 200_000_000  # length of each of the instrument's two windows
LEVEL = 0.3  # weight of the rate itself in the instrument, beside its change
LAG_NS = GUARD_NS + 2 * PART_NS
BEHIND_NS = (RATE_NS + round(MAX_LATE_S * 1e9)) // 2
KEPT_NS = LAG_NS + BEHIND_NS + 200_000_000


class TurnPoint(NamedTuple):
    """Heading dead-reckoned by the gyroscope, bias not subtracted."""

    t_ns: int
    theta_rad: float


class FrameHeading(NamedTuple):
    """A frame's heading and its variance; ``epoch`` changes with the axis."""

    t_ns: int
    heading_rad: float
    variance: float
    epoch: int


class AxisNoise(NamedTuple):
    """Densities of the gyroscope's noise and bias walk, the bias's sigma, and the frames' correlation time."""

    gyro: float
    bias_std_rad_s: float
    bias_walk: float
    correlation_s: float


class AxisFilter(NamedTuple):
    """Kalman filter of the corridor's axis in the dead-reckoned frame, with ``angle' = bias``.

    Parameters
    ----------
    angle_rad, bias_rad_s
        State: the axis, and the gyroscope's bias, by which it drifts.
    P
        Covariance: axis, axis with bias, bias.
    per_s
        Derivatives (2,) of the state with respect to the camera's delay.
    """

    angle_rad: float
    bias_rad_s: float
    P: tuple[float, float, float]
    per_s: tuple[float, float]

    def predicted(self, dt_s: float, noise: AxisNoise) -> AxisFilter:
        """Predict by ``dt_s``."""
        a, c, b = self.P
        walk = noise.bias_walk**2 * dt_s
        P = (
            a + 2.0 * dt_s * c + dt_s * dt_s * b + noise.gyro**2 * dt_s + walk * dt_s * dt_s / 3.0,
            c + dt_s * b + walk * dt_s / 2.0,
            b + walk,
        )
        angle, bias = self.per_s
        return AxisFilter(
            self.angle_rad + self.bias_rad_s * dt_s, self.bias_rad_s, P, (angle + bias * dt_s, bias)
        )

    def updated(self, innovation_rad: float, innovation_per_s: float, variance: float) -> AxisFilter:
        """Update with an innovation and its derivative with respect to the delay."""
        a, c, b = self.P
        k, j = a / (a + variance), c / (a + variance)
        angle, bias = self.per_s
        return AxisFilter(
            self.angle_rad + k * innovation_rad,
            self.bias_rad_s + j * innovation_rad,
            ((1.0 - k) * a, (1.0 - k) * c, b - j * c),
            (angle + k * innovation_per_s, bias + j * innovation_per_s),
        )


class Effect(NamedTuple):
    """Sensitivity of the main filter's heading and bias at a time to the delay; ``epoch`` as for frames."""

    t_ns: int
    heading_per_s: float
    bias_per_s: float
    epoch: int


class Delay(NamedTuple):
    """Estimate of the delay; immutable.

    Parameters
    ----------
    std_s
        Configured standard deviation.
    bounds_s
        Bounds of the delay beyond the configured one: no frame is stamped before its exposure or leaves the buffer.
    turns, waiting
        Recent dead reckoning, and the frames whose rates are not all known yet.
    last
        The last frame used; None after a restart of the axis.
    axis
        Filter of the axis.
    evidence, gain, spread
        The sums e, g and v.
    effect
        Sensitivity of the main filter; None while that has no heading.
    """

    std_s: float
    bounds_s: tuple[float, float] = (-MAX_LATE_S, MAX_LATE_S)
    turns: tuple[TurnPoint, ...] = ()
    waiting: tuple[FrameHeading, ...] = ()
    last: FrameHeading | None = None
    axis: AxisFilter | None = None
    evidence: float = 0.0
    gain: float = 0.0
    spread: float = 0.0
    effect: Effect | None = None

    @property
    def late_s(self) -> float:
        """Delay beyond the configured one."""
        prior = self.std_s**2
        gain = max(self.gain, 0.0)
        late = (
            prior * gain * self.evidence / (prior * gain * gain + self.spread) if self.spread > 0.0 else 0.0
        )
        return min(max(late, self.bounds_s[0]), self.bounds_s[1])

    @property
    def variance(self) -> float:
        """Variance of `late_s`, s^2."""
        prior = self.std_s**2
        gain = max(self.gain, 0.0)
        return prior * self.spread / (prior * gain * gain + self.spread) if self.spread > 0.0 else prior

    def heading_per_s(self, t_ns: int) -> float:
        """Return the sensitivity of the main filter's heading to the delay at a time, rad/s."""
        if self.effect is None:
            return 0.0
        return self.effect.heading_per_s - self.effect.bias_per_s * (t_ns - self.effect.t_ns) * 1e-9

    def interrupted(self) -> Delay:
        """Restart axis and dead reckoning; keep the estimate of the delay."""
        return self._replace(turns=(), waiting=(), last=None, axis=None, effect=None)


def initial_delay(config: FusionConfig) -> Delay | None:
    """Return the prior from the configuration; None if the delay is configured as known."""
    if config.camera_delay_std_s <= 0.0:
        return None
    configured_s = config.camera_delay_s
    bounds = (max(-configured_s, -MAX_LATE_S), min(config.buffer_s - configured_s, MAX_LATE_S))
    return Delay(config.camera_delay_std_s, bounds)


def camera_delay(delay: Delay | None, config: FusionConfig) -> tuple[float, float]:
    """Return the delay of the frames' stamps, s, and its sigma; NaN if the delay is configured as known."""
    if delay is None:
        return config.camera_delay_s, nan
    return config.camera_delay_s + delay.late_s, sqrt(delay.variance)


def spread_by_delay(heading_std_rad: float, delay: Delay | None, t_ns: int) -> float:
    """Return the sigma of the heading at a time, with the contribution of the delay's sigma."""
    if delay is None:
        return heading_std_rad
    return hypot(heading_std_rad, delay.heading_per_s(t_ns) * sqrt(delay.variance))


def with_turns(delay: Delay, t_ns: Sequence[int], theta_rad: Sequence[float]) -> Delay:
    """Add dead reckoning in order of time, thinned to one point per `STEP_NS`, and drop old points."""
    turns, first = list(delay.turns), 0
    for t, theta in zip(t_ns, theta_rad, strict=True):
        if len(turns) - first > 1 and t - turns[-2].t_ns < STEP_NS:
            turns.pop()
        if len(turns) > first and t - turns[first].t_ns > KEPT_NS:
            first += 1
        turns.append(TurnPoint(t, theta))
    return delay._replace(turns=tuple(turns[first:]))


def turned_at(turns: tuple[TurnPoint, ...], t_ns: int) -> float:
    """Return the angle at a time by linear interpolation; constant beyond the ends."""
    after = turns[-1]
    if t_ns >= after.t_ns:
        return after.theta_rad
    for before in reversed(turns):
        if before.t_ns <= t_ns:
            part = (t_ns - before.t_ns) / (after.t_ns - before.t_ns)
            return before.theta_rad + part * (after.theta_rad - before.theta_rad)
        after = before
    return after.theta_rad


def mean_rate(turns: tuple[TurnPoint, ...], start_ns: int, end_ns: int) -> float:
    """Return the mean rate between two times, rad/s."""
    return (turned_at(turns, end_ns) - turned_at(turns, start_ns)) / ((end_ns - start_ns) * 1e-9)


def turned_since(delay: Delay, t_ns: int, theta_rad: float) -> float:
    """Return the angle turned in the last ``delay.late_s``; extrapolated by the present rate if that is negative."""
    late_s = delay.late_s
    if late_s > 0.0:
        turns = (*delay.turns, TurnPoint(t_ns, theta_rad))
        return theta_rad - turned_at(turns, t_ns - round(late_s * 1e9))
    return recent_rate(delay, t_ns, theta_rad) * late_s


def recent_rate(delay: Delay, t_ns: int, theta_rad: float) -> float:
    """Return the mean rate over the last `RECENT_NS`."""
    turns = (*delay.turns, TurnPoint(t_ns, theta_rad))
    return mean_rate(turns, max(t_ns - RECENT_NS, turns[0].t_ns), t_ns) if turns[0].t_ns < t_ns else 0.0


def with_frame(delay: Delay, seen: FrameHeading, noise: AxisNoise) -> Delay:
    """Add a frame to the queue, and update with the frames whose rates are known by now."""
    delay = delay._replace(waiting=(*delay.waiting, seen))
    while delay.waiting and delay.turns and delay.waiting[0].t_ns + LAG_NS <= delay.turns[-1].t_ns:
        first = delay.waiting[0]
        delay = delay._replace(waiting=delay.waiting[1:])
        if first.t_ns - BEHIND_NS >= delay.turns[0].t_ns:
            delay = _updated(delay, first, noise)
    return delay


def _updated(delay: Delay, seen: FrameHeading, noise: AxisNoise) -> Delay:
    turns, t_ns = delay.turns, seen.t_ns
    middle_ns = t_ns - round(0.5e9 * delay.late_s)
    rate = mean_rate(turns, middle_ns - RATE_NS // 2, middle_ns + RATE_NS // 2)
    measured = turned_at(turns, t_ns) - seen.heading_rad
    axis, last = delay.axis, delay.last
    if axis is None or last is None:
        started = AxisFilter(measured, 0.0, (seen.variance, 0.0, noise.bias_std_rad_s**2), (rate, 0.0))
        return delay._replace(last=seen, axis=started)
    rate -= axis.bias_rad_s
    if last.epoch != seen.epoch:
        started = AxisFilter(
            measured, axis.bias_rad_s, (seen.variance, 0.0, axis.P[2]), (rate, axis.per_s[1])
        )
        return delay._replace(last=seen, axis=started)
    axis = axis.predicted((t_ns - last.t_ns) * 1e-9, noise)
    variance = equivalent_white_variance(
        seen.variance, axis.P[0], correlation(t_ns, last.t_ns, noise.correlation_s)
    )
    innovation, per_s, S = wrap_axis(measured - axis.angle_rad), rate - axis.per_s[0], axis.P[0] + variance
    start_ns = t_ns + GUARD_NS
    near = mean_rate(turns, start_ns, start_ns + PART_NS) - axis.bias_rad_s
    far = mean_rate(turns, start_ns + PART_NS, start_ns + 2 * PART_NS) - axis.bias_rad_s
    instrument = far - near + LEVEL * near
    return delay._replace(
        last=seen,
        axis=axis.updated(innovation, per_s, variance),
        evidence=delay.evidence + instrument * innovation / S,
        gain=delay.gain + instrument * per_s / S,
        spread=delay.spread + instrument * instrument / S,
    )


class DelayedInnovation(NamedTuple):
    """Derivative of an innovation with respect to the delay, rad/s, and the variance that the delay adds to it."""

    per_s: float
    variance: float


def turned_since_exposure(delay: Delay | None, bias_rad_s: float, t_ns: int, raw_theta_rad: float) -> float:
    """Return the angle turned in the time by which a frame is estimated to be later than configured.

    Parameters
    ----------
    delay
        Estimate of the delay; None if it is configured as known.
    bias_rad_s
        The gyroscope's bias.
    t_ns, raw_theta_rad
        Time now, and the dead-reckoned heading, bias not subtracted.
    """
    if delay is None:
        return 0.0
    return turned_since(delay, t_ns, raw_theta_rad) - bias_rad_s * delay.late_s


def with_axis(delay: Delay, ekf: CorridorEKF, t_ns: int, raw_theta_rad: float, epoch: int) -> Delay:
    """Start the sensitivity of the main filter if it measures the heading from a new axis.

    Parameters
    ----------
    delay
        Estimate of the delay.
    ekf
        Main filter.
    t_ns, raw_theta_rad
        Time now, and the dead-reckoned heading, bias not subtracted.
    epoch
        Number of jumps of the heading.
    """
    if delay.effect is not None and delay.effect.epoch == epoch:
        return delay
    rate = recent_rate(delay, t_ns, raw_theta_rad) - float(ekf.x[BIAS])  # the heading is that of a few frames
    return delay._replace(effect=Effect(t_ns, -rate, 0.0, epoch))


def innovation_of(delay: Delay, ekf: CorridorEKF, t_ns: int, raw_theta_rad: float) -> DelayedInnovation:
    """Return the effect of the delay's error on the next innovation of the heading; arguments as in `with_axis`."""
    rate = recent_rate(delay, t_ns, raw_theta_rad) - float(ekf.x[BIAS])
    per_s = -rate - delay.heading_per_s(t_ns)
    return DelayedInnovation(per_s, per_s**2 * delay.variance)


def learn_delay(
    delay: Delay, ekf: CorridorEKF, seen: FrameHeading, innovation_per_s: float, config: FusionConfig
) -> Delay:
    """Update the delay with an accepted frame, and correct the main filter by the change of the delay.

    Parameters
    ----------
    delay
        Estimate of the delay before the frame.
    ekf
        Main filter, right after its update with the frame's heading.
    seen
        The frame's heading.
    innovation_per_s
        From `innovation_of`.
    config
        Settings.
    """
    if delay.effect is None:
        return delay
    heading_per_s = delay.heading_per_s(seen.t_ns) + float(ekf.K[PSI, 0]) * innovation_per_s
    bias_per_s = delay.effect.bias_per_s + float(ekf.K[BIAS, 0]) * innovation_per_s
    before_s = delay.late_s
    noise = AxisNoise(
        config.gyro_noise, config.gyro_bias_std_rad_s, config.bias_walk, config.heading_correlation_s
    )
    effect = Effect(seen.t_ns, heading_per_s, bias_per_s, seen.epoch)
    delay = with_frame(delay, seen, noise)._replace(effect=effect)
    x = ekf.x.copy()  # earlier frames were fused with the old delay: correct their effect
    x[PSI] -= heading_per_s * (delay.late_s - before_s)
    x[BIAS] -= bias_per_s * (delay.late_s - before_s)
    ekf.correct(x)
    return delay
