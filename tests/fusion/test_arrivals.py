"""Stamps that are ahead, late or shifted: what is taken, what waits, and what is told."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from math import ceil, cos, degrees, radians

import numpy as np
import pytest

from fusion import CorridorEstimator
from fusion.estimator.faults import Fault
from tests.fusion.simulated import Sample, Scene, give, simulate, weaving, wrap
from vision import Reason

MS = 1_000_000
SCENE = Scene(
    seed=5, duration_s=12.0, heading=weaving(5, radians(30), 4.0), gyro_hz=100, attitude_hz=25, delay_s=0.05
)
FLIGHT = simulate(SCENE)
Change = Callable[[Sample], Sample]


def shifted(kind: str, ms: float, first_s: float, last_s: float = 1e9) -> Change:
    """Stamps of a source off between two times; samples arrive when they did."""

    def change(s: Sample) -> Sample:
        off = s.kind == kind and first_s <= s.t_ns * 1e-9 < last_s
        return replace(s, t_ns=s.t_ns + round(ms * MS)) if off else s

    return change


def fly(samples: Sequence[Sample], change: Change = lambda s: s) -> tuple[CorridorEstimator, list[str]]:
    """Fly in order of arrival; the reasons given in the last five seconds."""
    estimator, said = CorridorEstimator(), []
    for s in samples:
        give(estimator, change(s))
        if s.arrival_ns > 7000 * MS:
            e = estimator.estimate()
            said.append(f"{e.status}: {e.reason}")
    return estimator, said


def error_deg(estimator: CorridorEstimator) -> float:
    e = estimator.estimate()
    truth = np.interp(e.timestamp_ns * 1e-9, FLIGHT.t_s, FLIGHT.heading)
    return degrees(abs(float(wrap(e.heading_rad - truth))))


def one(kind: str, ahead_ms: float) -> Change:
    """Stamp one sample wrongly."""
    at_ns = next(s.t_ns for s in FLIGHT.samples if s.kind == kind and s.t_ns >= 8000 * MS)
    return shifted(kind, ahead_ms, at_ns * 1e-9, at_ns * 1e-9 + 1e-6)


@cache
def end_without_one(kind: str) -> str:
    """Fly without the sample that `one` stamps wrongly; the last estimate, to the last bit."""
    change = one(kind, 1.0)
    estimator, _ = fly([s for s in FLIGHT.samples if change(s) is s])
    return repr(estimator.estimate())


@pytest.mark.parametrize("kind", ["imu", "attitude", "frame"])
@pytest.mark.parametrize("ahead_ms", [600, 5_000, 100_000, 3.6e9])
def test_one_stamp_far_ahead_is_as_if_it_had_not_come(kind: str, ahead_ms: float) -> None:
    hurt, said = fly(FLIGHT.samples, one(kind, ahead_ms))
    hurt.finish()
    assert hurt.counters[f"{kind}_ahead"] == 1
    assert repr(hurt.estimate()) == end_without_one(kind)
    assert set(said) == {"tracking: "}


@pytest.mark.parametrize("kind", ["attitude", "frame"])
def test_a_clock_ahead_of_the_imu_s_is_told_and_costs_no_imu_sample(kind: str) -> None:
    estimator, said = fly(FLIGHT.samples, shifted(kind, 600, 0.0))
    word = "camera" if kind == "frame" else kind
    assert re.search(rf"{word} clock is 0\.[56]\d s ahead of the IMU's", said[-1])
    assert "gyroscope" not in said[-1]
    assert estimator.estimate().faults & (Fault.CAMERA_CLOCK if kind == "frame" else Fault.ATTITUDE_CLOCK)
    assert estimator.counters["imu"] == 1201
    assert estimator.counters["imu_late"] == 0


def test_a_frame_that_waits_is_told_so() -> None:
    estimator, _ = fly(FLIGHT.samples)
    measurement = next(s for s in FLIGHT.samples if s.kind == "frame").values[0]
    assert estimator.add_measurement(20_000 * MS, measurement).reason is Reason.AHEAD


def test_a_camera_clock_behind_is_told() -> None:
    estimator, said = fly(FLIGHT.samples, shifted("frame", -700, 0.0))
    assert said[-1].startswith("initialising: frames come too late, or their clock is 0.7")
    assert estimator.counters["frame_ok"] == 0


def test_a_pause_of_all_loses_nothing() -> None:
    paused = [replace(s, t_ns=s.t_ns + 5000 * MS) if s.arrival_ns > 6000 * MS else s for s in FLIGHT.samples]
    estimator, _ = fly(paused)
    estimator.finish()
    assert not [name for name in estimator.counters if name.endswith(("_ahead", "_late"))]
    for kind in ("imu", "attitude", "frame"):
        assert estimator.counters[kind] == sum(s.kind == kind for s in FLIGHT.samples)
    assert error_deg(estimator) < 1.5


@pytest.mark.parametrize(("kinds", "word"), [(("attitude", "frame"), "attitude"), (("frame",), "frame")])
def test_what_is_left_orders_time_once_the_imu_is_dead(kinds: tuple[str, ...], word: str) -> None:
    left = [s for s in FLIGHT.samples if s.t_ns < 6000 * MS or s.kind in kinds]
    estimator, said = fly(left)
    assert estimator.counters[f"{word}_ahead"] <= 2
    assert estimator.estimate().timestamp_ns == max(s.t_ns for s in left)
    assert said[-1].startswith("tracking: gyroscope is silent")
    assert error_deg(estimator) < 5


def test_two_wrong_stamps_in_a_row_are_undone() -> None:
    at_s = 8.0
    estimator, said = fly(FLIGHT.samples, shifted("imu", 100_000, at_s - 1e-4, at_s + 0.011))
    assert estimator.counters["clock_set_back"] == 1
    assert said[-1] == "tracking: "
    assert error_deg(estimator) < 1.5


def test_time_is_the_imu_s_if_others_came_before_it() -> None:
    first = [s for s in FLIGHT.samples if s.kind != "imu"][:5]
    strange = [replace(s, t_ns=s.t_ns + 3_600_000 * MS) for s in first]
    estimator, said = fly([*strange, *FLIGHT.samples])
    assert estimator.counters["imu_late"] == 0
    assert estimator.counters["clock_set_back"] == 1
    assert said[-1] == "tracking: "
    assert estimator.estimate().timestamp_ns == 12_000 * MS


@pytest.mark.parametrize("late_ms", [200, 400])
def test_frames_that_always_come_late_are_not_missed_before(late_ms: int) -> None:
    late = sorted(
        (
            replace(s, arrival_ns=s.t_ns + late_ms * MS) if s.kind == "frame" else s
            for s in FLIGHT.samples
            if s.kind != "frame" or s.t_ns < 9000 * MS
        ),
        key=lambda s: s.arrival_ns,
    )
    estimator, said = CorridorEstimator(), {}
    for s in late:
        give(estimator, s)
        said[s.arrival_ns] = estimator.estimate().status
    assert {status for t, status in said.items() if 1000 * MS < t < 9000 * MS + late_ms * MS} == {"tracking"}
    coasting = min(t for t, status in said.items() if status == "coasting")
    assert (coasting - 9000 * MS - late_ms * MS) * 1e-9 == pytest.approx(0.2, abs=0.05)


def later(kind: str, arrival_s: Callable[[float], float], until_s: float = 1e9) -> list[Sample]:
    """Samples of a source arrive at another time, and not at all from a time on."""
    kept = (s for s in FLIGHT.samples if s.kind != kind or s.t_ns < until_s * 1e9)
    moved = (
        replace(s, arrival_ns=round(arrival_s(s.t_ns * 1e-9) * 1e9)) if s.kind == kind else s for s in kept
    )
    return sorted(moved, key=lambda s: s.arrival_ns)


@pytest.mark.parametrize("kinds", [("imu", "attitude", "frame"), ("imu", "frame")])
@pytest.mark.parametrize(
    ("arrival_s", "late_s"),
    [
        (lambda t: t + 0.3, 0.3),
        (lambda t: ceil(t / 0.3 + 1e-6) * 0.3, 0.3),
        (lambda t: ceil(t / 0.4 + 1e-6) * 0.4, 0.4),
    ],
    ids=["0.3 s late", "bursts of 0.3 s", "bursts of 0.4 s"],
)
def test_a_gyroscope_that_always_comes_late_is_silent_only_once_it_dies(
    arrival_s: Callable[[float], float], late_s: float, kinds: tuple[str, ...]
) -> None:
    """In bursts, too; and the camera's clock, behind which it comes, has not moved."""
    estimator, said = CorridorEstimator(), {}
    for s in later("imu", arrival_s, until_s=9.0):
        if s.kind in kinds:
            give(estimator, s)
            said[s.arrival_ns * 1e-9] = estimator.estimate()
    alive = [e for t, e in said.items() if 2.0 < t < 9.0]
    assert {(e.status, e.reason) for e in alive} == {("tracking", "")}
    silent_s = min(t for t, e in said.items() if t > 2.0 and Fault.GYRO_SILENT in e.faults)
    assert 9.0 + 0.15 < silent_s < 9.0 + late_s + 0.4  # those ahead of it are held back for a while
    assert estimator.counters["imu_late"] == 0


def test_a_velocity_that_comes_later_than_a_late_imu_is_not_silent() -> None:
    estimator, faults = CorridorEstimator(), Fault.NONE
    for s in later("imu", lambda t: t + 0.25):
        give(estimator, s)
        t_ns = s.arrival_ns - 470 * MS
        if s.kind == "attitude" and t_ns > 0:
            estimator.add_velocity(t_ns, (1.0, 0.0, 0.0))
        if s.arrival_ns > 2000 * MS:
            faults |= estimator.estimate().faults
    assert not faults & (Fault.VELOCITY_SILENT | Fault.GYRO_SILENT)


@pytest.mark.parametrize("ms", [-100, 100])
def test_a_camera_clock_that_jumps_is_told_and_found_in_the_next_turn(ms: float) -> None:
    estimator, said = fly(FLIGHT.samples, shifted("frame", ms, 8.0))
    sense = "ahead" if ms > 0 else "back"
    told = f"camera clock has moved 0.10 s {sense} against the IMU's, or latency has changed"
    assert any(told in words for words in said)
    assert estimator.counters["camera_clock_moved"] == 1
    assert estimator._arrivals.frames.moved_ns == pytest.approx(ms * MS, abs=10 * MS)
    assert said[-1] == "tracking: "
    assert error_deg(estimator) < 1.0


def test_frames_that_take_longer_are_not_a_clock_that_has_jumped() -> None:
    slower = sorted(
        (
            replace(s, arrival_ns=s.arrival_ns + 100 * MS) if s.kind == "frame" and s.t_ns > 8000 * MS else s
            for s in FLIGHT.samples
        ),
        key=lambda s: s.arrival_ns,
    )
    estimator, said = fly(slower)
    assert any("or latency has changed" in words for words in said)
    assert said[-1] == "tracking: "
    assert estimator.counters["camera_clock_moved"] == 0


def test_without_a_turn_the_two_cannot_be_told_apart() -> None:
    straight = simulate(replace(SCENE, heading=lambda t: 0.1 * cos(0.0) + 0.0 * np.asarray(t, float)))
    _, said = fly(straight.samples, shifted("frame", 100, 8.0))
    assert "or latency has changed" in said[-1]


@pytest.mark.parametrize(
    ("tick_ns", "rate_hz", "told"),
    [
        (1000, 200, "IMU samples are 5 microseconds apart: times must be nanoseconds"),
        (1000, 50, "IMU samples are 20 microseconds apart: times must be nanoseconds"),
        (1_000_000, 200, "IMU samples are 0.005 microseconds apart: times must be nanoseconds"),
        (1, 8000, "no usable frame yet"),
        (1, 32000, "no usable frame yet"),
        (1, 50, "no usable frame yet"),
    ],
)
def test_times_in_another_unit_are_told(tick_ns: int, rate_hz: int, told: str) -> None:
    estimator = CorridorEstimator()
    for k in range(200):
        estimator.add_imu(round((10**15 + k * 1e9 / rate_hz) / tick_ns), (0.0, 0.0, 0.0))
    e = estimator.estimate()
    assert e.reason == told
    assert (Fault.IMU_CLOCK in e.faults) == ("nanoseconds" in told)


def test_samples_stamped_in_bursts_are_not_taken_for_microseconds() -> None:
    """A driver that stamps what it finds in the sensor's buffer as it reads it."""
    estimator = CorridorEstimator()
    for k in range(200):
        estimator.add_imu(k // 20 * 20 * MS + k % 20 * 1000, (0.0, 0.0, 0.0))
    assert estimator.estimate().reason == "no usable frame yet"


@pytest.mark.parametrize("ahead_ms", [300, 450])
def test_the_sigma_contains_the_lead_of_attitudes_stamped_ahead(ahead_ms: float) -> None:
    estimator, off, n = CorridorEstimator(), 0, 0
    for s in FLIGHT.samples:
        give(estimator, shifted("attitude", ahead_ms, 0.0)(s))
        if s.kind == "imu" and s.t_ns > 3000 * MS:
            n += 1
            off += error_deg(estimator) > 4.0 * degrees(estimator.estimate().heading_std_rad)
    assert off < 0.25 * n  # half to three quarters, if the turn by late samples is taken as known
