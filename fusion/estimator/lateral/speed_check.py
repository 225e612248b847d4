"""Check of the velocity stream against the motion that frames and accelerometer show.

The innovations of the speed across the corridor are compared with the sigmas of speed and prediction. Over seconds,
the mean of their squared ratios is about 1 or less. If it exceeds `CONTRADICTED_RATIO`, the velocities are wrong
(another frame, unit or sign, a bias), or the frames' offsets are. Velocities are not used until it falls below
`AGREEING_RATIO`: the offset follows from the frames alone, and the contradiction is reported.
"""

from __future__ import annotations

from math import exp
from typing import NamedTuple

from fusion.estimator.faults import Fault, Notice

AVERAGE_S = 2.0
CONTRADICTED_RATIO = 6.0
AGREEING_RATIO = 3.0
MAX_RATIO = 25.0  # of one innovation, so that a few outliers are not enough
MAX_INTERVAL_S = 0.2


class SpeedCheck(NamedTuple):
    """Mean squared ratio of innovation to sigma over the last seconds, and whether velocities are not used."""

    ratio: float = 1.0
    is_contradicted: bool = False

    def with_innovation(self, residual_m_s: float, variance: float, interval_s: float) -> SpeedCheck:
        """Add an innovation with its variance; ``interval_s`` is the time since the one before, NaN if unknown."""
        gain = 1.0 - exp(-min(interval_s, MAX_INTERVAL_S) / AVERAGE_S) if interval_s > 0.0 else 0.0
        ratio = self.ratio + gain * (min(residual_m_s * residual_m_s / variance, MAX_RATIO) - self.ratio)
        return SpeedCheck(ratio, ratio > (AGREEING_RATIO if self.is_contradicted else CONTRADICTED_RATIO))

    def notice(self) -> Notice | None:
        """Return the fault while velocities are not used."""
        if not self.is_contradicted:
            return None
        text = "velocity contradicts the lateral offset: not used; check its frame, unit and sign"
        return Notice(Fault.VELOCITY_CONTRADICTED, text)
