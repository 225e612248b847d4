"""Measurement of a frame with the filter's prediction as prior. Pure functions.

Vision prefers a vanishing point near the predicted heading. If the result is far from the prediction, or the vehicle
is turned away from the axis, the frame is measured again without prior. `fusion.estimator.frame_fusion` fuses it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import isfinite, nan, pi
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy.typing as npt

from fusion.estimator.config import FusionConfig
from vision.measurement import Attitude, FrameMeasurement, Prior, Reason
from vision.rotations import wrap_axis

if TYPE_CHECKING:
    from vision import Camera
    from vision.lines.line_set import LineSet

    Features = LineSet | FrameMeasurement

Measure = Callable[[Attitude | None, Prior, bool], FrameMeasurement]
"""Function from attitude and prediction to a frame's measurement, with or without the lateral offset."""


class FrameSample(NamedTuple):
    """A camera frame.

    Parameters
    ----------
    t_ns
        Time of exposure: the stamp less the camera's delay.
    stamp_ns
        Time stamp.
    measure
        Function that measures it; or its measurement, made elsewhere; None without a picture.
    picture
        Content of the picture, compared with the one before; empty if not known.
    stamp_std_s
        Sigma of the stamp: size of an undecided step of the camera's clock.
    """

    t_ns: int
    stamp_ns: int
    measure: Measure | FrameMeasurement | None
    picture: bytes = b""
    stamp_std_s: float = 0.0

    def fault(self) -> str:
        """Return no fault: a frame without a picture counts too."""
        return ""


@dataclass(frozen=True, slots=True, eq=False)
class FrameResult:
    """Result of a frame.

    Parameters
    ----------
    timestamp_ns
        Time stamp, nanoseconds, before the camera's delay is subtracted.
    measurement
        The frame's measurement; None if there was no picture.
    accepted, reason
        Whether the filter used its heading.
    innovation_rad, test_ratio
        Heading of the frame minus its prediction, radians, positive right; its square over gate squared, unit 1. NaN
        if it was not compared.
    cause
        Reason why a picture is unreadable, if known; else empty.
    """

    timestamp_ns: int
    measurement: FrameMeasurement | None
    accepted: bool
    reason: Reason
    innovation_rad: float = nan
    test_ratio: float = nan
    cause: str = ""


def extract_features(image: npt.NDArray[Any], camera: Camera, method: str) -> Features:
    """Extract what depends on the picture alone: its lines, or the whole measurement of the article's method.

    Raises
    ------
    InputError
        If the array is no picture or its size is not the camera's.
    """
    from vision import extract_lines, measure_frame
    from vision.images import to_grey

    if method == "paper":
        return measure_frame(image, camera, method="paper")
    return extract_lines(to_grey(image), camera)


def measure_with_prior(
    measure: Measure,
    attitude: Attitude | None,
    prior: Prior,
    psi_rad: float,
    lateral: bool,
    config: FusionConfig,
) -> FrameMeasurement:
    """Measure a frame with the prediction and, if the result is ambiguous, without.

    With the prediction, vision prefers an axis near it to one along the view, so strong lines across the corridor can
    win. If the vehicle is turned away from the axis, the prediction must not select: walls and fittings at a junction
    also run along the old corridor and would hide the new one. The best direction then counts, at least as a vote.

    Parameters
    ----------
    measure
        Function that measures the frame.
    attitude
        Roll and pitch; None if never measured.
    prior
        The filter's prediction; its heading is NaN before acquisition.
    psi_rad
        The filter's heading.
    lateral
        Whether to look for the lateral offset.
    config
        Settings.
    """
    expected = measure(attitude, prior, lateral)
    if not isfinite(prior.heading_rad):
        return expected
    turned = abs(prior.heading_rad) > config.junction_min_turn_rad
    near = _is_near(expected, psi_rad, config)
    if near and not turned:
        return expected
    blind = replace(prior, heading_rad=nan, heading_std_rad=nan)
    # After a turn both results are usually near the axis; the heading alone decides, at less than half the cost.
    free = measure(attitude, blind, lateral and not near)
    if reason_to_reject(free, config) is not Reason.OK:
        return expected
    if not near:
        return free
    if _is_near(free, psi_rad, config):
        return expected
    return measure(attitude, blind, lateral) if lateral else free


def reason_to_reject(m: FrameMeasurement, config: FusionConfig) -> Reason:
    """Return the reason to reject a measurement before the gate; OK if there is none."""
    if not m.accepted:
        return m.reason if m.reason is not Reason.OK else Reason.UNCERTAIN
    if m.n_inliers < config.min_lines:
        return Reason.TOO_FEW_LINES
    if not (isfinite(m.heading_rad) and 0.0 < m.heading_std_rad < pi):  # NaN fails too
        return Reason.UNCERTAIN
    return Reason.OK


def _is_near(m: FrameMeasurement, psi_rad: float, config: FusionConfig) -> bool:
    """Whether a measurement is valid and nearer to the present axis than to that of another corridor."""
    distance = abs(wrap_axis(m.heading_rad - psi_rad))
    return reason_to_reject(m, config) is Reason.OK and distance <= config.junction_min_turn_rad
