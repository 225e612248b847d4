"""The command ``corridor batch``: fuse many logged flights into one table."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fusion.cli import interrupts
from fusion.cli.console import command_line, echo, progress_bar, say
from fusion.cli.options import CameraOption, ConfigOption, Method, MethodOption

SHORT_HELP = "Fuse many flights: an output folder each, and one table and page of all."
HELP = """Fuse many logged flights, each as `corridor fuse` does, into one table, the worst first.

FLIGHTS are folders to search, patterns in quotes, or a list in TOML. Repeat the command to resume a batch that was
interrupted. Lists, outputs, clusters and comparisons: docs/fleet.md.

\b
Examples:
  corridor batch flights -o out
  corridor batch march.toml -o out --config hall.toml --jobs 8
  corridor batch flights -o new --config other.toml --against out/fleet.parquet

Next: open OUT/fleet.html, or pandas.read_parquet("OUT/fleet.parquet").
"""


FlightsArgument = Annotated[
    list[str],
    typer.Argument(metavar="FLIGHTS", help="Folders, patterns, lists, flights.", show_default=False),
]
OutOption = Annotated[Path, typer.Option("--out", "-o", metavar="OUT", help="Output folder.")]
JobsOption = Annotated[
    int | None, typer.Option("--jobs", metavar="N", min=1, help="Worker processes; default one per core.")
]
MemoryOption = Annotated[
    str | None,
    typer.Option(
        "--memory",
        metavar="SIZE",
        help="Memory limit of a worker, such as 2GB; default its share of the machine's.",
    ),
]
TimeoutOption = Annotated[
    int,
    typer.Option(
        "--timeout",
        metavar="SECONDS",
        min=0,
        max=10_000_000,
        help="Give up a flight that takes longer; 0: never.",
    ),
]
SchedulerOption = Annotated[
    str | None,
    typer.Option("--scheduler", metavar="tcp://HOST:PORT", help="Fuse on a Dask cluster."),
]
AgainstOption = Annotated[
    Path | None,
    typer.Option("--against", metavar="OLD/fleet.parquet", help="Compare with an earlier batch."),
]


def batch(
    flights: FlightsArgument,
    out: OutOption,
    config: ConfigOption = None,
    camera: CameraOption = None,
    method: MethodOption = Method.GEOMETRIC,
    jobs: JobsOption = None,
    memory: MemoryOption = None,
    timeout_s: TimeoutOption = 3600,
    scheduler: SchedulerOption = None,
    against: AgainstOption = None,
    reports: Annotated[
        bool, typer.Option(help="Write a report.html per flight; takes half of the time.")
    ] = True,
    redo: Annotated[bool, typer.Option("--redo", help="Fuse finished flights again.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON, not text.")] = False,
) -> None:
    """Fuse many flights."""
    from fusion.cli.batch_text import batch_text, batch_values, memory_bytes
    from fusion.estimator.config import FusionConfig
    from fusion.fleet.batch import BatchSettings, fuse_fleet
    from fusion.fleet.comparison import compare_fleets
    from fusion.fleet.tables import NEEDS_PARQUET, has_parquet, read_fleet
    from fusion.result.summary_json import summary_json
    from vision.errors import InputError

    if camera is not None and not camera.is_file():
        raise InputError("there is no such file", file=camera, remedy="check --camera")
    before = () if against is None else read_fleet(against)
    settings = BatchSettings(
        config=FusionConfig() if config is None else FusionConfig.from_toml(config),
        camera=None if camera is None else camera.resolve(),
        method=method.value,
        reports=reports,
        jobs=jobs,
        memory_bytes=None if memory is None else memory_bytes(memory),
        scheduler=scheduler,
        redo=redo,
        timeout_s=timeout_s or None,
        command=command_line(),
    )
    if not has_parquet():
        say(f"fleet.csv alone, no fleet.parquet: that needs pyarrow ({NEEDS_PARQUET})")
    with interrupts.Raised(), progress_bar("fusing flights") as progress:
        fleet = fuse_fleet(flights, out, settings, against=before, progress=progress, notify=say)
    comparison = compare_fleets(before, fleet.rows) if before else None
    echo(
        summary_json(batch_values(fleet, comparison)).rstrip("\n")
        if as_json
        else batch_text(fleet, out, comparison)
    )
