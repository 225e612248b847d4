"""Acceptance of a frame's heading, its standard deviation, and the class of each line.

The heading is accepted (`Reason.OK`) where all of these hold: enough inliers and a high enough score; not too much
motion blur; the score exceeds the rival's, in difference and in ratio, or a prediction decides between the two; the
inliers have a minimum share of the lines' length; heading sigma and elevation are small enough. Without a prediction
the view must not be across the corridor, see `assess_heading`.
"""

from __future__ import annotations

from math import atan2, copysign, cos, hypot, isfinite, log, pi, radians, sin, sqrt
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from vision.axis.level import LevelFrame
from vision.axis.peaks import PRIOR_FLOOR_STD_RAD, PRIOR_OUTLIER_SHARE
from vision.axis.vanishing_point import AxisFit
from vision.axis.vote import VERTICAL_SINE
from vision.cameras.camera import Camera
from vision.compiled import compiled
from vision.lines.line_set import LineSet
from vision.measurement import LineClass, Prior, Reason
from vision.rotations import wrap_axis
from vision.types import BoolArray, FloatArray

MIN_LINES = 4
MIN_SCORE = 8.0  # log-likelihood ratio against random lines
MIN_MARGIN = 6.5  # log-likelihood ratio against the second-best heading, by distinct edges
MAX_RIVAL = 0.80  # score of the second-best heading over the best
DECISION_SIGMA = 3.0  # a prediction decides where it is this near to one direction and not to the other
MIN_DECIDED = 0.9  # score of the predicted direction over the other's
MIN_SHARE = 0.07  # of the length of all lines that are not vertical
ASIDE_RAD = radians(16.0)
# Length of transverse lines aside of the axis over that of corridor lines. Along corridors 1 % of the views have more
# than 1.1; in front of side walls: 1.9.
MAX_ACROSS = 1.5
MAX_STD_RAD = radians(1.5)
MAX_ELEVATION_RAD = radians(5.5)  # ramps are at most 1:12 steep
MAX_ELEVATION_SIGMA = 2.5
MAX_BLUR_PX = 20.0
CALIBRATION_STD_RAD = radians(0.03)  # error by focal length and principal point, constant over frames
TRANSVERSE_SINE = sin(radians(1.5))
REJECTED, CORRIDOR, TRANSVERSE, VERTICAL = (int(kind) for kind in LineClass)


class HeadingAssessment(NamedTuple):
    """Decision on the heading, and its uncertainty; fields as in `FrameMeasurement`."""

    reason: Reason
    n_inliers: int
    heading_std_rad: float
    second_heading_rad: float
    second_score: float
    line_class: npt.NDArray[np.int8]


def assess_heading(
    fit: AxisFit, lines: LineSet, camera: Camera, level: LevelFrame, prior: Prior, elevation_std_rad: float
) -> HeadingAssessment:
    """Classify the lines, and decide whether the heading may be used.

    Parameters
    ----------
    fit, lines
        The axis and the lines that it was fitted to.
    camera
        The camera.
    level
        Level frame of the axis.
    prior
        A filter's prediction; it decides between directions that explain the lines about equally well.
    elevation_std_rad
        Prior standard deviation of the axis's elevation.
    """
    line_class, across_px, along_px = _classify(
        lines.normal, lines.centre, lines.length_px, level.R_level_camera, fit.heading_rad, fit.inlier
    )
    found = HeadingAssessment(
        reason=Reason.OK,
        n_inliers=int(np.count_nonzero(fit.inlier)),
        heading_std_rad=sqrt(fit.covariance[0, 0] + CALIBRATION_STD_RAD**2 + fit.split_variance),
        second_heading_rad=fit.second_heading_rad,
        second_score=max(fit.second_score, 0.0) / fit.score,
        line_class=line_class,
    )
    reason = _reason(found, fit, camera, prior, elevation_std_rad)
    # In a view along a corridor, transverse lines are ahead, between the walls. In front of a side wall, the wall's
    # lines span the view and look transverse, and objects sticking out of it are taken for the corridor. Only a
    # prediction can distinguish the two.
    if reason is Reason.OK and not isfinite(prior.heading_rad) and across_px > MAX_ACROSS * along_px:
        square_rad = fit.heading_rad - copysign(0.5 * pi, fit.heading_rad)
        return found._replace(reason=Reason.AMBIGUOUS, second_heading_rad=square_rad, second_score=1.0)
    return found._replace(reason=reason)


def _reason(
    found: HeadingAssessment, fit: AxisFit, camera: Camera, prior: Prior, elevation_std_rad: float
) -> Reason:
    """Return why the heading is rejected, or `Reason.OK`; the limits exclude gross errors in degraded pictures."""
    if found.n_inliers < MIN_LINES or fit.score < MIN_SCORE:
        return Reason.TOO_FEW_LINES
    blur_px = prior.body_rate_rad_s * camera.exposure_s * camera.fx_px
    if isfinite(blur_px) and blur_px > MAX_BLUR_PX:
        return Reason.BLUR
    distinct = min(fit.n_distinct / found.n_inliers * fit.score_of_all / fit.score, 1.0)
    is_tie = distinct * (fit.score - fit.second_score) < MIN_MARGIN or found.second_score > MAX_RIVAL
    if is_tie and not _prediction_decides(fit, prior):
        return Reason.AMBIGUOUS
    if fit.inlier_share < MIN_SHARE:
        return Reason.AMBIGUOUS
    if not found.heading_std_rad < MAX_STD_RAD or abs(fit.heading_rad) > 0.5 * pi:
        return Reason.UNCERTAIN
    if abs(fit.elevation_rad) > max(MAX_ELEVATION_RAD, MAX_ELEVATION_SIGMA * elevation_std_rad):
        return Reason.UNCERTAIN
    return Reason.OK


def _prediction_decides(fit: AxisFit, prior: Prior) -> bool:
    """Whether a prediction selects this direction, where the second one explains the lines about equally well.

    A filter may track the transverse direction by mistake. So a picture that favours the other direction by more than
    a tenth of the score is not overruled.
    """
    if not isfinite(prior.heading_rad):
        return False
    reach_rad = DECISION_SIGMA * hypot(prior.heading_std_rad, PRIOR_FLOOR_STD_RAD)
    own, other = (abs(wrap_axis(h - prior.heading_rad)) for h in (fit.heading_rad, fit.second_heading_rad))
    without_prior = fit.second_score - log(PRIOR_OUTLIER_SHARE)
    return own < reach_rad < other and fit.score > MIN_DECIDED * without_prior


@compiled
def _classify(
    normal: FloatArray,
    centre: FloatArray,
    length: FloatArray,
    R: FloatArray,
    heading: float,
    inlier: BoolArray,
) -> tuple[npt.NDArray[np.int8], float, float]:
    """Return each line's `LineClass` (n,), the length of transverse lines aside of the axis, and of corridor lines.

    ``R`` is the rotation (3, 3) from the lines' frame to the level frame.
    """
    line_class = np.empty(len(length), np.int8)
    across = along = 0.0
    cp, sp = cos(heading), sin(heading)
    for i in range(len(length)):
        x = R[0, 0] * normal[i, 0] + R[0, 1] * normal[i, 1] + R[0, 2] * normal[i, 2]
        y = R[1, 0] * normal[i, 0] + R[1, 1] * normal[i, 1] + R[1, 2] * normal[i, 2]
        z = R[2, 0] * normal[i, 0] + R[2, 1] * normal[i, 1] + R[2, 2] * normal[i, 2]
        if inlier[i]:
            line_class[i] = CORRIDOR
            along += length[i]
        elif abs(z) < VERTICAL_SINE:
            line_class[i] = VERTICAL
        elif abs(x * sp + y * cp) < TRANSVERSE_SINE:
            line_class[i] = TRANSVERSE
            ahead = R[0, 0] * centre[i, 0] + R[0, 1] * centre[i, 1] + R[0, 2] * centre[i, 2]
            right = R[1, 0] * centre[i, 0] + R[1, 1] * centre[i, 1] + R[1, 2] * centre[i, 2]
            if abs(atan2(right, ahead) + heading) > ASIDE_RAD:
                across += length[i]
        else:
            line_class[i] = REJECTED
    return line_class, across, along
