from __future__ import annotations

from math import radians

import numpy as np
import pytest

from fusion.yaw_watch import YawWatch, is_independent, watch

GYRO, YAW = 0.0075, 0.009
S = 1_000_000_000


def watched(
    seed: int, shared: bool, seconds: float = 90.0, steps: bool = False, gap_s: float = 0.0
) -> YawWatch:
    """Frames at 20 Hz over a gyroscope and a yaw that stray each on its own, or together."""
    rng = np.random.default_rng(seed)
    n = int(seconds * 20)
    gyro = np.cumsum(rng.normal(0, GYRO * np.sqrt(0.05), n))
    yaw = gyro + np.cumsum(rng.normal(0, 0.002 * np.sqrt(0.05), n))
    if not shared:
        yaw = np.cumsum(rng.normal(0, YAW * np.sqrt(0.05), n))
    if steps:
        yaw = yaw + np.where(np.arange(n) // 300 % 2 == 0, 0.0, radians(15))
    w = YawWatch()
    for i in range(n):
        if gap_s and 30 < i / 20 < 30 + gap_s:
            continue
        error = rng.normal(0, radians(0.6))
        w = watch(w, i * S // 20, error - gyro[i], error - yaw[i], radians(0.6) ** 2)
    return w


@pytest.mark.parametrize("steps", [False, True])
def test_a_yaw_of_its_own_is_told_from_the_same_gyroscope(steps: bool) -> None:
    own = [is_independent(watched(seed, False, steps=steps), GYRO, YAW) for seed in range(20)]
    same = [is_independent(watched(seed, True, steps=steps), GYRO, YAW) for seed in range(20)]
    assert sum(own) >= 15
    assert sum(same) == 0


def test_wander_is_measured() -> None:
    found = [watched(seed, False, seconds=120) for seed in range(30)]
    assert np.mean([w.gyro for w in found]) == pytest.approx(GYRO**2, rel=0.15)
    assert np.mean([w.yaw for w in found]) == pytest.approx(YAW**2, rel=0.15)
    assert abs(np.mean([w.shared for w in found])) < 0.15 * GYRO**2


def test_nothing_is_decided_on_a_few_seconds() -> None:
    assert not is_independent(watched(0, False, seconds=10), GYRO, YAW)


def test_a_yaw_that_wanders_more_than_told_is_not_believed() -> None:
    w = watched(1, False)
    assert not is_independent(w, GYRO, YAW / 4)


def test_a_long_gap_is_not_compared_across() -> None:
    with_gap, without = watched(2, False, gap_s=20.0), watched(2, False)
    assert 0 < with_gap.spans < without.spans
    assert is_independent(with_gap, GYRO, YAW) == is_independent(without, GYRO, YAW)


def test_change_of_axis_drops_the_comparison_under_way_only() -> None:
    w = watched(3, False)
    cut = w.interrupted()
    assert cut.first is None
    assert cut.reference is None
    assert (cut.spans, cut.shared) == (w.spans, w.shared)
