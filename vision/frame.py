"""Heading and lateral offset from one picture of a corridor: the entry point of the package.

1. Line segments with sub-pixel ends (`vision.lines.segments`).
2. Level frame: roll and pitch of the attitude, corrected by the vertical lines (`vision.axis.level`).
3. Corridor axis: vote over heading and elevation, then robust least squares (`vision.axis.vanishing_point`).
4. Acceptance of the heading, or the reason to reject it (`vision.axis.acceptance`). Where it is rejected, steps 1 to
   4 are repeated once at half the picture's size.
5. Lateral offset by pairs of corner lines and by a small network (`vision.lateral.offset`).

`measure_frame` runs all steps. A filter calls the two halves: `extract_lines` is step 1, needs only the picture and
takes most of the time; `measure_lines` needs attitude and prediction at the frame's time, and is cheap enough to
repeat when late samples change either.
"""

from __future__ import annotations

import time
from dataclasses import replace
from functools import lru_cache
from math import hypot, isfinite, isnan, nan, radians, sin, sqrt
from typing import Any, Literal, NamedTuple, get_args

import cv2
import numpy as np
import numpy.typing as npt

from vision.axis.acceptance import HeadingAssessment, assess_heading
from vision.axis.level import LevelFrame, level_from_verticals
from vision.axis.peaks import HEADING_PRIOR_STD_RAD
from vision.axis.vanishing_point import AxisFit, axis_direction, corridor_frame, fit_axis
from vision.cameras.camera import Camera
from vision.cameras.projection import project_directions
from vision.errors import InputError
from vision.images import to_grey
from vision.lateral.learned import aspect_at, corner_lines, corner_scores, learned_mixture, mixture_of
from vision.lateral.mixture import UNIFORM_DENSITY, OffsetMixture
from vision.lateral.offset import MODE_HALF_WIDTH, LateralFit, PictureOffset, combined_offset, fit_lateral
from vision.lateral.parallax import Profiles, wall_profiles
from vision.lateral.polar import polar_picture, pyramid_of
from vision.lateral.walls import missing_wall_evidence, wall_is_missing
from vision.lines.line_set import LineSet
from vision.lines.rolling_shutter import correct_rolling_shutter, to_original_px
from vision.lines.segments import extract_coarse_lines, extract_lines
from vision.measurement import (
    Attitude,
    FrameMeasurement,
    Position,
    Prior,
    Reason,
    position_from_offset,
)
from vision.paper.measure import FIRST_PIXEL, measure_paper, paper_yaw
from vision.rotations import rotation_from_angles
from vision.types import FloatArray

Method = Literal["geometric", "paper"]

# Of a heading's sigma. Over 45 simulated and rendered flights, errors 2 to 4 s apart have .1 to .28 of the stated
# variance in common, the more the more accurate the frames.
LASTING_SHARE = 0.45
MAX_DRAWN_CANNOT_TELL = 0.5  # the network's corners are drawn only where its "cannot tell" is below this
MAX_PREDICTED_STD_RAD = radians(1.0)  # of the predicted heading, for it to replace the picture's
MAX_PREDICTED_HEADING_RAD = radians(35.0)
MAX_PREDICTION_ERROR_RAD = radians(1.5)  # predicted minus measured heading, to align the wall profiles by it
MOUNT_ROLL_STD_RAD = radians(1.0)  # upper limit: cameras are mounted at a chosen pitch, but hardly rolled
MAX_SLOPE_RAD = radians(3.0)  # of a predicted elevation, the part that may be a slope
SLOPE_STD_RAD = radians(0.2)  # floors and ceilings are level to about this
SLOPE_PROBABILITY = 0.5  # that an elevation of the axis is a slope, not an error of the mounting pitch
UNKNOWN_ATTITUDE = Attitude(0.0, 0.0, std_rad=radians(12.0))

__all__ = ["LineSet", "Method", "extract_lines", "measure_frame", "measure_lines", "warm_up"]


def measure_frame(
    image: npt.NDArray[Any],
    camera: Camera,
    attitude: Attitude | npt.ArrayLike | None = None,
    prior: Prior | None = None,
    method: Method = "geometric",
    *,
    lateral: bool = True,
) -> FrameMeasurement:
    """Measure heading and lateral offset in one picture of a corridor.

    Line segments are found as in the article (equations 1 to 4; J. Kosecka, W. Zhang, "Video Compass", ECCV 2002),
    but with sub-pixel accuracy.

    Parameters
    ----------
    image
        Grey (h, w), BGR (h, w, 3) or BGRA (h, w, 4), uint8 or uint16.
    camera
        Calibration for this picture size; see `Camera.resized` and `Camera.from_fov`.
    attitude
        Roll and pitch of the body, or a quaternion (4,) w x y z, body FRD to a world whose z points down.
        None: level is found from the picture's vertical lines.
    prior
        A filter's prediction. It selects between hypotheses and is not averaged in.
    method
        ``geometric``, or ``paper``: the article's chain, which uses neither attitude nor prior.
    lateral
        Whether to measure the lateral offset; skipping it saves time.

    Returns
    -------
    FrameMeasurement
        Heading in radians, positive turned right; lateral offset in half widths, positive right of the centre line.
        If the heading is not ``accepted``, ``reason`` is the cause.

    Raises
    ------
    InputError
        If the method is unknown, the array is not a picture or has another size than the camera's, or the quaternion
        is not a unit quaternion of four numbers.
    """
    if method not in get_args(Method):
        raise InputError(f"method {method!r} is unknown", remedy=f"use one of {', '.join(get_args(Method))}")
    grey = to_grey(image)
    if method == "paper":
        return measure_paper(grey, camera)
    return measure_lines(extract_lines(grey, camera), camera, attitude, prior, lateral=lateral)


def measure_lines(
    lines: LineSet,
    camera: Camera,
    attitude: Attitude | npt.ArrayLike | None = None,
    prior: Prior | None = None,
    *,
    lateral: bool = True,
) -> FrameMeasurement:
    """Measure heading and lateral offset from the lines of a picture.

    Parameters
    ----------
    lines
        Result of `extract_lines`.
    camera
        Calibration that they were found with.
    attitude, prior, lateral
        As in `measure_frame`.

    Returns
    -------
    FrameMeasurement
        As from `measure_frame`.

    Raises
    ------
    InputError
        If the quaternion is not a unit quaternion of four numbers.
    """
    started = time.perf_counter()
    prior = prior or Prior()
    # A wider prediction carries less information than the built-in prior: the camera looks along the corridor.
    if not isnan(prior.heading_rad) and not prior.heading_std_rad < HEADING_PRIOR_STD_RAD:
        prior = replace(prior, heading_rad=nan, heading_std_rad=nan)
    if attitude is None:
        attitude = UNKNOWN_ATTITUDE
    elif not isinstance(attitude, Attitude):
        attitude = Attitude.from_quaternion(attitude)
    axis = _find_axis(lines, camera, attitude, prior)
    if not axis.is_accepted and lines.grey is not None:
        coarse = _find_axis(_coarse_lines(lines, camera), camera, attitude, prior)
        if coarse.is_accepted:  # its extraction time is already counted from `started`
            axis = coarse._replace(lines=replace(coarse.lines, extract_ms=lines.extract_ms))
    lines, level, fit, heading = axis
    if fit is None or heading is None:
        return FrameMeasurement(
            accepted=False,
            reason=Reason.TOO_FEW_LINES,
            n_lines=len(lines),
            offset_evidence=_evidence_about_predicted_axis(lines, camera, level, prior) if lateral else (),
            vision_ms=lines.extract_ms + 1e3 * (time.perf_counter() - started),
        )
    offset = _OffsetResult()
    if lateral:
        offset = _measure_offset(heading, fit, lines, camera, level, prior)
    return _frame_measurement(heading, offset, fit, lines, camera, level, attitude, prior, started)


@lru_cache(maxsize=8)
def _coarse_lines(lines: LineSet, camera: Camera) -> LineSet:
    """Extract lines at half the picture's size; cached, as a frame may be measured again with a new prediction."""
    assert lines.grey is not None
    return extract_coarse_lines(lines.grey, camera)


class _Axis(NamedTuple):
    """Corridor axis of one picture; fit and heading are None where there are too few lines."""

    lines: LineSet
    level: LevelFrame
    fit: AxisFit | None = None
    heading: HeadingAssessment | None = None

    @property
    def is_accepted(self) -> bool:
        """Whether the heading may be used."""
        return self.heading is not None and self.heading.reason is Reason.OK


def _find_axis(lines: LineSet, camera: Camera, attitude: Attitude, prior: Prior) -> _Axis:
    """Fit the corridor's axis and decide whether to accept it; lines across the vanishing point are cut in two."""
    if camera.line_delay_s != 0.0 and prior.body_rates_rad_s is not None:
        lines = correct_rolling_shutter(lines, camera, prior.body_rates_rad_s)
    # Subtract the predicted elevation, so that the axis is expected on the horizon. It is assumed to be an error of
    # the mounting pitch, which rolls with the body; if the corridor slopes instead, vertical lines correct it.
    R_body_camera = rotation_from_angles(0.0, -prior.elevation_rad, 0.0) @ camera.R_body_camera
    level_std = level_std_rad(attitude, prior.elevation_std_rad)
    share = _mount_share(attitude, prior)
    level = level_from_verticals(lines, attitude.R_level_body(), R_body_camera, *level_std, share)
    elevation_std_rad = hypot(level.pitch_std_rad, SLOPE_STD_RAD)
    known = (elevation_std_rad, prior.heading_rad, prior.heading_std_rad)
    fit = fit_axis(lines, level.R_level_camera, 0.0, *known)
    if fit is not None and fit.crossing.any():
        axis = corridor_frame(level.R_level_camera, fit.heading_rad, fit.elevation_rad)[0]
        lines = lines.cut(fit.crossing, axis)
        fit = fit_axis(lines, level.R_level_camera, 0.0, *known)
    if fit is None:
        return _Axis(lines, level)
    return _Axis(lines, level, fit, assess_heading(fit, lines, camera, level, prior, elevation_std_rad))


def warm_up(camera: Camera) -> None:
    """Load or build the compiled code, so that the first frame takes no longer than any other.

    Call it before take-off. The first call on a machine compiles, which takes 40 to 60 s of processor time on a slow
    one. Later calls only load the compiled code.

    Parameters
    ----------
    camera
        Camera of the flight: its lens model and picture size determine which code and buffers are needed.
    """
    picture = np.full((camera.height_px, camera.width_px), 160, np.uint8)
    x, y = camera.width_px // 2, camera.height_px // 2
    thick = max(camera.width_px // 80, 2)
    for side in (-x, x):
        for slope in (-0.9, -0.5, 0.3, 0.7, 0.9):
            cv2.line(picture, (x, y), (x + side, round(y + abs(side) * slope)), 40, thick)
        for part in (3, 4):
            cv2.line(picture, (x + side * part // 5, y // 2), (x + side * part // 5, y + y // 2), 90, thick)
    for attitude in (Attitude(0.0, 0.0), None):
        measure_frame(picture, camera, attitude)


def level_std_rad(attitude: Attitude, mount_std_rad: float) -> tuple[float, float]:
    """Return the standard deviations of the level frame's pitch and roll, radians.

    ``mount_std_rad`` is that of the camera's mounting pitch; the mounting roll's is at most `MOUNT_ROLL_STD_RAD`.
    """
    roll_std_rad = min(mount_std_rad, MOUNT_ROLL_STD_RAD)
    return hypot(attitude.std_rad, mount_std_rad), hypot(attitude.std_rad, roll_std_rad)


def _mount_share(attitude: Attitude, prior: Prior) -> float:
    """Return the share of a pitch correction that is due to the mount, which is its share of the variance."""
    if attitude is UNKNOWN_ATTITUDE:
        return 0.0
    mount_variance = prior.elevation_std_rad**2 + min(abs(prior.elevation_rad), MAX_SLOPE_RAD) ** 2
    return mount_variance / (mount_variance + attitude.std_rad**2)


class _OffsetResult(NamedTuple):
    """Estimate of the lateral offset and its evidence; fields as in `FrameMeasurement`."""

    lateral_offset_norm: float = nan
    lateral_offset_norm_std: float = nan
    width_per_height: float = nan
    corridor_aspect: float = nan
    corridor_aspect_std: float = nan
    position: Position | None = None
    wall_lines_px: npt.NDArray[np.float32] | None = None
    offset_evidence: tuple[OffsetMixture, ...] = ()
    wall_profiles: Profiles | None = None


def _frame_measurement(
    heading: HeadingAssessment,
    offset: _OffsetResult,
    fit: AxisFit,
    lines: LineSet,
    camera: Camera,
    level: LevelFrame,
    attitude: Attitude,
    prior: Prior,
    started: float,
) -> FrameMeasurement:
    """Assemble the measurement; ``started`` is the start time of the computation, seconds."""
    vp_px, vp_cov_px2 = _vanishing_point(fit, camera, level.R_level_camera)
    slope_variance = _slope_variance(attitude, level, prior)
    heading_std_rad = sqrt(heading.heading_std_rad**2 + slope_variance)
    lasting = fit.split_variance + slope_variance  # all of it
    return FrameMeasurement(
        accepted=heading.reason is Reason.OK,
        reason=heading.reason,
        n_lines=len(lines),
        n_inliers=heading.n_inliers,
        vp_px=vp_px,
        vp_cov_px2=vp_cov_px2,
        heading_rad=fit.heading_rad,
        heading_std_rad=heading_std_rad,
        heading_lasting_std_rad=sqrt(LASTING_SHARE**2 * (heading_std_rad**2 - lasting) + lasting),
        heading_split_std_rad=sqrt(fit.split_variance),
        elevation_rad=prior.elevation_rad + level.pitch_correction_rad + fit.elevation_rad,
        elevation_std_rad=sqrt(fit.covariance[1, 1]),
        second_heading_rad=heading.second_heading_rad,
        second_score=heading.second_score,
        paper_yaw_rad=paper_yaw(
            vp_px[0] + FIRST_PIXEL, vp_px[1] + FIRST_PIXEL, camera.width_px, camera.height_px
        ),
        lines_px=_in_picture(lines.ends_px, camera),
        line_class=heading.line_class,
        roll_correction_rad=level.roll_correction_rad,
        roll_correction_std_rad=level.roll_correction_std_rad,
        **offset._asdict(),
        vision_ms=lines.extract_ms + 1e3 * (time.perf_counter() - started),
    )


def _slope_variance(attitude: Attitude, level: LevelFrame, prior: Prior) -> float:
    """Return the heading's variance from what may be a slope but is taken for an error of the mounting pitch.

    A mounting pitch turns with the body's roll; a slope does not. Confusing them shifts the heading by the angle
    times the sine of the roll. What vertical lines have shown to be a slope is no longer in the pitch.
    """
    pitch_rad = prior.elevation_rad + level.pitch_correction_rad
    return SLOPE_PROBABILITY * (min(abs(pitch_rad), MAX_SLOPE_RAD) * sin(attitude.roll_rad)) ** 2


def _measure_offset(
    heading: HeadingAssessment, fit: AxisFit, lines: LineSet, camera: Camera, level: LevelFrame, prior: Prior
) -> _OffsetResult:
    """Estimate the lateral offset from lines and, where the heading is accepted, from the network.

    There is evidence but no estimate where a side wall seems to be missing and the corridor's width is not known.
    """
    known = (prior.lateral_offset_norm, prior.lateral_offset_norm_std, prior.width_per_height)
    by_lines, mixture = fit_lateral(lines, fit, level.R_level_camera, level.roll_std_rad, *known)
    estimate: LateralFit | PictureOffset | None = by_lines
    evidence: tuple[OffsetMixture, ...] = (mixture,)
    profiles, aspect = None, (nan, nan)
    walls = None if by_lines is None else _in_picture(lines.ends_px[by_lines.wall_lines], camera)
    if heading.reason is not Reason.OK:
        evidence = _evidence_about_predicted_axis(lines, camera, level, prior)
    elif lines.grey is not None:
        R_corridor_camera = corridor_frame(level.R_level_camera, fit.heading_rad, fit.elevation_rad)
        picture = pyramid_of(lines.grey)
        profiles = wall_profiles(picture, camera, _corridor_frame_from_prediction(fit, level, prior))
        scores = corner_scores(polar_picture(picture, camera, R_corridor_camera))
        regions = mixture_of(scores)
        evidence = (mixture, regions)
        estimate = combined_offset(mixture, regions, *known)
        if estimate is not None and not isfinite(prior.width_per_height):
            likelihood_ratio = float(mixture.likelihood(estimate.offset_norm)) / UNIFORM_DENSITY
            wall_evidence = missing_wall_evidence(
                lines.geometry(), heading.line_class, R_corridor_camera, scores, likelihood_ratio
            )
            if wall_is_missing(wall_evidence):
                estimate = None
        if estimate is not None:
            aspect = aspect_at(scores, estimate.offset_norm)
        agree = by_lines and estimate and abs(by_lines.offset_norm - estimate.offset_norm) < MODE_HALF_WIDTH
        if not agree:
            drawn = regions.cannot_tell < MAX_DRAWN_CANNOT_TELL
            walls = corner_lines(scores, camera, R_corridor_camera).astype(np.float32) if drawn else None
    if estimate is None:
        return _OffsetResult(wall_lines_px=walls, offset_evidence=evidence, wall_profiles=profiles)
    return _OffsetResult(
        lateral_offset_norm=estimate.offset_norm,
        lateral_offset_norm_std=estimate.offset_norm_std,
        width_per_height=estimate.width_per_height,
        corridor_aspect=aspect[0],
        corridor_aspect_std=aspect[1],
        position=position_from_offset(estimate.offset_norm),
        wall_lines_px=walls,
        offset_evidence=evidence,
        wall_profiles=profiles,
    )


def _corridor_frame_from_prediction(fit: AxisFit, level: LevelFrame, prior: Prior) -> FloatArray:
    """Return R_corridor_camera with the predicted heading, where it is precise enough.

    The profiles of two frames are compared, so their heading errors should be equal. The prediction follows the
    gyro; measured headings have independent noise: 0.1 degrees shift the displacement by 0.01 half widths.
    """
    error_rad = abs(prior.heading_rad - fit.heading_rad)  # NaN without a prediction
    known = prior.heading_std_rad < MAX_PREDICTED_STD_RAD and error_rad < MAX_PREDICTION_ERROR_RAD
    heading_rad = prior.heading_rad if known else fit.heading_rad
    return corridor_frame(level.R_level_camera, heading_rad, fit.elevation_rad)


def _evidence_about_predicted_axis(
    lines: LineSet, camera: Camera, level: LevelFrame, prior: Prior
) -> tuple[OffsetMixture, ...]:
    """Return the network's likelihood of the lateral offset about the predicted axis, for frames without an axis.

    Dark pictures have too few lines for an axis of their own. Empty where the predicted heading is too uncertain.
    """
    precise = prior.heading_std_rad < MAX_PREDICTED_STD_RAD
    predicted = precise and abs(prior.heading_rad) < MAX_PREDICTED_HEADING_RAD
    if lines.grey is None or not predicted:  # a prior of NaN is not a prediction
        return ()
    R_corridor_camera = corridor_frame(level.R_level_camera, prior.heading_rad, 0.0)
    return (learned_mixture(lines.grey, camera, R_corridor_camera),)


def _vanishing_point(
    fit: AxisFit, camera: Camera, R_level_camera: FloatArray
) -> tuple[tuple[float, float], tuple[tuple[float, float], tuple[float, float]]]:
    """Return the vanishing point (2,) in the original picture and its covariance ``J C J^T`` (2, 2)."""
    step = 1e-4  # of the finite differences in J, radians
    axes = np.array(
        [
            axis_direction(fit.heading_rad, fit.elevation_rad),
            axis_direction(fit.heading_rad + step, fit.elevation_rad),
            axis_direction(fit.heading_rad, fit.elevation_rad + step),
        ]
    )
    (x, y), (x_h, y_h), (x_e, y_e) = project_directions(axes, R_level_camera, camera).tolist()
    (hh, he), (_, ee) = fit.covariance.tolist()
    xh, yh = (x_h - x) / step, (y_h - y) / step
    xe, ye = (x_e - x) / step, (y_e - y) / step
    xx = xh * xh * hh + 2.0 * xh * xe * he + xe * xe * ee
    xy = xh * yh * hh + (xh * ye + xe * yh) * he + xe * ye * ee
    yy = yh * yh * hh + 2.0 * yh * ye * he + ye * ye * ee
    return (x, y), ((xx, xy), (xy, yy))


def _in_picture(ends_px: FloatArray, camera: Camera) -> npt.NDArray[np.float32]:
    """Map line ends (n, 4) from rectified pixels to the original picture."""
    return to_original_px(ends_px.reshape(-1, 2), camera).reshape(-1, 4).astype(np.float32)
