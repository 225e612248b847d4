"""Open files as declared in a manifest: with their columns, on the flight's clock, in SI units."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

from fusion.flight import ImuStream, RangeStream, TimeArray, VectorStream
from fusion.logs import format_of, open_log
from fusion.logs.contents import Kind, LogContents
from fusion.logs.csv.column_map import ColumnMap
from fusion.logs.manifest.manifest import CameraSource, Manifest, StreamSource
from fusion.logs.plausibility.findings import Medium
from fusion.logs.samples import at_rate, refuse_placeholder
from fusion.logs.units import in_si
from vision import InputError

AnyStream = TypeVar("AnyStream", bound=Any)


def with_time_shift(manifest: Manifest) -> Manifest:
    """Take the camera's clock offset from its calibration, if the manifest does not set it."""
    from vision.cameras.calibration import read_time_shift_s

    source = manifest.camera
    if source.calibration is None or "clock_offset_s" in source.model_fields_set:
        return manifest
    shift_s = read_time_shift_s(source.calibration)
    if shift_s is None:
        return manifest
    return manifest.model_copy(update={"camera": source.model_copy(update={"clock_offset_s": shift_s})})


def open_as_declared(path: Path, source: StreamSource) -> LogContents:
    """Open a file as declared in a manifest's table: with its column map and axes, frame times and start.

    Raises
    ------
    InputError
        If it cannot be opened, or a key does not apply to this kind of file.
    """
    from fusion.logs.csv import columns
    from fusion.logs.pictures import picture_folder as folder
    from fusion.logs.pictures import video

    options = source.open_options()
    refuse_placeholder(path)
    if isinstance(source, CameraSource):
        if video.recognises(path):
            _refuse(options, ("frame",), path, "a video")
            return video.open_video(
                path,
                start_ns=source.start_ns or 0,
                times=source.times,
                columns=source.columns,
                rate_hz=source.rate_hz,
            )
        if folder.recognises(path) and any(
            options[key] is not None for key in ("times", "columns", "rate_hz")
        ):
            _refuse(options, ("frame",), path, "a folder of pictures")
            return folder.open_folder(
                path,
                times=source.times,
                columns=source.columns,
                rate_hz=source.rate_hz,
                start_ns=source.start_ns or 0,
            )
        own = ("times", "start_ns", "rate_hz", "columns", "frame")
        _refuse(options, own, path, "a log with pictures of its own")
        return open_log(path)
    is_table = columns.recognises(path)
    if (source.columns is not None and (is_table or source.units() is None)) or source.frame is not None:
        if not path.is_file() or (source.columns is None and not is_table):
            _refuse(options, ("columns", "frame"), path, "a log with columns and axes of its own")
        return columns.open_columns(path, source.columns, source.frame)
    return open_log(path)


def medium_of(path: Path, source: StreamSource) -> Medium:
    """Determine the medium of a stream from the beginning of its file."""
    if source.frame is not None or (source.columns is not None and source.units() is None):
        return Medium.TABLE
    try:
        module = format_of(path)
    except InputError:
        return Medium.LOG
    return {"fusion.logs.asl": Medium.FOLDER, "fusion.logs.csv.columns": Medium.TABLE}.get(
        module or "", Medium.LOG
    )


def on_flights_clock(t_ns: TimeArray, source: StreamSource) -> TimeArray:
    """Return times (n,) of a file on the flight's clock; the same array if nothing changes."""
    shift_ns = round(source.clock_offset_s * 1e9)
    if source.clock_rate != 1.0:
        t_ns = at_rate(t_ns, source.clock_rate)
    return t_ns + shift_ns if shift_ns else t_ns


def converted(stream: AnyStream, kind: Kind, columns: ColumnMap) -> AnyStream:
    """Convert a stream whose numbers are not in the units of the log's format."""
    scaled: Any = stream
    if isinstance(stream, ImuStream):
        accel_unit = in_si(columns.accel_unit) * columns.accel_sign
        scaled = replace(
            stream,
            gyro_rad_s=stream.gyro_rad_s * in_si(columns.gyro_unit),
            accel_m_s2=stream.accel_m_s2 * accel_unit,
        )
    elif isinstance(stream, VectorStream):
        unit = columns.velocity_unit if kind is Kind.VELOCITY else columns.position_unit
        scaled = replace(stream, xyz=stream.xyz * in_si(unit))
    elif isinstance(stream, RangeStream):
        scaled = replace(stream, distance_m=stream.distance_m * in_si(columns.range_unit))
    result: AnyStream = scaled
    return result


def _refuse(options: Mapping[str, object], keys: tuple[str, ...], path: Path, what: str) -> None:
    for key in keys:
        if options[key] is not None:
            raise InputError(f"is {what}: {key} does not go with it", file=path, remedy=f"take {key} away")
