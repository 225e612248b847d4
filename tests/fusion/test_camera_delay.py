"""The camera's delay as an estimate: found in turns, left open without, honest about both."""

from __future__ import annotations

import random
from dataclasses import asdict, replace
from math import radians
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion.estimator.camera_delay import (
    AxisFilter,
    AxisNoise,
    Delay,
    TurnPoint,
    initial_delay,
    turned_at,
    with_turns,
)
from fusion.estimator.config import FusionConfig
from fusion.estimator.estimate import Estimate
from fusion.estimator.estimator import CorridorEstimator
from fusion.estimator.state import Entry
from tests.fusion.simulated import Sample, Scene, Simulated, config_for, give, simulate, weaving, wrap

MS = 1_000_000
TOLD_S, STD_S = 0.06, 0.03


def flight(seed: int, late_s: float, seconds: float, degrees: float = 30.0) -> Simulated:
    """Weave; frames are stamped, and arrive, later than they were taken."""
    scene = Scene(
        duration_s=seconds, seed=seed, heading=weaving(seed, radians(degrees), 5.0), gyro_hz=100, frame_hz=20
    )
    late_ns = round(late_s * 1e9)
    simulated = simulate(scene)
    samples = [
        replace(s, t_ns=s.t_ns + late_ns, arrival_ns=s.arrival_ns + late_ns) if s.kind == "frame" else s
        for s in simulated.samples
    ]
    return replace(simulated, samples=sorted(samples, key=lambda s: s.arrival_ns))


def flown(simulated: Simulated, every_s: float = 0.5, **config: Any) -> list[Estimate]:
    """Estimates every so often, the last one included."""
    values = {"camera_delay_s": TOLD_S, "camera_delay_std_s": STD_S} | config
    estimator = CorridorEstimator(config_for(simulated.scene, **values))
    found, next_s = [], 2.0
    for sample in simulated.samples:
        give(estimator, sample)
        if sample.kind == "imu" and sample.t_ns * 1e-9 >= next_s:
            next_s += every_s
            found.append(estimator.estimate())
    return [*found, estimator.estimate()]


@pytest.mark.parametrize("error_s", [-0.03, 0.03])
def test_it_is_found_while_the_vehicle_turns(error_s: float) -> None:
    for seed in range(2):
        end = flown(flight(seed, TOLD_S + error_s, 40.0))[-1]
        assert end.camera_delay_std_s < 0.3 * STD_S
        assert abs(end.camera_delay_s - TOLD_S - error_s) < 3 * end.camera_delay_std_s


def test_without_turning_it_stays_open() -> None:
    for seed in range(2):
        end = flown(flight(seed, TOLD_S + 0.03, 30.0, degrees=0.2))[-1]
        assert 0.95 * STD_S < end.camera_delay_std_s <= STD_S * (1.0 + 1e-12)  # but for rounding
        assert abs(end.camera_delay_s - TOLD_S) < 0.4 * STD_S


def test_noise_of_the_gyroscope_does_not_pass_for_a_delay() -> None:
    """The noise is both in the rate and in the heading's error; a Kalman state of the delay is led astray by it."""
    delays, headings, late = [], [], []
    for seed in range(14):
        error_s = float(np.random.default_rng(seed).normal(0, STD_S))
        simulated = flight(seed, max(TOLD_S + error_s, 0.0), 25.0)
        found = flown(simulated)
        ratio = (found[-1].camera_delay_s - max(TOLD_S + error_s, 0.0)) / found[-1].camera_delay_std_s
        delays.append(ratio**2)
        late.append(ratio)
        t = np.array([e.timestamp_ns * 1e-9 for e in found])
        wrong = wrap([e.heading_rad for e in found] - np.interp(t, simulated.t_s, simulated.heading))
        headings.append((wrong / [e.heading_std_rad for e in found]) ** 2)
    assert 0.3 < np.mean(delays) < 1.9  # 99 % of the time, of 14
    assert abs(np.mean(late)) < 0.7
    assert 0.9 < np.mean(headings) < 1.1


def test_by_default_it_is_as_told() -> None:
    end = flown(flight(0, TOLD_S, 5.0), camera_delay_std_s=0.0)[-1]
    assert end.camera_delay_s == TOLD_S
    assert np.isnan(end.camera_delay_std_s)
    assert initial_delay(FusionConfig(camera_delay_s=0.1)) is None


def everything(samples: list[Sample]) -> list[Any]:
    seen: list[Any] = []

    def keep(entry: Entry) -> None:
        seen.append((entry.t_ns, entry.after.x.tobytes(), entry.after.P.tobytes(), entry.after.delay))

    config = FusionConfig(camera_delay_s=TOLD_S, camera_delay_std_s=STD_S)
    estimator = CorridorEstimator(config, on_final=keep)
    for sample in samples:
        give(estimator, sample)
    last = repr(asdict(estimator.estimate()))
    estimator.finish()
    return [*seen, last]


@pytest.mark.parametrize("seed", [0, 1])
def test_any_order_gives_the_same_bits(seed: int) -> None:
    samples = sorted(flight(4, TOLD_S + 0.02, 5.0).samples, key=lambda s: s.t_ns)
    rng = random.Random(seed)
    arrivals = [
        (s.t_ns + (rng.uniform(0, 150 * MS) if rng.random() < 0.3 else 0.0), i) for i, s in enumerate(samples)
    ]
    expected = everything(samples)
    assert expected[-2][3].spread > 0.0  # frames have told of it
    assert everything([samples[i] for _, i in sorted(arrivals)]) == expected


def test_it_outlasts_a_silent_gyroscope() -> None:
    simulated = flight(3, TOLD_S + 0.03, 30.0)
    gap = replace(
        simulated,
        samples=[s for s in simulated.samples if s.kind != "imu" or not 20.0 <= s.t_ns * 1e-9 < 21.0],
    )
    found = flown(gap)
    before = next(e for e in found if e.timestamp_ns * 1e-9 > 19.4)
    after = next(e for e in found if e.timestamp_ns * 1e-9 > 21.0)
    assert after.camera_delay_std_s == pytest.approx(before.camera_delay_std_s, rel=0.1)
    assert found[-1].camera_delay_std_s < after.camera_delay_std_s
    assert abs(found[-1].camera_delay_s - TOLD_S - 0.03) < 3 * found[-1].camera_delay_std_s


def test_it_stays_within_its_bounds() -> None:
    known: dict[str, Any] = {"gain": 1e6, "spread": 1e6}
    start = initial_delay(FusionConfig(camera_delay_s=0.02, camera_delay_std_s=0.03, buffer_s=0.05))
    assert start is not None
    assert start.late_s == 0.0
    assert start.variance == pytest.approx(0.03**2)
    assert start._replace(evidence=-1e6, **known).late_s == pytest.approx(-0.02)
    assert start._replace(evidence=1e6, **known).late_s == pytest.approx(0.03)
    assert start._replace(evidence=1e4, **known).late_s == pytest.approx(0.01, rel=1e-2)
    assert start._replace(evidence=1e4, **known).variance == pytest.approx(1e-6, rel=1e-2)


def test_dead_reckoning_is_kept_thinned_and_read_between_its_points() -> None:
    delay = Delay(0.03)
    for k in range(600):
        delay = with_turns(delay, [k * 5 * MS], [0.1 * k])
    t = np.array([p.t_ns for p in delay.turns])
    assert len(t) < 60
    assert (t[2:-1] - t[:-3]).min() >= 20 * MS
    assert t[-1] == 599 * 5 * MS
    for when in (2_600 * MS, 2_613 * MS, 2_994 * MS):
        assert turned_at(delay.turns, when) == pytest.approx(0.1 * when / (5 * MS))
    assert turned_at((TurnPoint(0, 1.0), TurnPoint(10, 2.0)), -5) == 1.0


def test_the_axis_filter_is_a_kalman_filter_of_axis_and_bias() -> None:
    noise = AxisNoise(0.01, 0.02, 0.001, 0.0)
    axis = AxisFilter(0.2, 0.01, (0.01, 0.001, 0.004), (0.3, 0.1))
    x, P = np.array([0.2, 0.01]), np.array([[0.01, 0.001], [0.001, 0.004]])
    dt, H, R = 0.5, np.array([1.0, 0.0]), 0.02
    F = np.array([[1.0, dt], [0.0, 1.0]])
    walk = 0.001**2
    Q = np.array([[0.01**2 * dt + walk * dt**3 / 3, walk * dt**2 / 2], [walk * dt**2 / 2, walk * dt]])
    x, P, D = F @ x, F @ P @ F.T + Q, F @ [0.3, 0.1]
    K = P @ H / (P[0, 0] + R)
    found = axis.predicted(dt, noise).updated(0.05, -0.7, R)
    P = P - np.outer(K, H @ P)
    assert (found.angle_rad, found.bias_rad_s) == pytest.approx(tuple(x + K * 0.05))
    assert (found.P[0], found.P[1], found.P[2]) == pytest.approx((P[0, 0], P[0, 1], P[1, 1]))
    assert found.per_s == pytest.approx(tuple(D + K * -0.7))


@given(st.lists(st.integers(1, 120), min_size=1, max_size=80), st.integers(0, 80))
def test_turns_at_once_are_those_one_by_one(steps_ms: list[int], first: int) -> None:
    times = np.cumsum(steps_ms).tolist()
    times = [t * MS for t in times]
    angles = [0.01 * k for k in range(len(times))]
    one_by_one = Delay(0.02)
    for t_ns, angle in zip(times, angles, strict=True):
        one_by_one = with_turns(one_by_one, [t_ns], [angle])
    begun = with_turns(Delay(0.02), times[:first], angles[:first])
    assert with_turns(begun, times[first:], angles[first:]) == one_by_one
    assert one_by_one.turns[-1] == (times[-1], angles[-1])
    assert all(
        c.t_ns - a.t_ns >= 20 * MS for a, c in zip(one_by_one.turns, one_by_one.turns[2:], strict=False)
    )
