from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fusion.estimator.ekf import CorridorEKF
from fusion.estimator.models import ScalarMeasurement
from fusion.estimator.smoother import Block, Node, Steps, rts


class Problem(NamedTuple):
    """Start and its covariance; transitions with their noise and offset; measurements: after which step, H, R, z."""

    x0: np.ndarray
    P0: np.ndarray
    Fs: list[np.ndarray]
    Qs: list[np.ndarray]
    offsets: list[np.ndarray]
    measurements: list[tuple[int, np.ndarray, float, float]]


def linear_problem(seed: int, n: int = 12) -> tuple[Problem, list[Node]]:
    """A filter's run over transitions that all differ, with several, one or no measurements after each."""
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(3, 3))
    P0, x0 = A @ A.T + np.eye(3), rng.normal(size=3)
    ekf = CorridorEKF(x0, P0)
    nodes = [Node(None, x0, P0, x0, P0)]
    Fs, Qs, offsets, measurements = [], [], [], []
    for k in range(1, n):
        F = np.eye(3) + 0.3 * rng.normal(size=(3, 3))
        if k == n // 2:  # a reset: two states forgotten, as where the corridor changes
            F[[0, 2]] = 0.0
        B = rng.normal(size=(3, 3))
        Q, offset = 0.1 * B @ B.T + 1e-3 * np.eye(3), rng.normal(size=3)
        ekf.predict(F @ ekf.x + offset, F, Q)
        prior, P_prior = ekf.x, ekf.P
        for _ in range(int(rng.integers(0, 3))):
            H, R, z = rng.normal(size=3), float(rng.uniform(0.1, 2)), float(rng.normal(0, 3))
            ekf.update(ScalarMeasurement(z - float(H @ ekf.x), H, R))
            measurements.append((k, H, R, z))
        nodes.append(Node(F, prior, P_prior, ekf.x, ekf.P))
        Fs.append(F)
        Qs.append(Q)
        offsets.append(offset)
    return Problem(x0, P0, Fs, Qs, offsets, measurements), nodes


def batch(problem: Problem) -> tuple[np.ndarray, np.ndarray]:
    """Least squares over the whole trajectory at once: the definition of what the smoother must find."""
    x0, P0, Fs, Qs, offsets, measurements = problem
    n = len(Fs) + 1
    rows, values = [], []

    def add(blocks: dict[int, np.ndarray], value: np.ndarray, covariance: np.ndarray) -> None:
        W = np.linalg.inv(np.linalg.cholesky(covariance))
        row = np.zeros((len(value), 3 * n))
        for k, block in blocks.items():
            row[:, 3 * k : 3 * k + 3] = block
        rows.append(W @ row)
        values.append(W @ value)

    add({0: np.eye(3)}, x0, P0)
    for k, (F, Q, offset) in enumerate(zip(Fs, Qs, offsets, strict=True)):
        add({k + 1: np.eye(3), k: -F}, offset, Q)
    for k, H, R, z in measurements:
        add({k: H[None, :]}, np.array([z]), np.array([[R]]))
    A, b = np.concatenate(rows), np.concatenate(values)
    solution = np.linalg.lstsq(A, b, rcond=None)[0]
    covariance = np.linalg.inv(A.T @ A)
    return solution.reshape(n, 3), np.stack(
        [covariance[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] for k in range(n)]
    )


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 100_000))
def test_equals_the_batch_solution(seed: int) -> None:
    problem, nodes = linear_problem(seed)
    steps = Steps()
    steps.add(nodes)
    x, variance, *_ = steps.smoothed()
    expected_x, expected_P = batch(problem)
    expected = np.diagonal(expected_P, axis1=1, axis2=2)
    np.testing.assert_allclose(x, expected_x, rtol=0, atol=1e-9 * max(1.0, np.abs(expected_x).max()))
    np.testing.assert_allclose(variance, expected, rtol=0, atol=1e-9 * max(1.0, np.abs(expected_P).max()))


def test_filterpys_smoother_is_wrong_here() -> None:
    """The reason for an own one; should this fail, filterpy was mended."""
    from filterpy.kalman import KalmanFilter, rts_smoother

    problem, nodes = linear_problem(1)
    expected_x, _ = batch(problem)
    xs, Ps = np.stack([node.x for node in nodes]), np.stack([node.P for node in nodes])
    theirs = rts_smoother(xs, Ps, np.stack([np.eye(3), *problem.Fs]), np.stack([np.eye(3), *problem.Qs]))[0]
    assert KalmanFilter is not None
    assert np.abs(theirs - expected_x).max() > 1e-3


def test_states_of_very_different_size_keep_the_precision() -> None:
    scale = np.array([1e-3, 1e-6, 10.0])
    (x0, P0, Fs, Qs, offsets, measurements), _ = linear_problem(7)
    D, D_inv = np.diag(scale), np.diag(1 / scale)
    _, nodes = linear_problem(7)
    scaled = [
        Node(
            None if n.F is None else D @ n.F @ D_inv,
            *(D @ v if v.ndim == 1 else D @ v @ D for v in (n.x_prior, n.P_prior, n.x, n.P)),
        )
        for n in nodes
    ]
    steps = Steps()
    steps.add(scaled)
    x, *_ = steps.smoothed()
    expected, _ = batch(Problem(x0, P0, Fs, Qs, offsets, measurements))
    np.testing.assert_allclose(x / scale, expected, rtol=0, atol=1e-8 * np.abs(expected).max())


@pytest.mark.parametrize("n", [4096, 4097, 4098, 8193, 9000])
def test_a_run_in_blocks_is_smoothed_as_a_whole(n: int) -> None:
    many: list[Node] = []
    while len(many) < n:  # runs that have nothing to do with each other, and forget the one before
        _, nodes = linear_problem(len(many))
        first = replace(nodes[0], F=np.diag([0.0, 1.0, 1.0]))
        many += [first, *nodes[1:]]
    many = many[:n]
    steps = Steps()
    steps.add(many[: n // 2])
    steps.add(many[n // 2 :])
    assert steps.count == n
    found = steps.smoothed()
    assert steps.count == 0
    F = np.stack([np.eye(3) if node.F is None else node.F for node in many])
    whole = [np.stack([getattr(node, name) for node in many]) for name in ("x_prior", "P_prior", "x", "P")]
    np.testing.assert_array_equal(found.filter_bias, whole[2][:, 1])
    np.testing.assert_array_equal(found.filter_variance, whole[3][:, 0, 0])
    np.testing.assert_array_equal(found.forgets_heading, F[:, 0, 0] == 0.0)
    rts(F, *whole)
    np.testing.assert_array_equal(found.x, whole[2])
    np.testing.assert_array_equal(found.variance, np.diagonal(whole[3], axis1=1, axis2=2))


@pytest.mark.parametrize("cuts", [(0, 40), (1, 41), (30, 30), (100, 1100), (600, 640)])
def test_steps_added_as_arrays_are_those_added_one_by_one(cuts: tuple[int, int]) -> None:
    many: list[Node] = []
    while len(many) < 1200:
        _, nodes = linear_problem(len(many))
        many += [replace(nodes[0], F=np.diag([0.0, 1.0, 1.0])), *nodes[1:]]
    one_by_one, steps = Steps(), Steps()
    one_by_one.add(many)
    start, end = cuts
    steps.add(many[:start])
    shapes = zip(Block._fields, ((0, 3, 3), (0, 3), (0, 3, 3), (0, 3), (0, 3, 3)), strict=True)
    rows = [[getattr(n, name) for n in many[start:end]] or np.empty(empty) for name, empty in shapes]
    rows[0] = [np.eye(3) if F is None else F for F in rows[0]] or np.empty((0, 3, 3))
    steps.add_block(Block(*map(np.array, rows)))
    steps.add(many[end:])
    assert steps.count == one_by_one.count
    for found, expected in zip(steps.smoothed(), one_by_one.smoothed(), strict=True):
        np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("n", [0, 1])
def test_short_runs(n: int) -> None:
    _, nodes = linear_problem(3)
    steps = Steps()
    steps.add(nodes[:n])
    x, variance, *_ = steps.smoothed()
    assert x.shape == (n, 3)
    assert variance.shape == (n, 3)
