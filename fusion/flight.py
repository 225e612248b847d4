"""A flight in memory, whatever log it came from: SI units, radians, body FRD, world z down, integer nanoseconds."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

from vision import Camera

FloatArray = npt.NDArray[np.float64]
TimeArray = npt.NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class FrameStream:
    """Camera frames as files; a file that does not decode is found when it is read, not here.

    Parameters
    ----------
    t_ns
        Mid-exposure times (n,), strictly increasing.
    paths
        One picture per time.
    """

    t_ns: TimeArray
    paths: tuple[Path, ...]


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
        Specific force (n, 3), about (0, 0, -9.81) at rest and level; NaN rows where a log has none.
    gyro_noise_density, gyro_random_walk
        rad/s/sqrt(Hz) and rad/s^2/sqrt(Hz) as the log declares them; None where it does not.
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
    """Positions (world, z down) or velocities (body FRD), (n, 3), metres or metres per second."""

    t_ns: TimeArray
    xyz: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class CorridorTruth:
    """What the flight really did, columns of ``corridor_truth.csv``; every array is (n,)."""

    t_ns: TimeArray
    heading_rad: FloatArray
    lateral_offset_m: FloatArray
    corridor_width_m: FloatArray
    corridor_id: npt.NDArray[np.int64]
    in_junction: npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Flight:
    """One flight: a camera, its frames, and whatever else the log carried (None: it did not).

    ``problems`` names, one sentence each, what was dropped or mended on reading (duplicated times, rows of NaN,
    zero quaternions, missing pictures ...), so that nothing is lost silently.
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
