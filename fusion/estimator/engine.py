"""One step of the estimator: takes a state and the next sample in order of time, returns the next state.

The engine holds no history: its result depends only on state and sample. For each kind of sample it calls the parts
in a fixed order: propagation, then the measurement update. Each part has a module of its own and owns a field of
`fusion.estimator.state.State`. All of them update one extended Kalman filter, `fusion.estimator.ekf.CorridorEKF`,
with the state and models of `fusion.estimator.models`. `fusion.estimator.timeline` sorts the samples.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, assert_never

import numpy as np

from fusion.estimator import tilt as tilts
from fusion.estimator.camera_delay import (
    Delay,
    initial_delay,
    with_turns,
)
from fusion.estimator.config import FusionConfig
from fusion.estimator.corridor_axis import CorridorAxis
from fusion.estimator.ekf import CorridorEKF
from fusion.estimator.frame_fusion import FrameFusion
from fusion.estimator.frame_update import FrameResult, FrameSample
from fusion.estimator.gyro_checks import (
    GOOD,
    GyroVerdict,
    clipped_variance,
    rate_that_bridges,
    with_sample,
)
from fusion.estimator.gyro_run import GyroRun, leading_good
from fusion.estimator.gyro_run_kernel import compile_gyro_run
from fusion.estimator.imu_yaw import (
    UNKNOWN_YAW_OFFSET_STD_RAD,
    AttitudeSample,
    fuse_imu_yaw,
    yaw_updates,
)
from fusion.estimator.lateral.gaussian_sum import OffsetModel
from fusion.estimator.lateral.status import Lateral
from fusion.estimator.lateral.updates import LateralOffset, MotionStep, offset_model
from fusion.estimator.models import (
    N_STATES,
    PSI,
    YAW_OFFSET,
    Vector,
    level_yaw_rate,
)
from fusion.estimator.propagation import (
    UNKNOWN_HEADING_STD_RAD,
    DeadReckoning,
    ImuSample,
    Mode,
    Propagation,
    with_vision,
)
from fusion.estimator.range_width import RangeSample
from fusion.estimator.records import new_record
from fusion.estimator.sample_times import SampleTimes
from fusion.estimator.seed import HeadingSeed, WidthChange, seed_heading
from fusion.estimator.sensing import GoodSamples, compile_sensing, sense
from fusion.estimator.state import Checks, Entry, Sample, Sensed, State, sensed_after
from fusion.estimator.velocity import VelocitySample, with_velocity
from vision.rotations import wrap, yaw_of_quaternion

if TYPE_CHECKING:
    from fusion.estimator.filterpy_ekf import FilterpyEKF


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
        self.frame_fusion = FrameFusion(config, self._propagation, self._lateral)
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
                state, frame = self._frame(state, sample)
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
        seen_ns = s.axis.t_vision_ns
        with_offset = s.frames.begins_period(sample.t_ns, self.config.lateral_rate_hz)
        s = self._propagated_to(s, sample.t_ns, s.frames.with_sample(sample.t_ns))
        s, result = self.frame_fusion.fused(s, self.ekf, sample, with_offset)
        if s.axis.t_vision_ns != seen_ns:
            s = s._replace(reckoning=with_vision(s.reckoning))
        return s, result

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
