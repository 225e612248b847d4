"""Effect of a change of settings or version on a fleet: comparison of two tables of the same flights."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from fusion.fleet.quantities import QUANTITIES, Quantity, rank
from fusion.fleet.row import CHECK_NAMES, FleetRow
from fusion.result.summary import Level

LEAST_SHARE = 0.05  # smallest relative change that is reported


class Change(StrEnum):
    """Change of a flight."""

    WORSE = "worse"
    BETTER = "better"
    MIXED = "mixed"
    SAME = "same"


@dataclass(frozen=True, slots=True)
class Moved:
    """A quantity of a flight that changed, in its displayed unit."""

    quantity: Quantity
    before: float
    after: float

    @property
    def gain(self) -> float:
        """Improvement in multiples of the smallest reported change; negative: worse."""
        return self.quantity.sign * (self.after - self.before) / self.quantity.least


@dataclass(frozen=True, slots=True)
class FlightChange:
    """A flight before and after.

    Parameters
    ----------
    flight, change
        Its name, and its change.
    before, after
        Its rows.
    moved
        The changed quantities, the largest change first.
    checks
        The checks with another level: name, level before and after.
    """

    flight: str
    change: Change
    before: FleetRow
    after: FleetRow
    moved: tuple[Moved, ...]
    checks: tuple[tuple[str, Level, Level], ...]

    @property
    def has_new_verdict(self) -> bool:
        """Whether the verdict changed."""
        return self.before.verdict != self.after.verdict


@dataclass(frozen=True, slots=True)
class MedianChange:
    """A quantity over the flights that have it before and after: their number, and the medians."""

    quantity: Quantity
    flights: int
    before: float
    after: float


@dataclass(frozen=True, slots=True)
class FleetComparison:
    """Two batches of the same flights.

    Parameters
    ----------
    changes
        Of the flights in both, worse ones first.
    medians
        Of each quantity that both have.
    only_before, only_after
        Names of the flights that the other batch lacks.
    versions, settings
        Versions and hashes of settings before and after.
    """

    changes: tuple[FlightChange, ...]
    medians: tuple[MedianChange, ...]
    only_before: tuple[str, ...]
    only_after: tuple[str, ...]
    versions: tuple[frozenset[str], frozenset[str]]
    settings: tuple[frozenset[str], frozenset[str]]

    def count(self, change: Change) -> int:
        """Return the number of flights with this change."""
        return sum(c.change is change for c in self.changes)


def compare_fleets(before: Sequence[FleetRow], after: Sequence[FleetRow]) -> FleetComparison:
    """Compare two batches, flight by flight; flights are matched by name, or else by their log's hash."""
    pairs = list(_pairs(before, after))
    order = [Change.WORSE, Change.MIXED, Change.BETTER, Change.SAME]
    changes = sorted(
        (_compare(a, b) for a, b in pairs), key=lambda c: (order.index(c.change), -_size(c), c.flight)
    )
    olds, news = {id(a) for a, _ in pairs}, {id(b) for _, b in pairs}
    return FleetComparison(
        tuple(changes),
        tuple(_medians(pairs)),
        tuple(row.flight for row in before if id(row) not in olds),
        tuple(row.flight for row in after if id(row) not in news),
        _both(before, after, "version"),
        _both(before, after, "config_hash"),
    )


def _both(
    before: Sequence[FleetRow], after: Sequence[FleetRow], name: str
) -> tuple[frozenset[str], frozenset[str]]:
    old, new = (frozenset(getattr(row, name) for row in rows) for rows in (before, after))
    return old, new


def _pairs(before: Sequence[FleetRow], after: Sequence[FleetRow]) -> Iterator[tuple[FleetRow, FleetRow]]:
    named = {row.flight: row for row in before}
    taken = named.keys() & {row.flight for row in after}
    by_content = {row.log_hash: row for row in before if row.log_hash and row.flight not in taken}
    for row in after:
        old = named.get(row.flight) or by_content.pop(row.log_hash, None)
        if old is not None:
            yield old, row


def _compare(before: FleetRow, after: FleetRow) -> FlightChange:
    moved = sorted(_moved(before, after), key=lambda m: -abs(m.gain))
    checks = tuple(
        (name, before.checks[key].level, after.checks[key].level)
        for key, name in CHECK_NAMES.items()
        if key in before.checks
        and key in after.checks
        and before.checks[key].level is not after.checks[key].level
    )
    step = rank(after.verdict) - rank(before.verdict)
    if step:
        change = Change.BETTER if step > 0 else Change.WORSE
    else:
        directions = {m.gain > 0 for m in moved}
        change = Change.MIXED if len(directions) > 1 else Change.SAME
        if len(directions) == 1:
            change = Change.BETTER if directions.pop() else Change.WORSE
    return FlightChange(after.flight, change, before, after, tuple(moved), checks)


def _moved(before: FleetRow, after: FleetRow) -> Iterator[Moved]:
    for quantity in QUANTITIES:
        old, new = quantity.of(before), quantity.of(after)
        if not quantity.sign or old is None or new is None:
            continue
        if abs(new - old) > max(quantity.least, LEAST_SHARE * abs(old)):
            yield Moved(quantity, old, new)


def _size(change: FlightChange) -> float:
    """Size of the change; the verdict has priority."""
    return 1000.0 * change.has_new_verdict + max((abs(m.gain) for m in change.moved), default=0.0)


def _medians(pairs: Sequence[tuple[FleetRow, FleetRow]]) -> Iterator[MedianChange]:
    for quantity in QUANTITIES:
        values = [(quantity.of(a), quantity.of(b)) for a, b in pairs]
        known = [(a, b) for a, b in values if a is not None and b is not None]
        if known:
            old, new = np.median(np.array(known), axis=0)
            yield MedianChange(quantity, len(known), float(old), float(new))
