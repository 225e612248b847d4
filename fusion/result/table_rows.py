"""Rows of a result's tables: stretches with a flag, the row at a time, frames at a junction, unknown offsets."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from math import radians

import numpy as np
import numpy.typing as npt

from fusion.estimator.lateral.status import LATERAL_REASON_MEANING, LateralReason, LateralStatus
from fusion.estimator.tables import Table
from vision.rotations import wrap_axis

SAME_AXIS_RAD = radians(5)


def runs(flags: npt.NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Half-open index ranges (start, stop) of the stretches in which a flag is set."""
    padded = np.concatenate(([False], flags, [False])).astype(np.int8)
    edges = np.flatnonzero(np.diff(padded))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def lateral_unknown_share(estimates: Table) -> dict[str, float]:
    """Return the share of all rows whose lateral offset is unknown, by `LateralReason`, the largest first."""
    reasons = estimates["lateral_reason"][estimates["lateral_status"] == LateralStatus.UNKNOWN]
    return {word: count / len(estimates) for word, count in Counter(reasons.tolist()).most_common()}


def lateral_unknown_text(share: Mapping[str, float]) -> str:
    """Return the shares as words: by how much of the time the offset is unknown, and why."""
    total = sum(share.values())
    if not total:
        return "known all the time"
    parts = [f"{part:.1%} {LATERAL_REASON_MEANING[LateralReason(word)]}" for word, part in share.items()]
    return f"unknown {total:.1%} of the time: {', '.join(parts)}"


def row_before(table: Table, t_ns: int) -> int:
    """Row of a non-empty table that is valid at a time: the last one not after it, or else the first."""
    return max(int(np.searchsorted(table["timestamp_ns"], t_ns, side="right")) - 1, 0)


def held_back_at_junctions(estimates: Table, frames: Table) -> npt.NDArray[np.bool_]:
    """Flag the frames (n,) of a new corridor that the filter held back until it confirmed the junction.

    They follow the last frame used in the old corridor, and their innovation is the turn between the two axes. A
    junction is not confirmed if the filter returned to the old corridor later.

    Parameters
    ----------
    estimates
        The causal filter's table.
    frames
        The frames' table.
    """
    held = np.zeros(len(frames), dtype=bool)
    if not len(estimates):
        return held
    t_ns = estimates["timestamp_ns"]
    rows = np.append(np.searchsorted(t_ns, frames["timestamp_ns"], side="right") - 1, -1)
    rows[:-1] = np.maximum(rows[:-1], 0)  # before the first estimate: the first, as in `row_before`
    index, turn_rad = estimates["corridor_index"], estimates["corridor_turn_rad"]
    for first, end in runs(~frames["accepted"]):
        old, new = rows[max(first - 1, 0)], rows[end]
        if index[old] < index[new] <= index[new:].min():
            turned = frames["innovation_rad"][first:end] + (turn_rad[new] - turn_rad[old])
            held[first:end] = np.abs(wrap_axis(turned)) < SAME_AXIS_RAD  # False for NaN
    return held
