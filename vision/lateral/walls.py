"""Detection of a missing side wall: without a wall there is no corner, and the network's offset is wrong.

Between its two corners a side wall shows vertical edges, such as door posts. Where it is missing, as towards an open
hall, edges at right angles to the corridor are visible, which no side wall has. There the network is also less
certain of the corner's angle, its offsets by floor and by ceiling differ, it takes a farther wall for the near one,
or the offset is not confirmed by lines. These quantities (`MissingWallEvidence`) are weighted by logistic regression;
a wall counts as missing where the log-odds, the weighted sum, are positive.
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

CORNER_MARGIN_RAD = radians(3.0)  # about the axis: lines nearer to a corner are left out
ASIDE_COSINE = cos(radians(8.0))  # lines nearer to the axis are on the end wall
ARC_FLOOR_RAD = 0.1  # added to both lengths in the ratio of transverse to vertical lines
DISAGREEMENT_FLOOR, VERTICAL_FLOOR_RAD, MIN_LIKELIHOOD_RATIO = 0.05, 0.05, 0.1
USUAL_WIDTH_PER_HEIGHT = 2.718  # smaller widths are no evidence

TRANSVERSE, VERTICAL = int(LineClass.TRANSVERSE), int(LineClass.VERTICAL)


class MissingWallEvidence(NamedTuple):
    """Evidence that a side wall is missing, or the weights of the evidence in the log-odds.

    Parameters
    ----------
    bias
        One.
    certainty
        Sum of the network's certainty of the floor's and the ceiling's corner, on the less certain side.
    by_lines
        Logarithm of the likelihood of the estimated offset by lines alone, over the uniform density.
    transverse
        Logarithm of the length of transverse lines over the length of vertical lines, on the side where it is larger.
    vertical
        Logarithm of the length of vertical lines, on the side with fewer.
    disagreement
        Logarithm of the difference between the offsets by floor and by ceiling.
    width
        Logarithm of the corridor's width over the camera's height.
    """

    bias: float
    certainty: float
    by_lines: float
    transverse: float
    vertical: float
    disagreement: float
    width: float


# Fitted by ``python -m training.missing_wall``; fit again with every new network. In simulated corridors with two
# walls, 5 % of the estimates have positive log-odds and are lost.
WEIGHTS = MissingWallEvidence(
    bias=2.38,
    certainty=-1.94,
    by_lines=-0.8,
    transverse=2.01,
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
    """Compute the evidence that one of the side walls is missing.

    Parameters
    ----------
    lines, line_class
        The picture's n lines, optical frame, and their `vision.measurement.LineClass` (n,).
    R_corridor_camera
        Rotation (3, 3) from the optical frame to axes along the corridor, to its right, and down.
    scores
        The network's output for this picture.
    likelihood_ratio
        Likelihood of the estimated offset by lines alone, over the uniform density.
    """
    corners_rad, certainty = corners_from_level(scores.corner)
    transverse, vertical_rad = _transverse_and_vertical(lines, line_class, R_corridor_camera, corners_rad)
    # Distances of the walls over the camera's height above the floor, and below the ceiling.
    left, right, left_by_ceiling, right_by_ceiling = (1.0 / tan(angle) for angle in corners_rad.tolist())
    by_floor = (left - right) / (left + right)
    by_ceiling = (left_by_ceiling - right_by_ceiling) / (left_by_ceiling + right_by_ceiling)
    return MissingWallEvidence(
        bias=1.0,
        certainty=min(certainty[0] + certainty[2], certainty[1] + certainty[3]),
        by_lines=log(max(likelihood_ratio, MIN_LIKELIHOOD_RATIO)),
        transverse=log(transverse),
        vertical=log(vertical_rad + VERTICAL_FLOOR_RAD),
        disagreement=log(abs(by_floor - by_ceiling) + DISAGREEMENT_FLOOR),
        width=log(max(left + right, USUAL_WIDTH_PER_HEIGHT)),
    )


def wall_is_missing(evidence: MissingWallEvidence) -> bool:
    """Decide whether a side wall is missing: whether the log-odds are positive."""
    return sum(weight * value for weight, value in zip(WEIGHTS, evidence, strict=True)) > 0.0


@compiled
def _transverse_and_vertical(
    lines: LineGeometry, line_class: npt.NDArray[np.int8], R: FloatArray, corners_rad: FloatArray
) -> tuple[float, float]:
    """Compare transverse and vertical lines between each wall's corners; ``corners_rad`` (4,), `corners_from_level`.

    Returns
    -------
    tuple
        Larger of the two walls' ratios of transverse to vertical length, and smaller of their vertical lengths;
        lengths are subtended angles.
    """
    transverse, vertical = np.zeros(2), np.zeros(2)
    for i in range(len(line_class)):
        if line_class[i] != TRANSVERSE and line_class[i] != VERTICAL:
            continue
        a, b, c = lines.centre[i, 0], lines.centre[i, 1], lines.centre[i, 2]
        ahead = R[0, 0] * a + R[0, 1] * b + R[0, 2] * c
        right = R[1, 0] * a + R[1, 1] * b + R[1, 2] * c
        down = R[2, 0] * a + R[2, 1] * b + R[2, 2] * c
        side = 1 if right > 0.0 else 0
        angle = atan2(down, abs(right))
        lowest, highest = corners_rad[side] - CORNER_MARGIN_RAD, CORNER_MARGIN_RAD - corners_rad[2 + side]
        if ahead > ASIDE_COSINE * hypot(hypot(ahead, right), down) or not highest < angle < lowest:
            continue
        if line_class[i] == TRANSVERSE:
            transverse[side] += lines.arc_rad[i]
        else:
            vertical[side] += lines.arc_rad[i]
    ratio = (transverse + ARC_FLOOR_RAD) / (vertical + ARC_FLOOR_RAD)
    return ratio.max(), vertical.min()
