"""Velocities that contradict the lateral offset are named and not used."""

from __future__ import annotations

from collections.abc import Callable
from math import nan

import numpy as np
import pytest

from fusion import CorridorEstimator, Fault, FusionConfig
from fusion.estimator.lateral.speed_check import AVERAGE_S, SpeedCheck
from tests.fusion.simulated import frame

MS = 1_000_000
HALF_M = 1.1
AHEAD_M_S = 1.5
Velocity = tuple[float, float, float]


def test_a_lasting_contradiction_is_found_and_an_agreement_ends_it() -> None:
    check = SpeedCheck()
    for _ in range(round(AVERAGE_S / 0.05)):
        check = check.with_innovation(0.4, 0.1**2, 0.05)
    assert check.is_contradicted
    assert check.notice() is not None
    for _ in range(round(2 * AVERAGE_S / 0.05)):
        check = check.with_innovation(0.05, 0.1**2, 0.05)
    assert not check.is_contradicted
    assert check.notice() is None


def test_single_outliers_and_samples_without_an_interval_are_not_enough() -> None:
    check = SpeedCheck()
    for k in range(200):
        check = check.with_innovation(50.0 if k % 10 == 0 else 0.1, 0.1**2, 0.05)
        assert not check.is_contradicted
    assert check.with_innovation(50.0, 0.1**2, nan) == check


def weave(seed: int, given: Callable[[Velocity], Velocity]) -> tuple[np.ndarray, np.ndarray, bool]:
    """Fly from side to side for 20 s; return errors (n,) and sigmas (n,) of the offset, and whether it was named."""
    rng = np.random.default_rng(seed)
    estimator = CorridorEstimator(FusionConfig(corridor_width_m=2 * HALF_M))
    error, sigma, named = [], [], False
    for k in range(2000):
        t_s, t_ns = 0.01 * k, k * 10 * MS
        y, rate = 0.4 * np.sin(0.9 * t_s), 0.4 * 0.9 * np.cos(0.9 * t_s)  # metres
        across = -0.4 * 0.81 * np.sin(0.9 * t_s)
        estimator.add_imu(
            t_ns, (0.0, 0.0, rng.normal(0.0, 0.03)), (0.0, across + rng.normal(0.0, 0.1), -9.81)
        )
        if k % 4 == 1:
            estimator.add_attitude(t_ns, (1.0, 0.0, 0.0, 0.0))
        if k % 5 == 2:
            velocity = (AHEAD_M_S, rate + rng.normal(0.0, 0.05), 0.0)
            estimator.add_velocity(t_ns, given(velocity))
        if k % 5 == 4:
            seen = rng.normal(y / HALF_M, 0.03)
            estimator.add_measurement(t_ns, frame(rng.normal(0.0, 0.004), 0.004, seen, 0.03))
        if k > 300:
            e = estimator.estimate()
            error.append(e.lateral_offset_norm - y / HALF_M)
            sigma.append(e.lateral_offset_norm_std)
            named |= Fault.VELOCITY_CONTRADICTED in e.faults
    return np.array(error), np.array(sigma), named


@pytest.mark.parametrize("seed", range(3))
def test_right_velocities_contradict_nothing(seed: int) -> None:
    error, sigma, named = weave(seed, lambda v: v)
    assert not named
    assert np.isfinite(error).mean() > 0.95
    assert (np.abs(error) < 4 * sigma)[np.isfinite(error)].all()


@pytest.mark.parametrize(
    "given",
    [
        lambda v: (v[0], v[1] + 1.5, v[2]),
        lambda v: (v[1], v[0], v[2]),
        lambda v: (v[0], -v[1], v[2]),
    ],
    ids=["biased", "swapped", "sign"],
)
def test_wrong_velocities_are_named_and_the_offset_stays(given: Callable[[Velocity], Velocity]) -> None:
    error, sigma, named = weave(0, given)
    assert named
    assert np.isfinite(error).mean() > 0.8
    assert (np.abs(error) < 4 * sigma)[np.isfinite(error)].mean() > 0.99
