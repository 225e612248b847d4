"""Thin long series for a page without losing extremes."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from fusion.flight import FloatArray

IndexArray = npt.NDArray[np.int64]


def envelope_indices(t_s: FloatArray, y: FloatArray, bins: int = 700) -> IndexArray:
    """Choose the samples (at most 4 per bin of time) that keep a line's extremes, ends and gaps.

    Parameters
    ----------
    t_s, y
        Times (n,), not decreasing, and values (n,); NaN values are gaps, and one of each is kept.
    bins
        Intervals of equal length that the time is divided into.
    """
    n = len(t_s)
    if n <= 4 * bins:
        return np.arange(n)
    edges = np.searchsorted(t_s, np.linspace(t_s[0], t_s[-1], bins + 1)[1:-1])
    interval = np.searchsorted(edges, np.arange(n), side="right")
    starts = np.flatnonzero(np.diff(interval, prepend=-1))
    # Sorted by interval, then value: an interval's first is its extreme. NaN sorts last.
    lowest, highest = (np.lexsort((values, interval))[starts] for values in (y, -y))
    holes = np.flatnonzero(np.isnan(y))
    first_holes = holes[np.unique(interval[holes], return_index=True)[1]]
    return np.unique(np.concatenate([[0, n - 1], starts, lowest, highest, first_holes])).astype(np.int64)


def envelope(t_s: FloatArray, y: FloatArray, bins: int = 700) -> tuple[FloatArray, FloatArray]:
    """Return the samples that `envelope_indices` chooses."""
    keep = envelope_indices(t_s, y, bins)
    return t_s[keep], y[keep]


def band_envelope(
    t_s: FloatArray, low: FloatArray, high: FloatArray, bins: int = 700
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Thin a band to the samples at which either of its edges is extreme.

    Parameters
    ----------
    t_s, low, high
        Times (n,), not decreasing, and the band's edges (n,).
    bins
        As for `envelope_indices`.
    """
    keep = np.union1d(envelope_indices(t_s, low, bins), envelope_indices(t_s, high, bins))
    return t_s[keep], low[keep], high[keep]


def thin_points(t_s: FloatArray, y: FloatArray, limit: int = 3000) -> tuple[FloatArray, FloatArray]:
    """Thin a scatter to about ``limit`` points, half of them extremes and half evenly spaced.

    The extremes keep the outliers, but would look like two bands; the others show where most points are.
    """
    finite = np.isfinite(y) & np.isfinite(t_s)
    t_s, y = t_s[finite], y[finite]
    if len(t_s) <= limit:
        return t_s, y
    extremes = envelope_indices(t_s, y, bins=max(1, limit // 6))
    stride = -(-len(t_s) // max(1, limit // 2))
    keep = np.union1d(extremes, np.arange(0, len(t_s), stride))
    return t_s[keep], y[keep]


def broken(t_s: FloatArray, y: FloatArray, before: IndexArray) -> tuple[FloatArray, FloatArray]:
    """Break a line before the samples of the given indices."""
    return np.insert(t_s, before, t_s[before]), np.insert(y, before, np.nan)
