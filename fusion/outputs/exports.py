"""Export formats of a fused flight: Parquet, TUM trajectories for evo, MCAP for Foxglove, video.

They are written beside the CSV files by `fusion.outputs.folder.write_outputs`. Each format's library loads when it is
used.
"""

from __future__ import annotations

from collections.abc import Iterable
from enum import StrEnum
from importlib.util import find_spec
from pathlib import Path

from fusion.flight import Flight
from fusion.progress import Progress
from fusion.result.conventions import Frame, file_facts, table_in_frame
from fusion.result.result import FusionResult
from vision.errors import InputError


class Format(StrEnum):
    """An export format besides CSV."""

    PARQUET = "parquet"
    TUM = "tum"
    MCAP = "mcap"
    VIDEO = "video"


EXPORT_FILES = {
    Format.PARQUET: ("estimates.parquet", "smoothed.parquet", "frames.parquet"),
    Format.TUM: ("estimates.tum", "smoothed.tum"),
    Format.MCAP: ("flight.mcap",),
    Format.VIDEO: ("flight.mp4",),
}
_LIBRARY = {Format.PARQUET: "pyarrow", Format.MCAP: "mcap", Format.VIDEO: "av"}


def check_formats(words: Iterable[str]) -> tuple[Format, ...]:
    """Parse formats such as ``parquet,tum``, and check before the work that their libraries are installed.

    Raises
    ------
    InputError
        If a word is not a format, or its library is not installed.
    """
    names = [name.strip().lower() for word in words for name in word.split(",") if name.strip()]
    found = []
    for name in dict.fromkeys(names):
        if name not in list(Format):
            raise InputError(f"--export {name}: no such format", remedy="known are " + ", ".join(Format))
        library = _LIBRARY.get(Format(name))
        if library is not None and find_spec(library) is None:
            raise InputError(
                f"--export {name} needs the library {library}, which is not installed",
                remedy=f'pip install "corridor-fusion[{name}]"',
            )
        found.append(Format(name))
    return tuple(found)


def remarks(formats: Iterable[Format], frame: Frame) -> list[str]:
    """Describe the exports beside the tables, a line each, and the sign convention if it is not FRD."""
    names = [name for kind in formats for name in EXPORT_FILES[kind]]
    found = [f"and {', '.join(names)}"] if names else []
    if frame is Frame.ROS:
        found.append("in ROS's conventions: headings, turns and offsets count positive to the left")
    return found


def write_exports(
    result: FusionResult,
    flight: Flight,
    folder: Path,
    formats: Iterable[Format],
    frame: Frame = Frame.FRD,
    progress: Progress | None = None,
) -> None:
    """Write a fused flight into an existing folder, in the given formats; names as in `EXPORT_FILES`.

    Parameters
    ----------
    result, flight
        Result of `fusion.fuse_flight`, and its flight (MCAP and video show its pictures, TUM its velocity).
    folder
        Folder of the exports.
    formats
        From `check_formats`.
    frame
        Sign convention.
    progress
        Called with (done, total) pictures.

    Raises
    ------
    InputError
        If the flight cannot be written in that format.
    """
    facts = file_facts(result.summary, frame)
    tables = {"estimates": result.estimates, "smoothed": result.smoothed, "frames": result.frames}
    wanted = set(formats)
    if Format.PARQUET in wanted:
        from fusion.outputs.parquet import write_parquet

        for name, table in tables.items():
            path = folder / f"{name}.parquet"
            write_parquet(table_in_frame(table, frame), path, frame, facts | {"table": name})
    if Format.TUM in wanted:
        from fusion.outputs.tum import write_tum

        for name in ("estimates", "smoothed"):
            write_tum(tables[name], folder / f"{name}.tum", frame, facts, flight.velocity)
    if Format.MCAP in wanted:
        from fusion.outputs.mcap import write_mcap

        write_mcap(result, flight, folder / "flight.mcap", frame, facts, progress)
    if Format.VIDEO in wanted:
        from fusion.outputs.video import write_video

        write_video(result, flight, folder / "flight.mp4", progress)
