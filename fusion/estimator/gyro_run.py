"""Consecutive gyroscope samples and attitudes, processed in one compiled call.

Tilt and gyroscope checks come first: they do not depend on frames (`fusion.estimator.sensing`). Then heading,
covariance, yaw offset and lateral offset follow. A late frame changes only these, so the samples after it are
replayed with the stored level rates and forces. The full state after a sample is built only on access.

The result is bit-identical to that of `fusion.estimator.engine.Engine.process`.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from itertools import takewhile
from math import isfinite

import numpy as np

from fusion.estimator.camera_delay import Delay, with_turns
from fusion.estimator.imu_yaw import HEADING_TOO, NOTHING, OFFSET_ONLY, UNLIKE, ImuYaw, YawUpdates
from fusion.estimator.imu_yaw_check import Trace, find_disturbance, is_due, is_undisturbed, with_trace
from fusion.estimator.installation.checks import Installation
from fusion.estimator.kernels import BIAS, N_STATES, PSI, YAW_OFFSET, predicted_variance, stepped, updated
from fusion.estimator.lateral.gaussian_sum import Acceleration, OffsetState, Path
from fusion.estimator.lateral.kernels import extended_path
from fusion.estimator.lateral.status import Lateral
from fusion.estimator.models import FloatArray, Gate
from fusion.estimator.propagation import (
    LONG_TURN_RAD,
    SCALE_TIME_S,
    DeadReckoning,
    ImuSample,
    Mode,
    Propagation,
)
from fusion.estimator.resets import STEP_RAD
from fusion.estimator.sample_times import SampleTimes
from fusion.estimator.sensing import GoodSamples
from fusion.estimator.smoother import Block, Node
from fusion.estimator.state import Checks, Entry, Sensed, State
from fusion.flight import TimeArray
from vision.compiled import compiled, compiled_inner
from vision.rotations import wrap
from vision.types import BoolArray, IntArray

N_PROPAGATED = 21
THETA, RAW_THETA, PATH_S, RATE = 0, 1, 3, 15  # columns of ``propagated``, see `_process_samples`
SMALL_STEP_RAD = 0.5 * STEP_RAD  # a larger correction, which may count as a jump, is left to the engine
_wrap = compiled_inner(wrap)


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
        Other values after each sample, see `_process_samples`.
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
        self.count: int = _process_samples(
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


@cache
def compile_gyro_run() -> None:
    """Compile the run, or load it from the cache, before the first sample."""
    n = N_STATES
    rows, squares = np.empty((1, n)), np.empty((1, n, n))
    propagated, makes_step = np.empty((1, N_PROPAGATED)), np.empty(1, np.bool_)
    out = (
        rows,
        squares,
        squares.copy(),
        np.empty((n, n)),
        rows.copy(),
        squares.copy(),
        propagated,
        makes_step,
    )
    samples = (np.array([1_000_000]), np.ones(1, np.bool_), np.zeros((1, 8)))
    times, yaw = (0, 0, 1_000_000_000, 0), (NOTHING, 0.0, 1.0, 1.0)
    x, P, first = np.zeros(n), np.eye(n), np.zeros(N_PROPAGATED)
    _process_samples(samples, x, P, first, times, (0.0,) * 4, (1.0,) * 3, yaw, out)


@compiled
def _process_samples(
    samples: tuple[TimeArray, BoolArray, FloatArray],
    x: FloatArray,
    P: FloatArray,
    first: FloatArray,
    times_ns: tuple[int, int, int, int],
    numbers: tuple[float, float, float, float],
    noise: tuple[float, float, float],
    yaw: tuple[int, float, float, float],
    out: tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, BoolArray],
) -> int:
    """Process samples as the engine does in `Mode.GYRO`; return how many were processed.

    It stops before a gap in the gyroscope's samples, and before a yaw that the gate rejects.

    Parameters
    ----------
    samples
        ``t_ns``, ``is_gyro`` and ``steps`` of `fusion.estimator.sensing.GoodSamples`.
    x, P
        State (3,) and covariance (3, 3) of the filter.
    first
        Other propagated values (21,): dead-reckoned heading, the same with the bias, yaw since the last attitude;
        the six fields of the path and the four of the acceleration; age of the evidence; angle since the last
        gyroscope sample, level yaw rate; yaw and mean interval of the attitudes; residual, test ratio and variance
        of the last yaw.
    times_ns
        Times of the state and of the last gyroscope sample, the longest gap, and the time of the last attitude.
    numbers
        Roll correction, variance of the scale, squared density of the noise beyond the configured one, rad^2/s, and
        dead-reckoned heading at the last accepted frame.
    noise
        Densities of the process noise.
    yaw
        The first four fields of `fusion.estimator.imu_yaw.YawUpdates`.
    out
        Output, see `GyroRun`: x (n, 3), F (n, 3, 3), P (n, 3, 3), Q (3, 3), x_prior, P_prior, propagated (n, 21),
        makes_step (n,).
    """
    t_ns, is_gyro, steps = samples
    last_ns, gyro_ns, grace_ns, attitude_ns = times_ns
    roll, scale_variance, extra_noise, seen_theta = numbers
    heading_noise, bias_noise, offset_noise = noise
    x_out, F_out, P_out, Q, x_prior, P_prior, propagated, makes_step = out
    identity = np.eye(N_STATES)
    before = first
    for k in range(len(t_ns)):
        dt_s, gyro = (t_ns[k] - last_ns) * 1e-9, is_gyro[k]
        if t_ns[k] - gyro_ns > grace_ns or dt_s < 0.0 or (gyro and not dt_s > 0.0):
            return k
        row = propagated[k]
        row[:] = before
        x_prior[k], P_prior[k], F_out[k], makes_step[k] = x, P, identity, False
        if dt_s > 0.0:
            rate, done = before[RATE], before[RATE - 1]
            turned = rate * dt_s
            if gyro:
                turned = 0.5 * (rate + steps[k, 0]) * (t_ns[k] - gyro_ns) * 1e-9 - done
                if done != 0.0 and abs(turned - 0.5 * (rate + steps[k, 0]) * dt_s) > SMALL_STEP_RAD:
                    return k
            corrected = turned - x[BIAS] * dt_s
            since = before[THETA] - seen_theta
            variance = _scale_variance(scale_variance, corrected, dt_s, since) + extra_noise * dt_s
            stepped(
                x,
                P,
                x_prior[k],
                F_out[k],
                Q,
                P_prior[k],
                dt_s,
                turned,
                heading_noise,
                bias_noise,
                offset_noise,
                variance,
            )
            _extend(row, dt_s, x[PSI], steps[k], roll)
            row[0], row[1], row[2] = row[0] + corrected, row[1] + turned, row[2] + corrected
            row[RATE - 1] += turned
            makes_step[k] = True
        x_out[k], P_out[k] = x_prior[k], P_prior[k]
        if gyro:
            row[RATE - 1], row[RATE] = 0.0, steps[k, 0]
            gyro_ns = t_ns[k]
        else:
            if yaw[0] == UNLIKE or t_ns[k] <= attitude_ns:
                return k
            _note_yaw(row, steps[k, 0], (t_ns[k] - attitude_ns) * 1e-9)
            attitude_ns = t_ns[k]
            if yaw[0] != NOTHING:
                if not _fuse_yaw(x_prior[k], P_prior[k], steps[k, 0], yaw, row, x_out[k], P_out[k]):
                    return k
                makes_step[k] = True
        x, P, before, last_ns = x_out[k], P_out[k], row, t_ns[k]
    return len(t_ns)


@compiled_inner
def _scale_variance(scale_variance: float, turned: float, dt_s: float, before: float) -> float:
    """Do as `fusion.estimator.propagation.Propagation` for the error of the gyroscope's scale."""
    variance = scale_variance * SCALE_TIME_S * turned * turned / dt_s
    if abs(before) > LONG_TURN_RAD:
        return max(variance, scale_variance * turned * (2.0 * before + turned))
    return variance


@compiled_inner
def _extend(row: FloatArray, dt_s: float, heading_rad: float, step: FloatArray, roll: float) -> None:
    """Extend the path of the lateral offset by a step."""
    path = (row[3], row[4], row[5], row[6], row[7], row[8])
    accel = (row[9], row[10], row[11], int(row[12]))
    force, down = (step[1], step[2], step[3]), (step[4], step[5], step[6])
    path, accel = extended_path(path, accel, dt_s, heading_rad, force, down, roll, step[7])
    row[3], row[4], row[5], row[6], row[7], row[8] = path
    row[9], row[10], row[11], row[12] = accel
    row[13] += dt_s


@compiled_inner
def _note_yaw(row: FloatArray, yaw_rad: float, interval_s: float) -> None:
    """Note the yaw and the interval of an attitude, as `fusion.estimator.sample_times.SampleTimes` does."""
    mean_s = row[17]
    row[2], row[16] = 0.0, yaw_rad
    row[17] = 0.8 * mean_s + 0.2 * min(interval_s, 3 * mean_s) if isfinite(mean_s) else interval_s


@compiled_inner
def _fuse_yaw(
    x: FloatArray,
    P: FloatArray,
    yaw_rad: float,
    yaw: tuple[int, float, float, float],
    row: FloatArray,
    x_out: FloatArray,
    P_out: FloatArray,
) -> bool:
    """Update with a yaw as `fusion.estimator.imu_yaw.fuse_imu_yaw` does; return False if that would do more."""
    use, turn_rad, variance, sigma = yaw
    H, K = np.zeros(N_STATES), np.empty((N_STATES, 1))
    H[YAW_OFFSET] = 1.0
    if use == OFFSET_ONLY:
        variance += P[PSI, PSI]
    else:
        H[PSI] = 1.0
    residual = _wrap(yaw_rad - x[PSI] - turn_rad - x[YAW_OFFSET])
    expected = predicted_variance(P, H)
    ratio = residual * residual / (sigma * sigma * (expected + variance))
    if not isfinite(residual) or not variance > 0.0 or ratio > 1.0:
        return False
    updated(x, P, H, residual, variance, x_out, P_out, K)
    row[18], row[19], row[20] = residual, ratio, expected + variance
    return bool(abs(x_out[PSI] - x[PSI]) <= SMALL_STEP_RAD)
