"""Camera files of visual-inertial estimators and SLAM systems, converted to the fields of an EuRoC ``sensor.yaml``.

=============================== ====================================== ===================================
system                          recognised by                          pose of the camera
=============================== ====================================== ===================================
VINS-Fusion, VINS-Mono          ``model_type`` (camodocal)             ``body_T_cam0`` of the file that names
                                                                       this one, ``extrinsicRotation``
ORB-SLAM 2 and 3                ``Camera.fx``, ``Camera1.fx``          ``Tbc``, ``IMU.T_b_c1``
stella_vslam, OpenVSLAM         ``Camera`` with ``model``              none
OKVIS                           ``cameras`` with ``T_SC``              ``T_SC``
Basalt                          ``value0`` with ``intrinsics``         ``T_imu_cam``
=============================== ====================================== ===================================

All poses transform camera coordinates to the IMU. Unknown lens models are rejected by name.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from vision.cameras.fields import numbers, read_yaml, require
from vision.errors import InputError
from vision.types import FloatArray

Fields = Mapping[str, Any]
SUPPORTED = (
    "calibrate with a pinhole model and radial-tangential distortion, or with Kannala-Brandt's (equidistant)"
)

_PINHOLE = ("fx", "fy", "cx", "cy")
_RADTAN, _RADTAN_8 = ("k1", "k2", "p1", "p2"), ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
_FISHEYE = ("k1", "k2", "k3", "k4")


def to_euroc_fields(content: Fields, folder: Path, cam: str) -> dict[str, Any] | None:
    """Return a file's content as fields of a ``sensor.yaml``; None where it belongs to none of these systems.

    Parameters
    ----------
    content
        Content of the file.
    folder
        Its folder: VINS-Fusion's configuration refers to a file for each camera.
    cam
        Name of the camera; ``cam0`` is the first.

    Raises
    ------
    InputError
        Naming the missing field, or the unknown lens model.
    """
    number = int(cam.removeprefix("cam")) if cam.removeprefix("cam").isdigit() else 0
    if "model_type" in content:
        return _camodocal(content)
    if f"cam{number}_calib" in content:
        return _vins_fusion(content, folder, number)
    if any(key in content for key in ("Camera.fx", "Camera1.fx", "Camera.model")):
        return _orb_slam(content)
    if isinstance(content.get("Camera"), Mapping) and "model" in content["Camera"]:
        return _stella(content["Camera"])
    if isinstance(content.get("cameras"), list) and content["cameras"]:
        return _okvis(_camera_at(content["cameras"], number))
    value = content.get("value0")
    if isinstance(value, Mapping) and "intrinsics" in value:
        return _basalt(value, number)
    return None


def _euroc_fields(
    size: Sequence[float],
    pinhole: Sequence[float],
    model: str,
    coefficients: Sequence[float],
    pose: Any = None,
) -> dict[str, Any]:
    found: dict[str, Any] = {
        "resolution": list(size),
        "camera_model": "pinhole",
        "intrinsics": list(pinhole),
        "distortion_model": model,
        "distortion_coefficients": list(coefficients),
    }
    return found if pose is None else found | {"T_BS": pose}


def _values(
    content: Fields, names: Sequence[str], prefix: str = "", default: float | None = None
) -> list[float]:
    """Return the numbers of several fields, ``default`` for missing ones; `InputError` where there is no default."""
    if not isinstance(content, Mapping):
        raise InputError(f"has {content!r} where {', '.join(names)} should be", remedy="give the whole file")
    found = []
    for name in names:
        value = content.get(f"{prefix}{name}", default)
        if isinstance(value, bool) or not isinstance(value, int | float):
            value = require({name: value}, name, None, "give a number", prefix=prefix)
            raise InputError(f"{prefix}{name} is {value!r}", remedy="give a number")
        found.append(float(value))
    return found


def _camera_at(cameras: Sequence[Any], number: int) -> Any:
    if number < len(cameras) and isinstance(cameras[number], Mapping):
        return cameras[number]
    raise InputError(f"holds {len(cameras)} cameras, none of number {number}", remedy="the first is cam0")


def _unknown_model(key: str, model: object) -> InputError:
    return InputError(f"{key} is {str(model)!r}, a lens model that is not known here", remedy=SUPPORTED)


def _camodocal(content: Fields) -> dict[str, Any]:
    """Read camodocal's parameters; the coefficients of its Kannala-Brandt model are k2 to k5."""
    size = _values(content, ("image_width", "image_height"))
    remedy = "give the whole file"
    projection = require(content, "projection_parameters", None, remedy)
    model = str(content["model_type"]).upper()
    pose = None
    if content.get("extrinsicRotation") is not None and content.get("extrinsicTranslation") is not None:
        matrix = np.eye(4)
        matrix[:3, :3] = np.reshape(numbers(content, "extrinsicRotation", "", (9,), remedy), (3, 3))
        matrix[:3, 3] = numbers(content, "extrinsicTranslation", "", (3,), remedy)
        pose = matrix.tolist()
    if model == "PINHOLE":
        distortion = require(content, "distortion_parameters", None, remedy)
        lens = _values(projection, _PINHOLE), "radtan", _values(distortion, _RADTAN)
    elif model == "KANNALA_BRANDT":
        pinhole = _values(projection, ("mu", "mv", "u0", "v0"))
        lens = pinhole, "equidistant", _values(projection, ("k2", "k3", "k4", "k5"))
    else:
        raise _unknown_model("model_type", content["model_type"])
    return _euroc_fields(size, *lens, pose)


def _vins_fusion(content: Fields, folder: Path, number: int) -> dict[str, Any]:
    name = str(content[f"cam{number}_calib"])
    found = _camodocal(read_yaml(folder / name))
    pose = content.get(f"body_T_cam{number}")
    return found if pose is None else found | {"T_BS": pose}


def declared_time_shift(content: Fields) -> tuple[str, object] | None:
    """Return the field with the time shift, ``t_imu = t_camera + shift``, and its value in seconds.

    VINS-Fusion's ``td`` and Basalt's ``cam_time_offset_ns`` are added to the pictures' times, OKVIS's ``imageDelay``
    is subtracted.
    """
    inner = content.get("value0")
    if isinstance(inner, Mapping) and "cam_time_offset_ns" in inner:
        shift_ns = inner["cam_time_offset_ns"]
        shift_s = shift_ns * 1e-9 if isinstance(shift_ns, int | float) else shift_ns
        return "value0.cam_time_offset_ns", shift_s
    if any(key.endswith("_calib") for key in map(str, content)) and "td" in content:
        return "td", content["td"]
    if "cameras" in content and "imageDelay" in content:
        delay = content["imageDelay"]
        return "imageDelay", -delay if isinstance(delay, int | float) else delay
    return None


def _orb_slam(content: Fields) -> dict[str, Any]:
    prefix = "Camera1." if "Camera1.fx" in content else "Camera."
    size = _values(content, ("width", "height") if "Camera.width" in content else ("cols", "rows"), "Camera.")
    model = str(content.get("Camera.type", content.get("Camera.model", "PinHole")))
    pose = next((content[key] for key in ("IMU.T_b_c1", "Tbc") if content.get(key) is not None), None)
    return _euroc_fields(
        size, _values(content, _PINHOLE, prefix), *_lens(content, prefix, model, "Camera.type"), pose
    )


def _stella(camera: Fields) -> dict[str, Any]:
    lens = _lens(camera, "", str(camera["model"]), "Camera.model")
    return _euroc_fields(_values(camera, ("cols", "rows"), ""), _values(camera, _PINHOLE), *lens)


def _lens(content: Fields, prefix: str, model: str, key: str) -> tuple[str, list[float]]:
    """Return model and coefficients of ORB-SLAM's and stella's files; missing ones of a pinhole are zero."""
    name = model.lower()
    if name in ("pinhole", "perspective"):
        return "radtan", _values(content, (*_RADTAN, "k3"), prefix, 0.0)
    if name in ("kannalabrandt8", "fisheye"):
        return "equidistant", _values(content, _FISHEYE, prefix)
    if name == "rectified":
        return "none", []
    raise _unknown_model(key, model)


def _okvis(camera: Fields) -> dict[str, Any]:
    remedy = "give the whole file"
    size = numbers(camera, "image_dimension", "cameras.", (2,), remedy)
    focal = numbers(camera, "focal_length", "cameras.", (2,), remedy)
    centre = numbers(camera, "principal_point", "cameras.", (2,), remedy)
    models = {
        "radialtangential": "radtan",
        "radialtangential8": "radtan",
        "equidistant": "equidistant",
        "none": "none",
    }
    declared = require(camera, "distortion_type", None, SUPPORTED, prefix="cameras.")
    if str(declared).lower() not in models:
        raise _unknown_model("distortion_type", declared)
    coefficients = numbers(camera, "distortion_coefficients", "cameras.", None, remedy)
    return _euroc_fields(
        size, (*focal, *centre), models[str(declared).lower()], coefficients, camera.get("T_SC")
    )


_BASALT: dict[str, Callable[[Fields], tuple[str, list[float]]]] = {
    "pinhole": lambda values: ("none", []),
    "kb4": lambda values: ("equidistant", _values(values, _FISHEYE)),
    "pinhole-radtan8": lambda values: ("radtan", _values(values, _RADTAN_8)),
}


def _basalt(content: Fields, number: int) -> dict[str, Any]:
    camera = _camera_at(content["intrinsics"], number)
    values = require(camera, "intrinsics", None, "give the whole file", prefix="intrinsics.")
    kind = str(camera.get("camera_type"))
    if kind not in _BASALT:
        raise _unknown_model("camera_type", kind)
    sizes, poses = content.get("resolution"), content.get("T_imu_cam")
    if not isinstance(sizes, list) or number >= len(sizes):
        raise InputError("resolution is missing", remedy="give the whole file")
    size = numbers({"resolution": sizes[number]}, "resolution", "", (2,), "give the whole file")
    pose = None
    if isinstance(poses, list) and number < len(poses):
        pose = _transform(poses[number]).tolist()
    return _euroc_fields(size, _values(values, _PINHOLE), *_BASALT[kind](values), pose)


def _transform(pose: Fields) -> FloatArray:
    """Return the matrix (4, 4) of a quaternion and a translation."""
    x, y, z, w = _values(pose, ("qx", "qy", "qz", "qw"))
    length = float(np.linalg.norm([x, y, z, w]))
    if not 0.9 < length < 1.1:
        raise InputError(f"T_imu_cam has a quaternion of length {length:.3g}", remedy="give the whole file")
    x, y, z, w = (value / length for value in (x, y, z, w))
    matrix = np.eye(4)
    matrix[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    matrix[:3, 3] = _values(pose, ("px", "py", "pz"))
    return matrix
