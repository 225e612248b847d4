"""Values set by the caller: a heading, or the corridor's width, at a time.

They are samples like the sensors': late ones are sorted in, and the samples after them are replayed.
"""

from __future__ import annotations

from math import isfinite
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from fusion.estimator.corridor_axis import CorridorAxis
from fusion.estimator.input_checks import MAX_ANGLE_STD_RAD, number, whole_nanoseconds
from fusion.estimator.models import N_STATES, PSI, YAW_OFFSET
from vision.errors import InputError
from vision.rotations import wrap

if TYPE_CHECKING:
    from fusion.estimator.ekf import CorridorEKF

MIN_STD_RAD = 1e-4
MIN_WIDTH_M, MAX_WIDTH_M = 0.2, 100.0


class HeadingSeed(NamedTuple):
    """A heading from the corridor's axis, rad, with its sigma; over the full circle, unlike a frame's."""

    t_ns: int
    heading_rad: float
    std_rad: float

    @classmethod
    def checked(cls, t_ns: int, heading_rad: float, std_rad: float) -> HeadingSeed:
        """Check the caller's values; raise `InputError` if they are impossible."""
        heading, std = number(heading_rad, "heading_rad"), number(std_rad, "heading_std_rad")
        if not isfinite(heading):
            raise InputError(f"heading_rad = {heading} is not finite", remedy="give radians, or no seed")
        if not MIN_STD_RAD <= std <= MAX_ANGLE_STD_RAD:
            raise InputError(
                f"heading_std_rad = {std} is not within {MIN_STD_RAD:g} and pi",
                remedy="say how far the heading may be off, in radians: 0.1 for some 6 degrees",
            )
        return cls(whole_nanoseconds(t_ns), heading, std)

    def fault(self) -> str:
        """Return no fault: `checked` has validated the values."""
        return ""


class WidthChange(NamedTuple):
    """The corridor's width from a time on, metres; None: it is estimated again, if a sensor allows."""

    t_ns: int
    width_m: float | None

    @classmethod
    def checked(cls, t_ns: int, width_m: float | None) -> WidthChange:
        """Check the caller's value; raise `InputError` if it is impossible."""
        width = None if width_m is None else number(width_m, "corridor_width_m")
        if width is not None and not MIN_WIDTH_M <= width <= MAX_WIDTH_M:
            raise InputError(
                f"corridor_width_m = {width} is not within {MIN_WIDTH_M:g} and {MAX_WIDTH_M:g} m",
                remedy="give metres from wall to wall, or None where it is not known",
            )
        return cls(whole_nanoseconds(t_ns), width)

    def fault(self) -> str:
        """Return no fault: `checked` has validated the values."""
        return ""


def seed_heading(
    axis: CorridorAxis, ekf: CorridorEKF, seed: HeadingSeed, theta_rad: float, corrects_heading: bool
) -> CorridorAxis:
    """Replace the heading by a seed, independent of the previous estimate; the gyroscope's bias is kept.

    The yaw offset o absorbs the difference, so that the predicted IMU yaw, psi + turn + o, is unchanged.

    Parameters
    ----------
    axis
        Part of the state.
    ekf
        Filter to change, at the seed's time.
    seed
        The heading.
    theta_rad
        Dead-reckoned heading.
    corrects_heading
        Whether the IMU's yaw offset is correlated with the heading.
    """
    psi, bias, offset = ekf.x.tolist()
    step, variance = wrap(seed.heading_rad - psi), seed.std_rad**2
    F, Q = np.eye(N_STATES), np.zeros((N_STATES, N_STATES))
    F[PSI] = 0.0
    Q[PSI, PSI] = Q[YAW_OFFSET, YAW_OFFSET] = variance
    if corrects_heading:
        F[YAW_OFFSET, PSI] = 1.0
        Q[PSI, YAW_OFFSET] = Q[YAW_OFFSET, PSI] = -variance
    else:
        Q[YAW_OFFSET, YAW_OFFSET] += float(ekf.P[PSI, PSI])
    ekf.predict(np.array([psi + step, bias, offset - step]), F, Q)
    if axis.ever_acquired:
        axis = axis.with_reset(ekf, psi)
    axis = axis._replace(
        acquired=True, ever_acquired=True, votes=(), recent=(), rival=None, stamps_suspect=False
    )
    return axis.confirmed(ekf, seed.t_ns, theta_rad)
