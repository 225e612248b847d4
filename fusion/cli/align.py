"""The command ``corridor align``: put camera and clock right by the flight itself."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fusion.cli.console import compile_notice, echo, progress_bar, say
from vision.errors import InputError

SHORT_HELP = "Put camera and clock right by the flight itself: time offset, focal length, mounting."
HELP = """Find time offset, focal length and mounting of a flight's camera by the flight itself.

It compares turns that vision sees with those of the gyroscope, so the flight must turn left and right. Each quantity
comes with its sigma. Nothing is written without --write or -o. More: docs/commands.md.

\b
Examples:
  corridor align data/office
  corridor align flights/hall --write

Exit code 2 where the flight does not tell the time offset, as one without turns; nothing is then written.
Next: corridor fuse with that manifest.
"""


def align(
    flight: Annotated[Path, typer.Argument(metavar="FLIGHT", help="A flight as `corridor fuse` takes it.")],
    camera: Annotated[
        Path | None,
        typer.Option("--camera", metavar="CAM.yaml", help="Calibration to use instead of the flight's."),
    ] = None,
    max_offset_s: Annotated[
        float, typer.Option("--max-offset", metavar="SECONDS", help="How far apart the clocks may be.")
    ] = 3.0,
    write: Annotated[bool, typer.Option("--write", help="Write into the flight's own manifest.")] = False,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", metavar="FILE.toml", help="Write into this manifest.")
    ] = None,
) -> None:
    """Align a flight, and write its manifest where asked to."""
    from fusion.alignment import align_flight
    from fusion.alignment.manifest import check_place, load_to_align, place_of, write_alignment
    from fusion.alignment.opposite import opposite_remedy
    from fusion.alignment.text import alignment_text

    if write and out is not None:
        raise InputError("--write and -o say two places", remedy="give one of them")
    place = out
    if place is None and write and flight.exists():
        place = place_of(flight)
    if place is not None:
        check_place(place)  # before the work, not after it
    loaded = load_to_align(flight, camera)
    if not loaded.camera_known:
        say("no calibration: the focal length is looked for, too")
    with compile_notice("the line finder"), progress_bar("finding lines") as progress:
        alignment = align_flight(
            loaded.flight, camera_known=loaded.camera_known, max_offset_s=max_offset_s, progress=progress
        )
    if not alignment.clock_offset.usable:
        remedy = opposite_remedy(loaded.flight).rstrip(".") if alignment.turns_opposite else None
        raise InputError(alignment.clock_offset.sentence.rstrip("."), file=flight, remedy=remedy)
    echo(alignment_text(alignment))
    if place is None:
        say("nothing written: add --write, or -o FILE.toml")
        return
    for path in write_alignment(alignment, loaded.flight, place):
        say(f"wrote {path}")
