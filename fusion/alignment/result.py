"""What an alignment found: quantities with their standard deviations and a sentence each."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite

from vision.cameras.camera import Camera

SIGNIFICANT_SIGMA = 3.0


@dataclass(frozen=True, slots=True)
class Quantity:
    """One thing that was looked for.

    Parameters
    ----------
    name
        As in the manifest, unit included: ``clock_offset_s``, ``focal_scale``, ``mount_yaw_rad`` ...
    value, sigma
        What was found, against the flight as it was read; NaN and infinite where nothing was.
    usable
        Whether sigma is small enough for the value to be of use.
    sentence
        What it means, or why it could not be found.
    neutral
        The value that changes nothing.
    """

    name: str
    value: float
    sigma: float
    usable: bool
    sentence: str
    neutral: float = 0.0

    @property
    def changes(self) -> bool:
        """Whether to correct the flight by it: usable, and not what is there already."""
        if not (self.usable and isfinite(self.value)):
            return False
        return abs(self.value - self.neutral) > SIGNIFICANT_SIGMA * self.sigma


@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    """Camera against inertial sensors, for one flight.

    Parameters
    ----------
    clock_offset
        To be added to the frames' times.
    clock_rate
        Factor on the frames' times counted from the first, before the offset is added.
    focal_scale
        Factor on the camera's focal lengths; on an ordinary camera's, where nothing was known of the camera.
    mount_yaw, mount_pitch, mount_roll
        By how much further right and up the camera looks, and how much further its right side hangs down, than its
        calibration says.
    camera
        The flight's camera with the corrections that are usable and significant; where nothing was known of the
        camera, an ordinary one with the focal length found.
    camera_known
        Whether there was a calibration.
    n_frames, n_used
        Frames looked at, and those that told the time offset.
    notes
        What else should be known, a sentence each.
    turns_opposite
        Whether vision and the inertial sensors turn opposite ways.
    """

    clock_offset: Quantity
    focal_scale: Quantity
    mount_yaw: Quantity
    mount_pitch: Quantity
    mount_roll: Quantity
    clock_rate: Quantity
    camera: Camera
    camera_known: bool
    n_frames: int
    n_used: int
    notes: tuple[str, ...] = ()
    turns_opposite: bool = False

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        """All of them, in the order to be shown."""
        clock = (self.clock_offset, self.clock_rate)
        return (*clock, self.focal_scale, self.mount_yaw, self.mount_pitch, self.mount_roll)
