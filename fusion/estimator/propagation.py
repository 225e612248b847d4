"""The engine's first part: carry the state from sample to sample.

Which stream carries the heading is decided anew at each sample: the gyroscope; where it is absent or silent, the yaw
increments of the attitude stream; with neither, a constant rate (then the state's bias is minus that rate).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite

import numpy as np

from fusion.estimator import tilt as tilts
from fusion.estimator.camera_delay import unknown_delay, with_turn
from fusion.estimator.config import FusionConfig
from fusion.estimator.ekf import CorridorEKF
from fusion.estimator.models import (
    BIAS,
    N_STATES,
    OFFSET,
    PSI,
    FloatArray,
    ProcessNoise,
    Y,
    level_yaw_rate,
)
from fusion.estimator.range_width import Heights, with_range
from fusion.estimator.state import (
    UNKNOWN_HEADING_STD_RAD,
    Mode,
    State,
    half_width_m,
    is_moving,
    next_interval_s,
)
from fusion.estimator.tilt import Vector

ATTITUDE_DRIFT_STD_RAD_S = 0.003  # an attitude filter has removed most of the gyroscope's bias
UNKNOWN_RATE_STD_RAD_S = 0.5
HELD_RATE_STD_RAD_S = 0.2
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
        self.state = State(gyro_bias=(0.0, config.gyro_bias_std_rad_s**2), delay=unknown_delay(config))
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
        if s.delay is not None:
            s.delay = with_turn(s.delay, t_ns, s.raw_theta_rad)
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
        s.velocity_interval_s = next_interval_s(s.velocity_interval_s, s.t_velocity_ns, t_ns)
        s.t_velocity_ns, s.forward_m_s, s.sideways_m_s = t_ns, forward, right
        self._end()

    def range(self, t_ns: int, distance_m: float) -> None:
        """Take a distance to the floor. It moves nothing; the next frame may make a width of it."""
        s = self.state
        self.nodes = []
        s.heights = with_range(s.heights, t_ns, distance_m, s.tilt.down[2])
        s.range_interval_s = next_interval_s(s.range_interval_s, s.t_range_ns, t_ns)
        s.t_range_ns = t_ns

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
        s.t_range_ns, s.heights, s.widths = None, Heights(), s.widths._replace(t_ns=None)
        s.votes = ()
        s.recent, s.previous_axis, s.acquired = (), None, False
        if s.delay is not None:
            s.delay = s.delay.interrupted()
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
        moving = is_moving(s, t_ns)
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
        if s.delay is not None:
            s.delay = s.delay.interrupted()

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


__all__ = ["Node", "Propagation"]
