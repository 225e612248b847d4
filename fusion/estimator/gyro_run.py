"""Consecutive gyroscope samples and attitudes, processed in one compiled call (`fusion.estimator.gyro_run_kernel`).

Tilt and gyroscope checks come first: they do not depend on frames (`fusion.estimator.sensing`). Then heading,
covariance, yaw offset and lateral offset follow. A late frame changes only these, so the samples after it are
replayed with the stored level rates and forces. The full state after a sample is built only on access.

The result is bit-identical to that of `fusion.estimator.engine.Engine.process`.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import takewhile

import numpy as np

from fusion.estimator.camera_delay import Delay, with_turns
from fusion.estimator.gyro_run_kernel import N_PROPAGATED, PATH_S, RATE, RAW_THETA, process_samples
from fusion.estimator.imu_yaw import HEADING_TOO, NOTHING, UNLIKE, ImuYaw, YawUpdates
from fusion.estimator.imu_yaw_check import Trace, find_disturbance, is_due, is_undisturbed, with_trace
from fusion.estimator.installation.checks import Installation
from fusion.estimator.kernels import BIAS, N_STATES, PSI
from fusion.estimator.lateral.gaussian_sum import Acceleration, OffsetState, Path
from fusion.estimator.lateral.status import Lateral
from fusion.estimator.models import FloatArray, Gate
from fusion.estimator.propagation import (
    DeadReckoning,
    ImuSample,
    Mode,
    Propagation,
)
from fusion.estimator.sample_times import SampleTimes
from fusion.estimator.sensing import GoodSamples
from fusion.estimator.smoother import Block, Node
from fusion.estimator.state import Checks, Entry, Sensed, State
from vision.types import IntArray


def leading_good(entries: Sequence[Entry]) -> GoodSamples | None:
    """Return the leading good gyroscope samples of ``entries``; None if the first is not good."""
    if not entries:
        return None
    run, place = entries[0].run, entries[0].place
    if isinstance(run, GyroRun):  # reuse the arrays if the rest of a run follows
        count = run.count - place
        last = entries[count - 1] if count <= len(entries) else None
        if last is not None and last.run is run and last.place == run.count - 1:
            samples, sensed, t_ns, is_gyro, steps = run.good
            rest = slice(place, run.count)
            return GoodSamples(samples[rest], sensed[rest], t_ns[rest], is_gyro[rest], steps[rest])
    good = list(takewhile(lambda entry: entry.sensed.step is not None, entries))
    if not good:
        return None
    return GoodSamples(
        [entry.sample for entry in good],
        [entry.sensed for entry in good],
        np.array([entry.t_ns for entry in good]),
        np.ones(len(good), np.bool_),
        np.array([entry.sensed.step for entry in good]),
    )


class GyroRun:
    """Consecutive samples processed from a state.

    Parameters
    ----------
    start
        The state; a gyroscope propagates its heading.
    good
        The samples.
    before
        Tilt and checks before them, from their first processing.
    propagation
        Source of the noise parameters.
    yaw
        What the updates with the yaws of attitudes have in common.

    Attributes
    ----------
    count
        Number of samples processed; the next one needs `fusion.estimator.engine.Engine.process`.
    x, P, F, x_prior, P_prior, Q
        Steps for the smoother, rows as in `fusion.estimator.smoother.Block`; noise of the last step.
    propagated
        Other values after each sample, see `process_samples`.
    makes_step
        Whether a sample (n,) makes a step.
    """

    def __init__(
        self,
        start: State,
        good: GoodSamples,
        before: Sensed,
        propagation: Propagation,
        yaw: YawUpdates,
    ) -> None:
        self.start, self.good, self.before, self.yaw = start, good, before, yaw
        n = len(good.samples)
        self.x, self.F = np.empty((n, N_STATES)), np.empty((n, N_STATES, N_STATES))
        self.P, self.Q = np.empty_like(self.F), np.empty((N_STATES, N_STATES))
        self.x_prior, self.P_prior = np.empty_like(self.x), np.empty_like(self.P)
        self.propagated, self.makes_step = np.empty((n, N_PROPAGATED)), np.empty(n, np.bool_)
        d = start.reckoning
        assert d.t_ns is not None
        assert d.t_gyro_ns is not None
        unlike = yaw.use == UNLIKE or d.attitude.last_ns is None
        self.count: int = process_samples(
            (good.t_ns, good.is_gyro, good.steps),
            start.x,
            start.P,
            _first_row(start),
            (d.t_ns, d.t_gyro_ns, propagation.grace_ns, d.attitude.last_ns or 0),
            (
                start.lateral.offset.roll.mean,
                propagation.scale_variance,
                d.extra_noise,
                d.seen_theta_rad,
            ),
            (*propagation.noise[Mode.GYRO],),
            (UNLIKE if unlike else yaw.use, yaw.turn_rad, yaw.variance, yaw.gate_sigma),
            (self.x, self.F, self.P, self.Q, self.x_prior, self.P_prior, self.propagated, self.makes_step),
        )
        self._delay, self._delay_at = start.delay, 0  # delay after this number of samples
        self._traces = [(-1, start.imu_yaw.traces)]  # each with the place of the attitude it is due to
        if yaw.use > NOTHING:
            self._follow_traces()
        places = np.arange(n)
        self._last_gyro = np.maximum.accumulate(np.where(good.is_gyro, places, -1))
        self._last_attitude = np.maximum.accumulate(np.where(good.is_gyro, -1, places))

    def nodes(self, i: int) -> tuple[Node, ...]:
        """Return the smoother's steps of a sample."""
        if not self.makes_step[i]:
            return ()
        return (Node(self.F[i], self.x_prior[i], self.P_prior[i], self.x[i], self.P[i]),)

    def block(self, places: slice) -> Block:
        """Return the smoother's steps of samples."""
        rows = np.flatnonzero(self.makes_step[places]) + places.start
        return Block(self.F[rows], self.x_prior[rows], self.P_prior[rows], self.x[rows], self.P[rows])

    def heading_std_rad(self, places: IntArray) -> FloatArray:
        """Return the heading's sigma after samples, without that of an estimated camera delay."""
        variance = self.P[places, PSI, PSI]
        return np.asarray(np.hypot(np.sqrt(variance), self.start.axis.common_std_rad))

    def state(self, i: int) -> State:
        """Return the state after a sample."""
        sensed, lateral = self.good.sensed[i], self.start.lateral
        _, _, _, _, velocity, width, _, axis, _, frames, elevation, _, checks = self.start
        return State(
            self.x[i],
            self.P[i],
            self._reckoning(i),
            sensed.tilt,
            velocity,
            width,
            self._imu_yaw_after(i),
            axis,
            Lateral(self.offset(i), None, *lateral[2:]),
            frames,
            elevation,
            self._delay_after(i),
            Checks(sensed.gyro, checks.repeats, self._installation_after(i)),
        )

    def _reckoning(self, i: int) -> DeadReckoning:
        d = self.start.reckoning
        theta, raw, yaw_done = self.propagated[i, :PATH_S].tolist()
        gyro_done, rate, yaw_rad, interval_s, *_ = self.propagated[i, RATE - 1 :].tolist()
        last, t_gyro_ns, gyro_rad_s, attitude = self._last_gyro[i], d.t_gyro_ns, d.gyro_rad_s, d.attitude
        if last >= 0:
            sample = self.good.samples[last]
            assert isinstance(sample, ImuSample)
            t_gyro_ns, gyro_rad_s, _ = sample
        if self._last_attitude[i] >= 0:
            attitude = SampleTimes(self.good.samples[self._last_attitude[i]].t_ns, interval_s)
        return DeadReckoning(
            self.good.samples[i].t_ns,
            Mode.GYRO,
            rate,
            theta,
            raw,
            t_gyro_ns,
            gyro_rad_s,
            gyro_done,
            yaw_rad,
            yaw_done,
            attitude,
            d.stored_gyro_bias,
            d.extra_noise,
            d.seen_theta_rad,
        )

    def offset(self, i: int) -> OffsetState:
        """Return the lateral offset's filter after a sample."""
        x, P, weight, _, _, roll, spread2, _ = self.start.lateral.offset
        *path, last, silent_s, density2, n, age_s = self.propagated[i, PATH_S : RATE - 1].tolist()
        accel = Acceleration(last, silent_s, density2, int(n))
        return OffsetState(x, P, weight, Path(*path), accel, roll, spread2, age_s)

    def _imu_yaw_after(self, i: int) -> ImuYaw:
        part = self.start.imu_yaw
        if self._last_attitude[i] < 0 or self.yaw.use == NOTHING:
            return part
        traces = next(traces for place, traces in reversed(self._traces) if place <= i)
        gate = Gate(True, *self.propagated[i, -3:].tolist())
        return ImuYaw(True, part.corrects_heading, 0, gate, part.drift_statistics, traces)

    def _follow_traces(self) -> None:
        """Compare yaw and gyroscope as the engine does; end the run where that has an effect on the filter."""
        traces, yaw = self.start.imu_yaw.traces, self.yaw
        for i in np.flatnonzero(~self.good.is_gyro[: self.count]).tolist():
            if not is_due(traces, t_ns := self.good.samples[i].t_ns):
                continue
            raw, yaw_rad = float(self.propagated[i, RAW_THETA]), float(self.propagated[i, RATE + 1])
            x, variance = self.x[i], float(self.P[i, BIAS, BIAS])
            now = Trace(t_ns, yaw_rad - raw, float(x[PSI]) - raw, float(x[BIAS]), variance)
            disturbed = find_disturbance(traces, now, yaw.walk_variance, yaw.variance) is not None
            if disturbed and yaw.use == HEADING_TOO:  # the engine undoes its effect
                self.count = i
                return
            traces = (now,) if disturbed else with_trace(traces, now)
            self._traces.append((i, traces))
            if yaw.useful and is_undisturbed(traces) != (yaw.use == HEADING_TOO):
                self.count = i + 1
                return

    def _installation_after(self, i: int) -> Installation:
        found, start = self.good.sensed[i].installation, self.start.checks.installation
        return start if found is self.before.installation else found.with_frames_of(start)

    def _delay_after(self, i: int) -> Delay | None:
        if self._delay is None:
            return None
        if self._delay_at > i + 1:
            self._delay, self._delay_at = self.start.delay, 0
        assert self._delay is not None
        rows = [k for k in range(self._delay_at, i + 1) if self.good.is_gyro[k]]
        times = [self.good.samples[k].t_ns for k in rows]
        self._delay = with_turns(self._delay, times, self.propagated[rows, RAW_THETA].tolist())
        self._delay_at = i + 1
        return self._delay


def _first_row(start: State) -> FloatArray:
    """Return the row of ``propagated`` of the state before a run."""
    d, offset = start.reckoning, start.lateral.offset
    values = (
        d.theta_rad,
        d.raw_theta_rad,
        d.yaw_done_rad,
        *offset.path,
        *offset.accel,
        offset.evidence_age_s,
    )
    rest = (d.gyro_done_rad, d.rate_rad_s, d.yaw_rad, d.attitude.interval_s, 0.0, 0.0, 0.0)
    return np.array((*values, *rest))
