"""The command ``corridor config``: every setting with its meaning, as TOML."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

SHORT_HELP = "Print all settings with their meaning, as TOML."
HELP = """Print every setting with its value, unit, bounds and meaning, as TOML to edit and give back.

Without a file these are the defaults; with one, the settings as that file makes them, so that it can be seen what
they come to. A name that does not exist, a wrong unit or a value out of bounds is refused with the nearest right one.

\b
Examples:
  corridor config > my.toml
  corridor config my.toml
  corridor config --simulate > hall.toml

Next: edit what you want to change, delete the rest, then `corridor fuse FLIGHT --config my.toml`.
"""


def print_config(
    file: Annotated[
        Path | None, typer.Argument(metavar="[FILE.toml]", help="Settings that differ; else the defaults.")
    ] = None,
    simulate: Annotated[
        bool, typer.Option("--simulate", help="Those of `corridor simulate`, not of `corridor fuse`.")
    ] = False,
) -> None:
    """Print a configuration whole."""
    typer.echo(settings_text(file, simulate=simulate), nl=False)


def settings_text(file: str | Path | None = None, *, simulate: bool = False) -> str:
    """Return the settings of ``corridor fuse``, or of ``corridor simulate``, as TOML with their meaning.

    Parameters
    ----------
    file
        A settings file; None for the defaults.
    simulate
        Whether it is the simulator's.

    Raises
    ------
    InputError
        Where the file cannot be read or used.
    """
    from fusion.estimator.config import FusionConfig
    from fusion.settings.toml import config_toml
    from fusion.simulate import SimulationConfig

    model = SimulationConfig if simulate else FusionConfig
    config = model() if file is None else model.from_toml(file)
    command = "corridor simulate OUT" if simulate else "corridor fuse FLIGHT"
    whose = "the defaults" if file is None else f"as {Path(file).name} makes them"
    return config_toml(
        config,
        f"Settings of `{command} --config`: {whose}. What is deleted or stays a comment keeps its default.",
    )
