"""Tilt and gyroscope checks along consecutive samples in order of time, in one compiled call.

Neither depends on frames, so they are computed ahead of the heading, see `fusion.estimator.gyro_run`. Only the usual
case is compiled: good gyroscope samples and attitudes. The first other sample ends the run, and is left to
`fusion.estimator.engine.Engine.process`. The results are bit-identical to those of that function.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from math import inf, nan
from typing import NamedTuple, TypeVar, overload

import numpy as np

from fusion.estimator.config import FusionConfig
from fusion.estimator.gyro_checks import (
    CLIPPED_REPEATS,
    CLIPPED_SHARE,
    FROZEN_NS,
    FROZEN_REPEATS,
    GOOD,
    MIN_CLIPPED_RAD_S,
    MIN_JUMP_RAD_S,
    NOISY,
    NOISY_MEMORY,
    GyroCheck,
)
from fusion.estimator.imu_yaw import AttitudeSample
from fusion.estimator.installation.checks import IMU_STEP_NS, Installation
from fusion.estimator.kernels import NO_FORCE
from fusion.estimator.lateral.updates import MAX_FORCE_M_S2
from fusion.estimator.models import FloatArray, level_yaw_rate
from fusion.estimator.propagation import ImuSample, Mode
from fusion.estimator.records import new_record
from fusion.estimator.state import Sample, Sensed, State
from fusion.estimator.tilt import (
    ATTITUDE_GAP_S,
    MAX_STEP_S,
    START_S,
    Tilt,
    attitude_down,
    tilt_step,
    turned_by_gyro,
)
from fusion.estimator.tilt_check import SPAN_NS, TiltCheck
from fusion.flight import TimeArray
from vision.compiled import compiled, compiled_inner
from vision.rotations import yaw_of_quaternion
from vision.types import BoolArray

N_NUMBERS, N_COUNTS = 12, 4  # columns of `Sensing.numbers` and `Sensing.counts`
NEVER = -(2**63)  # time of a sample that has not come
_level_yaw_rate = compiled_inner(level_yaw_rate)
T = TypeVar("T")


class GoodSamples(NamedTuple):
    """Consecutive good gyroscope samples and attitudes, with tilt and checks after each.

    ``t_ns`` (n,), ``is_gyro`` (n,) and ``steps`` (n, 8) are for compiled code. Rows of ``steps`` are those of
    `fusion.estimator.state.Sensed`; for an attitude they hold its yaw, no force, and the direction of gravity before.
    """

    samples: Sequence[Sample]
    sensed: Sequence[Sensed]
    t_ns: TimeArray
    is_gyro: BoolArray
    steps: FloatArray


class SensedAlong(Sequence[Sensed]):
    """Tilt and checks after each sample of a run; the records are built on access.

    Parameters
    ----------
    start
        State before the run.
    samples, t_ns, is_gyro, steps
        The samples, as in `GoodSamples`.
    numbers
        Direction of gravity (3,), time settled, gyroscope bias (3,); last change and noise of the checks; direction
        turned by the gyroscope (3,): (n, 12).
    counts
        Time of the last force used, samples repeated and stuck, and time of the last change: (n, 4).
    tilt_checks
        Each change of the attitude's check with the place of its sample.
    """

    def __init__(
        self,
        start: State,
        good: tuple[Sequence[Sample], TimeArray, BoolArray, FloatArray],
        numbers: FloatArray,
        counts: TimeArray,
        tilt_checks: list[tuple[int, TiltCheck]],
    ) -> None:
        self._start, self._numbers, self._counts, self._tilt_checks = start, numbers, counts, tilt_checks
        self._samples, self._t_ns, self._is_gyro, self._steps = good
        places = np.arange(len(self._t_ns))
        self.last_gyro = np.maximum.accumulate(np.where(self._is_gyro, places, -1))
        self.last_attitude = np.maximum.accumulate(np.where(self._is_gyro, -1, places))
        self._installations = self._installations_along()

    def __len__(self) -> int:
        return len(self._t_ns)

    @overload
    def __getitem__(self, i: int) -> Sensed: ...
    @overload
    def __getitem__(self, i: slice) -> Sequence[Sensed]: ...
    def __getitem__(self, i: int | slice) -> Sensed | Sequence[Sensed]:
        if isinstance(i, slice):
            return [self[k] for k in range(*i.indices(len(self)))]
        step = tuple(self._steps[i].tolist()) if self._is_gyro[i] else None
        return Sensed(self._tilt(i), self._check(i), self._installation(i), step)

    def _tilt(self, i: int) -> Tilt:
        start = self._start.tilt
        dx, dy, dz, settled, bx, by, bz, _, _, tx, ty, tz = self._numbers[i].tolist()
        attitude, gyro, accel_ns = self.last_attitude[i], self.last_gyro[i], int(self._counts[i, 0])
        return Tilt(
            (dx, dy, dz),
            self._samples[i].t_ns,
            start.t_attitude_ns if attitude < 0 else self._samples[attitude].t_ns,
            start.t_gyro_ns if gyro < 0 else self._samples[gyro].t_ns,
            None if accel_ns == NEVER else accel_ns,
            settled,
            (bx, by, bz),
            (tx, ty, tz),
            _latest(self._tilt_checks, i, start.check),
        )

    def _check(self, i: int) -> GyroCheck:
        start = self._start.checks.gyro
        if self.last_gyro[i] < 0:
            return start
        sample = self._samples[self.last_gyro[i]]
        assert isinstance(sample, ImuSample)
        change, noisy = self._numbers[i, 7:9].tolist()
        repeats, stuck, changed_ns = self._counts[i, 1:].tolist()
        found = (GOOD, sample.t_ns, sample.gyro_rad_s, (), change, noisy, repeats, stuck, changed_ns, None)
        return new_record(GyroCheck, (*found, start.reported, start.reported_ns))

    def _installation(self, i: int) -> Installation:
        return _latest(self._installations, i, self._start.checks.installation)

    def _installations_along(self) -> list[tuple[int, Installation]]:
        """Return each change of the installation checks with the place of its sample."""
        found, changes = self._start.checks.installation, []
        due_ns = NEVER if found.imu_ns is None else found.imu_ns + IMU_STEP_NS
        for i, sample in enumerate(self._samples):
            if sample.t_ns >= due_ns and isinstance(sample, ImuSample):
                x, y, z = self._numbers[i - 1, :3].tolist() if i else self._start.tilt.down
                found = found.with_imu(sample.t_ns, sample.gyro_rad_s, sample.accel_m_s2, (x, y, z))
                changes.append((i, found))
                due_ns = sample.t_ns + IMU_STEP_NS
        return changes


def sense(s: State, samples: Sequence[Sample], config: FusionConfig, grace_ns: int) -> GoodSamples | None:
    """Process tilt and checks of the leading good samples; None if there is none.

    Parameters
    ----------
    s
        State before them.
    samples
        Gyroscope samples and attitudes in order of time.
    config
        Settings.
    grace_ns
        Longest gap between gyroscope samples.
    """
    d, check, tilt = s.reckoning, s.checks.gyro, s.tilt
    if d.mode is not Mode.GYRO or d.t_gyro_ns is None or check.t_ns is None or tilt.t_ns is None:
        return None
    if tilt.t_gyro_ns != d.t_gyro_ns or tilt.check.is_wrong:  # the engine then sets the tilt otherwise
        return None
    t_ns, is_gyro, vectors, forces = _as_arrays(samples)
    n = len(t_ns)
    steps, numbers = np.empty((n, 8)), np.empty((n, N_NUMBERS))
    counts = np.empty((n, N_COUNTS), np.int64)
    times_ns = (tilt.t_attitude_ns, tilt.t_accel_ns, tilt.check.since_ns)
    attitude_ns, accel_ns, since_ns = (NEVER if at is None else at for at in times_ns)
    n = _fill_sensed(
        t_ns,
        is_gyro,
        vectors,
        forces,
        (tilt.down, tilt.gyro_bias, d.gyro_rad_s, check.gyro_rad_s, tilt.turned),
        (tilt.settled_s, check.change_rad_s, check.noisy, config.gyro_range_rad_s),
        (
            tilt.t_ns,
            attitude_ns,
            accel_ns,
            d.t_gyro_ns,
            grace_ns,
            check.repeats,
            check.stuck,
            check.changed_ns,
            since_ns,
        ),
        (steps, numbers, counts),
    )
    tilt_checks, n = _check_tilt(tilt, samples[:n], is_gyro, numbers)
    if n == 0:
        return None
    good = (samples[:n], t_ns[:n], is_gyro[:n], steps[:n])
    return GoodSamples(good[0], SensedAlong(s, good, numbers, counts, tilt_checks), *good[1:])


def _check_tilt(
    tilt: Tilt, samples: Sequence[Sample], is_gyro: BoolArray, numbers: FloatArray
) -> tuple[list[tuple[int, TiltCheck]], int]:
    """Return each change of the attitude's check with its place, and how many samples come before it is wrong."""
    check = tilt.check
    changes: list[tuple[int, TiltCheck]] = []
    for i in np.flatnonzero(~is_gyro[: len(samples)]).tolist():
        if not check.ends_span(t_ns := samples[i].t_ns):
            continue
        dx, dy, dz = numbers[i, :3].tolist()
        tx, ty, tz = numbers[i - 1, 9:].tolist() if i else tilt.turned
        check = check.with_span(t_ns, (dx, dy, dz), (tx, ty, tz))
        if check.is_wrong:  # the engine then sets the tilt otherwise
            return changes, i
        changes.append((i, check))
    return changes, len(samples)


def _latest(changes: Sequence[tuple[int, T]], i: int, first: T) -> T:
    """Return the value after a sample from its changes, each with the place of its sample."""
    found = first
    for place, value in changes:
        if place > i:
            break
        found = value
    return found


def _as_arrays(samples: Sequence[Sample]) -> tuple[TimeArray, BoolArray, FloatArray, FloatArray]:
    """Return times and kinds (n,), and the numbers that `_fill_sensed` takes, up to the first of another kind."""
    t_ns, is_gyro, vectors, forces = [], [], [], []
    for sample in samples:
        if type(sample) is ImuSample:
            vectors.append(sample.gyro_rad_s)
            forces.append(sample.accel_m_s2 or NO_FORCE)
        elif type(sample) is AttitudeSample:
            q = sample.unit()
            vectors.append(attitude_down(q))
            forces.append((yaw_of_quaternion(q), nan, nan))
        else:
            break
        t_ns.append(sample.t_ns)
        is_gyro.append(type(sample) is ImuSample)
    shape = (len(t_ns), 3)
    return (
        np.array(t_ns, np.int64),
        np.array(is_gyro, np.bool_),
        np.array(vectors, np.float64).reshape(shape),
        np.array(forces, np.float64).reshape(shape),
    )


@cache
def compile_sensing() -> None:
    """Compile the run, or load it from the cache, before the first sample."""
    zero, row, out = (0.0, 0.0, 0.0), np.zeros((1, 3)), (np.zeros((1, 8)), np.zeros((1, N_NUMBERS)))
    counts, t_ns, is_gyro = np.zeros((1, N_COUNTS), np.int64), np.zeros(1, np.int64), np.ones(1, np.bool_)
    _fill_sensed(t_ns, is_gyro, row, row, (zero,) * 5, (0.0,) * 4, (0,) * 9, (*out, counts))


@compiled
def _fill_sensed(
    t_ns: TimeArray,
    is_gyro: BoolArray,
    vectors: FloatArray,
    forces: FloatArray,
    directions: tuple[
        tuple[float, float, float],
        tuple[float, float, float],
        tuple[float, float, float],
        tuple[float, float, float],
        tuple[float, float, float],
    ],
    start: tuple[float, float, float, float],
    times_ns: tuple[int, int, int, int, int, int, int, int, int],
    out: tuple[FloatArray, FloatArray, TimeArray],
) -> int:
    """Process samples as `tilt.with_imu`, `tilt.from_quaternion` and `gyro_checks.with_sample` do; return how many.

    All attitudes are taken to follow the gyroscope; `_check_tilt` ends the run where one does not.

    Parameters
    ----------
    t_ns, is_gyro
        Times and kinds (n,).
    vectors, forces
        Rows (n, 3): rates and forces of gyroscope samples; of attitudes the direction of gravity, and yaw, NaN, NaN.
    directions
        Direction of gravity, bias, and rate of the last gyroscope sample; the same rate, as the checks know it;
        the direction turned by the gyroscope.
    start
        Time settled, last change and noise of the checks; the gyroscope's range.
    times_ns
        Times of the tilt, the last attitude, the last force and the last gyroscope sample; the longest gap; samples
        repeated and stuck, and the time of the last change; start of the span of the attitude's check.
    out
        Output: ``steps``, ``numbers`` and ``counts``, see `GoodSamples` and `SensedAlong`.
    """
    down, bias, rate, checked, turned = directions
    settled_s, change, noisy, top = start
    last_ns, attitude_ns, accel_ns, gyro_ns, grace_ns, repeats, stuck, changed_ns, since_ns = times_ns
    steps, numbers, counts = out
    for k in range(len(t_ns)):
        now = (vectors[k, 0], vectors[k, 1], vectors[k, 2])
        force = (forces[k, 0], forces[k, 1], forces[k, 2])
        if is_gyro[k]:
            check = _checked(now, checked, change, noisy, repeats, stuck, t_ns[k], changed_ns, top)
            good, change, noisy, repeats, stuck, changed_ns = check
            if not good or t_ns[k] - gyro_ns > grace_ns:
                return k
            dt = min(max((t_ns[k] - last_ns) * 1e-9, 0.0), MAX_STEP_S)
            mean = (0.5 * (rate[0] + now[0]), 0.5 * (rate[1] + now[1]), 0.5 * (rate[2] + now[2]))
            ages = (_age_s(t_ns[k], attitude_ns), _age_s(t_ns[k], accel_ns))
            down, bias, settled_s, used = tilt_step(down, bias, settled_s, dt, mean, force, ages)
            accel_ns = t_ns[k] if used else accel_ns
            turned = turned_by_gyro(turned, mean, (t_ns[k] - gyro_ns) * 1e-9)
            rate, checked, gyro_ns = now, now, t_ns[k]
            steps[k, 0], last_ns = _level_yaw_rate(now, down), t_ns[k]
        else:
            steps[k, 0] = force[0]
        steps[k, 7] = 1.0 if _age_s(last_ns, attitude_ns) > ATTITUDE_GAP_S else 0.0
        for i in range(3):
            steps[k, 1 + i] = force[i] if is_gyro[k] and _is_usable(force) else nan
            steps[k, 4 + i] = down[i]
        if not is_gyro[k]:
            down, attitude_ns, last_ns, settled_s = now, t_ns[k], t_ns[k], START_S
            if since_ns == NEVER or not 0 <= t_ns[k] - since_ns < SPAN_NS:
                turned, since_ns = now, t_ns[k]
        row = numbers[k]
        row[0], row[1], row[2] = down
        row[3] = settled_s
        row[4], row[5], row[6] = bias
        row[7], row[8] = change, noisy
        row[9], row[10], row[11] = turned
        counts[k, 0], counts[k, 1], counts[k, 2], counts[k, 3] = accel_ns, repeats, stuck, changed_ns
    return len(t_ns)


@compiled_inner
def _age_s(t_ns: int, then_ns: int) -> float:
    return inf if then_ns == NEVER else (t_ns - then_ns) * 1e-9


@compiled_inner
def _is_usable(force: tuple[float, float, float]) -> bool:
    """Do as `fusion.estimator.lateral.updates.usable_force`."""
    x, y, z = force
    most = MAX_FORCE_M_S2
    return -most < x < most and -most < y < most and -most < z < most


@compiled_inner
def _checked(
    gyro: tuple[float, float, float],
    last: tuple[float, float, float],
    change: float,
    noisy: float,
    repeats: int,
    stuck: int,
    t_ns: int,
    changed_ns: int,
    top: float,
) -> tuple[bool, float, float, int, int, int]:
    """Check a sample as `gyro_checks.with_sample` does; return whether it is good, and the next state of the checks.

    A sample that may be a spike counts as not good.
    """
    p, q, r = gyro
    clip, far, fast = CLIPPED_SHARE * top, MIN_JUMP_RAD_S, MIN_CLIPPED_RAD_S
    dp, dq, dr = p - last[0], q - last[1], r - last[2]
    good = -top <= p <= top and -top <= q <= top and -top <= r <= top
    good = good and -far < dp < far and -far < dq < far and -far < dr < far
    if dr != 0.0:
        noisy += NOISY_MEMORY * ((1.0 if dr * change < 0.0 else 0.0) - noisy)
        change = dr
    if dp == 0.0 and dq == 0.0 and dr == 0.0:
        repeats += 1
        if repeats >= FROZEN_REPEATS and t_ns - changed_ns >= FROZEN_NS and noisy >= NOISY:
            good = False
    else:
        repeats, changed_ns = 0, t_ns
        held = (dp == 0.0 and abs(p) > fast) or (dq == 0.0 and abs(q) > fast) or (dr == 0.0 and abs(r) > fast)
        stuck = stuck + 1 if held else 0
    if (stuck >= CLIPPED_REPEATS and noisy >= NOISY) or abs(p) > clip or abs(q) > clip or abs(r) > clip:
        good = False
    return good, change, noisy, repeats, stuck, changed_ns
