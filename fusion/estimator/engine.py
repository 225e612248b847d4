"""One step of the estimator: takes a state and the next sample in order of time, returns the next state.

The engine holds no history: its result depends only on state and sample. For each kind of sample it calls the parts
in a fixed order: propagation, then the measurement update. Each part has a module of its own and owns a field of
`fusion.estimator.state.State`. All of them update one extended Kalman filter, `fusion.estimator.ekf.CorridorEKF`,
with the state and models of `fusion.estimator.models`. `fusion.estimator.timeline` sorts the samples.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import hypot, nan, pi, sqrt
from typing import TYPE_CHECKING, assert_never

import numpy as np

from fusion.estimator import junctions
from fusion.estimator import tilt as tilts
from fusion.estimator.attitude_drift import AttitudeDrift
from fusion.estimator.axis_drift import MeasuredHeading, with_diagnosis
from fusion.estimator.camera_delay import (
    Delay,
    DelayedInnovation,
    FrameHeading,
    initial_delay,
    innovation_of,
    learn_delay,
    turned_since_exposure,
    with_axis,
    with_turns,
)
from fusion.estimator.camera_elevation import Elevation
from fusion.estimator.config import FusionConfig
from fusion.estimator.corridor_axis import CorridorAxis, Recovery, recover, start
from fusion.estimator.ekf import CorridorEKF
from fusion.estimator.frame_update import FrameResult, FrameSample, measure_with_prior, reason_to_reject
from fusion.estimator.gyro_checks import (
    GOOD,
    GyroVerdict,
    clipped_variance,
    rate_that_bridges,
    with_sample,
)
from fusion.estimator.gyro_run import GyroRun, leading_good
from fusion.estimator.gyro_run_kernel import compile_gyro_run
from fusion.estimator.hypotheses import Hypothesis
from fusion.estimator.imu_yaw import (
    UNKNOWN_YAW_OFFSET_STD_RAD,
    AttitudeSample,
    compare_by_frame,
    fuse_imu_yaw,
    yaw_updates,
)
from fusion.estimator.lateral.gaussian_sum import OffsetModel
from fusion.estimator.lateral.status import Lateral
from fusion.estimator.lateral.updates import LateralOffset, MotionStep, offset_model
from fusion.estimator.models import (
    BIAS,
    N_STATES,
    PSI,
    YAW_OFFSET,
    Vector,
    heading_model,
    level_yaw_rate,
)
from fusion.estimator.noise_adaptation import ErrorModel, correlation, update_robustly
from fusion.estimator.propagation import (
    UNKNOWN_HEADING_STD_RAD,
    DeadReckoning,
    ImuSample,
    Mode,
    Propagation,
    with_vision,
)
from fusion.estimator.range_width import RangeSample, Width
from fusion.estimator.records import new_record
from fusion.estimator.sample_times import SampleTimes, seconds_since
from fusion.estimator.seed import HeadingSeed, WidthChange, seed_heading
from fusion.estimator.sensing import GoodSamples, compile_sensing, sense
from fusion.estimator.state import Checks, Entry, Sample, Sensed, State, sensed_after
from fusion.estimator.velocity import VelocitySample, with_velocity
from vision.measurement import Attitude, FrameMeasurement, Prior, Reason
from vision.rotations import wrap, wrap_axis, yaw_of_quaternion

if TYPE_CHECKING:
    from fusion.estimator.filterpy_ekf import FilterpyEKF

OUTLIER_DENSITY = 1 / pi  # 1/rad: outlying headings are uniform over half a turn


class Engine:
    """Processes samples in order of time; the result depends only on state and sample.

    Parameters
    ----------
    config
        Settings.
    camera_arm_m
        Position of the camera ahead and right of the body's centre, metres.
    """

    def __init__(self, config: FusionConfig, camera_arm_m: tuple[float, float] = (0.0, 0.0)) -> None:
        self.config = config
        initial = self.initial_state()
        self.ekf: CorridorEKF = CorridorEKF(initial.x, initial.P)
        self._ahead = CorridorEKF(initial.x, initial.P)
        self._propagation = Propagation(config)
        self._lateral = LateralOffset(config, camera_arm_m)
        tilts.compile_tilt()
        compile_sensing()
        compile_gyro_run()

    def initial_state(self) -> State:
        """Return the state before any sample."""
        std = [UNKNOWN_HEADING_STD_RAD, 0.02, UNKNOWN_YAW_OFFSET_STD_RAD]
        reckoning = DeadReckoning(stored_gyro_bias=(0.0, self.config.gyro_bias_std_rad_s**2))
        P = np.diag([s**2 for s in std])
        lateral = Lateral(model=offset_model(self.config))
        return State(np.zeros(N_STATES), P, reckoning, lateral=lateral, delay=initial_delay(self.config))

    def filterpy_ekf(self) -> FilterpyEKF:
        """Return the filter as one of filterpy's class; the engine uses that object from the first call on."""
        from fusion.estimator.filterpy_ekf import FilterpyEKF  # slow and large: load it on demand

        if not isinstance(self.ekf, FilterpyEKF):
            self.ekf = FilterpyEKF(self.ekf)
        return self.ekf

    def offset_model(self, state: State) -> OffsetModel:
        """Return the model parameters of the lateral offset's filter."""
        return self._lateral.model_of(state.lateral)

    def reset_state(self, s: State) -> State:
        """Return the initial state; it continues the reset counts of ``s``."""
        initial, old = self.initial_state(), s.lateral
        axis = CorridorAxis(reset_count=s.axis.reset_count + 1)
        lateral = initial.lateral._replace(last_known=old.last_known, reset_count=old.reset_count)
        return initial._replace(axis=axis, lateral=lateral)

    def predicted(self, s: State, t_ns: int) -> State:
        """Predict a state to a later time without a sample; the filter itself is not changed.

        The heading turns at the last rate; its variance grows by the process noise and by the possible change of the
        rate since it was measured. The lateral offset moves by its rate and the last acceleration.
        """
        if s.t_ns is None or t_ns <= s.t_ns:
            return s
        lateral = self._lateral.propagated(
            s.lateral,
            MotionStep((t_ns - s.t_ns) * 1e-9, float(s.x[PSI]), s.tilt.down, None, s.tilt.follows_force),
        )
        ekf = self._ahead
        ekf.load(s.x, s.P)
        reckoning = self._propagation.ahead(s.reckoning, ekf, t_ns)
        return s._replace(x=ekf.x, P=ekf.P, reckoning=reckoning, lateral=lateral)

    def process(self, state: State, sample: Sample, earlier: tuple[Sensed, Sensed] | None = None) -> Entry:
        """Process the next sample.

        ``earlier``: tilt and gyroscope checks before and after this sample from its first processing. They do not
        depend on frames, so a replay reuses them.
        """
        ekf, frame = self.ekf, None
        ekf.load(state.x, state.P)
        match sample:
            case ImuSample():
                state = self._imu(state, sample, earlier)
            case AttitudeSample():
                state = self._attitude(state, sample, earlier)
            case VelocitySample():
                state = self._velocity(state, sample)
            case RangeSample():
                state = state._replace(width=state.width.with_range(sample, state.tilt.down[2]))
            case FrameSample():
                axis = state.axis
                state, frame = self._frame(state, sample)
                if state.axis.t_vision_ns != axis.t_vision_ns:
                    state = state._replace(reckoning=with_vision(state.reckoning))
            case HeadingSeed():
                state = self._seeded(state, sample)
            case WidthChange():
                state = self._with_set_width(state, sample)
            case _:
                assert_never(sample)
        return Entry(sample.t_ns, sample, state, tuple(ekf.nodes), frame)

    def process_run(self, s: State, samples: Sequence[Sample]) -> GyroRun | None:
        """Process the leading good gyroscope samples and attitudes, in order of time; None if there is none."""
        good = sense(s, samples, self.config, self._propagation.grace_ns)
        return None if good is None else self._run(s, good, sensed_after(s))

    def replay_gyro_samples(self, s: State, entries: Sequence[Entry], before: Sensed) -> int:
        """Replay the leading run of valid gyroscope samples from another state; return its length.

        ``before``: tilt and gyroscope checks before the first of them, from their first processing.
        """
        d, checks = s.reckoning, s.checks
        same = s.tilt is before.tilt and checks.gyro is before.gyro
        if not (same and d.mode is Mode.GYRO and checks.installation.agrees_on_imu(before.installation)):
            return 0
        good = leading_good(entries)
        run = None if good is None else self._run(s, good, before)
        if run is None:
            return 0
        for place in range(run.count):
            entries[place].use_replay(run, place)
        return run.count

    def _run(self, s: State, good: GoodSamples, before: Sensed) -> GyroRun | None:
        """Process good samples from a state in `Mode.GYRO`; the filter is then that after the last of them."""
        yaw = yaw_updates(s.imu_yaw, True, s.axis, self.config)
        run = GyroRun(s, good, before, self._propagation, yaw)
        if run.count == 0:
            return None
        last = run.count - 1
        self.ekf.load(s.x, s.P)
        self.ekf.move_to(run.x[last], run.F[last], run.Q, run.P[last])
        return run

    def clock_set_back(self, s: State, t_ns: int) -> State:
        """Continue after the samples' clock was set back.

        The estimates are kept; the ages of all samples are reset.
        """
        if s.t_ns is None:
            return s
        ekf = self.ekf
        ekf.load(s.x, s.P)
        Q = np.zeros((N_STATES, N_STATES))
        Q[PSI, PSI] = Q[YAW_OFFSET, YAW_OFFSET] = 0.5**2
        ekf.predict(ekf.x, np.eye(N_STATES), Q)
        return s._replace(
            reckoning=self._propagation.clock_set_back(s.reckoning, ekf, t_ns),
            tilt=s.tilt.clock_set_back(t_ns),
            velocity=s.velocity.clock_set_back(),
            width=s.width.clock_set_back(),
            axis=s.axis.clock_set_back(),
            lateral=s.lateral.without_offset(),
            frames=s.frames.clock_set_back(),
            delay=None if s.delay is None else s.delay.interrupted(),
            checks=s.checks.clock_set_back(),
            x=ekf.x,
            P=ekf.P,
        )

    def expected_frame(self, s: State, t_ns: int) -> Prior:
        """Return the predicted measurement of a frame at this time."""
        x, P, d = s.x, s.P, s.reckoning
        psi = float(x[PSI]) - turned_since_exposure(s.delay, float(x[BIAS]), t_ns, d.raw_theta_rad)
        offset = offset_std = nan
        if seconds_since(t_ns, s.lateral.t_ns) <= s.frames.age_limit_s(self.config):
            half_m = s.width.half_m(self.config)
            offset, offset_std = self._lateral.expected(s.lateral, psi, half_m)
        p, q, r = d.gyro_rad_s
        return Prior(
            heading_rad=wrap_axis(psi) if s.axis.acquired else nan,
            heading_std_rad=sqrt(float(P[PSI, PSI])) if s.axis.acquired else nan,
            lateral_offset_norm=offset,
            lateral_offset_norm_std=offset_std,
            width_per_height=s.width.per_height,
            elevation_rad=s.elevation.mean_rad,
            elevation_std_rad=s.elevation.std_rad,
            body_rate_rad_s=sqrt(p * p + q * q + r * r) if d.mode is Mode.GYRO else nan,
            body_rates_rad_s=(p, q, r) if d.mode is Mode.GYRO else None,
        )

    def _imu(self, s: State, sample: ImuSample, earlier: tuple[Sensed, Sensed] | None = None) -> State:
        t_ns = sample.t_ns
        before, repeats, installed = s.checks
        installed = installed.with_imu(t_ns, sample.gyro_rad_s, sample.accel_m_s2, s.tilt.down)
        known = None
        if earlier is not None and earlier[0].tilt is s.tilt and earlier[0].gyro is before:
            known = earlier[1]
        judged = with_sample(before, sample, self.config) if known is None else known.gyro
        checks = new_record(Checks, (judged, repeats, installed))
        if judged.verdict is not GOOD:
            if not judged.is_used:
                return self._propagated_to(s, t_ns, s.frames)._replace(checks=checks)
            if judged.verdict is GyroVerdict.CONFIRMED:
                s = self._with_bridging_rate(s, rate_that_bridges(before, sample))
        if known is None:
            gyro = self._propagation.mean_gyro(s.reckoning, sample)
            tilt = tilts.with_imu(s.tilt, t_ns, gyro, sample.accel_m_s2)
        else:
            tilt = known.tilt
        rate = level_yaw_rate(sample.gyro_rad_s, tilt.down)
        lateral = self._lateral_propagated(s, t_ns, tilt, sample.accel_m_s2)
        d = self._propagation.with_gyro(s.reckoning, self.ekf, sample, rate)
        if judged.clipped_from_ns is not None:
            self.ekf.widen(PSI, clipped_variance(before, judged))
        delay = s.delay
        if delay is not None:
            delay = delay if d.mode is s.reckoning.mode else delay.interrupted()
            delay = with_turns(delay, (t_ns,), (d.raw_theta_rad,))
        x, P = self.ekf.x, self.ekf.P
        return s.moved(x, P, d, lateral, delay, tilt=tilt, imu_yaw=s.imu_yaw, frames=s.frames, checks=checks)

    def _with_bridging_rate(self, s: State, gyro_rad_s: Vector) -> State:
        """Replace the rate at the last gyroscope sample, so that the next trapezoid covers the rejected samples."""
        rate = level_yaw_rate(gyro_rad_s, s.tilt.down)
        return s._replace(reckoning=s.reckoning._replace(gyro_rad_s=gyro_rad_s, rate_rad_s=rate))

    def _attitude(
        self, s: State, sample: AttitudeSample, earlier: tuple[Sensed, Sensed] | None = None
    ) -> State:
        q = sample.unit()
        yaw_rad = yaw_of_quaternion(q)
        lateral = self._lateral_propagated(s, sample.t_ns, s.tilt)
        d = self._propagation.with_attitude_yaw(s.reckoning, self.ekf, sample.t_ns, yaw_rad)
        if earlier is not None and earlier[0].tilt is s.tilt:
            tilt = earlier[1].tilt
        else:
            tilt = tilts.from_quaternion(s.tilt, sample.t_ns, q)
        imu_yaw = fuse_imu_yaw(s.imu_yaw, self.ekf, yaw_rad, d, s.axis, self.config)
        delay = self._delay_in_mode(s, d)
        x, P = self.ekf.x, self.ekf.P
        return s.moved(x, P, d, lateral, delay, tilt=tilt, imu_yaw=imu_yaw, frames=s.frames, checks=s.checks)

    def _velocity(self, s: State, sample: VelocitySample) -> State:
        s = self._propagated_to(s, sample.t_ns, s.frames)
        velocity = with_velocity(s.velocity, sample, s.tilt.down)
        lateral = s.lateral
        if s.axis.acquired:
            lateral = self._lateral.with_velocity(lateral, s.x, s.P, velocity)
        return s._replace(velocity=velocity, lateral=lateral)

    def _seeded(self, s: State, seed: HeadingSeed) -> State:
        s = self._propagated_to(s, seed.t_ns, s.frames)
        turn_rad = abs(wrap(seed.heading_rad - float(self.ekf.x[PSI])))
        if turn_rad > self.config.junction_min_turn_rad:  # facing the other way, or along another corridor
            s = s._replace(lateral=s.lateral.without_offset())
        axis = seed_heading(s.axis, self.ekf, seed, s.reckoning.theta_rad, s.imu_yaw.corrects_heading)
        d, x, P = with_vision(s.reckoning), self.ekf.x, self.ekf.P
        return s._replace(axis=axis, reckoning=d, imu_yaw=s.imu_yaw.axis_changed(), x=x, P=P)

    def _with_set_width(self, s: State, sample: WidthChange) -> State:
        s = self._propagated_to(s, sample.t_ns, s.frames)
        lateral = self._lateral.with_set_width(s.lateral, sample.width_m)
        return s._replace(width=s.width.with_set_width(sample.width_m), lateral=lateral)

    def _frame(self, s: State, sample: FrameSample) -> tuple[State, FrameResult]:
        lateral = s.frames.begins_period(sample.t_ns, self.config.lateral_rate_hz)
        s = self._propagated_to(s, sample.t_ns, s.frames.with_sample(sample.t_ns))
        if sample.measure is None:
            return s, FrameResult(sample.stamp_ns, None, False, Reason.UNREADABLE)
        repeats = s.checks.repeats.with_frame(sample, s.reckoning, s.checks.gyro)
        s = s._replace(checks=s.checks._replace(repeats=repeats))
        if repeats.found:
            m = sample.measure if isinstance(sample.measure, FrameMeasurement) else None
            return s, FrameResult(sample.stamp_ns, m, False, Reason.REPEATED)
        attitude = tilts.attitude_at(s.tilt, sample.t_ns, self.config.attitude_std_rad)
        if isinstance(sample.measure, FrameMeasurement):
            m = sample.measure
        else:
            prior, psi_rad = self.expected_frame(s, sample.t_ns), float(self.ekf.x[PSI])
            m = measure_with_prior(sample.measure, attitude, prior, psi_rad, lateral, self.config)
        s = s._replace(axis=s.axis.with_split_seen(m))
        reason = reason_to_reject(m, self.config)
        if reason is not Reason.OK:
            if s.axis.acquired and not m.accepted and m.offset_evidence:  # relative to the predicted axis
                seen, half_m = s.lateral.with_section_seen(sample.t_ns, m), s.width.half_m(self.config)
                s = s._replace(lateral=self._lateral.fused(seen, self.ekf.x, sample.t_ns, m, half_m))
            return s, FrameResult(sample.stamp_ns, m, False, reason)
        installed = s.checks.installation
        if s.reckoning.mode is Mode.GYRO and s.axis.diagnosis.found is not Hypothesis.SPIKE:
            installed = installed.with_frame(
                sample.t_ns, m.heading_rad, s.reckoning.raw_theta_rad, m.heading_std_rad
            )
        else:
            installed = installed.interrupted()
        s = s._replace(checks=s.checks._replace(installation=installed))
        return self._fuse_heading(s, sample, m, attitude)

    def _lateral_propagated(
        self, s: State, t_ns: int, tilt: tilts.Tilt, accel_m_s2: Vector | None = None
    ) -> Lateral:
        """Return the lateral offset after a propagation step."""
        last_ns = s.reckoning.t_ns
        dt_s = 0.0 if last_ns is None else (t_ns - last_ns) * 1e-9
        step = new_record(MotionStep, (dt_s, self.ekf.x.item(PSI), tilt.down, accel_m_s2, tilt.follows_force))
        return self._lateral.propagated(s.lateral, step)

    def _propagated_to(self, s: State, t_ns: int, frames: SampleTimes) -> State:
        """Propagate to a sample that does not measure the yaw rate; ``frames`` are the frames' times up to it."""
        lateral = self._lateral_propagated(s, t_ns, s.tilt)
        d = self._propagation.hold(s.reckoning, self.ekf, t_ns)
        delay = self._delay_in_mode(s, d)
        x, P = self.ekf.x, self.ekf.P
        return s.moved(
            x, P, d, lateral, delay, tilt=s.tilt, imu_yaw=s.imu_yaw, frames=frames, checks=s.checks
        )

    def _delay_in_mode(self, s: State, d: DeadReckoning) -> Delay | None:
        """Restart the delay's dead reckoning if another source propagates the heading now."""
        if s.delay is None or d.mode is s.reckoning.mode:
            return s.delay
        return s.delay.interrupted()

    def _with_axis_checked(self, s: State, sample: FrameSample) -> State:
        """Drop an axis that is lost, and evidence that gyroscope or frame stamps no longer support."""
        axis, d = s.axis, s.reckoning
        if axis.acquired and float(self.ekf.P[PSI, PSI]) > self.config.lost_heading_std_rad**2:
            axis = axis.lost()
        if axis.stamps_suspect != (sample.stamp_std_s > 0.0):
            axis = axis._replace(stamps_suspect=sample.stamp_std_s > 0.0)
        if d.mode is not Mode.GYRO:  # without a gyroscope the faulty sensor cannot be isolated
            axis = axis._replace(
                diagnosis=axis.diagnosis.restarted(), frame_noise=axis.frame_noise.interrupted()
            )
        if d.mode is not Mode.ATTITUDE and axis.attitude_drift != AttitudeDrift():
            axis = axis._replace(attitude_drift=AttitudeDrift())
        extra_noise = axis.attitude_drift.density
        if d.mode is Mode.GYRO:
            extra_noise = (axis.frame_noise.gyro_scale - 1.0) * self.config.gyro_noise**2
        if extra_noise != d.extra_noise:
            d = d._replace(extra_noise=extra_noise)
        return s if axis is s.axis and d is s.reckoning else s._replace(axis=axis, reckoning=d)

    def _fuse_heading(
        self, s: State, sample: FrameSample, m: FrameMeasurement, attitude: Attitude | None
    ) -> tuple[State, FrameResult]:
        """Update with a frame's heading if it passes the gate, or keep it as a vote for another axis."""
        s = self._with_axis_checked(s, sample)
        c, ekf, t_ns, d, axis = self.config, self.ekf, sample.t_ns, s.reckoning, s.axis
        interval_s = s.frames.interval_s
        variance = max(m.heading_std_rad, c.heading_std_floor_rad) ** 2 + axis.unseen_split_variance(m)
        variance += self._propagation.held_rate_variance(d, t_ns)
        variance += (sample.stamp_std_s * (d.rate_rad_s - float(ekf.x[BIAS]))) ** 2
        heading = m.heading_rad + turned_since_exposure(s.delay, float(ekf.x[BIAS]), t_ns, d.raw_theta_rad)
        if not axis.acquired:
            s = self._acquire(s, t_ns, m, attitude, heading, sqrt(variance))
            return s, FrameResult(sample.stamp_ns, m, True, Reason.OK)
        scale, correlation_s = axis.scale_and_correlation(d.mode, c)
        rho = correlation(t_ns, axis.t_vision_ns, correlation_s)
        measurement = heading_model(ekf.x, heading, variance)
        delay, by_delay = s.delay, DelayedInnovation(0.0, 0.0)
        if delay is not None:
            delay = with_axis(delay, ekf, t_ns, d.raw_theta_rad, axis.reset_count)
            by_delay = innovation_of(delay, ekf, t_ns, d.raw_theta_rad)
        error_model = ErrorModel(
            axis.gate_sigma(c, t_ns, d.theta_rad - float(ekf.x[PSI]), float(ekf.P[PSI, PSI]) + variance),
            rho,
            OUTLIER_DENSITY,
            extra_variance=by_delay.variance,
            scale=scale,
            rejected_share=axis.diagnosis.rejected_share,
        )
        gate, noise = update_robustly(ekf, measurement, axis.noise, error_model)
        axis = axis._replace(noise=noise, gate=gate)
        axis = axis.with_seen_heading(
            t_ns, heading, sqrt(variance), d, gate.accepted, interval_s, c.imu_yaw_std_rad
        )
        result = (gate.residual, gate.test_ratio)
        if d.mode is Mode.GYRO:
            clipped_ns = s.checks.gyro.clipped_ns
            seen = MeasuredHeading(t_ns, heading, variance, rho, interval_s, sample.stamp_std_s, clipped_ns)
            axis, followed = with_diagnosis(axis, ekf, d, seen, s.imu_yaw.corrects_heading, c)
            if followed is not None:
                s = s._replace(axis=followed, delay=delay, x=ekf.x, P=ekf.P)
                return s, FrameResult(sample.stamp_ns, m, True, Reason.OK, *result)
        if not gate.accepted:
            vote = (t_ns, d.theta_rad - heading, sqrt(variance))
            axis = axis.with_vote(*vote, axis.recent[-1].linked, interval_s)
            s = self._follow_votes(s._replace(axis=axis, delay=delay), t_ns)
            return s, FrameResult(sample.stamp_ns, m, False, Reason.GATE, *result)
        if delay is not None and d.mode is Mode.GYRO:
            at_delay = FrameHeading(t_ns, m.heading_rad, variance * scale, axis.reset_count)
            delay = learn_delay(delay, ekf, at_delay, by_delay.per_s, c)
        imu_yaw = compare_by_frame(s.imu_yaw, t_ns, heading, variance, d)
        axis = axis.with_lasting_error(float(ekf.K[PSI, 0]), m)
        if d.mode is Mode.ATTITUDE:
            axis = axis.with_attitude_drift(ekf, t_ns, rho)
        s = s._replace(axis=axis.confirmed(ekf, t_ns, d.theta_rad), delay=delay, imu_yaw=imu_yaw)
        s = self._with_accepted(s, t_ns, m, attitude)
        return s, FrameResult(sample.stamp_ns, m, True, Reason.OK, *result)

    def _with_accepted(self, s: State, t_ns: int, m: FrameMeasurement, attitude: Attitude | None) -> State:
        """Use the other measurements of an accepted frame, and store the filter's new state."""
        lateral, width, elevation = self._fuse_other_measurements(s, t_ns, m, attitude)
        checks = s.checks
        if attitude is not None:
            std_rad = hypot(m.elevation_std_rad, attitude.std_rad)
            installation = checks.installation.with_elevation(
                t_ns, m.elevation_rad, std_rad, attitude.roll_rad
            )
            checks = checks._replace(installation=installation)
        x, P = self.ekf.x, self.ekf.P
        return s._replace(x=x, P=P, lateral=lateral, width=width, elevation=elevation, checks=checks)

    def _acquire(
        self,
        s: State,
        t_ns: int,
        m: FrameMeasurement,
        attitude: Attitude | None,
        heading_rad: float,
        std_rad: float,
    ) -> State:
        """Add a frame to the search for an axis; if that acquires one, use the frame's other measurements too."""
        ekf, d, interval_s = self.ekf, s.reckoning, s.frames.interval_s
        axis = s.axis.with_vote(t_ns, d.theta_rad - heading_rad, std_rad, False, interval_s)
        axis = start(axis, ekf, t_ns, d.theta_rad, s.imu_yaw.corrects_heading, self.config, d.mode)
        axis = axis.with_seen_heading(
            t_ns, heading_rad, std_rad, d, axis.acquired, interval_s, self.config.imu_yaw_std_rad
        )
        axis = axis.with_lasting_error(1.0, m)
        s = s._replace(axis=axis)
        if not axis.acquired:
            return s
        lateral, width, elevation = self._fuse_other_measurements(s, t_ns, m, attitude)
        return s._replace(lateral=lateral, width=width, elevation=elevation, x=ekf.x, P=ekf.P)

    def _fuse_other_measurements(
        self, s: State, t_ns: int, m: FrameMeasurement, attitude: Attitude | None
    ) -> tuple[Lateral, Width, Elevation]:
        """Use an accepted frame's other measurements: lateral offset, corridor width, elevation of the camera."""
        lateral = s.lateral.with_section_seen(t_ns, m)
        another = lateral.section.is_another_seen
        width = s.width if another else s.width.with_frame(t_ns, m.width_per_height)
        lateral = self._lateral.fused(lateral, self.ekf.x, t_ns, m, width.half_m(self.config))
        return lateral, width, s.elevation.with_frame(m, attitude)

    def _follow_votes(self, s: State, t_ns: int) -> State:
        """Recover the heading or enter another corridor if enough votes against the present axis agree."""
        c, ekf, theta_rad = self.config, self.ekf, s.reckoning.theta_rad
        corrects_heading = s.imu_yaw.corrects_heading
        axis, found = junctions.decide(
            s.axis, float(ekf.x[PSI]), sqrt(float(ekf.P[PSI, PSI])), t_ns, theta_rad, s.frames.interval_s, c
        )
        if found is None:
            return s._replace(axis=axis)  # the gate rejected the heading: the filter is unchanged
        imu_yaw = s.imu_yaw.axis_changed()
        if isinstance(found, Recovery):
            axis = recover(axis, ekf, found, t_ns, theta_rad, corrects_heading)
            return s._replace(axis=axis, imu_yaw=imu_yaw, x=ekf.x, P=ekf.P)
        lateral = s.lateral.without_offset()
        crossing = junctions.Crossing(corrects_heading, lateral.n_used)
        axis = junctions.enter_corridor(axis, ekf, found, t_ns, theta_rad, crossing, c)
        width = s.width.corridor_changed()
        return s._replace(axis=axis, imu_yaw=imu_yaw, lateral=lateral, width=width, x=ekf.x, P=ekf.P)
