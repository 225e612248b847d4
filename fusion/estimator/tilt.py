"""Roll and pitch at any time: takes gyroscope, accelerometer and attitude, whichever there are, returns a new `Tilt`.

The tilt is carried as the direction of gravity in the body frame, which has no singularity and turns with the
gyroscope. It is set by the attitude stream while there is one; otherwise it is a complementary filter of gyroscope
and accelerometer (R. Mahony, T. Hamel, J.-M. Pflimlin, "Nonlinear complementary filters on the special orthogonal
group", IEEE Transactions on Automatic Control 53(5), 2008, with gravity as the only reference); with neither it
leaks towards level, with a large standard deviation.
"""

from __future__ import annotations

from math import asin, atan2, hypot, radians, sqrt
from typing import NamedTuple

from fusion.estimator.kernels import Quaternion, Vector, corrected_down, turned_down
from vision.measurement import Attitude
from vision.rotations import down_of_quaternion

GRAVITY_M_S2 = 9.80665
ATTITUDE_GAP_S = 0.5  # an attitude stream silent for longer no longer sets the tilt
COMPLEMENTARY_STD_RAD = radians(1.5)
LEVEL_STD_RAD = radians(6.0)
HELD_RATE_STD_RAD_S = 0.2  # how fast the tilt wanders between attitude samples without a gyroscope
ACCEL_GAIN_1_S = 0.4
ACCEL_BIAS_GAIN_1_S2 = 0.04
START_GAIN_1_S = 5.0  # settles within a second on the first accelerometer samples
START_S = 1.0
LEVEL_LEAK_1_S = 0.2
ACCEL_TOLERANCE = 0.15  # |accel| / g - 1 at which the accelerometer no longer shows gravity


class Tilt(NamedTuple):
    """Direction of gravity in the body frame, and where it comes from.

    Parameters
    ----------
    down
        Unit vector, body FRD.
    t_ns
        Time it is valid for; None before any sample.
    t_attitude_ns, t_gyro_ns, t_accel_ns
        Last sample of each kind; None before the first.
    settled_s
        Time over which the accelerometer has been used.
    gyro_bias
        Bias that the complementary filter has learned, rad/s.
    """

    down: Vector = (0.0, 0.0, 1.0)
    t_ns: int | None = None
    t_attitude_ns: int | None = None
    t_gyro_ns: int | None = None
    t_accel_ns: int | None = None
    settled_s: float = 0.0
    gyro_bias: Vector = (0.0, 0.0, 0.0)

    def clock_set_back(self, t_ns: int) -> Tilt:
        """Keep the direction, valid from an earlier time on, and forget when samples came."""
        return self._replace(t_ns=t_ns, t_attitude_ns=None, t_gyro_ns=None, t_accel_ns=None)


def from_quaternion(tilt: Tilt, t_ns: int, q_world_body: Quaternion) -> Tilt:
    """Take the tilt from an attitude sample: a unit quaternion w, x, y, z, body FRD to a world with z down."""
    return tilt._replace(down=_unit(down_of_quaternion(q_world_body)), t_ns=t_ns, t_attitude_ns=t_ns)


def with_imu(tilt: Tilt, t_ns: int, gyro_rad_s: Vector, accel_m_s2: Vector | None) -> Tilt:
    """Turn with the gyroscope up to ``t_ns`` and correct by the accelerometer where no attitude stream does.

    ``gyro_rad_s`` is the mean rate since the last step, body FRD; ``accel_m_s2`` the specific force, about
    (0, 0, -9.81) at rest and level, or None.
    """
    down, last_ns, t_attitude, _, t_accel, settled, bias = tilt
    dt = 0.0 if last_ns is None else min(max((t_ns - last_ns) * 1e-9, 0.0), 0.2)
    if t_attitude is not None and (t_ns - t_attitude) * 1e-9 <= ATTITUDE_GAP_S:
        return Tilt(turned_down(down, gyro_rad_s, dt), t_ns, t_attitude, t_ns, t_accel, settled, bias)
    if accel_m_s2 is not None:
        ax, ay, az = accel_m_s2
        length = sqrt(ax * ax + ay * ay + az * az)
        trust = 1.0 - abs(length / GRAVITY_M_S2 - 1.0) / ACCEL_TOLERANCE
        if trust > 0.0:
            if t_accel is None and t_attitude is None:
                down = (-ax / length, -ay / length, -az / length)
            gains = (ACCEL_GAIN_1_S, ACCEL_BIAS_GAIN_1_S2) if settled >= START_S else (START_GAIN_1_S, 0.0)
            down, bias = corrected_down(
                down, bias, gyro_rad_s, dt, accel_m_s2, trust * gains[0], trust * gains[1]
            )
            return Tilt(down, t_ns, t_attitude, t_ns, t_ns, settled + dt, bias)
    p, q, r = gyro_rad_s
    bx, by, bz = bias
    p, q, r = p - bx, q - by, r - bz
    if accel_m_s2 is None and (t_accel is None or (t_ns - t_accel) * 1e-9 > ATTITUDE_GAP_S):
        p, q = p - LEVEL_LEAK_1_S * down[1], q + LEVEL_LEAK_1_S * down[0]  # estimate x (0, 0, 1)
    return Tilt(turned_down(down, (p, q, r), dt), t_ns, t_attitude, t_ns, t_accel, settled, bias)


def attitude_at(tilt: Tilt, t_ns: int, attitude_std_rad: float) -> Attitude | None:
    """Roll and pitch for a frame at ``t_ns``, not before the last sample; None where nothing was ever measured.

    The standard deviation is that of the source: the attitude stream's, growing with its age where no gyroscope
    carries it on; that of the complementary filter; or that of assuming level flight.
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
