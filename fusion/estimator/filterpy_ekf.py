"""The filter as an ``ExtendedKalmanFilter`` of filterpy, for inspection.

Importing this module imports all of filterpy, and with it ``scipy.stats`` and ``scipy.ndimage``.
"""

from __future__ import annotations

from filterpy.kalman import ExtendedKalmanFilter

from fusion.estimator.ekf import CorridorEKF
from fusion.estimator.kernels import N_STATES
from fusion.estimator.models import Gate, ScalarMeasurement


class FilterpyEKF(CorridorEKF, ExtendedKalmanFilter):  # type: ignore[misc]
    """`CorridorEKF` with ``likelihood``, ``log_likelihood``, ``mahalanobis`` and all else that filterpy has.

    Parameters
    ----------
    ekf
        Filter to continue from.
    """

    def __init__(self, ekf: CorridorEKF) -> None:
        ExtendedKalmanFilter.__init__(self, dim_x=N_STATES, dim_z=1)
        self.__dict__.update(ekf.__dict__)

    def update(
        self, measurement: ScalarMeasurement | None, gate_sigma: float = float("inf"), R: float | None = None
    ) -> Gate:
        """Update with one scalar measurement unless the gate rejects it; see `CorridorEKF.update`."""
        # filterpy computes these on access.
        self._log_likelihood = self._likelihood = self._mahalanobis = None
        return super().update(measurement, gate_sigma, R)
