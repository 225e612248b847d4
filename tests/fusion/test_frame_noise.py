"""Scale and correlation of the frames' errors, learned from headings of which both are known."""

from __future__ import annotations

from math import exp, radians, sqrt

import numpy as np
import pytest

from fusion.estimator.frame_noise import FrameNoise

GYRO_NOISE = 0.0075  # rad/s/sqrt(Hz)
STATED = radians(0.5) ** 2


def learned(
    scale: float = 1.0,
    time_s: float = 0.0,
    *,
    seed: int = 0,
    hz: float = 30.0,
    drift_rad_s: float = 0.0,
    gross: float = 0.0,
) -> tuple[float, float]:
    """Mean scale and correlation time over the last of forty seconds; errors of a first-order process."""
    rng = np.random.default_rng(seed)
    rho = exp(-1.0 / (hz * time_s)) if time_s else 0.0
    noise, turned, error, found = FrameNoise(), 0.0, 0.0, []
    for k in range(round(40.0 * hz)):
        turned += GYRO_NOISE / sqrt(hz) * rng.normal() + drift_rad_s / hz
        error = rho * error + sqrt(1.0 - rho * rho) * rng.normal()
        wrong = rng.uniform(-0.5, 0.5) if rng.uniform() < gross else 0.0
        difference = turned + error * sqrt(scale * STATED) + wrong
        noise = noise.with_heading(round(k / hz * 1e9), difference, STATED, GYRO_NOISE, 0.03)
        found.append((noise.scale, noise.correlation_s))
    scale, time_s = np.exp(np.log(found[len(found) // 2 :]).mean(axis=0)).tolist()
    return scale, time_s


@pytest.mark.parametrize("hz", [30.0, 120.0])
@pytest.mark.parametrize("scale", [0.25, 1.0, 6.0])
def test_the_scale_of_independent_errors_is_found(scale: float, hz: float) -> None:
    found, time_s = np.mean([learned(scale, hz=hz, seed=seed) for seed in range(3)], axis=0)
    assert found == pytest.approx(scale, rel=0.25)
    assert time_s < 0.03


@pytest.mark.parametrize("time_s", [0.1, 0.5, 2.0])
def test_errors_that_last_are_no_small_ones(time_s: float) -> None:
    scale, found = np.mean([learned(time_s=time_s, seed=seed) for seed in range(3)], axis=0)
    assert scale == pytest.approx(1.0, abs=0.25)
    assert found == pytest.approx(time_s, rel=0.35)


def test_a_gyroscope_that_drifts_is_no_noise_of_the_frames() -> None:
    scale, time_s = learned(drift_rad_s=radians(2.0))
    assert scale == pytest.approx(1.0, abs=0.25)
    assert time_s < 0.03


def test_gross_errors_count_for_little() -> None:
    plain, _ = learned()
    spoilt, _ = learned(gross=0.02)
    assert spoilt < plain + 1.0  # their squares are a thousand times what is stated


def test_frames_a_second_apart_tell_nothing_that_is_not_stated() -> None:
    scale, _ = learned(hz=0.8)
    assert scale == pytest.approx(1.0)
