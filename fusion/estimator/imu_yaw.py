"""The IMU's own yaw: measurement update with the yaw of an attitude sample.

The yaw measures ``psi + turn + o``, with psi the heading, turn the angle of the present corridor from the first one,
and o the yaw offset, a state of the filter. There are two ways to use it:

- By default only o is estimated: its covariance with the other states is zero, and the heading's variance counts as
  measurement noise (`fusion.estimator.models.imu_yaw_offset_model`).
- The yaw corrects the heading too while `fusion.estimator.imu_yaw_check` finds it independent of the gyroscope and
  not disturbed, or if the configuration asks for it.

A step of the yaw (`STEP_SAMPLES` rejected samples in a row) is absorbed by o.
"""

from __future__ import annotations

from math import isnan, nan
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from fusion.estimator.config import FusionConfig
from fusion.estimator.imu_yaw_check import (
    Trace,
    YawDriftStatistics,
    find_disturbance,
    is_due,
    is_independent,
    is_undisturbed,
    shifted_by,
    with_difference,
    with_trace,
)
from fusion.estimator.models import (
    BIAS,
    N_STATES,
    PSI,
    YAW_OFFSET,
    Gate,
    Quaternion,
    ScalarMeasurement,
    imu_yaw_model,
    imu_yaw_offset_model,
)
from fusion.estimator.propagation import DeadReckoning, Mode, yaw_at
from fusion.estimator.records import new_record

if TYPE_CHECKING:
    from fusion.estimator.corridor_axis import CorridorAxis
    from fusion.estimator.ekf import CorridorEKF

UNKNOWN_YAW_OFFSET_STD_RAD = 10.0
STEP_SAMPLES = 3  # rejected in a row


class AttitudeSample(NamedTuple):
    """An attitude (4,): quaternion w, x, y, z of unit length, body FRD to a world whose z points down."""

    t_ns: int
    q_world_body: Quaternion

    def fault(self) -> str:
        """Return the reason why it cannot be used; empty if it can."""
        return "" if 0.9 < _length(self.q_world_body) < 1.1 else "attitude_not_unit"  # NaN fails too

    def unit(self) -> Quaternion:
        """Return the quaternion at length one."""
        w, x, y, z = self.q_world_body
        norm = _length(self.q_world_body)
        return w / norm, x / norm, y / norm, z / norm


def _length(q: Quaternion) -> float:
    w, x, y, z = q
    return float((w * w + x * x + y * y + z * z) ** 0.5)  # mypy takes a power for Any


class ImuYaw(NamedTuple):
    """State of the fusion of the IMU's yaw.

    Parameters
    ----------
    known
        Whether its offset to the corridor is known.
    corrects_heading
        Whether the offset is correlated with the other states.
    rejects
        Number of samples rejected by the gate in a row.
    gate
        Outcome of the last innovation.
    drift_statistics, traces
        See `fusion.estimator.imu_yaw_check`.
    """

    known: bool = False
    corrects_heading: bool = False
    rejects: int = 0
    gate: Gate | None = None
    drift_statistics: YawDriftStatistics = YawDriftStatistics()
    traces: tuple[Trace, ...] = ()

    @property
    def test_ratio(self) -> float:
        """Square of the last innovation over the gate squared."""
        return nan if self.gate is None else self.gate.test_ratio

    def axis_changed(self) -> ImuYaw:
        """Drop the running comparison of gyroscope and yaw after a change of the axis."""
        return self._replace(drift_statistics=self.drift_statistics.interrupted())


def fuse_imu_yaw(
    part: ImuYaw,
    ekf: CorridorEKF,
    yaw_rad: float,
    reckoning: DeadReckoning,
    axis: CorridorAxis,
    config: FusionConfig,
) -> ImuYaw:
    """Update with the IMU's yaw; a step of the yaw is absorbed by its offset, never by the heading.

    Parameters
    ----------
    part
        Part of the state.
    ekf
        Filter to update.
    yaw_rad
        Yaw of the attitude sample, at the time of ``reckoning``.
    reckoning, axis
        Dead reckoning of the heading, and the axis that it is measured from.
    config
        Settings.
    """
    if not axis.acquired:
        return part
    # If its increments propagate the heading, the yaw carries no further information.
    useful = reckoning.mode is Mode.GYRO and _is_useful(part, config)
    part = _coupled(part, ekf, useful and is_undisturbed(part.traces))
    measurement = _measurement(part, ekf, yaw_rad, axis, config)
    if not part.known:
        ekf.update(measurement)
        return part._replace(known=True)
    gate = ekf.update(measurement, config.imu_yaw_gate_sigma)
    if gate.accepted:
        _, corrects_heading, _, _, statistics, traces = part
        part = new_record(ImuYaw, (True, corrects_heading, 0, gate, statistics, traces))
        return _trace(part, ekf, yaw_rad, reckoning, axis, config)
    part = part._replace(gate=gate, rejects=part.rejects + 1)
    if part.rejects >= STEP_SAMPLES:
        ekf.widen(YAW_OFFSET, gate.residual**2)
        ekf.update(_measurement(part, ekf, yaw_rad, axis, config))
        part = part._replace(traces=shifted_by(gate.residual, part.traces))
    return part


class YawUpdates(NamedTuple):
    """What the updates with the yaws of successive attitudes have in common, between two frames.

    Parameters
    ----------
    use
        What a yaw updates: `NOTHING`, `OFFSET_ONLY` or `HEADING_TOO`; `UNLIKE` if the next one does more.
    turn_rad, variance, gate_sigma
        Turn of the present corridor from the first one, variance of a yaw, and the gate.
    walk_variance
        Variance per second of the random walks of gyroscope and yaw.
    useful
        Whether the yaw would correct the heading once it is undisturbed.
    """

    use: int
    turn_rad: float
    variance: float
    gate_sigma: float
    walk_variance: float
    useful: bool


UNLIKE, NOTHING, OFFSET_ONLY, HEADING_TOO = -1, 0, 1, 2


def yaw_updates(part: ImuYaw, by_gyro: bool, axis: CorridorAxis, config: FusionConfig) -> YawUpdates:
    """Return what the next updates of `fuse_imu_yaw` have in common; ``by_gyro``: the heading is propagated by it."""
    useful = by_gyro and _is_useful(part, config)
    use = HEADING_TOO if part.corrects_heading else OFFSET_ONLY
    if not axis.acquired:
        use = NOTHING
    elif not part.known or part.corrects_heading != (useful and is_undisturbed(part.traces)):
        use = UNLIKE
    return YawUpdates(
        use,
        axis.corridor_turn_rad,
        config.imu_yaw_std_rad**2,
        config.imu_yaw_gate_sigma,
        config.gyro_noise**2 + config.offset_walk**2,
        useful,
    )


def compare_by_frame(
    part: ImuYaw, t_ns: int, heading_rad: float, variance: float, reckoning: DeadReckoning
) -> ImuYaw:
    """Compare gyroscope and IMU yaw with a frame, if an attitude sample is near.

    Parameters
    ----------
    part
        Part of the state.
    t_ns, heading_rad, variance
        Time of the frame, its heading and the variance.
    reckoning
        Dead reckoning of the heading.
    """
    yaw_now = yaw_at(reckoning, t_ns)
    if reckoning.mode is not Mode.GYRO or isnan(yaw_now):
        return part
    seen = with_difference(
        part.drift_statistics, t_ns, heading_rad - reckoning.theta_rad, heading_rad - yaw_now, variance
    )
    return part._replace(drift_statistics=seen)


def _is_useful(part: ImuYaw, config: FusionConfig) -> bool:
    if config.imu_yaw_use == "auto":
        return is_independent(part.drift_statistics, config.gyro_noise, config.offset_walk)
    return config.imu_yaw_use == "always"


def _measurement(
    part: ImuYaw, ekf: CorridorEKF, yaw_rad: float, axis: CorridorAxis, config: FusionConfig
) -> ScalarMeasurement:
    variance = config.imu_yaw_std_rad**2
    if part.corrects_heading:
        return imu_yaw_model(ekf.x, yaw_rad, axis.corridor_turn_rad, variance)
    return imu_yaw_offset_model(ekf.x, ekf.P, yaw_rad, axis.corridor_turn_rad, variance)


def _trace(
    part: ImuYaw,
    ekf: CorridorEKF,
    yaw_rad: float,
    reckoning: DeadReckoning,
    axis: CorridorAxis,
    config: FusionConfig,
) -> ImuYaw:
    """Detect a disturbance of the IMU's yaw, and undo its effect on heading and bias."""
    t_ns = reckoning.attitude.last_ns
    if t_ns is None or not is_due(part.traces, t_ns):
        return part
    x, raw = ekf.x, reckoning.raw_theta_rad
    now = Trace(t_ns, yaw_rad - raw, float(x[PSI]) - raw, float(x[BIAS]), float(ekf.P[BIAS, BIAS]))
    found = find_disturbance(
        part.traces, now, config.gyro_noise**2 + config.offset_walk**2, config.imu_yaw_std_rad**2
    )
    if found is None:
        return part._replace(traces=with_trace(part.traces, now))
    unseen = axis.t_vision_ns is None or axis.t_vision_ns < found.since_ns
    if part.corrects_heading and unseen:  # no frame was fused meanwhile, so the yaw caused the change
        moved = np.array([found.heading_rad, found.bias_rad_s, 0.0])
        ekf.predict(x - moved, np.eye(N_STATES), np.multiply.outer(moved, moved))
    return part._replace(traces=(now,))


def _coupled(part: ImuYaw, ekf: CorridorEKF, corrects_heading: bool) -> ImuYaw:
    """Couple the yaw offset to the heading, or decouple it, by a transition that resets the offset.

    An attitude filter's yaw contains the errors of the gyroscope that already propagates the heading. Fused as
    independent it makes the filter overconfident, and its drift is attributed to the gyroscope's bias. A decoupled
    offset is uncorrelated with every other state, so its updates do not change them, in the smoother either.
    """
    if corrects_heading == part.corrects_heading:
        return part
    F, Q = np.eye(N_STATES), np.zeros((N_STATES, N_STATES))
    F[YAW_OFFSET, YAW_OFFSET] = 0.0
    Q[YAW_OFFSET, YAW_OFFSET] = UNKNOWN_YAW_OFFSET_STD_RAD**2
    ekf.predict(ekf.x, F, Q)
    return part._replace(corrects_heading=corrects_heading, known=False)
