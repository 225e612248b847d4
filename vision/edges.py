"""The pixel loops: gradient maxima joined to straight components in one raster pass, then fitted.

Compiled; everything works on buffers that the caller keeps from frame to frame. A component is a row of running
sums, so that joining two of them is adding two rows and the line fit needs no second look at the pixels.
"""

from __future__ import annotations

from math import cos, radians, sqrt

import numpy as np
import numpy.typing as npt

from vision.compiled import compiled

FloatArray = npt.NDArray[np.float64]

DIRECTION_COS2 = cos(radians(22.5)) ** 2
MAX_RMS_PX = 0.8  # scatter across the line beyond which it is not one
MIN_PIXELS = 5
ROW_STEP = 8
MAX_BLOCK_STEP = 20  # larger ones are the picture's own edges

# columns of a component's running sums
N, SX, SY, SXX, SXY, SYY, GX, GY, MAG, X_MIN, X_MAX, Y_MIN, Y_MAX = range(13)
N_SUMS = 13
# columns of a fitted line
X0, Y0, X1, Y1, LENGTH, RMS, COUNT, CONTRAST = range(8)
N_LINE = 8


@compiled
def gradient_magnitude(
    gx: npt.NDArray[np.int16], gy: npt.NDArray[np.int16], magnitude: npt.NDArray[np.float32]
) -> None:
    """Fill ``magnitude`` (h, w) with the length of the gradient (gx, gy)."""
    height, width = gx.shape
    for y in range(height):
        for x in range(width):
            a = np.float32(gx[y, x])
            b = np.float32(gy[y, x])
            magnitude[y, x] = np.sqrt(a * a + b * b)


@compiled
def difference_statistics(grey: npt.NDArray[np.uint8], counts: npt.NDArray[np.int64]) -> float:
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
def _root(parent: npt.NDArray[np.int32], label: int) -> int:
    while parent[label] != label:
        parent[label] = parent[parent[label]]
        label = parent[label]
    return label


@compiled
def _new_component(s: FloatArray, x: float, y: float) -> None:
    s[:] = 0.0
    s[X_MIN] = s[X_MAX] = x
    s[Y_MIN] = s[Y_MAX] = y


@compiled
def _add_pixel(s: FloatArray, x: float, y: float, ux: float, uy: float, m: float) -> None:
    s[N] += 1.0
    s[SX] += x
    s[SY] += y
    s[SXX] += x * x
    s[SXY] += x * y
    s[SYY] += y * y
    s[GX] += ux
    s[GY] += uy
    s[MAG] += m
    s[X_MIN] = min(s[X_MIN], x)
    s[X_MAX] = max(s[X_MAX], x)
    s[Y_MIN] = min(s[Y_MIN], y)
    s[Y_MAX] = max(s[Y_MAX], y)


@compiled
def _add_component(t: FloatArray, s: FloatArray) -> None:
    for j in range(X_MIN):
        t[j] += s[j]
    t[X_MIN] = min(t[X_MIN], s[X_MIN])
    t[X_MAX] = max(t[X_MAX], s[X_MAX])
    t[Y_MIN] = min(t[Y_MIN], s[Y_MIN])
    t[Y_MAX] = max(t[Y_MAX], s[Y_MAX])


@compiled
def _agree(ax: float, ay: float, bx: float, by: float) -> bool:
    """Tell whether two directions differ by less than 22.5 degrees; edges of opposite sign never agree."""
    dot = ax * bx + ay * by
    return dot > 0.0 and dot * dot > DIRECTION_COS2 * (ax * ax + ay * ay) * (bx * bx + by * by)


@compiled
def _component_of_pixel(
    x: int,
    ux: float,
    uy: float,
    here: npt.NDArray[np.int32],
    above: npt.NDArray[np.int32],
    parent: npt.NDArray[np.int32],
    sums: FloatArray,
) -> int:
    """Find the component the pixel belongs to, joining those it connects; -1: none of its neighbours' agrees."""
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
            if _agree(s[GX], s[GY], ux, uy):
                label = other
        elif _agree(s[GX], s[GY], sums[label, GX], sums[label, GY]):
            if other < label:
                label, other = other, label
            parent[other] = label
            _add_component(sums[label], sums[other])
    return label


@compiled
def connect(
    gx: npt.NDArray[np.int16],
    gy: npt.NDArray[np.int16],
    magnitude: npt.NDArray[np.float32],
    threshold: np.float32,
    rectified: npt.NDArray[np.float32],
    parent: npt.NDArray[np.int32],
    sums: FloatArray,
    rows: npt.NDArray[np.int32],
) -> tuple[int, float, float]:
    """Join edge pixels to components in one raster pass; return how many labels were given out, and sharpness.

    Sharpness is the mean curvature of the gradient's ridge over its height, strong edges counting most: about 1 for
    edges as sharp as the pixels, 1 / s^2 for edges blurred over s pixels. It is taken apart for steep and for flat
    edges: motion blurs only those across its way.

    Parameters
    ----------
    gx, gy, magnitude
        Gradient and its length (h, w).
    threshold
        Length from which a maximum is an edge.
    rectified
        Rectified coordinates (h, w, 2) of the pixels, or (1, 1, 2) where they are the pixels' own.
    parent, sums
        Filled: each label's parent, and the sums (labels, 13) of those that are their own.
    rows
        Two rows (2, w) of labels, for work.
    """
    height, width = magnitude.shape
    distorted = rectified.shape[0] > 1
    n_labels = 0
    steep_bend = steep_height = flat_bend = flat_height = 1e-9
    above = rows[0]
    here = rows[1]
    above[:] = -1
    for y in range(2, height - 2):
        here[:] = -1
        for x in range(2, width - 2):
            m = magnitude[y, x]
            if m < threshold:
                continue
            a = gx[y, x]
            b = gy[y, x]
            # A parabola along the axis nearest to the gradient peaks on the edge whatever its direction.
            dx = 1 if abs(a) >= abs(b) else 0
            dy = 1 - dx
            m0 = magnitude[y - dy, x - dx]
            m1 = magnitude[y + dy, x + dx]
            if m <= m0 or m < m1:
                continue
            curvature = 2.0 * m - m0 - m1
            if dx:
                steep_bend += curvature
                steep_height += m
            else:
                flat_bend += curvature
                flat_height += m
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
            ux = a / m
            uy = b / m
            label = _component_of_pixel(x, ux, uy, here, above, parent, sums)
            if label < 0:
                if n_labels == parent.shape[0]:
                    return n_labels, steep_bend / steep_height, flat_bend / flat_height
                label = n_labels
                n_labels += 1
                parent[label] = label
                _new_component(sums[label], px, py)
            _add_pixel(sums[label], px, py, ux, uy, m)
            here[x] = label
        above, here = here, above
    return n_labels, steep_bend / steep_height, flat_bend / flat_height


@compiled
def fit(
    parent: npt.NDArray[np.int32], sums: FloatArray, n_labels: int, min_length_px: float, lines: FloatArray
) -> int:
    """Fit a line to each component (the article's equations 1 to 4); return how many are long and straight enough.

    ``lines`` gets a row per line: end points, length, scatter, pixels and mean gradient. Walking from the first end
    to the second, the bright side is on the right.
    """
    n_lines = 0
    for label in range(n_labels):
        s = sums[label]
        n = s[N]
        if parent[label] != label or n < 0.7 * min_length_px or n < MIN_PIXELS:
            continue
        x = s[SX] / n
        y = s[SY] / n
        sxx = s[SXX] / n - x * x
        sxy = s[SXY] / n - x * y
        syy = s[SYY] / n - y * y
        smaller = 0.5 * (sxx + syy) - sqrt(0.25 * (sxx - syy) ** 2 + sxy * sxy)
        rms = sqrt(max(smaller, 0.0))
        angle = 0.5 * np.arctan2(2.0 * sxy, sxx - syy)
        dx = np.cos(angle)
        dy = np.sin(angle)
        if dx * s[GY] - dy * s[GX] < 0.0:  # the gradient points to bright; right of (dx, dy) is (-dy, dx)
            dx = -dx
            dy = -dy
        if abs(dx) >= abs(dy):
            t0 = (s[X_MIN] - x) / dx
            t1 = (s[X_MAX] - x) / dx
        else:
            t0 = (s[Y_MIN] - y) / dy
            t1 = (s[Y_MAX] - y) / dy
        length = abs(t1 - t0)
        if length < min_length_px or rms > MAX_RMS_PX:
            continue
        t0, t1 = min(t0, t1), max(t0, t1)
        row = lines[n_lines]
        row[X0] = x + t0 * dx
        row[Y0] = y + t0 * dy
        row[X1] = x + t1 * dx
        row[Y1] = y + t1 * dy
        row[LENGTH] = length
        row[RMS] = rms
        row[COUNT] = n
        row[CONTRAST] = s[MAG] / n
        n_lines += 1
        if n_lines == len(lines):
            break
    return n_lines
