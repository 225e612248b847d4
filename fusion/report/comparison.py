"""Figure of a comparison of fused flights with ground truth: errors over time, and their distribution."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from matplotlib.figure import Figure

from fusion.evaluation.comparison import ErrorsOverTime, Output, errors_over_time
from fusion.evaluation.truth import Truth
from fusion.files import replacing
from fusion.flight import FloatArray
from fusion.report.drawing import FAINT, FILTER, IMU_YAW, RAW_YAW, REJECTED, SMOOTHED, VISION, plain_axes
from vision.errors import InputError

FORMATS = (".png", ".svg", ".pdf")
COLOURS = (
    FILTER,
    REJECTED,
    SMOOTHED,
    RAW_YAW,
    IMU_YAW,
    VISION,
)  # distinguishable for colour-blind readers, too
STYLES = ("-", (0, (5, 2)), (0, (1, 1.5)))
DPI = 160


def comparison_figure(outputs: Sequence[Output], truth: Truth, *, align: bool = False) -> Figure:
    """Draw the errors of the causal estimates of several outputs.

    Parameters
    ----------
    outputs, truth, align
        As for `fusion.evaluation.comparison.compare`.

    Returns
    -------
    Figure
        On the left, errors of heading and offset over time; on the right, their cumulative distribution, with a
        dotted line at the 90th percentile.
    """
    metres = any(np.isfinite(output.causal["lateral_offset_m"]).any() for output in outputs)
    unit: Literal["m", "norm"] = "m" if metres and truth.offset in ("m", "both") else "norm"
    found = {output.name: errors_over_time(output.causal, truth, unit, align=align) for output in outputs}
    offsets = any(np.isfinite(errors.lateral_offset).any() for errors in found.values())
    rows = 2 if offsets else 1
    figure = Figure(figsize=(10.0, 2.9 * rows + 0.3), layout="constrained")
    axes = figure.subplots(rows, 2, squeeze=False, width_ratios=(2.2, 1.0))
    origin_ns = min(int(errors.t_ns[0]) for errors in found.values())
    for k, (name, errors) in enumerate(found.items()):
        look: dict[str, Any] = {
            "color": COLOURS[k % len(COLOURS)],
            "ls": STYLES[k // len(COLOURS) % len(STYLES)],
            "lw": 1.2,
        }
        for (over_time, shares), values in zip(axes, _values(errors), strict=False):
            over_time.plot((errors.t_ns - origin_ns) / 1e9, values, label=name, **look)
            known = np.sort(np.abs(values[np.isfinite(values)]))
            shares.plot(known, 100.0 * (np.arange(len(known)) + 1.0) / max(len(known), 1), **look)
    offset_unit = "cm" if unit == "m" else "% of half width"
    for (over_time, shares), what in zip(
        axes, ("Heading error, degrees", f"Offset error, {offset_unit}"), strict=False
    ):
        plain_axes(over_time, "Time, s", what)
        over_time.axhline(0.0, color=FAINT, lw=0.6)
        plain_axes(shares, f"|{what[0].lower()}{what[1:].replace(', ', '|, ', 1)}", "Rows up to it, %")
        shares.axhline(90.0, color=FAINT, lw=0.8, ls=":")
        shares.set_xlim(left=0.0)
        shares.set_ylim(0.0, 101.0)
    handles, names = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside upper left", ncols=3, frameon=False, fontsize=9)
    return figure


def write_comparison_figure(
    outputs: Sequence[Output], truth: Truth, path: Path, *, align: bool = False
) -> None:
    """Write `comparison_figure` to a file, atomically; its extension selects the format.

    Raises
    ------
    InputError
        If the extension is none of `FORMATS`, or the file cannot be written.
    """
    if path.suffix.lower() not in FORMATS:
        remedy = f"end it in {', '.join(FORMATS[:-1])} or {FORMATS[-1]}"
        raise InputError("is not a figure format", file=path, remedy=remedy)
    figure = comparison_figure(outputs, truth, align=align)
    with replacing(path) as draft:
        figure.savefig(draft, format=path.suffix.lower()[1:], dpi=DPI)


def _values(errors: ErrorsOverTime) -> tuple[FloatArray, FloatArray]:
    return np.degrees(errors.heading_rad), 100.0 * errors.lateral_offset
