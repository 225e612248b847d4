"""State, process model and measurement models of the heading filter. Pure functions.

State (3,): ``[psi, b_z, o]``

- psi: heading, rad, kept unwrapped;
- b_z: bias of the level yaw rate, rad/s;
- o: IMU yaw minus heading in the first corridor's frame, rad.

Process, with level yaw rate omega::

    psi' = omega - b_z + n_psi        omega = (q sin(roll) + r cos(roll)) / cos(pitch)
    b_z' = n_b
    o'   = n_o

Measurements, with residuals wrapped to half a turn for frames and to a turn for the IMU's yaw::

    frame:    z = psi  (modulo pi)
    IMU yaw:  z = psi + turn + o    (turn: angle of the present corridor's axis from the first one's)

The lateral offset has a filter of its own, `fusion.estimator.lateral.gaussian_sum`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fusion.estimator.kernels import BIAS as BIAS
from fusion.estimator.kernels import N_STATES as N_STATES
from fusion.estimator.kernels import PSI as PSI
from fusion.estimator.kernels import STATE_NAMES as STATE_NAMES
from fusion.estimator.kernels import YAW_OFFSET as YAW_OFFSET
from fusion.estimator.kernels import FloatArray as FloatArray
from fusion.estimator.kernels import Quaternion as Quaternion
from fusion.estimator.kernels import Vector as Vector
from vision.rotations import wrap, wrap_axis

# Yaw is undefined at a pitch of 90 degrees; this lower bound (85 degrees) keeps the rate finite.
MIN_COS_PITCH_SQUARED = 0.0076


class ProcessNoise(NamedTuple):
    """Densities of the continuous process noise.

    Parameters
    ----------
    heading
        Density of n_psi, rad/sqrt(s): the gyroscope's noise density.
    bias
        Density of n_b, rad/s/sqrt(s).
    offset
        Density of n_o, rad/sqrt(s).
    """

    heading: float
    bias: float
    offset: float


class ScalarMeasurement(NamedTuple):
    """Scalar measurement: residual (wrapped if it is an angle), H (3,) and the variance R."""

    residual: float
    H: FloatArray
    R: float


class Gate(NamedTuple):
    """Outcome of an update: whether it was accepted, the residual, residual^2 / (gate^2 S), and S."""

    accepted: bool
    residual: float
    test_ratio: float
    variance: float


def level_yaw_rate(gyro_rad_s: tuple[float, float, float], down: tuple[float, float, float]) -> float:
    """Return the yaw rate about the vertical, rad/s, without bias correction.

    Parameters
    ----------
    gyro_rad_s
        Body rates p, q, r (FRD).
    down
        Unit vector of gravity's direction in the body frame: (-sin(pitch), sin(roll) cos(pitch), cos(roll)
        cos(pitch)). With it (q sin(roll) + r cos(roll)) / cos(pitch) needs no trigonometry.
    """
    _, q, r = gyro_rad_s
    _, dy, dz = down
    return (q * dy + r * dz) / max(dy * dy + dz * dz, MIN_COS_PITCH_SQUARED)


def level_yaw_rates(gyro_rad_s: FloatArray, down: FloatArray) -> FloatArray:
    """Return `level_yaw_rate` (n,) of many samples: rates (n, 3), directions (n, 3)."""
    _, q, r = gyro_rad_s.T
    _, dy, dz = down.T
    return np.asarray((q * dy + r * dz) / np.maximum(dy * dy + dz * dz, MIN_COS_PITCH_SQUARED))


_H_HEADING = np.array([1.0, 0.0, 0.0])
_H_IMU_YAW = np.array([1.0, 0.0, 1.0])
_H_YAW_OFFSET = np.array([0.0, 0.0, 1.0])
for _H in (_H_HEADING, _H_IMU_YAW, _H_YAW_OFFSET):
    _H.setflags(write=False)


def heading_model(x: FloatArray, heading_rad: float, variance: float) -> ScalarMeasurement:
    """Return the measurement of a frame's heading; it is ambiguous by half a turn, so the residual is an axis's."""
    return ScalarMeasurement(wrap_axis(heading_rad - float(x[PSI])), _H_HEADING, variance)


def imu_yaw_model(
    x: FloatArray, yaw_rad: float, corridor_turn_rad: float, variance: float
) -> ScalarMeasurement:
    """Return the measurement of the IMU's yaw: heading in the first corridor's frame, plus the offset."""
    return ScalarMeasurement(
        wrap(yaw_rad - float(x[PSI]) - corridor_turn_rad - float(x[YAW_OFFSET])), _H_IMU_YAW, variance
    )


def imu_yaw_offset_model(
    x: FloatArray, P: FloatArray, yaw_rad: float, corridor_turn_rad: float, variance: float
) -> ScalarMeasurement:
    """Return the measurement of the IMU's yaw that updates only the offset: the heading's variance is noise."""
    residual = wrap(yaw_rad - x.item(PSI) - corridor_turn_rad - x.item(YAW_OFFSET))
    return ScalarMeasurement(residual, _H_YAW_OFFSET, variance + P.item(PSI, PSI))
