"""Metres from a range sensor: the stream in the estimator, and what it may and may not do."""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import asdict, replace
from math import cos, isnan, nan, radians, sin, sqrt
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fusion import FusionResult, fuse_flight
from fusion.estimator.config import FusionConfig
from fusion.estimator.estimator import CorridorEstimator
from fusion.estimator.faults import Fault
from fusion.estimator.range_width import Heights, Widths, height_at, with_range, with_width
from fusion.estimator.state import Entry
from fusion.flight import Flight, RangeStream
from fusion.logs.asl import read_ground_truth
from fusion.offline.fuse import _sample_problems
from tests.files import OFFICE
from tests.fusion.simulated import Sample, frame, give, quaternion

MS = 1_000_000
WIDTH_M = 2.4


def height_m(t_s: float) -> float:
    return 1.4 + 0.3 * sin(0.7 * t_s)


def samples(
    seconds: float = 12.0, *, seed: int = 0, floor_m: Any = lambda t_s: 0.0, sigma: float = 0.01
) -> list[tuple[str, int, tuple[Any, ...]]]:
    """A vehicle 0.3 half widths to the right that climbs, sinks and tilts above ground ``floor_m`` high."""
    rng = np.random.default_rng(seed)
    given_samples: list[tuple[str, int, tuple[Any, ...]]] = []
    for i in range(int(seconds * 100)):
        t_ns, t_s = i * 10 * MS, i * 0.01
        roll, pitch = radians(8) * np.sin(2 * t_s), radians(6) * np.cos(1.3 * t_s)
        given_samples.append(("imu", t_ns, ((0.0, 0.0, 0.0),)))
        given_samples.append(("attitude", t_ns, (quaternion(roll, pitch, 0.2),)))
        if i % 5 == 3:
            distance = (height_m(t_s) - floor_m(t_s)) / (cos(roll) * cos(pitch))
            given_samples.append(("range", t_ns, (distance + sigma * rng.normal(),)))
        if i % 5 == 0:
            ratio = WIDTH_M / height_m(t_s) * (1 + 0.02 * rng.normal())
            given_samples.append(
                ("frame", t_ns, (frame(0.1, lateral=0.3, lateral_std=0.02, width_per_height=ratio),))
            )
    return given_samples


def fly(flown: list[tuple[str, int, tuple[Any, ...]]], **config: Any) -> CorridorEstimator:
    estimator = CorridorEstimator(FusionConfig(**config))
    for kind, t_ns, values in flown:
        give(estimator, Sample(kind, t_ns, t_ns, values))
    return estimator


def width_m(estimator: CorridorEstimator) -> float:
    estimate = estimator.estimate()
    return 2 * estimate.lateral_offset_m / estimate.lateral_offset_norm


def test_width_comes_from_range_and_frames_at_any_height_and_tilt() -> None:
    estimator = fly(samples())
    assert width_m(estimator) == pytest.approx(WIDTH_M, rel=0.01)
    assert estimator.estimate().lateral_offset_m == pytest.approx(0.3 * WIDTH_M / 2, abs=0.01)
    assert estimator.estimate().reason == ""
    assert estimator.counters["range"] == 240


def test_without_range_nothing_is_metric_and_with_it_nothing_else_changes() -> None:
    bare = [s for s in samples() if s[0] != "range"]
    ranged, without = fly(samples()).estimate(), fly(bare).estimate()
    assert isnan(without.lateral_offset_m)
    for name in ("heading_rad", "heading_std_rad", "gyro_bias_rad_s", "timestamp_ns", "imu_yaw_offset_rad"):
        assert getattr(ranged, name) == getattr(without, name)
    assert ranged.lateral_offset_norm == pytest.approx(without.lateral_offset_norm, abs=0.002)


@pytest.mark.parametrize("told", [{"corridor_width_m": 3.0}, {"camera_height_m": 1.9}])
def test_the_configuration_comes_before_the_sensor(told: dict[str, float]) -> None:
    flown = samples(4.0)
    bare = [s for s in flown if s[0] != "range"]
    a, b = asdict(fly(flown, **told).estimate()), asdict(fly(bare, **told).estimate())
    assert repr(a) == repr(b)


def test_a_table_below_for_a_second_does_not_move_the_width() -> None:
    flown = samples(floor_m=lambda t_s: 0.75 if 6.0 <= t_s < 7.0 else 0.0)
    estimator = CorridorEstimator(FusionConfig())
    widths = []
    for kind, t_ns, values in flown:
        give(estimator, Sample(kind, t_ns, t_ns, values))
        if kind == "frame" and t_ns > 3_000 * MS:
            widths.append(width_m(estimator))
    assert np.abs(np.array(widths) / WIDTH_M - 1.0).max() < 0.025


@pytest.mark.parametrize("wrong", ["noise", "stuck", "spikes"])
def test_a_sensor_that_lies_does_not_spoil_the_scale_free_offset(wrong: str) -> None:
    rng = random.Random(3)
    lies: dict[str, Callable[[float], float]] = {
        "noise": lambda d: rng.uniform(0.1, 5.0),
        "stuck": lambda d: 0.05,
        "spikes": lambda d: d if rng.random() < 0.7 else rng.choice((0.02, 40.0)),
    }
    flown = [(k, t, (lies[wrong](*v),)) if k == "range" else (k, t, v) for k, t, v in samples()]
    estimator = fly(flown)
    honest = fly(samples()).estimate()
    found = estimator.estimate()
    assert found.heading_rad == honest.heading_rad
    assert found.lateral_offset_norm == pytest.approx(honest.lateral_offset_norm, abs=0.002)
    if wrong == "spikes":
        assert width_m(estimator) == pytest.approx(WIDTH_M, rel=0.02)
    else:
        assert isnan(found.lateral_offset_m)


class Recorder:
    def __init__(self) -> None:
        self.seen: list[Any] = []

    def __call__(self, entry: Entry) -> None:
        s = entry.after
        self.seen.append(
            (entry.t_ns, type(entry.sample).__name__, s.x.tobytes(), s.P.tobytes(), repr(s.width))
        )


def recorded(flown: list[tuple[str, int, tuple[Any, ...]]]) -> list[Any]:
    estimator = CorridorEstimator(FusionConfig(), on_final=(recorder := Recorder()))
    for kind, t_ns, values in flown:
        give(estimator, Sample(kind, t_ns, t_ns, values))
    last = repr(asdict(estimator.estimate()))
    estimator.finish()
    assert not any(name.endswith(("_late", "_duplicate")) for name in estimator.counters)
    return [*recorder.seen, last]


IN_ORDER = samples(4.0)
EXPECTED = recorded(IN_ORDER)


@settings(max_examples=8, deadline=None)
@given(st.integers(0, 10_000), st.sampled_from([0.02, 0.1, 0.4]))
def test_late_ranges_give_the_same_bits(seed: int, jitter_s: float) -> None:
    rng = random.Random(seed)
    held = [rng.uniform(0, jitter_s) if s[0] == "range" else 0.0 for s in IN_ORDER]
    keyed = sorted((s[1] + h * 1e9, i) for i, (s, h) in enumerate(zip(IN_ORDER, held, strict=True)))
    assert recorded([IN_ORDER[i] for _, i in keyed]) == EXPECTED


@pytest.mark.parametrize(
    ("distance", "counted"),
    [
        (nan, "range_not_positive"),
        (0.0, "range_not_positive"),
        (-1.0, "range_not_positive"),
        (120.0, "range_out_of_range"),  # centimetres
        (1200.0, "range_out_of_range"),
        (float("inf"), "range_out_of_range"),
    ],
)
def test_what_is_no_distance_is_counted(distance: float, counted: str) -> None:
    estimator = CorridorEstimator()
    estimator.add_range(0, distance)
    assert dict(estimator.counters) == {counted: 1}
    assert ("metres" in "; ".join(_sample_problems(estimator))) == (counted == "range_out_of_range")


def metres_m(
    flown: list[tuple[str, int, tuple[Any, ...]]],
) -> tuple[CorridorEstimator, list[tuple[float, float, Fault]]]:
    """Times, widths in use (NaN if unknown) and faults after each frame."""
    estimator, found = CorridorEstimator(FusionConfig()), []
    for kind, t_ns, values in flown:
        give(estimator, Sample(kind, t_ns, t_ns, values))
        if kind == "frame":
            e = estimator.estimate()
            found.append((t_ns * 1e-9, 2 * e.lateral_offset_m / e.lateral_offset_norm, e.faults))
    return estimator, found


@pytest.mark.parametrize("left_s", [3.0, 9.0])
def test_a_start_over_a_table_gives_no_metres_until_the_floor_is_seen(left_s: float) -> None:
    """A table so high that the corridor would be 0.5 to 0.9 m wide."""
    flown = samples(left_s + 6.0, floor_m=lambda t_s: height_m(t_s) * 0.7 if t_s < left_s else 0.0)
    _, found = metres_m(flown)
    over = [(width, faults) for t, width, faults in found if 2.0 < t < left_s]
    assert all(isnan(width) and Fault.RANGE_TOO_SHORT in faults for width, faults in over)
    after = [(width, faults) for t, width, faults in found if t > left_s + 1.5]
    assert all(width == pytest.approx(WIDTH_M, rel=0.03) and not faults for width, faults in after)


def test_metres_end_soon_after_the_vehicle_has_left_a_low_table() -> None:
    flown = samples(15.0, floor_m=lambda t_s: height_m(t_s) * 0.35 if t_s < 3.0 else 0.0)
    _, found = metres_m(flown)
    wrong = [t for t, width, _ in found if abs(width / WIDTH_M - 1.0) > 0.03]
    assert max(wrong) < 3.8
    assert found[-1][1] == pytest.approx(WIDTH_M, rel=0.03)


def test_a_sensor_stuck_at_its_minimum_gives_no_metres() -> None:
    flown = [(k, t, (0.3,)) if k == "range" else (k, t, v) for k, t, v in samples()]
    estimator, found = metres_m(flown)
    assert all(isnan(width) for _, width, _ in found)
    assert "set its width" in estimator.estimate().reason
    estimator.set_corridor_width(flown[-1][1], 0.8)
    assert estimator.estimate().reason == ""


def test_silence_is_told_of_and_the_width_outlasts_it() -> None:
    estimator = fly([s for s in samples() if s[0] != "range" or s[1] < 8_000 * MS])
    assert estimator.estimate().reason == "range sensor is silent"
    assert estimator.estimate().status == "tracking"
    assert width_m(estimator) == pytest.approx(WIDTH_M, rel=0.01)


def test_a_clock_set_back_keeps_the_width_and_takes_ranges_again() -> None:
    later = [(kind, t + 10**12, values) for kind, t, values in samples(6.0)]
    estimator = fly([*later, *samples(6.0)])
    assert estimator.counters["clock_set_back"] == 1
    assert estimator.estimate().reason == ""
    assert width_m(estimator) == pytest.approx(WIDTH_M, rel=0.01)


# The parts


def test_height_is_the_median_of_fresh_readings_made_upright() -> None:
    heights = Heights()
    for i, distance in enumerate((2.0, 9.0, 2.02, 2.04)):
        heights = with_range(heights, i * 50 * MS, distance, 0.5 * sqrt(3))
    assert height_at(heights, 160 * MS) == pytest.approx(2.03 * 0.5 * sqrt(3))
    assert height_at(heights, 440 * MS) == pytest.approx(2.04 * 0.5 * sqrt(3))
    assert isnan(height_at(heights, 451 * MS))
    assert with_range(heights, 200 * MS, 2.0, cos(radians(50))) == heights  # too far over


def test_widths_must_be_several_and_agree() -> None:
    widths = Widths()
    for i in range(7):
        widths = with_width(widths, i * 100 * MS, 2.0 + 0.01 * i)
        assert isnan(widths.width_m)
    assert with_width(widths, 650 * MS, 2.0) == widths  # too soon after the last
    assert with_width(widths, 800 * MS, nan) == widths
    widths = with_width(widths, 700 * MS, 2.07)
    assert widths.width_m == pytest.approx(2.035)
    for i in range(8, 16):
        widths = with_width(widths, i * 100 * MS, 4.0)
    assert isnan(widths.width_m)  # as many of one as of the other
    for i in range(16, 90):
        widths = with_width(widths, i * 100 * MS, 4.0)
    assert widths.width_m == 4.0
    assert len(widths.recent_m) == 61


# Whole flights


@pytest.fixture(scope="module")
def ranged(office: Flight) -> Flight:
    """The sample flight without its corridor's width, with distances to the floor: noise of 1 cm and 1 %."""
    truth = read_ground_truth(OFFICE)
    rng = np.random.default_rng(1)
    every = slice(None, None, 10)  # 20 Hz
    q = truth.q_world_body[every]
    distance_m = -truth.p_world_m[every, 2] / (1.0 - 2.0 * (q[:, 1] ** 2 + q[:, 2] ** 2))
    distance_m *= 1.0 + 0.01 * rng.normal(size=len(q))
    distance_m += 0.01 * rng.normal(size=len(q))
    return replace(office, corridor_width_m=None, range=RangeStream(truth.t_ns[every], distance_m))


@pytest.fixture(scope="module")
def fused(ranged: Flight) -> FusionResult:
    return fuse_flight(ranged)


def test_metres_of_a_flight_without_a_width(ranged: Flight, fused: FusionResult) -> None:
    """Measured: filter 1.1 cm RMSE, smoother 0.6; with the true width told 1.4 and 0.9."""
    errors = fused.summary["errors"]
    assert errors["filter"]["lateral_offset_m"]["rmse_m"] < 0.015
    assert errors["smoothed"]["lateral_offset_m"]["rmse_m"] < 0.010
    assert errors["filter"]["lateral_offset_m"]["max_m"] < 0.05
    known = np.isfinite(fused.estimates["lateral_offset_m"])
    assert known.sum() > 0.9 * np.isfinite(fused.estimates["lateral_offset_norm"]).sum()
    assert fused.summary["counts"]["samples"]["range"] == len(ranged.range.t_ns)  # type: ignore[union-attr]
    assert not fused.problems


def test_a_table_below_changes_next_to_nothing(ranged: Flight, fused: FusionResult) -> None:
    assert ranged.range is not None
    t_s = (ranged.range.t_ns - ranged.range.t_ns[0]) * 1e-9
    over = (t_s > 6.0) & (t_s < 7.0)
    table = replace(ranged.range, distance_m=ranged.range.distance_m - 0.75 * over)
    plain, tabled = fused.estimates, fuse_flight(replace(ranged, range=table)).estimates
    assert np.nanmax(np.abs(tabled["lateral_offset_m"] - plain["lateral_offset_m"])) < 0.005
    np.testing.assert_array_equal(np.isnan(tabled["lateral_offset_m"]), np.isnan(plain["lateral_offset_m"]))
    np.testing.assert_allclose(tabled["lateral_offset_norm"], plain["lateral_offset_norm"], atol=0.002)


def test_a_sensor_of_noise_leaves_the_scale_free_offset_alone(ranged: Flight) -> None:
    assert ranged.range is not None
    rng = np.random.default_rng(2)
    noise = replace(ranged.range, distance_m=rng.uniform(0.2, 4.0, len(ranged.range.t_ns)))
    without, noisy = (fuse_flight(replace(ranged, range=r)).summary["errors"] for r in (None, noise))
    for table in ("filter", "smoothed"):
        a, b = (errors[table]["lateral_offset_norm"]["rmse_norm"] for errors in (without, noisy))
        assert b < 1.05 * a
    assert noisy["filter"]["heading"]["rmse_rad"] < 1.05 * without["filter"]["heading"]["rmse_rad"]
