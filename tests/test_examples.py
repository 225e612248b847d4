"""The control loop flies: a short closed loop through rendered pictures, and its parts one by one."""

from __future__ import annotations

import re
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from math import atan2, cos, hypot, isnan, nan, pi, radians
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import control_loop
import numpy as np
import pytest
from control_loop import TRANSFER_S, VISION_S, Clock, fly
from flight_record import BODY_RADIUS_M, Flight, Row, judge, table
from pilot import HOVER, Gains, Pilot
from scipy.spatial.transform import Rotation
from simulated_vehicle import Body, Vehicle, World, flown, junction_config

from fusion import Estimate
from fusion.live.vision_thread import VisionThread
from fusion.simulate import SimulationConfig
from fusion.simulate.motion import GRAVITY_M_S2
from vision import Camera

EXAMPLES = Path(__file__).resolve().parent.parent / "examples"

RATE_HZ = 100.0
SMALL: dict[str, Any] = {"size_px": (160, 120), "frame_hz": 15.0}
CAMERA = Camera.from_fov(64, 48, radians(70))
GAINS = Gains()


@pytest.fixture(autouse=True, scope="module")
def _switch_interval() -> Iterator[None]:
    """Flying makes the interpreter switch threads more often."""
    before = sys.getswitchinterval()
    yield
    sys.setswitchinterval(before)


@pytest.fixture(scope="module")
def round_the_corner() -> Flight:
    """Down a corridor, left into another, and along it, through rendered pictures, steered by the estimate alone."""
    return fly(junction_config(start_m=7.5, **SMALL), 19.0, RATE_HZ, wall_clock=False)


@pytest.fixture(scope="module")
def in_the_dark() -> Flight:
    """The camera sees nothing from 3 to 6 s."""
    return fly(junction_config(start_m=2.0, **SMALL), 8.0, RATE_HZ, wall_clock=False, blackout_s=(3.0, 6.0))


# The closed loop


def test_it_stays_between_the_walls(round_the_corner: Flight) -> None:
    outcome = judge(round_the_corner)
    assert outcome.clearance_m > BODY_RADIUS_M
    assert outcome.offset_rms_m < 0.15
    assert outcome.problems == ()


def test_it_knows_where_it_heads(round_the_corner: Flight) -> None:
    outcome = judge(round_the_corner)
    assert outcome.heading_rms_rad < radians(0.8)
    assert outcome.heading_max_rad < radians(2.5)
    assert outcome.offset_error_rms_m < 0.10


def test_the_second_corridor_is_known_as_such(round_the_corner: Flight) -> None:
    rows, turned_s = round_the_corner.rows, round_the_corner.turned_s
    assert turned_s is not None
    assert judge(round_the_corner).corridors == (0, 1)
    taken_s = next(r.t_s for r in rows if r.corridor == 1)
    assert 0.5 < taken_s - turned_s < 5.0
    assert all(r.is_turning for r in rows if turned_s + 0.05 < r.t_s < taken_s)
    assert not any(r.is_turning for r in rows if r.t_s > taken_s + 1.0)
    assert rows[-1].room == 1
    assert judge(round_the_corner).settled_s < 8.0


def test_frames_are_measured_off_the_control_thread(round_the_corner: Flight) -> None:
    flight = round_the_corner
    assert flight.control_thread == threading.get_ident()
    assert len(flight.vision_threads) == 1
    assert flight.control_thread not in flight.vision_threads
    assert len(flight.frame_ages_s) >= flight.pictures - 1  # the last may be on the way
    assert flight.dropped == 0
    assert flight.used > 0.7 * flight.pictures


def test_frames_come_late_and_count_from_when_they_were_taken(round_the_corner: Flight) -> None:
    ages, delay_s = np.array(round_the_corner.frame_ages_s), TRANSFER_S + VISION_S
    assert (ages > delay_s - 1e-6).all()
    assert (ages < delay_s + 1 / RATE_HZ + 1e-6).all()


def test_the_loop_takes_every_sample(round_the_corner: Flight) -> None:
    calls = {name: len(times) for name, times in round_the_corner.watch.wall_ns.items()}
    n = len(round_the_corner.rows)
    assert calls["add_imu"] == calls["control period"] == n
    assert calls["estimate"] == n + 1  # one when the pilot is made
    assert calls["add_lines"] == len(round_the_corner.frame_ages_s)
    assert calls["add_attitude"] == pytest.approx(n * 50 / RATE_HZ, abs=1)
    assert calls["add_velocity"] == pytest.approx(n * 25 / RATE_HZ, abs=1)


def test_it_slows_down_while_the_camera_sees_nothing(in_the_dark: Flight) -> None:
    rows = in_the_dark.rows
    assert {r.status for r in rows if 2.0 < r.t_s < 3.0} == {"tracking"}
    dark = [r for r in rows if 3.4 < r.t_s < 6.0]
    assert {r.status for r in dark} == {"coasting"}
    assert max(r.speed_m_s for r in dark) <= GAINS.coasting_share * GAINS.cruise_m_s
    assert min(r.speed_m_s for r in rows if 2.0 < r.t_s < 3.0) > 0.8 * GAINS.cruise_m_s
    assert {r.status for r in rows if r.t_s > 7.0} == {"tracking"}
    assert max(r.speed_m_s for r in rows if r.t_s > 7.0) > 0.8 * GAINS.cruise_m_s
    assert judge(in_the_dark).problems == ()


def test_without_the_wall_clock_every_flight_is_the_same(in_the_dark: Flight) -> None:
    again = fly(junction_config(start_m=2.0, **SMALL), 1.5, RATE_HZ, wall_clock=False, blackout_s=(3.0, 6.0))
    assert repr(again.rows) == repr(in_the_dark.rows[: len(again.rows)])


def test_it_runs_by_the_wall_clock(capsys: pytest.CaptureFixture[str]) -> None:
    code = control_loop.main(["--seconds", "0.6", "--rate", "100", "--frames", "10"])
    lines = capsys.readouterr().out.splitlines()
    assert code in (0, 1)
    assert [line.split()[0] for line in lines] == [
        *("microseconds", "add_imu", "add_attitude", "add_velocity", "add_lines", "estimate", "control"),
        *("frames", "age", "control", "status", "estimate", "tracking", "corridors", "flown", "verdict"),
    ]
    assert "beside the control thread" in "\n".join(lines)
    assert "control    60 periods of 10 ms" in "\n".join(lines)


@pytest.mark.parametrize(
    ("option", "value", "said"),
    [("--turn", "10", "angle_rad"), ("--rate", "0", "--rate"), ("--seconds", "nan", "--seconds")],
)
def test_what_cannot_be_flown_is_refused(
    option: str, value: str, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as end:
        control_loop.main([option, value])
    assert end.value.code == 2
    assert said in capsys.readouterr().err.splitlines()[-1]


def test_it_runs_from_anywhere(tmp_path: Path) -> None:
    command = [sys.executable, str(EXAMPLES / "control_loop.py"), "--help"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "--no-wall-clock" in done.stdout


# The vision thread


def test_the_vision_thread_never_keeps_its_caller_waiting() -> None:
    """While a picture is measured, later ones are taken all the same; only the newest of them is measured then."""
    begun, go_on = threading.Event(), threading.Event()
    measured: list[int] = []

    def extract(image: Any, camera: Camera) -> Any:
        begun.set()
        assert go_on.wait(30)
        measured.append(int(image[0, 0]))
        return f"lines of {image[0, 0]}"

    vision = VisionThread(CAMERA, extract)
    vision.offer(0, np.full((2, 2), 0, np.uint8))
    assert begun.wait(30)
    for k in range(1, 5):
        vision.offer(k, np.full((2, 2), k, np.uint8))
    assert list(vision.finished()) == []  # and asking does not wait either
    go_on.set()
    vision.wait()
    answers: list[tuple[int, object]] = [(m.t_ns, m.lines) for m in vision.finished()]
    assert answers == [(0, "lines of 0"), (4, "lines of 4")]
    assert measured == [0, 4]
    assert vision.dropped == 3
    vision.close()


def test_a_picture_of_no_use_is_told_as_such() -> None:
    vision = VisionThread(CAMERA)
    vision.offer(5, np.zeros((10, 10), np.uint8))  # another size than the camera's
    vision.wait()
    vision.offer(6, np.zeros((48, 64), np.uint8))
    vision.wait()
    found = {m.t_ns: m for m in vision.finished()}
    assert (found[5].lines, found[5].cause) == (None, "picture is 10x10, the camera's 64x48")
    assert found[6].lines is not None
    vision.close()


def test_a_mistake_in_one_picture_is_logged_and_does_not_end_vision(caplog: pytest.LogCaptureFixture) -> None:
    def extract(image: Any, camera: Camera) -> Any:
        return 1 / int(image[0, 0])

    vision = VisionThread(CAMERA, extract)
    for k in range(2):
        vision.offer(k, np.full((2, 2), k, np.uint8))
        vision.wait()
    answers: list[tuple[int, object]] = [(m.t_ns, m.lines) for m in vision.finished()]
    assert answers == [(0, None), (1, 1.0)]
    assert "picture of 0 ns" in caplog.text
    vision.close()


def test_closing_ends_the_thread() -> None:
    before = threading.active_count()
    vision = VisionThread(CAMERA)
    assert threading.active_count() == before + 1
    vision.close()
    assert threading.active_count() == before


# The pilot, given estimates


class Told:
    """An estimator that says what it is told to."""

    def __init__(self) -> None:
        self.now = Estimate(0)
        self.given: list[tuple[str, int]] = []

    def estimate(self, now_ns: int | None = None) -> Estimate:
        return self.now

    def add_lines(self, t_ns: int, lines: Any) -> None:
        self.given.append(("lines", t_ns))

    def add_unreadable_frame(self, t_ns: int, cause: str) -> None:
        self.given.append((f"unreadable: {cause}", t_ns))


def pilot_and_estimator(**known: Any) -> tuple[Pilot, Told]:
    told = Told()
    values: dict[str, Any] = {
        "status": "tracking",
        "heading_rad": 0.0,
        "heading_std_rad": radians(0.3),
        "lateral_offset_m": 0.0,
        "lateral_offset_std_m": 0.03,
    }
    told.now = replace(Estimate(1), **(values | known))
    vision: Any = SimpleNamespace(finished=lambda: iter([]), offer=None)
    return Pilot(told, vision), told  # type: ignore[arg-type]


@pytest.mark.parametrize("status", ["initialising", "lost"])
def test_it_hovers_while_it_does_not_know_its_heading(status: str) -> None:
    pilot, _ = pilot_and_estimator(status=status, heading_rad=nan, heading_std_rad=nan)
    assert pilot.control(1) == HOVER


@pytest.mark.parametrize("side", [-1, 1])
def test_it_steers_back_to_the_centre_line(side: int) -> None:
    pilot, _ = pilot_and_estimator(lateral_offset_m=side * 0.3)
    assert side * pilot.control(1).yaw_rate_rad_s < 0
    pilot, _ = pilot_and_estimator(heading_rad=side * 0.1)
    assert side * pilot.control(1).yaw_rate_rad_s < 0
    approach = atan2(0.3, GAINS.look_ahead_m)  # heading at the centre line already
    pilot, _ = pilot_and_estimator(lateral_offset_m=side * 0.3, heading_rad=-side * approach)
    assert pilot.control(1).yaw_rate_rad_s == pytest.approx(0)


def test_commands_have_limits() -> None:
    pilot, _ = pilot_and_estimator(lateral_offset_m=50.0, heading_rad=1.5)
    assert pilot.control(1).yaw_rate_rad_s == -GAINS.max_yaw_rate_rad_s


def test_the_less_it_knows_the_slower_it_flies() -> None:
    sure = pilot_and_estimator()[0].control(1)
    assert sure.speed_m_s == GAINS.cruise_m_s
    unplaced = pilot_and_estimator(lateral_offset_m=nan, lateral_offset_std_m=nan, heading_rad=0.1)[
        0
    ].control(1)
    assert 0 < unplaced.speed_m_s < sure.speed_m_s
    assert not isnan(unplaced.yaw_rate_rad_s)
    unsure = pilot_and_estimator(heading_std_rad=radians(5))[0].control(1)
    assert 0 < unsure.speed_m_s < sure.speed_m_s
    coasting = pilot_and_estimator(status="coasting")[0].control(1)
    assert coasting.speed_m_s == GAINS.coasting_share * GAINS.cruise_m_s
    assert pilot_and_estimator(heading_std_rad=radians(20))[0].control(1).speed_m_s == 0


def test_a_turn_lasts_until_the_corridor_that_is_meant_is_held() -> None:
    pilot, told = pilot_and_estimator(lateral_offset_m=0.3)
    pilot.control(1)
    pilot.turn(-pi / 2)
    assert pilot.control(2).yaw_rate_rad_s == -GAINS.turn_rate_rad_s
    # Frames are of no use in a turn: on by the gyroscope.
    told.now = replace(told.now, status="coasting", heading_rad=-1.5)
    command = pilot.control(3)
    assert command.speed_m_s == GAINS.turn_m_s
    assert command.yaw_rate_rad_s == pytest.approx(-GAINS.heading_per_s * (pi / 2 - 1.5))
    # Something else passes for a corridor: not that.
    told.now = replace(
        told.now, status="tracking", corridor_index=1, corridor_turn_rad=-0.8, heading_rad=-0.7, reset_count=1
    )
    assert pilot.control(4).yaw_rate_rad_s == pytest.approx(command.yaw_rate_rad_s)
    assert pilot.is_turning
    told.now = replace(told.now, corridor_index=2, corridor_turn_rad=-1.55, heading_rad=0.05, reset_count=2)
    assert pilot.control(5).yaw_rate_rad_s < 0  # right of the new centre line, and turned right
    assert not pilot.is_turning


def test_the_pilot_hands_frames_on_with_their_own_time() -> None:
    pilot, told = pilot_and_estimator()
    pilot.vision.finished = lambda: iter([(7, SimpleNamespace(), None, ""), (9, None, None, "dark")])  # type: ignore[method-assign,list-item]
    pilot.control(100)
    assert told.given == [("lines", 7), ("unreadable: dark", 9)]


# The clock


def test_the_vehicles_clock_stands_still_while_the_world_is_computed(monkeypatch: pytest.MonkeyPatch) -> None:
    wall = SimpleNamespace(ns=5_000)

    def sleep(seconds: float) -> None:
        wall.ns += round(seconds * 1e9)

    monkeypatch.setattr(time, "perf_counter_ns", lambda: wall.ns)
    monkeypatch.setattr(time, "sleep", sleep)
    clock = Clock(follows_wall=True)
    start = clock.now_ns()
    wall.ns += 100
    assert clock.now_ns() == start + 100
    with clock.stopped():
        wall.ns += 1_000_000
    assert clock.now_ns() == start + 100
    clock.wait_until(start + 2_000)
    assert clock.now_ns() == start + 2_000
    clock.wait_until(start)  # past: at once
    assert clock.now_ns() == start + 2_000
    free = Clock(follows_wall=False)
    free.wait_until(10**12)
    assert free.now_ns() == 10**12


# The vehicle


def quiet() -> SimulationConfig:
    """Return the configuration with perfect sensors."""
    config = junction_config(**SMALL)
    none = {"gyro_noise_density": 0.0, "gyro_bias_std_rad_s": 0.0, "gyro_random_walk": 0.0}
    assert config.imu is not None
    none |= {"accel_noise_density": 0.0, "accel_bias_std_m_s2": 0.0, "accel_random_walk": 0.0}
    return config.model_copy(update={"imu": config.imu.model_copy(update=none)})


def test_the_imu_says_how_the_vehicle_moves() -> None:
    """Dead reckoning with a perfect IMU ends where the vehicle is: its readings go with its motion."""
    vehicle, dt = Vehicle(quiet()), 0.0025
    R, v, p = vehicle.body.rotation(), np.zeros(3), np.array([vehicle.body.x, vehicle.body.y])
    for k in range(1600):
        rates_before = vehicle.body.rates()
        vehicle.fly(dt, 0.8 * cos(k * dt), 1.0)
        gyro, accel = vehicle.read_imu(dt)
        R = R @ Rotation.from_rotvec(0.5 * (rates_before + gyro) * dt).as_matrix()
        v = v + dt * (R @ accel + [0.0, 0.0, GRAVITY_M_S2])
        p = p + dt * v[:2]
    body = vehicle.body
    turned = Rotation.from_matrix(R.T @ body.rotation()).magnitude()
    assert turned < radians(0.3)
    assert v == pytest.approx([body.vx, body.vy, 0.0], abs=0.03)
    assert p == pytest.approx([body.x, body.y], abs=0.06)
    assert hypot(body.x - 3.0, body.y) > 1.0  # it did go somewhere


def test_the_vehicle_does_as_it_is_told() -> None:
    body = Body(0.0, 0.0, 0.0, 1.4, 0.0)
    tilts = []
    for _ in range(2000):
        body = flown(body, 0.0025, 0.0, 1.0, (0.0, 0.0))
        tilts.append(body.pitch)
    assert (body.vx, body.vy) == pytest.approx((1.0, 0.0), abs=0.01)
    assert min(tilts) < -radians(5)  # nose down to speed up
    for _ in range(800):
        body = flown(body, 0.0025, 0.5, 1.0, (0.0, 0.0))
        tilts.append(body.roll)
    assert body.yaw_rate == pytest.approx(0.5, abs=0.001)
    assert max(tilts[2000:]) > radians(1)  # right, to turn right
    course = atan2(body.vy, body.vx)
    assert 0.0 < body.yaw - course < 0.4  # the course follows the nose


def test_clearance_is_the_distance_to_the_walls() -> None:
    vehicle = Vehicle(junction_config(**SMALL))
    side = vehicle.meetings[0]
    for x, y, expected in (
        (5.0, 0.3, 0.8),
        (5.0, -1.0, 0.1),
        (5.0, -1.3, -0.2),
        (side.parent_s_m, -1.5, 1.1),
    ):
        vehicle.body = replace(vehicle.body, x=x, y=y)
        assert vehicle.clearance_m() == pytest.approx(expected)
    assert vehicle.to_junction_m() == pytest.approx(0.0)
    assert vehicle.in_room(1)[1] == pytest.approx(0.0)


def test_sensors_speak_at_their_own_rates() -> None:
    world = World(junction_config(size_px=(160, 120), frame_hz=20.0), 0, 10_000_000, 0.025)
    taken = [world.advance(0.0, 0.0) for _ in range(100)]
    assert sum(s.attitude is not None for s in taken) == 50
    assert sum(s.flow is not None for s in taken) == 25
    assert world.n_pictures == 20
    delivered = [(k, t_ns) for k, s in enumerate(taken, 1) for t_ns, _ in s.pictures]
    assert {k * 10_000_000 - t_ns for k, t_ns in delivered} == {30_000_000}  # the first period after 25 ms


# The verdict


def row(t_s: float, **changes: Any) -> Row:
    values: dict[str, Any] = {
        "status": "tracking",
        "corridor": 0,
        "is_turning": False,
        "room": 0,
        "heading_rad": 0.0,
        "offset_m": 0.0,
        "clearance_m": 1.0,
        "heading_error_rad": 0.01,
        "offset_error_m": 0.02,
        "speed_m_s": 1.0,
    }
    return Row(t_s, **(values | changes))


def flight_of(rows: list[Row], **changes: Any) -> Flight:
    return replace(Flight(60.0, 10.0, rows=rows, pictures=1, vision_threads={1}), **changes)


STRAIGHT = [row(0.1 * k) for k in range(100)]
ROUND = [
    *STRAIGHT,
    *(row(10 + 0.1 * k, corridor=1, room=1, offset_m=0.5 if k < 30 else 0.1) for k in range(150)),
]


def test_a_good_flight_is_called_good() -> None:
    straight, turned = judge(flight_of(STRAIGHT)), judge(flight_of(ROUND, turned_s=9.95))
    assert straight.problems == turned.problems == ()
    assert isnan(straight.settled_s)
    assert turned.settled_s == pytest.approx(3.05)
    assert turned.corridors == (0, 1)
    assert turned.heading_rms_rad == pytest.approx(0.01)
    assert 0.0 < turned.offset_rms_m < 0.1


@pytest.mark.parametrize(
    ("rows", "turned_s", "complaint"),
    [
        ([*STRAIGHT, row(10.0, clearance_m=0.2)], None, "touched a wall"),
        ([*STRAIGHT, row(10.0, heading_error_rad=-0.2)], None, "11.5 degrees off"),
        ([*STRAIGHT, row(10.0, corridor=1), row(10.1)], None, r"corridor_index went \[0, 1, 0\]"),
        ([row(0.1, status="initialising", heading_error_rad=nan)], None, "never knew"),
        ([r._replace(corridor=0) for r in ROUND], 9.95, r"corridor_index went \[0\]"),
        ([r._replace(offset_m=0.4) for r in ROUND], 9.95, "did not settle"),
    ],
)
def test_a_bad_flight_is_called_what_it_was(rows: list[Row], turned_s: float | None, complaint: str) -> None:
    flight = flight_of(rows, turned_s=turned_s)
    problems = judge(flight).problems
    assert any(re.search(complaint, problem) for problem in problems)
    assert list(table(flight))[-1].endswith("; ".join(problems))


def test_measuring_in_the_control_thread_would_be_told() -> None:
    assert any("in the control thread" in line for line in table(flight_of(STRAIGHT, control_thread=1)))
    assert any("beside the control thread" in line for line in table(flight_of(STRAIGHT, control_thread=2)))


def test_the_example_of_the_actuators_time_runs() -> None:
    ran = subprocess.run(
        [sys.executable, str(EXAMPLES / "actuator_time.py")], capture_output=True, text=True, check=True
    )
    lines = ran.stdout.splitlines()
    assert float(re.findall(r"[\d.]+ degrees", lines[0])[0].split()[0]) < 0.5
    assert lines[1] == "offset 0.20 half widths, 0.30 m in the wider corridor"
    assert "after 1 step the setpoint is 0.40 rad; faults <Fault.NONE: 0>" in lines
    assert lines[-1] == "after a reset: initialising, 2 steps, <Fault.NOT_STARTED: 256>"


def test_an_example_without_the_library_of_its_link_names_the_extra() -> None:
    code = (
        "import sys, runpy; sys.modules['pymavlink'] = None; runpy.run_path(sys.argv[1], run_name='__main__')"
    )
    ran = subprocess.run(
        [sys.executable, "-c", code, "live_loopback.py"], capture_output=True, text=True, cwd=EXAMPLES
    )
    assert ran.returncode == 2
    assert ran.stderr == "error: pymavlink is not installed (pip install 'corridor-fusion[live]')\n"
