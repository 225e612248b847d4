"""Output of ``corridor fuse``: a fused flight as plain, stable text.

Numbers are from the summary that is written beside the tables; only units are converted here.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import degrees, isnan, nan
from pathlib import Path
from textwrap import wrap

from fusion.cli.evaluate_text import excluded_text
from fusion.evaluation import checks_cause
from fusion.flight import Remark
from fusion.logs.samples import counted
from fusion.printable import printable
from fusion.result.summary import CorridorStretch, ErrorStatistics, FlightErrors, Level, SpeedSummary, Summary
from fusion.result.table_rows import lateral_unknown_text

NAME_WIDTH = 14  # of the names before the lines


def fusion_text(summary: Summary, folder: Path, remarks: Sequence[str] = ()) -> str:
    """Format a fused flight's summary as text: frames, errors, speed, outputs and verdict.

    Parameters
    ----------
    summary
        Of a `fusion.FusionResult`.
    folder
        Folder of the outputs.
    remarks
        Further remarks on the outputs, a line each.
    """
    counts = summary.counts
    frames = counts.frames
    rejected = {word: count for word, count in counts.by_reason.items() if word != "ok"}
    lines = [
        f"{summary.flight}: {summary.duration_s:.1f} s, {counted(frames, 'frame')}, "
        f"{counted(counts.estimates, 'estimate')}, method {summary.method}",
        "",
        _line("frames used", f"{counts.accepted} of {frames} ({_percent(counts.accepted, frames)})"),
        _line("rejected", ", ".join(f"{count} {word}" for word, count in rejected.items()) or "none"),
        _line("status", ", ".join(f"{word} {share:.1%}" for word, share in summary.status_share.items())),
        *_offset_lines(summary.lateral_unknown_share),
        *_corridor_lines(summary.corridors),
        "",
        *_error_lines(summary.errors, summary.config.get("corridor_width_m")),
        "",
        *([_line("speed", _speed(summary.timings))] if summary.timings is not None else []),
        _line("outputs", f"{folder} (open {folder / 'report.html'})"),
        *(_line("", remark) for remark in remarks),
        *(_line("note" if isinstance(text, Remark) else "problem", text) for text in summary.problems),
        "",
        _line("verdict", summary.verdict),
    ]
    for level in (Level.FAIL, Level.WARN):
        for check in summary.checks:
            if check.level == level:
                remedy = f" {check.action}" if check.name == checks_cause.NAME else ""
                text = f"{level}: {check.name}: {check.value}. {check.meaning}{remedy}"
                lines += wrap(text, 100, initial_indent="  ", subsequent_indent="        ")
    return "\n".join(printable(line.rstrip()) for line in lines)


def _line(name: str, text: str) -> str:
    return f"{name:<{NAME_WIDTH}}{text}"


def _percent(part: int, whole: int) -> str:
    return f"{part / whole:.1%}" if whole else "-"


def _offset_lines(unknown_share: Mapping[str, float]) -> list[str]:
    first, *rest = wrap(lateral_unknown_text(unknown_share), 100 - NAME_WIDTH)
    return [_line("offset", first), *(_line("", text) for text in rest)]


def _corridor_lines(corridors: Sequence[CorridorStretch]) -> list[str]:
    if len(corridors) < 2:
        return []
    words: list[str] = []
    for corridor in corridors:
        turn_deg = degrees(corridor.turn_rad)
        side = "right" if turn_deg > 0 else "left"
        turned = f", {abs(turn_deg):.0f} degrees {side} of the first" if words else ""
        words.append(f"{corridor.index} ({counted(corridor.frames, 'frame')}{turned})")
    return [_line("corridors", ", then ".join(words))]


def _speed(timings: SpeedSummary) -> str:
    times, vision_ms = timings.times_real_time, timings.vision_ms_median
    per_frame = "" if vision_ms is None else f", {vision_ms:.1f} ms a frame (median)"
    compiled = "" if timings.compile_s < 0.5 else f"; plus {timings.compile_s:.0f} s of compiling, once"
    total = f"{timings.total_s:.1f} s{per_frame}{compiled}"
    return total if times is None else f"{times:.1f} times real time: {total}"


def _error_lines(errors: FlightErrors | None, width_m: float | None) -> list[str]:
    if errors is None:
        return [_line("errors", "unknown: the flight has no corridor_truth.csv")]
    tables = (("filter", errors.filter), ("smoother", errors.smoothed), ("vision alone", errors.vision))
    in_metres = any(found.lateral_offset_m and found.lateral_offset_m.count for _, found in tables)
    unit = "cm" if in_metres else "% of half width"
    lines = [
        f"{'error':<14}{'heading, degrees':^24}{'lateral offset, ' + unit:^32}",
        f"{'':<14}{'RMSE':>8}{'MAE':>8}{'max':>8}{'RMSE':>16}{'MAE':>8}{'rows judged':>16}",
    ]
    for name, found in tables:
        heading, metres, norm = found.heading, found.lateral_offset_m, found.lateral_offset_norm
        numbers = [_scaled(value, degrees(1.0)) for value in (heading.rmse, heading.mae, heading.max)]
        if in_metres and metres is not None:
            offsets = _offset_cells(metres, 100.0)
        else:  # single frames have no metres; the configured width gives them
            offsets = _offset_cells(norm, 100.0 if not in_metres else 50.0 * width_m if width_m else nan)
        judged = f"{found.judged} of {found.rows}"
        lines.append(
            f"{name:<14}{numbers[0]:>8}{numbers[1]:>8}{numbers[2]:>8}{offsets[0]:>16}{offsets[1]:>8}{judged:>16}"
        )
    left_out = excluded_text(errors.filter)
    return [*lines, _line("not judged", f"{left_out} (rows of the filter)")] if left_out else lines


def _offset_cells(found: ErrorStatistics | None, factor: float) -> tuple[str, str]:
    return ("-", "-") if found is None else (_scaled(found.rmse, factor), _scaled(found.mae, factor))


def _scaled(value: float | None, factor: float) -> str:
    return "-" if value is None or isnan(factor) else f"{value * factor:.2f}"
