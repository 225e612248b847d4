"""Candidates for the corridor's four corners, where its walls meet floor and ceiling.

Corridor lines of one quadrant with the same angle about the axis are grouped into one candidate, longest line first;
its angle is their mean weighted by inverse variance. For each candidate the lengths of other lines are summed:
vertical lines that end at it (evidence for a corner) or cross it (against), transverse lines that end at it (they may
reach from corner to corner) or cross it (against), and corridor lines beyond it. Frame, angles, quadrants and sides
are those of `vision.lateral.line_directions`.
"""

from __future__ import annotations

from math import log, radians, sin, sqrt, tan
from typing import NamedTuple

import numpy as np

from vision.compiled import compiled_inner
from vision.lateral.line_directions import ANGLE_FLOOR_RAD, SortedLines
from vision.types import IntArray, Record, RecordArray

MAX_CORNERS = 12  # candidates in a quadrant
MERGE_STD_RAD, MAX_MERGE_RAD = radians(0.2), radians(2.0)
BEYOND_RAD = radians(1.5)
FIRST_BIN, BIN_WIDTH, N_BINS = 0.03, 0.16, 32  # coverage counts bins of the logarithm of inverse depth
COVERAGE_PER_BIN = 0.1
MIN_SKIRTING, MAX_SKIRTING = 0.84, 0.975  # depth of a skirting board's top below the camera over its foot's

CORNER = np.dtype(
    [
        ("slope", np.float64),  # tangent of the angle
        ("angle", np.float64),  # about the axis, radians from the horizontal
        ("angle_std", np.float64),
        ("length", np.float64),  # of all its lines
        ("polarity", np.float64),  # mean over length; 1: bright below, -1: bright above
        ("contrast", np.float64),  # mean over length
        ("farthest_depth", np.float64),  # over the distance of the corner from the axis
        ("coverage", np.float64),  # tenths: bins of depth with a line
        ("vertical_ends", np.float64),  # length of the vertical lines that end here
        ("vertical_crossings", np.float64),  # length of the vertical lines that cross it
        ("beyond", np.float64),  # length of the corridor lines beyond it, where no wall should be
        ("transverse_crossings", np.float64),  # length of the transverse lines that cross it
        ("skirting_ratio", np.float64),  # slope of its skirting board's presumed top over its own; 0: none
        ("skirting_length", np.float64),
        ("transverse_ends", np.int64),  # bit i: transverse line i ends here
        ("line", np.int64),  # index of its longest line in the `LineSet`
    ],
    align=True,
)
"""A candidate for a corner; lengths are over the picture's diagonal."""


class CornerCandidates(NamedTuple):
    """Candidates for each corner.

    Parameters
    ----------
    corners
        Array (4, n) of `CORNER`, a row per quadrant.
    n_candidates
        How many candidates each row holds (4,).
    """

    corners: RecordArray
    n_candidates: IntArray


@compiled_inner
def _depth_bins(nearest: float, farthest: float) -> int:
    """Return a bit mask of the depth bins that a line covers."""
    first = int(log(max(farthest, FIRST_BIN) / FIRST_BIN) / BIN_WIDTH)
    last = int(log(max(nearest, FIRST_BIN) / FIRST_BIN) / BIN_WIDTH)
    first, last = min(first, N_BINS - 1), min(last, N_BINS - 1)
    return (1 << (last + 1)) - (1 << first)


@compiled_inner
def count_bits(bits: int) -> int:
    """Return the number of set bits."""
    count = 0
    while bits:
        bits &= bits - 1
        count += 1
    return count


@compiled_inner
def group_by_angle(lines: RecordArray, quadrant: int, corners: RecordArray) -> int:
    """Group the corridor lines of a quadrant by angle, longest first.

    Parameters
    ----------
    lines
        Array (n,) of `vision.lateral.line_directions.CORRIDOR_LINE`.
    quadrant
        Quadrant to search.
    corners
        Array (n,) of `CORNER`, zeros; filled with at most n candidates.

    Returns
    -------
    int
        Number of candidates.
    """
    count = 0
    taken = np.zeros(len(lines), np.bool_)
    while count < len(corners):
        longest = -1
        for i in range(len(lines)):
            free = lines[i].quadrant == quadrant and not taken[i]
            if free and (longest < 0 or lines[i].length > lines[longest].length):
                longest = i
        if longest < 0:
            break
        seed, corner = lines[longest], corners[count]
        total, covered = 0.0, 0
        for i in range(len(lines)):
            line = lines[i]
            if line.quadrant != quadrant:
                continue
            tolerance = 2.0 * sqrt(line.angle_std**2 + seed.angle_std**2 + MERGE_STD_RAD**2)
            if abs(line.angle - seed.angle) >= min(tolerance, MAX_MERGE_RAD):
                continue
            taken[i] = True
            weight = 1.0 / (line.angle_std**2 + ANGLE_FLOOR_RAD**2)
            total += weight
            corner.angle += weight * line.angle
            corner.polarity += line.length * line.polarity
            corner.contrast += line.length * line.contrast
            corner.length += line.length
            corner.farthest_depth = max(corner.farthest_depth, 1.0 / line.farthest)
            covered |= _depth_bins(line.nearest, line.farthest)
        corner.angle /= total
        corner.slope = tan(corner.angle)
        corner.angle_std = 1.0 / sqrt(total)
        corner.polarity /= corner.length
        corner.contrast /= corner.length
        corner.coverage = COVERAGE_PER_BIN * count_bits(covered)
        corner.line = seed.index
        count += 1
    return count


@compiled_inner
def _count_vertical_lines(corner: Record, quadrant: int, lines: RecordArray) -> None:
    """Sum the lengths of vertical lines on the corner's wall that end at it, and of those that cross it."""
    side, floor = quadrant % 2, quadrant < 2
    angle = corner.angle
    for i in range(len(lines)):
        line = lines[i]
        if line.side != side:
            continue
        if floor:
            end, start, std = line.lower_angle, line.upper_angle, line.lower_std
        else:
            end, start, std = -line.upper_angle, -line.lower_angle, line.upper_std
        if start > angle - std:
            continue
        if abs(end - angle) < std:
            corner.vertical_ends += line.length * (1.0 - ((end - angle) / std) ** 2)
        elif end > angle:
            corner.vertical_crossings += line.length


@compiled_inner
def _count_transverse_lines(corner: Record, quadrant: int, lines: RecordArray) -> None:
    """Mark the transverse lines that end at the corner, and sum the lengths of those that cross it."""
    side, floor = quadrant % 2, quadrant < 2
    angle = corner.angle
    for i in range(len(lines)):
        line = lines[i]
        depression = line.depression if floor else -line.depression
        outer, std = line.outer_angle[side], line.outer_std[side]
        if depression <= 0.0 or line.inner_angle[side] < angle + 2.0 * std:
            continue
        if abs(outer - angle) < std:
            corner.transverse_ends |= 1 << i
        elif outer < angle - 2.0 * std and depression > 1.1 * sin(angle) / corner.farthest_depth:
            corner.transverse_crossings += line.length


@compiled_inner
def gather_evidence(corners: RecordArray, quadrant: int, lines: SortedLines) -> None:
    """Sum for each candidate of a quadrant the lines that end at it, cross it or lie beyond it.

    Parameters
    ----------
    corners
        Array (k,) of `CORNER`, result of `group_by_angle`.
    quadrant
        Quadrant of these candidates.
    lines
        The picture's lines.
    """
    for k in range(len(corners)):
        corner = corners[k]
        _count_vertical_lines(corner, quadrant, lines.vertical)
        _count_transverse_lines(corner, quadrant, lines.transverse)
        for i in range(len(lines.corridor)):
            line = lines.corridor[i]
            if line.quadrant == quadrant and line.angle > corner.angle + BEYOND_RAD + 2.0 * line.angle_std:
                corner.beyond += line.length
        for j in range(len(corners)):
            ratio = corners[j].slope / corner.slope
            if MIN_SKIRTING < ratio < MAX_SKIRTING and corners[j].length > corner.skirting_length:
                corner.skirting_ratio, corner.skirting_length = ratio, corners[j].length


@compiled_inner
def find_corner_candidates(lines: SortedLines, max_corners: int) -> CornerCandidates:
    """Find the candidates for the four corners, at most ``max_corners`` in each quadrant."""
    corners = np.zeros((4, max_corners), CORNER)
    count = np.empty(4, np.int64)
    for q in range(4):
        count[q] = group_by_angle(lines.corridor, q, corners[q])
        gather_evidence(corners[q, : count[q]], q, lines)
    return CornerCandidates(corners, count)
