"""Matplotlib figures as inline SVG: small, in the page's font, with colours of its colour scheme."""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.text import Text

from fusion.report import drawing

Panel = Callable[[Axes], None]

# Each colour of the plots is a CSS variable of the page, with a second value for dark screens.
CSS_NAME = {
    drawing.INK: "ink",
    drawing.FAINT: "faint",
    drawing.GRID: "grid",
    drawing.FILTER: "filter",
    drawing.SMOOTHED: "smoothed",
    drawing.VISION: "vision",
    drawing.REJECTED: "rejected",
    drawing.IMU_YAW: "imu-yaw",
    drawing.RAW_YAW: "raw-yaw",
    drawing.HYPOTHESIS: "hypothesis",
    **{colour: f"status-{status}" for status, colour in drawing.STATUS_COLOUR.items()},
}


KEY_ORDER = ("line", "dash", "band", "dot", "cross")


@dataclass(frozen=True, slots=True)
class Key:
    """An entry of a plot's legend: its text, its colour's CSS name, and band, dot, cross, dash or line."""

    word: str
    colour: str
    shape: str


@dataclass(frozen=True, slots=True)
class Drawing:
    """A figure for a page of about 1000 pixels and for a phone, with its legend."""

    wide: str
    narrow: str
    keys: tuple[Key, ...]


class _Page(NamedTuple):
    """Width and height of a panel, inches, and font size."""

    suffix: str
    size_in: tuple[float, float]
    font_pt: float


_WIDE, _NARROW = _Page("w", (10.0, 2.75), 9.2), _Page("n", (5.0, 2.9), 10.5)


def draw(name: str, title: str, panels: Sequence[Panel]) -> Drawing:
    """Draw panels above each other on one time axis.

    Parameters
    ----------
    name
        Short and unique on the page: makes the identifiers inside the SVG unique.
    title
        Text for screen readers.
    """
    figure = Figure()
    with mpl.rc_context({"font.size": _WIDE.font_pt}):
        axes = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
        keys: dict[str, Key] = {}
        for ax, panel in zip(axes, panels, strict=True):
            panel(ax)
            ax.patch.set_visible(False)
            ax.label_outer()
            for handle, word in zip(*ax.get_legend_handles_labels(), strict=True):
                keys.setdefault(word, _key(handle, word))
        figure.patch.set_visible(False)
    ordered = sorted(keys.values(), key=lambda key: (KEY_ORDER.index(key.shape), key.word != "filter"))
    # Drawn once: the narrow figure differs only in size.
    wide, narrow = (_svg(figure, f"{name}-{page.suffix}", title, page) for page in (_WIDE, _NARROW))
    return Drawing(wide, narrow, tuple(ordered))


def _svg(figure: Figure, name: str, title: str, page: _Page) -> str:
    settings: Any = {"svg.fonttype": "none", "svg.hashsalt": name, "font.size": page.font_pt}
    _set_margins(figure, page)
    text = io.StringIO()
    with mpl.rc_context(settings):
        figure.savefig(text, format="svg", metadata={"Date": None, "Creator": None})
    return _inline(text.getvalue(), name, title)


def _set_margins(figure: Figure, page: _Page) -> None:
    """Set margins of fixed width, so that the time axes of all figures on the page are aligned."""
    count = len(figure.axes)
    width, height = page.size_in[0], page.size_in[1] * count
    em = page.font_pt / 72
    figure.set_size_inches(width, height)
    figure.subplots_adjust(
        left=5.4 * em / width,
        right=1 - 1.2 * em / width,
        bottom=3.6 * em / height,
        top=1 - 0.9 * em / height,
        hspace=1.6 * em / (height / count),
    )
    for ax in figure.axes:
        ax.yaxis.set_label_coords(-4.4 * em / (width - 6.6 * em), 0.5)
        ax.tick_params(which="both", labelsize=page.font_pt)
    for text in figure.findobj(Text):
        text.set_fontsize(page.font_pt)


def _key(handle: object, word: str) -> Key:
    if isinstance(handle, mpl.lines.Line2D):
        shape = {"x": "cross", ".": "dot"}.get(
            str(handle.get_marker()), "dash" if handle.is_dashed() else "line"
        )
        return Key(word, CSS_NAME[to_hex(handle.get_color())], shape)
    return Key(word, CSS_NAME[to_hex(handle.get_facecolor()[0])], "band")  # type: ignore[attr-defined]


def _inline(svg: str, name: str, title: str) -> str:
    """Convert a file to an element: no prolog, unique identifiers, two decimals, named colours."""
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<metadata>.*?</metadata>\s*", "", svg, flags=re.S)
    svg = re.sub(r'\s(?:width|height)="[\d.]+pt"', "", svg, count=2)
    svg = re.sub(r'\sxmlns(?::xlink)?="[^"]*"|\sversion="1.1"', "", svg)
    svg = svg.replace("xlink:href=", "href=")
    svg = re.sub(r'(\sid="|url\(#|href="#)', rf"\g<1>{name}-", svg)
    svg = re.sub(r'\sd="[^"]*"', lambda path: re.sub(r"(\.\d\d)\d+", r"\1", path[0]), svg)
    svg = re.sub(r"#[0-9a-f]{6}\b", lambda c: f"var(--{CSS_NAME[c[0]]})" if c[0] in CSS_NAME else c[0], svg)
    svg = re.sub(r"\n\s*", "\n", svg)
    return svg.replace("<svg", f'<svg role="img" aria-label="{title}"', 1)
