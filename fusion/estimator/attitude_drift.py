"""Errors of the attitude's yaw while it alone propagates the heading, learned from the frames' innovations.

Without a gyroscope nothing tells whether the frames or the yaw increments are wrong when the two disagree. Errors
that scatter are the frames' noise (`fusion.estimator.noise_adaptation`). Innovations of one sign are not: averaged as
white noise they would leave a large error with a small sigma. When their mean is significant (see
`fusion.estimator.hypotheses.Innovations`), the prediction counts as wrong by it: the heading's variance grows by its
square at once, and from then on at the rate of a random walk that moves as far in the mean's time. So the heading
follows the frames, and its sigma contains the disagreement.
"""

from __future__ import annotations

from math import exp, sqrt
from typing import NamedTuple

from fusion.estimator.hypotheses import DRIFT_STD_RAD_S, LONG_S, SHORT_S, Innovations
from fusion.estimator.models import Gate

MEMORY_S = 15.0  # for which a drift of the yaw is remembered
UNDECIDED_S = 1.0  # duration of a disagreement that may be an error of the frames
MAX_DENSITY = DRIFT_STD_RAD_S**2 * UNDECIDED_S  # of a yaw that has nothing to do with the vehicle's
MAX_INTERVAL_S = 0.5  # largest weight of one frame in the means, as the time since the frame before


class AttitudeDrift(NamedTuple):
    """Drift of the attitude's yaw against the frames.

    Parameters
    ----------
    innovations, span_s
        Means of the accepted frames' innovations since the last significant mean, and the time since then.
    density
        Squared density of the yaw's random walk beyond the configured one, rad^2/s.
    """

    innovations: Innovations = Innovations()
    span_s: float = 0.0
    density: float = 0.0

    @property
    def undecided_std_rad(self) -> float:
        """Sigma of the heading if not the yaw but the frames have moved by what the yaw's walk is taken to be."""
        return sqrt(self.density * UNDECIDED_S)

    def interrupted(self) -> AttitudeDrift:
        """Drop the innovations from before a jump of the heading."""
        return AttitudeDrift(density=self.density)

    def with_innovation(self, gate: Gate, elapsed_s: float, rho: float) -> tuple[AttitudeDrift, float]:
        """Add an accepted frame; return the variance by which the prediction is wrong, 0 if it is not.

        Parameters
        ----------
        gate
            The frame's innovation.
        elapsed_s, rho
            Time since the accepted frame before, and the correlation with its error.
        """
        interval_s = min(elapsed_s, MAX_INTERVAL_S)
        seen = self.innovations.with_innovation(gate.residual / sqrt(gate.variance), interval_s, rho)
        span_s = self.span_s + interval_s
        density = self.density * exp(-elapsed_s / MEMORY_S)
        if not seen.systematic:
            return AttitudeDrift(seen, span_s, density), 0.0
        is_short = abs(seen.short_sigmas) >= abs(seen.long_sigmas)
        mean, time_s = (seen.short, SHORT_S) if is_short else (seen.long, LONG_S)
        mean /= 1.0 - exp(-span_s / time_s)  # it began at zero
        variance = mean * mean * gate.variance
        return AttitudeDrift(density=min(density + variance / time_s, MAX_DENSITY)), variance
