"""The command ``corridor evaluate``: fused flights against ground truth."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fusion.cli.console import echo
from fusion.result.conventions import Frame

SHORT_HELP = "Compare fused flights with ground truth."
HELP = """Compare fused flights with ground truth, several outputs side by side.

It prints RMSE, MAE, maximum, percentiles and NEES of heading and offset, for filter and smoother. Rows are evaluated
while tracking, outside junctions. Formats of the truth: docs/commands.md.

\b
Examples:
  corridor evaluate office_fused --truth data/office
  corridor evaluate hall_fused --truth mocap.tum --truth-frame ros --align
  corridor evaluate geometric paper --truth data/office --plot errors.svg --table errors.tex

Next: run `corridor fuse --config` with other settings and another OUT, and compare the two.
"""


def evaluate(
    outs: Annotated[list[Path], typer.Argument(metavar="OUT", help="Output folders of `corridor fuse`.")],
    truth: Annotated[
        Path, typer.Option("--truth", metavar="FILE", help="CSV or TUM trajectory, or a flight's folder.")
    ],
    truth_frame: Annotated[
        Frame | None,
        typer.Option("--truth-frame", help="Signs of the truth: frd is positive right, ros positive left."),
    ] = None,
    truth_shift_s: Annotated[
        float,
        typer.Option(
            "--truth-shift", metavar="SECONDS", help="Added to the truth's times, if it has another clock."
        ),
    ] = 0.0,
    align: Annotated[
        bool,
        typer.Option(
            "--align", help="Remove the constant difference between truth and estimate, and print it."
        ),
    ] = False,
    plot: Annotated[
        Path | None,
        typer.Option("--plot", metavar="FILE", help="Draw the errors over time: .png, .svg or .pdf."),
    ] = None,
    table: Annotated[
        Path | None, typer.Option("--table", metavar="FILE", help="Write the errors: .csv, .md or .tex.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON, not tables.")] = False,
) -> None:
    """Compare outputs with ground truth."""
    from fusion.cli.evaluate_text import comparison_text
    from fusion.evaluation.comparison import compare, read_outputs
    from fusion.evaluation.truth_file import read_truth
    from fusion.result.summary_json import summary_json

    outputs, true = read_outputs(outs), read_truth(truth, truth_frame).shifted(truth_shift_s)
    found = compare(outputs, true, align=align)
    if table is not None:
        from fusion.evaluation.comparison_table import write_comparison_table

        write_comparison_table(found, table)
    if plot is not None:
        from fusion.report.comparison import write_comparison_figure

        write_comparison_figure(outputs, true, plot, align=align)
    echo(summary_json(found).rstrip("\n") if as_json else comparison_text(found))
