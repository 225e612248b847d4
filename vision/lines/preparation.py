"""Size and blur of the picture in which lines are searched, chosen by its resolution, noise and JPEG artefacts.

Large pictures are reduced and small ones enlarged (`working_camera`); fine ones are then resampled at three quarters
(`resample_for_search`). `blur_by_noise` applies a Gaussian blur of 3, 5 or 7 pixels, depending on noise and
blockiness.
"""

from __future__ import annotations

from functools import lru_cache
from math import ceil, hypot, sqrt

import cv2
import numpy as np

from vision.cameras.camera import Camera
from vision.compiled import compiled, compiled_inner
from vision.lines.edges import median_bin
from vision.types import GreyImage

# Three quarters of the size suppress artefacts of single pixels by sensor, compression and resampling. The blur
# before makes all pixels of the smaller picture about equally sharp at any sub-pixel phase, so that a picture shifted
# by half a pixel gives the same lines.
FINE_DIAGONAL_PX = 600.0
FINE_SCALE, FINE_BLUR_PX, FINE_SHARPNESS = 0.75, 0.65, 0.67
SMOOTH_FROM_NOISE = (5.0, 14.0)  # noise above which the blur is 3, 5 pixels
SMOOTH_FROM_BLOCKINESS = (1.7, 1.7, 2.6)  # blockiness above which the blur is 3, 5, 7 pixels
# Of a sharp edge after a blur of 1, 3, 5, 7 pixels, see `vision.lines.edges.connect_edge_pixels`
SHARPNESS = (0.80, 0.58, 0.42, 0.34)
SMALL_DIAGONAL_PX = 300.0
MAX_DIAGONAL_PX = 1000.0
SECOND_DIFFERENCE_MEDIAN = 0.6745 * sqrt(6.0)  # median of |a - 2b + c| for noise of one grey level
ROW_STEP = 8
MAX_BLOCK_STEP = 20  # limits the influence of the picture's own edges
MAX_SECOND_DIFFERENCE = 2 * 255


@compiled_inner
def _block_step(row: GreyImage, x: int) -> int:
    """Return the absolute difference of a row's pixel x and its predecessor, at most `MAX_BLOCK_STEP`."""
    return int(min(abs(np.int32(row[x]) - np.int32(row[x - 1])), np.int32(MAX_BLOCK_STEP)))


@compiled
def estimate_noise_and_blockiness(grey: GreyImage) -> tuple[float, float]:
    """Estimate a picture's noise, standard deviation in grey levels, and its blockiness by JPEG compression.

    The noise follows from the median of |a - 2b + c| along every eighth row, which is robust to edges. Blockiness is
    the mean step between columns 8k - 1 and 8k, where JPEG's blocks meet, over the mean step elsewhere: about 1 for
    uncompressed pictures, 1.5 for good quality, 2 and more where the blocks are visible.

    Parameters
    ----------
    grey
        Picture (h, w).
    """
    height, width = grey.shape
    # Two alternating tables: incrementing one counter twice in a row would stall the processor.
    counts = np.zeros((2, MAX_SECOND_DIFFERENCE + 1), np.int64)
    n = at_joint = everywhere = 0
    for y in range(0, height, ROW_STEP):
        row = grey[y]
        for x in range(1, width - 1):
            counts[x & 1, abs(np.int64(row[x - 1]) - 2 * np.int64(row[x]) + np.int64(row[x + 1]))] += 1
        for x in range(1, width - 1):
            everywhere += _block_step(row, x)
        for x in range(8, width - 1, 8):
            at_joint += _block_step(row, x)
        n += max(width - 2, 0)
    elsewhere = everywhere - at_joint
    total = counts[0] + counts[1]
    below, level = median_bin(total, n)
    median = level - 0.5 + (0.5 * n - below) / max(total[level], 1)
    return max(median, 0.0) / SECOND_DIFFERENCE_MEDIAN, 7.0 * at_joint / max(elsewhere, 1)


def resample_for_search(grey: GreyImage, camera: Camera) -> tuple[Camera, GreyImage, float]:
    """Resample a picture to the size at which lines are searched.

    Returns
    -------
    tuple
        Camera and picture of that size, and the sharpness of a sharp edge in it.
    """
    working = working_camera(camera)
    picture = resize_picture(grey, working)
    if hypot(*picture.shape) <= FINE_DIAGONAL_PX:
        return working, picture, SHARPNESS[0]
    working = resized_camera(working, FINE_SCALE)
    size = (working.width_px, working.height_px)
    even = cv2.GaussianBlur(picture, (3, 3), FINE_BLUR_PX)
    return (
        working,
        np.asarray(cv2.resize(even, size, interpolation=cv2.INTER_LINEAR), np.uint8),
        FINE_SHARPNESS,
    )


@lru_cache(maxsize=8)
def working_camera(camera: Camera) -> Camera:
    """Return the camera scaled to the base size for line search.

    Larger pictures cost time without better lines. In small ones neighbouring edges interfere, which interpolation
    partly prevents.
    """
    diagonal = hypot(camera.width_px, camera.height_px)
    if diagonal > MAX_DIAGONAL_PX:
        scale = 1.0 / ceil(diagonal / MAX_DIAGONAL_PX)
    elif diagonal < SMALL_DIAGONAL_PX:
        scale = 2.0
    else:
        return camera
    return resized_camera(camera, scale)


@lru_cache(maxsize=8)
def resized_camera(camera: Camera, scale: float) -> Camera:
    """Return the camera for its pictures at ``scale`` times their size."""
    return camera.resized(max(round(camera.width_px * scale), 1), max(round(camera.height_px * scale), 1))


def resize_picture(grey: GreyImage, camera: Camera) -> GreyImage:
    """Return a grey picture (h, w) at the camera's size."""
    size = (camera.width_px, camera.height_px)
    if size == grey.shape[::-1]:
        return grey
    interpolation = cv2.INTER_AREA if size[0] < grey.shape[1] else cv2.INTER_CUBIC
    return np.asarray(cv2.resize(grey, size, interpolation=interpolation), np.uint8)


def blur_by_noise(picture: GreyImage, out: GreyImage) -> tuple[GreyImage, float]:
    """Blur as little as the noise allows; return the picture, and the share of sharpness that a sharp edge retains.

    More blur would bias edges towards their neighbours.
    """
    noise, blockiness = estimate_noise_and_blockiness(picture)
    level = max(
        sum(noise > limit for limit in SMOOTH_FROM_NOISE),
        sum(blockiness > limit for limit in SMOOTH_FROM_BLOCKINESS),
    )
    if level == 0:
        return picture, 1.0
    size = 1 + 2 * level
    cv2.GaussianBlur(picture, (size, size), 0, dst=out)
    return out, SHARPNESS[level] / SHARPNESS[0]
