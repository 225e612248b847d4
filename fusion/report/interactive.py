"""The report's plots as data, for the interactive charts that replace them in a browser with scripts.

The contents are defined only in `fusion.report.plots`: the same functions draw into axes that are never rendered, and
their lines, bands and points are extracted. `uPlot <https://github.com/leeoniya/uPlot>`_ draws them: 50 kB
under the MIT licence, where Plotly takes 1 MB and more and Bokeh 0.8 MB, and it draws 100,000 points at once.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from importlib.resources import files
from typing import Any

import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import PathPatch

from fusion.flight import Flight, FloatArray
from fusion.report import drawing, plots
from fusion.report.strip import small_pictures
from fusion.report.svg import CSS_NAME
from fusion.result.result import FusionResult
from fusion.result.table_rows import runs

Panel = Callable[[Axes], None]

BINS = 1200  # time bins of a thinned series: keeps the report of a ten-minute flight below 6 MB
GAP_S = 1e-4  # of a gap's time before the next sample, because times must differ
PICTURES_PER_S, MAX_PICTURES = 2.0, 90


def page_data(result: FusionResult, flight: Flight, panels: dict[str, Sequence[Panel]]) -> Markup:
    """Return the data for the page's script, as JSON safe for embedding in HTML.

    Parameters
    ----------
    result, flight
        As for `fusion.report.write_report`.
    panels
        Functions that draw the panels, by the name of the figure.
    """
    table = result.estimates
    origin_ns = result.origin_ns
    t = plots.seconds(table["timestamp_ns"], origin_ns)
    status = [
        [round(float(t[a]), 3), round(float(t[min(b, len(t) - 1)]), 3), word]
        for word in drawing.STATUS_COLOUR
        for a, b in runs(table["status"] == word)
    ]
    count = min(MAX_PICTURES, round(PICTURES_PER_S * float(t[-1] - t[0])) + 1) if len(t) else 0
    data = {
        "charts": {name: _charts(drawn) for name, drawn in panels.items()},
        "status": status,
        "switches": [round(float(t[k + 1]), 3) for k in np.flatnonzero(np.diff(table["corridor_index"]))],
        "pictures": [
            {
                "t": round((int(result.frames["timestamp_ns"][row]) - origin_ns) / 1e9, 3),
                "src": picture,
                "said": str(result.frames["reason"][row]),
            }
            for row, picture in small_pictures(result, flight, count)
        ],
    }
    return Markup(json.dumps(data, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c"))


def script() -> tuple[Markup, Markup]:
    """Return the page's script and its style sheet."""
    text = {
        name: (files("fusion.report") / name).read_text("utf-8")
        for name in ("uplot.min.js", "uplot.min.css", "interactive.js")
    }
    return Markup(text["uplot.min.js"] + "\n" + text["interactive.js"]), Markup(text["uplot.min.css"])


def _charts(panels: Sequence[Panel]) -> list[dict[str, Any]]:
    axes = Figure().subplots(len(panels), 1, squeeze=False)[:, 0]
    with drawing.thinned_to(BINS):
        for ax, panel in zip(axes, panels, strict=True):
            panel(ax)
    return [_chart(ax) for ax in axes]


def _chart(ax: Axes) -> dict[str, Any]:
    """Extract a panel's label, scale, limits and series, each band before the lines over it."""
    series = [_band(band) for band in ax.collections if isinstance(band, PolyCollection) and _is_named(band)]
    words = {line.get_color(): line.get_label() for line in ax.lines if not np.size(line.get_xdata())}
    for patch in ax.patches:
        if isinstance(patch, PathPatch):
            colour = to_hex(patch.get_edgecolor())
            points = np.asarray(patch.get_path().vertices)[::2]
            series.append(_series("dot", str(words[colour]), colour, points[:, 0], points[:, 1]))
    series += [_line(line, ax) for line in ax.lines if np.size(line.get_xdata()) and _is_named(line)]
    low, high = ax.get_ylim()
    return {
        "label": ax.get_ylabel(),
        "log": ax.get_yscale() == "log",
        "x": [float(v) for v in ax.get_xlim()],
        "y": [float(low), float(high)],
        "series": series,
    }


def _is_named(artist: Line2D | PolyCollection) -> bool:
    return not str(artist.get_label()).startswith("_")  # matplotlib's prefix of labels without a legend entry


def _line(line: Line2D, ax: Axes) -> dict[str, Any]:
    x, y = np.asarray(line.get_xdata(), dtype=float), np.asarray(line.get_ydata(), dtype=float)
    if line.get_transform() == ax.get_yaxis_transform():  # horizontal, from edge to edge
        x = np.array(ax.get_xlim())
    is_thick = line.get_linewidth() >= drawing.EDGE_WIDTH
    shape = "cross" if line.get_marker() == "x" else "dash" if line.is_dashed() else "line"
    shape = "edge" if is_thick else shape
    return _series(shape, str(line.get_label()), to_hex(line.get_color()), x, y)


def _band(band: PolyCollection) -> dict[str, Any]:
    """Extract a band's edges from its polygons: start, lower edge, end, upper edge backwards, start."""
    parts: list[tuple[FloatArray, FloatArray, FloatArray]] = []
    for path in band.get_paths():
        corners = np.asarray(path.vertices)
        n = (len(corners) - 3) // 2
        lower, upper = corners[1 : n + 1], corners[n + 2 : 2 * n + 2][::-1]
        if parts:
            parts.append((lower[:1, 0] - GAP_S, np.array([np.nan]), np.array([np.nan])))
        parts.append((lower[:, 0], lower[:, 1], upper[:, 1]))
    x, low, high = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    found = _series(
        "band", str(band.get_label()), to_hex(np.asarray(band.get_facecolor())[0].tolist()), x, low
    )
    return found | {"high": _numbers(high, 4)}


def _series(shape: str, label: str, colour: str, x: FloatArray, y: FloatArray) -> dict[str, Any]:
    x = np.where(np.isnan(y), x - GAP_S, x)
    return {
        "shape": shape,
        "label": label,
        "colour": CSS_NAME[colour],
        "x": np.round(x, 4).tolist(),
        "y": _numbers(y, 4),
    }


def _numbers(values: FloatArray, decimals: int) -> list[float | None]:
    """Round; NaN becomes null."""
    return [None if v != v else v for v in np.round(values, decimals).tolist()]
