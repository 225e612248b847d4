"""What `corridor inspect` found about one stream or one camera."""

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
    """The calibration of a camera, as far as a person checks it at a glance."""

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
    """One topic: its times, and what its samples show where they were looked at.

    Parameters
    ----------
    name, kind, note
        As the log names and describes it.
    chosen
        Whether `corridor fuse` would take it, without being told.
    timing
        Of the times as the log has them, or as they were spread where a driver stamped bursts.
    frames_covered
        Share of the chosen camera's frames between its first and its last sample; None without pictures.
    problems
        What was dropped or mended on reading it.
    error
        Why it cannot be read at all.
    imu, pictures, camera
        For an IMU, a camera, and a camera that the log has a calibration for.
    distances_m
        Least, median and greatest distance to the floor, for a range sensor.
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
