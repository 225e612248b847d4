"""A fused flight or a set of pictures in words: what the command line prints, plain and stable.

Numbers come from the summary that is written beside the tables; nothing is computed here but units.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from math import degrees, isnan, nan
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING, Any

from fusion.estimator.tables import Table
from fusion.logs.csv.rows import parse_time
from fusion.logs.samples import counted

if TYPE_CHECKING:
    from fusion.pictures.assumed_camera import AssumedViews
    from fusion.pictures.attitude_file import AttitudeFile


def assumptions_text(
    paths: Sequence[Path], views: AssumedViews | None, attitudes: AttitudeFile | None, method: str
) -> list[str]:
    """Say what `measure_images` takes for granted where it was not told."""
    from vision.frame import UNKNOWN_ATTITUDE

    notes = [] if views is None else views.notes()
    if method == "paper":  # which uses no attitude
        return notes
    level = f"assuming level within about {degrees(UNKNOWN_ATTITUDE.std_rad):.0f} degrees"
    if attitudes is None:
        return [*notes, f"no --attitude: {level}"]
    missing = sum(attitudes.of(path, parse_time(path.stem)) is None for path in paths)
    notes += attitudes.problems
    if missing:
        notes.append(f"{counted(missing, 'picture')} without an attitude in --attitude: {level}")
    return notes


def measured_text(table: Table, out: Path | None, overlay: Path | None) -> str:
    """Say in one line what came of measuring pictures, and where it lies."""
    reasons = Counter(str(reason) for reason in table["reason"])
    parts = [
        f"{reasons.pop('ok', 0)} measured",
        *(f"{count} {reason}" for reason, count in reasons.most_common()),
    ]
    places = [f"table in {out}"] if out is not None else []
    places += [f"drawings in {overlay}"] if overlay is not None else []
    return "; ".join([f"{counted(len(table), 'picture')}: {', '.join(parts)}", *places])


def fusion_text(summary: Mapping[str, Any], folder: Path, remarks: Sequence[str] = ()) -> str:
    """Lay out a fused flight's summary for reading: frames, errors, speed, outputs and verdict.

    Parameters
    ----------
    summary
        Of a `fusion.FusionResult`.
    folder
        Where the outputs lie.
    remarks
        What else is to be known of the outputs, a line each.
    """
    counts, timings = summary["counts"], summary["timings"]
    frames = counts["frames"]
    rejected = {word: count for word, count in counts["by_reason"].items() if word != "ok"}
    lines = [
        f"{summary['flight']}: {summary['duration_s']:.1f} s, {counted(frames, 'frame')}, "
        f"{counted(counts['estimates'], 'estimate')}, method {summary['method']}",
        "",
        _line("frames used", f"{counts['accepted']} of {frames} ({_percent(counts['accepted'], frames)})"),
        _line("rejected", ", ".join(f"{count} {word}" for word, count in rejected.items()) or "none"),
        _line("status", ", ".join(f"{word} {share:.1%}" for word, share in summary["status_share"].items())),
        *_corridor_lines(summary["corridors"]),
        "",
        *_error_lines(summary["errors"], summary["config"]["corridor_width_m"]),
        "",
        _line("speed", _speed(timings)),
        _line("outputs", f"{folder} (open {folder / 'report.html'})"),
        *(_line("", remark) for remark in remarks),
        *(_line("problem", problem) for problem in summary["problems"]),
        "",
        _line("verdict", summary["verdict"]),
    ]
    for level in ("fail", "warn"):
        for check in summary["checks"]:
            if check["level"] == level:
                text = f"{level}: {check['name']}: {check['value']}. {check['meaning']}"
                lines += wrap(text, 100, initial_indent="  ", subsequent_indent="        ")
    return "\n".join(line.rstrip() for line in lines)


def _line(name: str, text: str) -> str:
    return f"{name:<14}{text}"


def _percent(part: int, whole: int) -> str:
    return f"{part / whole:.1%}" if whole else "-"


def _corridor_lines(corridors: Sequence[Mapping[str, Any]]) -> list[str]:
    if len(corridors) < 2:
        return []
    words: list[str] = []
    for corridor in corridors:
        turn_deg = degrees(corridor["turn_rad"])
        side = "right" if turn_deg > 0 else "left"
        turned = f", {abs(turn_deg):.0f} degrees {side} of the first" if words else ""
        words.append(f"{corridor['index']} ({counted(corridor['frames'], 'frame')}{turned})")
    return [_line("corridors", ", then ".join(words))]


def _speed(timings: Mapping[str, Any]) -> str:
    times = timings["times_real_time"]
    vision_ms = timings["vision_ms_median"]
    per_frame = "" if vision_ms is None else f", {vision_ms:.1f} ms a frame (median)"
    total = f"{timings['total_s']:.1f} s{per_frame}"
    return total if times is None else f"{times:.1f} times real time: {total}"


def _error_lines(errors: Mapping[str, Any] | None, width_m: float | None) -> list[str]:
    if errors is None:
        return [_line("errors", "unknown: the flight has no corridor_truth.csv")]
    in_metres = any(errors[source].get("lateral_offset_m", {}).get("count") for source in errors)
    unit = "cm" if in_metres else "% of half width"
    lines = [
        f"{'error':<14}{'heading, degrees':^24}{'lateral offset, ' + unit:^32}",
        f"{'':<14}{'RMSE':>8}{'MAE':>8}{'max':>8}{'RMSE':>16}{'MAE':>8}{'rows judged':>16}",
    ]
    for source, name in (("filter", "filter"), ("smoothed", "smoother"), ("vision", "vision alone")):
        found = errors[source]
        heading = found["heading"]
        numbers = [_scaled(heading[f"{word}_rad"], degrees(1.0)) for word in ("rmse", "mae", "max")]
        if in_metres and "lateral_offset_m" in found:
            offset, kind, factor = found["lateral_offset_m"], "m", 100.0
        else:  # a single frame knows no metres; the configured width turns its share of it into them
            offset, kind = found["lateral_offset_norm"], "norm"
            factor = 100.0 if not in_metres else 50.0 * width_m if width_m else nan
        offsets = [_scaled(offset[f"{word}_{kind}"], factor) for word in ("rmse", "mae")]
        judged = f"{found['judged']} of {found['rows']}"
        lines.append(
            f"{name:<14}{numbers[0]:>8}{numbers[1]:>8}{numbers[2]:>8}{offsets[0]:>16}{offsets[1]:>8}{judged:>16}"
        )
    return lines


def _scaled(value: float | None, factor: float) -> str:
    return "-" if value is None or isnan(factor) else f"{value * factor:.2f}"
