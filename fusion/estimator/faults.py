"""What is amiss, for people and for programs: a sentence and a bit for each thing that the estimator can tell of."""

from __future__ import annotations

from enum import IntFlag
from typing import NamedTuple


class Fault(IntFlag):
    """Bits of `fusion.estimator.estimate.Estimate.faults`; a bit keeps its meaning for good, new ones are added.

    As in the flags of PX4's EKF2, a set bit is something that a flight controller may act on without reading text.
    """

    NONE = 0
    GYRO_SILENT = 1 << 0  # no sample for gyro_gap_s: attitude or a constant rate carries the heading
    ATTITUDE_SILENT = 1 << 1
    FRAMES_SILENT = 1 << 2  # no frame arrives
    VELOCITY_SILENT = 1 << 3
    RANGE_SILENT = 1 << 4
    FRAMES_REJECTED = 1 << 5  # frames arrive, but none is used
    NO_LATERAL_OFFSET = 1 << 6  # frames are used, but show no lateral offset
    HEADING_UNCERTAIN = 1 << 7  # sigma beyond lost_heading_std_rad
    NOT_STARTED = 1 << 8  # no heading yet
    CAMERA_CLOCK = 1 << 9  # frames are stamped ahead of, behind, or otherwise than before against the IMU
    ATTITUDE_CLOCK = 1 << 10  # attitudes are stamped ahead of the IMU, or too far behind
    IMU_CLOCK = 1 << 11  # IMU samples come too far behind the other sources, or not in nanoseconds
    OTHER_CLOCK = 1 << 12  # velocities or ranges are stamped ahead of the IMU, or too far behind
    GYRO_OUT_OF_RANGE = 1 << 13  # beyond gyro_range_rad_s: refused
    GYRO_SPIKES = 1 << 14  # jumps that no vehicle makes: held back
    GYRO_CLIPPED = 1 << 15  # at the end of its range: used, with a larger variance
    GYRO_FROZEN = 1 << 16  # the same sample again and again: refused
    CAMERA_FROZEN = 1 << 17  # the same picture again and again: not used
    GYRO_SIGN = 1 << 18  # turns the other way than the camera sees
    GYRO_SCALE = 1 << 19  # turns far more than the camera sees
    GYRO_BIAS = 1 << 20  # far from zero at rest
    FOCAL_LENGTH = 1 << 21  # the camera sees more, or less, of each turn than the gyroscope
    TILT_WRONG = 1 << 22  # attitude or accelerometer do not point where gravity does
    HEADING_CONTESTED = 1 << 23  # frames and prediction part, and it is not settled who is wrong
    CAMERA_YAW = (
        1 << 24
    )  # rolling moves what the camera sees up and down: it points to one side of what is told


class Notice(NamedTuple):
    """One thing that is amiss: its bit, and a sentence for people."""

    fault: Fault
    text: str
