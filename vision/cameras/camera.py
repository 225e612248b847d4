"""Calibrated camera: projection between pixels and rays, and its pose on the body.

The optical frame has x right, y down and z forward; pixel (0, 0) is the centre of the top-left pixel. A ray (x, y, z)
is projected to the pixel ``(fx x_d + cx, fy y_d + cy)``, where (x_d, y_d) is the distorted (x/z, y/z), see
`vision.cameras.lens`.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import StrEnum
from math import acos, degrees, isfinite, nan, pi, tan
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt

from vision.cameras.lens import Equidistant, RadialTangential
from vision.errors import InputError
from vision.types import FloatArray

BodyFrame = Literal["flu", "frd"]

ROTATION_TOLERANCE = 1e-3  # deviation from orthonormality: files print rotations with few digits
MAX_AXIS_ANGLE_RAD = pi / 3
MAX_READOUT_S = 0.5  # from the first row to the last

_FORWARD = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])


class Distortion(StrEnum):
    """Lens model of a `Camera`."""

    NONE = "none"
    RADTAN = "radtan"
    EQUIDISTANT = "equidistant"


COEFFICIENT_COUNTS = {
    Distortion.NONE: (0,),
    Distortion.RADTAN: (4, 5, 8),
    Distortion.EQUIDISTANT: (4,),
}


def nearest_rotation(matrix: npt.ArrayLike, what: str = "R_body_camera") -> FloatArray:
    """Return the rotation nearest to a (3, 3) matrix that is a rotation up to rounding.

    Raises
    ------
    InputError
        Where it is not orthonormal within 1e-3, is a reflection, or is not finite.
    """
    rotation = np.array(matrix, dtype=float)
    if rotation.shape != (3, 3) or not np.isfinite(rotation).all():
        raise InputError(f"{what} is not a 3x3 matrix of finite numbers", remedy="give a rotation matrix")
    defect = float(np.abs(rotation @ rotation.T - np.eye(3)).max())
    determinant = float(np.linalg.det(rotation))
    if defect > ROTATION_TOLERANCE or determinant < 0.0:
        raise InputError(
            f"{what} is not a rotation: off orthonormal by {defect:.3g}, determinant {determinant:.3g}",
            remedy="its rows must be orthogonal unit vectors of a right-handed frame",
        )
    if defect > 1e-12:
        u, _, vt = np.linalg.svd(rotation)
        rotation = u @ vt
    return rotation


@dataclass(frozen=True, slots=True, eq=False)
class Camera:
    """A calibrated camera on a body.

    The optical frame has x right, y down and z forward; pixel (0, 0) is the centre of the top-left pixel.

    Parameters
    ----------
    width_px, height_px
        Picture size of the calibration, pixels.
    fx_px, fy_px, cx_px, cy_px
        Focal lengths and principal point, pixels.
    distortion, coefficients
        Lens model and its coefficients: none (), radtan ``k1 k2 p1 p2 [k3 [k4 k5 k6]]`` or equidistant
        ``k1 k2 k3 k4``, in OpenCV's order.
    R_body_camera
        Rotation (3, 3) from the optical frame to the body FRD; straight ahead by default.
    exposure_s
        Exposure time, seconds; NaN where unknown.
    p_body_camera_m
        Position (3,) of the camera, metres, body FRD (forward, right, down). It matters because a camera ahead of the
        vehicle's centre moves sideways as the vehicle turns.
    mount_assumed
        Whether ``R_body_camera`` is only assumed, because the calibration does not contain it.
    line_delay_s
        Time from one row's exposure to the next row's below, seconds; negative where the lowest row comes first; 0
        for a global shutter. A picture's timestamp is that of its middle row.

    Raises
    ------
    InputError
        If a value is impossible for a camera.
    """

    width_px: int
    height_px: int
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    distortion: Distortion = Distortion.NONE
    coefficients: tuple[float, ...] = ()
    R_body_camera: FloatArray = field(default_factory=_FORWARD.copy)
    exposure_s: float = nan
    p_body_camera_m: FloatArray = field(default_factory=lambda: np.zeros(3))
    mount_assumed: bool = False
    line_delay_s: float = 0.0
    _lens: RadialTangential | Equidistant | None = field(init=False, repr=False, default=None)

    def __post_init__(self) -> None:
        self._check()
        rotation = nearest_rotation(self.R_body_camera)
        rotation.setflags(write=False)
        object.__setattr__(self, "distortion", Distortion(self.distortion))
        object.__setattr__(self, "coefficients", tuple(float(c) for c in self.coefficients))
        object.__setattr__(self, "R_body_camera", rotation)
        position = np.array(self.p_body_camera_m, dtype=float)
        if position.shape != (3,) or not np.isfinite(position).all():
            raise InputError("p_body_camera_m is not three finite numbers", remedy="give x, y, z in metres")
        position.setflags(write=False)
        object.__setattr__(self, "p_body_camera_m", position)
        lens: RadialTangential | Equidistant | None = None
        if self.distortion is Distortion.EQUIDISTANT:
            lens = Equidistant.from_coefficients(self.coefficients)
        elif any(self.coefficients):
            lens = RadialTangential.from_coefficients(self.coefficients)
        object.__setattr__(self, "_lens", lens)

    def _check(self) -> None:
        if min(self.width_px, self.height_px) < 1:
            raise InputError(
                f"resolution {self.width_px}x{self.height_px} is not a picture's size",
                remedy="give width and height in pixels, both positive",
            )
        for name in ("fx_px", "fy_px"):
            value = getattr(self, name)
            if not (isfinite(value) and value > 0.0):
                raise InputError(
                    f"focal length {name} is {value:g}", remedy="give a positive number of pixels"
                )
        for name in ("cx_px", "cy_px"):
            value = getattr(self, name)
            if not isfinite(value):
                raise InputError(f"principal point {name} is {value:g}", remedy="give a number of pixels")
        if not abs(self.line_delay_s) * self.height_px <= MAX_READOUT_S:  # NaN fails too
            raise InputError(
                f"line_delay {self.line_delay_s:g} would take {abs(self.line_delay_s) * self.height_px:.3g} s to"
                f" read {self.height_px} rows",
                remedy=f"give seconds from row to row: 20 ms for all are {0.02 / self.height_px:.2g}",
            )
        counts = COEFFICIENT_COUNTS[Distortion(self.distortion)]
        if len(self.coefficients) not in counts:
            wanted = " or ".join(str(c) for c in counts)
            raise InputError(
                f"distortion model {self.distortion} has {len(self.coefficients)} coefficients",
                remedy=f"it takes {wanted}",
            )
        if not all(isfinite(c) for c in self.coefficients):
            raise InputError(
                f"distortion coefficients {self.coefficients} are not finite", remedy="calibrate again"
            )

    @classmethod
    def from_yaml(cls, path: str | Path, body_frame: BodyFrame | None = None, cam: str = "cam0") -> Camera:
        """Read a calibration: EuRoC/ASL, Kalibr, ROS ``camera_info`` or OpenCV, YAML or JSON.

        Parameters
        ----------
        path
            The file. EuRoC's ``T_BS`` transforms camera coordinates to the body, Kalibr's ``T_cam_imu`` IMU
            coordinates to the camera; the body frame is then the IMU's. ROS's and OpenCV's files have no extrinsic:
            the camera is then assumed to look straight ahead, see ``mount_assumed``.
        body_frame
            Axes of the body in the file, ``flu`` or ``frd``. Default: the value in ``body.yaml`` in the folder above
            the file's (``mav0/body.yaml`` for ``mav0/cam0/sensor.yaml``), else ``flu``.
        cam
            Name of the camera in a Kalibr chain.

        Raises
        ------
        InputError
            Naming the file, the field and the remedy.
        """
        from vision.cameras.calibration import read_camera

        return read_camera(Path(path), body_frame, cam)

    @classmethod
    def from_fov(cls, width_px: int, height_px: int, horizontal_fov_rad: float) -> Camera:
        """Return an undistorted camera that looks straight ahead, from its horizontal field of view.

        Parameters
        ----------
        width_px, height_px
            Size of the pictures, pixels.
        horizontal_fov_rad
            Angle between the left and the right edge of the picture, radians.

        Raises
        ------
        InputError
            If the size has no pixels, or the angle is not between 0 and pi.
        """
        if not 0.0 < horizontal_fov_rad < pi:
            raise InputError(
                f"horizontal field of view is {horizontal_fov_rad:g} rad",
                remedy="give an angle between 0 and pi",
            )
        focal_px = width_px / 2.0 / tan(horizontal_fov_rad / 2.0)
        return cls(width_px, height_px, focal_px, focal_px, (width_px - 1) / 2.0, (height_px - 1) / 2.0)

    def resized(self, width_px: int, height_px: int) -> Camera:
        """Return the camera for the same pictures scaled to another size, with exact pixel centres.

        Raises
        ------
        InputError
            Where the new size has no pixels.
        """
        if min(width_px, height_px) < 1:
            raise InputError(f"size is {width_px}x{height_px}", remedy="give a size of at least one pixel")
        scale_x, scale_y = width_px / self.width_px, height_px / self.height_px
        return replace(
            self,
            width_px=width_px,
            height_px=height_px,
            fx_px=self.fx_px * scale_x,
            fy_px=self.fy_px * scale_y,
            cx_px=(self.cx_px + 0.5) * scale_x - 0.5,
            cy_px=(self.cy_px + 0.5) * scale_y - 0.5,
            line_delay_s=self.line_delay_s / scale_y,
        )

    def require_size(self, width_px: int, height_px: int, file: str | Path | None = None) -> None:
        """Raise `InputError` unless this is the picture size of the calibration."""
        if (width_px, height_px) != (self.width_px, self.height_px):
            raise InputError(
                f"picture is {width_px}x{height_px}, the camera's {self.width_px}x{self.height_px}",
                file=file,
                remedy=self._remedy_for(width_px, height_px),
            )

    def is_scaled_to(self, width_px: int, height_px: int) -> bool:
        """Whether pictures of this size have the calibration's aspect ratio, up to rounding of a side."""
        across, down = width_px / self.width_px, height_px / self.height_px
        return min(width_px, height_px) > 0 and abs(across / down - 1.0) < 1.0 / min(width_px, height_px)

    def _remedy_for(self, width_px: int, height_px: int) -> str:
        """Return the remedy for pictures of another size: their calibration, if they were scaled."""
        if not self.is_scaled_to(width_px, height_px):
            return (
                "give the calibration of these pictures; where they were cut out of the larger ones, subtract the "
                "first column and row from cx and cy, and write their resolution"
            )
        scaled = self.resized(width_px, height_px)
        numbers = ", ".join(
            f"{name} {getattr(scaled, f'{name}_px'):.6g}" for name in ("fx", "fy", "cx", "cy")
        )
        return f"give the calibration of these pictures; where they were scaled it is {numbers}, distortion as it is"

    def mount_problem(self, setting: str | None = None) -> str | None:
        """Return one sentence if the mounting is assumed, or the axis over 60 degrees off the body's x; else None.

        ``setting`` names another place for the mounting beside the calibration.
        """
        if self.mount_assumed:
            other = "" if setting is None else f"; or set {setting}"
            return (
                "the calibration does not say how the camera is mounted: taken as looking straight ahead "
                f"(add T_BS, body from camera, to it, in a Kalibr file inside cam0:{other})"
            )
        angle = acos(max(-1.0, min(1.0, float(self.R_body_camera[0, 2]))))
        if angle <= MAX_AXIS_ANGLE_RAD:
            return None
        return (
            f"the camera looks {degrees(angle):.0f} degrees away from the body's x axis: "
            "check the direction of its extrinsic (T_BS or T_cam_imu) and body_frame"
        )

    def _normalised(self, points_px: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
        points = np.asarray(points_px, dtype=float).reshape(-1, 2)
        return (points[:, 0] - self.cx_px) / self.fx_px, (points[:, 1] - self.cy_px) / self.fy_px

    def undistort(self, points_px: npt.ArrayLike) -> FloatArray:
        """Return the normalised image coordinates x/z, y/z (n, 2) of pixels (n, 2).

        The lens models are OpenCV's: radial-tangential, and the equidistant one of its ``fisheye`` module (J.
        Kannala, S. S. Brandt, "A generic camera model and calibration method for conventional, wide-angle, and
        fish-eye lenses", IEEE Transactions on Pattern Analysis and Machine Intelligence 28(8), 2006). NaN where the
        lens model has no inverse, or the ray is 90 degrees or more off the axis.
        """
        x, y = self._normalised(points_px)
        if isinstance(self._lens, RadialTangential):
            x, y = self._lens.undistort(x, y)
        elif isinstance(self._lens, Equidistant):
            radius = np.hypot(x, y)
            angle = self._lens.undistort(radius)
            with np.errstate(divide="ignore", invalid="ignore"):
                scale = np.where(radius == 0.0, 1.0, np.tan(angle) / radius)
            scale[~(angle < pi / 2)] = np.nan
            x, y = x * scale, y * scale
        return np.stack([x, y], axis=1)

    def rays(self, points_px: npt.ArrayLike) -> FloatArray:
        """Return the unit vectors (n, 3) in the optical frame of pixels (n, 2); NaN where there is no inverse.

        Lens models as in `undistort`. With the equidistant model the vectors may point more than 90 degrees away from
        the axis.
        """
        if isinstance(self._lens, Equidistant):
            x, y = self._normalised(points_px)
            radius = np.hypot(x, y)
            angle = self._lens.undistort(radius)
            with np.errstate(divide="ignore", invalid="ignore"):
                scale = np.where(radius == 0.0, 1.0, np.sin(angle) / radius)
            return np.stack([x * scale, y * scale, np.cos(angle)], axis=1)
        normalised = self.undistort(points_px)
        rays = np.concatenate([normalised, np.ones((len(normalised), 1))], axis=1)
        rays /= np.sqrt(np.einsum("ij,ij->i", rays, rays))[:, None]
        return rays

    def project(self, rays: npt.ArrayLike) -> FloatArray:
        """Return the pixels (n, 2) of vectors (n, 3) of any length in the optical frame.

        Lens models as in `undistort`. NaN behind the camera (pinhole models) and beyond the radius up to which the
        distortion is monotonic; a pixel may lie outside the picture.
        """
        vectors = np.asarray(rays, dtype=float).reshape(-1, 3)
        x, y, z = vectors[:, 0], vectors[:, 1], vectors[:, 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            if isinstance(self._lens, Equidistant):
                radius = np.hypot(x, y)
                angle = np.arctan2(radius, z)
                scale = np.where(radius == 0.0, 0.0, self._lens.distort(angle) / radius)
                scale[(radius == 0.0) & ~(z > 0.0)] = np.nan
                x, y = x * scale, y * scale
            else:
                depth = np.where(z > 0.0, z, np.nan)
                x, y = x / depth, y / depth
                if self._lens is not None:
                    x, y = self._lens.distort(x, y)
        return np.stack([x * self.fx_px + self.cx_px, y * self.fy_px + self.cy_px], axis=1)
