"""How far a source can be believed: learned from its own innovations, one number for gross errors, one for sigma.

A measurement is either what its sigma says or gross, that is anywhere. Given its innovation, the odds between the two
follow from Bayes's rule, as in the probabilistic data association filter (Y. Bar-Shalom, E. Tse, "Tracking in a
cluttered environment with probabilistic data association", Automatica 11, 1975); a measurement at the rim of the
gate, where both are likely, counts for less than one in the middle. That matters after a drop-out, when the gate is
wide and one gross error in it would draw the heading away.
"""

from __future__ import annotations

from math import exp, pi, sqrt
from typing import NamedTuple

START_GROSS_SHARE = 0.05
MIN_GROSS_SHARE, MAX_GROSS_SHARE = 0.02, 0.7
GROSS_MEMORY = 1 / 60  # of a measurement
SCALE_MEMORY = 1 / 60
SCALE_SLACK = 0.3  # about two standard deviations of the learned scale where sigmas are right
MAX_SCALE = 25.0
MAX_TERM = 9.0


class Trust(NamedTuple):
    """What is known of a source.

    Parameters
    ----------
    gross_share
        Part of its measurements that are gross.
    scale
        Variance of the others over what they state.
    """

    gross_share: float = START_GROSS_SHARE
    scale: float = 1.0

    @property
    def inflation(self) -> float:
        """Factor on the stated variance: never below one, and one where the scale may be chance."""
        return min(max(1.0, self.scale - SCALE_SLACK), MAX_SCALE)


def genuine(residual: float, innovation_variance: float, gross_share: float, gross_density: float) -> float:
    """Probability that a measurement is not gross, from its residual and the density of gross ones around it."""
    likely = exp(-0.5 * residual * residual / innovation_variance) / sqrt(2 * pi * innovation_variance)
    good = (1.0 - gross_share) * likely
    return good / (good + gross_share * gross_density)


def weakened(variance: float, predicted: float, probability: float) -> float:
    """Variance that gives a measurement the gain it has, times the probability that it is genuine."""
    return (predicted + variance) / max(probability, 1e-6) - predicted


def correlation(t_ns: int, last_ns: int | None, time_s: float) -> float:
    """Correlation of the errors of two measurements, of a first-order process of this correlation time."""
    if last_ns is None or time_s <= 0.0:
        return 0.0
    return exp(-max((t_ns - last_ns) * 1e-9, 1e-3) / time_s)


def as_if_independent(variance: float, predicted: float, rho: float) -> float:
    """Variance with which a measurement may be taken for independent of the one before, though it is not.

    A filter that keeps the part a of what it knew at each measurement averages errors that correlate by rho as it
    would independent ones of (1 + a rho) / (1 - a rho) times their variance. The part kept follows from the variance
    used, a = R / (predicted + R), so R solves a quadratic equation. With much to learn (``predicted``, the
    prediction's variance, is large) a measurement counts by itself; one of many counts by little.
    """
    half = 0.5 * (variance * (1.0 + rho) - predicted)
    return (half + sqrt(half * half + (1.0 - rho) * variance * predicted)) / (1.0 - rho)


def learn(trust: Trust, residual: float, predicted: float, stated: float, probability: float) -> Trust:
    """Take in a measurement's outcome.

    Parameters
    ----------
    residual, predicted, stated
        Innovation, the prediction's variance and the variance that the measurement states.
    probability
        That it is genuine; 0 where the gate rejected it.
    """
    share = trust.gross_share + GROSS_MEMORY * ((1.0 - probability) - trust.gross_share)
    term = min(max((residual * residual - predicted) / stated, 0.0), MAX_TERM * trust.inflation)
    scale = trust.scale + SCALE_MEMORY * probability * (term - trust.scale)
    return Trust(min(max(share, MIN_GROSS_SHARE), MAX_GROSS_SHARE), scale)
