"""Decides whether a velocity is along the body's axes or the world's, by comparison with the pose.

State estimators log velocities in the world's axes (EuRoC's ``v_RS_R``, VINS-Mono's odometry), flight controllers
and ROS drivers in the body's. With the wrong axes, the velocity is right at only one heading.
"""

from __future__ import annotations

from enum import StrEnum

import numpy as np

from fusion.flight import FloatArray, TimeArray
from fusion.logs.series import QUATERNION_TOLERANCE, into_body

WINDOW_S = 0.5
MIN_WINDOWS = 8
MIN_TURNED = 0.1  # of the speed; below it, both interpretations are the same
CLEARLY = 3.0  # ratio of the residuals' root mean squares
EXPLAINED = 0.5  # largest residual of the better one, as a share of the displacement's root mean square


class Axes(StrEnum):
    """Axes of a velocity."""

    BODY = "body"
    WORLD = "world"
    EITHER = "either"  # the same: the vehicle keeps to the world's axes


def axes_of_velocity(
    t_ns: TimeArray, position: FloatArray | None, q_world_body: FloatArray, velocity: FloatArray
) -> Axes | None:
    """Compare displacements with the velocity's integral, without and with rotation by the attitude.

    Parameters
    ----------
    t_ns
        Times (n,) of the rows.
    position
        Positions (n, 3) in the world; None if the log has none.
    q_world_body
        Quaternions (n, 4), w x y z, body to the same world.
    velocity
        Velocities (n, 3) along the body's axes or the world's.

    Returns
    -------
    Axes or None
        None if the data do not determine them.
    """
    good = np.abs(np.linalg.norm(q_world_body, axis=1) - 1.0) <= QUATERNION_TOLERANCE
    good &= np.isfinite(velocity).all(axis=1)
    good &= np.concatenate([[True], np.diff(t_ns) > 0])
    if position is not None:
        good &= np.isfinite(position).all(axis=1)
    if np.count_nonzero(good) < MIN_WINDOWS:
        return None
    conjugate = q_world_body[good] * np.array([1.0, -1.0, -1.0, -1.0])
    as_world = velocity[good]
    as_body = into_body(conjugate, as_world)  # in the world, if it is along the body's axes
    if _rms(as_body - as_world) < MIN_TURNED * _rms(as_world):
        return Axes.EITHER
    if position is None:
        return None
    t_s = (t_ns[good] - t_ns[good][0]) * 1e-9
    ends = np.unique(np.searchsorted(t_s, np.arange(0.0, t_s[-1], WINDOW_S)))
    length_s = np.diff(t_s[ends])
    ends = np.stack([ends[:-1], ends[1:]], axis=1)[length_s < 3.0 * WINDOW_S]
    if len(ends) < MIN_WINDOWS:
        return None
    moved = np.diff(position[good][ends], axis=1)[:, 0]
    left = {
        axes: _typical(moved - np.diff(_integral(t_s, values)[ends], axis=1)[:, 0])
        for axes, values in ((Axes.WORLD, as_world), (Axes.BODY, as_body))
    }
    best, other = sorted(left, key=lambda axes: left[axes])
    clear = left[other] > CLEARLY * left[best] and left[best] < EXPLAINED * _typical(moved)
    return best if clear else None


def _integral(t_s: FloatArray, values: FloatArray) -> FloatArray:
    steps = np.diff(t_s)[:, None] * (values[1:] + values[:-1]) / 2.0
    return np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])


def _rms(vectors: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.sum(vectors**2, axis=1))))


def _typical(vectors: FloatArray) -> float:
    """Median length, robust against jumps of a corrected pose."""
    return float(np.median(np.linalg.norm(vectors, axis=1)))
