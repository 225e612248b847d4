"""Statistics of a stream's times: rate, jitter, gaps, repeats, jumps of the clock."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from fusion.flight import TimeArray

GAP_STEPS = 3.0  # in median steps: a longer step is a gap
JUMP_FORWARD_NS = 60_000_000_000  # a longer step is a change of the clock or of the log
JUMP_BACK_NS = 1_000_000_000  # smaller steps are unsorted samples
LISTED = 5


@dataclass(frozen=True, slots=True)
class Gap:
    """A stretch without samples, after the sample at ``after_ns``."""

    after_ns: int
    length_s: float


@dataclass(frozen=True, slots=True)
class Timing:
    """Statistics of a stream's times.

    Parameters
    ----------
    samples
        Number of times, repeated ones included.
    first_ns, last_ns
        Earliest and latest; None for a stream without samples.
    duration_s
        Between the two.
    rate_hz
        One over the median step; None if there are fewer than two different times.
    jitter_s
        Deviation from the median step within which 95 of 100 steps lie, without gaps.
    gaps
        Stretches of more than three median steps, the longest first, at most five of them.
    gap_count, gap_total_s
        Number and total duration of all gaps.
    repeated
        Samples with the time of an earlier one.
    backwards
        Places where the time is less than the one before.
    jumps
        Of the clock: a minute or more forward, a second or more back; at most five.
    jump_count
        Number of all.
    """

    samples: int
    first_ns: int | None = None
    last_ns: int | None = None
    duration_s: float = 0.0
    rate_hz: float | None = None
    jitter_s: float | None = None
    gaps: tuple[Gap, ...] = ()
    gap_count: int = 0
    gap_total_s: float = 0.0
    repeated: int = 0
    backwards: int = 0
    jumps: tuple[Gap, ...] = ()
    jump_count: int = 0


def time_stream(t_ns: TimeArray) -> Timing:
    """Describe the times (n,) in a log, in any order."""
    n = len(t_ns)
    if n == 0:
        return Timing(0)
    raw_steps = np.diff(t_ns)
    jumped = np.flatnonzero((raw_steps >= JUMP_FORWARD_NS) | (raw_steps <= -JUMP_BACK_NS))
    ordered = np.unique(t_ns)
    steps = np.diff(ordered)
    found = Timing(
        n,
        int(ordered[0]),
        int(ordered[-1]),
        float(ordered[-1] - ordered[0]) * 1e-9,
        repeated=n - len(ordered),
        backwards=int(np.count_nonzero(raw_steps < 0)),
        jumps=tuple(Gap(int(t_ns[i]), float(raw_steps[i]) * 1e-9) for i in jumped[:LISTED]),
        jump_count=len(jumped),
    )
    if len(steps) == 0:
        return found
    usual = float(np.median(steps))
    long = np.flatnonzero((steps > GAP_STEPS * usual) & (steps < JUMP_FORWARD_NS))
    worst = long[np.argsort(steps[long], kind="stable")[::-1][:LISTED]]
    return replace(
        found,
        rate_hz=1e9 / usual,
        jitter_s=float(np.percentile(np.abs(steps[steps <= GAP_STEPS * usual] - usual), 95.0)) * 1e-9,
        gaps=tuple(Gap(int(ordered[i]), float(steps[i]) * 1e-9) for i in worst),
        gap_count=len(long),
        gap_total_s=float(steps[long].sum()) * 1e-9,
    )


def share_covered(t_ns: TimeArray, by_ns: TimeArray) -> float:
    """Share of times (n,) that lie between the first and the last of others (m,); 0 if either is empty."""
    if len(t_ns) == 0 or len(by_ns) == 0:
        return 0.0
    return float(np.mean((t_ns >= by_ns.min()) & (t_ns <= by_ns.max())))
