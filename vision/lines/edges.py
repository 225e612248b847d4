"""Edge pixels, the maxima of the gradient, connected to components in one raster pass.

An edge pixel's gradient magnitude (Sobel 3x3) reaches the threshold and exceeds both neighbours along x or y,
whichever is nearer to the gradient. The parabola through the three magnitudes gives its sub-pixel position.
Union-find connects 8-neighbours whose gradients are within 22.5 degrees of the component's mean gradient.

Components are stored as running sums only. Everything is compiled and works on buffers that the caller reuses. Loops
over all pixels treat the picture as one long row without branches, so that they vectorise.
"""

from __future__ import annotations

from math import cos, radians
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from vision.compiled import compiled, compiled_inner
from vision.types import Float32Array, FloatArray, GreyImage, IntArray, Record, RecordArray

DIRECTION_COS2 = cos(radians(22.5)) ** 2

GreyPixels = npt.NDArray[np.uint8]
Int16Array = npt.NDArray[np.int16]
UintArray = npt.NDArray[np.uint32]

NO_LABEL = np.uint32(0xFFFFFFFF)

COMPONENT = np.dtype(
    [(name, np.float64) for name in ("n", "x", "y", "xx", "xy", "yy", "gx", "gy")], align=True
)
"""Running sums over a component's pixels: number, coordinates, their products, gradient. Fills one cache line."""


class Gradient(NamedTuple):
    """A picture's gradient (Sobel 3x3), its magnitude, and the marks of edge pixels, each (h * w,).

    Parameters
    ----------
    gx, gy, magnitude
        Not valid at the picture's border.
    mark
        One for edge pixels; padded to a multiple of 8.
    words
        The same memory as ``mark``, eight pixels per word.
    """

    gx: npt.NDArray[np.int16]
    gy: npt.NDArray[np.int16]
    magnitude: npt.NDArray[np.float32]
    mark: npt.NDArray[np.uint8]
    words: npt.NDArray[np.uint64]


class Components(NamedTuple):
    """Buffers for the components of connected edge pixels in a picture of width w.

    Parameters
    ----------
    edges
        Indices (h * w,) of the edge pixels.
    places
        Their rectified coordinates (h * w, 2).
    parent
        Parent (m,) of each label (union-find); a root, which is its own parent, is a component.
    sums
        Array (m,) of `COMPONENT`, valid for roots.
    rows
        Working memory (2, w).
    """

    edges: UintArray
    places: FloatArray
    parent: UintArray
    sums: RecordArray
    rows: UintArray


@compiled_inner
def median_bin(counts: IntArray, n: int) -> tuple[int, int]:
    """Return the number of a histogram's n entries below the bin of their median, and that bin."""
    below = level = 0
    while below + counts[level] < 0.5 * n:
        below += counts[level]
        level += 1
    return below, level


@compiled_inner
def median_and_mean(magnitude: Float32Array, width: int, counts: IntArray) -> tuple[float, float]:
    """Return the median, to half a level, and the mean of every fourth magnitude in every fourth row.

    ``counts`` is working memory with more entries than twice the largest magnitude.
    """
    counts[:] = 0
    total = 0.0
    n = 0
    for y in range(2, len(magnitude) // width - 2, 4):
        row = magnitude[y * width : (y + 1) * width]
        for x in range(2, width - 2, 4):
            m = row[x]
            total += m
            n += 1
            counts[min(int(2.0 * m), len(counts) - 1)] += 1
    return 0.5 * median_bin(counts, n)[1], total / max(n, 1)


@compiled_inner
def _fill_gradient(
    above: GreyPixels,
    middle: GreyPixels,
    below: GreyPixels,
    gx: Int16Array,
    gy: Int16Array,
    magnitude: Float32Array,
) -> None:
    """Fill in the gradient (Sobel 3x3) of a row's pixels, except the first and the last."""
    two = np.int16(2)
    last = len(gx) - 1
    for x in range(1, last):
        outer = (
            np.int16(above[x + 1]) - np.int16(above[x - 1]) + np.int16(below[x + 1]) - np.int16(below[x - 1])
        )
        gx[x] = outer + two * (np.int16(middle[x + 1]) - np.int16(middle[x - 1]))
    for x in range(1, last):
        outer = (
            np.int16(below[x - 1]) - np.int16(above[x - 1]) + np.int16(below[x + 1]) - np.int16(above[x + 1])
        )
        gy[x] = outer + two * (np.int16(below[x]) - np.int16(above[x]))
    for x in range(1, last):
        a, b = np.float32(gx[x]), np.float32(gy[x])
        magnitude[x] = np.sqrt(a * a + b * b)


@compiled_inner
def fill_gradient(picture: GreyImage, gradient: Gradient) -> None:
    """Fill in the gradient of a picture (h, w) and its magnitude, but not ``mark``."""
    pixels, w = picture.ravel(), picture.shape[1]
    inner = slice(w, len(pixels) - w)
    _fill_gradient(
        pixels[: len(pixels) - 2 * w],
        pixels[inner],
        pixels[2 * w :],
        gradient.gx[inner],
        gradient.gy[inner],
        gradient.magnitude[inner],
    )


@compiled_inner
def _mark_ridge(
    middle: Float32Array,
    left: Float32Array,
    right: Float32Array,
    up: Float32Array,
    down: Float32Array,
    gx: Int16Array,
    gy: Int16Array,
    threshold: np.float32,
    mark: npt.NDArray[np.uint8],
) -> None:
    """Mark the pixels that reach the threshold and exceed their neighbours across the edge, without branches."""
    for x in range(len(middle)):
        m = middle[x]
        at_left, at_right, at_up, at_down = left[x], right[x], up[x], down[x]
        steep = abs(np.int32(gx[x])) >= abs(np.int32(gy[x]))
        m0 = at_left if steep else at_up
        m1 = at_right if steep else at_down
        mark[x] = np.uint8((m >= threshold) & (m > m0) & (m >= m1))


@compiled_inner
def _find_edge_pixels(gradient: Gradient, width: int, threshold: np.float32, edges: UintArray) -> int:
    """Fill in the indices of edge pixels, including those too near to the picture's sides; return their number."""
    magnitude, mark, words = gradient.magnitude, gradient.mark, gradient.words
    first, last = 2 * width, len(magnitude) - 2 * width
    _mark_ridge(
        magnitude[first:last],
        magnitude[first - 1 : last - 1],
        magnitude[first + 1 : last + 1],
        magnitude[first - width : last - width],
        magnitude[first + width : last + width],
        gradient.gx[first:last],
        gradient.gy[first:last],
        threshold,
        mark[first:last],
    )
    n = 0
    for word in range(len(words)):
        if words[word] != 0:
            for i in range(8 * word, 8 * word + 8):
                edges[n] = i
                n += mark[i]
    return n


@compiled_inner
def _root(parent: UintArray, label: np.uint32) -> np.uint32:
    while parent[label] != label:
        parent[label] = parent[parent[label]]
        label = parent[label]
    return label


@compiled_inner
def _agree(ax: float, ay: float, bx: float, by: float) -> bool:
    """Whether two gradients differ by less than 22.5 degrees; opposite ones never agree."""
    dot = ax * bx + ay * by
    return dot > 0.0 and dot * dot > DIRECTION_COS2 * (ax * ax + ay * ay) * (bx * bx + by * by)


@compiled_inner
def add_sums(total: Record, part: Record) -> None:
    """Add a component's sums to another's."""
    total.n += part.n
    total.x += part.x
    total.y += part.y
    total.xx += part.xx
    total.xy += part.xy
    total.yy += part.yy
    total.gx += part.gx
    total.gy += part.gy


@compiled_inner
def _join_around(
    a: float,
    b: float,
    around: tuple[np.uint32, np.uint32, np.uint32, np.uint32],
    parent: UintArray,
    sums: RecordArray,
) -> np.uint32:
    """Return the component of an edge pixel with gradient (a, b), merging the components around it that it connects.

    `NO_LABEL` where it agrees with none of them.
    """
    label = NO_LABEL
    for other in around:
        if other == NO_LABEL:
            continue
        other = _root(parent, other)
        if other == label:
            continue
        s = sums[other]
        if label == NO_LABEL:
            if _agree(s.gx, s.gy, a, b):
                label = other
        elif _agree(s.gx, s.gy, sums[label].gx, sums[label].gy):
            if other < label:
                label, other = other, label
            parent[other] = label
            add_sums(sums[label], sums[other])
    return label


@compiled_inner
def _is_or_none(label: np.uint32, one: np.uint32) -> bool:
    return bool((label == one) | (label == NO_LABEL))


@compiled_inner
def _clear(sums: Record) -> None:
    sums.n = sums.x = sums.y = sums.xx = sums.xy = sums.yy = sums.gx = sums.gy = 0.0


@compiled_inner
def _add_pixel(s: Record, x: float, y: float, a: float, b: float) -> None:
    s.n += 1.0
    s.x += x
    s.y += y
    s.xx += x * x
    s.xy += x * y
    s.yy += y * y
    s.gx += a
    s.gy += b


@compiled_inner
def _is_upright(gradient: Gradient, i: np.uintp) -> bool:
    return bool(abs(np.int32(gradient.gx[i])) >= abs(np.int32(gradient.gy[i])))


@compiled_inner
def _peak(gradient: Gradient, i: np.uintp, step: np.uintp) -> tuple[float, float]:
    """Return the curvature of a parabola across the edge, and its vertex relative to pixel i."""
    m, m0, m1 = gradient.magnitude[i], gradient.magnitude[i - step], gradient.magnitude[i + step]
    curvature = 2.0 * m - m0 - m1
    return curvature, 0.5 * (m1 - m0) / curvature


@compiled_inner
def _locate(gradient: Gradient, width: int, n_edges: int, components: Components) -> tuple[int, float, float]:
    """Compute the sub-pixel positions of edge pixels, leaving out those at the picture's sides.

    Fills in the first rows of ``components.edges`` and ``components.places``; returns their number, and the sharpness
    of upright and of level edges, see `connect_edge_pixels`. Lens distortion is left to `_rectify`: this loop must
    not branch on an edge's direction, which processors cannot predict.
    """
    edges, places = components.edges, components.places
    bend, ridge = np.full(2, 1e-9), np.full(2, 1e-9)
    w, n, y, row = np.uintp(width), np.uintp(0), 0, np.uintp(0)
    for k in range(n_edges):
        i = np.uintp(edges[k])
        while i >= row + w:
            row += w
            y += 1
        x = np.intp(i - row)
        if x < 2 or x >= width - 2:
            continue
        # The parabola along x or y, whichever is nearer to the gradient, peaks on the edge for any edge direction.
        upright = _is_upright(gradient, i)
        step, axis = np.uintp(1) if upright else w, np.uintp(upright)
        curvature, shift = _peak(gradient, i, step)
        bend[axis] += curvature
        ridge[axis] += gradient.magnitude[i]
        across, down = (shift, 0.0) if upright else (0.0, shift)
        places[n, 0], places[n, 1] = x + across, y + down
        edges[n] = i
        n += np.uintp(1)
    return int(np.intp(n)), bend[1] / ridge[1], bend[0] / ridge[0]


@compiled_inner
def _rectify(
    gradient: Gradient, width: int, n_edges: int, rectified: Float32Array, components: Components
) -> int:
    """Convert located edge pixels to rectified coordinates, leaving out those without; return their number."""
    edges, places = components.edges, components.places
    n = 0
    for k in range(n_edges):
        i = np.uintp(edges[k])
        y, x = np.intp(i) // width, np.intp(i) % width
        upright = _is_upright(gradient, i)
        _, shift = _peak(gradient, i, np.uintp(1) if upright else np.uintp(width))
        ahead, part = 1 if shift > 0.0 else -1, abs(shift)
        v, u = (y, x + ahead) if upright else (y + ahead, x)
        for c in range(2):
            places[n, c] = rectified[y, x, c] * (1.0 - part) + rectified[v, u, c] * part
        edges[n] = i
        n += places[n, 0] == places[n, 0] and places[n, 1] == places[n, 1]  # not NaN: within the usable field
    return n


@compiled
def connect_edge_pixels(
    gradient: Gradient, width: int, threshold: np.float32, rectified: Float32Array, components: Components
) -> tuple[int, float, float]:
    """Connect edge pixels to components of one gradient direction, in one raster pass.

    Parameters
    ----------
    gradient
        Gradient of a picture, by `fill_gradient`.
    width
        Width of the picture.
    threshold
        Least gradient magnitude of an edge pixel.
    rectified
        Rectified coordinates (h, w, 2) of the pixels, or (1, 1, 2) where they equal the pixel coordinates.
    components
        Filled with the components.

    Returns
    -------
    tuple
        Number of labels, and the sharpness of upright and of level edges: total curvature of the gradient magnitude
        across the edges over its total height. It is about 1 for edges as sharp as a pixel, 1 / s^2 for edges blurred
        over s pixels. The two differ because motion blurs only the edges across its direction.
    """
    n_edges = _find_edge_pixels(gradient, width, threshold, components.edges)
    n_edges, upright, level = _locate(gradient, width, n_edges, components)
    if rectified.shape[0] > 1:
        n_edges = _rectify(gradient, width, n_edges, rectified, components)
    return _label(gradient, width, n_edges, components), upright, level


@compiled_inner
def _label(gradient: Gradient, width: int, n_edges: int, components: Components) -> int:
    """Assign each edge pixel, row by row, to a component; return the number of labels.

    Indices are unsigned, which avoids the check for negative indices.
    """
    gx, gy = gradient.gx, gradient.gy
    edges, places, parent, sums = components.edges, components.places, components.parent, components.sums
    above, here = components.rows[0], components.rows[1]
    above[:] = NO_LABEL
    here[:] = NO_LABEL
    w, one, row, n_labels = np.uintp(width), np.uintp(1), np.uintp(0), np.uintp(0)
    for k in range(n_edges):
        i = np.uintp(edges[k])
        while i >= row + w:
            row += w
            above, here = here, above
            here[:] = NO_LABEL
        x = i - row
        a, b = float(gx[i]), float(gy[i])
        around = (here[x - one], above[x - one], above[x], above[x + one])
        label = min(min(around[0], around[1]), min(around[2], around[3]))
        if label != NO_LABEL:
            # Fast path for the common case of one component around.
            first, second, third, fourth = around
            alone = _is_or_none(first, label) & _is_or_none(second, label) & _is_or_none(third, label)
            if alone & _is_or_none(fourth, label):
                label = _root(parent, label)
                if not _agree(sums[label].gx, sums[label].gy, a, b):
                    label = NO_LABEL
            else:
                label = _join_around(a, b, around, parent, sums)
        if label == NO_LABEL:
            if n_labels == np.uintp(len(parent)):
                continue
            label = np.uint32(n_labels)
            n_labels += one
            parent[label] = label
            _clear(sums[label])
        _add_pixel(sums[label], places[k, 0], places[k, 1], a, b)
        here[x] = label
    return int(np.intp(n_labels))
