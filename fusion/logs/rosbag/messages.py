"""ROS messages as numbers: stamps, inertial samples, poses, velocities, calibrations; from REP 103 and 105 to FRD.

ROS has bodies x forward, y left, z up and worlds with z up; both are rotated by half a turn about x. Only message
types of fixed layout are decoded here, without rosbags, because a flight has millions of them; rosbags decodes
pictures.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from math import nan

from fusion.logs.rosbag.frames import Mount
from vision import Camera, InputError
from vision.cameras.camera import Distortion
from vision.cameras.lens_check import refuse_fisheye_numbers

HALF_TURN_X = (1.0, -1.0, -1.0)
NO_DATA = -1.0  # first covariance of a missing part of sensor_msgs/Imu

_NAN3 = (nan, nan, nan)
_NAN4 = (nan, nan, nan, nan)


class RosType(StrEnum):
    """Message types that are read."""

    IMU = "sensor_msgs/msg/Imu"
    IMAGE = "sensor_msgs/msg/Image"
    COMPRESSED = "sensor_msgs/msg/CompressedImage"
    CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
    ODOMETRY = "nav_msgs/msg/Odometry"
    POSE = "geometry_msgs/msg/PoseStamped"
    POSE_COVARIANCE = "geometry_msgs/msg/PoseWithCovarianceStamped"
    TWIST = "geometry_msgs/msg/TwistStamped"
    TWIST_COVARIANCE = "geometry_msgs/msg/TwistWithCovarianceStamped"
    RANGE = "sensor_msgs/msg/Range"
    PX4_COMBINED = "px4_msgs/msg/SensorCombined"
    PX4_ATTITUDE = "px4_msgs/msg/VehicleAttitude"
    TRANSFORMS = "tf2_msgs/msg/TFMessage"


PICTURES = (RosType.IMAGE, RosType.COMPRESSED)
POSES = (RosType.POSE, RosType.POSE_COVARIANCE, RosType.ODOMETRY)
IMUS = (RosType.IMU, RosType.PX4_COMBINED)
PX4 = (RosType.PX4_COMBINED, RosType.PX4_ATTITUDE)  # microseconds and no header; FRD and NED
TWISTS = (RosType.ODOMETRY, RosType.TWIST, RosType.TWIST_COVARIANCE)

# Number of strings between the stamp and the numbers, and of the numbers.
_LAYOUT = {
    RosType.IMU: (1, 37),
    RosType.ODOMETRY: (2, 85),
    RosType.POSE: (1, 7),
    RosType.POSE_COVARIANCE: (1, 43),
    RosType.TWIST: (1, 6),
    RosType.TWIST_COVARIANCE: (1, 42),
}
WIDTH = {
    RosType.IMU: 10,  # quaternion w x y z, gyro, acceleration
    RosType.ODOMETRY: 10,  # position, quaternion, velocity
    RosType.POSE: 7,
    RosType.POSE_COVARIANCE: 7,
    RosType.TWIST: 3,
    RosType.TWIST_COVARIANCE: 3,
    RosType.PX4_COMBINED: 10,
    RosType.PX4_ATTITUDE: 4,
    RosType.RANGE: 3,  # distance, smallest and largest measurable
}


@dataclass(frozen=True, slots=True)
class Wire:
    """Encoding of a bag's numbers.

    Parameters
    ----------
    ros2
        CDR, which aligns numbers and begins with 4 bytes with the byte order; else ROS 1, packed, with a
        sequence number before the stamp.
    """

    ros2: bool

    def order(self, raw: bytes) -> str:
        """Byte order, as `struct` names it."""
        return ">" if self.ros2 and raw[1] == 0 else "<"

    def stamp_ns(self, raw: bytes, kind: RosType) -> int:
        """Time of a message's header; `struct.error` if it has none, -1 if it is damaged."""
        if kind in PX4:
            logged_us, sampled_us = struct.unpack_from(self.order(raw) + "2Q", raw, 4)
            return int(sampled_us if kind is RosType.PX4_ATTITUDE and sampled_us else logged_us) * 1000
        seconds, nanoseconds = struct.unpack_from(self.order(raw) + "II", raw, 4)
        return int(seconds) * 1_000_000_000 + int(nanoseconds) if nanoseconds < 1_000_000_000 else -1

    def strings(self, raw: bytes, n: int) -> tuple[list[str], int]:
        """Read the ``n`` strings after the stamp; return them and the position of the numbers."""
        at, order = 12, self.order(raw)
        found = []
        for _ in range(n):
            if self.ros2:
                at += -at % 4
            (length,) = struct.unpack_from(order + "I", raw, at)
            at += 4
            found.append(raw[at : at + length].rstrip(b"\0").decode(errors="replace"))
            at += length
        if self.ros2:
            at += (4 - at) % 8  # alignment is relative to the end of the first 4 bytes
        return found, at

    def numbers(self, raw: bytes, kind: RosType) -> Sequence[float]:
        """Read the numbers of a message of fixed layout, in double precision except distances."""
        if kind is RosType.RANGE:
            return self._range(raw)
        if kind is RosType.PX4_COMBINED:
            return struct.unpack_from(self.order(raw) + "3f8x3f", raw, 12)
        if kind is RosType.PX4_ATTITUDE:
            return struct.unpack_from(self.order(raw) + "4f", raw, 20)
        strings, count = _LAYOUT[kind]
        _, at = self.strings(raw, strings)
        return struct.unpack_from(f"{self.order(raw)}{count}d", raw, at)

    def _range(self, raw: bytes) -> Sequence[float]:
        """Field of view, smallest and largest distance, and distance, after a byte with the kind of sensor."""
        order = self.order(raw)
        (length,) = struct.unpack_from(order + "I", raw, 12)
        at = 16 + int(length) + 1
        if self.ros2:
            at += -at % 4
        return struct.unpack_from(order + "4f", raw, at)

    def frame_id(self, raw: bytes) -> str:
        """Frame of a message."""
        return self.strings(raw, 1)[0][0]


def row(kind: RosType, v: Sequence[float]) -> tuple[float, ...]:
    """Convert a message's numbers to `WIDTH` values in FRD and a world with z down."""
    if kind is RosType.IMU:
        q = _quaternion(v[0:4]) if v[4] != NO_DATA else _NAN4
        gyro = _turned(v[13:16]) if v[16] != NO_DATA else _NAN3
        accel = _turned(v[25:28]) if v[28] != NO_DATA else _NAN3
        return (*q, *gyro, *accel)
    if kind is RosType.ODOMETRY:
        return (*_turned(v[0:3]), *_quaternion(v[3:7]), *_turned(v[43:46]))
    if kind in POSES:
        return (*_turned(v[0:3]), *_quaternion(v[3:7]))
    if kind is RosType.RANGE:
        return v[3], v[1], v[2]
    if kind in PX4:
        return (*_NAN4, *v) if kind is RosType.PX4_COMBINED else tuple(v)
    return _turned(v[0:3])


def _turned(v: Sequence[float]) -> tuple[float, float, float]:
    return v[0], -v[1], -v[2]


def _quaternion(q: Sequence[float]) -> tuple[float, float, float, float]:
    """Quaternion w x y z from x y z w, with body and world both rotated by half a turn about x."""
    return q[3], q[0], -q[1], -q[2]


_DISTORTIONS = {
    "": Distortion.RADTAN,
    "plumb_bob": Distortion.RADTAN,
    "rational_polynomial": Distortion.RADTAN,
    "equidistant": Distortion.EQUIDISTANT,
    "fisheye": Distortion.EQUIDISTANT,
}


def camera_from_info(
    info: object, topic: str, *, rectified: bool, mount: Mount | None = None
) -> Camera | None:
    """Camera of a ``sensor_msgs/CameraInfo``.

    Parameters
    ----------
    info
        The message as decoded by rosbags; ROS 1 writes ``K``, ROS 2 ``k``.
    topic
        Its topic, for messages.
    rectified
        Whether the pictures are rectified: then the projection ``P`` is used, without distortion.
    mount
        Its pose on the body, which the message does not contain; straight ahead by default.

    Returns
    -------
    Camera or None
        None if the camera is not calibrated (all zero).

    Raises
    ------
    InputError
        If the lens model is unknown or the numbers are not those of a camera.
    """

    def numbers(name: str) -> list[float]:
        value = getattr(info, name, None)
        return [float(v) for v in (getattr(info, name.lower()) if value is None else value)]

    K, P, D = numbers("K"), numbers("P"), numbers("D")
    if rectified and P[0] != 0.0:
        lens, D, model = (P[0], P[5], P[2], P[6]), [], Distortion.NONE
    elif K[0] == 0.0:
        return None
    else:
        lens = (K[0], K[4], K[2], K[5])
        name = str(info.distortion_model)  # type: ignore[attr-defined]
        model, D = _distortion(name, D, topic)
    binning = [max(1, int(getattr(info, f"binning_{axis}"))) for axis in "xy"]
    roi = info.roi  # type: ignore[attr-defined]
    width = int(roi.width) or int(info.width)  # type: ignore[attr-defined]
    height = int(roi.height) or int(info.height)  # type: ignore[attr-defined]
    fx_px, fy_px, cx_px, cy_px = lens
    centre = (cx_px - int(roi.x_offset), cy_px - int(roi.y_offset))
    try:
        whole = Camera(width, height, fx_px, fy_px, *centre, model, tuple(D))
        if mount is not None:
            whole = replace(whole, R_body_camera=mount.R_body_sensor, p_body_camera_m=mount.p_body_sensor_m)
        refuse_fisheye_numbers(whole)
        return whole.resized(width // binning[0], height // binning[1]) if max(binning) > 1 else whole
    except InputError as error:
        raise InputError(f"{topic}: {error.problem}", remedy=error.remedy) from error


def _distortion(name: str, D: list[float], topic: str) -> tuple[Distortion, list[float]]:
    if name not in _DISTORTIONS:
        raise InputError(
            f"{topic} has the distortion model {name!r}",
            remedy=f"known are {', '.join(known for known in _DISTORTIONS if known)}; give a camera file instead",
        )
    if not any(D):
        return Distortion.NONE, []
    model = _DISTORTIONS[name]
    if (
        model is Distortion.EQUIDISTANT and len(D) == 5 and D[4] == 0.0
    ):  # RealSense drivers always fill all five
        D = D[:4]
    if model is Distortion.RADTAN and len(D) > 8 and not any(D[8:]):  # thin prism and tilt, unused
        D = D[:8]
    return model, D
