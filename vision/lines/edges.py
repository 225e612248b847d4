"""Edge pixels, maxima of the gradient, joined to straight components in one raster pass; lines fitted to them.

Everything is compiled and works on buffers that the caller keeps from frame to frame. Of a component only running
sums are kept: to join two is to add their sums, and a line is fitted without looking at the pixels again.
"""

from __future__ import annotations

from math import cos, radians, sqrt
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from vision.compiled import compiled
from vision.types import IntArray, Record, RecordArray

DIRECTION_COS2 = cos(radians(22.5)) ** 2
MAX_RMS_PX = 0.8  # scatter across the line beyond which it is not one
MIN_PIXELS = 5
ROW_STEP = 8
MAX_BLOCK_STEP = 20  # larger ones are the picture's own edges

COMPONENT = np.dtype(
    [(name, np.float64) for name in ("n", "x", "y", "xx", "xy", "yy", "gx", "gy")], align=True
)
"""Running sums of a component's pixels: number, coordinates and their products, gradient. One cache line."""

FITTED_LINE = np.dtype(
    [
        ("x0", np.float64),  # ends, pixels
        ("y0", np.float64),
        ("x1", np.float64),
        ("y1", np.float64),
        ("length", np.float64),  # pixels
        ("rms", np.float64),  # scatter of the edge pixels across the line
        ("n_pixels", np.float64),
        ("contrast", np.float64),  # mean gradient magnitude
    ],
    align=True,
)
"""A line fitted to a component. Walking from the first end to the second, the bright side is on the right."""


class Gradient(NamedTuple):
    """A picture's gradient (Sobel 3x3) and its length, each (h, w)."""

    gx: npt.NDArray[np.int16]
    gy: npt.NDArray[np.int16]
    magnitude: npt.NDArray[np.float32]


class Components(NamedTuple):
    """Buffers for the components of connected edge pixels in a picture of width w.

    Parameters
    ----------
    parent
        Parent (m,) of each label; a label that is its own is a component.
    sums
        Array (m,) of `COMPONENT`, of use for labels that are their own parent.
    rows
        Working memory (3, w).
    mark
        Working memory: the edge pixels of a row, filled up to a multiple of 8.
    words
        The same memory as ``mark``, eight pixels at a time.
    """

    parent: npt.NDArray[np.int32]
    sums: RecordArray
    rows: npt.NDArray[np.int32]
    mark: npt.NDArray[np.uint8]
    words: npt.NDArray[np.uint64]


@compiled
def fill_magnitude(gradient: Gradient) -> None:
    """Fill in the length of the gradient."""
    gx, gy, magnitude = gradient.gx, gradient.gy, gradient.magnitude
    height, width = gx.shape
    for y in range(height):
        for x in range(width):
            a = np.float32(gx[y, x])
            b = np.float32(gy[y, x])
            magnitude[y, x] = np.sqrt(a * a + b * b)


@compiled
def difference_statistics(grey: npt.NDArray[np.uint8], counts: IntArray) -> float:
    """Fill ``counts`` (1024,) with the histogram of |a - 2b + c| along every eighth row; return the blockiness.

    Blockiness is the mean step between columns 8k - 1 and 8k, where JPEG's blocks meet, over the mean step elsewhere:
    about 1 for pictures never compressed, 1.5 for good quality, 2 and more where the blocks can be seen.
    """
    height, width = grey.shape
    counts[:] = 0
    at_joint = 0
    elsewhere = 0
    for y in range(0, height, ROW_STEP):
        for x in range(1, width - 1):
            a = np.int64(grey[y, x - 1])
            b = np.int64(grey[y, x])
            counts[abs(a - 2 * b + np.int64(grey[y, x + 1]))] += 1
            step = int(abs(b - a))
            if step > MAX_BLOCK_STEP:
                step = MAX_BLOCK_STEP
            if x % 8 == 0:
                at_joint += step
            else:
                elsewhere += step
    return 7.0 * at_joint / max(elsewhere, 1)


@compiled
def median_and_mean(magnitude: npt.NDArray[np.float32], counts: IntArray) -> tuple[float, float]:
    """Return the median, to half a level, and the mean of every fourth magnitude of every fourth row."""
    height, width = magnitude.shape
    counts[:] = 0
    total = 0.0
    n = 0
    for y in range(2, height - 2, 4):
        for x in range(2, width - 2, 4):
            m = magnitude[y, x]
            total += m
            n += 1
            counts[min(int(2.0 * m), len(counts) - 1)] += 1
    below = 0
    level = 0
    while below + counts[level] < 0.5 * n:
        below += counts[level]
        level += 1
    return 0.5 * level, total / max(n, 1)


@compiled
def _mark_ridge(
    middle: npt.NDArray[np.float32],
    left: npt.NDArray[np.float32],
    right: npt.NDArray[np.float32],
    up: npt.NDArray[np.float32],
    down: npt.NDArray[np.float32],
    gx: npt.NDArray[np.int16],
    gy: npt.NDArray[np.int16],
    threshold: np.float32,
    mark: npt.NDArray[np.uint8],
) -> None:
    """Mark the pixels of a row that exceed the threshold and their neighbours across the edge.

    Nothing here branches, not even whether to load a neighbour, so that the compiler works on many pixels at a time.
    """
    for x in range(len(middle)):
        m = middle[x]
        a = np.int32(gx[x])
        b = np.int32(gy[x])
        at_left, at_right, at_up, at_down = left[x], right[x], up[x], down[x]
        steep = a * a >= b * b
        m0 = at_left if steep else at_up
        m1 = at_right if steep else at_down
        mark[x] = np.uint8((m >= threshold) & (m > m0) & (m >= m1))


@compiled
def _root(parent: npt.NDArray[np.int32], label: int) -> int:
    while parent[label] != label:
        parent[label] = parent[parent[label]]
        label = parent[label]
    return label


@compiled
def _agree(ax: float, ay: float, bx: float, by: float) -> bool:
    """Tell whether two directions differ by less than 22.5 degrees; edges of opposite sign never agree."""
    dot = ax * bx + ay * by
    return dot > 0.0 and dot * dot > DIRECTION_COS2 * (ax * ax + ay * ay) * (bx * bx + by * by)


@compiled
def _add(total: Record, part: Record) -> None:
    total.n += part.n
    total.x += part.x
    total.y += part.y
    total.xx += part.xx
    total.xy += part.xy
    total.yy += part.yy
    total.gx += part.gx
    total.gy += part.gy


@compiled
def _join_around(
    x: int,
    a: float,
    b: float,
    here: npt.NDArray[np.int32],
    above: npt.NDArray[np.int32],
    parent: npt.NDArray[np.int32],
    sums: RecordArray,
) -> int:
    """Find the component of an edge pixel, joining those that it connects; -1: it agrees with none around it."""
    label = -1
    for k in range(4):
        other = here[x - 1] if k == 0 else above[x - 2 + k]
        if other < 0:
            continue
        other = _root(parent, other)
        if other == label:
            continue
        s = sums[other]
        if label < 0:
            if _agree(s.gx, s.gy, a, b):
                label = other
        elif _agree(s.gx, s.gy, sums[label].gx, sums[label].gy):
            if other < label:
                label, other = other, label
            parent[other] = label
            _add(sums[label], sums[other])
    return label


@compiled
def _clear(sums: Record) -> None:
    sums.n = sums.x = sums.y = sums.xx = sums.xy = sums.yy = sums.gx = sums.gy = 0.0


@compiled
def connect(
    gradient: Gradient, threshold: np.float32, rectified: npt.NDArray[np.float32], components: Components
) -> tuple[int, float, float]:
    """Join edge pixels to components of one gradient direction, in one raster pass.

    Parameters
    ----------
    gradient
        The picture's gradient.
    threshold
        Magnitude from which a maximum across the edge is an edge pixel.
    rectified
        Rectified coordinates (h, w, 2) of the pixels, or (1, 1, 2) where they are the pixels' own.
    components
        Filled with the components.

    Returns
    -------
    tuple
        How many labels were given out, and the sharpness of upright and of level edges: the mean curvature of the
        gradient's ridge over its height, strong edges counting most. It is about 1 for edges as sharp as the pixels,
        1 / s^2 for edges blurred over s pixels. Motion blurs only the edges across its direction.
    """
    gx, gy, magnitude = gradient.gx, gradient.gy, gradient.magnitude
    parent, sums, rows = components.parent, components.sums, components.rows
    mark, words = components.mark, components.words
    height, width = magnitude.shape
    distorted = rectified.shape[0] > 1
    n_labels = 0
    bend = np.full(2, 1e-9)
    ridge = np.full(2, 1e-9)
    above = rows[0]
    here = rows[1]
    edges = rows[2]
    above[:] = -1
    mark[:] = 0
    for y in range(2, height - 2):
        row = magnitude[y]
        _mark_ridge(
            row[2:-2],
            row[1:-3],
            row[3:-1],
            magnitude[y - 1, 2:-2],
            magnitude[y + 1, 2:-2],
            gx[y, 2:-2],
            gy[y, 2:-2],
            threshold,
            mark[2 : width - 2],
        )
        n_edges = 0
        for word in range(len(words)):
            if words[word] != 0:
                for x in range(8 * word, 8 * word + 8):
                    edges[n_edges] = x
                    n_edges += mark[x]
        here[:] = -1
        for k in range(n_edges):
            x = edges[k]
            m = row[x]
            a = float(gx[y, x])
            b = float(gy[y, x])
            # A parabola along the axis nearest to the gradient peaks on the edge whatever its direction.
            dx = 1 if abs(a) >= abs(b) else 0
            dy = 1 - dx
            m0 = row[x - 1] if dx else magnitude[y - 1, x]
            m1 = row[x + 1] if dx else magnitude[y + 1, x]
            curvature = 2.0 * m - m0 - m1
            bend[dx] += curvature
            ridge[dx] += m
            shift = 0.5 * (m1 - m0) / curvature
            px = x + shift * dx
            py = y + shift * dy
            if distorted:
                step = 1 if shift > 0.0 else -1
                part = abs(shift)
                ahead = rectified[y + step * dy, x + step * dx]
                px = rectified[y, x, 0] * (1.0 - part) + ahead[0] * part
                py = rectified[y, x, 1] * (1.0 - part) + ahead[1] * part
                if px != px or py != py:  # outside the usable field
                    continue
            # The common case, one component around, stays in line: a call would count references on its arrays.
            w = here[x - 1]
            nw = above[x - 1]
            n = above[x]
            ne = above[x + 1]
            label = max(max(w, nw), max(n, ne))
            if label >= 0:
                one = ((w < 0) | (w == label)) & ((nw < 0) | (nw == label)) & ((n < 0) | (n == label))
                if one & ((ne < 0) | (ne == label)):
                    label = _root(parent, label)
                    if not _agree(sums[label].gx, sums[label].gy, a, b):
                        label = -1
                else:
                    label = _join_around(x, a, b, here, above, parent, sums)
            if label < 0:
                if n_labels == parent.shape[0]:
                    break
                label = n_labels
                n_labels += 1
                parent[label] = label
                _clear(sums[label])
            s = sums[label]
            s.n += 1.0
            s.x += px
            s.y += py
            s.xx += px * px
            s.xy += px * py
            s.yy += py * py
            s.gx += a
            s.gy += b
            here[x] = label
        above, here = here, above
    return n_labels, bend[1] / ridge[1], bend[0] / ridge[0]


@compiled
def fit(components: Components, n_labels: int, min_length_px: float, lines: RecordArray) -> int:
    """Fit a line to each component, by the article's equations 1 to 4.

    Parameters
    ----------
    components, n_labels
        As `connect` left them.
    min_length_px
        Shorter lines are left out.
    lines
        Array (m,) of `FITTED_LINE`, filled.

    Returns
    -------
    int
        How many lines are long and straight enough.
    """
    parent, sums = components.parent, components.sums
    n_lines = 0
    for label in range(n_labels):
        s = sums[label]
        n = s.n
        if parent[label] != label or n < 0.7 * min_length_px or n < MIN_PIXELS:
            continue
        x = s.x / n
        y = s.y / n
        sxx = s.xx / n - x * x
        sxy = s.xy / n - x * y
        syy = s.yy / n - y * y
        mean = 0.5 * (sxx + syy)
        half = sqrt(0.25 * (sxx - syy) ** 2 + sxy * sxy)
        rms = sqrt(max(mean - half, 0.0))
        length = sqrt(12.0 * (mean + half))  # of evenly spread pixels
        if length < min_length_px or rms > MAX_RMS_PX:
            continue
        angle = 0.5 * np.arctan2(2.0 * sxy, sxx - syy)
        dx = 0.5 * length * np.cos(angle)
        dy = 0.5 * length * np.sin(angle)
        if dx * s.gy - dy * s.gx < 0.0:  # the gradient points to bright; right of (dx, dy) is (-dy, dx)
            dx = -dx
            dy = -dy
        line = lines[n_lines]
        line.x0 = x - dx
        line.y0 = y - dy
        line.x1 = x + dx
        line.y1 = y + dy
        line.length = length
        line.rms = rms
        line.n_pixels = n
        line.contrast = sqrt(s.gx * s.gx + s.gy * s.gy) / n
        n_lines += 1
        if n_lines == len(lines):
            break
    return n_lines
