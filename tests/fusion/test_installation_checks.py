"""Sensors that are installed otherwise than told are named within seconds, and those that are not never."""

from __future__ import annotations

from math import cos, exp, hypot, inf, pi, radians, sin, sqrt

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from fusion.estimator.faults import Fault
from fusion.estimator.installation.camera_yaw import CameraYaw
from fusion.estimator.installation.checks import Installation
from fusion.estimator.installation.running_slope import LEVEL_S, MEMORY
from fusion.estimator.models import Vector

DOWN = (0.0, 0.0, 1.0)


def told(slope: float, bias: float, seconds: float = 6.0, seed: int = 0) -> Fault:
    """What is said where frames see ``slope`` times the gyroscope's turns, which have this bias, rad/s."""
    installation, rng, said = Installation(), np.random.default_rng(seed), Fault.NONE
    for t in np.arange(0.0, seconds, 1 / 30).tolist():
        turned = 0.4 * float(np.sin(1.5 * t))
        heading = slope * turned + float(rng.normal(0.0, 0.009))
        installation = installation.with_frame(round(t * 1e9), heading, turned + bias * t, radians(0.5))
        for notice in installation.notices():
            said |= notice.fault
    return said


@pytest.mark.parametrize(
    ("slope", "bias", "fault"),
    [
        (-1.0, 0.0, Fault.GYRO_SIGN),
        (1.0, 0.35, Fault.GYRO_BIAS),
        (1 / 0.7, 0.0, Fault.FOCAL_LENGTH),
    ],
)
def test_turns_tell(slope: float, bias: float, fault: Fault) -> None:
    assert told(slope, bias, 20.0) == fault


@pytest.mark.parametrize("seed", range(20))
def test_what_is_installed_as_told_is_not_accused(seed: int) -> None:
    assert told(1.02, 0.02, 20.0, seed) == Fault.NONE


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize(
    ("yaw_deg", "roll_deg", "fault"),
    [
        (6.0, 8.0, Fault.CAMERA_YAW),
        (-6.0, 8.0, Fault.CAMERA_YAW),
        (2.0, 8.0, Fault.NONE),
        (6.0, 0.5, Fault.NONE),  # it hardly rolls: nothing can be told
    ],
)
def test_rolling_tells_where_the_camera_points(
    yaw_deg: float, roll_deg: float, fault: Fault, seed: int
) -> None:
    installation, rng, said = Installation(), np.random.default_rng(seed), Fault.NONE
    for t in np.arange(0.0, 8.0, 1 / 30).tolist():
        roll = radians(roll_deg) * sin(2.0 * t)
        elevation = radians(3.0) + radians(yaw_deg) * sin(roll) + float(rng.normal(0.0, radians(0.2)))
        installation = installation.with_elevation(round(t * 1e9), elevation, radians(0.2), roll)
        for notice in installation.notices():
            said |= notice.fault
    assert said == fault


def camera_yaw_told_s(
    yaw_deg: float, lasting_s: float, lasting_deg: float, seed: int, seconds: float
) -> float:
    """When a camera is said to point to one side, by elevations of which some errors last; infinite: never."""
    rng, error = np.random.default_rng(seed), 0.0
    keep, seen = exp(-1 / (30.0 * lasting_s)), CameraYaw()
    phases = rng.uniform(0.0, 2 * pi, 2).tolist()
    for k in range(round(30 * seconds)):
        t = k / 30
        error = keep * error + float(rng.normal(0.0, lasting_deg * sqrt(1.0 - keep * keep)))
        roll = radians(6.0) * sin(2.0 * t + phases[0]) + radians(4.0) * sin(3.3 * t + phases[1])
        white = float(rng.normal(0.0, 0.3))
        elevation = radians(3.0 + error + white) + radians(yaw_deg) * sin(roll)
        seen = seen.with_elevation(round(t * 1e9), elevation, radians(0.54), roll)
        if seen.is_off:
            return t
    return inf


@pytest.mark.parametrize("seed", range(6))
def test_elevations_better_than_they_say_tell_sooner_where_the_camera_points(seed: int) -> None:
    """What is stated would take twice as long: 10 frames that have one error of 0.54 degrees."""
    assert camera_yaw_told_s(6.0, 0.05, 0.0, seed, 20.0) < 10.0
    assert camera_yaw_told_s(-12.0, 0.05, 0.0, seed, 20.0) < 6.0


@pytest.mark.parametrize("lasting_s", [0.3, 1.0, 3.0, 10.0])
def test_errors_of_the_attitude_that_last_accuse_no_camera(lasting_s: float) -> None:
    assert all(camera_yaw_told_s(0.0, lasting_s, 0.5, seed, 60.0) == inf for seed in range(6))


@pytest.mark.parametrize("lasting_s", [5.0, 20.0, 60.0])
@pytest.mark.parametrize("ramp_deg", [0.0, 5.0])
def test_what_lasts_as_long_as_the_roll_accuses_no_camera(lasting_s: float, ramp_deg: float) -> None:
    """A vehicle that leans into the wind for a while, an attitude that is off as long, and a ramp in the floor."""
    keep = exp(-1 / (30.0 * lasting_s))
    drive = sqrt(1.0 - keep * keep)
    for seed in range(4):
        rng, error, lean, seen = np.random.default_rng(seed), 0.0, 0.0, CameraYaw()
        for k in range(30 * 120):
            error, lean = keep * np.array([error, lean]) + drive * rng.normal(0.0, [0.5, 5.0])
            ramp = ramp_deg if 1200 < k < 2000 else 0.0
            elevation = radians(3.0 + ramp + error + float(rng.normal(0.0, 0.3)))
            seen = seen.with_elevation(round(k * 1e9 / 30), elevation, radians(0.54), radians(float(lean)))
            assert not seen.is_off


def test_the_angle_is_that_of_a_line_through_all_elevations() -> None:
    """Without fading it is the weighted least squares of numpy."""
    rng, seen = np.random.default_rng(1), CameraYaw()
    rolls = rng.normal(0.0, 0.1, 45)
    stds = rng.uniform(0.002, 0.006, 45)
    elevations = 0.05 + 0.1 * np.sin(rolls) + rng.normal(0.0, stds)
    for k in range(46):
        at = min(k, 44)  # the last one only ends the third block
        seen = seen.with_elevation(round(k * 1e9 / 30), elevations[at], stds[at], rolls[at])
    weights = np.concatenate([np.full(15, memory) for memory in (MEMORY**2, MEMORY, 1.0)])
    points = np.column_stack([np.sin(rolls), elevations])
    mean, fast = points[0], []
    for point in points:
        fast.append(point - mean)
        mean = mean + (1.0 - exp(-1.0 / 30.0 / LEVEL_S)) * (point - mean)
    x, y = np.transpose(fast)
    slope, _ = np.polyfit(x, y, 1, w=np.sqrt(weights) / stds)
    assert seen.angle_rad == pytest.approx(slope, rel=1e-9)
    assert 0.0 < seen.std_rad < 0.1


@pytest.mark.parametrize(
    ("accel", "down", "words"),
    [
        ((0.0, 0.0, 9.8), (0.0, 0.0, -1.0), "accelerometer is upside down"),
        ((0.0, 0.0, -9.8), (0.0, 0.0, -1.0), "attitude is upside down"),
        ((0.0, -5.0, -8.4), (0.0, 0.0, 1.0), "disagree"),
        ((0.0, 0.0, -1.0), (0.0, 0.0, 1.0), "check its unit"),  # in g
        ((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), "not gravity"),
        ((0.0, -1.0, -9.7), (0.0, 0.0, 1.0), ""),
        (None, (0.0, 0.0, 1.0), ""),
    ],
)
def test_gravity_tells(
    accel: tuple[float, float, float] | None, down: tuple[float, float, float], words: str
) -> None:
    installation = Installation()
    for k in range(500):
        installation = installation.with_imu(k * 5_000_000, (0.0, 0.0, 0.0), accel, down)
    text = "; ".join(notice.text for notice in installation.notices())
    assert words in text
    assert bool(words) == bool(text)


@settings(max_examples=40, deadline=None)
@given(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3), st.floats(0.0, 1.5), st.floats(3.0, 8.0))
def test_an_attitude_that_leans_is_told_within_six_seconds(
    roll: float, pitch: float, acceleration: float, period_s: float
) -> None:
    """Weaving across the corridor is no lean; 9 degrees are, 3 are not."""
    leaning = hypot(roll, pitch)
    assume(leaning > radians(9) or (leaning < radians(3) and acceleration < 0.7))
    down = (-sin(pitch), sin(roll) * cos(pitch), cos(roll) * cos(pitch))
    installation = Installation()
    for t in np.arange(0.0, 6.0, 0.01).tolist():
        across = acceleration * sin(2.0 * pi * t / period_s) if leaning < radians(3) else 0.0
        installation = installation.with_imu(round(t * 1e9), (0.0, 0.0, 0.0), (0.0, across, -9.8), down)
    told = [notice.fault for notice in installation.notices()]
    assert told == ([Fault.TILT_WRONG] if leaning > radians(9) else [])


@pytest.mark.parametrize(
    ("accel", "down", "told"),
    [
        ((0.0, 0.0, -9.8), DOWN, [Fault.GYRO_SIGN]),
        ((0.0, 0.0, -9.8), (0.0, 0.0, -1.0), [Fault.TILT_WRONG]),  # the turns are reversed by the attitude,
        ((0.0, 0.0, 9.8), (0.0, 0.0, -1.0), [Fault.TILT_WRONG]),  # or by the accelerometer
        ((0.0, 0.0, 9.8), DOWN, [Fault.TILT_WRONG, Fault.GYRO_SIGN]),
        ((0.0, 0.0, 0.0), DOWN, [Fault.TILT_WRONG, Fault.GYRO_SIGN]),
        ((0.0, -5.0, -8.4), DOWN, [Fault.TILT_WRONG, Fault.GYRO_SIGN]),
    ],
)
def test_a_gyroscope_whose_turns_the_tilt_reverses_is_not_named_and_another_is(
    accel: Vector, down: Vector, told: list[Fault]
) -> None:
    installation, rng = Installation(), np.random.default_rng(0)
    for t in np.arange(0.0, 6.0, 1 / 30).tolist():
        turned = 0.4 * float(np.sin(1.5 * t))
        heading = -turned + float(rng.normal(0.0, 0.009))
        installation = installation.with_frame(round(t * 1e9), heading, turned, radians(0.5))
        installation = installation.with_imu(round(t * 1e9), (0.0, 0.0, 0.0), accel, down)
    assert [notice.fault for notice in installation.notices()] == told


@pytest.mark.parametrize("along_thrust", [False, True])
@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("rad_s", [0.5, 0.7, 1.5, 2.5, 4.0])
@pytest.mark.parametrize("tilt_deg", [10.0, 18.0, 25.0, 35.0, 45.0])
def test_a_vehicle_that_rolls_or_pitches_to_and_fro_is_not_accused(
    tilt_deg: float, rad_s: float, axis: int, along_thrust: bool
) -> None:
    """Its force is along gravity, or along the thrust: then it speeds up by 8 m/s at most."""
    if along_thrust and 2.0 * 9.8 * sin(radians(tilt_deg)) / rad_s > 8.0:
        return
    installation = Installation()
    for k in range(6000):
        angle = radians(tilt_deg) * sin(0.005 * rad_s * k)
        rate = radians(tilt_deg) * rad_s * cos(0.005 * rad_s * k)
        rates, down = (rate, 0.0, 0.0), (0.0, sin(angle), cos(angle))
        if axis == 1:
            rates, down = (0.0, rate, 0.0), (-sin(angle), 0.0, cos(angle))
        x, y, z = down
        accel = (0.0, 0.0, -9.8 / z) if along_thrust else (-9.8 * x, -9.8 * y, -9.8 * z)
        installation = installation.with_imu(k * 5_000_000, rates, accel, down)
        assert k % 10 or not list(installation.notices())


@pytest.mark.parametrize("k_wild", [20, 500])
@pytest.mark.parametrize("wild", [(600.0, 0.0, 0.0), (0.0, 0.0, 600.0), (200.0, -200.0, 200.0)])
def test_one_wild_force_accuses_nothing(wild: Vector, k_wild: int) -> None:
    installation = Installation()
    for k in range(1000):
        accel = wild if k == k_wild else (0.0, 0.0, -9.8)
        installation = installation.with_imu(k * 10_000_000, (0.0, 0.0, 0.0), accel, DOWN)
        assert not list(installation.notices())


@pytest.mark.parametrize("accel", [(0.0, 0.0, -9.8), None])
@pytest.mark.parametrize(("rate", "told"), [(20.0, True), (2.0, False)])
def test_a_gyroscope_in_degrees_is_named_before_what_it_does_to_the_tilt(
    rate: float, told: bool, accel: tuple[float, float, float] | None
) -> None:
    """No frame is of use then: nothing but the rates themselves can tell."""
    installation = Installation()
    for t in np.arange(0.0, 4.0, 0.005).tolist():
        turning = (0.0, 0.0, rate * float(np.sin(1.5 * t)))
        down = (0.0, 0.0, -1.0)  # what such turns made of it
        installation = installation.with_imu(round(t * 1e9), turning, accel, down)
    (notice,) = installation.notices() if told else (None,)
    if notice is not None:
        assert notice.fault is Fault.GYRO_SCALE
        assert "convert deg/s to rad/s" in notice.text
    else:
        assert all(n.fault is Fault.TILT_WRONG for n in installation.notices())


def flown(flip: bool, weaving: float, degrees_taken: bool) -> list[set[Fault]]:
    """Faults of each tenth of a second: a rate of noise and weaving, and a flip in one second or a spin for three."""
    installation, rng, found = Installation(), np.random.default_rng(3), []
    turned, end_s = 0.0, 15.7 if flip else 18.0
    scale = 180 / pi if degrees_taken else 1.0
    for k in range(25 * 200):
        t = k / 200
        fast = 9.0 if 15.0 < t < end_s else 0.0
        yaw = weaving * cos(0.9 * t) + float(rng.normal(0.0, 0.04))
        turned += scale * (yaw + (0.0 if flip else fast)) / 200
        rates = (scale * fast, 0.0, scale * yaw) if flip else (0.0, 0.0, scale * (yaw + fast))
        installation = installation.with_imu(round(t * 1e9), rates, (0.0, 0.0, -9.8), DOWN)
        if k % 10 == 0 and not 14.9 < t < end_s + 2.0:
            heading = turned / scale + float(rng.normal(0.0, 0.009))
            installation = installation.with_frame(round(t * 1e9), heading, turned, radians(0.5))
        if k % 20 == 0:
            found.append({notice.fault for notice in installation.notices()})
    return found


@pytest.mark.parametrize("weaving", [0.0, 0.02, 0.15])
def test_a_flip_is_not_a_gyroscope_in_degrees(weaving: float) -> None:
    assert not any(Fault.GYRO_SCALE in found for found in flown(True, weaving, False))


def test_a_spin_of_three_seconds_is_not_a_gyroscope_in_degrees_if_frames_have_confirmed_the_rates() -> None:
    assert not any(Fault.GYRO_SCALE in found for found in flown(False, 0.15, False))


@pytest.mark.parametrize("weaving", [0.1, 0.2])
def test_a_gyroscope_in_degrees_is_reported_before_a_flip_and_after(weaving: float) -> None:
    found = flown(True, weaving, True)
    assert all(Fault.GYRO_SCALE in faults for faults in found[25:])


def test_a_gyroscope_in_degrees_does_not_hide_an_inverted_accelerometer() -> None:
    installation = Installation()
    for k in range(800):
        installation = installation.with_imu(k * 5_000_000, (0.0, 0.0, 20.0), (0.0, 0.0, 9.8), DOWN)
    assert [n.fault for n in installation.notices()] == [Fault.GYRO_SCALE, Fault.TILT_WRONG]


@pytest.mark.parametrize("std_rad", [1e-300, 5e-324, 1e-9, 3.0])
def test_any_sigma_leaves_numbers(std_rad: float) -> None:
    installation = Installation()
    for k in range(600):
        t = k / 30
        installation = installation.with_frame(round(t * 1e9), 0.5 * sin(t), 0.5 * sin(t), std_rad)
        installation = installation.with_elevation(round(t * 1e9), 0.01, std_rad, 0.1 * sin(t))
    assert not list(installation.notices())
