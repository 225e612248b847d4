"""Dead reckoning: propagates the heading filter by gyroscope, attitude or a constant rate.

The source (`Mode`) is chosen at each sample: the gyroscope; if it is absent or silent, the yaw increments of the
attitude stream; without both, a constant rate (the bias state is then minus that rate). With the measured turn
``delta`` over dt, a step is::

    psi += delta - b dt,    P = F P F' + Q,    Q[psi, psi] += v

For the gyroscope, ``delta`` is the trapezoid of the level yaw rate (`fusion.estimator.models.level_yaw_rate`). At a
sample of another source the last rate is held; the next gyroscope sample adds the rest of its trapezoid. The extra
variance v contains the error of the gyroscope's scale, a gap in its samples (the rate is a random walk of density
``yaw_acceleration_density``), and noise beyond the configured one. The scale's error counts as a random walk of the
rate over `SCALE_TIME_S`; beyond half a turn since the last accepted frame as constant, if that adds more: in a long
turn without frames its sigma grows with the angle.
"""

from __future__ import annotations

from enum import StrEnum
from math import isfinite, nan, pi
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from fusion.estimator.config import FusionConfig
from fusion.estimator.models import BIAS, N_STATES, PSI, ProcessNoise, Vector
from fusion.estimator.records import new_record
from fusion.estimator.sample_times import SampleTimes, seconds_since
from fusion.estimator.tilt import ATTITUDE_GAP_S
from vision.rotations import wrap

if TYPE_CHECKING:
    from fusion.estimator.ekf import CorridorEKF

UNKNOWN_HEADING_STD_RAD = pi / 2
ATTITUDE_DRIFT_STD_RAD_S = 0.003  # an attitude filter has removed most of the gyroscope's bias
HELD_RATE_STD_RAD_S = 0.2
SCALE_TIME_S = 0.5  # duration of a turn in one direction, over which the scale's error adds up at least
LONG_TURN_RAD = pi  # without frames, beyond which the scale's error adds up as it does if it is constant
MAX_YAW_AGE_S = 0.1  # oldest attitude that a frame is compared with


class ImuSample(NamedTuple):
    """Gyroscope (3,) rad/s and, if present, accelerometer (3,) m/s^2, body FRD."""

    t_ns: int
    gyro_rad_s: Vector
    accel_m_s2: Vector | None

    def fault(self) -> str:
        """Return the reason why it cannot be used; empty if it can."""
        p, q, r = self.gyro_rad_s
        return "" if isfinite(p) and isfinite(q) and isfinite(r) else "imu_not_finite"


class Mode(StrEnum):
    """Source that propagates the heading between frames."""

    NONE = "none"  # a rate assumed constant
    ATTITUDE = "attitude"  # yaw increments of the attitude stream
    GYRO = "gyro"


# Member lookup of an enum is slow in Python 3.11, and needed for each sample.
_NONE, _ATTITUDE, _GYRO = Mode.NONE, Mode.ATTITUDE, Mode.GYRO


class DeadReckoning(NamedTuple):
    """Source that propagates the heading, and the angle turned so far.

    Parameters
    ----------
    t_ns
        Time to which the filter's state is propagated; None before any sample.
    mode
        Source that propagates the heading.
    rate_rad_s
        Level yaw rate, at ``t_gyro_ns`` or over the last attitude interval.
    theta_rad
        Dead-reckoned heading: the sum of all yaw increments since the start, without corrections by frames.
    raw_theta_rad
        The same without subtracting the bias.
    t_gyro_ns, gyro_rad_s
        Last gyroscope sample.
    gyro_done_rad
        Angle already propagated since then.
    yaw_rad
        Yaw of the last attitude sample.
    yaw_done_rad
        Angle already propagated since then.
    attitude
        Times of the attitude samples.
    stored_gyro_bias
        Mean and variance of the gyroscope's bias, stored while another mode is active.
    extra_noise
        Squared density of the noise of the source in use beyond the configured one, rad^2/s, as estimated from
        frames.
    seen_theta_rad
        ``theta_rad`` at the last accepted frame.
    """

    t_ns: int | None = None
    mode: Mode = Mode.NONE
    rate_rad_s: float = 0.0
    theta_rad: float = 0.0
    raw_theta_rad: float = 0.0
    t_gyro_ns: int | None = None
    gyro_rad_s: Vector = (0.0, 0.0, 0.0)
    gyro_done_rad: float = 0.0
    yaw_rad: float = nan
    yaw_done_rad: float = 0.0
    attitude: SampleTimes = SampleTimes()
    stored_gyro_bias: tuple[float, float] = (0.0, 0.02**2)
    extra_noise: float = 0.0
    seen_theta_rad: float = 0.0

    def yaw_rate(self, bias_rad_s: float) -> float:
        """Level yaw rate minus the filter's bias, rad/s."""
        return -bias_rad_s if self.mode is Mode.NONE else self.rate_rad_s - bias_rad_s

    def gyro_silence(self, t_ns: int, config: FusionConfig) -> str:
        """Report a gyroscope that has fallen silent; empty if it has not."""
        return "gyroscope is silent" if seconds_since(t_ns, self.t_gyro_ns) > config.gyro_gap_s else ""

    def attitude_silence(self, t_ns: int, config: FusionConfig) -> str:
        """Report an attitude stream that has fallen silent; empty if it has not."""
        return "attitude is silent" if self.attitude.is_silent(t_ns, config) else ""


def with_vision(d: DeadReckoning) -> DeadReckoning:
    """Count the turn from here on: a frame was accepted, or the heading was set."""
    return d._replace(seen_theta_rad=d.theta_rad)


def yaw_at(reckoning: DeadReckoning, t_ns: int) -> float:
    """Return the IMU's yaw propagated from its last sample, rad; NaN if that is too old."""
    fresh = reckoning.attitude.age_s(t_ns) <= MAX_YAW_AGE_S
    return reckoning.yaw_rad + reckoning.yaw_done_rad if fresh else nan


class Propagation:
    """Propagates the filter and the dead-reckoned heading.

    Parameters
    ----------
    config
        Settings.
    """

    def __init__(self, config: FusionConfig) -> None:
        self.config = config
        self.grace_ns = round(config.gyro_gap_s * 1e9)
        self.noise = {mode: _noise(mode, config) for mode in Mode}
        self.scale_variance = config.gyro_scale_std**2

    def mean_gyro(self, d: DeadReckoning, sample: ImuSample) -> Vector:
        """Return the mean rate since the last sample; the newest rate if the last one is too old."""
        if d.t_gyro_ns is None or sample.t_ns - d.t_gyro_ns > self.grace_ns:
            return sample.gyro_rad_s
        p, q, r = d.gyro_rad_s
        new_p, new_q, new_r = sample.gyro_rad_s
        return 0.5 * (p + new_p), 0.5 * (q + new_q), 0.5 * (r + new_r)

    def with_gyro(
        self, d: DeadReckoning, ekf: CorridorEKF, sample: ImuSample, rate_rad_s: float
    ) -> DeadReckoning:
        """Propagate to a gyroscope sample.

        Parameters
        ----------
        d
            Part of the state.
        ekf
            Filter to propagate.
        sample
            The sample.
        rate_rad_s
            Its level yaw rate.
        """
        t_ns: int | None = sample.t_ns
        turned = corrected = 0.0
        if d.mode is _GYRO:
            turned, corrected = self._turn(d, ekf, sample.t_ns, rate_rad_s)
        else:
            d = self._with_mode(self.advance(d, ekf, sample.t_ns), ekf, Mode.GYRO)
            t_ns = d.t_ns
        _, mode, _, theta, raw_theta, _, _, _, yaw, yaw_done, *kept = d
        theta, raw_theta, yaw_done = theta + corrected, raw_theta + turned, yaw_done + corrected
        gyro_ns, gyro, _ = sample
        new = (t_ns, mode, rate_rad_s, theta, raw_theta, gyro_ns, gyro, 0.0, yaw, yaw_done, *kept)
        return new_record(DeadReckoning, new)

    def with_attitude_yaw(
        self, d: DeadReckoning, ekf: CorridorEKF, t_ns: int, yaw_rad: float
    ) -> DeadReckoning:
        """Propagate to an attitude sample; its yaw increment propagates the heading if no gyroscope does.

        Parameters
        ----------
        d
            Part of the state.
        ekf
            Filter to propagate.
        t_ns, yaw_rad
            The sample's time and yaw.
        """
        d = self._leave_silent_gyro(d, ekf, t_ns)
        rate = d.rate_rad_s
        if d.mode is _ATTITUDE and d.attitude.last_ns is not None:
            increment = wrap(yaw_rad - d.yaw_rad)
            span_s = (t_ns - d.attitude.last_ns) * 1e-9
            d = self.advance(d, ekf, t_ns, wrap(increment - d.yaw_done_rad))
            if span_s > 0:
                rate = increment / span_s
        else:
            d = self.advance(d, ekf, t_ns)
        end_ns, mode, _, theta, raw_theta, t_gyro, gyro, gyro_done, _, _, attitude, *rest = d
        kept = (attitude.with_sample(t_ns), *rest)
        new = (end_ns, mode, rate, theta, raw_theta, t_gyro, gyro, gyro_done, yaw_rad, 0.0, *kept)
        d = new_record(DeadReckoning, new)
        return self._with_mode(d, ekf, Mode.ATTITUDE) if d.mode is _NONE else d

    def hold(self, d: DeadReckoning, ekf: CorridorEKF, t_ns: int) -> DeadReckoning:
        """Propagate to a time without a gyroscope or attitude sample."""
        d = self._leave_silent_gyro(d, ekf, t_ns)
        if d.mode is Mode.ATTITUDE and not self._attitude_is_recent(d, t_ns):
            d = self._with_mode(d, ekf, Mode.NONE)
        return self.advance(d, ekf, t_ns)

    def advance(
        self, d: DeadReckoning, ekf: CorridorEKF, t_ns: int, turned_rad: float | None = None
    ) -> DeadReckoning:
        """Propagate to a time in the present mode.

        Parameters
        ----------
        d
            Part of the state.
        ekf
            Filter to propagate.
        t_ns
            End of the step.
        turned_rad
            The attitude's yaw increment less the part propagated already. None: the last rate is held; the next
            sample corrects the difference.
        """
        if d.t_ns is None:
            return d._replace(t_ns=t_ns)
        if t_ns <= d.t_ns and turned_rad is None:
            return d
        turned, corrected = self._move(d, ekf, t_ns, turned_rad)
        (
            _,
            mode,
            rate,
            theta,
            raw_theta,
            t_gyro,
            gyro,
            gyro_done,
            yaw,
            yaw_done,
            *kept,
        ) = d
        moved = (theta + corrected, raw_theta + turned, t_gyro, gyro, gyro_done + turned, yaw)
        yaw_done += turned if mode is _ATTITUDE else corrected
        return new_record(DeadReckoning, (t_ns, mode, rate, *moved, yaw_done, *kept))

    def _turn(
        self, d: DeadReckoning, ekf: CorridorEKF, t_ns: int, end_rate_rad_s: float
    ) -> tuple[float, float]:
        """Propagate to a gyroscope sample by the trapezoid rule, in `Mode.GYRO`; returns the same as `_move`.

        ``end_rate_rad_s`` is the sample's level yaw rate.
        """
        start_ns, mode, rate, _, _, gyro_ns, _, done, _, _, _, _, extra_noise, _ = d
        dt_s = 0.0 if start_ns is None else (t_ns - start_ns) * 1e-9
        turned = variance = 0.0
        if gyro_ns is not None:
            turned = 0.5 * (rate + end_rate_rad_s) * (t_ns - gyro_ns) * 1e-9 - done
            if t_ns - gyro_ns > self.grace_ns:
                variance = 0.25 * self._silence_variance(d, ekf, t_ns)  # the rate is known at both ends
        corrected = turned - ekf.x.item(BIAS) * dt_s
        variance += self._scale_variance(d, corrected, dt_s) + extra_noise * dt_s
        ekf.advance(dt_s, turned, self.noise[mode], variance)
        return turned, corrected

    def _move(
        self, d: DeadReckoning, ekf: CorridorEKF, t_ns: int, turned_rad: float | None
    ) -> tuple[float, float]:
        """Propagate the filter to a time; return the angle turned, and the same minus the gyroscope's bias.

        ``turned_rad`` is as in `advance`.
        """
        start_ns = t_ns if d.t_ns is None else d.t_ns
        dt_s = (t_ns - start_ns) * 1e-9
        variance = 0.0
        mode = d.mode
        if mode is _NONE:
            turned_rad = 0.0
        elif turned_rad is None:
            turned_rad = d.rate_rad_s * dt_s
            if mode is _GYRO:
                variance = self._silence_variance(d, ekf, t_ns)
        bias_turn = float(ekf.x[BIAS]) * dt_s
        if mode is _GYRO:
            variance += self._scale_variance(d, turned_rad - bias_turn, dt_s)
        variance += d.extra_noise * dt_s
        ekf.advance(dt_s, turned_rad, self.noise[mode], variance)
        return turned_rad, turned_rad - bias_turn

    def _leave_silent_gyro(self, d: DeadReckoning, ekf: CorridorEKF, t_ns: int) -> DeadReckoning:
        """Change to the attitude's yaw, or to a constant rate, if the gyroscope has fallen silent."""
        silent = d.t_gyro_ns is not None and t_ns - d.t_gyro_ns > self.grace_ns
        if d.mode is _GYRO and silent:
            return self._with_mode(d, ekf, Mode.ATTITUDE if self._attitude_is_recent(d, t_ns) else Mode.NONE)
        return d

    def _attitude_is_recent(self, d: DeadReckoning, t_ns: int) -> bool:
        return d.attitude.age_s(t_ns) <= max(ATTITUDE_GAP_S, d.attitude.age_limit_s(self.config))

    def held_rate_variance(self, d: DeadReckoning, t_ns: int) -> float:
        """Return the variance of the heading at ``t_ns`` from holding the last rate or yaw until then."""
        last = d.t_gyro_ns if d.mode is Mode.GYRO else d.attitude.last_ns
        if d.mode is Mode.NONE or last is None:
            return 0.0
        age_s = min((t_ns - last) * 1e-9, 0.5)
        variance = self.config.yaw_acceleration_density**2 * age_s**3 / 3.0
        return variance + (self.config.imu_yaw_std_rad**2 if d.mode is Mode.ATTITUDE else 0.0)

    def ahead(self, d: DeadReckoning, ekf: CorridorEKF, t_ns: int) -> DeadReckoning:
        """Predict to a time later than the last sample in the present mode; not a state to continue from."""
        dt_s = 0.0 if d.t_ns is None else (t_ns - d.t_ns) * 1e-9
        turned = 0.0 if d.mode is Mode.NONE else d.rate_rad_s * dt_s
        variance = self.held_rate_variance(d, t_ns)
        if d.mode is Mode.GYRO:
            corrected = turned - float(ekf.x[BIAS]) * dt_s
            variance += self._scale_variance(d, corrected, dt_s)
        variance += d.extra_noise * dt_s
        ekf.advance(dt_s, turned, self.noise[d.mode], variance)
        return d._replace(t_ns=t_ns)

    def clock_set_back(self, d: DeadReckoning, ekf: CorridorEKF, t_ns: int) -> DeadReckoning:
        """Continue at an earlier time, without a gyroscope or attitude sample so far."""
        attitude = d.attitude.clock_set_back()
        return self._with_mode(d._replace(t_ns=t_ns, t_gyro_ns=None, attitude=attitude), ekf, Mode.NONE)

    def _scale_variance(self, d: DeadReckoning, turned_rad: float, dt_s: float) -> float:
        """Return the heading variance that the gyroscope's scale error adds in a step."""
        if not dt_s > 0.0:
            return 0.0
        walk = self.scale_variance * SCALE_TIME_S * turned_rad * turned_rad / dt_s
        before_rad = d.theta_rad - d.seen_theta_rad
        if abs(before_rad) <= LONG_TURN_RAD:
            return walk
        # (before + turned)^2 - before^2
        constant = self.scale_variance * turned_rad * (2.0 * before_rad + turned_rad)
        return max(walk, constant)

    def _silence_variance(self, d: DeadReckoning, ekf: CorridorEKF, end_ns: int) -> float:
        """Return the heading variance from a gap in the gyroscope's samples, up to a time."""
        if d.t_gyro_ns is None or d.t_ns is None or end_ns - d.t_gyro_ns <= self.grace_ns:
            return 0.0
        grace = self.config.gyro_gap_s
        first = max((d.t_ns - d.t_gyro_ns) * 1e-9 - grace, 0.0)
        last = max((end_ns - d.t_gyro_ns) * 1e-9 - grace, 0.0)
        # The rate is a random walk from its last sample on.
        variance = self.config.yaw_acceleration_density**2 * (last**3 - first**3) / 3.0
        known = float(ekf.P[PSI, PSI])
        return max(min(variance, 2.0 * UNKNOWN_HEADING_STD_RAD**2 - known), 0.0)

    def _with_mode(self, d: DeadReckoning, ekf: CorridorEKF, mode: Mode) -> DeadReckoning:
        """Change the source that propagates the heading; the bias state then has another meaning and is reset."""
        if mode is d.mode:
            return d
        bias, variance = float(ekf.x[BIAS]), float(ekf.P[BIAS, BIAS])
        stored = (bias, variance) if d.mode is Mode.GYRO else d.stored_gyro_bias
        if mode is Mode.GYRO:
            new, new_variance = stored
        elif mode is Mode.ATTITUDE:
            new, new_variance = 0.0, ATTITUDE_DRIFT_STD_RAD_S**2
        else:
            new, new_variance = bias - d.rate_rad_s, HELD_RATE_STD_RAD_S**2
        x = ekf.x.copy()
        x[BIAS] = new
        F = np.eye(N_STATES)
        F[BIAS, BIAS] = 0.0
        Q = np.zeros((N_STATES, N_STATES))
        Q[BIAS, BIAS] = new_variance
        ekf.predict(x, F, Q)
        return d._replace(mode=mode, stored_gyro_bias=stored, extra_noise=0.0)


def _noise(mode: Mode, c: FusionConfig) -> ProcessNoise:
    walk = c.offset_walk
    if mode is Mode.GYRO:
        return ProcessNoise(c.gyro_noise, c.bias_walk, walk)
    if mode is Mode.ATTITUDE:
        return ProcessNoise(walk, c.bias_walk, walk)
    return ProcessNoise(1e-4, c.yaw_acceleration_density, walk)
