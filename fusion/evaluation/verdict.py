"""Parts of a check, its limits, and the verdict from all checks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import isfinite, radians

from fusion.flight import Flight
from fusion.result.result import FusionResult
from fusion.result.summary import Check, Level


@dataclass(frozen=True, slots=True)
class Limits:
    """The two thresholds of each check: the first separates pass from warn, the second warn from fail."""

    accepted_share: tuple[float, float] = (0.80, 0.50)
    over_gate_share: tuple[float, float] = (0.05, 0.20)
    one_reason_share: tuple[float, float] = (0.10, 0.30)
    late_s: tuple[float, float] = (0.020, 0.060)
    late_std_s: float = 0.008
    frame_rate_hz: tuple[float, float] = (8.0, 2.0)
    inertial_rate_hz: tuple[float, float] = (50.0, 2.0)
    coast_s: tuple[float, float] = (2.0, 10.0)
    across_rad: float = radians(50.0)
    across_s: float = 3.0
    offset_known_share: float = 0.80
    offset_known_norm: float = 0.25
    gyro_bias_rad_s: tuple[float, float] = (radians(1.0), radians(5.0))
    yaw_step_rad: float = radians(3.0)
    innovation_ratio: tuple[float, float] = (1.5, 3.0)
    truth_sigma_p90: tuple[float, float] = (2.0, 4.0)
    truth_nees: tuple[float, float] = (3.0, 10.0)
    frame_gap_s: tuple[float, float] = (0.5, 5.0)
    heading_rmse_rad: tuple[float, float] = (radians(0.5), radians(2.0))
    offset_rmse_m: tuple[float, float] = (0.10, 0.30)
    offset_rmse_norm: tuple[float, float] = (0.10, 0.30)


def level_of(value: float, limits: tuple[float, float]) -> Level:
    """Compare with (pass, fail) limits, in either direction; NaN is not judged."""
    good, bad = limits
    if not isfinite(value):
        return Level.NOT_JUDGED
    if good > bad:
        value, good, bad = -value, -good, -bad
    if value <= good:
        return Level.PASS
    return Level.WARN if value <= bad else Level.FAIL


_WORST_FIRST = (Level.FAIL, Level.WARN, Level.PASS, Level.NOT_JUDGED)


def worst_of(*levels: Level) -> Level:
    """Return the worst level; ``not_judged`` is the least of all."""
    return min(levels, key=_WORST_FIRST.index)


def worst_first(checks: Sequence[Check]) -> list[Check]:
    """Sort checks by importance to a reader; the order of equal ones is kept."""
    return sorted(checks, key=lambda check: _WORST_FIRST.index(check.level))


def overall(checks: Sequence[Check]) -> Level:
    """Return the worst level of all; ``not_judged`` only if nothing was judged."""
    return worst_of(Level.NOT_JUDGED, *(check.level for check in checks))


@dataclass(frozen=True, slots=True)
class Finding:
    """Finding of a check on one flight.

    Parameters
    ----------
    text
        The finding in words, in convenient units.
    number
        The finding as one number, SI units and radians; compared with the rule's ``pass_fail`` unless ``level`` is
        set.
    level
        Set if one number does not determine the level.
    limit, meaning, action
        Replace the rule's sentences, unless None.
    """

    text: str
    number: float | None = None
    level: Level | None = None
    limit: str | None = None
    meaning: str | None = None
    action: str | None = None


def nothing_to_judge(why: str) -> Finding:
    """Return the finding of a check that cannot be judged on the flight, with the reason in a sentence."""
    return Finding("not judged", level=Level.NOT_JUDGED, meaning=why)


@dataclass(frozen=True, slots=True)
class CheckRule:
    """One row of the table of checks, see `fusion.evaluation.checks.CHECKS`.

    Parameters
    ----------
    name
        Subject of the check, as printed in the report.
    measure
        Computes the finding on a flight.
    limit
        The limits in words.
    good
        Meaning if the check passes.
    bad
        Meaning if it does not; a finding may be more specific.
    remedy
        Remedy in that case.
    pass_fail
        Limits that ``Finding.number`` is compared with: the first separates pass from warn, the second warn from
        fail.
    """

    name: str
    measure: Callable[[FusionResult, Flight, Limits], Finding]
    limit: Callable[[Limits], str]
    good: str
    bad: str = ""
    remedy: str = ""
    pass_fail: Callable[[Limits], tuple[float, float]] | None = None

    def apply(self, result: FusionResult, flight: Flight, limits: Limits) -> Check:
        """Run the check on a fused flight and describe its result."""
        found = self.measure(result, flight, limits)
        level = self._level(found, limits)
        meaning, action = (self.good, "") if level is Level.PASS else (self.bad, self.remedy)
        if level is Level.NOT_JUDGED:
            action = ""
        return Check(
            self.name,
            level,
            found.text,
            self.limit(limits) if found.limit is None else found.limit,
            meaning if found.meaning is None else found.meaning,
            action if found.action is None else found.action,
            found.number if found.number is not None and isfinite(found.number) else None,
        )

    def _level(self, found: Finding, limits: Limits) -> Level:
        if found.level is not None:
            return found.level
        if found.number is None or self.pass_fail is None:
            raise ValueError(f"check {self.name!r}: the finding has neither a level nor a number with limits")
        return level_of(found.number, self.pass_fail(limits))
