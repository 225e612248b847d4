"""The engine's first half: carry the state from sample to sample, and fuse the IMU's yaw.

Which stream carries the heading is decided anew at each sample: the gyroscope; where it is absent or silent, the yaw
increments of the attitude stream; with neither, a constant rate (then the state's bias is minus that rate).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import atan2, isfinite

import numpy as np

from fusion import tilt as tilts
from fusion.config import FusionConfig
from fusion.ekf import CorridorEKF
from fusion.models import (
    BIAS,
    N_STATES,
    OFFSET,
    PSI,
    FloatArray,
    ProcessNoise,
    ScalarMeasurement,
    Y,
    imu_yaw_model,
    imu_yaw_offset_model,
    level_yaw_rate,
    wrap,
)
from fusion.state import UNKNOWN_HEADING_STD_RAD, UNKNOWN_OFFSET_STD_RAD, Mode, State, half_width_m
from fusion.tilt import Vector
from fusion.yaw_watch import Trace, is_calm, is_due, is_independent, parted, stepped_by, traced

Quaternion = tuple[float, float, float, float]

ATTITUDE_DRIFT_STD_RAD_S = 0.003  # an attitude filter has removed most of the gyroscope's bias
UNKNOWN_RATE_STD_RAD_S = 0.5
HELD_RATE_STD_RAD_S = 0.2
VELOCITY_AGE_S = 0.5
IMU_YAW_STEP_SAMPLES = 3
_CACHE_SIZE = 512


@dataclass(slots=True, eq=False)
class Node:
    """One step for the smoother: a transition, and the state after what was measured behind it.

    ``F`` is None where nothing moved. ``x_prior``, ``P_prior`` stand right behind the transition.
    """

    t_ns: int
    F: FloatArray | None
    x_prior: FloatArray
    P_prior: FloatArray
    x: FloatArray
    P: FloatArray


class Propagation:
    """State, filter and what moves them between frames. A step depends on nothing but the state and the sample."""

    def __init__(self, config: FusionConfig) -> None:
        self.config = config
        self.state = State(gyro_bias=(0.0, config.gyro_bias_std_rad_s**2))
        self.ekf = CorridorEKF(self.state.x, self.state.P)
        self.nodes: list[Node] = []
        self._noise_cache: dict[tuple[Mode, bool, float], ProcessNoise] = {}
        self._grace_ns = round(config.gyro_gap_s * 1e9)

    # Every event runs between these two, which move x and P between the snapshot and filterpy's object.
    def _begin(self, t_ns: int) -> None:
        s, ekf = self.state, self.ekf
        ekf.x, ekf.P = s.x, s.P
        if s.t_ns is None:
            s.t_ns = t_ns
        self._now_ns, self.nodes = s.t_ns, []

    def _end(self) -> None:
        s, ekf = self.state, self.ekf
        self._close_node(s.x, s.P)
        s.x, s.P = ekf.x, ekf.P

    def _close_node(self, x_before: FloatArray, P_before: FloatArray) -> None:
        """Note what was measured since the last transition; ``x_before``, ``P_before`` where there was none."""
        ekf = self.ekf
        if self.nodes:
            self.nodes[-1].x, self.nodes[-1].P = ekf.x, ekf.P
        elif ekf.P is not P_before:
            self.nodes.append(Node(self._now_ns, None, x_before, P_before, ekf.x, ekf.P))

    def _transit(self, x_next: FloatArray, F: FloatArray, Q: FloatArray) -> None:
        """Apply a transition and note it for the smoother."""
        self._close_node(self.state.x, self.state.P)
        self.ekf.predict(x_next, F, Q)
        self._open_node()

    def _open_node(self) -> None:
        ekf = self.ekf
        self.nodes.append(Node(self._now_ns, ekf.F, ekf.x, ekf.P, ekf.x, ekf.P))

    _now_ns = 0

    def imu(self, t_ns: int, gyro_rad_s: Vector, accel_m_s2: Vector | None) -> None:
        """Take a gyroscope sample and, where there is one, the accelerometer's."""
        self._begin(t_ns)
        s = self.state
        gyro = gyro_rad_s
        gap = s.t_gyro_ns is None or t_ns - s.t_gyro_ns > self._grace_ns
        if not gap:
            p, q, r = s.gyro
            gyro = (0.5 * (p + gyro[0]), 0.5 * (q + gyro[1]), 0.5 * (r + gyro[2]))
        s.tilt = tilts.with_imu(s.tilt, t_ns, gyro, accel_m_s2)
        rate = level_yaw_rate(gyro_rad_s, s.tilt.down)
        if s.mode is Mode.GYRO:
            self._advance(t_ns, end_rate_rad_s=rate)
        else:
            self._advance(t_ns)
            self._set_mode(Mode.GYRO)
        s.t_gyro_ns, s.gyro, s.rate_rad_s, s.gyro_done_rad = t_ns, gyro_rad_s, rate, 0.0
        self._end()

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
        s.t_attitude_ns, s.yaw_rad, s.yaw_done_rad = t_ns, yaw, 0.0
        if s.mode is Mode.NONE:
            self._set_mode(Mode.ATTITUDE)
        self._correct_by_imu_yaw(yaw)
        self._end()

    def velocity(self, t_ns: int, v_body_m_s: Vector) -> None:
        """Take a velocity in the body frame; it is held for half a second."""
        self._begin(t_ns)
        self._leave_silent_gyro(t_ns)
        self._advance(t_ns)
        s = self.state
        # Level forward and right axes seen from the body: without yaw, only gravity's direction is needed.
        dx, dy, dz = s.tilt.down
        vx, vy, vz = v_body_m_s
        horizontal = max((dy * dy + dz * dz) ** 0.5, 0.09)
        right = (dz * vy - dy * vz) / horizontal
        forward = vx * horizontal - dx * (dy * vy + dz * vz) / horizontal
        s.t_velocity_ns, s.forward_m_s, s.sideways_m_s = t_ns, forward, right
        self._end()

    def restart_clock(self, t_ns: int) -> None:
        """Go on after the samples' clock was set back: what was known is kept, how long ago it was is not."""
        s = self.state
        old_ns = s.t_ns
        if old_ns is None:
            return
        self._begin(t_ns)
        Q = np.zeros((N_STATES, N_STATES))
        Q[PSI, PSI], Q[OFFSET, OFFSET] = 0.5**2, 0.5**2
        self._now_ns = s.t_ns = t_ns
        self._transit(self.ekf.x, np.eye(N_STATES), Q)
        s.tilt = s.tilt._replace(t_ns=t_ns, t_attitude_ns=None, t_gyro_ns=None, t_accel_ns=None)
        s.t_gyro_ns = s.t_attitude_ns = s.t_velocity_ns = s.t_frame_ns = s.t_vision_ns = s.t_lateral_ns = None
        s.votes = ()
        s.recent, s.previous_axis, s.acquired = (), None, False
        self._lose_lateral()
        self._set_mode(Mode.NONE)
        self._end()

    def _lose_lateral(self) -> None:
        """Let the next lateral offsets start anew; what was known last is kept, to tell the step."""
        s = self.state
        if s.lateral_acquired:
            y = float(self.ekf.x[Y])
            s.lateral_left = (y, y * half_width_m(s, self.config))
        s.lateral_acquired, s.lateral_votes = False, ()

    def _advance(
        self, t_ns: int, *, end_rate_rad_s: float | None = None, turned_rad: float | None = None
    ) -> None:
        """Propagate to ``t_ns`` with the mode in force.

        ``end_rate_rad_s`` is the gyroscope's level rate at ``t_ns``, ``turned_rad`` the attitude's yaw increment less
        what was propagated already; without either the last rate is held, and made good when the next is known.
        """
        s = self.state
        start_ns = s.t_ns
        self._now_ns = t_ns
        if start_ns is None or (t_ns <= start_ns and end_rate_rad_s is None and turned_rad is None):
            return
        dt_s = (t_ns - start_ns) * 1e-9
        variance = 0.0
        if s.mode is Mode.NONE:
            turned_rad = 0.0
        elif s.mode is Mode.GYRO and end_rate_rad_s is not None:
            turned_rad = self._turn_since_gyro(t_ns, end_rate_rad_s) - s.gyro_done_rad
            variance = 0.25 * self._silence_variance(start_ns, t_ns)  # known at both ends: a bridge
        elif turned_rad is None:
            turned_rad = s.rate_rad_s * dt_s
            if s.mode is Mode.GYRO:
                variance = self._silence_variance(start_ns, t_ns)
        bias_turn = float(self.ekf.x[BIAS]) * dt_s
        moving = s.t_velocity_ns is not None and (t_ns - s.t_velocity_ns) * 1e-9 <= VELOCITY_AGE_S
        noise = self._noise(s.mode, moving)
        u = w = 0.0
        if moving:
            half = self._half_width()
            u, w = s.forward_m_s / half, s.sideways_m_s / half
        self._close_node(s.x, s.P)
        self.ekf.advance(dt_s, turned_rad, noise, u, w, variance)
        self._open_node()
        s.theta_rad += turned_rad - bias_turn
        s.raw_theta_rad += turned_rad
        s.yaw_done_rad += turned_rad - (bias_turn if s.mode is not Mode.ATTITUDE else 0.0)
        s.gyro_done_rad += turned_rad
        s.t_ns = t_ns

    def _turn_since_gyro(self, t_ns: int, end_rate_rad_s: float) -> float:
        """Yaw turned since the last gyroscope sample, by the trapezoid rule: each sample counts for as much."""
        s = self.state
        if s.t_gyro_ns is None:
            return s.gyro_done_rad
        return 0.5 * (s.rate_rad_s + end_rate_rad_s) * (t_ns - s.t_gyro_ns) * 1e-9

    def _silence_variance(self, start_ns: int, end_ns: int) -> float:
        """Heading variance gained between two times in which the gyroscope should have spoken and did not."""
        s = self.state
        if s.t_gyro_ns is None or end_ns - s.t_gyro_ns <= self._grace_ns:
            return 0.0
        grace = self.config.gyro_gap_s
        first = max((start_ns - s.t_gyro_ns) * 1e-9 - grace, 0.0)
        last = max((end_ns - s.t_gyro_ns) * 1e-9 - grace, 0.0)
        # The rate wanders like a random walk from its last sample.
        variance = self.config.yaw_acceleration_density**2 * (last**3 - first**3) / 3.0
        known = float(self.ekf.P[PSI, PSI])
        return max(min(variance, 2.0 * UNKNOWN_HEADING_STD_RAD**2 - known), 0.0)

    def held_rate_variance(self, t_ns: int) -> float:
        """Variance of the heading at ``t_ns`` from holding the last rate or yaw until then; gone with the next."""
        s = self.state
        last = s.t_gyro_ns if s.mode is Mode.GYRO else s.t_attitude_ns
        if s.mode is Mode.NONE or last is None:
            return 0.0
        age_s = min((t_ns - last) * 1e-9, 0.5)
        variance = self.config.yaw_acceleration_density**2 * age_s**3 / 3.0
        return variance + (self.config.imu_yaw_std_rad**2 if s.mode is Mode.ATTITUDE else 0.0)

    def _leave_silent_gyro(self, t_ns: int) -> None:
        """Go over to the attitude's yaw, or to a constant rate, where the gyroscope has fallen silent."""
        s = self.state
        silent = s.t_gyro_ns is not None and t_ns - s.t_gyro_ns > self._grace_ns
        if s.mode is Mode.GYRO and silent:
            live = s.t_attitude_ns is not None and (t_ns - s.t_attitude_ns) * 1e-9 <= tilts.ATTITUDE_GAP_S
            self._set_mode(Mode.ATTITUDE if live else Mode.NONE)

    def _set_mode(self, mode: Mode) -> None:
        """Change what carries the heading; the bias then means something else and starts anew."""
        s = self.state
        if mode is s.mode:
            return
        bias, variance = float(self.ekf.x[BIAS]), float(self.ekf.P[BIAS, BIAS])
        if s.mode is Mode.GYRO:
            s.gyro_bias = (bias, variance)
        if mode is Mode.GYRO:
            new, new_variance = s.gyro_bias
        elif mode is Mode.ATTITUDE:
            new, new_variance = 0.0, ATTITUDE_DRIFT_STD_RAD_S**2
        elif s.mode is Mode.NONE or s.t_ns is None:
            new, new_variance = 0.0, UNKNOWN_RATE_STD_RAD_S**2
        else:
            new, new_variance = bias - s.rate_rad_s, HELD_RATE_STD_RAD_S**2
        x = self.ekf.x.copy()
        x[BIAS] = new
        F = np.eye(N_STATES)
        F[BIAS, BIAS] = 0.0
        Q = np.zeros((N_STATES, N_STATES))
        Q[BIAS, BIAS] = new_variance
        self._transit(x, F, Q)
        s.mode = mode

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

    def _widen(self, index: int, variance: float) -> None:
        Q = np.zeros((N_STATES, N_STATES))
        Q[index, index] = variance
        self._transit(self.ekf.x, np.eye(N_STATES), Q)

    def _half_width(self) -> float:
        """Half width for turning metres into half widths; one metre where it is unknown."""
        half = half_width_m(self.state, self.config)
        return half if isfinite(half) and half > 0.0 else 1.0

    def _noise(self, mode: Mode, moving: bool) -> ProcessNoise:
        half = self._half_width()
        key = (mode, moving, half)
        noise = self._noise_cache.get(key)
        if noise is None:
            noise = self._make_noise(mode, moving, half)
            if len(self._noise_cache) >= _CACHE_SIZE:
                self._noise_cache.clear()
            self._noise_cache[key] = noise
        return noise

    def _make_noise(self, mode: Mode, moving: bool, half_m: float) -> ProcessNoise:
        c = self.config
        v_std = (c.velocity_std_m_s if moving else c.lateral_velocity_std_m_s) / half_m
        lateral = (v_std, c.lateral_velocity_time_s)
        walk = c.offset_walk
        if mode is Mode.GYRO:
            return ProcessNoise(c.gyro_noise, c.bias_walk, walk, *lateral)
        if mode is Mode.ATTITUDE:
            return ProcessNoise(walk, c.bias_walk, walk, *lateral)
        return ProcessNoise(1e-4, c.yaw_acceleration_density, walk, *lateral)


__all__ = ["UNKNOWN_OFFSET_STD_RAD", "Node", "Propagation", "Quaternion"]
