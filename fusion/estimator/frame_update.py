"""The engine's last part: what a frame does to the state.

A frame is measured with what the filter expects, gated, and taken in; with it the lateral offset, the corridor's
width and the elevation of the camera. What the gate rejects goes to `fusion.estimator.corridor_axis`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import cos, hypot, isfinite, nan, pi, radians, sin, sqrt
from typing import NamedTuple

from fusion.estimator import tilt as tilts
from fusion.estimator.camera_delay import AxisNoise, Effect, Seen, recent_rate, turned_since, with_frame
from fusion.estimator.corridor_axis import AGREEING_SHARE, CONTESTED_SHARE, VOTE_AGE_S, Axes
from fusion.estimator.ekf import Gate
from fusion.estimator.imu_yaw_check import watch
from fusion.estimator.kernels import spread
from fusion.estimator.models import BIAS, PSI, ScalarMeasurement, Y, heading_model, lateral_model, wrap_axis
from fusion.estimator.noise_adaptation import Trust, as_if_independent, correlation, genuine, learn, weakened
from fusion.estimator.range_width import height_at, with_width
from fusion.estimator.state import (
    UNKNOWN_LATERAL_STD,
    Mode,
    frame_age_limit_s,
    half_width_m,
    next_interval_s,
    seconds_since,
)
from fusion.estimator.votes import Vote, add_vote, agreement
from vision.measurement import Attitude, FrameMeasurement, Prior, Reason

Measure = Callable[[Attitude | None, Prior], FrameMeasurement] | FrameMeasurement
"""What turns attitude and prediction into a frame's measurement; or the measurement itself, made elsewhere."""

GROSS_HEADING_DENSITY = 1 / pi  # a gross heading may be any
GROSS_LATERAL_DENSITY = 0.5  # anywhere between the walls
MAX_YAW_AGE_S = 0.1
LATERAL_START_FRAMES = 3
LATERAL_LOST_STD = 0.5
LATERAL_PRIOR_STD = 0.1
ELEVATION_WEIGHT = 30.0  # errors of successive elevations are those of the attitude: alike for seconds
ELEVATION_FLOOR_RAD = radians(0.25)
WIDTH_MEMORY_FRAMES = 100


@dataclass(frozen=True, slots=True, eq=False)
class FrameResult:
    """What became of a frame.

    Parameters
    ----------
    timestamp_ns
        As stamped, before the camera's delay is taken off.
    measurement
        What vision found; None where there was no picture.
    accepted, reason
        Whether the filter used its heading.
    innovation_rad, test_ratio
        Heading minus prediction, and its square over gate squared; NaN where it was not judged.
    """

    timestamp_ns: int
    measurement: FrameMeasurement | None
    accepted: bool
    reason: Reason
    innovation_rad: float = nan
    test_ratio: float = nan


class _ByDelay(NamedTuple):
    """Derivative of an innovation by the camera's delay, rad/s, and the variance that the delay adds to it."""

    per_s: float
    variance: float


class Engine(Axes):
    """The whole estimator for samples in order of time; `fusion.estimator.timeline` brings them into order."""

    camera_arm_m: tuple[float, float] = (0.0, 0.0)
    """How far the camera sits ahead and right of the body's centre."""

    def frame(self, t_ns: int, stamp_ns: int, measure: Measure | None) -> FrameResult:
        """Take a frame of time ``t_ns``; ``measure`` turns attitude and prediction into its measurement."""
        self._begin(t_ns)
        s = self.state
        self._leave_silent_gyro(t_ns)
        self._advance(t_ns)
        s.frame_interval_s = next_interval_s(s.frame_interval_s, s.t_frame_ns, t_ns)
        s.t_frame_ns = t_ns
        if measure is None:
            result = FrameResult(stamp_ns, None, False, Reason.UNREADABLE)
        else:
            attitude = tilts.attitude_at(s.tilt, t_ns, self.config.attitude_std_rad)
            measurement = self._look(measure, attitude)
            reason = self._check(measurement)
            if reason is Reason.OK:
                result = self._use(t_ns, stamp_ns, measurement, attitude)
            else:
                result = FrameResult(stamp_ns, measurement, False, reason)
        self._end()
        return result

    def prior(self) -> Prior:
        """Return what the filter expects of a frame now, as a frame would see it."""
        s = self.state
        psi = float(self.ekf.x[PSI]) - self._turned_since_exposure(self._now_ns)
        elevation, variance = s.elevation
        p, q, r = s.gyro
        offset = offset_std = nan
        age_s = seconds_since(self._now_ns, s.t_lateral_ns)
        if s.lateral_acquired and age_s <= frame_age_limit_s(s, self.config):
            # Wider than it is: were vision silent wherever the filter is wrong, nothing could set the filter right.
            offset = (1 if cos(psi) >= 0 else -1) * float(self.ekf.x[Y]) + self._camera_aside(wrap_axis(psi))
            offset_std = hypot(sqrt(float(self.ekf.P[Y, Y])), LATERAL_PRIOR_STD)
        return Prior(
            heading_rad=wrap_axis(psi) if s.acquired else nan,
            heading_std_rad=sqrt(float(self.ekf.P[PSI, PSI])) if s.acquired else nan,
            lateral_offset_norm=offset,
            lateral_offset_norm_std=offset_std,
            width_per_height=s.width_per_height,
            elevation_rad=elevation,
            elevation_std_rad=max(sqrt(variance), ELEVATION_FLOOR_RAD),
            body_rate_rad_s=sqrt(p * p + q * q + r * r) if s.mode is Mode.GYRO else nan,
        )

    def _look(self, measure: Measure, attitude: Attitude | None) -> FrameMeasurement:
        """Measure a frame with the prediction, and, where that does not settle it, without.

        With the prediction, vision prefers an axis near it to one along the view, so strong lines across can win. And
        turned away from the axis, the prediction must not choose at all: walls and fittings at a junction run along
        the old corridor too, and would hide the new one; there the best direction counts, if only as a vote.
        """
        if isinstance(measure, FrameMeasurement):
            return measure
        prior = self.prior()
        expected = measure(attitude, prior)
        if not self.state.acquired:
            return expected
        turned = abs(prior.heading_rad) > self.config.junction_min_turn_rad
        if not turned and self._is_near(expected):
            return expected
        free = measure(attitude, replace(prior, heading_rad=nan, heading_std_rad=nan))
        if self._check(free) is not Reason.OK:
            return expected
        return expected if self._is_near(expected) and self._is_near(free) else free

    def _is_near(self, m: FrameMeasurement) -> bool:
        """Whether a measurement is of the present axis rather than of another."""
        distance = abs(wrap_axis(m.heading_rad - float(self.ekf.x[PSI])))
        return self._check(m) is Reason.OK and distance <= self.config.junction_min_turn_rad

    def _check(self, m: FrameMeasurement) -> Reason:
        """Reason to turn a measurement down before the filter looks at it."""
        if not m.accepted:
            return m.reason if m.reason is not Reason.OK else Reason.UNCERTAIN
        if m.n_inliers < self.config.min_lines:
            return Reason.TOO_FEW_LINES
        if not (isfinite(m.heading_rad) and 0.0 < m.heading_std_rad < pi):  # NaN fails too
            return Reason.UNCERTAIN
        return Reason.OK

    def _use(self, t_ns: int, stamp_ns: int, m: FrameMeasurement, attitude: Attitude | None) -> FrameResult:
        s, c = self.state, self.config
        if s.acquired and float(self.ekf.P[PSI, PSI]) > c.lost_heading_std_rad**2:
            s.acquired, s.votes = False, ()
        variance = max(m.heading_std_rad, c.heading_std_floor_rad) ** 2 + self.held_rate_variance(t_ns)
        heading = m.heading_rad + self._turned_since_exposure(t_ns)
        axis = s.theta_rad - heading
        if not s.acquired:
            self._vote(t_ns, axis, sqrt(variance), False)
            started = self._start(t_ns)
            self._see(t_ns, heading, started)
            if started:
                self._learn(t_ns, m, attitude)
            return FrameResult(stamp_ns, m, True, Reason.OK)
        rho = correlation(t_ns, s.t_vision_ns, c.heading_correlation_s)
        measurement = heading_model(self.ekf.x, heading, variance)
        by_delay = self._innovation_by_delay(t_ns)
        gate, s.heading_trust = self._take(
            measurement, c.heading_gate_sigma, rho, s.heading_trust, GROSS_HEADING_DENSITY, by_delay.variance
        )
        s.heading_ratio = gate.test_ratio
        linked = self._see(t_ns, heading, gate.accepted)
        if gate.accepted:
            self._learn_delay(t_ns, m.heading_rad, variance, by_delay.per_s)
            self._confirm(t_ns)
            self._learn(t_ns, m, attitude)
            self._watch_imu_yaw(t_ns, heading, variance)
            return FrameResult(stamp_ns, m, True, Reason.OK, gate.residual, gate.test_ratio)
        self._vote(t_ns, axis, sqrt(variance), linked)
        self._consider(t_ns)
        return FrameResult(stamp_ns, m, False, Reason.GATE, gate.residual, gate.test_ratio)

    def _turned_since_exposure(self, t_ns: int) -> float:
        """Angle turned in the time by which a frame is estimated to be later than configured."""
        s = self.state
        if s.delay is None:
            return 0.0
        return turned_since(s.delay, t_ns, s.raw_theta_rad) - float(self.ekf.x[BIAS]) * s.delay.late_s

    def _innovation_by_delay(self, t_ns: int) -> _ByDelay:
        """How an error of the camera's delay shows in the next innovation of the heading."""
        s = self.state
        if s.delay is None:
            return _ByDelay(0.0, 0.0)
        rate = recent_rate(s.delay, t_ns, s.raw_theta_rad) - float(self.ekf.x[BIAS])
        effect = s.delay.effect
        if effect is None or effect.epoch != s.reset_count:  # the heading is that of a few frames
            s.delay = s.delay._replace(effect=Effect(t_ns, -rate, 0.0, s.reset_count))
        delay, per_s = s.delay, -rate - s.delay.heading_per_s(t_ns)
        return _ByDelay(per_s, per_s**2 * delay.variance)

    def _learn_delay(self, t_ns: int, heading_rad: float, variance: float, innovation_per_s: float) -> None:
        """Let an accepted frame tell of the camera's delay, too."""
        s, c = self.state, self.config
        if s.delay is None or s.delay.effect is None or s.mode is not Mode.GYRO:
            return
        heading_per_s = s.delay.heading_per_s(t_ns) + float(self.ekf.K[PSI]) * innovation_per_s
        bias_per_s = s.delay.effect.bias_per_s + float(self.ekf.K[BIAS]) * innovation_per_s
        seen = Seen(t_ns, heading_rad, variance * s.heading_trust.inflation, s.reset_count)
        before_s = s.delay.late_s
        known = AxisNoise(c.gyro_noise, c.gyro_bias_std_rad_s, c.bias_walk, c.heading_correlation_s)
        s.delay = with_frame(s.delay, seen, known)._replace(
            effect=Effect(t_ns, heading_per_s, bias_per_s, s.reset_count)
        )
        x = self.ekf.x.copy()  # what frames have done to the heading with the delay as it was thought to be
        x[PSI] -= heading_per_s * (s.delay.late_s - before_s)
        x[BIAS] -= bias_per_s * (s.delay.late_s - before_s)
        self.ekf.x = x

    def _take(
        self,
        m: ScalarMeasurement,
        gate_sigma: float,
        rho: float,
        trust: Trust,
        gross_density: float,
        more_variance: float = 0.0,
    ) -> tuple[Gate, Trust]:
        """Update with a measurement that may be gross, whose sigma may be wrong and whose error resembles the last.

        The gate judges it by its own variance; the update takes the larger one that, as if independent, stands for
        the correlation ``rho`` with the one before, and weakens it by the odds that it is genuine. ``more_variance``
        is what the innovation has besides, of which neither state nor measurement knows.
        """
        predicted = spread(self.ekf.P, m.H) + more_variance
        stated, believed = m.R, m.R * trust.inflation
        probability = genuine(m.residual, predicted + believed, trust.gross_share, gross_density)
        variance = weakened(as_if_independent(believed, predicted, rho), predicted, probability)
        gate = self.ekf.update(m._replace(R=believed + more_variance), gate_sigma, variance)
        return gate, learn(trust, m.residual, predicted, stated, probability if gate.accepted else 0.0)

    def _watch_imu_yaw(self, t_ns: int, heading_rad: float, variance: float) -> None:
        """Compare gyroscope and IMU yaw by a frame, where an attitude sample is near."""
        s = self.state
        if s.mode is Mode.GYRO and seconds_since(t_ns, s.t_attitude_ns) <= MAX_YAW_AGE_S:
            yaw_now = s.yaw_rad + s.yaw_done_rad
            s.yaw_watch = watch(s.yaw_watch, t_ns, heading_rad - s.theta_rad, heading_rad - yaw_now, variance)

    def _learn(self, t_ns: int, m: FrameMeasurement, attitude: Attitude | None) -> None:
        """Use the rest of a frame whose heading was accepted: lateral offset, width, elevation of the camera."""
        s = self.state
        if isfinite(m.lateral_offset_norm) and 0.0 < m.lateral_offset_norm_std < 10.0:
            offset_norm = m.lateral_offset_norm - self._camera_aside(m.heading_rad)
            self._use_lateral(t_ns, offset_norm, m.lateral_offset_norm_std)
        if isfinite(m.width_per_height) and m.width_per_height > 0.0:
            s.n_width = min(s.n_width + 1, WIDTH_MEMORY_FRAMES)
            old = s.width_per_height if s.n_width > 1 else m.width_per_height
            change = max(-0.2 * old, min(0.2 * old, m.width_per_height - old))
            s.width_per_height = old + change / s.n_width
            s.widths = with_width(s.widths, t_ns, m.width_per_height * height_at(s.heights, t_ns))
        if isfinite(m.elevation_rad) and m.elevation_std_rad > 0.0 and attitude is not None:
            mean, variance = s.elevation
            R = ELEVATION_WEIGHT * hypot(m.elevation_std_rad, attitude.std_rad) ** 2
            gain = variance / (variance + R)
            s.elevation = (mean + gain * (m.elevation_rad - mean), (1.0 - gain) * variance)

    def _camera_aside(self, heading_rad: float) -> float:
        """Half widths by which a camera ahead of the body's centre swings to the right; 0 while no width is known."""
        half_m = half_width_m(self.state, self.config)
        if not half_m > 0.0:  # NaN fails too
            return 0.0
        ahead_m, right_m = self.camera_arm_m
        return (ahead_m * sin(heading_rad) + right_m * cos(heading_rad)) / half_m

    def _use_lateral(self, t_ns: int, offset_norm: float, std: float) -> None:
        """Gate a lateral offset; as with headings, what is rejected may win by agreeing."""
        s, c = self.state, self.config
        variance = max(std, c.lateral_std_floor_norm) ** 2
        if s.lateral_acquired and float(self.ekf.P[Y, Y]) > LATERAL_LOST_STD**2:
            self._lose_lateral()
        measurement = lateral_model(self.ekf.x, offset_norm, variance)
        if s.lateral_acquired:
            rho = correlation(t_ns, s.t_lateral_ns, c.lateral_correlation_s)
            gate, s.lateral_trust = self._take(
                measurement, c.lateral_gate_sigma, rho, s.lateral_trust, GROSS_LATERAL_DENSITY
            )
            s.lateral_ratio = gate.test_ratio
            if gate.accepted:
                s.t_lateral_ns, s.n_lateral = t_ns, s.n_lateral + 1
                return
        side = float(measurement.H[Y])
        vote = Vote(t_ns, side * measurement.residual, sqrt(variance), s.n_lateral)
        s.lateral_votes = add_vote(s.lateral_votes, vote, VOTE_AGE_S)
        found = agreement(s.lateral_votes, c.lateral_recovery_spread_norm)
        needed = c.recovery_frames if s.lateral_acquired else min(LATERAL_START_FRAMES, c.start_frames)
        if found is None or found.n_votes < needed or found.share < AGREEING_SHARE:
            return
        if s.n_lateral - found.n_accepted > CONTESTED_SHARE * found.n_votes:
            return
        self._widen(Y, found.value**2 if s.lateral_acquired else UNKNOWN_LATERAL_STD**2)
        value = offset_norm + side * (found.value - side * measurement.residual)
        half_m = half_width_m(s, c)
        before = float(self.ekf.x[Y])
        before, before_m = (before, before * half_m) if s.lateral_acquired else s.lateral_left
        self.ekf.update(lateral_model(self.ekf.x, value, found.std**2))
        if isfinite(before):  # known before: a step, not the start
            after = float(self.ekf.x[Y])
            s.lateral_reset_count += 1
            s.lateral_reset = (after - before, after * half_m - before_m)
        s.lateral_acquired, s.lateral_votes = True, ()
        s.t_lateral_ns, s.n_lateral = t_ns, s.n_lateral + 1
