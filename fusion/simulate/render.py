"""Pictures of a `Mesh` in linear light, through any `vision.Camera`."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from fusion.simulate.mesh import Mesh
from fusion.simulate.raster import render_rows
from vision import Camera

FloatArray = npt.NDArray[np.float64]
Image = npt.NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """What does not change from frame to frame of one camera.

    Parameters
    ----------
    corner_rays
        Unit vectors in the body frame through the pixel corners, (h + 1, w + 1, 3); NaN outside the lens.
    pixel_rad
        Angular size of each pixel, (h, w).
    """

    camera: Camera
    corner_rays: FloatArray
    pixel_rad: FloatArray

    @classmethod
    def of(cls, camera: Camera) -> View:
        """Compute the rays of a camera."""
        h, w = camera.height_px, camera.width_px
        y, x = np.mgrid[0 : h + 1, 0 : w + 1]
        points = np.stack([x.ravel() - 0.5, y.ravel() - 0.5], axis=1)
        rays = (camera.rays(points) @ camera.R_body_camera.T).reshape(h + 1, w + 1, 3)
        right = np.linalg.norm(rays[:-1, 1:] - rays[:-1, :-1], axis=2)
        down = np.linalg.norm(rays[1:, :-1] - rays[:-1, :-1], axis=2)
        return cls(camera, np.ascontiguousarray(rays), np.nan_to_num(np.sqrt(right * down), nan=1e-3))


def render_linear(mesh: Mesh, view: View, origins: FloatArray, rotations: FloatArray, grid: int = 4) -> Image:
    """Radiance (h, w) seen from a pose, or from one pose per pixel row (rolling shutter).

    Parameters
    ----------
    origins, rotations
        Camera centre (3,) or (h, 3), and R_world_body (3, 3) or (h, 3, 3); world z down, metres.
    grid
        Samples across a pixel where edges cross it.
    """
    height, width = view.camera.height_px, view.camera.width_px
    slack = 1e-6
    if rotations.ndim == 3:  # the rows of a tile see from slightly different places
        slack += 2e-3
    origins = np.ascontiguousarray(np.broadcast_to(origins, (height, 3)), float)
    rotations = np.ascontiguousarray(np.broadcast_to(rotations, (height, 3, 3)), float)
    direct, share, mirror = (np.zeros((height, width), np.float32) for _ in range(3))
    render_rows(
        *mesh[:2],
        *mesh[2:],
        view.corner_rays,
        view.pixel_rad,
        origins,
        rotations,
        grid,
        slack,
        direct,
        share,
        mirror,
    )
    if share.any():
        return direct + share * _spread(mirror, share > 0, height)
    return direct


def _spread(mirror: Image, where: npt.NDArray[np.bool_], height: int) -> Image:
    """Smooth mirrored light within the glossy region: the jitter of single rays becomes a soft reflection."""
    size = (max(3, round(height / 80) | 1), max(3, round(height / 40) | 1))
    mask = where.astype(np.float32)
    blurred = cv2.GaussianBlur(mirror * mask, size, 0)
    weight = cv2.GaussianBlur(mask, size, 0)
    return np.asarray(blurred / np.maximum(weight, 1e-3), np.float32)
