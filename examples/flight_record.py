"""What `control_loop.py` notes on the way, how the flight is judged, and the table it prints."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from math import degrees, inf, isfinite, nan, radians
from typing import Any, NamedTuple

import numpy as np

from fusion.estimator.notices import Status

BODY_RADIUS_M = 0.25
SETTLED_M, SETTLED_RAD, SETTLED_S = 0.15, radians(6), 2.0
MAX_SETTLING_S = 10.0
MAX_HEADING_ERROR_RAD = radians(5)
CALLS = ("add_imu", "add_attitude", "add_velocity", "add_lines", "estimate", "control period")


class Stopwatch:
    """How long calls take: by the wall clock, and of the thread's own time on the processor."""

    def __init__(self) -> None:
        self.wall_ns: dict[str, list[int]] = defaultdict(list)
        self.cpu_ns: dict[str, list[int]] = defaultdict(list)

    def watched(self, name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """Return the function with its calls timed under a name."""
        wall_ns, cpu_ns = self.wall_ns[name], self.cpu_ns[name]

        def call(*arguments: Any) -> Any:
            wall, cpu = time.perf_counter_ns(), time.thread_time_ns()
            result = function(*arguments)
            cpu_ns.append(time.thread_time_ns() - cpu)
            wall_ns.append(time.perf_counter_ns() - wall)
            return result

        return call


class Row(NamedTuple):
    """One control period: what the pilot knew, and how far that was from the truth."""

    t_s: float
    status: str
    corridor: int
    is_turning: bool
    room: int  # that is truly being flown
    heading_rad: float  # true, in that room
    offset_m: float
    clearance_m: float
    heading_error_rad: float  # of the estimate, in the corridor that it holds
    offset_error_m: float
    speed_m_s: float


@dataclass
class Flight:
    """Everything noted on the way.

    Parameters
    ----------
    seconds, rate_hz
        Longest flight, and rate of the control loop.
    frame_ages_s
        From the exposure of a picture to its use.
    vision_threads, control_thread
        Where pictures were measured, and where the loop ran.
    pictures, dropped, used
        Taken; given up for newer ones; accepted by the filter.
    missed
        Control periods whose work was not done when the next began.
    turned_s
        When the turn was called for.
    """

    seconds: float
    rate_hz: float
    rows: list[Row] = field(default_factory=list)
    watch: Stopwatch = field(default_factory=Stopwatch)
    frame_ages_s: list[float] = field(default_factory=list)
    vision_threads: set[int] = field(default_factory=set)
    control_thread: int = 0
    pictures: int = 0
    dropped: int = 0
    used: int = 0
    missed: int = 0
    turned_s: float | None = None
    took_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Outcome:
    """How a flight went.

    Parameters
    ----------
    corridors
        Values of ``corridor_index``, in order.
    clearance_m
        Least distance from a wall to the vehicle's middle.
    heading_rms_rad, heading_max_rad, offset_error_rms_m
        Error of the estimate, from the first heading on; of the offset, outside the turn.
    offset_rms_m
        Distance from the centre line, once settled on it.
    settled_s
        From the call for the turn until the vehicle is on the new centre line, and stays on it for two seconds; NaN
        where it never was.
    shares
        Of the time, in each status.
    problems
        What should not have been; empty where all went well.
    """

    corridors: tuple[int, ...]
    clearance_m: float
    heading_rms_rad: float
    heading_max_rad: float
    offset_error_rms_m: float
    offset_rms_m: float
    settled_s: float
    shares: dict[str, float]
    problems: tuple[str, ...]


def judge(flight: Flight) -> Outcome:
    """Sum a flight up."""
    rows, turned_s = flight.rows, inf if flight.turned_s is None else flight.turned_s
    corridors = [rows[0].corridor]
    corridors += [now.corridor for last, now in pairwise(rows) if now.corridor != last.corridor]
    before, after = [r for r in rows if r.t_s < turned_s], [r for r in rows if r.t_s >= turned_s]
    first_s, second_s = _settled_at(before), _settled_at(after)
    level = [r.offset_m for r in before if r.t_s > first_s] + [r.offset_m for r in after if r.t_s > second_s]
    heading = np.array([r.heading_error_rad for r in rows if r.status != Status.INITIALISING])
    clearance, greatest = min(r.clearance_m for r in rows), float(np.abs(heading).max(initial=0.0))
    is_round = rows[-1].t_s > turned_s + MAX_SETTLING_S
    checks = {
        f"it touched a wall, {clearance:.2f} m from its middle": clearance < BODY_RADIUS_M,
        "it never knew its heading": not heading.size,
        f"the heading was {degrees(greatest):.1f} degrees off": greatest > MAX_HEADING_ERROR_RAD,
        f"corridor_index went {corridors}": corridors != [0, 1]
        if is_round
        else corridors not in ([0], [0, 1]),
        "it did not settle in the second corridor": is_round and not second_s < turned_s + MAX_SETTLING_S,
    }
    return Outcome(
        corridors=tuple(corridors),
        clearance_m=clearance,
        heading_rms_rad=_rms(heading),
        heading_max_rad=greatest,
        offset_error_rms_m=_rms([r.offset_error_m for r in rows if not r.is_turning]),
        offset_rms_m=_rms(level),
        settled_s=second_s - turned_s if isfinite(turned_s) else nan,
        shares={str(s): sum(r.status == s for r in rows) / len(rows) for s in Status},
        problems=tuple(text for text, is_wrong in checks.items() if is_wrong),
    )


def _settled_at(rows: list[Row]) -> float:
    """Time from which on the vehicle is near the centre line and along it for long enough; NaN where it never is."""
    since_s = None
    for row in rows:
        if abs(row.offset_m) > SETTLED_M or abs(row.heading_rad) > SETTLED_RAD:
            since_s = None
        elif since_s is None:
            since_s = row.t_s
        elif row.t_s - since_s >= SETTLED_S:
            return since_s
    return nan


def _rms(values: Any) -> float:
    """Root of the mean square of what is known."""
    known = np.asarray(values, dtype=float)
    known = known[np.isfinite(known)]
    return float(np.sqrt(np.mean(known**2))) if known.size else nan


def table(flight: Flight) -> Iterator[str]:
    """Lines of the report."""
    yield f"{'microseconds':16}{'calls':>8}{'median':>10}{'99 %':>10}{'longest':>10}   on the processor{'99 %':>10}"
    for name in CALLS:
        wall, cpu = flight.watch.wall_ns[name], flight.watch.cpu_ns[name]
        if wall:
            times = [*np.percentile(wall, [50, 99, 100]) * 1e-3, *np.percentile(cpu, [50, 99]) * 1e-3]
            yield "{:16}{:8}{:10.1f}{:10.1f}{:10.1f}{:19.1f}{:10.1f}".format(name, len(wall), *times)
    o, ages_ms = judge(flight), np.array(flight.frame_ages_s or [nan]) * 1e3
    beside = flight.vision_threads and flight.control_thread not in flight.vision_threads
    yield (
        f"frames     {flight.pictures} taken, {len(flight.frame_ages_s)} measured "
        f"{'beside' if beside else 'in'} the control thread, {flight.dropped} dropped for newer ones, "
        f"{flight.used} used by the filter"
    )
    yield f"age        {np.median(ages_ms):.1f} ms from exposure to use, at most {ages_ms.max():.1f}"
    slow = sum(ns * flight.rate_hz > 1e9 for ns in flight.watch.cpu_ns[CALLS[-1]])
    why = f": {slow} by work of their own, the others for want of the processor" if flight.missed else ""
    yield f"control    {len(flight.rows)} periods of {1e3 / flight.rate_hz:g} ms, {flight.missed} missed{why}"
    yield f"status     {', '.join(f'{name} {100 * share:.0f} %' for name, share in o.shares.items() if share)}"
    yield (
        f"estimate   heading {degrees(o.heading_rms_rad):.2f} degrees RMS off, at most "
        f"{degrees(o.heading_max_rad):.2f}; offset {100 * o.offset_error_rms_m:.1f} cm RMS"
    )
    yield (
        f"tracking   {100 * o.offset_rms_m:.1f} cm RMS from the centre line, never nearer to a wall than "
        f"{o.clearance_m:.2f} m"
    )
    settled = (
        f"settled {o.settled_s:.1f} s after the call for it" if isfinite(o.settled_s) else "not settled yet"
    )
    turned = "no turn" if flight.turned_s is None else f"turned, and {settled}"
    yield f"corridors  {' -> '.join(map(str, o.corridors))}; {turned}"
    yield f"flown      {flight.rows[-1].t_s:.1f} s, in {flight.took_s:.0f} s with the rendering"
    # Of the flight alone: missed periods depend on the machine.
    yield f"verdict    {'; '.join(o.problems) or 'good: no wall touched, heading and corridors right'}"
