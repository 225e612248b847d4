"""The summary of a fused flight: verdict, counts, rates, timings, errors against the truth."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from fusion.estimator.events import Event, EventKind
from fusion.estimator.tables import Table
from fusion.evaluation.checks import run_checks
from fusion.evaluation.errors import evaluate
from fusion.evaluation.verdict import overall
from fusion.flight import Flight
from fusion.result.result import FusionResult, Timings
from fusion.result.summary import CorridorStretch, Counts, FlightErrors, Rates, SpeedSummary, Summary
from fusion.result.table_rows import lateral_unknown_share

MAX_EVENTS = 20_000  # in the summary; frames.csv has every rejection
_DROPPED_ENDINGS = (
    "_late",
    "_ahead",
    "_duplicate",
    "_not_finite",
    "_not_unit",
    "_not_positive",
    "_out_of_range",
    "_failed",
    "_set_back",
    "_spike",
    "_frozen",
    "_repeated",
)


def summarise(
    result: FusionResult,
    flight: Flight,
    method: str,
    counters: Mapping[str, int],
    timings: Timings,
    events: Sequence[Event] = (),
) -> Summary:
    """Summarise a fused flight.

    Parameters
    ----------
    result, flight
        The result, and the flight that was fused.
    method
        Method of measuring the pictures.
    counters
        Samples that the estimator took and dropped, by name.
    timings
        Durations of the run.
    events
        Events in order of time.
    """
    duration_s = _duration_s(result, flight)
    checks = run_checks(result, flight)
    return Summary(
        verdict=overall(checks),
        checks=checks,
        flight=result.flight_name,
        method=method,
        duration_s=duration_s,
        counts=_counts(result, counters),
        rates=Rates(
            frames_hz=_rate(flight.frames.t_ns),
            imu_hz=None if flight.imu is None else _rate(flight.imu.t_ns),
            attitude_hz=None if flight.attitude is None else _rate(flight.attitude.t_ns),
        ),
        timings=_timings(result.frames, timings, duration_s),
        status_share=_status_share(result.estimates),
        corridors=_corridors(result),
        errors=_errors(result, flight),
        problems=result.problems,
        config=result.config.model_dump(),
        events=_summed_up(events[:MAX_EVENTS]),
        events_left_out=max(len(events) - MAX_EVENTS, 0),
        lateral_unknown_share=lateral_unknown_share(result.estimates),
    )


def _summed_up(events: Sequence[Event]) -> tuple[Mapping[str, Any], ...]:
    """Return events as plain values; consecutive frames rejected for one reason are one event with a count."""
    found: list[dict[str, Any]] = []
    for event in events:
        last, reason = found[-1] if found else {}, event.values.get("reason")
        if event.kind is EventKind.FRAME_REJECTED and (last.get("kind"), last.get("reason")) == (
            event.kind,
            reason,
        ):
            last |= {"last_ns": event.timestamp_ns, "frames": last["frames"] + 1}
            continue
        found.append({"timestamp_ns": event.timestamp_ns, "kind": str(event.kind), **event.values})
        if event.kind is EventKind.FRAME_REJECTED:
            found[-1] |= {"last_ns": event.timestamp_ns, "frames": 1}
    return tuple(found)


def _duration_s(result: FusionResult, flight: Flight) -> float:
    ends = [t for t in (result.estimates["timestamp_ns"], flight.frames.t_ns) if len(t)]
    return float(max(t[-1] for t in ends) - min(t[0] for t in ends)) * 1e-9 if ends else 0.0


def _counts(result: FusionResult, counters: Mapping[str, int]) -> Counts:
    frames = result.frames
    words = Counter(frames["reason"].tolist())
    return Counts(
        frames=len(frames),
        accepted=int(frames["accepted"].sum()),
        rejected=int((~frames["accepted"]).sum()),
        by_reason=dict(words.most_common()),
        estimates=len(result.estimates),
        samples={name: counters.get(name, 0) for name in ("imu", "attitude", "velocity", "range")},
        dropped={
            name: count
            for name, count in sorted(counters.items())
            if count and name.endswith(_DROPPED_ENDINGS)
        },
    )


def _rate(t_ns: npt.NDArray[np.int64]) -> float | None:
    """Nominal rate, from the median interval, so that gaps do not lower it."""
    return float(1e9 / np.median(np.diff(t_ns))) if len(t_ns) > 1 else None


def _timings(frames: Table, timings: Timings, duration_s: float) -> SpeedSummary:
    milliseconds = frames["vision_ms"][np.isfinite(frames["vision_ms"])]
    return SpeedSummary(
        vision_ms_median=float(np.median(milliseconds)) if milliseconds.size else None,
        vision_ms_p95=float(np.percentile(milliseconds, 95)) if milliseconds.size else None,
        vision_s=timings.vision_s,
        filter_s=timings.filter_s,
        smoother_s=timings.smoother_s,
        total_s=timings.total_s,
        times_real_time=duration_s / timings.total_s if timings.total_s > 0 else None,
        compile_s=timings.compile_s,
    )


def _status_share(estimates: Table) -> dict[str, float]:
    words = Counter(estimates["status"].tolist())
    return {word: count / len(estimates) for word, count in words.most_common()}


def _corridors(result: FusionResult) -> tuple[CorridorStretch, ...]:
    """Time span of each corridor, by the smoother."""
    found = []
    table, frames = result.smoothed, result.frames
    if not len(table):
        return ()
    edges = [0, *(np.flatnonzero(np.diff(table["corridor_index"])) + 1).tolist(), len(table)]
    for first, end in pairwise(edges):
        t0, t1 = int(table["timestamp_ns"][first]), int(table["timestamp_ns"][end - 1])
        within = (frames["timestamp_ns"] >= t0) & (frames["timestamp_ns"] <= t1)
        found.append(
            CorridorStretch(
                index=int(table["corridor_index"][first]),
                turn_rad=float(table["corridor_turn_rad"][end - 1]),
                first_ns=t0,
                last_ns=t1,
                frames=int(within.sum()),
                accepted=int(frames["accepted"][within].sum()),
            )
        )
    return tuple(found)


def _errors(result: FusionResult, flight: Flight) -> FlightErrors | None:
    """Errors of filter, smoother and single frames; None without ground truth."""
    if flight.truth is None:
        return None
    return FlightErrors(
        filter=evaluate(result.estimates, flight.truth),
        smoothed=evaluate(result.smoothed, flight.truth),
        vision=evaluate(result.frames, flight.truth),
    )
