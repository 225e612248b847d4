"""Lateral offset from the lines of the two walls, scale-free.

Seen along the corridor's axis, a line that runs along it is a point of the cross-section. A line on the
left wall at height z below the camera has the slope ``t = z / w_L`` below the horizontal, one at the same
height on the right wall ``z / w_R``; so the pair gives ``y / (W / 2) = (w_L - w_R) / (w_L + w_R) = (t_R -
t_L) / (t_R + t_L)`` whatever z is: floor corners, skirting boards, door tops and ceiling corners all say
the same. Which lines belong together is not known, so every left line votes with every right line of the
same sign and the same polarity (brighter above or below); false pairs scatter, true pairs agree. Pairs far
from a plausible ratio of width to height count less.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, hypot, isfinite, log, nan, radians, sqrt

import numpy as np
import numpy.typing as npt

from vision.axis_vote import VERTICAL_SINE
from vision.compiled import compiled
from vision.lines import LineSet
from vision.vanishing_point import AxisFit, axis_direction

FloatArray = npt.NDArray[np.float64]

MIN_SLOPE, MAX_SLOPE = 0.3, 6.0
MIN_SIDEWAYS = 0.15  # a line straight above or below the camera is on neither wall
SLOPE_SLACK = 0.012  # relative: corners are rounded, boards have thickness
TYPICAL_WIDTH_PER_HEIGHT = 1.6
WIDTH_PER_HEIGHT_SPREAD = 0.45  # of its logarithm
CEILING_WEIGHT = 0.5
N_BINS = 401
REACH = 2.5  # kernel half width in standard deviations
RIVAL_DISTANCE = 0.08
MAX_RIVAL = 0.6
MIN_SUPPORT_OF_DIAGONAL = 0.04
MIN_STD = 0.014
NO_CORNER_WEIGHT = 0.3
END_TOLERANCE = 0.05  # relative to the slope
MAX_UPRIGHT_OF_DIAGONAL = 0.15


@dataclass(frozen=True, slots=True, eq=False)
class LateralFit:
    """Where in the cross-section the camera is.

    Parameters
    ----------
    offset_norm, offset_norm_std
        Offset right of the centre line over half the width.
    width_per_height
        Corridor width over camera height above the floor; NaN where only the ceiling was seen.
    wall_lines
        Indices (k,) of the lines taken for the corners of wall and floor, wall and ceiling.
    """

    offset_norm: float
    offset_norm_std: float
    width_per_height: float
    wall_lines: npt.NDArray[np.intp]


@compiled
def _vote_pairs(left: FloatArray, right: FloatArray, votes: FloatArray, pairs: FloatArray) -> int:
    """Vote with all pairs of lines, rows of slope, slope std, length and polarity; return how many pairs.

    Rows of ``pairs``: offset, std, weight, left and right index, width over height (negative: above the
    camera).
    """
    votes[:] = 0.0
    count = 0
    step = 2.0 / (N_BINS - 1)
    for i in range(len(left)):
        for j in range(len(right)):
            tl = left[i, 0]
            tr = right[j, 0]
            if tl * tr <= 0.0 or left[i, 3] != right[j, 3]:
                continue
            below = tl > 0.0
            tl = abs(tl)
            tr = abs(tr)
            total = tl + tr
            offset = (tr - tl) / total
            std = 2.0 * hypot(tl * right[j, 1], tr * left[i, 1]) / (total * total)
            std = hypot(std, 0.004)
            width = 1.0 / tl + 1.0 / tr
            spread = WIDTH_PER_HEIGHT_SPREAD if below else 1.5 * WIDTH_PER_HEIGHT_SPREAD
            unusual = log(width / TYPICAL_WIDTH_PER_HEIGHT) / spread
            alike = left[i, 4] * right[j, 4] + NO_CORNER_WEIGHT * (1.0 - left[i, 4]) * (1.0 - right[j, 4])
            weight = alike * sqrt(left[i, 2] * right[j, 2]) * exp(-0.5 * unusual * unusual)
            if not below:
                weight *= CEILING_WEIGHT
            reach = REACH * std
            first = max(int(np.ceil((offset - reach + 1.0) / step)), 0)
            last = min(int(np.floor((offset + reach + 1.0) / step)), N_BINS - 1)
            for b in range(first, last + 1):
                z = (b * step - 1.0 - offset) / reach
                votes[b] += weight * (1.0 - z * z)
            if count < len(pairs):
                row = pairs[count]
                row[0] = offset
                row[1] = std
                row[2] = weight
                row[3] = i
                row[4] = j
                row[5] = width if below else -width
                count += 1
    return count


def fit_lateral(
    lines: LineSet,
    axis: AxisFit,
    R_level_camera: FloatArray,
    roll_std_rad: float,
    prior_offset_norm: float = nan,
    prior_offset_norm_std: float = nan,
) -> LateralFit | None:
    """Find the lateral offset; None where the walls do not tell.

    Parameters
    ----------
    lines, axis
        The segments and the corridor's axis among them.
    R_level_camera
        Rotation (3, 3) from the optical frame to the level frame.
    roll_std_rad
        Standard deviation of the level frame's roll: it tilts left against right.
    prior_offset_norm, prior_offset_norm_std
        A filter's prediction, to choose between hypotheses; NaN: none.
    """
    index, slope, std, polarity, on_left = _cross_section(lines, axis, R_level_camera)
    corner = _corner_likelihood(lines, axis, R_level_camera, slope, on_left)
    columns = np.column_stack([slope, std, lines.length_px[index], polarity, corner])
    left, right = columns[on_left], columns[~on_left]
    if not len(left) or not len(right):
        return None
    votes = np.empty(N_BINS)
    pairs = np.empty((len(left) * len(right), 6))
    pairs = pairs[: _vote_pairs(left, right, votes, pairs)]
    offsets = np.linspace(-1.0, 1.0, N_BINS)
    if isfinite(prior_offset_norm):
        z = (offsets - prior_offset_norm) / hypot(prior_offset_norm_std, 0.03)
        votes = votes * (0.1 + 0.9 * np.exp(-0.5 * z * z))  # the floor lets strong evidence win
    best = int(np.argmax(votes))
    rival = votes[np.abs(offsets - offsets[best]) > RIVAL_DISTANCE].max()
    diagonal = hypot(lines.width_px, lines.height_px)
    if votes[best] < MIN_SUPPORT_OF_DIAGONAL * diagonal or rival > MAX_RIVAL * votes[best]:
        return None
    return _refine(pairs, offsets[best], roll_std_rad, index[on_left], index[~on_left])


def _cross_section(
    lines: LineSet, axis: AxisFit, R_level_camera: FloatArray
) -> tuple[npt.NDArray[np.intp], FloatArray, FloatArray, FloatArray, npt.NDArray[np.bool_]]:
    """Pick the lines that can be on a wall: index, slope below the horizontal, its std, polarity, on the left."""
    ahead = axis_direction(axis.heading_rad, axis.elevation_rad)
    rightward = axis_direction(axis.heading_rad - 0.5 * np.pi, 0.0)
    down = np.cross(ahead, rightward)
    normal = lines.normal @ R_level_camera.T
    centre = lines.centre @ R_level_camera.T
    towards = np.cross(normal, ahead)  # in the line's plane, across the axis
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    aside = (centre * towards).sum(axis=1)  # sine of the angle between the axis and the line's middle
    towards *= np.sign(aside)[:, None]
    sideways = towards @ rightward
    slope = (towards @ down) / np.maximum(np.abs(sideways), 1e-9)
    usable = axis.inlier & (np.abs(sideways) > MIN_SIDEWAYS)
    usable &= (np.abs(slope) > MIN_SLOPE) & (np.abs(slope) < MAX_SLOPE)
    index = np.flatnonzero(usable)
    slope = slope[index]
    angle_std = np.hypot(lines.sigma_rad[index] / np.abs(aside[index]), radians(0.1))
    std = np.hypot(angle_std * (1.0 + slope**2), SLOPE_SLACK * np.abs(slope))
    # the line's normal points to its bright side: below the line or above it?
    polarity = np.sign(normal[index] @ down)
    return index, slope, std, polarity, sideways[index] < 0.0


def _corner_likelihood(
    lines: LineSet,
    axis: AxisFit,
    R_level_camera: FloatArray,
    slope: FloatArray,
    on_left: npt.NDArray[np.bool_],
) -> FloatArray:
    """Return how likely (k,) each line is the corner of its wall, by the door posts and wall edges near it.

    What is upright on a wall ends where the wall does: uprights that end at a line speak for a corner,
    uprights that cross it say that the wall goes on.
    """
    ahead = axis_direction(axis.heading_rad, axis.elevation_rad)
    rightward = axis_direction(axis.heading_rad - 0.5 * np.pi, 0.0)
    down = np.cross(ahead, rightward)
    normal = lines.normal @ R_level_camera.T
    upright = ~axis.inlier & (np.abs(normal[:, 2]) < VERTICAL_SINE)
    ends = []
    for sign in (-1.0, 1.0):
        angle = 0.5 * lines.arc_rad[upright, None]
        rays = np.cos(angle) * lines.centre[upright] + sign * np.sin(angle) * lines.direction[upright]
        rays = rays @ R_level_camera.T
        ends.append(np.column_stack([rays @ down, rays @ rightward]))
    slopes = np.column_stack([e[:, 0] / np.maximum(np.abs(e[:, 1]), 1e-6) for e in ends])
    top, foot = slopes.min(axis=1), slopes.max(axis=1)
    length = np.minimum(
        lines.length_px[upright], MAX_UPRIGHT_OF_DIAGONAL * hypot(lines.width_px, lines.height_px)
    )
    left_upright = ends[0][:, 1] < 0.0
    same_side = on_left[:, None] == left_upright[None, :]
    size = np.abs(slope)[:, None]
    end = np.where(slope[:, None] > 0.0, foot[None, :] - slope[:, None], slope[:, None] - top[None, :]) / size
    start = (
        np.where(slope[:, None] > 0.0, slope[:, None] - top[None, :], foot[None, :] - slope[:, None]) / size
    )
    ending = same_side & (np.abs(end) < END_TOLERANCE) & (start > END_TOLERANCE)
    crossing = same_side & (end > 2.0 * END_TOLERANCE) & (start > 2.0 * END_TOLERANCE)
    few = 0.03 * hypot(lines.width_px, lines.height_px)
    ends_there = (ending * length).sum(axis=1) + few
    return np.asarray(ends_there / (ends_there + (crossing * length).sum(axis=1) + few))


def _refine(
    pairs: FloatArray,
    offset: float,
    roll_std_rad: float,
    left_index: npt.NDArray[np.intp],
    right_index: npt.NDArray[np.intp],
) -> LateralFit | None:
    for _ in range(5):  # the vote's bins are coarse: settle between them
        z = (pairs[:, 0] - offset) / (REACH * pairs[:, 1])
        weight = pairs[:, 2] * np.maximum(1.0 - z * z, 0.0) ** 2 / pairs[:, 1] ** 2
        if not weight.sum() > 0.0:
            return None
        offset = float(weight @ pairs[:, 0] / weight.sum())
    pairs, weight = pairs[weight > 0.0], weight[weight > 0.0]
    scatter = float(weight @ (pairs[:, 0] - offset) ** 2 / weight.sum())
    # A roll error turns slopes of both walls the same way: (1 + t^2) / t on the offset, t about 2 / width.
    below = pairs[:, 5] > 0.0
    slope = 2.0 / float(weight @ np.abs(pairs[:, 5]) / weight.sum())
    cancel = abs(float(weight @ np.where(below, 1.0, -1.0)) / weight.sum())
    roll = roll_std_rad * (1.0 + slope * slope) / slope * cancel
    std = sqrt(scatter / max(1.0, 0.5 * len(pairs)) + roll * roll + MIN_STD**2)
    walls: list[int] = []
    width_per_height = nan
    for side in (1.0, -1.0):
        here = np.flatnonzero((side * pairs[:, 5] > 0.0) & (pairs[:, 2] > 0.4 * pairs[:, 2].max()))
        if len(here):
            # the corner is the pair farthest from the camera's height: the narrowest in units of it
            corner = pairs[here[np.argmin(np.abs(pairs[here, 5]))]]
            walls += [int(left_index[int(corner[3])]), int(right_index[int(corner[4])])]
            if side > 0.0:
                width_per_height = float(corner[5])
    return LateralFit(offset, std, width_per_height, np.array(walls, dtype=np.intp))
