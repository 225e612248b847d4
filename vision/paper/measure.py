"""The article's own measurement: k-means of line end points, and the yaw of its equation (8).

Source: "Position and heading estimation for indoor navigation of a micro aerial vehicle using vanishing
point". Steps 1 to 7, picture to lines, are in `vision.paper.lines`; here are step 8, the vanishing point
(section 3.4, equations 5 to 7), step 9, the yaw (section 3.5, equation 8), and step 10, left, centre or right
(Table 1).

It is implemented faithfully and can be selected (``method="paper"``). It is not the default, because it does not
measure the corridor's vanishing point:

- The mean of line end points is the vanishing point only where their density is symmetric about it. The
  border of the picture and other objects with edges break this symmetry, so the point follows the corridor only
  partly.
- Equation (8) has no sign. Its distance to the image centre is the Euclidean one, so that pitch, and any
  vertical error in the picture, counts as yaw; it is hardly ever zero.
- It assumes that the focal length is half the image's height, a vertical field of view of 90 degrees, for every
  camera. Lens distortion, roll and the camera's mounting do not enter.
- The result depends on the random start of the k-means: the point is near the middle of the picture, and the
  sign depends on its side.

The heading error is as large as a vehicle's headings in a corridor, see `HEADING_ERROR_RMS_RAD`; the command
``python benchmarks/article.py --flights`` compares it with a constant heading of 0. The article's own figures
compare equation (8) with an "actual" yaw frame by frame, to 0.3 degrees RMSE; they are in ``data/article``.
"""

from __future__ import annotations

from dataclasses import replace
from math import atan, copysign, hypot, radians
from time import perf_counter
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from vision.errors import InputError
from vision.measurement import FrameMeasurement, LineClass, Position, Reason
from vision.paper.lines import find_lines
from vision.types import FloatArray

if TYPE_CHECKING:
    from vision.cameras.camera import Camera

CLUSTERS = 4  # k of section 3.4
MIN_LINES = 4
DEAD_BAND_TO_WIDTH = 0.005
FIRST_PIXEL = 1.0  # the article's coordinates are MATLAB's: the top-left pixel is (1, 1)
HEADING_ERROR_RMS_RAD = radians(17.0)
"""Measured RMS error of the signed heading; equation (8) gives no uncertainty of its own.

On the rendered flight ``office``, 300 frames against exact truth: 17.2 degrees at 640x480, 17.5 at 320x240,
17.1 at 256x256; a constant heading of 0 has 12.4. On 42 frames of a real flight along one corridor, after
subtracting a constant: 11.4, 14.6 and 12.5; a constant heading has 1.6. The larger one is used. Another seed of the
k-means alone changes the heading by 10 to 15 degrees RMS.
"""


def cluster_end_points(points_px: FloatArray, seed: int = 0) -> FloatArray:
    """Step 8, section 3.4, equations (5) to (7): k-means with k = 4 of the lines' end points.

    Equation (5), the random start, is four distinct end points drawn at random (MATLAB's "sample");
    equations (6), nearest centroid, and (7), mean of each cluster, repeat until convergence. There is a single
    start.

    Parameters
    ----------
    points_px
        Starting and ending points of all lines (m, 2).
    seed
        Seed of the random start; the same points and seed give the same centroids. Global generators are not used.

    Returns
    -------
    Centroids (4, 2); fewer where there are fewer distinct points, or where a cluster became empty.
    """
    from scipy.cluster.vq import kmeans  # slow to import, and seldom needed

    distinct = np.unique(points_px, axis=0)
    if len(distinct) <= CLUSTERS:
        return distinct
    chosen = np.random.default_rng(seed).choice(len(distinct), CLUSTERS, replace=False)
    centroids, _ = kmeans(points_px, distinct[chosen], thresh=1e-9)
    return np.asarray(centroids, dtype=float)


def vanishing_point(lines_px: FloatArray, seed: int = 0) -> tuple[float, float] | None:
    """Step 8, section 3.4: the centroid of the four clusters' centroids.

    The "final clustering" of the centroids has one cluster, so its k-means is their mean.

    Parameters
    ----------
    lines_px
        Lines (n, 4) as x0, y0, x1, y1.
    seed
        See `cluster_end_points`.

    Returns
    -------
    x, y in the lines' pixels, or None with fewer than four lines or four centroids.
    """
    if len(lines_px) < MIN_LINES:
        return None
    centroids = cluster_end_points(lines_px.reshape(-1, 2), seed)
    if len(centroids) < CLUSTERS:
        return None
    x, y = centroids.mean(axis=0)
    return float(x), float(y)


def equation_8(
    vp_x_px: npt.ArrayLike, vp_y_px: npt.ArrayLike, width_px: npt.ArrayLike, height_px: npt.ArrayLike
) -> FloatArray:
    """Step 9, section 3.5, equation (8): unsigned yaw ``atan(D / V)`` of vanishing points.

    The text calls D the horizontal distance from the image centre. The printed yaws follow only from the
    Euclidean distance, ``D = hypot(x - width / 2, y - height / 2)``, with ``V = height / 2`` (279 of the
    article's 287 rows, within 0.06 degrees).

    Parameters
    ----------
    vp_x_px, vp_y_px
        Vanishing points in the article's pixels, the first of which is (1, 1).
    width_px, height_px
        Size of the picture. All four arguments broadcast against each other.

    Returns
    -------
    Angle in [0, pi/2), radians, of the broadcast shape.

    Raises
    ------
    InputError
        Where a size is not positive.
    """
    width, height = np.asarray(width_px, dtype=float), np.asarray(height_px, dtype=float)
    if not (np.all(width > 0) and np.all(height > 0)):
        raise InputError(
            "width_px and height_px must be positive", remedy="give the size of the picture in pixels"
        )
    half_width, half_height = width / 2, height / 2
    d = np.hypot(
        np.asarray(vp_x_px, dtype=float) - half_width, np.asarray(vp_y_px, dtype=float) - half_height
    )
    return np.asarray(np.arctan(d / half_height), dtype=float)


def paper_yaw(vp_x_px: float, vp_y_px: float, width_px: int, height_px: int) -> float:
    """Return `equation_8` of one vanishing point without numpy and without checks, for use in flight."""
    return atan(hypot(vp_x_px - 0.5 * width_px, vp_y_px - 0.5 * height_px) / (0.5 * height_px))


def position_of(vp_x_px: float, width_px: float) -> Position:
    """Step 10, Table 1: side of the corridor from the horizontal offset of the vanishing point.

    A vanishing point right of the image centre means "left", left of it "right"; within 0.5 % of the width it means
    "centre". (The article gives no dead band: its three rows need one between 0.40 and 0.69 %.) Actually this
    offset depends on the heading, not on the position.

    Parameters
    ----------
    vp_x_px
        In the article's pixels, the first of which is 1.
    width_px
        Width of the picture.
    """
    offset = vp_x_px - width_px / 2
    if abs(offset) <= DEAD_BAND_TO_WIDTH * width_px:
        return Position.CENTRE
    return Position.LEFT if offset > 0 else Position.RIGHT


def measure_paper(
    image_grey: npt.NDArray[np.generic],
    camera: Camera | None = None,
    seed: int = 0,
    *,
    kernel_feeds_canny: bool = True,
) -> FrameMeasurement:
    """Measure one picture by the article's method.

    Parameters
    ----------
    image_grey
        Picture (h, w) uint8; colour (h, w, 3) BGR is converted to grey as in step 1.
    camera
        Not used: the article's method has no camera model. It gives both methods the same signature.
    seed
        Seed of the k-means' random start.
    kernel_feeds_canny
        See `vision.paper.lines.respond_45_degrees`: False is the other reading of the article.

    Returns
    -------
    ``paper_yaw_rad`` is equation (8); ``heading_rad`` is the same angle with the side's sign, positive where
    the vanishing point is left of the image centre (turned right), and ``heading_std_rad`` is
    `HEADING_ERROR_RMS_RAD`. ``position`` is as in Table 1. The article measures no lateral offset; it is NaN, like
    all other numbers that the method does not give.

    Raises
    ------
    InputError
        Where the array is not a picture.
    """
    start = perf_counter()
    lines = find_lines(image_grey, kernel_feeds_canny)
    height, width = image_grey.shape[:2]
    measurement = _measure_lines(lines, width, height, seed)
    return replace(measurement, vision_ms=1e3 * (perf_counter() - start))


def _measure_lines(lines: FloatArray, width: int, height: int, seed: int) -> FrameMeasurement:
    """Run steps 8 to 10 on the lines (n, 4) of a picture of this size."""
    found = FrameMeasurement(
        accepted=False,
        reason=Reason.TOO_FEW_LINES,
        n_lines=len(lines),
        lines_px=lines.astype(np.float32),
        line_class=np.full(len(lines), LineClass.CORRIDOR, dtype=np.int8),
    )
    vp = vanishing_point(lines, seed)
    if vp is None:
        return found
    x, y = vp[0] + FIRST_PIXEL, vp[1] + FIRST_PIXEL
    yaw_rad = float(equation_8(x, y, width, height))
    return replace(
        found,
        accepted=True,
        reason=Reason.OK,
        n_inliers=len(lines),  # every line votes; the article rejects none
        vp_px=vp,
        heading_rad=copysign(yaw_rad, width / 2 - x),
        heading_std_rad=HEADING_ERROR_RMS_RAD,
        position=position_of(x, width),
        paper_yaw_rad=yaw_rad,
    )
