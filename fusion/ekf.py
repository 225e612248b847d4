"""The filter's arithmetic: filterpy's extended Kalman filter, with what is wrong or slow in it replaced.

Taken from filterpy 2.0: the attributes and their meaning, `predict`. Replaced, because in filterpy

- ``update`` with None keeps the innovation of the measurement before, so a gate that reads it judges the wrong one;
- a NaN measurement turns state and covariance into NaN for good;
- each update makes a deep copy of the measurement and calls a general matrix inverse, for a scalar;
- rounding lets the covariance lose its symmetry over millions of steps.

Arrays are replaced, never written into, so that a snapshot of the filter is two references.
"""

from __future__ import annotations

from math import isfinite
from typing import NamedTuple

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter

from fusion.models import N_STATES, FloatArray, ScalarMeasurement


class Gate(NamedTuple):
    """Outcome of an update: whether it was taken, the residual, and residual^2 / (gate^2 S)."""

    accepted: bool
    residual: float
    test_ratio: float


class CorridorEKF(ExtendedKalmanFilter):  # type: ignore[misc]
    """Filter over `fusion.models`' state, for scalar measurements.

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
        self._x_next = self.x

    def predict_x(self, u: float = 0.0) -> None:
        """Filterpy's hook for nonlinear models: the state was computed by `fusion.models.propagate`."""
        self.x = self._x_next

    def predict(self, x_next: FloatArray, F: FloatArray, Q: FloatArray) -> None:
        """Move to ``x_next`` (5,), with ``F`` its derivative and ``Q`` the noise gained; filterpy does the rest."""
        self._x_next, self.F, self.Q = x_next, F, Q
        super().predict()
        P = self.P + self.P.T
        P *= 0.5
        self.P = P

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
            self.y = np.array([np.nan])
            return Gate(False, float("nan"), float("nan"))
        residual, H, gate_variance = measurement
        PH = self.P @ H
        predicted = float(H @ PH)
        ratio = residual * residual / (gate_sigma * gate_sigma * (predicted + gate_variance))
        variance = gate_variance if R is None else R
        S = predicted + variance
        self.y, self.S, self.SI = np.array([residual]), np.array([[S]]), np.array([[1.0 / S]])
        self._log_likelihood = self._likelihood = self._mahalanobis = None
        if ratio > 1.0:
            return Gate(False, residual, ratio)
        K = PH / S
        A = self._I - np.multiply.outer(K, H)
        P = A @ self.P @ A.T + variance * np.multiply.outer(K, K)  # Joseph's form: positive whatever K
        self.x, self.P, self.K = self.x + K * residual, 0.5 * (P + P.T), K
        return Gate(True, residual, ratio)
