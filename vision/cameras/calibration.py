"""Readers of all supported camera files; every field is checked.

=====================  =============================================  ==================================
kind                   recognised by                                  pose of the camera
=====================  =============================================  ==================================
EuRoC ``sensor.yaml``  ``resolution``, ``intrinsics``                 ``T_BS``: camera to body
Kalibr ``camchain``    ``cam0``, ``cam1`` ...                         ``T_cam_imu``: IMU to camera, if any
ROS ``camera_info``    ``camera_matrix`` or ``K``, the model's name   none: assumed straight ahead
OpenCV YAML, JSON, XML ``camera_matrix`` and other names in use       none: assumed straight ahead
SLAM systems           see `vision.cameras.slam_files`                camera to IMU, if any
=====================  =============================================  ==================================

The extrinsics have opposite directions: ``T_BS`` and ``T_imu_cam`` (OpenVINS) transform points from the camera to the
body, ``T_cam_imu`` from the IMU to the camera. Any file may contain any of the three, and also ``line_delay``, a
rolling shutter's time in seconds from row to row as calibrated by Kalibr.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

import numpy as np

from vision.cameras.camera import COEFFICIENT_COUNTS, BodyFrame, Camera, Distortion
from vision.cameras.fields import (
    R_FRD_FLU,
    check_pinhole,
    check_size,
    exposure_s,
    line_delay_s,
    numbers,
    parts_of_transform,
    require,
)
from vision.cameras.fields import read_yaml as read_yaml
from vision.cameras.imu_noise import ImuNoise as ImuNoise
from vision.cameras.imu_noise import read_imu_noise as read_imu_noise
from vision.cameras.lens_check import refuse_fisheye_numbers
from vision.cameras.matrix_files import is_matrix_file, read_lens
from vision.cameras.slam_files import declared_time_shift, to_euroc_fields
from vision.errors import InputError
from vision.types import FloatArray

Pose = tuple[FloatArray, FloatArray]

FORMATS = (
    "EuRoC sensor.yaml, Kalibr camchain.yaml, ROS camera_info (YAML or INI), a file of VINS-Fusion, ORB-SLAM, OKVIS, "
    "Basalt or stella_vslam, or OpenCV's camera_matrix and distortion_coefficients in YAML, JSON or XML"
)

_DISTORTIONS = {
    "none": Distortion.NONE,
    "radtan": Distortion.RADTAN,
    "radial-tangential": Distortion.RADTAN,
    "plumb_bob": Distortion.RADTAN,
    "rational_polynomial": Distortion.RADTAN,
    "equi": Distortion.EQUIDISTANT,
    "equidistant": Distortion.EQUIDISTANT,
    "fisheye": Distortion.EQUIDISTANT,
}
_POSE_TOLERANCE = 2e-3  # between two extrinsics in one file, which may be printed with three digits
_STRAIGHT_AHEAD = {
    "flu": "[0,0,1,0, -1,0,0,0, 0,-1,0,0, 0,0,0,1]",
    "frd": "[0,0,1,0, 1,0,0,0, 0,1,0,0, 0,0,0,1]",
}


def read_body_frame(path: Path) -> BodyFrame:
    """Read ``body_frame`` (``flu`` or ``frd``) from a ``body.yaml``; ``flu`` where it is not declared.

    In the public EuRoC flights ``body.yaml`` contains only a comment.
    """
    declared = read_yaml(path).get("body_frame") if path.exists() else None
    return "flu" if declared is None else check_body_frame(declared, path)


def check_body_frame(value: object, file: Path | None = None) -> BodyFrame:
    """Return ``flu`` or ``frd``; raise `InputError` for anything else."""
    for known in get_args(BodyFrame):
        if str(value).strip().lower() == known:
            return known  # type: ignore[no-any-return]
    raise InputError(
        f"body_frame is {value!r}",
        file=file,
        remedy="write flu (x forward, y left, z up) or frd (x forward, y right, z down)",
    )


def to_frd(body_frame: BodyFrame) -> FloatArray:
    """Return the rotation (3, 3) from the file's body axes to FRD; it is its own inverse."""
    return R_FRD_FLU.copy() if body_frame == "flu" else np.eye(3)


def read_camera(path: Path, body_frame: BodyFrame | None, cam: str) -> Camera:
    """Read a camera file of any supported kind, see `Camera.from_yaml`."""
    content = read_yaml(path)
    if body_frame is None:
        body_frame = read_body_frame(path.absolute().parent.parent / "body.yaml")
    else:
        body_frame = check_body_frame(body_frame)
    try:
        camera = _read_content(content, path.absolute().parent, body_frame, cam)
        refuse_fisheye_numbers(camera)
        return camera
    except InputError as error:
        if error.file is not None:
            raise
        raise InputError(error.problem, file=path, remedy=error.remedy) from error


def _read_content(content: Mapping[str, Any], folder: Path, body_frame: BodyFrame, cam: str) -> Camera:
    translated = to_euroc_fields(content, folder, cam)
    if translated is not None:
        pose = _read_pose(translated, "", body_frame)
        return _make_camera(translated, "", "distortion_coefficients", pose)
    if _is_chain(content):
        return _read_kalibr(content, body_frame, cam)
    if is_matrix_file(content):
        return _read_matrix_file(content, body_frame)
    if not any(key in content for key in ("resolution", "intrinsics", "camera_model", "T_BS")):
        found = ", ".join(str(key) for key in list(content)[:8]) or "nothing"
        raise InputError(f"is not a camera calibration: it contains {found}", remedy=f"give {FORMATS}")
    return _read_euroc(content, body_frame)


def read_time_shift_s(path: Path, cam: str = "cam0") -> float | None:
    """Read the time shift, ``t_imu = t_camera + shift`` in seconds, from a Kalibr chain or a SLAM system's file.

    Returns
    -------
    float or None
        None where the file is of another kind or has no such field.
    """
    content = read_yaml(path)
    chain = content.get(cam)
    if _is_chain(content) and isinstance(chain, Mapping):
        declared: tuple[str, object] | None = f"{cam}.timeshift_cam_imu", chain.get("timeshift_cam_imu")
    else:
        declared = declared_time_shift(content)
    if declared is None or declared[1] is None:
        return None
    key, shift_s = declared
    if isinstance(shift_s, bool) or not isinstance(shift_s, int | float) or not abs(shift_s) < 1e10:
        raise InputError(f"{key} is {shift_s!r}", file=path, remedy="give seconds")
    return float(shift_s)


def _is_chain(content: Mapping[str, Any]) -> bool:
    return any(
        re.fullmatch(r"cam\d+", str(key)) and isinstance(value, Mapping) for key, value in content.items()
    )


def _read_euroc(content: Mapping[str, Any], body_frame: BodyFrame) -> Camera:
    pose = _read_pose(content, "", body_frame)
    if pose is None:
        example = f"add T_BS, body from camera; straight ahead it is data: {_STRAIGHT_AHEAD[body_frame]}"
        raise InputError("T_BS is missing", remedy=example)
    return _make_camera(content, "", "distortion_coefficients", pose)


def _read_kalibr(content: Mapping[str, Any], body_frame: BodyFrame, cam: str) -> Camera:
    chain = content.get(cam)
    if not isinstance(chain, Mapping):
        found = ", ".join(str(key) for key in content)
        raise InputError(f"there is no camera {cam} in this chain", remedy=f"choose one of: {found}")
    pose = _read_pose(chain, f"{cam}.", body_frame)  # None in a chain of cameras alone
    return _make_camera(chain, f"{cam}.", "distortion_coeffs", pose)


def _read_matrix_file(content: Mapping[str, Any], body_frame: BodyFrame) -> Camera:
    lens = read_lens(content)
    pose = _read_pose(content, "", body_frame)
    camera = Camera(
        *lens.size,
        *lens.pinhole,
        distortion=lens.distortion,
        coefficients=lens.coefficients,
        exposure_s=exposure_s(content, ""),
        line_delay_s=line_delay_s(content, ""),
        mount_assumed=pose is None,
    )
    return camera if pose is None else replace(camera, R_body_camera=pose[0], p_body_camera_m=pose[1])


def _read_pose(content: Mapping[str, Any], prefix: str, body_frame: BodyFrame) -> Pose | None:
    """Return rotation (3, 3) and position (3,) of the camera in body FRD; None without an extrinsic."""
    found: dict[str, Pose] = {}
    for name in ("T_BS", "T_cam_imu", "T_imu_cam"):
        if content.get(name) is None:
            continue
        R, p = parts_of_transform(content[name], f"{prefix}{name}")
        found[name] = (R.T, -R.T @ p) if name == "T_cam_imu" else (R, p)
    if not found:
        return None
    (first, (R_body_camera, p_body_camera_m)), *others = found.items()
    for name, (R, _) in others:
        if not np.allclose(R, R_body_camera, atol=_POSE_TOLERANCE):
            raise InputError(
                f"{prefix}{first} and {prefix}{name} place the camera differently",
                remedy="T_BS and T_imu_cam take the camera to the body, T_cam_imu the IMU to the camera; keep one",
            )
    R_frd = to_frd(body_frame)
    return R_frd @ R_body_camera, R_frd @ p_body_camera_m


def rotation_of_transform(value: object, name: str) -> FloatArray:
    """Return the rotation (3, 3) of a 4x4 transform, given flat, nested, or as a mapping with ``data``."""
    return parts_of_transform(value, name)[0]


def _make_camera(content: Mapping[str, Any], prefix: str, coefficient_key: str, pose: Pose | None) -> Camera:
    resolution = numbers(content, "resolution", prefix, (2,), "write [width, height]")
    size = check_size(resolution[0], resolution[1], f"{prefix}resolution")
    known = _distortion_model(content, prefix)
    fx_px, fy_px, cx_px, cy_px = numbers(content, "intrinsics", prefix, (4,), "write [fu, fv, cu, cv]")
    pinhole_px = (fx_px, fy_px, cx_px, cy_px)
    check_pinhole(size, pinhole_px, f"{prefix}intrinsics")
    coefficients = _coefficients(content, prefix, coefficient_key, known)
    camera = Camera(
        *size,
        *pinhole_px,
        distortion=known,
        coefficients=coefficients,
        exposure_s=exposure_s(content, prefix),
        line_delay_s=line_delay_s(content, prefix),
        mount_assumed=pose is None,
    )
    return camera if pose is None else replace(camera, R_body_camera=pose[0], p_body_camera_m=pose[1])


def _coefficients(
    content: Mapping[str, Any], prefix: str, key: str, distortion: Distortion
) -> tuple[float, ...]:
    if distortion is not Distortion.NONE:
        counts = COEFFICIENT_COUNTS[distortion]
        return numbers(content, key, prefix, counts, f"{distortion} needs them all")
    if content.get(key) and any(numbers(content, key, prefix, None, "leave it empty")):
        raise InputError(
            f"{prefix}{key} is {content[key]!r} though {prefix}distortion_model is none",
            remedy="name the model, radtan or equidistant",
        )
    return ()


def _distortion_model(content: Mapping[str, Any], prefix: str) -> Distortion:
    known = "supported are pinhole with radtan, equidistant or none: calibrate with one of them"
    parts = str(require(content, "camera_model", None, known, prefix=prefix)).strip().lower().split("-", 1)
    if parts[0] != "pinhole":
        raise InputError(f"{prefix}camera_model is {parts[0]!r}", remedy=known)
    named = content.get("distortion_model")
    if named is None:  # Kalibr's command line names both at once, as pinhole-equi
        named = (
            parts[1] if len(parts) == 2 else require(content, "distortion_model", None, known, prefix=prefix)
        )
    model = _DISTORTIONS.get(str(named).strip().lower())
    if model is None:
        raise InputError(f"{prefix}distortion_model is {str(named)!r}", remedy=known)
    if len(parts) == 2 and _DISTORTIONS.get(parts[1]) is not model:
        raise InputError(
            f"{prefix}camera_model is {'-'.join(parts)!r} but {prefix}distortion_model is {str(named)!r}",
            remedy="make them agree",
        )
    return model
