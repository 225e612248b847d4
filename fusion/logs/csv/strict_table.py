"""Tables of time-stamped numbers from CSV files that may be torn, unsorted or dirty.

A good file goes through numpy's own parser whole; only the stretches it refuses are looked at row by row.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from fusion.flight import FloatArray, TimeArray
from fusion.logs.samples import MIN_STEP_NS, NOT_NANOSECONDS, counted, in_order
from vision import InputError

_CHUNK_ROWS = 4096


@dataclass(frozen=True, slots=True, eq=False)
class CsvTable:
    """Rows of one file in the order of time.

    Parameters
    ----------
    t_ns
        Times (n,), strictly increasing, at least one.
    values
        The other columns (n, k); a field that is empty is NaN.
    """

    t_ns: TimeArray
    values: FloatArray


def read_table(
    path: Path,
    columns: Sequence[str],
    problems: list[str],
    *,
    label: str,
    min_step_ns: int = MIN_STEP_NS,
    by_name: bool = False,
) -> CsvTable:
    """Read ``timestamp, columns ...``, dropping what is broken and saying so in ``problems``.

    Parameters
    ----------
    path
        The file; comment lines start with ``#``, and a line of column names may stand first.
    columns
        Names of the columns after the time, for messages.
    problems
        Sentences are appended here.
    label
        What to call the file in them, such as ``imu0/data.csv``.
    min_step_ns
        A median time step below it means that the times are not nanoseconds.
    by_name
        Find the columns by the names in the file's header, where it has one, instead of by their order.

    Raises
    ------
    InputError
        Where no usable rows are left, or the columns or the times are not what they should be.
    """
    header, lines = read_rows(path, problems, label)
    order: list[int] | None = None
    width = len(columns) + 1
    if by_name and header is not None:
        missing = [name for name in columns if name not in header]
        if missing:
            raise InputError(
                f"has no column {', '.join(missing)}", file=path, remedy="name it in the first line"
            )
        order = [header.index(name) - 1 for name in columns]
        width = len(header)
    check_row(path, lines, width, ("timestamp", *columns))
    data = _parse(path, lines, width, problems, label)
    index = in_order(data["t"], label, problems, min_step_ns, file=path)
    t_ns, values = data["t"][index], data["v"][index]
    return CsvTable(t_ns, values if order is None else values[:, order])


def read_rows(path: Path, problems: list[str], label: str) -> tuple[list[str] | None, list[str]]:
    """Read the data lines of a CSV file and the column names, if the file has any.

    A last line that ends without a line break and looks shorter than the one before was cut: it is dropped.
    """
    try:
        text = path.read_bytes().decode("utf-8-sig", errors="replace")
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", file=path, remedy="check the file") from error
    lines = text.replace("\r", "").split("\n")
    ends_whole = lines[-1] == ""
    lines = [line for line in lines if line and not line.isspace()]
    if not lines:
        raise InputError("is empty", file=path, remedy="the file was not written whole; copy it again")
    header: list[str] | None = None
    start = 0
    while start < len(lines) and (
        lines[start].lstrip().startswith("#") or (start == 0 and _is_names(lines[0]))
    ):
        if "," in lines[start]:  # names, not a remark; units in brackets are no part of them
            header = [re.sub(r"\s*\[.*", "", name).strip() for name in lines[start].lstrip("# ").split(",")]
        start += 1
    rows = [line for line in lines[start:] if not line.lstrip().startswith("#")]
    if not rows:
        raise InputError(
            "has a header but no rows", file=path, remedy="the log is empty; take the folder away"
        )
    if not ends_whole and len(rows) > 1 and _is_cut(rows[-1], rows[-2]):
        del rows[-1]
        problems.append(f"{label}: the last line is cut short, dropped")
    return header, rows


def _is_names(line: str) -> bool:
    """Whether a first line holds column names: letters where the time should stand."""
    return re.match(r"\s*[A-Za-z_]", line) is not None and not _is_float(line.split(",")[0])


def _is_float(field: str) -> bool:
    try:
        float(field)
    except ValueError:
        return False
    return True


def _is_cut(last: str, before: str) -> bool:
    """Whether the last line seems cut; a false alarm costs one row."""
    if last.count(",") != before.count(","):
        return last.count(",") < before.count(",")

    def length_after_point(line: str) -> int:
        return len(line.rsplit(",", 1)[-1].partition(".")[2].strip())

    return length_after_point(last) < length_after_point(before)


def check_row(path: Path, rows: list[str], width: int, columns: Sequence[str]) -> None:
    """Raise `InputError` where most of the first rows have a wrong number of columns or no whole time."""
    head = [row.split(",") for row in rows[:20]]
    wrong = [len(fields) for fields in head if len(fields) != width]
    if 2 * len(wrong) > len(head):
        raise InputError(
            f"has rows of {counted(wrong[0], 'column')} instead of {width}",
            file=path,
            remedy=f"the columns are {', '.join(columns)}",
        )
    times = [fields[0].strip() for fields in head]
    floats = [t for t in times if _is_float(t) and not re.fullmatch(r"[+-]?\d+", t) and t.lower() != "nan"]
    if 2 * len(floats) > len(head):
        raise InputError(
            f"timestamp {floats[0]} is not a whole number",
            file=path,
            remedy=f"{NOT_NANOSECONDS}; multiply seconds by 1e9",
        )


def _parse(path: Path, lines: list[str], width: int, problems: list[str], label: str) -> npt.NDArray[np.void]:
    dtype = np.dtype([("t", "i8"), ("v", "f8", (width - 1,))])
    whole = _parse_fast(lines, dtype)
    if whole is not None:
        return whole
    parts: list[npt.NDArray[np.void]] = []
    broken: list[str] = []
    for start in range(0, len(lines), _CHUNK_ROWS):
        chunk = lines[start : start + _CHUNK_ROWS]
        part = _parse_fast(chunk, dtype)
        parts.append(_parse_slowly(chunk, dtype, width, broken) if part is None else part)
    data = np.concatenate(parts)
    if len(data) == 0:
        raise InputError(
            f"has no row of {width} numbers", file=path, remedy="check that it is the right file"
        )
    if broken:
        what = f"{counted(len(broken), 'row')} not of {width} numbers dropped"
        problems.append(f"{label}: {what}, the first is {broken[0][:60]!r}")
    return data


def _parse_fast(lines: list[str], dtype: np.dtype[np.void]) -> npt.NDArray[np.void] | None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # an integer read through a float would lose its last digits
        try:
            return np.loadtxt(lines, dtype=dtype, delimiter=",", comments=None, ndmin=1)
        except (ValueError, OverflowError, Warning):
            return None


def _parse_slowly(
    lines: list[str], dtype: np.dtype[np.void], width: int, broken: list[str]
) -> npt.NDArray[np.void]:
    rows: list[tuple[int, list[float]]] = []
    for line in lines:
        fields = [field.strip() for field in line.split(",")]
        t_ns = parse_time(fields[0])
        try:
            values = [float(field) if field else np.nan for field in fields[1:]]
        except ValueError:
            values = []
        if t_ns is None or len(values) != width - 1:
            broken.append(line)
        else:
            rows.append((t_ns, values))
    return np.array(rows, dtype=dtype)


def parse_time(field: str) -> int | None:
    """Whole nanoseconds that fit 64 bits, or None."""
    if not re.fullmatch(r"-?[0-9]+", field):
        return None
    t_ns = int(field)
    return t_ns if abs(t_ns) < 2**63 else None
