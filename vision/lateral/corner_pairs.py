"""Pairs of corner candidates, left and right, and the evidence that a pair is the corridor's two corners.

Every candidate on the left is paired with every one on the right, separately for floor and ceiling. With the slopes
t_L, t_R below (above) the horizontal the pair gives, in units of half the width and of the camera's distance from the
floor (ceiling):

    offset = (t_R - t_L) / (t_R + t_L),    width = 1 / t_L + 1 / t_R

The two true corners are long and of equal contrast; vertical lines end at them and do not cross them; transverse
lines reach from one to the other; lines beyond a corner exist on both sides or on neither; skirting boards, door tops
and rails of one wall have a counterpart on the other, at the same lateral offset. `EVIDENCE` lists these quantities,
and `vision.lateral.hypotheses` weights them.
"""

from __future__ import annotations

from math import hypot, log, sqrt
from typing import NamedTuple

import numpy as np

from vision.axis.vanishing_point import AxisFit, corridor_frame
from vision.compiled import compiled, compiled_inner
from vision.lateral.corner_candidates import (
    MAX_CORNERS,
    CornerCandidates,
    count_bits,
    find_corner_candidates,
)
from vision.lateral.line_directions import PictureLines, sort_by_direction
from vision.lines.line_set import LineSet
from vision.types import FloatArray, IntArray, Record, RecordArray

# Corridor width over the camera's distance from the floor and from the ceiling
MIN_WIDTH = 0.3
MAX_WIDTH = (8.0, 12.0)
TYPICAL_WIDTH = (1.7, 2.0)

LENGTH_SCALE = 0.05  # of the diagonal: a length l counts as log(1 + l / LENGTH_SCALE)
MAX_OFFSET, NEAR_WALL_SCALE = 0.7, 0.1  # vehicles seldom fly nearer to a wall
SAME_SKIRTING = 0.02
MAX_SPANS = 2
SYMMETRY_WINDOW = 0.04  # in lateral offset
SYMMETRY_CONTRAST = 0.25  # in the logarithm
CLEAR_OF_CORNER_RAD = 0.0175

PAIR = np.dtype(
    [
        ("offset", np.float64),  # lateral offset over half the corridor's width, positive right
        ("offset_std", np.float64),
        ("width", np.float64),  # of the corridor, over the camera's distance from the floor or the ceiling
        ("left", np.int64),  # index of the candidate in the left quadrant
        ("right", np.int64),  # index of the candidate in the right quadrant
    ],
    align=True,
)
"""A pair of corners."""

EVIDENCE = np.dtype(
    [
        (name, np.float64)
        for name in (
            "lengths",  # sum of both lengths' logarithms
            "coverages",  # sum of both coverages
            "vertical_ends",  # sum of the logarithms of the lengths of vertical lines ending at each
            "transverse_crossings",  # sum of the logarithms of the lengths of transverse lines crossing each
            "length_gap",  # difference of the lengths' logarithms; likewise the gaps below
            "vertical_ends_gap",
            "vertical_crossings_gap",
            "beyond_gap",
            "same_polarity",  # 1: both bright on the same side, -1: on opposite sides
            "contrast_gap",
            "spans",  # number of transverse lines from one to the other, at most MAX_SPANS
            "skirtings",  # logarithm of the shorter skirting board's length, where both have one height
            "symmetry",  # logarithm of the length of other lines that are symmetric at this offset
            "near_wall",  # excess of the offset over MAX_OFFSET
            "log_width",  # logarithm of the width over a typical one
            "log_width_squared",
            "log_pairs",  # logarithm of the number of pairs to choose from
        )
    ],
    align=True,
)
"""Evidence for a pair, dimensionless; contiguous, so that it can also be viewed as a vector."""

N_EVIDENCE = len(EVIDENCE.names or ())


class CornerPairs(NamedTuple):
    """Possible pairs of corners of the floor, or of the ceiling.

    Parameters
    ----------
    pair
        Array (k,) of `PAIR`.
    evidence
        Array (k,) of `EVIDENCE`.
    """

    pair: RecordArray
    evidence: RecordArray


class PictureCorners(NamedTuple):
    """Candidates for the corners in a picture, and their pairs on the floor and on the ceiling."""

    candidates: CornerCandidates
    floor: CornerPairs
    ceiling: CornerPairs


@compiled_inner
def _log_sum(a: float, b: float) -> tuple[float, float]:
    """Sum and absolute difference of the logarithms of two lengths."""
    la, lb = log(1.0 + a / LENGTH_SCALE), log(1.0 + b / LENGTH_SCALE)
    return la + lb, abs(la - lb)


@compiled_inner
def _log_ratio(a: float, b: float) -> float:
    return abs(log((LENGTH_SCALE + a) / (LENGTH_SCALE + b)))


@compiled_inner
def _fill_evidence(row: Record, left: Record, right: Record) -> None:
    """Fill in the evidence that depends only on the two corners of a pair."""
    row.lengths, row.length_gap = _log_sum(left.length, right.length)
    row.coverages = left.coverage + right.coverage
    row.vertical_ends, row.vertical_ends_gap = _log_sum(left.vertical_ends, right.vertical_ends)
    row.vertical_crossings_gap = _log_ratio(left.vertical_crossings, right.vertical_crossings)
    row.beyond_gap = _log_ratio(left.beyond, right.beyond)
    row.transverse_crossings = log(
        (1.0 + left.transverse_crossings / LENGTH_SCALE) * (1.0 + right.transverse_crossings / LENGTH_SCALE)
    )
    row.same_polarity = left.polarity * right.polarity
    row.contrast_gap = abs(log(left.contrast / right.contrast))
    row.spans = min(count_bits(left.transverse_ends & right.transverse_ends), MAX_SPANS)
    skirting = min(left.skirting_length, right.skirting_length)
    same = abs(left.skirting_ratio - right.skirting_ratio) < SAME_SKIRTING
    row.skirtings = log(1.0 + skirting / LENGTH_SCALE) if same else 0.0


@compiled_inner
def _pair_up(left: RecordArray, right: RecordArray, max_width: float, typical_width: float) -> CornerPairs:
    """Pair every left candidate with every right one, where the resulting corridor width is plausible."""
    size = len(left) * len(right)
    pairs, evidence = np.empty(size, PAIR), np.empty(size, EVIDENCE)
    count = 0
    for i in range(len(left)):
        for j in range(len(right)):
            a, b = left[i], right[j]
            tl, tr = a.slope, b.slope
            total = tl + tr
            width = total / (tl * tr)
            if not MIN_WIDTH < width < max_width:
                continue
            pair, row = pairs[count], evidence[count]
            count += 1
            pair.offset = (tr - tl) / total
            pair.offset_std = (
                2.0
                * hypot(tl * b.angle_std * (1.0 + tr * tr), tr * a.angle_std * (1.0 + tl * tl))
                / (total * total)
            )
            pair.width, pair.left, pair.right = width, i, j
            _fill_evidence(row, a, b)
            row.near_wall = max(0.0, abs(pair.offset) - MAX_OFFSET) / NEAR_WALL_SCALE
            row.log_width = log(width / typical_width)
            row.log_width_squared = row.log_width * row.log_width
            row.log_pairs = log(float(len(left) * len(right)))
    return CornerPairs(pairs[:count], evidence[:count])


@compiled
def rising_order(values: FloatArray) -> IntArray:
    """Return the indices (n,) that sort values (n,), by Shell sort; numba's own sort takes a second to compile."""
    n = len(values)
    order = np.empty(n, np.int64)
    for i in range(n):
        order[i] = i
    gap = 1
    while 3 * gap < n:
        gap = 3 * gap + 1
    while gap > 0:
        for i in range(gap, n):
            index, k = order[i], i
            while k >= gap and values[order[k - gap]] > values[index]:
                order[k] = order[k - gap]
                k -= gap
            order[k] = index
        gap //= 3
    return order


@compiled_inner
def _fill_symmetry(floor: CornerPairs, ceiling: CornerPairs, corners: RecordArray) -> None:
    """Sum for each pair the lengths of other pairs at the same offset: structure that is symmetric on both walls."""
    n = len(floor.pair)
    m = n + len(ceiling.pair)
    offset, weight, angle = np.empty(m), np.empty(m), np.empty((m, 2))
    for p in range(m):
        pair = floor.pair[p] if p < n else ceiling.pair[p - n]
        row = floor.evidence[p] if p < n else ceiling.evidence[p - n]
        q = 0 if p < n else 2
        a, b = corners[q, pair.left], corners[q + 1, pair.right]
        offset[p], angle[p, 0], angle[p, 1] = pair.offset, a.angle, b.angle
        z = row.contrast_gap / SYMMETRY_CONTRAST
        weight[p] = sqrt(a.length * b.length) / (1.0 + z * z) if row.same_polarity > 0.0 else 0.0
    order = rising_order(offset)
    for s in range(m):
        p = order[s]
        total = 0.0
        for step in (-1, 1):
            t = s + step
            while 0 <= t < m and abs(offset[order[t]] - offset[p]) < SYMMETRY_WINDOW:
                q = order[t]
                t += step
                if (p < n) == (q < n) and (
                    angle[q, 0] > angle[p, 0] - CLEAR_OF_CORNER_RAD
                    or angle[q, 1] > angle[p, 1] - CLEAR_OF_CORNER_RAD
                ):
                    continue  # beyond the corners there is no wall
                z = (offset[q] - offset[p]) / SYMMETRY_WINDOW
                total += weight[q] * (1.0 - z * z)
        row = floor.evidence[p] if p < n else ceiling.evidence[p - n]
        row.symmetry = log(1.0 + total / LENGTH_SCALE)


@compiled
def pair_corners(candidates: CornerCandidates) -> tuple[CornerPairs, CornerPairs]:
    """Return the possible pairs of the floor's corners, and of the ceiling's, with their evidence."""
    corners, count = candidates.corners, candidates.n_candidates
    floor = _pair_up(corners[0, : count[0]], corners[1, : count[1]], MAX_WIDTH[0], TYPICAL_WIDTH[0])
    ceiling = _pair_up(corners[2, : count[2]], corners[3, : count[3]], MAX_WIDTH[1], TYPICAL_WIDTH[1])
    _fill_symmetry(floor, ceiling, corners)
    return floor, ceiling


@compiled
def corners_of_arrays(
    lines: PictureLines, R_axis_camera: FloatArray, down: FloatArray, diagonal_px: float, max_corners: int
) -> PictureCorners:
    """Find the pairs of lines that may be the corridor's corners, for compiled callers.

    Parameters
    ----------
    lines, R_axis_camera, down, diagonal_px
        Result of `arrays_of`, see `vision.lateral.line_directions.sort_by_direction`.
    max_corners
        Largest number of candidates in a quadrant; lines are taken longest first.
    """
    candidates = find_corner_candidates(
        sort_by_direction(lines, R_axis_camera, down, diagonal_px), max_corners
    )
    floor, ceiling = pair_corners(candidates)
    return PictureCorners(candidates, floor, ceiling)


def arrays_of(
    lines: LineSet, axis: AxisFit, R_level_camera: FloatArray
) -> tuple[PictureLines, FloatArray, FloatArray, float]:
    """Return the first arguments of `corners_of_arrays`; parameters as in `find_corner_pairs`."""
    R_axis_camera = corridor_frame(R_level_camera, axis.heading_rad, axis.elevation_rad)
    arrays = PictureLines(
        normal=lines.normal,
        centre=lines.centre,
        direction=lines.direction,
        sigma_rad=lines.sigma_rad,
        arc_rad=lines.arc_rad,
        length_px=lines.length_px,
        contrast=lines.contrast,
        along_corridor=axis.inlier,
    )
    return arrays, R_axis_camera, R_level_camera[2], hypot(lines.width_px, lines.height_px)


def find_corner_pairs(lines: LineSet, axis: AxisFit, R_level_camera: FloatArray) -> PictureCorners:
    """Find the pairs of lines that may be the corridor's corners.

    Parameters
    ----------
    lines, axis
        The picture's lines, and the corridor's axis among them.
    R_level_camera
        Rotation (3, 3) from the optical frame to the level frame.
    """
    return corners_of_arrays(*arrays_of(lines, axis, R_level_camera), MAX_CORNERS)
