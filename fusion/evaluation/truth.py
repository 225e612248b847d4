"""Ground truth of a flight, and its construction from a file's columns."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import pi
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt

from fusion.flight import CorridorTruth, FloatArray, TimeArray
from fusion.logs.samples import Problems, order_times
from fusion.result.conventions import Frame
from vision.errors import InputError

OffsetUnit = Literal["m", "norm"]


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """A ground truth, and how to compare with it.

    Parameters
    ----------
    corridor
        In FRD; NaN for unknown offsets.
    fixed_axis
        Headings are relative to one axis for the whole flight, not to the corridor being flown.
    offset
        ``m``, ``norm`` or ``both``: units of comparable offsets; None if it has none.
    source
        The file, in words.
    frame
        Sign convention with which it was read.
    problems
        Problems of reading.
    """

    corridor: CorridorTruth
    fixed_axis: bool
    offset: str | None
    source: str
    frame: Frame
    problems: tuple[str, ...] = ()

    def shifted(self, seconds: float) -> Truth:
        """Add seconds to its times, for a truth with another clock.

        Raises
        ------
        InputError
            If that is not a number, or so large that the times leave the years 1678 to 2262.
        """
        if not seconds:
            return self
        reach_ns = int(np.abs(self.corridor.t_ns).max())
        if not abs(seconds) * 1e9 + reach_ns < 2**63:  # NaN is rejected, too
            raise InputError(f"--truth-shift {seconds:.15g}: no time of a truth can be shifted by that")
        corridor = replace(self.corridor, t_ns=self.corridor.t_ns + round(seconds * 1e9))
        return replace(self, corridor=corridor, source=f"{self.source}; {seconds:+.15g} s to its times")


@dataclass(frozen=True, slots=True, eq=False)
class TruthColumns:
    """Rows of a ground truth file, in the file's own sign convention.

    Parameters
    ----------
    t_ns
        Times (n,) in nanoseconds, in any order.
    heading_rad
        Headings (n,); NaN if a row has none.
    offset
        Lateral offsets (n,) in ``offset_unit``; NaN if unknown.
    offset_unit
        ``m``, or ``norm`` for half widths.
    width_m
        Corridor widths (n,), NaN if unknown; None if the file has none.
    corridor_id, in_junction
        Numbers (n,), NaN taken as 0; None if the file has none.
    """

    t_ns: TimeArray
    heading_rad: FloatArray
    offset: FloatArray
    offset_unit: OffsetUnit
    width_m: FloatArray | None = None
    corridor_id: FloatArray | None = None
    in_junction: FloatArray | None = None


def truth_of(
    columns: TruthColumns, path: Path, frame: Frame, problems: Problems, *, fixed_axis: bool, kind: str
) -> Truth:
    """Make a ground truth from a file's columns: rows with a heading, in order of time, in FRD.

    Parameters
    ----------
    columns
        As read.
    path, kind
        The file, and its kind of truth, for `Truth.source`.
    frame
        Its sign convention.
    problems
        Problems of reading.
    fixed_axis
        See `Truth`.

    Raises
    ------
    InputError
        If no row has a heading, or headings are too large for radians.
    """
    sign = -1.0 if frame is Frame.ROS else 1.0
    heading_rad = columns.heading_rad
    rows = np.flatnonzero(np.isfinite(heading_rad))
    if not rows.size:
        raise InputError("contains no row with a heading", file=path)
    order, disorder = order_times(columns.t_ns[rows], path.name)
    rows = rows[order]
    if np.abs(heading_rad[rows]).max() > 4 * pi:
        raise InputError(
            f"headings reach {np.abs(heading_rad[rows]).max():.4g} rad",
            file=path,
            remedy="are they degrees? name them heading_deg",
        )
    offset_m, width_m, known_as = _offset_in_metres(columns)
    count = len(columns.t_ns)
    corridor = CorridorTruth(
        t_ns=columns.t_ns[rows],
        heading_rad=sign * heading_rad[rows],
        lateral_offset_m=sign * offset_m[rows],
        corridor_width_m=width_m[rows],
        corridor_id=_integers(columns.corridor_id, count)[rows],
        in_junction=_integers(columns.in_junction, count)[rows] != 0,
    )
    side = "left" if frame is Frame.ROS else "right"
    has_offset = bool(np.isfinite(offset_m[rows]).any())
    source = f"{path}: {kind}, positive {side}" + ("" if has_offset else "; no offsets")
    return Truth(corridor, fixed_axis, known_as if has_offset else None, source, frame, problems + disorder)


def _offset_in_metres(columns: TruthColumns) -> tuple[FloatArray, FloatArray, str]:
    """Return offsets and widths (n,) in metres, and the units of comparable offsets; see `Truth.offset`."""
    offset = columns.offset
    width_m = np.full(len(offset), np.nan) if columns.width_m is None else columns.width_m
    known = np.isfinite(width_m)
    if columns.offset_unit == "m":
        return offset, width_m, "both" if known.any() else "m"
    # If no width is known, a width of 2 m makes an offset in half widths equal to one in metres.
    offset_m = np.where(known, offset * width_m / 2, offset)
    return offset_m, np.where(known, width_m, 2.0), "both" if known.any() else "norm"


def _integers(values: FloatArray | None, count: int) -> npt.NDArray[np.int64]:
    if values is None:
        return np.zeros(count, dtype=np.int64)
    return np.nan_to_num(values, nan=0.0).astype(np.int64)
