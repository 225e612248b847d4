"""Prior knowledge of the elevation of the corridor's axis, and the elevations to try in the vote."""

from __future__ import annotations

from math import exp, hypot, log, radians

import numpy as np

from vision.compiled import compiled
from vision.types import FloatArray

SLOPE_STD_RAD = radians(2.5)  # of the elevation of ramps and of floors that are not level
SLOPE_SHARE = 0.02  # of corridors
FINE_STEP_RAD, COARSE_STEP_RAD = radians(0.5), radians(1.0)  # between elevations to try
STD_OF_SPACING = 0.4
FINEST_STD_RAD = STD_OF_SPACING * FINE_STEP_RAD
FINE_REACH_RAD, MAX_REACH_RAD = radians(1.0), radians(10.0)


@compiled
def elevations_to_try(std: float) -> tuple[FloatArray, FloatArray]:
    """Return elevations (m,) about the expected one, closer together where corridors are level, and their stds.

    Parameters
    ----------
    std
        Standard deviation of the elevation.

    Returns
    -------
    elevation, elevation_std
        Relative to the expected one, and the standard deviation of those that each stands for.
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
        # half the distance between its neighbours, or to its only one
        low, high = max(k - 1, 0), min(k + 1, last)
        spacing = (elevation[high] - elevation[low]) / max(high - low, 1)
        elevation_std[k] = min(std, STD_OF_SPACING * spacing) if last > 0 else std
    return elevation, elevation_std


@compiled
def elevation_log_prior(elevation: float, std: float) -> float:
    """Return the log of the elevation's prior density over that of a Gaussian's peak.

    Most corridors are level: then the axis's elevation is the error of the level frame, Gaussian with ``std``. A few
    slope: that adds their own elevation, and the sum is Gaussian, too. The prior is the mixture of both.
    """
    z = elevation / std
    wide = hypot(std, SLOPE_STD_RAD)
    y = elevation / wide
    return log((1.0 - SLOPE_SHARE) * exp(-0.5 * z * z) + SLOPE_SHARE * std / wide * exp(-0.5 * y * y))


@compiled
def elevation_information(elevation: float, std: float) -> float:
    """Return the information (rad^-2) of the Gaussian whose gradient there is that of `elevation_log_prior`.

    It is the mean of both Gaussians' information by their share of the density: iterated, it finds the maximum of
    the posterior (expectation-maximisation).
    """
    z = elevation / std
    wide = hypot(std, SLOPE_STD_RAD)
    y = elevation / wide
    level = (1.0 - SLOPE_SHARE) * exp(-0.5 * z * z) / std
    sloping = SLOPE_SHARE * exp(-0.5 * y * y) / wide
    return (level / (std * std) + sloping / (wide * wide)) / (level + sloping)
