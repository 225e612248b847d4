"""The command ``corridor simulate``: a simulated flight with ground truth."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fusion.cli.console import compile_notice, echo, progress_bar
from fusion.cli.options import CameraOption

SHORT_HELP = "Simulate a flight, with ground truth."
HELP = """Simulate a flight through a furnished, lit corridor: pictures, IMU, attitude and exact ground truth.

The same settings give the same files, byte for byte. OUT is a flight folder for `corridor fuse`; it must not exist
yet. All settings: corridor config --simulate.

\b
Examples:
  corridor simulate flight
  corridor simulate turn --turn -65 --duration 30 --seed 7

Next: corridor fuse OUT, which reports the errors against the ground truth.
"""


def simulate(
    out: Annotated[Path, typer.Argument(metavar="OUT", help="The flight's folder, to be created.")],
    config: Annotated[
        Path | None,
        typer.Option("--config", metavar="F.toml", help="Settings; the options below override them."),
    ] = None,
    seed: Annotated[
        int | None, typer.Option("--seed", help="Random seed of corridor, motion and noise.")
    ] = None,
    duration_s: Annotated[
        float | None, typer.Option("--duration", metavar="SECONDS", help="Length of the flight.")
    ] = None,
    width_m: Annotated[
        float | None, typer.Option("--width", metavar="METRES", help="Width of the corridor.")
    ] = None,
    size: Annotated[
        str | None, typer.Option("--size", metavar="WIDTHxHEIGHT", help="Size of the pictures, in pixels.")
    ] = None,
    turn_deg: Annotated[
        float | None,
        typer.Option(
            "--turn",
            metavar="DEGREES",
            help="Turn into another corridor half way: 30 to 150, positive right.",
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
    echo(f"{out}: a flight of {settings.motion.duration_s:g} s; next: corridor fuse {out}")
