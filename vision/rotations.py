"""Roll, pitch and yaw of rotations: Z-Y-X Euler angles of a body FRD in a world whose z points down, radians.

Quaternions are (w, x, y, z), of unit length, and take vectors in the body to the world.
"""

from __future__ import annotations

from math import atan2

import numpy as np

from vision.measurement import FloatArray


def yaw_of_quaternion(q_world_body: tuple[float, float, float, float]) -> float:
    """Yaw of one quaternion, positive right, in [-pi, pi]."""
    w, x, y, z = q_world_body
    return atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def down_of_quaternion(q_world_body: tuple[float, float, float, float]) -> tuple[float, float, float]:
    """Direction of the world's z axis, gravity, in the body: third row of the rotation matrix."""
    w, x, y, z = q_world_body
    return 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)


def euler_of_quaternions(q_world_body: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Roll, pitch and yaw (...,) of quaternions (..., 4); pitch in [-pi/2, pi/2]."""
    w, x, y, z = np.moveaxis(np.asarray(q_world_body, dtype=float), -1, 0)
    roll = np.arctan2(2 * (y * z + w * x), 1 - 2 * (x * x + y * y))
    pitch = np.arcsin(np.clip(2 * (w * y - x * z), -1.0, 1.0))
    yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return roll, pitch, yaw


def rotation_of_euler(roll_rad: float, pitch_rad: float, yaw_rad: float) -> FloatArray:
    """Rotation matrix R_world_body (3, 3) of Euler angles."""
    (cr, sr), (cp, sp), (cy, sy) = ((np.cos(a), np.sin(a)) for a in (roll_rad, pitch_rad, yaw_rad))
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )
