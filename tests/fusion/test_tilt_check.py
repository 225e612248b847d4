"""An attitude whose roll or pitch does not follow the gyroscope is named and not used."""

from __future__ import annotations

from collections.abc import Callable
from math import cos, radians, sin

import numpy as np
import pytest

from fusion import CorridorEstimator, Fault
from fusion.estimator.tilt import Tilt, from_quaternion, with_imu
from tests.fusion.simulated import frame, quaternion

S = 1_000_000_000
Given = Callable[[float, float, float], tuple[float, float, float]]


def right(roll: float, pitch: float, yaw: float) -> tuple[float, float, float]:
    return roll, pitch, yaw


WRONG: dict[str, Given] = {
    "roll of the other sign": lambda roll, pitch, yaw: (-roll, pitch, yaw),
    "pitch of the other sign": lambda roll, pitch, yaw: (roll, -pitch, yaw),
    "frozen": lambda roll, pitch, yaw: (0.03, -0.02, 1.0),
    "twice as large": lambda roll, pitch, yaw: (2 * roll, 2 * pitch, yaw),
    "exchanged": lambda roll, pitch, yaw: (pitch, roll, yaw),
}


def fly(given: Given, seed: int, *, since_s: float = 0.0, until_s: float = 24.0) -> list[tuple[float, Tilt]]:
    """Roll and pitch by 4 degrees for 40 s; the attitude is ``given`` in a part of the time."""
    rng = np.random.default_rng(seed)
    phase, tilt, error, found = rng.uniform(0.0, 6.0, 2), Tilt(), np.zeros(2), []
    for k in range(4000):
        t, t_ns = 0.01 * k, k * S // 100
        roll, pitch = radians(4) * np.sin(1.3 * t + phase[0]), radians(4) * np.sin(0.9 * t + phase[1])
        p = radians(4) * 1.3 * np.cos(1.3 * t + phase[0])
        q = radians(4) * 0.9 * np.cos(0.9 * t + phase[1])
        error = 0.98 * error + 0.2 * rng.normal(0.0, radians(0.4), 2)  # lasts for half a second
        if k % 4 == 1:
            angles = (roll + error[0], pitch + error[1], 0.3)
            tilt = from_quaternion(
                tilt, t_ns, quaternion(*(given(*angles) if since_s <= t < until_s else angles))
            )
        gyro = (p + 0.02, q * cos(roll) - 0.02, -q * sin(roll))  # with a bias of a degree per second
        force = rng.normal((9.81 * sin(pitch), -9.81 * sin(roll), -9.81), 0.1).tolist()
        tilt = with_imu(tilt, t_ns + S // 200, gyro, (force[0], force[1], force[2]))
        found.append((t, tilt))
    return found


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_one_that_follows_the_gyroscope_is_used(seed: int) -> None:
    assert not any(tilt.check.is_wrong for _, tilt in fly(right, seed))


@pytest.mark.parametrize("lean_deg", [3.0, 10.0])
def test_a_constant_error_is_left_to_the_accelerometer(lean_deg: float) -> None:
    flown = fly(lambda roll, pitch, yaw: (roll + radians(lean_deg), pitch, yaw), 0)
    assert not any(tilt.check.is_wrong for _, tilt in flown)


@pytest.mark.parametrize("since_s", [0.0, 8.0])
@pytest.mark.parametrize("name", WRONG)
def test_one_that_does_not_is_found_and_used_again_when_it_does(name: str, since_s: float) -> None:
    flown = fly(WRONG[name], 1, since_s=since_s)
    wrong = [t for t, tilt in flown if tilt.check.is_wrong]
    assert since_s < wrong[0] < since_s + 18.0
    assert wrong[-1] < 39.0
    assert all(tilt.follows_force for t, tilt in flown if wrong[0] + 0.1 < t < 24.0)
    assert not flown[-1][1].follows_force


def test_a_vehicle_that_hardly_tilts_accuses_no_attitude() -> None:
    tilt, rng = Tilt(), np.random.default_rng(2)
    for k in range(3000):
        roll, pitch = rng.normal(0.0, radians(0.3), 2).tolist()
        tilt = from_quaternion(tilt, k * S // 100, quaternion(roll, pitch, 0.0))
        p, q = rng.normal(0.0, 0.02, 2).tolist()
        tilt = with_imu(tilt, k * S // 100 + S // 200, (p, q, 0.0), None)
        assert not tilt.check.is_wrong


@pytest.mark.parametrize("noise_deg", [1.5, 2.5])
@pytest.mark.parametrize("seed", range(20))
def test_nor_one_whose_attitude_is_noisy(seed: int, noise_deg: float) -> None:
    tilt, rng = Tilt(), np.random.default_rng(seed)
    for k in range(500):
        if k % 2 == 0:
            roll, pitch = rng.normal((radians(1) * sin(0.065 * k), 0.0), radians(noise_deg)).tolist()
            tilt = from_quaternion(tilt, k * S // 50, quaternion(roll, pitch, 0.0))
        tilt = with_imu(tilt, k * S // 50 + S // 100, (radians(3.25) * cos(0.065 * k), 0.0, 0.0), None)
        assert not tilt.check.is_wrong


@pytest.mark.parametrize("given", ["at 5 Hz", "0.1 s late"])
@pytest.mark.parametrize("amplitude_deg", [4.0, 35.0])
def test_nor_one_whose_attitude_is_slow_or_late(given: str, amplitude_deg: float) -> None:
    """The gyroscope has a bias of 5 degrees per second."""
    tilt, amplitude, late_s = Tilt(), radians(amplitude_deg), 0.1 if given == "0.1 s late" else 0.0
    for k in range(2400):
        t = 0.01 * k
        if k % (20 if given == "at 5 Hz" else 2) == 0:
            roll = amplitude * sin(1.5 * (t - late_s))
            tilt = from_quaternion(tilt, k * S // 100, quaternion(roll, 0.0, 0.0))
        rates = (1.5 * amplitude * cos(1.5 * t) + radians(5), -radians(5), 0.0)
        tilt = with_imu(tilt, k * S // 100 + S // 200, rates, None)
        assert not tilt.check.is_wrong


def test_spans_with_a_gap_of_the_gyroscope_do_not_count() -> None:
    tilt = Tilt()
    for k in range(400):
        roll = radians(10) * sin(0.03 * k)
        tilt = from_quaternion(tilt, k * S // 20, quaternion(roll, 0.0, 0.0))
        if k % 8 == 0:  # every 0.4 s
            tilt = with_imu(tilt, k * S // 20 + 1, (0.0, 0.0, 0.0), None)
    assert not tilt.check.is_wrong
    assert tilt.check.sums[1][0] == 0.0


@pytest.mark.parametrize("with_frames", [True, False])
def test_the_estimator_names_it(with_frames: bool) -> None:
    """Also before the first heading."""
    estimator, named = CorridorEstimator(), False
    for k in range(1500):
        t, t_ns = 0.01 * k, k * S // 100
        roll, rate = radians(4) * sin(2.0 * t), radians(8) * cos(2.0 * t)
        estimator.add_imu(t_ns, (rate, 0.0, 0.0), (0.0, -9.81 * sin(roll), -9.81 * cos(roll)))
        if k % 4 == 1:
            estimator.add_attitude(t_ns, quaternion(-roll, 0.0, 0.0))
        if k % 5 == 4 and with_frames:
            estimator.add_measurement(t_ns, frame(0.0, 0.004, 0.0, 0.03))
        named |= bool(k % 50 == 49 and estimator.estimate().faults & Fault.TILT_WRONG)
    assert named
    assert estimator.estimate().roll_rad == pytest.approx(roll, abs=radians(1))
