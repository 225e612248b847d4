"""The output folder of a fused flight: three tables, a summary, a report and exports, whole or not at all."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from itertools import chain
from pathlib import Path

from fusion.files import error_text, temporary_beside
from fusion.flight import Flight
from fusion.outputs.exports import EXPORT_FILES, Format, write_exports
from fusion.progress import Progress
from fusion.result.conventions import Frame, summary_in_frame, table_in_frame
from fusion.result.result import FusionResult
from fusion.result.summary_json import write_summary
from fusion.result.tables_csv import write_table
from vision.errors import InputError

OUTPUT_FILES = ("estimates.csv", "smoothed.csv", "frames.csv", "summary.json", "report.html", "flight.toml")
_OURS = (*OUTPUT_FILES, *chain.from_iterable(EXPORT_FILES.values()))
_LEFT_BY_FILE_BROWSERS = frozenset({".DS_Store", "Thumbs.db"})


def write_outputs(
    result: FusionResult,
    flight: Flight,
    out_dir: str | Path,
    *,
    report: bool = True,
    exports: Iterable[Format] = (),
    frame: Frame = Frame.FRD,
    progress: Progress | None = None,
) -> Path:
    """Write a fused flight's files, and what else is asked for, into ``out_dir``, all of them or none.

    ``flight.toml`` names where the flight came from, for `corridor fuse` and `corridor align` to take up again; a
    flight made by hand has none.

    They are written beside ``out_dir`` under a temporary name and renamed once complete. An earlier output is
    replaced; a folder that holds anything else is left alone.

    Parameters
    ----------
    result, flight
        What `fusion.fuse_flight` returned, and what it was given (the report shows its pictures).
    out_dir
        The folder to make; its parents are made as needed.
    report
        Whether to write ``report.html`` too, the slowest of them.
    exports
        Other forms of the tables, from `fusion.outputs.exports.check_formats`.
    frame
        Convention of signs in the tables and in the summary, which names it; the report's words need none.
    progress
        Called with pictures exported and in all, where ``exports`` holds any.

    Returns
    -------
    Path
        The folder, absolute.

    Raises
    ------
    InputError
        Where ``out_dir`` is a file, holds files that are not ours, or cannot be written.
    """
    with _appearing_whole(out_dir) as folder:
        write_table(table_in_frame(result.estimates, frame), folder / "estimates.csv")
        write_table(table_in_frame(result.smoothed, frame), folder / "smoothed.csv")
        write_table(table_in_frame(result.frames, frame), folder / "frames.csv")
        write_summary(summary_in_frame(result.summary, frame), folder / "summary.json")
        _write_manifest(flight, folder / "flight.toml", Path(out_dir).resolve())
        write_exports(result, flight, folder, exports, frame, progress)
        if report:
            from fusion.report import write_report

            write_report(result, flight, folder / "report.html")
    return Path(out_dir).resolve()


def _write_manifest(flight: Flight, path: Path, folder: Path) -> None:
    """Write where the flight came from, seen from the folder that the file will lie in."""
    from fusion.logs.manifest.manifest import Manifest
    from fusion.logs.manifest.text import manifest_text

    if not isinstance(flight.manifest, Manifest):
        return
    manifest = flight.manifest.model_copy(update={"name": flight.name})
    path.write_text(manifest_text(manifest, folder, {}), encoding="utf-8")


def check_out_dir(out_dir: str | Path) -> Path:
    """Say before the work whether `write_outputs` will accept ``out_dir``; return it absolute.

    Raises
    ------
    InputError
        Where it is a file, or a folder that holds files that are not ours.
    """
    folder = Path(out_dir).resolve()
    remedy = "choose another with -o, or remove it"
    if not folder.exists():
        return folder
    if not folder.is_dir():
        raise InputError("the output folder is an existing file", file=out_dir, remedy=remedy)
    ours = {*_OURS, *_LEFT_BY_FILE_BROWSERS}
    there = {entry.name for entry in folder.iterdir()}
    if "summary.json" not in there:  # a manifest alone is the user's own
        ours -= {"flight.toml"}
    foreign = sorted(entry.name for entry in folder.iterdir() if entry.name not in ours or entry.is_dir())
    if foreign:
        more = f" and {len(foreign) - 1} more" if len(foreign) > 1 else ""
        raise InputError(
            f"the output folder holds {foreign[0]!r}{more}, which corridor did not write",
            file=out_dir,
            remedy="choose another with -o",
        )
    return folder


@contextmanager
def _appearing_whole(out_dir: str | Path) -> Iterator[Path]:
    """Give a temporary folder to fill; it takes the name ``out_dir`` when the block ends without error."""
    folder = check_out_dir(out_dir)
    # A mount point or the shell's own folder cannot be renamed: fill a folder inside it and move the files.
    in_place = folder.is_dir() and (folder.is_mount() or Path.cwd().is_relative_to(folder))
    temporary = temporary_beside(folder / folder.name if in_place else folder)
    try:
        temporary.mkdir(parents=True)
        yield temporary
        if in_place:
            _replace_files(temporary, folder)
        else:
            _replace_folder(temporary, folder)
    except OSError as error:
        raise InputError(
            f"cannot write the outputs: {error_text(error)}",
            file=out_dir,
            remedy="choose another folder with -o",
        ) from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def _replace_folder(new: Path, folder: Path) -> None:
    if not folder.exists():
        new.rename(folder)
        return
    old = new.with_suffix(".old")
    folder.rename(old)
    try:
        new.rename(folder)
    except OSError:
        with suppress(OSError):
            old.rename(folder)
        raise
    shutil.rmtree(old, ignore_errors=True)


def _replace_files(new: Path, folder: Path) -> None:
    written = {entry.name for entry in new.iterdir()}
    for name in _OURS:
        if name in written:
            os.replace(new / name, folder / name)
        else:
            (folder / name).unlink(missing_ok=True)
