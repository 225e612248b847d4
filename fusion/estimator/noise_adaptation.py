"""Robust update: adapts the noise of a source to its innovations, and weights measurements by inlier probability.

A measurement is an inlier with its stated variance, scaled, or an outlier with a uniform density c. Two parameters
per source are learned: the share of outliers eps, and the scale. With the innovation z of variance S, Bayes' rule
gives the inlier probability, as in the probabilistic data association filter (Y. Bar-Shalom, E. Tse, "Tracking in a
cluttered environment with probabilistic data association", Automatica 11, 1975)::

    p = (1 - eps) N(z; 0, S) / ((1 - eps) N(z; 0, S) + eps c)

The gain of the update is multiplied by p, so a measurement near the limit of the gate counts less than one near its
centre. That matters after a drop-out, when the gate is wide and a single outlier in it would shift the heading.
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
OUTLIER_MEMORY = 1 / 60  # gain per measurement
SCALE_MEMORY = 1 / 60
SCALE_SLACK = 0.3  # about two standard deviations of the learned scale for correct sigmas
MAX_SCALE = 25.0
MAX_TERM = 9.0  # bound of one measurement's squared normalised innovation
MIN_INLIER_SHARE = 0.01
RECENT_FRAMES, LONG_RUN_FRAMES = 15.0, 1.0  # weights of the recent and of the long-run share of outliers


class SourceNoise(NamedTuple):
    """Learned noise of a source.

    Parameters
    ----------
    outlier_share
        Part of its measurements that are outliers.
    scale
        Ratio of the inliers' variance to the stated one.
    """

    outlier_share: float = START_OUTLIER_SHARE
    scale: float = 1.0

    @property
    def inflation(self) -> float:
        """Factor on the stated variance: at least one, and one if the scale is not significantly larger."""
        return min(max(1.0, self.scale - SCALE_SLACK), MAX_SCALE)


def inlier_probability(
    residual: float, innovation_variance: float, outlier_share: float, outlier_density: float
) -> float:
    """Return the probability p that a measurement is an inlier.

    Parameters
    ----------
    residual, innovation_variance
        Innovation and its variance.
    outlier_share
        Part of the source's measurements that are outliers.
    outlier_density
        Probability density of outliers.
    """
    likely = exp(-0.5 * residual * residual / innovation_variance) / sqrt(2 * pi * innovation_variance)
    good = (1.0 - outlier_share) * likely
    return good / (good + outlier_share * outlier_density)


def weakened_variance(variance: float, predicted: float, probability: float) -> float:
    """Return the variance for which a measurement's gain is multiplied by the probability that it is an inlier."""
    return (predicted + variance) / max(probability, 1e-6) - predicted


def correlation(t_ns: int, last_ns: int | None, time_s: float) -> float:
    """Return the correlation of the errors of two measurements, a first-order process of this correlation time."""
    if last_ns is None or time_s <= 0.0:
        return 0.0
    return exp(-max((t_ns - last_ns) * 1e-9, 1e-3) / time_s)


def equivalent_white_variance(variance: float, predicted: float, rho: float) -> float:
    """Return the variance of a white measurement error that is equivalent to one correlated with the one before.

    A filter that keeps the part a of its prediction at each measurement averages errors of correlation rho like
    independent ones of (1 + a rho) / (1 - a rho) times their variance. With a = R / (predicted + R), R solves a
    quadratic equation. If the prediction's variance ``predicted`` is large, the measurement keeps its own variance;
    in a long series R grows by (1 + rho) / (1 - rho).
    """
    half = 0.5 * (variance * (1.0 + rho) - predicted)
    return (half + sqrt(half * half + (1.0 - rho) * variance * predicted)) / (1.0 - rho)


def learn(
    noise: SourceNoise, residual: float, predicted: float, stated: float, probability: float
) -> SourceNoise:
    """Update a source's noise by a measurement's innovation.

    Parameters
    ----------
    noise
        Noise learned so far.
    residual, predicted, stated
        Innovation, the prediction's variance and the measurement's stated variance.
    probability
        Inlier probability; 0 if the gate rejected the measurement.
    """
    share = noise.outlier_share + OUTLIER_MEMORY * ((1.0 - probability) - noise.outlier_share)
    term = min(max((residual * residual - predicted) / stated, 0.0), MAX_TERM * noise.inflation)
    scale = noise.scale + SCALE_MEMORY * probability * (term - noise.scale)
    return SourceNoise(min(max(share, MIN_OUTLIER_SHARE), MAX_OUTLIER_SHARE), scale)


class ErrorModel(NamedTuple):
    """Errors of a measurement beyond its stated variance.

    Parameters
    ----------
    gate_sigma
        Innovations beyond this many standard deviations are rejected.
    rho
        Correlation of its error with that of the measurement before.
    outlier_density
        Probability density of outliers.
    extra_variance
        Further variance of the innovation, contained in neither state nor measurement.
    scale
        Ratio of the inliers' variance to the stated one; None for the learned one of `SourceNoise`.
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
    """Return the share of outliers in the last half second, at least the long-run share.

    Outliers that fall into the gate (of half width ``gate_rad``) by chance are not rejected, so the rejected share of
    a wide gate carries little information. The long-run share counts as `LONG_RUN_FRAMES` frames, the half second as
    `RECENT_FRAMES`.
    """
    seen = max(1.0 - 2.0 * gate_rad * density, 0.0)  # of all outliers, the share that is rejected
    recent = RECENT_FRAMES * rejected_share + LONG_RUN_FRAMES * noise.outlier_share
    now = recent / (RECENT_FRAMES * seen + LONG_RUN_FRAMES)
    return min(max(noise.outlier_share, now), 1.0 - MIN_INLIER_SHARE)


def update_robustly(
    ekf: CorridorEKF, m: ScalarMeasurement, noise: SourceNoise, error_model: ErrorModel
) -> tuple[Gate, SourceNoise]:
    """Update with a measurement that may be an outlier, with a wrong sigma and an error correlated with the last one.

    The gate uses the measurement's own variance. The update uses the larger variance that accounts for the
    correlation, and scales the gain by the inlier probability.

    Parameters
    ----------
    ekf
        Filter to update.
    m
        The measurement.
    noise
        Learned noise of its source.
    error_model
        Errors beyond the stated variance.
    """
    predicted = predicted_variance(ekf.P, m.H) + error_model.extra_variance
    stated = m.R
    believed = stated * (noise.inflation if error_model.scale is None else error_model.scale)
    gated = max(believed, stated)  # errors smaller than stated so far may still reach the stated sigma
    reach = error_model.gate_sigma * sqrt(predicted + gated)
    outliers = outlier_share_now(noise, error_model.rejected_share, reach, error_model.outlier_density)
    probability = inlier_probability(m.residual, predicted + gated, outliers, error_model.outlier_density)
    variance = weakened_variance(
        equivalent_white_variance(believed, predicted, error_model.rho), predicted, probability
    )
    gate = ekf.update(m._replace(R=gated + error_model.extra_variance), error_model.gate_sigma, variance)
    probability = probability if gate.accepted else 0.0
    return gate, learn(noise, m.residual, predicted, stated, probability)
