"""Scale and correlation of the frames' errors, learned from headings of which both are known."""

from __future__ import annotations

from math import exp, pi, radians, sqrt
from typing import Any

import numpy as np
import pytest

from fusion import CorridorEstimator, FusionConfig
from fusion.estimator.frame_noise import FrameNoise
from vision import FrameMeasurement, Reason

GYRO_NOISE = 0.0075  # rad/s/sqrt(Hz)


def learned(
    scale: float = 1.0,
    time_s: float = 0.0,
    *,
    seed: int = 0,
    hz: float = 30.0,
    drift_rad_s: float = 0.0,
    gross: float = 0.0,
    std_rad: float = radians(0.5),
    gyro_scale: float = 1.0,
) -> tuple[float, float, float]:
    """Mean scales and correlation time over the last of forty seconds; errors of a first-order process."""
    rng = np.random.default_rng(seed)
    rho = exp(-1.0 / (hz * time_s)) if time_s else 0.0
    noise, turned, error, found = FrameNoise(), 0.0, 0.0, []
    for k in range(round(40.0 * hz)):
        turned += GYRO_NOISE * sqrt(gyro_scale / hz) * rng.normal() + drift_rad_s / hz
        error = rho * error + sqrt(1.0 - rho * rho) * rng.normal()
        wrong = rng.uniform(-0.5, 0.5) if rng.uniform() < gross else 0.0
        difference = turned + error * sqrt(scale) * std_rad + wrong
        noise = noise.with_heading(round(k / hz * 1e9), difference, std_rad**2, GYRO_NOISE, 0.03)
        found.append((noise.scale, noise.correlation_s, noise.gyro_scale))
    scale, time_s, gyro_scale = np.exp(np.log(found[len(found) // 2 :]).mean(axis=0)).tolist()
    return scale, time_s, gyro_scale


@pytest.mark.parametrize("hz", [30.0, 120.0])
@pytest.mark.parametrize("scale", [0.25, 1.0, 6.0])
def test_the_scale_of_independent_errors_is_found(scale: float, hz: float) -> None:
    found, time_s, _ = np.mean([learned(scale, hz=hz, seed=seed) for seed in range(3)], axis=0)
    assert found == pytest.approx(scale, rel=0.25)
    assert time_s < 0.03


@pytest.mark.parametrize("time_s", [0.1, 0.5, 2.0])
def test_errors_that_last_are_no_small_ones(time_s: float) -> None:
    scale, found, _ = np.mean([learned(time_s=time_s, seed=seed) for seed in range(3)], axis=0)
    assert scale == pytest.approx(1.0, abs=0.25)
    assert found == pytest.approx(time_s, rel=0.35)


def test_a_gyroscope_that_drifts_is_no_noise_of_the_frames() -> None:
    scale, time_s, _ = learned(drift_rad_s=radians(2.0))
    assert scale == pytest.approx(1.0, abs=0.25)
    assert time_s < 0.03


def test_gross_errors_count_for_little() -> None:
    plain, _, _ = learned()
    spoilt, _, _ = learned(gross=0.02)
    assert spoilt < plain + 1.0  # their squares are a thousand times what is stated


def test_frames_a_second_apart_tell_nothing_that_is_not_stated() -> None:
    scale, _, _ = learned(hz=0.8)
    assert scale == pytest.approx(1.0)


@pytest.mark.parametrize("hz", [5.0, 10.0, 30.0])
@pytest.mark.parametrize("gyro_scale", [4.0, 9.0])
def test_a_gyroscope_noisier_than_told_is_found_by_precise_frames(hz: float, gyro_scale: float) -> None:
    found = np.mean(
        [learned(hz=hz, std_rad=radians(0.1), gyro_scale=gyro_scale, seed=seed) for seed in range(3)], axis=0
    )
    assert found[2] == pytest.approx(gyro_scale, rel=0.35)
    assert found[0] < 3.0


@pytest.mark.parametrize("hz", [5.0, 30.0])
@pytest.mark.parametrize(
    "wrong", [{}, {"scale": 6.0}, {"scale": 0.25}, {"time_s": 0.5}, {"time_s": 2.0}, {"gross": 0.1}]
)
def test_the_gyroscope_is_as_told_where_frames_explain_what_is_seen(hz: float, wrong: dict[str, Any]) -> None:
    assert learned(hz=hz, **wrong)[2] < 1.5


@pytest.mark.parametrize("seed", range(1, 6))
@pytest.mark.parametrize("hz", [5, 10])
def test_precise_frames_are_used_though_the_gyroscope_is_noisier_than_told(seed: int, hz: int) -> None:
    """As of a log with one in so many of its samples: twice the noise, turns to 50 degrees/s, few frames."""
    rng, imu_hz, std_rad = np.random.default_rng(seed), 50, radians(0.05)
    t = np.arange(0.0, 12.0, 1 / imu_hz)
    rates, phases = rng.uniform(1.0, 3.0, 3), rng.uniform(0.0, 2 * pi, 3)
    heading = radians(18.0) / 1.7 * np.sin(np.outer(t, rates) + phases).sum(axis=1)
    rate = np.gradient(heading, t) + rng.normal(0.0, 0.01)
    gyro = rate + rng.normal(0.0, 2.0 * GYRO_NOISE * sqrt(imu_hz), len(t))
    estimator = CorridorEstimator(FusionConfig(gyro_noise_density=GYRO_NOISE))
    refused, ratios = 0, []
    for k in range(len(t)):
        t_ns = round(t[k] * 1e9)
        estimator.add_imu(t_ns, (0.0, 0.0, gyro[k]), (0.0, 0.0, -9.81))
        if k % (imu_hz // hz) == 0:
            seen = heading[k] + rng.normal(0.0, std_rad)
            frame = FrameMeasurement(True, Reason.OK, 40, 30, heading_rad=seen, heading_std_rad=std_rad)
            reason = estimator.add_measurement(t_ns, frame).reason
            found = estimator.estimate()
            refused += reason is not Reason.OK
            if found.status != "initialising":
                ratios.append((found.heading_rad - heading[k]) / found.heading_std_rad)
    assert refused <= 2
    assert len(ratios) > 0.9 * 12 * hz
    assert np.abs(ratios).max() < 5.0
