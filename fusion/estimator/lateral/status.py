"""Status of the lateral offset: whether it is known, whether it is consistent with the motion, and its jumps.

`updates` updates this part of the state. After each frame:

- The offset is compared with a prediction: the median of the offsets of the last `CONTRADICTED_S`, each moved on by
  the integrated rate. It is contradicted, and reported as unknown, if it differs by more than `DRIFT_NORM` +
  `DRIFT_S` sigma_v. One of the two is wrong then, and the next seconds show which.
- A change by more than `JUMP_NORM` means that another hypothesis has become the most probable one: a jump, counted.
"""

from __future__ import annotations

from enum import StrEnum
from math import cos, isfinite, isnan, nan, sin
from statistics import median
from typing import NamedTuple

from fusion.estimator.lateral.cross_section import CrossSection
from fusion.estimator.lateral.gaussian_sum import (
    OffsetModel,
    OffsetReadout,
    OffsetState,
    Path,
    at_path_end,
    in_new_corridor,
    initial_offset_state,
)
from fusion.estimator.lateral.gaussian_sum import readout as readout_of
from fusion.estimator.lateral.parallax import WallView
from fusion.estimator.lateral.smoother import MotionPrediction, OffsetStep
from fusion.estimator.lateral.speed_check import SpeedCheck
from fusion.estimator.models import Gate
from fusion.estimator.sample_times import seconds_since
from fusion.estimator.velocity import Velocity
from vision.measurement import FrameMeasurement

JUMP_NORM = 0.1  # half widths; a larger change in one frame means another hypothesis
CONTRADICTED_S = 4.0  # memory of offsets: the longest time for which a contradicted offset is not reported
DRIFT_NORM = 0.07  # half widths; tolerated drift between offset and displacement in that time
DRIFT_S = 0.5  # further tolerance, times the standard deviation of the rate
MIN_RECENT = 5  # offsets needed to contradict one: fewer may be a wrong initial hypothesis
RECENT_EVERY_S = 0.1


class LateralStatus(StrEnum):
    """Reliability of the lateral offset; the values of the ``lateral_status`` column."""

    UNKNOWN = "unknown"  # never measured, or no hypothesis is probable and narrow enough
    KNOWN = "known"  # recent frames confirm it
    COASTING = "coasting"  # propagated by the accelerometer or velocity; its sigma grows


class LateralReason(StrEnum):
    """Why the lateral offset is not known; the values of the ``lateral_reason`` column."""

    NONE = ""  # it is known
    WIDTH_STEP = "width_step"
    CONTRADICTED = "contradicted"
    NO_FRAME = "no_frame"
    NO_OFFSET = "no_offset"
    AMBIGUOUS = "ambiguous"
    UNCERTAIN = "uncertain"


LATERAL_REASON_MEANING = {
    LateralReason.WIDTH_STEP: "frames are held back at a step in width",
    LateralReason.CONTRADICTED: "the motion contradicts the offset",
    LateralReason.NO_FRAME: "no frame is used",
    LateralReason.NO_OFFSET: "the frames show no offset",
    LateralReason.AMBIGUOUS: "several offsets are possible",
    LateralReason.UNCERTAIN: "its sigma is too large",
}


class RecentOffsets(NamedTuple):
    """Known offsets of the last seconds, each less the displacement up to its time.

    Where the corridor gets narrower or wider ahead, frames increasingly show the walls beyond that place: the
    measured offset drifts or jumps to a value that the vehicle's displacement does not explain.

    Parameters
    ----------
    displacement_norm
        Displacement of the vehicle to the right since the first frame, half widths.
    t_frame_ns
        Time of the last frame; None before the first.
    t_ns, origin_norm
        Times of known offsets, and the offsets less the displacement up to then; the oldest first.
    """

    displacement_norm: float = 0.0
    t_frame_ns: int | None = None
    t_ns: tuple[int, ...] = ()
    origin_norm: tuple[float, ...] = ()

    def propagated(self, rate_norm_s: float, t_ns: int) -> RecentOffsets:
        """Integrate the rate up to a frame, and drop old offsets."""
        moved = self.displacement_norm
        if self.t_frame_ns is not None and isfinite(rate_norm_s):
            moved += rate_norm_s * seconds_since(t_ns, self.t_frame_ns)
        old = sum(seconds_since(t_ns, t) >= CONTRADICTED_S for t in self.t_ns)
        return RecentOffsets(moved, t_ns, self.t_ns[old:], self.origin_norm[old:])

    @property
    def predicted_norm(self) -> float:
        """Offset predicted from the recent ones and the displacement; NaN if there are too few."""
        return self.displacement_norm + median(self.origin_norm) if len(self.t_ns) >= MIN_RECENT else nan

    def with_offset(self, offset_norm: float, t_ns: int) -> RecentOffsets:
        """Add an offset, unless the last one is recent."""
        if self.t_ns and seconds_since(t_ns, self.t_ns[-1]) < RECENT_EVERY_S:
            return self
        origins = (*self.origin_norm, offset_norm - self.displacement_norm)
        return self._replace(t_ns=(*self.t_ns, t_ns), origin_norm=origins)


class Lateral(NamedTuple):
    """Estimate of the lateral offset.

    Parameters
    ----------
    offset
        The Gaussian sum.
    step
        Its last step, for the smoother; None if the last sample made none.
    t_frame_ns, t_ns
        Time of the last frame with offset evidence, and of the last one that confirmed the offset.
    n_used
        Number of frames that confirmed it.
    gate, speed_gate
        Innovation of the last frame's most probable offset, half widths, and of the last velocity, m/s.
    speed_check
        Whether the velocities contradict the offset.
    known
        Whether the offset after the last frame is reliable.
    last_known
        The last known offset, half widths and metres.
    recent
        Known offsets of the last seconds, in this corridor.
    contradicted
        Whether the motion does not explain the change from them to the offset after the last frame.
    reset_count, reset_norm, reset_m
        Number of jumps, and the last jump.
    model
        Parameters of the filter, with the width set last; None: those of the configuration.
    views
        Earlier frames' wall profiles, for the parallax of later frames; the oldest first.
    section
        Cross-section of the corridor that the frames show.
    """

    offset: OffsetState = initial_offset_state()
    step: OffsetStep | None = None
    t_frame_ns: int | None = None
    t_ns: int | None = None
    n_used: int = 0
    gate: Gate | None = None
    speed_gate: Gate | None = None
    speed_check: SpeedCheck = SpeedCheck()
    known: bool = False
    last_known: tuple[float, float] = (nan, nan)
    recent: RecentOffsets = RecentOffsets()
    contradicted: bool = False
    reset_count: int = 0
    reset_norm: float = 0.0
    reset_m: float = 0.0
    model: OffsetModel | None = None
    views: tuple[WallView, ...] = ()
    section: CrossSection = CrossSection()

    @property
    def test_ratio(self) -> float:
        """Square of the last innovation over the gate squared."""
        return nan if self.gate is None else self.gate.test_ratio

    def without_offset(self) -> Lateral:
        """Reset the estimate for another corridor or clock; keep the last known offset and the counts."""
        offset = in_new_corridor(self.offset)
        step = OffsetStep(Path(), offset, is_reset=True)
        return self._replace(
            offset=offset,
            step=step,
            t_frame_ns=None,
            t_ns=None,
            known=False,
            recent=RecentOffsets(),
            contradicted=False,
            views=(),
            section=CrossSection(),
        )

    def with_section_seen(self, t_ns: int, m: FrameMeasurement) -> Lateral:
        """Compare the cross-section that a frame shows with the corridor's."""
        section = self.section.with_frame(t_ns, m)
        return self if section is self.section else self._replace(section=section)

    def at_path_end(self, model: OffsetModel) -> Lateral:
        """Propagate the hypotheses to the state's time."""
        views = tuple(view.propagated(self.offset.path) for view in self.views)
        return self._replace(offset=at_path_end(self.offset, model), views=views)


class LateralReadout(NamedTuple):
    """The lateral offset as reported.

    Offset and sigma in half widths, its rate and sigma in half widths per second, NaN if unknown; status; the
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
    """Report the offset at the state's time; one that the motion contradicts counts as unknown."""
    found = readout_of(lateral.offset, model)
    return found._replace(known=found.known and not lateral.contradicted)


def readout(
    lateral: Lateral, model: OffsetModel, psi_rad: float, velocity: Velocity, t_ns: int, age_limit_s: float
) -> LateralReadout:
    """Report the offset.

    Parameters
    ----------
    lateral, model
        Part of the state, and the parameters of its filter.
    psi_rad
        Heading.
    velocity
        Level speeds of the velocity stream.
    t_ns
        Time of the report.
    age_limit_s
        Age of the last confirming frame beyond which the offset is coasting.
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


def reason_of(lateral: Lateral, is_old: bool, is_unseen: bool, is_probable: bool) -> LateralReason:
    """Return why the offset is unknown or coasting.

    Parameters
    ----------
    lateral
        Part of the state.
    is_old, is_unseen
        Whether no recent frame confirmed the offset, and whether none was used at all.
    is_probable
        Whether the most probable hypothesis is probable enough.
    """
    if lateral.section.is_another_seen:
        return LateralReason.WIDTH_STEP
    if lateral.contradicted:
        return LateralReason.CONTRADICTED
    if is_old:
        return LateralReason.NO_FRAME if is_unseen else LateralReason.NO_OFFSET
    return LateralReason.UNCERTAIN if is_probable else LateralReason.AMBIGUOUS


def with_frame_outcome(
    lateral: Lateral, before: OffsetReadout, after: OffsetReadout, t_ns: int, half_m: float
) -> Lateral:
    """Check the offset after a frame against the motion, and count a jump.

    Parameters
    ----------
    lateral
        Part of the state after the frame.
    before, after
        The offset just before the frame and after it.
    t_ns
        Time of the frame.
    half_m
        Half the corridor's width, metres; NaN if unknown.
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
            # Too few are left for a prediction, but they would contradict the next frame again.
            recent = recent._replace(t_ns=(), origin_norm=())
        recent = recent.with_offset(after.offset_norm, t_ns)
    step = None if lateral.step is None else lateral.step._replace(predicted=predicted)
    return lateral._replace(recent=recent, contradicted=contradicted, step=step)


def _with_jump_counted(
    lateral: Lateral, was_known: bool, before: OffsetReadout, after: OffsetReadout, half_m: float
) -> Lateral:
    """Count a jump: another hypothesis is the most probable one, or the offset is known again after a gap.

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
