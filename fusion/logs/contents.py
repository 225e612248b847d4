"""Contents of a log of any format: named topics, each to be read as one of the streams of a flight.

A format is a module with ``recognises(path)`` and ``open_log(path)``, see `fusion.logs`. Opening a log reads only
its topics and their times; a topic is read, converted (body FRD, world z down, SI) and cleaned on request.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Protocol

from fusion.flight import (
    AttitudeStream,
    CorridorTruth,
    FrameStream,
    ImuStream,
    RangeStream,
    TimeArray,
    VectorStream,
)
from fusion.logs.samples import Problems, WithProblems
from vision import Camera, InputError
from vision.cameras.camera import BodyFrame


class UndecidedError(InputError):
    """A stream with undefined meaning: an error if the user named it, else it is left out."""


class Kind(StrEnum):
    """Kind of stream that a topic can be read as."""

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
        Name in the log: a ROS topic, ``vehicle_attitude``, ``IMU[0]``, ``cam0``.
    kind
        Kind of stream.
    t_ns
        Times (n,) as in the log, neither sorted nor cleaned.
    note
        Information for choosing it, such as the size of its pictures or its frame convention.
    """

    name: str
    kind: Kind
    t_ns: TimeArray
    note: str = ""


class LogContents(Protocol):
    """An opened log.

    The reading methods take the name of a topic of their kind. They return the stream with a sentence for each thing
    that they dropped or repaired, and raise `InputError` if nothing usable is left. Members with a default are
    optional for readers that inherit from this class.
    """

    path: Path
    format: str  # in words, "PX4 ULog"
    topics: tuple[Topic, ...]
    problems: Problems  # of the whole file: truncated end, corrupt blocks
    body_frame: BodyFrame | None = None  # axes of extrinsics, if the log states them
    pictures_remedy: str | None = None  # how to supply pictures, if the format supports them

    def frames(self, topic: str) -> WithProblems[FrameStream]:
        """Pictures, decoded one at a time on request."""

    def camera(self, topic: str) -> Camera | None:
        """Return the log's own calibration for these pictures, or None."""

    def imu(self, topic: str) -> WithProblems[ImuStream]:
        """Gyroscope and accelerometer, body FRD."""

    def attitude(self, topic: str) -> WithProblems[AttitudeStream]:
        """Body FRD to world z down."""

    def position(self, topic: str) -> WithProblems[VectorStream]:
        """World, z down."""

    def velocity(self, topic: str) -> WithProblems[VectorStream]:
        """Body FRD."""

    def range(self, topic: str) -> WithProblems[RangeStream]:
        """Distance to the floor along the body's z."""

    def calibration_file(self, topic: str) -> Path | None:
        """Return the path where the format expects a camera's calibration, or None."""
        return None

    def file_of(self, topic: str) -> Path:
        """Return the file with a topic's times."""
        return self.path

    def truth(self) -> WithProblems[CorridorTruth | None]:
        """Read the ground truth, if the log has one."""
        return WithProblems(None)
