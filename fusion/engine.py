"""The engine's second half: what a frame does to the state.

A frame is gated. What the gate rejects is not thrown away but put by as a vote for another axis, in the dead-reckoned
frame, in which the axis of a corridor stays where it is however the vehicle turns. Once enough votes agree, they mean
one of three things:

- The filter has gone wrong: the axis is near the expected one, or it is where the axis was when frames last confirmed
  it, or the picture has changed only gradually since then. The covariance is widened in the direction of the
  disagreement, so that the votes' median can be taken in.
- Another corridor: the vehicle itself has turned away from the old axis, and looks along the new one.
- A wall, a side corridor, furniture: neither of these, so it is waited out, unless nothing else is seen for long.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import cos, exp, hypot, isfinite, nan, pi, radians, sqrt

import numpy as np

from fusion import tilt as tilts
from fusion.consensus import Agreement, Vote, add_vote, agreement
from fusion.models import BIAS, N_STATES, OFFSET, PSI, V, Y, heading_model, lateral_model, wrap_axis
from fusion.propagation import Propagation
from fusion.state import (
    UNKNOWN_HEADING_STD_RAD,
    UNKNOWN_LATERAL_STD,
    Mode,
    PreviousAxis,
    frame_age_limit_s,
    seconds_since,
)
from vision.measurement import Attitude, FrameMeasurement, Prior, Reason

Measure = Callable[[Attitude | None, Prior], FrameMeasurement]

VOTE_AGE_S = 3.0
VOTE_AGE_FRAMES = 15
VOTE_SPACING_S = 0.03
AGREEING_SHARE = 0.6
CONTESTED_SHARE = 0.25
KNOWN_AXIS_RAD = radians(5)
GRADUAL_RAD = radians(6)
ALIGNED_RAD = radians(10)
OBLIQUE_RAD = radians(35)
OBLIQUE_WAIT_S = 3.0
WEAK_SUPPORT_S = 1.5
REAL_CORRIDOR_OFFSETS = 10
GLANCE_S = 3.0
LATERAL_START_FRAMES = 3
LATERAL_LOST_STD = 0.5
LATERAL_PRIOR_STD = 0.1
ELEVATION_WEIGHT = 30.0  # errors of successive elevations are those of the attitude: alike for seconds
ELEVATION_FLOOR_RAD = radians(0.25)
WIDTH_MEMORY_FRAMES = 100


@dataclass(frozen=True, slots=True, eq=False)
class FrameResult:
    """What became of a frame.

    Parameters
    ----------
    timestamp_ns
        As stamped, before the camera's delay is taken off.
    measurement
        What vision found; None where there was no picture.
    accepted, reason
        Whether the filter used its heading.
    innovation_rad, test_ratio
        Heading minus prediction, and its square over gate squared; NaN where it was not judged.
    """

    timestamp_ns: int
    measurement: FrameMeasurement | None
    accepted: bool
    reason: Reason
    innovation_rad: float = nan
    test_ratio: float = nan


class Engine(Propagation):
    """The whole estimator for samples in order of time; `fusion.timeline` brings them into order."""

    def frame(self, t_ns: int, stamp_ns: int, measure: Measure | None) -> FrameResult:
        """Take a frame of time ``t_ns``; ``measure`` turns attitude and prediction into its measurement."""
        self._begin(t_ns)
        s = self.state
        self._leave_silent_gyro(t_ns)
        self._advance(t_ns)
        if s.t_frame_ns is not None:
            interval = (t_ns - s.t_frame_ns) * 1e-9
            old = s.frame_interval_s
            s.frame_interval_s = 0.8 * old + 0.2 * min(interval, 3 * old) if isfinite(old) else interval
        s.t_frame_ns = t_ns
        if measure is None:
            result = FrameResult(stamp_ns, None, False, Reason.UNREADABLE)
        else:
            attitude = tilts.attitude_at(s.tilt, t_ns, self.config.attitude_std_rad)
            measurement = self._look(measure, attitude)
            reason = self._check(measurement)
            if reason is Reason.OK:
                result = self._use(t_ns, stamp_ns, measurement, attitude)
            else:
                result = FrameResult(stamp_ns, measurement, False, reason)
        self._end()
        return result

    def prior(self) -> Prior:
        """Return what the filter expects of a frame now, as a frame would see it."""
        s = self.state
        psi = float(self.ekf.x[PSI])
        elevation, variance = s.elevation
        p, q, r = s.gyro
        offset = offset_std = nan
        age_s = seconds_since(self._now_ns, s.t_lateral_ns)
        if s.lateral_acquired and age_s <= frame_age_limit_s(s, self.config):
            # Wider than it is: were vision silent wherever the filter is wrong, nothing could set the filter right.
            offset = (1 if cos(psi) >= 0 else -1) * float(self.ekf.x[Y])
            offset_std = hypot(sqrt(float(self.ekf.P[Y, Y])), LATERAL_PRIOR_STD)
        return Prior(
            heading_rad=wrap_axis(psi) if s.acquired else nan,
            heading_std_rad=sqrt(float(self.ekf.P[PSI, PSI])) if s.acquired else nan,
            lateral_offset_norm=offset,
            lateral_offset_norm_std=offset_std,
            width_per_height=s.width_per_height,
            elevation_rad=elevation,
            elevation_std_rad=max(sqrt(variance), ELEVATION_FLOOR_RAD),
            body_rate_rad_s=sqrt(p * p + q * q + r * r) if s.mode is Mode.GYRO else nan,
        )

    def _look(self, measure: Measure, attitude: Attitude | None) -> FrameMeasurement:
        """Measure a frame with the prediction, and, where that does not settle it, without.

        With the prediction, vision prefers an axis near it to one along the view, so strong lines across can win. And
        turned away from the axis, the prediction must not choose at all: walls and fittings at a junction run along
        the old corridor too, and would hide the new one; there the best direction counts, if only as a vote.
        """
        prior = self.prior()
        expected = measure(attitude, prior)
        if not self.state.acquired:
            return expected
        turned = abs(prior.heading_rad) > self.config.junction_min_turn_rad
        if not turned and self._is_near(expected):
            return expected
        free = measure(attitude, replace(prior, heading_rad=nan, heading_std_rad=nan))
        if self._check(free) is not Reason.OK:
            return expected
        return expected if self._is_near(expected) and self._is_near(free) else free

    def _is_near(self, m: FrameMeasurement) -> bool:
        """Whether a measurement is of the present axis rather than of another."""
        distance = abs(wrap_axis(m.heading_rad - float(self.ekf.x[PSI])))
        return self._check(m) is Reason.OK and distance <= self.config.junction_min_turn_rad

    def _check(self, m: FrameMeasurement) -> Reason:
        """Reason to turn a measurement down before the filter looks at it."""
        if not m.accepted:
            return m.reason if m.reason is not Reason.OK else Reason.UNCERTAIN
        if m.n_inliers < self.config.min_lines:
            return Reason.TOO_FEW_LINES
        if not (isfinite(m.heading_rad) and 0.0 < m.heading_std_rad < pi):  # NaN fails too
            return Reason.UNCERTAIN
        return Reason.OK

    def _use(self, t_ns: int, stamp_ns: int, m: FrameMeasurement, attitude: Attitude | None) -> FrameResult:
        s, c = self.state, self.config
        if s.acquired and float(self.ekf.P[PSI, PSI]) > c.lost_heading_std_rad**2:
            s.acquired, s.votes = False, ()
        variance = max(m.heading_std_rad, c.heading_std_floor_rad) ** 2 + self.held_rate_variance(t_ns)
        axis = s.theta_rad - m.heading_rad
        if not s.acquired:
            self._vote(t_ns, axis, sqrt(variance), False)
            started = self._start(t_ns)
            self._see(t_ns, m.heading_rad, started)
            if started:
                self._learn(t_ns, m, attitude)
            return FrameResult(stamp_ns, m, True, Reason.OK)
        measurement = heading_model(self.ekf.x, m.heading_rad, variance)
        gate = self.ekf.update(measurement, c.heading_gate_sigma, self._correlated(t_ns, variance))
        s.heading_ratio = gate.test_ratio
        linked = self._see(t_ns, m.heading_rad, gate.accepted)
        if gate.accepted:
            self._confirm(t_ns)
            self._learn(t_ns, m, attitude)
            return FrameResult(stamp_ns, m, True, Reason.OK, gate.residual, gate.test_ratio)
        self._vote(t_ns, axis, sqrt(variance), linked)
        self._consider(t_ns)
        return FrameResult(stamp_ns, m, False, Reason.GATE, gate.residual, gate.test_ratio)

    def _correlated(self, t_ns: int, variance: float) -> float:
        """Variance that, taken as independent, stands for errors which resemble those of the frame before."""
        return variance * _inflation(t_ns, self.state.t_vision_ns, self.config.heading_correlation_s)

    def _confirm(self, t_ns: int) -> None:
        """Note that the present axis was seen."""
        s = self.state
        if s.t_vision_ns is not None:
            s.support_s += min((t_ns - s.t_vision_ns) * 1e-9, 0.5)
        s.t_vision_ns = t_ns
        s.n_accepted += 1
        s.anchor_rad = s.theta_rad - float(self.ekf.x[PSI])

    def _see(self, t_ns: int, heading_rad: float, accepted: bool) -> bool:
        """Follow the axis through the pictures alone; True where no jump lies between it and a confirmed one."""
        s = self.state
        reach_ns = round(max(0.4, 2.5 * s.frame_interval_s if isfinite(s.frame_interval_s) else 0.0) * 1e9)
        linked = accepted or any(
            known and t_ns - t <= reach_ns and abs(wrap_axis(heading_rad - heading)) < GRADUAL_RAD
            for t, heading, known in s.recent
        )
        s.recent = (*s.recent[-3:], (t_ns, heading_rad, linked))
        return linked

    def _vote(self, t_ns: int, axis_rad: float, std_rad: float, linked: bool) -> None:
        s = self.state
        if s.votes and (t_ns - s.votes[-1].t_ns) * 1e-9 < VOTE_SPACING_S:
            return  # a fast camera's frames resemble each other, and would crowd out the older ones
        interval = s.frame_interval_s if isfinite(s.frame_interval_s) else 0.0
        age_s = max(VOTE_AGE_S, VOTE_AGE_FRAMES * interval)
        s.votes = add_vote(s.votes, Vote(t_ns, axis_rad, std_rad, s.n_accepted, linked), age_s)

    def _start(self, t_ns: int) -> bool:
        """Find the first heading, or the first after loss: the median of frames that agree."""
        s, c = self.state, self.config
        found = agreement(s.votes, c.recovery_spread_rad, wrap_axis)
        if found is None or found.n_votes < c.start_frames or found.share < AGREEING_SHARE:
            return False
        heading = wrap_axis(s.theta_rad - found.value)
        if s.ever_acquired:
            self._widen_heading(wrap_axis(heading - float(self.ekf.x[PSI])))
        elif float(self.ekf.P[PSI, PSI]) < UNKNOWN_HEADING_STD_RAD**2:
            self._widen(PSI, UNKNOWN_HEADING_STD_RAD**2)
        self.ekf.update(heading_model(self.ekf.x, heading, found.std**2))
        s.acquired = s.ever_acquired = True
        s.votes = ()
        self._confirm(t_ns)
        return True

    def _consider(self, t_ns: int) -> None:
        """Decide what the votes mean, if enough of them agree."""
        s, c = self.state, self.config
        found = agreement(s.votes, c.recovery_spread_rad, wrap_axis)
        if found is None or found.n_votes < min(c.recovery_frames, c.junction_frames):
            return
        lasting_s = self._follow_rival(t_ns, found)
        if s.n_accepted - found.n_accepted > CONTESTED_SHARE * found.n_votes:
            s.rival = None
            return  # other frames still see the present axis
        heading = wrap_axis(s.theta_rad - found.value)
        distance = abs(wrap_axis(heading - float(self.ekf.x[PSI])))
        known = found.linked_share > 0.5 or abs(wrap_axis(found.value - s.anchor_rad)) < KNOWN_AXIS_RAD
        if distance < c.junction_min_turn_rad or known:
            if found.n_votes >= c.recovery_frames:
                self._recover(t_ns, heading, found)
        elif self._has_turned_into(heading, found, lasting_s):
            self._change_corridor(t_ns, heading, found)
        elif found.n_votes >= c.recovery_frames and lasting_s >= self._patience_s():
            # No turn explains it: the axis taken up before was the wrong one.
            if s.corridor_index == 0:
                self._recover(t_ns, heading, found)
            else:
                self._change_corridor(t_ns, heading, found, same_corridor=True)

    def _follow_rival(self, t_ns: int, found: Agreement) -> float:
        """Return how long this axis has been the one that votes agree on, also beyond the votes' own age."""
        s = self.state
        first_ns = found.first_ns
        if s.rival is not None:
            axis, since_ns, last_ns = s.rival
            alive = (t_ns - last_ns) * 1e-9 <= max(1.0, 5.0 * s.frame_interval_s)
            if alive and abs(wrap_axis(axis - found.value)) < KNOWN_AXIS_RAD:
                first_ns = min(first_ns, since_ns)
        s.rival = (found.value, first_ns, t_ns)
        return (t_ns - first_ns) * 1e-9

    def _patience_s(self) -> float:
        """How long another direction must last against an axis that frames have confirmed for some time."""
        return min(self.config.axis_jump_hold_s, 0.3 + self.state.support_s)

    def _has_turned_into(self, heading_rad: float, found: Agreement, lasting_s: float) -> bool:
        """Whether the vehicle's own turn makes the agreed axis that of another corridor, ``heading_rad`` off it."""
        s, c = self.state, self.config
        turned = s.theta_rad - s.anchor_rad
        oblique = abs(heading_rad)
        if abs(turned) < c.junction_min_turn_rad or oblique > OBLIQUE_RAD:
            return False
        if oblique + radians(5) > abs(wrap_axis(turned)):
            return False
        wait_s = c.junction_time_s + OBLIQUE_WAIT_S * max(
            0.0, (oblique - ALIGNED_RAD) / (OBLIQUE_RAD - ALIGNED_RAD)
        )
        return found.n_votes >= c.junction_frames and lasting_s >= wait_s and found.share >= AGREEING_SHARE

    def _recover(self, t_ns: int, heading_rad: float, found: Agreement) -> None:
        """Let the covariance admit the heading that the votes agree on, and take in their median."""
        s = self.state
        before = float(self.ekf.x[PSI])
        self._widen_heading(wrap_axis(heading_rad - before))
        self.ekf.update(heading_model(self.ekf.x, heading_rad, found.std**2))
        s.reset_count += 1
        s.reset_heading_rad = float(self.ekf.x[PSI]) - before
        s.votes, s.rival = (), None
        self._confirm(t_ns)

    def _widen_heading(self, error_rad: float) -> None:
        """Widen along an error of the heading that leaves psi + o, what the IMU's yaw has shown, as it was."""
        Q = np.zeros((N_STATES, N_STATES))
        Q[PSI, PSI] = Q[OFFSET, OFFSET] = error_rad**2
        if self.state.imu_yaw_coupled:
            Q[PSI, OFFSET] = Q[OFFSET, PSI] = -(error_rad**2)
        self._transit(self.ekf.x, np.eye(N_STATES), Q)

    def _change_corridor(
        self, t_ns: int, heading_rad: float, found: Agreement, *, same_corridor: bool = False
    ) -> None:
        """Measure the heading from another corridor's axis from now on.

        As a transition: the new heading is what the votes say, independent of the old; the offset takes up the
        difference, so that the IMU's yaw, psi + turn + o, goes on as it was; the lateral state is unknown.
        """
        s, c = self.state, self.config
        psi, bias, offset, *_ = self.ekf.x.tolist()
        turn = s.corridor_turn_rad + psi - heading_rad
        F, Q = np.zeros((N_STATES, N_STATES)), np.zeros((N_STATES, N_STATES))
        F[BIAS, BIAS] = F[OFFSET, OFFSET] = 1.0
        Q[PSI, PSI] = Q[OFFSET, OFFSET] = found.std**2
        if s.imu_yaw_coupled:
            F[OFFSET, PSI] = 1.0
            Q[PSI, OFFSET] = Q[OFFSET, PSI] = -(found.std**2)
        else:
            Q[OFFSET, OFFSET] += float(self.ekf.P[PSI, PSI])
        Q[Y, Y] = UNKNOWN_LATERAL_STD**2
        Q[V, V] = (c.lateral_velocity_std_m_s / self._half_width()) ** 2
        self._transit(np.array([heading_rad, bias, offset, 0.0, 0.0]), F, Q)
        left = PreviousAxis(s.theta_rad - psi, s.corridor_index, s.corridor_turn_rad, t_ns, s.n_lateral)
        back = s.previous_axis
        recent = back is not None and self._is_glance(t_ns, back)
        if back is not None and recent and abs(wrap_axis(found.value - back.axis_rad)) < 2 * KNOWN_AXIS_RAD:
            s.corridor_index = back.corridor_index  # the vehicle came back: it was no other corridor
        elif same_corridor or (recent and s.support_s < WEAK_SUPPORT_S):
            left = back or left  # the right axis of the corridor just entered; the first guess was a wall's
        else:
            s.corridor_index = s.n_corridors
        s.n_corridors = max(s.n_corridors, s.corridor_index + 1)
        s.previous_axis, s.corridor_turn_rad = left, turn
        s.reset_count += 1
        s.reset_heading_rad = heading_rad - psi
        s.votes, s.lateral_votes, s.rival = (), (), None
        s.lateral_acquired, s.t_lateral_ns = False, None
        s.width_per_height, s.n_width = nan, 0
        s.support_s = 0.0
        self._confirm(t_ns)

    def _is_glance(self, t_ns: int, back: PreviousAxis) -> bool:
        """Whether the present corridor may still turn out to be a wall or a side corridor looked at in passing."""
        since_s = (t_ns - back.left_ns) * 1e-9
        two_sided = self.state.n_lateral - back.n_lateral >= REAL_CORRIDOR_OFFSETS  # a wall shows one side
        return since_s <= (GLANCE_S if two_sided else self.config.junction_revert_s)

    def _learn(self, t_ns: int, m: FrameMeasurement, attitude: Attitude | None) -> None:
        """Use the rest of a frame whose heading was accepted: lateral offset, width, elevation of the camera."""
        s = self.state
        if isfinite(m.lateral_offset_norm) and 0.0 < m.lateral_offset_norm_std < 10.0:
            self._use_lateral(t_ns, m.lateral_offset_norm, m.lateral_offset_norm_std)
        if isfinite(m.width_per_height) and m.width_per_height > 0.0:
            s.n_width = min(s.n_width + 1, WIDTH_MEMORY_FRAMES)
            old = s.width_per_height if s.n_width > 1 else m.width_per_height
            change = max(-0.2 * old, min(0.2 * old, m.width_per_height - old))
            s.width_per_height = old + change / s.n_width
        if isfinite(m.elevation_rad) and m.elevation_std_rad > 0.0 and attitude is not None:
            mean, variance = s.elevation
            R = ELEVATION_WEIGHT * hypot(m.elevation_std_rad, attitude.std_rad) ** 2
            gain = variance / (variance + R)
            s.elevation = (mean + gain * (m.elevation_rad - mean), (1.0 - gain) * variance)

    def _use_lateral(self, t_ns: int, offset_norm: float, std: float) -> None:
        """Gate a lateral offset; as with headings, what is rejected may win by agreeing."""
        s, c = self.state, self.config
        variance = max(std, c.lateral_std_floor_norm) ** 2
        if s.lateral_acquired and float(self.ekf.P[Y, Y]) > LATERAL_LOST_STD**2:
            s.lateral_acquired, s.lateral_votes = False, ()
        measurement = lateral_model(self.ekf.x, offset_norm, variance)
        if s.lateral_acquired:
            inflated = variance * _inflation(t_ns, s.t_lateral_ns, c.lateral_correlation_s)
            gate = self.ekf.update(measurement, c.lateral_gate_sigma, inflated)
            s.lateral_ratio = gate.test_ratio
            if gate.accepted:
                s.t_lateral_ns, s.n_lateral = t_ns, s.n_lateral + 1
                return
        side = float(measurement.H[Y])
        vote = Vote(t_ns, side * measurement.residual, sqrt(variance), s.n_lateral)
        s.lateral_votes = add_vote(s.lateral_votes, vote, VOTE_AGE_S)
        found = agreement(s.lateral_votes, c.lateral_recovery_spread_norm)
        needed = c.recovery_frames if s.lateral_acquired else min(LATERAL_START_FRAMES, c.start_frames)
        if found is None or found.n_votes < needed or found.share < AGREEING_SHARE:
            return
        if s.n_lateral - found.n_accepted > CONTESTED_SHARE * found.n_votes:
            return
        self._widen(Y, found.value**2 if s.lateral_acquired else UNKNOWN_LATERAL_STD**2)
        value = offset_norm + side * (found.value - side * measurement.residual)
        self.ekf.update(lateral_model(self.ekf.x, value, found.std**2))
        s.lateral_acquired, s.lateral_votes = True, ()
        s.t_lateral_ns, s.n_lateral = t_ns, s.n_lateral + 1


def _inflation(t_ns: int, last_ns: int | None, correlation_s: float) -> float:
    """Factor (1 + rho) / (1 - rho) for errors of a first-order process of this correlation time, sampled apart."""
    if last_ns is None or correlation_s <= 0.0:
        return 1.0
    rho = exp(-max((t_ns - last_ns) * 1e-9, 1e-3) / correlation_s)
    return (1.0 + rho) / (1.0 - rho)
