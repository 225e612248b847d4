"""Gyroscope samples that cannot be true: refused, bridged, counted and told of, and no true one is."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pytest

from fusion import CorridorEstimator, FusionConfig
from fusion.estimator.faults import Fault
from fusion.estimator.gyro_checks import GyroCheck, GyroVerdict, rate_that_bridges, with_sample
from fusion.estimator.propagation import ImuSample
from tests.fusion.simulated import frame

CONFIG = FusionConfig()
STEP_NS = 5_000_000


def samples(rates: Iterable[float]) -> list[ImuSample]:
    return [ImuSample(k * STEP_NS, (0.0, 0.0, float(r)), None) for k, r in enumerate(rates)]


def verdicts(rates: Iterable[float], config: FusionConfig = CONFIG) -> list[GyroVerdict]:
    check, found = GyroCheck(), []
    for s in samples(rates):
        check = with_sample(check, s, config)
        found.append(check.verdict)
    return found


def noise(n: int, std: float = 0.05, seed: int = 0) -> list[float]:
    return [float(v) for v in np.random.default_rng(seed).normal(0.0, std, n)]


@pytest.mark.parametrize("rate", [35.1, -300.0, 1e308])
def test_beyond_the_range_is_refused(rate: float) -> None:
    assert verdicts([0.1, rate, 0.1])[1:] == [GyroVerdict.OUT_OF_RANGE, GyroVerdict.GOOD]


def test_a_spike_is_held_back_and_the_next_sample_is_not() -> None:
    assert verdicts([0.0, 8.0, 8.0, 0.1]) == ["good", "spike", "spike", "good"]


@pytest.mark.parametrize("frozen", [40, 200])
def test_a_spike_after_a_frozen_stretch_is_held_back_too(frozen: int) -> None:
    rates = noise(100)
    found = verdicts([*rates, *[rates[-1]] * frozen, 30.0, 0.02, *noise(5, seed=1)])
    assert found[100 + frozen - 1] == "frozen"
    assert found[100 + frozen :] == ["spike", *["good"] * 6]


def test_a_leap_that_lasts_is_believed_and_loses_no_angle() -> None:
    rates = [0.0, *[8.0] * 5]
    found = verdicts(rates)
    assert found == ["good", *["spike"] * 4, "confirmed"]
    check = GyroCheck()
    *earlier, last = samples(rates)
    for s in earlier:
        check = with_sample(check, s, CONFIG)
    turned = 0.5 * (rate_that_bridges(check, last)[2] + 8.0) * 5 * STEP_NS
    assert turned == pytest.approx((0.5 * 8.0 + 4 * 8.0) * STEP_NS)


def test_a_fast_turn_and_vibration_are_true() -> None:
    turn = 12.0 * np.sin(np.arange(400) * STEP_NS * 1e-9 * 2 * np.pi * 2.0)
    shaking = turn + np.array(noise(400, 0.3))
    assert set(verdicts(shaking)) == {"good"}


def test_clipping_is_found_at_the_range_and_at_one_that_is_not_configured() -> None:
    assert verdicts([33.0, 34.5, 35.0])[1:] == ["clipped", "clipped"]
    check = GyroCheck()
    found = []
    cross = noise(200, seed=1)
    for k, rate in enumerate(np.clip(np.array(noise(200)) + np.linspace(0, 6, 200), -4.0, 4.0).tolist()):
        check = with_sample(check, ImuSample(k * STEP_NS, (cross[k], 0.0, rate), None), CONFIG)
        found.append(check.verdict)
    assert set(found[:120]) == {"good"}
    assert set(found[-40:]) == {"clipped"}


def test_a_noisy_gyro_that_repeats_itself_is_frozen_and_an_exact_one_is_not() -> None:
    before = noise(100)
    assert verdicts([*before, *[0.2] * 20])[-1] == "frozen"
    assert verdicts([*before, *[0.2] * 20, 0.21])[-1] == "good"
    exact = np.sin(np.arange(100) * 0.02)
    assert set(verdicts([*exact.tolist(), *[0.2] * 100])) == {"good"}


def test_coarse_steps_and_a_slow_sensor_read_often_are_not_frozen() -> None:
    coarse = np.round(np.array(noise(4000, 0.02)) / 0.01) * 0.01
    assert set(verdicts(coarse)) == {"good"}
    assert set(verdicts(np.repeat(noise(400), 9))) == {"good"}  # 22 Hz, at 200 Hz


def flown(rates: dict[int, float], seconds: float = 3.0) -> CorridorEstimator:
    """Hover, frames at 20 Hz; some gyroscope samples read these rates instead."""
    estimator = CorridorEstimator()
    rng = np.random.default_rng(5)
    for k in range(round(seconds * 200)):
        p, q, r = rng.normal(0.0, 0.05, 3)
        estimator.add_imu(k * STEP_NS, (p, q, rates.get(k, r)), (0.0, 0.0, -9.8))
        if k % 10 == 0:
            estimator.add_measurement(k * STEP_NS, frame(float(rng.normal(0.0, 0.005)), 0.005))
    return estimator


@pytest.mark.parametrize(
    ("rate", "name", "fault"),
    [(300.0, "imu_out_of_range", Fault.GYRO_OUT_OF_RANGE), (20.0, "imu_spike", Fault.GYRO_SPIKES)],
)
def test_what_cannot_be_is_counted_and_told_and_moves_nothing(rate: float, name: str, fault: Fault) -> None:
    estimator = flown({580: rate, 590: -rate})
    estimate = estimator.estimate()
    assert estimator.counters[name] == 2
    assert estimate.faults & fault
    assert "gyroscope" in estimate.reason
    assert estimate.heading_rad == pytest.approx(flown({}).estimate().heading_rad, abs=0.003)
    assert flown({}).estimate().reason == ""


def test_clipping_widens_the_heading() -> None:
    clipped = flown(dict.fromkeys(range(560, 600), 34.9))
    plain = flown({})
    assert clipped.counters["imu_clipped"] > 20
    assert clipped.estimate().heading_std_rad > 10 * plain.estimate().heading_std_rad
    assert clipped.estimate().faults & Fault.GYRO_CLIPPED
