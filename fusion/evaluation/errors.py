"""Errors against the truth: the article's RMSE and MAE, and whether the stated sigmas are honest.

Sign of every error: estimate minus truth. Angles in radians, offsets in metres and over half the corridor's
width (positive right), times in nanoseconds. Headings are relative to the corridor being flown, so truth is
never interpolated from one corridor into the next.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from fusion.estimator.tables import Table
from fusion.flight import CorridorTruth, FloatArray, TimeArray

BoolArray = npt.NDArray[np.bool_]

PERCENTILES = (50, 90, 95, 99)


def wrap_angle(angle_rad: npt.ArrayLike) -> FloatArray:
    """Bring angles of any shape into [-pi, pi)."""
    angle = np.asarray(angle_rad, dtype=np.float64)
    return np.asarray((angle + np.pi) % (2.0 * np.pi) - np.pi, dtype=np.float64)


def rmse(estimate: npt.ArrayLike, truth: npt.ArrayLike, *, angle: bool = False) -> float:
    """Root mean squared error, the article's equation (9).

    Parameters
    ----------
    estimate, truth
        Arrays of one shape, in one unit; the answer has that unit. A NaN in either gives NaN.
    angle
        Whether they are angles in radians, whose difference is wrapped to half a turn.

    Raises
    ------
    ValueError
        Where the shapes differ or there is nothing to compare.
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
    return wrap_angle(a - b) if angle else a - b


@dataclass(frozen=True, slots=True, eq=False)
class TruthAt:
    """Truth at given times; every array is (n,). Rows that are not ``known`` hold NaN.

    Parameters
    ----------
    inside
        The time lies within the truth's span.
    known
        ``inside``, and neither in a hole of the truth nor between two corridors.
    in_junction
        Either neighbouring row of the truth lies in a junction.
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
    max_gap_s
        Neighbouring truth rows further apart than this leave the times between them unknown.
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
    # Differences of integers first: a float64 of Unix time in nanoseconds is only good to 256 ns.
    part = np.clip((t - truth.t_ns[low]) / np.maximum(gap_ns, 1), 0.0, 1.0)
    known = inside & (truth.corridor_id[low] == truth.corridor_id[high]) & (gap_ns <= max_gap_s * 1e9)

    def blend(values: FloatArray, *, angle: bool = False) -> FloatArray:
        step = values[high] - values[low]
        out = values[low] + part * (wrap_angle(step) if angle else step)
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


def evaluate(table: Table, truth: CorridorTruth, *, max_gap_s: float = 0.5) -> dict[str, Any]:
    """Compare estimates or single frames with the truth.

    Judged are the rows that are tracking (estimates) or accepted (frames), outside junctions and within the
    truth's span; every other row is counted under the first cause that applies.

    Parameters
    ----------
    table
        Rows of `ESTIMATE_DTYPE` or `FRAME_DTYPE`.
    truth
        What the flight really did.
    max_gap_s
        As for `interpolate_truth`.

    Returns
    -------
    dict
        Plain numbers, ready for JSON: ``rows``, ``judged``, ``excluded`` (``outside_truth``, ``junction``,
        ``no_truth`` and ``not_tracking`` or ``not_accepted``), ``status_share`` (estimates only), the
        quantities ``heading``, ``lateral_offset_m`` and ``lateral_offset_norm``, and ``corridors``, which
        holds ``rows`` and the same by the truth's corridor id as text. A quantity holds ``count``, then ``rmse``,
        ``mae``, ``max``, ``p50``, ``p90``, ``p95``, ``p99`` (all of the absolute error but the first) and
        ``bias`` (the mean error) with the unit appended (``rmse_rad``, ``rmse_m``, ``rmse_norm``), then
        ``nees_mean`` (1 for an honest sigma) and ``error_over_sigma_p90`` (1.64 for an honest Gaussian one);
        None where nothing was left to judge.
    """
    names = table.dtype.names or ()
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
    result: dict[str, Any] = {
        "rows": len(table),
        "judged": int(np.count_nonzero(judged)),
        "excluded": excluded,
    }
    if estimates:
        result["status_share"] = _status_share(table)
    result |= _quantities(table, at, judged)
    result["corridors"] = {}
    for i in np.unique(at.corridor_id[judged]):
        there = at.inside & (at.corridor_id == i)
        found: dict[str, Any] = {"rows": int(np.count_nonzero(there))}
        if estimates:
            found["status_share"] = _status_share(table[there])
        result["corridors"][str(i)] = found | _quantities(table, at, judged & there)
    return result


def _status_share(table: Table) -> dict[str, float]:
    words, counts = np.unique(table["status"], return_counts=True)
    return {str(word): float(count / len(table)) for word, count in zip(words, counts, strict=True)}


def _quantities(table: Table, at: TruthAt, rows: BoolArray) -> dict[str, Any]:
    names = table.dtype.names or ()
    heading_error = wrap_angle(table["heading_rad"] - at.heading_rad)
    out = {"heading": _statistics(heading_error[rows], table["heading_std_rad"][rows], "rad")}
    for unit, truth_values in (("m", at.lateral_offset_m), ("norm", at.lateral_offset_norm)):
        name = f"lateral_offset_{unit}"
        if name in names:
            std = table["lateral_offset_std_m" if unit == "m" else "lateral_offset_norm_std"]
            out[name] = _statistics((table[name] - truth_values)[rows], std[rows], unit)
    return out


def _statistics(error: FloatArray, std: FloatArray, unit: str) -> dict[str, Any]:
    finite = np.isfinite(error)
    error, std = error[finite], std[finite]
    names = [f"{word}_{unit}" for word in ("rmse", "mae", "max", *(f"p{p}" for p in PERCENTILES), "bias")]
    out: dict[str, Any] = {"count": int(error.size)} | dict.fromkeys(names)
    if error.size:
        size = np.abs(error)
        numbers = (
            rmse(error, np.zeros_like(error)),
            size.mean(),
            size.max(),
            *np.percentile(size, PERCENTILES),
        )
        out |= {name: float(v) for name, v in zip(names, (*numbers, error.mean()), strict=True)}
    stated = std > 0  # NaN fails too
    ratio = np.abs(error[stated]) / std[stated]
    out["nees_mean"] = float(np.mean(ratio**2)) if ratio.size else None
    out["error_over_sigma_p90"] = float(np.percentile(ratio, 90)) if ratio.size else None
    return out
