"""The sample flight changed in each way that a log can be wrong: refused or said, in words; and silence otherwise."""

from __future__ import annotations

import re
from dataclasses import replace
from math import radians
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fusion.flight import AttitudeStream, Flight, ImuStream, VectorStream
from fusion.logs import load_flight
from fusion.logs.contents import Medium
from fusion.logs.plausibility.clocks import examine_clocks
from fusion.logs.plausibility.findings import Advice, Severity
from fusion.logs.plausibility.flight import check_flight, examine_attitude, examine_flight
from fusion.logs.plausibility.imu import examine_imu
from fusion.logs.plausibility.mounting import rotation
from fusion.logs.plausibility.turn_rates import compare_turns, turn_between
from fusion.simulate.config import AttitudeConfig, ImuConfig, MotionConfig
from fusion.simulate.imu import read_attitude, read_imu, sample_times
from fusion.simulate.motion import plan_flight
from fusion.simulate.scene.config import SceneConfig
from fusion.simulate.scene.plan import floor_plan
from tests.files import HALLWAY, ROOT, SHARED
from vision import InputError

OFFICE: Flight = load_flight(ROOT / "data" / "office")
TOML = Path("flight.toml")

FLU = np.diag([1.0, -1.0, -1.0])
PHONE = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])  # x, y, z named one off
CONJUGATED, ENU = [1.0, -1.0, -1.0, -1.0], [1.0, 1.0, -1.0, -1.0]


def imu(flight: Flight = OFFICE, **changes: Any) -> Flight:
    assert flight.imu is not None
    return replace(flight, imu=replace(flight.imu, **changes))


def attitude(signs: list[float], flight: Flight = OFFICE) -> Flight:
    assert flight.attitude is not None
    turned = replace(flight.attitude, q_world_body=flight.attitude.q_world_body * np.array(signs))
    return replace(flight, attitude=turned)


assert OFFICE.imu is not None
assert OFFICE.attitude is not None
T, GYRO, ACCEL = OFFICE.imu.t_ns, OFFICE.imu.gyro_rad_s, OFFICE.imu.accel_m_s2
NO_ATTITUDE = replace(OFFICE, attitude=None)
SINCE_ZERO = T - T[0]


@pytest.mark.parametrize(
    ("flight", "match"),
    [
        (
            imu(gyro_rad_s=np.degrees(GYRO)),
            r"imu: the gyroscope turns 5\d\.\d times as fast as the attitude: it is in degrees/s, not rad/s "
            r'\(set gyro_unit = "deg/s" in \[imu.columns\] of flight.toml',
        ),
        (
            imu(NO_ATTITUDE, gyro_rad_s=np.degrees(GYRO)),
            r"one gyroscope sample in a hundred is beyond \d+ rad/s, more than any measures: it is in degrees/s",
        ),
        (
            imu(NO_ATTITUDE, gyro_rad_s=np.degrees(0.3 * GYRO)),
            r"by the gyroscope the vehicle tilts \d+ degrees every 0.5 s, by gravity \d\.\d: it is in degrees/s",
        ),
        (imu(gyro_rad_s=1000.0 * GYRO), r'it is in mrad/s, not rad/s \(set gyro_unit = "mrad/s"'),
        (
            imu(gyro_rad_s=20.0 * GYRO),
            "the gyroscope turns 20.* times as fast as the attitude: it is in another unit",
        ),
        (
            imu(accel_m_s2=ACCEL / 9.80665),
            r"imu: gravity reads 1.0\d* instead of 9.81 m/s\^2: the accelerometer is in g \(set accel_unit = \"g\"",
        ),
        (
            imu(accel_m_s2=ACCEL / 9.80665e-3),
            r"gravity reads 10\d\d instead of 9.81 m/s\^2: the accelerometer is in thousandths of g \(set accel_unit",
        ),
        (
            imu(accel_m_s2=ACCEL * 660.0),
            r"the accelerometer is in another unit \(set accel_unit = \"g/6[56]\d\d\" in \[imu.columns\]",
        ),
        (
            imu(gyro_rad_s=GYRO @ FLU, accel_m_s2=ACCEL @ FLU),
            r"imu: gravity reads \+9\.\d along z and the gyroscope's y and z turn against the attitude: its axes "
            r"look like FLU, correlation -0\.9\d as taken, \+0\.9\d so \(set mount_rad = \[3.1416, 0, 0\] for ",
        ),
        (
            imu(NO_ATTITUDE, gyro_rad_s=GYRO @ FLU, accel_m_s2=ACCEL @ FLU),
            r"imu: gravity reads \+9\.\d along z instead of -9.8: axes look like FLU, not FRD \(set mount_rad = "
            r"\[3.1416, 0, 0\] for \[imu\] in flight.toml; if vision then turns the other way, only the "
            r"accelerometer's sign is reversed: instead set accel_sign = -1 in \[imu.columns\]",
        ),
        (
            imu(gyro_rad_s=GYRO @ PHONE, accel_m_s2=ACCEL @ PHONE),
            "the gyroscope turns against the attitude; they agree with x, y, z of the IMU taken as z, x, y",
        ),
        (
            imu(NO_ATTITUDE, gyro_rad_s=GYRO @ PHONE, accel_m_s2=ACCEL @ PHONE),
            r"gravity reads -9\.\d along y instead of -9.8 along z: the IMU's axes are not the body's",
        ),
        (
            attitude(CONJUGATED),
            r"attitude: its quaternions turn against the gyroscope and agree with it conjugated: they take the world "
            r"to the body.*\(set use = false for \[attitude\] in flight.toml",
        ),
        (
            attitude(ENU),
            r"attitude: its pitch and yaw turn against the gyroscope, whose gravity is right: it looks like FLU to a "
            r"world with z up, as in ROS.*\(set use = false for \[attitude\] in flight",
        ),
        (
            imu(gyro_rad_s=GYRO * [1.0, 1.0, 0.0]),
            r"the gyroscope's z axis is 0 rad/s in every row: it is stuck \(set use = false for \[imu\]",
        ),
        (
            imu(t_ns=SINCE_ZERO),
            r"imu: it runs from 0.0 to 15.0 s, the frames from 2020-09-13 12:43:20 to 12:43:34: they do not overlap, "
            r"the frames are in Unix time and it counts from zero \(add -1600001000.000 to \[camera\] cl",
        ),
        (
            imu(t_ns=T + 10**11),
            "imu: it runs from .*: they do not overlap .add 100.000 to .camera. clock_offset_s",
        ),
        (imu(t_ns=T // 1000), r"imu: 2e\+05 samples a second cannot be .*these look like microseconds"),
        (imu(t_ns=T // 10**6), "samples a second cannot be .*these look like milliseconds"),
        (
            imu(t_ns=T[0] + 1000 * SINCE_ZERO),
            "its samples are 5 s apart .*were nanoseconds multiplied by 1000",
        ),
    ],
)
def test_what_would_give_a_wrong_answer_is_refused(flight: Flight, match: str) -> None:
    with pytest.raises(InputError, match=match) as caught:
        check_flight(flight, TOML)
    assert caught.value.file == TOML
    assert "\n" not in str(caught.value)


HELD = np.where(((np.arange(len(T)) // 500) % 2 == 1)[:, None], GYRO[500], GYRO)


@pytest.mark.parametrize(
    ("flight", "match"),
    [
        (
            imu(accel_m_s2=-ACCEL),
            r"^imu: gravity reads \+9\.\d along z though the gyroscope turns as the attitude does: the accelerometer "
            r"gives gravity's pull, not the specific force \(set accel_sign = -1",
        ),
        (
            imu(accel_m_s2=ACCEL + np.array([0.0, 0.0, 9.80665])),
            r"^imu: the accelerometer shows no gravity, in the median 0\.\d+ m/s\^2: it was taken out",
        ),
        (
            imu(accel_m_s2=1.6 * ACCEL),
            r"gravity reads 15\.\d+ instead of 9.81 m/s\^2: the accelerometer's scale is",
        ),
        (imu(gyro_rad_s=2.0 * GYRO), r"the gyroscope turns 2\.\d+ times as fast as the attitude \(check"),
        (
            imu(gyro_rad_s=HELD),
            r"^imu: the gyroscope repeats one value for 7.5 s in all, longest 2.5 s from \d+: it hung there",
        ),
        (
            imu(t_ns=np.append(T[:-1], T[-1] + 10**15)),
            r"^imu: its clock leaps ahead once, first by 1000000 s after \d+ \(a damaged row, or a clock",
        ),
        (
            imu(t_ns=T + 7 * 10**9),
            r"^imu: it covers 53% of the frames: it runs from .* \(the rest is fused without it; where the clocks",
        ),
    ],
)
def test_what_is_likely_or_harmless_is_said(flight: Flight, match: str) -> None:
    checked = check_flight(flight, TOML)
    assert len(checked.problems) == len(flight.problems) + 1
    assert re.search(match, checked.problems[-1])


@pytest.mark.parametrize(
    ("flight", "stream", "match"),
    [
        (
            imu(gyro_rad_s=0.0 * GYRO),
            "imu",
            r"imu: the gyroscope is \(0, 0, 0\) in all of its 3001 rows: it was never",
        ),
        (
            attitude([0.0] * 4),
            "attitude",
            r"attitude: the quaternion is \(0, 0, 0, 0\) in all of its 751 rows",
        ),
        (
            replace(OFFICE, velocity=VectorStream(T, np.zeros((len(T), 3)))),
            "velocity",
            r"velocity: it is \(0, 0, 0\) in all of its 3001 rows: it was never measured, left out",
        ),
    ],
)
def test_a_stream_that_never_changes_is_left_out(flight: Flight, stream: str, match: str) -> None:
    checked = check_flight(flight, TOML)
    assert getattr(checked, stream) is None
    assert re.search(match, checked.problems[-1])


def test_an_accelerometer_of_zeros_becomes_unknown() -> None:
    checked = check_flight(imu(accel_m_s2=0.0 * ACCEL))
    assert checked.imu is not None
    assert np.isnan(checked.imu.accel_m_s2).all()
    np.testing.assert_array_equal(checked.imu.gyro_rad_s, GYRO)
    assert "the accelerometer is (0, 0, 0) in all of its 3001 rows" in checked.problems[-1]


def test_a_folder_is_advised_in_its_own_terms() -> None:
    folder = Advice(dict.fromkeys(("imu", "attitude"), Medium.FOLDER))
    with pytest.raises(
        InputError, match=r"\(correct body_frame in mav0/body.yaml, or T_BS in mav0/imu0/sensor.yaml"
    ):
        check_flight(imu(gyro_rad_s=GYRO @ FLU, accel_m_s2=ACCEL @ FLU), advice=folder)
    with pytest.raises(InputError, match=r"\(multiply its columns in mav0/imu0/data.csv by 0.0174533\)"):
        check_flight(imu(gyro_rad_s=np.degrees(GYRO)), advice=folder)
    with pytest.raises(InputError, match=r"take mav0/imu0 away to fuse without it"):
        check_flight(imu(t_ns=SINCE_ZERO), advice=folder)


def test_an_attitude_upside_down_or_on_its_side() -> None:
    turned = {
        angle: [np.cos(angle / 2), np.sin(angle / 2), 0.0, 0.0]
        for angle in (np.pi, radians(80), radians(50), 0.1)
    }
    found = {}
    for angle, q in turned.items():
        stream = AttitudeStream(np.arange(50) * 10**8, np.tile(q, (50, 1)))
        found[angle] = [(f.severity, f.text) for f in examine_attitude(stream, Advice())]
    assert found[0.1] == []
    [(severity, text)] = found[np.pi]
    assert severity is Severity.ERROR
    assert text.startswith(
        "the vehicle is upside down most of the time, by 180 degrees: its axes are not as taken"
    )
    for angle, severity in ((80, Severity.ERROR), (50, Severity.WARNING)):
        text = f"the vehicle lies on its side most of the time, by {angle} degrees"
        assert found[radians(angle)] == [(severity, text)]


@pytest.mark.parametrize(("roll", "pitch"), [(90, 0), (-90, 0), (180, 0), (0, 90), (0, -90), (65, 0)])
def test_gravity_tells_roll_and_pitch_of_a_sensor_that_sits_askew(roll: int, pitch: int) -> None:
    R_body_sensor = rotation((radians(roll), radians(pitch), 0.7))
    advice = Advice().mounting("imu", R_body_sensor.T @ [0.0, 0.0, -1.0])
    expected = rf"mount_rad = \[{radians(roll):.4g}, {radians(pitch):.4g}, 0\] for \[imu\]"
    if roll == 180:
        expected = expected.replace("3.142", "-?3.142")
    assert re.search(expected, advice)


def test_velocity_in_another_unit() -> None:
    speeds = np.tile([50.0, 0.0, 0.0], (50, 1)) * np.linspace(1.0, 3.0, 50)[:, None]
    flight = replace(OFFICE, velocity=VectorStream(OFFICE.frames.t_ns[0] + np.arange(50) * 3 * 10**8, speeds))
    with pytest.raises(
        InputError, match=r"velocity: one sample in ten is faster than 14\d m/s: it is in another unit"
    ):
        check_flight(flight)


# --- silence ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "flight", [OFFICE, NO_ATTITUDE, replace(OFFICE, imu=None)], ids=["all", "imu", "attitude"]
)
def test_the_sample_flight_is_plausible(flight: Flight) -> None:
    assert examine_flight(flight, Advice()) == []


def test_the_real_flight_is_plausible() -> None:
    hallway = HALLWAY
    if not hallway.exists():
        pytest.skip("the shared flights are not here")
    assert examine_flight(load_flight(hallway), Advice()) == []


def simulated(seed: int) -> tuple[ImuStream, AttitudeStream]:
    """Sensors along a flight of random length, motion, rates and noise."""
    rng = np.random.default_rng(seed)
    motion = MotionConfig(
        duration_s=rng.uniform(8, 25), heading_rate_rad_s=rng.uniform(0.1, 1.5), tilt_rad=rng.uniform(0, 0.15)
    )
    trajectory = plan_flight(motion, *floor_plan(SceneConfig(length_m=150)), seed)
    imu_config = ImuConfig(
        rate_hz=float(rng.choice([50, 100, 200, 1000])),
        gyro_noise_density=10 ** rng.uniform(-4, -2),
        gyro_bias_std_rad_s=rng.uniform(0, 0.05),
        accel_noise_density=10 ** rng.uniform(-3, -0.7),
    )
    samples = read_imu(
        trajectory.truth(sample_times(trajectory.duration_s, imu_config.rate_hz)), imu_config, seed
    )
    attitude_config = AttitudeConfig(
        rate_hz=float(rng.choice([5, 10, 50, 200])),
        disturbance_s=float(rng.choice([0, 8])),
        yaw_follows_gyro=bool(rng.integers(2)),
    )
    tilt = read_attitude(trajectory, attitude_config, samples, seed)
    return (
        ImuStream((samples.t_s * 1e9).astype(np.int64), samples.gyro_rad_s, samples.accel_m_s2),
        AttitudeStream((tilt.t_s * 1e9).astype(np.int64), tilt.q_world_body),
    )


@pytest.mark.parametrize("seed", range(6))
def test_simulated_flights_are_plausible_and_their_faults_are_told_apart(seed: int) -> None:
    good, turned = simulated(seed)

    def kinds(imu: ImuStream, attitude: AttitudeStream | None) -> set[str]:
        return {finding.kind for finding in examine_imu(imu, attitude, Advice())}

    assert kinds(good, turned) == kinds(good, None) == set()
    assert not list(examine_attitude(turned, Advice()))
    degrees = replace(good, gyro_rad_s=np.degrees(good.gyro_rad_s))
    assert kinds(degrees, turned) == kinds(degrees, None) == {"gyro_unit"}
    flu = replace(good, gyro_rad_s=good.gyro_rad_s @ FLU, accel_m_s2=good.accel_m_s2 @ FLU)
    assert kinds(flu, turned) == kinds(flu, None) == {"imu_axes"}
    for signs, kind in ((CONJUGATED, "attitude_conjugated"), (ENU, "attitude_axes")):
        wrong = replace(turned, q_world_body=turned.q_world_body * np.array(signs))
        assert kinds(good, wrong) == {kind}


PX4 = SHARED / "logs" / "px4" / "sample.ulg"


def test_a_real_vehicle_and_its_faults() -> None:
    pytest.importorskip("pyulog")
    if not PX4.exists():
        pytest.skip("the shared logs are not here")
    from fusion.logs import open_log

    log = open_log(PX4)
    good, turned = log.imu("sensor_combined").value, log.attitude("vehicle_attitude").value
    comparison = compare_turns(good, turned)
    assert comparison is not None
    assert comparison.others == ()
    assert comparison.as_taken.correlation > 0.99
    assert comparison.as_taken.scale == pytest.approx(1.0, abs=0.02)
    assert not list(examine_imu(good, turned, Advice()))
    flu = replace(good, gyro_rad_s=good.gyro_rad_s @ FLU, accel_m_s2=good.accel_m_s2 @ FLU)
    assert [finding.kind for finding in examine_imu(flu, turned, Advice())] == ["imu_axes"]
    conjugated = replace(turned, q_world_body=turned.q_world_body * np.array(CONJUGATED))
    assert [f.kind for f in examine_imu(good, conjugated, Advice())] == ["attitude_conjugated"]
    degrees = replace(good, gyro_rad_s=np.degrees(good.gyro_rad_s))
    assert [finding.kind for finding in examine_imu(degrees, turned, Advice())] == ["gyro_unit"]


def test_streams_too_short_to_judge_are_not_judged() -> None:
    short = ImuStream(T[:10], 1000.0 + GYRO[:10], ACCEL[:10] * 100.0)
    assert list(examine_imu(short, None, Advice())) == []
    assert OFFICE.imu is not None
    nothing = replace(OFFICE.imu, accel_m_s2=np.full_like(ACCEL, np.nan))
    assert list(examine_imu(nothing, OFFICE.attitude, Advice())) == []


# --- the parts ----------------------------------------------------------------------------------------------------


@given(
    vector=st.tuples(*[st.floats(-1.7, 1.7)] * 3),
    first=st.tuples(*[st.floats(-1.0, 1.0)] * 4).filter(lambda q: np.linalg.norm(q) > 0.1),
    flipped=st.booleans(),
)
def test_the_turn_between_two_attitudes_is_what_was_turned(
    vector: tuple[float, ...], first: tuple[float, ...], flipped: bool
) -> None:
    from scipy.spatial.transform import Rotation

    start = Rotation.from_quat(np.roll(first, -1))
    end = start * Rotation.from_rotvec(vector)
    q = [np.roll(rotation.as_quat(), 1)[None] for rotation in (start, end)]
    np.testing.assert_allclose(turn_between(q[0], -q[1] if flipped else q[1])[0], vector, atol=1e-7)


@settings(max_examples=50)
@given(
    start_ns=st.integers(0, 2 * 10**18),
    step_ns=st.integers(10**6, 10**8),
    count=st.integers(3, 200),
    shift=st.floats(-3.0, 3.0),
)
def test_overlap_is_said_where_frames_are_not_covered(
    start_ns: int, step_ns: int, count: int, shift: float
) -> None:
    frames = start_ns + step_ns * np.arange(count)
    other = frames + round(shift * step_ns * count)
    found = list(examine_clocks({"camera": frames, "imu": other}, Advice()))
    covered = np.mean((frames >= other[0]) & (frames <= other[-1]))
    if covered >= 0.9:
        assert found == []
    else:
        [finding] = found
        disjoint = other[0] > frames[-1] or other[-1] < frames[0]
        assert finding.severity is (Severity.ERROR if disjoint else Severity.WARNING)
        assert disjoint == ("do not overlap" in finding.text)


@pytest.mark.parametrize(
    ("shift", "order"), [(1, "w, x, y, z, read as x, y, z, w"), (-1, "x, y, z, w, read as w, x, y, z")]
)
@pytest.mark.parametrize("turned", [False, True], ids=["frd", "turned from flu by its reader"])
def test_quaternions_in_the_wrong_order_are_named_as_that(shift: int, order: str, turned: bool) -> None:
    assert OFFICE.attitude is not None
    flip = np.array(ENU) if turned else np.ones(4)
    in_file = OFFICE.attitude.q_world_body * flip
    wrong = replace(OFFICE.attitude, q_world_body=np.roll(in_file, shift, axis=1) * flip)
    with pytest.raises(InputError, match=f"written in the order {order}") as caught:
        check_flight(replace(OFFICE, attitude=wrong), TOML)
    assert "set use = false for [attitude]" in (caught.value.remedy or "")
    assert check_flight(replace(OFFICE, attitude=None), TOML).attitude is None
