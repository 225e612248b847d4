"""Folders of public data sets: TUM RGB-D, UZH-FPV and KITTI, written small from the sample flight."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

import cv2
import numpy as np
import pytest

from fusion.flight import Flight, FloatArray
from fusion.logs import load_flight, open_log
from fusion.logs.contents import Kind
from tests.files import OFFICE, written
from vision import InputError

FLU = np.array([1.0, -1.0, -1.0])
N = 12


@pytest.fixture(scope="module")
def office() -> Flight:
    return load_flight(OFFICE)


def pictures(office: Flight, folder: Path, names: list[str]) -> None:
    folder.mkdir(parents=True)
    for i, name in enumerate(names):
        cv2.imwrite(str(folder / name), cv2.resize(office.frames.read(i), (160, 120)))


def imu_rows(office: Flight, n: int = 200) -> Iterator[tuple[int, FloatArray]]:
    assert office.imu is not None
    rows = np.hstack([office.imu.gyro_rad_s * FLU, office.imu.accel_m_s2 * FLU])[:n]
    return zip(office.imu.t_ns[:n].tolist(), rows, strict=True)


def seconds(t_ns: int) -> str:
    return f"{t_ns // 10**9}.{t_ns % 10**9:09d}"


def test_tum_rgbd(office: Flight, tmp_path: Path) -> None:
    t_ns = office.frames.t_ns[:N].tolist()
    pictures(office, tmp_path / "rgb", [f"{seconds(t)[:-3]}.png" for t in t_ns])
    lines = "".join(f"{seconds(t)[:-3]} rgb/{seconds(t)[:-3]}.png\n" for t in t_ns)
    written(tmp_path / "rgb.txt", "# color images\n# file: 'x.bag'\n# timestamp filename\n" + lines)
    written(tmp_path / "accelerometer.txt", "# timestamp ax ay az\n1.0 0 0 9.8\n")
    log = open_log(tmp_path)
    assert log.format == "TUM RGB-D folder"
    frames = log.frames("rgb").value
    np.testing.assert_allclose(frames.t_ns, t_ns, atol=1000)
    assert frames.read(3).shape == (120, 160)
    assert "accelerometer.txt: an accelerometer without gyroscope, left out" in log.problems


def test_uzh_fpv(office: Flight, tmp_path: Path) -> None:
    t_ns = office.frames.t_ns[:N].tolist()
    pictures(office, tmp_path / "img", [f"image_0_{k}.png" for k in range(N)])
    listed = "".join(f"{k} {seconds(t)} img/image_0_{k}.png\n" for k, t in enumerate(t_ns))
    written(tmp_path / "images.txt", "# id timestamp image_name\n" + listed)
    head = "# id timestamp ang_vel_x ang_vel_y ang_vel_z lin_acc_x lin_acc_y lin_acc_z\n"
    rows = "".join(
        f"{k} {seconds(t)} {' '.join(map(repr, row.tolist()))}\n"
        for k, (t, row) in enumerate(imu_rows(office))
    )
    written(tmp_path / "imu.txt", head + rows)
    log = open_log(tmp_path)
    assert [(topic.kind, topic.name) for topic in log.topics] == [(Kind.FRAMES, "images"), (Kind.IMU, "imu")]
    np.testing.assert_allclose(log.frames("images").value.t_ns, t_ns, atol=1000)
    imu = log.imu("imu").value
    assert office.imu is not None
    np.testing.assert_allclose(imu.gyro_rad_s, office.imu.gyro_rad_s[:200], atol=1e-12)
    alone = open_log(tmp_path / "img")  # the folder of the pictures finds the list beside it
    np.testing.assert_array_equal(alone.frames("pictures").value.t_ns, log.frames("images").value.t_ns)


def date(t_ns: int) -> str:
    return datetime.fromtimestamp(t_ns // 10**9, UTC).strftime("%Y-%m-%d %H:%M:%S.") + f"{t_ns % 10**9:09d}"


@pytest.fixture
def kitti(office: Flight, tmp_path: Path) -> Path:
    """A drive whose inertial navigation turns left at a yaw of 0.5 rad from east, rolled right side down."""
    t_ns = office.frames.t_ns[:N].tolist()
    pictures(office, tmp_path / "image_00" / "data", [f"{k:010d}.png" for k in range(N)])
    written(tmp_path / "image_00" / "timestamps.txt", "".join(date(t) + "\n" for t in t_ns))
    for k, (_, row) in enumerate(imu_rows(office, N)):
        angles, velocity = "0.1 -0.2 0.5", "0 0 1.5 0.2 0.1"
        gyro, accel = " ".join(map(repr, row[:3].tolist())), " ".join(map(repr, row[3:].tolist()))
        text = f"49.0 8.4 112.8 {angles} {velocity} {accel} 0 0 0 {gyro} 0 0 0 0.1 0.1 4 11 4 4 0\n"
        written(tmp_path / "oxts" / "data" / f"{k:010d}.txt", text)
    written(tmp_path / "oxts" / "timestamps.txt", "".join(date(t) + "\n" for t in t_ns))
    return tmp_path


def test_kitti(office: Flight, kitti: Path) -> None:
    log = open_log(kitti)
    assert log.format == "KITTI raw drive"
    np.testing.assert_array_equal(log.frames("image_00").value.t_ns, office.frames.t_ns[:N])
    imu = log.imu("oxts").value
    assert office.imu is not None
    np.testing.assert_allclose(imu.gyro_rad_s, office.imu.gyro_rad_s[:N], atol=1e-12)
    np.testing.assert_allclose(imu.accel_m_s2, office.imu.accel_m_s2[:N], atol=1e-12)
    np.testing.assert_allclose(log.velocity("oxts").value.xyz[0], [1.5, -0.2, -0.1])
    # Pitch positive nose down and yaw positive left there: nose up and right here, both negative there.
    from scipy.spatial.transform import Rotation

    q = log.attitude("oxts").value.q_world_body[0]
    np.testing.assert_allclose(
        Rotation.from_quat(np.roll(q, -1)).as_euler("ZYX"), [-0.5, 0.2, 0.1], atol=1e-12
    )
    # The folder of a camera, and that of its pictures, find the same times.
    for path in (kitti / "image_00", kitti / "image_00" / "data"):
        part = open_log(path)
        np.testing.assert_array_equal(part.frames(part.topics[0].name).value.t_ns, office.frames.t_ns[:N])


def test_numbered_pictures_are_asked_for_their_rate_and_it_works(kitti: Path, tmp_path: Path) -> None:
    (kitti / "image_00" / "timestamps.txt").unlink()
    data = kitti / "image_00" / "data"
    with pytest.raises(InputError, match=r"12 pictures are numbered \(0000000000\.png .*rate_hz = 20\)"):
        open_log(data)
    calibration = (OFFICE / "mav0" / "cam0" / "sensor.yaml").read_text().replace("[640, 480]", "[160, 120]")
    calibration = calibration.replace("[466.0, 466.0, 319.5, 239.5]", "[116.5, 116.5, 79.5, 59.5]")
    written(tmp_path / "cam.yaml", calibration)
    (data / "0000000004.png").unlink()
    table = f'[camera]\nfile = "{data.as_posix()}"\ncalibration = "cam.yaml"\nrate_hz = 20.0\n'
    flight = load_flight(written(tmp_path / "flight.toml", table))
    expected = np.delete(np.arange(N), 4) * 50_000_000  # the picture that is missing leaves its time
    np.testing.assert_array_equal(flight.frames.t_ns, expected)


def test_pictures_that_show_nothing_are_named(tmp_path: Path) -> None:
    (tmp_path / "dark").mkdir()
    for k in range(5):
        cv2.imwrite(str(tmp_path / "dark" / f"{k}.png"), np.full((120, 160), 3, np.uint8))
    calibration = (OFFICE / "mav0" / "cam0" / "sensor.yaml").read_text().replace("[640, 480]", "[160, 120]")
    written(
        tmp_path / "cam.yaml",
        calibration.replace("[466.0, 466.0, 319.5, 239.5]", "[116.5, 116.5, 79.5, 59.5]"),
    )
    table = '[camera]\nfile = "dark"\ncalibration = "cam.yaml"\nrate_hz = 20.0\n'
    problems = load_flight(written(tmp_path / "flight.toml", table)).problems
    assert any("the pictures are black" in text for text in problems)
