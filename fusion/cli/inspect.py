"""The command ``corridor inspect``: what a log holds, and what can be made of it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fusion.cli.console import echo, say

SHORT_HELP = "Say what a log holds, and what can be made of it."
HELP = """Say what a log holds, and what can be made of it: streams, rates, gaps, clocks, noise, the first picture.

Any format that `corridor fuse` takes. It looks at a handful of pictures only, and at the rest of a log where a part
cannot be read.

\b
Told for each stream:
  rate, jitter   one over the usual (median) step, and how far 95 of 100 steps are from it
  gaps           stretches of more than three usual steps; also repeated times and jumps of the clock
  frames covered the share of the frames that lie within the stream
  IMU            still periods, and in them white noise (Allan deviation at 0.1 s), bias and gravity

What the data contradict is said too: degrees for radians, g for m/s^2, reversed axes, clocks that do not overlap.

\b
Examples:
  corridor inspect data/office
  corridor inspect log.ulg --json > log.json
  corridor inspect flight.bag --picture first.png

Next: supply what it says is missing, then corridor fuse.
"""


def inspect(
    log: Annotated[
        Path,
        typer.Argument(metavar="LOG", help="A log file, a flight's folder or a flight.toml."),
    ],
    picture: Annotated[
        Path | None, typer.Option("--picture", metavar="FILE.png", help="Write the first picture here.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON, not text.")] = False,
) -> None:
    """Describe a log."""
    from fusion.inspection.pictures import check_picture_file, write_picture
    from fusion.inspection.sources import inspect_path
    from fusion.inspection.text import inspection_text, inspection_values
    from fusion.result.summary_json import summary_json

    if picture is not None:
        check_picture_file(picture)
    found = inspect_path(log)
    echo(summary_json(inspection_values(found)).rstrip("\n") if as_json else inspection_text(found))
    if picture is not None:
        write_picture(found.first_picture, picture)
        say(f"first picture in {picture}")
