"""The process model's compiled parts one by one: what `CorridorEKF.advance` does in one call."""

from __future__ import annotations

import numpy as np

from fusion.estimator.kernels import N_STATES, discretised, propagated
from fusion.estimator.models import ProcessNoise


def transition(
    dt_s: float, noise: ProcessNoise, y_per_psi: float = 0.0, heading_variance: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """F and Q of a step."""
    F, Q = np.empty((N_STATES, N_STATES)), np.empty((N_STATES, N_STATES))
    discretised(F, Q, dt_s, *noise, y_per_psi, heading_variance)
    return F, Q


def propagate(
    x: np.ndarray,
    dt_s: float,
    turned_rad: float,
    noise: ProcessNoise,
    forward: float = 0.0,
    sideways: float = 0.0,
) -> np.ndarray:
    """The state after a step."""
    x_next = np.empty(N_STATES)
    propagated(x, x_next, dt_s, turned_rad, noise.v_time_s, forward, sideways)
    return x_next
