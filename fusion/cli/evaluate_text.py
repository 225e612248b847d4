"""Output of ``corridor evaluate``: a comparison with ground truth in tables of up to 100 columns."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from math import degrees
from typing import NamedTuple

from fusion.evaluation.comparison import ComparedOutput, Comparison
from fusion.logs.samples import counted
from fusion.printable import printable
from fusion.result.summary import PERCENTILES, CorridorErrors, ErrorStatistics, TableErrors

NAME, KIND, CELL = 24, 11, 8


class Quantity(NamedTuple):
    """A quantity of the tables: its field in the errors, its title, the factor to the unit shown, decimals."""

    name: str
    title: str
    factor: float
    decimals: int

    def of(self, errors: TableErrors | CorridorErrors | None) -> ErrorStatistics | None:
        """Return the statistics of this quantity; None if there are none."""
        if errors is None or self.name == "heading":
            return None if errors is None else errors.heading
        return errors.lateral_offset_m if self.name == "lateral_offset_m" else errors.lateral_offset_norm


QUANTITIES = (
    Quantity("heading", "heading, degrees", degrees(1.0), 3),
    Quantity("lateral_offset_m", "lateral offset, cm", 100.0, 2),
    Quantity("lateral_offset_norm", "lateral offset, % of half width", 100.0, 2),
)
STATUSES = ("initialising", "tracking", "coasting", "lost")
EXCLUDED = {
    "outside_truth": "outside the truth's time",
    "junction": "in a junction",
    "no_truth": "in a gap of the truth or between corridors",
    "not_tracking": "not tracking",
}


def comparison_text(found: Comparison) -> str:
    """Format a comparison with ground truth."""
    truth, outputs = found.truth, found.outputs
    span_s = (truth.last_ns - truth.first_ns) / 1e9
    lines = [f"truth   {truth.source}", f"        {counted(truth.rows, 'row')}, {span_s:.1f} s"]
    lines += [f"        problem: {problem}" for problem in truth.problems]
    for quantity in QUANTITIES:
        if any(quantity.of(output.causal.errors) is not None for output in outputs):
            lines += ["", _head(quantity.title)]
            for output in outputs:
                lines += _quantity_lines(output, quantity)
    _, *offsets = QUANTITIES
    if all(quantity.of(output.causal.errors) is None for output in outputs for quantity in offsets):
        lines += ["", "lateral offset: the truth has none"]
    lines += ["", *_statuses(outputs), "", *_remarks(found)]
    return "\n".join(printable(line.rstrip()) for line in lines).rstrip()


def _head(title: str) -> str:
    words = ("RMSE", "MAE", "max", *(f"p{p}" for p in PERCENTILES), "NEES")
    return f"{title:<{NAME + KIND}}" + "".join(f"{word:>{CELL}}" for word in words)


def _quantity_lines(output: ComparedOutput, quantity: Quantity) -> Iterator[str]:
    causal, smoothed = output.causal.errors, output.smoothed.errors
    rows: list[tuple[str, TableErrors | CorridorErrors | None, TableErrors | CorridorErrors | None]]
    rows = [(_shortened(output.name), causal, smoothed)]
    if len(causal.corridors) > 1:
        rows += [
            (f"  corridor {number}", part, smoothed.corridors.get(number))
            for number, part in causal.corridors.items()
        ]
    for name, filtered, smooth in rows:
        yield f"{name:<{NAME}}{'causal':<{KIND}}" + _cells(quantity.of(filtered), quantity)
        yield f"{'':<{NAME}}{'smoothed':<{KIND}}" + _cells(quantity.of(smooth), quantity)


def _shortened(name: str) -> str:
    return name if len(name) < NAME else "..." + name[-(NAME - 4) :]


def _cells(found: ErrorStatistics | None, quantity: Quantity) -> str:
    if found is None:
        return f"{'-':>{CELL}}" * (4 + len(PERCENTILES))
    numbers = (found.rmse, found.mae, found.max, found.p50, found.p90, found.p95, found.p99)
    texts = [
        "-" if number is None else _number(number * quantity.factor, quantity.decimals) for number in numbers
    ]
    texts.append("-" if found.nees_mean is None else _number(found.nees_mean, 2))
    return "".join(f"{text:>{CELL}}" for text in texts)


def _number(value: float, decimals: int) -> str:
    text = f"{value:.{decimals}f}"
    return text if len(text) < CELL else f"{value:.2g}"


def _statuses(outputs: Sequence[ComparedOutput]) -> Iterator[str]:
    title = "time in each status, %"
    yield f"{title:<{NAME + KIND}}" + "".join(f"{word:>13}" for word in STATUSES)
    for output in outputs:
        name, errors = _shortened(output.name), output.causal.errors
        yield f"{name:<{NAME}}{'causal':<{KIND}}" + _shares(errors.status_share)
        for number, part in errors.corridors.items() if len(errors.corridors) > 1 else ():
            yield f"{f'  corridor {number}':<{NAME + KIND}}" + _shares(part.status_share)


def _shares(shares: Mapping[str, float] | None) -> str:
    return "".join(f"{100 * (shares or {}).get(word, 0.0):>13.1f}" for word in STATUSES)


def excluded_text(errors: TableErrors) -> str:
    """Report how many rows of estimates were not judged, and the reasons; empty if all were judged."""
    return ", ".join(f"{count} {EXCLUDED[cause]}" for cause, count in errors.excluded.items() if count)


def _remarks(found: Comparison) -> Iterator[str]:
    for output in found.outputs:
        errors = output.causal.errors
        left_out = excluded_text(errors)
        rest = f"; not judged: {left_out}" if left_out else ""
        yield f"{output.name}: {errors.judged} of {counted(errors.rows, 'row')} judged{rest}"
        if output.overlap_s < 0.98 * output.duration_s:
            yield f"  the truth covers {output.overlap_s:.1f} of its {output.duration_s:.1f} s"
        for number, constants in (output.causal.removed or {}).items():
            offset = ""
            if constants.lateral_offset_m is not None:
                offset = f", {constants.lateral_offset_m * 100:.1f} cm"
            if constants.lateral_offset_norm is not None:
                offset += f", {constants.lateral_offset_norm:.1%} of half width"
            yield f"  removed in corridor {number}: {degrees(constants.heading_rad):+.2f} degrees{offset}"
    yield "RMSE, MAE: the article's equations (9) and (10); p50 to p99: percentiles of the absolute error;"
    yield "NEES: mean of (error / sigma) squared, 1 for a consistent filter."
    if found.truth.fixed_axis:
        yield "Headings are compared from the first corridor's axis, offsets only within the first corridor."
