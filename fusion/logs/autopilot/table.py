"""Common form of the messages of all autopilots' logs: a table of samples with a column of times."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from mmap import ACCESS_READ, mmap
from pathlib import Path
from typing import Any, TypeVar

from fusion.flight import AttitudeStream, FloatArray, ImuStream, TimeArray, VectorStream
from fusion.logs.contents import Kind, Topic
from fusion.logs.imu_series import imu_stream
from fusion.logs.samples import WithProblems
from fusion.logs.series import (
    MAX_POSITION,
    Series,
    Stream,
    Where,
    attitude_stream,
    quaternions,
    vector_stream,
)
from vision import InputError

DOWNWARD = (
    25  # orientation of a distance sensor that looks down: the same number in PX4, ArduPilot and MAVLink
)

Columns = tuple[str, ...]
AnyTable = TypeVar("AnyTable", bound="MessageTable")


@dataclass(frozen=True, slots=True, eq=False)
class MessageTable(ABC):
    """Samples of one message from one sensor or filter; formats implement the access to columns.

    Parameters
    ----------
    file
        The log.
    label
        Name of the topic, such as ``IMU[0]``.
    t_ns
        Time of each sample (n,), neither sorted nor cleaned.
    """

    file: Path
    label: str
    t_ns: TimeArray

    @abstractmethod
    def has(self, *columns: str) -> bool:
        """Whether all of these columns exist, as numbers."""

    @abstractmethod
    def numbers(self, *columns: str) -> FloatArray:
        """Columns (n, k) as floats, in the format's unit."""

    def column(self, name: str) -> FloatArray:
        """One column (n,)."""
        return self.numbers(name)[:, 0]

    def where(self) -> Where:
        """Return the name of the samples for messages."""
        return Where(self.file, self.label)

    def imu(self, gyro: Columns, accel: Columns) -> WithProblems[ImuStream]:
        """Angular rates and specific forces, rad/s and m/s^2, body FRD."""
        return imu_stream(self.t_ns, self.numbers(*gyro), self.numbers(*accel), self.where())

    def attitude(self, quaternion: Columns) -> WithProblems[AttitudeStream]:
        """Quaternions, columns in the order w, x, y, z, body FRD to NED."""
        return attitude_stream(self.t_ns, self.numbers(*quaternion), self.where())

    def attitude_from_angles(self, angles: Columns, unit_rad: float = 1.0) -> WithProblems[AttitudeStream]:
        """Roll, pitch and yaw, in a unit given in radians."""
        return attitude_stream(self.t_ns, quaternions(*(self.numbers(*angles) * unit_rad).T), self.where())

    def position(self, columns: Columns) -> WithProblems[VectorStream]:
        """Positions, NED, metres."""
        return vector_stream(self.t_ns, self.numbers(*columns), self.where(), MAX_POSITION)


def series_of(
    table: AnyTable, kind: Kind, note: str, read: Callable[[AnyTable], WithProblems[Stream]]
) -> Series:
    """Offer a table as a topic.

    Parameters
    ----------
    table
        Its label and times become the topic's.
    kind
        Kind of stream.
    note
        Information for choosing it.
    read
        Reads the table when the topic is requested.
    """
    return Series(Topic(table.label, kind, table.t_ns, note), partial(read, table))


def map_file(path: Path) -> Any:
    """Map a log into memory, an `mmap` to read from.

    Raises
    ------
    InputError
        If it cannot be opened, or is empty.
    """
    try:
        with path.open("rb") as file:
            return mmap(file.fileno(), 0, access=ACCESS_READ)
    except (OSError, ValueError) as error:
        raise InputError(f"cannot be read: {error}", file=path, remedy="check the file") from error


def begins_with(path: Path, magic: bytes) -> bool:
    """Whether a path is a file that begins with these bytes."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return file.read(len(magic)) == magic
