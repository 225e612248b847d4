"""The command ``corridor fuse``: a logged flight into tables and a report."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import Annotated

import typer

from fusion.cli.console import compile_notice, echo, progress_bar, say
from fusion.cli.options import CameraOption, Method, MethodOption
from fusion.result.conventions import Frame

SHORT_HELP = "Fuse a logged flight: heading and offset, tables and a report."
HELP = """Fuse a logged flight into a smooth heading and lateral offset.

\b
FLIGHT is one of
  a folder in ASL / EuRoC layout, the truth beside it if known: mav0/cam0/{sensor.yaml,data.csv,data/*}, and as
    there are mav0/imu0, mav0/attitude0, mav0/velocity0, mav0/position0, mav0/range0; corridor_truth.csv
  a ROS 1 or 2 bag or MCAP with pictures; a folder of TUM RGB-D, UZH-FPV or KITTI
  a flight.toml, or the folder that holds it: where each stream comes from, see below
  a PX4 ULog, ArduPilot DataFlash log, MAVLink tlog or CSV, together with --video
Without FLIGHT: --imu and --video name the files; their clocks may differ by --clock-offset.

\b
OUT gets these, whole or not at all; an earlier output there is replaced:
  estimates.csv   the causal filter, a row per IMU sample: heading, offset, sigmas, bias, status
  smoothed.csv    the same after the backward pass: the best answer once the flight is over
  frames.csv      a row per camera frame: what vision saw, used or not, and why
  summary.json    verdict, counts, timings, errors against the truth
  report.html     all of it to look at, in one file
  flight.toml     where every stream came from, to fuse again or for `corridor align`

\b
With --export, also:
  parquet   estimates, smoothed, frames .parquet: the tables with units and frames in their metadata
  tum       estimates.tum, smoothed.tum: trajectories for evo
  mcap      flight.mcap: pictures with what was seen in them, estimates and events, for Foxglove

\b
Examples:
  corridor fuse data/office
  corridor fuse data/office --export parquet,mcap --frame ros
  corridor fuse flights/hall -o out/hall --config hall.toml
  corridor fuse flights/hall --camera camchain.yaml --method paper
  corridor fuse log.ulg --video hall.mp4 --camera cam.yaml --clock-offset 12.85
  corridor fuse --imu imu.csv --video pictures/ --camera cam.yaml

\b
flight.toml, for streams in several files; paths count from its folder, flight time = file time + clock_offset_s:
  corridor_width_m = 2.2
  [camera]
  file = "hall.mp4"              # or a folder of pictures; times = "times.csv" where a CSV has the frames' times,
                                 # rate_hz = 20 where they are numbered
  calibration = "camera.yaml"
  clock_offset_s = 12.85
  [imu]
  file = "imu.csv"               # or a log; topic = "/imu/data" chooses one of several
  frame = "flu"                  # x ahead, y left, z up; frd is x ahead, y right, z down
  camera_axis = "-z"             # a phone: the IMU's axis that the camera looks along; gravity tells the rest
  columns = { time = "t", time_unit = "ms", gyro = ["gx", "gy", "gz"], gyro_unit = "deg/s" }
  [attitude]
  file = "state.csv"
  columns = "tello"              # ready maps: tello, crazyflie, betaflight, ardrone, ardrone_ros

\b
hall.toml, for offsets in metres where the log has no range sensor:
  corridor_width_m = 2.2

Next: open OUT/report.html, or read the tables: pandas.read_csv("OUT/estimates.csv").
"""

ExportOption = Annotated[
    list[str] | None,
    typer.Option("--export", metavar="parquet,tum,mcap", help="Write these besides CSV; may be repeated."),
]
FrameOption = Annotated[
    Frame,
    typer.Option(
        "--frame",
        help="Signs in the files: frd, positive right; ros (FLU, ENU), positive left. summary.json names it.",
    ),
]


def fuse(
    flight: Annotated[
        Path | None,
        typer.Argument(
            metavar="[FLIGHT]", help="A flight's folder, a flight.toml or a log.", show_default=False
        ),
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", metavar="OUT", help="Output folder; else FLIGHT-name_fused.")
    ] = None,
    imu: Annotated[
        Path | None,
        typer.Option("--imu", metavar="LOG", help="Log or CSV of the IMU, and what else it holds."),
    ] = None,
    video: Annotated[
        Path | None, typer.Option("--video", metavar="VIDEO", help="Video, or folder of pictures with times.")
    ] = None,
    attitude: Annotated[
        Path | None, typer.Option("--attitude", metavar="LOG", help="Log or CSV of the attitude alone.")
    ] = None,
    clock_offset_s: Annotated[
        float | None,
        typer.Option(
            "--clock-offset", metavar="SECONDS", help="Add to the pictures' times to give the IMU's."
        ),
    ] = None,
    config: Annotated[
        Path | None,
        typer.Option("--config", metavar="F.toml", help="Settings; the rest keep defaults."),
    ] = None,
    camera: CameraOption = None,
    method: MethodOption = Method.GEOMETRIC,
    export: ExportOption = None,
    frame: FrameOption = Frame.FRD,
) -> None:
    """Fuse a flight and write its files."""
    from fusion import FusionConfig, fuse_flight
    from fusion.cli.fuse_options import flight_from_options, outside_text
    from fusion.cli.fuse_text import fusion_text
    from fusion.outputs.exports import check_formats, remarks
    from fusion.outputs.folder import check_out_dir, write_outputs

    if out is not None:
        check_out_dir(out)  # before the work, not after it
    exports = check_formats(export or ())
    settings = None if config is None else FusionConfig.from_toml(config)
    log = flight_from_options(
        flight, imu=imu, video=video, attitude=attitude, camera=camera, clock_offset_s=clock_offset_s
    )
    if (told := outside_text(flight)) is not None:
        say(told)
    folder = out if out is not None else Path(f"{log.name}_fused")
    check_out_dir(folder)
    with compile_notice("the line finder"), progress_bar("fusing") as progress:
        result = fuse_flight(log, settings, method=method.value, progress=progress)
    with progress_bar("writing") as progress:
        command = shlex.join(["corridor", *sys.argv[1:]])
        write_outputs(result, log, folder, exports=exports, frame=frame, command=command, progress=progress)
    echo(fusion_text(result.overview, folder, remarks(exports, frame)))
