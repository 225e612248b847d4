"""The command ``corridor fuse``: a logged flight into tables and a report."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fusion.cli.console import command_line, compile_notice, echo, progress_bar, say
from fusion.cli.options import CameraOption, ConfigOption, Method, MethodOption
from fusion.result.conventions import Frame

SHORT_HELP = "Fuse a logged flight: heading and offset, tables and a report."
HELP = """Fuse a logged flight into a smooth heading and lateral offset, with tables and a report.

FLIGHT is a flight's folder, a bag, a flight.toml, or an autopilot's log together with --video. OUT is written
completely or not at all. Inputs, outputs and exports: docs/commands.md.

\b
Examples:
  corridor fuse data/office
  corridor fuse log.ulg --video hall.mp4 --camera cam.yaml -o out/hall --export parquet,mcap

\b
A flight.toml lists streams that are in several files:
  corridor_width_m = 2.2
  [camera]
  file = "hall.mp4"
  calibration = "camera.yaml"
  [imu]
  file = "imu.csv"
  frame = "flu"

Next: open OUT/report.html, or read the tables: pandas.read_csv("OUT/estimates.csv").
"""

FlightArgument = Annotated[
    Path | None,
    typer.Argument(metavar="FLIGHT", help="A flight's folder, a flight.toml or a log.", show_default=False),
]
OutOption = Annotated[
    Path | None, typer.Option("--out", "-o", metavar="OUT", help="Output folder; default FLIGHT-name_fused.")
]
ImuOption = Annotated[
    Path | None, typer.Option("--imu", metavar="LOG", help="Log or CSV of the IMU and other sensors.")
]
VideoOption = Annotated[
    Path | None, typer.Option("--video", metavar="VIDEO", help="Video, or folder of pictures with times.")
]
AttitudeOption = Annotated[
    Path | None, typer.Option("--attitude", metavar="LOG", help="Log or CSV of the attitude only.")
]
ClockOffsetOption = Annotated[
    float | None,
    typer.Option("--clock-offset", metavar="SECONDS", help="Added to the pictures' times to give the IMU's."),
]
ExportOption = Annotated[
    list[str] | None,
    typer.Option(
        "--export", metavar="parquet,tum,mcap,video", help="Also write these formats; may be repeated."
    ),
]
FrameOption = Annotated[
    Frame,
    typer.Option(
        "--frame",
        help="Signs in the files: frd is positive right, ros (FLU, ENU) positive left; noted in summary.json.",
    ),
]
JobsOption = Annotated[
    int | None,
    typer.Option(
        "--jobs", metavar="N", min=1, help="Threads, including the filter's; default one per core, up to 8."
    ),
]


def fuse(
    flight: FlightArgument = None,
    out: OutOption = None,
    imu: ImuOption = None,
    video: VideoOption = None,
    attitude: AttitudeOption = None,
    clock_offset_s: ClockOffsetOption = None,
    config: ConfigOption = None,
    camera: CameraOption = None,
    method: MethodOption = Method.GEOMETRIC,
    export: ExportOption = None,
    frame: FrameOption = Frame.FRD,
    jobs: JobsOption = None,
) -> None:
    """Fuse a flight and write its files."""
    from fusion import FusionConfig, fuse_flight
    from fusion.cli.fuse_options import flight_from_options, outside_text
    from fusion.cli.fuse_text import fusion_text
    from fusion.live.replay import recorded_config, replay
    from fusion.logs.rosbag.attachments import is_recording
    from fusion.outputs.exports import check_formats, remarks
    from fusion.outputs.folder import check_out_dir, write_outputs

    if out is not None:
        check_out_dir(out)  # before the work
    exports = check_formats(export or ())
    settings = None if config is None else FusionConfig.from_toml(config)
    again = None
    if flight is not None and is_recording(flight):
        settings = settings or recorded_config(flight)
        again = replay(flight)
    log = flight_from_options(
        flight, imu=imu, video=video, attitude=attitude, camera=camera, clock_offset_s=clock_offset_s
    )
    if (outside := outside_text(flight)) is not None:
        say(outside)
    folder = out if out is not None else Path(f"{log.name}_fused")
    check_out_dir(folder)
    with compile_notice("the line finder"), progress_bar("fusing") as progress:
        result = fuse_flight(log, settings, method=method.value, progress=progress, jobs=jobs)
    with progress_bar("writing") as progress:
        write_outputs(
            result,
            log,
            folder,
            exports=exports,
            frame=frame,
            command=command_line(),
            progress=progress,
            sent=None if again is None else again.estimates,
        )
    echo(fusion_text(result.overview, folder, remarks(exports, frame)))
    if again is not None:
        echo(again.text())
