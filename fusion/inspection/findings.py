"""Findings of `corridor inspect` about one stream or one camera."""

from __future__ import annotations

from dataclasses import dataclass
from math import degrees

import numpy as np

from fusion.inspection.imu import ImuFindings
from fusion.inspection.pictures import PictureFindings
from fusion.inspection.times import Timing
from fusion.logs.contents import Kind
from vision import Camera


@dataclass(frozen=True, slots=True)
class CameraFindings:
    """Main values of a camera's calibration."""

    width_px: int
    height_px: int
    fx_px: float
    horizontal_fov_deg: float
    distortion: str
    looks_right_deg: float
    looks_up_deg: float
    mount_assumed: bool

    @classmethod
    def of(cls, camera: Camera) -> CameraFindings:
        """Describe a camera."""
        middle = (camera.height_px - 1) / 2.0
        left, right = camera.rays([[-0.5, middle], [camera.width_px - 0.5, middle]])
        axis = camera.R_body_camera[:, 2]
        return cls(
            camera.width_px,
            camera.height_px,
            camera.fx_px,
            degrees(float(np.arccos(np.clip(left @ right, -1.0, 1.0)))),
            str(camera.distortion),
            degrees(float(np.arctan2(axis[1], axis[0]))),
            degrees(float(np.arctan2(-axis[2], np.hypot(axis[0], axis[1])))),
            camera.mount_assumed,
        )


@dataclass(frozen=True, slots=True)
class StreamFindings:
    """One topic: its times, and the properties of its samples, if they were read.

    Parameters
    ----------
    name, kind, note
        Name, kind and note in the log.
    chosen
        Whether `corridor fuse` would choose it by default.
    timing
        Of the times in the log, or of the spread ones if a driver stamped bursts.
    frames_covered
        Share of the chosen camera's frames between its first and its last sample; None without pictures.
    problems
        Samples dropped or repaired on reading.
    error
        Reason why it cannot be read.
    imu, pictures, camera
        For an IMU, a camera, and a camera with a calibration in the log.
    distances_m
        Smallest, median and largest distance to the floor, for a range sensor.
    """

    name: str
    kind: Kind
    note: str
    chosen: bool
    timing: Timing
    frames_covered: float | None = None
    problems: tuple[str, ...] = ()
    error: str | None = None
    imu: ImuFindings | None = None
    pictures: PictureFindings | None = None
    camera: CameraFindings | None = None
    distances_m: tuple[float, float, float] | None = None
