"""The smoother: a backward pass, so that every estimate uses the whole flight.

Rauch, Tung and Striebel's recursion (H. E. Rauch, F. Tung, C. T. Striebel, "Maximum likelihood estimates of linear
dynamic systems", AIAA Journal 3(8), 1965) over the steps that the engine took, each with its own transition. Resets
are steps like any other: a change of corridor or of what carries the heading, and a recovery, are transitions that
forget what they must, so nothing is carried back across them that is not so.

filterpy's function ``rts_smoother`` is not used: for transitions that change it takes those of the wrong step.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cache
from math import sqrt
from typing import NamedTuple

import numpy as np

from fusion.estimator.models import BIAS, N_STATES, PSI, FloatArray
from vision.compiled import compiled, compiled_inner
from vision.types import BoolArray

_BLOCK = 512


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


class Block(NamedTuple):
    """Steps in a row: F (n, 3, 3), state (n, 3) and covariance (n, 3, 3) before the measurements and after them."""

    F: FloatArray
    x_prior: FloatArray
    P_prior: FloatArray
    x: FloatArray
    P: FloatArray


class SmoothedSteps(NamedTuple):
    """All steps of a run as known from the whole of it.

    Parameters
    ----------
    x, P
        State (n, 3) and covariance (n, 3, 3).
    filter_bias, filter_variance
        The filter's own bias (n,) and variance of the heading (n,).
    forgets_heading
        Whether a step (n,) forgot the heading before it.
    """

    x: FloatArray
    P: FloatArray
    filter_bias: FloatArray
    filter_variance: FloatArray
    forgets_heading: BoolArray


@dataclass(slots=True, eq=False)
class Steps:
    """The engine's steps, gathered in blocks so that a long flight does not become millions of small objects.

    The last step of a block is the first of the next one, so that each can be smoothed by itself.
    """

    _nodes: list[Node] = field(default_factory=list)
    _blocks: list[Block] = field(default_factory=list)
    count: int = 0

    def add(self, nodes: Iterable[Node]) -> None:
        """Append steps, in order of time."""
        for node in nodes:
            self._nodes.append(node)
            self.count += 1
            if len(self._nodes) > _BLOCK:
                self._blocks.append(_block_of(self._nodes))
                self._nodes = [node]

    def smoothed(self) -> SmoothedSteps:
        """Smooth the run. The steps are freed one block after another, so that a long flight is not held twice."""
        n, self.count = self.count, 0
        blocks, self._blocks = self._blocks, []
        if self._nodes:
            blocks.append(_block_of(self._nodes))
            self._nodes = []
        out = SmoothedSteps(
            np.empty((n, N_STATES)),
            np.empty((n, N_STATES, N_STATES)),
            np.empty(n),
            np.empty(n),
            np.empty(n, np.bool_),
        )
        end = n
        while blocks:
            block = blocks.pop()
            rows = slice(end - len(block.x), end)
            out.filter_bias[rows], out.filter_variance[rows] = block.x[:, BIAS], block.P[:, PSI, PSI]
            out.forgets_heading[rows] = block.F[:, PSI, PSI] == 0.0
            if end < n:
                block.x[-1], block.P[-1] = out.x[end - 1], out.P[end - 1]
            rts(*block)
            out.x[rows], out.P[rows] = block.x, block.P
            end = rows.start + 1
        return out


def _block_of(nodes: list[Node]) -> Block:
    identity = np.eye(N_STATES)
    vectors, squares = (-1, N_STATES), (-1, N_STATES, N_STATES)
    return Block(
        np.concatenate([identity if n.F is None else n.F for n in nodes]).reshape(squares),
        np.concatenate([n.x_prior for n in nodes]).reshape(vectors),
        np.concatenate([n.P_prior for n in nodes]).reshape(squares),
        np.concatenate([n.x for n in nodes]).reshape(vectors),
        np.concatenate([n.P for n in nodes]).reshape(squares),
    )


@compiled
def rts(F: FloatArray, x_prior: FloatArray, P_prior: FloatArray, x: FloatArray, P: FloatArray) -> None:
    """Smooth a filter's run of n steps in place.

    Parameters
    ----------
    F
        Transition (n, m, m) that led to each step (the first one's is not used).
    x_prior, P_prior
        State (n, m) and covariance (n, m, m) right behind the transition.
    x, P
        The same after the step's measurements; smoothed on return.
    """
    n, m = x.shape
    scale, A, C = np.empty(m), np.empty((m, m)), np.empty((m, m))
    dx, D, CD = np.empty(m), np.empty((m, m)), np.empty((m, m))
    for k in range(n - 2, -1, -1):
        _fill_gain(F[k + 1], P_prior[k + 1], P[k], scale, A, C)
        for i in range(m):
            dx[i] = x[k + 1, i] - x_prior[k + 1, i]
            for j in range(m):
                D[i, j] = P[k + 1, i, j] - P_prior[k + 1, i, j]
        for i in range(m):
            for j in range(m):
                x[k, i] += C[i, j] * dx[j]
                CD[i, j] = 0.0
                for h in range(m):
                    CD[i, j] += C[i, h] * D[h, j]
        for i in range(m):
            for j in range(i + 1):
                total = 0.5 * (P[k, i, j] + P[k, j, i])
                for h in range(m):
                    total += 0.5 * (CD[i, h] * C[j, h] + CD[j, h] * C[i, h])
                P[k, i, j] = P[k, j, i] = total


@cache
def compile_smoother() -> None:
    """Compile, or load what was compiled, when an estimator that smooths in flight is made: not in flight."""
    x, P = np.zeros((2, N_STATES)), np.tile(np.eye(N_STATES), (2, 1, 1))
    rts(P.copy(), x.copy(), P.copy(), x, P)


@compiled_inner
def _fill_gain(
    F: FloatArray, P_prior: FloatArray, P: FloatArray, scale: FloatArray, A: FloatArray, C: FloatArray
) -> None:
    """Smoother's gain (m, m), P F' / P_prior, into ``C``: by elimination, scaled to unit diagonal as units differ."""
    m = len(scale)
    still = True
    for i in range(m):
        scale[i] = sqrt(P_prior[i, i])
        for j in range(m):
            C[i, j] = 1.0 if i == j else 0.0
            still = still and P_prior[i, j] == P[i, j] and F[i, j] == C[i, j]
    if still:
        return
    for i in range(m):
        for j in range(m):
            A[i, j] = P_prior[i, j] / (scale[i] * scale[j])
            C[j, i] = 0.0
            for h in range(m):
                C[j, i] += F[i, h] * P[h, j] / scale[i]  # C holds the transposed right side
    for pivot in range(m):  # symmetric and positive: no pivoting
        for i in range(pivot + 1, m):
            factor = A[i, pivot] / A[pivot, pivot]
            for j in range(pivot, m):
                A[i, j] -= factor * A[pivot, j]
            for j in range(m):
                C[j, i] -= factor * C[j, pivot]
    for i in range(m - 1, -1, -1):
        for j in range(m):
            for h in range(i + 1, m):
                C[j, i] -= A[i, h] * C[j, h]
            C[j, i] /= A[i, i]
    for i in range(m):
        for j in range(m):
            C[j, i] /= scale[i]
