"""Errors against ground truth: the article's RMSE and MAE, and the filter's consistency.

Sign of every error: estimate minus truth. Angles in radians, offsets in metres and over half the corridor's
width (positive right), times in nanoseconds. Headings are relative to the corridor being flown, so truth is
not interpolated between corridors.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypedDict

import numpy as np
import numpy.typing as npt

from fusion.estimator.tables import Table
from fusion.flight import CorridorTruth, FloatArray, TimeArray, check_type
from fusion.result.summary import PERCENTILES, CorridorErrors, ErrorStatistics, TableErrors
from vision.errors import InputError
from vision.rotations import wrap

BoolArray = npt.NDArray[np.bool_]


def rmse(estimate: npt.ArrayLike, truth: npt.ArrayLike, *, angle: bool = False) -> float:
    """Root mean squared error, the article's equation (9).

    Parameters
    ----------
    estimate, truth
        Arrays of one shape, in one unit, which is that of the result. A NaN in either gives NaN.
    angle
        Whether they are angles in radians, with their difference wrapped to half a turn.

    Raises
    ------
    ValueError
        If the shapes differ or there is nothing to compare.
    """
    return float(np.sqrt(np.mean(np.square(_difference(estimate, truth, angle)))))


def mae(estimate: npt.ArrayLike, truth: npt.ArrayLike, *, angle: bool = False) -> float:
    """Mean absolute error, the article's equation (10); arguments as for `rmse`."""
    return float(np.mean(np.abs(_difference(estimate, truth, angle))))


def _difference(estimate: npt.ArrayLike, truth: npt.ArrayLike, angle: bool) -> FloatArray:
    a, b = np.asarray(estimate, dtype=np.float64), np.asarray(truth, dtype=np.float64)
    if a.shape != b.shape:
        raise ValueError(f"estimate has shape {a.shape}, truth {b.shape}; they must agree")
    if a.size == 0:
        raise ValueError("there is nothing to compare: both arrays are empty")
    return wrap(a - b) if angle else a - b


@dataclass(frozen=True, slots=True, eq=False)
class TruthAt:
    """Truth at given times; every array is (n,). Rows that are not ``known`` hold NaN.

    Parameters
    ----------
    inside
        The time is within the truth's span.
    known
        ``inside``, and neither in a gap of the truth nor between two corridors.
    in_junction
        Either neighbouring row of the truth is in a junction.
    """

    heading_rad: FloatArray
    lateral_offset_m: FloatArray
    lateral_offset_norm: FloatArray
    corridor_id: npt.NDArray[np.int64]
    in_junction: BoolArray
    inside: BoolArray
    known: BoolArray


def interpolate_truth(truth: CorridorTruth, t_ns: TimeArray, max_gap_s: float = 0.5) -> TruthAt:
    """Interpolate the truth linearly at times (n,), along the shorter arc and within one corridor only.

    Parameters
    ----------
    truth
        The ground truth.
    t_ns
        Times (n,), in any order.
    max_gap_s
        Truth is unknown between neighbouring rows further apart than this.
    """
    t = np.asarray(t_ns, dtype=np.int64)
    if truth.t_ns.size == 0:
        nothing, no = np.full(t.size, np.nan), np.zeros(t.size, dtype=bool)
        return TruthAt(nothing, nothing, nothing, np.full(t.size, -1, dtype=np.int64), no, no, no)
    inside = (t >= truth.t_ns[0]) & (t <= truth.t_ns[-1])
    last = truth.t_ns.size - 1
    low = np.clip(np.searchsorted(truth.t_ns, t, side="right") - 1, 0, last)
    high = np.where(truth.t_ns[low] == t, low, np.minimum(low + 1, last))
    gap_ns = truth.t_ns[high] - truth.t_ns[low]
    # Integer differences first: a float64 of Unix time in nanoseconds has a resolution of 256 ns.
    part = np.clip((t - truth.t_ns[low]) / np.maximum(gap_ns, 1), 0.0, 1.0)
    known = inside & (truth.corridor_id[low] == truth.corridor_id[high]) & (gap_ns <= max_gap_s * 1e9)

    def blend(values: FloatArray, *, angle: bool = False) -> FloatArray:
        step = values[high] - values[low]
        out = values[low] + part * (wrap(step) if angle else step)
        return np.where(known, out, np.nan)

    offset_m, width_m = blend(truth.lateral_offset_m), blend(truth.corridor_width_m)
    half_m = np.where(width_m > 0, width_m / 2.0, np.nan)
    return TruthAt(
        heading_rad=blend(truth.heading_rad, angle=True),
        lateral_offset_m=offset_m,
        lateral_offset_norm=offset_m / half_m,
        corridor_id=np.where(part < 0.5, truth.corridor_id[low], truth.corridor_id[high]),
        in_junction=truth.in_junction[low] | truth.in_junction[high],
        inside=inside,
        known=known,
    )


def evaluate(table: Table, truth: CorridorTruth, *, max_gap_s: float = 0.5) -> TableErrors:
    """Compare estimates or single frames with ground truth.

    Errors are evaluated over rows that are tracking (estimates) or accepted (frames), outside junctions and within
    the time of the truth. All other rows are counted under the first reason that applies. RMSE and MAE are the
    article's equations (9) and (10). NEES, the normalised estimation error squared, is the mean of (error /
    sigma)^2, 1 for a consistent filter (Y. Bar-Shalom, X. R. Li, T. Kirubarajan, "Estimation with Applications to
    Tracking and Navigation", Wiley 2001, section 5.4).

    Parameters
    ----------
    table
        Rows of `fusion.estimator.tables.ESTIMATE_DTYPE` or `fusion.estimator.tables.FRAME_DTYPE`.
    truth
        The ground truth.
    max_gap_s
        As for `interpolate_truth`.

    Returns
    -------
    TableErrors
        Errors of heading (rad) and lateral offset (m and half widths), for the flight and per corridor; ``to_dict()``
        gives plain values for JSON.

    Raises
    ------
    InputError
        If the table is none of these types, or the truth is not a `fusion.flight.CorridorTruth`.
    """
    columns = "a table with its columns, such as result.estimates or result.frames"
    check_type(table, np.ndarray, "table", f"give {columns}")
    check_type(truth, CorridorTruth, "truth", "give flight.truth of a flight with ground truth")
    names = table.dtype.names or ()
    missing = {"timestamp_ns", "heading_rad", "heading_std_rad"}.difference(names)
    if missing or not {"status", "accepted"}.intersection(names):
        raise InputError(
            f"table has no column {', '.join(sorted(missing)) or 'status or accepted'}",
            remedy=f"give {columns}",
        )
    estimates = "status" in names
    usable = table["status"] == "tracking" if estimates else np.asarray(table["accepted"], dtype=bool)
    at = interpolate_truth(truth, table["timestamp_ns"], max_gap_s)
    excluded, judged = {}, np.ones(len(table), dtype=bool)
    for cause, keep in (
        ("outside_truth", at.inside),
        ("junction", ~at.in_junction),
        ("no_truth", at.known),
        ("not_tracking" if estimates else "not_accepted", usable),
    ):
        excluded[cause] = int(np.count_nonzero(judged & ~keep))
        judged &= keep
    corridors = {}
    for i in np.unique(at.corridor_id[judged]):
        there = at.inside & (at.corridor_id == i)
        corridors[str(i)] = CorridorErrors(
            rows=int(np.count_nonzero(there)),
            status_share=_status_share(table[there]) if estimates else None,
            **_quantities(table, at, judged & there),
        )
    return TableErrors(
        rows=len(table),
        judged=int(np.count_nonzero(judged)),
        excluded=excluded,
        status_share=_status_share(table) if estimates else None,
        corridors=corridors,
        **_quantities(table, at, judged),
    )


def _status_share(table: Table) -> Mapping[str, float]:
    words, counts = np.unique(table["status"], return_counts=True)
    return {str(word): float(count / len(table)) for word, count in zip(words, counts, strict=True)}


class _Quantities(TypedDict):
    heading: ErrorStatistics
    lateral_offset_m: ErrorStatistics | None
    lateral_offset_norm: ErrorStatistics | None


def _quantities(table: Table, at: TruthAt, rows: BoolArray) -> _Quantities:
    heading_error = wrap(table["heading_rad"] - at.heading_rad)

    def offset(name: str, std_name: str, truth: FloatArray, unit: str) -> ErrorStatistics | None:
        if name not in (table.dtype.names or ()):
            return None
        return _statistics((table[name] - truth)[rows], table[std_name][rows], unit)

    return _Quantities(
        heading=_statistics(heading_error[rows], table["heading_std_rad"][rows], "rad"),
        lateral_offset_m=offset("lateral_offset_m", "lateral_offset_std_m", at.lateral_offset_m, "m"),
        lateral_offset_norm=offset(
            "lateral_offset_norm", "lateral_offset_norm_std", at.lateral_offset_norm, "norm"
        ),
    )


def _statistics(error: FloatArray, std: FloatArray, unit: str) -> ErrorStatistics:
    finite = np.isfinite(error)
    error, std = error[finite], std[finite]
    stated = std > 0  # excludes NaN, too
    ratio = np.abs(error[stated]) / std[stated]
    nees = float(np.mean(ratio**2)) if ratio.size else None
    ratio_p90 = float(np.percentile(ratio, 90)) if ratio.size else None
    if not error.size:
        return ErrorStatistics(unit, 0, nees_mean=nees, error_over_sigma_p90=ratio_p90)
    size = np.abs(error)
    p50, p90, p95, p99 = (float(value) for value in np.percentile(size, PERCENTILES))
    return ErrorStatistics(
        unit,
        int(error.size),
        rmse=rmse(error, np.zeros_like(error)),
        mae=float(size.mean()),
        max=float(size.max()),
        p50=p50,
        p90=p90,
        p95=p95,
        p99=p99,
        bias=float(error.mean()),
        nees_mean=nees,
        error_over_sigma_p90=ratio_p90,
    )
