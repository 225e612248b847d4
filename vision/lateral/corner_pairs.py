"""Pairs of corners: every candidate on the left wall with every one on the right, and the evidence for each pair.

Both are long and of one contrast; what stands upright ends at them and does not cross them; lines across reach from
one to the other; nothing lies beyond one only; boards, door tops and rails find their counterpart on the other wall
at the offset the pair gives. `vision.lateral.offset` weighs it.
"""

from __future__ import annotations

from math import hypot, log, sqrt

import numpy as np
import numpy.typing as npt

from vision.axis.vanishing_point import AxisFit, axis_direction
from vision.compiled import compiled
from vision.lateral.corner_candidates import (
    ANGLE,
    BEYOND,
    BOARD,
    BOARD_LENGTH,
    CONTRAST,
    COVERAGE,
    CROSSED,
    CROSSING,
    ENDING,
    LENGTH,
    MAX_CORNERS,
    POLARITY,
    SLOPE,
    STD,
    count_bits,
    survey,
)
from vision.lines.segments import LineSet

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

MIN_WIDTH = 0.3  # corridor width over the camera's distance from floor, from ceiling
MAX_WIDTH = (8.0, 12.0)
TYPICAL_WIDTH = (1.7, 2.0)
SMALL = 0.05  # of the diagonal: from here on lengths count by the logarithm
ASIDE_SCALE = 0.1
MAX_ASIDE = 0.7  # nearer to a wall a vehicle seldom flies
SAME_BOARD = 0.02
VOTE_WINDOW = 0.04  # in offset
VOTE_CONTRAST = 0.25  # in the logarithm
CLEAR_OF_CORNER_RAD = 0.0175


# columns of pairs; those from LENGTHS on are evidence
OFFSET, OFFSET_STD, WIDTH, LEFT, RIGHT = range(5)
LENGTHS, COVERAGES, ENDINGS, CROSSEDS, LENGTH_GAP, ENDING_GAP, CROSSING_GAP, BEYOND_GAP = range(5, 13)
SAME_POLARITY, CONTRAST_GAP, SPANS, BOARDS, VOTES, ASIDE, WIDE, WIDE_SQUARED, CROWD = range(13, 22)
N_PAIR = 22
EVIDENCE = slice(LENGTHS, N_PAIR)


@compiled
def _pair(
    left: FloatArray,
    right: FloatArray,
    rungs_left: IntArray,
    rungs_right: IntArray,
    above: int,
    pairs: FloatArray,
) -> int:
    """Pair every left with every right candidate; return how many pairs are possible."""
    count = 0
    for i in range(len(left)):
        for j in range(len(right)):
            a, b = left[i], right[j]
            tl, tr = a[SLOPE], b[SLOPE]
            total = tl + tr
            width = total / (tl * tr)
            if not MIN_WIDTH < width < MAX_WIDTH[above]:
                continue
            row = pairs[count]
            count += 1
            row[OFFSET] = (tr - tl) / total
            row[OFFSET_STD] = (
                2.0 * hypot(tl * b[STD] * (1.0 + tr * tr), tr * a[STD] * (1.0 + tl * tl)) / (total * total)
            )
            row[WIDTH], row[LEFT], row[RIGHT] = width, i, j
            la, lb = log(1.0 + a[LENGTH] / SMALL), log(1.0 + b[LENGTH] / SMALL)
            ea, eb = log(1.0 + a[ENDING] / SMALL), log(1.0 + b[ENDING] / SMALL)
            row[LENGTHS], row[LENGTH_GAP] = la + lb, abs(la - lb)
            row[COVERAGES] = a[COVERAGE] + b[COVERAGE]
            row[ENDINGS], row[ENDING_GAP] = ea + eb, abs(ea - eb)
            row[CROSSING_GAP] = abs(log((SMALL + a[CROSSING]) / (SMALL + b[CROSSING])))
            row[BEYOND_GAP] = abs(log((SMALL + a[BEYOND]) / (SMALL + b[BEYOND])))
            row[CROSSEDS] = log((1.0 + a[CROSSED] / SMALL) * (1.0 + b[CROSSED] / SMALL))
            row[SAME_POLARITY] = a[POLARITY] * b[POLARITY]
            row[CONTRAST_GAP] = abs(log(a[CONTRAST] / b[CONTRAST]))
            row[SPANS] = min(count_bits(rungs_left[i] & rungs_right[j]), 2)
            board = min(a[BOARD_LENGTH], b[BOARD_LENGTH])
            row[BOARDS] = log(1.0 + board / SMALL) if abs(a[BOARD] - b[BOARD]) < SAME_BOARD else 0.0
            row[ASIDE] = max(0.0, abs(row[OFFSET]) - MAX_ASIDE) / ASIDE_SCALE
            row[WIDE] = log(width / TYPICAL_WIDTH[above])
            row[WIDE_SQUARED] = row[WIDE] * row[WIDE]
            row[CROWD] = log(float(len(left) * len(right)))
    return count


@compiled
def _vote(floor: FloatArray, ceiling: FloatArray, corners: FloatArray) -> None:
    """Let every pair be supported by the pairs of the same offset: what is symmetric on the walls."""
    n = len(floor)
    m = n + len(ceiling)
    offset, weight, angle = np.empty(m), np.empty(m), np.empty((m, 2))
    for p in range(m):
        row = floor[p] if p < n else ceiling[p - n]
        q = 0 if p < n else 2
        a, b = corners[q, int(row[LEFT])], corners[q + 1, int(row[RIGHT])]
        offset[p], angle[p, 0], angle[p, 1] = row[OFFSET], a[ANGLE], b[ANGLE]
        z = row[CONTRAST_GAP] / VOTE_CONTRAST
        weight[p] = sqrt(a[LENGTH] * b[LENGTH]) / (1.0 + z * z) if row[SAME_POLARITY] > 0.0 else 0.0
    order = np.argsort(offset)
    for s in range(m):
        p = order[s]
        total = 0.0
        for step in (-1, 1):
            t = s + step
            while 0 <= t < m and abs(offset[order[t]] - offset[p]) < VOTE_WINDOW:
                q = order[t]
                t += step
                if (p < n) == (q < n) and (
                    angle[q, 0] > angle[p, 0] - CLEAR_OF_CORNER_RAD
                    or angle[q, 1] > angle[p, 1] - CLEAR_OF_CORNER_RAD
                ):
                    continue  # beyond the corners there is no wall
                z = (offset[q] - offset[p]) / VOTE_WINDOW
                total += weight[q] * (1.0 - z * z)
        if p < n:
            floor[p, VOTES] = log(1.0 + total / SMALL)
        else:
            ceiling[p - n, VOTES] = log(1.0 + total / SMALL)


@compiled
def pair_corners(corners: FloatArray, found: IntArray, touching: IntArray) -> tuple[FloatArray, FloatArray]:
    """Pair the candidates of `survey`; return the pairs of the floor and those of the ceiling, (k, 22) each."""
    size = MAX_CORNERS * MAX_CORNERS
    floor, ceiling = np.empty((size, N_PAIR)), np.empty((size, N_PAIR))
    n = _pair(corners[0, : found[0]], corners[1, : found[1]], touching[0], touching[1], 0, floor)
    m = _pair(corners[2, : found[2]], corners[3, : found[3]], touching[2], touching[3], 1, ceiling)
    floor, ceiling = floor[:n], ceiling[:m]
    _vote(floor, ceiling, corners)
    return floor, ceiling


def survey_lines(
    lines: LineSet, axis: AxisFit, R_level_camera: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return candidates for corners (4, 12, 15), and the pairs of the floor and of the ceiling, (k, 22) each."""
    ahead = axis_direction(axis.heading_rad, axis.elevation_rad)
    rightward = axis_direction(axis.heading_rad - 0.5 * np.pi, 0.0)
    R_axis_camera = np.array([ahead, rightward, np.cross(ahead, rightward)]) @ R_level_camera
    corners, found, touching = survey(
        lines.normal,
        lines.centre,
        lines.direction,
        lines.arc_rad,
        lines.sigma_rad,
        lines.length_px,
        lines.contrast,
        axis.inlier,
        R_axis_camera,
        R_level_camera[2],
        hypot(lines.width_px, lines.height_px),
    )
    floor, ceiling = pair_corners(corners, found, touching)
    return corners, floor, ceiling
