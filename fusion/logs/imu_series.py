"""IMU samples of drivers: cleaned, separate sensors joined by time, burst time stamps spread."""

from __future__ import annotations

import numpy as np

from fusion.flight import FloatArray, ImuStream, Remark, TimeArray, VectorStream
from fusion.logs.interpolation import interpolated
from fusion.logs.samples import BoolArray, Problems, WithProblems, counted, finite
from fusion.logs.series import Where, usable, vector_stream, within
from vision import InputError

MAX_ACCEL_GAP_NS = 50_000_000  # interpolated between accelerometer samples, unless the sensor is slower
MIN_ALONE, MOSTLY = (
    0.1,
    0.8,
)  # shares of rows with one sensor, of each and of both, if the sensors alternate
MAX_BURST_STEP_NS, MIN_BURST_SHARE, MIN_BURST_STEPS = 200_000, 0.4, 20
BURST_RATIO = 5.0  # ratio of the usual step to that within a burst

# Beyond any vehicle's motion in any unit, so the sample is damaged.
MAX_RATE = 1e4
MAX_ACCELERATION = 1e5


def imu_stream(
    t_ns: TimeArray, gyro_rad_s: FloatArray, accel_m_s2: FloatArray, where: Where
) -> WithProblems[ImuStream]:
    """Clean IMU samples; rows without acceleration keep NaN there.

    Some drivers send the two sensors alternately, with the other one zero or unknown. Then the gyroscope's rows are
    kept, with interpolated acceleration.

    Parameters
    ----------
    t_ns
        Times (n,), as read.
    gyro_rad_s, accel_m_s2
        Angular rate and specific force (n, 3), body FRD.
    where
        Name of the stream.
    """
    with_gyro, with_accel = is_measured(gyro_rad_s), is_measured(accel_m_s2)
    alone = (
        (float(np.mean(with_gyro & ~with_accel)), float(np.mean(with_accel & ~with_gyro)))
        if len(t_ns)
        else (0, 0)
    )
    if min(alone) > MIN_ALONE and sum(alone) > MOSTLY:
        accel = VectorStream(t_ns[with_accel], accel_m_s2[with_accel])
        imu, problems = joined_imu(t_ns[with_gyro], gyro_rad_s[with_gyro], accel, where, where)
        remark = f"{where.label}: gyroscope and accelerometer come in rows of their own, joined by time"
        return WithProblems(imu, (Remark(remark), *problems))
    return _clean_imu(t_ns, gyro_rad_s, accel_m_s2, where)


def _clean_imu(
    t_ns: TimeArray, gyro_rad_s: FloatArray, accel_m_s2: FloatArray, where: Where
) -> WithProblems[ImuStream]:
    t_ns, burst_problems = spread_bursts(t_ns, where)
    index, problems = usable(t_ns, where)
    problems = burst_problems + problems
    t_ns, gyro_rad_s, accel_m_s2 = t_ns[index], gyro_rad_s[index], accel_m_s2[index]
    good = within(gyro_rad_s, MAX_RATE)
    problems += where.dropped(good, t_ns, "a missing or impossible gyro value")
    t_ns, gyro_rad_s, accel_m_s2 = t_ns[good], gyro_rad_s[good], accel_m_s2[good]
    without = ~within(accel_m_s2, MAX_ACCELERATION)
    if without.any():
        accel_m_s2 = np.where(without[:, None], np.nan, accel_m_s2)
        problems += (f"{where.label}: {counted(int(np.count_nonzero(without)), 'row')} without acceleration",)
    return WithProblems(ImuStream(t_ns, gyro_rad_s, accel_m_s2), problems)


def is_measured(values: FloatArray) -> BoolArray:
    """Rows (n,) of (n, 3) that are plausible sensor values: numbers, and not all zero."""
    return np.asarray(finite(values) & (values != 0.0).any(axis=1))


def joined_imu(
    t_ns: TimeArray, gyro_rad_s: FloatArray, accel: VectorStream | None, where: Where, accel_where: Where
) -> WithProblems[ImuStream]:
    """Clean a gyroscope's samples, and interpolate another sensor's acceleration at their times.

    Parameters
    ----------
    t_ns, gyro_rad_s
        Times (n,) and angular rates (n, 3), body FRD, as read.
    accel
        Specific force, body FRD, on the same clock, as read; None if there is none.
    where, accel_where
        Names of the two streams.
    """
    accel_m_s2 = np.full((len(t_ns), 3), np.nan)
    problems: Problems = ()
    if accel is not None:
        try:
            samples, problems = vector_stream(accel.t_ns, accel.xyz, accel_where, MAX_ACCELERATION)
        except InputError as error:
            problems = (f"{accel_where.label}: {error.problem}, left out",)
        else:
            steps_ns = [int(np.median(np.abs(np.diff(t)))) for t in (t_ns, samples.t_ns) if len(t) > 1]
            accel_m_s2 = interpolated(samples, t_ns, max(MAX_ACCEL_GAP_NS, 2 * max(steps_ns, default=0)))
    imu, more = _clean_imu(t_ns, gyro_rad_s, accel_m_s2, where)
    return WithProblems(imu, problems + more)


def spread_bursts(t_ns: TimeArray, where: Where) -> WithProblems[TimeArray]:
    """Spread times (n,) that a driver assigned to whole buffers on receipt evenly between the buffers.

    The stamp is right for the last sample of a buffer; the others precede it at the sensor's sampling interval.
    """
    steps = np.diff(t_ns)
    if len(steps) < MIN_BURST_STEPS or steps.min() < 0:
        return WithProblems(t_ns)
    close = steps < MAX_BURST_STEP_NS
    usual_ns = float(t_ns[-1] - t_ns[0]) / len(steps)
    if not MIN_BURST_SHARE < float(np.mean(close)) < 1.0 or usual_ns < BURST_RATIO * float(
        np.median(steps[close])
    ):
        return WithProblems(t_ns)
    ends = np.append(np.flatnonzero(~close), len(steps))  # the last sample of each buffer
    lengths = np.diff(ends, prepend=-1)
    period_ns = np.diff(t_ns[ends], prepend=0) / lengths
    pace_ns = float(np.median(period_ns[1:]))
    period_ns[0] = pace_ns
    period_ns = np.minimum(
        period_ns, 2.0 * pace_ns
    )  # after a pause, the sensor's sampling interval is the better estimate
    before = np.repeat(ends, lengths) - np.arange(len(t_ns))
    spread = np.repeat(t_ns[ends], lengths) - np.rint(before * np.repeat(period_ns, lengths)).astype(np.int64)
    within_us = float(np.median(steps[close])) * 1e-3
    problem = (
        f"{where.label}: samples stamped in bursts of {int(np.median(lengths))}, {within_us:.0f} us apart, as when "
        "a driver empties a buffer: spread over the time between the bursts"
    )
    return WithProblems(np.maximum.accumulate(spread), (problem,))
