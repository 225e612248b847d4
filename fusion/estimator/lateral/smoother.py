"""Smoother of the lateral offset over a whole flight: combines a forward and a backward filter.

A two-filter smoother (D. C. Fraser, J. E. Potter, "The optimum linear smoother as a combination of two optimum
linear filters", IEEE Transactions on Automatic Control 14(4), 1969) for Gaussian sums. The filter of
`gaussian_sum` runs a second time over the same steps, from the end to the start, with inverted
transitions and the same frame likelihoods. At each step the forward density p_f(y, v) and the backward density p_b
are multiplied. Both contain the prior p_0, uniform in y and Gaussian in v, which must count only once::

    p(y, v) = p_f p_b / p_0,    w_ij = w_i w_j N(m_i - m_j; 0, P_i + P_j) / p_0

The part of a density that is unknown equals p_0, so it leaves the other's weights unchanged. A hypothesis that later
frames confirm thus gains weight from its start, and one that they refute loses it. Both filters restart at a change
of corridor. Only y and v are compared: both filters estimate accelerometer bias and width from the same prior, and
these have little effect on the comparison.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from math import nan, pi, sqrt
from typing import NamedTuple

import numpy as np

from fusion.estimator.lateral.gaussian_sum import (
    FrameEvidence,
    OffsetModel,
    OffsetReadout,
    OffsetState,
    Path,
    along_path,
    at_path_end,
    initial_offset_state,
    summary,
    with_evidence,
    with_speed,
)
from fusion.estimator.lateral.kernels import V, Y
from fusion.estimator.lateral.parallax import WallParallax, with_parallax
from vision.types import FloatArray

YV = slice(Y, V + 1)
COMBINED_INFLATION = 1.5  # of the combined variance: errors of earlier and later frames are correlated
KNOWN_PROBABILITY = 0.95  # higher than the filter's for the same reason
LONGEST_STEP_S = 0.5  # in a longer one the motion may reverse unseen by offsets and rates at its ends


class MotionPrediction(NamedTuple):
    """Offset predicted by the motion, and its tolerance, half widths; NaN if unknown."""

    offset_norm: float = nan
    tolerance_norm: float = nan

    def excludes(self, offset_norm: float) -> bool:
        """Whether an offset differs from the prediction by more than the tolerance."""
        return abs(offset_norm - self.offset_norm) > self.tolerance_norm


class OffsetStep(NamedTuple):
    """One step of the filter: a path, then the measurements fused at its end.

    Parameters
    ----------
    path
        Motion since the step before.
    after
        The filter's state after the step; for a step of motion alone its own path is still to be applied.
    evidence
        Likelihood of a frame; None without one.
    speed
        Speed across the corridor, m/s, and its variance; None without one.
    parallax
        Parallax of the walls since an earlier frame, fused before this frame's evidence; None without one.
    is_reset
        Whether another corridor begins here.
    predicted
        Offset predicted by the motion from earlier known offsets; a smoothed offset that it excludes is unknown.
    """

    path: Path
    after: OffsetState
    evidence: FrameEvidence | None = None
    speed: tuple[float, float] | None = None
    parallax: WallParallax | None = None
    is_reset: bool = False
    predicted: MotionPrediction = MotionPrediction()


def ends_step(path: Path, moved: Path) -> bool:
    """Whether a path is long enough for a step of its own; ``moved`` is the part that is in steps already."""
    return int(path.t_s / LONGEST_STEP_S) > int(moved.t_s / LONGEST_STEP_S)


@dataclass(slots=True)
class OffsetSteps:
    """Steps of the lateral offset with their times, in order.

    While nothing is measured for long, motion alone makes steps, so that the offset is not interpolated over seconds.
    They are appended once a measurement follows: after the last one the filter's offset equals the smoother's.
    """

    t_ns: list[int] = field(default_factory=list)
    steps: list[OffsetStep] = field(default_factory=list)
    _moved: Path = field(default_factory=Path)  # the part of the filter's path that is in steps already
    _waiting: list[tuple[int, OffsetStep]] = field(default_factory=list)

    def add(self, t_ns: int, step: OffsetStep | None, offset: OffsetState) -> None:
        """Append the step that led to the filter's state ``offset``; None for motion alone."""
        if step is None:
            if self.steps and ends_step(offset.path, self._moved):
                self._waiting.append((t_ns, OffsetStep(offset.path.since(self._moved), offset)))
                self._moved = offset.path
            return
        if not step.is_reset:
            step = step._replace(path=step.path.since(self._moved))
        for time_ns, waiting in (*self._waiting, (t_ns, step)):
            self.t_ns.append(time_ns)
            self.steps.append(waiting)
        self._moved, self._waiting = Path(), []

    def add_motion(
        self, t_ns: Sequence[int], path_s: FloatArray, offset_at: Callable[[int], OffsetState]
    ) -> None:
        """Append motion alone over times (n,), where the filter's paths last ``path_s`` (n,).

        ``offset_at`` returns the filter's state at one of them.
        """
        whole = (np.append(self._moved.t_s, path_s) / LONGEST_STEP_S).astype(np.int64)
        for i in np.flatnonzero(np.diff(whole) > 0).tolist():
            self.add(t_ns[i], None, offset_at(i))

    def begin(self, t_ns: int, offset: OffsetState) -> None:
        """Begin with the filter's state after a step; earlier steps are dropped."""
        self.t_ns, self.steps = [t_ns], [OffsetStep(Path(), offset)]
        self._moved, self._waiting = offset.path, []


def smoothed_offsets(steps: Sequence[OffsetStep], model: OffsetModel) -> list[OffsetReadout]:
    """Return the smoothed offset after each step; ages are the filter's."""
    model = model._replace(known_probability=KNOWN_PROBABILITY)
    out: list[OffsetReadout] = []
    later = initial_offset_state()
    for step in reversed(steps):
        found = _combined(at_path_end(step.after, model), later, model)
        out.append(found._replace(known=found.known and not step.predicted.excludes(found.offset_norm)))
        if step.evidence is not None:
            later = with_evidence(later, step.evidence, model)
        if step.speed is not None:
            later = with_speed(later, *step.speed)
        if step.parallax is not None:
            later = with_parallax(later, step.parallax, model)
        later = (
            initial_offset_state() if step.is_reset else along_path(later, step.path, model, backward=True)
        )
    return out[::-1]


def _combined(before: OffsetState, after: OffsetState, model: OffsetModel) -> OffsetReadout:
    """Return the moments of the product of forward and backward density, as in the module's equation."""
    m_f, P_f, w_f = before.x[:, YV], before.P[:, YV, YV], before.weight
    m_b, P_b, w_b = after.x[:, YV], after.P[:, YV, YV], after.weight
    n, k = len(m_f), len(m_b)
    mean = np.empty((n * k + n + k, 2))
    cov = np.empty((n * k + n + k, 2, 2))
    weight = np.empty(n * k + n + k)
    weight[n * k :] = np.concatenate([w_f[:-1] * w_b[-1], w_b[:-1] * w_f[-1]])
    mean[n * k :], cov[n * k :] = np.concatenate([m_f, m_b]), np.concatenate([P_f, P_b])
    if n and k:
        total = P_f[:, None] + P_b[None]
        apart = m_b[None] - m_f[:, None]
        inverse = np.linalg.inv(total)
        pull = inverse @ apart[..., None]
        gain = P_f[:, None] @ inverse
        middle = m_f[:, None] + (P_f[:, None] @ pull)[..., 0]
        mean[: n * k] = middle.reshape(-1, 2)
        both = P_f[:, None] - gain @ P_f[:, None]
        both = 0.5 * COMBINED_INFLATION * (both + np.swapaxes(both, -1, -2))
        cov[: n * k] = both.reshape(-1, 2, 2)
        distance = (apart[..., None, :] @ pull)[..., 0, 0]
        density = np.exp(-0.5 * distance) / (2.0 * pi * np.sqrt(np.linalg.det(total)))
        v_std = model.start_velocity_std_m_s * model.inverse_half_width[0]
        prior = 0.5 * np.exp(-0.5 * (middle[..., 1] / v_std) ** 2) / (sqrt(2.0 * pi) * v_std)
        prior = np.maximum(prior, 0.5 * np.exp(-4.5) / (sqrt(2.0 * pi) * v_std))
        weight[: n * k] = (w_f[:-1, None] * w_b[None, :-1] * density / prior).ravel()
    whole = weight.sum() + w_f[-1] * w_b[-1]
    both_see = before._replace(spread2=min(before.spread2, after.spread2))
    return summary(mean, cov, weight / whole, both_see, model)


def at_times(
    step_t_s: FloatArray, offsets: Sequence[OffsetReadout], t_s: FloatArray
) -> tuple[FloatArray, FloatArray, np.ndarray[tuple[int], np.dtype[np.bool_]]]:
    """Interpolate smoothed offsets to times (n,): offset (n,), sigma (n,), whether it is known (n,).

    Cubic Hermite interpolation of offsets and rates; unknown if the step on either side is.
    """
    y, std, v = (np.array([o[k] for o in offsets]) for k in range(3))
    known = np.array([o.known for o in offsets])
    right = np.clip(np.searchsorted(step_t_s, t_s), 1, len(step_t_s) - 1)
    left = right - 1
    gap = np.maximum(step_t_s[right] - step_t_s[left], 1e-9)
    u = np.clip((t_s - step_t_s[left]) / gap, 0.0, 1.0)
    h00, h10 = (1 + 2 * u) * (1 - u) ** 2, u * (1 - u) ** 2
    h01, h11 = u * u * (3 - 2 * u), u * u * (u - 1)
    offset = h00 * y[left] + h10 * gap * v[left] + h01 * y[right] + h11 * gap * v[right]
    return offset, (1 - u) * std[left] + u * std[right], known[left] & known[right]
