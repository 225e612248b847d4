"""Junctions: decides whether votes against the present axis mean another corridor, a wrong heading, or nothing.

Once enough votes agree (`fusion.estimator.votes`), there are three cases:

- The filter has diverged: the agreed axis is the one that frames last confirmed, or the votes are linked to frames
  that the filter accepted. The heading is reset to the votes' median (`fusion.estimator.axis_acquisition.recover`).
- Another corridor: the vehicle has turned away from the old axis by at least `FusionConfig.junction_min_turn_rad` and
  faces along the agreed one, within `OBLIQUE_RAD`, for `FusionConfig.junction_time_s` and longer if it is oblique.
  `enter_corridor` changes the axis.
- Otherwise the votes come from a wall, a side corridor or furniture and are ignored, unless frames show nothing else
  for `FusionConfig.axis_jump_hold_s`, or for as long as they had shown the present axis: then that was wrong.
"""

from __future__ import annotations

from math import pi, radians, sqrt
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from fusion.estimator.axis_acquisition import Recovery
from fusion.estimator.config import FusionConfig
from fusion.estimator.corridor_axis import CorridorAxis, PreviousAxis, Rival
from fusion.estimator.models import BIAS, N_STATES, PSI, YAW_OFFSET
from fusion.estimator.votes import AGREEING_SHARE, Agreement, agreement, is_contested
from vision.rotations import wrap, wrap_axis

if TYPE_CHECKING:
    from fusion.estimator.ekf import CorridorEKF

KNOWN_AXIS_RAD = radians(5)
ALIGNED_RAD = radians(10)
OBLIQUE_RAD = radians(35)
OBLIQUE_WAIT_S = 1.5
WEAK_SUPPORT_S = 1.5
REAL_CORRIDOR_OFFSETS = 10
GLANCE_S = 3.0


class NewCorridor(NamedTuple):
    """Another axis to measure the heading from; that of another corridor unless ``same_corridor``."""

    heading_rad: float
    axis_rad: float
    std_rad: float
    same_corridor: bool


def decide(
    axis: CorridorAxis,
    psi_rad: float,
    psi_std: float,
    t_ns: int,
    theta_rad: float,
    frame_interval_s: float,
    config: FusionConfig,
) -> tuple[CorridorAxis, Recovery | NewCorridor | None]:
    """Apply the module's decision rule; return the axis, and the recovery or new corridor, if any.

    Parameters
    ----------
    axis
        Part of the state, with the newest frame's vote.
    psi_rad, psi_std
        The filter's heading and its standard deviation.
    t_ns, theta_rad
        Time now, and the dead-reckoned heading.
    frame_interval_s
        Mean time between frames.
    config
        Settings.
    """
    c = config
    found = agreement(axis.votes, c.recovery_spread_rad, wrap_axis)
    if found is None or found.n_votes < min(c.recovery_frames, c.junction_frames):
        return axis, None
    rival = _rival(axis, t_ns, found, psi_std, frame_interval_s)
    lasting_s = (t_ns - rival.since_ns) * 1e-9
    if is_contested(found, axis.n_accepted):
        return axis._replace(rival=None), None  # other frames still show the present axis
    axis = axis._replace(rival=rival)
    heading = wrap_axis(theta_rad - found.value)
    linked = found.linked_share > 0.5
    # Sigma of the anchor's drift until the first vote: what has drifted since moves the votes one by one.
    drifted = c.gyro_noise * sqrt(max(rival.since_ns - axis.anchor_ns, 0) * 1e-9)
    at_anchor = abs(wrap_axis(found.value - axis.anchor_rad)) < rival.reach(c, drifted)
    enough = found.n_votes >= c.recovery_frames
    if linked or at_anchor:
        if not enough:
            return axis, None
        expected = psi_rad
        if at_anchor:
            expected = theta_rad - axis.anchor_rad
        elif linked:
            expected = heading + axis.facing_rad
        return axis, Recovery(_facing(heading, expected), found.std)
    differs = abs(wrap_axis(heading - psi_rad)) >= c.junction_min_turn_rad
    if differs and _has_turned_into(axis, theta_rad, heading, found, lasting_s, c):
        return axis, NewCorridor(heading, found.value, found.std, same_corridor=False)
    if enough and lasting_s >= min(c.axis_jump_hold_s, 0.3 + axis.support_s):
        # No turn explains the votes: the present axis is the wrong one.
        if axis.corridor_index == 0:
            return axis, Recovery(_facing(heading, psi_rad), found.std)
        return axis, NewCorridor(heading, found.value, found.std, same_corridor=True)
    return axis, None


class Crossing(NamedTuple):
    """Further state that a change of corridor depends on.

    Parameters
    ----------
    corrects_heading
        Whether the IMU's yaw offset is correlated with the heading.
    n_lateral
        Number of lateral offsets used so far.
    """

    corrects_heading: bool
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

    The change is a transition of the filter: the new heading is the votes' median, independent of the old heading.
    The yaw offset o absorbs the difference, so that the predicted IMU yaw, psi + turn + o, is unchanged.

    Parameters
    ----------
    axis, ekf, t_ns, theta_rad, config
        As in `fusion.estimator.axis_acquisition.acquire`.
    found
        The new axis.
    crossing
        Further state that it depends on.
    """
    psi, bias, offset = ekf.x.tolist()
    turn = wrap(axis.corridor_turn_rad + psi - found.heading_rad)  # the vehicle may have spun
    variance = found.std_rad**2
    F, Q = np.zeros((N_STATES, N_STATES)), np.zeros((N_STATES, N_STATES))
    F[BIAS, BIAS] = F[YAW_OFFSET, YAW_OFFSET] = 1.0
    Q[PSI, PSI] = Q[YAW_OFFSET, YAW_OFFSET] = variance
    if crossing.corrects_heading:
        F[YAW_OFFSET, PSI] = 1.0
        Q[PSI, YAW_OFFSET] = Q[YAW_OFFSET, PSI] = -variance
    else:
        Q[YAW_OFFSET, YAW_OFFSET] += float(ekf.P[PSI, PSI])
    ekf.predict(np.array([found.heading_rad, bias, offset]), F, Q)
    index = axis.corridor_index
    left = PreviousAxis(theta_rad - psi, index, axis.corridor_turn_rad, t_ns, crossing.n_lateral)
    back = axis.previous
    recent = back is not None and _is_glance(back, t_ns, crossing.n_lateral, config)
    if back is not None and recent and abs(wrap_axis(found.axis_rad - back.axis_rad)) < 2 * KNOWN_AXIS_RAD:
        index = back.corridor_index  # the vehicle came back: the axis left now was no corridor
    elif found.same_corridor or (recent and axis.support_s < WEAK_SUPPORT_S):
        left = back or left  # a better axis of the corridor just entered; the first one was that of a wall
    else:
        index = axis.n_corridors
    axis = axis.with_reset(ekf, psi)._replace(
        corridor_index=index,
        n_corridors=max(axis.n_corridors, index + 1),
        previous=left,
        corridor_turn_rad=turn,
        votes=(),
        rival=None,
        support_s=0.0,
        stamps_suspect=False,
    )
    return axis.confirmed(ekf, t_ns, theta_rad)


def _facing(heading_rad: float, expected_rad: float) -> float:
    """Resolve the ambiguity of half a turn: choose the heading nearest to the expected one."""
    return heading_rad + pi * round((expected_rad - heading_rad) / pi)


def _rival(axis: CorridorAxis, t_ns: int, found: Agreement, psi_std: float, frame_interval_s: float) -> Rival:
    """Track the axis that votes agree on for longer than the votes themselves are kept."""
    first_ns = found.first_ns
    if axis.rival is not None:
        alive = (t_ns - axis.rival.last_ns) * 1e-9 <= max(1.0, 5.0 * frame_interval_s)
        if alive and abs(wrap_axis(axis.rival.axis_rad - found.value)) < KNOWN_AXIS_RAD:
            first_ns, psi_std = min(first_ns, axis.rival.since_ns), min(psi_std, axis.rival.psi_std_rad)
    return Rival(found.value, first_ns, t_ns, psi_std)


def _has_turned_into(
    axis: CorridorAxis,
    theta_rad: float,
    heading_rad: float,
    found: Agreement,
    lasting_s: float,
    c: FusionConfig,
) -> bool:
    """Whether the vehicle has turned into another corridor along the agreed axis, at ``heading_rad`` from it."""
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


def _is_glance(back: PreviousAxis, t_ns: int, n_lateral: int, config: FusionConfig) -> bool:
    """Whether the present corridor may still be a wall or a side corridor seen in passing."""
    since_s = (t_ns - back.left_ns) * 1e-9
    two_sided = n_lateral - back.n_lateral >= REAL_CORRIDOR_OFFSETS  # a single wall gives no lateral offset
    return since_s <= (GLANCE_S if two_sided else config.junction_revert_s)
