"""The fleet's page: the worst flights with links, failing checks, distributions, trends, the comparison."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from urllib.parse import quote

import numpy as np

from fusion.files import replacing
from fusion.fleet import plots
from fusion.fleet.comparison import Change, FleetComparison, compare_fleets
from fusion.fleet.quantities import QUANTITIES, Quantity, rank, worst_first_key
from fusion.fleet.row import CHECK_NAMES, FleetRow
from fusion.report.svg import Drawing, draw
from fusion.report.template import render
from fusion.result.summary import Level

PAGE = "fleet.html"
LISTED = 200  # flights in a list of the page; the tables have all of them
MIN_DRAWN = 3  # values for a distribution
_LEVELS = (Level.FAIL, Level.WARN, Level.PASS, Level.NOT_JUDGED)
_BADGES = {"error": "fail", "unusable": "fail"}  # colours of verdicts without a result


@dataclass(frozen=True, slots=True)
class ListedFlight:
    """A flight in the list: its verdict, link, and problems in words."""

    name: str
    verdict: str
    badge: str
    link: str
    where: str
    concerns: str
    cells: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class CheckCounts:
    """Number of flights at each level of a check, in the order fail, warn, pass, not judged."""

    name: str
    counts: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Figure:
    """A plot with its title."""

    title: str
    text: str
    drawing: Drawing


def write_page(rows: Sequence[FleetRow], folder: Path, total: int, against: Sequence[FleetRow] = ()) -> None:
    """Write ``fleet.html`` atomically.

    Parameters
    ----------
    rows
        Rows of the finished flights.
    folder
        Folder of the fleet; links are relative to it.
    total
        Total number of flights.
    against
        Rows of another batch to compare with.

    Raises
    ------
    InputError
        If it cannot be written.
    """
    text = render_page(rows, folder, total, against)
    with replacing(folder / PAGE) as draft:
        draft.write_text(text, encoding="utf-8", errors="backslashreplace")


def render_page(rows: Sequence[FleetRow], folder: Path, total: int, against: Sequence[FleetRow] = ()) -> str:
    """Return the page as text; see `write_page`."""
    ordered = sorted(rows, key=worst_first_key)
    done = [row for row in rows if row.has_result]
    columns = _listed_quantities(done)
    context = {
        "name": folder.name,
        "made": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "done": len(rows),
        "total": total,
        "verdicts": _verdicts(rows),
        "facts": _facts(rows, done),
        "columns": [quantity.short for quantity in columns],
        "flights": [_listed(row, folder, columns) for row in ordered[:LISTED]],
        "comparison": _comparison_context(compare_fleets(against, rows)) if against else None,
        "checks": _check_counts(done),
        "vehicles": _vehicle_rows(rows),
        "distributions": _distributions(done),
        "drifts": _drifts(done),
        "versions": sorted({row.version for row in rows}),
        "libraries": sorted({row.libraries for row in rows if row.libraries}),
    }
    return render("fusion.fleet", "fleet.html.j2", context)


def _verdicts(rows: Sequence[FleetRow]) -> list[tuple[str, str, int]]:
    """Return (verdict, colour level, flights), the worst first."""
    words = sorted({row.verdict for row in rows}, key=rank)
    return [(word, _BADGES.get(word, word), sum(row.verdict == word for row in rows)) for word in words]


def _facts(rows: Sequence[FleetRow], done: Sequence[FleetRow]) -> list[tuple[str, str, str]]:
    """Return the headline numbers: (name, number, remark)."""
    flown = _duration(sum(row.duration_s or 0.0 for row in done))
    found = [("Flights", str(len(rows)), f"{len(done)} with a result, {flown} of flight")]
    for quantity in QUANTITIES[:5]:
        values = quantity.values(done)
        if len(values):
            worst = values.max() if quantity.sign < 0 else values.min()
            remark = f"median of {len(values)}; worst {quantity.text(float(worst))}"
            found.append((quantity.title, quantity.text(float(np.median(values))), remark))
    return found


def _duration(seconds: float) -> str:
    """Return a time in the largest unit with at least two digits."""
    if seconds < 120:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 7200 else f"{seconds / 3600:.1f} h"


def _listed_quantities(rows: Sequence[FleetRow]) -> list[Quantity]:
    """Return the quantities of the list of flights: those with a better direction that at least one flight has."""
    return [quantity for quantity in QUANTITIES if quantity.sign and len(quantity.values(rows))][:5]


def _listed(row: FleetRow, folder: Path, columns: Sequence[Quantity]) -> ListedFlight:
    failing = [CHECK_NAMES[key] for key in CHECK_NAMES if _level(row, key) is Level.FAIL]
    warned = [CHECK_NAMES[key] for key in CHECK_NAMES if _level(row, key) is Level.WARN]
    parts = [f"fails: {', '.join(failing)}"] if failing else []
    parts += [f"warns: {', '.join(warned)}"] if warned else []
    return ListedFlight(
        row.flight,
        row.verdict.replace("_", " "),
        _BADGES.get(row.verdict, row.verdict),
        _link(row, folder),
        ", ".join(filter(None, (row.vehicle, row.date[:10]))),
        row.reason or "; ".join(parts),
        tuple(quantity.text(quantity.of(row)) for quantity in columns),
    )


def _link(row: FleetRow, folder: Path) -> str:
    """Return the link to a flight's report, or to its folder without a report; empty without a result."""
    if not row.output:
        return ""
    report = f"{row.output}/report.html"
    return quote(report if (folder / report).is_file() else f"{row.output}/")


def _level(row: FleetRow, check: str) -> Level | None:
    outcome = row.checks.get(check)
    return None if outcome is None else outcome.level


def _check_counts(rows: Sequence[FleetRow]) -> list[CheckCounts]:
    """Return how often each check failed, the most often failing first."""
    found = []
    for key, name in CHECK_NAMES.items():
        levels = [_level(row, key) for row in rows]
        found.append(CheckCounts(name, tuple(levels.count(level) for level in _LEVELS)))
    return sorted(found, key=lambda check: (-check.counts[0], -check.counts[1]))


def _vehicle_rows(rows: Sequence[FleetRow]) -> list[tuple[str, list[str]]]:
    """Return a row per vehicle: its name and the cells; empty if there are fewer than two."""
    vehicles = sorted({row.vehicle for row in rows})
    if len(vehicles) < 2:
        return []
    found = []
    for vehicle in vehicles:
        own = [row for row in rows if row.vehicle == vehicle]
        bad = sum(row.verdict in ("fail", "error", "unusable") for row in own)
        cells = [str(len(own)), f"{bad / len(own):.0%}"]
        for quantity in _listed_quantities(rows):
            values = quantity.values(own)
            cells.append(quantity.text(float(np.median(values))) if len(values) else "")
        found.append((vehicle or "(not named)", cells))
    return found


def _distributions(rows: Sequence[FleetRow]) -> list[Figure]:
    found = []
    for quantity in QUANTITIES:
        values = quantity.values(rows)
        if len(values) >= MIN_DRAWN:
            panel = partial(plots.plot_distribution, quantity=quantity, values=values)
            found.append(Figure(quantity.title, "", draw(f"d-{quantity.column}", quantity.title, [panel])))
    return found


def _drifts(rows: Sequence[FleetRow]) -> list[Figure]:
    """Draw each quantity over the date, if there are flights of several days or hours."""
    dated = [row for row in rows if plots.day_of(row) is not None]
    vehicles = plots.drawn_vehicles(dated)
    if len({row.date for row in dated}) < MIN_DRAWN:
        return []
    found = []
    for quantity in QUANTITIES:
        if len(quantity.values(dated)) >= MIN_DRAWN:
            panel = partial(plots.plot_drift, quantity=quantity, rows=dated, vehicles=vehicles)
            trend = _trend(quantity, dated)
            found.append(Figure(quantity.title, trend, draw(f"t-{quantity.column}", quantity.title, [panel])))
    return found


def _trend(quantity: Quantity, rows: Sequence[FleetRow]) -> str:
    """Report a significant difference between the first and the second half of the flights."""
    from scipy.stats import mannwhitneyu

    dated = sorted(
        (day, value) for row in rows if (day := plots.day_of(row)) and (value := quantity.of(row)) is not None
    )
    values = np.array([value for _, value in dated])
    early, late = values[: len(values) // 2], values[len(values) // 2 :]
    if len(early) < 8 or np.ptp(values) == 0.0:
        return ""
    chance = float(mannwhitneyu(early, late).pvalue)
    medians = (
        f"{quantity.text(float(np.median(early)))} before, {quantity.text(float(np.median(late)))} after"
    )
    return f"Trend: median of the earlier half {medians} (p = {chance:.2g})." if chance < 0.01 else ""


def _comparison_context(found: FleetComparison) -> dict[str, object]:
    return {
        "found": found,
        "counts": [(str(change), found.count(change)) for change in Change],
        "new_verdicts": sum(change.has_new_verdict for change in found.changes),
        "flights": [change for change in found.changes if change.change is not Change.SAME][:LISTED],
        "same_version": found.versions[0] == found.versions[1],
        "same_settings": found.settings[0] == found.settings[1],
    }
