"""Checks of a flight that the caller constructed, before any work: types, times and shapes of its streams."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from fusion.flight import (
    AttitudeStream,
    CorridorTruth,
    Flight,
    FrameStream,
    ImuStream,
    RangeStream,
    VectorStream,
    check_type,
)
from vision.errors import InputError

#: Type of each stream, and number of columns of its arrays; 0 for one number per row.
_STREAMS: Mapping[str, tuple[type[object], Mapping[str, int]]] = {
    "frames": (FrameStream, {}),
    "imu": (ImuStream, {"gyro_rad_s": 3, "accel_m_s2": 3}),
    "attitude": (AttitudeStream, {"q_world_body": 4}),
    "position": (VectorStream, {"xyz": 3}),
    "velocity": (VectorStream, {"xyz": 3}),
    "range": (RangeStream, {"distance_m": 0}),
    "truth": (
        CorridorTruth,
        dict.fromkeys(
            ("heading_rad", "lateral_offset_m", "corridor_width_m", "corridor_id", "in_junction"), 0
        ),
    ),
}


def check_flight(flight: object) -> None:
    """Reject what is not a flight, or has streams of other types and shapes, times not ascending, or no frames.

    Raises
    ------
    InputError
        With the stream, and the first row out of order.
    """
    check_type(flight, Flight, "flight", "give a Flight: fuse_flight(load_flight(path))")
    for name, (kind, columns) in _STREAMS.items():
        stream = getattr(flight, name)
        if stream is None and name != "frames":
            continue
        check_type(stream, kind, f"flight.{name}", f"give a fusion.flight.{kind.__name__}")
        _check_times(f"flight.{name}.t_ns", stream.t_ns)
        for field, width in columns.items():
            shape = (len(stream.t_ns), width) if width else (len(stream.t_ns),)
            _check_array(f"flight.{name}.{field}", getattr(stream, field), shape)
    if isinstance(flight, Flight) and not len(flight.frames.t_ns):
        raise InputError("the flight has no camera frames", remedy="check mav0/cam0/data.csv of the log")


def _check_array(name: str, values: object, shape: tuple[int, ...]) -> None:
    wanted = f"give a numpy array of numbers of shape {shape}, a row per time"
    check_type(values, np.ndarray, name, wanted)
    if isinstance(values, np.ndarray) and (values.shape != shape or values.dtype.kind not in "biuf"):
        raise InputError(f"{name} is {values.dtype} of shape {values.shape}", remedy=wanted)


def _check_times(name: str, times: npt.ArrayLike) -> None:
    t_ns = np.asarray(times)
    if t_ns.ndim != 1 or not np.issubdtype(t_ns.dtype, np.integer):
        raise InputError(
            f"{name} is {t_ns.dtype} of shape {t_ns.shape}", remedy="give int64 nanoseconds (n,)"
        )
    back = np.flatnonzero(np.diff(t_ns) < 0)
    if len(back):
        row = int(back[0]) + 1
        raise InputError(
            f"{name} goes back in row {row}, from {t_ns[row - 1]} to {t_ns[row]}",
            remedy="sort the stream by time",
        )
