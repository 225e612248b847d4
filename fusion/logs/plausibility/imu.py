"""Checks an IMU's units (rad/s, m/s^2), axes (body FRD) and function, by gravity, by itself and by the attitude.

No check reports anything if the data are insufficient. Thresholds are far beyond vehicles' motions: they detect a
factor of 57 or 9.8 or a reversed axis, not a poor calibration.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import degrees, radians

import numpy as np

from fusion.flight import AttitudeStream, FloatArray, ImuStream
from fusion.logs.plausibility.findings import Advice, Finding, Medium, Severity
from fusion.logs.plausibility.turn_rates import FLU, Reading, compare_turns
from fusion.logs.units import in_si, unit_in_words, unit_of_size

GRAVITY_M_S2 = 9.80665
MIN_SAMPLES = 20
GYRO_RANGE_RAD_S = radians(2000.0)  # the widest range of small gyroscopes
MAX_DEGREES = 2000.0  # per second: larger numbers are not degrees either
LIKELY_DEGREES = 4.0  # median of |gyro|: 230 degrees/s all the time
UPRIGHT = 0.8  # share of gravity along z: within 37 degrees
MIN_CORRELATION = 0.7  # with the attitude, to judge its scale or axes
TILT_WINDOW_S = 0.5
STUCK_S = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Gravity:
    """Median specific force (3,) and median of its length, m/s^2 if the unit is right."""

    mean: FloatArray
    length: float

    @property
    def is_seen(self) -> bool:
        """Whether it has a constant direction, as gravity has and vibration has not."""
        return self.length > 0.0 and float(np.linalg.norm(self.mean)) > 0.7 * self.length

    @property
    def direction(self) -> FloatArray:
        """Unit vector (3,)."""
        return np.asarray(self.mean / np.linalg.norm(self.mean))


def gravity_of(imu: ImuStream) -> Gravity | None:
    """Measure gravity over the whole log; None if the log has no accelerometer, or too little of it."""
    accel = imu.accel_m_s2[np.isfinite(imu.accel_m_s2).all(axis=1)]
    if len(accel) < MIN_SAMPLES:
        return None
    return Gravity(np.median(accel, axis=0), float(np.median(np.linalg.norm(accel, axis=1))))


def examine_imu(imu: ImuStream, attitude: AttitudeStream | None, advice: Advice) -> Iterator[Finding]:
    """Yield implausible properties of an IMU, and of an attitude that contradicts it."""
    if len(imu.t_ns) < MIN_SAMPLES:
        return
    yield from _stuck(imu, advice)
    gravity = gravity_of(imu)
    if gravity is not None:
        yield from _accel_unit(gravity, advice)
    if attitude is not None and (order := examine_order(imu, attitude, advice)) is not None:
        yield order
        yield from _gravity_sign(gravity, advice, gyro_confirmed=False)
        return
    comparison = None if attitude is None else compare_turns(imu, attitude)
    likeliest = None if comparison is None else (comparison.others or (comparison.as_taken,))[0]
    if likeliest is not None and likeliest.correlation >= MIN_CORRELATION:
        yield from _scale(likeliest, advice)
        if comparison is not None and comparison.others:
            yield from _axes_by_attitude(comparison.as_taken, likeliest, gravity, advice)
            return
        yield from _gravity_sign(gravity, advice, gyro_confirmed=True)
        return
    yield from _gyro_degrees(imu, gravity, advice)
    yield from _gravity_sign(gravity, advice, gyro_confirmed=False)


def examine_order(imu: ImuStream, attitude: AttitudeStream, advice: Advice) -> Finding | None:
    """Determine whether quaternions have another order than assumed: w first instead of last, or the reverse.

    In the other order, and only in it, they agree with the gyroscope, and the vehicle is upright.
    """
    taken = compare_turns(imu, attitude)
    if taken is None or (taken.as_taken.correlation >= MIN_CORRELATION and not taken.others):
        return None
    flip = np.array([1.0, 1.0, -1.0, -1.0])  # a reader may have converted them from z up already
    for turned in (np.ones(4), flip):
        for shift, text in ((-1, "w, x, y, z, read as x, y, z, w"), (1, "x, y, z, w, read as w, x, y, z")):
            q = np.roll(attitude.q_world_body * turned, shift, axis=1) * turned
            other = compare_turns(imu, replace(attitude, q_world_body=q))
            upright = np.median(1.0 - 2.0 * (q[:, 1] ** 2 + q[:, 2] ** 2)) > UPRIGHT
            if other is None or other.others or not upright or other.as_taken.correlation < MIN_CORRELATION:
                continue
            return Finding(
                Severity.ERROR,
                "attitude",
                "quaternion_order",
                f"its quaternions are written in the order {text}: in the other order they turn as the gyroscope, "
                f"correlation {other.as_taken.correlation:+.2f}, as taken {taken.as_taken.correlation:+.2f}",
                advice.quaternion_order(),
            )
    return None


def _stuck(imu: ImuStream, advice: Advice) -> Iterator[Finding]:
    repeated = ~np.any(np.diff(imu.gyro_rad_s, axis=0) != 0.0, axis=1)
    runs = np.flatnonzero(np.diff(np.concatenate([[False], repeated, [False]]).astype(np.int8)))
    start, end = runs[::2], runs[1::2]
    if len(start) and not repeated.all():
        duration_s = (imu.t_ns[end] - imu.t_ns[start]) * 1e-9
        frozen = (duration_s >= STUCK_S) & (end - start >= MIN_SAMPLES)
        if frozen.any():
            longest = int(np.argmax(np.where(frozen, duration_s, 0.0)))
            yield Finding(
                Severity.WARNING,
                "imu",
                "gyro_stuck",
                f"the gyroscope repeats one value for {duration_s[frozen].sum():.1f} s in all, longest "
                f"{duration_s[longest]:.1f} s from {imu.t_ns[start[longest]]}: it hung there",
                "turns in these stretches are lost; check the logger",
            )
    if not np.any(np.diff(imu.gyro_rad_s[:, 2])) and not repeated.all():
        yield Finding(
            Severity.ERROR,
            "imu",
            "gyro_stuck",
            f"the gyroscope's z axis is {imu.gyro_rad_s[0, 2] + 0.0:g} rad/s in every row: it is stuck",
            advice.leave_out("imu"),
        )


def _accel_unit(gravity: Gravity, advice: Advice) -> Iterator[Finding]:
    """Determine the unit by the length of gravity, if there is gravity: vibration has no direction."""
    if not gravity.is_seen:
        if gravity.length < 0.5 * GRAVITY_M_S2:
            yield Finding(
                Severity.WARNING,
                "imu",
                "accel_without_gravity",
                f"the accelerometer shows no gravity, in the median {gravity.length:.2g} m/s^2: it was taken out",
                "give the raw accelerometer, else roll and pitch come from the attitude alone",
            )
        return
    length = float(np.linalg.norm(gravity.mean))
    if 0.6 * GRAVITY_M_S2 < length < 1.4 * GRAVITY_M_S2:
        return
    size = advice.taken.get("accel_unit", 1.0) * GRAVITY_M_S2 / length
    unit, is_known = unit_of_size(size, "g")
    remedy = advice.unit("imu", "accel_unit", unit, f"{GRAVITY_M_S2 / length:.4g}")
    text = f"gravity reads {length:.4g} instead of 9.81 m/s^2: the accelerometer"
    if is_known:
        yield Finding(Severity.ERROR, "imu", "accel_unit", f"{text} is in {unit_in_words(unit)}", remedy)
        return
    far = not 0.3 < length / GRAVITY_M_S2 < 3.0
    yield Finding(
        Severity.ERROR if far else Severity.WARNING,
        "imu",
        "accel_unit",
        f"{text} is in another unit" if far else f"{text}'s scale is off",
        remedy,
    )


def _scale(reading: Reading, advice: Advice) -> Iterator[Finding]:
    """Compare both rates: the gyroscope's is 57 times the attitude's if it is in degrees."""
    ratio = 1.0 / reading.scale
    if 0.6 < ratio < 1.6:
        return
    taken = advice.taken.get("gyro_unit", 1.0)
    unit, is_known = unit_of_size(taken / ratio, "deg/s")
    if not is_known:  # an attitude that lags or leads still gives the rate's magnitude roughly
        near = [name for name in ("deg/s", "mrad/s") if 0.7 < ratio * in_si(name) / taken < 1.3]
        unit, is_known = (near[0], True) if near else (unit, False)
    certain = is_known or not 0.2 < ratio < 5.0
    words = (
        f"in {unit_in_words(unit)}, not rad/s"
        if is_known and taken == 1.0
        else (f"in {unit_in_words(unit)}" if is_known else "in another unit")
    )
    yield Finding(
        Severity.ERROR if certain else Severity.WARNING,
        "imu",
        "gyro_unit",
        f"the gyroscope turns {ratio:.3g} times as fast as the attitude: it is {words}"
        if certain
        else f"the gyroscope turns {ratio:.3g} times as fast as the attitude",
        advice.unit("imu", "gyro_unit", unit, f"{in_si(unit) / taken:.6g}")
        if certain
        else "check the gyroscope's unit and scale, and the clocks of both",
    )


def _axes_by_attitude(
    as_taken: Reading, likeliest: Reading, gravity: Gravity | None, advice: Advice
) -> Iterator[Finding]:
    """Determine by gravity whose axes are wrong if gyroscope and attitude disagree."""
    evidence = f"correlation {as_taken.correlation:+.2f} as taken, {likeliest.correlation:+.2f} so"
    certain = as_taken.correlation < 0.5
    severity = Severity.ERROR if certain else Severity.WARNING
    down = gravity is not None and gravity.is_seen and gravity.direction[2] < -UPRIGHT
    up = gravity is not None and gravity.is_seen and gravity.direction[2] > UPRIGHT
    if likeliest.conjugated:
        yield Finding(
            severity,
            "attitude",
            "attitude_conjugated",
            "its quaternions turn against the gyroscope and agree with it conjugated: they take the world to the "
            f"body, {evidence}",
            advice.conjugated(),
        )
    elif np.array_equal(likeliest.axes, FLU) and up:
        yield Finding(
            severity,
            "imu",
            "imu_axes",
            f"gravity reads {_signed(gravity)} along z and the gyroscope's y and z turn against the attitude: "
            f"{advice.reversed_axes('imu')}, {evidence}",
            advice.frame("imu", "flu"),
        )
    elif np.array_equal(likeliest.axes, FLU) and down:
        yield Finding(
            severity,
            "attitude",
            "attitude_axes",
            "its pitch and yaw turn against the gyroscope, whose gravity is right: "
            f"{advice.reversed_axes('attitude')}, {evidence}",
            advice.frame("attitude", "enu"),
        )
    else:
        yield Finding(
            severity,
            "imu",
            "imu_axes",
            f"the gyroscope turns against the attitude; they agree with x, y, z of the IMU taken as "
            f"{_axes_in_words(likeliest.axes)}, {evidence}",
            "one of the two is wrong: turn the axes of the IMU, or of the attitude, into forward, right, down",
        )


def _gravity_sign(gravity: Gravity | None, advice: Advice, *, gyro_confirmed: bool) -> Iterator[Finding]:
    """At rest, body FRD, the accelerometer reads -9.8 along z."""
    if gravity is None or not gravity.is_seen or gravity.direction[2] < -UPRIGHT:
        return
    direction = gravity.direction
    axis = int(np.argmax(np.abs(direction)))
    if direction[2] > UPRIGHT:
        if gyro_confirmed:
            yield Finding(
                Severity.WARNING,
                "imu",
                "accel_sign",
                f"gravity reads {_signed(gravity)} along z though the gyroscope turns as the attitude does: the "
                "accelerometer gives gravity's pull, not the specific force",
                "set accel_sign = -1 in [imu.columns] of flight.toml, or negate the accelerometer",
            )
            return
        text = f"gravity reads {_signed(gravity)} along z instead of -9.8: {advice.reversed_axes('imu')}"
        remedy = advice.frame("imu", "flu")
        if advice.medium("imu") is not Medium.FOLDER:
            remedy += (
                "; if vision then turns the other way, only the accelerometer's sign is reversed: instead set "
                "accel_sign = -1 in [imu.columns]"
            )
        yield Finding(Severity.ERROR, "imu", "imu_axes", text, remedy)
    elif abs(direction[axis]) > UPRIGHT:
        yield Finding(
            Severity.ERROR,
            "imu",
            "imu_axes",
            f"gravity reads {gravity.mean[axis]:+.1f} along {'xyz'[axis]} instead of -9.8 along z: the "
            "IMU's axes are not the body's",
            advice.mounting("imu", direction),
        )
    else:
        yield Finding(
            Severity.WARNING,
            "imu",
            "imu_axes",
            f"gravity points {degrees(np.arccos(-direction[2])):.0f} degrees off the body's z axis, median over the "
            "log: the IMU is mounted at an angle or the vehicle lay on its side",
            advice.mounting("imu", direction),
        )


def _gyro_degrees(imu: ImuStream, gravity: Gravity | None, advice: Advice) -> Iterator[Finding]:
    """Without an attitude: rates beyond any gyroscope's range, or tilts that gravity does not follow."""
    speed = np.linalg.norm(imu.gyro_rad_s, axis=1)
    fastest, usual = float(np.percentile(speed, 99.0)), float(np.median(speed))
    text, severity, taken = None, Severity.ERROR, advice.taken.get("gyro_unit", 1.0)
    if fastest > GYRO_RANGE_RAD_S:
        text = f"one gyroscope sample in a hundred is beyond {fastest:.0f} rad/s, more than any measures"
    else:
        tilts = _tilts(imu) if gravity is not None and gravity.is_seen else None
        if tilts is not None and tilts[0] > 0.3 and tilts[1] < 0.15 * tilts[0]:
            text = (
                f"by the gyroscope the vehicle tilts {degrees(tilts[0]):.0f} degrees every {TILT_WINDOW_S:g} s, by "
                f"gravity {degrees(tilts[1]):.1f}"
            )
        elif usual > LIKELY_DEGREES:
            # A declared unit is certainly wrong; in a log, something may have spun.
            severity = Severity.WARNING if taken == 1.0 else Severity.ERROR
            text = f"the gyroscope reads {usual:.0f} rad/s half of the time"
    if text is None:
        return
    as_degrees = fastest < MAX_DEGREES and radians(usual) < LIKELY_DEGREES
    unit = "deg/s" if taken == 1.0 and as_degrees else "deg/s/16.4"
    words = {"deg/s": "degrees/s, not rad/s"}.get(unit, "counts of its sensor")
    remedy = advice.unit("imu", "gyro_unit", unit, f"{in_si(unit) / taken:.6g}")
    if unit != "deg/s":
        remedy += "; its data sheet gives the counts of one degree/s, 16.4 for a range of 2000"
    yield Finding(
        severity,
        "imu",
        "gyro_unit",
        f"{text}: it {'is' if severity is Severity.ERROR else 'may be'} in {words}",
        remedy,
    )


def _tilts(imu: ImuStream) -> tuple[float, float] | None:
    """Return the usual change of tilt in half a second, radians, by the gyroscope and by gravity."""
    t_s = (imu.t_ns - imu.t_ns[0]) * 1e-9
    window = np.floor(t_s / TILT_WINDOW_S).astype(np.int64)
    finite = np.isfinite(imu.accel_m_s2).all(axis=1)
    window, accel, gyro = window[finite], imu.accel_m_s2[finite], imu.gyro_rad_s[finite]
    starts = np.flatnonzero(np.diff(window, prepend=-1))
    if len(starts) < MIN_SAMPLES:
        return None
    count = np.diff(np.append(starts, len(window)))[:, None]
    force, rate = np.add.reduceat(accel, starts) / count, np.add.reduceat(gyro, starts) / count
    force /= np.maximum(np.linalg.norm(force, axis=1, keepdims=True), 1e-9)
    follow = np.diff(window[starts]) == 1
    turn = 0.5 * (rate[1:] + rate[:-1]) * TILT_WINDOW_S
    by_gyro = np.cross(turn, force[:-1])[follow]
    by_gravity = (force[1:] - force[:-1])[follow]
    if len(by_gyro) < MIN_SAMPLES:
        return None
    return _typical_length(by_gyro), _typical_length(by_gravity)


def _typical_length(vectors: FloatArray) -> float:
    return float(np.sqrt(np.median(np.sum(vectors**2, axis=1))))


def _signed(gravity: Gravity | None) -> str:
    return "" if gravity is None else f"{gravity.mean[2]:+.1f}"


def _axes_in_words(axes: FloatArray) -> str:
    """Return the IMU's axis along each of the body's, such as ``x, -y, -z``."""
    words = []
    for row in axes:
        axis = int(np.argmax(np.abs(row)))
        words.append(("-" if row[axis] < 0.0 else "") + "xyz"[axis])
    return ", ".join(words)
