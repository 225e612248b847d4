"""Log-polar picture about the corridor's axis: lines along the corridor become columns.

A direction at the angle a about the axis and b off the axis is ``(1, tan b cos a, tan b sin a)`` in the corridor's
axes (along, right, down). Columns sample a, rows sample log tan b. The corner where a wall meets the floor lies in
one column, from the far end of the corridor in the first row to the near end in the last. Angles are counted from
the corridor's right, clockwise as seen along it: right 0, down pi/2, left pi, up 3/2 pi.
"""

from __future__ import annotations

from itertools import pairwise
from math import hypot, pi
from threading import local

import cv2
import numpy as np
import numpy.typing as npt

from vision.cameras.camera import Camera
from vision.cameras.projection import project_directions
from vision.compiled import compiled
from vision.images import GreyImage

FloatArray = npt.NDArray[np.float64]
Polar = npt.NDArray[np.float32]

N_ANGLES, N_RADII = 192, 20
NEAREST_TAN, WIDEST_TAN = 0.14, 2.0  # of the angle off the axis, first row and last
NARROWEST_TAN = 0.65  # from the centre to a corner of the picture, for the narrowest lens in training
N_LEVELS = 6  # of the pyramid
MIN_SIDE_PX = 8
MAX_SIGMA = 3.0  # standardised brightness is clipped here

_PER_THREAD = local()

ANGLES: FloatArray = np.linspace(0.5, N_ANGLES - 0.5, N_ANGLES) * (2.0 * pi / N_ANGLES)
TANGENTS: FloatArray = NEAREST_TAN * (WIDEST_TAN / NEAREST_TAN) ** (np.arange(N_RADII) / (N_RADII - 1))
# Directions (N_RADII, N_ANGLES, 3) of the samples: along the corridor, right, down
DIRECTIONS: FloatArray = np.stack(
    [
        np.ones((N_RADII, N_ANGLES)),
        TANGENTS[:, None] * np.cos(ANGLES),
        TANGENTS[:, None] * np.sin(ANGLES),
    ],
    axis=-1,
)


@compiled
def _sample(
    points: FloatArray, pixels: npt.NDArray[np.float32], sizes: npt.NDArray[np.int64], out: Polar
) -> None:
    """Sample the pyramid at points (rows, columns, 2), each at the level whose pixels match the column spacing."""
    height, width = sizes[0, 0], sizes[0, 1]
    n_columns = points.shape[1]
    for r in range(points.shape[0]):
        for a in range(n_columns):
            x, y = points[r, a, 0], points[r, a, 1]
            if not (-0.5 <= x <= width - 0.5 and -0.5 <= y <= height - 0.5):  # NaN neither
                out[0, r, a] = 0.0
                out[1, r, a] = 0.0
                continue
            after = a + 1 if a + 1 < n_columns else 0
            gap = (points[r, after, 0] - x) ** 2 + (points[r, after, 1] - y) ** 2
            if not gap < 1e9:
                gap = (points[r, a - 1, 0] - x) ** 2 + (points[r, a - 1, 1] - y) ** 2
            level = start = 0
            while gap > 2.0 and level + 1 < len(sizes):
                gap *= 0.25
                start += sizes[level, 0] * sizes[level, 1]
                level += 1
            rows, columns = sizes[level, 0], sizes[level, 1]
            u = min(max((x + 0.5) * columns / width - 0.5, 0.0), columns - 1.0)
            v = min(max((y + 0.5) * rows / height - 0.5, 0.0), rows - 1.0)
            i, j = min(int(u), columns - 2), min(int(v), rows - 2)
            u -= i
            v -= j
            k = start + j * columns + i
            above = pixels[k] * (1.0 - u) + pixels[k + 1] * u
            below = pixels[k + columns] * (1.0 - u) + pixels[k + columns + 1] * u
            out[0, r, a] = above * (1.0 - v) + below * v
            out[1, r, a] = 1.0


@compiled
def standardise(polar: Polar) -> None:
    """Standardise the valid samples (2, rows, columns) to mean 0 and standard deviation 1, in place."""
    count = total = squares = 0.0
    for r in range(polar.shape[1]):
        for a in range(polar.shape[2]):
            count += polar[1, r, a]
            total += polar[0, r, a]
            squares += polar[0, r, a] * polar[0, r, a]
    mean = total / max(count, 1.0)
    std = np.sqrt(max(squares / max(count, 1.0) - mean * mean, 0.0))
    for r in range(polar.shape[1]):
        for a in range(polar.shape[2]):
            z = (polar[0, r, a] - mean) / (std + 1.0)
            polar[0, r, a] = min(max(z, -MAX_SIGMA), MAX_SIGMA) * polar[1, r, a]


class Pyramid:
    """Image pyramid by halving, in one buffer that is reused for every picture, see `pyramid_of`.

    Allocating it anew would map and clear the memory for every frame, which takes longer than filling it.
    """

    def __init__(self, height: int, width: int) -> None:
        sizes = [(height, width)]
        while len(sizes) < N_LEVELS and min(sizes[-1]) >= 2 * MIN_SIDE_PX:
            sizes.append(((sizes[-1][0] + 1) // 2, (sizes[-1][1] + 1) // 2))
        self.sizes = np.array(sizes, dtype=np.int64)
        ends = np.cumsum(self.sizes.prod(axis=1))
        self.pixels = np.empty(ends[-1], np.float32)
        parts = np.split(self.pixels, ends[:-1])
        self._levels = [part.reshape(size) for part, size in zip(parts, sizes, strict=True)]

    def fill(self, grey: GreyImage) -> None:
        """Fill all levels from a picture (h, w)."""
        np.copyto(self._levels[0], grey)
        for large, small in pairwise(self._levels):
            cv2.resize(large, small.shape[::-1], dst=small, interpolation=cv2.INTER_AREA)


def pyramid_of(picture: GreyImage | Pyramid) -> Pyramid:
    """Return the pyramid of a picture (h, w); valid until this thread requests another picture's."""
    if isinstance(picture, Pyramid):
        return picture
    pyramid: Pyramid | None = getattr(_PER_THREAD, "pyramid", None)
    if pyramid is None or tuple(pyramid.sizes[0]) != picture.shape:
        pyramid = _PER_THREAD.pyramid = Pyramid(*picture.shape)
    pyramid.fill(picture)
    return pyramid


def sample_points(picture: GreyImage | Pyramid, points_px: FloatArray) -> Polar:
    """Sample brightness (grey levels) and validity (2, rows, columns) of a picture at points (rows, columns, 2).

    Each sample averages over about the distance to the next column, which suppresses noise and fine texture. Points
    outside the picture, or NaN, are 0 and invalid.
    """
    pyramid = pyramid_of(picture)
    out: Polar = np.empty((2, *points_px.shape[:2]), np.float32)
    _sample(points_px, pyramid.pixels, pyramid.sizes, out)
    return out


def _directions_for(camera: Camera) -> FloatArray:
    """Return `DIRECTIONS` for a camera, scaled towards the axis where its lens is narrower than any in training.

    A corridor has one cross-section at all depths, so scaling the tangents only scales the depths.
    """
    corner_tan = 0.5 * hypot(camera.width_px / camera.fx_px, camera.height_px / camera.fy_px)
    if corner_tan >= NARROWEST_TAN:
        return DIRECTIONS
    scale = corner_tan / NARROWEST_TAN
    return np.asarray(DIRECTIONS * np.array([1.0, scale, scale]), dtype=float)


def polar_picture(picture: GreyImage | Pyramid, camera: Camera, R_corridor_camera: FloatArray) -> Polar:
    """Resample a picture about the corridor's axis.

    Parameters
    ----------
    picture
        Original picture (h, w), not undistorted: the lens model is applied to the directions.
    R_corridor_camera
        Rotation (3, 3) by `vision.axis.vanishing_point.corridor_frame`.

    Returns
    -------
    Polar
        Standardised brightness and validity (2, N_RADII, N_ANGLES).
    """
    directions = _directions_for(camera).reshape(-1, 3)
    points = project_directions(directions, R_corridor_camera, camera)
    polar = sample_points(picture, points.reshape(N_RADII, N_ANGLES, 2))
    standardise(polar)
    return polar
