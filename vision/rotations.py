"""Angles and rotations used by both packages: wrapping, yaw of a quaternion, rotation from Euler angles.

Quaternions are (w, x, y, z) and rotate body vectors to world vectors. Euler angles are aerospace Z-Y-X: yaw, then
pitch, then roll, right-handed about each axis; with z down, yaw is positive to the right.
"""

from __future__ import annotations

from math import atan2, cos, pi, sin
from typing import overload

import numpy as np
import numpy.typing as npt

from vision.types import FloatArray


@overload
def wrap(angle_rad: float) -> float: ...
@overload
def wrap(angle_rad: FloatArray) -> FloatArray: ...
def wrap(angle_rad: float | FloatArray) -> float | FloatArray:
    """Wrap an angle, or an array of angles, to [-pi, pi)."""
    return (angle_rad + pi) % (2 * pi) - pi


@overload
def wrap_axis(angle_rad: float) -> float: ...
@overload
def wrap_axis(angle_rad: FloatArray) -> FloatArray: ...
def wrap_axis(angle_rad: float | FloatArray) -> float | FloatArray:
    """Wrap the angle of an undirected axis, such as a corridor's, to [-pi/2, pi/2)."""
    return (angle_rad + 0.5 * pi) % pi - 0.5 * pi


def yaw_of(q: npt.ArrayLike) -> FloatArray:
    """Return the yaw (...,) of unit quaternions (..., 4), w x y z, in (-pi, pi]."""
    w, x, y, z = np.moveaxis(np.asarray(q, dtype=np.float64), -1, 0)
    return np.asarray(np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))


def yaw_of_quaternion(q_world_body: tuple[float, float, float, float]) -> float:
    """Return the yaw of one unit quaternion, in [-pi, pi]: `yaw_of` without numpy, for use in flight."""
    w, x, y, z = q_world_body
    return atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def down_of(q: npt.ArrayLike) -> FloatArray:
    """Return the direction (..., 3) of the world's z axis in the body of unit quaternions (..., 4), w x y z."""
    w, x, y, z = np.moveaxis(np.asarray(q, dtype=np.float64), -1, 0)
    return np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], axis=-1)


def down_of_quaternion(q_world_body: tuple[float, float, float, float]) -> tuple[float, float, float]:
    """Return the world's z axis in the body by one unit quaternion: `down_of` without numpy, for use in flight."""
    w, x, y, z = q_world_body
    return 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)


def rotation_from_angles(yaw_rad: float, pitch_rad: float, roll_rad: float) -> FloatArray:
    """Return the rotation (3, 3) from body to world of Z-Y-X Euler angles.

    Parameters
    ----------
    yaw_rad, pitch_rad, roll_rad
        Rotations in this order about z, the new y and the new x.
    """
    cr, cp, cy = cos(roll_rad), cos(pitch_rad), cos(yaw_rad)
    sr, sp, sy = sin(roll_rad), sin(pitch_rad), sin(yaw_rad)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )
