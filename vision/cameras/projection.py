"""Projection of directions in any frame to pixels, compiled for lenses without distortion."""

from __future__ import annotations

import numpy as np

from vision.cameras.camera import Camera, Distortion
from vision.compiled import compiled
from vision.types import FloatArray


def is_distorted(camera: Camera) -> bool:
    """Whether straight lines are curved in this camera's pictures."""
    return any(camera.coefficients) or camera.distortion is Distortion.EQUIDISTANT


@compiled
def _project_turned(
    directions: FloatArray, R: FloatArray, fx: float, fy: float, cx: float, cy: float
) -> FloatArray:
    points = np.empty((len(directions), 2))
    for i in range(len(directions)):
        a, b, c = directions[i, 0], directions[i, 1], directions[i, 2]
        z = a * R[0, 2] + b * R[1, 2] + c * R[2, 2]
        if not z > 0.0:
            points[i] = np.nan
            continue
        points[i, 0] = (a * R[0, 0] + b * R[1, 0] + c * R[2, 0]) / z * fx + cx
        points[i, 1] = (a * R[0, 1] + b * R[1, 1] + c * R[2, 1]) / z * fy + cy
    return points


def project_directions(directions: FloatArray, R_frame_camera: FloatArray, camera: Camera) -> FloatArray:
    """Return the pixels (n, 2) of directions in a given frame; NaN where they have none, see `Camera.project`.

    Parameters
    ----------
    directions
        Vectors (n, 3) of any length.
    R_frame_camera
        Rotation (3, 3) from the optical frame to the directions' frame.
    camera
        The camera.
    """
    if is_distorted(camera):
        return camera.project(directions @ R_frame_camera)
    return _project_turned(directions, R_frame_camera, camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px)
