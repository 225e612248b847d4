"""PX4 logs: written byte by byte as the format says, and real ones."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fusion.logs.autopilot import ulog
from fusion.logs.contents import Kind
from tests.files import SHARED
from tests.fusion import damage
from tests.fusion.reading import Told
from vision import InputError

pytest.importorskip("pyulog")

REAL = SHARED / "logs" / "px4"
START_US = 5_000_000
STEP_US = 5_000
N = 240

COMBINED = (
    "sensor_combined:uint64_t timestamp;float[3] gyro_rad;uint32_t gyro_integral_dt;"
    "int32_t accelerometer_timestamp_relative;float[3] accelerometer_m_s2;uint32_t accelerometer_integral_dt;"
)
ATTITUDE = "vehicle_attitude:uint64_t timestamp;uint64_t timestamp_sample;float[4] q;"
POSITION = (
    "vehicle_local_position:uint64_t timestamp;float x;float y;float z;float vx;float vy;float vz;"
    "bool xy_valid;bool z_valid;bool v_xy_valid;bool v_z_valid;uint8_t[4] _padding0;"
)
GYRO = "sensor_gyro:uint64_t timestamp;uint64_t timestamp_sample;uint32_t device_id;float x;float y;float z;"
ACCEL = GYRO.replace("gyro", "accel")
IMU = (
    "vehicle_imu:uint64_t timestamp;uint64_t timestamp_sample;float[3] delta_angle;float[3] delta_velocity;"
    "uint16_t delta_angle_dt;uint16_t delta_velocity_dt;"
)


@dataclass
class Writer:
    """A ULog under construction; https://docs.px4.io/main/en/dev_log/ulog_file_format.html."""

    data: bytearray = field(
        default_factory=lambda: bytearray(b"ULog\x01\x12\x35\x01" + struct.pack("<Q", START_US))
    )

    def message(self, kind: str, payload: bytes) -> None:
        self.data += struct.pack("<HB", len(payload), ord(kind)) + payload

    def formats(self, *texts: str) -> None:
        self.message("B", bytes(40))
        for text in texts:
            self.message("F", text.encode())

    def subscribe(self, message_id: int, name: str, instance: int = 0) -> None:
        self.message("A", struct.pack("<BH", instance, message_id) + name.encode())

    def sample(self, message_id: int, layout: str, *values: float) -> None:
        self.message("D", struct.pack("<H" + layout, message_id, *values))

    def save(self, path: Path) -> Path:
        path.write_bytes(self.data)
        return path


def times_us(n: int = N) -> list[int]:
    return [START_US + k * STEP_US for k in range(n)]


def flying_right(tmp_path: Path, *, damaged_time: bool = False, n: int = N) -> Path:
    """North-going at 2 m/s, nose to the east: the body moves to its left; turning at 0.25 rad/s about z."""
    writer = Writer()
    writer.formats(COMBINED, ATTITUDE, POSITION)
    for message_id, name in enumerate(("sensor_combined", "vehicle_attitude", "vehicle_local_position")):
        writer.subscribe(message_id, name)
    east = Rotation.from_euler("ZYX", [90.0, 0.0, 0.0], degrees=True).as_quat(scalar_first=True)
    for k, t_us in enumerate(times_us(n)):
        accel_age = 0x7FFFFFFF if k == 3 else -100
        logged = 2**63 if damaged_time and k == 200 else t_us
        writer.sample(0, "Q3fIi3fI", logged, 0.01, 0.02, 0.25, 4000, accel_age, 0.1, 0.2, -9.8, 4000)
        if k == 100:
            writer.message("O", struct.pack("<H", 60))
        writer.sample(1, "QQ4f", t_us + 900, t_us, *east)
        if k % 10 == 0:
            trusted = k >= 100
            writer.sample(2, "Q6f4B", t_us, 0.01 * k, 1.0, -1.5, 2.0, 0.0, 0.0, trusted, 1, 1, 1)
    return writer.save(tmp_path / "flight.ulg")


def test_every_stream_has_the_values_written(tmp_path: Path) -> None:
    log = ulog.open_log(flying_right(tmp_path))
    assert [(topic.kind, topic.name) for topic in log.topics] == [
        (Kind.IMU, "sensor_combined"),
        (Kind.ATTITUDE, "vehicle_attitude"),
        (Kind.POSITION, "vehicle_local_position"),
        (Kind.VELOCITY, "vehicle_local_position"),
    ]
    problems = Told()
    imu = problems.take(log.imu("sensor_combined"))
    middle_ns = np.array(times_us()) * 1000 - 2_000_000  # a mean over 4 ms belongs to their middle
    np.testing.assert_array_equal(imu.t_ns, middle_ns)
    np.testing.assert_array_equal(imu.t_ns, log.topics[0].t_ns)
    np.testing.assert_allclose(imu.gyro_rad_s, [[0.01, 0.02, 0.25]] * N, rtol=1e-6)
    np.testing.assert_allclose(np.delete(imu.accel_m_s2, 3, axis=0), [[0.1, 0.2, -9.8]] * (N - 1), rtol=1e-6)
    assert np.isnan(imu.accel_m_s2[3]).all()
    assert problems == ["sensor_combined: 1 row without acceleration"]
    attitude = problems.take(log.attitude("vehicle_attitude"))
    np.testing.assert_array_equal(attitude.t_ns, np.array(times_us()) * 1000)  # when taken, not when logged
    np.testing.assert_allclose(attitude.q_world_body, [[0.5**0.5, 0.0, 0.0, 0.5**0.5]] * N, atol=1e-7)
    assert log.problems == ("the logger could not keep up: 1 dropout, 0.06 s in all, the longest 0.06 s",)


def test_velocity_is_turned_into_the_body_and_untrusted_positions_are_dropped(tmp_path: Path) -> None:
    log = ulog.open_log(flying_right(tmp_path))
    problems = Told()
    velocity = problems.take(log.velocity("vehicle_local_position"))
    np.testing.assert_allclose(velocity.xyz, [[0.0, -2.0, 0.0]] * (N // 10), atol=1e-6)
    assert problems == []
    position = problems.take(log.position("vehicle_local_position"))
    np.testing.assert_allclose(position.xyz[0], [1.0, 1.0, -1.5], rtol=1e-6)
    assert len(position.t_ns) == 14
    assert problems == [
        "vehicle_local_position: 10 rows dropped: a position that the autopilot did not trust "
        f"(first at {START_US * 1000})"
    ]


def test_a_damaged_time_is_dropped_and_said(tmp_path: Path) -> None:
    log = ulog.open_log(flying_right(tmp_path, damaged_time=True))
    problems = Told()
    imu = problems.take(log.imu("sensor_combined"))
    assert len(imu.t_ns) == N - 1
    assert imu.t_ns[-1] == times_us()[-1] * 1000 - 2_000_000
    assert "1 row dropped: a time" in problems[0]


def test_several_sensors_are_several_topics(tmp_path: Path) -> None:
    writer = Writer()
    writer.formats(GYRO, ACCEL, IMU)
    for instance in (0, 1):
        writer.subscribe(instance, "sensor_gyro", instance)
        writer.subscribe(10 + instance, "sensor_accel", instance)
        writer.subscribe(20 + instance, "vehicle_imu", instance)
    for t_us in times_us(50):
        for instance in (0, 1):
            writer.sample(instance, "QQI3f", t_us + 70, t_us, 9, 0.1 + instance, 0.0, 0.0)
            at_us = t_us + 2500
            writer.sample(10 + instance, "QQI3f", at_us + 70, at_us, 9, 0.0, t_us * 1e-6 + instance, -9.8)
            angle, velocity = 0.004 * (1 + instance), -9.8 * 0.005
            writer.sample(20 + instance, "QQ6f2H", t_us, t_us, angle, 0, 0, 0, 0, velocity, 4000, 5000)
    log = ulog.open_log(writer.save(tmp_path / "many.ulg"))
    names = [topic.name for topic in log.topics]
    assert names == ["vehicle_imu", "vehicle_imu[1]", "sensor_gyro", "sensor_gyro[1]"]
    problems = Told()
    integrated = problems.take(log.imu("vehicle_imu[1]"))
    np.testing.assert_allclose(integrated.gyro_rad_s, [[2.0, 0.0, 0.0]] * 50, rtol=1e-6)
    np.testing.assert_allclose(integrated.accel_m_s2, [[0.0, 0.0, -9.8]] * 50, rtol=1e-6)
    assert integrated.t_ns[0] == START_US * 1000 - 2_000_000
    assert problems == []
    raw = problems.take(log.imu("sensor_gyro[1]"))
    np.testing.assert_allclose(raw.gyro_rad_s[:, 0], 1.1, rtol=1e-6)
    # The accelerometer's time is half a step off: at the gyroscope's the mean of two of its samples holds.
    expected = np.array(times_us(50))[1:] * 1e-6 - 2500e-6 + 1.0
    np.testing.assert_allclose(raw.accel_m_s2[1:, 1], expected, atol=2e-6)
    assert problems == ["sensor_gyro[1]: 1 row without acceleration"]


def test_what_the_autopilot_never_trusted_is_left_out_and_said(tmp_path: Path) -> None:
    writer = Writer()
    writer.formats(ATTITUDE, POSITION)
    writer.subscribe(1, "vehicle_attitude")
    writer.subscribe(2, "vehicle_local_position")
    for t_us in times_us(20):
        writer.sample(1, "QQ4f", t_us, 0, 1.0, 0.0, 0.0, 0.0)
        writer.sample(2, "Q6f4B", t_us, 1.0, 1.0, -1.5, 2.0, 0.0, 0.0, 0, 1, 0, 1)
    log = ulog.open_log(writer.save(tmp_path / "indoors.ulg"))
    assert [topic.kind for topic in log.topics] == [Kind.ATTITUDE]
    assert len(log.problems) == 2
    assert all("never trusted" in problem for problem in log.problems)


def test_it_is_known_by_its_first_bytes_not_its_name(tmp_path: Path) -> None:
    path = flying_right(tmp_path)
    assert ulog.recognises(path.rename(tmp_path / "flight.bin"))
    (tmp_path / "other.ulg").write_bytes(b"not a log at all")
    assert not ulog.recognises(tmp_path / "other.ulg")
    assert not ulog.recognises(tmp_path)


def test_refusals_name_the_file_and_the_remedy(tmp_path: Path) -> None:
    writer = Writer()
    writer.formats(ATTITUDE)
    with pytest.raises(InputError, match=r"empty\.ulg: contains no IMU, attitude or position \(log at least"):
        ulog.open_log(writer.save(tmp_path / "empty.ulg"))
    (tmp_path / "stub.ulg").write_bytes(ulog.MAGIC + b"\x01")
    with pytest.raises(InputError, match="damaged in its definitions"):
        ulog.open_log(tmp_path / "stub.ulg")
    log = ulog.open_log(flying_right(tmp_path))
    with pytest.raises(InputError, match="carries no pictures"):
        log.frames("camera")
    with pytest.raises(InputError, match=r"has no imu topic vehicle_imu \(choose one of sensor_combined"):
        log.imu("vehicle_imu")
    assert log.camera("camera") is None


def test_a_torn_end_is_said(tmp_path: Path) -> None:
    path = flying_right(tmp_path)
    path.write_bytes(path.read_bytes()[:-5])
    assert "the file ends in the middle of a message: it was cut short" in ulog.open_log(path).problems


def test_damage_is_said_or_refused_and_nothing_else(tmp_path: Path) -> None:
    data = flying_right(tmp_path).read_bytes()
    opened, refused = damage.survives(ulog, damage.cuts(data), tmp_path / "cut.ulg")
    assert opened > refused
    opened, refused = damage.survives(ulog, damage.flips(data), tmp_path / "flip.ulg")
    assert opened > 3 * refused


@pytest.mark.parametrize("name", ["sample.ulg", "sample_appended_multiple.ulg", "sample_log_small.ulg"])
def test_real_logs_agree_with_themselves_on_where_down_is(name: str) -> None:
    if not (REAL / name).exists():
        pytest.skip("the real PX4 logs are not here")
    log = ulog.open_log(REAL / name)
    problems = Told()
    imu = problems.take(log.imu("sensor_combined"))
    damage.check_stream(imu)
    up = np.nanmedian(imu.accel_m_s2, axis=0)
    assert np.linalg.norm(up) == pytest.approx(9.8, abs=0.3)
    attitude = problems.take(log.attitude("vehicle_attitude"))
    down = Rotation.from_quat(attitude.q_world_body, scalar_first=True).inv().apply([0.0, 0.0, 1.0])
    np.testing.assert_allclose(np.median(down, axis=0), -up / np.linalg.norm(up), atol=0.05)
    assert problems == []


@pytest.mark.parametrize("name", ["sample_appended_multiple.ulg", "sample_log_small.ulg"])
def test_a_real_log_in_pieces(name: str, tmp_path: Path) -> None:
    if not (REAL / name).exists():
        pytest.skip("the real PX4 logs are not here")
    data = (REAL / name).read_bytes()
    opened, refused = damage.survives(ulog, damage.cuts(data, 40), tmp_path / "cut.ulg")
    assert opened > refused
    opened, refused = damage.survives(ulog, damage.flips(data, 40), tmp_path / "flip.ulg")
    assert opened > refused


RANGE = (
    "distance_sensor:uint64_t timestamp;float min_distance;float max_distance;float current_distance;"
    "int8_t signal_quality;uint8_t orientation;uint8_t[2] _padding0;"
)


def test_distances_of_sensors_that_look_down(tmp_path: Path) -> None:
    writer = Writer()
    writer.formats(RANGE)
    for instance in range(3):
        writer.subscribe(instance, "distance_sensor", instance)
    for k, t_us in enumerate(times_us(40)):
        quality = 0 if k == 5 else -1  # invalid, else unknown
        distance = {7: 0.05, 8: 12.0, 9: np.nan, 10: 0.0, 11: -1.0}.get(k, 1.0 + 0.01 * k)
        writer.sample(0, "Q3fbB", t_us, 0.1, 12.0, 3.0, 100, 0)  # ahead
        writer.sample(1, "Q3fbB", t_us, 0.1, 12.0, distance, quality, 25)
        writer.sample(2, "Q3fbB", t_us, 0.0, 0.0, 1.5, 80, 25)  # knows no limits
    log = ulog.open_log(writer.save(tmp_path / "range.ulg"))
    assert [(topic.kind, topic.name) for topic in log.topics] == [
        (Kind.RANGE, "distance_sensor[1]"),
        (Kind.RANGE, "distance_sensor[2]"),
    ]
    problems = Told()
    found = problems.take(log.range("distance_sensor[1]"))
    kept = [k for k in range(40) if k not in (5, 7, 8, 9, 10, 11)]
    np.testing.assert_array_equal(found.t_ns, np.array(times_us(40))[kept] * 1000)
    np.testing.assert_allclose(found.distance_m, 1.0 + 0.01 * np.array(kept), rtol=1e-6)
    first_ns = times_us()[5] * 1000
    assert problems == [
        f"distance_sensor[1]: 6 rows dropped: no distance within the sensor's reach (first at {first_ns})"
    ]
    np.testing.assert_allclose(log.range("distance_sensor[2]").value.distance_m, [1.5] * 40)


def test_intervals_in_seconds_and_a_time_stamp_of_another_clock(tmp_path: Path) -> None:
    """Logs from before 2017 have gyro_integral_dt in seconds; a companion may stamp samples in Unix time, or not."""
    writer = Writer()
    writer.formats(COMBINED.replace("uint32_t gyro_integral_dt", "float gyro_integral_dt"), ATTITUDE)
    writer.subscribe(0, "sensor_combined")
    writer.subscribe(1, "vehicle_attitude")
    for k, t_us in enumerate(times_us()):
        writer.sample(0, "Q4fi3fI", t_us, 0.01, 0.02, 0.25, 0.004, 0, 0.1, 0.2, -9.8, 4000)
        taken_us = (1_716_551_400_058_872 + t_us, 0, t_us - 900)[k % 3]
        writer.sample(1, "QQ4f", t_us, taken_us, 1.0, 0.0, 0.0, 0.0)
    log = ulog.open_log(writer.save(tmp_path / "old.ulg"))
    middle_ns = np.array(times_us()) * 1000 - 2_000_000
    np.testing.assert_allclose(log.imu("sensor_combined").value.t_ns, middle_ns, atol=1)
    late_us = np.array(times_us()) - log.attitude("vehicle_attitude").value.t_ns // 1000
    assert set(late_us.tolist()) == {0, 900}
