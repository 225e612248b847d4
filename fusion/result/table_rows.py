"""Rows of a result's tables: the stretches in which a flag is set, and the row that holds at a time."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from fusion.estimator.tables import Table


def runs(flags: npt.NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Half-open index ranges (start, stop) of the stretches in which a flag is set."""
    padded = np.concatenate(([False], flags, [False])).astype(np.int8)
    edges = np.flatnonzero(np.diff(padded))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def row_before(table: Table, t_ns: int) -> int:
    """Row of a table that is not empty which holds at a time: the last not after it, else the first."""
    return max(int(np.searchsorted(table["timestamp_ns"], t_ns, side="right")) - 1, 0)
