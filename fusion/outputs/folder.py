"""What a fused flight leaves on disk: three tables, a summary, a report and exports, whole or not at all.

Tables are CSV: integers as integers, truth values as ``true`` and ``false``, floats with nine significant
digits, unknown numbers empty.
"""

from __future__ import annotations

import csv
import json
import math
import os
import secrets
import shutil
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from itertools import chain, islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

import numpy as np

from fusion.estimator.tables import Table
from fusion.outputs.exports import EXPORT_FILES, Format, Frame, write_exports
from fusion.result.conventions import summary_in_frame, table_in_frame
from vision.errors import InputError

if TYPE_CHECKING:
    from fusion.flight import Flight
    from fusion.offline.fuse import FusionResult

OUTPUT_FILES = ("estimates.csv", "smoothed.csv", "frames.csv", "summary.json", "report.html", "flight.toml")
_OURS = (*OUTPUT_FILES, *chain.from_iterable(EXPORT_FILES.values()))
_LEFT_BY_FILE_BROWSERS = frozenset({".DS_Store", "Thumbs.db"})
_CHUNK_ROWS = 50_000


def write_outputs(
    result: FusionResult,
    flight: Flight,
    out_dir: str | Path,
    *,
    report: bool = True,
    exports: Iterable[Format] = (),
    frame: Frame = Frame.FRD,
    progress: Callable[[int, int], None] | None = None,
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
    if flight.manifest is None:
        return
    from fusion.logs.manifest.text import manifest_text

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


def write_table(table: Table, path: str | Path) -> None:
    """Write a structured array as CSV, a column per field, the whole file or none.

    Raises
    ------
    InputError
        Where ``path`` is a folder or cannot be written.
    """
    path = Path(path)
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(4)}.partial")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with temporary.open("w", encoding="utf-8", newline="") as file:
            print_table(table, file)
        temporary.replace(path)
    except OSError as error:
        raise InputError(
            f"cannot be written: {_cause(error)}", file=path, remedy="choose another file"
        ) from error
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def print_table(table: Table, file: TextIO) -> None:
    """Write a structured array as CSV to an open text file, by column and in chunks: an hour in seconds."""
    names = table.dtype.names or ()
    file.write(",".join(names) + "\n")
    for start in range(0, len(table), _CHUNK_ROWS):
        chunk = table[start : start + _CHUNK_ROWS]
        columns = [_format_column(chunk[name]) for name in names]
        file.write("\n".join(map(",".join, zip(*columns, strict=True))) + "\n")


def _format_column(values: np.ndarray[Any, Any]) -> Iterable[str]:
    if values.dtype.kind == "b":
        return ["true" if value else "false" for value in values.tolist()]
    if values.dtype.kind in "iu":
        return map(str, values.tolist())
    if values.dtype.kind == "f":
        if np.isnan(values).all():
            return [""] * len(values)
        return ["" if value != value else f"{value:.9g}" for value in values.tolist()]
    texts = [str(value) for value in values.tolist()]
    return [_quoted(text) if any(sign in text for sign in ',"\r\n') else text for text in texts]


def _quoted(text: str) -> str:
    return '"' + text.replace('"', '""') + '"'


def read_table(path: str | Path, dtype: np.dtype[Any]) -> Table:
    """Read back a table that `write_table` wrote; empty numbers become NaN.

    Parameters
    ----------
    path
        A CSV file whose header names ``dtype``'s fields, in order.
    dtype
        `fusion.estimator.tables.ESTIMATE_DTYPE`, `fusion.estimator.tables.FRAME_DTYPE` or another structured type.

    Raises
    ------
    InputError
        Where the file is missing, its header is another, or a row is torn or has no number where one belongs.
    """
    names = list(dtype.names or ())
    chunks: list[Table] = []
    try:
        with Path(path).open(encoding="utf-8", newline="") as file:
            reader = csv.reader(file)
            header = next(reader, None)
            if header != names:
                raise InputError(
                    "the file is empty" if header is None else f"columns are {','.join(header)}",
                    file=path,
                    remedy=f"expected {','.join(names)}",
                )
            line = 2
            while rows := list(islice(reader, _CHUNK_ROWS)):
                chunks.append(_parse_rows(rows, dtype, path, line))
                line += len(rows)
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"cannot be read: {_cause(error)}", file=path) from error
    return np.concatenate(chunks) if chunks else np.zeros(0, dtype)


def _parse_rows(rows: list[list[str]], dtype: np.dtype[Any], path: str | Path, first_line: int) -> Table:
    names = dtype.names or ()
    table = np.zeros(len(rows), dtype)
    for number, row in enumerate(rows, first_line):
        if len(row) != len(names):
            raise InputError(
                f"line {number} has {len(row)} of {len(names)} columns",
                file=path,
                remedy="the file is cut off or was edited; write it again",
            )
    for name, cells in zip(names, zip(*rows, strict=True), strict=True):
        kind = dtype[name].kind
        convert = _CELL.get(kind, str)
        try:
            table[name] = [convert(cell) for cell in cells]
        except (KeyError, ValueError, OverflowError) as error:
            bad = next(index for index, cell in enumerate(cells) if _fails(convert, cell, dtype[name]))
            raise InputError(
                f"line {first_line + bad}: {name} is {cells[bad]!r}",
                file=path,
                remedy=f"expected {_CELL_WORD.get(kind, 'text')}",
            ) from error
    return table


_CELL: dict[str, Callable[[str], Any]] = {
    "f": lambda cell: float(cell) if cell else math.nan,
    "i": int,
    "b": lambda cell: {"true": True, "false": False}[cell],
}
_CELL_WORD = {"f": "a number or nothing", "i": "an integer", "b": "true or false"}


def _fails(convert: Callable[[str], Any], cell: str, dtype: np.dtype[Any]) -> bool:
    try:
        np.array([convert(cell)], dtype)
    except (KeyError, ValueError, OverflowError):
        return True
    return False


def write_summary(summary: dict[str, Any], path: str | Path) -> None:
    """Write a summary as JSON that every reader takes: unknown numbers are null, never ``NaN``."""
    Path(path).write_text(summary_json(summary), encoding="utf-8")


def summary_json(summary: dict[str, Any]) -> str:
    """Return the text that `write_summary` writes."""
    return json.dumps(_plain(summary), indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, np.generic | np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, Path):
        return str(value)
    return value


@contextmanager
def _appearing_whole(out_dir: str | Path) -> Iterator[Path]:
    """Give a temporary folder to fill; it takes the name ``out_dir`` when the block ends without error."""
    folder = check_out_dir(out_dir)
    # A mount point or the shell's own folder cannot be renamed: fill a folder inside it and move the files.
    in_place = folder.is_dir() and (folder.is_mount() or Path.cwd().is_relative_to(folder))
    parent = folder if in_place else folder.parent
    temporary = parent / f".{folder.name}.{secrets.token_hex(4)}.partial"
    try:
        temporary.mkdir(parents=True)
        yield temporary
        if in_place:
            _replace_files(temporary, folder)
        else:
            _replace_folder(temporary, folder)
    except OSError as error:
        raise InputError(
            f"cannot write the outputs: {_cause(error)}", file=out_dir, remedy="choose another folder with -o"
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


def _cause(error: Exception) -> str:
    return (error.strerror or str(error)) if isinstance(error, OSError) else str(error)
