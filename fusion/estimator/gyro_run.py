"""Fast replay of consecutive gyroscope samples in one compiled call, after a late sample.

A late frame changes the heading, its covariance and the lateral offset for all samples after it, but neither the tilt
nor the gyroscope checks (`fusion.estimator.state.Sensed`). So a run of good gyroscope samples is replayed with stored
level rates and forces. The full state after a sample is built only on access.

The result is bit-identical to that of `fusion.estimator.engine.Engine.process`.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from itertools import takewhile
from typing import NamedTuple

import numpy as np

from fusion.estimator.camera_delay import Delay, with_turns
from fusion.estimator.installation.checks import Installation
from fusion.estimator.kernels import BIAS, N_STATES, PSI, stepped
from fusion.estimator.lateral.gaussian_sum import Acceleration, OffsetState, Path
from fusion.estimator.lateral.kernels import extended_path
from fusion.estimator.lateral.status import Lateral
from fusion.estimator.models import FloatArray
from fusion.estimator.propagation import (
    LONG_TURN_RAD,
    SCALE_TIME_S,
    DeadReckoning,
    ImuSample,
    Mode,
    Propagation,
)
from fusion.estimator.smoother import Node
from fusion.estimator.state import Checks, Entry, Sample, Sensed, State
from fusion.flight import TimeArray
from vision.compiled import compiled

N_PROPAGATED = 14
RAW_THETA = 1  # column of ``propagated``, see `_replay_gyro_samples`


class GoodSamples(NamedTuple):
    """Consecutive good gyroscope samples, and tilt and checks from their first processing.

    ``t_ns`` (n,) and ``steps`` (n, 8) hold the same for compiled code, rows as in `fusion.estimator.state.Sensed`.
    """

    samples: Sequence[Sample]
    sensed: Sequence[Sensed]
    t_ns: TimeArray
    steps: FloatArray

    @classmethod
    def first_of(cls, entries: Sequence[Entry]) -> GoodSamples | None:
        """Return the leading good samples of ``entries``; None if the first is not good."""
        if not entries:
            return None
        run, place = entries[0].run, entries[0].place
        if isinstance(run, GyroRun):  # reuse the arrays if the rest of a run follows
            count = run.count - place
            last = entries[count - 1] if count <= len(entries) else None
            if last is not None and last.run is run and last.place == run.count - 1:
                samples, sensed, t_ns, steps = run.good
                rest = slice(place, run.count)
                return cls(samples[rest], sensed[rest], t_ns[rest], steps[rest])
        good = list(takewhile(lambda entry: entry.sensed.step is not None, entries))
        if not good:
            return None
        t_ns = np.array([entry.t_ns for entry in good])
        steps = np.array([entry.sensed.step for entry in good])
        return cls([entry.sample for entry in good], [entry.sensed for entry in good], t_ns, steps)


class GyroRun:
    """Consecutive samples replayed from a state.

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
    """

    def __init__(
        self,
        start: State,
        good: GoodSamples,
        before: Sensed,
        propagation: Propagation,
    ) -> None:
        self.start, self.good, self.before = start, good, before
        n = len(good.samples)
        self.x, self.F = np.empty((n, N_STATES)), np.empty((n, N_STATES, N_STATES))
        self.P, self.Q = np.empty_like(self.F), np.empty((N_STATES, N_STATES))
        self.propagated = np.empty((n, N_PROPAGATED))
        d, offset = start.reckoning, start.lateral.offset
        path, accel = offset.path, offset.accel
        first = np.array((d.theta_rad, d.raw_theta_rad, d.yaw_done_rad, *path, *accel, offset.evidence_age_s))
        assert d.t_ns is not None
        assert d.t_gyro_ns is not None
        self.count: int = _replay_gyro_samples(
            good.t_ns,
            good.steps,
            start.x,
            start.P,
            first,
            (d.t_ns, d.t_gyro_ns, propagation.grace_ns),
            (
                d.rate_rad_s,
                d.gyro_done_rad,
                offset.roll.mean,
                propagation.scale_variance,
                d.extra_noise,
                d.seen_theta_rad,
            ),
            (*propagation.noise[Mode.GYRO],),
            (self.x, self.F, self.P, self.Q, self.propagated),
        )
        self._delay, self._delay_at = start.delay, 0  # delay after this number of samples

    def nodes(self, i: int) -> tuple[Node, ...]:
        """Return the smoother's step of a sample."""
        x, P = self.x[i], self.P[i]
        return (Node(self.F[i], x, P, x, P),)

    def state(self, i: int) -> State:
        """Return the state after a sample."""
        sample, sensed = self.good.samples[i], self.good.sensed[i]
        assert isinstance(sample, ImuSample)
        theta, raw, yaw_done, *path, last, silent_s, density2, n, age_s = self.propagated[i].tolist()
        _, _, d, _, velocity, width, imu_yaw, axis, lateral, frames, elevation, _, checks = self.start
        offset = lateral.offset
        offset = OffsetState(
            offset.x,
            offset.P,
            offset.weight,
            Path(*path),
            Acceleration(last, silent_s, density2, int(n)),
            offset.roll,
            offset.spread2,
            age_s,
        )
        reckoning = DeadReckoning(
            sample.t_ns,
            Mode.GYRO,
            float(self.good.steps[i, 0]),
            theta,
            raw,
            sample.t_ns,
            sample.gyro_rad_s,
            0.0,
            d.yaw_rad,
            yaw_done,
            d.attitude,
            d.stored_gyro_bias,
            d.extra_noise,
            d.seen_theta_rad,
        )
        return State(
            self.x[i],
            self.P[i],
            reckoning,
            sensed.tilt,
            velocity,
            width,
            imu_yaw,
            axis,
            Lateral(offset, None, *lateral[2:]),
            frames,
            elevation,
            self._delay_after(i),
            Checks(sensed.gyro, checks.repeats, self._installation_after(i)),
        )

    def _installation_after(self, i: int) -> Installation:
        found, start = self.good.sensed[i].installation, self.start.checks.installation
        return start if found is self.before.installation else found.with_frames_of(start)

    def _delay_after(self, i: int) -> Delay | None:
        if self._delay is None:
            return None
        if self._delay_at > i + 1:
            self._delay, self._delay_at = self.start.delay, 0
        assert self._delay is not None
        rows = slice(self._delay_at, i + 1)
        times = [sample.t_ns for sample in self.good.samples[rows]]
        self._delay = with_turns(self._delay, times, self.propagated[rows, RAW_THETA].tolist())
        self._delay_at = i + 1
        return self._delay


@cache
def compile_gyro_run() -> None:
    """Compile the replay, or load it from the cache, before the first late frame."""
    n = N_STATES
    out = (
        np.empty((1, n)),
        np.empty((1, n, n)),
        np.empty((1, n, n)),
        np.empty((n, n)),
        np.empty((1, N_PROPAGATED)),
    )
    times = (0, 0, 1_000_000_000)
    t_ns, steps = np.array([1_000_000]), np.array([(0.0,) * 8])
    noise, x, P, propagated = (1.0,) * 3, np.zeros(n), np.eye(n), np.zeros(N_PROPAGATED)
    _replay_gyro_samples(t_ns, steps, x, P, propagated, times, (0.0,) * 6, noise, out)


@compiled
def _replay_gyro_samples(
    t_ns: TimeArray,
    steps: FloatArray,
    x: FloatArray,
    P: FloatArray,
    propagated: FloatArray,
    times_ns: tuple[int, int, int],
    numbers: tuple[float, float, float, float, float, float],
    noise: tuple[float, float, float],
    out: tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray],
) -> int:
    """Process samples as the engine does in `Mode.GYRO`; return how many were processed.

    It stops before a gap in the gyroscope's samples.

    Parameters
    ----------
    t_ns, steps
        Times (n,), and rows (n, 8) as in `fusion.estimator.state.Sensed`.
    x, P
        State (3,) and covariance (3, 3) of the filter.
    propagated
        Other propagated values (14,): dead-reckoned heading, the same with the bias, yaw since the last attitude;
        the six fields of the path and the four of the acceleration; age of the evidence.
    times_ns
        Times of the state and of the last gyroscope sample, and the longest gap.
    numbers
        Last level yaw rate, angle propagated since then, roll correction, variance of the scale, squared density of
        the noise beyond the configured one, rad^2/s, and dead-reckoned heading at the last accepted frame.
    noise
        Densities of the process noise.
    out
        Output: x (n, 3), F (n, 3, 3), P (n, 3, 3), Q (3, 3) of the last step, propagated (n, 14).
    """
    last_ns, gyro_ns, grace_ns = times_ns
    last_rate, done, roll, scale_variance, extra_noise, seen_theta = numbers
    heading_noise, bias_noise, offset_noise = noise
    x_out, F_out, P_out, Q, propagated_out = out
    theta, raw_theta, yaw_done = propagated[0], propagated[1], propagated[2]
    path = (propagated[3], propagated[4], propagated[5], propagated[6], propagated[7], propagated[8])
    accel = (propagated[9], propagated[10], propagated[11], int(propagated[12]))
    age_s = propagated[13]
    for k in range(len(t_ns)):
        dt_s = (t_ns[k] - last_ns) * 1e-9
        if t_ns[k] - gyro_ns > grace_ns or not dt_s > 0.0:
            return k
        rate = steps[k, 0]
        force, down = (steps[k, 1], steps[k, 2], steps[k, 3]), (steps[k, 4], steps[k, 5], steps[k, 6])
        path, accel = extended_path(path, accel, dt_s, x[PSI], force, down, roll, steps[k, 7])
        age_s += dt_s
        turned = 0.5 * (last_rate + rate) * (t_ns[k] - gyro_ns) * 1e-9 - done
        corrected = turned - x[BIAS] * dt_s
        variance = scale_variance * SCALE_TIME_S * corrected * corrected / dt_s
        before = theta - seen_theta
        if abs(before) > LONG_TURN_RAD:
            variance = max(variance, scale_variance * corrected * (2.0 * before + corrected))
        variance += extra_noise * dt_s
        stepped(
            x,
            P,
            x_out[k],
            F_out[k],
            Q,
            P_out[k],
            dt_s,
            turned,
            heading_noise,
            bias_noise,
            offset_noise,
            variance,
        )
        theta, raw_theta, yaw_done = theta + corrected, raw_theta + turned, yaw_done + corrected
        x, P, last_ns, gyro_ns, last_rate, done = x_out[k], P_out[k], t_ns[k], t_ns[k], rate, 0.0
        row = propagated_out[k]
        row[0], row[1], row[2], row[13] = theta, raw_theta, yaw_done, age_s
        row[3], row[4], row[5], row[6], row[7], row[8] = path
        row[9], row[10], row[11], row[12] = accel
    return len(t_ns)
