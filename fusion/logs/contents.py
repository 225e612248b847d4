"""What a log holds, whatever its format: named topics, each to be read as one of the streams of a flight.

A format is a module with ``recognises(path)`` and ``open_log(path)``. Opening a log reads no more than its topics and
their times; a topic is read, converted (body FRD, world z down, SI) and cleaned when it is asked for.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Protocol

from fusion.flight import AttitudeStream, FrameStream, ImuStream, RangeStream, TimeArray, VectorStream
from vision import Camera


class Kind(StrEnum):
    """What a topic can be read as."""

    FRAMES = "frames"
    IMU = "imu"
    ATTITUDE = "attitude"
    POSITION = "position"
    VELOCITY = "velocity"
    RANGE = "range"


@dataclass(frozen=True, slots=True, eq=False)
class Topic:
    """One series of samples in a log.

    Parameters
    ----------
    name
        As the log calls it: a ROS topic, ``vehicle_attitude``, ``IMU[0]``, ``cam0``.
    kind
        What it can be read as.
    t_ns
        Times (n,) as they stand in the log, neither sorted nor cleaned.
    note
        What a person should know before choosing it, such as the size of its pictures or its frame convention.
    """

    name: str
    kind: Kind
    t_ns: TimeArray
    note: str = ""


class LogContents(Protocol):
    """An opened log.

    The methods take the name of a topic of that kind and append to ``problems``, one sentence each, what they drop or
    mend; they raise `InputError` where nothing usable is left.
    """

    path: Path
    format: str  # in words, "PX4 ULog"
    topics: tuple[Topic, ...]
    problems: tuple[str, ...]  # of the file as a whole: torn end, corrupt blocks

    def frames(self, topic: str, problems: list[str]) -> FrameStream:
        """Pictures, decoded one at a time when asked for."""

    def camera(self, topic: str) -> Camera | None:
        """Return the calibration that the log itself carries for these pictures; None: none."""

    def imu(self, topic: str, problems: list[str]) -> ImuStream:
        """Gyroscope and accelerometer, body FRD."""

    def attitude(self, topic: str, problems: list[str]) -> AttitudeStream:
        """Body FRD to world z down."""

    def position(self, topic: str, problems: list[str]) -> VectorStream:
        """World, z down."""

    def velocity(self, topic: str, problems: list[str]) -> VectorStream:
        """Body FRD."""

    def range(self, topic: str, problems: list[str]) -> RangeStream:
        """Distance to the floor along the body's z."""
