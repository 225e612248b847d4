"""Video of a fused flight: each picture with its lines and vanishing point, above the filter's estimate."""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from math import degrees, isfinite
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from fusion.flight import Flight
from fusion.progress import Progress
from fusion.report.remeasure import delay_ns, measure_frame_again
from fusion.result.result import FusionResult
from fusion.result.table_rows import row_before
from vision.errors import InputError
from vision.measurement import FrameMeasurement, Reason
from vision.overlay import draw_overlay
from vision.types import ColourImage

TIME_BASE = Fraction(1, 90_000)  # of video containers
QUALITY = "23"  # x264's constant rate factor
STATUS_COLOUR = {"tracking": (233, 180, 86), "coasting": (66, 228, 240), "lost": (60, 130, 255)}
PAPER, INK = (32, 28, 26), (238, 238, 238)


def write_video(result: FusionResult, flight: Flight, path: Path, progress: Progress | None = None) -> None:
    """Write an MP4 file with a picture per camera frame, at the frames' times.

    Parameters
    ----------
    result, flight
        Result of `fusion.fuse_flight`, and its flight.
    path
        The file.
    progress
        Called with (done, total) pictures.

    Raises
    ------
    InputError
        If no picture of the flight can be read.
    """
    import av

    codec = "libx264" if "libx264" in av.codecs_available else "mpeg4"
    stream: Any = None
    with av.open(str(path), "w", format="mp4") as container:
        for t_ns, canvas in _pictures(result, flight, progress):
            if stream is None:
                stream = container.add_stream(codec)
                stream.height, stream.width = canvas.shape[0] // 2 * 2, canvas.shape[1] // 2 * 2
                stream.pix_fmt, stream.time_base = "yuv420p", TIME_BASE
                stream.codec_context.time_base = TIME_BASE
                stream.options = {"crf": QUALITY}
            frame = av.VideoFrame.from_ndarray(
                np.ascontiguousarray(canvas[: stream.height, : stream.width]), format="bgr24"
            )
            frame.pts, frame.time_base = round((t_ns - result.origin_ns) * 1e-9 / TIME_BASE), TIME_BASE
            container.mux(stream.encode(frame))
        if stream is None:
            raise InputError("no picture of the flight can be read", remedy="leave out --export video")
        container.mux(stream.encode())


def _pictures(
    result: FusionResult, flight: Flight, progress: Progress | None
) -> Iterator[tuple[int, ColourImage]]:
    """Yield time and drawing of each frame whose picture can be decoded."""
    table, total = result.estimates, len(result.frames)
    for row, stamp_ns in enumerate(result.frames["timestamp_ns"].tolist()):
        seen = measure_frame_again(result, flight, row)
        if seen is not None:
            measurement = seen.measurement or FrameMeasurement(
                False, Reason(str(result.frames["reason"][row]))
            )
            canvas = draw_overlay(seen.image, flight.camera, measurement)
            estimate = table[row_before(table, stamp_ns - delay_ns(result))]
            yield stamp_ns, np.vstack([canvas, _caption(estimate, result.origin_ns, canvas.shape[1])])
        if progress is not None:
            progress(row + 1, total)


def _caption(estimate: np.void, origin_ns: int, width_px: int) -> ColourImage:
    """Draw the filter's estimate on a strip of the picture's width."""
    unit = width_px / 640.0
    strip = np.full((round(30 * unit), width_px, 3), PAPER, dtype=np.uint8)
    status = str(estimate["status"])
    seconds = (int(estimate["timestamp_ns"]) - origin_ns) * 1e-9
    words = f"{seconds:6.2f} s  filter: {_words(estimate)}"
    at = (round(10 * unit), round(20 * unit))
    face, scale, thickness = cv2.FONT_HERSHEY_SIMPLEX, 0.48 * unit, max(1, round(unit))
    cv2.putText(strip, words, at, face, scale, INK, thickness, cv2.LINE_AA)
    (length, _), _ = cv2.getTextSize(status, face, scale, thickness)
    colour = STATUS_COLOUR.get(status, INK)
    cv2.putText(
        strip, status, (width_px - length - at[0], at[1]), face, scale, colour, thickness, cv2.LINE_AA
    )
    return strip


def _words(estimate: np.void) -> str:
    if estimate["status"] == "initialising":
        return "no heading yet"
    heading, std = degrees(float(estimate["heading_rad"])), degrees(float(estimate["heading_std_rad"]))
    parts = [f"{abs(heading):.1f} deg {'right' if heading >= 0 else 'left'} +- {std:.1f}"]
    for unit in ("m", "norm"):
        offset, offset_std = float(estimate[f"lateral_offset_{unit}"]), float(estimate[_std_name(unit)])
        if isfinite(offset):
            name = "m" if unit == "m" else "half widths"
            parts.append(f"{abs(offset):.2f} {name} {'right' if offset >= 0 else 'left'} +- {offset_std:.2f}")
            break
    return ", ".join(parts)


def _std_name(unit: str) -> str:
    return "lateral_offset_std_m" if unit == "m" else "lateral_offset_norm_std"
