"""Line fits to components of edge pixels, and the joining of fragments of one edge.

A component's scatter matrix gives the line (the article's equations 1 to 4): direction by the eigenvector of the
larger eigenvalue L, length ``sqrt(12 L)`` as of evenly spread pixels, rms across it by the smaller eigenvalue. The
position across a line has the variance ``v = 12 rms^2 / n + floor^2``, as about one in 12 pixels is independent, and
its direction ``12 v / length^2``.

Noise, a door handle or a shadow breaks an edge into fragments, differently in each picture. A fragment alone gives
the edge's direction poorly; joined, the fragments are as precise as an unbroken edge. Two fragments are joined if
each one's direction agrees with the line through both midpoints (chi^2 below `JOIN_CHI2`), the gap is not too long,
and at least one extrapolates precisely enough for the agreement to be significant.
"""

from __future__ import annotations

from math import atan2, pi, sqrt

import numpy as np

from vision.compiled import compiled_inner
from vision.lines.edges import Components, add_sums
from vision.types import FloatArray, IntArray, Record, RecordArray

MAX_RMS_PX = 0.8  # of the pixels across a line
MIN_PIXELS = 5
PIXELS_PER_INDEPENDENT = 12.0  # neighbouring edge pixels share blur, noise and aliasing
JOIN_CHI2 = 4.0  # of each fragment's direction against the line through both midpoints
MAX_GAP = 1.0  # between fragments, over the length of the longer one
MAX_OVERLAP = 0.5  # of the shorter one's length
# Standard deviation of the more precise line at the other's midpoint; with a larger one agreement may be chance.
MAX_EXTRAPOLATED_PX = 1.0
SECTORS = 60  # of directions; fragments of one edge are in the same or in neighbouring sectors
ROUNDING = 1.0001  # margin for rounding where a limit is computed in another order

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
        ("label", np.int64),  # of its component
    ],
    align=True,
)
"""A line fitted to a component. Walking from the first end to the second, the bright side is on the right."""


@compiled_inner
def _fit(s: Record, line: Record) -> None:
    """Fit a line to a component's sums by the article's equations 1 to 4."""
    n = s.n
    x = s.x / n
    y = s.y / n
    sxx = s.xx / n - x * x
    sxy = s.xy / n - x * y
    syy = s.yy / n - y * y
    mean = 0.5 * (sxx + syy)
    half = sqrt(0.25 * (sxx - syy) ** 2 + sxy * sxy)
    length = sqrt(12.0 * (mean + half))  # of evenly spread pixels
    angle = 0.5 * atan2(2.0 * sxy, sxx - syy)
    dx = 0.5 * length * np.cos(angle)
    dy = 0.5 * length * np.sin(angle)
    if dx * s.gy - dy * s.gx < 0.0:  # the gradient points to bright; right of (dx, dy) is (-dy, dx)
        dx = -dx
        dy = -dy
    line.x0 = x - dx
    line.y0 = y - dy
    line.x1 = x + dx
    line.y1 = y + dy
    line.length = length
    line.rms = sqrt(max(mean - half, 0.0))
    line.n_pixels = n
    line.contrast = sqrt(s.gx * s.gx + s.gy * s.gy) / n


@compiled_inner
def fit_components(components: Components, n_labels: int, min_length_px: float, lines: RecordArray) -> int:
    """Fit a line to each component.

    Parameters
    ----------
    components, n_labels
        Results of `vision.lines.edges.connect_edge_pixels`.
    min_length_px
        Shorter lines are left out.
    lines
        Array (m,) of `FITTED_LINE`, filled.

    Returns
    -------
    int
        Number of lines that are long and straight enough.
    """
    parent, sums = components.parent, components.sums
    n_lines = 0
    for label in range(n_labels):
        n = sums[label].n
        if parent[label] != label or n < 0.7 * min_length_px or n < MIN_PIXELS:
            continue
        line = lines[n_lines]
        _fit(sums[label], line)
        if line.length < min_length_px or line.rms > MAX_RMS_PX:
            continue
        line.label = label
        n_lines += 1
        if n_lines == len(lines):
            break
    return n_lines


@compiled_inner
def variance_across(line: Record, floor_px: float) -> float:
    """Return the variance (px^2) of a line's midpoint across the line; ``floor_px`` as in `join_fragments`."""
    return float(line.rms * line.rms * PIXELS_PER_INDEPENDENT / line.n_pixels + floor_px * floor_px)


@compiled_inner
def _are_of_one_edge(a: Record, b: Record, floor_px: float) -> bool:
    ax, ay, bx, by = a.x1 - a.x0, a.y1 - a.y0, b.x1 - b.x0, b.y1 - b.y0
    apart_x = 0.5 * (b.x0 + b.x1 - a.x0 - a.x1)
    apart_y = 0.5 * (b.y0 + b.y1 - a.y0 - a.y1)
    # Multiplied by the length of a, so that most pairs are rejected without a division.
    along, across = abs(ax * apart_x + ay * apart_y), ax * apart_y - ay * apart_x
    middle, longer, shorter = 0.5 * (a.length + b.length), max(a.length, b.length), min(a.length, b.length)
    # Fragments side by side, not one behind the other, belong to different edges.
    if along > a.length * (middle + MAX_GAP * longer) or along < a.length * (middle - MAX_OVERLAP * shorter):
        return False
    if abs(across) > along or ax * bx + ay * by <= 0.0:
        return False
    a_middle, b_middle = variance_across(a, floor_px), variance_across(b, floor_px)
    squared = apart_x * apart_x + apart_y * apart_y
    a_turn = 12.0 * a_middle / (a.length * a.length) * squared
    b_turn = 12.0 * b_middle / (b.length * b.length) * squared
    if min(a_middle + a_turn, b_middle + b_turn) > MAX_EXTRAPOLATED_PX**2:
        return False
    # sines of the directions against the line through both midpoints, times their distance
    a_off, b_off = across / a.length, (bx * apart_y - by * apart_x) / b.length
    middles = a_middle + b_middle
    return bool(
        a_off * a_off < JOIN_CHI2 * (middles + a_turn) and b_off * b_off < JOIN_CHI2 * (middles + b_turn)
    )


@compiled_inner
def _sector(line: Record) -> int:
    return int((atan2(line.y1 - line.y0, line.x1 - line.x0) / pi + 1.0) * 0.5 * SECTORS) % SECTORS


@compiled_inner
def _fill_middle(line: Record, floor_px: float, middle: FloatArray) -> None:
    """Fill in twice the midpoint (x, y) of a line, and its variance across the line."""
    middle[0], middle[1] = line.x0 + line.x1, line.y0 + line.y1
    middle[2] = variance_across(line, floor_px)


@compiled_inner
def _next_in_line(line: Record, own: FloatArray, middles: FloatArray, following: IntArray, other: int) -> int:
    """Return the first line of a linked list whose midpoint allows `_are_of_one_edge` to be true; -1: none.

    This test rejects nearly all pairs without a division and with little memory traffic. ``own`` is the line's own
    row of ``middles`` (m, 3), see `_fill_middle`; the list starts at ``other`` and continues by ``following``.
    """
    ax, ay, x, y = line.x1 - line.x0, line.y1 - line.y0, own[0], own[1]
    # The limit of a_off in `_are_of_one_edge`, times the squared length, and times 4 as the midpoints are doubled.
    per_variance = 4.0 * ROUNDING * JOIN_CHI2 * line.length * line.length
    constant, per_distance = per_variance * own[2], 12.0 * ROUNDING * JOIN_CHI2 * own[2]
    while other >= 0:
        apart_x, apart_y = middles[other, 0] - x, middles[other, 1] - y
        across = ax * apart_y - ay * apart_x
        limit = constant + per_variance * middles[other, 2]
        if across * across <= limit + per_distance * (apart_x * apart_x + apart_y * apart_y):
            break
        other = following[other]
    return other


@compiled_inner
def join_fragments(
    components: Components, lines: RecordArray, n_lines: int, floor_px: float, following: IntArray
) -> int:
    """Join fragments of one edge; return the number of remaining lines.

    Parameters
    ----------
    components
        Components of the lines; their sums are added where lines are joined.
    lines, n_lines
        Results of `fit_components`; the remaining lines are moved to the front.
    floor_px
        Error across a line that does not average out over its pixels.
    following
        Working memory (m,), as long as ``lines``.
    """
    first, sector, middles = np.full(SECTORS, -1), np.empty(n_lines, np.int64), np.empty((n_lines, 3))
    for i in range(n_lines - 1, -1, -1):
        sector[i] = _sector(lines[i])
        following[i] = first[sector[i]]
        first[sector[i]] = i
        _fill_middle(lines[i], floor_px, middles[i])
    for i in range(n_lines):
        line = lines[i]
        grown = line.label >= 0
        while grown:
            grown = False
            for turn in range(-1, 2):
                j = _next_in_line(line, middles[i], middles, following, first[(sector[i] + turn) % SECTORS])
                while j >= 0:
                    other = lines[j]
                    if j != i and other.label >= 0 and _are_of_one_edge(line, other, floor_px):
                        add_sums(components.sums[line.label], components.sums[other.label])
                        _fit(components.sums[line.label], line)
                        _fill_middle(line, floor_px, middles[i])
                        other.label = -1
                        grown = True
                    j = _next_in_line(line, middles[i], middles, following, following[j])
    n_left = 0
    for i in range(n_lines):
        if lines[i].label >= 0:
            lines[n_left] = lines[i]
            n_left += 1
    return n_left
