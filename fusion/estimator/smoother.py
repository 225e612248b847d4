"""Rauch-Tung-Striebel smoother of the heading filter: a backward pass over the whole flight.

The recursion (H. E. Rauch, F. Tung, C. T. Striebel, "Maximum likelihood estimates of linear dynamic systems", AIAA
Journal 3(8), 1965) over the engine's steps, each with its own transition::

    C_k = P_k F' / P-_{k+1},    x_k += C_k (x_{k+1} - x-_{k+1}),    P_k += C_k (P_{k+1} - P-_{k+1}) C_k'

with x-, P- before the measurements of a step. Resets are steps like all others: a change of corridor or of the source
that propagates the heading, and a recovery, are transitions that remove the dependence on the states they replace, so
no information flows back across them.

filterpy's function ``rts_smoother`` is not used: with time-varying transitions it uses those of the wrong step.
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
    """One step for the smoother: a transition, and the state after the measurements that follow it.

    Parameters
    ----------
    F
        Transition (3, 3); None for the identity.
    x_prior, P_prior
        State (3,) and covariance (3, 3) right after the transition.
    x, P
        The same after the step's measurements.
    """

    F: FloatArray | None
    x_prior: FloatArray
    P_prior: FloatArray
    x: FloatArray
    P: FloatArray


class Block(NamedTuple):
    """Consecutive steps: F (n, 3, 3), state (n, 3) and covariance (n, 3, 3) before and after the measurements."""

    F: FloatArray
    x_prior: FloatArray
    P_prior: FloatArray
    x: FloatArray
    P: FloatArray


class SmoothedSteps(NamedTuple):
    """The smoothed steps of a run.

    Parameters
    ----------
    x, variance
        State (n, 3) and its variances (n, 3).
    filter_bias, filter_variance
        Bias (n,) and variance of the heading (n,) before smoothing.
    forgets_heading
        Whether a step (n,) made the heading independent of the one before it.
    """

    x: FloatArray
    variance: FloatArray
    filter_bias: FloatArray
    filter_variance: FloatArray
    forgets_heading: BoolArray


@dataclass(slots=True, eq=False)
class Steps:
    """The engine's steps, stored in blocks: a long flight would otherwise be millions of small objects.

    The last step of a block is the first of the next one, so that each block can be smoothed separately.
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

    def add_block(self, steps: Block) -> None:
        """Append many steps, in order of time."""
        last = self._nodes[-1:]
        if len(self._nodes) > 1:
            self._blocks.append(_block_of(self._nodes))
        if last:
            parts = zip(_block_of(last), steps, strict=True)
            steps = Block(*(np.concatenate(pair) for pair in parts))
        if len(steps.x) > 1:
            self._blocks.append(steps)
        self.count += len(steps.x) - len(last)
        self._nodes = [Node(*(values[-1].copy() for values in steps))] if len(steps.x) else []

    def smoothed(self) -> SmoothedSteps:
        """Smooth the run, and release its blocks one after another to save memory."""
        n, self.count = self.count, 0
        blocks, self._blocks = self._blocks, []
        if self._nodes:
            blocks.append(_block_of(self._nodes))
            self._nodes = []
        out = SmoothedSteps(
            np.empty((n, N_STATES)),
            np.empty((n, N_STATES)),
            np.empty(n),
            np.empty(n),
            np.empty(n, np.bool_),
        )
        end, P = n, np.empty(0)  # covariance at the end of the next block
        while blocks:
            block = blocks.pop()
            rows = slice(end - len(block.x), end)
            out.filter_bias[rows], out.filter_variance[rows] = block.x[:, BIAS], block.P[:, PSI, PSI]
            out.forgets_heading[rows] = block.F[:, PSI, PSI] == 0.0
            if end < n:
                block.x[-1], block.P[-1] = out.x[end - 1], P
            rts(*block)
            out.x[rows], P = block.x, block.P[0].copy()
            out.variance[rows] = np.diagonal(block.P, axis1=1, axis2=2)
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
        Transition (n, m, m) that led to each step (the first one is not used).
    x_prior, P_prior
        State (n, m) and covariance (n, m, m) right after the transition.
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
    """Compile the smoother, or load it from the cache, before take-off."""
    x, P = np.zeros((2, N_STATES)), np.tile(np.eye(N_STATES), (2, 1, 1))
    rts(P.copy(), x.copy(), P.copy(), x, P)


@compiled_inner
def _fill_gain(
    F: FloatArray, P_prior: FloatArray, P: FloatArray, scale: FloatArray, A: FloatArray, C: FloatArray
) -> None:
    """Fill the smoother's gain ``C`` (m, m), P F' / P_prior, by elimination, scaled to a unit diagonal."""
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
