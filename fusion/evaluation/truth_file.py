"""What a flight really did, from files as people have them: CSV with a heading, TUM trajectories, an earlier output.

Two kinds of heading are told apart. ``heading_*`` is the angle from the axis of the corridor being flown, as in
``corridor_truth.csv``. ``yaw_*`` and quaternions are angles from one fixed axis; they are compared with the
heading plus the turn between corridors, and offsets only within the first corridor.
"""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from math import pi
from pathlib import Path

import numpy as np
import numpy.typing as npt

from fusion.flight import CorridorTruth, FloatArray, TimeArray
from fusion.logs.samples import counted, order_times
from fusion.result.conventions import Frame
from vision.errors import InputError

TRUTH_NAME = "corridor_truth.csv"
SUPPORTED = (
    "CSV with a time (timestamp_ns, timestamp_s ...) and heading_rad, heading_deg, yaw_rad, yaw_deg or qw,qx,qy,qz, "
    "and as known lateral_offset_m or lateral_offset_norm, corridor_width_m, corridor_id, in_junction; or a TUM "
    "trajectory"
)
_TIME_SCALE = {"ns": 1, "us": 1_000, "ms": 1_000_000, "s": 1_000_000_000}
_TIME_NAMES = ("timestamp", "time", "t", "stamp")
_QUATERNIONS = (
    ("qw", "qx", "qy", "qz"),
    ("q_w", "q_x", "q_y", "q_z"),
    ("q_rs_w", "q_rs_x", "q_rs_y", "q_rs_z"),
)


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """A truth and how to compare with it.

    Parameters
    ----------
    corridor
        In FRD; NaN where an offset is not known.
    fixed_axis
        Headings are from one axis through the whole flight, not from the corridor being flown.
    offset
        ``m``, ``norm`` or ``both``: what its offsets can be compared with; None where it has none.
    source
        The file, in words.
    problems
        What was dropped on reading.
    """

    corridor: CorridorTruth
    fixed_axis: bool
    offset: str | None
    source: str
    problems: tuple[str, ...] = ()


def read_truth(path: str | Path, frame: Frame | None = None) -> Truth:
    """Read a truth file, see `SUPPORTED`; a flight's folder stands for its ``corridor_truth.csv``.

    Parameters
    ----------
    path
        The file or folder.
    frame
        Convention of its signs. None: what the file says of itself; a CSV that says nothing is in FRD.

    Raises
    ------
    InputError
        Where it cannot be read, lacks a time or a heading, or its convention or units are not known.
    """
    path = Path(path)
    if path.is_dir():
        if not (path / TRUTH_NAME).exists():
            raise InputError(f"the folder holds no {TRUTH_NAME}", file=path, remedy="give the file itself")
        path = path / TRUTH_NAME
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror or error}", file=path) from error
    except UnicodeDecodeError as error:
        raise InputError("is not a text file", file=path, remedy=f"supported: {SUPPORTED}") from error
    lines = [line for line in lines if line.strip()]
    rows = [line for line in lines if not line.startswith("#")]
    if not rows:
        raise InputError("holds no rows", file=path)
    if "," not in rows[0] and len(rows[0].split()) == 8:
        return _from_tum(path, lines, rows, frame)
    return _from_csv(path, lines, frame or _frame_beside(path))


def _frame_beside(path: Path) -> Frame | None:
    """Convention of a table that lies in an output folder."""
    if path.name not in ("estimates.csv", "smoothed.csv"):
        return None
    with suppress(OSError, ValueError, KeyError):
        return Frame(json.loads((path.parent / "summary.json").read_text(encoding="utf-8"))["frame"])
    return None


def _from_tum(path: Path, lines: Sequence[str], rows: Sequence[str], frame: Frame | None) -> Truth:
    found = (re.match(r"#\s*(\w+):\s*(\S+)", line) for line in lines)
    said = {match[1]: match[2] for match in found if match}
    ours = said.get("software") == "corridor-fusion"
    if frame is None and said.get("frame", "") in list(Frame):
        frame = Frame(said["frame"])
    if frame is None:
        raise _which_way(path, "a TUM trajectory does")
    problems: list[str] = []
    cells = [row.split() for row in rows]
    t_ns = _times(path, [cell[0] for cell in cells], "s")
    values = _numbers(path, [cell[1:] for cell in cells], 7, problems)
    x, y, z, w = values[:, 3:].T
    heading = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    offset = values[:, 1] if said.get("offset_unit") != "none" else np.full(len(t_ns), np.nan)
    unit = "norm" if said.get("offset_unit") == "half" else "m"
    kind = (
        "a corridor-fusion trajectory" if ours else "a TUM trajectory: yaw from one fixed axis, y as offset"
    )
    return _truth(path, t_ns, heading, offset, unit, frame, problems, fixed_axis=not ours, kind=kind)


def _which_way(path: Path, what: str) -> InputError:
    return InputError(
        f"{what} not say which way its angles count",
        file=path,
        remedy="add --truth-frame ros where z points up, positive left, or frd where it points down, positive right",
    )


def _from_csv(path: Path, lines: Sequence[str], frame: Frame | None) -> Truth:
    first = next((k for k, line in enumerate(lines) if _is_number(line.partition(",")[0])), len(lines))
    header = next((line for line in reversed(lines[:first]) if "," in line), None)
    if header is None:
        raise InputError(
            "does not name its columns in the first line", file=path, remedy=f"supported: {SUPPORTED}"
        )
    names = [_plain_name(cell) for cell in next(csv.reader([header.lstrip("# ")]))]
    rows = list(csv.reader(line for line in lines[first:] if not line.startswith("#")))
    if not rows:
        raise InputError("has a header but no rows", file=path)
    column: dict[str, int] = {}
    for k, name in enumerate(names):
        column.setdefault(name, k)
    problems: list[str] = []
    whole = [row for row in rows if len(row) == len(names)]
    if not whole:
        raise InputError(f"its rows do not have the header's {len(names)} columns", file=path)
    if len(whole) < len(rows):
        problems.append(f"{path.name}: {counted(len(rows) - len(whole), 'row')} of other length dropped")

    time_name, unit = _find_time(path, column, whole[0])

    def read(name: str) -> FloatArray:
        return _numbers(path, [[row[column[name]]] for row in whole], 1, problems, names=(name,))[:, 0]

    t_ns = _times(path, [row[column[time_name]].strip() for row in whole], unit)
    heading, fixed_axis, kind = _heading(path, column, read)
    if fixed_axis and frame is None:
        raise _which_way(path, "yaw and quaternions do")
    offset, offset_unit = np.full(len(whole), np.nan), "m"
    for name, scale, its in (("lateral_offset_m", 1.0, "m"), ("lateral_offset_cm", 0.01, "m")):
        if name in column:
            offset, offset_unit = scale * read(name), its
    if not np.isfinite(offset).any() and "lateral_offset_norm" in column:
        offset, offset_unit = read("lateral_offset_norm"), "norm"
    ids = next((read(name) for name in ("corridor_id", "corridor_index") if name in column), None)
    return _truth(
        path,
        t_ns,
        heading,
        offset,
        offset_unit,
        frame or Frame.FRD,
        problems,
        fixed_axis=fixed_axis,
        kind=kind,
        width_m=read("corridor_width_m") if "corridor_width_m" in column else None,
        ids=ids,
        in_junction=read("in_junction") if "in_junction" in column else None,
    )


def _is_number(cell: str) -> bool:
    with suppress(ValueError):
        float(cell)
        return True
    return False


def _plain_name(cell: str) -> str:
    """Return ``heading_deg`` for ``Heading [deg]``."""
    name = re.sub(
        r"\s*[\[(]\s*([\w/]*)\s*[\])]\s*$",
        lambda unit: f"_{unit[1]}" if unit[1] else "",
        cell.strip().lower(),
    )
    return re.sub(r"[\s.]+", "_", name)


def _as_suffix(unit: re.Match[str]) -> str:
    return f"_{unit[1]}" if unit[1] else ""


def _find_time(path: Path, column: Mapping[str, int], row: Sequence[str]) -> tuple[str, str]:
    for base in _TIME_NAMES:
        for unit in _TIME_SCALE:
            if f"{base}_{unit}" in column:
                return f"{base}_{unit}", unit
    bare = next((name for name in _TIME_NAMES if name in column), None)
    remedy = "name it with its unit: timestamp_ns, timestamp_us, timestamp_ms or timestamp_s"
    if bare is None:
        raise InputError(f"has no time column among {', '.join(column)}", file=path, remedy=remedy)
    if re.fullmatch(r"\d{18,19}", row[column[bare]].strip()):  # Unix time of this century in nanoseconds
        return bare, "ns"
    raise InputError(f"column {bare} does not say its unit", file=path, remedy=remedy)


def _heading(
    path: Path, column: Mapping[str, int], read: Callable[[str], FloatArray]
) -> tuple[FloatArray, bool, str]:
    for name, scale in (("heading_rad", 1.0), ("heading_deg", pi / 180)):
        if name in column:
            return scale * read(name), False, "headings from the axis of the corridor being flown"
    for name, scale in (("yaw_rad", 1.0), ("yaw_deg", pi / 180)):
        if name in column:
            return scale * read(name), True, "yaw from one fixed axis"
    for names in _QUATERNIONS:
        if set(names) <= set(column):
            w, x, y, z = (read(name) for name in names)
            yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
            return yaw, True, "quaternions: yaw from one fixed axis"
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


def _times(path: Path, cells: Sequence[str], unit: str) -> TimeArray:
    """Return times in nanoseconds, exact; a decimal fraction of Unix seconds does not fit a float64."""
    scale = _TIME_SCALE[unit]
    digits = len(str(scale)) - 1
    found = []
    for cell in cells:
        match = re.fullmatch(r"([+-]?)(\d+)(?:\.(\d*))?", cell)
        try:
            if match:
                part = (match[3] or "")[:digits].ljust(digits, "0")
                t_ns = int(match[2]) * scale + (int(part) if part else 0)
                found.append(-t_ns if match[1] == "-" else t_ns)
            else:
                found.append(round(float(cell) * scale))
        except (ValueError, OverflowError) as error:
            raise InputError(
                f"time {cell!r} is no number", file=path, remedy=f"times are in {unit}"
            ) from error
    try:
        return np.array(found, dtype=np.int64)
    except OverflowError as error:
        raise InputError(f"times are too large for {unit}", file=path, remedy="name their unit") from error


_TRUE_FALSE = {"true": "1", "false": "0", "": "nan", "null": "nan", "none": "nan"}


def _numbers(
    path: Path, rows: Sequence[Sequence[str]], width: int, problems: list[str], names: Sequence[str] = ()
) -> FloatArray:
    values = np.full((len(rows), width), np.nan)
    bad: list[str] = []
    for k, row in enumerate(rows):
        try:
            values[k] = [float(_TRUE_FALSE.get(cell.strip().lower(), cell)) for cell in row]
        except ValueError:
            bad.append(" ".join(row))
    if bad:
        if 2 * len(bad) > len(rows):
            raise InputError(f"{', '.join(names) or 'a row'} is {bad[0]!r}, no number", file=path)
        what = f" in {names[0]}" if names else ""
        problems.append(
            f"{path.name}: {counted(len(bad), 'value')} that are no numbers{what}, the first {bad[0]!r}"
        )
    return values


def _truth(
    path: Path,
    t_ns: TimeArray,
    heading: FloatArray,
    offset: FloatArray,
    offset_unit: str,
    frame: Frame,
    problems: list[str],
    *,
    fixed_axis: bool,
    kind: str,
    width_m: FloatArray | None = None,
    ids: FloatArray | None = None,
    in_junction: FloatArray | None = None,
) -> Truth:
    sign = -1.0 if frame is Frame.ROS else 1.0
    rows = np.flatnonzero(np.isfinite(heading))
    if not rows.size:
        raise InputError("holds no row with a heading", file=path)
    rows = rows[order_times(t_ns[rows], problems, path.name)]
    if np.abs(heading[rows]).max() > 4 * pi:
        raise InputError(
            f"headings reach {np.abs(heading[rows]).max():.4g} rad",
            file=path,
            remedy="are they degrees? name them heading_deg",
        )
    kinds = "m" if offset_unit == "m" else "norm"
    width = np.full(len(t_ns), np.nan) if width_m is None else width_m
    if offset_unit == "norm":  # with a width of two metres half of it is one
        known_width = np.isfinite(width)
        offset = np.where(known_width, offset * width / 2, offset)
        kinds = "both" if known_width.any() else "norm"
        width = np.where(known_width, width, 2.0)
    elif np.isfinite(width).any():
        kinds = "both"
    corridor = CorridorTruth(
        t_ns=t_ns[rows],
        heading_rad=sign * heading[rows],
        lateral_offset_m=sign * offset[rows],
        corridor_width_m=width[rows],
        corridor_id=_whole(ids, len(t_ns))[rows],
        in_junction=_whole(in_junction, len(t_ns))[rows] != 0,
    )
    side = "left" if frame is Frame.ROS else "right"
    has_offset = bool(np.isfinite(offset[rows]).any())
    source = f"{path}: {kind}, positive {side}" + ("" if has_offset else "; no offsets")
    return Truth(corridor, fixed_axis, kinds if has_offset else None, source, tuple(problems))


def _whole(values: FloatArray | None, count: int) -> npt.NDArray[np.int64]:
    if values is None:
        return np.zeros(count, dtype=np.int64)
    return np.nan_to_num(values, nan=0.0).astype(np.int64)
