"""A comparison with a truth in words: tables that fit 100 columns."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from math import degrees
from typing import Any

from fusion.evaluation.errors import PERCENTILES
from fusion.logs.samples import counted

NAME, KIND, CELL = 24, 11, 8
MEASURES = ("rmse", "mae", "max", *(f"p{p}" for p in PERCENTILES))
QUANTITIES = (
    ("heading", "rad", "heading, degrees", degrees(1.0), 3),
    ("lateral_offset_m", "m", "lateral offset, cm", 100.0, 2),
    ("lateral_offset_norm", "norm", "lateral offset, % of half width", 100.0, 2),
)
STATUSES = ("initialising", "tracking", "coasting", "lost")
EXCLUDED = {
    "outside_truth": "outside the truth's time",
    "junction": "in a junction",
    "no_truth": "in a hole of the truth or between corridors",
    "not_tracking": "not tracking",
}


def comparison_text(found: Mapping[str, Any]) -> str:
    """Lay out what `fusion.evaluation.comparison.compare` returned."""
    truth, outputs = found["truth"], found["outputs"]
    span_s = (truth["last_ns"] - truth["first_ns"]) / 1e9
    lines = [f"truth   {truth['source']}", f"        {counted(truth['rows'], 'row')}, {span_s:.1f} s"]
    lines += [f"        problem: {problem}" for problem in truth["problems"]]
    for quantity, unit, title, factor, decimals in QUANTITIES:
        if any(quantity in output["causal"] for output in outputs):
            lines += ["", _head(title)]
            for output in outputs:
                lines += _quantity(output, quantity, unit, factor, decimals)
    if not any("lateral_offset_m" in o["causal"] or "lateral_offset_norm" in o["causal"] for o in outputs):
        lines += ["", "lateral offset: the truth has none"]
    lines += ["", *_statuses(outputs), "", *_remarks(found)]
    return "\n".join(line.rstrip() for line in lines).rstrip()


def _head(title: str) -> str:
    words = ("RMSE", "MAE", "max", *(f"p{p}" for p in PERCENTILES), "NEES")
    return f"{title:<{NAME + KIND}}" + "".join(f"{word:>{CELL}}" for word in words)


def _quantity(
    output: Mapping[str, Any], quantity: str, unit: str, factor: float, decimals: int
) -> Iterator[str]:
    name = _shortened(output["name"])
    for kind in ("causal", "smoothed"):
        yield f"{name:<{NAME}}{kind:<{KIND}}" + _cells(output[kind].get(quantity), unit, factor, decimals)
        name = ""
    corridors = output["causal"]["corridors"]
    for number in corridors if len(corridors) > 1 else ():
        name = f"  corridor {number}"
        for kind in ("causal", "smoothed"):
            part = output[kind]["corridors"].get(number, {})
            yield f"{name:<{NAME}}{kind:<{KIND}}" + _cells(part.get(quantity), unit, factor, decimals)
            name = ""


def _shortened(name: str) -> str:
    return name if len(name) < NAME else "..." + name[-(NAME - 4) :]


def _cells(statistics: Mapping[str, Any] | None, unit: str, factor: float, decimals: int) -> str:
    numbers = [(statistics or {}).get(f"{word}_{unit}") for word in MEASURES]
    texts = ["-" if number is None else _number(number * factor, decimals) for number in numbers]
    nees = (statistics or {}).get("nees_mean")
    texts.append("-" if nees is None else _number(nees, 2))
    return "".join(f"{text:>{CELL}}" for text in texts)


def _number(value: float, decimals: int) -> str:
    text = f"{value:.{decimals}f}"
    return text if len(text) < CELL else f"{value:.2g}"


def _statuses(outputs: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    title = "time in each status, %"
    yield f"{title:<{NAME + KIND}}" + "".join(f"{word:>13}" for word in STATUSES)
    for output in outputs:
        name, corridors = _shortened(output["name"]), output["causal"]["corridors"]
        yield f"{name:<{NAME}}{'causal':<{KIND}}" + _shares(output["causal"]["status_share"])
        for number, part in corridors.items() if len(corridors) > 1 else ():
            yield f"{f'  corridor {number}':<{NAME + KIND}}" + _shares(part["status_share"])


def _shares(shares: Mapping[str, float]) -> str:
    return "".join(f"{100 * shares.get(word, 0.0):>13.1f}" for word in STATUSES)


def _remarks(found: Mapping[str, Any]) -> Iterator[str]:
    for output in found["outputs"]:
        errors = output["causal"]
        left = [f"{count} {EXCLUDED[cause]}" for cause, count in errors["excluded"].items() if count]
        rest = f"; left out: {', '.join(left)}" if left else ""
        yield f"{output['name']}: {errors['judged']} of {counted(errors['rows'], 'row')} judged{rest}"
        if output["overlap_s"] < 0.98 * output["duration_s"]:
            yield f"  the truth covers {output['overlap_s']:.1f} s of its {output['duration_s']:.1f} s"
        for number, constants in (errors["removed"] or {}).items():
            offset = next(
                (f", {v * 100:.1f} cm" for k, v in constants.items() if k == "lateral_offset_m"), ""
            )
            offset += next(
                (f", {v:.1%} of half width" for k, v in constants.items() if k.endswith("norm")), ""
            )
            yield f"  taken out in corridor {number}: {degrees(constants['heading_rad']):+.2f} degrees{offset}"
    yield "RMSE, MAE: the article's equations (9) and (10); p50 to p99: percentiles of the absolute error;"
    yield "NEES: mean of (error / sigma) squared, 1 for an honest sigma."
    if found["truth"]["fixed_axis"]:
        yield "Headings are compared from the first corridor's axis, offsets only within the first corridor."
