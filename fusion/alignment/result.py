"""Result of an alignment: quantities with their standard deviations and a sentence each."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite

from vision.cameras.camera import Camera

SIGNIFICANT_SIGMA = 3.0


@dataclass(frozen=True, slots=True)
class Quantity:
    """One estimated quantity.

    Parameters
    ----------
    name
        As in the manifest, unit included: ``clock_offset_s``, ``focal_scale``, ``mount_yaw_rad`` ...
    value, sigma
        Estimate relative to the flight as read; NaN and infinite if there is none.
    usable
        Whether sigma is small enough to use the value.
    sentence
        Its meaning, or the reason why it could not be found.
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
        """Whether to correct the flight by it: usable and significantly different from the present value."""
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
        Factor on the camera's focal lengths; relative to an ordinary camera's if the camera is unknown.
    mount_yaw, mount_pitch, mount_roll
        Angles by which the camera looks further right and up, and its right side is lower, than calibrated.
    camera
        The flight's camera with the corrections that are usable and significant; if it is unknown, an ordinary camera
        with the focal length found.
    camera_known
        Whether there was a calibration.
    n_frames, n_used
        Frames measured, and those used for the time offset.
    notes
        Further remarks, a sentence each.
    turns_opposite
        Whether vision and inertial sensors measure opposite turns.
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
        """All quantities, in the order of display."""
        clock = (self.clock_offset, self.clock_rate)
        return (*clock, self.focal_scale, self.mount_yaw, self.mount_pitch, self.mount_roll)
