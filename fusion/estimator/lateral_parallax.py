"""Motion parallax of the walls between two frames, as evidence for the lateral offset and its rate.

`vision.lateral.parallax` compares a frame with one some tenths of a second earlier. This evidence is independent
of the other kinds: it rests on any texture of the walls, not on where their corners are.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fusion.estimator.lateral_offset import MIN_CANNOT_TELL, FrameEvidence, Path, WallParallax
from vision.lateral.parallax import Profiles, compare

BASELINE_S = 0.29  # between two frames that are compared; more, where frames are rarer
INTERVAL_S = 0.19  # between two comparisons
MAX_VIEW_S = 1.2  # after which the walls in view are others


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

    def moved_on(self, path: Path) -> WallView:
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
