"""Decides whether a frame's heading may be used, with its sigma and the class of each line."""

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
MIN_SCORE = 8.0  # log-likelihood over chance
MIN_MARGIN = 6.5  # log-likelihood over the second-best heading, by lines that are not pieces of one edge
MAX_RIVAL = 0.80  # score of the second-best heading over the best
CHOOSING_SIGMA = 3.0  # of a prediction: it is near one direction and not near the other
MIN_CHOSEN = 0.9  # score of the direction that a prediction chooses over the other's
MIN_SHARE = 0.07  # of the length of all lines that are not vertical
ASIDE_RAD = radians(16.0)
# Of the corridor lines' length: views along corridors: 1 % have more than 1.1; walls before the camera: 1.9.
MAX_ACROSS = 1.5
MAX_STD_RAD = radians(1.5)
MAX_ELEVATION_RAD = radians(5.5)  # ramps are at most 1:12 steep: an axis that rises more was none
MAX_ELEVATION_SIGMA = 2.5
MAX_BLUR_PX = 20.0
CALIBRATION_STD_RAD = radians(0.03)  # what focal length and principal point leave, the same in every frame
TRANSVERSE_SINE = sin(radians(1.5))
REJECTED, CORRIDOR, TRANSVERSE, VERTICAL = (int(kind) for kind in LineClass)


class HeadingAssessment(NamedTuple):
    """What is said of the heading; fields as in `FrameMeasurement`."""

    reason: Reason
    n_inliers: int
    heading_std_rad: float
    second_heading_rad: float
    second_score: float
    line_class: npt.NDArray[np.int8]


def assess_heading(
    fit: AxisFit, lines: LineSet, camera: Camera, level: LevelFrame, prior: Prior, elevation_std_rad: float
) -> HeadingAssessment:
    """Say which lines are which, and whether the heading may be used.

    Parameters
    ----------
    fit, lines
        The axis and the lines, as many, that it was fitted to.
    camera
        What took the picture.
    level
        The level frame that the axis is given in.
    prior
        What a filter predicts; decides between directions that explain the lines about as well.
    elevation_std_rad
        What was known of the axis's elevation.
    """
    line_class, across_px, along_px = _classify(
        lines.normal, lines.centre, lines.length_px, level.R_level_camera, fit.heading_rad, fit.inlier
    )
    found = HeadingAssessment(
        reason=Reason.OK,
        n_inliers=int(np.count_nonzero(fit.inlier)),
        heading_std_rad=hypot(sqrt(fit.covariance[0, 0]), CALIBRATION_STD_RAD),
        second_heading_rad=fit.second_heading_rad,
        second_score=max(fit.second_score, 0.0) / fit.score,
        line_class=line_class,
    )
    reason = _reason(found, fit, camera, prior, elevation_std_rad)
    # Along a corridor what runs across lies ahead, between the walls. Before a side wall it spans the view: it is
    # what runs along the corridor, and what sticks out of the wall is taken for the corridor. A prediction tells.
    if reason is Reason.OK and not isfinite(prior.heading_rad) and across_px > MAX_ACROSS * along_px:
        square_rad = fit.heading_rad - copysign(0.5 * pi, fit.heading_rad)
        return found._replace(reason=Reason.AMBIGUOUS, second_heading_rad=square_rad, second_score=1.0)
    return found._replace(reason=reason)


def _reason(
    found: HeadingAssessment, fit: AxisFit, camera: Camera, prior: Prior, elevation_std_rad: float
) -> Reason:
    """Decide whether the heading may be used; the limits were set where gross errors in degraded pictures end."""
    if found.n_inliers < MIN_LINES or fit.score < MIN_SCORE:
        return Reason.TOO_FEW_LINES
    blur_px = prior.body_rate_rad_s * camera.exposure_s * camera.fx_px
    if isfinite(blur_px) and blur_px > MAX_BLUR_PX:
        return Reason.BLUR
    distinct = min(fit.n_distinct / found.n_inliers * fit.score_of_all / fit.score, 1.0)
    tied = distinct * (fit.score - fit.second_score) < MIN_MARGIN or found.second_score > MAX_RIVAL
    if tied and not _is_chosen(fit, prior):
        return Reason.AMBIGUOUS
    if fit.inlier_share < MIN_SHARE:
        return Reason.AMBIGUOUS
    if not found.heading_std_rad < MAX_STD_RAD or abs(fit.heading_rad) > 0.5 * pi:
        return Reason.UNCERTAIN
    if abs(fit.elevation_rad) > max(MAX_ELEVATION_RAD, MAX_ELEVATION_SIGMA * elevation_std_rad):
        return Reason.UNCERTAIN
    return Reason.OK


def _is_chosen(fit: AxisFit, prior: Prior) -> bool:
    """Tell whether a prediction decides for this direction, where another explains the lines about as well.

    A prediction can be wrong by the angle between the two, where a filter follows the axis across: a picture that is
    for the other direction by more than a tenth is not overruled.
    """
    if not isfinite(prior.heading_rad):
        return False
    reach_rad = CHOOSING_SIGMA * hypot(prior.heading_std_rad, PRIOR_FLOOR_STD_RAD)
    own, other = (abs(wrap_axis(h - prior.heading_rad)) for h in (fit.heading_rad, fit.second_heading_rad))
    without_prior = fit.second_score - log(PRIOR_OUTLIER_SHARE)
    return own < reach_rad < other and fit.score > MIN_CHOSEN * without_prior


@compiled
def _classify(
    normal: FloatArray,
    centre: FloatArray,
    length: FloatArray,
    R: FloatArray,
    heading: float,
    inlier: BoolArray,
) -> tuple[npt.NDArray[np.int8], float, float]:
    """Return each line's `LineClass` (n,), and two lengths: of those across well aside of the axis, and along it.

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
