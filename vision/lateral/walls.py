"""Checks that a picture shows a wall on either side: without a wall there is no corner, whatever the network reports.

Between its two corners a wall has door posts, which are vertical. Where it is missing, as towards an open hall, one
sees edges square to the corridor, which no side wall has. Besides, the network spreads a corner that it only guesses
over many angles, guesses another offset by the ceiling than by the floor, or takes a far wall for the near one, and
lines seldom confirm it.
"""

from __future__ import annotations

from math import atan2, cos, hypot, log, radians, tan
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from vision.compiled import compiled
from vision.lateral.learned import CornerScores, corners_from_level
from vision.lines.line_set import LineGeometry
from vision.measurement import LineClass
from vision.types import FloatArray

OFF_CORNER_RAD = radians(3.0)  # about the axis
ASIDE_COSINE = cos(radians(8.0))  # nearer to the axis is the end of the corridor
FEW_RAD = 0.1  # a line shorter than this tells little
LEAST_DISAGREEMENT, LEAST_VERTICAL_RAD, LEAST_RATIO = 0.05, 0.05, 0.1
USUAL_WIDTH_PER_HEIGHT = 2.718  # up to here it shows nothing

TRANSVERSE, VERTICAL = int(LineClass.TRANSVERSE), int(LineClass.VERTICAL)


class MissingWallEvidence(NamedTuple):
    """What tells that a side wall is missing; or the weight of each, in a sum that is the log-odds.

    Parameters
    ----------
    bias
        One.
    sureness
        Probability of the corners of floor and ceiling, on the side where they are less sure.
    by_lines
        Logarithm of the answer's likelihood by lines alone, over that of any other offset.
    across
        Logarithm of the length of lines square to the corridor over that of vertical ones.
    vertical
        Logarithm of the length of vertical lines, on the side where there are fewer.
    disagreement
        Logarithm of the distance between the offsets by floor and by ceiling.
    width
        Logarithm of the width over the camera's height.
    """

    bias: float
    sureness: float
    by_lines: float
    across: float
    vertical: float
    disagreement: float
    width: float


# By ``python -m training.missing_wall``, which is to be run again with every network: of the answers in simulated
# corridors with two walls, 5 % have positive log-odds.
WEIGHTS = MissingWallEvidence(
    bias=2.38,
    sureness=-1.94,
    by_lines=-0.8,
    across=2.01,
    vertical=0.81,
    disagreement=0.35,
    width=2.52,
)


def missing_wall_evidence(
    lines: LineGeometry,
    line_class: npt.NDArray[np.int8],
    R_corridor_camera: FloatArray,
    scores: CornerScores,
    likelihood_ratio: float,
) -> MissingWallEvidence:
    """Collect what tells whether one of the side walls is missing.

    Parameters
    ----------
    lines, line_class
        The picture's n lines, optical frame, and their `vision.measurement.LineClass` (n,).
    R_corridor_camera
        Rotation (3, 3) from the optical frame to axes along the corridor, to its right, and down.
    scores
        What the network says about the corners.
    likelihood_ratio
        Likelihood of the offset to answer, by lines alone, over that of any other.
    """
    corners_rad, sure = corners_from_level(scores.corner)
    across, vertical_rad = _across_and_vertical(lines, line_class, R_corridor_camera, corners_rad)
    # Distances of the walls over the camera's height above the floor, and below the ceiling.
    left, right, left_by_ceiling, right_by_ceiling = (1.0 / tan(angle) for angle in corners_rad.tolist())
    by_floor = (left - right) / (left + right)
    by_ceiling = (left_by_ceiling - right_by_ceiling) / (left_by_ceiling + right_by_ceiling)
    return MissingWallEvidence(
        bias=1.0,
        sureness=min(sure[0] + sure[2], sure[1] + sure[3]),
        by_lines=log(max(likelihood_ratio, LEAST_RATIO)),
        across=log(across),
        vertical=log(vertical_rad + LEAST_VERTICAL_RAD),
        disagreement=log(abs(by_floor - by_ceiling) + LEAST_DISAGREEMENT),
        width=log(max(left + right, USUAL_WIDTH_PER_HEIGHT)),
    )


def wall_is_missing(evidence: MissingWallEvidence) -> bool:
    """Tell whether one of the side walls is likelier to be missing than an answer can bear."""
    return sum(weight * found for weight, found in zip(WEIGHTS, evidence, strict=True)) > 0.0


@compiled
def _across_and_vertical(
    lines: LineGeometry, line_class: npt.NDArray[np.int8], R: FloatArray, corners_rad: FloatArray
) -> tuple[float, float]:
    """Compare lines between a wall's corners; ``corners_rad`` (4,) as by `corners_from_level`.

    Returns
    -------
    tuple
        The length of lines square to the corridor over that of vertical ones, where it is larger, and the length of
        vertical lines where it is less, as angles that they subtend.
    """
    across, vertical = np.zeros(2), np.zeros(2)
    for i in range(len(line_class)):
        if line_class[i] != TRANSVERSE and line_class[i] != VERTICAL:
            continue
        a, b, c = lines.centre[i, 0], lines.centre[i, 1], lines.centre[i, 2]
        ahead = R[0, 0] * a + R[0, 1] * b + R[0, 2] * c
        right = R[1, 0] * a + R[1, 1] * b + R[1, 2] * c
        down = R[2, 0] * a + R[2, 1] * b + R[2, 2] * c
        side = 1 if right > 0.0 else 0
        angle = atan2(down, abs(right))
        lowest, highest = corners_rad[side] - OFF_CORNER_RAD, OFF_CORNER_RAD - corners_rad[2 + side]
        if ahead > ASIDE_COSINE * hypot(hypot(ahead, right), down) or not highest < angle < lowest:
            continue
        if line_class[i] == TRANSVERSE:
            across[side] += lines.arc_rad[i]
        else:
            vertical[side] += lines.arc_rad[i]
    ratio = (across + FEW_RAD) / (vertical + FEW_RAD)
    return ratio.max(), vertical.min()
