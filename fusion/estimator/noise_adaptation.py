"""Adapts the noise of a source to its own innovations, and weighs outliers by their probability.

Two numbers per source: its share of outliers, and the variance of its inliers over what they state. A measurement is
either what its sigma says or an outlier, that is anywhere. Given its innovation, the odds between the two follow from
Bayes's rule, as in the probabilistic data association filter (Y. Bar-Shalom, E. Tse, "Tracking in a cluttered
environment with probabilistic data association", Automatica 11, 1975); a measurement at the rim of the gate, where
both are likely, counts for less than one in the middle. That matters after a drop-out, when the gate is wide and one
outlier in it would draw the heading away.
"""

from __future__ import annotations

from math import exp, pi, sqrt
from typing import TYPE_CHECKING, NamedTuple

from fusion.estimator.kernels import predicted_variance
from fusion.estimator.models import Gate, ScalarMeasurement

if TYPE_CHECKING:
    from fusion.estimator.ekf import CorridorEKF

START_OUTLIER_SHARE = 0.05
MIN_OUTLIER_SHARE, MAX_OUTLIER_SHARE = 0.02, 0.7
OUTLIER_MEMORY = 1 / 60  # of a measurement
SCALE_MEMORY = 1 / 60
SCALE_SLACK = 0.3  # about two standard deviations of the learned scale where sigmas are right
MAX_SCALE = 25.0
MAX_TERM = 9.0
MIN_INLIER_SHARE = 0.01
RECENT_FRAMES, KNOWN_FRAMES = 15.0, 1.0


class SourceNoise(NamedTuple):
    """What is known of a source's noise.

    Parameters
    ----------
    outlier_share
        Part of its measurements that are outliers.
    scale
        Variance of the others over what they state.
    """

    outlier_share: float = START_OUTLIER_SHARE
    scale: float = 1.0

    @property
    def inflation(self) -> float:
        """Factor on the stated variance: never below one, and one where the scale may be chance."""
        return min(max(1.0, self.scale - SCALE_SLACK), MAX_SCALE)


def inlier_probability(
    residual: float, innovation_variance: float, outlier_share: float, outlier_density: float
) -> float:
    """Probability that a measurement is no outlier.

    Parameters
    ----------
    residual, innovation_variance
        Innovation and its variance.
    outlier_share
        Part of the source's measurements that are outliers.
    outlier_density
        Probability density of outliers around the measurement.
    """
    likely = exp(-0.5 * residual * residual / innovation_variance) / sqrt(2 * pi * innovation_variance)
    good = (1.0 - outlier_share) * likely
    return good / (good + outlier_share * outlier_density)


def weakened_variance(variance: float, predicted: float, probability: float) -> float:
    """Variance that gives a measurement the gain it has, times the probability that it is an inlier."""
    return (predicted + variance) / max(probability, 1e-6) - predicted


def correlation(t_ns: int, last_ns: int | None, time_s: float) -> float:
    """Correlation of the errors of two measurements, of a first-order process of this correlation time."""
    if last_ns is None or time_s <= 0.0:
        return 0.0
    return exp(-max((t_ns - last_ns) * 1e-9, 1e-3) / time_s)


def independent_equivalent_variance(variance: float, predicted: float, rho: float) -> float:
    """Variance with which a measurement may be taken for independent of the one before, though it is not.

    A filter that keeps the part a of what it knew at each measurement averages errors that correlate by rho as it
    would independent ones of (1 + a rho) / (1 - a rho) times their variance. The part kept follows from the variance
    used, a = R / (predicted + R), so R solves a quadratic equation. With much to learn (``predicted``, the
    prediction's variance, is large) a measurement counts by itself; one of many counts by little.
    """
    half = 0.5 * (variance * (1.0 + rho) - predicted)
    return (half + sqrt(half * half + (1.0 - rho) * variance * predicted)) / (1.0 - rho)


def learn(
    noise: SourceNoise, residual: float, predicted: float, stated: float, probability: float
) -> SourceNoise:
    """Take in a measurement's outcome.

    Parameters
    ----------
    noise
        What was known before.
    residual, predicted, stated
        Innovation, the prediction's variance and the variance that the measurement states.
    probability
        That it is an inlier; 0 where the gate rejected it.
    """
    share = noise.outlier_share + OUTLIER_MEMORY * ((1.0 - probability) - noise.outlier_share)
    term = min(max((residual * residual - predicted) / stated, 0.0), MAX_TERM * noise.inflation)
    scale = noise.scale + SCALE_MEMORY * probability * (term - noise.scale)
    return SourceNoise(min(max(share, MIN_OUTLIER_SHARE), MAX_OUTLIER_SHARE), scale)


class ErrorModel(NamedTuple):
    """How far a measurement may be off from what it states.

    Parameters
    ----------
    gate_sigma
        Innovations beyond this many standard deviations are rejected.
    rho
        Correlation of its error with that of the measurement before.
    outlier_density
        Probability density of outliers.
    extra_variance
        What the innovation has besides, of which neither state nor measurement knows.
    scale
        Variance of inliers over what they state; None: as `SourceNoise` has learned.
    rejected_share
        Share of the last half second's measurements that were not used.
    """

    gate_sigma: float
    rho: float
    outlier_density: float
    extra_variance: float = 0.0
    scale: float | None = None
    rejected_share: float = 0.0


def outlier_share_now(noise: SourceNoise, rejected_share: float, gate_rad: float, density: float) -> float:
    """Share of outliers among the measurements of the last half second, not less than what is known in the long run.

    Outliers that fall into the gate (a half width ``gate_rad``) by chance are not refused: with a wide gate, what is
    refused tells little. The long-run share counts as `KNOWN_FRAMES` frames, the half second as `RECENT_FRAMES`.
    """
    seen = max(1.0 - 2.0 * gate_rad * density, 0.0)  # of all outliers, the share that is rejected
    recent = RECENT_FRAMES * rejected_share + KNOWN_FRAMES * noise.outlier_share
    now = recent / (RECENT_FRAMES * seen + KNOWN_FRAMES)
    return min(max(noise.outlier_share, now), 1.0 - MIN_INLIER_SHARE)


def update_robustly(
    ekf: CorridorEKF, m: ScalarMeasurement, noise: SourceNoise, error_model: ErrorModel
) -> tuple[Gate, SourceNoise]:
    """Update with a measurement that may be an outlier, whose sigma may be wrong and whose error resembles the last.

    The gate judges it by its own variance; the update takes the larger one that, as if independent, stands for the
    correlation with the one before, and weakens it by the probability that it is an inlier.

    Parameters
    ----------
    ekf
        Filter to update.
    m
        The measurement.
    noise
        What is known of its source.
    error_model
        How far it may be off.
    """
    predicted = predicted_variance(ekf.P, m.H) + error_model.extra_variance
    stated = m.R
    believed = stated * (noise.inflation if error_model.scale is None else error_model.scale)
    gated = max(believed, stated)  # what has been better than it says so far may yet be as bad as it says
    reach = error_model.gate_sigma * sqrt(predicted + gated)
    outliers = outlier_share_now(noise, error_model.rejected_share, reach, error_model.outlier_density)
    probability = inlier_probability(m.residual, predicted + gated, outliers, error_model.outlier_density)
    variance = weakened_variance(
        independent_equivalent_variance(believed, predicted, error_model.rho), predicted, probability
    )
    gate = ekf.update(m._replace(R=gated + error_model.extra_variance), error_model.gate_sigma, variance)
    probability = probability if gate.accepted else 0.0
    return gate, learn(noise, m.residual, predicted, stated, probability)
