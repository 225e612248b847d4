"""The command ``corridor simulate``: a flight to try things on, truth included."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fusion.cli.console import compile_notice, echo, progress_bar
from fusion.cli.options import CameraOption

SHORT_HELP = "Make a flight to try things on, truth included."
HELP = """Make a flight through a furnished, lit corridor: pictures, IMU, attitude and the exact truth.

The same settings give the same files, byte for byte. OUT is a flight folder as `corridor fuse` takes it; it must not
exist yet. All settings: corridor config --simulate.

\b
Examples:
  corridor simulate flight
  corridor simulate turn --turn -65 --duration 30 --seed 7

Next: corridor fuse OUT, which then reports its errors against the truth.
"""


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
    echo(f"{out}: a flight of {settings.motion.duration_s:g} s; next: corridor fuse {out}")
