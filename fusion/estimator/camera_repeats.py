"""Detects a camera that repeats its picture, from the pictures and the motion of the vehicle.

Two pictures of a real camera are never equal, because of noise. So a picture equal to the one before is a repetition
if the gyroscope shows any motion. For measurements made elsewhere the rule depends on the gyroscope: with a noisy
one, `EQUAL_FRAMES` equal measurements in a row are a repetition; with one free of noise, as in a simulation, the
vehicle must have turned by `TURN_RAD`. A vehicle at rest in a simulation without noise therefore raises no fault.
"""

from __future__ import annotations

from math import radians
from struct import pack
from typing import NamedTuple

from fusion.estimator.faults import Fault, Notice
from fusion.estimator.frame_update import FrameSample
from fusion.estimator.gyro_checks import GyroCheck
from fusion.estimator.propagation import DeadReckoning, Mode
from vision.measurement import FrameMeasurement

MIN_REPORTED_FRAMES = 3  # in a row: a video at a higher rate than its camera's shows some pictures twice
EQUAL_FRAMES = 5  # equal measurements in a row, with a noisy gyroscope
TURN_RAD = radians(0.3)


class Repeats(NamedTuple):
    """State of the detection.

    Parameters
    ----------
    content
        Content of the last frame, compared bit for bit; empty if there was none.
    turned_rad
        The dead-reckoned heading, bias not subtracted, at the first frame with this content.
    equal, found
        Number of frames in a row equal to the first, and of those found to be repetitions.
    """

    content: bytes = b""
    turned_rad: float = 0.0
    equal: int = 0
    found: int = 0

    def with_frame(self, sample: FrameSample, reckoning: DeadReckoning, gyro: GyroCheck) -> Repeats:
        """Add the next frame; ``reckoning`` and ``gyro`` are those at its time."""
        m = sample.measure
        content = _content(m) if isinstance(m, FrameMeasurement) else sample.picture
        if not content or content != self.content:
            return Repeats(content, reckoning.raw_theta_rad)
        equal, turned_rad = self.equal + 1, abs(reckoning.raw_theta_rad - self.turned_rad)
        if not isinstance(m, FrameMeasurement):
            again = turned_rad > 0.0 or reckoning.mode is Mode.NONE  # without a source, motion is unknown
        else:
            again = (turned_rad > TURN_RAD and not gyro.is_noisy) or (equal >= EQUAL_FRAMES and gyro.is_noisy)
        return Repeats(content, self.turned_rad, equal, self.found + 1 if again or self.found else 0)

    def notice(self) -> Notice | None:
        """Report a frozen camera; None if it is not frozen."""
        if self.found < MIN_REPORTED_FRAMES:
            return None
        return Notice(Fault.CAMERA_FROZEN, "camera repeats the same picture")


def _content(m: FrameMeasurement) -> bytes:
    if not m.accepted:
        return b""
    values = (m.heading_rad, m.heading_std_rad, m.lateral_offset_norm, m.elevation_rad, m.width_per_height)
    return pack("=5d", *values)
