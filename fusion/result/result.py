"""A fused flight in memory: `FusionResult`."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from fusion.estimator.config import FusionConfig
from fusion.estimator.tables import HYPOTHESIS_DTYPE, Table
from fusion.result.display import data_frame, summary_html, summary_line
from fusion.result.summary import Summary
from vision.errors import InputError

if TYPE_CHECKING:
    import pandas as pd

TABLES = ("estimates", "smoothed", "frames")


@dataclass(frozen=True, slots=True)
class Timings:
    """Seconds of wall clock: pictures (reading and measuring), filter, smoother, total; compilation separately."""

    vision_s: float = 0.0
    filter_s: float = 0.0
    smoother_s: float = 0.0
    total_s: float = 0.0
    compile_s: float = 0.0


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class FusionResult:
    """A fused flight.

    Parameters
    ----------
    flight_name
        Of the flight.
    config
        Settings as used: noise that the log declares is filled in.
    estimates, smoothed
        The causal filter and the smoother, arrays of `fusion.estimator.tables.ESTIMATE_DTYPE`, a row per propagation
        step.
    frames
        A row of `fusion.estimator.tables.FRAME_DTYPE` per camera frame.
    overview
        Verdict, counts, rates, timings and errors against the truth, typed; `summary` has them as plain values.
    problems
        Problems of the log and of its samples, a sentence each.
    offset_hypotheses
        Hypotheses of the lateral offset after each frame, a row of
        `fusion.estimator.tables.HYPOTHESIS_DTYPE` per hypothesis.
    """

    flight_name: str
    config: FusionConfig
    estimates: Table
    smoothed: Table
    frames: Table
    overview: Summary = field(default_factory=Summary)
    problems: tuple[str, ...] = ()
    offset_hypotheses: Table = field(default_factory=lambda: np.zeros(0, HYPOTHESIS_DTYPE))

    @property
    def summary(self) -> dict[str, Any]:
        """Return the overview as plain values for JSON: the contents of ``summary.json``."""
        return self.overview.to_dict()

    @property
    def origin_ns(self) -> int:
        """First time of the tables: origin of all plots, and of `to_pandas` in seconds."""
        firsts = [int(table["timestamp_ns"][0]) for table in (self.estimates, self.frames) if len(table)]
        return min(firsts, default=0)

    def to_pandas(
        self,
        table: Literal["estimates", "smoothed", "frames"] = "estimates",
        *,
        seconds: bool = False,
        degrees: bool = False,
    ) -> pd.DataFrame:
        """Return one of the tables as a pandas frame.

        Parameters
        ----------
        table
            ``estimates`` (the causal filter), ``smoothed`` or ``frames``.
        seconds
            True makes the time since the flight's first row the index, ``time_s``.
        degrees
            True gives angles and rates in degrees; ``heading_rad`` becomes ``heading_deg``.

        Raises
        ------
        InputError
            If there is no such table, or pandas is not installed.
        """
        if table not in TABLES:
            raise InputError(f"there is no table {table!r}", remedy=f"use one of {', '.join(TABLES)}")
        return data_frame(getattr(self, table), self.origin_ns, seconds=seconds, degrees=degrees)

    def __repr__(self) -> str:
        return f"FusionResult({summary_line(self.overview)})"

    def _repr_html_(self) -> str:
        return summary_html(self.overview)
