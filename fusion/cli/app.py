"""The command ``corridor``: a thin layer over functions that can also be called from Python.

Each command is a module of this package with its help; this one only assembles them. Results go to stdout, all other
output to stderr. Exit codes: 0 success; 2 input or options that cannot be used; 130 interrupted. Commands import
heavy modules themselves, so that ``--help`` is quick.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Sequence
from io import TextIOWrapper
from typing import Annotated, NoReturn

import typer

from fusion.cli import align, batch, config, evaluate, fuse, inspect, live, measure, simulate
from fusion.cli.console import OneLineErrors

HELP = """Heading and lateral offset in indoor corridors, from camera frames fused with an IMU.

\b
First steps:
  corridor fuse data/office           fuse the sample flight; then open office_fused/report.html
  corridor batch flights -o out       many flights into one table; then open out/fleet.html
  corridor inspect log.ulg            what a log contains, what is missing, how to supply it
  corridor align data/office          calibrate time offset, focal length and mounting from the flight
  corridor config > my.toml           all settings, explained; edit them and pass them to fuse
  corridor evaluate office_fused --truth data/office    errors against ground truth
  corridor measure picture.jpg        single pictures; needs no IMU and no calibration
  corridor live /dev/video0 ...       on the vehicle: camera and MAVLink in, estimates out
  corridor simulate flight            a simulated flight with ground truth

Heading is the angle from the corridor's axis to the vehicle's nose, positive when turned right. Lateral
offset is positive right of the centre line. Files are in radians, metres and nanoseconds.

Results go to stdout, notes and progress to stderr. The exit code is 0 on success, 2 for input that cannot be
used (one line says why), and 130 after an interrupt.

`corridor COMMAND --help` lists the options of a command; the manual is docs/commands.md.
"""

app = typer.Typer(
    cls=OneLineErrors,
    add_completion=True,
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110},
)


def _print_version(wanted: bool) -> None:
    if wanted:
        from fusion import __version__

        typer.echo(f"corridor-fusion {__version__}")
        raise typer.Exit


@app.callback(help=HELP)
def corridor(
    version: Annotated[
        bool,
        typer.Option("--version", "-V", help="Print the version.", is_eager=True, callback=_print_version),
    ] = False,
) -> None:
    """Define the command group."""


#: In the order of the help.
for _name, _help, _short_help, _command in (
    ("fuse", fuse.HELP, fuse.SHORT_HELP, fuse.fuse),
    ("batch", batch.HELP, batch.SHORT_HELP, batch.batch),
    ("inspect", inspect.HELP, inspect.SHORT_HELP, inspect.inspect),
    ("measure", measure.HELP, measure.SHORT_HELP, measure.measure),
    ("align", align.HELP, align.SHORT_HELP, align.align),
    ("simulate", simulate.HELP, simulate.SHORT_HELP, simulate.simulate),
    ("live", live.HELP, live.SHORT_HELP, live.live),
    ("evaluate", evaluate.HELP, evaluate.SHORT_HELP, evaluate.evaluate),
    ("config", config.HELP, config.SHORT_HELP, config.print_config),
):
    app.command(_name, help=_help, short_help=_short_help)(_command)


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """Run the command line and exit; the entry point of the script ``corridor``."""
    if isinstance(sys.stdout, TextIOWrapper):  # terminals without a degree sign show a question mark
        sys.stdout.reconfigure(errors="replace")
    if not sys.warnoptions:  # hide warnings of libraries from users
        warnings.simplefilter("ignore")
    app(arguments, prog_name="corridor")
    raise SystemExit(0)


if __name__ == "__main__":
    main()
