"""The engine's second part: what an attitude sample does to the state.

Its tilt is taken as it is. Its yaw carries the heading on where no gyroscope does; where one does, its offset to the
corridor is followed, and it corrects the heading if `fusion.estimator.imu_yaw_check` finds that it knows something of
its own.
"""

from __future__ import annotations

from math import atan2

import numpy as np

from fusion.estimator import tilt as tilts
from fusion.estimator.imu_yaw_check import Trace, is_calm, is_due, is_independent, parted, stepped_by, traced
from fusion.estimator.models import (
    BIAS,
    N_STATES,
    OFFSET,
    PSI,
    ScalarMeasurement,
    imu_yaw_model,
    imu_yaw_offset_model,
    wrap,
)
from fusion.estimator.propagation import Propagation
from fusion.estimator.state import UNKNOWN_OFFSET_STD_RAD, Mode, next_interval_s

Quaternion = tuple[float, float, float, float]

IMU_YAW_STEP_SAMPLES = 3


class ImuYaw(Propagation):
    """The part of the engine that knows the IMU's own yaw."""

    def attitude(self, t_ns: int, q_world_body: Quaternion) -> None:
        """Take an attitude sample: tilt, and yaw as increment or as measurement."""
        self._begin(t_ns)
        s = self.state
        w, x, y, z = q_world_body
        yaw = atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
        self._leave_silent_gyro(t_ns)
        if s.mode is Mode.ATTITUDE and s.t_attitude_ns is not None:
            increment = wrap(yaw - s.yaw_rad)
            span_s = (t_ns - s.t_attitude_ns) * 1e-9
            self._advance(t_ns, turned_rad=wrap(increment - s.yaw_done_rad))
            if span_s > 0:
                s.rate_rad_s = increment / span_s
        else:
            self._advance(t_ns)
        s.tilt = tilts.from_quaternion(s.tilt, t_ns, q_world_body)
        s.attitude_interval_s = next_interval_s(s.attitude_interval_s, s.t_attitude_ns, t_ns)
        s.t_attitude_ns, s.yaw_rad, s.yaw_done_rad = t_ns, yaw, 0.0
        if s.mode is Mode.NONE:
            self._set_mode(Mode.ATTITUDE)
        self._correct_by_imu_yaw(yaw)
        self._end()

    def _correct_by_imu_yaw(self, yaw_rad: float) -> None:
        """Fuse the IMU's yaw, or follow its offset; a step of it is taken up by the offset, never by the heading."""
        s, c = self.state, self.config
        if not s.acquired:
            return
        # Where yaw increments carry the heading, the same yaw tells nothing more.
        worth = s.mode is Mode.GYRO and self._imu_yaw_is_worth_having()
        self._couple_imu_yaw(worth and is_calm(s.yaw_traces))
        measurement = self._imu_yaw_measurement(yaw_rad)
        if not s.imu_yaw_known:
            self.ekf.update(measurement)
            s.imu_yaw_known = True
            return
        gate = self.ekf.update(measurement, c.imu_yaw_gate_sigma)
        s.imu_yaw_ratio = gate.test_ratio
        if gate.accepted:
            s.imu_yaw_rejects = 0
            self._trace_imu_yaw(yaw_rad)
            return
        s.imu_yaw_rejects += 1
        if s.imu_yaw_rejects >= IMU_YAW_STEP_SAMPLES:
            self._widen(OFFSET, gate.residual**2)
            self.ekf.update(self._imu_yaw_measurement(yaw_rad))
            s.yaw_traces = stepped_by(gate.residual, s.yaw_traces)

    def _trace_imu_yaw(self, yaw_rad: float) -> None:
        """Notice where the IMU's yaw parts from the gyroscope, and undo what that did to the heading."""
        s, c = self.state, self.config
        if not is_due(s.yaw_traces, self._now_ns):
            return
        x, P, raw = self.ekf.x, self.ekf.P, s.raw_theta_rad
        now = Trace(self._now_ns, yaw_rad - raw, float(x[PSI]) - raw, float(x[BIAS]), float(P[BIAS, BIAS]))
        found = parted(s.yaw_traces, now, c.gyro_noise**2 + c.offset_walk**2, c.imu_yaw_std_rad**2)
        if found is None:
            s.yaw_traces = traced(s.yaw_traces, now)
            return
        s.yaw_traces = (now,)
        unseen = s.t_vision_ns is None or s.t_vision_ns < found.since_ns
        if s.imu_yaw_coupled and unseen:  # no frame has moved them meanwhile, so the yaw has
            moved = np.array([found.heading_rad, found.bias_rad_s, 0.0, 0.0, 0.0])
            self._transit(x - moved, np.eye(N_STATES), np.multiply.outer(moved, moved))

    def _imu_yaw_is_worth_having(self) -> bool:
        c = self.config
        if c.imu_yaw_use == "auto":
            return is_independent(self.state.yaw_watch, c.gyro_noise, c.offset_walk)
        return c.imu_yaw_use == "always"

    def _imu_yaw_measurement(self, yaw_rad: float) -> ScalarMeasurement:
        s, variance = self.state, self.config.imu_yaw_std_rad**2
        if s.imu_yaw_coupled:
            return imu_yaw_model(self.ekf.x, yaw_rad, s.corridor_turn_rad, variance)
        return imu_yaw_offset_model(self.ekf.x, self.ekf.P, yaw_rad, s.corridor_turn_rad, variance)

    def _couple_imu_yaw(self, coupled: bool) -> None:
        """Let the heading learn from the IMU's yaw, or keep the two apart.

        An attitude filter's yaw comes from the gyroscope that already carries the heading. Taken as independent it
        makes the filter too sure, and its drift passes for the gyroscope's bias. Kept apart, the offset is
        uncorrelated with every other state, so nothing learned about it can move them, in the smoother neither.
        """
        s = self.state
        if coupled == s.imu_yaw_coupled:
            return
        F, Q = np.eye(N_STATES), np.zeros((N_STATES, N_STATES))
        F[OFFSET, OFFSET] = 0.0
        Q[OFFSET, OFFSET] = UNKNOWN_OFFSET_STD_RAD**2
        self._transit(self.ekf.x, F, Q)
        s.imu_yaw_coupled, s.imu_yaw_known = coupled, False
