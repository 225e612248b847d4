from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion.estimator.noise_adaptation import (
    SourceNoise,
    correlation,
    equivalent_white_variance,
    inlier_probability,
    learn,
    weakened_variance,
)


@given(st.floats(0.0, 1.0), st.floats(1e-6, 1.0), st.floats(0.02, 0.7))
def test_odds_fall_with_the_residual(residual: float, variance: float, share: float) -> None:
    here, further = (inlier_probability(r, variance, share, 0.3) for r in (residual, residual * 1.5 + 0.01))
    assert 0.0 <= further <= here <= 1.0


def test_odds_are_bayess_rule() -> None:
    likely = 1 / np.sqrt(2 * np.pi * 0.04)
    assert inlier_probability(0.0, 0.04, 0.2, 0.5) == pytest.approx(0.8 * likely / (0.8 * likely + 0.2 * 0.5))


@given(st.floats(1e-6, 1.0), st.floats(1e-6, 1.0), st.floats(0.01, 1.0))
def test_weakened_gain_is_the_gain_times_the_odds(
    variance: float, predicted: float, probability: float
) -> None:
    weak = weakened_variance(variance, predicted, probability)
    gain = predicted / (predicted + variance)
    assert predicted / (predicted + weak) == pytest.approx(probability * gain)


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.8])
@pytest.mark.parametrize("process_variance", [0.01, 0.1, 1.0])
def test_errors_that_resemble_each_other_leave_the_filter_as_sure_as_it_should_be(
    rho: float, process_variance: float
) -> None:
    """A random walk, measured with errors of a first-order process; on average the error is what the filter says."""
    rng, n = np.random.default_rng(3), 12_000
    steps, kicks = rng.normal(size=(2, n))
    x = error = found = 0.0
    P, ratios = 1.0, []
    for step, kick in zip(steps, kicks, strict=True):
        x += np.sqrt(process_variance) * step
        P += process_variance
        error = rho * error + np.sqrt(1 - rho**2) * kick
        gain = P / (P + equivalent_white_variance(1.0, P, rho))
        found += gain * (x + error - found)
        P *= 1 - gain
        ratios.append((found - x) ** 2 / P)
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.12)


@given(st.floats(1e-6, 1.0), st.floats(1e-9, 10.0), st.floats(0.0, 0.95))
def test_variance_in_place_of_correlation_has_its_bounds(
    variance: float, predicted: float, rho: float
) -> None:
    R = equivalent_white_variance(variance, predicted, rho)
    kept = R / (predicted + R)
    assert pytest.approx(variance * (1 + kept * rho) / (1 - kept * rho), rel=1e-6) == R
    assert variance * (1 - 1e-9) <= R <= variance * (1 + rho) / (1 - rho) * (1 + 1e-9)
    assert equivalent_white_variance(variance, predicted, 0.0) == pytest.approx(variance)


def test_correlation_falls_with_time() -> None:
    assert correlation(5_000_000_000, 4_900_000_000, 0.1) == pytest.approx(np.exp(-1))
    assert correlation(5_000_000_000, None, 0.1) == 0.0
    assert correlation(5_000_000_000, 4_900_000_000, 0.0) == 0.0
    assert correlation(5, 5, 0.1) < 1.0


def learned(sigma_factor: float, gross: float, seed: int = 0, n: int = 600) -> SourceNoise:
    rng, noise, stated, predicted = np.random.default_rng(seed), SourceNoise(), 0.01**2, 0.004**2
    for _ in range(n):
        is_gross = rng.uniform() < gross
        r = rng.uniform(-1, 1) if is_gross else rng.normal(0, np.sqrt(predicted + sigma_factor**2 * stated))
        S = predicted + stated * noise.inflation
        accepted = r * r < 16 * S
        noise = learn(
            noise,
            r,
            predicted,
            stated,
            inlier_probability(r, S, noise.outlier_share, 0.3) if accepted else 0.0,
        )
    return noise


@pytest.mark.parametrize("factor", [2.0, 3.0])
def test_sigma_that_is_too_small_is_found_out(factor: float) -> None:
    found = [learned(factor, 0.05, seed).inflation for seed in range(5)]
    assert np.mean(found) == pytest.approx(factor**2, rel=0.4)


def test_honest_or_cautious_sigma_is_taken_as_it_is() -> None:
    assert np.mean([learned(1.0, 0.05, seed).inflation for seed in range(10)]) < 1.1
    assert learned(0.5, 0.05).inflation == 1.0


@pytest.mark.parametrize("gross", [0.05, 0.5])
def test_share_of_gross_errors_is_learned(gross: float) -> None:
    found = np.mean([learned(1.0, gross, seed).outlier_share for seed in range(8)])
    assert found == pytest.approx(gross, abs=0.08)
    assert learned(1.0, gross).inflation < 1.3
