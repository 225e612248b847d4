"""The engine's third part, what frames say of the axis: start, votes against it, recovery, other corridors.

What the gate rejects is not thrown away but put by as a vote for another axis, in the dead-reckoned frame, in which
the axis of a corridor stays where it is however the vehicle turns. Once enough votes agree, they mean one of three
things:

- The filter has gone wrong: the axis is near the expected one, or it is where the axis was when frames last confirmed
  it, or the picture has changed only gradually since then. The covariance is widened in the direction of the
  disagreement, so that the votes' median can be taken in.
- Another corridor: the vehicle itself has turned away from the old axis, and looks along the new one.
- A wall, a side corridor, furniture: neither of these, so it is waited out, unless nothing else is seen for as long
  as the present axis was.
"""

from __future__ import annotations

from math import isfinite, nan, pi, radians

import numpy as np

from fusion.estimator.imu_yaw import ImuYaw
from fusion.estimator.models import BIAS, N_STATES, OFFSET, PSI, V, Y, heading_model, wrap_axis
from fusion.estimator.range_width import Widths
from fusion.estimator.state import UNKNOWN_HEADING_STD_RAD, UNKNOWN_LATERAL_STD, PreviousAxis
from fusion.estimator.votes import Agreement, Vote, add_vote, agreement

VOTE_AGE_S = 3.0
VOTE_AGE_FRAMES = 15
VOTE_SPACING_S = 0.03
AGREEING_SHARE = 0.4
CONTESTED_SHARE = 0.25
KNOWN_AXIS_RAD = radians(5)
GRADUAL_RAD = radians(6)
ALIGNED_RAD = radians(10)
OBLIQUE_RAD = radians(35)
OBLIQUE_WAIT_S = 1.5
WEAK_SUPPORT_S = 1.5
REAL_CORRIDOR_OFFSETS = 10
GLANCE_S = 3.0


class Axes(ImuYaw):
    """The part of the engine that knows which axis the heading is measured from."""

    def _confirm(self, t_ns: int) -> None:
        """Note that the present axis was seen."""
        s = self.state
        if s.t_vision_ns is not None:
            s.support_s += min((t_ns - s.t_vision_ns) * 1e-9, 0.5)
        s.t_vision_ns = t_ns
        s.n_accepted += 1
        psi = float(self.ekf.x[PSI])
        s.anchor_rad, s.facing_rad = s.theta_rad - psi, psi - wrap_axis(psi)

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
        before = float(self.ekf.x[PSI])
        if s.ever_acquired:
            self._widen_heading(wrap_axis(heading - before))
        elif float(self.ekf.P[PSI, PSI]) < UNKNOWN_HEADING_STD_RAD**2:
            self._widen(PSI, UNKNOWN_HEADING_STD_RAD**2)
        self.ekf.update(heading_model(self.ekf.x, heading, found.std**2))
        if s.ever_acquired:
            self._note_step(before)
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
        linked = found.linked_share > 0.5
        at_anchor = abs(wrap_axis(found.value - s.anchor_rad)) < KNOWN_AXIS_RAD
        if distance < c.junction_min_turn_rad or linked or at_anchor:
            if found.n_votes >= c.recovery_frames:
                self._recover(t_ns, self._facing(heading, at_anchor, linked), found)
        elif self._has_turned_into(heading, found, lasting_s):
            self._change_corridor(t_ns, heading, found)
        elif found.n_votes >= c.recovery_frames and lasting_s >= self._patience_s():
            # No turn explains it: the axis taken up before was the wrong one.
            if s.corridor_index == 0:
                self._recover(t_ns, self._facing(heading, False, False), found)
            else:
                self._change_corridor(t_ns, heading, found, same_corridor=True)

    def _facing(self, heading_rad: float, at_anchor: bool, linked: bool) -> float:
        """Choose the end of the corridor that the vehicle faces, which a frame cannot tell."""
        s = self.state
        expected = float(self.ekf.x[PSI])
        if at_anchor:
            expected = s.theta_rad - s.anchor_rad
        elif linked:
            expected = heading_rad + s.facing_rad
        return heading_rad + pi * round((expected - heading_rad) / pi)

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
        self._widen_heading(heading_rad - before)
        expected = heading_model(self.ekf.x, heading_rad, found.std**2)
        self.ekf.update(expected._replace(residual=heading_rad - before))
        self._note_step(before)
        s.votes, s.rival = (), None
        s.yaw_watch = s.yaw_watch.interrupted()
        self._confirm(t_ns)

    def _note_step(self, before_rad: float) -> None:
        """Count a jump of the heading from ``before_rad`` to what it is now."""
        s = self.state
        s.reset_count += 1
        s.reset_heading_rad = float(self.ekf.x[PSI]) - before_rad

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
        self._lose_lateral()
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
        self._note_step(psi)
        s.votes, s.rival = (), None
        s.t_lateral_ns = None
        s.width_per_height, s.n_width, s.widths = nan, 0, Widths()
        s.support_s = 0.0
        s.yaw_watch = s.yaw_watch.interrupted()
        self._confirm(t_ns)

    def _is_glance(self, t_ns: int, back: PreviousAxis) -> bool:
        """Whether the present corridor may still turn out to be a wall or a side corridor looked at in passing."""
        since_s = (t_ns - back.left_ns) * 1e-9
        two_sided = self.state.n_lateral - back.n_lateral >= REAL_CORRIDOR_OFFSETS  # a wall shows one side
        return since_s <= (GLANCE_S if two_sided else self.config.junction_revert_s)
