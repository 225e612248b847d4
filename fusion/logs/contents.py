"""What a log holds, whatever its format: named topics, each to be read as one of the streams of a flight.

A format is a module with ``recognises(path)`` and ``open_log(path)``, see `fusion.logs`. Opening a log reads no more
than its topics and their times; a topic is read, converted (body FRD, world z down, SI) and cleaned when it is asked
for.
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
    """A stream whose meaning the log leaves open: the user is asked where it was named, else it is left out."""


class Medium(StrEnum):
    """What a log is to who has to put its axes or units right."""

    FOLDER = "folder"  # a flight folder in the ASL layout, whose files state their axes; its units are fixed
    TABLE = "table"  # a CSV, of which the manifest says axes, columns and units
    LOG = "log"  # any other format: its axes are known, a sensor's mounting or unit may differ from them


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
        Times (n,) as the log has them, neither sorted nor cleaned.
    note
        What a person should know before choosing it, such as the size of its pictures or its frame convention.
    """

    name: str
    kind: Kind
    t_ns: TimeArray
    note: str = ""


class LogContents(Protocol):
    """An opened log.

    The methods that read take the name of a topic of that kind. They return the stream with one sentence for each
    thing that they dropped or repaired, and raise `InputError` where nothing usable is left. The members with a
    default are for formats that have more to tell; a reader that inherits from this class may leave them.
    """

    path: Path
    format: str  # in words, "PX4 ULog"
    topics: tuple[Topic, ...]
    problems: Problems  # of the file as a whole: torn end, corrupt blocks
    body_frame: BodyFrame | None = None  # axes that extrinsics refer to, where the log states them
    medium: Medium = Medium.LOG
    pictures_remedy: str | None = None  # how to supply pictures, where the format has a place for them

    def frames(self, topic: str) -> WithProblems[FrameStream]:
        """Pictures, decoded one at a time when asked for."""

    def camera(self, topic: str) -> Camera | None:
        """Return the calibration that the log itself carries for these pictures; None: none."""

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

    def unit_taken(self, role: str) -> float:
        """Return what one of the file's unit of ``gyro`` or ``accel`` was taken for in SI."""
        return 1.0

    def calibration_file(self, topic: str) -> Path | None:
        """Return where the format expects the calibration of a camera; None: nowhere."""
        return None

    def file_of(self, topic: str) -> Path:
        """Return the file that a topic's times are from."""
        return self.path

    def truth(self) -> WithProblems[CorridorTruth | None]:
        """Read what the flight really did, where the log carries it."""
        return WithProblems(None)
