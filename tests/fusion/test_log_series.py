"""What the readers of recorded logs share: times that lie, samples that are none, frames turned."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from fusion.flight import AttitudeStream, VectorStream
from fusion.logs.autopilot import tlog, ulog
from fusion.logs.imu_series import imu_stream, spread_bursts
from fusion.logs.interpolation import attitude_at, interpolated
from fusion.logs.rosbag import bag as rosbag
from fusion.logs.series import (
    LATEST_NS,
    Where,
    attitude_stream,
    into_body,
    nanoseconds,
    quaternions,
    range_stream,
    usable,
    vector_stream,
    velocity_stream,
)
from vision import InputError

STEP_NS = 5_000_000
START_NS = 10_000_000_000


def clean(n: int = 200) -> np.ndarray:
    return START_NS + STEP_NS * np.arange(n, dtype=np.int64)


def where() -> Where:
    return Where(Path("a.log"), "imu")


def test_good_times_are_kept_as_they_are() -> None:
    index, problems = usable(clean(), where())
    np.testing.assert_array_equal(index, np.arange(200))
    assert problems == ()


@settings(max_examples=60, deadline=None)
@given(
    places=st.lists(st.integers(0, 199), min_size=1, max_size=4, unique=True),
    wrong=st.lists(st.integers(-(2**62), 2**63 - 1), min_size=4, max_size=4),
)
def test_damaged_times_never_stay_in_the_stream(places: list[int], wrong: list[int]) -> None:
    t_ns = clean()
    for place, value in zip(places, wrong, strict=False):
        t_ns[place] = value
    index, problems = usable(t_ns, where())
    kept = t_ns[index]
    assert (np.diff(kept) > 0).all()
    assert kept.min() >= START_NS - 600_000_000
    assert kept.max() <= clean()[-1] + 600_000_000
    assert len(kept) >= 200 - 2 * len(places)
    if len(kept) < 200:
        assert problems != ()


def test_a_damaged_time_close_by_is_sorted_and_said() -> None:
    t_ns = clean()
    t_ns[50] += 30 * STEP_NS + 1
    index, problems = usable(t_ns, where())
    assert sorted(index.tolist()) == list(range(200))
    assert "times go backwards in 1 place" in problems[0]


def test_a_gap_is_no_damage() -> None:
    t_ns = clean()
    t_ns[120:] += 30_000_000_000
    index, problems = usable(t_ns, where())
    np.testing.assert_array_equal(index, np.arange(200))
    assert problems == ()


@pytest.mark.parametrize("jump_s", [-5.0, -9.0, 86_400.0])
def test_a_clock_that_jumps_leaves_the_longest_stretch(jump_s: float) -> None:
    t_ns = clean()
    t_ns[60:] += int(jump_s * 1e9)
    index, problems = usable(t_ns, where())
    np.testing.assert_array_equal(index, np.arange(60, 200))
    assert f"the clock jumps by {jump_s:+.3g} s" in problems[0]
    assert "60 samples left out" in problems[0]


def test_times_that_are_all_damaged_are_refused() -> None:
    with pytest.raises(InputError, match=r"a\.log: imu: every row has a time that cannot be one"):
        usable(np.full(5, LATEST_NS), where())
    with pytest.raises(InputError, match="imu has no samples"):
        usable(np.empty(0, np.int64), where())


def test_ticks_that_overflow_are_no_times() -> None:
    ticks = np.array([5, 2**63, 2**64 - 1, 2**62 // 1000 + 1], dtype=np.uint64)
    np.testing.assert_array_equal(nanoseconds(ticks, 1000), [5000, LATEST_NS, LATEST_NS, LATEST_NS])


def test_rows_that_are_no_numbers_are_dropped_and_said() -> None:
    gyro, accel = np.zeros((200, 3)), np.full((200, 3), 9.8)
    gyro[3, 1], gyro[5, 0], accel[7, 2], accel[8, 0] = np.nan, 1e30, np.inf, -1e20
    imu, problems = imu_stream(clean(), gyro, accel, where())
    assert len(imu.t_ns) == 198
    assert np.isnan(imu.accel_m_s2).all(axis=1).sum() == 2
    assert problems[0].startswith("imu: 2 rows dropped: a missing or impossible gyro value")
    assert problems[1] == "imu: 2 rows without acceleration"
    with pytest.raises(InputError, match="imu: every row has a missing or impossible gyro value"):
        imu_stream(clean(), np.full((200, 3), np.nan), accel, where())


def test_quaternions_are_made_unit_and_those_that_are_none_dropped() -> None:
    q = np.tile([0.0, 0.0, 0.0, 1.02], (200, 1))
    q[4] = 0.0
    attitude, problems = attitude_stream(clean(), q, where())
    np.testing.assert_allclose(attitude.q_world_body, [[0.0, 0.0, 0.0, 1.0]] * 199)
    assert "1 row dropped: a quaternion that is not of unit length" in problems[0]


@given(angles=st.tuples(*[st.floats(-3.1, 3.1)] * 3), v=st.tuples(*[st.floats(-10, 10)] * 3))
def test_angles_and_turning_are_those_of_scipy(angles: tuple[float, ...], v: tuple[float, ...]) -> None:
    roll, pitch, yaw = (np.array([angle]) for angle in angles)
    q = quaternions(roll, pitch, yaw)
    expected = Rotation.from_euler("ZYX", [angles[2], angles[1], angles[0]])
    assert abs(np.dot(q[0], expected.as_quat(scalar_first=True))) == pytest.approx(1.0, abs=1e-12)
    np.testing.assert_allclose(into_body(q, np.array([v]))[0], expected.inv().apply(v), atol=1e-9)


def test_attitude_between_samples_is_that_of_slerp_and_unknown_in_gaps() -> None:
    t_ns = np.array([0, 20, 40, 1000, 1020], dtype=np.int64) * 1_000_000
    rotation = Rotation.from_euler(
        "ZYX", np.radians([[0, 0, 0], [3, 1, 0], [6, 2, 1], [50, 0, 0], [53, 0, 0]])
    )
    q = rotation.as_quat(scalar_first=True) * np.array([1, -1, 1, -1, 1])[:, None]  # either sign is the same
    stream = AttitudeStream(t_ns, q)
    at_ns = np.array([-1, 0, 7, 33, 40, 500, 1010, 1020, 1021], dtype=np.int64) * 1_000_000
    found, known = attitude_at(stream, at_ns)
    assert known.tolist() == [False, True, True, True, True, False, True, True, False]
    expected = Slerp(t_ns, rotation)(at_ns[known]).as_quat(scalar_first=True)
    np.testing.assert_allclose(np.abs(np.sum(found[known] * expected, axis=1)), 1.0, atol=1e-9)
    found, known = attitude_at(stream, at_ns, hold_ns=500_000_000)
    assert known.all()
    nearest = q[[0, 0, 1, 2, 2, 2, 4, 4, 4]]  # held in the gap and beyond the ends, from either side
    held = [0, 5, 8]
    np.testing.assert_allclose(np.abs(np.sum(found[held] * nearest[held], axis=1)), 1.0, atol=1e-12)


def test_velocity_without_attitude_is_dropped_and_said() -> None:
    attitude = AttitudeStream(clean(100), np.tile([0.5**0.5, 0.0, 0.0, 0.5**0.5], (100, 1)))
    world = np.tile([0.0, 2.0, 0.1], (200, 1))
    velocity, problems = velocity_stream(clean(), world, attitude, where())
    np.testing.assert_allclose(velocity.xyz, [[2.0, 0.0, 0.1]] * 100, atol=1e-12)
    assert "100 rows dropped: no attitude to turn it into the body" in problems[0]


def test_a_limit_tells_damage() -> None:
    xyz = np.zeros((200, 3))
    xyz[9, 2] = 2e7
    assert len(vector_stream(clean(), xyz, where(), 1e7).value.t_ns) == 199


def test_values_between_samples_and_none_in_gaps() -> None:
    samples = VectorStream(
        np.array([0, 10, 100], np.int64), np.array([[0.0], [1.0], [2.0]]) * [1.0, 2.0, 3.0]
    )
    found = interpolated(samples, np.array([-1, 0, 5, 10, 50, 100, 101], np.int64), max_gap_ns=20)
    np.testing.assert_array_equal(found[:, 1], [np.nan, 0.0, 1.0, 2.0, np.nan, 4.0, np.nan])
    one = VectorStream(np.array([7], np.int64), np.array([[1.0, 2.0, 3.0]]))
    np.testing.assert_array_equal(
        interpolated(one, np.array([6, 7, 8], np.int64), 20)[:, 0], [np.nan, 1.0, np.nan]
    )


@pytest.mark.parametrize(
    ("reader", "library", "extra", "head"),
    [
        (ulog, "pyulog", "px4", ulog.MAGIC + bytes(100)),
        (rosbag, "rosbags.rosbag2", "ros", b"#ROSBAG V2.0\n" + bytes(100)),
        (
            tlog,
            "pymavlink.dialects.v20",
            "ardupilot",
            (1_700_000_000_000_000).to_bytes(8, "big") + b"\xfd" + bytes(100),
        ),
    ],
)
def test_a_library_that_is_missing_is_named(
    reader: object, library: str, extra: str, head: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, library, None)
    path = tmp_path / "log"
    path.write_bytes(head)
    assert reader.recognises(path)  # type: ignore[attr-defined]
    with pytest.raises(InputError, match=rf"pip install 'corridor-fusion\[{extra}\]'"):
        reader.open_log(path)  # type: ignore[attr-defined]


def test_distances_that_are_none_are_dropped() -> None:
    nan, inf = float("nan"), float("inf")
    distance_m = np.array([1.0, nan, inf, -inf, 0.0, -1.0, 0.3, 8.0, 7.9, 150.0])
    t_ns = clean(10)
    found, problems = range_stream(t_ns, distance_m, where(), limits_m=(0.3, 8.0))
    assert found.distance_m.tolist() == [1.0, 7.9]
    assert found.t_ns.tolist() == [t_ns[0], t_ns[8]]
    assert "imu: 8 rows dropped: no distance within the sensor's reach" in problems[0]
    unlimited = range_stream(t_ns, distance_m, where(), limits_m=(nan, 0.0)).value
    assert unlimited.distance_m.tolist() == [1.0, 0.3, 8.0, 7.9]
    trusted = np.arange(10) != 0
    assert range_stream(t_ns, distance_m, where(), trusted=trusted).value.distance_m[0] == 0.3
    with pytest.raises(InputError, match="every row has no distance within the sensor's reach"):
        range_stream(t_ns, np.full(10, nan), where())


def test_rows_before_a_pause_are_no_damage() -> None:
    """A few samples at an end, or between two pauses, in the usual step: the log was paused."""
    t_ns = clean()
    t_ns[:3] -= 9_000_000_000
    t_ns[150:] += 3_000_000_000
    t_ns[154:] += 3_000_000_000
    t_ns[199] += 2_000_000_000
    index, problems = usable(t_ns, where())
    np.testing.assert_array_equal(index, np.arange(200))
    assert problems == ()


@pytest.mark.parametrize(("size", "close_ns"), [(10, 20_000), (10, 60_000), (3, 150_000)])
def test_bursts_of_a_drivers_buffer_are_spread(size: int, close_ns: int) -> None:
    true_ns = clean(600)
    last = np.minimum(np.arange(600) // size * size + size - 1, 599)
    stamped_ns = true_ns[last] + np.arange(600) % size * close_ns - (size - 1) * close_ns
    gyro = np.linspace(1.0, 2.0, 600)[:, None] * np.ones(3)
    imu, problems = imu_stream(stamped_ns, gyro, np.full((600, 3), 9.8), where())
    assert np.abs(imu.t_ns - true_ns).max() < 1_000_000
    assert f"bursts of {size}, {close_ns // 1000} us apart" in problems[0]


@given(rate_hz=st.integers(1, 8000))
def test_an_even_rate_is_no_burst(rate_hz: int) -> None:
    t_ns = START_NS + (np.arange(300) * 10**9) // rate_hz
    assert spread_bursts(t_ns, where()) == (t_ns, ())
