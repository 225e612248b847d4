"""The command ``corridor align``: calibrate the camera's clock, focal length and mounting from a flight."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fusion.cli.console import compile_notice, echo, progress_bar, say
from vision.errors import InputError

SHORT_HELP = "Calibrate the camera from the flight: time offset, focal length, mounting."
HELP = """Estimate time offset, focal length and mounting angles of the camera from the flight.

It compares turns seen by vision with those of the gyroscope, so the flight must turn left and right. Each quantity is
printed with its sigma. Nothing is written without --write or -o. More: docs/commands.md.

\b
Examples:
  corridor align data/office
  corridor align flights/hall --write

If the time offset cannot be estimated, as without turns, the exit code is 2 and nothing is written.
Next: corridor fuse with that manifest.
"""


def align(
    flight: Annotated[Path, typer.Argument(metavar="FLIGHT", help="A flight, as for `corridor fuse`.")],
    camera: Annotated[
        Path | None,
        typer.Option("--camera", metavar="CAM.yaml", help="Calibration in place of the flight's."),
    ] = None,
    max_offset_s: Annotated[
        float, typer.Option("--max-offset", metavar="SECONDS", help="Largest time offset to search.")
    ] = 3.0,
    write: Annotated[bool, typer.Option("--write", help="Write to the flight's own manifest.")] = False,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", metavar="FILE.toml", help="Write to this manifest.")
    ] = None,
) -> None:
    """Align a flight, and write its manifest on request."""
    from fusion.alignment import align_flight
    from fusion.alignment.manifest import check_place, former_of, load_to_align, place_of, write_alignment
    from fusion.alignment.opposite import opposite_remedy
    from fusion.alignment.text import alignment_text

    if write and out is not None:
        raise InputError("--write and -o name two places", remedy="give one of them")
    place = out
    if place is None and write and flight.exists():
        place = place_of(flight)
    if place is not None:
        check_place(place)  # before the work
    loaded = load_to_align(flight, camera)
    if not loaded.camera_known:
        say("no calibration: the focal length is estimated, too")
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
    is_rewritten, is_kept = place.exists(), former_of(place).exists()
    for path in write_alignment(alignment, loaded.flight, place):
        say(f"wrote {path}")
    if is_rewritten:
        kept = f"{former_of(place)} is still the first {place.name}" if is_kept else ""
        say(kept or f"kept the former {place.name} as {former_of(place)}")
