"""The extended Kalman filter of the heading: prediction and gated scalar updates, with compiled arithmetic.

It has the attributes of `filterpy.kalman.ExtendedKalmanFilter` with the same meaning: ``x``, ``P``, ``F``, ``Q``,
``x_prior``, ``P_prior``, ``x_post``, ``P_post``, ``K``, ``y``, ``S``, ``SI``, ``R``. Results agree with filterpy's
(tests require 1e-12). filterpy 2.0 itself is not used, because

- ``update`` with None keeps the innovation of the measurement before, so a gate would use the wrong one;
- a NaN measurement makes state and covariance NaN for good;
- each update copies the measurement and inverts a general matrix, for a scalar; each prediction makes needless
  copies;
- rounding makes the covariance asymmetric over millions of steps;
- importing it imports ``scipy.stats``, which takes half a second and a third of an estimator's memory.

`fusion.estimator.filterpy_ekf` converts the filter to filterpy's class for inspection. State and covariance arrays
are replaced, never modified, so a snapshot of the filter is two references.
"""

from __future__ import annotations

from functools import cache
from math import isfinite

import numpy as np

from fusion.estimator.kernels import N_STATES, FloatArray, predicted, predicted_variance, stepped, updated
from fusion.estimator.models import Gate, ProcessNoise, ScalarMeasurement
from fusion.estimator.smoother import Node

_SQUARE = (N_STATES, N_STATES)


class CorridorEKF:
    """Filter over the state of `fusion.estimator.models`, for scalar measurements.

    Every change of the state goes through its methods, which record it for the smoother in ``nodes``.

    Parameters
    ----------
    x, P
        State (3,) and covariance (3, 3).
    """

    x: FloatArray
    P: FloatArray
    nodes: list[Node]

    def __init__(self, x: FloatArray, P: FloatArray) -> None:
        self.load(np.array(x, dtype=float), np.array(P, dtype=float))
        self.x_prior = self.x_post = self.x
        self.P_prior = self.P_post = self.P
        self.F, self.Q = np.eye(N_STATES), np.eye(N_STATES)
        self.K, self.y = np.zeros((N_STATES, 1)), np.zeros(1)
        self.S, self.SI, self.R = np.eye(1), np.eye(1), np.eye(1)
        self._Q = np.empty(_SQUARE)  # of the process model; reused in each step
        _compile()

    def load(self, x: FloatArray, P: FloatArray) -> None:
        """Continue from a state (3,) and covariance (3, 3), with no recorded steps."""
        self.x, self.P, self.nodes = x, P, []

    def predict(self, x_next: FloatArray, F: FloatArray, Q: FloatArray) -> None:
        """Predict: the state becomes ``x_next`` (3,), the covariance F P F' + Q."""
        P = np.empty_like(self.P)
        predicted(self.P, F, Q, P)
        self.move_to(x_next, F, Q, P)

    def widen(self, index: int, variance: float) -> None:
        """Add to the variance of one state."""
        Q = np.zeros((N_STATES, N_STATES))
        Q[index, index] = variance
        self.predict(self.x, np.eye(N_STATES), Q)

    def advance(
        self, dt_s: float, turned_rad: float, noise: ProcessNoise, heading_variance: float = 0.0
    ) -> None:
        """Predict by the process model, discretised exactly.

        Parameters
        ----------
        dt_s, turned_rad
            Length of the step, and the turn of the level frame in it (bias not subtracted).
        noise
            Densities of the process noise.
        heading_variance
            Additional variance of the heading in this step, rad^2 (a gap in the gyroscope's samples).
        """
        x, F, P, Q = np.empty(N_STATES), np.empty(_SQUARE), np.empty(_SQUARE), self._Q
        stepped(self.x, self.P, x, F, Q, P, dt_s, turned_rad, *noise, heading_variance)
        self.move_to(x, F, Q, P)

    def update(
        self, measurement: ScalarMeasurement | None, gate_sigma: float = float("inf"), R: float | None = None
    ) -> Gate:
        """Update with one scalar measurement unless the gate rejects it.

        Parameters
        ----------
        measurement
            Residual, H and the variance used by the gate; None counts as rejected.
        gate_sigma
            Residuals beyond this many standard deviations are rejected; so are those that are not finite.
        R
            Variance used by the update, if it differs from the gate's (correlated errors).

        Returns
        -------
        Gate
            With NaN if there was no valid measurement. After a rejection ``y`` and ``S`` hold the rejected
            innovation; x and P are unchanged.
        """
        if measurement is None or not isfinite(measurement.residual) or not measurement.R > 0.0:
            self.y[0] = np.nan
            return Gate(False, float("nan"), float("nan"), float("nan"))
        residual, H, gate_variance = measurement
        expected = predicted_variance(self.P, H)
        ratio = residual * residual / (gate_sigma * gate_sigma * (expected + gate_variance))
        variance = gate_variance if R is None else R
        S = expected + variance
        self.y[0], self.S[0, 0], self.SI[0, 0], self.R[0, 0] = residual, S, 1.0 / S, variance
        if ratio > 1.0:
            return Gate(False, residual, ratio, expected + gate_variance)
        x, P, K = np.empty(N_STATES), np.empty((N_STATES, N_STATES)), np.empty((N_STATES, 1))
        updated(self.x, self.P, H, residual, variance, x, P, K)
        self.K = K
        self._measured(x, P)
        return Gate(True, residual, ratio, expected + gate_variance)

    def correct(self, x: FloatArray) -> None:
        """Replace the state (3,) as part of a measurement update; the covariance is kept."""
        self._measured(x, self.P)

    def move_to(self, x: FloatArray, F: FloatArray, Q: FloatArray, P: FloatArray) -> None:
        """Adopt a prediction: state (3,) and covariance (3, 3) after it, its transition and noise (3, 3)."""
        self.F, self.Q = F, Q
        self.x = self.x_prior = x
        self.P = self.P_prior = P
        self.nodes.append(Node(F, x, P, x, P))

    def _measured(self, x: FloatArray, P: FloatArray) -> None:
        if not self.nodes:
            self.nodes.append(Node(None, self.x, self.P, x, P))
        self.x = self.x_post = self.nodes[-1].x = x
        self.P = self.P_post = self.nodes[-1].P = P


@cache
def _compile() -> None:
    """Compile the filter's kernels, or load them from the cache, before the first sample."""
    x, P = np.zeros(N_STATES), np.eye(N_STATES)
    H = x.copy()
    H.setflags(write=False)  # as in the models: a read-only array is another type for the compiler
    predicted_variance(P, H)
    updated(x, P, H, 0.0, 1.0, x.copy(), P.copy(), np.zeros((N_STATES, 1)))
    predicted(P, P, P, P.copy())
    noise = ProcessNoise(1.0, 1.0, 1.0)
    stepped(x, P, x.copy(), P.copy(), P.copy(), P.copy(), 1.0, 0.0, *noise, 0.0)
