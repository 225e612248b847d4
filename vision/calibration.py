"""Camera files: EuRoC/ASL ``sensor.yaml`` and Kalibr ``camchain.yaml``, with every field checked.

The two formats give the camera's pose in opposite directions. EuRoC's ``T_BS`` takes points from the sensor
to the body; Kalibr's ``T_cam_imu`` takes points from the IMU to the camera.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from math import isfinite, nan
from pathlib import Path
from typing import Any, get_args

import numpy as np
import numpy.typing as npt

from vision.camera import COEFFICIENT_COUNTS, BodyFrame, Camera, Distortion, nearest_rotation
from vision.errors import InputError

FloatArray = npt.NDArray[np.float64]

R_FRD_FLU: FloatArray = np.diag([1.0, -1.0, -1.0])

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
_STRAIGHT_AHEAD = {
    "flu": ("[0,0,1,0, -1,0,0,0, 0,-1,0,0, 0,0,0,1]", "[[0,-1,0,0],[0,0,-1,0],[1,0,0,0],[0,0,0,1]]"),
    "frd": ("[0,0,1,0, 1,0,0,0, 0,1,0,0, 0,0,0,1]", "[[0,1,0,0],[0,0,1,0],[1,0,0,0],[0,0,0,1]]"),
}


def read_yaml(path: Path) -> dict[str, Any]:
    """Read a YAML mapping, also with OpenCV's ``%YAML:1.0`` first line and ``!!opencv-matrix`` tags.

    Raises
    ------
    InputError
        Where the file is missing, unreadable, no YAML, or no mapping.
    """
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise InputError("there is no such file", file=path, remedy="check the path") from None
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"cannot be read as text: {error}", file=path, remedy="give a YAML file") from error
    text = re.sub(r"\A\ufeff?%YAML:[^\n]*\n(---[^\n]*\n)?", "", text).replace("!!opencv-matrix", "")
    try:
        content = YAML(typ="safe", pure=True).load(text)
    except YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = f" in line {mark.line + 1}" if mark is not None else ""
        what = getattr(error, "problem", None) or "syntax error"
        raise InputError(f"is not valid YAML{where}: {what}", file=path, remedy="correct the file") from error
    if not isinstance(content, dict):
        raise InputError(
            "does not hold a YAML mapping", file=path, remedy="give lines such as `resolution: [640, 480]`"
        )
    return content


def read_body_frame(path: Path) -> BodyFrame:
    """Read ``body_frame`` (``flu`` or ``frd``) from a ``body.yaml``; ``flu`` where the file is absent."""
    if not path.exists():
        return "flu"
    content = read_yaml(path)
    return check_body_frame(_require(content, "body_frame", path, "write `body_frame: flu` or `frd`"), path)


def check_body_frame(value: object, file: Path | None = None) -> BodyFrame:
    """Return ``flu`` or ``frd``; `InputError` for anything else."""
    for known in get_args(BodyFrame):
        if str(value).strip().lower() == known:
            return known  # type: ignore[no-any-return]
    raise InputError(
        f"body_frame is {value!r}",
        file=file,
        remedy="write flu (x forward, y left, z up) or frd (x forward, y right, z down)",
    )


def to_frd(body_frame: BodyFrame) -> FloatArray:
    """Rotation (3, 3) from the file's body axes to FRD; its own inverse."""
    return R_FRD_FLU.copy() if body_frame == "flu" else np.eye(3)


def read_camera(path: Path, body_frame: BodyFrame | None, cam: str) -> Camera:
    """Read either kind of camera file, see `Camera.from_yaml`."""
    content = read_yaml(path)
    if body_frame is None:
        body_frame = read_body_frame(path.absolute().parent.parent / "body.yaml")
    else:
        body_frame = check_body_frame(body_frame)
    try:
        if any(
            re.fullmatch(r"cam\d+", str(key)) and isinstance(value, Mapping) for key, value in content.items()
        ):
            return _read_kalibr(content, body_frame, cam)
        return _read_euroc(content, body_frame)
    except InputError as error:
        if error.file is not None:
            raise
        raise InputError(error.problem, file=path, remedy=error.remedy) from error


def _read_euroc(content: Mapping[str, Any], body_frame: BodyFrame) -> Camera:
    example = f"add T_BS, body from camera; straight ahead it is data: {_STRAIGHT_AHEAD[body_frame][0]}"
    R_body_camera, p_body_camera_m = parts_of_transform(_require(content, "T_BS", None, example), "T_BS")
    R_frd = to_frd(body_frame)
    pose = (R_frd @ R_body_camera, R_frd @ p_body_camera_m)
    return _make_camera(content, "", "distortion_coefficients", pose)


def _read_kalibr(content: Mapping[str, Any], body_frame: BodyFrame, cam: str) -> Camera:
    chain = content.get(cam)
    if not isinstance(chain, Mapping):
        found = ", ".join(str(key) for key in content)
        raise InputError(f"there is no camera {cam} in this chain", remedy=f"choose one of: {found}")
    example = f"add T_cam_imu, camera from IMU; straight ahead it is {_STRAIGHT_AHEAD[body_frame][1]}"
    T_cam_imu = _require(chain, "T_cam_imu", None, example, prefix=f"{cam}.")
    R_camera_imu, p_camera_imu_m = parts_of_transform(T_cam_imu, f"{cam}.T_cam_imu")
    R_frd_camera = to_frd(body_frame) @ R_camera_imu.T
    return _make_camera(chain, f"{cam}.", "distortion_coeffs", (R_frd_camera, -R_frd_camera @ p_camera_imu_m))


def rotation_of_transform(value: object, name: str) -> FloatArray:
    """Rotation (3, 3) of a 4x4 transform, given flat, nested, or as a mapping with ``data``."""
    return parts_of_transform(value, name)[0]


def parts_of_transform(value: object, name: str) -> tuple[FloatArray, FloatArray]:
    """Rotation (3, 3) and translation (3,) of a 4x4 transform, given flat, nested, or as a mapping with ``data``."""
    if isinstance(value, Mapping):
        value = _require(value, "data", None, "give 16 numbers, row by row", prefix=f"{name}.")
    try:
        matrix = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        matrix = np.empty(0)
    if matrix.size != 16:
        raise InputError(f"{name} does not hold 16 numbers", remedy="give a 4x4 transform, row by row")
    matrix = matrix.reshape(4, 4)
    if not np.allclose(matrix[3], [0.0, 0.0, 0.0, 1.0]):
        raise InputError(f"{name} has the last row {matrix[3].tolist()}", remedy="it must be [0, 0, 0, 1]")
    if not np.isfinite(matrix).all():
        raise InputError(f"{name} holds numbers that are not finite", remedy="give a 4x4 transform")
    return nearest_rotation(matrix[:3, :3], f"{name}'s rotation"), matrix[:3, 3].copy()


def _make_camera(
    content: Mapping[str, Any], prefix: str, coefficient_key: str, pose: tuple[FloatArray, FloatArray]
) -> Camera:
    resolution = _numbers(content, "resolution", prefix, (2,), "write [width, height]")
    if any(v != int(v) or v < 1 for v in resolution):
        raise InputError(
            f"{prefix}resolution is {list(resolution)}", remedy="write [width, height] in whole pixels"
        )
    width_px, height_px = (int(v) for v in resolution)
    fx_px, fy_px, cx_px, cy_px = _numbers(content, "intrinsics", prefix, (4,), "write [fu, fv, cu, cv]")
    for name, focal_px in (("fu", fx_px), ("fv", fy_px)):
        if focal_px <= 0.0:
            raise InputError(
                f"{prefix}intrinsics has the focal length {name} = {focal_px:g}", remedy="it must be positive"
            )
    if not (0.0 <= cx_px <= width_px and 0.0 <= cy_px <= height_px):
        raise InputError(
            f"{prefix}intrinsics has the principal point ({cx_px:g}, {cy_px:g}) outside "
            f"the resolution {width_px}x{height_px}",
            remedy="intrinsics and resolution must belong to the same picture size",
        )
    distortion = _distortion_model(content, prefix)
    coefficients = _coefficients(content, prefix, coefficient_key, distortion)
    lens = (fx_px, fy_px, cx_px, cy_px, distortion, coefficients)
    return Camera(width_px, height_px, *lens, pose[0], _exposure_s(content, prefix), pose[1])


def _coefficients(
    content: Mapping[str, Any], prefix: str, key: str, distortion: Distortion
) -> tuple[float, ...]:
    if distortion is not Distortion.NONE:
        counts = COEFFICIENT_COUNTS[distortion]
        return _numbers(content, key, prefix, counts, f"{distortion} needs them all")
    if content.get(key) and any(_numbers(content, key, prefix, None, "leave it empty")):
        raise InputError(
            f"{prefix}{key} is {content[key]!r} though {prefix}distortion_model is none",
            remedy="name the model, radtan or equidistant",
        )
    return ()


def _exposure_s(content: Mapping[str, Any], prefix: str) -> float:
    value = content.get("exposure_s")
    if value is None:
        return nan
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 < value < 10.0:
        raise InputError(f"{prefix}exposure_s is {value!r}", remedy="give seconds, or leave it out")
    return float(value)


def _distortion_model(content: Mapping[str, Any], prefix: str) -> Distortion:
    known = "supported are pinhole with radtan, equidistant or none: calibrate with one of them"
    parts = str(_require(content, "camera_model", None, known, prefix=prefix)).strip().lower().split("-", 1)
    if parts[0] != "pinhole":
        raise InputError(f"{prefix}camera_model is {parts[0]!r}", remedy=known)
    named = content.get("distortion_model")
    if named is None:  # Kalibr's command line names both at once, as pinhole-equi
        named = (
            parts[1] if len(parts) == 2 else _require(content, "distortion_model", None, known, prefix=prefix)
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


def _require(content: Mapping[str, Any], key: str, file: Path | None, remedy: str, prefix: str = "") -> Any:
    if content.get(key) is None:
        raise InputError(f"{prefix}{key} is missing", file=file, remedy=remedy)
    return content[key]


def _numbers(
    content: Mapping[str, Any], key: str, prefix: str, counts: tuple[int, ...] | None, remedy: str
) -> tuple[float, ...]:
    value = _require(content, key, None, remedy, prefix=prefix)
    if isinstance(value, Mapping):
        value = _require(value, "data", None, remedy, prefix=f"{prefix}{key}.")
    try:
        numbers = tuple(float(v) for v in value)
    except (TypeError, ValueError):
        raise InputError(f"{prefix}{key} is {value!r}, not a list of numbers", remedy=remedy) from None
    if counts is not None and len(numbers) not in counts:
        wanted = " or ".join(str(c) for c in counts)
        raise InputError(f"{prefix}{key} has {len(numbers)} numbers instead of {wanted}", remedy=remedy)
    if not all(isfinite(v) for v in numbers):
        raise InputError(f"{prefix}{key} is {list(numbers)}", remedy="every number must be finite")
    return numbers
