"""Stamps that are early or late show as an offset against the gyroscope; nothing else passes for one."""

from __future__ import annotations

from collections.abc import Callable
from math import atan, inf, pi, radians, sin, sqrt, tan

import numpy as np
import pytest

from fusion import CorridorEstimator, FusionConfig
from fusion.estimator.faults import Fault
from fusion.estimator.installation.frame_timing import MIN_BLOCKS, FrameTiming
from tests.fusion.simulated import frame

MS = 1_000_000


def weaving(t: float) -> float:
    return radians(30) * sin(1.3 * t)


def seen(
    heading: Callable[[float], float] = weaving,
    late_s: Callable[[float], float] = lambda t: 0.0,
    seconds: float = 30.0,
    hz: float = 30.0,
    *,
    std_deg: float = 0.4,
    scale: float = 0.0,
    focal: float = 0.0,
    walk: float = 0.003,
    gross: float = 0.05,
    seed: int = 0,
) -> FrameTiming:
    """Fly with a gyroscope of this scale error and random walk, a camera of this error of its focal length."""
    rng, timing, wander = np.random.default_rng(seed), FrameTiming(), 0.0
    for k in range(int(seconds * hz)):
        t = k / hz
        wander += rng.normal(0.0, walk / sqrt(hz))
        shown = atan((1.0 + focal) * tan(heading(t - late_s(t)))) + rng.normal(0.0, radians(std_deg))
        shown += rng.normal(0.0, 0.15) * (rng.random() < gross)
        gyro = (1.0 + scale) * heading(t) + 0.01 * t + wander
        timing = timing.with_frame(round(t * 1e9), shown, gyro, radians(std_deg))
    return timing


@pytest.mark.parametrize("late_s", [-0.1, -0.07, 0.06, 0.07, 0.15])
@pytest.mark.parametrize("hz", [10.0, 30.0, 60.0])
def test_a_constant_offset_is_measured_with_its_sign(late_s: float, hz: float) -> None:
    timing = seen(late_s=lambda t: late_s, hz=hz)
    assert timing.is_off
    assert abs(timing.late_s - late_s) < max(4.0 * timing.std_s, 0.1 * abs(late_s))


@pytest.mark.parametrize("drift", [0.003, -0.003, 0.01])
def test_a_clock_that_runs_wrong_is_found_within_twenty_seconds(drift: float) -> None:
    timing = seen(late_s=lambda t: drift * t, seconds=20.0)
    assert timing.is_off
    assert timing.late_s * drift > 0.0


@pytest.mark.parametrize("seed", range(40))
def test_nothing_else_passes_for_an_offset(seed: int) -> None:
    """Scale of the gyroscope, focal length, wander, bias, gross frames, fast turns and slow ones."""
    rng = np.random.default_rng((seed, 1))
    amplitude, periods = radians(rng.uniform(3, 40)), rng.uniform(2.0, 20.0) / rng.uniform(0.5, 1.5, 3)
    phases = rng.uniform(0.0, 2 * pi, 3)
    timing = seen(
        lambda t: amplitude / 3 * sum(sin(2 * pi * t / p + a) for p, a in zip(periods, phases, strict=True)),
        seconds=40.0,
        hz=float(rng.choice([5, 15, 30, 60])),
        std_deg=float(rng.uniform(0.1, 1.5)),
        scale=float(rng.normal(0.0, 0.02)),
        focal=float(rng.uniform(-0.1, 0.1)),
        walk=float(rng.uniform(0.001, 0.01)),
        seed=seed,
    )
    assert not timing.is_off


@pytest.mark.parametrize("std_rad", [1e-300, 5e-324, 1e-9, 3.0])
def test_any_sigma_leaves_numbers(std_rad: float) -> None:
    timing = FrameTiming()
    for k in range(300):
        t = k / 30
        timing = timing.with_frame(round(t * 1e9), weaving(t), weaving(t), std_rad)
    assert np.isfinite(timing.late_s)
    assert not timing.is_off


def test_without_turns_nothing_is_known() -> None:
    assert seen(lambda t: 0.1, late_s=lambda t: 0.1).std_s == inf


def test_another_axis_or_a_gap_starts_no_turn() -> None:
    timing = seen(seconds=0.5 * MIN_BLOCKS + 2.0)
    jumped = timing.with_frame(round(60e9), 1.0, 0.0, 0.01)
    assert jumped.late_s == timing.late_s
    assert jumped.level is None
    again = jumped.with_frame(round(60.03e9), 1.5, 0.0, 0.01)  # by a quarter turn, within a frame
    assert again.level is None


@pytest.mark.parametrize("late_ms", [0, 60, -60])
def test_the_estimator_names_the_offset(late_ms: int) -> None:
    rng = np.random.default_rng(3)
    estimator = CorridorEstimator(FusionConfig())
    for ms in range(0, 15_000, 5):
        t = ms * 1e-3
        rate = (weaving(t + 1e-4) - weaving(t - 1e-4)) / 2e-4
        estimator.add_imu((1_000 + ms) * MS, (0.0, 0.0, rate + rng.normal(0.0, 0.02)), (0.0, 0.0, -9.8))
        if ms % 35 == 0 and ms >= 200:
            shown = weaving(t - 0.1) + rng.normal(0.0, radians(0.4))
            estimator.add_measurement((1_000 + ms - 100 + late_ms) * MS, frame(shown, radians(0.4)))
    found = estimator.estimate()
    assert (Fault.CAMERA_CLOCK in found.faults) == (late_ms != 0)
    if late_ms:
        assert f"frames are stamped 60 ms {'late' if late_ms > 0 else 'early'}" in found.reason


@pytest.mark.parametrize("step_deg", [-12.0, -3.0, 6.0, 15.0])
@pytest.mark.parametrize("at_s", [4.0, 5.2, 6.4])
@pytest.mark.parametrize("std_deg", [0.1, 0.4])
def test_a_camera_that_is_knocked_is_not_late(step_deg: float, at_s: float, std_deg: float) -> None:
    """Nor does the step hide that the frames are late."""
    rng, right, late = np.random.default_rng(6), FrameTiming(), FrameTiming()
    found = []
    for k in range(240):
        t = k / 12
        error = radians(step_deg) * (t > at_s) + rng.normal(0.0, radians(std_deg))
        right = right.with_frame(round(t * 1e9), weaving(t) + error, weaving(t), radians(std_deg))
        late = late.with_frame(round(t * 1e9), weaving(t - 0.08) + error, weaving(t), radians(std_deg))
        found.append(right.is_off)
    assert not any(found)
    assert late.is_off
    assert late.late_s == pytest.approx(0.08, abs=0.03)
