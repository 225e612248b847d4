"""Straight line segments with sub-pixel accuracy, in one pass over the picture.

This is the article's line finder (connected components of edge pixels with a common gradient direction, eigenvector
fit of each, equations 1 to 4), made sub-pixel. An edge pixel is a maximum of the gradient magnitude across the edge;
its position is the vertex of a parabola through three magnitudes. Pixels join a component if their gradient agrees
with the component's mean within 22.5 degrees (`vision.lines.edges`). A line is fitted to each component, and
fragments of one edge are joined (`vision.lines.fitting`). For a distorted lens the fit uses rectified coordinates, in
which straight edges are straight. The gradient threshold, the blur and the working size adapt to the picture's noise
and to the sharpness of its edges.

A line's plane follows from its ends, and sigma, the standard deviation of the angle across it, from the scatter of
its n pixels: the variance is ``12 rms^2 / n + floor^2`` (px^2), as about one pixel in 12 is independent.
"""

from __future__ import annotations

import threading
import time
from functools import lru_cache
from math import atan2, hypot, radians, sqrt, tan
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from vision.cameras.camera import Camera
from vision.cameras.projection import is_distorted
from vision.compiled import compiled, compiled_inner
from vision.images import to_grey
from vision.lines.edges import (
    COMPONENT,
    Components,
    Gradient,
    connect_edge_pixels,
    fill_gradient,
    median_and_mean,
)
from vision.lines.fitting import FITTED_LINE, fit_components, join_fragments, variance_across
from vision.lines.line_set import LineGeometry, LineSet
from vision.lines.preparation import (
    SHARPNESS,
    blur_by_noise,
    resample_for_search,
    resize_picture,
    resized_camera,
    working_camera,
)
from vision.types import Float32Array, FloatArray, GreyImage, IntArray, RecordArray

PINHOLE = np.dtype([(name, np.float64) for name in ("fx", "fy", "cx", "cy")], align=True)
"""Focal lengths and principal point, pixels."""

MAX_COMPONENTS = 1 << 15
MAX_LINES = 1 << 12
NOISE_TO_THRESHOLD = 3.0  # threshold over the median gradient magnitude
STRUCTURE_TO_THRESHOLD = 1.0  # threshold over the mean gradient magnitude
MIN_THRESHOLD = 6.0  # gradient (Sobel 3x3) that quantisation to whole grey levels can cause
BLURRED_SHARPNESS = 0.5
MIN_DIAGONAL_PX = 100.0
MIN_LENGTH_OF_DIAGONAL = 0.015
MIN_LENGTH_PX = 7.0
MAX_HALF_FIELD_RAD = radians(75.0)  # rectified coordinates stretch without bound towards 90 degrees
POSITION_FLOOR_PX = 0.055  # parabola bias, compression, edges not exactly straight: does not average out
BLURRED_FLOOR_FACTOR = 3.0  # where edges are blurred even at the smallest size


class _Workspace:
    """Buffers for one picture size, kept from frame to frame to save allocations."""

    def __init__(self, height_px: int, width_px: int) -> None:
        self.smooth = np.empty((height_px, width_px), np.uint8)
        pixels = height_px * width_px
        mark = np.zeros((pixels + 7) // 8 * 8, np.uint8)
        self.gradient = Gradient(
            gx=np.zeros(pixels, np.int16),
            gy=np.zeros(pixels, np.int16),
            magnitude=np.zeros(pixels, np.float32),
            mark=mark,
            words=mark.view(np.uint64),
        )
        self.components = Components(
            edges=np.empty(len(mark), np.uint32),
            places=np.empty((len(mark), 2)),
            parent=np.empty(MAX_COMPONENTS, np.uint32),
            sums=np.empty(MAX_COMPONENTS, COMPONENT),
            rows=np.empty((2, width_px), np.uint32),
        )
        self.lines = np.empty(MAX_LINES, FITTED_LINE)
        self.following = np.empty(MAX_LINES, np.int64)
        self.counts = np.empty(3072, np.int64)  # of gradients


_per_thread = threading.local()


def _workspace(height_px: int, width_px: int) -> _Workspace:
    """Return this thread's buffers: frames may be measured in several threads at once."""
    cache: dict[tuple[int, int], _Workspace] = _per_thread.__dict__.setdefault("workspaces", {})
    size = (height_px, width_px)
    if size not in cache:
        while len(cache) >= 4:
            cache.pop(next(iter(cache)))
        cache[size] = _Workspace(*size)
    return cache[size]


def extract_lines(image: npt.NDArray[Any], camera: Camera, *, keep_picture: bool = True) -> LineSet:
    """Find the straight line segments of a picture.

    Parameters
    ----------
    image
        Picture (h, w), (h, w, 3) BGR or (h, w, 4) BGRA, uint8 or uint16.
    camera
        Calibration for this picture size.
    keep_picture
        Whether to keep a reference to the grey picture: `measure_lines` reads the lateral offset from it too, and
        searches it again where these lines show no axis.

    Returns
    -------
    LineSet
        Segments in rectified pixels and as rays in the optical frame (x right, y down, z forward).

    Raises
    ------
    InputError
        Where the array is not a picture, or not of the camera's size.
    """
    grey = to_grey(image)
    camera.require_size(grey.shape[1], grey.shape[0])
    return _extract(grey, grey, camera, camera, keep_picture)


def extract_coarse_lines(grey: GreyImage, camera: Camera) -> LineSet:
    """Find the straight line segments of a picture at half its size.

    This averages noise and leaves longer pieces of weak edges: more lines are found in dark pictures, with less
    accuracy. Arguments and result as in `extract_lines`.
    """
    half = resized_camera(camera, 0.5)
    return _extract(grey, resize_picture(grey, half), camera, half, keep_picture=True)


def _extract(
    grey: GreyImage, searched: GreyImage, camera: Camera, searched_camera: Camera, keep_picture: bool
) -> LineSet:
    """Find lines in ``searched``, the picture ``grey`` at some size, and convert them to the camera's pixels."""
    started = time.perf_counter()
    chosen, picture, sharpness = resample_for_search(searched, searched_camera)
    working, view = chosen, _view(camera, chosen)
    n_labels, threshold, blurred = _connect_edges(picture, view.rectified, sharpness)
    # On edges blurred over several pixels the maximum is anywhere on a plateau: halve the size until they are sharp.
    while blurred and hypot(working.width_px, working.height_px) > 2.0 * MIN_DIAGONAL_PX:
        working = resized_camera(working, 0.5)
        view = _view(camera, working)
        n_labels, threshold, blurred = _connect_edges(resize_picture(grey, working), view.rectified)
    work = _workspace(working.height_px, working.width_px)
    floor_px = POSITION_FLOOR_PX * (chosen.fx_px / working.fx_px) * (BLURRED_FLOOR_FACTOR if blurred else 1.0)
    found = _fit_lines(work.components, n_labels, view, floor_px, work.lines, work.following)
    return _line_set(found, camera, threshold, started, grey if keep_picture else None)


class _FoundLines(NamedTuple):
    """Lines as returned by compiled code; fields as in `LineSet`."""

    ends_px: FloatArray
    length_px: FloatArray
    rms_px: FloatArray
    n_pixels: FloatArray
    contrast: FloatArray
    planes: LineGeometry


class _View(NamedTuple):
    """Camera data for compiled code, at the working size and at the original one.

    Parameters
    ----------
    rectified
        Rectified coordinates (h, w, 2) of every pixel, see `_rectified`.
    working, original
        Arrays (1,) of `PINHOLE`.
    min_length_px
        Least length of a line, working pixels.
    """

    rectified: Float32Array
    working: RecordArray
    original: RecordArray
    min_length_px: float


@lru_cache(maxsize=8)
def _view(camera: Camera, working: Camera) -> _View:
    diagonal = hypot(working.width_px, working.height_px)
    min_length_px = max(MIN_LENGTH_PX, MIN_LENGTH_OF_DIAGONAL * diagonal)
    return _View(_rectified(working), _pinhole(working), _pinhole(camera), min_length_px)


def _connect_edges(
    picture: GreyImage, rectified: Float32Array, sharpness: float = SHARPNESS[0]
) -> tuple[int, float, bool]:
    """Blur a picture according to its noise, and connect its edge pixels in this thread's buffers.

    The buffers are valid until the next picture. ``sharpness`` is the expected sharpness of sharp edges, see
    `connect_edge_pixels`.

    Returns
    -------
    tuple
        Number of labels, threshold of the gradient magnitude, and whether edges are blurred over several pixels.
    """
    work = _workspace(*picture.shape)
    smooth, remaining_sharpness = blur_by_noise(picture, work.smooth)
    n_labels, threshold, found = _find_components(
        smooth, rectified, work.gradient, work.components, work.counts
    )
    return n_labels, threshold, found < BLURRED_SHARPNESS * remaining_sharpness * sharpness


@compiled
def _find_components(
    smooth: GreyImage, rectified: Float32Array, gradient: Gradient, components: Components, counts: IntArray
) -> tuple[int, float, float]:
    """Return the number of labels, the threshold, and the sharpness of the blurrier edge direction."""
    fill_gradient(smooth, gradient)
    width = smooth.shape[1]
    median, mean = median_and_mean(gradient.magnitude, width, counts)
    threshold = max(MIN_THRESHOLD, NOISE_TO_THRESHOLD * median, STRUCTURE_TO_THRESHOLD * mean)
    n_labels, upright, level = connect_edge_pixels(
        gradient, width, np.float32(threshold), rectified, components
    )
    return n_labels, threshold, min(upright, level)


@compiled
def _fit_lines(
    components: Components,
    n_labels: int,
    view: _View,
    floor_px: float,
    lines: RecordArray,
    following: IntArray,
) -> _FoundLines:
    """Fit and join lines; ``lines`` and ``following`` are working memory, ``floor_px`` as in `join_fragments`."""
    n_lines = fit_components(components, n_labels, view.min_length_px, lines)
    n_lines = join_fragments(components, lines, n_lines, floor_px, following)
    return _describe_lines(lines[:n_lines], view, floor_px)


@compiled
def _describe_lines(lines: RecordArray, view: _View, floor_px: float) -> _FoundLines:
    """Convert fitted lines (n,) of `vision.lines.fitting.FITTED_LINE` from working pixels to the camera's frame."""
    scale = view.original[0].fx / view.working[0].fx
    ends_px, planes = _span_planes(lines, view.working, view.original, floor_px)
    return _FoundLines(
        ends_px,
        lines["length"] * scale,
        lines["rms"].copy(),
        lines["n_pixels"].copy(),
        lines["contrast"].copy(),
        planes,
    )


def _line_set(
    found: _FoundLines, camera: Camera, threshold: float, started: float, grey: GreyImage | None
) -> LineSet:
    planes = found.planes
    return LineSet(
        width_px=camera.width_px,
        height_px=camera.height_px,
        ends_px=found.ends_px,
        length_px=found.length_px,
        rms_px=found.rms_px,
        n_pixels=found.n_pixels,
        contrast=found.contrast,
        centre=planes.centre,
        direction=planes.direction,
        normal=planes.normal,
        sigma_rad=planes.sigma_rad,
        arc_rad=planes.arc_rad,
        threshold=threshold,
        extract_ms=1e3 * (time.perf_counter() - started),
        grey=grey,
    )


def edge_components(grey: GreyImage, camera: Camera, radial_share: float = 0.0) -> RecordArray:
    """Return the sums (n,) of a picture's connected edges, of `vision.lines.edges.COMPONENT`, at full size.

    The lens model affects only the rectified coordinates of the pixels, not which pixels form a component. With a
    ``radial_share`` q, each pixel's distance from the optical axis is multiplied by ``1 + q (r / R)^2``, where r is
    the distance in the picture and R half of its diagonal. A negative q divides by ``1 - q / (1 + q) (r / R)^2``,
    which is the same at R, and increases with r too.
    """
    working = working_camera(camera)
    rectified = _rectified(working) if radial_share == 0.0 else _scaled_radially(working, radial_share)
    n_labels, _, _ = _connect_edges(resize_picture(grey, working), rectified)
    work = _workspace(working.height_px, working.width_px)
    parent = work.components.parent[:n_labels]
    sums: RecordArray = work.components.sums[:n_labels][parent == np.arange(n_labels)]
    return sums


@lru_cache(maxsize=1)
def _scaled_radially(camera: Camera, share: float) -> Float32Array:
    """Return `_rectified`, all of its pixels, scaled about the principal point as for `edge_components`."""
    x, y = np.meshgrid(
        np.arange(camera.width_px, dtype=np.float32), np.arange(camera.height_px, dtype=np.float32)
    )
    pixels = np.stack([x, y], axis=-1)
    centre = np.array([camera.cx_px, camera.cy_px], np.float32)
    radius = np.linalg.norm(pixels - centre, axis=-1) / (0.5 * hypot(camera.width_px, camera.height_px))
    rectified = _rectified(camera) if is_distorted(camera) else pixels
    factor = 1.0 + share * radius**2 if share > 0.0 else 1.0 / (1.0 - share / (1.0 + share) * radius**2)
    scaled = (rectified - centre) * factor[..., None] + centre
    return np.ascontiguousarray(scaled, np.float32)


@lru_cache(maxsize=8)
def _rectified(camera: Camera) -> Float32Array:
    """Return rectified coordinates (h, w, 2) of every pixel, NaN outside the usable field.

    The array is (1, 1, 2) for a lens without distortion, where they equal the pixel coordinates.
    """
    if not is_distorted(camera):
        return np.zeros((1, 1, 2), np.float32)
    x, y = np.meshgrid(np.arange(camera.width_px, dtype=float), np.arange(camera.height_px, dtype=float))
    points = camera.undistort(np.stack([x.ravel(), y.ravel()], axis=1))
    points[np.hypot(points[:, 0], points[:, 1]) > tan(MAX_HALF_FIELD_RAD)] = np.nan
    points = points * (camera.fx_px, camera.fy_px) + (camera.cx_px, camera.cy_px)
    return points.reshape(camera.height_px, camera.width_px, 2).astype(np.float32)


@compiled_inner
def _span_planes(
    lines: RecordArray, working: RecordArray, original: RecordArray, floor_px: float
) -> tuple[FloatArray, LineGeometry]:
    """Return each line's ends (n, 4) in the original camera's rectified pixels, and its plane in the optical frame.

    Parameters
    ----------
    lines
        Array (n,) of `vision.lines.fitting.FITTED_LINE`, in the working camera's pixels.
    working, original
        Arrays (1,) of `PINHOLE`.
    floor_px
        Error across a line, in working pixels, that more edge pixels do not average out.
    """
    n = len(lines)
    ends_px = np.empty((n, 4))
    centre, direction, normal = np.empty((n, 3)), np.empty((n, 3)), np.empty((n, 3))
    sigma_rad, arc_rad = np.empty(n), np.empty(n)
    w, o = working[0], original[0]
    for i in range(n):
        line = lines[i]
        x0 = (line.x0 - w.cx) / w.fx
        y0 = (line.y0 - w.cy) / w.fy
        x1 = (line.x1 - w.cx) / w.fx
        y1 = (line.y1 - w.cy) / w.fy
        ends_px[i, 0] = x0 * o.fx + o.cx
        ends_px[i, 1] = y0 * o.fy + o.cy
        ends_px[i, 2] = x1 * o.fx + o.cx
        ends_px[i, 3] = y1 * o.fy + o.cy
        # cross product of (x0, y0, 1) and (x1, y1, 1)
        nx = y0 - y1
        ny = x1 - x0
        nz = x0 * y1 - y0 * x1
        size = sqrt(nx * nx + ny * ny + nz * nz)
        normal[i, 0] = nx / size
        normal[i, 1] = ny / size
        normal[i, 2] = nz / size
        arc_rad[i] = atan2(size, x0 * x1 + y0 * y1 + 1.0)
        cx = 0.5 * (x0 + x1)
        cy = 0.5 * (y0 + y1)
        depth = sqrt(cx * cx + cy * cy + 1.0)
        centre[i, 0] = cx / depth
        centre[i, 1] = cy / depth
        centre[i, 2] = 1.0 / depth
        direction[i, 0] = normal[i, 1] * centre[i, 2] - normal[i, 2] * centre[i, 1]
        direction[i, 1] = normal[i, 2] * centre[i, 0] - normal[i, 0] * centre[i, 2]
        direction[i, 2] = normal[i, 0] * centre[i, 1] - normal[i, 1] * centre[i, 0]
        sigma_px = sqrt(variance_across(line, floor_px))
        sigma_rad[i] = sigma_px * hypot(normal[i, 0], normal[i, 1]) / (depth * w.fx)
    return ends_px, LineGeometry(normal, centre, direction, sigma_rad, arc_rad)


def _pinhole(camera: Camera) -> RecordArray:
    return np.array([(camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px)], PINHOLE)
