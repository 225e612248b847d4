"""Roll and pitch at any time, from whatever the log has.

The tilt is carried as the direction of gravity in the body frame, which has no singularity and turns with the
gyroscope. It is set by the attitude stream while there is one; otherwise it is a complementary filter of gyroscope
and accelerometer (R. Mahony, T. Hamel, J.-M. Pflimlin, "Nonlinear complementary filters on the special orthogonal
group", IEEE Transactions on Automatic Control 53(5), 2008, with gravity as the only reference); with neither it
leaks towards level, with a large standard deviation.

All values are immutable; each function returns a new `Tilt`.
"""

from __future__ import annotations

from math import asin, atan2, hypot, radians, sqrt
from typing import NamedTuple

from vision.measurement import Attitude

Vector = tuple[float, float, float]

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


def from_quaternion(tilt: Tilt, t_ns: int, q_world_body: tuple[float, float, float, float]) -> Tilt:
    """Take the tilt from an attitude sample: a unit quaternion w, x, y, z, body FRD to a world with z down."""
    w, x, y, z = q_world_body
    # Third row of the rotation matrix: the world's z axis seen from the body.
    down = (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y))
    return tilt._replace(down=_unit(down), t_ns=t_ns, t_attitude_ns=t_ns)


def with_imu(tilt: Tilt, t_ns: int, gyro_rad_s: Vector, accel_m_s2: Vector | None) -> Tilt:
    """Turn with the gyroscope up to ``t_ns`` and correct by the accelerometer where no attitude stream does.

    ``gyro_rad_s`` is the mean rate since the last step, body FRD; ``accel_m_s2`` the specific force, about
    (0, 0, -9.81) at rest and level, or None.
    """
    dt = 0.0 if tilt.t_ns is None else min(max((t_ns - tilt.t_ns) * 1e-9, 0.0), 0.2)
    p, q, r = gyro_rad_s
    gx, gy, gz = tilt.down
    bx, by, bz = tilt.gyro_bias
    t_accel, settled = tilt.t_accel_ns, tilt.settled_s
    t_attitude = tilt.t_attitude_ns
    if t_attitude is None or (t_ns - t_attitude) * 1e-9 > ATTITUDE_GAP_S:
        if accel_m_s2 is not None:
            ax, ay, az = accel_m_s2
            length = sqrt(ax * ax + ay * ay + az * az)
            trust = 1.0 - abs(length / GRAVITY_M_S2 - 1.0) / ACCEL_TOLERANCE
            if trust > 0.0:
                if t_accel is None and t_attitude is None:
                    gx, gy, gz = -ax / length, -ay / length, -az / length
                # Rotation that takes the estimate to the measurement: estimate x measured.
                ex, ey, ez = (
                    (gz * ay - gy * az) / length,
                    (gx * az - gz * ax) / length,
                    (gy * ax - gx * ay) / length,
                )
                gain = trust * (START_GAIN_1_S if settled < START_S else ACCEL_GAIN_1_S)
                step = trust * ACCEL_BIAS_GAIN_1_S2 * dt if settled >= START_S else 0.0
                bx, by, bz = bx + step * ex, by + step * ey, bz + step * ez
                p, q, r = p - gain * ex, q - gain * ey, r - gain * ez
                t_accel, settled = t_ns, settled + dt
        elif t_accel is None or (t_ns - t_accel) * 1e-9 > ATTITUDE_GAP_S:
            # Towards level: estimate x (0, 0, 1).
            p, q = p - LEVEL_LEAK_1_S * gy, q + LEVEL_LEAK_1_S * gx
        p, q, r = p - bx, q - by, r - bz
    ux, uy, uz = p * dt, q * dt, r * dt
    # down' = down x rate, to second order in the angle turned.
    sx, sy, sz = gy * uz - gz * uy, gz * ux - gx * uz, gx * uy - gy * ux
    gx += sx + 0.5 * (sy * uz - sz * uy)
    gy += sy + 0.5 * (sz * ux - sx * uz)
    gz += sz + 0.5 * (sx * uy - sy * ux)
    return Tilt(_unit((gx, gy, gz)), t_ns, t_attitude, t_ns, t_accel, settled, (bx, by, bz))


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
