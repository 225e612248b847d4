"""Orientation of a rig of IMU and camera on the vehicle, from gravity and the optical axis.

Calibrations such as Kalibr's and EuRoC's give the camera's pose in the IMU's axes, which may differ from the
vehicle's: those of the public EuRoC flights are x up and z forward. If gravity, the vertical direction of the picture
and the optical axis agree on the rig's orientation, they determine the rotation of camera and IMU to forward, right,
down.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import asin, atan2, cos, degrees, radians, sin, sqrt

import numpy as np

from fusion.flight import AttitudeStream, FloatArray, ImuStream, VectorStream
from fusion.logs.plausibility.flight import down_in_body
from fusion.logs.plausibility.imu import UPRIGHT, Gravity
from fusion.logs.plausibility.mounting import MountRad, mounted_attitude, rotation
from fusion.logs.plausibility.turn_rates import compare_turns
from vision import Camera
from vision.cameras.camera import MAX_AXIS_ANGLE_RAD

MAX_PICTURE_TILT_RAD = radians(45)  # between the picture's vertical and gravity
MAX_LOOK_RAD = radians(60)  # of an optical axis above or below level
MAX_SNAP_RAD = radians(20)  # from quarter turns, which are usual; a flight's mean attitude is not quite level
SAME_AXES_RAD = radians(30)  # between gravity by the IMU and by an attitude in the same axes


@dataclass(frozen=True, slots=True)
class Rig:
    """Common orientation of IMU and camera on the vehicle.

    Parameters
    ----------
    mount_rad
        Roll, pitch and yaw of the IMU's axes.
    looks_up_rad
        Angle of the optical axis above level, if it is declared by the IMU's axes and not by the calibration.
    """

    mount_rad: MountRad
    looks_up_rad: float | None = None


def find_body_from_imu(gravity: Gravity, camera: Camera) -> MountRad | None:
    """Find roll, pitch and yaw of the IMU's axes on the vehicle.

    Parameters
    ----------
    gravity
        Measured by the IMU along the axes in which it is read.
    camera
        Its ``R_body_camera`` refers to the same axes.

    Returns
    -------
    tuple or None
        Radians, see `fusion.logs.plausibility.mounting`; None if the axes are the vehicle's already, or gravity
        and the camera do not agree on the rig's orientation.
    """
    if camera.mount_assumed or not gravity.is_seen:
        return None
    up, R = gravity.direction, camera.R_body_camera
    picture_down, optical_axis = R[:, 1], R[:, 2]
    is_upright = up[2] < -UPRIGHT and optical_axis[0] > cos(MAX_AXIS_ANGLE_RAD)
    if is_upright or -picture_down @ up < cos(MAX_PICTURE_TILT_RAD):
        return None
    forward = optical_axis - (optical_axis @ up) * up
    forward /= np.linalg.norm(forward)
    return _angles(_snapped(np.stack([forward, np.cross(-up, forward), -up])))


def body_from_camera_axis(gravity: Gravity, optical_axis: FloatArray) -> Rig | None:
    """Find the orientation of an IMU along one of whose axes an upright camera looks.

    Parameters
    ----------
    gravity
        Measured by the IMU along the axes in which it is read.
    optical_axis
        Unit vector (3,) along the same axes.

    Returns
    -------
    Rig or None
        None if gravity is not measured, or the camera looks along it.
    """
    up = gravity.direction if gravity.is_seen else optical_axis
    upward = float(optical_axis @ up)
    if abs(upward) > sin(MAX_LOOK_RAD):
        return None
    forward = (optical_axis - upward * up) / sqrt(1.0 - upward**2)
    return Rig(_angles(np.stack([forward, np.cross(-up, forward), -up])), round(asin(upward), 5))


def _snapped(R: FloatArray) -> FloatArray:
    """Return the nearest rotation (3, 3) by quarter turns, if one is near."""
    from scipy.spatial.transform import Rotation

    quarter_turns = Rotation.create_group("O")
    off_rad = (quarter_turns.inv() * Rotation.from_matrix(R)).magnitude()
    nearest = int(np.argmin(off_rad))
    return np.rint(quarter_turns[nearest].as_matrix()) if off_rad[nearest] < MAX_SNAP_RAD else R


def _angles(R: FloatArray) -> MountRad:
    """Roll, pitch and yaw of ``R = Rz Ry Rx``, rounded to the reported digits."""
    pitch = -asin(max(-1.0, min(1.0, float(R[2, 0]))))
    if abs(R[2, 0]) > 0.99999:  # gimbal lock: roll and yaw have one axis
        roll, yaw = 0.0, atan2(-R[0, 1], R[1, 1])
    else:
        roll, yaw = atan2(R[2, 1], R[2, 2]), atan2(R[1, 0], R[0, 0])
    roll, pitch, yaw = (round(angle, 5) + 0.0 for angle in (roll, pitch, yaw))
    return roll, pitch, yaw


def turned_camera(camera: Camera, rig: Rig) -> Camera:
    """Return the camera on the vehicle, as calibrated to the IMU's axes, or upright along one of them.

    If the camera's axis on the IMU is declared, a calibration with a pose refers to the vehicle already.
    """
    if rig.looks_up_rad is None and not camera.mount_assumed:
        R = rotation(rig.mount_rad)
        return replace(
            camera, R_body_camera=R @ camera.R_body_camera, p_body_camera_m=R @ camera.p_body_camera_m
        )
    if rig.looks_up_rad is None or not camera.mount_assumed:
        return camera
    R_up = rotation((0.0, rig.looks_up_rad, 0.0))
    return replace(camera, R_body_camera=R_up @ camera.R_body_camera, mount_assumed=False)


def is_along_imu(attitude: AttitudeStream, gravity: Gravity | None) -> bool:
    """Whether an attitude refers to the IMU's own axes: it agrees with the IMU on gravity."""
    if gravity is None or not gravity.is_seen:
        return False
    down = np.median(down_in_body(attitude.q_world_body), axis=0)
    return float(-gravity.direction @ down / np.linalg.norm(down)) > cos(SAME_AXES_RAD)


def turned_attitude(
    attitude: AttitudeStream, imu: ImuStream | None, gravity: Gravity | None, mount_rad: MountRad
) -> AttitudeStream:
    """Return an attitude along the vehicle's axes, rotated if it refers to the IMU's.

    Parameters
    ----------
    attitude
        As read.
    imu
        Along the vehicle's axes already; the attitude's rates must agree with it.
    gravity
        Measured by the IMU along the axes in which it is read.
    mount_rad
        Of the IMU on the vehicle.
    """
    turned = mounted_attitude(attitude, mount_rad)
    as_read, as_turned = (None if imu is None else compare_turns(imu, a) for a in (attitude, turned))
    if as_read is None or as_turned is None:  # too little motion to decide
        return turned if is_along_imu(attitude, gravity) else attitude
    return turned if as_turned.as_taken.correlation > as_read.as_taken.correlation else attitude


def turned_velocity(velocity: VectorStream, mount_rad: MountRad) -> VectorStream:
    """Return a velocity along the vehicle's axes, rotated if it then points forward, as usual in flight."""
    turned = velocity.xyz @ rotation(mount_rad).T
    ahead = float(np.median(turned[:, 0])) > float(np.median(velocity.xyz[:, 0]))
    return replace(velocity, xyz=turned) if ahead else velocity


def sentence(mount_rad: MountRad) -> str:
    """Return the finding as a sentence."""
    rpy = ", ".join(str(round(degrees(angle))) for angle in mount_rad)
    written = ", ".join(f"{angle:g}" for angle in mount_rad)
    return (
        "the axes of IMU and camera are not the vehicle's: by gravity and the optical axis both are rotated by roll, "
        f"pitch, yaw of {rpy} degrees (body_from_imu_rad = [{written}] in flight.toml; [0, 0, 0] keeps them as they "
        "are)"
    )
