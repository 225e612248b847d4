"""The command ``corridor inspect``: what a log contains, and what can be fused."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fusion.cli.console import echo, say

SHORT_HELP = "List what a log contains, and what can be fused."
HELP = """List what a log contains and what can be fused: streams, rates, gaps, clocks, noise, the first picture.

It reads every format that `corridor fuse` does. For what is missing or inconsistent it names the setting that
corrects it. The meaning of each line: docs/commands.md.

\b
Examples:
  corridor inspect data/office
  corridor inspect log.ulg --json > log.json

Next: supply what is missing, then run corridor fuse.
"""


def inspect(
    log: Annotated[
        Path,
        typer.Argument(metavar="LOG", help="A log file, a flight's folder or a flight.toml."),
    ],
    picture: Annotated[
        Path | None,
        typer.Option("--picture", metavar="FILE.png", help="Write the first picture to this file."),
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
