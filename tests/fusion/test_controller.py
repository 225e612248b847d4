"""What an autopilot asks of the estimator besides the estimate: reset, seeds, prediction, covariance, innovations."""

from __future__ import annotations

import re
from dataclasses import astuple
from math import isnan, nan, pi, radians, sqrt
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fusion import CorridorEstimator, Estimate, FusionConfig
from fusion.estimator.estimator import MAX_AHEAD_NS
from fusion.estimator.faults import Fault
from fusion.estimator.models import N_STATES, STATE_NAMES
from tests.fusion.simulated import frame
from vision import InputError

MS = 1_000_000
DOWN = (0.0, 0.0, -9.80665)
CONFIG = FusionConfig(corridor_width_m=2.0)


def fly(
    estimator: CorridorEstimator, start_ms: int, end_ms: int, rate: float = 0.0, heading: float = 0.2
) -> int:
    """Fly at a constant yaw rate from a heading, with frames at 25 Hz that show it; the last sample's time, ns."""
    for ms in range(start_ms, end_ms + 1, 10):
        estimator.add_imu(ms * MS, (0.0, 0.0, rate), DOWN)
        if ms % 40 == 0:
            seen = heading + rate * (ms - start_ms) * 1e-3
            estimator.add_measurement(ms * MS, frame(seen, 0.005, 0.3, 0.02))
    return end_ms * MS


def flown(rate: float = 0.0, **config: Any) -> tuple[CorridorEstimator, int]:
    estimator = CorridorEstimator(FusionConfig(corridor_width_m=2.0, **config))
    return estimator, fly(estimator, 0, 3000, rate, 0.2 - 3.0 * rate)


def plain(e: Estimate) -> tuple[str, ...]:
    return tuple(repr(v) for v in astuple(e))


# Reset and seed


def test_after_a_reset_nothing_is_known_and_the_flight_is_a_new_one() -> None:
    estimator, t = flown()
    estimator.reset()
    empty = estimator.estimate()
    assert empty.status == "initialising"
    assert isnan(empty.heading_rad)
    assert empty.reset_count == 1
    assert empty.faults == Fault.NOT_STARTED
    fly(estimator, t // MS - 5000, t // MS - 2000, heading=0.7)  # an earlier time is no late one
    again, fresh = estimator.estimate(), CorridorEstimator(CONFIG)
    fly(fresh, t // MS - 5000, t // MS - 2000, heading=0.7)
    expected = fresh.estimate()
    for name in Estimate.__dataclass_fields__:
        if "reset" not in name:
            assert repr(getattr(again, name)) == repr(getattr(expected, name)), name
    assert again.reset_count == 2
    assert again.reset_heading_rad == pytest.approx(0.5, abs=0.02)
    assert again.lateral_reset_count == 1
    assert again.reset_lateral_norm == pytest.approx(0.0, abs=0.05)
    assert not any("late" in name for name in estimator.counters)
    assert estimator.counters["reset"] == 1


def test_a_seed_before_the_first_frame_is_the_heading_and_no_step() -> None:
    estimator = CorridorEstimator(FusionConfig())
    estimator.add_imu(0, (0.0, 0.0, 0.5), DOWN)
    estimator.seed(0, -2.5, 0.1, corridor_width_m=3.0)
    estimator.add_imu(100 * MS, (0.0, 0.0, 0.5), DOWN)
    e = estimator.estimate()
    assert e.status == "tracking"
    assert e.reset_count == 0
    assert e.heading_rad == pytest.approx(-2.45, abs=1e-9)
    assert e.heading_std_rad == pytest.approx(0.1, abs=1e-3)
    fly(estimator, 110, 3000, 0.0, -2.5 + pi)  # a frame cannot tell the facing: the seed does
    e = estimator.estimate()
    assert e.heading_rad == pytest.approx(-2.5, abs=0.02)
    assert e.lateral_offset_m == pytest.approx(1.5 * e.lateral_offset_norm)


def test_a_seed_without_any_sample_waits_for_them() -> None:
    estimator = CorridorEstimator(CONFIG)
    estimator.seed(1000 * MS, 0.4, 0.05)
    estimator.add_imu(1010 * MS, (0.0, 0.0, 0.0), DOWN)
    assert estimator.estimate().heading_rad == pytest.approx(0.4)


def test_a_seed_in_flight_is_a_counted_step() -> None:
    estimator, t = flown()
    before = estimator.estimate()
    estimator.seed(t, 1.4, 0.05)
    after = estimator.estimate()
    assert after.reset_count == 1
    assert after.heading_rad == pytest.approx(1.4)
    assert after.heading_std_rad == pytest.approx(0.05)
    assert after.reset_heading_rad == pytest.approx(1.4 - before.heading_rad)
    assert after.reset_heading_total_rad == after.reset_heading_rad
    P = estimator.covariance()
    assert P.variance("heading_rad", "gyro_bias_rad_s") == 0.0


def test_a_seed_leaves_the_yaw_that_the_imu_should_show() -> None:
    estimator = CorridorEstimator(CONFIG)
    for ms in range(0, 3000, 10):
        estimator.add_imu(ms * MS, (0.0, 0.0, 0.0), DOWN)
        if ms % 40 == 0:
            estimator.add_measurement(ms * MS, frame(0.2))
            estimator.add_attitude(ms * MS, (np.cos(0.45), 0.0, 0.0, np.sin(0.45)))
    before = estimator.estimate()
    estimator.seed(2995 * MS, 1.0, 0.02)
    after = estimator.estimate()
    assert before.imu_yaw_offset_rad == pytest.approx(0.7, abs=0.01)
    assert after.imu_yaw_offset_rad == pytest.approx(-0.1, abs=0.01)


def test_a_late_seed_is_put_in_its_place() -> None:
    on_time, t = flown()
    on_time.seed(t, 0.4, 0.02)
    on_time.add_imu(t + 20 * MS, (0.0, 0.0, 0.3), DOWN)
    late, t = flown()
    late.add_imu(t + 20 * MS, (0.0, 0.0, 0.3), DOWN)
    late.seed(t, 0.4, 0.02)
    for name in ("heading_rad", "heading_std_rad", "lateral_offset_norm", "reset_count"):
        assert getattr(late.estimate(), name) == getattr(on_time.estimate(), name), name


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        ((nan, 0.1), "heading_rad"),
        ((0.0, 0.0), "heading_std_rad"),
        ((0.0, nan), "heading_std_rad"),
        ((0.0, 0.1, 0.1), "corridor_width_m"),
        ((0.0, 0.1, nan), "corridor_width_m"),
    ],
)
def test_a_seed_that_cannot_be_is_refused(arguments: tuple[float, ...], named: str) -> None:
    estimator, t = flown()
    before = plain(estimator.estimate())
    with pytest.raises(InputError, match=named):
        estimator.seed(t, *arguments)
    assert plain(estimator.estimate()) == before


@pytest.mark.parametrize("off_s", [-0.6, 0.6])
def test_a_seed_of_another_time_is_refused(off_s: float) -> None:
    estimator, t = flown()
    with pytest.raises(InputError, match="from the newest sample"):
        estimator.seed(t + round(off_s * 1e9), 0.0, 0.1)


def test_two_seeds_of_one_time_are_refused() -> None:
    estimator, t = flown()
    estimator.seed(t, 0.5, 0.1)
    with pytest.raises(InputError, match="1 ns later"):
        estimator.seed(t, 0.6, 0.1)


def test_a_seed_whose_width_is_refused_leaves_the_heading() -> None:
    estimator, t = flown()
    estimator.set_corridor_width(t, 2.0)
    before = plain(estimator.estimate())
    with pytest.raises(InputError, match="1 ns later"):
        estimator.seed(t, 1.0, 0.05, 2.5)
    assert plain(estimator.estimate()) == before


# Width


def test_another_width_scales_the_metres_from_then_on() -> None:
    estimator, t = flown()
    assert estimator.estimate().lateral_offset_m == pytest.approx(0.3, abs=0.02)
    estimator.set_corridor_width(t, 3.0)
    e = estimator.estimate()
    assert e.lateral_offset_norm == pytest.approx(0.3, abs=0.02)
    assert e.lateral_offset_m == pytest.approx(1.5 * e.lateral_offset_norm)
    P = estimator.covariance()
    assert P.mean[P.names.index("inverse_half_width_1_m")] == pytest.approx(1 / 1.5)
    fly(estimator, t // MS + 10, t // MS + 2000)
    e = estimator.estimate()
    assert e.lateral_offset_m == pytest.approx(0.45, abs=0.03)
    assert (e.reset_count, e.lateral_reset_count) == (0, 0)


def test_a_width_that_is_no_longer_known_leaves_no_metres() -> None:
    estimator, t = flown()
    estimator.set_corridor_width(t, None)
    e = estimator.estimate()
    assert e.lateral_offset_norm == pytest.approx(0.3, abs=0.02)
    assert isnan(e.lateral_offset_m)


def test_the_smoothed_estimate_knows_the_width_of_its_time() -> None:
    estimator, t = flown(fixed_lag_s=0.5)
    estimator.set_corridor_width(t, 3.0)
    fly(estimator, t // MS + 10, t // MS + 400)
    e = estimator.smoothed()
    assert e.lateral_offset_m == pytest.approx(1.0 * e.lateral_offset_norm)
    fly(estimator, t // MS + 410, t // MS + 1000)
    e = estimator.smoothed()
    assert e.lateral_offset_m == pytest.approx(1.5 * e.lateral_offset_norm)


# Prediction


@settings(max_examples=15, deadline=None)
@given(st.floats(-0.3, 0.3), st.integers(1, 500))
def test_a_constant_turn_goes_on(rate: float, ahead_ms: int) -> None:
    estimator, t = flown(rate)
    now, ahead = estimator.estimate(), estimator.estimate(at_ns=t + ahead_ms * MS)
    assert ahead.timestamp_ns == t + ahead_ms * MS
    turned = now.yaw_rate_rad_s * ahead_ms * 1e-3
    assert ahead.heading_rad == pytest.approx(now.heading_rad + turned, abs=1e-9)
    assert ahead.heading_std_rad > now.heading_std_rad
    assert (ahead.status, ahead.reason, ahead.vision_age_s) == (now.status, now.reason, now.vision_age_s)
    assert plain(estimator.estimate()) == plain(now)  # a look changes nothing


@pytest.mark.parametrize("ahead_ms", [5, 20, 90])
def test_prediction_is_what_the_filter_makes_of_a_sample_with_the_same_rate(ahead_ms: int) -> None:
    """But for the held rate's uncertainty, which the sample removes: its variance is q^2 t^3 / 3."""
    estimator, t = flown(0.2)
    ahead = estimator.estimate(at_ns=t + ahead_ms * MS)
    estimator.add_imu(t + ahead_ms * MS, (0.0, 0.0, 0.2), None)
    arrived = estimator.estimate()
    held = CONFIG.yaw_acceleration_density**2 * (ahead_ms * 1e-3) ** 3 / 3
    assert ahead.heading_rad == pytest.approx(arrived.heading_rad, abs=1e-12)
    assert ahead.heading_std_rad**2 - held == pytest.approx(arrived.heading_std_rad**2, rel=1e-9)
    for name in ("lateral_offset_norm", "lateral_offset_norm_std", "lateral_velocity_norm_s"):
        assert getattr(ahead, name) == pytest.approx(getattr(arrived, name), rel=1e-9), name


def test_the_lateral_offset_moves_on_by_its_rate() -> None:
    estimator = CorridorEstimator(CONFIG)
    for ms in range(0, 4001, 10):
        estimator.add_imu(ms * MS, (0.0, 0.0, 0.0), DOWN)
        if ms % 40 == 0:
            estimator.add_measurement(ms * MS, frame(0.0, 0.005, -0.4 + 0.2 * ms * 1e-3, 0.01))
    now, ahead = estimator.estimate(), estimator.estimate(at_ns=4100 * MS)
    assert now.lateral_velocity_norm_s == pytest.approx(0.2, abs=0.05)
    moved = ahead.lateral_offset_norm - now.lateral_offset_norm
    assert moved == pytest.approx(0.1 * now.lateral_velocity_norm_s, abs=2e-3)
    assert ahead.lateral_offset_norm_std > now.lateral_offset_norm_std


def test_too_far_ahead_is_said() -> None:
    estimator, t = flown(0.2)
    limit = estimator.estimate(at_ns=t + MAX_AHEAD_NS)
    far = estimator.estimate(at_ns=t + 2000 * MS)
    assert far.timestamp_ns == limit.timestamp_ns
    assert far.heading_rad == limit.heading_rad
    assert limit.reason == ""
    assert far.reason == "predicted 0.5 s ahead, not the 2.00 s asked for"


@pytest.mark.parametrize("name", ["now_ns", "at_ns"])
def test_times_in_seconds_are_rejected(name: str) -> None:
    estimator, _ = flown(0.2)
    wrong: dict[str, Any] = {name: 2.5}
    with pytest.raises(InputError, match="not an integer"):
        estimator.estimate(**wrong)


def test_a_time_that_is_past_gives_the_newest_estimate() -> None:
    estimator, t = flown(0.2)
    assert plain(estimator.estimate(at_ns=t - 100 * MS)) == plain(estimator.estimate())


# Covariance


def test_the_covariance_names_its_states_and_agrees_with_the_estimate() -> None:
    estimator, t = flown(0.1)
    P, e = estimator.covariance(), estimator.estimate()
    assert P.timestamp_ns == t
    assert P.names[:N_STATES] == STATE_NAMES
    assert P.matrix.shape == (len(P.names), len(P.names))
    assert len(set(P.names)) == len(P.names) == len(P.mean)
    assert (P.matrix == P.matrix.T).all()
    assert np.linalg.eigvalsh(P.matrix).min() > 0.0
    known = dict(zip(P.names, P.mean.tolist(), strict=True))
    assert known["heading_rad"] == pytest.approx(e.heading_rad)
    assert known["gyro_bias_rad_s"] == pytest.approx(e.gyro_bias_rad_s)
    assert known["lateral_offset_norm"] == pytest.approx(e.lateral_offset_norm)
    assert known["lateral_velocity_norm_s"] == pytest.approx(e.lateral_velocity_norm_s)
    for name, std in (
        ("heading_rad", e.heading_std_rad),
        ("lateral_offset_norm", e.lateral_offset_norm_std),
        ("lateral_velocity_norm_s", e.lateral_velocity_norm_s_std),
    ):
        assert sqrt(P.variance(name)) == pytest.approx(std), name
    # A heading too far right and a bias too small look alike.
    assert P.variance("heading_rad", "gyro_bias_rad_s") < 0.0
    with pytest.raises(KeyError, match="no state 'speed'"):
        P.variance("speed")


def test_an_offset_that_is_not_known_has_no_covariance() -> None:
    P = CorridorEstimator(CONFIG).covariance()
    assert P.timestamp_ns is None
    assert P.names == STATE_NAMES


def test_an_estimated_camera_delay_is_in_the_headings_variance() -> None:
    estimator, _ = flown(0.3, camera_delay_std_s=0.02)
    std = estimator.estimate().heading_std_rad
    assert sqrt(estimator.covariance().variance("heading_rad")) == pytest.approx(std)
    assert std > 1.001 * sqrt(float(estimator.ekf.P[0, 0]))


# Innovations


def test_innovations_are_measured_less_expected() -> None:
    estimator, t = flown()
    before, P = estimator.estimate(), estimator.covariance()
    estimator.add_measurement(t + 1, frame(0.21, 0.005, 0.35, 0.02))
    estimator.add_velocity(t + 2, (0.0, 0.1, 0.0))
    estimator.add_attitude(t + 3, (1.0, 0.0, 0.0, 0.0))
    found = estimator.innovations()
    assert found.heading.value == pytest.approx(0.21 - before.heading_rad, abs=1e-6)
    assert found.heading.variance == pytest.approx(P.variance("heading_rad") + 0.005**2, rel=0.05)
    assert found.lateral.value == pytest.approx(0.35 - before.lateral_offset_norm, abs=1e-6)
    assert found.velocity.value == pytest.approx(0.1, abs=0.05)
    assert found.velocity.variance > CONFIG.velocity_std_m_s**2
    gates = {
        "heading": CONFIG.heading_gate_sigma,
        "lateral": CONFIG.lateral_gate_sigma,
        "velocity": 3.0,
    }
    for name, gate in gates.items():
        one = getattr(found, name)
        assert one.test_ratio == pytest.approx(one.value**2 / (gate**2 * one.variance)), name
        assert one.accepted == (one.test_ratio <= 1.0), name
    assert isnan(found.imu_yaw.value)  # the first one only finds the offset
    estimator.add_attitude(t + 40 * MS, (1.0, 0.0, 0.0, 0.0))
    assert estimator.innovations().imu_yaw.accepted
    assert estimator.innovations().imu_yaw.value == pytest.approx(0.0, abs=0.01)


def test_a_rejected_innovation_stays_visible() -> None:
    estimator, t = flown()
    estimator.add_measurement(t + 1, frame(0.2 + radians(20), 0.005))
    found = estimator.innovations().heading
    assert not found.accepted
    assert found.test_ratio > 1.0
    assert found.value == pytest.approx(radians(20), abs=0.01)


def test_sources_that_have_not_spoken_have_no_innovation() -> None:
    found = CorridorEstimator(CONFIG).innovations()
    assert all(isnan(v) for one in astuple(found) for v in one[:3])


# Documentation


def test_every_fault_is_documented() -> None:
    text = (Path(__file__).parents[2] / "docs" / "controller.md").read_text()
    rows = re.findall(r"^\| (\d+) \| `(\w+)` \| [^|]+ \| [^|]+ \|$", text, re.MULTILINE)
    assert {name: 1 << int(bit) for bit, name in rows} == {f.name: f.value for f in Fault}
    assert len(rows) == len(Fault)


def test_an_estimate_is_stamped_with_the_time_it_is_predicted_to() -> None:
    """Not with the caller's clock, to which it was not."""
    estimator, t = flown()
    newest = estimator.estimate()
    late = estimator.estimate(now_ns=t + 80 * MS)
    assert late.timestamp_ns == newest.timestamp_ns
    assert late.heading_rad == newest.heading_rad
    assert late.gyro_age_s == pytest.approx(newest.gyro_age_s + 0.08)
    both = estimator.estimate(now_ns=t + 80 * MS, at_ns=t + 80 * MS)
    assert both.timestamp_ns == t + 80 * MS


@pytest.mark.parametrize("now_ns", [1.7e9, float("nan"), "1700000000", 2**70])
def test_a_clock_that_gives_no_nanoseconds_is_refused(now_ns: Any) -> None:
    estimator, _ = flown()
    with pytest.raises(InputError, match="t_ns"):
        estimator.estimate(now_ns=now_ns)


def test_a_clock_far_behind_the_samples_is_reported() -> None:
    """Whole seconds, say: no silent sensor would ever show."""
    estimator, t = flown()
    found = estimator.estimate(now_ns=t - 5_000 * MS)
    assert "now_ns is 5 s before the newest sample" in found.reason
    assert Fault.IMU_CLOCK in found.faults
    assert not estimator.estimate(now_ns=t - 20 * MS).reason


def test_a_clock_far_ahead_of_the_samples_is_reported() -> None:
    """Unix time against time since boot."""
    estimator, t = flown()
    found = estimator.estimate(now_ns=1_700_000_000 * 10**9)
    assert "s after the newest sample: give nanoseconds of the samples' clock" in found.reason
    assert Fault.IMU_CLOCK in found.faults
    assert "now_ns" not in estimator.estimate(now_ns=t + 60_000 * MS).reason


@pytest.mark.parametrize("width_m", [0.2, 100.0])
def test_the_bounds_of_a_width_are_widths(width_m: float) -> None:
    estimator, t = flown()
    estimator.set_corridor_width(t, width_m)
    e = estimator.estimate()
    assert 2 * e.lateral_offset_m == pytest.approx(width_m * e.lateral_offset_norm)
    assert FusionConfig(corridor_width_m=width_m).corridor_width_m == width_m


@pytest.mark.parametrize("used_s", [0.0, 1.0])
@pytest.mark.parametrize(
    ("kind", "good", "bad", "told"),
    [
        ("velocity", (1.0, 0.0, 0.0), (150.0, 0.0, 0.0), "velocity is out of range: give m/s"),
        ("velocity", (1.0, 0.0, 0.0), (nan, 0.0, 0.0), "velocity is not finite"),
        ("attitude", (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0), "attitude is no unit quaternion"),
        ("range", 1.0, 1200.0, "range is out of range: give metres"),
        ("range", 1.0, 0.0, "range is not positive"),
    ],
)
def test_a_source_whose_values_are_impossible_is_not_called_silent(
    kind: str, good: Any, bad: Any, told: str, used_s: float
) -> None:
    """Whether it was used before, or never."""
    estimator, t = flown()
    for k in range(60):
        add = getattr(estimator, f"add_{kind}")
        add(t + k * 50 * MS, good if k * 0.05 < used_s else bad)
        fly(estimator, t // MS + k * 50, t // MS + k * 50 + 50, 0.0, 0.2)
    assert told in estimator.estimate().reason
    assert "silent" not in estimator.estimate().reason
