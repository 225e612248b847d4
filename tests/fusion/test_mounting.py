"""A sensor that sits askew: by hand, by the sample flight turned and turned back, and by a real robot's IMU."""

from __future__ import annotations

from dataclasses import replace
from math import pi, radians
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from fusion.cli import app as cli
from fusion.flight import AttitudeStream, ImuStream
from fusion.logs import load_flight, open_log
from fusion.logs.plausibility.findings import Advice
from fusion.logs.plausibility.flight import Streams, examine_streams
from fusion.logs.plausibility.mounting import mounted_attitude, mounted_imu, rotation
from tests.files import OFFICE, SHARED
from vision import InputError

HUSKY = SHARED / "logs" / "ros1" / "test1.bag"


def test_each_angle_by_hand() -> None:
    # the sensor's right side is turned down: what it calls right is the body's down
    np.testing.assert_allclose(rotation((pi / 2, 0.0, 0.0)) @ [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], atol=1e-12)
    # its nose is turned up: what it calls forward is the body's up
    np.testing.assert_allclose(rotation((0.0, pi / 2, 0.0)) @ [1.0, 0.0, 0.0], [0.0, 0.0, -1.0], atol=1e-12)
    # it is turned right: what it calls forward is the body's right
    np.testing.assert_allclose(rotation((0.0, 0.0, pi / 2)) @ [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], atol=1e-12)
    # FLU taken for FRD
    np.testing.assert_allclose(rotation((pi, 0.0, 0.0)), np.diag([1.0, -1.0, -1.0]), atol=1e-12)


ANGLE = st.floats(-6.2, 6.2)


@given(mount_rad=st.tuples(ANGLE, ANGLE, ANGLE), vector=st.tuples(ANGLE, ANGLE, ANGLE))
def test_a_sensor_turned_on_the_body_is_turned_back(
    mount_rad: tuple[float, float, float], vector: tuple[float, float, float]
) -> None:
    R = Rotation.from_euler("ZYX", mount_rad[::-1])
    np.testing.assert_allclose(rotation(mount_rad), R.as_matrix(), atol=1e-12)
    body = Rotation.from_rotvec(vector)
    read = np.roll((body * R).as_quat(), 1)[None]  # world from sensor
    back = mounted_attitude(AttitudeStream(np.zeros(1, np.int64), read), mount_rad).q_world_body[0]
    assert (Rotation.from_quat(np.roll(back, -1)).inv() * body).magnitude() < 1e-7
    imu = ImuStream(np.zeros(1, np.int64), R.inv().apply([vector]), R.inv().apply([vector]) * 2.0)
    np.testing.assert_allclose(mounted_imu(imu, mount_rad).gyro_rad_s[0], vector, atol=1e-12)
    np.testing.assert_allclose(mounted_imu(imu, mount_rad).accel_m_s2[0], 2.0 * np.array(vector), atol=1e-12)


def test_a_manifest_mounts_imu_and_attitude(tmp_path: Path) -> None:
    manifest = tmp_path / "flight.toml"
    lines = [f'log = "{OFFICE.as_posix()}"', "[imu]", "mount_rad = [0.0, 0.0, 0.1]"]
    manifest.write_text("\n".join([*lines, "[attitude]", "mount_rad = [0.0, 0.0, 0.1]"]))
    plain, turned = load_flight(OFFICE), load_flight(manifest)
    assert plain.imu is not None
    assert turned.imu is not None
    np.testing.assert_allclose(turned.imu.gyro_rad_s, mounted_imu(plain.imu, (0.0, 0.0, 0.1)).gyro_rad_s)
    assert plain.attitude is not None
    assert turned.attitude is not None
    expected = mounted_attitude(plain.attitude, (0.0, 0.0, 0.1))
    np.testing.assert_allclose(turned.attitude.q_world_body, expected.q_world_body)
    manifest.write_text(lines[0] + "\n[imu]\nmount_rad = [90, 0, 0]\n")
    with pytest.raises(InputError, match=r"imu.mount_rad.*90.* less than or equal to 6.2832"):
        load_flight(manifest)


def test_an_imu_said_to_hang_upside_down_that_does_not_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    manifest = tmp_path / "flight.toml"
    manifest.write_text(f'log = "{OFFICE.as_posix()}"\n[imu]\nmount_rad = [3.14159, 0.0, 0.0]\n')
    with pytest.raises(SystemExit) as end:
        cli.main(["fuse", str(manifest), "-o", str(tmp_path / "out")])
    assert end.value.code == 2
    assert not (tmp_path / "out").exists()
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "gravity reads +9.9 along z and the gyroscope's y and z turn against the attitude" in error


def test_the_robots_imu_is_noticed_and_put_right() -> None:
    """robot_localization's own launch file mounts this IMU with yaw -90, roll 90 degrees in FLU."""
    pytest.importorskip("rosbags")
    if not HUSKY.exists():
        pytest.skip("the shared logs are not here")
    log = open_log(HUSKY)
    imu, attitude = log.imu("/imu/data").value, log.attitude("/imu/data").value
    _, found = examine_streams(Streams(imu=imu, attitude=attitude), Advice())
    assert [(f.kind, f.text[:28]) for f in found] == [
        ("imu_axes", "gravity reads -9.8 along y i"),
        ("attitude_axes", "the vehicle lies on its side"),
    ]
    mount_rad = (radians(90), 0.0, radians(90))
    put_right = Streams(imu=mounted_imu(imu, mount_rad), attitude=mounted_attitude(attitude, mount_rad))
    assert examine_streams(put_right, Advice())[1] == []
    forgotten = replace(put_right, attitude=attitude)
    assert "imu_axes" in [f.kind for f in examine_streams(forgotten, Advice())[1]]
