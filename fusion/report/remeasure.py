"""Measure frames of a fused flight again, for their lines: the tables contain only numbers."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from fusion.flight import Flight, GreyImage
from fusion.logs.interpolation import attitude_at as attitude_at_times
from fusion.result.result import FusionResult
from fusion.result.table_rows import row_before
from vision.errors import InputError
from vision.measurement import Attitude, FrameMeasurement, Position, Prior, Reason


class RemeasuredFrame(NamedTuple):
    """A frame's picture, and its measurement with lines; None if it could not be measured again."""

    image: GreyImage
    measurement: FrameMeasurement | None


def measure_frame_again(result: FusionResult, flight: Flight, row: int) -> RemeasuredFrame | None:
    """Read and measure a frame again, with the filter's prior; None if its picture cannot be decoded.

    The lines are from the new measurement, the numbers are those used by the filter.

    Parameters
    ----------
    result, flight
        Result of `fusion.fuse_flight`, and its flight.
    row
        Row of ``result.frames``.
    """
    from vision.frame import measure_frame

    record = result.frames[row]
    stamp_ns = int(record["timestamp_ns"])
    k = int(np.searchsorted(flight.frames.t_ns, stamp_ns))
    if k >= len(flight.frames.t_ns) or flight.frames.t_ns[k] != stamp_ns:
        return None
    try:
        image = flight.frames.read(k)
    except InputError:
        return None
    t_ns = stamp_ns - delay_ns(result)
    table = result.estimates
    prior = _prior(table[row_before(table, t_ns)]) if len(table) else None
    try:
        measurement = measure_frame(
            image,
            flight.camera,
            interpolated_attitude(flight, t_ns),
            prior,
            method="paper" if result.overview.method == "paper" else "geometric",
        )
    except InputError:
        return RemeasuredFrame(image, None)
    return RemeasuredFrame(image, _as_recorded(measurement, record))


def delay_ns(result: FusionResult) -> int:
    """Delay of the frames' stamps after mid-exposure, as assumed by the filter."""
    return round(result.config.camera_delay_s * 1e9)


def _as_recorded(measurement: FrameMeasurement, record: np.void) -> FrameMeasurement:
    """Combine the new measurement's lines with the recorded numbers, which the filter used."""
    position = str(record["position"])
    vp = (float(record["vp_x_px"]), float(record["vp_y_px"]))
    return replace(
        measurement,
        accepted=bool(record["accepted"]),
        reason=Reason(str(record["reason"])),
        vp_px=vp,
        heading_rad=float(record["heading_rad"]),
        heading_std_rad=float(record["heading_std_rad"]),
        lateral_offset_norm=float(record["lateral_offset_norm"]),
        position=Position(position) if position else None,
    )


def _prior(estimate: np.void) -> Prior | None:
    if estimate["status"] == "initialising":
        return None
    return Prior(
        heading_rad=float(estimate["heading_rad"]),
        heading_std_rad=float(estimate["heading_std_rad"]),
        lateral_offset_norm=float(estimate["lateral_offset_norm"]),
        lateral_offset_norm_std=float(estimate["lateral_offset_norm_std"]),
    )


def interpolated_attitude(flight: Flight, t_ns: int, within_s: float = 0.5) -> Attitude | None:
    """Interpolate roll and pitch between the neighbouring attitude samples.

    Parameters
    ----------
    flight
        Whose attitude stream is used.
    t_ns
        The time.
    within_s
        Largest distance of the nearest sample.

    Returns
    -------
    Attitude or None
        None if no sample is near enough.
    """
    stream = flight.attitude
    if stream is None or not stream.t_ns.size:
        return None
    within_ns = round(within_s * 1e9)
    q_world_body, known = attitude_at_times(stream, np.array([t_ns]), 2 * within_ns, within_ns)
    return Attitude.from_quaternion(q_world_body[0]) if known[0] else None
