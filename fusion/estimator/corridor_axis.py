"""Which axis the heading is measured from: takes frames' headings, corrects the filter, returns its state.

What the gate rejects is not thrown away but kept as a vote for another axis, in the dead-reckoned frame, in which
the axis of a corridor stays where it is however the vehicle turns. Once enough votes agree, they mean one of these:

- The filter has gone wrong: the axis is near the expected one, or it is where the axis was when frames last confirmed
  it, or the picture has changed only gradually since then. The covariance is widened in the direction of the
  disagreement, so that the votes' median can be taken in.
- Another corridor: the vehicle itself has turned away from the old axis, and looks along the new one.
- A wall, a side corridor, furniture: neither of these, so it is waited out, unless nothing else is seen for as long
  as the present axis was.

`decide` says which; `start`, `recover` and `enter_corridor` do it.
"""

from __future__ import annotations

from math import isfinite, nan, pi, radians
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from fusion.estimator.config import FusionConfig
from fusion.estimator.models import BIAS, N_STATES, PSI, YAW_OFFSET, V, Y, heading_model
from fusion.estimator.noise_adaptation import SourceNoise
from fusion.estimator.propagation import UNKNOWN_HEADING_STD_RAD
from fusion.estimator.votes import AGREEING_SHARE, Agreement, Vote, add_vote, agreement, is_contested
from vision.rotations import wrap_axis

if TYPE_CHECKING:
    from fusion.estimator.ekf import CorridorEKF

VOTE_AGE_S = 3.0
VOTE_AGE_FRAMES = 15
VOTE_SPACING_S = 0.03
KNOWN_AXIS_RAD = radians(5)
GRADUAL_RAD = radians(6)
ALIGNED_RAD = radians(10)
OBLIQUE_RAD = radians(35)
OBLIQUE_WAIT_S = 1.5
WEAK_SUPPORT_S = 1.5
REAL_CORRIDOR_OFFSETS = 10
GLANCE_S = 3.0


class PreviousAxis(NamedTuple):
    """The corridor left last: axis in the dead-reckoned frame, index, turn, when, lateral offsets used by then."""

    axis_rad: float
    corridor_index: int
    corridor_turn_rad: float
    left_ns: int
    n_lateral: int


class FrameAxis(NamedTuple):
    """A heading that a picture showed, and whether no jump lies between it and one that the filter accepted."""

    t_ns: int
    heading_rad: float
    linked: bool


class Rival(NamedTuple):
    """An axis that rejected frames agree on, dead-reckoned; since when, and seen last."""

    axis_rad: float
    since_ns: int
    last_ns: int


class CorridorAxis(NamedTuple):
    """What is known of the axis that the heading is measured from.

    Parameters
    ----------
    acquired, ever_acquired
        Whether a heading was found and not lost since, and whether ever.
    corridor_index, n_corridors, corridor_turn_rad
        The corridor being flown, how many there were, and the angle of its axis from the first one's.
    reset_count, reset_heading_rad
        How often the heading jumped, and its last step.
    t_vision_ns, n_accepted
        When a frame was last used, and how many have been.
    support_s
        Time over which frames have confirmed the present axis.
    anchor_rad
        Axis in the dead-reckoned frame when a frame last confirmed it.
    facing_rad
        pi where the vehicle then faced against the axis.
    noise, test_ratio
        Of the frames' headings; of the last innovation.
    votes
        Rejected headings, as axes in the dead-reckoned frame.
    recent
        The last headings that pictures showed.
    rival
        Axis that rejected frames agree on.
    previous
        The corridor left last.
    """

    acquired: bool = False
    ever_acquired: bool = False
    corridor_index: int = 0
    n_corridors: int = 1
    corridor_turn_rad: float = 0.0
    reset_count: int = 0
    reset_heading_rad: float = 0.0
    t_vision_ns: int | None = None
    n_accepted: int = 0
    support_s: float = 0.0
    anchor_rad: float = nan
    facing_rad: float = 0.0
    noise: SourceNoise = SourceNoise()
    test_ratio: float = nan
    votes: tuple[Vote, ...] = ()
    recent: tuple[FrameAxis, ...] = ()
    rival: Rival | None = None
    previous: PreviousAxis | None = None

    def lost(self) -> CorridorAxis:
        """Let the next headings start anew."""
        return self._replace(acquired=False, votes=())

    def clock_set_back(self) -> CorridorAxis:
        """Start anew; corridors and counts stay."""
        return self.lost()._replace(t_vision_ns=None, recent=(), previous=None)

    def confirmed(self, ekf: CorridorEKF, t_ns: int, theta_rad: float) -> CorridorAxis:
        """Note that the present axis was seen at a time and a dead-reckoned heading."""
        support_s = self.support_s
        if self.t_vision_ns is not None:
            support_s += min((t_ns - self.t_vision_ns) * 1e-9, 0.5)
        psi = float(ekf.x[PSI])
        return self._replace(
            support_s=support_s,
            t_vision_ns=t_ns,
            n_accepted=self.n_accepted + 1,
            anchor_rad=theta_rad - psi,
            facing_rad=psi - wrap_axis(psi),
        )

    def followed(
        self, t_ns: int, heading_rad: float, accepted: bool, frame_interval_s: float
    ) -> tuple[FrameAxis, ...]:
        """Follow the axis through the pictures alone; return ``recent`` with a frame's heading.

        Parameters
        ----------
        t_ns, heading_rad, accepted
            Of the frame, and whether the filter took it.
        frame_interval_s
            Mean time between frames; NaN where unknown.
        """
        reach_ns = round(max(0.4, 2.5 * frame_interval_s if isfinite(frame_interval_s) else 0.0) * 1e9)
        linked = accepted or any(
            known and t_ns - t <= reach_ns and abs(wrap_axis(heading_rad - heading)) < GRADUAL_RAD
            for t, heading, known in self.recent
        )
        return (*self.recent[-3:], FrameAxis(t_ns, heading_rad, linked))

    def voted(
        self, t_ns: int, axis_rad: float, std_rad: float, linked: bool, frame_interval_s: float
    ) -> CorridorAxis:
        """Keep a heading as a vote.

        Parameters
        ----------
        t_ns, axis_rad, std_rad
            Of the frame; axis in the dead-reckoned frame.
        linked
            See `FrameAxis`.
        frame_interval_s
            Mean time between frames; NaN where unknown.
        """
        if self.votes and (t_ns - self.votes[-1].t_ns) * 1e-9 < VOTE_SPACING_S:
            return self  # a fast camera's frames resemble each other, and would crowd out the older ones
        interval = frame_interval_s if isfinite(frame_interval_s) else 0.0
        age_s = max(VOTE_AGE_S, VOTE_AGE_FRAMES * interval)
        vote = Vote(t_ns, axis_rad, std_rad, self.n_accepted, linked)
        return self._replace(votes=add_vote(self.votes, vote, age_s))

    def stepped(self, ekf: CorridorEKF, before_rad: float) -> CorridorAxis:
        """Count a jump of the heading from ``before_rad`` to what it is now."""
        step_rad = float(ekf.x[PSI]) - before_rad
        return self._replace(reset_count=self.reset_count + 1, reset_heading_rad=step_rad)


class Recovery(NamedTuple):
    """The filter has gone wrong: the heading is another one."""

    heading_rad: float
    std_rad: float


class NewCorridor(NamedTuple):
    """The heading is to be measured from another axis, that of another corridor unless ``same_corridor``."""

    heading_rad: float
    axis_rad: float
    std_rad: float
    same_corridor: bool


def start(
    axis: CorridorAxis, ekf: CorridorEKF, t_ns: int, theta_rad: float, coupled: bool, config: FusionConfig
) -> CorridorAxis:
    """Find the first heading, or the first after loss: the median of frames that agree.

    Parameters
    ----------
    axis
        Part of the state, with the newest frame's vote; it comes back acquired if enough agree.
    ekf
        Filter to correct.
    t_ns, theta_rad
        Now, and the dead-reckoned heading.
    coupled
        Whether the IMU's yaw offset is correlated with the heading.
    config
        Settings.
    """
    found = agreement(axis.votes, config.recovery_spread_rad, wrap_axis)
    if found is None or found.n_votes < config.start_frames or found.share < AGREEING_SHARE:
        return axis
    heading = wrap_axis(theta_rad - found.value)
    before = float(ekf.x[PSI])
    if axis.ever_acquired:
        _widen_heading(ekf, wrap_axis(heading - before), coupled)
    elif float(ekf.P[PSI, PSI]) < UNKNOWN_HEADING_STD_RAD**2:
        ekf.widen(PSI, UNKNOWN_HEADING_STD_RAD**2)
    ekf.update(heading_model(ekf.x, heading, found.std**2))
    if axis.ever_acquired:
        axis = axis.stepped(ekf, before)
    return axis._replace(acquired=True, ever_acquired=True, votes=()).confirmed(ekf, t_ns, theta_rad)


def decide(
    axis: CorridorAxis,
    psi_rad: float,
    t_ns: int,
    theta_rad: float,
    frame_interval_s: float,
    config: FusionConfig,
) -> tuple[CorridorAxis, Recovery | NewCorridor | None]:
    """Decide what the votes mean, if enough of them agree.

    Parameters
    ----------
    axis
        Part of the state, with the newest frame's vote.
    psi_rad
        The filter's heading.
    t_ns, theta_rad
        Now, and the dead-reckoned heading.
    frame_interval_s
        Mean time between frames.
    config
        Settings.
    """
    c = config
    found = agreement(axis.votes, c.recovery_spread_rad, wrap_axis)
    if found is None or found.n_votes < min(c.recovery_frames, c.junction_frames):
        return axis, None
    rival = _rival(axis, t_ns, found, frame_interval_s)
    lasting_s = (t_ns - rival.since_ns) * 1e-9
    if is_contested(found, axis.n_accepted):
        return axis._replace(rival=None), None  # other frames still see the present axis
    axis = axis._replace(rival=rival)
    heading = wrap_axis(theta_rad - found.value)
    distance = abs(wrap_axis(heading - psi_rad))
    linked = found.linked_share > 0.5
    at_anchor = abs(wrap_axis(found.value - axis.anchor_rad)) < KNOWN_AXIS_RAD
    enough = found.n_votes >= c.recovery_frames
    if distance < c.junction_min_turn_rad or linked or at_anchor:
        if not enough:
            return axis, None
        expected = psi_rad
        if at_anchor:
            expected = theta_rad - axis.anchor_rad
        elif linked:
            expected = heading + axis.facing_rad
        return axis, Recovery(_facing(heading, expected), found.std)
    if _has_turned_into(axis, theta_rad, heading, found, lasting_s, c):
        return axis, NewCorridor(heading, found.value, found.std, same_corridor=False)
    if enough and lasting_s >= min(c.axis_jump_hold_s, 0.3 + axis.support_s):
        # No turn explains it: the axis taken up before was the wrong one.
        if axis.corridor_index == 0:
            return axis, Recovery(_facing(heading, psi_rad), found.std)
        return axis, NewCorridor(heading, found.value, found.std, same_corridor=True)
    return axis, None


def recover(
    axis: CorridorAxis, ekf: CorridorEKF, found: Recovery, t_ns: int, theta_rad: float, coupled: bool
) -> CorridorAxis:
    """Let the covariance admit the heading that the votes agree on, and take in their median.

    Parameters
    ----------
    axis, ekf, t_ns, theta_rad, coupled
        As in `start`.
    found
        What the votes say.
    """
    before = float(ekf.x[PSI])
    _widen_heading(ekf, found.heading_rad - before, coupled)
    expected = heading_model(ekf.x, found.heading_rad, found.std_rad**2)
    ekf.update(expected._replace(residual=found.heading_rad - before))
    axis = axis.stepped(ekf, before)._replace(votes=(), rival=None)
    return axis.confirmed(ekf, t_ns, theta_rad)


class Crossing(NamedTuple):
    """What else changes with the corridor.

    Parameters
    ----------
    coupled
        Whether the IMU's yaw offset is correlated with the heading.
    y_variance, v_variance
        Of the lateral offset and its unexplained velocity in a corridor of which nothing is known.
    n_lateral
        How many lateral offsets have been used.
    """

    coupled: bool
    y_variance: float
    v_variance: float
    n_lateral: int


def enter_corridor(
    axis: CorridorAxis,
    ekf: CorridorEKF,
    found: NewCorridor,
    t_ns: int,
    theta_rad: float,
    crossing: Crossing,
    config: FusionConfig,
) -> CorridorAxis:
    """Measure the heading from another corridor's axis from now on.

    As a transition: the new heading is what the votes say, independent of the old; the offset takes up the
    difference, so that the IMU's yaw, psi + turn + o, goes on as it was; the lateral state is unknown.

    Parameters
    ----------
    axis, ekf, t_ns, theta_rad, config
        As in `start`.
    found
        What the votes say.
    crossing
        What else changes.
    """
    psi, bias, offset, *_ = ekf.x.tolist()
    turn = axis.corridor_turn_rad + psi - found.heading_rad
    variance = found.std_rad**2
    F, Q = np.zeros((N_STATES, N_STATES)), np.zeros((N_STATES, N_STATES))
    F[BIAS, BIAS] = F[YAW_OFFSET, YAW_OFFSET] = 1.0
    Q[PSI, PSI] = Q[YAW_OFFSET, YAW_OFFSET] = variance
    if crossing.coupled:
        F[YAW_OFFSET, PSI] = 1.0
        Q[PSI, YAW_OFFSET] = Q[YAW_OFFSET, PSI] = -variance
    else:
        Q[YAW_OFFSET, YAW_OFFSET] += float(ekf.P[PSI, PSI])
    Q[Y, Y], Q[V, V] = crossing.y_variance, crossing.v_variance
    ekf.predict(np.array([found.heading_rad, bias, offset, 0.0, 0.0]), F, Q)
    index = axis.corridor_index
    left = PreviousAxis(theta_rad - psi, index, axis.corridor_turn_rad, t_ns, crossing.n_lateral)
    back = axis.previous
    recent = back is not None and _is_glance(back, t_ns, crossing.n_lateral, config)
    if back is not None and recent and abs(wrap_axis(found.axis_rad - back.axis_rad)) < 2 * KNOWN_AXIS_RAD:
        index = back.corridor_index  # the vehicle came back: it was no other corridor
    elif found.same_corridor or (recent and axis.support_s < WEAK_SUPPORT_S):
        left = back or left  # the right axis of the corridor just entered; the first guess was a wall's
    else:
        index = axis.n_corridors
    axis = axis.stepped(ekf, psi)._replace(
        corridor_index=index,
        n_corridors=max(axis.n_corridors, index + 1),
        previous=left,
        corridor_turn_rad=turn,
        votes=(),
        rival=None,
        support_s=0.0,
    )
    return axis.confirmed(ekf, t_ns, theta_rad)


def _facing(heading_rad: float, expected_rad: float) -> float:
    """Choose the end of the corridor that the vehicle faces, which a frame cannot tell."""
    return heading_rad + pi * round((expected_rad - heading_rad) / pi)


def _rival(axis: CorridorAxis, t_ns: int, found: Agreement, frame_interval_s: float) -> Rival:
    """Follow the axis that votes agree on, also beyond the votes' own age."""
    first_ns = found.first_ns
    if axis.rival is not None:
        alive = (t_ns - axis.rival.last_ns) * 1e-9 <= max(1.0, 5.0 * frame_interval_s)
        if alive and abs(wrap_axis(axis.rival.axis_rad - found.value)) < KNOWN_AXIS_RAD:
            first_ns = min(first_ns, axis.rival.since_ns)
    return Rival(found.value, first_ns, t_ns)


def _has_turned_into(
    axis: CorridorAxis,
    theta_rad: float,
    heading_rad: float,
    found: Agreement,
    lasting_s: float,
    c: FusionConfig,
) -> bool:
    """Whether the vehicle's own turn makes the agreed axis that of another corridor, ``heading_rad`` off it."""
    turned = theta_rad - axis.anchor_rad
    oblique = abs(heading_rad)
    if abs(turned) < c.junction_min_turn_rad or oblique > OBLIQUE_RAD:
        return False
    if oblique + radians(5) > abs(wrap_axis(turned)):
        return False
    wait_s = c.junction_time_s + OBLIQUE_WAIT_S * max(
        0.0, (oblique - ALIGNED_RAD) / (OBLIQUE_RAD - ALIGNED_RAD)
    )
    return found.n_votes >= c.junction_frames and lasting_s >= wait_s and found.share >= AGREEING_SHARE


def _widen_heading(ekf: CorridorEKF, error_rad: float, coupled: bool) -> None:
    """Widen along an error of the heading that leaves psi + o, what the IMU's yaw has shown, as it was."""
    Q = np.zeros((N_STATES, N_STATES))
    Q[PSI, PSI] = Q[YAW_OFFSET, YAW_OFFSET] = error_rad**2
    if coupled:
        Q[PSI, YAW_OFFSET] = Q[YAW_OFFSET, PSI] = -(error_rad**2)
    ekf.predict(ekf.x, np.eye(N_STATES), Q)


def _is_glance(back: PreviousAxis, t_ns: int, n_lateral: int, config: FusionConfig) -> bool:
    """Whether the present corridor may still turn out to be a wall or a side corridor looked at in passing."""
    since_s = (t_ns - back.left_ns) * 1e-9
    two_sided = n_lateral - back.n_lateral >= REAL_CORRIDOR_OFFSETS  # a wall shows one side
    return since_s <= (GLANCE_S if two_sided else config.junction_revert_s)
