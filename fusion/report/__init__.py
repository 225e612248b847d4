"""The report of a fused flight, one HTML page: `write_report`.

May import `fusion.evaluation`, `fusion.result` and the packages below them. Begin reading at `fusion.report.page`;
the plots in `fusion.report.plots` can be used alone, for example in notebooks.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fusion.flight import Flight
    from fusion.result.result import FusionResult

__all__ = ["write_report"]


def write_report(
    result: FusionResult, flight: Flight, path: str | Path, provenance: Mapping[str, Any] | None = None
) -> None:
    """Write the report on a fused flight: one self-contained HTML file that opens without a network.

    Parameters
    ----------
    result, flight
        Result of `fusion.fuse_flight`, and its flight; some of its pictures are measured again.
    path
        The file, written atomically: after an error, an earlier one is unchanged.
    provenance
        Version, command, inputs and camera from `fusion.outputs.provenance.provenance`; None: not shown.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    from fusion.report.page import render_report, replace_text

    replace_text(path, render_report(result, flight, provenance))
