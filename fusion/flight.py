"""A flight in memory, for any log format: SI units, radians, body FRD, world z down, integer nanoseconds."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
import numpy.typing as npt

from vision import Camera, InputError

FloatArray = npt.NDArray[np.float64]
TimeArray = npt.NDArray[np.int64]
GreyImage = npt.NDArray[np.uint8]


def check_type(value: object, kind: type[object], name: str, remedy: str) -> None:
    """Raise `InputError` if an argument has another type; ``name`` is its name."""
    if not isinstance(value, kind):
        raise InputError(f"{name} is of type {type(value).__name__}", remedy=remedy)


class Remark(str):
    """A sentence among a flight's ``problems`` that states a finding or an assumption; nothing was lost."""

    __slots__ = ()


class FrameSource(Protocol):
    """Pictures of a log by number, decoded one at a time, so that memory does not grow with the flight."""

    def read(self, index: int) -> GreyImage:
        """Decode a picture, grey (h, w); cheapest in ascending order, any order allowed.

        Raises
        ------
        InputError
            If the picture cannot be decoded.
        """


@dataclass(frozen=True, slots=True, eq=False)
class ChosenFrames:
    """Some pictures of a source, renumbered: ``index`` (n,) are their numbers in the source."""

    source: FrameSource
    index: npt.NDArray[np.int64]

    def read(self, index: int) -> GreyImage:
        """Decode a picture."""
        return self.source.read(int(self.index[index]))


@dataclass(frozen=True, slots=True, eq=False)
class FrameStream:
    """Camera frames; a picture that cannot be decoded is noticed only when it is read.

    Parameters
    ----------
    t_ns
        Mid-exposure times (n,), strictly increasing.
    source
        One picture per time.
    """

    t_ns: TimeArray
    source: FrameSource

    def read(self, index: int) -> GreyImage:
        """Decode a picture, see `FrameSource`."""
        return self.source.read(index)

    def chosen(self, index: npt.NDArray[np.int64]) -> FrameStream:
        """Return the stream of some of the frames (m,), ascending."""
        index = np.asarray(index, dtype=np.int64)
        return FrameStream(self.t_ns[index], ChosenFrames(self.source, index))


@dataclass(frozen=True, slots=True, eq=False)
class ImuStream:
    """Gyroscope and accelerometer in body FRD.

    Parameters
    ----------
    t_ns
        Times (n,), strictly increasing.
    gyro_rad_s
        Angular rate (n, 3).
    accel_m_s2
        Specific force (n, 3), about (0, 0, -9.81) at rest and level; NaN rows if a log has none.
    gyro_noise_density, gyro_random_walk
        rad/s/sqrt(Hz) and rad/s^2/sqrt(Hz) as the log declares them; None if it does not.
    """

    t_ns: TimeArray
    gyro_rad_s: FloatArray
    accel_m_s2: FloatArray
    gyro_noise_density: float | None = None
    gyro_random_walk: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class AttitudeStream:
    """The vehicle's own attitude filter: unit quaternions (n, 4), w x y z, body FRD to world z down."""

    t_ns: TimeArray
    q_world_body: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class VectorStream:
    """Positions (n, 3), m, in a world with z down, or velocities (n, 3), m/s, in body FRD."""

    t_ns: TimeArray
    xyz: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class RangeStream:
    """Distances (n,) to the floor, metres, along the body's z (down), from the camera."""

    t_ns: TimeArray
    distance_m: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class CorridorTruth:
    """Ground truth, the columns of ``corridor_truth.csv``; every array is (n,)."""

    t_ns: TimeArray
    heading_rad: FloatArray
    lateral_offset_m: FloatArray
    corridor_width_m: FloatArray
    corridor_id: npt.NDArray[np.int64]
    in_junction: npt.NDArray[np.bool_]


class FlightSource(Protocol):
    """Sources of a flight's streams: `fusion.logs.manifest.manifest.Manifest`, which this module does not import."""

    @property
    def name(self) -> str | None:
        """Name of the flight; None if the source has none."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Flight:
    """One flight: a camera, its frames, and the other streams of the log, each None if the log does not have it.

    All times are integer nanoseconds of one clock, in ascending order.

    Parameters
    ----------
    name
        Name of the flight.
    camera
        Calibration of the pictures.
    frames
        Times of the pictures, and the pictures.
    imu
        Gyroscope, rad/s, and accelerometer, m/s^2, body FRD.
    attitude
        Unit quaternions w, x, y, z of the vehicle's own filter, from body FRD to a world with z down.
    position
        Positions in that world (z down), m.
    velocity
        Velocities, body FRD, m/s.
    truth
        Ground truth of heading and lateral offset.
    problems
        What was dropped or repaired on reading (duplicate times, rows of NaN, zero quaternions, missing pictures
        ...), one sentence each; a `Remark` among them states what was found or assumed.
    corridor_width_m
        Width from the manifest, m; None if it does not set one.
    manifest
        Where every stream came from; None for a flight constructed by the caller.
    range
        Distances to the floor, m, along the body's z axis (down).
    """

    name: str
    camera: Camera
    frames: FrameStream
    imu: ImuStream | None = None
    attitude: AttitudeStream | None = None
    position: VectorStream | None = None
    velocity: VectorStream | None = None
    truth: CorridorTruth | None = None
    problems: tuple[str, ...] = field(default=())
    corridor_width_m: float | None = None
    manifest: FlightSource | None = None
    range: RangeStream | None = None

    def __repr__(self) -> str:
        streams = {
            "frames": self.frames,
            "IMU samples": self.imu,
            "attitudes": self.attitude,
            "positions": self.position,
            "velocities": self.velocity,
            "ranges": self.range,
            "rows of truth": self.truth,
        }
        held = [f"{len(stream.t_ns)} {name}" for name, stream in streams.items() if stream is not None]
        if self.problems:
            held.append(f"{len(self.problems)} problems")
        return f"Flight({self.name}: {', '.join(held)})"
