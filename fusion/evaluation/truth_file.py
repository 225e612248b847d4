"""Ground truth of a flight from files in common forms: CSV with a heading, TUM, an earlier output.

There are two kinds of heading. ``heading_*`` is the angle from the axis of the corridor being flown, as in
``corridor_truth.csv``. ``yaw_*`` and quaternions are angles from one fixed axis; they are compared with the
heading plus the turn between corridors, and offsets only within the first corridor.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from math import pi
from pathlib import Path

import numpy as np

from fusion.evaluation.truth import OffsetUnit, Truth, TruthColumns, truth_of
from fusion.flight import FloatArray, TimeArray
from fusion.logs.csv.column_map import TimeUnit
from fusion.logs.csv.rows import (
    Block,
    RowFormat,
    Rows,
    is_number,
    is_row,
    read_blocks,
    read_head,
    read_rows,
    split_fields,
)
from fusion.logs.csv.time_units import NS, decimal_to_ns
from fusion.logs.samples import Problems, WithProblems, counted
from fusion.result.conventions import Frame
from fusion.result.summary_json import read_summary
from vision.errors import InputError
from vision.rotations import yaw_of

TRUTH_NAME = "corridor_truth.csv"
SUPPORTED = (
    "CSV with a time (timestamp_ns, timestamp_s ...) and heading_rad, heading_deg, yaw_rad, yaw_deg or qw,qx,qy,qz, "
    "and as known lateral_offset_m or lateral_offset_norm, corridor_width_m, corridor_id, in_junction; or a TUM "
    "trajectory"
)
_TIME_NAMES = ("timestamp", "time", "t", "stamp")
_QUATERNIONS = (
    ("qw", "qx", "qy", "qz"),
    ("q_w", "q_x", "q_y", "q_z"),
    ("q_rs_w", "q_rs_x", "q_rs_y", "q_rs_z"),
)
_OFFSETS: Mapping[str, tuple[float, OffsetUnit]] = {
    "lateral_offset_m": (1.0, "m"),
    "lateral_offset_cm": (0.01, "m"),
    "lateral_offset_norm": (1.0, "norm"),
}
_IDS = ("corridor_id", "corridor_index")
_TUM_WIDTH = 8
_MAX_NAME = 200


def read_truth(path: str | Path, frame: Frame | None = None) -> Truth:
    """Read a truth file, see `SUPPORTED`; a flight's folder means its ``corridor_truth.csv``.

    Parameters
    ----------
    path
        The file or folder.
    frame
        Convention of its signs. None: as declared in the file; a CSV without a declaration is in FRD.

    Raises
    ------
    InputError
        If it cannot be read, lacks a time or a heading, or its convention or units are unknown.
    """
    path = Path(path)
    if path.is_dir():
        if not (path / TRUTH_NAME).exists() and (path / "smoothed.csv").exists():
            raise InputError(
                "is an output of corridor fuse, not ground truth",
                file=path,
                remedy=f"to compare with its smoother, give {path / 'smoothed.csv'}",
            )
        if not (path / TRUTH_NAME).exists():
            raise InputError(f"the folder contains no {TRUTH_NAME}", file=path, remedy="give the file itself")
        path = path / TRUTH_NAME
    try:
        lines = read_head(path)
    except InputError as error:
        if error.problem == "is empty":
            raise InputError("contains no rows", file=path) from error
        raise
    if any(sign in line for line in lines for sign in ("\0", "\N{REPLACEMENT CHARACTER}")):
        raise InputError("is not a text file", file=path, remedy=f"supported: {SUPPORTED}")
    first = next((line for line in lines if line.strip() and not line.startswith("#")), None)
    if first is None:
        raise InputError("contains no rows", file=path)
    if "," not in first and len(first.split()) == _TUM_WIDTH:
        return _from_tum(path, lines, frame)
    return _from_csv(path, lines, frame or _frame_beside(path))


def _frame_beside(path: Path) -> Frame | None:
    """Convention of a table in an output folder."""
    if path.name not in ("estimates.csv", "smoothed.csv"):
        return None
    with suppress(OSError, ValueError, KeyError):
        return Frame(read_summary(path.parent / "summary.json")["frame"])
    return None


def _from_tum(path: Path, lines: Sequence[str], frame: Frame | None) -> Truth:
    found = (re.match(r"#\s*(\w+):\s*(\S+)", line) for line in lines)
    metadata = {match[1]: match[2] for match in found if match}
    ours = metadata.get("software") == "corridor-fusion"
    if frame is None and metadata.get("frame", "") in list(Frame):
        frame = Frame(metadata["frame"])
    if frame is None:
        raise _unknown_convention(path, "a TUM trajectory does")
    names = ("timestamp", "tx", "ty", "tz", "qx", "qy", "qz", "qw")
    rows, problems = _read(path, " ", 0, tuple(range(1, _TUM_WIDTH)), names)
    t_ns = _times(path, rows.first.tolist(), "s")
    values = rows.values
    heading = _yaw_of_body(values[:, [6, 3, 4, 5]], path, "x, y, z, w")
    offset = values[:, 1] if metadata.get("offset_unit") != "none" else np.full(len(t_ns), np.nan)
    unit: OffsetUnit = "norm" if metadata.get("offset_unit") == "half" else "m"
    kind = (
        "a corridor-fusion trajectory" if ours else "a TUM trajectory: yaw from one fixed axis, y as offset"
    )
    columns = TruthColumns(t_ns, heading, offset, unit)
    return truth_of(columns, path, frame, problems, fixed_axis=not ours, kind=kind)


def _unknown_convention(path: Path, what: str) -> InputError:
    return InputError(
        f"{what} not say which way its angles count",
        file=path,
        remedy="add --truth-frame ros where z points up, positive left, or frd where it points down, positive right",
    )


def _from_csv(path: Path, lines: Sequence[str], frame: Frame | None) -> Truth:
    first = next((k for k, line in enumerate(lines) if is_number(line.partition(",")[0])), len(lines))
    header = next((line for line in reversed(lines[:first]) if "," in line), None)
    if header is None:
        raise InputError(
            "does not name its columns in the first line", file=path, remedy=f"supported: {SUPPORTED}"
        )
    names = [_plain_name(cell) for cell in split_fields(header.lstrip("# "), ",")]
    column: dict[str, int] = {}
    for k, name in enumerate(names):
        column.setdefault(name, k)
    after_header = lines.index(header) + 1
    sample = [split_fields(line, ",") for line in lines[after_header:] if is_row(line)]
    if not sample:
        raise InputError("has a header but no rows", file=path)
    whole = next((row for row in sample if len(row) == len(names)), None)
    if whole is None:
        raise InputError(f"its rows do not have the header's {len(names)} columns", file=path)
    time_name, unit = _find_time(path, column, whole)
    heading = _find_heading(path, column)
    if heading.fixed_axis and frame is None:
        raise _unknown_convention(path, "yaw and quaternions do")
    id_name = next((name for name in _IDS if name in column), None)
    optional = [name for name in (*_OFFSETS, id_name, "corridor_width_m", "in_junction") if name in column]
    wanted = (*heading.names, *(name for name in optional if name is not None))
    rows, problems = _read(path, ",", column[time_name], tuple(column[name] for name in wanted), names)
    values = dict(zip(wanted, rows.values.T, strict=True))
    offset, offset_unit = _offset_of(values, len(rows.first))
    columns = TruthColumns(
        _times(path, rows.first.tolist(), unit),
        heading.of([values[name] for name in heading.names], path),
        offset,
        offset_unit,
        width_m=values.get("corridor_width_m"),
        corridor_id=None if id_name is None else values[id_name],
        in_junction=values.get("in_junction"),
    )
    return truth_of(
        columns, path, frame or Frame.FRD, problems, fixed_axis=heading.fixed_axis, kind=heading.kind
    )


def _offset_of(values: Mapping[str, FloatArray], count: int) -> tuple[FloatArray, OffsetUnit]:
    """Return offsets (n,) and their unit: metres if any are known, else half widths; NaN if there are none."""
    offset = np.full(count, np.nan)
    unit: OffsetUnit = "m"
    for name, (scale, its_unit) in _OFFSETS.items():
        if name in values and not (its_unit == "norm" and np.isfinite(offset).any()):
            offset, unit = scale * values[name], its_unit
    return offset, unit


def _read(
    path: Path, separator: str, first: int, others: tuple[int, ...], names: Sequence[str]
) -> WithProblems[Rows]:
    """Read the times, as texts, and columns of numbers; a field that is not a number becomes NaN."""
    fmt = RowFormat(separator, first, others, "O", width=len(names), keep_bad_fields=True)
    # A shorter last line is not taken for truncated, because truths may be written by hand.
    blocks = read_blocks(path, separator, leave_out_cut=False)
    rows = read_rows(_without_names(blocks, separator), fmt)
    if not len(rows.first):
        raise InputError(f"its rows do not have the header's {len(names)} columns", file=path)
    problems: Problems = ()
    if rows.damaged:
        problems += (f"{path.name}: {counted(rows.damaged, 'row')} of other length dropped",)
    for column, texts in rows.bad_fields.items():
        if 2 * len(texts) > len(rows.first):
            raise InputError(f"{names[column]} is {texts[0]!r}, no number", file=path)
        problems += (
            f"{path.name}: {counted(len(texts), 'value')} that are not numbers in {names[column]}, the first "
            f"{texts[0]!r}",
        )
    return WithProblems(rows, problems)


def _without_names(blocks: Iterable[Block], separator: str) -> Iterator[Block]:
    """Skip lines before the first row of numbers."""
    begun = False
    for rows, cut in blocks:
        start = 0
        while not begun and start < len(rows):
            begun = is_number(rows[start].partition(separator)[0])
            start += not begun
        yield Block(rows[start:], cut)


def _plain_name(cell: str) -> str:
    """Return ``heading_deg`` for ``Heading [deg]``."""
    name = re.sub(
        r"\s*[\[(]\s*([\w/]*)\s*[\])]\s*$",
        lambda unit: f"_{unit[1]}" if unit[1] else "",
        cell.strip()[:_MAX_NAME].lower(),
    )
    return re.sub(r"[\s.]+", "_", name)


def _find_time(path: Path, column: Mapping[str, int], row: Sequence[str]) -> tuple[str, TimeUnit]:
    for base in _TIME_NAMES:
        for unit in NS:
            if f"{base}_{unit}" in column:
                return f"{base}_{unit}", unit
    bare = next((name for name in _TIME_NAMES if name in column), None)
    remedy = "name it with its unit: timestamp_ns, timestamp_us, timestamp_ms or timestamp_s"
    if bare is None:
        raise InputError(f"has no time column among {', '.join(column)}", file=path, remedy=remedy)
    if re.fullmatch(r"\d{18,19}", row[column[bare]].strip()):  # Unix time of this century in nanoseconds
        return bare, "ns"
    raise InputError(f"column {bare} does not say its unit", file=path, remedy=remedy)


@dataclass(frozen=True, slots=True)
class _Heading:
    """Columns of the heading: an angle and its unit in radians, or a quaternion w, x, y, z."""

    names: tuple[str, ...]
    unit_rad: float
    fixed_axis: bool
    kind: str

    def of(self, values: Sequence[FloatArray], path: Path) -> FloatArray:
        """Return the angles (n,), radians, of the columns' values (n,); ``path`` for an error."""
        if len(values) == 1:
            return self.unit_rad * values[0]
        return _yaw_of_body(np.column_stack(values), path, "w, x, y, z")


def _yaw_of_body(q: FloatArray, path: Path, order: str) -> FloatArray:
    """Return the yaw (n,) of quaternions (n, 4), w x y z, of a vehicle that flies level, upright or inverted.

    Raises
    ------
    InputError
        If it is on its side, or would be level with another order of the quaternions than ``order``.
    """
    is_upright, off_deg = _upright_and_tilt(q)
    # In the wrong order, a level vehicle with a yaw angle appears upside down, tilted by that angle.
    suspicious_deg = 20.0 if is_upright else 5.0
    other, shift = ("w, x, y, z", -1) if order == "x, y, z, w" else ("x, y, z, w", 1)
    if off_deg > suspicious_deg and _upright_and_tilt(np.roll(q, shift, axis=1))[1] < 0.5 * off_deg:
        raise InputError(
            f"its quaternions, read in the order {order}, are {off_deg:.0f} degrees off level; in the order {other} "
            "they are level",
            file=path,
            remedy=f"write them in the order {order}",
        )
    if off_deg > 45.0:
        raise InputError(
            f"its quaternions are {off_deg:.0f} degrees off level: not of the vehicle's body, perhaps of a camera's "
            "axes, z ahead",
            file=path,
            remedy="give those of the body, x ahead",
        )
    return yaw_of(q)


def _upright_and_tilt(q: FloatArray) -> tuple[bool, float]:
    """Whether quaternions (n, 4) are mostly upright, and their median tilt in degrees."""
    tilt_deg = np.degrees(np.arccos(np.clip(1.0 - 2.0 * (q[:, 1] ** 2 + q[:, 2] ** 2), -1.0, 1.0)))
    tilt_deg = tilt_deg[np.isfinite(tilt_deg)]
    if not len(tilt_deg):
        return True, 0.0
    off_deg = np.minimum(tilt_deg, 180.0 - tilt_deg)
    return bool(np.median(tilt_deg) < 90.0), float(np.median(off_deg))


def _find_heading(path: Path, column: Mapping[str, int]) -> _Heading:
    for name, unit_rad in (("heading_rad", 1.0), ("heading_deg", pi / 180)):
        if name in column:
            kind = "headings from the axis of the corridor being flown"
            return _Heading((name,), unit_rad, False, kind)
    for name, unit_rad in (("yaw_rad", 1.0), ("yaw_deg", pi / 180)):
        if name in column:
            return _Heading((name,), unit_rad, True, "yaw from one fixed axis")
    for names in _QUATERNIONS:
        if set(names) <= set(column):
            return _Heading(names, 1.0, True, "quaternions: yaw from one fixed axis")
    without = next((name for name in ("heading", "yaw") if name in column), None)
    if without is not None:
        raise InputError(
            f"column {without} does not say its unit",
            file=path,
            remedy=f"name it {without}_rad or {without}_deg",
        )
    raise InputError(
        f"has no heading column among {', '.join(column)}",
        file=path,
        remedy="name one heading_rad, heading_deg, yaw_rad or yaw_deg, or give qw,qx,qy,qz",
    )


def _times(path: Path, cells: Sequence[str], unit: TimeUnit) -> TimeArray:
    """Return times in nanoseconds, exact; a decimal fraction of Unix seconds does not fit a float64."""
    found = []
    for cell in cells:
        try:
            found.append(decimal_to_ns(cell.strip(), unit))
        except (ValueError, OverflowError) as error:
            raise InputError(
                f"time {cell!r} is not a number", file=path, remedy=f"times are in {unit}"
            ) from error
    try:
        return np.array(found, dtype=np.int64)
    except OverflowError as error:
        raise InputError(f"times are too large for {unit}", file=path, remedy="name their unit") from error
