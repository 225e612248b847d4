"""Acquisition of the corridor's axis by votes of frames that agree, and recovery of a diverged heading.

`acquire`: the axis is acquired once `FusionConfig.start_frames` votes agree; their median gives the heading.
`recover`: the covariance is widened along the heading's error, and the filter is updated with the votes' median.
"""

from __future__ import annotations

from math import sqrt
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from fusion.estimator.config import FusionConfig
from fusion.estimator.corridor_axis import CorridorAxis
from fusion.estimator.models import BIAS, N_STATES, PSI, YAW_OFFSET, heading_model
from fusion.estimator.propagation import UNKNOWN_HEADING_STD_RAD, Mode
from fusion.estimator.votes import AGREEING_SHARE, agreement
from vision.rotations import wrap_axis

if TYPE_CHECKING:
    from fusion.estimator.ekf import CorridorEKF


class Recovery(NamedTuple):
    """Heading to reset a diverged filter to."""

    heading_rad: float
    std_rad: float


def acquire(
    axis: CorridorAxis,
    ekf: CorridorEKF,
    t_ns: int,
    theta_rad: float,
    corrects_heading: bool,
    config: FusionConfig,
    mode: Mode,
) -> CorridorAxis:
    """Acquire the heading, at first or after loss, as the median of frames that agree.

    Parameters
    ----------
    axis
        Part of the state, with the newest frame's vote; it is returned as acquired if enough votes agree.
    ekf
        Filter to correct.
    t_ns, theta_rad
        Time now, and the dead-reckoned heading.
    corrects_heading
        Whether the IMU's yaw offset is correlated with the heading.
    config
        Settings.
    mode
        Source that propagates the heading.
    """
    # Frames of a slow camera are seconds apart; meanwhile a gyroscope of unknown bias drifts.
    drift_rad_s = sqrt(float(ekf.P[BIAS, BIAS])) if mode is Mode.GYRO else 0.0
    found = agreement(axis.votes, config.recovery_spread_rad, wrap_axis, drift_rad_s)
    if found is None or found.n_votes < config.start_frames or found.share < AGREEING_SHARE:
        return axis
    heading = wrap_axis(theta_rad - found.value)
    before = float(ekf.x[PSI])
    if axis.ever_acquired:
        _widen_heading(ekf, wrap_axis(heading - before), corrects_heading)
    elif float(ekf.P[PSI, PSI]) < UNKNOWN_HEADING_STD_RAD**2:
        ekf.widen(PSI, UNKNOWN_HEADING_STD_RAD**2)
    # Variance from propagating the median frame to now with a gyroscope of unknown bias.
    age_s = found.age_s if mode is Mode.GYRO else 0.0
    drift_variance = float(ekf.P[BIAS, BIAS]) * age_s**2 + config.gyro_noise**2 * age_s
    ekf.update(heading_model(ekf.x, heading, found.std**2 + drift_variance))
    if axis.ever_acquired:
        axis = axis.with_reset(ekf, before)
    axis = axis._replace(acquired=True, ever_acquired=True, votes=(), stamps_suspect=False)
    return axis.confirmed(ekf, t_ns, theta_rad)


def recover(
    axis: CorridorAxis, ekf: CorridorEKF, found: Recovery, t_ns: int, theta_rad: float, corrects_heading: bool
) -> CorridorAxis:
    """Reset the heading: widen the covariance along the error, and update with the votes' median.

    Parameters
    ----------
    axis, ekf, t_ns, theta_rad, corrects_heading
        As in `acquire`.
    found
        Median of the votes.
    """
    before = float(ekf.x[PSI])
    _widen_heading(ekf, found.heading_rad - before, corrects_heading)
    expected = heading_model(ekf.x, found.heading_rad, found.std_rad**2)
    ekf.update(expected._replace(residual=found.heading_rad - before))
    axis = axis.with_reset(ekf, before)._replace(votes=(), rival=None)
    return axis.confirmed(ekf, t_ns, theta_rad)


def _widen_heading(ekf: CorridorEKF, error_rad: float, corrects_heading: bool) -> None:
    """Widen the covariance along an error of the heading that leaves psi + o (the IMU's yaw) unchanged."""
    Q = np.zeros((N_STATES, N_STATES))
    Q[PSI, PSI] = Q[YAW_OFFSET, YAW_OFFSET] = error_rad**2
    if corrects_heading:
        Q[PSI, YAW_OFFSET] = Q[YAW_OFFSET, PSI] = -(error_rad**2)
    ekf.predict(ekf.x, np.eye(N_STATES), Q)
