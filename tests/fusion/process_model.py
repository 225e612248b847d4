"""The process model's compiled parts one by one: what `CorridorEKF.advance` does in one call."""

from __future__ import annotations

import numpy as np

from fusion.estimator.kernels import BIAS, N_STATES, PSI, discretised
from fusion.estimator.models import ProcessNoise


def transition(
    dt_s: float, noise: ProcessNoise, heading_variance: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """F and Q of a step."""
    F, Q = np.empty((N_STATES, N_STATES)), np.empty((N_STATES, N_STATES))
    discretised(F, Q, dt_s, *noise, heading_variance)
    return F, Q


def propagate(x: np.ndarray, dt_s: float, turned_rad: float) -> np.ndarray:
    """The state after a step."""
    x_next = x.copy()
    x_next[PSI] += turned_rad - x[BIAS] * dt_s
    return x_next
