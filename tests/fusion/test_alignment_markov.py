"""Correlated least squares against dense matrices, and its sigma against the scatter of many fits."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fusion.alignment.markov import Noise, Process, find_noise, fit_lines, solve


def dense(white: np.ndarray, process: Process) -> np.ndarray:
    """Covariance (n, n) by carrying the process along, sample by sample."""
    n = len(white)
    lower = np.zeros((n, n))  # what each sample holds of each step
    for k in range(n):
        if k:
            lower[k] = process.phi[k] * lower[k - 1]
        lower[k, k] = 1.0
    return lower @ np.diag(process.variance) @ lower.T + np.diag(white)


@st.composite
def noises(draw: st.DrawFn) -> tuple[np.ndarray, Process]:
    n = draw(st.integers(2, 25))
    rng = np.random.default_rng(draw(st.integers(0, 2**31)))
    t, chain = np.cumsum(rng.uniform(0.01, 0.5, n)), np.sort(rng.integers(0, 3, n))
    white = rng.uniform(0.01, 1.0, n)
    size = draw(st.floats(0.05, 2.0))
    walk = Process(Process.walk(t, chain, size).phi, np.minimum(Process.walk(t, chain, size).variance, 4.0))
    return white, draw(st.sampled_from([walk, Process.stationary(t, chain, size, 0.7)]))


@given(noises())
@settings(max_examples=60, deadline=None)
def test_the_banded_solution_is_the_dense_one(noise: tuple[np.ndarray, Process]) -> None:
    white, process = noise
    banded, S = Noise(white, process), dense(white, process)
    values = np.random.default_rng(1).normal(size=(len(white), 2))
    inverse = np.linalg.inv(S)
    np.testing.assert_allclose(banded.whiten(values), inverse @ values, rtol=1e-6, atol=1e-8)
    assert banded.log_determinant == pytest.approx(np.linalg.slogdet(S)[1], abs=1e-6)
    alone = inverse @ values[:, 0] / np.sqrt(np.diag(inverse))
    np.testing.assert_allclose(banded.standardised(values[:, 0]), alone, rtol=1e-6, atol=1e-8)
    shared = S - np.diag(white)
    np.testing.assert_allclose(
        banded.process_of(values[:, 0]), shared @ inverse @ values[:, 0], rtol=1e-5, atol=1e-7
    )
    assert banded.process_trace() == pytest.approx(np.trace(inverse @ shared), rel=1e-6, abs=1e-8)


def walk_and_white(rng: np.random.Generator, t: np.ndarray, white: float, density: float) -> np.ndarray:
    steps = rng.normal(0, density * np.sqrt(np.diff(t, prepend=t[0])))
    return np.cumsum(steps) + rng.normal(0, white, len(t))


def test_sigma_of_a_slope_is_the_scatter_of_many() -> None:
    rng = np.random.default_rng(7)
    t, chain = np.arange(0, 12, 0.05), np.zeros(240, np.int64)
    shape = np.sin(1.3 * t) + 0.4 * np.cos(3.1 * t)
    z = []
    for _ in range(60):
        target = 2.0 * shape + 5.0 + walk_and_white(rng, t, 0.03, 0.05)
        fit = fit_lines(
            shape[:, None], target, np.full(240, 0.01**2), lambda d: Process.walk(t, chain, d), 0.01
        )
        z.append((fit.values[0] - 2.0) / np.sqrt(fit.covariance[0, 0]))
    assert abs(np.mean(z)) < 0.45
    assert 0.75 < np.std(z) < 1.3


def test_both_sizes_of_noise_are_found() -> None:
    rng = np.random.default_rng(3)
    t, chain = np.arange(0, 60, 0.05), np.zeros(1200, np.int64)
    scales, sizes = [], []
    for _ in range(5):
        target = walk_and_white(rng, t, 0.02, 0.04)
        scale, size = find_noise(
            np.zeros((1200, 0)),
            target,
            np.full(1200, 0.01**2),
            lambda d: Process.walk(t, chain, d),
            1.0,
            0.01,
        )
        scales.append(scale)
        sizes.append(size)
    assert np.median(scales) == pytest.approx(4.0, rel=0.2)
    assert np.median(sizes) == pytest.approx(0.04, rel=0.2)


def test_outliers_do_not_move_a_fit() -> None:
    rng = np.random.default_rng(5)
    t, chain = np.arange(0, 15, 0.05), np.zeros(300, np.int64)
    shape = np.sin(1.3 * t)
    target = 2.0 * shape + walk_and_white(rng, t, 0.02, 0.01)
    spoilt = target.copy()
    spoilt[rng.choice(300, 24, replace=False)] += rng.choice([-0.5, 0.7], 24)

    def fit(values: np.ndarray) -> float:
        white = np.full(300, 0.02**2)
        return float(
            fit_lines(shape[:, None], values, white, lambda d: Process.walk(t, chain, d), 0.01).values[0]
        )

    assert fit(spoilt) == pytest.approx(fit(target), abs=0.015)


def test_chains_begin_anywhere() -> None:
    """A step between chains is no evidence about the slope."""
    t = np.arange(0, 10, 0.1)
    chain = (t > 5).astype(np.int64)
    slope = t - 5.0
    target = 0.3 * slope + np.where(chain, 40.0, -3.0)
    noise = Noise(np.full(100, 1e-4), Process.walk(t, chain, 0.01))
    values, _ = solve(slope[:, None], target, noise)
    assert values[0] == pytest.approx(0.3, abs=2e-3)
