"""An inspection in words, for people, and as plain values, for programs."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from math import degrees
from textwrap import wrap
from typing import Any

from fusion.inspection.advice import Matter
from fusion.inspection.findings import CameraFindings, StreamFindings
from fusion.inspection.imu import MAX_STEP_S, MIN_STILL_S, ImuFindings, Noise
from fusion.inspection.log import Inspection
from fusion.inspection.pictures import PictureFindings
from fusion.inspection.times import Gap, Timing
from fusion.logs.plausibility.clocks import UNIX_FROM_NS, UNIX_TO_NS, span_of
from fusion.logs.plausibility.findings import Severity
from fusion.logs.samples import counted
from fusion.printable import printable

WIDTH = 110
ONE_CLOCK_S = 1e6  # streams more than eleven days apart have different clocks
LISTED = 3

_NO_BREAK = "\N{NO-BREAK SPACE}"
_TITLES = {
    Matter.FUSE: "can be fused",
    Matter.MISSING: "missing, or to be corrected first",
    Matter.BETTER: "would help",
}


def inspection_values(inspection: Inspection) -> dict[str, Any]:
    """Return an inspection as plain values: numbers, texts, lists and mappings; names include units."""
    values = asdict(inspection, dict_factory=lambda pairs: {k: v for k, v in pairs if k != "first_picture"})
    for stream in values["streams"]:
        stream["kind"] = str(stream["kind"])
    return values


def inspection_text(inspection: Inspection) -> str:
    """Format an inspection as text."""
    streams = inspection.streams
    start_ns = _start(streams)
    lines = [f"{inspection.path}: {inspection.format}", *_time_lines(streams), ""]
    lines += _table(streams, start_ns)
    decided = {stream.kind for stream in streams if stream.chosen}
    for stream in streams:
        if stream.chosen or stream.kind not in decided:
            lines += _block(stream, list(_described(stream, start_ns)))
    problems = list(_problems(inspection, start_ns))
    if problems:
        lines += ["", "problems", *(line for text in problems for line in _wrapped(text, "  - ", "    "))]
    for matter, title in _TITLES.items():
        texts = [sentence.text for sentence in inspection.advice if sentence.matter is matter]
        if texts:
            lines += ["", title, *(line for text in texts for line in _wrapped(text, "  - ", "    "))]
    return "\n".join(printable(line.rstrip()) for line in lines)


def _wrapped(text: str, first: str, then: str) -> list[str]:
    # keep a number and its unit together
    text = re.sub(r"(?<=\d) (?=(?:s|Hz|px|ms|m/s|degrees)\b)", _NO_BREAK, text)
    lines = wrap(
        text,
        WIDTH,
        initial_indent=first,
        subsequent_indent=then,
        break_long_words=False,
        break_on_hyphens=False,
    )
    return [line.replace(_NO_BREAK, " ") for line in lines]


def _block(stream: StreamFindings, texts: Sequence[str]) -> list[str]:
    if not texts and not stream.note:
        return []
    head = stream.name if stream.name == stream.kind else f"{stream.name}, {stream.kind}"
    lines = ["", *_wrapped(f"{head}: {stream.note}" if stream.note else head, "", "    ")]
    for text in texts:
        lines += _wrapped(text, "  ", "    ")
    return lines


def _times(streams: Sequence[StreamFindings]) -> list[tuple[int, int]]:
    timings = [stream.timing for stream in streams]
    return [(t.first_ns, t.last_ns) for t in timings if t.first_ns is not None and t.last_ns is not None]


def _start(streams: Sequence[StreamFindings]) -> int | None:
    """Return the first time of all; None if the streams are on different clocks."""
    times = _times(streams)
    if not times:
        return None
    first, last = min(t[0] for t in times), max(t[1] for t in times)
    return first if (last - first) * 1e-9 < ONE_CLOCK_S else None


def _time_lines(streams: Sequence[StreamFindings]) -> list[str]:
    times = _times(streams)
    if not times:
        return ["it contains no samples"]
    if _start(streams) is None:
        return ["its streams are on different clocks"]
    first, last = min(t[0] for t in times), max(t[1] for t in times)
    clock = " UTC" if UNIX_FROM_NS < first < UNIX_TO_NS else " after the clock's zero"
    return [f"{(last - first) * 1e-9:.1f} s, {span_of(first, last)}{clock}"]


def _table(streams: Sequence[StreamFindings], start_ns: int | None) -> list[str]:
    if not streams:
        return ["it contains no stream that can be fused"]
    has_frames = any(stream.frames_covered is not None for stream in streams)
    titles = ["", "kind", "samples", "rate", "jitter", "gaps", "longest", "from", "to"]
    rows = [[*titles, *(["frames covered"] if has_frames else [])]]
    for stream in streams:
        t = stream.timing
        row = [
            f"{'*' if stream.chosen else ' '} {stream.name}",
            str(stream.kind),
            str(t.samples),
            "-" if t.rate_hz is None else f"{t.rate_hz:.3g} Hz",
            "-" if t.jitter_s is None else f"{t.jitter_s * 1e3:.1f} ms",
            str(t.gap_count) if t.gap_count else "-",
            f"{t.gaps[0].length_s:.2f} s" if t.gaps else "-",
            _relative(t.first_ns, start_ns),
            _relative(t.last_ns, start_ns),
        ]
        if has_frames:
            row.append("" if stream.frames_covered is None else f"{stream.frames_covered:.0%}")
        rows.append(row)
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    lines = [
        "  ".join(
            cell.ljust(width) if i < 2 else cell.rjust(width)
            for i, (cell, width) in enumerate(zip(row, widths, strict=True))
        )
        for row in rows
    ]
    return [*lines, "(* would be fused)"] if any(stream.chosen for stream in streams) else lines


def _relative(t_ns: int | None, start_ns: int | None) -> str:
    if t_ns is None:
        return "-"
    return f"{(t_ns - (start_ns or 0)) * 1e-9:.2f} s"


def _described(stream: StreamFindings, start_ns: int | None) -> Iterator[str]:
    if stream.pictures is not None:
        yield _pictures(stream.pictures, stream.timing)
    if stream.camera is not None:
        yield _camera(stream.camera)
    if stream.imu is not None:
        yield from _imu(stream.imu, start_ns, is_judged=_is_judged(stream.timing))
    if stream.distances_m is not None:
        least_m, usual_m, most_m = stream.distances_m
        yield (
            f"{least_m:.2f} to {most_m:.2f} m above the floor, median {usual_m:.2f} m: used for offsets in metres if "
            "neither corridor_width_m nor camera_height_m is given"
        )


def _is_judged(timing: Timing) -> bool:
    """Whether an IMU's log is long and dense enough to detect still periods."""
    return (timing.rate_hz or 0.0) * MAX_STEP_S >= 1.0 and timing.duration_s >= MIN_STILL_S


def _pictures(found: PictureFindings, timing: Timing) -> str:
    if found.first_index is None:
        return f"none of the first {counted(found.sampled, 'picture')} decodes"
    sizes = " and ".join(f"{width}x{height}" for width, height in found.sizes)
    bad = (
        f", {found.unreadable} of which {'does' if found.unreadable == 1 else 'do'} not decode"
        if found.unreadable
        else ""
    )
    which = (
        "the first" if found.first_index == 0 else f"number {found.first_index + 1}, the first that decodes,"
    )
    return (
        f"pictures of {sizes} pixels ({found.sampled} of {timing.samples} read{bad}); {which} has a brightness of "
        f"{found.brightness:.0f} and a contrast of {found.contrast:.0f}, of 255"
    )


def _camera(camera: CameraFindings) -> str:
    directions = [
        f"{abs(angle):.1f} degrees {words[0] if angle > 0 else words[1]}"
        for angle, words in (
            (camera.looks_right_deg, ("right", "left")),
            (camera.looks_up_deg, ("up", "down")),
        )
        if abs(angle) >= 0.05
    ]
    looks = "looks " + (" and ".join(directions) if directions else "straight ahead")
    if camera.mount_assumed:
        looks = "mounting unknown"
    return (
        f"calibration for {camera.width_px}x{camera.height_px}: focal length {camera.fx_px:.1f} px, "
        f"field of view {camera.horizontal_fov_deg:.0f} degrees, distortion {camera.distortion}, {looks}"
    )


def _imu(imu: ImuFindings, start_ns: int | None, *, is_judged: bool) -> Iterator[str]:
    if imu.still:
        periods = ", ".join(
            f"{_relative(p.start_ns, start_ns)} to {_relative(p.end_ns, start_ns)}"
            for p in imu.still[:LISTED]
        )
        more = f" and {len(imu.still) - LISTED} more" if len(imu.still) > LISTED else ""
        yield f"at rest for {imu.still_total_s:.1f} s: {periods}{more}"
    elif is_judged:
        yield "never at rest for two seconds"
    noise, when, bound = (
        (imu.in_flight, "in motion", "at most ") if imu.at_rest is None else (imu.at_rest, "at rest", "")
    )
    noise_text = _noise(noise, bound)
    if noise_text:
        declared = (
            "" if imu.declared_gyro_noise is None else f"; declared gyroscope {imu.declared_gyro_noise:.2g}"
        )
        yield f"white noise {when}: {noise_text}{declared}"
    if imu.gyro_bias_rad_s is not None:
        bias = ", ".join(f"{round(degrees(axis), 2) + 0.0:+.2f}" for axis in imu.gyro_bias_rad_s)
        yield f"gyroscope's bias at rest ({bias}) degrees/s"
    turn = degrees(imu.fastest_rad_s)
    gravity = ""
    if imu.gravity_m_s2 is not None:
        gravity = f"gravity at rest {imu.gravity_m_s2:.2f} m/s^2; "
    if imu.usual_accel_m_s2 is not None:
        axes = ", ".join(f"{round(axis, 1) + 0.0:+.1f}" for axis in imu.usual_accel_m_s2)
        gravity += f"median specific force ({axes}) m/s^2 forward, right, down; "
    yield f"{gravity}turns up to {turn:.{0 if turn >= 10 else 1}f} degrees/s"


def _noise(noise: Noise, bound: str) -> str:
    parts = []
    if noise.gyro is not None:
        parts.append(f"gyroscope {bound}{noise.gyro:.2g} rad/s/sqrt(Hz)")
    if noise.accel is not None:
        parts.append(f"accelerometer {bound}{noise.accel:.2g} m/s^2/sqrt(Hz)")
    return ", ".join(parts)


def _problems(inspection: Inspection, start_ns: int | None) -> Iterator[str]:
    yield from inspection.problems
    for stream in inspection.streams:
        if stream.error is not None:
            yield f"{stream.name} cannot be read: {stream.error}"
        for text in stream.problems:
            yield text if stream.name in text else f"{stream.name}: {text}"
        yield from _timing_problems(stream, start_ns)
    for finding in inspection.findings:
        # errors are listed under the required corrections, jumps with the stream's other times
        if finding.severity is Severity.WARNING and finding.kind != "time_jump":
            yield finding.sentence


def _timing_problems(stream: StreamFindings, start_ns: int | None) -> Iterator[str]:
    t = stream.timing
    if t.jump_count:
        jumps = ", ".join(
            f"{jump.length_s:+.1f} s at {_relative(jump.after_ns, start_ns)}" for jump in t.jumps[:LISTED]
        )
        yield f"{stream.name}: the clock jumps {counted(t.jump_count, 'time')} ({jumps})"
    if t.gap_count:
        total = f"{counted(t.gap_count, 'gap')}, {t.gap_total_s:.2f} s in all"
        yield f"{stream.name}: {total} ({_gaps(t.gaps, start_ns)})"
    read = " ".join(stream.problems)
    if t.repeated and "repeated" not in read:
        yield f"{stream.name}: {counted(t.repeated, 'sample')} with a repeated time"
    if t.backwards and "backwards" not in read:
        yield f"{stream.name}: the times go backwards in {counted(t.backwards, 'place')}"


def _gaps(gaps: Sequence[Gap], start_ns: int | None) -> str:
    listed = ", ".join(
        f"{gap.length_s:.2f} s at {_relative(gap.after_ns, start_ns)}" for gap in gaps[:LISTED]
    )
    return f"the longest {listed}"
