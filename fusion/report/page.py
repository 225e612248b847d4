"""The report's page: values for the template, in words and convenient units."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from math import degrees, isfinite
from pathlib import Path
from typing import Any

import numpy as np

from fusion.estimator.smoothed_table import half_widths_m
from fusion.evaluation.checks import run_checks
from fusion.evaluation.checks_input import all_problems
from fusion.evaluation.errors import evaluate
from fusion.evaluation.verdict import overall, worst_first
from fusion.files import replacing
from fusion.flight import Flight
from fusion.report import drawing, plots
from fusion.report.interactive import page_data, script
from fusion.report.strip import DrawnFrame, choose_frames, show_frames
from fusion.report.svg import Drawing, Panel, draw
from fusion.report.template import render
from fusion.result.result import FusionResult
from fusion.result.summary import CorridorErrors, Level, TableErrors
from fusion.result.table_rows import lateral_unknown_share, lateral_unknown_text
from fusion.settings.toml import description_of
from vision.measurement import REASON_MEANING, Reason

TIMING_WORDS = {
    "vision_s": ("Reading and measuring all pictures", "s"),
    "filter_s": ("Filter", "s"),
    "smoother_s": ("Smoother", "s"),
    "total_s": ("Fusing in all", "s"),
    "times_real_time": ("Against real time", "times as fast"),
    "compile_s": ("Compiling, once", "s"),
}
VERDICT_WORDS = {
    Level.PASS: "Verdict: pass. Heading and offset can be used",
    Level.WARN: "Verdict: warn. Read the warnings before use",
    Level.FAIL: "Verdict: fail. Do not rely on this flight",
    Level.NOT_JUDGED: "Verdict: not judged",
}


@dataclass(frozen=True, slots=True)
class Figure:
    """A plot on the page."""

    name: str
    title: str
    text: str
    drawing: Drawing
    panels: tuple[Panel, ...]


@dataclass(frozen=True, slots=True)
class Caption:
    """The caption of a frame."""

    shown: DrawnFrame
    accepted: bool
    verdict: str
    vision: str
    filtered: str
    heading_deg: float | None
    offset_norm: float | None


def render_report(result: FusionResult, flight: Flight, provenance: Mapping[str, Any] | None = None) -> str:
    """Return the page as text; see `fusion.report.write_report`."""
    checks = run_checks(result, flight)
    level = overall(checks)
    drawn = figures(result, flight)
    code, style = script()
    context = {
        "name": result.flight_name,
        "made": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "level": level,
        "verdict": VERDICT_WORDS[level],
        "checks": worst_first(checks),
        "concerns": [check.name for check in worst_first(checks) if check.level in (Level.FAIL, Level.WARN)],
        "facts": facts(result, flight),
        "figures": drawn,
        "data": page_data(result, flight, {figure.name: figure.panels for figure in drawn}),
        "script": code,
        "script_style": style,
        "statuses": status_shares(result),
        "errors": error_rows(result, flight),
        "strip": [
            _caption(shown, result) for shown in show_frames(result, flight, choose_frames(result, flight))
        ],
        "reasons": reason_counts(result),
        "settings": settings(result),
        "problems": all_problems(result, flight),
        "timings": timings(result),
        "provenance": provenance_rows(provenance or {}),
        "inputs": (provenance or {}).get("inputs", []),
    }
    return render("fusion.report", "page.html.j2", context)


def replace_text(path: str | Path, text: str) -> None:
    """Write the report completely, or leave an earlier one unchanged."""
    with replacing(Path(path)) as draft:
        draft.write_text(text, encoding="utf-8", errors="backslashreplace")


def facts(result: FusionResult, flight: Flight) -> list[tuple[str, str, str]]:
    """Return the headline numbers: (name, number, remark)."""
    table, frames = result.estimates, result.frames
    tracking = table["status"] == "tracking"
    found = []
    if flight.truth is not None:
        filtered, smooth = (evaluate(t, flight.truth) for t in (table, result.smoothed))
        remark = f"RMSE of the filter; smoother {_degrees(smooth.heading.rmse)}"
        found.append(("Heading error", _degrees(filtered.heading.rmse), remark))
        metres, smooth_m = filtered.lateral_offset_m, smooth.lateral_offset_m
        if metres is not None and metres.rmse is not None:
            remark = f"RMSE of the filter; smoother {_centimetres(smooth_m.rmse if smooth_m else None)}"
            found.append(("Offset error", _centimetres(metres.rmse), remark))
    elif tracking.any():
        sigma = float(np.median(table["heading_std_rad"][tracking]))
        found.append(("Heading sigma", _degrees(sigma), "median while tracking; no ground truth"))
        sigma_m, sigma_norm = (
            float(np.median(table[name][tracking]))
            for name in ("lateral_offset_std_m", "lateral_offset_norm_std")
        )
        if isfinite(sigma_m):
            found.append(("Offset sigma", _centimetres(sigma_m), "median while tracking"))
        elif isfinite(sigma_norm):
            found.append(("Offset sigma", _percent(sigma_norm), "of half the corridor's width"))
    if len(frames):
        used = int(np.count_nonzero(frames["accepted"]))
        found.append(("Frames used", f"{used / len(frames):.1%}", f"{used} of {len(frames)}"))
    if len(table) > 1:
        length = (int(table["timestamp_ns"][-1]) - int(table["timestamp_ns"][0])) / 1e9
        corridors = int(table["corridor_index"].max()) + 1 - int(table["corridor_index"].min())
        remark = f"{corridors} corridor{'s' if corridors != 1 else ''}"
        found.append(("Flight", f"{length:.1f} s", f"{remark}, tracking for {np.mean(tracking):.0%}"))
    return found


def figures(result: FusionResult, flight: Flight) -> list[Figure]:
    """Draw all plots for which the flight has data."""
    found: list[Figure] = []

    def add(name: str, title: str, text: str, *panels: Panel) -> None:
        found.append(Figure(name, title, text, draw(name, title, panels), panels))

    if not len(result.estimates):
        return found
    text = (
        "Angle from the corridor's axis, positive right. Frames outside the scale are not drawn. "
        "A thick line at the edge means that the filter is outside the scale."
    )
    add("heading", "Heading", text, partial(plots.plot_heading, result=result, flight=flight))
    unknown = lateral_unknown_text(lateral_unknown_share(result.estimates))
    text = f"Distance from the centre line, positive right. It is {unknown}."
    add("offset", "Lateral offset", text, partial(plots.plot_offset, result=result, flight=flight))
    if np.isfinite(result.frames["test_ratio"]).any():
        text = (
            "Heading of each frame less its prediction, and the test ratio: innovation squared over gate squared. "
            "Frames above 1 are rejected. Values outside the scale are drawn at its edge."
        )
        panels = (
            partial(plots.plot_innovations, result=result),
            partial(plots.plot_test_ratio, result=result),
        )
        add("innovations", "Innovations", text, *panels)
    states = []
    if flight.imu is not None and np.isfinite(result.estimates["gyro_bias_rad_s"]).any():
        states.append(partial(plots.plot_gyro_bias, result=result))
    if flight.attitude is not None and np.isfinite(result.estimates["imu_yaw_offset_rad"]).any():
        states.append(partial(plots.plot_imu_yaw_offset, result=result))
    if states:
        text = "The gyroscope's bias and the offset of the vehicle's own yaw, as estimated by the filter."
        add("states", "Bias and offset", text, *states)
    if flight.truth is not None:
        errors = (plots.plot_heading_error, plots.plot_offset_error)
        text = (
            "Estimate less truth, outside junctions; the table is for rows that are tracking. NEES is the mean of "
            "(error / sigma) squared, 1 for a consistent filter; the band should contain 95 % of the line. "
            "Percentages are of half the corridor's width. A thick line at the edge means that the filter is outside "
            "the scale."
        )
        add(
            "errors",
            "Errors against truth",
            text,
            *(partial(e, result=result, truth=flight.truth) for e in errors),
        )
    return found


def status_shares(result: FusionResult) -> list[tuple[str, float]]:
    """Return the share of rows in each status, in the order of the plots' key."""
    status = result.estimates["status"]
    if not len(status):
        return []
    return [
        (word, float(np.mean(status == word))) for word in drawing.STATUS_COLOUR if np.any(status == word)
    ]


def error_rows(result: FusionResult, flight: Flight) -> list[tuple[str, list[str]]]:
    """Return the table of errors: a name and its cells, in the order of the template's columns."""
    if flight.truth is None:
        return []
    rows = []
    half = half_widths_m(result.estimates, result.config)
    half_m = float(half[0]) if np.ptp(half) == 0.0 else None  # the same in all corridors; NaN: unknown
    for name, table in (
        ("Filter", result.estimates),
        ("Smoother", result.smoothed),
        ("Frames alone", result.frames),
    ):
        found = evaluate(table, flight.truth)
        rows.append((name, _error_cells(found, half_m)))
        if len(found.corridors) > 1:
            rows += [(f"{name}, corridor {k}", _error_cells(c, half_m)) for k, c in found.corridors.items()]
    return rows


def _error_cells(found: TableErrors | CorridorErrors, half_m: float | None) -> list[str]:
    """Format errors in degrees and, if the width is known, in centimetres; single frames have no metres."""
    heading, metres, norm = found.heading, found.lateral_offset_m, found.lateral_offset_norm
    cells = [_degrees(value) for value in (heading.rmse, heading.mae, heading.p95, heading.max)]
    cells.append("" if heading.nees_mean is None else f"{heading.nees_mean:.2f}")
    if metres is not None and metres.rmse is not None:
        return cells + [_centimetres(value) for value in (metres.rmse, metres.mae, metres.max)]
    if norm is None:
        return [*cells, "", "", ""]
    if half_m is not None:
        return cells + [
            _centimetres(None if value is None else half_m * value)
            for value in (norm.rmse, norm.mae, norm.max)
        ]
    return cells + [_percent(value) for value in (norm.rmse, norm.mae, norm.max)]


def reason_counts(result: FusionResult) -> list[tuple[str, str, int, float]]:
    """Return (reason, its meaning, frames, share), the most frequent first."""
    words, counts = np.unique(result.frames["reason"], return_counts=True)
    order = np.argsort(-counts, kind="stable")
    total = max(len(result.frames), 1)
    return [
        (str(words[k]), REASON_MEANING[Reason(words[k])], int(counts[k]), float(counts[k] / total))
        for k in order
    ]


def settings(result: FusionResult) -> list[tuple[str, str, str, bool]]:
    """Return (name, value, meaning, changed) for every setting of the configuration."""
    fields = type(result.config).model_fields
    found = []
    for name, value in result.config.model_dump().items():
        field = fields[name]
        text = "not set" if value is None else f"{value:.6g}" if isinstance(value, float) else str(value)
        if name.endswith(("_rad", "_rad_s")) and isinstance(value, float):
            text += f" ({degrees(value):.4g}°{'/s' if name.endswith('_s') else ''})"
        found.append((name, text, description_of(field), value != field.default))
    return found


def provenance_rows(provenance: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return (name, value) of the program, command and camera of the output."""
    if not provenance:
        return []
    rows = [("Version", f"{provenance['version']}, Python {provenance['python']}")]
    if provenance["command"]:
        rows.append(("Command", provenance["command"]))
    camera = provenance["camera"]
    width, height = camera["size_px"]
    fx, fy, cx, cy = (f"{value:.2f}" for value in (*camera["focal_px"], *camera["centre_px"]))
    lens = f"{camera['distortion']} ({', '.join(f'{value:.4g}' for value in camera['coefficients'])})"
    rows.append(("Camera", f"{width}x{height} px, focal length {fx}, {fy} px, centre {cx}, {cy} px, {lens}"))
    return rows


def timings(result: FusionResult) -> list[tuple[str, str]]:
    """Return the timings in the summary, and those of measuring a picture."""
    found = []
    values = {} if result.overview.timings is None else result.overview.timings.to_dict()
    for name, (words, unit) in TIMING_WORDS.items():
        if values.get(name) is not None:
            found.append((words, f"{values[name]:.3g} {unit}"))
    milliseconds = result.frames["vision_ms"]
    milliseconds = milliseconds[np.isfinite(milliseconds)]
    if milliseconds.size:
        p50, p95, worst = np.percentile(milliseconds, (50, 95, 100))
        found.append(
            (
                "Measuring a picture",
                f"{p50:.1f} ms median, {p95:.1f} ms 95th percentile, {worst:.1f} ms longest",
            )
        )
    return found


def _caption(shown: DrawnFrame, result: FusionResult) -> Caption:
    record = result.frames[shown.row]
    reason = str(record["reason"])
    heading, sigma = float(record["heading_rad"]), float(record["heading_std_rad"])
    vision = "no heading"
    if isfinite(heading):
        vision = f"{_sided(degrees(heading), '°')} ± {2 * degrees(sigma):.1f}°"
    offset = shown.filter_offset_norm
    filtered = (
        _sided(degrees(shown.filter_heading_rad), "°") if isfinite(shown.filter_heading_rad) else "unknown"
    )
    if isfinite(offset):
        metres = shown.filter_offset_m
        place = _centimetres(abs(metres)) if isfinite(metres) else f"{abs(offset):.0%} of half the width"
        filtered += f", {place} {'right' if offset >= 0 else 'left'} of the centre line"
    return Caption(
        shown=shown,
        accepted=bool(record["accepted"]),
        verdict="used" if record["accepted"] else REASON_MEANING[Reason(reason)],
        vision=vision,
        filtered=filtered,
        heading_deg=degrees(shown.filter_heading_rad) if isfinite(shown.filter_heading_rad) else None,
        offset_norm=max(-1.0, min(1.0, offset)) if isfinite(offset) else None,
    )


def _sided(value: float, unit: str) -> str:
    return f"{abs(value):.1f}{unit} {'right' if value >= 0 else 'left'}"


def _degrees(value_rad: float | None) -> str:
    return "" if value_rad is None else f"{degrees(value_rad):.2f}°"


def _centimetres(value_m: float | None) -> str:
    return "" if value_m is None else f"{100 * value_m:.1f} cm"


def _percent(value: float | None) -> str:
    return "" if value is None else f"{value:.1%}"
