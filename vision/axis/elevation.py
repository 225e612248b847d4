"""Prior of the corridor axis's elevation e in the level frame, and the grid of elevations in the vote.

Most corridors are level, so e is the level frame's error with standard deviation s. A share q of them slopes, with
the standard deviation t of the slope. The prior is the mixture

    p(e) = (1 - q) N(e; 0, s^2) + q N(e; 0, s^2 + t^2).
"""

from __future__ import annotations

from math import exp, hypot, log, radians

import numpy as np

from vision.compiled import compiled
from vision.types import FloatArray

SLOPE_STD_RAD = radians(2.5)  # t: of ramps and floors that are not level
SLOPE_SHARE = 0.02  # q
FINE_STEP_RAD, COARSE_STEP_RAD = radians(0.5), radians(1.0)  # of the grid
STD_OF_SPACING = 0.4  # standard deviation that a grid value represents, over the grid's spacing
FINEST_STD_RAD = STD_OF_SPACING * FINE_STEP_RAD
FINE_REACH_RAD, MAX_REACH_RAD = radians(1.0), radians(10.0)


@compiled
def elevations_to_try(std: float) -> tuple[FloatArray, FloatArray]:
    """Return a grid of elevations (m,) about the predicted one, finer in its middle, and their standard deviations.

    Parameters
    ----------
    std
        Standard deviation of the level frame's elevation error, radians.

    Returns
    -------
    elevation, elevation_std
        Elevation relative to the predicted one, and standard deviation of the elevations each value represents.
    """
    reach = min(2.0 * hypot(std, SLOPE_STD_RAD), MAX_REACH_RAD)
    n_fine = int(np.ceil(FINE_REACH_RAD / FINE_STEP_RAD))
    n = n_fine + max(int(np.ceil((reach - FINE_REACH_RAD) / COARSE_STEP_RAD)), 0)
    elevation, elevation_std = np.empty(2 * n - 1), np.empty(2 * n - 1)
    for k in range(n):
        up = k * FINE_STEP_RAD if k < n_fine else FINE_REACH_RAD + (k - n_fine) * COARSE_STEP_RAD
        elevation[n - 1 + k], elevation[n - 1 - k] = up, -up
    last = 2 * n - 2
    for k in range(2 * n - 1):
        # half the distance between its neighbours, or the distance to the only one
        low, high = max(k - 1, 0), min(k + 1, last)
        spacing = (elevation[high] - elevation[low]) / max(high - low, 1)
        elevation_std[k] = min(std, STD_OF_SPACING * spacing) if last > 0 else std
    return elevation, elevation_std


@compiled
def elevation_log_prior(elevation: float, std: float) -> float:
    """Return the logarithm of the elevation's prior density over the peak density of a Gaussian with ``std``."""
    z = elevation / std
    wide = hypot(std, SLOPE_STD_RAD)
    y = elevation / wide
    return log((1.0 - SLOPE_SHARE) * exp(-0.5 * z * z) + SLOPE_SHARE * std / wide * exp(-0.5 * y * y))


@compiled
def elevation_information(elevation: float, std: float) -> float:
    """Return the information (rad^-2) of the zero-mean Gaussian with the gradient of `elevation_log_prior`.

    It is the mean of both Gaussians' information, weighted by their responsibilities; iterating with it is
    expectation-maximisation and converges to the maximum of the posterior.
    """
    z = elevation / std
    wide = hypot(std, SLOPE_STD_RAD)
    y = elevation / wide
    level = (1.0 - SLOPE_SHARE) * exp(-0.5 * z * z) / std
    sloping = SLOPE_SHARE * exp(-0.5 * y * y) / wide
    return (level / (std * std) + sloping / (wide * wide)) / (level + sloping)
