"""Detects a camera that repeats its picture, by the pictures and the motion of the vehicle.

No two pictures of a real camera are equal, for their noise differs. So a picture equal to the one before is a
repetition as soon as anything moved at all. Of measurements that another program hands over, a few in a row must be
equal beside a gyroscope that is noisy; beside an exact one, the vehicle must have turned. A vehicle at rest in a
simulation without noise is left in peace.
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

MIN_REPORTED_FRAMES = 3  # in a row: a video of a higher rate than its camera's shows some pictures twice
EQUAL_FRAMES = 5  # measurements in a row beside a noisy gyroscope
TURN_RAD = radians(0.3)


class Repeats(NamedTuple):
    """What the last frame showed.

    Parameters
    ----------
    content
        Of the last frame, to be compared bit for bit; empty where it showed nothing.
    turned_rad
        The dead-reckoned heading, bias included, at the first frame of this content.
    equal, found
        Frames in a row that equal the first, and that were found to be repetitions.
    """

    content: bytes = b""
    turned_rad: float = 0.0
    equal: int = 0
    found: int = 0

    def with_frame(self, sample: FrameSample, reckoning: DeadReckoning, gyro: GyroCheck) -> Repeats:
        """Take the next frame; ``reckoning`` and ``gyro`` are those of its time."""
        m = sample.measure
        content = _content(m) if isinstance(m, FrameMeasurement) else sample.picture
        if not content or content != self.content:
            return Repeats(content, reckoning.raw_theta_rad)
        equal, turned_rad = self.equal + 1, abs(reckoning.raw_theta_rad - self.turned_rad)
        if not isinstance(m, FrameMeasurement):
            again = turned_rad > 0.0 or reckoning.mode is Mode.NONE  # then nothing tells whether it moved
        else:
            again = (turned_rad > TURN_RAD and not gyro.is_noisy) or (equal >= EQUAL_FRAMES and gyro.is_noisy)
        return Repeats(content, self.turned_rad, equal, self.found + 1 if again or self.found else 0)

    def notice(self) -> Notice | None:
        """Say that the camera is frozen; None where it is not."""
        if self.found < MIN_REPORTED_FRAMES:
            return None
        return Notice(Fault.CAMERA_FROZEN, "camera repeats the same picture")


def _content(m: FrameMeasurement) -> bytes:
    if not m.accepted:
        return b""
    values = (m.heading_rad, m.heading_std_rad, m.lateral_offset_norm, m.elevation_rad, m.width_per_height)
    return pack("=5d", *values)
