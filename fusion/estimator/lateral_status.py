"""Status of the lateral offset: whether it is known and consistent with the motion, and its jumps.

`fusion.estimator.lateral` updates it. If another hypothesis becomes the most probable one, this is a jump and is
counted. An offset that the motion does not explain is reported as unknown for some seconds.
"""

from __future__ import annotations

from enum import StrEnum
from math import cos, isfinite, isnan, nan, sin
from statistics import median
from typing import NamedTuple

from fusion.estimator.lateral_offset import (
    OffsetModel,
    OffsetReadout,
    OffsetState,
    Path,
    at_path_end,
    in_new_corridor,
    initial_offset_state,
)
from fusion.estimator.lateral_offset import readout as readout_of
from fusion.estimator.lateral_parallax import WallView
from fusion.estimator.lateral_smoother import MotionPrediction, OffsetStep
from fusion.estimator.models import Gate
from fusion.estimator.sample_times import seconds_since
from fusion.estimator.velocity import Velocity

JUMP_NORM = 0.1  # change in one frame from which on another hypothesis has won
CONTRADICTED_S = 4.0  # for which no offset is reported that motion does not lead to: one of the two is wrong
DRIFT_NORM = 0.07  # half widths by which offset and displacement drift apart in that time, besides
DRIFT_S = 0.5  # times the standard deviation of the rate
MIN_RECENT = 5  # offsets that contradict one: fewer may be a first guess
RECENT_EVERY_S = 0.1


class LateralStatus(StrEnum):
    """How far the lateral offset can be relied on; the words of the ``lateral_status`` column."""

    UNKNOWN = "unknown"  # never told, or no hypothesis is probable and narrow enough
    KNOWN = "known"  # recent frames confirm it
    COASTING = "coasting"  # propagated by the accelerometer or velocity; its sigma grows


class RecentOffsets(NamedTuple):
    """Offsets that were known in the last seconds, each less the displacement until then.

    Ahead of a place where the corridor gets narrower or wider, frames show more and more the walls beyond it: the
    offset drifts or jumps to theirs, to where the displacement does not lead.

    Parameters
    ----------
    displacement_norm
        How far the vehicle has moved right since the first frame, half widths.
    t_frame_ns
        Last frame; None before the first.
    t_ns, origin_norm
        When an offset was known, and that offset less the displacement until then; the oldest first.
    """

    displacement_norm: float = 0.0
    t_frame_ns: int | None = None
    t_ns: tuple[int, ...] = ()
    origin_norm: tuple[float, ...] = ()

    def propagated(self, rate_norm_s: float, t_ns: int) -> RecentOffsets:
        """Go on to a frame by the rate there, and forget what is too old."""
        moved = self.displacement_norm
        if self.t_frame_ns is not None and isfinite(rate_norm_s):
            moved += rate_norm_s * seconds_since(t_ns, self.t_frame_ns)
        old = sum(seconds_since(t_ns, t) >= CONTRADICTED_S for t in self.t_ns)
        return RecentOffsets(moved, t_ns, self.t_ns[old:], self.origin_norm[old:])

    @property
    def predicted_norm(self) -> float:
        """Offset that follows from them and the displacement; NaN where they are too few."""
        return self.displacement_norm + median(self.origin_norm) if len(self.t_ns) >= MIN_RECENT else nan

    def with_offset(self, offset_norm: float, t_ns: int) -> RecentOffsets:
        """Add one, unless the last is recent."""
        if self.t_ns and seconds_since(t_ns, self.t_ns[-1]) < RECENT_EVERY_S:
            return self
        origins = (*self.origin_norm, offset_norm - self.displacement_norm)
        return self._replace(t_ns=(*self.t_ns, t_ns), origin_norm=origins)


class Lateral(NamedTuple):
    """What is known of the lateral offset.

    Parameters
    ----------
    offset
        The Gaussian sum.
    step
        Its last step, for the smoother; None where the last sample made none.
    t_frame_ns, t_ns
        When the last frame came that told anything, and the last one that confirmed the offset.
    n_used
        How many confirmed it.
    gate, speed_gate
        Outcome of the last frame's likeliest offset, half widths, and of the last velocity, m/s.
    known
        Whether the last frame left an offset that may be relied on.
    last_known
        Offset when it was last known, half widths and metres.
    recent
        Offsets in this corridor that were known in the last seconds.
    contradicted
        Whether motion does not lead from them to where the last frame left it.
    reset_count, reset_norm, reset_m
        How often it jumped, and its last step.
    model
        What the filter assumes, with the width as it was told last; None: what the configuration says.
    views
        Frames with which the walls of later ones are compared, the oldest first.
    """

    offset: OffsetState = initial_offset_state()
    step: OffsetStep | None = None
    t_frame_ns: int | None = None
    t_ns: int | None = None
    n_used: int = 0
    gate: Gate | None = None
    speed_gate: Gate | None = None
    known: bool = False
    last_known: tuple[float, float] = (nan, nan)
    recent: RecentOffsets = RecentOffsets()
    contradicted: bool = False
    reset_count: int = 0
    reset_norm: float = 0.0
    reset_m: float = 0.0
    model: OffsetModel | None = None
    views: tuple[WallView, ...] = ()

    @property
    def test_ratio(self) -> float:
        """Of the last innovation: squared over gate squared."""
        return nan if self.gate is None else self.gate.test_ratio

    def without_offset(self) -> Lateral:
        """Go on in another corridor, or at another time, with nothing known but what the offset was last."""
        offset = in_new_corridor(self.offset)
        step = OffsetStep(Path(), offset, starts_anew=True)
        return self._replace(
            offset=offset,
            step=step,
            t_frame_ns=None,
            t_ns=None,
            known=False,
            recent=RecentOffsets(),
            contradicted=False,
            views=(),
        )

    def at_path_end(self, model: OffsetModel) -> Lateral:
        """Carry the hypotheses to the state's time."""
        views = tuple(view.propagated(self.offset.path) for view in self.views)
        return self._replace(offset=at_path_end(self.offset, model), views=views)


class LateralReadout(NamedTuple):
    """The lateral offset as reported.

    Offset and sigma in half widths, its rate and sigma in half widths per second, NaN where unknown; status; the
    probability of the hypothesis; speed along the axis, m/s.
    """

    offset: float
    offset_std: float
    rate: float
    rate_std: float
    status: LateralStatus
    probability: float
    along_m_s: float


def reliable(lateral: Lateral, model: OffsetModel) -> OffsetReadout:
    """Report the offset at the state's time; it is known only where motion does not contradict it."""
    found = readout_of(lateral.offset, model)
    return found._replace(known=found.known and not lateral.contradicted)


def readout(
    lateral: Lateral, model: OffsetModel, psi_rad: float, velocity: Velocity, t_ns: int, age_limit_s: float
) -> LateralReadout:
    """Report the offset.

    Parameters
    ----------
    lateral, model
        Part of the state, and what its filter assumes.
    psi_rad
        Heading.
    velocity
        Level speeds of the velocity stream.
    t_ns
        When.
    age_limit_s
        Age of the last confirming frame from which on the offset counts as carried on.
    """
    along = nan
    if velocity.is_known(t_ns):
        along = velocity.forward_m_s * cos(psi_rad) - velocity.sideways_m_s * sin(psi_rad)
    found = reliable(lateral, model)
    if not found.known:
        return LateralReadout(nan, nan, nan, nan, LateralStatus.UNKNOWN, found.probability, along)
    recent = seconds_since(t_ns, lateral.t_ns) <= age_limit_s
    status = LateralStatus.KNOWN if recent else LateralStatus.COASTING
    return LateralReadout(
        found.offset_norm,
        found.std_norm,
        found.velocity_norm_s,
        found.velocity_std_norm_s,
        status,
        found.probability,
        along,
    )


def with_frame_outcome(
    lateral: Lateral, before: OffsetReadout, after: OffsetReadout, t_ns: int, half_m: float
) -> Lateral:
    """Say whether the offset that a frame has left may be relied on, and count it if it jumped.

    Parameters
    ----------
    lateral
        After the frame.
    before, after
        The offset just before the frame and after it.
    t_ns
        Time of the frame.
    half_m
        Half the corridor's width; NaN where unknown.
    """
    return _with_jump_counted(
        _checked_against_motion(lateral, after, t_ns), lateral.known, before, after, half_m
    )


def _checked_against_motion(lateral: Lateral, after: OffsetReadout, t_ns: int) -> Lateral:
    """Compare the offset after a frame with those of the last seconds."""
    recent = lateral.recent.propagated(after.velocity_norm_s, t_ns)
    tolerance = DRIFT_NORM + DRIFT_S * after.velocity_std_norm_s
    predicted = MotionPrediction(recent.predicted_norm, tolerance)
    contradicted = predicted.excludes(after.offset_norm) if after.known else lateral.contradicted
    if after.known and not contradicted:
        if lateral.contradicted and isnan(predicted.offset_norm):
            # The few that are left would contradict the next frame again.
            recent = recent._replace(t_ns=(), origin_norm=())
        recent = recent.with_offset(after.offset_norm, t_ns)
    step = None if lateral.step is None else lateral.step._replace(predicted=predicted)
    return lateral._replace(recent=recent, contradicted=contradicted, step=step)


def _with_jump_counted(
    lateral: Lateral, was_known: bool, before: OffsetReadout, after: OffsetReadout, half_m: float
) -> Lateral:
    """Count a jump: another hypothesis has won, or the offset is known again after a frame left it unknown.

    An offset that is only too uncertain between two frames does not jump: the hypothesis stays the same.
    """
    latest = lateral.last_known
    if was_known and before.known:
        latest = (before.offset_norm, before.offset_norm * half_m)
    if not after.known or lateral.contradicted:
        return lateral._replace(known=False, last_known=latest)
    (old, old_m), (new, new_m) = latest, (after.offset_norm, after.offset_norm * half_m)
    if abs(new - old) > JUMP_NORM or (isfinite(old) and not was_known):
        count = lateral.reset_count + 1
        lateral = lateral._replace(reset_count=count, reset_norm=new - old, reset_m=new_m - old_m)
    return lateral._replace(known=True, last_known=(new, new_m))
