"""A fused flight as one MCAP file: pictures, their measurements, frames, estimates and events on one time line."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from heapq import merge
from pathlib import Path
from typing import Any

import numpy as np

from fusion.estimator.tables import Table
from fusion.flight import Flight
from fusion.outputs import foxglove
from fusion.progress import Progress
from fusion.report.remeasure import measure_frame_again
from fusion.result.conventions import Frame, summary_in_frame, table_in_frame
from fusion.result.result import FusionResult
from fusion.result.summary_json import summary_json
from vision.errors import InputError

JPEG_QUALITY = 85
Event = tuple[int, int, str, Callable[[], dict[str, Any] | None]]
"""Time, rank among events of equal time, topic, and the message, created on demand."""

IMAGE, OVERLAY, FRAME, ESTIMATE, SMOOTHED, LOG = (
    "/camera/image",
    "/camera/overlay",
    "/corridor/frame",
    "/corridor/estimate",
    "/corridor/smoothed",
    "/log",
)


def write_mcap(
    result: FusionResult,
    flight: Flight,
    path: Path,
    frame: Frame,
    facts: Mapping[str, str],
    progress: Progress | None = None,
) -> None:
    """Write the file; pictures are read, measured and encoded one by one.

    Parameters
    ----------
    result, flight
        Result of `fusion.fuse_flight`, and its flight.
    path
        The file.
    frame
        Sign convention of the numbers.
    facts
        Metadata of the file.
    progress
        Called with (done, total) frames.

    Raises
    ------
    InputError
        If times are negative, which the format does not support.
    """
    from mcap.writer import Writer

    tables = {
        FRAME: table_in_frame(result.frames, frame),
        ESTIMATE: table_in_frame(result.estimates, frame),
        SMOOTHED: table_in_frame(result.smoothed, frame),
    }
    first_ns = min((int(table["timestamp_ns"][0]) for table in tables.values() if len(table)), default=0)
    if first_ns < 0:
        raise InputError(
            f"times from {first_ns} ns cannot be written as MCAP, whose times begin at zero",
            remedy="leave out --export mcap, or shift the log's clock",
        )
    with path.open("wb") as file:
        writer: Any = Writer(file)
        writer.start(profile="", library=f"{facts['software']} {facts['software_version']}")
        channels = _register(writer, tables, frame)
        writer.add_metadata("corridor_fusion", dict(facts))
        summary = summary_json(summary_in_frame(result.summary, frame)).encode()
        writer.add_attachment(first_ns, first_ns, "summary.json", "application/json", summary)
        pictures = _pictures(result, flight, progress)
        rows = (_rows(table, topic, rank) for rank, (topic, table) in enumerate(tables.items(), 2))
        for t_ns, _, topic, make in merge(pictures, *rows, _events(result), key=lambda event: event[:2]):
            message = make()
            if message is not None:
                data = json.dumps(message, separators=(",", ":"), allow_nan=False).encode()
                writer.add_message(channels[topic], log_time=t_ns, publish_time=t_ns, data=data)
        writer.finish()


def _register(writer: Any, tables: Mapping[str, Table], frame: Frame) -> dict[str, int]:
    title = {FRAME: "corridor_fusion.Frame", ESTIMATE: "corridor_fusion.Estimate"}
    schemas = {
        topic: foxglove.table_schema(name, tables[topic].dtype, frame) for topic, name in title.items()
    }
    schemas |= {
        SMOOTHED: schemas[ESTIMATE],
        IMAGE: foxglove.COMPRESSED_IMAGE,
        OVERLAY: foxglove.IMAGE_ANNOTATIONS,
        LOG: foxglove.LOG,
    }
    known: dict[str, int] = {}
    channels = {}
    for topic, schema in schemas.items():
        name = schema["title"]
        if name not in known:
            known[name] = writer.register_schema(name, "jsonschema", json.dumps(schema).encode())
        channels[topic] = writer.register_channel(topic, "json", known[name])
    return channels


def _pictures(result: FusionResult, flight: Flight, progress: Progress | None) -> Iterator[Event]:
    """Yield each frame's picture and overlay; a frame is measured once, when its picture is written."""
    overlays: dict[int, dict[str, Any]] = {}
    total = len(result.frames)

    def picture(row: int, t_ns: int) -> dict[str, Any] | None:
        seen = measure_frame_again(result, flight, row)
        if progress is not None:
            progress(row + 1, total)
        if seen is None:
            return None
        if seen.measurement is not None:
            overlays[row] = foxglove.overlay_message(t_ns, seen.measurement, seen.image.shape[1])
        return foxglove.image_message(t_ns, seen.image, JPEG_QUALITY)

    for row, stamp in enumerate(result.frames["timestamp_ns"].tolist()):
        yield stamp, 0, IMAGE, partial(picture, row, stamp)
        yield stamp, 1, OVERLAY, partial(overlays.pop, row, None)


def _rows(table: Table, topic: str, rank: int) -> Iterator[Event]:
    names = table.dtype.names or ()
    for start in range(0, len(table), 4096):
        for row in table[start : start + 4096].tolist():
            yield row[0], rank, topic, partial(foxglove.row_message, names, row)


def _events(result: FusionResult) -> Iterator[Event]:
    """Yield the log's messages: changes of status and corridor, and the flight's problems."""
    table = result.estimates
    if not len(table):
        return
    status, corridor = table["status"], table["corridor_index"]
    found = [(int(table["timestamp_ns"][0]), f"problem: {problem}", True) for problem in result.problems]
    found.append((int(table["timestamp_ns"][0]), f"status {status[0]}", False))
    for k in (np.flatnonzero((status[1:] != status[:-1]) | (np.diff(corridor) != 0)) + 1).tolist():
        t_ns = int(table["timestamp_ns"][k])
        if status[k] != status[k - 1]:
            found.append((t_ns, f"status {status[k]}", str(status[k]) in ("coasting", "lost")))
        if corridor[k] != corridor[k - 1]:
            found.append((t_ns, f"corridor {corridor[k]}", False))
    for t_ns, text, bad in found:
        level = foxglove.WARNING if bad else foxglove.INFO
        yield t_ns, 9, LOG, partial(foxglove.log_message, t_ns, text, level)
