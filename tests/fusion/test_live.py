"""`corridor live`: its core without clock or socket, its clocks, and what it sends."""

from __future__ import annotations

from collections.abc import Iterator
from math import atan2, inf, isnan, nan, pi, radians
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fusion import Estimate, FusionConfig
from fusion.estimator.notices import Status
from fusion.live.clock import AutopilotClock, CameraClock, LeastLatency, SyncState
from fusion.live.core import LiveCore
from fusion.live.packets import PacketWriter, quality_of
from fusion.live.pose import PoseTracker
from fusion.live.samples import ARDUPILOT, attitude_of, imu_of, range_of
from fusion.live.settings import LiveSettings
from vision import Camera

mavlink = pytest.importorskip("pymavlink.dialects.v20.ardupilotmega")

CAMERA = Camera.from_fov(64, 48, radians(70))
START_NS = 1_700_000_000_000_000_000
BOOT_NS = 40_000_000_000  # the autopilot's time at the start
PX4 = 12
MS = 1_000_000


class Vehicle:
    """An autopilot's packets, and what comes back, as messages."""

    def __init__(self, core: LiveCore, kind: int = PX4, system: int = 1) -> None:
        self.core, self.kind = core, kind
        self.boot_ns = BOOT_NS - START_NS
        self.now_ns = START_NS
        self._send: Any = mavlink.MAVLink(None, srcSystem=system, srcComponent=1)
        self._read: Any = mavlink.MAVLink(None)

    def say(self, message: Any, after_ns: int = MS) -> list[Any]:
        """Send, to be received ``after_ns`` later."""
        self.now_ns += after_ns
        return self.read(self.core.on_bytes(self.now_ns, bytes(message.pack(self._send))))

    def read(self, packets: list[bytes]) -> list[Any]:
        return [m for p in packets for m in self._read.parse_buffer(p) or ()]

    def heartbeat(self) -> list[Any]:
        return self.say(self._send.heartbeat_encode(2, self.kind, 0, 0, 4))

    def stamp_ns(self) -> int:
        return self.now_ns + self.boot_ns

    def imu(self, rate_rad_s: float = 0.0) -> list[Any]:
        values = (0.0, 0.0, -9.81, 0.0, 0.0, rate_rad_s)
        return self.say(
            self._send.highres_imu_encode(self.stamp_ns() // 1000, *values, 0, 0, 0, 0, 0, 0, 0, 0x3F)
        )

    def tick(self, after_ns: int = 20 * MS) -> list[Any]:
        """Tick, and answer what asks for the time."""
        self.now_ns += after_ns
        heard = self.read(self.core.on_tick(self.now_ns))
        for m in heard:
            if m.get_type() == "TIMESYNC" and m.tc1 == 0:
                self.say(self._send.timesync_encode(self.stamp_ns() + MS, m.ts1), 2 * MS)
        return heard


def _core(**values: Any) -> LiveCore:
    return LiveCore(FusionConfig(corridor_width_m=2.2), CAMERA, LiveSettings(**values))


def _kinds(messages: list[Any]) -> list[str]:
    return [m.get_type() for m in messages]


@pytest.fixture
def vehicle() -> Vehicle:
    """An autopilot that is heard, and whose clock is known."""
    vehicle = Vehicle(_core())
    vehicle.heartbeat()
    for _ in range(60):
        vehicle.tick()
    return vehicle


# The autopilot's clock


def test_of_the_replies_the_one_with_the_shortest_way_counts() -> None:
    clock, offset_ns = AutopilotClock(), 5_000_000_000
    for there_ms, back_ms in ((1, 30), (2, 2), (40, 1), (1, 9)):
        asked_ns = START_NS
        autopilot_ns = asked_ns + there_ms * MS - offset_ns
        assert clock.replied(asked_ns, autopilot_ns, asked_ns + (there_ms + back_ms) * MS)
    assert clock.state is SyncState.SYNCHRONISED
    assert clock.round_trip_ns == 4 * MS
    assert clock.host_ns(START_NS - offset_ns, START_NS + MS) == START_NS


def test_an_autopilot_that_does_not_answer_is_known_by_its_least_latency() -> None:
    clock = AutopilotClock()
    found = [clock.host_ns(k * 10 * MS, START_NS + k * 10 * MS + (3 + k % 5) * MS) for k in range(400)]
    assert found[0] is None  # it may answer yet
    assert clock.state is SyncState.ONE_WAY
    assert found[-1] == START_NS + 399 * 10 * MS + 3 * MS


def test_another_boot_is_noticed_by_the_samples_and_by_the_replies() -> None:
    by_samples, by_replies = AutopilotClock(), AutopilotClock()
    for clock in (by_samples, by_replies):
        for k in range(5):
            clock.replied(START_NS + k, BOOT_NS, START_NS + k + MS)
    for k in range(12):
        by_samples.host_ns(k * MS, START_NS + 10**9 + k * MS)
    by_replies.replied(START_NS + 10**9, 1, START_NS + 10**9 + MS)
    assert by_samples.restarts == by_replies.restarts == 1


def test_what_is_no_reply_of_ours_is_refused() -> None:
    clock = AutopilotClock()
    assert not clock.replied(START_NS, BOOT_NS, START_NS - 1)  # asked later than answered
    assert not clock.replied(5, BOOT_NS, START_NS)  # somebody else's
    assert not clock.replied(START_NS, -3, START_NS + MS)


@given(st.lists(st.integers(0, 50 * MS), min_size=1, max_size=60))
def test_the_least_latency_is_that_of_the_quickest(latencies_ns: list[int]) -> None:
    clock = LeastLatency()
    for k, latency_ns in enumerate(latencies_ns):
        offset_ns = clock.offset_ns(k * MS, 10**12 + k * MS + latency_ns)
        assert offset_ns == 10**12 + min(latencies_ns[: k + 1])


def test_a_cameras_stamps_are_since_1970_or_monotonic_or_its_own() -> None:
    clock = CameraClock(START_NS)
    assert clock.host_ns(START_NS + 90 * MS, START_NS + 100 * MS) == START_NS + 90 * MS
    assert clock.host_ns(190 * MS, START_NS + 200 * MS) == START_NS + 190 * MS
    assert clock.host_ns(None, START_NS + 300 * MS) == START_NS + 300 * MS
    stream = CameraClock(START_NS)
    assert stream.host_ns(7 * 10**15, START_NS + 100 * MS) == START_NS + 100 * MS
    assert stream.host_ns(7 * 10**15 + 33 * MS, START_NS + 150 * MS) == START_NS + 133 * MS


# Messages in


def test_units_are_those_of_the_definitions() -> None:
    scaled = imu_of(mavlink.MAVLink_scaled_imu_message(1500, 0, 0, -1000, 0, 0, 500, 0, 0, 0), PX4)
    assert scaled is not None
    assert scaled.stamp_ns == 1_500 * MS
    assert scaled.gyro_rad_s == (0.0, 0.0, 0.5)
    assert scaled.accel_m_s2 == pytest.approx((0, 0, -9.80665))
    raw = mavlink.MAVLink_raw_imu_message(1_500_000, 0, 0, -1000, 0, 0, 500, 0, 0, 0)
    assert imu_of(raw, ARDUPILOT) == scaled
    assert imu_of(raw, PX4) is None  # a sensor's own counts
    stale = mavlink.MAVLink_highres_imu_message(1, 0, 0, -9.8, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0, 0x38)
    fresh = imu_of(stale, PX4)
    assert fresh is not None
    assert fresh.accel_m_s2 is None
    angles = attitude_of(mavlink.MAVLink_attitude_message(1500, 0.1, -0.2, 2.0, 0, 0, 0))
    assert angles is not None
    w, x, y, z = angles.q_world_body
    assert atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)) == pytest.approx(2.0)
    assert attitude_of(mavlink.MAVLink_attitude_message(1500, nan, 0, 0, 0, 0, 0)) is None


def test_only_a_sensor_that_looks_down_measures_the_floor() -> None:
    def message(distance_cm: int, orientation: int = 25, quality: int = 0) -> Any:
        return mavlink.MAVLink_distance_sensor_message(
            1500, 10, 800, distance_cm, 0, 0, orientation, 0, signal_quality=quality
        )

    found = range_of(message(130))
    assert found is not None
    assert found.distance_m == pytest.approx(1.3)
    for useless in (message(130, orientation=0), message(130, quality=1), message(800), message(5)):
        assert range_of(useless) is None


def test_samples_come_in_by_the_computers_time(vehicle: Vehicle) -> None:
    vehicle.imu()
    estimator = vehicle.core.estimator
    assert estimator.counters["imu"] == 1
    assert abs(estimator.estimate().timestamp_ns - (vehicle.now_ns - MS)) < MS


def test_nothing_is_taken_before_the_vehicle_is_heard_nor_from_another() -> None:
    core = _core()
    early, other = Vehicle(core), Vehicle(core, system=9)
    early.imu()
    assert core.counters["before_heartbeat"] == 1
    early.heartbeat()
    other.heartbeat()
    other.imu()
    assert core.vehicle is not None
    assert core.vehicle.system_id == 1
    assert core.counters["other_sender"] == 1
    assert core.estimator.counters["imu"] == 0


def test_a_worse_message_is_taken_only_while_the_better_is_silent(vehicle: Vehicle) -> None:
    counters = vehicle.core.estimator.counters

    def scaled() -> None:
        stamp_ms = vehicle.stamp_ns() // MS
        vehicle.say(mavlink.MAVLink_scaled_imu_message(stamp_ms, 0, 0, -1000, 0, 0, 0, 0, 0, 0))

    vehicle.imu()
    scaled()
    assert counters["imu"] == 1
    for _ in range(60):
        vehicle.tick()
    scaled()
    assert counters["imu"] == 2


def test_the_time_is_told_to_who_asks(vehicle: Vehicle) -> None:
    (answer,) = vehicle.say(mavlink.MAVLink_timesync_message(0, 1234))
    assert (answer.tc1, answer.ts1) == (vehicle.now_ns, 1234)


def test_messages_are_asked_for_until_they_come_and_after_a_boot(vehicle: Vehicle) -> None:
    asked = vehicle.core.counters["streams_asked"]
    assert asked == 1
    for _ in range(600):
        vehicle.imu()
        vehicle.imu()
        vehicle.tick(18 * MS)
    assert vehicle.core.counters["streams_asked"] == asked
    vehicle.boot_ns = -vehicle.now_ns  # it counts from zero again
    for _ in range(40):
        vehicle.imu()
        vehicle.tick(18 * MS)
    assert vehicle.core.counters["autopilot_restarts"] >= 1
    assert vehicle.core.counters["streams_asked"] == asked + 1
    before = vehicle.core.estimator.counters["imu"]
    vehicle.imu()
    assert vehicle.core.estimator.counters["imu"] == before + 1


def test_ardupilot_is_asked_for_its_own_messages() -> None:
    vehicle = Vehicle(_core(), kind=ARDUPILOT)
    vehicle.heartbeat()
    asked = {int(m.param1) for m in vehicle.tick() if m.get_type() == "COMMAND_LONG"}
    assert {27, 30, 31, 132} <= asked


# Messages out


def _estimate(**values: Any) -> Estimate:
    told: dict[str, Any] = {
        "heading_rad": 0.1,
        "heading_std_rad": radians(0.5),
        "lateral_offset_m": 0.3,
        "lateral_offset_std_m": 0.05,
        "roll_rad": 0.02,
        "pitch_rad": -0.03,
        "status": "tracking",
    }
    return Estimate(START_NS, **(told | values))


def _odometry(e: Estimate, with_position: bool) -> Any:
    packet = PacketWriter().odometry(e, PoseTracker().follow(e), FusionConfig(), with_position)
    (message,) = mavlink.MAVLink(None).parse_buffer(packet)
    return message


def test_odometry_says_yaw_and_its_variance_and_no_position() -> None:
    m = _odometry(_estimate(), with_position=False)
    w, x, y, z = m.q
    assert (m.frame_id, m.child_frame_id, m.estimator_type) == (20, 12, 2)
    assert atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)) == pytest.approx(0.1, abs=1e-6)
    assert abs(np.linalg.norm(m.q) - 1) < 1e-6  # PX4 wants it within 1e-5
    assert m.pose_covariance[20] == pytest.approx(radians(0.5) ** 2)
    assert all(isnan(v) for v in (m.x, m.y, m.z, m.vx, m.vy, m.vz, m.rollspeed, m.pose_covariance[0]))
    assert np.isfinite([m.pose_covariance[k] for k in (15, 18, 20)]).all()
    assert m.time_usec == START_NS // 1000
    assert m.quality == 95


def test_odometry_with_a_position_is_whole() -> None:
    m = _odometry(_estimate(), with_position=True)
    assert (m.x, m.z) == (0.0, 0.0)
    assert m.y == pytest.approx(0.3)
    assert m.pose_covariance[6] == pytest.approx(0.05**2)
    assert np.isfinite([m.pose_covariance[k] for k in (0, 6, 11, 15, 18, 20)]).all()


@pytest.mark.parametrize("status", ["lost", "initialising"])
def test_nothing_is_claimed_while_lost(status: str) -> None:
    m = _odometry(_estimate(status=status), with_position=False)
    assert m.quality == -1
    assert all(isnan(v) for v in m.q)


@given(st.sampled_from(list(Status)), st.floats(0, 10) | st.just(nan) | st.just(inf))
def test_quality_is_a_percentage_or_failed(status: Status, std_rad: float) -> None:
    quality = quality_of(_estimate(status=status, heading_std_rad=std_rad), FusionConfig())
    assert quality == -1 or 1 <= quality <= 100
    assert (quality == -1) == (status in ("lost", "initialising") or not std_rad < inf)


def test_offset_is_told_in_metres_or_in_half_widths() -> None:
    read = mavlink.MAVLink(None)
    (metres,) = read.parse_buffer(PacketWriter().offset_vector(_estimate()))
    bare = _estimate(lateral_offset_m=nan, lateral_offset_norm=0.25, lateral_offset_norm_std=0.1)
    (halves,) = read.parse_buffer(PacketWriter().offset_vector(bare))
    assert (metres.name, halves.name) == ("corridor_m", "corridor_n")
    assert (metres.x, metres.y, metres.z) == pytest.approx((0.3, 0.05, 0.1))
    assert halves.x == 0.25


def test_names_fit_and_status_is_a_number() -> None:
    read = mavlink.MAVLink(None)
    named = {m.name: m.value for p in PacketWriter().plots(_estimate(), 5) for m in read.parse_buffer(p)}
    assert named["cf_status"] == 1.0
    assert named["cf_y"] == pytest.approx(0.3)
    assert max(map(len, named)) <= 10


def test_the_pilot_is_told_of_changes_and_not_too_often(vehicle: Vehicle) -> None:
    e = vehicle.core.estimator.estimate()
    texts = []
    for k in range(200):
        status = ("tracking", "coasting")[k // 10 % 2]
        told = _estimate(status=status, reason="frames are rejected" if status == "coasting" else "")
        vehicle.core.estimator.estimate = lambda *_, told=told, **__: told  # type: ignore[method-assign]
        texts += [m for m in vehicle.tick() if m.get_type() == "STATUSTEXT"]
    assert e.status == "initialising"
    assert 3 <= len(texts) <= 5  # in four seconds
    assert texts[0].text == "corridor 1: tracking"
    assert {m.severity for m in texts} == {4, 6}


# Yaw and place from the first corridor


def _round_a_corner(**at_the_end: Any) -> Iterator[Estimate]:
    """Along a corridor at 1 m/s, then into one 90 degrees to the left, whose heading and offset count anew."""
    for k in range(100):
        yield _estimate_at(k, heading_rad=-0.9 * pi / 2 * max(0, k - 50) / 50, along_velocity_m_s=1.0)
    for k in range(100, 150):
        yield _estimate_at(
            k,
            heading_rad=0.1 * pi / 2,
            corridor_index=1,
            corridor_turn_rad=-pi / 2,
            reset_count=1,
            reset_heading_total_rad=pi / 2,
            along_velocity_m_s=1.0,
            lateral_offset_m=-0.4 if k > 110 else nan,
            **at_the_end,
        )


def _estimate_at(k: int, **values: Any) -> Estimate:
    from dataclasses import replace

    return replace(_estimate(**values), timestamp_ns=START_NS + k * 20 * MS)


def test_yaw_and_place_go_on_smoothly_round_a_corner() -> None:
    tracker = PoseTracker()
    poses = [tracker.follow(e) for e in _round_a_corner()]
    yaws = np.unwrap([p.yaw_rad for p in poses])
    assert np.abs(np.diff(yaws)).max() < 0.05
    assert poses[-1].yaw_rad == pytest.approx(-0.9 * pi / 2)
    steps = np.hypot(np.diff([p.x_m for p in poses]), np.diff([p.y_m for p in poses]))
    assert steps.max() < 0.021
    assert {p.reset_counter for p in poses} == {0}
    assert (poses[99].x_m, poses[99].y_m) == pytest.approx((1.98, 0.3))
    assert poses[-1].x_m == pytest.approx(1.98, abs=0.03)
    assert poses[-1].y_m == pytest.approx(0.3 - 1.0, abs=0.03)  # left of where it turned


def test_a_jump_of_the_yaw_is_counted_once() -> None:
    tracker = PoseTracker()
    tracker.follow(_estimate_at(0))
    for k in range(1, 4):
        jumped = _estimate_at(k, heading_rad=0.4, reset_count=1, reset_heading_total_rad=0.3)
        assert tracker.follow(jumped).reset_counter == 1


def test_a_speed_that_is_not_known_is_not_claimed() -> None:
    unknown, known = PoseTracker(), PoseTracker()
    for k in range(151):
        a = unknown.follow(_estimate_at(k))
        b = known.follow(_estimate_at(k, along_velocity_m_s=0.5))
    assert a.variance_m2[0] == pytest.approx(9.0)  # 1 m/s for 3 s
    assert b.variance_m2[0] < 0.1
    assert b.x_m == pytest.approx(1.5)


# No input can crash it

WORDS = st.sampled_from([0, 1, 2**31, 2**32 - 1, 2**63 - 1, 2**64 - 1])
FLOATS = st.floats(width=32) | st.sampled_from([0.0, -9.81, nan, inf, -inf])
SHORTS = st.integers(-(2**15), 2**15 - 1)


@st.composite
def messages(draw: st.DrawFn) -> Any:
    """Any message that is listened to, with anything in it."""

    def f() -> float:
        return draw(FLOATS)

    def short() -> int:
        return draw(SHORTS)

    ms, us = draw(st.integers(0, 2**32 - 1)), draw(WORDS | st.integers(0, 2**45))
    kind = draw(st.integers(0, 8))
    if kind == 0:
        return mavlink.MAVLink_highres_imu_message(us, *[f() for _ in range(13)], draw(st.integers(0, 65535)))
    if kind == 1:
        return mavlink.MAVLink_scaled_imu_message(ms, *[short() for _ in range(9)])
    if kind == 2:
        return mavlink.MAVLink_raw_imu_message(us, *[short() for _ in range(9)])
    if kind == 3:
        return mavlink.MAVLink_attitude_message(ms, *[f() for _ in range(6)])
    if kind == 4:
        return mavlink.MAVLink_attitude_quaternion_message(ms, *[f() for _ in range(7)])
    if kind == 5:
        byte = st.integers(0, 255)
        word = st.integers(0, 65535)
        return mavlink.MAVLink_distance_sensor_message(
            ms, draw(word), draw(word), draw(word), 0, 0, draw(byte), draw(byte)
        )
    if kind == 6:
        long = st.integers(-(2**63), 2**63 - 1)
        return mavlink.MAVLink_timesync_message(draw(long), draw(long))
    if kind == 7:
        return mavlink.MAVLink_local_position_ned_message(ms, *[f() for _ in range(6)])
    return mavlink.MAVLink_heartbeat_message(draw(st.integers(0, 40)), draw(st.integers(0, 20)), 0, 0, 4, 3)


EVENTS = st.lists(
    st.tuples(st.just("message"), messages())
    | st.tuples(st.just("bytes"), st.binary(max_size=60))
    | st.tuples(st.just("tick"), st.integers(0, 3_000 * MS))
    | st.tuples(st.just("unreadable"), st.integers(-(10**9), 10**9)),
    max_size=40,
)


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(EVENTS, st.sampled_from([PX4, ARDUPILOT]), st.booleans())
def test_no_stream_of_messages_can_crash_it(events: list[Any], kind: int, answers: bool) -> None:
    core = _core(use_velocity=True)
    vehicle = Vehicle(core, kind)
    vehicle.heartbeat()
    for _ in range(30 if answers else 0):
        vehicle.tick()
    for what, value in events:
        if what == "message":
            vehicle.say(value)
        elif what == "bytes":
            vehicle.read(core.on_bytes(vehicle.now_ns, value))
        elif what == "tick":
            vehicle.tick(value)
        else:
            core.on_frame(vehicle.now_ns + value, None)
    heard = _kinds(vehicle.tick(3_000 * MS))
    assert "DEBUG_VECT" in heard  # and it goes on
