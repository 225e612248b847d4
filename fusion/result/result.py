"""A fused flight in memory: `FusionResult`."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from fusion.estimator.config import FusionConfig
from fusion.estimator.tables import HYPOTHESIS_DTYPE, Table
from fusion.result.summary import Summary


@dataclass(frozen=True, slots=True)
class Timings:
    """Seconds of wall clock: pictures (reading and measuring), filter, smoother, all; and, apart, compilation."""

    vision_s: float = 0.0
    filter_s: float = 0.0
    smoother_s: float = 0.0
    total_s: float = 0.0
    compile_s: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
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
        What was wrong with the log and with its samples, a sentence each.
    offset_hypotheses
        What the filter held possible of the lateral offset after each frame, a row of
        `fusion.estimator.tables.HYPOTHESIS_DTYPE` per hypothesis.
    """

    flight_name: str
    config: FusionConfig
    estimates: Table
    smoothed: Table
    frames: Table
    overview: Summary = field(default_factory=Summary)
    problems: tuple[str, ...] = ()
    offset_hypotheses: Table = field(default_factory=lambda: np.zeros(0, HYPOTHESIS_DTYPE), repr=False)

    @property
    def summary(self) -> dict[str, Any]:
        """Return the overview as plain values, ready for JSON: what ``summary.json`` holds."""
        return self.overview.to_dict()
