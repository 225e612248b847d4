from __future__ import annotations

from math import cos, degrees, radians, sin
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion.estimator.tilt import (
    COMPLEMENTARY_STD_RAD,
    LEVEL_STD_RAD,
    Tilt,
    attitude_at,
    from_quaternion,
    tilt_along,
    with_imu,
)
from tests.fusion.simulated import quaternion, weaving
from vision.errors import InputError
from vision.measurement import Attitude

S = 1_000_000_000


def down_of(roll: float, pitch: float) -> tuple[float, float, float]:
    return (-sin(pitch), sin(roll) * cos(pitch), cos(roll) * cos(pitch))


@pytest.mark.parametrize("q", [(1.0, 0.0, 0.0), np.eye(3), "level", None, (1.0, 0.0, 0.0, "z")])
def test_what_is_not_four_numbers_is_no_attitude(q: Any) -> None:
    with pytest.raises(InputError, match="four numbers"):
        Attitude.from_quaternion(q)


@given(st.floats(-3.1, 3.1), st.floats(-1.5, 1.5), st.floats(-3.1, 3.1))
def test_quaternion_gives_its_roll_and_pitch(roll: float, pitch: float, yaw: float) -> None:
    q = quaternion(roll, pitch, yaw)
    tilt = from_quaternion(Tilt(), 5, q)
    np.testing.assert_allclose(tilt.down, down_of(roll, pitch), atol=1e-9)
    found = attitude_at(tilt, 5, 0.01)
    expected = Attitude.from_quaternion(q)
    assert found is not None
    assert found.roll_rad == pytest.approx(expected.roll_rad, abs=1e-6)
    assert found.pitch_rad == pytest.approx(expected.pitch_rad, abs=1e-6)
    assert found.std_rad == pytest.approx(0.01)


def test_nothing_measured_is_no_attitude() -> None:
    assert attitude_at(Tilt(), 0, 0.01) is None


def fly(
    seed: int, *, attitude_hz: float, accel: bool, bias: float, seconds: float = 20.0, hz: float = 100.0
) -> tuple[np.ndarray, Attitude]:
    """Tilt by sensors against the truth; returns the errors of roll and pitch and the last attitude."""
    roll_of, pitch_of = weaving(seed, radians(12), 4.0), weaving(seed + 50, radians(12), 5.0)
    rng = np.random.default_rng(seed)
    tilt, errors, found = Tilt(), [], None
    for i in range(int(seconds * hz)):
        t = i / hz
        h = 0.5 / hz
        middle = t - h
        roll, pitch = float(roll_of(np.array(middle))), float(pitch_of(np.array(middle)))
        droll = float((roll_of(np.array(t)) - roll_of(np.array(t - 2 * h))) * hz)
        dpitch = float((pitch_of(np.array(t)) - pitch_of(np.array(t - 2 * h))) * hz)
        gyro = (droll + bias, dpitch * cos(roll) + bias, -dpitch * sin(roll))
        roll, pitch = float(roll_of(np.array(t))), float(pitch_of(np.array(t)))
        dx, dy, dz = down_of(roll, pitch)
        nx, ny, nz = rng.normal(0, 0.3, 3).tolist() if accel else (0.0, 0.0, 0.0)
        force = (-9.80665 * dx + nx, -9.80665 * dy + ny, -9.80665 * dz + nz) if accel else None
        t_ns = round(t * S)
        if attitude_hz and i % round(hz / attitude_hz) == 0:
            tilt = from_quaternion(tilt, t_ns, quaternion(roll, pitch, 1.0))
        tilt = with_imu(tilt, t_ns, gyro, force)
        found = attitude_at(tilt, t_ns, radians(0.5))
        assert found is not None
        errors.append((found.roll_rad - roll, found.pitch_rad - pitch))
    assert found is not None
    return np.array(errors), found


@pytest.mark.parametrize("seed", range(3))
def test_gyroscope_carries_the_attitude_between_its_samples(seed: int) -> None:
    errors, found = fly(seed, attitude_hz=10, accel=False, bias=0.01)
    assert degrees(np.abs(errors).max()) < 0.3
    assert found.std_rad < radians(0.6)


@pytest.mark.parametrize("seed", range(3))
def test_complementary_filter_learns_the_bias(seed: int) -> None:
    errors, found = fly(seed, attitude_hz=0, accel=True, bias=0.02, seconds=40)
    assert degrees(np.sqrt(np.mean(errors[2000:] ** 2))) < 1.5
    assert found.std_rad == COMPLEMENTARY_STD_RAD


def test_neither_is_level_with_a_wide_sigma() -> None:
    errors, found = fly(0, attitude_hz=0, accel=False, bias=0.0)
    assert found.std_rad == LEVEL_STD_RAD
    assert np.sqrt(np.mean(errors**2)) < LEVEL_STD_RAD


def test_a_silent_attitude_stream_gives_way_to_the_accelerometer() -> None:
    tilt = from_quaternion(Tilt(), 0, quaternion(0.3, 0.0, 0.0))  # a wrong last word
    for i in range(1, 3000):
        tilt = with_imu(tilt, i * S // 100, (0.0, 0.0, 0.0), (0.0, 0.0, -9.81))
    found = attitude_at(tilt, 30 * S, radians(0.5))
    assert found is not None
    assert abs(found.roll_rad) < radians(1)
    assert found.std_rad == COMPLEMENTARY_STD_RAD


@pytest.mark.parametrize("attitude_hz", [0, 20])
@pytest.mark.parametrize("accel", [True, False])
def test_a_log_at_once_has_the_tilt_of_its_samples_one_by_one(attitude_hz: int, accel: bool) -> None:
    rng = np.random.default_rng(7)
    t_ns = np.cumsum(rng.integers(4_000_000, 6_000_000, 2000))
    gyro, force = rng.normal(0.0, 0.2, (2000, 3)), rng.normal((0.0, 0.0, -9.8), 0.5, (2000, 3))
    force[:, :] += np.where(accel & (np.arange(2000) % 400 < 300), 0.0, np.nan)[:, None]
    # The attitude falls silent for two seconds, and comes back.
    attitude_ns = np.arange(S // 10, t_ns[-1], S // 20)[:: 1 if attitude_hz else 10**9][1:]
    attitude_ns = attitude_ns[(attitude_ns < 3 * S) | (attitude_ns > 5 * S)]
    q = np.array([quaternion(*rng.normal(0.0, 0.1, 3)) for _ in attitude_ns]).reshape(-1, 4)
    down, std_rad = tilt_along(t_ns, gyro, force, attitude_ns, q, 0.01)

    tilt, last, seen = Tilt(), gyro[0].tolist(), 0
    for k, (now_ns, now) in enumerate(zip(t_ns.tolist(), gyro.tolist(), strict=True)):
        while seen < len(attitude_ns) and attitude_ns[seen] < now_ns:
            tilt = from_quaternion(tilt, int(attitude_ns[seen]), tuple(q[seen].tolist()))
            seen += 1
        mean = (0.5 * (last[0] + now[0]), 0.5 * (last[1] + now[1]), 0.5 * (last[2] + now[2]))
        ax, ay, az = force[k].tolist()
        tilt, last = with_imu(tilt, now_ns, mean, (ax, ay, az) if ax == ax else None), now
        found = attitude_at(tilt, now_ns, 0.01)
        assert found is not None
        assert down[k] == pytest.approx(tilt.down, abs=1e-12)
        assert std_rad[k] == found.std_rad
    expected = {0.01} if attitude_hz else set()
    expected |= {COMPLEMENTARY_STD_RAD, LEVEL_STD_RAD} if accel else {LEVEL_STD_RAD}
    assert set(std_rad.tolist()) == expected


def test_acceleration_that_is_not_gravity_is_not_followed() -> None:
    tilt = from_quaternion(Tilt(), 0, quaternion(0.0, 0.0, 0.0))
    for i in range(1, 300):
        tilt = with_imu(tilt, i * S // 100, (0.0, 0.0, 0.0), (6.0, 0.0, -12.0))
    assert tilt.down == pytest.approx((0.0, 0.0, 1.0), abs=1e-6)


def test_held_attitude_grows_uncertain_without_a_gyroscope() -> None:
    tilt = from_quaternion(Tilt(), 0, quaternion(0.1, 0.0, 0.0))
    fresh, old, gone = (attitude_at(tilt, t, radians(0.5)) for t in (0, S // 5, S))
    assert fresh is not None
    assert old is not None
    assert gone is not None
    assert fresh.std_rad < old.std_rad < gone.std_rad == LEVEL_STD_RAD
