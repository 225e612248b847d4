"""Roll and pitch from the vertical lines of a picture, such as door posts and wall corners.

The attitude given with a frame is a prior whose standard deviation covers the filter's tilt error and the mounting
error; it may also be unknown. The plane of a vertical line contains the down vector. In the given level frame that is
(a, b, 1), where a and b are the tangents of the pitch and roll corrections, so a line with plane normal n has the
residual

    r = n_x a + n_y b + n_z.

An exhaustive vote, coarse then fine, maximises the sum of truncated parabolas ``max(0, 1 - r^2 / s^2)``, weighted by
the lines' lengths, plus the Gaussian log-prior of a and b, limited below. Gauss-Newton with Tukey's biweight refines
it; the scale shrinks to 3 sigma of each line. The lateral offset needs this accuracy: 0.5 degrees of roll move it by
1 % of the corridor's width. The heading improves too.

The corrected frame has z along (a, b, 1), and x below the body's x axis: the heading is that of the body. Were it
that of the given level frame, a roll error b of a body pitched by theta would turn it by ``sin(theta) sin(b)``. A
pitch error of the mount, not of the attitude, moves the body's x axis in the picture: it turns the heading by its
sine times the sine of the roll.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import atan, cos, nan, radians, sin, sqrt
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from vision.compiled import compiled, compiled_inner
from vision.lines.line_set import LineGeometry, LineSet, rotate_lines
from vision.types import FloatArray

COARSE_STEP_RAD = radians(2.0)
GRID_REACH_SIGMA = 2.5
MIN_REACH_RAD = radians(8.0)  # of the roll: the attitude's error may exceed its standard deviation
MAX_PENALTY = 24.0  # by the prior; equals the votes of four long lines
MAX_VOTE_ARC_RAD = 0.3  # longer lines get no more weight
VOTE_WEIGHT = 6.0
VERTICAL_COSINE = 0.7  # least component of a vertical line's direction along the given vertical
PLUMB_STD_RAD = radians(0.15)  # door posts are vertical to about this
CUT_SIGMA = 3.0
MIN_COS_ROLL = 0.5  # of a body whose pitch the picture's verticals show
MIN_LEVEL_FORWARD = 0.1  # horizontal part of the body's x axis, from which on it has a heading
MAX_ROLL_VARIANCE_SHARE = 0.8  # posterior over prior variance; with a larger one there is no roll correction


@dataclass(frozen=True, slots=True, eq=False)
class LevelFrame:
    """The level frame relative to the camera.

    Parameters
    ----------
    R_level_camera
        Rotation (3, 3) from the optical frame.
    roll_std_rad, pitch_std_rad
        Standard deviations of the remaining errors about the level frame's x and y axes.
    pitch_correction_rad
        Elevation of the picture's horizon above the given attitude's.
    roll_correction_rad, roll_correction_std_rad
        Correction of the given roll by the vertical lines alone, with the prior removed; NaN where they carry little
        information.
    """

    R_level_camera: FloatArray
    roll_std_rad: float
    pitch_std_rad: float
    pitch_correction_rad: float
    roll_correction_rad: float
    roll_correction_std_rad: float


@compiled_inner
def _vertical_std(down: float, along: float, sigma: float, arc: float) -> float:
    rotation = 3.4641 * sigma / arc
    return sqrt((sigma * down) ** 2 + (rotation * along) ** 2 + PLUMB_STD_RAD * PLUMB_STD_RAD)


class _Down(NamedTuple):
    """Down vector (a, b, 1) in the given level frame, and the information on it.

    Parameters
    ----------
    a, b
        Components along the given level frame's x and y.
    information_a, information_both, information_b
        Elements of their information matrix.
    given_roll_std
        Standard deviation of the roll's prior as used in the fit, radians.
    """

    a: float
    b: float
    information_a: float
    information_both: float
    information_b: float
    given_roll_std: float


@compiled_inner
def _search_down(lines: LineGeometry, pitch_std: float, roll_std: float) -> tuple[float, float]:
    """Find the down vector's a and b (see `_Down`) by exhaustive vote, first on a coarse grid, then on a fine one."""
    normal, direction, arc = lines.normal, lines.direction, lines.arc_rad
    upright = np.empty((len(arc), 4), np.float32)
    n = 0
    for k in range(len(arc)):
        if abs(direction[k, 2]) >= VERTICAL_COSINE:
            for i in range(3):
                upright[n, i] = normal[k, i]
            upright[n, 3] = VOTE_WEIGHT * min(arc[k], MAX_VOTE_ARC_RAD) / MAX_VOTE_ARC_RAD
            n += 1
    middle_a = middle_b = 0.0
    step = COARSE_STEP_RAD
    reach_a = int(np.ceil(GRID_REACH_SIGMA * pitch_std / step))
    reach_b = int(np.ceil(max(GRID_REACH_SIGMA * roll_std, MIN_REACH_RAD) / step))
    for _ in range(2):
        first_a, first_b = middle_a - reach_a * step, middle_b - reach_b * step
        scores = np.empty((2 * reach_a + 1, 2 * reach_b + 1), np.float32)
        for i in range(scores.shape[0]):
            for j in range(scores.shape[1]):
                a, b = first_a + i * step, first_b + j * step
                scores[i, j] = -min(0.5 * ((a / pitch_std) ** 2 + (b / roll_std) ** 2), MAX_PENALTY)
        _add_votes(upright[:n], np.float32(1.4 * step), first_a, first_b, step, scores)
        best = np.argmax(scores)
        middle_a = first_a + (best // scores.shape[1]) * step
        middle_b = first_b + (best % scores.shape[1]) * step
        step = 0.5 * COARSE_STEP_RAD
        reach_a = reach_b = 2
    return middle_a, middle_b


@compiled_inner
def _add_votes(
    upright: npt.NDArray[np.float32],
    spread: np.float32,
    first_a: float,
    first_b: float,
    step: float,
    scores: npt.NDArray[np.float32],
) -> None:
    """Add each line's parabola, truncated at zero, to a grid of down vectors; the inner loop is vectorised."""
    n_rows, n_columns = scores.shape
    inverse, one, zero = np.float32(1.0) / spread, np.float32(1.0), np.float32(0.0)
    a0, b0, step32 = np.float32(first_a), np.float32(first_b), np.float32(step)
    columns = np.arange(n_columns).astype(np.float32)  # converted here: int64 to float32 does not vectorise
    for k in range(len(upright)):
        nx, ny, weight = upright[k, 0] * inverse, upright[k, 1] * inverse, upright[k, 3]
        z0 = upright[k, 2] * inverse + nx * a0 + ny * b0
        along_a, along_b = nx * step32, ny * step32
        for i in range(n_rows):
            start = z0 + np.float32(i) * along_a
            row = scores[i]
            for j in range(n_columns):
                z = start + columns[j] * along_b
                row[j] += weight * max(zero, one - z * z)


@compiled
def _fit_down(
    in_camera: LineGeometry, R_level_camera: FloatArray, pitch_std: float, roll_std: float
) -> _Down:
    """Fit the down vector to the vertical lines; a and b have zero-mean Gaussian priors."""
    lines = rotate_lines(in_camera, R_level_camera)
    normal, centre, direction = lines.normal, lines.centre, lines.direction
    sigma, arc = lines.sigma_rad, lines.arc_rad
    n = len(sigma)
    a, b = _search_down(lines, pitch_std, roll_std)
    start = 0.5 * COARSE_STEP_RAD
    # Widen the prior where the vote contradicts it, so that it does not bias the fit.
    pitch_std, roll_std = max(pitch_std, abs(a) / CUT_SIGMA), max(roll_std, abs(b) / CUT_SIGMA)
    h00 = h01 = h11 = 0.0
    for iteration in range(8):
        h00, h11 = 1.0 / pitch_std**2, 1.0 / roll_std**2
        h01 = 0.0
        g0, g1 = a * h00, b * h11
        for k in range(n):
            if abs(direction[k, 2]) < VERTICAL_COSINE:
                continue
            nx = normal[k, 0]
            ny = normal[k, 1]
            down = centre[k, 0] * a + centre[k, 1] * b + centre[k, 2]
            along = direction[k, 0] * a + direction[k, 1] * b + direction[k, 2]
            line_std = _vertical_std(down, along, sigma[k], arc[k])
            cut = CUT_SIGMA * sqrt(line_std * line_std + (start * 0.5**iteration) ** 2)
            r = nx * a + ny * b + normal[k, 2]
            if abs(r) >= cut:
                continue
            w = (1.0 - (r / cut) ** 2) ** 2 / (line_std * line_std)
            h00 += w * nx * nx
            h01 += w * nx * ny
            h11 += w * ny * ny
            g0 += w * nx * r
            g1 += w * ny * r
        determinant = h00 * h11 - h01 * h01
        a -= (h11 * g0 - h01 * g1) / determinant
        b -= (h00 * g1 - h01 * g0) / determinant
    return _Down(a, b, h00, h01, h11, roll_std)


def _forward(R_level_body: FloatArray, mount_pitch_rad: float) -> tuple[float, float, float]:
    """Return the body's x axis (3,) in the given level frame.

    ``mount_pitch_rad`` is the part of the pitch correction in that frame that is an error of the mount.
    """
    cos_roll = float(R_level_body[1, 1])
    pitch = mount_pitch_rad / cos_roll if cos_roll > MIN_COS_ROLL else 0.0
    x, y, z = (cos(pitch) * R_level_body[:, 0] - sin(pitch) * R_level_body[:, 2]).tolist()
    return x, y, z


def _level_frame(a: float, b: float, forward: tuple[float, float, float]) -> FloatArray:
    """Return the rotation (3, 3) from a level frame to the one with z along (a, b, 1) and x along ``forward``."""
    size = sqrt(1.0 + a * a + b * b)
    dx, dy, dz = a / size, b / size, 1.0 / size
    x, y, z = forward
    along = x * dx + y * dy + z * dz
    x, y, z = x - along * dx, y - along * dy, z - along * dz
    level = sqrt(x * x + y * y + z * z)
    if level < MIN_LEVEL_FORWARD:
        return _level_frame(a, b, (1.0, 0.0, 0.0))
    x, y, z = x / level, y / level, z / level
    return np.array([[x, y, z], [dy * z - dz * y, dz * x - dx * z, dx * y - dy * x], [dx, dy, dz]])


def level_from_verticals(
    lines: LineSet,
    R_level_body: FloatArray,
    R_body_camera: FloatArray,
    pitch_std_rad: float,
    roll_std_rad: float,
    mount_share: float = 0.0,
) -> LevelFrame:
    """Correct a level frame by the picture's vertical lines.

    Parameters
    ----------
    lines
        Segments of the picture.
    R_level_body, R_body_camera
        Rotations (3, 3) from the body to level, by the attitude, and from the optical frame to the body.
    pitch_std_rad, roll_std_rad
        Standard deviations of their pitch and roll. They limit the roll error by a stripe on the floor below the
        camera, which looks vertical.
    mount_share
        Share of the pitch correction that is an error of the mount; the rest is one of the attitude.
    """
    R_level_camera = R_level_body @ R_body_camera
    down = _fit_down(lines.geometry(), R_level_camera, pitch_std_rad, roll_std_rad)
    a, b, h_pitch, h_both, h_roll, given_roll_std = down
    determinant = h_pitch * h_roll - h_both * h_both
    R_new_old = _level_frame(a, b, _forward(R_level_body, mount_share * atan(a)))
    roll_variance, given = h_pitch / determinant, given_roll_std * given_roll_std
    alone_rad = alone_variance = nan
    if roll_variance < MAX_ROLL_VARIANCE_SHARE * given:
        alone_variance = roll_variance * given / (given - roll_variance)
        alone_rad = atan(b * alone_variance / roll_variance)
    return LevelFrame(
        R_level_camera=R_new_old @ R_level_camera,
        roll_std_rad=sqrt(roll_variance),
        pitch_std_rad=sqrt(h_roll / determinant),
        pitch_correction_rad=atan(a),
        roll_correction_rad=alone_rad,
        roll_correction_std_rad=sqrt(alone_variance),
    )
