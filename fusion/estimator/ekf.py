"""The filter's arithmetic: filterpy's extended Kalman filter, with what is wrong or slow in it replaced.

Taken from filterpy 2.0: the attributes and their meaning, and what follows from them (likelihood, Mahalanobis
distance). Replaced is the arithmetic of ``predict`` and ``update`` (the same to rounding, see the tests), because in
filterpy

- ``update`` with None keeps the innovation of the measurement before, so a gate that reads it judges the wrong one;
- a NaN measurement turns state and covariance into NaN for good;
- each update makes a deep copy of the measurement and calls a general matrix inverse, for a scalar; each
  prediction copies what nobody writes into;
- rounding lets the covariance lose its symmetry over millions of steps.

State and covariance are replaced, never written into, so that a snapshot of the filter is two references.
"""

from __future__ import annotations

from functools import cache
from math import isfinite
from typing import NamedTuple

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter

from fusion.estimator.kernels import N_STATES, FloatArray, predicted, spread, updated
from fusion.estimator.models import ProcessNoise, ScalarMeasurement, step


class Gate(NamedTuple):
    """Outcome of an update: whether it was taken, the residual, and residual^2 / (gate^2 S)."""

    accepted: bool
    residual: float
    test_ratio: float


class CorridorEKF(ExtendedKalmanFilter):  # type: ignore[misc]
    """Filter over `fusion.estimator.models`' state, for scalar measurements.

    Parameters
    ----------
    x, P
        State (5,) and covariance (5, 5).
    """

    x: FloatArray
    P: FloatArray

    def __init__(self, x: FloatArray, P: FloatArray) -> None:
        super().__init__(dim_x=N_STATES, dim_z=1)
        self.x = np.array(x, dtype=float)
        self.P = np.array(P, dtype=float)
        self.y, self.S, self.SI = np.zeros(1), np.eye(1), np.eye(1)
        _compile()

    def predict(self, x_next: FloatArray, F: FloatArray, Q: FloatArray) -> None:
        """Move to ``x_next`` (5,), with ``F`` its derivative and ``Q`` the noise gained."""
        self.F, self.Q = F, Q
        self.x = self.x_prior = x_next
        P = np.empty_like(self.P)
        predicted(self.P, F, Q, P)
        self.P = self.P_prior = P

    def advance(
        self, dt_s: float, turned_rad: float, noise: ProcessNoise, u: float, w: float, heading_variance: float
    ) -> None:
        """Move by the process model: see `fusion.estimator.models.step`."""
        x, self.F, P = step(self.x, self.P, dt_s, turned_rad, noise, u, w, heading_variance)
        self.x = self.x_prior = x
        self.P = self.P_prior = P

    def update(
        self, measurement: ScalarMeasurement | None, gate_sigma: float = float("inf"), R: float | None = None
    ) -> Gate:
        """Take in one scalar measurement unless it fails the gate.

        Parameters
        ----------
        measurement
            Residual, H and the variance that the gate expects; None counts as rejected.
        gate_sigma
            Residuals beyond this many standard deviations are rejected; so are those that are not finite.
        R
            Variance to update with where it differs from the gate's (correlated errors).

        Returns
        -------
        Gate
            With NaN where there was nothing to judge. After a rejection ``y`` and ``S`` hold the rejected
            innovation, x and P are untouched.
        """
        if measurement is None or not isfinite(measurement.residual) or not measurement.R > 0.0:
            self.y[0] = np.nan
            return Gate(False, float("nan"), float("nan"))
        residual, H, gate_variance = measurement
        expected = spread(self.P, H)
        ratio = residual * residual / (gate_sigma * gate_sigma * (expected + gate_variance))
        variance = gate_variance if R is None else R
        S = expected + variance
        self.y[0], self.S[0, 0], self.SI[0, 0] = residual, S, 1.0 / S
        self._log_likelihood = self._likelihood = self._mahalanobis = None
        if ratio > 1.0:
            return Gate(False, residual, ratio)
        x, P, K = np.empty(N_STATES), np.empty((N_STATES, N_STATES)), np.empty(N_STATES)
        updated(self.x, self.P, H, residual, variance, x, P, K)
        self.x, self.P, self.K = x, P, K
        return Gate(True, residual, ratio)


@cache
def _compile() -> None:
    """Compile, or load what was compiled, when a filter is made: not at its first sample, in flight."""
    x, P = np.zeros(N_STATES), np.eye(N_STATES)
    constant = x.copy()
    constant.setflags(write=False)  # to the compiler another type
    for H in (x, constant):
        spread(P, H)
        updated(x, P, H, 0.0, 1.0, x.copy(), P.copy(), x.copy())
    predicted(P, P, P, P.copy())
    step(x, P, 1.0, 0.0, ProcessNoise(1.0, 1.0, 1.0, 1.0, 1.0))
