"""The backward pass: every estimate from the whole flight, not only from what came before it.

Rauch, Tung and Striebel's recursion (H. E. Rauch, F. Tung, C. T. Striebel, "Maximum likelihood estimates of linear
dynamic systems", AIAA Journal 3(8), 1965) over the steps that the engine took, each with its own transition. Resets
are steps like any other: a change of corridor or of what carries the heading, and a recovery, are transitions that
forget what they must, so nothing is carried back across them that is not so.

filterpy's function ``rts_smoother`` is not used: for transitions that change it takes those of the wrong step.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from fusion.estimator.models import N_STATES, FloatArray

_BLOCK = 4096


@dataclass(slots=True, eq=False)
class Node:
    """One step for the smoother: a transition, and the state after what was measured behind it.

    Parameters
    ----------
    F
        Transition (3, 3); None where nothing moved.
    x_prior, P_prior
        State (3,) and covariance (3, 3) right behind the transition.
    x, P
        The same after the step's measurements.
    """

    F: FloatArray | None
    x_prior: FloatArray
    P_prior: FloatArray
    x: FloatArray
    P: FloatArray


Arrays = tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]
"""F (n, 3, 3), prior state (n, 3) and covariance (n, 3, 3), state and covariance after the measurements."""


@dataclass(slots=True, eq=False)
class Steps:
    """The engine's steps, gathered in blocks so that a long flight does not become millions of small objects."""

    _nodes: list[Node] = field(default_factory=list)
    _blocks: list[Arrays] = field(default_factory=list)
    count: int = 0

    def add(self, nodes: Iterable[Node]) -> None:
        """Append steps, in order of time."""
        for node in nodes:
            self._nodes.append(node)
            self.count += 1
            if len(self._nodes) >= _BLOCK:
                self._pack()

    def _pack(self) -> None:
        if not self._nodes:
            return
        parts = ((n.F, n.x_prior, n.P_prior, n.x, n.P) for n in self._nodes)
        F, x_prior, P_prior, x, P = zip(*parts, strict=True)
        identity = np.eye(N_STATES)
        vectors, squares = (-1, N_STATES), (-1, N_STATES, N_STATES)
        self._blocks.append(
            (
                np.concatenate([identity if f is None else f for f in F]).reshape(squares),
                np.concatenate(x_prior).reshape(vectors),
                np.concatenate(P_prior).reshape(squares),
                np.concatenate(x).reshape(vectors),
                np.concatenate(P).reshape(squares),
            )
        )
        self._nodes = []

    def arrays(self) -> Arrays:
        """Return all steps, in the order in which `rts` takes them."""
        self._pack()
        if not self._blocks:
            empty, square = np.zeros((0, N_STATES)), np.zeros((0, N_STATES, N_STATES))
            return square, empty, square, empty, square
        F, x_prior, P_prior, x, P = (np.concatenate(parts) for parts in zip(*self._blocks, strict=True))
        return F, x_prior, P_prior, x, P


def rts(
    F: FloatArray, x_prior: FloatArray, P_prior: FloatArray, x: FloatArray, P: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Smooth a filter's run.

    Parameters
    ----------
    F
        Transition (n, m, m) that led to each step (the first one's is not used).
    x_prior, P_prior
        State (n, m) and covariance (n, m, m) right behind the transition.
    x, P
        The same after the step's measurements.

    Returns
    -------
    x_smoothed, P_smoothed
        (n, m) and (n, m, m).
    """
    x_smoothed, P_smoothed = x.copy(), P.copy()
    if len(x) < 2:
        return x_smoothed, P_smoothed
    # Gain P F' / P_prior for all steps at once; scaled to unit diagonal first, for the units differ widely.
    scale = np.sqrt(np.diagonal(P_prior[1:], axis1=1, axis2=2))
    scaled = P_prior[1:] / (scale[:, :, None] * scale[:, None, :])
    right = F[1:] @ P[:-1] / scale[:, :, None]
    gain = np.swapaxes(np.linalg.solve(scaled, right) / scale[:, :, None], 1, 2)
    still = (F[1:] == np.eye(F.shape[1])).all(axis=(1, 2)) & (P_prior[1:] == P[:-1]).all(axis=(1, 2))
    gain[still] = np.eye(F.shape[1])
    for k in range(len(x) - 2, -1, -1):
        C = gain[k]
        x_smoothed[k] += C @ (x_smoothed[k + 1] - x_prior[k + 1])
        S = P[k] + C @ (P_smoothed[k + 1] - P_prior[k + 1]) @ C.T
        P_smoothed[k] = 0.5 * (S + S.T)
    return x_smoothed, P_smoothed
