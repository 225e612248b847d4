"""The command ``corridor``: thin, so that all it does can be done from Python as well.

Results go to stdout, all else to stderr. Exit codes: 0 done; 2 input or usage that cannot be used; 130
interrupted. Heavy modules load inside the commands, so that ``--help`` is quick.
"""

from __future__ import annotations

import errno
import sys
from collections.abc import Sequence
from enum import StrEnum
from io import TextIOWrapper
from math import radians
from pathlib import Path
from typing import Annotated, Any, NoReturn

import typer
from typer.core import TyperGroup

from fusion.cli import align as cli_align
from fusion.cli import help as cli_help
from fusion.progress import compile_notice, progress_bar, say
from fusion.result.conventions import Frame
from vision.errors import InputError


class Method(StrEnum):
    """How a frame's vanishing point is found."""

    GEOMETRIC = "geometric"
    PAPER = "paper"


class _OneLineErrors(TyperGroup):
    """Commands whose input errors are one line on stderr and exit code 2, never a traceback."""

    def invoke(self, ctx: Any) -> Any:
        try:
            return super().invoke(ctx)
        except InputError as error:
            say("error: " + " ".join(str(error).split()))
        except OSError as error:
            if error.errno == errno.EPIPE:  # whoever read our output has gone: end as pipes do
                raise
            where = f"{error.filename}: " if error.filename else ""
            say(f"error: {where}{error.strerror or error}")
        except KeyboardInterrupt:
            say("interrupted")
            raise typer.Exit(130) from None
        raise typer.Exit(2)


app = typer.Typer(
    cls=_OneLineErrors,
    add_completion=False,
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110},
)

CameraOption = Annotated[
    Path | None,
    typer.Option(
        "--camera",
        metavar="CAM.yaml",
        help="Calibration: EuRoC, Kalibr, ROS camera_info or OpenCV, YAML or JSON, pinhole or fisheye.",
    ),
]
MethodOption = Annotated[
    Method,
    typer.Option(
        "--method",
        help="geometric: sub-pixel lines, gravity-aided; paper: the article's k-means chain, for comparison.",
    ),
]

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


def _print_version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        typer.echo(f"corridor-fusion {version('corridor-fusion')}")
        raise typer.Exit


@app.callback(help=cli_help.CORRIDOR)
def corridor(
    version: Annotated[
        bool, typer.Option("--version", help="Print the version.", is_eager=True, callback=_print_version)
    ] = False,
) -> None:
    """Offer the commands."""


@app.command(help=cli_help.FUSE, short_help="Fuse a logged flight: heading and offset, tables and a report.")
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
    from fusion.cli.fuse_options import flight_from_options
    from fusion.offline.summary_text import fusion_text
    from fusion.outputs.exports import check_formats, remarks
    from fusion.outputs.folder import check_out_dir, write_outputs

    if out is not None:
        check_out_dir(out)  # before the work, not after it
    exports = check_formats(export or ())
    settings = None if config is None else FusionConfig.from_toml(config)
    log = flight_from_options(
        flight, imu=imu, video=video, attitude=attitude, camera=camera, clock_offset_s=clock_offset_s
    )
    folder = out if out is not None else Path(f"{log.name}_fused")
    check_out_dir(folder)
    with compile_notice("the line finder"), progress_bar("fusing") as progress:
        result = fuse_flight(log, settings, method=method.value, progress=progress)
    with progress_bar("writing") as progress:
        write_outputs(result, log, folder, exports=exports, frame=frame, progress=progress)
    typer.echo(fusion_text(result.summary, folder, remarks(exports, frame)))


@app.command(help=cli_help.INSPECT, short_help="Say what a log holds, and what can be made of it.")
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
    from fusion.outputs.folder import summary_json

    if picture is not None:
        check_picture_file(picture)
    found = inspect_path(log)
    text = summary_json(inspection_values(found)) if as_json else inspection_text(found)
    typer.echo(text, nl=not as_json)
    if picture is not None:
        write_picture(found.first_picture, picture)
        say(f"first picture in {picture}")


@app.command(help=cli_help.MEASURE, short_help="Measure single pictures: heading, offset, vanishing point.")
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
    from fusion.offline.summary_text import assumptions_text, measured_text
    from fusion.outputs.folder import print_table, write_table
    from fusion.pictures.assumed_camera import assume_views
    from fusion.pictures.attitude_file import AttitudeFile
    from fusion.pictures.measure import check_table_file, find_images, measure_images
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


app.command(
    name="align",
    help=cli_align.HELP,
    short_help="Put camera and clock right by the flight itself: time offset, focal length, mounting.",
)(cli_align.align)


@app.command(help=cli_help.SIMULATE, short_help="Make a flight to try things on, truth included.")
def simulate(
    out: Annotated[Path, typer.Argument(metavar="OUT", help="The flight's folder, to be made.")],
    config: Annotated[
        Path | None, typer.Option("--config", metavar="F.toml", help="Settings; the options below go on top.")
    ] = None,
    seed: Annotated[int | None, typer.Option("--seed", help="Another corridor, motion and noise.")] = None,
    duration_s: Annotated[
        float | None, typer.Option("--duration", metavar="SECONDS", help="Length of the flight.")
    ] = None,
    width_m: Annotated[
        float | None, typer.Option("--width", metavar="METRES", help="Width of the corridor.")
    ] = None,
    size: Annotated[
        str | None, typer.Option("--size", metavar="WIDTHxHEIGHT", help="Of the pictures, in pixels.")
    ] = None,
    turn_deg: Annotated[
        float | None,
        typer.Option(
            "--turn", metavar="DEGREES", help="Turn into a side corridor half way, positive right, 30 to 150."
        ),
    ] = None,
    camera: CameraOption = None,
) -> None:
    """Simulate a flight and write its folder."""
    from fusion.cli.simulate_options import simulation_config
    from fusion.simulate.flight import simulate_flight
    from vision import Camera

    settings = simulation_config(
        config, seed=seed, duration_s=duration_s, width_m=width_m, size=size, turn_deg=turn_deg
    )
    calibration = None if camera is None else Camera.from_yaml(camera)
    with compile_notice("the renderer"), progress_bar("rendering") as progress:
        simulate_flight(settings, out, progress, calibration)
    typer.echo(f"{out}: a flight of {settings.motion.duration_s:g} s; next: corridor fuse {out}")


@app.command(help=cli_help.EVALUATE, short_help="Compare fused flights with what the vehicle really did.")
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
    from fusion.evaluation.comparison import compare, read_outputs
    from fusion.evaluation.comparison_text import comparison_text
    from fusion.evaluation.truth_file import read_truth
    from fusion.outputs.folder import summary_json

    found = compare(read_outputs(outs), read_truth(truth, truth_frame), align=align)
    typer.echo(summary_json(found) if as_json else comparison_text(found), nl=not as_json)


@app.command("config", help=cli_help.CONFIG, short_help="Print all settings with their meaning, as TOML.")
def print_config(
    file: Annotated[
        Path | None, typer.Argument(metavar="[FILE.toml]", help="Settings that differ; else the defaults.")
    ] = None,
    simulate: Annotated[
        bool, typer.Option("--simulate", help="Those of `corridor simulate`, not of `corridor fuse`.")
    ] = False,
) -> None:
    """Print a configuration whole."""
    from fusion.cli.config import settings_text

    typer.echo(settings_text(file, simulate=simulate), nl=False)


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """Run the command line and exit; the entry point of the script ``corridor``."""
    if isinstance(
        sys.stdout, TextIOWrapper
    ):  # a terminal that cannot write a degree sign gets a question mark
        sys.stdout.reconfigure(errors="replace")
    app(arguments, prog_name="corridor")
    raise SystemExit(0)


if __name__ == "__main__":
    main()
