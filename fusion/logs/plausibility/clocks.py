"""Checks whether the streams of a flight run on one clock, in nanoseconds: rates, durations and overlap."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from datetime import UTC, datetime

import numpy as np

from fusion.flight import TimeArray
from fusion.logs.plausibility.findings import Advice, Finding, Severity

UNIX_FROM_NS = 946_684_800 * 10**9  # the year 2000: times since boot are smaller
UNIX_TO_NS = 4_102_444_800 * 10**9  # the year 2100
JUMP_NS = 60_000_000_000  # a minute without a sample
MIN_COVERED = 0.9  # of the frames, by an auxiliary stream

#: Plausible median steps in seconds: shortest and longest of each stream.
STEPS_S = {
    "camera": (5e-4, 5.0),
    "imu": (5e-5, 1.0),
    "attitude": (5e-5, 5.0),
    "velocity": (5e-5, 10.0),
    "position": (5e-5, 10.0),
    "range": (5e-5, 10.0),
}
_UNITS = ((1000.0, "microseconds"), (1e6, "milliseconds"), (1e9, "seconds"))


def examine_clocks(streams: Mapping[str, TimeArray], advice: Advice) -> Iterator[Finding]:
    """Yield implausible properties of the streams' times, by name; ``camera`` is one of them."""
    wrong_unit = False
    for name, t_ns in streams.items():
        for finding in _unit(name, t_ns):
            wrong_unit = True
            yield finding
    for name, t_ns in streams.items():
        yield from _jumps(name, t_ns)
    frames = streams.get("camera")
    if wrong_unit or frames is None or len(frames) == 0:
        return
    for name, t_ns in streams.items():
        if name != "camera" and len(t_ns):
            gap = examine_overlap(name, t_ns, frames, advice)
            if gap is not None:
                yield gap


def _unit(name: str, t_ns: TimeArray) -> Iterator[Finding]:
    if len(t_ns) < 3:
        return
    step_s = float(np.median(np.diff(t_ns))) * 1e-9
    shortest, longest = STEPS_S[name]
    if step_s < shortest:
        unit = next((unit for factor, unit in _UNITS if shortest <= step_s * factor <= longest), None)
        guess = f"these look like {unit}" if unit else "these are not nanoseconds"
        yield Finding(
            Severity.ERROR,
            name,
            "time_unit",
            f"{1.0 / step_s if step_s else np.inf:.3g} samples a second cannot be",
            f"times must be nanoseconds, {guess}",
        )
    elif step_s > longest:
        fits = shortest <= step_s / 1000.0 <= longest / 10.0
        yield Finding(
            Severity.ERROR if fits and step_s > 2.0 * longest else Severity.WARNING,
            name,
            "time_unit",
            f"its samples are {step_s:.3g} s apart",
            "too slow to be of use" + ("; were nanoseconds multiplied by 1000?" if fits else ""),
        )


def _jumps(name: str, t_ns: TimeArray) -> Iterator[Finding]:
    steps = np.diff(t_ns)
    jumps = np.flatnonzero(steps >= JUMP_NS)
    if len(jumps):
        first = int(jumps[0])
        times = "once" if len(jumps) == 1 else f"{len(jumps)} times"
        yield Finding(
            Severity.WARNING,
            name,
            "time_jump",
            f"its clock leaps ahead {times}, first by {steps[first] * 1e-9:.0f} s after {t_ns[first]}",
            "a damaged row, or a clock that was set; cut the log there",
        )


def examine_overlap(name: str, t_ns: TimeArray, frames: TimeArray, advice: Advice) -> Finding | None:
    """Report the share of frames that a stream covers, unless nearly all; an error if none.

    Parameters
    ----------
    name
        Of the stream in a manifest.
    t_ns, frames
        Times (m,) of the stream and (n,) of the frames.
    advice
        Words the remedy for the kind of log.
    """
    inside = float(np.mean((frames >= t_ns[0]) & (frames <= t_ns[-1])))
    if inside >= MIN_COVERED:
        return None
    lag_s = (int(t_ns[0]) - int(frames[0])) * 1e-9
    remedy = advice.clock(name, lag_s)
    if t_ns[0] <= frames[-1] and t_ns[-1] >= frames[0]:
        text = (
            f"it covers {inside:.0%} of the frames: it runs from {span(t_ns)}, the frames from {span(frames)}"
        )
        remedy = "the rest is fused without it; where the clocks differ, `corridor align` finds by how much"
        return Finding(Severity.WARNING, name, "overlap", text, remedy)
    text = f"it runs from {span(t_ns)}, the frames from {span(frames)}: they do not overlap"
    if is_unix(t_ns) != is_unix(frames):
        sides = ("it is", "the frames count") if is_unix(t_ns) else ("the frames are", "it counts")
        text += f", {sides[0]} in Unix time and {sides[1]} from zero"
    return Finding(Severity.ERROR, name, "overlap", text, remedy)


def is_unix(t_ns: TimeArray) -> bool:
    """Whether times count from 1970."""
    return UNIX_FROM_NS < int(t_ns[0]) < UNIX_TO_NS


def span(t_ns: TimeArray) -> str:
    """Return first and last time in words."""
    return span_of(int(t_ns[0]), int(t_ns[-1]))


def span_of(first_ns: int, last_ns: int) -> str:
    """Return a stretch of time in words: dates in UTC for Unix time, else seconds."""
    if not UNIX_FROM_NS < first_ns <= last_ns < UNIX_TO_NS:
        return f"{first_ns * 1e-9:.1f} to {last_ns * 1e-9:.1f} s"
    begin, end = (datetime.fromtimestamp(t // 10**9, UTC) for t in (first_ns, last_ns))
    ends = f"{end:%H:%M:%S}" if begin.date() == end.date() else f"{end:%Y-%m-%d %H:%M:%S}"
    return f"{begin:%Y-%m-%d %H:%M:%S} to {ends}"
