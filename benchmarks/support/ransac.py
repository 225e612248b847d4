"""The usual way: OpenCV's line segment detector, then RANSAC for the point where most of them meet.

Written plainly but with care, to compare with: it is given the same camera and attitude, leaves door posts out,
weighs segments by their length and refines on the inliers.
"""

from __future__ import annotations

from functools import lru_cache
from math import atan2, hypot, nan, radians

import cv2
import numpy as np
import numpy.typing as npt

from vision import Attitude, Camera
from vision.images import GreyImage

FloatArray = npt.NDArray[np.float64]

TRIALS = 300
INLIER_RAD = radians(0.7)
UPRIGHT_SINE = 0.10
MAX_ELEVATION_RAD, MAX_HEADING_RAD = radians(6.0), radians(60.0)
MIN_LENGTH_OF_DIAGONAL = 0.03
MIN_INLIERS = 4
REFINEMENTS = 5
RUNAWAY_RAD = radians(3.0)


@lru_cache(maxsize=1)
def _detector() -> cv2.LineSegmentDetector:
    return cv2.createLineSegmentDetector()


def segments(image: GreyImage) -> FloatArray:
    """Line segments (n, 4) x0, y0, x1, y1 of OpenCV's LSD with its defaults."""
    found = _detector().detect(image)[0]
    return np.empty((0, 4)) if found is None else np.asarray(found, float).reshape(-1, 4)


def heading_by_ransac(image: GreyImage, camera: Camera, attitude: Attitude, seed: int = 0) -> float:
    """Heading of the vanishing point of most segments by length; NaN where fewer than four meet."""
    ends = segments(image)
    length = np.hypot(ends[:, 2] - ends[:, 0], ends[:, 3] - ends[:, 1])
    ends, length = _longest(ends, length, MIN_LENGTH_OF_DIAGONAL * hypot(*image.shape))
    if len(ends) < MIN_INLIERS:
        return nan
    R = attitude.R_level_body() @ camera.R_body_camera
    normal = np.cross(camera.rays(ends[:, :2]), camera.rays(ends[:, 2:])) @ R.T
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    flat = np.abs(normal[:, 2]) > UPRIGHT_SINE
    normal, length = normal[flat], length[flat]
    if len(normal) < MIN_INLIERS:
        return nan
    axes = _hypotheses(normal, length, np.random.default_rng(seed))
    if not len(axes):
        return nan
    support = (np.abs(axes @ normal.T) < INLIER_RAD) @ length
    return heading_of(_refined(axes[int(np.argmax(support))], normal, length))


def _refined(axis: FloatArray, normal: FloatArray, length: FloatArray) -> FloatArray:
    """Fit the axis (3,) to its inliers by least squares, unless the fit runs away from it."""
    best = axis
    for _ in range(REFINEMENTS):
        inlier = np.abs(normal @ best) < INLIER_RAD
        if inlier.sum() < MIN_INLIERS:
            break
        weighted = normal[inlier] * length[inlier, None]
        best = np.linalg.eigh(weighted.T @ weighted)[1][:, 0]
    return best if abs(best @ axis) > np.cos(RUNAWAY_RAD) else axis


def heading_of(axis: FloatArray) -> float:
    """Heading relative to an axis (3,) in the level frame, whichever way it points."""
    ahead = axis if axis[0] >= 0 else -axis
    return atan2(-ahead[1], ahead[0])


def _longest(ends: FloatArray, length: FloatArray, at_least: float) -> tuple[FloatArray, FloatArray]:
    keep = length >= at_least
    return ends[keep], length[keep]


def _hypotheses(normal: FloatArray, length: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Axes (k, 3) of random pairs of lines, long ones more often, that could be a corridor's."""
    pairs = rng.choice(len(normal), size=(TRIALS, 2), p=length / length.sum())
    axes = np.cross(normal[pairs[:, 0]], normal[pairs[:, 1]])
    size = np.linalg.norm(axes, axis=1)
    axes = axes[size > 1e-6] / size[size > 1e-6, None]
    axes *= np.where(axes[:, :1] < 0, -1.0, 1.0)
    level = np.abs(axes[:, 2]) < np.sin(MAX_ELEVATION_RAD)
    ahead = np.abs(np.arctan2(axes[:, 1], axes[:, 0])) < MAX_HEADING_RAD
    return np.asarray(axes[level & ahead], dtype=float)
