"""Checks of single gyroscope samples: range, spikes, clipping and repeated values.

- Out of range: a sample beyond ``gyro_range_rad_s`` is rejected.
- Spike: a sample is held back if it differs from the last one by more than ``alpha dt + 8 sigma``, with alpha the
  largest angular acceleration of a vehicle and sigma the gyroscope's noise. It is accepted once the samples after it
  agree with it: a spike lasts one or two samples, a collision longer. The trapezoid rule bridges samples that are
  held back or rejected.
- Clipped: at the end of the range, the true rate is only known to be larger. The sample is used, and the heading's
  variance grows.
- Frozen: a gyroscope whose samples were noisy and are now bit-identical is frozen, and counts as silent.
"""

from __future__ import annotations

from enum import StrEnum
from itertools import pairwise
from math import sqrt
from typing import NamedTuple

from fusion.estimator.config import FusionConfig
from fusion.estimator.faults import Fault, Notice
from fusion.estimator.models import Vector
from fusion.estimator.propagation import ImuSample
from fusion.estimator.records import new_record

MAX_ANGULAR_ACCELERATION_RAD_S2 = 300.0  # about what small racing multirotors reach
MAX_ACCELERATED_S = 0.03  # upper bound of dt: no vehicle accelerates at that rate for longer
MIN_JUMP_RAD_S = 3.0  # smallest jump from sample to sample; vibration causes smaller ones
JUMP_SIGMA = 8.0  # of the gyroscope's noise
CONFIRMED_SAMPLES, CONFIRMED_NS = 3, 20_000_000  # samples that must agree, and their span, to accept a jump
CLIPPED_SHARE = 0.98  # part of the range above which a sample is clipped
CLIPPED_REPEATS = 2  # of one fast axis while another changes: clipped at a range that is not configured
MIN_CLIPPED_RAD_S = 1.0
CLIPPED_STD_SHARE = 0.3  # sigma of the excess over the range, as a part of the rate
# Coarse quantisation repeats fewer samples; a slow sensor that is polled often repeats for less time.
FROZEN_REPEATS, FROZEN_NS = 8, 50_000_000
# Part of the changes that reverse the one before: 2/3 in white noise, near 0 in an exact simulation.
NOISY, NOISY_MEMORY = 0.3, 1 / 32
REPORTED_NS = 500_000_000  # for which a fault remains reported


class GyroVerdict(StrEnum):
    """Result of the check of a sample; the names in the counters."""

    GOOD = "good"
    CONFIRMED = "confirmed"  # confirms the samples that were held back, too
    OUT_OF_RANGE = "out_of_range"
    SPIKE = "spike"
    CLIPPED = "clipped"
    FROZEN = "frozen"


GOOD = GyroVerdict.GOOD  # member lookup of an enum is slow in Python 3.11, and needed for each sample
_USED = (GOOD, GyroVerdict.CLIPPED, GyroVerdict.CONFIRMED)
_TEXTS = {
    GyroVerdict.OUT_OF_RANGE: (
        Fault.GYRO_OUT_OF_RANGE,
        "gyroscope exceeds gyro_range_rad_s; are its rates in rad/s?",
    ),
    GyroVerdict.SPIKE: (Fault.GYRO_SPIKES, "gyroscope jumps as no vehicle can; are its rates in rad/s?"),
    GyroVerdict.CLIPPED: (Fault.GYRO_CLIPPED, "gyroscope is clipped at the end of its range"),
    GyroVerdict.FROZEN: (Fault.GYRO_FROZEN, "gyroscope repeats the same sample"),
}


class GyroCheck(NamedTuple):
    """State of the checks of the gyroscope's samples.

    Parameters
    ----------
    verdict
        Verdict on the newest sample.
    t_ns, gyro_rad_s
        The last sample used; None before the first.
    waiting
        Samples that are held back, oldest first.
    change_rad_s, noisy
        Last change of the third axis, and the part of its changes that reverse the one before.
    repeats, stuck
        Samples in a row that equal the one before: on all axes, and on one fast axis alone.
    changed_ns
        Time of the last sample that differed from the one before.
    clipped_from_ns
        Time since which samples are clipped; None if they are not.
    reported, reported_ns
        The last verdict that was not good, and its time.
    """

    verdict: GyroVerdict = GyroVerdict.GOOD
    t_ns: int | None = None
    gyro_rad_s: Vector = (0.0, 0.0, 0.0)
    waiting: tuple[ImuSample, ...] = ()
    change_rad_s: float = 0.0
    noisy: float = 0.0
    repeats: int = 0
    stuck: int = 0
    changed_ns: int = 0
    clipped_from_ns: int | None = None
    reported: GyroVerdict = GyroVerdict.GOOD
    reported_ns: int = 0

    @property
    def is_used(self) -> bool:
        """Whether the newest sample is integrated."""
        return self.verdict in _USED

    @property
    def is_noisy(self) -> bool:
        """Whether the samples are noisy, as those of a real gyroscope."""
        return self.noisy >= NOISY

    @property
    def clipped_ns(self) -> int | None:
        """Time of the last clipped sample, if clipping was the last fault; else None."""
        return self.reported_ns if self.reported is GyroVerdict.CLIPPED else None

    def clock_set_back(self) -> GyroCheck:
        """Restart the checks; keep the estimated noise."""
        return GyroCheck(noisy=self.noisy)

    def notice(self, t_ns: int) -> Notice | None:
        """Return the fault found within the last half second; None if there is none."""
        if self.reported is GyroVerdict.GOOD or t_ns - self.reported_ns > REPORTED_NS:
            return None
        return Notice(*_TEXTS[self.reported])

    def _wrong(self, verdict: GyroVerdict, t_ns: int) -> GyroCheck:
        return self._replace(verdict=verdict, reported=verdict, reported_ns=t_ns)


def with_sample(check: GyroCheck, sample: ImuSample, config: FusionConfig) -> GyroCheck:
    """Check the next sample.

    Parameters
    ----------
    check
        State of the checks.
    sample
        The next sample.
    config
        Settings.
    """
    t_ns, gyro, _ = sample
    p, q, r = gyro
    top = config.gyro_range_rad_s
    if not (-top <= p <= top and -top <= q <= top and -top <= r <= top):
        return check._wrong(GyroVerdict.OUT_OF_RANGE, t_ns)
    _, last_ns, last, _, change, noisy, repeats, stuck, changed_ns, clipped_ns, reported, reported_ns = check
    if last_ns is None:
        return check._replace(verdict=GyroVerdict.GOOD, t_ns=t_ns, gyro_rad_s=gyro, changed_ns=t_ns)
    dp, dq, dr = p - last[0], q - last[1], r - last[2]
    least = MIN_JUMP_RAD_S
    far = not (-least < dp < least and -least < dq < least and -least < dr < least)
    if far and _jumps(gyro, last, t_ns - last_ns, config):
        return _with_jump(check, sample, config)
    if dr != 0.0:
        noisy += NOISY_MEMORY * ((dr * change < 0.0) - noisy)
        change = dr
    if dp == 0.0 and dq == 0.0 and dr == 0.0:
        repeats += 1
        if repeats >= FROZEN_REPEATS and t_ns - changed_ns >= FROZEN_NS and noisy >= NOISY:
            return check._replace(waiting=(), repeats=repeats)._wrong(GyroVerdict.FROZEN, t_ns)
    else:
        repeats, changed_ns = 0, t_ns
        fast = MIN_CLIPPED_RAD_S
        held = (dp == 0.0 and abs(p) > fast) or (dq == 0.0 and abs(q) > fast) or (dr == 0.0 and abs(r) > fast)
        stuck = stuck + 1 if held else 0
    verdict, clip = GOOD, CLIPPED_SHARE * top
    if (stuck >= CLIPPED_REPEATS and noisy >= NOISY) or abs(p) > clip or abs(q) > clip or abs(r) > clip:
        verdict = reported = GyroVerdict.CLIPPED
        reported_ns, clipped_ns = t_ns, clipped_ns or last_ns
    else:
        clipped_ns = None
    found = (
        verdict,
        t_ns,
        gyro,
        (),
        change,
        noisy,
        repeats,
        stuck,
        changed_ns,
        clipped_ns,
        reported,
        reported_ns,
    )
    return new_record(GyroCheck, found)


def clipped_variance(before: GyroCheck, check: GyroCheck) -> float:
    """Return the variance of the heading added by a clipped sample, rad^2: that of a constant unknown rate."""
    if check.clipped_from_ns is None or check.t_ns is None or before.t_ns is None:
        return 0.0
    std = CLIPPED_STD_SHARE * max(map(abs, check.gyro_rad_s))
    first_s, last_s = ((t - check.clipped_from_ns) * 1e-9 for t in (before.t_ns, check.t_ns))
    return float(std**2 * (last_s**2 - first_s**2))


def rate_that_bridges(before: GyroCheck, sample: ImuSample) -> Vector:
    """Return the rate (3,) at the last sample used with which one trapezoid covers the held-back samples."""
    if before.t_ns is None:
        return sample.gyro_rad_s
    path = [(before.t_ns, before.gyro_rad_s), *((w.t_ns, w.gyro_rad_s) for w in before.waiting)]
    path.append((sample.t_ns, sample.gyro_rad_s))
    span_ns = sample.t_ns - before.t_ns

    def start(axis: int) -> float:
        turned = sum((a[axis] + b[axis]) * (t - s) for (s, a), (t, b) in pairwise(path))
        return turned / span_ns - sample.gyro_rad_s[axis]

    return start(0), start(1), start(2)


def _jumps(gyro: Vector, last: Vector, dt_ns: int, config: FusionConfig) -> bool:
    """Whether the change of the rate exceeds what acceleration and noise allow in that time."""
    dt_s = min(max(dt_ns * 1e-9, 1e-4), MAX_ACCELERATED_S)
    reach = max(
        MAX_ANGULAR_ACCELERATION_RAD_S2 * dt_s, MIN_JUMP_RAD_S
    ) + JUMP_SIGMA * config.gyro_noise / sqrt(dt_s)
    return max(abs(a - b) for a, b in zip(gyro, last, strict=True)) > reach


def _with_jump(check: GyroCheck, sample: ImuSample, config: FusionConfig) -> GyroCheck:
    """Hold a sample back, or accept it if enough samples held back agree with it."""
    waiting, t_ns = check.waiting, sample.t_ns
    if waiting and _jumps(sample.gyro_rad_s, waiting[-1].gyro_rad_s, t_ns - waiting[-1].t_ns, config):
        waiting = ()
    if len(waiting) + 1 >= CONFIRMED_SAMPLES and t_ns - waiting[0].t_ns >= CONFIRMED_NS:
        return check._replace(
            verdict=GyroVerdict.CONFIRMED,
            t_ns=t_ns,
            gyro_rad_s=sample.gyro_rad_s,
            waiting=(),
            repeats=0,
            stuck=0,
            changed_ns=t_ns,
            clipped_from_ns=None,
        )
    return check._wrong(GyroVerdict.SPIKE, t_ns)._replace(waiting=(*waiting, sample))
