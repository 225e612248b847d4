"""Camera files with a 3x3 matrix: ROS ``camera_info`` and OpenCV's FileStorage, YAML or JSON.

Both describe the raw, distorted picture by ``camera_matrix`` (K) and ``distortion_coefficients``; ROS adds the
matrices of a rectified picture (R, P), which are not used here. Neither contains the mounting: the camera is assumed
to look straight ahead unless a ``T_BS`` or a ``T_cam_imu`` was added to the file.

Many of these files are written by users' own scripts, so a field is recognised by any of the names in common use.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from math import atan, degrees, pi
from typing import Any

from vision.cameras.camera import Distortion
from vision.cameras.fields import check_pinhole, check_size, numbers
from vision.cameras.lens_check import MAX_TANGENTIAL
from vision.errors import InputError

_MATRIX = ("cameramatrix", "k", "mtx", "intrinsicmatrix", "m1")
_COEFFICIENTS = (
    "distortioncoefficients",
    "distortioncoeffs",
    "distcoeffs",
    "distcoeff",
    "distcoef",
    "distcoefs",
    "dist",
    "d",
    "d1",
)
_WIDTH, _HEIGHT = ("imagewidth", "width"), ("imageheight", "height")
_SIZE = ("imagesize", "imgsize", "resolution", "size")
_MODEL = ("distortionmodel", "cameramodel", "model")
_FISHEYE = ("fisheyemodel", "fisheye", "isfisheye")

_MODELS = {
    "plumbbob": Distortion.RADTAN,
    "rationalpolynomial": Distortion.RADTAN,
    "radtan": Distortion.RADTAN,
    "radialtangential": Distortion.RADTAN,
    "brownconrady": Distortion.RADTAN,
    "opencv": Distortion.RADTAN,
    "pinhole": None,  # does not specify the distortion
    "equidistant": Distortion.EQUIDISTANT,
    "equi": Distortion.EQUIDISTANT,
    "fisheye": Distortion.EQUIDISTANT,
    "opencvfisheye": Distortion.EQUIDISTANT,
    "kannalabrandt4": Distortion.EQUIDISTANT,
    "none": Distortion.NONE,
    "": Distortion.NONE,
}
SUPPORTED = (
    "supported are plumb_bob, rational_polynomial and equidistant (fisheye): calibrate with one of them"
)

MAX_PLAIN_FOV_RAD = pi / 2  # up to here, four coefficients without a model are radial-tangential


@dataclass(frozen=True, slots=True)
class Lens:
    """Intrinsics in such a file: size of the raw pictures, ``fx fy cx cy`` in pixels, and distortion."""

    size: tuple[int, int]
    pinhole: tuple[float, float, float, float]
    distortion: Distortion
    coefficients: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class _Fields:
    """A file's fields, looked up by name in lower case without underscores."""

    content: Mapping[str, Any]
    names: Mapping[str, str]

    def find(self, names: tuple[str, ...]) -> str | None:
        """Return the file's spelling of the first of these names that has a value; None without any."""
        for name in names:
            if name in self.names and self.content[self.names[name]] is not None:
                return self.names[name]
        return None

    def value(self, names: tuple[str, ...]) -> Any:
        """Return the value of the first of these names in the file; None without any."""
        key = self.find(names)
        return None if key is None else self.content[key]


def _normalised_name(name: object) -> str:
    return re.sub(r"[\s_-]", "", str(name)).lower()


def _fields(content: Mapping[str, Any]) -> _Fields:
    return _Fields(content, {_normalised_name(key): key for key in reversed(list(content))})


def is_matrix_file(content: Mapping[str, Any]) -> bool:
    """Whether a file contains a camera matrix."""
    return _fields(content).find(_MATRIX) is not None


def read_lens(content: Mapping[str, Any]) -> Lens:
    """Read size, matrix and distortion; an `InputError` names an unusable field."""
    fields = _fields(content)
    size = _size(fields)
    key = fields.find(_MATRIX) or "camera_matrix"
    matrix = numbers(content, key, "", (9,), "give the 3x3 matrix row by row")
    fx_px, skew, cx_px, _, fy_px, cy_px, *last = matrix
    if fx_px == 0.0:
        raise InputError(f"{key} is zero: the camera was never calibrated", remedy="calibrate it")
    if matrix[3] != 0.0 or abs(skew) > 1e-3 * abs(fx_px) or tuple(last) != (0.0, 0.0, 1.0):
        raise InputError(
            f"{key} is {[list(matrix[i : i + 3]) for i in (0, 3, 6)]}",
            remedy="it must be [fx, 0, cx], [0, fy, cy], [0, 0, 1]",
        )
    check_pinhole(size, (fx_px, fy_px, cx_px, cy_px), key)
    _refuse_cut_pictures(fields, size)
    distortion, coefficients = _distortion(fields, size, fx_px)
    return Lens(size, (fx_px, fy_px, cx_px, cy_px), distortion, coefficients)


def _size(fields: _Fields) -> tuple[int, int]:
    key = fields.find(_SIZE)
    if key is not None and not isinstance(fields.content[key], int | float):
        width_px, height_px = numbers(fields.content, key, "", (2,), "write [width, height]")
        return check_size(width_px, height_px, key)
    sides = []
    for names, example in ((_WIDTH, "image_width"), (_HEIGHT, "image_height")):
        key = fields.find(names)
        if key is None:
            raise InputError(
                f"{example} is missing",
                remedy=f"add a line such as `{example}: 640`, in pixels; in XML `<{example}>640</{example}>`",
            )
        side = fields.content[key]
        if isinstance(side, bool) or not isinstance(side, int | float):
            raise InputError(f"{key} is {side!r}", remedy="give a whole number of pixels")
        sides.append(float(side))
    return check_size(sides[0], sides[1], "image_width, image_height")


def _refuse_cut_pictures(fields: _Fields, size: tuple[int, int]) -> None:
    """Raise `InputError` where the pictures are binned or cropped relative to the matrix."""
    remedy = "give the calibration of the pictures as they are in the log"
    for name in ("binningx", "binningy"):
        if (fields.value((name,)) or 1) not in (0, 1):
            raise InputError(f"{fields.find((name,))} is {fields.value((name,))}", remedy=remedy)
    roi = fields.value(("roi",))
    if not isinstance(roi, Mapping):
        return
    cut = (roi.get("width") or size[0], roi.get("height") or size[1])
    if roi.get("x_offset") or roi.get("y_offset") or cut != size:
        raise InputError(f"roi cuts {cut[0]}x{cut[1]} out of {size[0]}x{size[1]}", remedy=remedy)


def _distortion(fields: _Fields, size: tuple[int, int], fx_px: float) -> tuple[Distortion, tuple[float, ...]]:
    key = fields.find(_COEFFICIENTS)
    given = () if key is None else numbers(fields.content, key, "", None, "give a list of numbers")
    distortion = _named_model(fields)
    if key is None and distortion is not Distortion.NONE:
        raise InputError(
            "distortion_coefficients is missing", remedy="write zeros where the lens has no distortion"
        )
    if distortion is None:
        distortion = _model_by_count(key or "", given, size, fx_px)
    if distortion is Distortion.NONE or not given:
        if any(given):
            raise InputError(f"{key} is {list(given)} though the model is none", remedy=SUPPORTED)
        if distortion is Distortion.EQUIDISTANT:  # distorted even without coefficients: r = f * angle
            return distortion, (0.0,) * 4
        return Distortion.NONE, ()
    if distortion is Distortion.EQUIDISTANT:
        if len(given) != 4:
            raise InputError(
                f"{key} has {len(given)} numbers instead of 4",
                remedy="the equidistant model takes k1 k2 k3 k4",
            )
        return distortion, given
    if len(given) in (12, 14) and not any(given[8:]):
        given = given[:8]
    if len(given) not in (4, 5, 8):
        more = ": thin prism and tilt are not supported" if len(given) in (12, 14) else ""
        raise InputError(f"{key} has {len(given)} numbers instead of 4 or 5 or 8{more}", remedy=SUPPORTED)
    return distortion, given


def _named_model(fields: _Fields) -> Distortion | None:
    """Return the declared model, None where the file does not declare one."""
    fisheye = fields.value(_FISHEYE)
    if fisheye is not None and _normalised_name(fisheye) in ("1", "true", "yes"):
        return Distortion.EQUIDISTANT
    key = fields.find(_MODEL)
    if key is None:
        return None if fisheye is None else Distortion.RADTAN
    name = _normalised_name(fields.content[key])
    if name not in _MODELS:
        raise InputError(f"{key} is {str(fields.content[key])!r}", remedy=SUPPORTED)
    return _MODELS[name]


def _model_by_count(key: str, given: tuple[float, ...], size: tuple[int, int], fx_px: float) -> Distortion:
    """Choose the model by the number of coefficients, as OpenCV does; four of a wide lens are ambiguous."""
    if len(given) != 4 or not any(given):
        return Distortion.RADTAN
    fov_rad = 2.0 * atan(0.5 * size[0] / fx_px)
    if fov_rad <= MAX_PLAIN_FOV_RAD and max(map(abs, given[2:])) <= MAX_TANGENTIAL:
        return Distortion.RADTAN
    raise InputError(
        f"{key} has 4 numbers and no distortion_model; with a view of {degrees(fov_rad):.0f} degrees it may be a "
        "fisheye's",
        remedy="add `distortion_model: equidistant` where cv2.fisheye made it, else `distortion_model: plumb_bob`",
    )
