"""ArduPilot's DataFlash logs: written byte by byte as the format says, and a real one."""

from __future__ import annotations

import contextlib
import io
import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

from fusion.logs import open_log
from fusion.logs.autopilot import dataflash
from fusion.logs.contents import Kind
from tests.files import SHARED
from tests.fusion import damage
from tests.fusion.reading import Told
from vision import InputError

REAL = SHARED / "logs" / "ardupilot" / "test.BIN"
START_US = 80_000_000
STEP_US = 20_000
N = 120

CODES = {"Q": "Q", "B": "B", "b": "b", "f": "f", "c": "h", "C": "H", "I": "I", "L": "i", "Z": "64s", "E": "I"}


@dataclass
class Writer:
    """A DataFlash log under construction."""

    data: bytearray = field(default_factory=bytearray)
    codes: dict[str, tuple[int, str]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.define(128, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns", 89)

    def define(self, number: int, name: str, letters: str, columns: str, length: int = 0) -> None:
        layout = "<" + "".join(CODES.get(letter, "") for letter in letters)
        length = length or 3 + struct.calcsize(layout)
        fmt = struct.pack("<BB4s16s64s", number, length, name.encode(), letters.encode(), columns.encode())
        self.data += b"\xa3\x95\x80" + fmt
        self.codes[name] = (number, layout)

    def write(self, name: str, *values: float | bytes) -> None:
        number, layout = self.codes[name]
        self.data += b"\xa3\x95" + bytes([number]) + struct.pack(layout, *values)

    def save(self, path: Path) -> Path:
        path.write_bytes(self.data)
        return path


def times_us() -> list[int]:
    return [START_US + k * STEP_US for k in range(N)]


def new_log(tmp_path: Path, extra: bytes = b"", n: int = N) -> Path:
    """Two IMUs and filters, numbered by a column; flying east at 3 m/s, nose to the east, right wing down."""
    writer = Writer()
    writer.define(1, "IMU", "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ")
    writer.define(2, "XKQ", "QBffff", "TimeUS,C,Q1,Q2,Q3,Q4")
    writer.define(3, "XKF1", "QBccCffffff", "TimeUS,C,Roll,Pitch,Yaw,VN,VE,VD,PN,PE,PD")
    writer.define(4, "ATT", "QccC", "TimeUS,Roll,Pitch,Yaw")
    writer.define(5, "MSG", "QZ", "TimeUS,Message")
    writer.define(6, "RFND", "QBC", "TimeUS,Instance,Dist")
    for k, t_us in enumerate(times_us()[:n]):
        for core in (0, 1):
            writer.write("IMU", t_us, core, 0.1, 0.2, 0.3 + core, 0.0, 9.8, 0.01 * k)
            writer.write("XKQ", t_us + 5, core, 0.5, 0.5, 0.5, 0.5 if core == 0 else -0.5)
            speed = (0.0, 3.0, 0.5, 1.0, 0.06 * k, -1.5)
            writer.write("XKF1", t_us + 10, core, 9000, 0, 9000, *speed)
        writer.write("ATT", t_us + 15, -4500, 1000, 35900)
        if k == n // 2:
            writer.data += extra
        if k % 50 == 0:
            writer.write("MSG", t_us, b"hello \xa3\x95\x01")
            writer.write("RFND", t_us, 0, 250)
    return writer.save(tmp_path / "new.BIN")


def test_every_stream_has_the_values_written(tmp_path: Path) -> None:
    log = dataflash.open_log(new_log(tmp_path))
    assert [(topic.kind, topic.name) for topic in log.topics] == [
        (Kind.IMU, "IMU[0]"),
        (Kind.IMU, "IMU[1]"),
        (Kind.ATTITUDE, "XKQ[0]"),
        (Kind.ATTITUDE, "XKQ[1]"),
        (Kind.ATTITUDE, "ATT"),
        (Kind.POSITION, "XKF1[0]"),
        (Kind.POSITION, "XKF1[1]"),
        (Kind.VELOCITY, "XKF1[0]"),
        (Kind.VELOCITY, "XKF1[1]"),
        (Kind.RANGE, "RFND[0]"),
    ]
    problems = Told()
    imu = problems.take(log.imu("IMU[1]"))
    np.testing.assert_array_equal(imu.t_ns, np.array(times_us()) * 1000)
    np.testing.assert_array_equal(imu.t_ns, log.topics[1].t_ns)
    np.testing.assert_allclose(imu.gyro_rad_s, [[0.1, 0.2, 1.3]] * N, rtol=1e-6)
    np.testing.assert_allclose(imu.accel_m_s2[:, 2], 0.01 * np.arange(N), atol=1e-6)
    np.testing.assert_allclose(problems.take(log.attitude("XKQ[0]")).q_world_body, [[0.5] * 4] * N)
    position = problems.take(log.position("XKF1[0]"))
    np.testing.assert_allclose(position.xyz[-1], [1.0, 0.06 * (N - 1), -1.5], rtol=1e-6)
    # The body's x points east, its y down and its z north.
    velocity = problems.take(log.velocity("XKF1[0]"))
    np.testing.assert_allclose(velocity.xyz, [[3.0, 0.5, 0.0]] * N, atol=1e-6)
    np.testing.assert_allclose(problems.take(log.range("RFND[0]")).distance_m, [2.5] * 3)
    assert problems == []
    assert log.problems == ()


def test_angles_in_hundredths_of_degrees(tmp_path: Path) -> None:
    from scipy.spatial.transform import Rotation

    attitude = dataflash.open_log(new_log(tmp_path)).attitude("ATT").value
    yaw_pitch_roll = Rotation.from_quat(attitude.q_world_body, scalar_first=True).as_euler(
        "ZYX", degrees=True
    )
    np.testing.assert_allclose(yaw_pitch_roll, [[-1.0, 10.0, -45.0]] * N, atol=1e-9)


def test_old_logs_number_their_sensors_in_the_name(tmp_path: Path) -> None:
    writer = Writer()
    for number, name in ((1, "IMU"), (2, "IMU2")):
        writer.define(number, name, "Iffffff", "TimeMS,GyrX,GyrY,GyrZ,AccX,AccY,AccZ")
    writer.define(3, "NKQ1", "Qffff", "TimeUS,Q1,Q2,Q3,Q4")
    for t_us in times_us():
        for k, name in enumerate(("IMU", "IMU2")):
            writer.write(name, t_us // 1000, 0.5 * k, 0.0, 0.0, 0.0, 0.0, -9.8)
        writer.write("NKQ1", t_us, 1.0, 0.0, 0.0, 0.0)
    log = dataflash.open_log(writer.save(tmp_path / "old.BIN"))
    assert [topic.name for topic in log.topics] == ["IMU[0]", "IMU[1]", "NKQ1"]
    imu = log.imu("IMU[1]").value
    assert imu.t_ns[1] == (START_US + STEP_US) * 1000
    np.testing.assert_allclose(imu.gyro_rad_s[:, 0], 0.5)


def test_rubbish_between_messages_is_skipped_and_said(tmp_path: Path) -> None:
    rubbish = b"\xa3\x95\x01" + bytes(7) + b"\xa3\x95\xee"  # looks like messages and is none
    log = dataflash.open_log(new_log(tmp_path, rubbish))
    assert log.problems[0].startswith("13 of ")
    for topic, n in (("IMU[0]", N), ("IMU[1]", N)):
        assert len(log.imu(topic).value.t_ns) == n
    assert len(log.attitude("ATT").value.t_ns) == N


def test_a_torn_end_costs_one_message(tmp_path: Path) -> None:
    path = new_log(tmp_path)
    path.write_bytes(path.read_bytes()[:-10])
    log = dataflash.open_log(path)
    assert len(log.attitude("ATT").value.t_ns) == N - 1
    assert "belong to no whole message" in log.problems[0]


def test_it_is_known_by_its_first_bytes_not_its_name(tmp_path: Path) -> None:
    assert dataflash.recognises(new_log(tmp_path).rename(tmp_path / "log.dat"))
    (tmp_path / "other.BIN").write_bytes(b"firmware")
    assert not dataflash.recognises(tmp_path / "other.BIN")
    assert not dataflash.recognises(tmp_path)


def test_refusals_name_the_file_and_the_remedy(tmp_path: Path) -> None:
    writer = Writer()
    with pytest.raises(
        InputError, match=r"empty\.BIN: contains no IMU, attitude or filter messages \(set LOG_"
    ):
        dataflash.open_log(writer.save(tmp_path / "empty.BIN"))
    (tmp_path / "nothing.BIN").touch()
    with pytest.raises(InputError, match="cannot be read"):
        dataflash.open_log(tmp_path / "nothing.BIN")
    log = dataflash.open_log(new_log(tmp_path))
    with pytest.raises(InputError, match=r"has no imu topic IMU\[2\] \(choose one of IMU\[0\], IMU\[1\]\)"):
        log.imu("IMU[2]")


def test_damage_is_said_or_refused_and_nothing_else(tmp_path: Path) -> None:
    data = new_log(tmp_path).read_bytes()
    opened, refused = damage.survives(dataflash, damage.cuts(data), tmp_path / "cut.BIN")
    assert opened > refused
    opened, refused = damage.survives(dataflash, damage.flips(data), tmp_path / "flip.BIN")
    assert opened > 3 * refused


def test_a_real_log_reads_as_pymavlink_reads_it() -> None:
    mavutil = pytest.importorskip("pymavlink.mavutil")
    if not REAL.exists():
        pytest.skip("the real ArduPilot log is not here")
    log = dataflash.open_log(REAL)
    expected: dict[str, list[list[float]]] = {}
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        reader = mavutil.mavlink_connection(str(REAL))
        while (message := reader.recv_match(type=["IMU", "IMU2", "NKQ1", "ATT", "NKF1"])) is not None:
            expected.setdefault(message.get_type(), []).append(list(message.to_dict().values())[1:])
        reader.close()
    problems = Told()
    for name, label in (("IMU", "IMU[0]"), ("IMU2", "IMU[1]")):
        values = np.array(expected[name], dtype=float)
        imu = problems.take(log.imu(label))
        np.testing.assert_array_equal(imu.t_ns, values[:, 0].astype(np.int64) * 1000)
        np.testing.assert_array_equal(np.hstack([imu.gyro_rad_s, imu.accel_m_s2]), values[:, 1:7])
    values = np.array(expected["NKQ1"], dtype=float)
    np.testing.assert_allclose(problems.take(log.attitude("NKQ1")).q_world_body, values[:, 1:5], atol=1e-6)
    values = np.array(expected["NKF1"], dtype=float)
    np.testing.assert_array_equal(problems.take(log.position("NKF1")).xyz, values[:, 8:11])
    speed = np.linalg.norm(problems.take(log.velocity("NKF1")).xyz, axis=1)
    np.testing.assert_allclose(speed, np.linalg.norm(values[:, 4:7], axis=1), rtol=1e-9)
    assert problems == []


def test_attitudes_of_a_real_log_agree() -> None:
    if not REAL.exists():
        pytest.skip("the real ArduPilot log is not here")
    log = dataflash.open_log(REAL)
    attitudes = [log.attitude(name).value.q_world_body for name in ("ATT", "AHR2", "NKQ1", "NKQ2")]
    n = min(len(q) for q in attitudes)
    for q in attitudes[1:]:
        # The filters' quaternions leave out the trim, a few degrees here.
        apart = 2.0 * np.degrees(
            np.arccos(np.clip(np.abs(np.sum(attitudes[0][:n] * q[:n], axis=1)), 0.0, 1.0))
        )
        assert apart.max() < 4.0


def test_a_real_log_in_pieces(tmp_path: Path) -> None:
    if not REAL.exists():
        pytest.skip("the real ArduPilot log is not here")
    data = REAL.read_bytes()
    opened, _ = damage.survives(dataflash, damage.cuts(data), tmp_path / "cut.BIN")
    assert opened > 0
    opened, refused = damage.survives(dataflash, damage.flips(data, 100), tmp_path / "flip.BIN")
    assert opened > 3 * refused


# As ArduPilot has defined the message over the years: 3.2, 3.5, 3.6, 4.0, and with the quality of the signal.
RANGES: dict[str, tuple[str, str, Callable[[int], tuple[float, ...]], str]] = {
    "3.2": ("QCC", "TimeUS,Dist1,Dist2", lambda cm: (cm, 0), "RFND.Dist1"),
    "3.5": ("QCBCB", "TimeUS,Dist1,Orient1,Dist2,Orient2", lambda cm: (300, 0, cm, 25), "RFND.Dist2"),
    "3.6": (
        "QCBBCBB",
        "TimeUS,Dist1,Stat1,Orient1,Dist2,Stat2,Orient2",
        lambda cm: (cm, 4, 25, 300, 4, 0),
        "RFND.Dist1",
    ),
    "4.0": ("QBCBB", "TimeUS,Instance,Dist,Stat,Orient", lambda cm: (1, cm, 4, 25), "RFND[1]"),
    "4.6": (
        "QBfBBb",
        "TimeUS,Instance,Dist,Stat,Orient,Quality",
        lambda cm: (0, cm / 100, 4, 25, -1),
        "RFND[0]",
    ),
}


@pytest.mark.parametrize("version", RANGES)
def test_range_finders_of_every_version(tmp_path: Path, version: str) -> None:
    letters, columns, values, name = RANGES[version]
    writer = Writer()
    writer.define(6, "RFND", letters, columns)
    for k, t_us in enumerate(times_us()):
        writer.write("RFND", t_us, *values(100 + k))
    log = dataflash.open_log(writer.save(tmp_path / "range.BIN"))
    assert [(topic.kind, topic.name) for topic in log.topics] == [(Kind.RANGE, name)]
    told = "taken to look down: the log does not tell" if version == "3.2" else "looks down"
    assert log.topics[0].note == told
    problems = Told()
    found = problems.take(log.range(name))
    np.testing.assert_array_equal(found.t_ns, np.array(times_us()) * 1000)
    np.testing.assert_allclose(found.distance_m, 1.0 + 0.01 * np.arange(N), rtol=1e-6)
    assert problems == []


def test_what_a_range_finder_calls_bad_is_dropped(tmp_path: Path) -> None:
    writer = Writer()
    writer.define(6, "RFND", "QBfBBb", "TimeUS,Instance,Dist,Stat,Orient,Quality")
    for k, t_us in enumerate(times_us()):
        status = {3: 2, 4: 3, 5: 1}.get(k, 4)  # too near, too far, no data
        writer.write("RFND", t_us, 0, 1.4, status, 25, 0 if k == 6 else 90)
        writer.write("RFND", t_us, 1, 3.0, 4, 0, 90)  # ahead
    log = dataflash.open_log(writer.save(tmp_path / "range.BIN"))
    assert [topic.name for topic in log.topics] == ["RFND[0]"]
    problems = Told()
    found = problems.take(log.range("RFND[0]"))
    assert len(found.t_ns) == N - 4
    assert "RFND[0]: 4 rows dropped: no distance within the sensor's reach" in problems[0]


def test_a_log_as_text_is_the_same_log(tmp_path: Path) -> None:
    """As Mission Planner writes it: its lengths are not those of the fields, and a line may be damaged."""
    lines = [
        "FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns",
        "FMT, 1, 43, IMU, QBffffff, TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ",
        "FMT, 4, 20, ATT, QccC, TimeUS,Roll,Pitch,Yaw",
        "FMT, 6, 20, RFND, QBCBB, TimeUS,Instance,Dist,Stat,Orient",
        "FMT, 5, 75, MSG, QZ, TimeUS,Message",
    ]
    for k, t_us in enumerate(times_us()):
        lines += [
            f"IMU, {t_us}, 0, 0.1, 0.2, {0.3 + k}, 0, 9.8, {0.01 * k:.4f}",
            f"ATT, {t_us + 15}, -45, 10, 359",
            f"RFND, {t_us}, 0, 2.5, 4, 25",
        ]
    lines[50] = lines[50][:20]
    lines.append("MSG, 5, hello, world")
    path = tmp_path / "text.log"
    path.write_text("\n".join(lines) + "\n")
    log = open_log(path)
    assert log.format == dataflash.FORMAT
    assert log.problems == ("1 line damaged, dropped",)
    imu = log.imu("IMU[0]").value
    np.testing.assert_allclose(imu.gyro_rad_s[3], [0.1, 0.2, 3.3], rtol=1e-6)
    np.testing.assert_array_equal(imu.t_ns[:3], np.array(times_us()[:3]) * 1000)
    binary = dataflash.open_log(new_log(tmp_path)).attitude("ATT").value
    text = log.attitude("ATT").value
    np.testing.assert_allclose(text.q_world_body[0], binary.q_world_body[0], atol=1e-12)
    np.testing.assert_allclose(log.range("RFND[0]").value.distance_m, 2.5)
