"""Output of ``corridor batch``: a fused fleet as plain, stable text."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from fusion.fleet.batch import Fleet
from fusion.fleet.comparison import Change, FleetComparison, FlightChange
from fusion.fleet.quantities import QUANTITIES, rank, worst_first_key
from fusion.fleet.row import CHECK_NAMES, FleetRow, flat
from fusion.logs.samples import counted
from fusion.printable import printable
from fusion.result.summary import Level
from vision.errors import InputError

LISTED = 10
_SIZE = re.compile(r"(\d+(?:\.\d+)?)\s*([kMGT]?)(i?)B?", re.IGNORECASE)
_POWERS = {"": 0, "k": 1, "m": 2, "g": 3, "t": 4}


def memory_bytes(text: str) -> int:
    """Return a size such as ``2GB``, ``1.5GiB`` or ``800M`` in bytes.

    Raises
    ------
    InputError
        If it is invalid, or less than a worker needs to start.
    """
    match = _SIZE.fullmatch(text.strip())
    if match is None:
        raise InputError(f"--memory {text}: is not a size", remedy="write it as 2GB")
    size = float(match[1]) * (1024 if match[3] else 1000) ** _POWERS[match[2].lower()]
    if size < 500e6:
        raise InputError(f"--memory {text}: less than a worker needs to start", remedy="give at least 500MB")
    return int(size)


def batch_text(fleet: Fleet, out: Path, comparison: FleetComparison | None = None) -> str:
    """Format a fleet as text: verdicts, medians, the worst flights, and the comparison."""
    rows = fleet.rows
    verdicts = sorted({row.verdict for row in rows}, key=rank)
    counts = ", ".join(
        f"{sum(row.verdict == word for row in rows)} {word.replace('_', ' ')}" for word in verdicts
    )
    done = len(rows) - fleet.kept
    kept = f", {fleet.kept} kept" if fleet.kept else ""
    lines = [f"{counted(len(rows), 'flight')}: {counts} ({done} fused in {fleet.wall_s:.1f} s{kept})", ""]
    for quantity in QUANTITIES:
        values = quantity.values(rows)
        if len(values) and quantity.sign:
            worst = values.max() if quantity.sign < 0 else values.min()
            middle = quantity.text(float(np.median(values)))
            lines.append(f"{quantity.title:<44}{'median ' + middle:<22}worst {quantity.text(float(worst))}")
    worst_rows = [
        row for row in sorted(rows, key=worst_first_key) if row.verdict not in ("pass", "not_judged")
    ]
    lines += ["", *map(_flight_line, worst_rows[:LISTED])]
    if len(worst_rows) > LISTED:
        lines.append(f"  and {len(worst_rows) - LISTED} more")
    if comparison is not None:
        lines += ["", *_comparison_lines(comparison)]
    lines += ["", f"outputs       {out} (open {out / 'fleet.html'})"]
    return "\n".join(printable(line.rstrip()) for line in lines)


def _flight_line(row: FleetRow) -> str:
    return f"  {row.verdict:<9} {row.flight}: {row.reason or _concerns(row)}"


def _concerns(row: FleetRow) -> str:
    level = Level.FAIL if row.verdict == "fail" else Level.WARN
    return ", ".join(
        f"{CHECK_NAMES[key]} ({row.checks[key].value})"
        for key in CHECK_NAMES
        if key in row.checks and row.checks[key].level is level
    )


def _comparison_lines(found: FleetComparison) -> list[str]:
    counts = ", ".join(f"{found.count(change)} {change}" for change in Change)
    changed = sum(change.has_new_verdict for change in found.changes)
    lines = [f"against       {counts}; {changed} with another verdict"]
    for name, flights in (("only before", found.only_before), ("new", found.only_after)):
        if flights:
            lines.append(f"{name:<14}{', '.join(flights[:LISTED])}{' ...' if len(flights) > LISTED else ''}")
    for median in found.medians:
        quantity = median.quantity
        if quantity.sign:
            before, after = quantity.text(median.before), quantity.text(median.after)
            lines.append(f"  {quantity.title:<42}median {before} to {after}")
    different = [change for change in found.changes if change.change is not Change.SAME]
    lines += [_change_line(change) for change in different[:LISTED]]
    if len(different) > LISTED:
        lines.append(f"  and {len(different) - LISTED} more")
    return lines


def _change_line(change: FlightChange) -> str:
    parts = [f"{change.before.verdict} to {change.after.verdict}"] if change.has_new_verdict else []
    for moved in change.moved[:3]:
        quantity = moved.quantity
        parts.append(f"{quantity.title} {quantity.text(moved.before)} to {quantity.text(moved.after)}")
    parts += [change.after.reason] if change.after.reason else []
    return f"  {change.change:<7} {change.flight}: {'; '.join(parts)}"


def batch_values(fleet: Fleet, comparison: FleetComparison | None = None) -> dict[str, Any]:
    """Return a fleet as plain values for JSON: all rows, and the change of each flight."""
    found: dict[str, Any] = {
        "flights": [flat(row) for row in fleet.rows],
        "kept": fleet.kept,
        "wall_s": fleet.wall_s,
    }
    if comparison is not None:
        found["against"] = {
            **{str(change): comparison.count(change) for change in Change},
            "changes": [
                {
                    "flight": change.flight,
                    "change": str(change.change),
                    "verdict_before": change.before.verdict,
                    "verdict_after": change.after.verdict,
                }
                for change in comparison.changes
            ],
            "only_before": list(comparison.only_before),
            "only_after": list(comparison.only_after),
        }
    return found
