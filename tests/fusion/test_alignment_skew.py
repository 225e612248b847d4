"""Clocks that run at different rates, from made-up headings whose answers are known."""

from __future__ import annotations

from math import pi, radians

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from fusion.alignment.skew import SkewedClock, find_skewed_clock
from fusion.alignment.turning import Turning
from tests.fusion.test_alignment_clock import FRAME_HZ, GYRO_HZ, heading, sightings, weave


def look(seed: int, skew: float, offset_s: float = 0.0, duration_s: float = 20.0) -> SkewedClock:
    """Look at a flight whose frames, stamped t, were taken at (1 + skew) t + offset by the gyroscope's clock."""
    rng = np.random.default_rng((seed, 3))
    curve = weave(seed, radians(15.0))
    t = np.arange(-3.0, duration_s + 3.0, 1 / GYRO_HZ)
    walk = np.cumsum(rng.normal(0, 0.005 / np.sqrt(GYRO_HZ), len(t)))
    down, tilt_std = np.tile([0.0, 0.0, 1.0], (len(t), 1)), np.full(len(t), 0.01)
    turning = Turning(t, heading(t, curve) + 0.02 * t + walk, down, tilt_std, 0.1, True, 0.005)
    stamps = np.arange(0.0, duration_s - 1.0, 1 / FRAME_HZ)
    seen = heading((1.0 + skew) * stamps + offset_s, curve) + rng.normal(0, radians(0.15), len(stamps))
    seen = (seen + pi / 2) % pi - pi / 2
    return find_skewed_clock(sightings(stamps, seen, radians(0.15)), turning, 3.0)


@example(833, 0.004, 1.0, 0.0)
@given(st.integers(0, 10_000), st.floats(0.004, 0.02), st.sampled_from([-1.0, 1.0]), st.floats(-0.8, 0.8))
@settings(max_examples=8, deadline=None)
def test_a_fast_clock_is_told_as_a_rate(seed: int, size: float, sign: float, offset_s: float) -> None:
    found = look(seed, sign * size, offset_s)
    if not found.skew:  # below five sigma it is left alone
        assert size < 8 * found.skew_std
        return
    assert found.skew == pytest.approx(sign * size, abs=max(5 * found.skew_std, 5e-4))
    assert found.skew_std < 0.0015
    fit = found.search.fit
    assert fit is not None
    assert fit.offset_s == pytest.approx(
        offset_s, abs=0.01 + 50 * found.skew_std
    )  # five sigma, ten seconds from the middle


def test_clocks_that_run_alike_are_left_alone() -> None:
    assert [look(seed, 0.0, 0.3).skew for seed in range(16)] == [0.0] * 16


def test_a_skew_that_hides_the_offset_is_found() -> None:
    """Over two minutes the ends part by more than a turn lasts: no offset explains the whole."""
    found = look(5, 0.01, 0.2, duration_s=120.0)
    assert found.skew == pytest.approx(0.01, abs=5e-4)
    assert found.search.fit is not None
    assert found.search.fit.offset_s == pytest.approx(0.2, abs=0.01)
