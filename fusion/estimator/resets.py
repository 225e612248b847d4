"""Jumps of the published estimate: compares the newest state before and after a sample, and counts them.

The engine counts its own resets in the state, but a late sample rolls the state back and may undo a reset or add one
in the past. A controller cannot roll back what it has read. So the published count is kept here, outside the states,
and never decreases: a difference of the newest state to the one before, beyond dead reckoning and beyond an ordinary
correction of `STEP_RAD`, is one more jump.
"""

from __future__ import annotations

from math import isfinite, radians
from typing import TYPE_CHECKING, NamedTuple

from fusion.estimator.lateral.gaussian_sum import OffsetModel
from fusion.estimator.lateral.status import JUMP_NORM, Lateral, reliable
from fusion.estimator.models import BIAS, PSI
from fusion.estimator.propagation import ImuSample
from vision.rotations import wrap

if TYPE_CHECKING:
    from fusion.estimator.state import Sample, State

STEP_RAD = radians(2)  # a larger single correction is a jump, for instance by the first frame after a gap


class Resets(NamedTuple):
    """Jumps of the published heading and lateral offset.

    Parameters
    ----------
    heading_count, heading_rad, heading_total_rad
        Number of jumps of the heading, the last one, new minus old, and the sum of all.
    lateral_count, lateral_norm, lateral_m, lateral_total_norm
        The same for the lateral offset; half widths, and metres if the width is known.
    lost_rad
        The last known heading while the heading is unknown after a reset; else None.
    """

    heading_count: int = 0
    heading_rad: float = 0.0
    heading_total_rad: float = 0.0
    lateral_count: int = 0
    lateral_norm: float = 0.0
    lateral_m: float = 0.0
    lateral_total_norm: float = 0.0
    lost_rad: float | None = None

    def with_heading_step(self, step_rad: float) -> Resets:
        """Count a jump of the heading."""
        return self._replace(
            heading_count=self.heading_count + 1,
            heading_rad=step_rad,
            heading_total_rad=self.heading_total_rad + step_rad,
        )

    def with_lateral_step(self, step_norm: float, step_m: float) -> Resets:
        """Count a jump of the lateral offset."""
        return self._replace(
            lateral_count=self.lateral_count + 1,
            lateral_norm=step_norm,
            lateral_m=step_m,
            lateral_total_norm=self.lateral_total_norm + step_norm,
        )

    def after(self, old: State, new: State, model: OffsetModel, half_m: float) -> Resets:
        """Count the jumps between the newest state and the one before.

        Parameters
        ----------
        old, new
            The newest states before and after a sample.
        model, half_m
            Parameters of the lateral offset's filter, and half the corridor's width, metres.
        """
        resets = self._after_heading(old, new)
        if new.lateral is old.lateral:
            return resets
        rolled_back = new.t_ns == old.t_ns
        return resets._after_lateral(old.lateral, new.lateral, model, half_m, rolled_back)

    def _after_heading(self, old: State, new: State) -> Resets:
        was_known, is_known = old.axis.ever_acquired, new.axis.ever_acquired
        if was_known and is_known:
            step = heading_step(old, new)
            if new.axis.reset_count != old.axis.reset_count or abs(step) > STEP_RAD:
                return self.with_heading_step(step)
        elif was_known:
            return self._replace(lost_rad=float(old.x[PSI]))
        elif is_known and self.lost_rad is not None:
            return self.with_heading_step(wrap(float(new.x[PSI]) - self.lost_rad))._replace(lost_rad=None)
        return self

    def _after_lateral(
        self, old: Lateral, new: Lateral, model: OffsetModel, half_m: float, rolled_back: bool
    ) -> Resets:
        if not rolled_back:
            counted = new.reset_count != old.reset_count
            return self.with_lateral_step(new.reset_norm, new.reset_m) if counted else self
        before, after = reliable(old, model), reliable(new, model)
        step = after.offset_norm - before.offset_norm
        if before.known and after.known:
            if abs(step) > JUMP_NORM or new.reset_count != old.reset_count:
                return self.with_lateral_step(step, step * half_m)
        elif after.known and new.reset_count != old.reset_count and isfinite(new.reset_norm):
            return self.with_lateral_step(new.reset_norm, new.reset_m)
        return self


def only_propagated(old: State, new: State, sample: Sample) -> bool:
    """Whether only dead reckoning lies between two states, the later of which follows ``sample``."""
    before = old.reckoning
    return (
        type(sample) is ImuSample
        and new.axis is old.axis
        and before.gyro_done_rad == 0.0
        and before.t_ns is not None
        and before.t_ns < sample.t_ns
    )


def heading_step(old: State, new: State) -> float:
    """Return the change of the heading beyond propagation, rad.

    States of equal time differ by the effect of a late sample, or of one of the same instant. A later state differs
    by the corrections since, and by the error of the rate that was held until the next gyroscope or attitude sample,
    or until another source took over: its turn may begin long before the earlier state.
    """
    moved = float(new.x[PSI]) - float(old.x[PSI])
    before, after = old.reckoning, new.reckoning
    if before.t_ns is None or after.t_ns is None or after.t_ns <= before.t_ns:
        return moved
    if before.gyro_done_rad == 0.0 and after.mode is before.mode:
        return moved - (after.theta_rad - before.theta_rad)
    rate = 0.5 * (before.yaw_rate(float(old.x[BIAS])) + after.yaw_rate(float(new.x[BIAS])))
    return moved - rate * (after.t_ns - before.t_ns) * 1e-9
