"""A fused flight in a notebook: its tables as pandas frames, and its display as a cell's output."""

from __future__ import annotations

from html import escape
from math import isfinite, pi
from typing import TYPE_CHECKING

from fusion.estimator.tables import Table
from fusion.printable import printable
from fusion.result.summary import ErrorStatistics, Summary, TableErrors
from vision.errors import InputError

if TYPE_CHECKING:
    import pandas as pd

DEGREES_PER_RADIAN = 180.0 / pi


def data_frame(table: Table, origin_ns: int, *, seconds: bool, degrees: bool) -> pd.DataFrame:
    """Make a pandas frame of a table.

    Parameters
    ----------
    table
        Structured array (n,), see `fusion.estimator.tables`.
    origin_ns
        Time of zero seconds.
    seconds
        Whether the index is the time in seconds since ``origin_ns``, named ``time_s``.
    degrees
        Whether angles and rates are in degrees; their columns end in ``_deg`` and ``_deg_s`` then.

    Raises
    ------
    InputError
        If pandas is not installed.
    """
    try:
        import pandas as pd
    except ImportError as error:
        raise InputError(
            "pandas is not installed", remedy="pip install 'corridor-fusion[notebook]', or pandas itself"
        ) from error
    frame = pd.DataFrame(table)
    if degrees:
        angles = [name for name in frame.columns if name.endswith(("_rad", "_rad_s"))]
        frame[angles] *= DEGREES_PER_RADIAN
        frame = frame.rename(columns={name: name.replace("_rad", "_deg") for name in angles})
    if seconds:
        frame.index = pd.Index((table["timestamp_ns"] - origin_ns) / 1e9, name="time_s")
    return frame


def summary_line(summary: Summary) -> str:
    """Summarise the flight and its verdict in one line."""
    counts = summary.counts
    return printable(
        f"{summary.flight}: {summary.verdict}, {summary.duration_s:.1f} s, {counts.accepted} of {counts.frames} "
        f"frames used, {counts.estimates} estimates"
    )


def summary_html(summary: Summary) -> str:
    """Return the same as HTML, with the errors against ground truth and the checks that did not pass."""
    parts = [f"<p><b>{escape(summary_line(summary))}</b></p>"]
    if summary.errors is not None:
        found = {
            "filter": summary.errors.filter,
            "smoother": summary.errors.smoothed,
            "single frames": summary.errors.vision,
        }
        rows = [_error_row(name, errors) for name, errors in found.items()]
        parts.append(_table(("RMS error", "heading, degrees", "lateral offset"), rows))
    amiss = [check for check in summary.checks if check.level in ("warn", "fail")]
    if amiss:
        rows = [(check.level, check.name, check.value, check.action or check.meaning) for check in amiss]
        parts.append(_table(("check", "", "found", "what to do"), rows))
    return "".join(parts)


def _error_row(name: str, errors: TableErrors) -> tuple[str, ...]:
    return name, _scaled(errors.heading, DEGREES_PER_RADIAN, ""), _offset(errors)


def _offset(errors: TableErrors) -> str:
    if errors.lateral_offset_m is not None and errors.lateral_offset_m.count:
        return _scaled(errors.lateral_offset_m, 100.0, " cm")
    return _scaled(errors.lateral_offset_norm, 100.0, " % of half the width")


def _scaled(errors: ErrorStatistics | None, factor: float, unit: str) -> str:
    if errors is None or errors.rmse is None or not isfinite(errors.rmse):
        return "-"
    return f"{errors.rmse * factor:.2f}{unit}"


def _table(head: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    def row(cells: tuple[str, ...], tag: str) -> str:
        aligned = "".join(f'<{tag} style="text-align:left">{escape(str(cell))}</{tag}>' for cell in cells)
        return f"<tr>{aligned}</tr>"

    return f"<table>{row(head, 'th')}{''.join(row(cells, 'td') for cells in rows)}</table>"
