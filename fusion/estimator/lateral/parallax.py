"""Motion parallax of the walls between two frames, as a measurement of the lateral offset and its rate.

`vision.lateral.parallax` compares a frame with one some tenths of a second earlier. This evidence is independent
of the other kinds: it uses any texture of the walls, not the position of their corners.

With F the backward transition along the path between the two frames, and Q its noise, the displacement d of the
camera is a measurement of each hypothesis x = [y, v, c, s]::

    d = (e_Y - F_Y) x + l s,    variance  R / (1 - exp(-dt / tau)) + Q_YY

with e_Y the unit vector of y, F_Y the row of F for y, and l the camera's displacement by rotation about the body's
centre, metres. R is divided by the independent part of a comparison after dt, as in
`gaussian_sum`, with a tau of seconds: an axis that is off by a tenth of a degree shifts d by some
thousandths, and this error lasts. The mixture of y is fused like that of a frame, without forgetting.
"""

from __future__ import annotations

from functools import cache
from math import expm1, isfinite
from typing import NamedTuple

import numpy as np

from fusion.estimator.lateral.gaussian_sum import (
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
from fusion.estimator.lateral.kernels import S, Y, correct_all
from vision.lateral.parallax import PROFILES_SHAPE, Profiles, compare
from vision.types import FloatArray

BASELINE_S = 0.29  # shortest time between two compared frames
INTERVAL_S = 0.19  # shortest time between two comparisons
MAX_VIEW_S = 1.2  # longest time between compared frames: later ones see other parts of the walls
# Residuals of a displacement beyond this have their variance inflated. It is low: beside an open side or pale walls
# the displacement is biased towards 0 by up to half, whatever its sigma says.
DISPLACEMENT_SIGMA = 1.5


class WallParallax(NamedTuple):
    """Measurement from the parallax of both walls between an earlier frame and one at the hypotheses' time.

    Parameters
    ----------
    components, side, aside_m
        As in `FrameEvidence`, of the later frame.
    path
        Motion between the two frames.
    dt_s
        As in `FrameEvidence`: time since the comparison before.
    displacement_norm, displacement_per_offset, displacement_variance
        Lateral displacement of the camera, half widths, positive right: at the camera's offset o it is
        ``displacement_norm + displacement_per_offset o`` with that variance; NaN if it was not measured.
    swing_m
        Part of it from the camera's rotation about the body's centre, metres.
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
    """Update with the parallax of both walls.

    The displacement measures ``y - y'``, with y' the offset at the earlier frame, by the backward transition.
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
    """A frame's wall profiles, and the motion since.

    Parameters
    ----------
    profiles
        `FrameMeasurement.wall_profiles`.
    side, aside_m
        As in `gaussian_sum.FrameEvidence`.
    path
        Motion since the frame.
    """

    profiles: Profiles
    side: float
    aside_m: float
    path: Path = Path()

    def propagated(self, path: Path) -> WallView:
        """Return the view with its path extended."""
        return self._replace(path=self.path.followed_by(path))

    def compared(self, now: WallView, dt_s: float) -> WallParallax | None:
        """Compare with a later view; None if they cannot be compared.

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
    """Compare a frame with an earlier view; return the views to keep and the measurement, if any.

    Parameters
    ----------
    views
        Views of earlier frames, the oldest first.
    profiles
        Wall profiles of the frame; None without.
    evidence
        The frame's own likelihood.
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
    """Compile the comparison, or load it from the cache, before the first frame."""
    nothing = np.zeros(PROFILES_SHAPE, np.float32)
    compare(nothing, nothing)
    example = WallParallax(np.array([[0.5, 0.2, 0.01]]), 1.0, 0.0, Path(0.3, 0.3), 0.2, 0.0, 0.0, 1e-4, 0.0)
    model = OffsetModel()
    state = with_parallax(initial_offset_state(), example, model)
    with_parallax(state, example, model)
