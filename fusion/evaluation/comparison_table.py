"""A comparison with ground truth as a table for papers and spreadsheets: CSV, Markdown or LaTeX."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator
from math import degrees
from pathlib import Path

from fusion.evaluation.comparison import Comparison
from fusion.files import replacing
from fusion.result.summary import TableErrors
from vision.errors import InputError

FORMATS = (".csv", ".md", ".tex")
HEAD = (
    "output", "estimate",
    "heading RMSE, deg", "heading MAE, deg", "heading p95, deg", "heading max, deg", "heading NEES",
    "offset RMSE, cm", "offset MAE, cm", "offset max, cm",
)  # fmt: skip
_LATEX = {c: "\\" + c for c in "&%$#_{}"} | {
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
}


def write_comparison_table(found: Comparison, path: Path) -> None:
    """Write a row for each output's filter and smoother, atomically; the extension selects the format.

    LaTeX needs the package booktabs.

    Raises
    ------
    InputError
        If the extension is none of `FORMATS`, or the file cannot be written.
    """
    ending = path.suffix.lower()
    if ending not in FORMATS:
        remedy = f"end it in {', '.join(FORMATS[:-1])} or {FORMATS[-1]}"
        raise InputError("is not a table format", file=path, remedy=remedy)
    rows = list(_rows(found))
    text = {".csv": _as_csv, ".md": _as_markdown, ".tex": _as_latex}[ending](rows)
    with replacing(path) as draft:
        draft.write_text(text, encoding="utf-8", errors="backslashreplace")


def _rows(found: Comparison) -> Iterator[tuple[str, ...]]:
    for output in found.outputs:
        yield output.name, "filter", *_cells(output.causal.errors)
        yield output.name, "smoother", *_cells(output.smoothed.errors)


def _cells(errors: TableErrors) -> Iterator[str]:
    heading, offset = errors.heading, errors.lateral_offset_m
    for angle in (heading.rmse, heading.mae, heading.p95, heading.max):
        yield "" if angle is None else f"{degrees(angle):.3f}"
    yield "" if heading.nees_mean is None else f"{heading.nees_mean:.2f}"
    for length in (None,) * 3 if offset is None else (offset.rmse, offset.mae, offset.max):
        yield "" if length is None else f"{100.0 * length:.2f}"


def _as_csv(rows: list[tuple[str, ...]]) -> str:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([HEAD, *rows])
    return text.getvalue()


def _as_markdown(rows: list[tuple[str, ...]]) -> str:
    rule = ("---",) * 2 + ("---:",) * (len(HEAD) - 2)
    escaped = [tuple(cell.replace("|", "\\|") for cell in row) for row in (HEAD, rule, *rows)]
    return "".join(f"| {' | '.join(row)} |\n" for row in escaped)


def _as_latex(rows: list[tuple[str, ...]]) -> str:
    def line(row: tuple[str, ...]) -> str:
        return " & ".join("".join(_LATEX.get(c, c) for c in cell) for cell in row) + r" \\"

    columns = "ll" + "r" * (len(HEAD) - 2)
    body = [line(HEAD), r"\midrule", *(line(row) for row in rows)]
    parts = [rf"\begin{{tabular}}{{{columns}}}", r"\toprule", *body, r"\bottomrule", r"\end{tabular}"]
    return "\n".join(parts) + "\n"
