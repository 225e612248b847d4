"""A picture's lines sorted by direction: along the corridor, vertical, or transverse.

Viewed along the corridor's axis, a line parallel to it is one point of the corridor's cross-section; one picture
gives its angle about the axis, ``atan2(|z|, |y|)``. Vertical lines on a wall end where the wall ends. Transverse
lines lie across the floor, the ceiling or the end wall and reach from wall to wall.

Coordinates are those of the axis frame: x along the corridor's axis, y right, z down; a ray (1, y, z) passes through
(y, z) in the plane at unit depth. Quadrants are numbered 0 floor left, 1 floor right, 2 ceiling left, 3 ceiling
right. Angles about the axis are measured from the horizontal, towards the floor in the lower quadrants and towards
the ceiling in the upper ones, so that all quadrants are treated alike. Sides are numbered 0 left, 1 right. Lengths
are over the picture's diagonal.
"""

from __future__ import annotations

from math import atan2, cos, hypot, radians, sin
from typing import NamedTuple

import numpy as np

from vision.axis.vote import VERTICAL_SINE
from vision.compiled import compiled_inner
from vision.types import BoolArray, FloatArray, Record, RecordArray

MIN_DEPTH = 0.05  # cosine of the angle from the axis; rays farther off are clipped to it
MIN_AXIS_SINE = 1e-4  # a line whose middle is this close to the axis has no defined angle about it
ANGLE_FLOOR_RAD = radians(0.1)  # corners are rounded, skirting boards have thickness
VERTICAL_COSINE = 0.7  # least downward component of a vertical line's direction
TRANSVERSE_SINE = 0.026  # transverse lines are at right angles to the corridor to about this
MAX_LENGTH = 0.15  # limits the influence of a single vertical or transverse line
# Uncertainty of a vertical line's end, and of a transverse line's
END_PX, END_STD_RAD, MAX_END_STD_RAD = 6.0, radians(3.0), radians(12.0)
TRANSVERSE_END_PX, TRANSVERSE_STD_RAD, MAX_TRANSVERSE_STD_RAD = 4.0, radians(1.0), radians(6.0)
MAX_TRANSVERSE = 60  # they are bits of an int64
SAME_TRANSVERSE = 0.01  # relative difference in the tangent of depression within which pieces are merged

CORRIDOR_LINE = np.dtype(
    [
        ("quadrant", np.int64),
        ("angle", np.float64),  # about the axis, radians from the horizontal
        ("angle_std", np.float64),
        ("length", np.float64),
        ("polarity", np.float64),  # 1: bright below the line, -1: bright above it
        ("contrast", np.float64),
        ("nearest", np.float64),  # tangent of the angle from the axis to the near end: inverse of its depth
        ("farthest", np.float64),  # the same for the far end
        ("index", np.int64),  # of the line in its `LineSet`
    ],
    align=True,
)
"""A line parallel to the corridor's axis."""

VERTICAL_LINE = np.dtype(
    [
        ("side", np.int64),
        ("lower_angle", np.float64),  # of the lower end about the axis, radians below the horizontal
        ("lower_std", np.float64),
        ("upper_angle", np.float64),  # of the upper end, also radians below the horizontal
        ("upper_std", np.float64),
        ("length", np.float64),  # at most MAX_LENGTH
    ],
    align=True,
)
"""A vertical line, on the wall of one side."""

TRANSVERSE_LINE = np.dtype(
    [
        ("depression", np.float64),  # z at unit depth: tangent of the angle below the axis
        ("left_end", np.float64),  # y at unit depth
        ("right_end", np.float64),
        ("length", np.float64),  # at most MAX_LENGTH
        ("pixel_rad", np.float64),  # angle of a pixel
        ("outer_angle", np.float64, (2,)),  # of the end towards each side, about the axis, radians
        ("inner_angle", np.float64, (2,)),  # of the other end, as seen from that side
        ("outer_std", np.float64, (2,)),
    ],
    align=True,
)
"""A line across the corridor; `merge_transverse_lines` joins its pieces and fills in the angles."""


class PictureLines(NamedTuple):
    """A picture's n lines as arrays for compiled code; fields as in `vision.lines.line_set.LineSet`."""

    normal: FloatArray  # (n, 3), optical frame, as the next two
    centre: FloatArray
    direction: FloatArray
    sigma_rad: FloatArray  # (n,)
    arc_rad: FloatArray
    length_px: FloatArray
    contrast: FloatArray
    along_corridor: BoolArray


class SortedLines(NamedTuple):
    """A picture's lines by direction, in the axis frame.

    Parameters
    ----------
    corridor, vertical, transverse
        Arrays of `CORRIDOR_LINE`, `VERTICAL_LINE` and `TRANSVERSE_LINE`.
    """

    corridor: RecordArray
    vertical: RecordArray
    transverse: RecordArray


@compiled_inner
def _end_std(y: float, z: float, angle: float, pixel_rad: float) -> float:
    """Return the standard deviation (rad) of a vertical line's end at (y, z) of the plane at unit depth."""
    radius = hypot(y, z)
    blur = END_PX * pixel_rad * (1.0 + radius * radius) * cos(angle) / radius
    return min(hypot(END_STD_RAD, blur), MAX_END_STD_RAD)


@compiled_inner
def _fill_corridor_line(
    row: Record, normal: FloatArray, centre: FloatArray, a: FloatArray, b: FloatArray, sigma_rad: float
) -> bool:
    """Compute a line's angle about the axis from its normal, centre and ends; False where it passes the axis."""
    across = hypot(normal[1], normal[2])
    y, z = normal[2] / across, -normal[1] / across
    sine = centre[1] * y + centre[2] * z  # of the angle between the axis and the line's middle
    if sine < 0.0:
        y, z, sine = -y, -z, -sine
    if sine < MIN_AXIS_SINE:
        return False
    row.quadrant = (0 if z > 0.0 else 2) + (0 if y < 0.0 else 1)
    row.angle = atan2(abs(z), abs(y))
    row.angle_std = hypot(sigma_rad / sine, ANGLE_FLOOR_RAD)
    row.polarity = 1.0 if normal[2] > 0.0 else -1.0  # the normal points to the bright side
    first, second = hypot(a[1], a[2]), hypot(b[1], b[2])
    row.nearest, row.farthest = max(first, second), min(first, second)
    return True


@compiled_inner
def _fill_vertical_line(row: Record, a: FloatArray, b: FloatArray, pixel_rad: float) -> bool:
    """Compute the side and end angles of a vertical line; False where its ends are on different sides."""
    if a[1] * b[1] <= 0.0:
        return False
    row.side = 0 if a[1] < 0.0 else 1
    first, second = atan2(a[2], abs(a[1])), atan2(b[2], abs(b[1]))
    first_std, second_std = _end_std(a[1], a[2], first, pixel_rad), _end_std(b[1], b[2], second, pixel_rad)
    if first < second:
        first, first_std, second, second_std = second, second_std, first, first_std
    row.lower_angle, row.lower_std = first, first_std
    row.upper_angle, row.upper_std = second, second_std
    return True


@compiled_inner
def sort_by_direction(
    lines: PictureLines, R_axis_camera: FloatArray, down: FloatArray, diagonal_px: float
) -> SortedLines:
    """Sort the lines of a picture by direction and describe each in the axis frame.

    Parameters
    ----------
    lines
        The picture's lines.
    R_axis_camera
        Rotation (3, 3) from the optical frame to the axis frame.
    down
        Direction of gravity (3,) in the optical frame.
    diagonal_px
        Diagonal of the picture.

    Returns
    -------
    SortedLines
        Lines in none of the three directions are left out.
    """
    count = len(lines.arc_rad)
    corridor = np.empty(count + 1, CORRIDOR_LINE)
    vertical = np.empty(count + 1, VERTICAL_LINE)
    transverse = np.empty(count + 1, TRANSVERSE_LINE)
    n_corridor = n_vertical = n_transverse = 0
    n, c, d, a, b = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    R, normal, centre, direction = R_axis_camera, lines.normal, lines.centre, lines.direction
    for i in range(count):
        cosine, sine = cos(0.5 * lines.arc_rad[i]), sin(0.5 * lines.arc_rad[i])
        for k in range(3):
            n[k] = R[k, 0] * normal[i, 0] + R[k, 1] * normal[i, 1] + R[k, 2] * normal[i, 2]
            c[k] = R[k, 0] * centre[i, 0] + R[k, 1] * centre[i, 1] + R[k, 2] * centre[i, 2]
            d[k] = R[k, 0] * direction[i, 0] + R[k, 1] * direction[i, 1] + R[k, 2] * direction[i, 2]
            a[k] = cosine * c[k] - sine * d[k]
            b[k] = cosine * c[k] + sine * d[k]
        first, second = max(a[0], MIN_DEPTH), max(b[0], MIN_DEPTH)
        for k in range(1, 3):
            a[k] /= first
            b[k] /= second
        pixel_rad = lines.arc_rad[i] / lines.length_px[i]
        length = lines.length_px[i] / diagonal_px
        if lines.along_corridor[i]:
            line = corridor[n_corridor]
            line.length, line.contrast, line.index = length, lines.contrast[i], i
            n_corridor += _fill_corridor_line(line, n, c, a, b, lines.sigma_rad[i])
        elif abs(down[0] * normal[i, 0] + down[1] * normal[i, 1] + down[2] * normal[i, 2]) < VERTICAL_SINE:
            if abs(d[2]) > VERTICAL_COSINE:
                line = vertical[n_vertical]
                line.length = min(length, MAX_LENGTH)
                n_vertical += _fill_vertical_line(line, a, b, pixel_rad)
        elif abs(n[1]) < TRANSVERSE_SINE:
            line = transverse[n_transverse]
            line.depression = c[2] / max(c[0], MIN_DEPTH)
            line.left_end, line.right_end = min(a[1], b[1]), max(a[1], b[1])
            line.length, line.pixel_rad = min(length, MAX_LENGTH), pixel_rad
            n_transverse += 1
    n_transverse = merge_transverse_lines(transverse[:n_transverse])
    return SortedLines(corridor[:n_corridor], vertical[:n_vertical], transverse[:n_transverse])


@compiled_inner
def merge_transverse_lines(lines: RecordArray) -> int:
    """Merge the pieces of each `TRANSVERSE_LINE` in place; return the number of lines, at most `MAX_TRANSVERSE`."""
    count = 0
    taken = np.zeros(len(lines), np.bool_)
    for i in range(len(lines)):
        if taken[i] or count >= MAX_TRANSVERSE:
            continue
        first = lines[i]
        depression, left, right, pixel_rad = (
            first.depression,
            first.left_end,
            first.right_end,
            first.pixel_rad,
        )
        length = moment = 0.0
        for j in range(i, len(lines)):
            piece = lines[j]
            tolerance = TRANSVERSE_END_PX * pixel_rad + SAME_TRANSVERSE * abs(depression)
            near = abs(piece.depression - depression) < tolerance
            if taken[j] or not near or piece.depression * depression <= 0.0:
                continue
            taken[j] = True
            length += piece.length
            moment += piece.length * piece.depression
            left, right = min(left, piece.left_end), max(right, piece.right_end)
        merged = lines[count]
        count += 1
        merged.depression = moment / length
        merged.length = min(length, MAX_LENGTH)
        height = abs(merged.depression)
        for side in range(2):
            outer, inner = (-left, -right) if side == 0 else (right, left)
            angle = atan2(height, outer)
            merged.outer_angle[side] = angle
            merged.inner_angle[side] = atan2(height, inner)
            blur = TRANSVERSE_END_PX * pixel_rad * sin(angle) / max(hypot(height, outer), 1e-3)
            merged.outer_std[side] = min(hypot(TRANSVERSE_STD_RAD, blur), MAX_TRANSVERSE_STD_RAD)
    return count
