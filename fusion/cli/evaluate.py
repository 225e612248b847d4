"""The command ``corridor evaluate``: fused flights against a truth, side by side."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fusion.cli.console import echo
from fusion.result.conventions import Frame

SHORT_HELP = "Compare fused flights with what the vehicle really did."
HELP = """Compare fused flights with what the vehicle really did, several outputs side by side.

RMSE and MAE (the article's equations 9 and 10), the largest error, percentiles, NEES and the share of time in each
status; for heading and lateral offset, for the causal filter and the smoother, in all and per corridor. Judged are
rows that are tracking, outside junctions and within the truth's time; all others are counted.

\b
FILE is one of
  corridor_truth.csv               or the flight's folder that holds it
  CSV with names in its first line: a time (timestamp_ns, timestamp_us, timestamp_ms or timestamp_s) and one of
      heading_rad, heading_deg     from the axis of the corridor being flown, positive right
      yaw_rad, yaw_deg             from one fixed axis; give --truth-frame
      qw,qx,qy,qz                  the same as a quaternion, body to world
    and as known lateral_offset_m (or _norm), corridor_width_m, corridor_id, in_junction
  estimates.csv or smoothed.csv    of another output
  a TUM trajectory                 timestamp_s x y z qx qy qz qw: yaw from x, y as the offset; give --truth-frame

\b
Examples:
  corridor evaluate office_fused --truth data/office
  corridor evaluate geometric paper --truth data/office/corridor_truth.csv --json
  corridor evaluate hall_fused --truth mocap.tum --truth-frame ros --align

Next: `corridor fuse --config` with other settings into another OUT, and compare the two.
"""


def evaluate(
    outs: Annotated[list[Path], typer.Argument(metavar="OUT...", help="Folders that `corridor fuse` wrote.")],
    truth: Annotated[
        Path, typer.Option("--truth", metavar="FILE", help="CSV or TUM trajectory, or a flight's folder.")
    ],
    truth_frame: Annotated[
        Frame | None,
        typer.Option("--truth-frame", help="Signs of the truth: frd positive right, ros positive left."),
    ] = None,
    align: Annotated[
        bool, typer.Option("--align", help="Take out the constant between truth and estimate, and tell it.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON, not tables.")] = False,
) -> None:
    """Compare outputs with a truth."""
    from fusion.cli.evaluate_text import comparison_text
    from fusion.evaluation.comparison import compare, read_outputs
    from fusion.evaluation.truth_file import read_truth
    from fusion.result.summary_json import summary_json

    found = compare(read_outputs(outs), read_truth(truth, truth_frame), align=align)
    echo(summary_json(found).rstrip("\n") if as_json else comparison_text(found))
