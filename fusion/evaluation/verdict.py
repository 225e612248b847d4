"""What a check is, where it passes, and how many checks become one verdict."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from math import isfinite, radians


class Level(StrEnum):
    """Outcome of a check; ``not_judged`` where the flight has nothing to judge."""

    PASS = "pass"
    WARN = "warn"
    FAIL = "fail"
    NOT_JUDGED = "not_judged"


@dataclass(frozen=True, slots=True)
class Check:
    """One line of the verdict.

    Parameters
    ----------
    name, level
        What was looked at, and how it came out.
    value
        The number found, in units for people.
    limit
        Where it passes and where it fails.
    meaning
        One sentence: what this says about the flight.
    action
        One sentence: what to do; empty where nothing needs doing.
    """

    name: str
    level: Level
    value: str
    limit: str
    meaning: str
    action: str = ""


@dataclass(frozen=True, slots=True)
class Limits:
    """The two thresholds of each check: the first parts pass from warn, the second warn from fail."""

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
    """Order checks by how much they matter to a reader, those alike as they were."""
    return sorted(checks, key=lambda check: _WORST_FIRST.index(check.level))


def overall(checks: Sequence[Check]) -> Level:
    """Return the worst level of all; ``not_judged`` counts only where nothing was judged."""
    return worst_of(Level.NOT_JUDGED, *(check.level for check in checks))


def not_judged(name: str, limit: str, why: str) -> Check:
    """Return a check that the flight gave nothing to judge by."""
    return Check(name, Level.NOT_JUDGED, "not judged", limit, why)
