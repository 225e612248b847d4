from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion.trust import Trust, genuine, learn, weakened


@given(st.floats(0.0, 1.0), st.floats(1e-6, 1.0), st.floats(0.02, 0.7))
def test_odds_fall_with_the_residual(residual: float, variance: float, share: float) -> None:
    here, further = (genuine(r, variance, share, 0.3) for r in (residual, residual * 1.5 + 0.01))
    assert 0.0 <= further <= here <= 1.0


def test_odds_are_bayess_rule() -> None:
    likely = 1 / np.sqrt(2 * np.pi * 0.04)
    assert genuine(0.0, 0.04, 0.2, 0.5) == pytest.approx(0.8 * likely / (0.8 * likely + 0.2 * 0.5))


@given(st.floats(1e-6, 1.0), st.floats(1e-6, 1.0), st.floats(0.01, 1.0))
def test_weakened_gain_is_the_gain_times_the_odds(
    variance: float, predicted: float, probability: float
) -> None:
    weak = weakened(variance, predicted, probability)
    gain = predicted / (predicted + variance)
    assert predicted / (predicted + weak) == pytest.approx(probability * gain)


def learned(sigma_factor: float, gross: float, seed: int = 0, n: int = 600) -> Trust:
    rng, trust, stated, predicted = np.random.default_rng(seed), Trust(), 0.01**2, 0.004**2
    for _ in range(n):
        is_gross = rng.uniform() < gross
        r = rng.uniform(-1, 1) if is_gross else rng.normal(0, np.sqrt(predicted + sigma_factor**2 * stated))
        S = predicted + stated * trust.inflation
        accepted = r * r < 16 * S
        trust = learn(trust, r, predicted, stated, genuine(r, S, trust.gross_share, 0.3) if accepted else 0.0)
    return trust


@pytest.mark.parametrize("factor", [2.0, 3.0])
def test_sigma_that_is_too_small_is_found_out(factor: float) -> None:
    found = [learned(factor, 0.05, seed).inflation for seed in range(5)]
    assert np.mean(found) == pytest.approx(factor**2, rel=0.4)


def test_honest_or_cautious_sigma_is_taken_as_it_is() -> None:
    assert np.mean([learned(1.0, 0.05, seed).inflation for seed in range(10)]) < 1.1
    assert learned(0.5, 0.05).inflation == 1.0


@pytest.mark.parametrize("gross", [0.05, 0.5])
def test_share_of_gross_errors_is_learned(gross: float) -> None:
    found = np.mean([learned(1.0, gross, seed).gross_share for seed in range(8)])
    assert found == pytest.approx(gross, abs=0.08)
    assert learned(1.0, gross).inflation < 1.3
