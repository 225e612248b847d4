"""Tables and names in the dialects of programs and countries: the same samples at the same times."""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime
from functools import partial
from math import degrees
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fusion.flight import Flight, ImuStream
from fusion.logs import open_log
from fusion.logs.contents import Kind
from fusion.logs.csv.column_map import ColumnMap
from fusion.logs.csv.columns import open_columns
from fusion.logs.csv.times import read_times
from tests.files import written
from tests.fusion.log_cases import FLU, Part
from tests.fusion.log_cases_files import NAMES, G, rows_of
from vision import InputError

N = 300
DEG = degrees(1.0)
SCALES = {
    "SI": (1.0,) * 6,
    "deg/s and g": (DEG,) * 3 + (1 / G,) * 3,
    "deg/s": (DEG,) * 3 + (1.0,) * 3,
    "mdeg/s and mg": (1e3 * DEG,) * 3 + (1e3 / G,) * 3,
    "FLU": (*FLU, *FLU),
}


@pytest.fixture(scope="module")
def part(office: Flight) -> Part:
    return Part.of(office, 40)


def dated(form: str, t_ns: int) -> str:
    return (
        datetime.fromtimestamp(t_ns // 10**9, UTC)
        .strftime(form)
        .replace("FFF", f"{t_ns % 10**9 // 10**6:03d}")
    )


def since(part: Part, unit_ns: int, t_ns: int) -> str:
    return f"{(t_ns - int(part.t_ns[0])) / unit_ns:.6f}"


def days(zero: int, t_ns: int) -> str:
    return f"{t_ns / 86_400e9 + zero:.11f}"


Stamp = Callable[[int], str]


@pytest.mark.parametrize(
    ("header", "stamp", "scale", "separator", "within_ms"),
    [
        (f"Zeit;{NAMES.replace(',', ';')}", partial(dated, "%d.%m.%Y %H:%M:%S,FFF"), "SI", ";", 0.001),
        (f"Timestamp,{NAMES}", partial(dated, "%m/%d/%Y %I:%M:%S.FFF %p"), "SI", ",", 0.001),
        (f"when,{NAMES}", partial(dated, "%m/%d/%Y %H:%M:%S.FFF"), "SI", ",", 0.001),  # the 13th is no month
        (f"datenum,{NAMES}", partial(days, 719_529), "SI", ",", 0.02),
        (f"time,{NAMES}", partial(days, 25_569), "SI", ",", 0.02),
        (f"sec,nanosec,{NAMES}", lambda t: f"{t // 10**9},{t % 10**9}", "SI", ",", 0.0),
        (f"stamp_secs,stamp_nsecs,{NAMES}", lambda t: f"{t // 10**9},{t % 10**9}", "SI", ",", 0.0),
        (f",timestamp,{NAMES}", lambda t: f"7,{t}", "SI", ",", 0.0),
        (
            "timestamp_ns," + NAMES.replace("gyro_", "AngularVelocity_").replace("accel_", "Acceleration_"),
            str,
            "SI",
            ",",
            0.0,
        ),
        (f"timestamp_ns|{NAMES.replace(',', '|')}", str, "SI", "|", 0.0),
        (
            "t [ms];Gyro X [°/s];Gyro Y [°/s];Gyro Z [°/s];Acc X [m/s²];Acc Y [m/s²];Acc Z [m/s²]",
            lambda t: f"{t // 10**6}",
            "deg/s",
            ";",
            0.0,
        ),
        (
            "Time [us],G_X [mdps],G_Y [mdps],G_Z [mdps],A_X [mg],A_Y [mg],A_Z [mg]",
            lambda t: str(t // 1000),
            "mdeg/s and mg",
            ",",
            0.0,
        ),
        (f"timestamp_ns,{NAMES}\nns,deg/s,deg/s,deg/s,g,g,g", str, "deg/s and g", ",", 0.0),
    ],
    ids=lambda value: value.split("\n")[0][:24] if isinstance(value, str) else "",
)
def test_a_dialect(
    header: str, stamp: Stamp, scale: str, separator: str, within_ms: float, part: Part, tmp_path: Path
) -> None:
    rows = rows_of(part, separator, stamp, SCALES[scale])[:N]
    text = "\n".join([header, *rows])
    if header.startswith("Zeit"):  # dates keep their dots
        text = "\n".join([header, *(_german(row) for row in rows)])
    path = tmp_path / "imu.csv"
    path.write_bytes((text + "\n").encode("cp1252"))
    imu = only_imu(path)
    assert np.abs(imu.t_ns - part.t_ns[:N]).max() <= within_ms * 1e6
    np.testing.assert_allclose(imu.gyro_rad_s, part.gyro[:N], atol=1e-5)
    np.testing.assert_allclose(imu.accel_m_s2, part.accel[:N], atol=1e-4)


def _german(row: str) -> str:
    date, _, numbers = row.partition(";")
    return f"{date};{numbers.replace('.', ',')}"


def only_imu(path: Path) -> ImuStream:
    log = open_log(path)
    (topic,) = (topic.name for topic in log.topics if topic.kind is Kind.IMU)
    return log.imu(topic).value


def test_xsens_counts_tenths_of_milliseconds(part: Part, tmp_path: Path) -> None:
    header = "PacketCounter,SampleTimeFine,Gyr_X,Gyr_Y,Gyr_Z,Acc_X,Acc_Y,Acc_Z"
    rows = rows_of(part, ",", lambda t: str((t - int(part.t_ns[0])) // 100_000), SCALES["SI"])[:N]
    text = "\n".join([header, *(f"{k},{row}" for k, row in enumerate(rows))])
    imu = only_imu(written(tmp_path / "imu.csv", text + "\n"))
    np.testing.assert_array_equal(imu.t_ns, part.t_ns[:N] - part.t_ns[0])


def test_dates_whose_order_is_open_are_refused(part: Part, tmp_path: Path) -> None:
    rows = [f"05/06/2020 12:00:{k // 10:02d}.{k % 10},0,0,{k}" for k in range(300)]
    path = written(tmp_path / "imu.csv", "time,gyro_x,gyro_y,gyro_z\n" + "\n".join(rows) + "\n")
    with pytest.raises(InputError, match=r"contains no times, such as '05/06/2020"):
        open_log(path)


def test_two_columns_that_rise_are_asked_for(tmp_path: Path) -> None:
    text = "a,b,gyro_x,gyro_y,gyro_z\n" + "".join(f"{0.01 * k},{0.02 * k},0,0,{k % 7}\n" for k in range(100))
    with pytest.raises(InputError, match="has no column of time stamps"):
        open_log(written(tmp_path / "imu.csv", text))


def test_an_orientation_of_zeros_is_none(part: Part, tmp_path: Path) -> None:
    header = f"timestamp_ns,{NAMES},orientation.x,orientation.y,orientation.z,orientation.w"
    text = "\n".join([header, *(f"{row},0,0,0,0" for row in rows_of(part, ",", str, SCALES["SI"])[:N])])
    log = open_log(written(tmp_path / "imu.csv", text + "\n"))
    assert [topic.kind for topic in log.topics] == [Kind.IMU]
    assert any("quaternions are zero" in problem for problem in log.problems)


@pytest.mark.parametrize("names", ["roll,pitch,yaw", "roll,pitch,heading"])
def test_angles_that_cannot_be_radians_are_degrees(names: str, part: Part, tmp_path: Path) -> None:
    angles = Rotation.from_quat(part.q, scalar_first=True).as_euler("ZYX", degrees=True)[:, ::-1] % [
        360,
        360,
        360,
    ]
    angles[:, :2] = (angles[:, :2] + 180) % 360 - 180
    rows = (
        f"{t},{r:.6f},{p:.6f},{y:.6f}\n"
        for t, (r, p, y) in zip(part.attitude_ns.tolist(), angles, strict=True)
    )
    path = written(tmp_path / "attitude.csv", f"timestamp_ns,{names}\n" + "".join(rows))
    q = open_log(path).attitude("attitude").value.q_world_body
    np.testing.assert_allclose(np.abs(np.sum(q * part.q, axis=1)), 1.0, atol=1e-6)
    with pytest.raises(
        InputError, match=r'degrees, not radians \(set euler_unit = "deg" in \[attitude.columns\]'
    ):
        open_columns(path, ColumnMap(euler=tuple(names.split(",")), euler_unit="rad"))  # type: ignore[arg-type]


def test_a_quaternion_whose_parts_are_numbered(part: Part, tmp_path: Path) -> None:
    rows = (
        f"{t}," + ",".join(f"{v:.8f}" for v in q) + "\n"
        for t, q in zip(part.attitude_ns.tolist(), part.q, strict=True)
    )
    path = written(tmp_path / "attitude.csv", "timestamp_ns,q0,q1,q2,q3\n" + "".join(rows))
    q = open_columns(path, frame="frd").attitude("attitude").value.q_world_body
    np.testing.assert_allclose(q, part.q, atol=1e-7)


def test_times_behind_the_numbers_of_frames(part: Part, tmp_path: Path) -> None:
    text = "".join(f"{k} {t / 1e9:.6f}\n" for k, t in enumerate(part.frames_ns.tolist()))
    listed = read_times(written(tmp_path / "times.txt", text), None).value
    np.testing.assert_allclose(listed.t_ns, part.frames_ns, atol=1000)


@pytest.mark.parametrize(
    ("name", "said"),
    [("imu.csv.gz", "unpack it first"), ("flight.zip", "unpack it first"), ("imu.xlsx", "as CSV")],
)
def test_other_files_are_told_what_to_do_with(name: str, said: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=said):
        open_log(written(tmp_path / name, "PK"))


@pytest.mark.parametrize("form", ["%Y-%m-%dT%H-%M-%S.FFF", "IMG_%Y%m%d_%H%M%S_FFF", "%Y.%m.%d %H:%M:%S.FFF"])
def test_dates_in_the_names_of_pictures(form: str, part: Part, tmp_path: Path) -> None:
    """Read as their last number, they would be seconds that start over each minute."""
    for t_ns in part.frames_ns.tolist():
        cv2.imwrite(str(tmp_path / f"{dated(form, t_ns)}.png"), np.zeros((4, 4), np.uint8))
    log = open_log(tmp_path)
    np.testing.assert_array_equal(log.frames("pictures").value.t_ns, part.frames_ns)


def test_px4_messages_in_a_bag(part: Part, tmp_path: Path) -> None:
    """As the bridge to ROS 2 publishes them: microseconds from boot, FRD and NED, no header."""
    pytest.importorskip("rosbags")
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    combined, attitude = "px4_msgs/msg/SensorCombined", "px4_msgs/msg/VehicleAttitude"
    text = "uint64 timestamp\nfloat32[3] gyro_rad\nuint32 gyro_integral_dt\nint32 accelerometer_timestamp_relative\n"
    store.register(
        get_types_from_msg(
            text + "float32[3] accelerometer_m_s2\nuint32 accelerometer_integral_dt\n", combined
        )
    )
    store.register(get_types_from_msg("uint64 timestamp\nuint64 timestamp_sample\nfloat32[4] q\n", attitude))
    first = int(part.t_ns[0])
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        imu = writer.add_connection("/fmu/out/sensor_combined", combined, typestore=store)
        pose = writer.add_connection("/fmu/out/vehicle_attitude", attitude, typestore=store)
        for t, g, a in zip(part.t_ns[:N].tolist(), part.gyro, part.accel, strict=False):
            boot_us = 5_000_000 + (t - first) // 1000
            sample = store.types[combined](boot_us, np.float32(g), 5000, 0, np.float32(a), 5000)
            writer.write(imu, t, store.serialize_cdr(sample, combined))
        for t, q in zip(part.attitude_ns[:60].tolist(), part.q, strict=False):
            boot_us = 5_000_000 + (t - first) // 1000
            writer.write(
                pose,
                t,
                store.serialize_cdr(store.types[attitude](boot_us + 900, boot_us, np.float32(q)), attitude),
            )
    log = open_log(tmp_path / "bag")
    found = only_imu(tmp_path / "bag")
    np.testing.assert_allclose(np.diff(found.t_ns), np.diff(part.t_ns[:N]), atol=1000)
    np.testing.assert_allclose(found.gyro_rad_s, part.gyro[:N], atol=1e-6)
    np.testing.assert_allclose(found.accel_m_s2, part.accel[:N], atol=1e-5)
    q = log.attitude("/fmu/out/vehicle_attitude").value
    np.testing.assert_allclose(np.abs(np.sum(q.q_world_body * part.q[:60], axis=1)), 1.0, atol=1e-6)
