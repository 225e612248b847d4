"""MAVLink telemetry logs, packed by pymavlink."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fusion.logs.autopilot import tlog
from fusion.logs.contents import Kind
from tests.fusion import damage
from tests.fusion.reading import Told
from vision import InputError

pytest.importorskip("pymavlink")

from pymavlink.dialects.v10 import common as mavlink1
from pymavlink.dialects.v20 import common as mavlink2

UNIX_US = 1_700_000_000_000_000
BOOT_MS = 30_000  # the vehicle's clock when the first message is sent
STEP_MS = 20
DELAY_US = 40_000
N = 120
G_M_S2 = 9.80665


class Writer:
    """A telemetry log under construction."""

    def __init__(self, dialect: Any = mavlink2, system: int = 1) -> None:
        self.dialect, self.data = dialect, bytearray()
        self.link = dialect.MAVLink(None, srcSystem=system, srcComponent=1)

    def send(self, message: Any, received_us: int) -> None:
        self.data += struct.pack(">Q", received_us) + message.pack(self.link)

    def save(self, path: Path) -> Path:
        path.write_bytes(self.data)
        return path


def flight(writer: Writer, start_ms: int = BOOT_MS, n: int = N, at_us: int = UNIX_US) -> Writer:
    """Turning right at 0.25 rad/s and facing east while moving north at 2 m/s; noise in the delays of the radio."""
    rng = np.random.default_rng(1)
    half = 0.5**0.5
    for k in range(n):
        boot_ms = start_ms + k * STEP_MS
        m = writer.dialect
        north = (0.04 * k, 1.0, -1.5, 2.0, 0.0, 0.0)
        # Thousandths of g and of rad/s. The magnetometer and what follows stay zero and are not sent.
        counts = (102, 0, -1000, 0, -50, 250, 0, 0, 0)
        messages = [
            m.MAVLink_raw_imu_message(boot_ms * 1000, *counts),
            m.MAVLink_scaled_imu2_message(boot_ms, *counts),
            m.MAVLink_attitude_message(boot_ms, 0.1, -0.2, 3.0, 0.0, 0.0, 0.25),
            m.MAVLink_attitude_quaternion_message(boot_ms, half, 0.0, 0.0, half, 0.0, 0.0, 0.25),
            m.MAVLink_local_position_ned_message(boot_ms, *north),
            m.MAVLink_heartbeat_message(2, 3, 0, 0, 0, 3),
        ]
        received_us = at_us + k * STEP_MS * 1000 + DELAY_US + int(rng.integers(0, 30_000) if k else 0)
        for message in messages:
            writer.send(message, received_us)
    return writer


@pytest.fixture(params=[mavlink1, mavlink2], ids=["v1", "v2"])
def path(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    return flight(Writer(request.param)).save(tmp_path / "flight.tlog")


def test_every_stream_has_the_values_sent(path: Path) -> None:
    log = tlog.open_log(path)
    assert [(topic.kind, topic.name) for topic in log.topics] == [
        (Kind.IMU, "RAW_IMU"),
        (Kind.IMU, "SCALED_IMU2"),
        (Kind.ATTITUDE, "ATTITUDE_QUATERNION"),
        (Kind.ATTITUDE, "ATTITUDE"),
        (Kind.POSITION, "LOCAL_POSITION_NED"),
        (Kind.VELOCITY, "LOCAL_POSITION_NED"),
    ]
    problems = Told()
    t_ns = (BOOT_MS + STEP_MS * np.arange(N)) * 1_000_000
    for name in ("RAW_IMU", "SCALED_IMU2"):
        imu = problems.take(log.imu(name))
        np.testing.assert_array_equal(imu.t_ns, t_ns)  # the vehicle's clock, not the radio's delays
        np.testing.assert_allclose(imu.gyro_rad_s, [[0.0, -0.05, 0.25]] * N)
        np.testing.assert_allclose(imu.accel_m_s2, [[0.102 * G_M_S2, 0.0, -G_M_S2]] * N)
    half = 0.5**0.5
    attitude = problems.take(log.attitude("ATTITUDE_QUATERNION"))
    np.testing.assert_allclose(attitude.q_world_body, [[half, 0.0, 0.0, half]] * N, atol=1e-7)
    np.testing.assert_allclose(
        problems.take(log.position("LOCAL_POSITION_NED")).xyz[-1], [0.04 * (N - 1), 1.0, -1.5]
    )
    velocity = problems.take(log.velocity("LOCAL_POSITION_NED"))
    np.testing.assert_allclose(velocity.xyz, [[0.0, -2.0, 0.0]] * N, atol=1e-6)
    assert problems == []
    assert log.problems == ()


def test_angles_of_attitude(path: Path) -> None:
    from scipy.spatial.transform import Rotation

    q = tlog.open_log(path).attitude("ATTITUDE").value.q_world_body
    angles = Rotation.from_quat(q, scalar_first=True).as_euler("ZYX")
    np.testing.assert_allclose(angles, [[3.0, -0.2, 0.1]] * N, atol=1e-6)


def test_the_difference_to_unix_time_is_noted(path: Path) -> None:
    offset_s = (UNIX_US + DELAY_US) * 1e-6 - BOOT_MS * 1e-3
    note = tlog.open_log(path).topics[0].note
    assert note.startswith("sent in mrad/s, mG; the vehicle's clock; ")
    assert f"add {offset_s:.3f} s for Unix time by the recording computer's clock" in note


def test_units_and_unix_times_of_highres_imu(tmp_path: Path) -> None:
    writer = Writer()
    for k in range(N):
        boot_ms = BOOT_MS + k * STEP_MS
        updated = 0x3F if k % 2 == 0 else 0x07  # every other gyroscope sample repeats the one before
        values = (0.1, 0.2, -9.8, 0.01, 0.02, 0.3, 0, 0, 0, 1013, 0, 0, 20)
        unix_us = UNIX_US + k * STEP_MS * 1000
        writer.send(mavlink2.MAVLink_highres_imu_message(unix_us, *values, updated), unix_us + DELAY_US)
        writer.send(mavlink2.MAVLink_system_time_message(unix_us, boot_ms), unix_us + DELAY_US)
    log = tlog.open_log(writer.save(tmp_path / "px4.tlog"))
    assert [topic.name for topic in log.topics] == ["HIGHRES_IMU"]
    assert "by SYSTEM_TIME, subtracted here" in log.topics[0].note
    problems = Told()
    imu = problems.take(log.imu("HIGHRES_IMU"))
    np.testing.assert_array_equal(imu.t_ns, (BOOT_MS + 2 * STEP_MS * np.arange(N // 2)) * 1_000_000)
    np.testing.assert_allclose(imu.gyro_rad_s, [[0.01, 0.02, 0.3]] * (N // 2), rtol=1e-6)
    np.testing.assert_allclose(imu.accel_m_s2, [[0.1, 0.2, -9.8]] * (N // 2), rtol=1e-6)
    assert f"{N // 2} rows dropped: a missing or impossible gyro value" in problems[0]


def test_a_sensors_own_counts_are_refused(tmp_path: Path) -> None:
    writer = Writer()
    for k in range(N):
        message = mavlink2.MAVLink_raw_imu_message(k * 20_000, 0, 0, -16384, 0, 0, 100, 0, 0, 0)
        writer.send(message, UNIX_US + k * 20_000)
    log = tlog.open_log(writer.save(tmp_path / "raw.tlog"))
    with pytest.raises(InputError, match=r"RAW_IMU contains a sensor's raw counts: at rest 16\.4 g"):
        log.imu("RAW_IMU")


def test_two_vehicles_are_kept_apart(tmp_path: Path) -> None:
    first, second = flight(Writer(system=1)), flight(Writer(system=7), start_ms=500_000)
    path = tmp_path / "two.tlog"
    path.write_bytes(first.data + second.data)
    log = tlog.open_log(path)
    assert {topic.name for topic in log.topics if topic.kind == Kind.IMU} == {
        *(f"{name}[{system}.1]" for name in ("RAW_IMU", "SCALED_IMU2") for system in (1, 7))
    }
    assert log.imu("RAW_IMU[7.1]").value.t_ns[0] == 500_000 * 1_000_000
    assert len(log.velocity("LOCAL_POSITION_NED[1.1]").value.t_ns) == N


def test_a_restart_of_the_vehicle_does_not_shuffle_two_flights_into_one(tmp_path: Path) -> None:
    writer = flight(Writer(), start_ms=2_000, n=40)
    flight(writer, start_ms=500, n=N, at_us=UNIX_US + 60_000_000)
    log = tlog.open_log(writer.save(tmp_path / "twice.tlog"))
    assert "the vehicle's clock went back 1 time, as when it restarts" in log.problems[0]
    problems = Told()
    for topic in log.topics:
        stream = problems.take(getattr(log, topic.kind)(topic.name))
        np.testing.assert_array_equal(stream.t_ns, (500 + STEP_MS * np.arange(N)) * 1_000_000)
    assert problems == []


def test_a_wrong_checksum_costs_one_message_and_is_said(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[path.read_bytes().index(struct.pack("<hhh", 102, 0, -1000))] ^= 0x55
    path.write_bytes(data)
    log = tlog.open_log(path)
    assert log.problems == ("1 message with a wrong checksum dropped",)
    assert len(log.imu("RAW_IMU").value.t_ns) == N - 1


def test_rubbish_between_messages_is_skipped_and_said(path: Path) -> None:
    data = path.read_bytes()
    path.write_bytes(data[:1000] + b"\xfe\xfd" * 40 + data[1000:])
    log = tlog.open_log(path)
    assert "belong to no whole message" in " ".join(log.problems)
    assert len(log.imu("RAW_IMU").value.t_ns) >= N - 2


def test_it_is_known_by_its_first_bytes_not_its_name(path: Path, tmp_path: Path) -> None:
    assert tlog.recognises(path.rename(tmp_path / "flight.log"))
    (tmp_path / "other.tlog").write_bytes(b"\0" * 8 + b"\xfe" + b"\0" * 20)  # no time that could be one
    assert not tlog.recognises(tmp_path / "other.tlog")
    assert not tlog.recognises(tmp_path)


def test_refusals_name_the_file_and_the_remedy(tmp_path: Path) -> None:
    writer = Writer()
    writer.send(mavlink2.MAVLink_heartbeat_message(2, 3, 0, 0, 0, 3), UNIX_US)
    with pytest.raises(InputError, match=r"none\.tlog: contains no IMU, attitude or position messages \(ask"):
        tlog.open_log(writer.save(tmp_path / "none.tlog"))


def test_damage_is_said_or_refused_and_nothing_else(path: Path, tmp_path: Path) -> None:
    data = path.read_bytes()
    opened, refused = damage.survives(tlog, damage.cuts(data), tmp_path / "cut.tlog")
    assert opened > refused
    opened, refused = damage.survives(tlog, damage.flips(data), tmp_path / "flip.tlog")
    assert opened > 3 * refused


@pytest.mark.parametrize("dialect", [mavlink1, mavlink2])
def test_centimetres_to_the_floor(tmp_path: Path, dialect: Any) -> None:
    writer = Writer(dialect)
    for k in range(N):
        boot_ms = BOOT_MS + k * STEP_MS
        distance_cm = {3: 15, 4: 700, 5: 0}.get(k, 100 + k)
        for sensor, orientation in ((0, 25), (1, 0)):  # down, ahead
            message = dialect.MAVLink_distance_sensor_message(
                boot_ms, 20, 700, distance_cm, 0, sensor, orientation, 255
            )
            writer.send(message, UNIX_US + k * STEP_MS * 1000)
    log = tlog.open_log(writer.save(tmp_path / "range.tlog"))
    assert [(topic.kind, topic.name) for topic in log.topics] == [(Kind.RANGE, "DISTANCE_SENSOR")]
    problems = Told()
    found = problems.take(log.range("DISTANCE_SENSOR"))
    kept = np.delete(np.arange(N), [3, 4, 5])
    np.testing.assert_array_equal(found.t_ns, (BOOT_MS + STEP_MS * kept) * 1_000_000)
    np.testing.assert_allclose(found.distance_m, 1.0 + 0.01 * kept)
    assert "3 rows dropped: no distance within the sensor's reach" in problems[0]


def test_a_signal_that_is_called_invalid_is_dropped(tmp_path: Path) -> None:
    writer = Writer()
    for k in range(N):
        quality = {2: 1, 3: 0, 4: 60}.get(k, 100)  # 1: invalid, 0: not known
        angles = (0.0, 0.0, (1.0, 0.0, 0.0, 0.0))
        writer.send(
            mavlink2.MAVLink_distance_sensor_message(
                BOOT_MS + k * STEP_MS, 20, 700, 140, 0, 0, 25, 255, *angles, quality
            ),
            UNIX_US + k * STEP_MS * 1000,
        )
    found = tlog.open_log(writer.save(tmp_path / "range.tlog")).range("DISTANCE_SENSOR").value
    np.testing.assert_array_equal(found.t_ns, (BOOT_MS + STEP_MS * np.delete(np.arange(N), 2)) * 1_000_000)


def test_a_recording_computer_that_had_no_clock(tmp_path: Path) -> None:
    """It counts from 1970; the vehicle's clock is what counts."""
    path = flight(Writer(), at_us=47_000_000).save(tmp_path / "pi.tlog")
    assert tlog.recognises(path)
    log = tlog.open_log(path)
    np.testing.assert_array_equal(
        log.imu("SCALED_IMU2").value.t_ns, (BOOT_MS + STEP_MS * np.arange(N)) * 1_000_000
    )
    assert not any("Unix time" in topic.note for topic in log.topics)
    other = tmp_path / "noise.tlog"
    other.write_bytes(path.read_bytes()[:20] + bytes(300))
    assert not tlog.recognises(other)


def test_a_counter_of_milliseconds_that_starts_over_goes_on(tmp_path: Path) -> None:
    """After 49.7 days; a message that is first sent after that goes on with the others."""
    start_ms = 2**32 - 50 * STEP_MS
    writer = Writer()
    for k in range(N):
        boot_ms = (start_ms + k * STEP_MS) % 2**32
        received_us = UNIX_US + k * STEP_MS * 1000
        counts = (102, 0, -1000, 0, -50, 250, 0, 0, 0)
        writer.send(mavlink2.MAVLink_scaled_imu_message(boot_ms, *counts), received_us)
        if k >= 60:
            writer.send(mavlink2.MAVLink_attitude_message(boot_ms, 0.1, 0, 0, 0, 0, 0.25), received_us)
    log = tlog.open_log(writer.save(tmp_path / "long.tlog"))
    t_ns = (start_ms + STEP_MS * np.arange(N)) * 1_000_000
    np.testing.assert_array_equal(log.imu("SCALED_IMU").value.t_ns, t_ns)
    np.testing.assert_array_equal(log.attitude("ATTITUDE").value.t_ns, t_ns[60:])
    assert log.problems == ()
