"""The command ``corridor measure``: single pictures, without a filter."""

from __future__ import annotations

import sys
from math import radians
from pathlib import Path
from typing import Annotated

import typer

from fusion.cli.console import compile_notice, progress_bar, say
from fusion.cli.options import CameraOption, Method, MethodOption
from vision.errors import InputError

SHORT_HELP = "Measure single pictures: heading, offset, vanishing point."
HELP = """Measure single pictures of a corridor: heading, lateral offset, vanishing point. No filter.

Folders are taken with all the pictures in them. The table goes to stdout as CSV, or to a file with -o; its
columns are those of frames.csv, with the picture first. A picture that does not decode is a row with the
reason `unreadable`. A picture's name that is an integer is taken for its time in nanoseconds.

\b
What is assumed unless given:
  --camera      a lens without distortion that looks straight ahead; its horizontal field of view from, in this order,
                --fov, the focal length in the picture's EXIF, the right angles in all pictures of one size, or
                65 +- 20 degrees. It is said which, and the headings' sigma includes it.
  --attitude    level, within about 12 degrees

\b
--attitude CSV is one of
  timestamp_ns,qw,qx,qy,qz     body to world as in attitude0/data.csv (FLU, z up), matched by nearest time
  image,roll_rad,pitch_rad     with these names in the first line; roll right side down, pitch nose up

\b
Examples:
  corridor measure picture.jpg
  corridor measure hall/mav0/cam0/data --camera hall/mav0/cam0/sensor.yaml -o frames.csv --overlay drawn
  corridor measure *.jpg --fov 54 -o frames.csv
  corridor measure *.png --attitude tilt.csv > frames.csv

Next: look at the drawings in --overlay DIR; with an IMU log, `corridor fuse` makes it smooth.
"""


def measure(
    pictures: Annotated[
        list[Path],
        typer.Argument(metavar="IMAGE|FOLDER...", help="Pictures, or folders of them."),
    ],
    camera: CameraOption = None,
    fov_deg: Annotated[
        float | None,
        typer.Option(
            "--fov", metavar="DEGREES", help="Horizontal field of view, where there is no --camera."
        ),
    ] = None,
    attitude: Annotated[
        Path | None, typer.Option("--attitude", metavar="CSV", help="Roll and pitch of the body, see above.")
    ] = None,
    method: MethodOption = Method.GEOMETRIC,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", metavar="frames.csv", help="Write the table to a file."),
    ] = None,
    overlay: Annotated[
        Path | None, typer.Option("--overlay", metavar="DIR", help="Draw what was seen into pictures here.")
    ] = None,
) -> None:
    """Measure pictures one by one."""
    from fusion.cli.measure_text import assumptions_text, measured_text
    from fusion.pictures.assumed_camera import assume_views
    from fusion.pictures.attitude_file import AttitudeFile
    from fusion.pictures.measure import check_table_file, find_images, measure_images
    from fusion.result.tables_csv import print_table, write_table
    from vision import Camera

    paths = find_images(pictures)
    if out is not None:
        check_table_file(out)
    calibration = None if camera is None else Camera.from_yaml(camera)
    attitudes = None if attitude is None else AttitudeFile.read(attitude)
    if calibration is not None and fov_deg is not None:
        raise InputError("--fov and --camera say the same thing", remedy="give one of them")
    if calibration is not None and (mounting := calibration.mount_problem()) is not None:
        say(mounting)
    views = None
    if calibration is None and method is Method.GEOMETRIC:
        with compile_notice("the line finder"), progress_bar("finding the field of view") as progress:
            views = assume_views(paths, None if fov_deg is None else radians(fov_deg), progress)
    for note in assumptions_text(paths, views, attitudes, method.value):
        say(note)
    with compile_notice("the line finder"), progress_bar("measuring") as progress:
        table = measure_images(paths, calibration, attitudes, method.value, overlay, progress, views)
    if out is None:
        print_table(table, sys.stdout)
    else:
        write_table(table, out)
    say(measured_text(table, out, overlay))
