from __future__ import annotations

import random
from dataclasses import asdict, fields, is_dataclass, replace
from functools import cache
from math import radians
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fusion.estimator.config import FusionConfig
from fusion.estimator.engine import Engine
from fusion.estimator.estimator import CorridorEstimator
from fusion.estimator.frame_update import FrameSample
from fusion.estimator.state import Entry
from tests.fusion.simulated import Sample, Scene, frame, give, plus, simulate, turning, weaving
from vision.measurement import Attitude, FrameMeasurement, Prior, Reason

MS = 1_000_000

SCENE = Scene(
    duration_s=4.5,
    seed=3,
    heading=plus(weaving(3, radians(10)), turning((2.5, 1.0, radians(70)))),
    axis=lambda t: np.where(np.asarray(t) < 3.0, 0.0, radians(70)),
    gyro_hz=100,
    frame_hz=20,
    gross=0.1,
    attitude_hz=25,
    accel=True,
    lateral_sigma=0.02,
)
SAMPLES = sorted(simulate(SCENE).samples, key=lambda s: (s.t_ns, s.kind != "attitude", s.kind != "imu"))
SAMPLES.insert(200, Sample("velocity", 1_503 * MS, 0, ((0.8, 0.1, 0.0),)))
SAMPLES.sort(key=lambda s: s.t_ns)


def bits(value: Any) -> Any:
    """All numbers of a state, such that only those of the same bits are equal, NaN with NaN."""
    if isinstance(value, np.ndarray):
        return value.tobytes()
    if isinstance(value, tuple | list):
        return [bits(v) for v in value]
    if is_dataclass(value):
        return [bits(getattr(value, f.name)) for f in fields(value)]
    return value.hex() if isinstance(value, float) else value


class Recorder:
    """Keeps what leaves the buffer, to the last bit."""

    def __init__(self) -> None:
        self.seen: list[tuple[Any, ...]] = []

    def __call__(self, entry: Entry) -> None:
        result = entry.frame
        self.seen.append(
            (
                entry.t_ns,
                type(entry.sample).__name__,
                bits(entry.after),
                [bits((n.F, n.x_prior, n.P_prior, n.x, n.P)) for n in entry.nodes],
                None if result is None else (result.accepted, result.reason, repr(result.test_ratio)),
            )
        )


def fuse(samples: list[Sample], **config: Any) -> tuple[list[object], CorridorEstimator]:
    recorder = Recorder()
    estimator = CorridorEstimator(FusionConfig(corridor_width_m=2.0, **config), on_final=recorder)
    for sample in samples:
        give(estimator, sample)
    last = asdict(estimator.estimate())
    last = {name: value for name, value in last.items() if "reset" not in name}  # those that were published
    estimator.finish()
    return [*recorder.seen, repr(last)], estimator


@cache
def expected() -> list[object]:
    """What comes out where every sample arrives in the order of time."""
    return fuse(SAMPLES)[0]


def shuffled(seed: int, jitter_s: float, share: float = 1.0) -> list[Sample]:
    """Order in which samples arrive if each is held up by up to so much."""
    rng = random.Random(seed)
    held = [rng.uniform(0, jitter_s) if rng.random() < share else 0.0 for _ in SAMPLES]
    return [
        s
        for _, _, s in sorted(
            (s.t_ns + h * 1e9, i, s) for i, (s, h) in enumerate(zip(SAMPLES, held, strict=True))
        )
    ]


@pytest.mark.parametrize(("seed", "jitter_s"), [(0, 0.03), (1, 0.1), (2, 0.45)])
def test_any_order_within_the_buffer_gives_the_same_bits(seed: int, jitter_s: float) -> None:
    found, estimator = fuse(shuffled(seed, jitter_s, share=0.3))
    assert found == expected()
    assert not any(name.endswith(("_late", "_duplicate")) for name in estimator.counters)


@settings(max_examples=4, deadline=None)
@given(st.integers(0, 10_000))
def test_any_order_at_random(seed: int) -> None:
    found, _ = fuse(shuffled(seed, 0.06))
    assert found == expected()


def test_asking_in_between_changes_nothing() -> None:
    estimator = CorridorEstimator(FusionConfig(corridor_width_m=2.0), on_final=(recorder := Recorder()))
    for sample in shuffled(5, 0.1, share=0.5):
        give(estimator, sample)
        estimator.estimate()
        estimator.estimate(sample.t_ns + 10**9)
    last = asdict(estimator.estimate())
    last = {name: value for name, value in last.items() if "reset" not in name}  # those that were published
    estimator.finish()
    assert [*recorder.seen, repr(last)] == expected()


def test_buffers_of_other_lengths_give_the_same_bits() -> None:
    assert fuse(SAMPLES, buffer_s=0.05)[0] == expected()
    assert fuse(SAMPLES, buffer_s=5.0)[0] == expected()


def test_late_frames_of_a_spin_give_the_same_bits() -> None:
    """They show no heading, so that the gyroscope's scale error adds up over more than half a turn."""
    spin = replace(SCENE, heading=turning((1.5, 2.5, radians(900))), axis=lambda t: 0.0 * np.asarray(t))
    blurred = (FrameMeasurement(False, Reason.BLUR),)
    samples = [
        replace(s, values=blurred) if s.kind == "frame" and 1_500 * MS < s.t_ns < 4_100 * MS else s
        for s in sorted(simulate(spin).samples, key=lambda s: (s.t_ns, s.kind != "attitude", s.kind != "imu"))
    ]
    late = sorted(samples, key=lambda s: s.t_ns + (200 * MS if s.kind == "frame" else 0))
    found, estimator = fuse(late)
    assert found == fuse(samples)[0]
    assert not any(name.endswith("_late") for name in estimator.counters)


def test_late_frame_replays_gyroscope_samples_in_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    late = [s for s in SAMPLES if s.kind == "frame"][40]
    before = [s for s in SAMPLES if s.t_ns < late.t_ns + 300 * MS and s is not late]
    estimator = CorridorEstimator(FusionConfig(corridor_width_m=2.0))
    for sample in before:
        give(estimator, sample)
    with monkeypatch.context() as patch:
        patch.delattr(Engine, "_imu")  # which processes a sample by itself
        give(estimator, late)
    assert not any(name.endswith("_failed") for name in estimator.counters)
    assert sum(s.kind == "imu" and s.t_ns > late.t_ns for s in before) >= 29


def test_duplicates_are_counted_and_change_nothing() -> None:
    twice = [s for sample in SAMPLES for s in (sample, sample)]
    found, estimator = fuse(twice)
    assert found == expected()
    assert estimator.counters["imu_duplicate"] == sum(s.kind == "imu" for s in SAMPLES)


def test_later_than_the_buffer_is_counted_and_dropped() -> None:
    late = [s for s in SAMPLES if s.kind == "frame"][40]
    others = [s for s in SAMPLES if s is not late]
    at = next(i for i, s in enumerate(others) if s.t_ns > late.t_ns + 510 * MS)
    found, estimator = fuse([*others[:at], late, *others[at:]])
    assert estimator.counters["frame_late"] == 1
    assert found == fuse(others)[0]


def test_late_frame_is_told_so() -> None:
    estimator = CorridorEstimator()
    for i in range(200):
        estimator.add_imu(i * 10 * MS, (0, 0, 0))
    result = estimator.add_measurement(100 * MS, frame(0.1))
    assert not result.accepted
    assert result.reason is Reason.LATE


def test_clock_that_is_set_back_is_survived() -> None:
    estimator = CorridorEstimator()
    for start in (10**12, 5 * 10**9):
        for i in range(600):
            t = start + i * 10 * MS
            estimator.add_imu(t, (0.0, 0.0, 0.0))
            if i % 5 == 0:
                estimator.add_measurement(t, frame(0.2))
    assert estimator.counters["clock_set_back"] == 1
    estimate = estimator.estimate()
    assert estimate.timestamp_ns < 2 * 10**10
    assert estimate.status == "tracking"
    assert estimate.heading_rad == pytest.approx(0.2, abs=0.01)


def test_replay_measures_again_with_what_came_late() -> None:
    """A frame's tilt and prediction are those of its time, also when the samples come after it."""
    seen: list[tuple[Attitude | None, Prior]] = []

    def measure(attitude: Attitude | None, prior: Prior, lateral: bool) -> FrameMeasurement:
        seen.append((attitude, prior))
        return frame(0.1)

    estimator = CorridorEstimator()
    estimator.add(FrameSample(100 * MS, 100 * MS, measure))
    assert seen[-1][0] is None
    estimator.add_attitude(50 * MS, (np.cos(0.1), np.sin(0.1), 0.0, 0.0))
    attitude = seen[-1][0]
    assert attitude is not None
    assert attitude.roll_rad == pytest.approx(0.2)
    assert len(seen) == 2


@pytest.mark.parametrize("order", [(0, 1, 2, 3, 4, 5), (0, 2, 1, 3, 5, 4), (0, 3, 1, 2, 4, 5)])
def test_which_frames_are_searched_for_the_offset_does_not_depend_on_their_order(
    order: tuple[int, ...],
) -> None:
    searched: dict[int, bool] = {}
    estimator = CorridorEstimator(FusionConfig(lateral_rate_hz=10.0))
    for k in order:

        def measure(
            attitude: Attitude | None, prior: Prior, lateral: bool, place: int = k
        ) -> FrameMeasurement:
            searched[place] = lateral
            return frame(0.1)

        estimator.add(FrameSample((100 + 50 * k) * MS, (100 + 50 * k) * MS, measure))
    assert [searched[k] for k in range(6)] == [True, False, True, False, True, False]
