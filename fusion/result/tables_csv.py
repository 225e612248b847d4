"""A result's tables as CSV, written and read back.

Integers are written as integers, Booleans as ``true`` and ``false``, floats with nine significant digits; unknown
numbers are empty.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Iterable
from itertools import islice
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from fusion.estimator.tables import Table
from fusion.files import error_text, replacing
from vision.errors import InputError
from vision.limits import check_is_file

_CHUNK_ROWS = 50_000


def write_table(table: Table, path: str | Path) -> None:
    """Write a structured array as CSV, a column per field, atomically; bytes of names that are not UTF-8 are escaped.

    Raises
    ------
    InputError
        If ``path`` is a folder or cannot be written.
    """
    with (
        replacing(Path(path)) as draft,
        draft.open("w", encoding="utf-8", errors="backslashreplace", newline="") as file,
    ):
        print_table(table, file)


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
        If the file is missing, its header differs, or a row is truncated or has an invalid number.
    """
    names = list(dtype.names or ())
    chunks: list[Table] = []
    try:
        check_is_file(Path(path))
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
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"cannot be read: {error_text(error)}", file=path) from error
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
