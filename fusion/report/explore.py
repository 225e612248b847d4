"""The flight to zoom into: what the report's script needs, thinned to what a screen can show.

The plots are uPlot's (MIT licence, 51 kB): Plotly and Bokeh are 1 to 4 MB each, and most of a report would be theirs.
Without scripts the section stays hidden, and the page is complete.
"""

from __future__ import annotations

import base64
from collections.abc import Iterator
from importlib.resources import files
from math import isfinite
from typing import Any

import cv2
import numpy as np

from fusion.estimator.smoothed_table import half_widths_m
from fusion.evaluation.errors import interpolate_truth
from fusion.flight import Flight, FloatArray
from fusion.report.remeasure import measure_frame_again
from fusion.report.series import IndexArray, envelope_indices
from fusion.result.result import FusionResult
from vision.overlay import draw_overlay

BINS = 600  # of the time axis
MAX_PICTURES, LEAST_APART_S = 120, 0.25
PICTURE_WIDTH_PX, JPEG_QUALITY = 320, 60


def explore_data(result: FusionResult, flight: Flight) -> dict[str, Any] | None:
    """Return series and pictures for the script, ready for JSON; None where there is nothing to show.

    Returns
    -------
    dict or None
        ``plots``: title, unit, and named series by their colour's CSS name, each as long as ``t_s``; None stands for
        unknown numbers. ``pictures``: time, words and data URI of some frames, in order of time.
    """
    if len(result.estimates) < 2:
        return None
    table, smooth = result.estimates, result.smoothed
    metres = bool(np.isfinite(table["lateral_offset_m"]).any())
    unit = "m" if metres else "norm"
    offset_std = "lateral_offset_std_m" if metres else "lateral_offset_norm_std"
    t_s = (table["timestamp_ns"] - result.origin_ns) / 1e9
    keep = np.unique(
        np.concatenate(
            [envelope_indices(t_s, table[name], BINS) for name in ("heading_rad", f"lateral_offset_{unit}")]
        )
    )
    frame_rows = _nearest_rows(t_s[keep], (result.frames["timestamp_ns"] - result.origin_ns) / 1e9)
    scales = {"heading_rad": np.full(len(table), 180 / np.pi), f"lateral_offset_{unit}": np.ones(len(table))}
    seen = {
        "heading_rad": np.degrees(result.frames["heading_rad"]),
        f"lateral_offset_{unit}": result.frames["lateral_offset_norm"]
        * (_half_at_frames(result) if metres else 1.0),
    }
    plots = []
    for name, std, title, shown_unit in (
        ("heading_rad", "heading_std_rad", "Heading", "degrees right"),
        (
            f"lateral_offset_{unit}",
            offset_std,
            "Lateral offset",
            "m right" if metres else "half widths right",
        ),
    ):
        scale = scales[name][keep]
        values, sigma = table[name][keep] * scale, table[std][keep] * scale
        sigma = np.where(table["status"][keep] == "initialising", np.nan, sigma)
        at_frames = np.full(len(keep), np.nan)
        at_frames[frame_rows] = seen[name]
        series = [
            {"name": "low", "colour": "filter", "values": _plain(values - 2 * sigma)},
            {"name": "high", "colour": "filter", "values": _plain(values + 2 * sigma)},
            {"name": "frames", "colour": "vision", "values": _plain(at_frames)},
            {"name": "filter", "colour": "filter", "values": _plain(values)},
            {"name": "smoother", "colour": "smoothed", "values": _plain(smooth[name][keep] * scale)},
        ]
        if flight.truth is not None:
            truth = interpolate_truth(flight.truth, table["timestamp_ns"][keep])
            true = truth.heading_rad if name == "heading_rad" else getattr(truth, name)
            series.append({"name": "truth", "colour": "ink", "values": _plain(true * scale)})
        plots.append({"title": title, "unit": shown_unit, "series": series})
    return {"t_s": _plain(t_s[keep], 3), "plots": plots, "pictures": list(_pictures(result, flight))}


def script(name: str) -> str:
    """Return a script or style that is inlined into the page."""
    return files("fusion.report").joinpath(name).read_text(encoding="utf-8")


def _nearest_rows(t_s: FloatArray, at_s: FloatArray) -> IndexArray:
    """Row (m,) of the times t_s (n,) that is nearest to each of at_s (m,)."""
    after = np.clip(np.searchsorted(t_s, at_s), 1, len(t_s) - 1)
    return np.asarray(after - (at_s - t_s[after - 1] < t_s[after] - at_s), dtype=np.int64)


def _half_at_frames(result: FusionResult) -> FloatArray:
    """Half the corridor's width (m,) at the frames, metres."""
    half = half_widths_m(result.estimates, result.config)
    rows = np.searchsorted(result.estimates["timestamp_ns"], result.frames["timestamp_ns"], side="right") - 1
    return np.asarray(half[np.clip(rows, 0, None)])


def _plain(values: FloatArray, decimals: int = 4) -> list[float | None]:
    return [round(v, decimals) if isfinite(v) else None for v in values.tolist()]


def _pictures(result: FusionResult, flight: Flight) -> Iterator[dict[str, Any]]:
    """Measure some frames again, evenly over the flight, and draw them small."""
    frames = result.frames
    if not len(frames):
        return
    t_s = (frames["timestamp_ns"] - result.origin_ns) / 1e9
    apart_s = max(LEAST_APART_S, float(t_s[-1] - t_s[0]) / MAX_PICTURES)
    last_s = -np.inf
    for row, time_s in enumerate(t_s.tolist()):
        if time_s - last_s < apart_s - 1e-6:
            continue
        seen = measure_frame_again(result, flight, row)
        if seen is None or seen.measurement is None:
            continue
        last_s = time_s
        drawn = draw_overlay(seen.image, flight.camera, seen.measurement, footer=False)
        size = (PICTURE_WIDTH_PX, round(drawn.shape[0] * PICTURE_WIDTH_PX / drawn.shape[1]))
        small = cv2.resize(drawn, size, interpolation=cv2.INTER_AREA)
        ok, data = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
        if ok:
            uri = "data:image/jpeg;base64," + base64.b64encode(data.tobytes()).decode()
            used = "used" if frames["accepted"][row] else f"refused: {frames['reason'][row]}"
            yield {"t_s": round(time_s, 3), "words": used, "uri": uri}
