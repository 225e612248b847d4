"""Contents of ``summary.json``, typed: the fields are its keys, in its order."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

from fusion.result.record import Record

PERCENTILES = (50, 90, 95, 99)


class Level(StrEnum):
    """Result of a check; ``not_judged`` if the flight has nothing to judge."""

    PASS = "pass"
    WARN = "warn"
    FAIL = "fail"
    NOT_JUDGED = "not_judged"


@dataclass(frozen=True, slots=True, eq=False)
class Check(Record):
    """One line of the verdict.

    Parameters
    ----------
    name, level
        Subject and result of the check.
    value
        The finding, in convenient units.
    limit
        The limits in words.
    meaning
        One sentence: what it means for the flight.
    action
        One sentence: what to do; empty if nothing needs doing.
    number
        ``value`` as a number, in SI units and radians, for the comparison of flights; None if it is not one number.
    """

    optional = frozenset({"number"})

    name: str
    level: Level
    value: str
    limit: str
    meaning: str
    action: str = ""
    number: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class ErrorStatistics(Record):
    """Errors of one quantity, estimate minus truth; None if no row was left to judge.

    Parameters
    ----------
    unit
        ``rad``, ``m`` or ``norm`` (half widths of the corridor); appended to the names in JSON: ``rmse_rad``.
    count
        Rows judged.
    rmse, mae, max, p50, p90, p95, p99
        Of the absolute error (RMSE and MAE: the article's equations 9 and 10), and its percentiles.
    bias
        Mean error.
    nees_mean
        Mean of (error / sigma) squared; 1 for a consistent filter.
    error_over_sigma_p90
        90th percentile of abs(error) / sigma; 1.64 for a consistent filter with Gaussian errors.
    """

    unit: str
    count: int
    rmse: float | None = None
    mae: float | None = None
    max: float | None = None
    p50: float | None = None
    p90: float | None = None
    p95: float | None = None
    p99: float | None = None
    bias: float | None = None
    nees_mean: float | None = None
    error_over_sigma_p90: float | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON object: the unit is part of the names."""
        percentiles = zip(PERCENTILES, (self.p50, self.p90, self.p95, self.p99), strict=True)
        sizes = {"rmse": self.rmse, "mae": self.mae, "max": self.max}
        sizes |= {f"p{share}": value for share, value in percentiles} | {"bias": self.bias}
        return {
            "count": self.count,
            **{f"{name}_{self.unit}": value for name, value in sizes.items()},
            "nees_mean": self.nees_mean,
            "error_over_sigma_p90": self.error_over_sigma_p90,
        }


@dataclass(frozen=True, slots=True, eq=False)
class CorridorErrors(Record):
    """Errors within one corridor of the truth.

    Parameters
    ----------
    rows
        Rows within the truth's time and this corridor.
    status_share
        Share of those rows in each status; None for single frames, which have none.
    heading, lateral_offset_m, lateral_offset_norm
        Errors of each quantity; None if the table or the truth has no such column.
    """

    optional = frozenset({"status_share", "lateral_offset_m", "lateral_offset_norm"})

    rows: int
    status_share: Mapping[str, float] | None
    heading: ErrorStatistics
    lateral_offset_m: ErrorStatistics | None
    lateral_offset_norm: ErrorStatistics | None


@dataclass(frozen=True, slots=True, eq=False)
class TableErrors(Record):
    """Errors of a whole table against the truth, see `fusion.evaluation.errors.evaluate`.

    Parameters
    ----------
    rows, judged
        Rows of the table, and those that were compared with the truth.
    excluded
        Number of the others by the first reason that applies: ``outside_truth``, ``junction``, ``no_truth``, and
        ``not_tracking`` (estimates) or ``not_accepted`` (frames).
    status_share
        Share of the rows in each status; None for single frames.
    heading, lateral_offset_m, lateral_offset_norm
        Errors of each quantity; None if the table or the truth has no such column.
    corridors
        The same by the truth's corridor id, as text.
    """

    optional = CorridorErrors.optional

    rows: int
    judged: int
    excluded: Mapping[str, int]
    status_share: Mapping[str, float] | None
    heading: ErrorStatistics
    lateral_offset_m: ErrorStatistics | None
    lateral_offset_norm: ErrorStatistics | None
    corridors: Mapping[str, CorridorErrors]


@dataclass(frozen=True, slots=True, eq=False)
class FlightErrors(Record):
    """Errors of the causal filter, of the smoother, and of single frames."""

    filter: TableErrors
    smoothed: TableErrors
    vision: TableErrors


@dataclass(frozen=True, slots=True, eq=False)
class Counts(Record):
    """Numbers of frames, by outcome and reason, of rows, and of samples used and dropped."""

    frames: int = 0
    accepted: int = 0
    rejected: int = 0
    by_reason: Mapping[str, int] = field(default_factory=dict)
    estimates: int = 0
    samples: Mapping[str, int] = field(default_factory=dict)
    dropped: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False)
class Rates(Record):
    """Nominal rates of the streams, Hz; None for a stream that the flight lacks."""

    frames_hz: float | None = None
    imu_hz: float | None = None
    attitude_hz: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class SpeedSummary(Record):
    """Durations of the run: milliseconds per picture, and seconds of wall clock.

    ``compile_s`` is the time of compiling pixel loops, once per machine; the other times exclude it.
    """

    vision_ms_median: float | None = None
    vision_ms_p95: float | None = None
    vision_s: float = 0.0
    filter_s: float = 0.0
    smoother_s: float = 0.0
    total_s: float = 0.0
    times_real_time: float | None = None
    compile_s: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class CorridorStretch(Record):
    """One corridor's part of the flight, by the smoother; ``turn_rad`` is from the first corridor."""

    index: int
    turn_rad: float
    first_ns: int
    last_ns: int
    frames: int
    accepted: int


@dataclass(frozen=True, slots=True, eq=False)
class Summary(Record):
    """Verdict, counts, rates, timings and errors of a fused flight; `to_dict` is ``summary.json``.

    Parameters
    ----------
    verdict, checks
        The worst level of all checks, and each of them.
    flight, method, duration_s
        Name, measurement method and length of the flight.
    counts, rates, timings
        Numbers and rates of the inputs, and durations of the run.
    status_share
        Share of the rows of the estimates in each status.
    corridors
        The corridors flown, in order.
    errors
        Against the truth; None without one.
    problems, config
        Problems of the log, a sentence each; the settings as used.
    events, events_left_out
        Events, see `fusion.estimator.events`, and the number of unlisted ones: each with ``timestamp_ns``, ``kind``
        and its numbers. Frames rejected in a row for one reason are one event, from ``timestamp_ns`` to ``last_ns``.
    lateral_unknown_share
        Share of the rows of the estimates with an unknown lateral offset, by its ``lateral_reason``.
    """

    verdict: Level = Level.NOT_JUDGED
    checks: tuple[Check, ...] = ()
    flight: str = ""
    method: str = "geometric"
    duration_s: float = 0.0
    counts: Counts = field(default_factory=Counts)
    rates: Rates = field(default_factory=Rates)
    timings: SpeedSummary | None = None
    status_share: Mapping[str, float] = field(default_factory=dict)
    corridors: tuple[CorridorStretch, ...] = ()
    errors: FlightErrors | None = None
    problems: tuple[str, ...] = ()
    config: Mapping[str, Any] = field(default_factory=dict)
    events: tuple[Mapping[str, Any], ...] = ()
    events_left_out: int = 0
    lateral_unknown_share: Mapping[str, float] = field(default_factory=dict)
