"""The command ``corridor align``: put camera and clock right by the flight itself."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fusion.cli.console import compile_notice, echo, progress_bar, say
from vision.errors import InputError

SHORT_HELP = "Put camera and clock right by the flight itself: time offset, focal length, mounting."
HELP = """Find time offset, focal length and mounting of a flight's camera by the flight itself.

Turns that vision sees along the corridor are compared with those of the gyroscope (of the attitude, where there is
no gyroscope). That takes some turning left and right; the mounting yaw takes some rolling and pitching too. Each
quantity comes with its sigma and a sentence; `corrects` stands beside those that differ by more than three sigma
from how the flight was read. The gyroscope's scale is taken to be right.

FLIGHT is what `corridor fuse` takes. Where there is no calibration of the camera, the focal length is found by the
flight, too, with no distortion and the principal point in the middle.

\b
Nothing is written unless asked for:
  --write      into the flight's own manifest: FLIGHT, or flight.toml in its folder, or LOG.toml beside a log file
  -o FILE      into a manifest of your own that names the flight's files
Corrections go under [camera]: clock_offset_s, focal_scale, mount_yaw_rad, mount_pitch_rad; on top of those that
are there. A camera that nothing was known of also gets a calibration file beside the manifest.

\b
Examples:
  corridor align flights/hall
  corridor align flights/hall --write
  corridor align flights/hall -o hall.toml --max-offset 10

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
        raise InputError(alignment.clock_offset.sentence, file=flight)
    echo(alignment_text(alignment))
    if place is None:
        say("nothing written: add --write, or -o FILE.toml")
        return
    for path in write_alignment(alignment, loaded.flight, place):
        say(f"wrote {path}")
