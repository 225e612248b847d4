"""Measure a frame: takes what measures it and what the filter expects, returns the measurement, changes nothing.

`fusion.estimator.engine` fuses its heading.
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
"""What turns attitude and prediction into a frame's measurement, with the lateral offset or without."""


class FrameSample(NamedTuple):
    """A camera frame.

    Parameters
    ----------
    t_ns
        When it was taken.
    stamp_ns
        As stamped, before the camera's delay is taken off.
    measure
        What measures it; or its measurement, made elsewhere; None where there is no picture.
    picture
        What the picture shows, to be compared with the one before; empty where that is not known.
    stamp_std_s
        By how much the stamp may be off: a step of the camera's clock that is suspected, but not decided.
    """

    t_ns: int
    stamp_ns: int
    measure: Measure | FrameMeasurement | None
    picture: bytes = b""
    stamp_std_s: float = 0.0

    def fault(self) -> str:
        """Why it cannot be used: a frame without a picture counts too, so nothing."""
        return ""


@dataclass(frozen=True, slots=True, eq=False)
class FrameResult:
    """What became of a frame.

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
        where it was not compared.
    cause
        Why a picture is unreadable, where that is known; else empty.
    """

    timestamp_ns: int
    measurement: FrameMeasurement | None
    accepted: bool
    reason: Reason
    innovation_rad: float = nan
    test_ratio: float = nan
    cause: str = ""


def extract_features(image: npt.NDArray[Any], camera: Camera, method: str) -> Features:
    """Extract what depends on nothing but the picture: its lines, or all that the article's method measures.

    Raises
    ------
    InputError
        Where the array is no picture or has another size than the camera's.
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
    """Measure a frame with the prediction, and, where that does not settle it, without.

    With the prediction, vision prefers an axis near it to one along the view, so strong lines across can win. And
    turned away from the axis, the prediction must not choose at all: walls and fittings at a junction run along
    the old corridor too, and would hide the new one; there the best direction counts, if only as a vote.

    Parameters
    ----------
    measure
        What measures the frame.
    attitude
        Roll and pitch; None where nothing ever told them.
    prior
        What the filter expects; its heading is NaN where it has none.
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
    # Turned away, both are nearly always near: the heading tells, at less than half the cost.
    free = measure(attitude, blind, lateral and not near)
    if reason_to_reject(free, config) is not Reason.OK:
        return expected
    if not near:
        return free
    if _is_near(free, psi_rad, config):
        return expected
    return measure(attitude, blind, lateral) if lateral else free


def reason_to_reject(m: FrameMeasurement, config: FusionConfig) -> Reason:
    """Reason to turn a measurement down before the filter looks at it; OK where there is none."""
    if not m.accepted:
        return m.reason if m.reason is not Reason.OK else Reason.UNCERTAIN
    if m.n_inliers < config.min_lines:
        return Reason.TOO_FEW_LINES
    if not (isfinite(m.heading_rad) and 0.0 < m.heading_std_rad < pi):  # NaN fails too
        return Reason.UNCERTAIN
    return Reason.OK


def _is_near(m: FrameMeasurement, psi_rad: float, config: FusionConfig) -> bool:
    """Whether a measurement is of the present axis rather than of another."""
    distance = abs(wrap_axis(m.heading_rad - psi_rad))
    return reason_to_reject(m, config) is Reason.OK and distance <= config.junction_min_turn_rad
