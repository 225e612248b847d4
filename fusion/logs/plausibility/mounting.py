"""Corrects streams of sensors whose mounting differs from their declared axes.

``mount_rad`` is the sensor's roll, pitch and yaw on the body: roll right side down, pitch nose up, yaw to the right,
applied in the order yaw, pitch, roll (``R_body_sensor = Rz Ry Rx`` in FRD). A sensor mounted upside down has
``[3.1416, 0, 0]``; so has an IMU whose log is in FLU although its reader assumes FRD.
"""

from __future__ import annotations

from dataclasses import replace
from math import cos, sin
from typing import Any, TypeVar, cast

import numpy as np

from fusion.flight import AttitudeStream, FloatArray, ImuStream, RangeStream
from fusion.logs.manifest.manifest import RangeSource, SensorSource, StreamSource

AnyStream = TypeVar("AnyStream", bound=Any)
MountRad = tuple[float, float, float]


def mounted(stream: AnyStream, source: StreamSource) -> AnyStream:
    """Return a stream along the body's axes, by the mounting in its table of a manifest.

    Distances to the floor are then measured from the camera's height.
    """
    if isinstance(stream, RangeStream) and isinstance(source, RangeSource) and source.above_camera_m:
        lowered: Any = replace(stream, distance_m=stream.distance_m - source.above_camera_m)
        return cast(AnyStream, lowered)
    if not isinstance(source, SensorSource) or source.mount_rad is None:
        return stream
    mount_rad = source.mount_rad
    turned: Any = stream
    if isinstance(stream, ImuStream):
        turned = mounted_imu(stream, mount_rad)
    elif isinstance(stream, AttitudeStream):
        turned = mounted_attitude(stream, mount_rad)
    result: AnyStream = turned
    return result


def mounted_imu(imu: ImuStream, mount_rad: MountRad) -> ImuStream:
    """Return an IMU's readings along the body's axes."""
    R_body_sensor = rotation(mount_rad)
    return replace(
        imu, gyro_rad_s=imu.gyro_rad_s @ R_body_sensor.T, accel_m_s2=imu.accel_m_s2 @ R_body_sensor.T
    )


def mounted_attitude(attitude: AttitudeStream, mount_rad: MountRad) -> AttitudeStream:
    """Return the body's attitude, from that of a sensor on it."""
    w0, v0 = attitude.q_world_body[:, :1], attitude.q_world_body[:, 1:]
    (w1, *vector) = _quaternion(mount_rad)
    v1 = -np.array(vector)  # inverse: world from sensor, sensor from body
    w = w0 * w1 - (v0 @ v1)[:, None]
    return replace(attitude, q_world_body=np.hstack([w, w0 * v1 + w1 * v0 + np.cross(v0, v1)]))


def rotation(mount_rad: MountRad) -> FloatArray:
    """Rotation (3, 3) from the sensor's axes to the body's, both FRD."""
    w, x, y, z = _quaternion(mount_rad)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def _quaternion(mount_rad: MountRad) -> tuple[float, float, float, float]:
    """Quaternion w, x, y, z of roll, pitch and yaw."""
    (cr, sr), (cp, sp), (cy, sy) = ((cos(angle / 2.0), sin(angle / 2.0)) for angle in mount_rad)
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )
