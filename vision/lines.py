"""Straight line segments with sub-pixel accuracy, in one pass over the picture.

The article's line finder (connected components of edge pixels with a common gradient direction, eigen fit of each,
equations 1 to 4) made sub-pixel: an edge pixel is a maximum of the gradient magnitude across the edge, its position
the vertex of a parabola through three magnitudes; pixels join a component while their gradient agrees with the
component's mean within 22.5 degrees; sums kept while joining give the fit without a second pass. For a distorted lens
the sums are taken in rectified coordinates, where edges of straight things are straight.

The threshold follows the picture's own noise, so that the dark and the bright are treated alike.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import lru_cache
from math import ceil, cos, hypot, radians, sqrt
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from vision.camera import Camera, Distortion
from vision.compiled import compiled
from vision.images import to_grey

FloatArray = npt.NDArray[np.float64]

MAX_COMPONENTS = 1 << 15
DIRECTION_COS2 = cos(radians(22.5)) ** 2
NOISE_TO_THRESHOLD = 3.0  # threshold over the median gradient magnitude
MIN_THRESHOLD = 6.0  # gradient (Sobel 3x3) that quantisation to whole grey levels can make
SMOOTH_FROM_NOISE = (1.5, 5.0, 8.5)  # noise, grey levels, above which blur of 3, 5, 7 pixels pays
SMOOTH_FROM_NOISE_COARSE = (5.0, 14.0)  # the same for pictures whose edges lie closer together
FINE_DIAGONAL_PX = 600.0
SMALL_DIAGONAL_PX = 300.0
MAX_DIAGONAL_PX = 1000.0
SECOND_DIFFERENCE_MEDIAN = 0.6745 * sqrt(6.0)  # median of |a - 2b + c| for noise of one grey level
MIN_LENGTH_OF_DIAGONAL = 0.02
MIN_LENGTH_PX = 7.0
MAX_RMS_PX = 0.8  # scatter across the line beyond which it is not one
MAX_HALF_FIELD_RAD = radians(75.0)  # rectified coordinates stretch without bound towards 90 degrees

# columns of the running sums of a component
N, SX, SY, SXX, SXY, SYY, GX, GY, MAG, X_MIN, X_MAX, Y_MIN, Y_MAX = range(13)
SUMS = 13


@dataclass(frozen=True, slots=True, eq=False)
class LineSet:
    """Line segments of one picture, as the vanishing point needs them; n lines.

    Parameters
    ----------
    width_px, height_px
        Size of the picture.
    ends_px
        End points (n, 4) x0, y0, x1, y1 in rectified pixels (those of a distortion-free lens with the same
        focal length and principal point); bright is on the right when walking from 0 to 1.
    length_px
        Lengths (n,), rectified pixels.
    rms_px
        Scatter (n,) of the edge pixels across their line.
    n_pixels
        Edge pixels (n,) in the line.
    contrast
        Mean gradient magnitude (n,), in grey levels per pixel times 8 (Sobel 3x3).
    centre, direction, normal
        Unit vectors (n, 3) in the optical frame: towards the middle of the segment, along it, and normal to the
        plane it spans with the camera's centre; ``normal = centre x direction``.
    sigma_rad
        Standard deviation (n,) of the angle by which the middle is off its plane.
    arc_rad
        Angle (n,) the segment subtends.
    threshold
        Gradient magnitude above which pixels counted as edges.
    extract_ms
        Time it took to find them, milliseconds.
    """

    width_px: int
    height_px: int
    ends_px: FloatArray
    length_px: FloatArray
    rms_px: FloatArray
    n_pixels: FloatArray
    contrast: FloatArray
    centre: FloatArray
    direction: FloatArray
    normal: FloatArray
    sigma_rad: FloatArray
    arc_rad: FloatArray
    threshold: float
    extract_ms: float

    def __len__(self) -> int:
        return len(self.length_px)


@compiled
def _magnitude(
    gx: npt.NDArray[np.int16], gy: npt.NDArray[np.int16], magnitude: npt.NDArray[np.float32]
) -> None:
    height, width = gx.shape
    for y in range(height):
        for x in range(width):
            a = np.float32(gx[y, x])
            b = np.float32(gy[y, x])
            magnitude[y, x] = np.sqrt(a * a + b * b)


@compiled
def _root(parent: npt.NDArray[np.int32], label: int) -> int:
    while parent[label] != label:
        parent[label] = parent[parent[label]]
        label = parent[label]
    return label


@compiled
def _trace(
    gx: npt.NDArray[np.int16],
    gy: npt.NDArray[np.int16],
    magnitude: npt.NDArray[np.float32],
    threshold: np.float32,
    rectified: npt.NDArray[np.float32],
    parent: npt.NDArray[np.int32],
    sums: FloatArray,
    rows: npt.NDArray[np.int32],
) -> int:
    """Join edge pixels to components in one raster pass; return how many labels were given out."""
    height, width = magnitude.shape
    distorted = rectified.shape[0] > 1
    n_labels = 0
    above = rows[0]
    here = rows[1]
    above[:] = -1
    here[:] = -1
    for y in range(2, height - 2):
        for x in range(2, width - 2):
            here[x] = -1
            m = magnitude[y, x]
            if m < threshold:
                continue
            a = gx[y, x]
            b = gy[y, x]
            # A parabola along the axis nearest to the gradient peaks on the edge whatever the edge's direction.
            if abs(a) >= abs(b):
                m0 = magnitude[y, x - 1]
                m1 = magnitude[y, x + 1]
                if m <= m0 or m < m1:
                    continue
                shift = 0.5 * (m0 - m1) / (m0 - 2.0 * m + m1)
                px = x + shift
                py = float(y)
                if distorted:
                    step = 1 if shift > 0 else -1
                    part = abs(shift)
                    px = rectified[y, x, 0] + part * (rectified[y, x + step, 0] - rectified[y, x, 0])
                    py = rectified[y, x, 1] + part * (rectified[y, x + step, 1] - rectified[y, x, 1])
            else:
                m0 = magnitude[y - 1, x]
                m1 = magnitude[y + 1, x]
                if m <= m0 or m < m1:
                    continue
                shift = 0.5 * (m0 - m1) / (m0 - 2.0 * m + m1)
                px = float(x)
                py = y + shift
                if distorted:
                    step = 1 if shift > 0 else -1
                    part = abs(shift)
                    px = rectified[y, x, 0] + part * (rectified[y + step, x, 0] - rectified[y, x, 0])
                    py = rectified[y, x, 1] + part * (rectified[y + step, x, 1] - rectified[y, x, 1])
            if distorted and not (px == px and py == py):
                continue
            ux = a / m
            uy = b / m
            label = -1
            for k in range(4):
                if k == 0:
                    other = here[x - 1]
                else:
                    other = above[x - 2 + k]
                if other < 0:
                    continue
                other = _root(parent, other)
                if other == label:
                    continue
                s = sums[other]
                if label < 0:
                    dot = s[GX] * ux + s[GY] * uy
                    if dot > 0 and dot * dot > DIRECTION_COS2 * (s[GX] * s[GX] + s[GY] * s[GY]):
                        label = other
                    continue
                t = sums[label]
                dot = s[GX] * t[GX] + s[GY] * t[GY]
                sizes = (s[GX] * s[GX] + s[GY] * s[GY]) * (t[GX] * t[GX] + t[GY] * t[GY])
                if dot > 0 and dot * dot > DIRECTION_COS2 * sizes:
                    if other < label:
                        label, other = other, label
                    parent[other] = label
                    s = sums[other]
                    t = sums[label]
                    for j in range(X_MIN):
                        t[j] += s[j]
                    t[X_MIN] = min(t[X_MIN], s[X_MIN])
                    t[X_MAX] = max(t[X_MAX], s[X_MAX])
                    t[Y_MIN] = min(t[Y_MIN], s[Y_MIN])
                    t[Y_MAX] = max(t[Y_MAX], s[Y_MAX])
            if label < 0:
                if n_labels == parent.shape[0]:
                    return n_labels
                label = n_labels
                n_labels += 1
                parent[label] = label
                t = sums[label]
                t[:] = 0.0
                t[X_MIN] = px
                t[X_MAX] = px
                t[Y_MIN] = py
                t[Y_MAX] = py
            t = sums[label]
            t[N] += 1.0
            t[SX] += px
            t[SY] += py
            t[SXX] += px * px
            t[SXY] += px * py
            t[SYY] += py * py
            t[GX] += ux
            t[GY] += uy
            t[MAG] += m
            t[X_MIN] = min(t[X_MIN], px)
            t[X_MAX] = max(t[X_MAX], px)
            t[Y_MIN] = min(t[Y_MIN], py)
            t[Y_MAX] = max(t[Y_MAX], py)
            here[x] = label
        above, here = here, above
    return n_labels


@compiled
def _fit(
    parent: npt.NDArray[np.int32], sums: FloatArray, n_labels: int, min_length_px: float, out: FloatArray
) -> int:
    """Fit each component (equations 1 to 4) into rows x0, y0, x1, y1, length, rms, n, contrast; return how many."""
    n_lines = 0
    for label in range(n_labels):
        if parent[label] != label:
            continue
        s = sums[label]
        n = s[N]
        if n < 0.7 * min_length_px or n < 5.0:
            continue
        x = s[SX] / n
        y = s[SY] / n
        sxx = s[SXX] / n - x * x
        sxy = s[SXY] / n - x * y
        syy = s[SYY] / n - y * y
        half_trace = 0.5 * (sxx + syy)
        root = sqrt(0.25 * (sxx - syy) ** 2 + sxy * sxy)
        rms = sqrt(max(half_trace - root, 0.0))
        angle = 0.5 * np.arctan2(2.0 * sxy, sxx - syy)
        dx = np.cos(angle)
        dy = np.sin(angle)
        # walk with the bright side on the right: the gradient points to bright, right of (dx, dy) is (-dy, dx)
        if -dy * s[GX] + dx * s[GY] < 0.0:
            dx = -dx
            dy = -dy
        if abs(dx) >= abs(dy):
            t0 = (s[X_MIN] - x) / dx
            t1 = (s[X_MAX] - x) / dx
        else:
            t0 = (s[Y_MIN] - y) / dy
            t1 = (s[Y_MAX] - y) / dy
        if t0 > t1:
            t0, t1 = t1, t0
        length = t1 - t0
        if length < min_length_px or rms > MAX_RMS_PX:
            continue
        row = out[n_lines]
        row[0] = x + t0 * dx
        row[1] = y + t0 * dy
        row[2] = x + t1 * dx
        row[3] = y + t1 * dy
        row[4] = length
        row[5] = rms
        row[6] = n
        row[7] = s[MAG] / n
        n_lines += 1
        if n_lines == out.shape[0]:
            break
    return n_lines


def is_distorted(camera: Camera) -> bool:
    """Whether straight things have bent edges in this camera's pictures."""
    return any(camera.coefficients) or camera.distortion is Distortion.EQUIDISTANT


@lru_cache(maxsize=4)
def _rectified(camera: Camera) -> npt.NDArray[np.float32]:
    """Rectified pixel coordinates (h, w, 2) of every pixel, NaN outside the usable field; (1, 1, 2) if they are its own."""
    if not is_distorted(camera):
        return np.zeros((1, 1, 2), np.float32)
    x, y = np.meshgrid(np.arange(camera.width_px, dtype=float), np.arange(camera.height_px, dtype=float))
    points = camera.undistort(np.stack([x.ravel(), y.ravel()], axis=1))
    points[np.hypot(points[:, 0], points[:, 1]) > np.tan(MAX_HALF_FIELD_RAD)] = np.nan
    points = points * (camera.fx_px, camera.fy_px) + (camera.cx_px, camera.cy_px)
    return points.reshape(camera.height_px, camera.width_px, 2).astype(np.float32)


class _Workspace:
    """Buffers for one picture size, kept so that no frame allocates what the last one already had."""

    def __init__(self, height_px: int, width_px: int) -> None:
        self.magnitude = np.empty((height_px, width_px), np.float32)
        self.parent = np.empty(MAX_COMPONENTS, np.int32)
        self.sums = np.empty((MAX_COMPONENTS, SUMS))
        self.rows = np.empty((2, width_px), np.int32)
        self.lines = np.empty((MAX_COMPONENTS // 8, 8))
        self.counts = np.empty(1024, np.int64)


@lru_cache(maxsize=4)
def _workspace(height_px: int, width_px: int) -> _Workspace:
    return _Workspace(height_px, width_px)


@lru_cache(maxsize=4)
def _working_camera(camera: Camera) -> Camera:
    """Return the camera at the size lines are sought at.

    Large pictures gain nothing but time; small ones hide neighbouring edges from each other, which interpolation
    undoes in part.
    """
    diagonal = hypot(camera.width_px, camera.height_px)
    if diagonal > MAX_DIAGONAL_PX:
        scale = 1.0 / ceil(diagonal / MAX_DIAGONAL_PX)
    elif diagonal < SMALL_DIAGONAL_PX:
        scale = 2.0
    else:
        return camera
    return camera.resized(round(camera.width_px * scale), round(camera.height_px * scale))


@compiled
def _second_differences(grey: npt.NDArray[np.uint8], counts: npt.NDArray[np.int64]) -> None:
    height, width = grey.shape
    counts[:] = 0
    for y in range(0, height, 8):
        for x in range(1, width - 1):
            counts[abs(int(grey[y, x - 1]) - 2 * int(grey[y, x]) + int(grey[y, x + 1]))] += 1


def noise_std(grey: npt.NDArray[np.uint8]) -> float:
    """Estimate the standard deviation of a picture's noise, grey levels, from the median second difference."""
    counts = _workspace(*grey.shape).counts
    _second_differences(grey, counts)
    cumulative = np.cumsum(counts)
    half = 0.5 * cumulative[-1]
    level = int(np.searchsorted(cumulative, half))
    below = cumulative[level - 1] if level else 0
    median = level - 0.5 + (half - below) / counts[level]
    return max(float(median), 0.0) / SECOND_DIFFERENCE_MEDIAN


def _smoothed(grey: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
    """Blur as little as the noise allows: blur lets neighbouring edges pull at each other, in small pictures most."""
    noise = noise_std(grey)
    limits = SMOOTH_FROM_NOISE if hypot(*grey.shape) > FINE_DIAGONAL_PX else SMOOTH_FROM_NOISE_COARSE
    size = 1 + 2 * sum(noise > limit for limit in limits)
    return grey if size == 1 else np.asarray(cv2.GaussianBlur(grey, (size, size), 0))


def extract_lines(image: npt.NDArray[Any], camera: Camera) -> LineSet:
    """Find the straight line segments of a picture.

    Parameters
    ----------
    image
        Grey, BGR or BGRA picture, uint8 or uint16.
    camera
        Calibration for this picture size.

    Raises
    ------
    InputError
        Where it is no picture, or not of the camera's size.
    """
    started = time.perf_counter()
    grey = to_grey(image)
    camera.require_size(grey.shape[1], grey.shape[0])
    working = _working_camera(camera)
    width, height = working.width_px, working.height_px
    if working is not camera:
        shrink = width < camera.width_px
        grey = cv2.resize(grey, (width, height), interpolation=cv2.INTER_AREA if shrink else cv2.INTER_CUBIC)
    work = _workspace(height, width)
    gx, gy = cv2.spatialGradient(_smoothed(grey))
    _magnitude(gx, gy, work.magnitude)
    median = float(np.median(work.magnitude[2:-2:4, 2:-2:4]))
    threshold = max(MIN_THRESHOLD, NOISE_TO_THRESHOLD * median)
    n_labels = _trace(
        gx, gy, work.magnitude, np.float32(threshold), _rectified(working), work.parent, work.sums, work.rows
    )
    min_length = max(MIN_LENGTH_PX, MIN_LENGTH_OF_DIAGONAL * hypot(width, height))
    n = _fit(work.parent, work.sums, n_labels, min_length, work.lines)
    return _line_set(work.lines[:n].copy(), camera, working, threshold, started)


def _line_set(
    lines: FloatArray, camera: Camera, working: Camera, threshold: float, started: float
) -> LineSet:
    ends = lines[:, :4]
    offset = np.array([working.cx_px, working.cy_px])
    focal = np.array([working.fx_px, working.fy_px])
    p0 = np.column_stack([(ends[:, :2] - offset) / focal, np.ones(len(lines))])
    p1 = np.column_stack([(ends[:, 2:] - offset) / focal, np.ones(len(lines))])
    middle = 0.5 * (p0 + p1)
    depth = np.linalg.norm(middle, axis=1)
    scale = np.array([camera.fx_px, camera.fy_px])
    shift = np.array([camera.cx_px, camera.cy_px])
    ends_px = np.hstack([p0[:, :2] * scale + shift, p1[:, :2] * scale + shift])
    p0 /= np.linalg.norm(p0, axis=1, keepdims=True)
    p1 /= np.linalg.norm(p1, axis=1, keepdims=True)
    normal = np.cross(p0, p1)
    sine = np.linalg.norm(normal, axis=1)
    normal /= sine[:, None]
    centre = middle / depth[:, None]
    sigma_px = _position_sigma_px(lines[:, 5], lines[:, 6])
    return LineSet(
        width_px=camera.width_px,
        height_px=camera.height_px,
        ends_px=ends_px,
        length_px=lines[:, 4] * (camera.fx_px / working.fx_px),
        rms_px=lines[:, 5],
        n_pixels=lines[:, 6],
        contrast=lines[:, 7],
        centre=centre,
        direction=np.cross(normal, centre),
        normal=normal,
        sigma_rad=sigma_px * np.hypot(normal[:, 0], normal[:, 1]) / (depth * working.fx_px),
        arc_rad=np.arctan2(sine, (p0 * p1).sum(axis=1)),
        threshold=threshold,
        extract_ms=1e3 * (time.perf_counter() - started),
    )


def _position_sigma_px(rms_px: FloatArray, n_pixels: FloatArray) -> FloatArray:
    """Return the standard deviation of a line's position across itself: what the scatter says, and what it cannot.

    Neighbouring edge pixels share blur and noise (about three speak as one); bias of the parabola, compression and
    edges that are not quite straight do not average out at all.
    """
    return np.asarray(np.hypot(rms_px * np.sqrt(3.0 / n_pixels), 0.05))
