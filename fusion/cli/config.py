"""The command ``corridor config``: every setting with its meaning, as TOML."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

SHORT_HELP = "Print all settings with their meaning, as TOML."
HELP = """Print every setting with its value, unit, bounds and meaning, as TOML to edit and pass to --config.

Without a file it prints the defaults, with one the settings of that file. An unknown name, a wrong unit or a value
out of bounds is rejected, with a suggestion.

\b
Examples:
  corridor config > my.toml
  corridor config --simulate > hall.toml

Next: edit what you want to change, delete the rest, then run `corridor fuse FLIGHT --config my.toml`.
"""


def print_config(
    file: Annotated[
        Path | None, typer.Argument(metavar="FILE.toml", help="Settings that differ from the defaults.")
    ] = None,
    simulate: Annotated[bool, typer.Option("--simulate", help="Settings of `corridor simulate`.")] = False,
) -> None:
    """Print a complete configuration."""
    from fusion.settings.toml import settings_text

    if simulate:
        from fusion.simulate import SimulationConfig

        text = settings_text(SimulationConfig, "corridor simulate OUT", file)
    else:
        from fusion.estimator.config import FusionConfig

        text = settings_text(FusionConfig, "corridor fuse FLIGHT", file)
    typer.echo(text, nl=False)
