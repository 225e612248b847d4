"""Faults that the estimator reports: a bit for programs and a sentence for people."""

from __future__ import annotations

from enum import IntFlag
from typing import NamedTuple


class Fault(IntFlag):
    """Bits of `fusion.estimator.estimate.Estimate.faults`; the meaning of a bit never changes, new ones are added.

    As with the fault flags of PX4's EKF2, a flight controller can act on a bit without reading the text.
    """

    NONE = 0
    GYRO_SILENT = 1 << 0  # no sample for gyro_gap_s: the heading is propagated by attitude or a constant rate
    ATTITUDE_SILENT = 1 << 1  # no attitude sample any more
    FRAMES_SILENT = 1 << 2  # no frame arrives
    VELOCITY_SILENT = 1 << 3  # no velocity sample any more
    RANGE_SILENT = 1 << 4  # no range sample any more
    FRAMES_REJECTED = 1 << 5  # frames arrive, but none is used
    NO_LATERAL_OFFSET = 1 << 6  # frames are used, but show no lateral offset
    HEADING_UNCERTAIN = 1 << 7  # sigma beyond lost_heading_std_rad
    NOT_STARTED = 1 << 8  # no heading yet
    CAMERA_CLOCK = 1 << 9  # frames are stamped early, late or ahead of the IMU, or their offset has changed
    ATTITUDE_CLOCK = 1 << 10  # attitudes are stamped ahead of the IMU, or too far behind
    IMU_CLOCK = 1 << 11  # IMU samples come too far behind the other sources, or not in nanoseconds
    OTHER_CLOCK = 1 << 12  # velocities or ranges are stamped ahead of the IMU, or too far behind
    GYRO_OUT_OF_RANGE = 1 << 13  # beyond gyro_range_rad_s: rejected
    GYRO_SPIKES = 1 << 14  # jumps that no vehicle makes: held back
    GYRO_CLIPPED = 1 << 15  # at the end of its range: used, with a larger variance
    GYRO_FROZEN = 1 << 16  # the same sample again and again: rejected
    CAMERA_FROZEN = 1 << 17  # the same picture again and again: not used
    GYRO_SIGN = 1 << 18  # turns the other way than the camera sees
    GYRO_SCALE = 1 << 19  # turns far more than the camera sees
    GYRO_BIAS = 1 << 20  # far from zero at rest
    FOCAL_LENGTH = 1 << 21  # the camera sees more, or less, of each turn than the gyroscope
    # Attitude or accelerometer do not point where gravity does, or the attitude does not turn with the gyroscope.
    TILT_WRONG = 1 << 22
    HEADING_CONTESTED = 1 << 23  # frames and prediction disagree; which is wrong is undecided
    # The axis moves up and down as the vehicle rolls: the camera's yaw or principal point differs from the
    # calibration.
    CAMERA_YAW = 1 << 24
    RANGE_TOO_SHORT = 1 << 25  # ranges give a corridor narrower than 1 m: not used
    VELOCITY_CONTRADICTED = 1 << 26  # velocities contradict the lateral offset's changes: not used


class Notice(NamedTuple):
    """One fault: its bit, and a sentence for people."""

    fault: Fault
    text: str
