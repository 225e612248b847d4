"""MAVLink messages as samples for the estimator: SI units, body FRD, time by the autopilot's clock.

The messages are those of https://mavlink.io/en/messages/common.html. An unusable message, such as from a distance
sensor that looks ahead, gives None.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from fusion.logs.autopilot.table import DOWNWARD
from fusion.logs.autopilot.tlog import ACCEL_UPDATED, GYRO_UPDATED, INVALID_SIGNAL, SCALES
from fusion.logs.series import into_body, quaternions

ARDUPILOT = 3  # MAV_AUTOPILOT_ARDUPILOTMEGA
MAX_ANGLE_RAD = 100.0  # of roll, pitch and yaw in a message that is not damaged

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]


class Imu(NamedTuple):
    """Angular rate, rad/s, and specific force, m/s^2, if the message has a new one; body FRD."""

    stamp_ns: int
    gyro_rad_s: Vector
    accel_m_s2: Vector | None


class Orientation(NamedTuple):
    """Attitude: unit quaternion w x y z, body FRD to NED."""

    stamp_ns: int
    q_world_body: Quaternion


class Distance(NamedTuple):
    """Distance to the floor, metres."""

    stamp_ns: int
    distance_m: float


class Velocity(NamedTuple):
    """Velocity in the body FRD, m/s."""

    stamp_ns: int
    v_body_m_s: Vector


def imu_of(message: Any, autopilot: int) -> Imu | None:
    """Read an IMU message.

    ``RAW_IMU`` is defined as raw sensor counts. It is read only from ArduPilot, which sends thousandths of g and
    rad/s.
    """
    kind = message.get_type()
    if kind == "HIGHRES_IMU":
        fresh = int(message.fields_updated)
        if fresh and fresh & GYRO_UPDATED != GYRO_UPDATED:
            return None
        accel = (message.xacc, message.yacc, message.zacc)
        is_fresh = not fresh or fresh & ACCEL_UPDATED == ACCEL_UPDATED
        gyro = (message.xgyro, message.ygyro, message.zgyro)
        return Imu(message.time_usec * 1000, gyro, accel if is_fresh else None)
    if kind == "RAW_IMU" and autopilot != ARDUPILOT:
        return None
    rate, force = SCALES["mrad/s"], SCALES["mG"]
    return Imu(
        message.time_usec * 1000 if kind == "RAW_IMU" else message.time_boot_ms * 1_000_000,
        (message.xgyro * rate, message.ygyro * rate, message.zgyro * rate),
        (message.xacc * force, message.yacc * force, message.zacc * force),
    )


def attitude_of(message: Any) -> Orientation | None:
    """Read an attitude message; the estimator counts and ignores invalid quaternions."""
    stamp_ns = message.time_boot_ms * 1_000_000
    if message.get_type() == "ATTITUDE_QUATERNION":
        return Orientation(stamp_ns, (message.q1, message.q2, message.q3, message.q4))
    angles = (message.roll, message.pitch, message.yaw)
    if not all(abs(angle) < MAX_ANGLE_RAD for angle in angles):  # NaN fails too
        return None
    w, x, y, z = quaternions(*np.array([angles]).T)[0].tolist()
    return Orientation(stamp_ns, (w, x, y, z))


def range_of(message: Any) -> Distance | None:
    """Read a distance to the floor, within what the sensor can measure."""
    reading_cm = message.current_distance
    trusted = message.orientation == DOWNWARD and message.signal_quality != INVALID_SIGNAL
    if not trusted or not message.min_distance <= reading_cm < message.max_distance:
        return None
    return Distance(message.time_boot_ms * 1_000_000, reading_cm * 0.01)


def velocity_of(message: Any, q_world_body: Quaternion) -> Velocity:
    """Read ``LOCAL_POSITION_NED``'s velocity, rotated into the body by an attitude."""
    v_world = np.array([[message.vx, message.vy, message.vz]])
    x, y, z = into_body(np.array([q_world_body]), v_world)[0].tolist()
    return Velocity(message.time_boot_ms * 1_000_000, (x, y, z))
