"""The corridor's cross-section: where its lines lie about the axis, and what speaks for a corner among them.

Seen along the axis, a line that runs along the corridor is a point of the cross-section, known by its angle about the
axis. Lines of one angle are gathered into a candidate for a corner of wall and floor, or wall and ceiling. What is
upright on a wall ends where the wall does: uprights that end at a candidate speak for it, uprights that cross it
against. What lies across, on the floor, the ceiling or the end wall ("rungs"), reaches from wall to wall.

Quadrants are numbered 0 floor left, 1 floor right, 2 ceiling left, 3 ceiling right; angles are measured from the
horizontal, down to the floor or up to the ceiling, so that all four look alike. "Reach" is the tangent of the angle
from the axis, the inverse of depth. Lengths are over the picture's diagonal.
"""

from __future__ import annotations

from math import atan2, cos, hypot, log, radians, sin, sqrt, tan

import numpy as np
import numpy.typing as npt

from vision.axis.vote import VERTICAL_SINE
from vision.compiled import compiled

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]

MIN_AHEAD = 0.05
MIN_ASIDE = 1e-4
ANGLE_FLOOR_RAD = radians(0.1)  # corners are rounded, boards have thickness
UPRIGHT = 0.7  # least downward component of an upright line's direction
RUNG_SINE = 0.026  # lines across are square to the corridor to about this
MAX_SIZE = 0.15  # no single upright or rung decides
END_PX, END_STD_RAD, MAX_END_RAD = 6.0, radians(3.0), radians(12.0)  # how well an upright's end is known
RUNG_PX, RUNG_STD_RAD, MAX_RUNG_RAD = 4.0, radians(1.0), radians(6.0)
MAX_RUNGS = 60  # one bit each
SAME_RUNG = 0.01  # of its depth
MAX_CORNERS = 12  # candidates in a quadrant
MERGE_STD_RAD, MAX_MERGE_RAD = radians(0.2), radians(2.0)
BEYOND_RAD = radians(1.5)
FIRST_REACH, REACH_STEP, REACH_STEPS = 0.03, 0.16, 32  # coverage counts steps of depth's logarithm
MIN_BOARD, MAX_BOARD = 0.84, 0.975  # a skirting board's top below the camera over its foot

# columns of walls
QUADRANT, ANGLE, STD, LENGTH, POLARITY, CONTRAST, NEAREST, FARTHEST, INDEX = range(9)
N_WALL = 9
# columns of uprights: angles of their lower and upper ends, positive downward
SIDE, FOOT, TOP, SIZE, FOOT_STD, TOP_STD = range(6)
N_UPRIGHT = 6
# columns of rungs: reach, ends to the left and right, then for each side the angle of the outer end, of the inner
# end and the tolerance of the outer
LEVEL, LEFT_END, RIGHT_END, RUNG_SIZE, PIXEL, OUTER, INNER, OUTER_STD = 0, 1, 2, 3, 4, 5, 7, 9
N_RUNG = 11
# columns of corners: ANGLE to NEAREST as of walls, and
SLOPE, COVERAGE, ENDING, CROSSING, BEYOND, CROSSED, BOARD, BOARD_LENGTH, LINE = 0, 7, 8, 9, 10, 11, 12, 13, 14
N_CORNER = 15


@compiled
def _end_std(y: float, z: float, angle: float, pixel: float) -> float:
    reach = hypot(y, z)
    return min(hypot(END_STD_RAD, END_PX * pixel * (1.0 + reach * reach) * cos(angle) / reach), MAX_END_RAD)


@compiled
def _describe_wall(
    n: FloatArray, c: FloatArray, a: FloatArray, b: FloatArray, sigma: float, row: FloatArray
) -> int:
    across = hypot(n[1], n[2])
    y, z = n[2] / across, -n[1] / across
    aside = c[1] * y + c[2] * z  # sine of the angle between the axis and the line's middle
    if aside < 0.0:
        y, z, aside = -y, -z, -aside
    if aside < MIN_ASIDE:
        return 0
    row[QUADRANT] = (0.0 if z > 0.0 else 2.0) + (0.0 if y < 0.0 else 1.0)
    row[ANGLE] = atan2(abs(z), abs(y))
    row[STD] = hypot(sigma / aside, ANGLE_FLOOR_RAD)
    row[POLARITY] = (
        1.0 if n[2] > 0.0 else -1.0
    )  # the normal points to the bright side: below the line, or above
    first, second = hypot(a[1], a[2]), hypot(b[1], b[2])
    row[NEAREST], row[FARTHEST] = max(first, second), min(first, second)
    return 1


@compiled
def _describe_upright(a: FloatArray, b: FloatArray, pixel: float, row: FloatArray) -> int:
    if a[1] * b[1] <= 0.0:
        return 0
    row[SIDE] = 0.0 if a[1] < 0.0 else 1.0
    first, second = atan2(a[2], abs(a[1])), atan2(b[2], abs(b[1]))
    first_std, second_std = _end_std(a[1], a[2], first, pixel), _end_std(b[1], b[2], second, pixel)
    row[FOOT], row[FOOT_STD], row[TOP], row[TOP_STD] = first, first_std, second, second_std
    if first < second:
        row[FOOT], row[FOOT_STD], row[TOP], row[TOP_STD] = second, second_std, first, first_std
    return 1


@compiled
def sort_lines(
    normal: FloatArray,
    centre: FloatArray,
    direction: FloatArray,
    arc: FloatArray,
    sigma: FloatArray,
    length: FloatArray,
    contrast: FloatArray,
    inlier: BoolArray,
    R: FloatArray,
    down: FloatArray,
    diagonal: float,
    walls: FloatArray,
    uprights: FloatArray,
    rungs: FloatArray,
) -> tuple[int, int, int]:
    """Sort the lines by what they can be; return how many run along, stand upright and lie across.

    R turns from the optical frame into axis, right and below; ``down`` is gravity (3,) in the optical frame.
    """
    n_walls = n_uprights = n_rungs = 0
    n, c, d, a, b = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for i in range(len(arc)):
        cosine, sine = cos(0.5 * arc[i]), sin(0.5 * arc[i])
        for k in range(3):
            n[k] = R[k, 0] * normal[i, 0] + R[k, 1] * normal[i, 1] + R[k, 2] * normal[i, 2]
            c[k] = R[k, 0] * centre[i, 0] + R[k, 1] * centre[i, 1] + R[k, 2] * centre[i, 2]
            d[k] = R[k, 0] * direction[i, 0] + R[k, 1] * direction[i, 1] + R[k, 2] * direction[i, 2]
            a[k] = cosine * c[k] - sine * d[k]
            b[k] = cosine * c[k] + sine * d[k]
        first, second = max(a[0], MIN_AHEAD), max(b[0], MIN_AHEAD)
        for k in range(1, 3):
            a[k] /= first
            b[k] /= second
        pixel = arc[i] / length[i]
        if inlier[i]:
            row = walls[n_walls]
            row[LENGTH], row[CONTRAST], row[INDEX] = length[i] / diagonal, contrast[i], i
            n_walls += _describe_wall(n, c, a, b, sigma[i], row)
        elif abs(down[0] * normal[i, 0] + down[1] * normal[i, 1] + down[2] * normal[i, 2]) < VERTICAL_SINE:
            if abs(d[2]) > UPRIGHT:
                uprights[n_uprights, SIZE] = min(length[i] / diagonal, MAX_SIZE)
                n_uprights += _describe_upright(a, b, pixel, uprights[n_uprights])
        elif abs(n[1]) < RUNG_SINE:
            row = rungs[n_rungs]
            row[LEVEL] = c[2] / max(c[0], MIN_AHEAD)
            row[LEFT_END], row[RIGHT_END] = min(a[1], b[1]), max(a[1], b[1])
            row[RUNG_SIZE], row[PIXEL] = min(length[i] / diagonal, MAX_SIZE), pixel
            n_rungs += 1
    return n_walls, n_uprights, n_rungs


@compiled
def join_rungs(rungs: FloatArray) -> int:
    """Join the pieces of each line across, in place; return how many lines there are."""
    n = len(rungs)
    count = 0
    taken = np.zeros(n, np.bool_)
    for i in range(n):
        if taken[i] or count >= MAX_RUNGS:
            continue
        level, left, right, pixel = rungs[i, LEVEL], rungs[i, LEFT_END], rungs[i, RIGHT_END], rungs[i, PIXEL]
        size = moment = 0.0
        for j in range(i, n):
            near = abs(rungs[j, LEVEL] - level) < RUNG_PX * pixel + SAME_RUNG * abs(level)
            if taken[j] or not near or rungs[j, LEVEL] * level <= 0.0:
                continue
            taken[j] = True
            size += rungs[j, RUNG_SIZE]
            moment += rungs[j, RUNG_SIZE] * rungs[j, LEVEL]
            left, right = min(left, rungs[j, LEFT_END]), max(right, rungs[j, RIGHT_END])
        row = rungs[count]
        count += 1
        row[LEVEL] = moment / size
        row[RUNG_SIZE] = min(size, MAX_SIZE)
        height = abs(row[LEVEL])
        for side in range(2):
            outer, inner = (-left, -right) if side == 0 else (right, left)
            row[OUTER + side] = atan2(height, outer)
            row[INNER + side] = atan2(height, inner)
            blur = RUNG_PX * pixel * sin(row[OUTER + side]) / max(hypot(height, outer), 1e-3)
            row[OUTER_STD + side] = min(hypot(RUNG_STD_RAD, blur), MAX_RUNG_RAD)
    return count


@compiled
def _steps(nearest: float, farthest: float) -> int:
    """Return the steps of depth a line covers, one bit each."""
    first = int(log(max(farthest, FIRST_REACH) / FIRST_REACH) / REACH_STEP)
    last = int(log(max(nearest, FIRST_REACH) / FIRST_REACH) / REACH_STEP)
    first, last = min(first, REACH_STEPS - 1), min(last, REACH_STEPS - 1)
    return (1 << (last + 1)) - (1 << first)


@compiled
def count_bits(bits: int) -> int:
    """Return how many bits are set."""
    count = 0
    while bits:
        bits &= bits - 1
        count += 1
    return count


@compiled
def gather_corners(walls: FloatArray, quadrant: int, corners: FloatArray) -> int:
    """Gather the lines of a quadrant by angle, longest first, into ``corners``; return how many there are."""
    count = 0
    taken = np.zeros(len(walls), np.bool_)
    while count < MAX_CORNERS:
        seed = -1
        for i in range(len(walls)):
            free = walls[i, QUADRANT] == quadrant and not taken[i]
            if free and (seed < 0 or walls[i, LENGTH] > walls[seed, LENGTH]):
                seed = i
        if seed < 0:
            break
        row = corners[count]
        row[:] = 0.0
        total, covered = 0.0, 0
        for i in range(len(walls)):
            if walls[i, QUADRANT] != quadrant:
                continue
            spread = 2.0 * sqrt(walls[i, STD] ** 2 + walls[seed, STD] ** 2 + MERGE_STD_RAD**2)
            if abs(walls[i, ANGLE] - walls[seed, ANGLE]) >= min(spread, MAX_MERGE_RAD):
                continue
            taken[i] = True
            weight = 1.0 / (walls[i, STD] ** 2 + ANGLE_FLOOR_RAD**2)
            total += weight
            row[ANGLE] += weight * walls[i, ANGLE]
            for k in range(POLARITY, CONTRAST + 1):
                row[k] += walls[i, LENGTH] * walls[i, k]
            row[LENGTH] += walls[i, LENGTH]
            row[NEAREST] = max(row[NEAREST], 1.0 / walls[i, FARTHEST])
            covered |= _steps(walls[i, NEAREST], walls[i, FARTHEST])
        row[ANGLE] /= total
        row[SLOPE] = tan(row[ANGLE])
        row[STD] = 1.0 / sqrt(total)
        row[POLARITY] /= row[LENGTH]
        row[CONTRAST] /= row[LENGTH]
        row[COVERAGE] = 0.1 * count_bits(covered)
        row[LINE] = walls[seed, INDEX]
        count += 1
    return count


@compiled
def weigh_corners(
    corners: FloatArray,
    quadrant: int,
    walls: FloatArray,
    uprights: FloatArray,
    rungs: FloatArray,
    touching: IntArray,
) -> None:
    """Count what ends at each candidate, crosses it and lies beyond it; ``touching`` are the rungs that end there."""
    side, floor = quadrant % 2, quadrant < 2
    for k in range(len(corners)):
        row = corners[k]
        angle = row[ANGLE]
        for i in range(len(uprights)):
            if uprights[i, SIDE] != side:
                continue
            if floor:
                end, start, std = uprights[i, FOOT], uprights[i, TOP], uprights[i, FOOT_STD]
            else:
                end, start, std = -uprights[i, TOP], -uprights[i, FOOT], uprights[i, TOP_STD]
            if start > angle - std:
                continue
            if abs(end - angle) < std:
                row[ENDING] += uprights[i, SIZE] * (1.0 - ((end - angle) / std) ** 2)
            elif end > angle:
                row[CROSSING] += uprights[i, SIZE]
        touching[k] = 0
        for i in range(len(rungs)):
            level = rungs[i, LEVEL] if floor else -rungs[i, LEVEL]
            outer, std = rungs[i, OUTER + side], rungs[i, OUTER_STD + side]
            if level <= 0.0 or rungs[i, INNER + side] < angle + 2.0 * std:
                continue
            if abs(outer - angle) < std:
                touching[k] |= 1 << i
            elif outer < angle - 2.0 * std and level > 1.1 * sin(angle) / row[NEAREST]:
                row[CROSSED] += rungs[i, RUNG_SIZE]
        for i in range(len(walls)):
            if walls[i, QUADRANT] == quadrant and walls[i, ANGLE] > angle + BEYOND_RAD + 2.0 * walls[i, STD]:
                row[BEYOND] += walls[i, LENGTH]
        for j in range(len(corners)):
            ratio = corners[j, SLOPE] / row[SLOPE]
            if MIN_BOARD < ratio < MAX_BOARD and corners[j, LENGTH] > row[BOARD_LENGTH]:
                row[BOARD], row[BOARD_LENGTH] = ratio, corners[j, LENGTH]


@compiled
def survey(
    normal: FloatArray,
    centre: FloatArray,
    direction: FloatArray,
    arc: FloatArray,
    sigma: FloatArray,
    length: FloatArray,
    contrast: FloatArray,
    inlier: BoolArray,
    R: FloatArray,
    down: FloatArray,
    diagonal: float,
) -> tuple[FloatArray, IntArray, IntArray]:
    """Find the candidates for the corners among a picture's lines; arguments as in `vision.lines.segments.LineSet`.

    Returns
    -------
    tuple
        Candidates (4, 12, 15) by quadrant, how many of each quadrant (4,), and the rungs that end at each (4, 12), a
        bit each.
    """
    n = len(arc)
    walls, uprights, rungs = (
        np.empty((n + 1, N_WALL)),
        np.empty((n + 1, N_UPRIGHT)),
        np.empty((n + 1, N_RUNG)),
    )
    n_walls, n_uprights, n_rungs = sort_lines(
        normal,
        centre,
        direction,
        arc,
        sigma,
        length,
        contrast,
        inlier,
        R,
        down,
        diagonal,
        walls,
        uprights,
        rungs,
    )
    walls, uprights = walls[:n_walls], uprights[:n_uprights]
    rungs = rungs[: join_rungs(rungs[:n_rungs])]
    corners = np.empty((4, MAX_CORNERS, N_CORNER))
    touching = np.empty((4, MAX_CORNERS), np.int64)
    found = np.empty(4, np.int64)
    for q in range(4):
        found[q] = gather_corners(walls, q, corners[q])
        weigh_corners(corners[q, : found[q]], q, walls, uprights, rungs, touching[q])
    return corners, found, touching
