"""Lines of a rolling shutter's picture, as if all of its rows had been exposed with the middle one.

While the rows are exposed one after the other, the camera turns. A ray seen t after the middle row had, at the middle
row's moment, the direction ``exp([w t]) r`` in the camera, where w is the angular rate. The camera's movement is left
out: it is small against the turn.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from vision.cameras.camera import Camera
from vision.cameras.projection import is_distorted
from vision.lines.line_set import LineSet
from vision.types import FloatArray


def to_picture(points_px: FloatArray, camera: Camera) -> FloatArray:
    """Bring points (n, 2) from rectified pixels to where they are in the picture as it was taken."""
    return camera.project(_rectified_rays(points_px, camera)) if is_distorted(camera) else points_px


def lines_at_one_moment(lines: LineSet, camera: Camera, body_rates_rad_s: npt.ArrayLike) -> LineSet:
    """Return the planes of a picture's lines at the moment of its middle row.

    Parameters
    ----------
    lines
        As found; their ends stay where they are in the picture.
    camera
        What took the picture, with its ``line_delay_s``.
    body_rates_rad_s
        Angular rate (3,) of the body, FRD, while the picture was read.
    """
    rate = camera.R_body_camera.T @ np.asarray(body_rates_rad_s, dtype=float)
    rays = []
    for points in (lines.ends_px[:, :2], lines.ends_px[:, 2:]):
        row = to_picture(points, camera)[:, 1]
        seconds = np.nan_to_num((row - 0.5 * (camera.height_px - 1)) * camera.line_delay_s)
        ray = _rectified_rays(points, camera)
        turn = seconds[:, None] * rate
        across = np.cross(turn, ray)
        rays.append(ray + across + 0.5 * np.cross(turn, across))  # exp, as turns are of a degree or two
    return lines.with_ends(*rays)


def _rectified_rays(points_px: FloatArray, camera: Camera) -> FloatArray:
    x = (points_px[:, 0] - camera.cx_px) / camera.fx_px
    y = (points_px[:, 1] - camera.cy_px) / camera.fy_px
    return np.column_stack([x, y, np.ones(len(points_px))])
