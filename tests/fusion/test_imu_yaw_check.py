from __future__ import annotations

from math import radians

import numpy as np
import pytest

from fusion.estimator.imu_yaw_check import (
    Trace,
    YawDriftStatistics,
    find_disturbance,
    is_due,
    is_independent,
    is_undisturbed,
    shifted_by,
    with_difference,
    with_trace,
)

GYRO, YAW = 0.0075, 0.009
S = 1_000_000_000


def statistics(
    seed: int, shared: bool, seconds: float = 90.0, steps: bool = False, gap_s: float = 0.0
) -> YawDriftStatistics:
    """Frames at 20 Hz over a gyroscope and a yaw that stray each on its own, or together."""
    rng = np.random.default_rng(seed)
    n = int(seconds * 20)
    gyro = np.cumsum(rng.normal(0, GYRO * np.sqrt(0.05), n))
    yaw = gyro + np.cumsum(rng.normal(0, 0.002 * np.sqrt(0.05), n))
    if not shared:
        yaw = np.cumsum(rng.normal(0, YAW * np.sqrt(0.05), n))
    if steps:
        yaw = yaw + np.where(np.arange(n) // 300 % 2 == 0, 0.0, radians(15))
    w = YawDriftStatistics()
    for i in range(n):
        if gap_s and 30 < i / 20 < 30 + gap_s:
            continue
        error = rng.normal(0, radians(0.6))
        w = with_difference(w, i * S // 20, error - gyro[i], error - yaw[i], radians(0.6) ** 2)
    return w


@pytest.mark.parametrize("steps", [False, True])
def test_a_yaw_of_its_own_is_told_from_the_same_gyroscope(steps: bool) -> None:
    own = [is_independent(statistics(seed, False, steps=steps), GYRO, YAW) for seed in range(20)]
    same = [is_independent(statistics(seed, True, steps=steps), GYRO, YAW) for seed in range(20)]
    assert sum(own) >= 15
    assert sum(same) == 0


def test_wander_is_measured() -> None:
    found = [statistics(seed, False, seconds=120) for seed in range(30)]
    assert np.mean([w.gyro for w in found]) == pytest.approx(GYRO**2, rel=0.15)
    assert np.mean([w.yaw for w in found]) == pytest.approx(YAW**2, rel=0.15)
    assert abs(np.mean([w.shared for w in found])) < 0.15 * GYRO**2


def test_nothing_is_decided_on_a_few_seconds() -> None:
    assert not is_independent(statistics(0, False, seconds=10), GYRO, YAW)


def test_a_yaw_that_wanders_more_than_told_is_not_believed() -> None:
    w = statistics(1, False)
    assert not is_independent(w, GYRO, YAW / 4)


def test_a_long_gap_is_not_compared_across() -> None:
    with_gap, without = statistics(2, False, gap_s=20.0), statistics(2, False)
    assert 0 < with_gap.spans < without.spans
    assert is_independent(with_gap, GYRO, YAW) == is_independent(without, GYRO, YAW)


def test_change_of_axis_drops_the_comparison_under_way_only() -> None:
    w = statistics(3, False)
    cut = w.interrupted()
    assert cut.first is None
    assert cut.reference is None
    assert (cut.spans, cut.shared) == (w.spans, w.shared)


def first_alarm_s(stray: np.ndarray, hz: float = 50.0) -> float | None:
    """When a yaw that strays so from the gyroscope is found to depart from it."""
    traces: tuple[Trace, ...] = ()
    for i, value in enumerate(stray.tolist()):
        now = Trace(round(i / hz * S), value, 0.0, 0.0, 1e-6)
        if not is_due(traces, now.t_ns):
            continue
        if find_disturbance(traces, now, GYRO**2 + YAW**2, radians(0.3) ** 2):
            return i / hz
        traces = with_trace(traces, now)
        assert len(traces) < 35
    return None


@pytest.mark.parametrize(("rate_deg_s", "within_s"), [(1000.0, 0.15), (15.0, 0.4), (7.5, 0.6), (2.5, 2.5)])
def test_a_yaw_that_is_pulled_away_is_noticed(rate_deg_s: float, within_s: float) -> None:
    t = np.arange(500) / 50
    for seed in range(5):
        noise = np.random.default_rng(seed).normal(0, radians(0.2), t.size)
        pulled = np.minimum(radians(rate_deg_s) * np.clip(t - 5, 0, None), radians(15))
        alarm = first_alarm_s(noise + pulled)
        assert alarm is not None
        assert 5.0 <= alarm <= 5.0 + within_s


def test_noise_and_wander_are_no_disturbance() -> None:
    alarms = 0
    for seed in range(10):
        rng = np.random.default_rng(seed)
        wander = np.cumsum(rng.normal(0, np.hypot(GYRO, YAW) / np.sqrt(50), 3000))
        alarms += first_alarm_s(wander + rng.normal(0, radians(0.3), 3000)) is not None
    assert alarms <= 1  # in ten minutes


def test_calm_takes_two_seconds_and_ends_with_a_gap() -> None:
    traces: tuple[Trace, ...] = ()
    assert not is_undisturbed(traces)
    for i in range(25):
        traces = with_trace(traces, Trace(i * S // 10, 0.0, 0.0, 0.0, 0.0))
        assert is_undisturbed(traces) == (i >= 20)
    assert not is_undisturbed(with_trace(traces, Trace(9 * S, 0.0, 0.0, 0.0, 0.0)))


def test_step_that_was_taken_up_is_no_parting() -> None:
    traces: tuple[Trace, ...] = ()
    for i in range(20):
        traces = with_trace(traces, Trace(i * S // 10, 0.1, 0.0, 0.0, 1e-6))
    now = Trace(2 * S, 0.1 + radians(15), 0.0, 0.0, 1e-6)
    assert find_disturbance(traces, now, GYRO**2, radians(0.3) ** 2) is not None
    assert find_disturbance(shifted_by(radians(15), traces), now, GYRO**2, radians(0.3) ** 2) is None
