"""Correction of a rolling shutter: lines as if all rows had been exposed together with the middle row.

The camera rotates while the rows are exposed one after the other. A ray r seen the time t after the middle row has,
at the middle row's time, the direction ``exp([w t]_x) r`` in the camera, with the angular rate w; the exponential is
computed to second order. The camera's translation is neglected, as its effect is small compared with the rotation's.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from vision.cameras.camera import Camera
from vision.cameras.projection import is_distorted
from vision.lines.line_set import LineSet
from vision.types import FloatArray


def to_original_px(points_px: FloatArray, camera: Camera) -> FloatArray:
    """Map points (n, 2) from rectified pixels to the original picture."""
    return camera.project(_rectified_rays(points_px, camera)) if is_distorted(camera) else points_px


def correct_rolling_shutter(lines: LineSet, camera: Camera, body_rates_rad_s: npt.ArrayLike) -> LineSet:
    """Return the lines with their planes at the time of the picture's middle row.

    Parameters
    ----------
    lines
        Lines as extracted; their ends in pixels do not change.
    camera
        The camera, with its ``line_delay_s``.
    body_rates_rad_s
        Angular rate (3,) of the body, FRD, during the readout.
    """
    rate = camera.R_body_camera.T @ np.asarray(body_rates_rad_s, dtype=float)
    rays = []
    for points in (lines.ends_px[:, :2], lines.ends_px[:, 2:]):
        row = to_original_px(points, camera)[:, 1]
        seconds = np.nan_to_num((row - 0.5 * (camera.height_px - 1)) * camera.line_delay_s)
        ray = _rectified_rays(points, camera)
        turn = seconds[:, None] * rate
        across = np.cross(turn, ray)
        rays.append(ray + across + 0.5 * np.cross(turn, across))  # second order: turns are a degree or two
    return lines.with_ends(*rays)


def _rectified_rays(points_px: FloatArray, camera: Camera) -> FloatArray:
    x = (points_px[:, 0] - camera.cx_px) / camera.fx_px
    y = (points_px[:, 1] - camera.cy_px) / camera.fy_px
    return np.column_stack([x, y, np.ones(len(points_px))])
