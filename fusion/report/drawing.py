"""Drawing of plots: colours, thinned lines, bands and dots, and axes."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import PathPatch
from matplotlib.path import Path

from fusion.flight import FloatArray
from fusion.report.series import IndexArray, band_envelope, broken, envelope

INK = "#1b1f24"
FAINT = "#7a828b"
GRID = "#dfe2e6"
FILTER = "#0072b2"
SMOOTHED = "#009e73"
VISION = "#59616b"
REJECTED = "#d55e00"
HYPOTHESIS = "#b8a3c9"
IMU_YAW = "#e69f00"
RAW_YAW = "#cc79a7"
EDGE_WIDTH = 4.0  # of a line along the edge of an axis, for values beyond it
STATUS_COLOUR = {"initialising": "#b4bac1", "tracking": "#7cc4e8", "coasting": "#e8b33a", "lost": "#d1495b"}
NO_CUTS: IndexArray = np.array([], dtype=np.int64)

_BINS = ContextVar("bins", default=700)


@contextmanager
def thinned_to(bins: int) -> Iterator[None]:
    """Set the number of time intervals for thinning within this context (default: 700)."""
    before = _BINS.set(bins)
    try:
        yield
    finally:
        _BINS.reset(before)


def plain_axes(ax: Axes, x_label: str, y_label: str) -> None:
    """Label axes, and reduce their frame to two thin edges and a grid behind the lines."""
    ax.set_xlabel(x_label, color=INK)
    ax.set_ylabel(y_label, color=INK)
    ax.grid(axis="y", color=GRID, lw=0.6)
    ax.set_axisbelow(True)
    for side in ("top", "right"):
        ax.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        ax.spines[side].set_color(FAINT)
        ax.spines[side].set_linewidth(0.6)
    ax.tick_params(colors=INK, length=3, width=0.6, color=FAINT)


def draw_line(
    ax: Axes,
    t: FloatArray,
    y: FloatArray,
    cuts: IndexArray,
    colour: str,
    width: float,
    label: str,
    style: str | tuple[int, tuple[int, ...]] = "-",
) -> None:
    """Draw a thinned line, unless it is NaN throughout.

    Parameters
    ----------
    t, y
        Times (n,), seconds, and values (n,); NaN leaves a gap.
    cuts
        Indices (k,) of samples that are not connected to the previous one.
    colour, width, label, style
        As for `Axes.plot`.
    """
    if np.isfinite(y).any():
        x, values = envelope(*broken(t, y, cuts), _BINS.get())
        ax.plot(x, values, color=colour, lw=width, ls=style, label=label, zorder=3)


def draw_band(
    ax: Axes, t: FloatArray, middle: FloatArray, half: FloatArray, cuts: IndexArray, colour: str, label: str
) -> None:
    """Fill a band (n,) of this half width around its middle (n,), as `draw_line` draws a line."""
    if not np.isfinite(middle + half).any():
        return
    x, low = broken(t, middle - half, cuts)
    _, high = broken(t, middle + half, cuts)
    x, low, high = band_envelope(x, low, high, _BINS.get())
    ax.fill_between(x, low, high, color=colour, alpha=0.22, lw=0, label=label, zorder=1)


def draw_dots(ax: Axes, x: FloatArray, y: FloatArray, colour: str, label: str) -> None:
    """Draw points (n,) as dots."""
    if not len(x):
        return
    # A path of zero-length strokes with round caps needs a quarter of the bytes of markers in SVG.
    vertices = np.repeat(np.column_stack([x, y]), 2, axis=0)
    path = Path(vertices, np.tile(np.array([Path.MOVETO, Path.LINETO], dtype=np.uint8), len(x)))
    path.should_simplify = False
    patch = PathPatch(path, fill=False, edgecolor=colour, lw=2.4, capstyle="round", zorder=2.5)
    ax.add_patch(patch)
    ax.plot([], [], ".", color=colour, label=label)  # for the legend
    ax.update_datalim(vertices)
    ax.autoscale_view()


def widen_y_axis(ax: Axes, values: FloatArray) -> None:
    """Extend the limits for another series, unless that would squeeze the first."""
    values = values[np.isfinite(values)]
    if not values.size:
        return
    low, high = ax.get_ylim()
    margin = 0.05 * (high - low)
    wide = min(low, values.min() - margin), max(high, values.max() + margin)
    if wide[1] - wide[0] <= 2.0 * (high - low):
        ax.set_ylim(*wide)


def mark_beyond(ax: Axes, t: FloatArray, values: FloatArray) -> None:
    """Draw a thick line along the edge of the axis where the filter is beyond it."""
    low, high = ax.get_ylim()
    inset = 0.02 * (high - low)  # the status colour is below
    edge = np.where(values > high, high - inset, np.where(values < low, low + 3 * inset, np.nan))
    edge[1:] = np.where(np.isnan(edge[1:]), edge[:-1], edge[1:])  # a single sample would draw nothing
    draw_line(ax, t, edge, NO_CUTS, FILTER, EDGE_WIDTH, "filter beyond the scale")
