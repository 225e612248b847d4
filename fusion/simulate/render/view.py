"""Pictures of a `Mesh` in linear light, through any `vision.Camera`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from fusion.simulate.render.mesh import Mesh
from fusion.simulate.render.raster import BLOCK, render_rows
from vision import Camera

FloatArray = npt.NDArray[np.float64]
Image = npt.NDArray[np.float32]

SUB_EXPOSURE_PX = 1.5  # distance of the pictures averaged for motion blur; about the blur of the lens
MAX_SUB_EXPOSURES = 24


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """Constants of a camera for all its frames.

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


def exposure_moments(view: View, exposure_s: float, turned_rad: float, grid: int) -> tuple[FloatArray, int]:
    """Moments (k,) of an exposure to average, relative to its middle, and the edge grid for this number.

    ``turned_rad`` is the picture's motion during the exposure.
    """
    pixels = turned_rad / float(np.median(view.pixel_rad))
    count = int(np.clip(np.ceil(pixels / SUB_EXPOSURE_PX), 1, MAX_SUB_EXPOSURES))
    if count > 1:  # the moments differ by a pixel, so together they sample edges finely enough
        grid = max(2, round(grid / count**0.5))
    return ((np.arange(count) + 0.5) / count - 0.5) * exposure_s, grid


def render_linear(
    mesh: Mesh, view: View, origins: Sequence[FloatArray], rotations: Sequence[FloatArray], grid: int = 4
) -> Image:
    """Radiance (h, w), averaged over moments of an exposure.

    Parameters
    ----------
    origins, rotations
        For each moment, the camera's centre (3,) or (h, 3), and R_world_body (3, 3) or (h, 3, 3): one pose, or one
        for every pixel row (rolling shutter). World z down, metres.
    grid
        Samples across a pixel that contains an edge.
    """
    height, width = view.camera.height_px, view.camera.width_px
    total, total_share = np.zeros((height, width), np.float32), np.zeros((height, width), np.float32)
    direct, share = np.empty_like(total), np.empty_like(total)
    mirror = np.full((height, width), -1.0, np.float32)
    moments = list(zip(origins, rotations, strict=True))
    for turn, (origin, rotation) in enumerate(moments):
        centre = np.array(np.broadcast_to(origin, (height, 3)), float, order="C")
        R = np.array(np.broadcast_to(rotation, (height, 3, 3)), float, order="C")
        direct[:], share[:] = 0.0, 0.0
        fixed = (view.corner_rays, view.pixel_rad, centre, R)
        render_rows(*mesh, *fixed, grid, turn, len(moments), direct, share, mirror)
        total += direct
        total_share += share
    if total_share.any():
        total += total_share * _spread(mirror)
    return np.asarray(total / np.float32(len(moments)), np.float32)


def _spread(mirror: Image) -> Image:
    """Average mirrored light over the blocks whose pixels share its directions, if there is any."""
    mask = (mirror >= 0).astype(np.float32)
    size, ddepth = (BLOCK, BLOCK), -1
    blurred = cv2.GaussianBlur(cv2.boxFilter(mirror * mask, ddepth, size), (3, 3), 0)
    weight = cv2.GaussianBlur(cv2.boxFilter(mask, ddepth, size), (3, 3), 0)
    return np.asarray(blurred / np.maximum(weight, 1e-3), np.float32)
