"""Roll and pitch from gyroscope, accelerometer and attitude, whichever are available.

The tilt is represented by the direction of gravity g in the body frame (a unit vector), which has no singularity. Its
kinematics are ``g' = g x omega``.

- With an attitude stream that follows the gyroscope (`fusion.estimator.tilt_check`), each sample sets g, and the
  gyroscope propagates it between samples.
- Otherwise a complementary filter of gyroscope and accelerometer (R. Mahony, T. Hamel, J.-M. Pflimlin, "Nonlinear
  complementary filters on the special orthogonal group", IEEE Transactions on Automatic Control 53(5), 2008, with
  gravity as the only reference): ``g' = g x (omega - b - k e)``, ``b' = k_b e``, with the error e the cross product
  of g and the measured direction. Both gains decrease to zero as the force deviates from 1 g by `ACCEL_TOLERANCE`.
- Without both, g decays towards level, with a large standard deviation.
"""

from __future__ import annotations

from functools import cache
from math import asin, atan2, hypot, inf, radians, sqrt
from typing import NamedTuple

import numpy as np

from fusion.estimator.kernels import NO_FORCE, FloatArray, Quaternion, Vector, corrected_down, turned_down
from fusion.estimator.records import new_record
from fusion.estimator.tilt_check import UNKNOWN_DOWN, TiltCheck
from fusion.flight import TimeArray
from vision.compiled import compiled
from vision.measurement import Attitude
from vision.rotations import down_of, down_of_quaternion

GRAVITY_M_S2 = 9.80665
ATTITUDE_GAP_S = 0.5  # an attitude stream that is silent for longer no longer sets the tilt
COMPLEMENTARY_STD_RAD = radians(1.5)
LEVEL_STD_RAD = radians(6.0)
HELD_RATE_STD_RAD_S = 0.2  # unknown rate of the tilt between attitude samples without a gyroscope
ACCEL_GAIN_1_S = 0.4
ACCEL_BIAS_GAIN_1_S2 = 0.04
START_GAIN_1_S = 5.0  # initial gain: settles within a second
START_S = 1.0
LEVEL_LEAK_1_S = 0.2
MAX_STEP_S = 0.2  # longest time for which a rate is held
ACCEL_TOLERANCE = 0.15  # | |accel| / g - 1 | at which the accelerometer is no longer used


class Tilt(NamedTuple):
    """Direction of gravity in the body frame, and its sources.

    Parameters
    ----------
    down
        Unit vector, body FRD.
    t_ns
        Time it is valid for; None before any sample.
    t_attitude_ns, t_gyro_ns, t_accel_ns
        Last sample of each kind; None before the first.
    settled_s
        Time over which the accelerometer has been used; an attitude needs no start.
    gyro_bias
        Gyroscope bias estimated by the complementary filter, rad/s.
    turned
        The attitude's direction of gravity at the start of the check's span, turned by the gyroscope since; NaN if
        unknown.
    check
        Whether the attitude follows the gyroscope.
    """

    down: Vector = (0.0, 0.0, 1.0)
    t_ns: int | None = None
    t_attitude_ns: int | None = None
    t_gyro_ns: int | None = None
    t_accel_ns: int | None = None
    settled_s: float = 0.0
    gyro_bias: Vector = (0.0, 0.0, 0.0)
    turned: Vector = UNKNOWN_DOWN
    check: TiltCheck = TiltCheck()

    @property
    def follows_force(self) -> bool:
        """Whether there is no recent attitude, so that the accelerometer corrects the direction."""
        then_ns, now_ns = self.t_attitude_ns, self.t_ns
        return then_ns is None or now_ns is None or (now_ns - then_ns) * 1e-9 > ATTITUDE_GAP_S

    def clock_set_back(self, t_ns: int) -> Tilt:
        """Keep the direction, valid from an earlier time on, and forget the times of the samples."""
        return self._replace(
            t_ns=t_ns, t_attitude_ns=None, t_gyro_ns=None, t_accel_ns=None, turned=UNKNOWN_DOWN
        )


def from_quaternion(tilt: Tilt, t_ns: int, q_world_body: Quaternion) -> Tilt:
    """Set the tilt from an attitude sample, unless it does not follow the gyroscope.

    ``q_world_body`` is a unit quaternion w, x, y, z, body FRD to a world with z down.
    """
    _, _, _, t_gyro, t_accel, _, bias, turned, check = tilt
    down = attitude_down(q_world_body)
    if check.ends_span(t_ns):
        was_wrong, check = check.is_wrong, check.with_span(t_ns, down, turned)
        turned = down
        if check.is_wrong and not was_wrong:  # start from the accelerometer
            tilt = tilt._replace(t_attitude_ns=None, t_accel_ns=None, settled_s=0.0)
    if check.is_wrong:
        return tilt._replace(turned=turned, check=check)
    return new_record(Tilt, (down, t_ns, t_ns, t_gyro, t_accel, START_S, bias, turned, check))


def attitude_down(q_world_body: Quaternion) -> Vector:
    """Return the direction of gravity in the body by an attitude: a unit vector."""
    return _unit(down_of_quaternion(q_world_body))


def with_imu(tilt: Tilt, t_ns: int, gyro_rad_s: Vector, accel_m_s2: Vector | None) -> Tilt:
    """Propagate by the gyroscope to ``t_ns``, and correct by the accelerometer if there is no attitude stream.

    ``gyro_rad_s`` is the mean rate since the last step, body FRD; ``accel_m_s2`` the specific force, about
    (0, 0, -9.81) at rest and level, or None.
    """
    down, last_ns, t_attitude, t_gyro, t_accel, settled, bias, turned, check = tilt
    dt = 0.0 if last_ns is None else min(max((t_ns - last_ns) * 1e-9, 0.0), MAX_STEP_S)
    ages = (
        inf if t_attitude is None else (t_ns - t_attitude) * 1e-9,
        inf if t_accel is None else (t_ns - t_accel) * 1e-9,
    )
    down, bias, settled, used = tilt_step(down, bias, settled, dt, gyro_rad_s, accel_m_s2 or NO_FORCE, ages)
    if t_gyro is not None:
        turned = turned_by_gyro(turned, gyro_rad_s, (t_ns - t_gyro) * 1e-9)
    t_accel = t_ns if used else t_accel
    return new_record(Tilt, (down, t_ns, t_attitude, t_ns, t_accel, settled, bias, turned, check))


@compiled
def tilt_step(
    down: Vector,
    bias: Vector,
    settled_s: float,
    dt: float,
    rate: Vector,
    force: Vector,
    ages_s: tuple[float, float],
) -> tuple[Vector, Vector, float, bool]:
    """Return gravity's direction, gyroscope bias, time settled, and whether the force was used; see `with_imu`.

    ``force`` is NaN without a sample; ``ages_s`` are those of the last attitude and the last force used, infinite
    before the first.
    """
    attitude_age_s, force_age_s = ages_s
    if attitude_age_s <= ATTITUDE_GAP_S:
        return turned_down(down, rate, dt), bias, settled_s, False
    ax, ay, az = force
    length = sqrt(ax * ax + ay * ay + az * az)
    trust = 1.0 - abs(length / GRAVITY_M_S2 - 1.0) / ACCEL_TOLERANCE
    if trust > 0.0:
        if force_age_s == inf and attitude_age_s == inf:
            down = (-ax / length, -ay / length, -az / length)
        gain, bias_gain = START_GAIN_1_S, 0.0
        if settled_s >= START_S:
            gain, bias_gain = ACCEL_GAIN_1_S, ACCEL_BIAS_GAIN_1_S2
        down, bias = corrected_down(down, bias, rate, dt, force, trust * gain, trust * bias_gain)
        return down, bias, settled_s + dt, True
    p, q, r = rate
    bx, by, bz = bias
    p, q, r = p - bx, q - by, r - bz
    if length != length and force_age_s > ATTITUDE_GAP_S:  # NaN: there is none
        p, q = p - LEVEL_LEAK_1_S * down[1], q + LEVEL_LEAK_1_S * down[0]  # estimate x (0, 0, 1)
    return turned_down(down, (p, q, r), dt), bias, settled_s, False


@compiled
def turned_by_gyro(down: Vector, rate: Vector, dt: float) -> Vector:
    """Return a direction turned by the gyroscope; NaN after a gap."""
    return turned_down(down, rate, dt) if 0.0 <= dt <= MAX_STEP_S else UNKNOWN_DOWN


@cache
def compile_tilt() -> None:
    """Compile the filter step, or load it from the cache, before the first sample."""
    with_imu(with_imu(Tilt(), 0, (0.0, 0.0, 0.0), None), 0, (0.0, 0.0, 0.0), None)


def tilt_along(
    t_ns: TimeArray,
    gyro_rad_s: FloatArray,
    accel_m_s2: FloatArray,
    attitude_t_ns: TimeArray,
    q_world_body: FloatArray,
    attitude_std_rad: float,
) -> tuple[FloatArray, FloatArray]:
    """Return the tilt at every sample of a log, as `with_imu` and `from_quaternion` compute it.

    The attitude is not checked against the gyroscope.

    Parameters
    ----------
    t_ns, gyro_rad_s, accel_m_s2
        Times (n,), rates (n, 3) and specific forces (n, 3); rows without a force are NaN.
    attitude_t_ns, q_world_body
        Times (m,) and unit quaternions (m, 4) of the attitude stream; an attitude is used from the first IMU sample
        after it.
    attitude_std_rad
        Standard deviation of its roll and pitch.

    Returns
    -------
    down, std_rad
        Direction of gravity in the body (n, 3), and the standard deviation of roll and pitch (n,).
    """
    down, std_rad = np.empty((len(t_ns), 3)), np.empty(len(t_ns))
    downs = down_of(q_world_body)
    downs /= np.sqrt((downs**2).sum(axis=1, keepdims=True))
    _fill_tilts(t_ns, gyro_rad_s, accel_m_s2, attitude_t_ns, downs, attitude_std_rad, down, std_rad)
    return down, std_rad


@compiled
def _fill_tilts(
    t_ns: TimeArray,
    gyro: FloatArray,
    accel: FloatArray,
    attitude_t_ns: TimeArray,
    attitude_down: FloatArray,
    attitude_std_rad: float,
    down_out: FloatArray,
    std_out: FloatArray,
) -> None:
    down, bias, settled_s = (0.0, 0.0, 1.0), (0.0, 0.0, 0.0), 0.0
    attitude, last_ns, force_ns = -1, t_ns[0], t_ns[0]
    has_force = False
    last = (gyro[0, 0], gyro[0, 1], gyro[0, 2])
    for k in range(len(t_ns)):
        now_ns = t_ns[k]
        while attitude + 1 < len(attitude_t_ns) and attitude_t_ns[attitude + 1] < now_ns:
            attitude += 1
            last_ns = attitude_t_ns[attitude]
            down = (attitude_down[attitude, 0], attitude_down[attitude, 1], attitude_down[attitude, 2])
            settled_s = START_S
        dt = min(max((now_ns - last_ns) * 1e-9, 0.0), MAX_STEP_S)
        attitude_age_s = inf if attitude < 0 else (now_ns - attitude_t_ns[attitude]) * 1e-9
        force_age_s = (now_ns - force_ns) * 1e-9 if has_force else inf
        now = (gyro[k, 0], gyro[k, 1], gyro[k, 2])
        rate = (0.5 * (last[0] + now[0]), 0.5 * (last[1] + now[1]), 0.5 * (last[2] + now[2]))
        force = (accel[k, 0], accel[k, 1], accel[k, 2])
        down, bias, settled_s, used = tilt_step(
            down, bias, settled_s, dt, rate, force, (attitude_age_s, force_age_s)
        )
        if used:
            force_ns, has_force, force_age_s = now_ns, True, 0.0
        last_ns, last = now_ns, now
        for i in range(3):
            down_out[k, i] = down[i]
        if attitude_age_s <= ATTITUDE_GAP_S:
            std_out[k] = min(attitude_std_rad, LEVEL_STD_RAD)
        else:
            std_out[k] = COMPLEMENTARY_STD_RAD if force_age_s <= ATTITUDE_GAP_S else LEVEL_STD_RAD


def attitude_at(tilt: Tilt, t_ns: int, attitude_std_rad: float) -> Attitude | None:
    """Return roll and pitch for a frame at ``t_ns``, not before the last sample; None before any measurement.

    The standard deviation depends on the source: that of the attitude stream, growing with its age if no gyroscope
    propagates it; that of the complementary filter; or that of assuming level flight.
    """
    if tilt.t_ns is None:
        return None
    std = LEVEL_STD_RAD
    if tilt.t_attitude_ns is not None and (t_ns - tilt.t_attitude_ns) * 1e-9 <= ATTITUDE_GAP_S:
        last = max(tilt.t_attitude_ns, tilt.t_gyro_ns or tilt.t_attitude_ns)
        std = min(hypot(attitude_std_rad, HELD_RATE_STD_RAD_S * (t_ns - last) * 1e-9), LEVEL_STD_RAD)
    elif tilt.t_accel_ns is not None and (t_ns - tilt.t_accel_ns) * 1e-9 <= ATTITUDE_GAP_S:
        std = COMPLEMENTARY_STD_RAD
    gx, gy, gz = tilt.down
    return Attitude(roll_rad=atan2(gy, gz), pitch_rad=-asin(max(-1.0, min(1.0, gx))), std_rad=std)


def _unit(v: Vector) -> Vector:
    x, y, z = v
    length = sqrt(x * x + y * y + z * z)
    return x / length, y / length, z / length
