"""CSV files of any shape: units and axes by hand, ready maps, damage row by row, and what cannot be read."""

from __future__ import annotations

import re
from collections.abc import Callable
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from math import cos, radians, sin
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from fusion.flight import AttitudeStream, ImuStream, VectorStream
from fusion.inspection.sources import inspect_path
from fusion.logs import open_log
from fusion.logs.contents import Kind
from fusion.logs.csv.column_map import ColumnMap, Frame
from fusion.logs.csv.columns import open_columns
from fusion.logs.csv.table import read_layout
from fusion.logs.csv.time_units import guess_unit, to_ns
from fusion.logs.csv.times import read_times
from tests.files import written
from tests.fusion.reading import Told
from vision import InputError

T0 = 1_403_636_579_763_555_584
G = 9.80665


def rows(row: Callable[[int], str], n: int = 30) -> str:
    return "".join(row(i) + "\n" for i in range(n))


def imu_of(path: Path, columns: ColumnMap | str | None = None, frame: Frame | None = None) -> ImuStream:
    return open_columns(path, columns, frame).imu("imu").value


def attitude_of(
    path: Path, columns: ColumnMap | str | None = None, frame: Frame | None = None
) -> AttitudeStream:
    return open_columns(path, columns, frame).attitude("attitude").value


def rotation(stream: AttitudeStream) -> np.ndarray:
    return np.asarray(Rotation.from_quat(np.roll(stream.q_world_body[0], -1)).as_matrix())


# ------------------------------------------------------------------------------------------- units and axes


@pytest.mark.parametrize(("unit", "one"), [("rad/s", 1.0), ("deg/s", radians(1)), ("mrad/s", 1e-3)])
def test_units_of_the_gyroscope(tmp_path: Path, unit: str, one: float) -> None:
    path = written(tmp_path / "a.csv", "t,x,y,z\n" + rows(lambda i: f"{i * 10},1,2,-3"))
    columns = ColumnMap(time="t", time_unit="ms", gyro=("x", "y", "z"), gyro_unit=unit)
    imu = imu_of(path, columns, "frd")
    np.testing.assert_allclose(imu.gyro_rad_s[0], [one, 2 * one, -3 * one])
    assert imu.t_ns[:2].tolist() == [0, 10_000_000]
    assert np.isnan(imu.accel_m_s2).all()


@pytest.mark.parametrize(("unit", "one"), [("m/s2", 1.0), ("g", G), ("mg", G * 1e-3), ("cm/s2", 0.01)])
def test_units_of_the_accelerometer(tmp_path: Path, unit: str, one: float) -> None:
    path = written(tmp_path / "a.csv", "t,gx,gy,gz,x,y,z\n" + rows(lambda i: f"{i * 10},0,0,0,1,2,-3"))
    columns = ColumnMap(gyro=("gx", "gy", "gz"), accel=("x", "y", "z"), accel_unit=unit)
    np.testing.assert_allclose(imu_of(path, columns, "frd").accel_m_s2[0], [one, 2 * one, -3 * one])
    np.testing.assert_allclose(
        imu_of(path, columns.model_copy(update={"accel_sign": -1}), "frd").accel_m_s2[0],
        [-one, -2 * one, 3 * one],
    )


@pytest.mark.parametrize(
    ("frame", "expected"),
    [("frd", (1, 2, -3)), ("ned", (1, 2, -3)), ("flu", (1, -2, 3)), ("enu", (1, -2, 3))],
)
def test_axes_of_an_imu(tmp_path: Path, frame: Frame, expected: tuple[float, ...]) -> None:
    path = written(tmp_path / "a.csv", "t,gx,gy,gz,ax,ay,az\n" + rows(lambda i: f"{i * 10},1,2,-3,1,2,-3"))
    imu = imu_of(path, None, frame)
    np.testing.assert_allclose(imu.gyro_rad_s[0], expected)
    np.testing.assert_allclose(imu.accel_m_s2[0], expected)


@pytest.mark.parametrize(("z", "frame"), [(9.8, "flu"), (-9.8, "frd")])
def test_gravity_tells_the_axes_and_it_is_said(tmp_path: Path, z: float, frame: str) -> None:
    path = written(tmp_path / "a.csv", "t,gx,gy,gz,ax,ay,az\n" + rows(lambda i: f"{i * 10},0,0,1,0,0,{z}"))
    problems = Told()
    imu = problems.take(open_log(path).imu("imu"))
    assert imu.accel_m_s2[0, 2] == -9.8
    assert imu.gyro_rad_s[0, 2] == (1.0 if frame == "frd" else -1.0)
    assert any(f"axes assumed {frame} (the accelerometer reads gravity" in text for text in problems)


@pytest.mark.parametrize("unit", ["rad", "deg", "mdeg"])
def test_euler_angles_in_frd_and_flu(tmp_path: Path, unit: str) -> None:
    """A nose turned 30 degrees right and 10 up, right side 5 down, told in either convention, is the same."""
    one = {"rad": radians(1), "deg": 1.0, "mdeg": 1000.0}[unit]
    right = written(
        tmp_path / "frd.csv",
        "t,roll,pitch,yaw\n" + rows(lambda i: f"{i * 10},{5 * one},{10 * one},{30 * one}"),
    )
    left = written(
        tmp_path / "flu.csv",
        "t,roll,pitch,yaw\n" + rows(lambda i: f"{i * 10},{5 * one},{-10 * one},{-30 * one}"),
    )
    columns = ColumnMap(euler=("roll", "pitch", "yaw"), euler_unit=unit)  # type: ignore[arg-type]
    frd = attitude_of(right, columns, "frd")
    np.testing.assert_allclose(
        frd.q_world_body[0], attitude_of(left, columns, "flu").q_world_body[0], atol=1e-9
    )
    expected = Rotation.from_euler("ZYX", [30, 10, 5], degrees=True).as_matrix()
    np.testing.assert_allclose(rotation(frd), expected, atol=1e-9)


def test_an_attitude_to_east_north_up(tmp_path: Path) -> None:
    """Level, nose north-east: in ENU a yaw of 45 degrees from east, in NED one of 45 from north; by hand."""
    half = radians(45) / 2
    path = written(
        tmp_path / "a.csv", "t,qw,qx,qy,qz\n" + rows(lambda i: f"{i * 10},{cos(half)},0,0,{sin(half)}")
    )
    ned = rotation(attitude_of(path, None, "enu"))
    np.testing.assert_allclose(ned @ [1, 0, 0], [cos(2 * half), sin(2 * half), 0], atol=1e-9)  # forward
    np.testing.assert_allclose(ned @ [0, 0, 1], [0, 0, 1], atol=1e-9)  # down
    # East by north: 30 degrees from east towards north is 60 from north towards east.
    half = radians(30) / 2
    path = written(
        tmp_path / "b.csv", "t,qw,qx,qy,qz\n" + rows(lambda i: f"{i * 10},{cos(half)},0,0,{sin(half)}")
    )
    ned = rotation(attitude_of(path, None, "enu"))
    np.testing.assert_allclose(ned @ [1, 0, 0], [cos(radians(60)), sin(radians(60)), 0], atol=1e-9)


@pytest.mark.parametrize(
    ("frame", "expected"), [("ned", (1, 2, 3)), ("frd", (1, 2, 3)), ("flu", (1, -2, -3)), ("enu", (2, 1, -3))]
)
def test_positions_in_every_world(tmp_path: Path, frame: Frame, expected: tuple[float, ...]) -> None:
    path = written(
        tmp_path / "a.csv", "t;px [cm];py [cm];pz [cm]\n" + rows(lambda i: f"{i * 10};100;200;300")
    )
    found = open_columns(path, None, frame).position("position").value
    np.testing.assert_allclose(found.xyz[0], expected)


@pytest.mark.parametrize(
    ("frame", "expected"),
    [("frd", (1, 2, 3)), ("flu", (1, -2, -3)), ("ned", (2, -1, 3)), ("enu", (1, -2, -3))],
)
def test_velocities_of_body_and_world(tmp_path: Path, frame: Frame, expected: tuple[float, ...]) -> None:
    """Nose to the east: yaw 90 degrees from north (NED), none from east (ENU)."""
    yaw = 0.0 if frame == "enu" else 90.0
    path = written(
        tmp_path / "a.csv", "t,roll,pitch,yaw_deg,vx,vy,vz\n" + rows(lambda i: f"{i * 10},0,0,{yaw},1,2,3")
    )
    columns = ColumnMap(
        frame="flu" if frame == "flu" else "enu" if frame == "enu" else "frd",
        velocity_frame=frame,
        euler=("roll", "pitch", "yaw_deg"),
        euler_unit="deg",
        velocity=("vx", "vy", "vz"),
    )
    found = open_columns(path, columns).velocity("velocity").value
    np.testing.assert_allclose(found.xyz[0], expected, atol=1e-9)


def test_a_velocity_of_the_world_needs_an_attitude(tmp_path: Path) -> None:
    path = written(tmp_path / "a.csv", "t,vx,vy,vz\n" + rows(lambda i: f"{i * 10},1,2,3"))
    with pytest.raises(InputError, match=r"along the world's axes \(ned\).*use = false"):
        open_columns(path, None, "ned").velocity("velocity")


# ------------------------------------------------------------------------------------------- ready maps

TELLO = "timestamp,mid,x,y,z,mpry,pitch,roll,yaw,vgx,vgy,vgz,templ,temph,tof,h,bat,baro,time,agx,agy,agz\n"
STATE = (
    "mid:-1;x:0;y:0;z:0;mpry:0,0,0;pitch:10;roll:-5;yaw:90;vgx:3;vgy:-4;vgz:0;templ:60;temph:62;tof:80;h:70;"
)


def tello(i: int) -> str:
    state = '-1,0,0,0,"0,0,0",10,-5,90,3,-4,0,60,62,80,70,87,44.5'
    return f"{1612345678 + i / 10:.3f},{state},{i // 10},0.00,0.00,-998.00"


def check_tello(path: Path) -> None:
    log = open_log(path)
    assert log.format == "CSV (tello)"
    assert [topic.kind for topic in log.topics] == [Kind.ATTITUDE, Kind.VELOCITY, Kind.RANGE]  # no gyroscope
    attitude = log.attitude("attitude").value
    expected = Rotation.from_euler("ZYX", [90, 10, -5], degrees=True)
    np.testing.assert_allclose(rotation(attitude), expected.as_matrix(), atol=1e-9)
    # 0.3 m/s along the first axis of the world and 0.4 against the second; the nose points along the second.
    velocity = log.velocity("velocity").value
    np.testing.assert_allclose(velocity.xyz[0], expected.inv().apply([0.3, -0.4, 0.0]), atol=1e-9)
    assert attitude.t_ns[0] == 1_612_345_678_000_000_000
    assert attitude.t_ns[1] - attitude.t_ns[0] == 100_000_000
    np.testing.assert_allclose(log.range("range").value.distance_m, 0.8)


def test_tello_on_the_ground_and_out_of_reach(tmp_path: Path) -> None:
    far = {3: 10, 4: 6553, 5: 29, 6: 31}
    lines = rows(lambda i: tello(i).replace(",62,80,70,", f",62,{far.get(i, 80)},70,"))
    problems = Told()
    found = problems.take(open_log(written(tmp_path / "tello.csv", TELLO + lines)).range("range"))
    assert found.distance_m[3] == pytest.approx(0.31)
    np.testing.assert_allclose(np.delete(found.distance_m, 3), 0.8)
    assert "(range): 3 rows dropped: no distance within the sensor's reach" in problems[0]


@pytest.mark.parametrize(
    ("header", "value", "told"),
    [
        ("range_m", 1.4, False),
        ("tof_cm", 140, False),
        ("rangefinder (mm)", 1400, False),
        ("range", 1.4, True),
    ],
)
def test_distances_to_the_floor_by_name(tmp_path: Path, header: str, value: float, told: bool) -> None:
    log = open_log(
        written(tmp_path / "range.csv", f"time_ms,{header}\n" + rows(lambda i: f"{20 * i},{value}"))
    )
    assert [topic.kind for topic in log.topics] == [Kind.RANGE]
    np.testing.assert_allclose(log.range("range").value.distance_m, 1.4)
    assert any("no unit is given for range, m assumed" in text for text in log.problems) == told


@pytest.mark.parametrize("unit", [None, "rad/s", "deg/s"])
def test_a_unit_that_is_set_is_not_assumed(tmp_path: Path, unit: str | None) -> None:
    path = written(tmp_path / "imu.csv", "t_ns,gx,gy,gz\n" + rows(lambda i: f"{5_000_000 * i},0.1,0.2,0.3"))
    log = (
        open_log(path) if unit is None else open_columns(path, ColumnMap.model_validate({"gyro_unit": unit}))
    )
    assert any("no unit is given" in text for text in log.problems) == (unit is None)


def test_a_header_unit_that_is_not_known_is_read_by_the_one_that_is_set(tmp_path: Path) -> None:
    header = "t_ns,gx [furlong],gy [furlong],gz [furlong]\n"
    path = written(tmp_path / "imu.csv", header + rows(lambda i: f"{5_000_000 * i},10,20,30"))
    with pytest.raises(InputError, match="furlong, a unit that is not known"):
        open_log(path)
    read = imu_of(path, ColumnMap.model_validate({"gyro_unit": "deg/s"}), "frd")
    np.testing.assert_allclose(read.gyro_rad_s[0], np.radians([10.0, 20.0, 30.0]), atol=1e-9)


def test_distances_to_the_floor_by_a_map(tmp_path: Path) -> None:
    text = "t,d\n" + rows(lambda i: f"{0.02 * i:.2f},{400 if i == 3 else 140 + i}")
    columns = ColumnMap(time="t", time_unit="s", range="d", range_unit="cm", range_limits=(5.0, 399.0))
    found, problems = open_columns(written(tmp_path / "range.csv", text), columns).range("range")
    assert found.distance_m[0] == pytest.approx(1.4)
    assert found.distance_m[3] == pytest.approx(1.44)
    assert len(problems) == 1


def test_tello_state_as_csv(tmp_path: Path) -> None:
    check_tello(written(tmp_path / "tello.csv", TELLO + rows(tello)))


@pytest.mark.parametrize("between", [" ", ",", ";", ", "])
def test_tello_state_as_it_comes_over_the_network(tmp_path: Path, between: str) -> None:
    text = rows(
        lambda i: f"{1612345678 + i / 10:.3f}{between}{STATE}bat:87;baro:44.50;time:{i};agz:-998.00;\r"
    )
    check_tello(written(tmp_path / "state.txt", text))


def test_tello_state_without_a_time(tmp_path: Path) -> None:
    text = rows(lambda i: f"{STATE}bat:87;baro:44.50;time:{i // 10};agz:-998.00;", 60)
    with pytest.raises(
        InputError, match=r"times in column 'time' repeat: .*too coarse.*log the time of each row"
    ):
        open_log(written(tmp_path / "state.txt", text))


def test_ardrone_of_ros(tmp_path: Path) -> None:
    text = "%time,rotX,rotY,rotZ,altd,vx,vy,vz,ax,ay,az,tm\n"
    text += rows(lambda i: f"{T0 + i * 5_000_000},5,-10,-30,0,500,100,0,0,0,1,{5000 * i + 77}")
    log = open_log(written(tmp_path / "navdata.csv", text))
    assert log.format == "CSV (ardrone_ros)"
    attitude = log.attitude("attitude").value
    expected = Rotation.from_euler("ZYX", [30, 10, 5], degrees=True).as_matrix()  # FLU: y and z change sign
    np.testing.assert_allclose(rotation(attitude), expected, atol=1e-9)
    np.testing.assert_allclose(log.velocity("velocity").value.xyz[0], [0.5, -0.1, 0.0])
    assert attitude.t_ns[:2].tolist() == [77_000, 5_077_000]


def test_ardrone_of_its_own_sdk(tmp_path: Path) -> None:
    text = "time_ms,theta,phi,psi,altitude,vx,vy,vz\n" + rows(
        lambda i: f"{i * 5},10000,5000,30000,0,500,100,0"
    )
    log = open_log(written(tmp_path / "navdata.csv", text))
    expected = Rotation.from_euler("ZYX", [30, 10, 5], degrees=True).as_matrix()
    np.testing.assert_allclose(rotation(log.attitude("attitude").value), expected, atol=1e-9)
    np.testing.assert_allclose(log.velocity("velocity").value.xyz[0], [0.5, 0.1, 0.0])


# ------------------------------------------------------------------------------------------- names and shapes


@pytest.mark.parametrize(
    ("header", "unit"),
    [
        ("#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1]", 1.0),
        ("timestamp_ns,gyro_x,gyro_y,gyro_z", 1.0),
        ("timestamp_ns,gyro_x_dps,gyro_y_dps,gyro_z_dps", radians(1)),
        ("timestamp_ns,Gyro X (deg/s),Gyro Y (deg/s),Gyro Z (deg/s)", radians(1)),
        ("%time,field.angular_velocity.x,field.angular_velocity.y,field.angular_velocity.z", 1.0),
        ("t,wx [°/s],wy [°/s],wz [°/s]", radians(1)),
    ],
)
def test_usual_names_need_no_map(tmp_path: Path, header: str, unit: float) -> None:
    path = written(tmp_path / "a.csv", header + "\n" + rows(lambda i: f"{T0 + i * 5_000_000},1,2,3"))
    imu = imu_of(path, None, "frd")
    np.testing.assert_allclose(imu.gyro_rad_s[0], np.array([1, 2, 3]) * unit)
    assert imu.t_ns[0] == T0  # every digit


@pytest.mark.parametrize(
    "line",
    [
        "{t};0,5;1,5;-2,5",
        "{t},0.5,1.5,-2.5",
        "{t}\t0.5\t1.5\t-2.5",
        "{t}   0.5  1.5 -2.5",
        '"{t}","0.5","1.5","-2.5"',
    ],
    ids=["german", "comma", "tab", "blanks", "quoted"],
)
@pytest.mark.parametrize("header", [True, False])
def test_separators_decimal_commas_and_no_header(tmp_path: Path, line: str, header: bool) -> None:
    separator = next(s for s in (";", "\t", ",", " ") if s in line)
    text = (separator.join(["when", "x", "y", "z"]) + "\n") * header + rows(lambda i: line.format(t=i * 10))
    columns = ColumnMap(time="when", gyro=("x", "y", "z")) if header else ColumnMap(time=1, gyro=(2, 3, 4))
    imu = imu_of(written(tmp_path / "a.csv", text), columns, "frd")
    np.testing.assert_allclose(imu.gyro_rad_s, np.tile([0.5, 1.5, -2.5], (30, 1)))
    assert imu.t_ns[-1] == 290_000_000


def test_dates_are_times(tmp_path: Path) -> None:
    text = "datetime,roll,pitch,yaw\n" + rows(lambda i: f"2021-03-05 12:00:{i:02d}.250,0,0,0")
    assert attitude_of(written(tmp_path / "a.csv", text), None, "frd").t_ns[0] == 1_614_945_600_250_000_000
    text = "datetime,roll,pitch,yaw\n" + rows(lambda i: f"2021-03-05T13:00:{i:02d}.25+01:00,0,0,0")
    assert attitude_of(written(tmp_path / "b.csv", text), None, "frd").t_ns[0] == 1_614_945_600_250_000_000


@pytest.mark.parametrize("unit", ["ns", "us", "ms", "s"])
@pytest.mark.parametrize("start", [0, T0])
@pytest.mark.parametrize("step_s", [0.002, 0.005, 0.02, 0.1])
def test_the_unit_of_times_is_found(unit: str, start: int, step_s: float) -> None:
    ns = {"ns": 1, "us": 10**3, "ms": 10**6, "s": 10**9}[unit]
    t_ns = start + (np.arange(50) * step_s * 1e9).astype(np.int64)
    values = t_ns / ns if unit == "s" else t_ns // ns
    assert guess_unit(values) == unit
    assert np.abs(to_ns(values, unit) - t_ns).max() <= max(ns if unit != "s" else 1000, 1)


@given(st.lists(st.integers(-(2**61), 2**61), min_size=1, max_size=20, unique=True))
@settings(max_examples=50, deadline=None)
def test_whole_nanoseconds_keep_every_digit(values: list[int]) -> None:
    assert to_ns(np.array(values, dtype=np.int64), "ns").tolist() == values


# ------------------------------------------------------------------------------------------- damage


def test_damaged_rows_are_dropped_and_counted(tmp_path: Path) -> None:
    good = [f"{T0 + i * 5_000_000},1,2,3" for i in range(40)]
    bad = list(good)
    bad[3], bad[7], bad[20] = "what,is,this,row", f"{T0},1", "\0\0\0"[:0] + "x;y"
    path = written(tmp_path / "a.csv", "t,gx,gy,gz\n" + "\n".join(bad) + "\n")
    log = open_columns(path, None, "frd")
    assert len(log.imu("imu").value.t_ns) == 37
    assert any(
        text.startswith("a.csv: 3 rows damaged, dropped, the first is 'what,is,this") for text in log.problems
    )


def test_empty_fields_are_no_numbers(tmp_path: Path) -> None:
    text = "t,gx,gy,gz,ax,ay,az\n" + rows(lambda i: f"{i * 10},1,2,{'' if i == 4 else 3},,,")
    problems = Told()
    imu = problems.take(open_columns(written(tmp_path / "a.csv", text), None, "frd").imu("imu"))
    assert len(imu.t_ns) == 29
    assert any("1 row dropped: a missing or impossible gyro value" in text for text in problems)


def test_a_torn_end_costs_one_row(tmp_path: Path) -> None:
    text = "t,gx,gy,gz\n" + rows(lambda i: f"{i * 10},1.25,2.25,3.25")
    log = open_columns(written(tmp_path / "a.csv", text[:-4]), None, "frd")
    assert len(log.imu("imu").value.t_ns) == 29
    assert "a.csv: the last line is cut short, dropped" in log.problems


def test_cut_anywhere_it_reads_or_says_why(tmp_path: Path) -> None:
    text, said = TELLO + rows(tello, 6), []
    for end in range(0, len(text), 7):
        try:
            log = open_log(written(tmp_path / "cut.csv", text[:end]))
            for topic in log.topics:
                getattr(log, topic.kind.value)(topic.name)
        except InputError as error:
            said.append(str(error))
    assert said
    assert not any("\n" in text for text in said)


@given(st.binary(max_size=200))
@settings(max_examples=80, deadline=None)
def test_any_bytes_read_or_say_why(tmp_path_factory: pytest.TempPathFactory, data: bytes) -> None:
    path = tmp_path_factory.mktemp("bytes") / "a.csv"
    path.write_bytes(data)
    with suppress(InputError):  # and nothing else
        open_log(path)


@pytest.mark.parametrize(
    ("text", "columns", "message"),
    [
        ("", None, r"is empty"),
        ("a,b\n", None, r"has a header but no rows"),
        (
            "a,b,c\n1,2,3\n",
            None,
            r"its columns are not known by name: a, b, c \(name them in flight\.toml, as in",
        ),
        (
            "t,foo_x [rad/s],w_RS_S_y [rad/s],w_RS_S_z [rad/s],ax,ay,az\n1,2,3,4,5,6,7\n",
            None,
            r"has w_RS_S_y and w_RS_S_z of the gyroscope, but no column w_rs_s_x \(rename the column",
        ),
        (
            "t,gyro_x,gyro_y,gyro_z,acc_x_g,acc_y_g,foo_z\n1,2,3,4,5,6,7\n",
            None,
            r"has acc_x_g and acc_y_g of the accelerometer, but no column acc_z_g ",
        ),
        (
            "t,foo_x,foo_y,foo_z,ax,ay,az\n1,2,3,4,5,6,7\n",
            None,
            r"an accelerometer, but no known gyroscope: t, foo_x, .*\(name them in flight\.toml",
        ),
        (
            "1,2,3\n2,3,4\n",
            None,
            r"no header, .* its 3 columns .*numbers of the columns, from 1, .*gyro = \[2, 3, 4\]",
        ),
        ("a,gx,gy,gz\n1,2,3,4\n", None, r"has no column of time stamps: a, gx, gy, gz \(name it"),
        ("t,gx,gy,gz\n1,2,3,4\n", ColumnMap(gyro=("gx", "gy", "hz")), r"no column 'hz' .*did you mean gz\?"),
        (
            "t,gx,gy,gz\n1,2,3,4\n",
            ColumnMap(gyro=("gx", "gy", "blue")),
            r"no column 'blue' .*the columns are t, gx",
        ),
        (
            "1,2,3,4\n1,2,3,4\n",
            ColumnMap(gyro=("gx", "gy", "gz")),
            r"has no header.*\(give columns by number",
        ),
        (
            "t,gx\n1,2\n",
            ColumnMap(time=1, gyro=(2, 3, 4)),
            r"has 2 columns, none of number 3 \(columns\.gyro\)",
        ),
        (
            "t,gx,gy,gz\na,b,c,d\ne,f,g,h\n",
            ColumnMap(gyro=("gx", "gy", "gz")),
            r"column 't' contains no times, such as 'a'",
        ),
        ("t,x\n1,2\n", ColumnMap(time="t"), r"the column map names no data"),
        ("t,gx,gy,gz\n\0", None, r"is not a text file"),
    ],
)
def test_what_cannot_be_read_says_what_to_do(
    tmp_path: Path, text: str, columns: ColumnMap | None, message: str
) -> None:
    with pytest.raises(InputError, match=rf"a\.csv: .*{message}") as caught:
        open_columns(written(tmp_path / "a.csv", text), columns)
    assert caught.value.remedy


def test_long_files_are_read_in_blocks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rows across the borders of blocks are neither lost nor doubled."""
    monkeypatch.setattr("fusion.logs.csv.rows._BLOCK_CHARACTERS", 100)
    monkeypatch.setattr("fusion.logs.csv.rows._PIECE_ROWS", 3)
    lines = [f"{i * 10},{i},2,3" for i in range(200)]
    lines[77] = "broken"
    imu = imu_of(written(tmp_path / "a.csv", "t,gx,gy,gz\n" + "\n".join(lines) + "\n"), None, "frd")
    assert imu.gyro_rad_s[:, 0].tolist() == [i for i in range(200) if i != 77]


# ------------------------------------------------------------------------------------------- times of pictures


def test_times_of_pictures(tmp_path: Path) -> None:
    problems = Told()
    path = written(tmp_path / "t.csv", "name,time_s\n" + rows(lambda i: f"{i}.jpg,{i / 20}"))
    named = problems.take(read_times(path, None))
    assert named.names is not None
    assert named.names[2] == "2.jpg"
    assert named.t_ns[2] == 100_000_000
    path = written(tmp_path / "t.txt", "# timecode format v2\n" + rows(lambda i: f"{i * 33.333:.3f}"))
    plain = problems.take(read_times(path, None))
    assert plain.names is None
    assert plain.t_ns[1] == 33_333_000
    assert problems == ["t.txt: times assumed to be in milliseconds; set time_unit if they are not"]


def test_a_broken_row_keeps_the_numbers_of_the_others(tmp_path: Path) -> None:
    times = read_times(written(tmp_path / "t.csv", "time_ms\n0\n50\nbroken\n150\n"), None).value
    assert times.row.tolist() == [0, 1, 3]
    assert times.t_ns.tolist() == [0, 50_000_000, 150_000_000]


def test_layouts_are_found(tmp_path: Path) -> None:
    layout = read_layout(
        written(tmp_path / "a.csv", "# a remark\n# time [s];gyro x [deg/s]\n1,5;2,5\n2,5;3\n")
    )
    assert (layout.separator, layout.decimal_comma) == (";", True)
    assert layout.names == ("time", "gyro x")
    assert layout.units == ("s", "deg/s")


def test_the_streams_are_of_their_types(tmp_path: Path) -> None:
    text = "t,gx,gy,gz,qw,qx,qy,qz,px,py,pz,vx,vy,vz\n" + rows(
        lambda i: f"{i * 10},0,0,0,1,0,0,0,1,2,3,4,5,6"
    )
    log = open_columns(written(tmp_path / "a.csv", text), None, "frd")
    assert [topic.name for topic in log.topics] == ["imu", "attitude", "position", "velocity"]
    assert isinstance(log.position("position").value, VectorStream)
    assert log.camera("imu") is None
    with pytest.raises(InputError, match="carries no pictures"):
        log.frames("imu")


# ------------------------------------------------------------------------------------------- velocities by the pose

TURNS_S = np.arange(0.0, 12.0, 0.02)
YAW_RAD = 0.6 * np.sin(0.7 * TURNS_S) + 0.2 * TURNS_S
AHEAD_M_S = np.stack([0.8 * np.cos(YAW_RAD), 0.8 * np.sin(YAW_RAD), np.zeros_like(YAW_RAD)], axis=1)


def pose_csv(path: Path, velocity: np.ndarray, names: str = "vx,vy,vz", position: bool = True) -> Path:
    """A body x ahead, y left, z up that flies ahead at 0.8 m/s through turns, its pose in a world with z up."""
    p = np.concatenate([np.zeros((1, 3)), np.cumsum(AHEAD_M_S[:-1] * 0.02, axis=0)])
    q = np.stack([np.cos(YAW_RAD / 2), 0 * YAW_RAD, 0 * YAW_RAD, np.sin(YAW_RAD / 2)], axis=1)
    columns = [p, q, velocity] if position else [q, velocity]
    data = np.hstack(columns)
    head = "timestamp_ns," + ("px,py,pz," if position else "") + "qw,qx,qy,qz," + names
    lines = [f"{i * 20_000_000}," + ",".join(f"{v:.9g}" for v in row) for i, row in enumerate(data)]
    return written(path, "\n".join([head, *lines]) + "\n")


BODY_M_S = np.tile([0.8, 0.0, 0.0], (len(TURNS_S), 1))


@pytest.mark.parametrize("frame", [None, "flu", "enu"])
@pytest.mark.parametrize("names", ["v_RS_R_x [m s^-1],v_RS_R_y [m s^-1],v_RS_R_z [m s^-1]", "vx,vy,vz"])
def test_a_velocity_of_the_world_is_turned_into_the_body(
    tmp_path: Path, names: str, frame: Frame | None
) -> None:
    told = Told()
    log = open_columns(pose_csv(tmp_path / "gt.csv", AHEAD_M_S, names), None, frame)
    velocity = told.take(log.velocity("velocity"))
    np.testing.assert_allclose(velocity.xyz, np.tile([0.8, 0.0, 0.0], (len(velocity.xyz), 1)), atol=2e-3)
    assert frame == "enu" or any("along the world's axes" in text for text in told)


def test_a_velocity_of_the_body_beside_a_pose_stays_as_it_is(tmp_path: Path) -> None:
    velocity = open_log(pose_csv(tmp_path / "body.csv", BODY_M_S)).velocity("velocity").value
    np.testing.assert_allclose(velocity.xyz, BODY_M_S, atol=1e-9)


def test_a_velocity_that_may_be_either_is_asked_about_and_the_answers_work(tmp_path: Path) -> None:
    path = pose_csv(tmp_path / "open.csv", AHEAD_M_S, position=False)
    with pytest.raises(InputError, match=r'\[velocity\] frame = "frd" or "flu" of the body, "ned" or "enu"'):
        open_log(path).velocity("velocity")
    world = open_columns(path, None, "enu").velocity("velocity").value
    np.testing.assert_allclose(world.xyz[::50], BODY_M_S[::50], atol=2e-3)
    body = open_columns(path, None, "frd").velocity("velocity").value
    np.testing.assert_allclose(body.xyz, AHEAD_M_S, atol=1e-6)
    sure = ColumnMap(velocity_frame="frd")
    np.testing.assert_allclose(open_columns(path, sure).velocity("velocity").value.xyz, AHEAD_M_S, atol=1e-6)


# ------------------------------------------------------------------------------------------- as people have them


def turning(i: int) -> str:
    return f"0.1,0.2,{0.01 * i:.2f},0,0,9.8"


@pytest.mark.parametrize(
    ("style", "start_ns"),
    [
        ("%Y-%m-%dT%H:%M:%S.%fZ", 1_600_001_000_000_000_000),
        ("%Y-%m-%d %H:%M:%S.%f", 1_600_001_000_000_000_000),
        ("%Y/%m/%d %H:%M:%S.%f", 1_600_001_000_000_000_000),
        ("%d.%m.%Y %H:%M:%S.%f", 1_600_001_000_000_000_000),
        ("%Y-%m-%dT%H:%M:%S.%f+02:00", 1_599_993_800_000_000_000),
        ("%H:%M:%S.%f", 45_800_000_000_000),
    ],
)
@pytest.mark.parametrize("separator", [",", ";", "\t"])
def test_dates_as_they_are_written(tmp_path: Path, style: str, start_ns: int, separator: str) -> None:
    first = datetime(2020, 9, 13, 12, 43, 20, tzinfo=UTC)
    lines = [
        f"{(first + timedelta(milliseconds=10 * i)).strftime(style)},{turning(i)}".replace(",", separator)
        for i in range(30)
    ]
    head = "time,gx,gy,gz,ax,ay,az".replace(",", separator)
    imu = imu_of(written(tmp_path / "a.csv", "\n".join([head, *lines]) + "\n"))
    np.testing.assert_array_equal(imu.t_ns, start_ns + 10_000_000 * np.arange(30))


def test_a_date_apart_by_a_blank_among_columns_apart_by_blanks(tmp_path: Path) -> None:
    """As KITTI writes it, nine digits behind the second."""
    text = "time gx gy gz\n" + rows(lambda i: f"2011-09-26 13:02:25.{100 + 10 * i}389445 0 0 {i}", 20)
    imu = imu_of(written(tmp_path / "a.csv", text))
    assert imu.t_ns[0] == 1_317_042_145_100_389_445
    assert set(np.diff(imu.t_ns).tolist()) == {10_000_000}


def test_a_time_of_day_goes_on_past_midnight(tmp_path: Path) -> None:
    times = [f"23:59:59.{i}00" for i in range(5, 10)] + [f"00:00:00.{i}00" for i in range(5)]
    text = "time,gx,gy,gz\n" + "".join(f"{t},0,0,{i}\n" for i, t in enumerate(times))
    assert np.diff(imu_of(written(tmp_path / "a.csv", text)).t_ns).tolist() == [100_000_000] * 9


def test_an_ambiguous_date_is_named_with_its_column(tmp_path: Path) -> None:
    text = "when,time,gx,gy,gz\n" + rows(lambda i: f"x,9/3/2020 12:43:{i:02},0,0,{i}")
    with pytest.raises(InputError, match=r"column 'time' contains no times, such as '9/3/2020 12:43:00'"):
        imu_of(written(tmp_path / "a.csv", text))


@pytest.mark.parametrize(("size", "name"), [(1 << 32, "time_us"), (1 << 16, "time_ms")])
def test_counters_that_start_over_go_on(tmp_path: Path, size: int, name: str) -> None:
    step = 5000 if name == "time_us" else 5
    text = f"{name},gx,gy,gz\n" + rows(lambda i: f"{(size - 50 * step + i * step) % size},0,0,{i}", 200)
    log = open_columns(written(tmp_path / "a.csv", text))
    told = Told()
    imu = told.take(log.imu("imu"))
    assert set(np.diff(imu.t_ns).tolist()) == {5_000_000}
    assert len(imu.t_ns) == 200
    assert not any("clock" in text for text in told)


def test_a_header_behind_a_hash_and_a_comma_at_the_end_of_each_row(tmp_path: Path) -> None:
    text = "#timestamp [ns],gx [rad/s],gy [rad/s],gz [rad/s],ax,ay,az\n"
    imu = imu_of(
        written(tmp_path / "a.csv", text + rows(lambda i: f"{T0 + i * 10_000_000},{turning(i)},")),
        None,
        "flu",
    )
    assert len(imu.t_ns) == 30
    np.testing.assert_allclose(imu.gyro_rad_s[10], [0.1, -0.2, -0.1])


def test_names_of_uzh_fpv(tmp_path: Path) -> None:
    head = "# id timestamp ang_vel_x ang_vel_y ang_vel_z lin_acc_x lin_acc_y lin_acc_z\n"
    line = "{} {} 0.1 0.2 0.3 0 0 9.8"
    path = written(
        tmp_path / "imu.txt", head + rows(lambda i: line.format(i, f"{1540821844.5 + i * 0.002:.6f}"))
    )
    imu = open_log(path).imu("imu").value
    np.testing.assert_allclose(imu.gyro_rad_s[0], [0.1, -0.2, -0.3])
    assert imu.t_ns[0] == 1_540_821_844_500_000_000


@pytest.mark.parametrize(
    "head", ["", "# timestamp tx ty tz qx qy qz qw\n", "timestamp tx ty tz qx qy qz qw\n"]
)
@pytest.mark.parametrize("covariances", ["", " 0.1" * 21])
def test_tum_trajectories(tmp_path: Path, head: str, covariances: str) -> None:
    if head and covariances:
        head = head.rstrip() + "".join(f" c{k}" for k in range(21)) + "\n"
    half = radians(15)
    text = head + rows(
        lambda i: f"{1e9 + i / 10:.6f} {i} 2 3 0 0 {sin(half):.9f} {cos(half):.9f}{covariances}"
    )
    log = open_log(written(tmp_path / "a.txt", text))
    assert [topic.kind for topic in log.topics] == [Kind.ATTITUDE, Kind.POSITION]
    np.testing.assert_allclose(log.attitude("attitude").value.q_world_body[0], [cos(half), 0, 0, sin(half)])
    np.testing.assert_allclose(log.position("position").value.xyz[5], [5, 2, 3])


def test_a_phones_file_of_one_sensor_is_known_by_its_name(tmp_path: Path) -> None:
    text = "time,seconds_elapsed,z,y,x\n" + rows(lambda i: f"{T0 + i * 10_000_000},{i / 100},3,2,1")
    log = open_columns(written(tmp_path / "Gyroscope.csv", text), None, "frd")
    assert [topic.kind for topic in log.topics] == [Kind.IMU]
    np.testing.assert_allclose(log.imu("imu").value.gyro_rad_s[0], [1, 2, 3])
    with pytest.raises(InputError, match="not known by name"):  # and no position
        open_columns(written(tmp_path / "Magnetometer.csv", text))


def test_excels_unicode_text(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    head = "timestamp_ns\tgx\tgy\tgz\n"
    path.write_text(head + rows(lambda i: f"{T0 + i * 10_000_000}\t1\t2\t3"), encoding="utf-16")
    np.testing.assert_allclose(imu_of(path, None, "frd").gyro_rad_s, [[1, 2, 3]] * 30)


def test_crazyflie(tmp_path: Path) -> None:
    names = (
        "timestamp,gyro.x,gyro.y,gyro.z,acc.x,acc.y,acc.z,stateEstimate.qw,stateEstimate.qx,stateEstimate.qy,"
        "stateEstimate.qz,stateEstimate.vx,stateEstimate.vy,stateEstimate.vz,range.zrange\n"
    )
    half = radians(45)  # nose along the world's y, where it flies
    path = written(
        tmp_path / "cf.csv",
        names + rows(lambda i: f"{5000 + 10 * i},0,0,90,0,0,1,{cos(half)},0,0,{sin(half)},0,0.5,0,1200"),
    )
    log = open_log(path)
    assert log.format == "CSV (crazyflie)"
    imu = log.imu("imu").value
    np.testing.assert_allclose(imu.gyro_rad_s[0], [0, 0, -radians(90)], atol=1e-12)
    np.testing.assert_allclose(imu.accel_m_s2[0], [0, 0, -G])
    np.testing.assert_allclose(log.velocity("velocity").value.xyz[0], [0.5, 0, 0], atol=1e-12)
    np.testing.assert_allclose(log.range("range").value.distance_m, 1.2)


# ------------------------------------------------------------------------------------------- Betaflight


@pytest.mark.parametrize("of", ["blackbox_decode", "Explorer"])
def test_betaflights_blackbox(tmp_path: Path, of: str) -> None:
    """As the two tools write it: microseconds, degrees/s, counts of 2048 to a g; z up at rest."""
    names = ["loopIteration", "time", "axisP[0]", "gyroADC[0]", "gyroADC[1]", "gyroADC[2]"]
    names += ["accSmooth[0]", "accSmooth[1]", "accSmooth[2]", "motor[0]"]
    if of == "Explorer":  # begins with the settings of the vehicle
        head = '"Product","Blackbox flight data recorder by Nicholas Sherlock"\n"gyro_scale","0x3f800000"\n'
        head += '"rates","70,70,70"\n"acc_1G","2048"\n' + ",".join(f'"{name}"' for name in names) + "\n"
    else:
        head = ", ".join("time (us)" if name == "time" else name for name in names) + "\n"
    lines = rows(lambda i: f"{i * 4},{71_000_000 + 2000 * i},3,0,-10,90,0,205,2048,1400")
    log = open_log(written(tmp_path / "LOG00001.01.csv", head + lines))
    (topic,) = log.topics
    imu = log.imu(topic.name).value
    assert imu.t_ns[0] == 71_000_000_000
    np.testing.assert_allclose(imu.gyro_rad_s[0], np.radians([0, 10, -90]))  # pitch up, to the left
    np.testing.assert_allclose(imu.accel_m_s2[0], np.array([0, -0.1, -1.0]) * 9.80665, rtol=2e-3)
    (said,) = (text for text in log.problems if "not read" in text)
    assert said.endswith("columns that are not read: loopIteration, axisP[0], motor[0]")


def test_topics_of_px4_as_ulog2csv_writes_them(tmp_path: Path) -> None:
    """A file per topic: microseconds since boot, FRD, an index after the names."""
    xyz = (0, 1, 2)
    names = [
        "timestamp",
        *(f"gyro_rad[{i}]" for i in xyz),
        "gyro_integral_dt",
        "accelerometer_timestamp_relative",
    ]
    names += [
        *(f"accelerometer_m_s2[{i}]" for i in xyz),
        "accelerometer_integral_dt",
        "accelerometer_clipping",
    ]
    lines = rows(lambda i: f"{92_000_000 + 4000 * i},0.01,-0.02,{0.1 * (i % 7)},4000,0,0.1,-0.2,-9.8,4000,0")
    path = written(tmp_path / "log_7_sensor_combined_0.csv", ",".join(names) + "\n" + lines)
    log = open_log(path)
    assert log.format == "CSV (px4)"
    assert not [text for text in log.problems if "assumed" in text]
    imu = log.imu(log.topics[0].name).value
    assert imu.t_ns[:2].tolist() == [92_000_000_000, 92_004_000_000]
    np.testing.assert_allclose(imu.gyro_rad_s[1], [0.01, -0.02, 0.1])
    np.testing.assert_allclose(imu.accel_m_s2[1], [0.1, -0.2, -9.8])
    names = ["timestamp", "timestamp_sample", *(f"q[{i}]" for i in range(4))]
    names += [*(f"delta_q_reset[{i}]" for i in range(4)), "quat_reset_counter"]
    lines = rows(lambda i: f"{92_000_000 + 20_000 * i},{91_999_000 + 20_000 * i},0.96,0,0,0.28,1,0,0,0,2")
    log = open_log(written(tmp_path / "log_7_vehicle_attitude_0.csv", ",".join(names) + "\n" + lines))
    attitude = log.attitude(log.topics[0].name).value
    assert attitude.t_ns[1] == 92_020_000_000
    np.testing.assert_allclose(attitude.q_world_body[0], [0.96, 0.0, 0.0, 0.28])


def test_counts_of_an_accelerometer_are_put_right_as_the_finding_says(tmp_path: Path) -> None:
    lines = rows(lambda i: f"{5_000_000 * i},0.01,0,{0.1 * (i % 7)},{i % 5},3,{-4096 + i % 3}", 400)
    path = written(tmp_path / "imu.csv", "timestamp_ns,gx,gy,gz,ax,ay,az\n" + lines)
    (finding,) = (f for f in inspect_path(path).findings if f.kind == "accel_unit")
    setting = re.search(r'set (accel_unit = "g/4096") in \[imu\.columns\]', finding.remedy)
    assert setting is not None
    manifest = written(tmp_path / "flight.toml", f'log = "imu.csv"\n[imu.columns]\n{setting[1]}\n')
    assert not [f for f in inspect_path(manifest).findings if f.kind == "accel_unit"]


HEADER = "t_ns,gx [{0}],gy [{0}],gz [{0}],ax [m/s^2],ay [m/s^2],az [m/s^2]\n"


@pytest.mark.parametrize("unit", ["rev/s", "rps", "rpm", "turns/s", "deg/h", "urad/s", "LSB"])
def test_a_unit_that_is_not_known_is_refused(tmp_path: Path, unit: str) -> None:
    text = HEADER.format(unit) + rows(lambda i: f"{1_000_000_000 + 5_000_000 * i},0.1,0.2,0.3,0,0,-9.8")
    with pytest.raises(InputError, match=f"column gx is in {unit}, .*known are rad/s, deg/s") as refused:
        open_log(written(tmp_path / "imu.csv", text))
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("unit", ["rad/sec", "rad/second"])
def test_seconds_may_be_written_out(tmp_path: Path, unit: str) -> None:
    text = HEADER.format(unit) + rows(lambda i: f"{1_000_000_000 + 5_000_000 * i},0.1,0.2,0.3,0,0,-9.8")
    log = open_log(written(tmp_path / "imu.csv", text))
    assert not any("no unit is given" in problem for problem in log.problems)
