"""The command ``corridor measure``: single pictures, without the filter."""

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

Of a folder, all pictures are measured. The table goes to stdout as CSV, or to a file with -o. Without --camera or
--attitude it prints what it assumes. Columns and assumptions: docs/commands.md.

\b
Examples:
  corridor measure picture.jpg
  corridor measure pictures --camera camera.yaml -o frames.csv --overlay drawn

Next: look at the pictures in --overlay DIR. With an IMU log, `corridor fuse` gives smooth estimates.
"""


def measure(
    pictures: Annotated[
        list[Path],
        typer.Argument(metavar="IMAGE|FOLDER", help="Pictures, or folders of them."),
    ],
    camera: CameraOption = None,
    fov_deg: Annotated[
        float | None,
        typer.Option("--fov", metavar="DEGREES", help="Horizontal field of view, in place of --camera."),
    ] = None,
    attitude: Annotated[
        Path | None,
        typer.Option("--attitude", metavar="CSV", help="Roll and pitch of the body: docs/commands.md."),
    ] = None,
    method: MethodOption = Method.GEOMETRIC,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", metavar="frames.csv", help="Write the table to this file."),
    ] = None,
    overlay: Annotated[
        Path | None,
        typer.Option("--overlay", metavar="DIR", help="Write pictures with their lines to this folder."),
    ] = None,
) -> None:
    """Measure pictures one by one."""
    from fusion.cli.measure_text import assumptions_text, measured_text
    from fusion.pictures.assumed_camera import assume_views
    from fusion.pictures.attitude_file import AttitudeFile
    from fusion.pictures.measure import check_overlay_dir, check_table_file, find_images, measure_images
    from fusion.result.tables_csv import print_table, write_table
    from vision import Camera

    paths = find_images(pictures)
    if out is not None:
        check_table_file(out)
    if overlay is not None:
        check_overlay_dir(overlay)
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
