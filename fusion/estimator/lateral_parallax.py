"""Motion parallax of the walls between two frames, as evidence for the lateral offset and its rate.

`vision.lateral.parallax` compares a frame with one some tenths of a second earlier. This evidence is independent
of the other kinds: it rests on any texture of the walls, not on where their corners are.

With F the transition back along the path between the two frames, and Q its noise, the displacement d of the camera
is a measurement of each hypothesis x = [y, v, c, s]::

    d = (e_Y - F_Y) x + l s,    variance  R / (1 - exp(-dt / tau)) + Q_YY

with e_Y the unit vector of y, F_Y the row of F for y, and l the camera's swing about the body's centre, metres. R is
divided by the part of a comparison that is new after dt, as in `fusion.estimator.lateral_offset`, with a tau of
seconds: an axis that is off by a tenth of a degree shifts d by some thousandths, and stays off. The mixture of y
counts like that of a frame, but lets nothing be forgotten.
"""

from __future__ import annotations

from functools import cache
from math import expm1, isfinite
from typing import NamedTuple

import numpy as np

from fusion.estimator.lateral_kernels import S, Y, correct_all
from fusion.estimator.lateral_offset import (
    FIRST_FRAME_S,
    MIN_CANNOT_TELL,
    FrameEvidence,
    OffsetModel,
    OffsetState,
    Path,
    initial_offset_state,
    transition,
    updated_hypotheses,
)
from vision.lateral.parallax import PROFILES_SHAPE, Profiles, compare
from vision.types import FloatArray

BASELINE_S = 0.29  # between two frames that are compared; more, where frames are rarer
INTERVAL_S = 0.19  # between two comparisons
MAX_VIEW_S = 1.2  # after which the walls in view are others
DISPLACEMENT_SIGMA = 3.0  # from which on a displacement is doubted


class WallParallax(NamedTuple):
    """What the parallax of both walls says, between an earlier frame and one at the hypotheses' time.

    Parameters
    ----------
    components, side, aside_m
        As in `FrameEvidence`, of the later frame.
    path
        Motion between the two frames.
    dt_s
        As in `FrameEvidence`: time since the comparison before.
    displacement_norm, displacement_per_offset, displacement_variance
        Lateral displacement of the camera, half widths, positive right: at its offset o it is
        ``displacement_norm + displacement_per_offset o`` with that variance; NaN where it was not measured.
    swing_m
        What of it is the camera's swing about the body's centre, metres.
    """

    components: FloatArray
    side: float
    aside_m: float
    path: Path
    dt_s: float
    displacement_norm: float
    displacement_per_offset: float
    displacement_variance: float
    swing_m: float


def with_parallax(state: OffsetState, motion: WallParallax, model: OffsetModel) -> OffsetState:
    """Take in what the parallax of both walls says.

    The displacement is a measurement of ``y - y'``, with y' what the transition back along the path makes of the
    state.
    """
    if isfinite(motion.displacement_norm) and len(state.x):
        x, P = state.x.copy(), state.P.copy()
        F, Q = transition(motion.path, model, backward=True)
        lasting = -1.0 / expm1(-motion.dt_s / model.displacement_time_s)
        H = -motion.side * F[Y]
        H[Y] += motion.side
        H[S] += motion.swing_m
        for h in range(len(x)):
            offset = motion.side * x[h, Y] + motion.aside_m * x[h, S]
            moved = motion.displacement_norm + motion.displacement_per_offset * offset
            doubt = motion.displacement_per_offset**2 * P[h, Y, Y]
            variance = lasting * motion.displacement_variance + doubt + float(Q[Y, Y])
            correct_all(x[h : h + 1], P[h : h + 1], H, moved, variance, DISPLACEMENT_SIGMA)
        state = state._replace(x=x, P=P)
    evidence = FrameEvidence(motion.components, motion.dt_s, motion.side, motion.aside_m)
    x, P, weight, _, _ = updated_hypotheses(state, evidence, model, min(motion.dt_s, FIRST_FRAME_S), 0.0)
    return state._replace(x=x, P=P, weight=weight)


class WallView(NamedTuple):
    """How a frame saw the walls, and the motion since.

    Parameters
    ----------
    profiles
        `FrameMeasurement.wall_profiles`.
    side, aside_m
        As in `fusion.estimator.lateral_offset.FrameEvidence`.
    path
        Motion since.
    """

    profiles: Profiles
    side: float
    aside_m: float
    path: Path = Path()

    def propagated(self, path: Path) -> WallView:
        """Return the view after some more motion."""
        return self._replace(path=self.path.then(path))

    def compared(self, now: WallView, dt_s: float) -> WallParallax | None:
        """Compare with a later view; None where they have nothing in common.

        ``dt_s`` is the time since the last comparison.
        """
        if now.side != self.side or not self.path.t_s < MAX_VIEW_S:
            return None
        found = compare(self.profiles, now.profiles)
        offset = found.offset.less_sure(MIN_CANNOT_TELL)
        components = np.column_stack([offset.weight, offset.offset_norm, offset.std_norm**2])
        return WallParallax(
            components,
            now.side,
            now.aside_m,
            self.path,
            dt_s,
            found.displacement_norm,
            found.displacement_per_offset,
            found.displacement_std_norm**2,
            now.aside_m - self.aside_m,
        )


def compare_walls(
    views: tuple[WallView, ...], profiles: Profiles | None, evidence: FrameEvidence
) -> tuple[tuple[WallView, ...], WallParallax | None]:
    """Return the views that later frames are compared with, and what a frame says compared with one before.

    Parameters
    ----------
    views
        Of earlier frames, the oldest first.
    profiles
        Of the frame; None where it has none.
    evidence
        What the frame says by itself.
    """
    if profiles is None or (views and views[-1].path.t_s < INTERVAL_S):
        return views, None
    now = WallView(profiles, evidence.side, evidence.aside_m)
    old = [view for view in views if view.path.t_s >= BASELINE_S]
    if not old:
        return (*views, now), None
    return (*views[len(old) :], now), old[-1].compared(now, views[-1].path.t_s)


@cache
def compile_parallax() -> None:
    """Compile, or load what was compiled, when an estimator is made: not at its first frames, in flight."""
    nothing = np.zeros(PROFILES_SHAPE, np.float32)
    compare(nothing, nothing)
    example = WallParallax(np.array([[0.5, 0.2, 0.01]]), 1.0, 0.0, Path(0.3, 0.3), 0.2, 0.0, 0.0, 1e-4, 0.0)
    model = OffsetModel()
    state = with_parallax(initial_offset_state(), example, model)
    with_parallax(state, example, model)
