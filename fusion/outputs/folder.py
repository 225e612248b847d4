"""The output folder of a fused flight: three tables, a summary, a report and exports, written atomically."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from errno import EACCES, ENOTDIR
from itertools import chain
from pathlib import Path
from typing import Any

from fusion.estimator.tables import Table
from fusion.files import (
    draft_of,
    error_text,
    left_behind,
    locked,
    remove,
    replacing_folder,
    restore,
    to_disk,
    tree_to_disk,
)
from fusion.flight import Flight
from fusion.outputs.exports import EXPORT_FILES, Format, write_exports
from fusion.outputs.provenance import provenance
from fusion.progress import Progress
from fusion.result.conventions import Frame, summary_in_frame, table_in_frame
from fusion.result.result import FusionResult
from fusion.result.summary_json import read_summary, write_summary
from fusion.result.tables_csv import write_table
from vision.errors import InputError

OUTPUT_FILES = ("estimates.csv", "smoothed.csv", "frames.csv", "summary.json", "report.html", "flight.toml")
SENT_FILE = "sent.csv"
_OURS = (*OUTPUT_FILES, SENT_FILE, *chain.from_iterable(EXPORT_FILES.values()))
MARK = "summary.json"  # marks an output folder, and lists the files written with it
_LEFT_BY_FILE_BROWSERS = frozenset({".DS_Store", "Thumbs.db"})


def write_outputs(
    result: FusionResult,
    flight: Flight,
    out_dir: str | Path,
    *,
    report: bool = True,
    exports: Iterable[Format] = (),
    frame: Frame = Frame.FRD,
    command: str | None = None,
    hashes: Mapping[Path, str] | None = None,
    progress: Progress | None = None,
    sent: Table | None = None,
) -> Path:
    """Write the files of a fused flight into ``out_dir``, all of them or none.

    They are written beside ``out_dir`` under a temporary name, and renamed once they are complete and on the disk. An
    earlier output is replaced; it is recognised by the list of files in its ``summary.json``. A folder with any other
    file is left unchanged. Remains of an interrupted run are deleted or completed.

    Parameters
    ----------
    result, flight
        Result of `fusion.fuse_flight`, and its flight (the report shows its pictures).
    out_dir
        The folder to create, with its parents as needed.
    report
        Whether to write ``report.html``, which takes the longest.
    exports
        Further formats, from `fusion.outputs.exports.check_formats`.
    frame
        Sign convention of the tables and the summary, which names it.
    command
        The command line, for ``provenance`` in ``summary.json``.
    hashes
        SHA-256 of the flight's files where already known, for ``provenance``.
    progress
        Called with (done, total) exported pictures, if ``exports`` include pictures.
    sent
        Estimates sent in flight, if the flight is a recording of `corridor live`.

    Returns
    -------
    Path
        The folder, absolute.

    Raises
    ------
    InputError
        If ``out_dir`` is a file, contains other files, or cannot be written.
    """
    with _atomic_folder(out_dir) as folder:
        _write_tables(result, sent, folder, frame)
        _write_manifest(flight, folder / "flight.toml", Path(out_dir).resolve())
        write_exports(result, flight, folder, exports, frame, progress)
        origin = provenance(flight, command, hashes)
        if report:
            from fusion.report import write_report

            write_report(result, flight, folder / "report.html", origin)
        _write_summary(result, origin, folder, frame)
    return Path(out_dir).resolve()


def _write_tables(result: FusionResult, sent: Table | None, folder: Path, frame: Frame) -> None:
    tables = {"estimates.csv": result.estimates, "smoothed.csv": result.smoothed, "frames.csv": result.frames}
    if sent is not None:
        tables[SENT_FILE] = sent
    for name, table in tables.items():
        write_table(table_in_frame(table, frame), folder / name)


def _write_manifest(flight: Flight, path: Path, folder: Path) -> None:
    """Write the flight's manifest, for use by `corridor fuse` and `corridor align`.

    Its paths are relative to the file's final folder. A flight constructed by the caller has no manifest.
    """
    from fusion.logs.manifest.manifest import Manifest
    from fusion.logs.manifest.text import manifest_text

    if not isinstance(flight.manifest, Manifest):
        return
    manifest = flight.manifest.model_copy(update={"name": flight.name})
    path.write_text(manifest_text(manifest, folder, {}), encoding="utf-8")


def _write_summary(result: FusionResult, origin: Mapping[str, Any], folder: Path, frame: Frame) -> None:
    """Write the summary, the last file of a folder, which lists all others."""
    files = sorted([MARK, *(entry.name for entry in folder.iterdir())])
    additions = {"files": files, "provenance": origin}
    write_summary(summary_in_frame(result.summary, frame) | additions, folder / MARK)


def check_out_dir(out_dir: str | Path) -> Path:
    """Check before the work whether `write_outputs` will accept ``out_dir``; return it absolute.

    Remains of a killed run are completed or deleted first.

    Raises
    ------
    InputError
        If it is a file, a folder with other files, or cannot be written.
    """
    try:
        folder = Path(out_dir).resolve()
        _recover(folder)
        if not folder.is_file():
            _check_writable(folder)
        if not folder.exists():
            return folder
        if not folder.is_dir():
            raise InputError(
                "the output folder is an existing file",
                file=out_dir,
                remedy="choose another with -o, or remove it",
            )
        ours = _listed_files(folder) | _LEFT_BY_FILE_BROWSERS
        foreign = sorted(
            entry.name
            for entry in folder.iterdir()
            if (entry.name not in ours or entry.is_dir()) and not _is_draft(entry)
        )
    except (OSError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        problem = f"the output folder cannot be used: {error_text(error)}"
        raise InputError(problem, file=out_dir, remedy="choose another with -o") from error
    if foreign:
        more = f" and {len(foreign) - 1} more" if len(foreign) > 1 else ""
        raise InputError(
            f"the output folder contains {foreign[0]!r}{more}, which corridor did not write",
            file=out_dir,
            remedy="choose another with -o",
        )
    return folder


def _check_writable(folder: Path) -> None:
    """Check that the outputs can be written beside their folder, or in its first existing parent.

    Raises
    ------
    OSError
        If they cannot.
    """
    place = folder if _stays(folder) else next(parent for parent in folder.parents if parent.exists())
    if not place.is_dir():
        raise NotADirectoryError(ENOTDIR, os.strerror(ENOTDIR), str(place))
    if not os.access(place, os.W_OK | os.X_OK):
        raise PermissionError(EACCES, os.strerror(EACCES), str(place))


def _listed_files(folder: Path) -> set[str]:
    """Return the files listed in a folder's summary; none without a summary."""
    try:
        summary = read_summary(folder / MARK)
        files = summary.get("files", _OURS)  # the first versions did not list them
        return {*files} & {*_OURS} if "verdict" in summary else set()
    except (OSError, ValueError, TypeError):
        return set()


def _is_draft(entry: Path) -> bool:
    return entry.is_dir() and entry.name.startswith(".corridor-")


@contextmanager
def _atomic_folder(out_dir: str | Path) -> Iterator[Path]:
    """Provide a draft folder; it replaces ``out_dir`` when the block ends without an error."""
    folder = check_out_dir(out_dir)
    draft = folder
    try:
        with _moved_into(folder) if _stays(folder) else replacing_folder(folder) as draft:
            yield draft
    except InputError as error:
        if error.file is None or not error.file.is_relative_to(draft):
            raise
        file = Path(out_dir) / error.file.relative_to(draft)  # its name in the final folder
        raise InputError(error.problem, file=file, remedy=error.remedy) from error
    except OSError as error:
        raise InputError(
            f"cannot write the outputs: {error_text(error)}",
            file=out_dir,
            remedy="choose another folder with -o",
        ) from error


def _stays(folder: Path) -> bool:
    """Whether a folder cannot be renamed: a mount point, the working directory, or in another user's folder."""
    if not folder.is_dir():
        return False
    return (
        folder.is_mount()
        or Path.cwd().is_relative_to(folder)
        or not os.access(folder.parent, os.W_OK | os.X_OK)
    )


@contextmanager
def _moved_into(folder: Path) -> Iterator[Path]:
    """Provide a draft inside a folder that cannot be renamed; its files are moved when all are written.

    If a run is killed after the renaming to ``.complete``, the next run completes it.
    """
    with draft_of(folder / MARK) as draft:
        draft.mkdir()
        with locked(draft):
            yield draft
            tree_to_disk(draft)
            complete = draft.rename(draft.with_suffix(".complete"))
            to_disk(folder)
            _move_files(complete, folder)


def _move_files(complete: Path, folder: Path) -> None:
    """Move a complete draft's files into its folder, the summary last, which lists them."""
    if (complete / MARK).exists():
        for name in _listed_files(folder) - _listed_files(complete):
            (folder / name).unlink(missing_ok=True)
        for path in sorted(complete.iterdir(), key=lambda path: path.name == MARK):
            path.replace(folder / path.name)
        to_disk(folder)
    complete.rmdir()


def _recover(folder: Path) -> None:
    """Complete, restore or delete the remains of a killed run's output."""
    restore(folder)
    for left in left_behind(folder):
        if left.suffix == ".complete":
            _move_files(left, folder)
        else:
            remove(left)
