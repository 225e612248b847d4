"""IMU and camera whose common axes are not the vehicle's: found, told, set by hand, and left alone where unclear."""

from __future__ import annotations

import shutil
from math import radians
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from fusion.flight import Flight, FloatArray
from fusion.inspection.sources import inspect_path
from fusion.logs import load_flight
from fusion.logs.plausibility.imu import Gravity
from fusion.logs.plausibility.mounting import rotation
from fusion.logs.plausibility.rig import find_body_from_imu, sentence
from tests.files import OFFICE, written
from vision import Camera, InputError

FLU = np.diag([1.0, -1.0, -1.0])
EUROC = np.array([[0.0, 0.0, 1.0], [0.0, -1.0, 0.0], [1.0, 0.0, 0.0]])  # its IMU: x up, y right, z ahead
LEFT = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # x right, y ahead, z up


def turned_office(folder: Path, R_imu_flu: FloatArray, body: str | None) -> Path:
    """Write the sample flight as a rig would record it whose IMU stands otherwise, the camera calibrated to it."""
    office, mav0 = load_flight(OFFICE), folder / "mav0"
    assert office.imu is not None
    (mav0 / "cam0").mkdir(parents=True)
    (mav0 / "cam0" / "data").symlink_to(OFFICE / "mav0" / "cam0" / "data")
    shutil.copy(OFFICE / "mav0" / "cam0" / "data.csv", mav0 / "cam0")
    pose = np.eye(4)
    pose[:3, :3] = R_imu_flu @ FLU @ office.camera.R_body_camera
    lines = (OFFICE / "mav0" / "cam0" / "sensor.yaml").read_text().splitlines()
    kept = "\n".join(
        line for line in lines if not line.startswith(("T_BS", "  cols", "  rows", "  data", " "))
    )
    numbers = ", ".join(f"{v:.15g}" for v in pose.ravel())
    written(mav0 / "cam0" / "sensor.yaml", f"{kept}\nT_BS:\n  cols: 4\n  rows: 4\n  data: [{numbers}]\n")
    gyro, accel = (values @ FLU @ R_imu_flu.T for values in (office.imu.gyro_rad_s, office.imu.accel_m_s2))
    rows = zip(office.imu.t_ns.tolist(), np.hstack([gyro, accel]).tolist(), strict=True)
    written(mav0 / "imu0" / "data.csv", "".join(f"{t}," + ",".join(map(repr, row)) + "\n" for t, row in rows))
    if body is not None:
        written(mav0 / "body.yaml", body)
    return folder


def check_is_the_office(flight: Flight) -> None:
    office = load_flight(OFFICE)
    assert flight.imu is not None
    assert office.imu is not None
    np.testing.assert_allclose(flight.imu.gyro_rad_s, office.imu.gyro_rad_s, atol=1e-4)
    np.testing.assert_allclose(flight.imu.accel_m_s2, office.imu.accel_m_s2, atol=1e-3)
    np.testing.assert_allclose(flight.camera.R_body_camera, office.camera.R_body_camera, atol=1e-4)


@pytest.mark.parametrize("body", ["%YAML:1.0\ncomment: any vehicle\n", "body_frame: flu\n", None])
@pytest.mark.parametrize("R_imu_flu", [EUROC, LEFT], ids=["euroc", "sideways"])
def test_a_folder_whose_imu_is_not_x_forward_works_as_it_is(
    tmp_path: Path, R_imu_flu: FloatArray, body: str | None
) -> None:
    folder = turned_office(tmp_path / "flight", R_imu_flu, body)
    flight = load_flight(folder)
    check_is_the_office(flight)
    (told,) = (text for text in flight.problems if "axes of IMU and camera are not the vehicle's" in text)
    assert told in inspect_path(folder).problems  # inspect proposes what fuse takes
    # What it says can be written down, and gives the same flight.
    setting = told[told.index("body_from_imu_rad") : told.index("] in flight.toml") + 1]
    manifest = written(tmp_path / "flight.toml", f'log = "flight"\n{setting}\n')
    by_hand = load_flight(manifest)
    check_is_the_office(by_hand)
    assert not any("axes of IMU and camera" in text for text in by_hand.problems)


def test_the_rotation_can_be_kept_out(tmp_path: Path) -> None:
    turned_office(tmp_path / "flight", EUROC, None)
    manifest = written(tmp_path / "flight.toml", 'log = "flight"\nbody_from_imu_rad = [0, 0, 0]\n')
    with pytest.raises(InputError, match="the IMU's axes are not the body's"):
        load_flight(manifest)


def test_the_vehicles_own_axes_are_left_alone() -> None:
    office = load_flight(OFFICE)
    assert office.manifest is not None
    assert office.manifest.body_from_imu_rad is None  # type: ignore[attr-defined]
    assert office.problems == ()


@given(
    quarters=st.tuples(*[st.integers(0, 3)] * 3),
    lean_deg=st.tuples(st.floats(-8, 8), st.floats(-8, 8)),
    pitch_deg=st.floats(-15, 15),
)
def test_any_rig_by_quarter_turns_is_found(
    quarters: tuple[int, int, int], lean_deg: tuple[float, float], pitch_deg: float
) -> None:
    """A camera that looks a little up or down, on a vehicle that leans a little in the usual."""
    R_body_imu = np.rint(
        Rotation.from_euler("ZYX", 90.0 * np.array(quarters[::-1]), degrees=True).as_matrix()
    )
    level = Rotation.from_euler("yx", lean_deg, degrees=True).apply([0.0, 0.0, -9.81])
    gravity = Gravity(R_body_imu.T @ level, 9.81)
    look = rotation((0.0, radians(pitch_deg), 0.0)) @ Camera.from_fov(64, 48, 1.2).R_body_camera
    camera = Camera(64, 48, 50.0, 50.0, 31.5, 23.5, R_body_camera=R_body_imu.T @ look)
    found = find_body_from_imu(gravity, camera)
    if found is None:  # it is upright, and looks ahead
        np.testing.assert_array_equal(R_body_imu, np.eye(3))
    else:
        np.testing.assert_allclose(rotation(found), R_body_imu, atol=1e-4)


def test_gravity_and_camera_that_contradict_each_other_tell_nothing() -> None:
    """Axes that are wrong for one of the two are not turned for both: an IMU in FLU that is read as FRD."""
    camera = Camera(64, 48, 50.0, 50.0, 31.5, 23.5)
    assert find_body_from_imu(Gravity(np.array([0.0, 0.0, 9.81]), 9.81), camera) is None
    assert find_body_from_imu(Gravity(np.array([9.81, 0.0, 0.0]), 9.81), camera) is None
    assumed = Camera(64, 48, 50.0, 50.0, 31.5, 23.5, mount_assumed=True)
    assert find_body_from_imu(Gravity(np.array([9.81, 0.0, 0.0]), 9.81), assumed) is None


@pytest.mark.parametrize("pitch_deg", [0.0, -8.0])
@pytest.mark.parametrize("phone", [True, False], ids=["phone on its side", "reversed on its side"])
def test_a_phone_needs_to_be_told_only_where_its_camera_looks(
    tmp_path: Path, phone: bool, pitch_deg: float
) -> None:
    """A phone's axes: x right and y up of its screen, z out of it; the camera looks out of its back."""
    office = load_flight(OFFICE)
    assert office.imu is not None
    # Held sideways its x points up or down; the vehicle's x is its -z. It looks down a little.
    side = 1.0 if phone else -1.0
    R_phone_flu = np.array([[0.0, 0.0, side], [0.0, side, 0.0], [-1.0, 0.0, 0.0]])
    R_phone = R_phone_flu @ FLU @ rotation((0.0, radians(pitch_deg), 0.0)).T @ FLU
    gyro, accel = (v @ FLU @ R_phone.T for v in (office.imu.gyro_rad_s, office.imu.accel_m_s2))
    rows = zip(office.imu.t_ns.tolist(), np.hstack([gyro, accel]).tolist(), strict=True)
    head = "timestamp_ns,gx,gy,gz,ax,ay,az\n"
    written(
        tmp_path / "imu.csv", head + "".join(f"{t}," + ",".join(map(repr, row)) + "\n" for t, row in rows)
    )
    written(
        tmp_path / "camera.yaml",
        "image_width: 640\nimage_height: 480\nK: [466.0, 0, 319.5, 0, 466.0, 239.5, 0, 0, 1]\nD: [0, 0, 0, 0, 0]\n"
        "distortion_model: plumb_bob\n",
    )
    table = (
        f'[camera]\nfile = "{OFFICE.as_posix()}"\ncalibration = "camera.yaml"\n[imu]\nfile = "imu.csv"\n'
        'camera_axis = "-z"\n'
    )
    flight = load_flight(written(tmp_path / "flight.toml", table))
    assert flight.imu is not None
    # Level is the usual attitude of the flight, half a degree from the office's own.
    np.testing.assert_allclose(flight.imu.gyro_rad_s, office.imu.gyro_rad_s, atol=0.06)
    assert np.rad2deg(np.arcsin(-flight.camera.R_body_camera[2, 2])) == pytest.approx(pitch_deg, abs=2.0)
    assert not flight.camera.mount_assumed
    assert any("axes of IMU and camera are not the vehicle's" in text for text in flight.problems)
    # A calibration with a pose is on the vehicle, as `corridor align` writes it.
    given = np.eye(4)
    given[:3, :3] = FLU @ flight.camera.R_body_camera
    pose = f"T_BS: [{', '.join(f'{v:.12g}' for v in given.ravel())}]\n"
    written(tmp_path / "camera.yaml", (tmp_path / "camera.yaml").read_text() + pose)
    posed = load_flight(tmp_path / "flight.toml").camera
    np.testing.assert_allclose(posed.R_body_camera, flight.camera.R_body_camera, atol=1e-9)
    written(tmp_path / "flight.toml", table.replace('"-z"', '"x"'))  # it looks up
    with pytest.raises(InputError, match="the IMU's axes are not the body's"):
        load_flight(tmp_path / "flight.toml")


@pytest.mark.parametrize("of_imu", [True, False], ids=["of the IMU", "of the vehicle"])
@pytest.mark.parametrize("R_imu_flu", [EUROC, LEFT], ids=["euroc", "sideways"])
def test_an_attitude_is_turned_where_it_is_of_the_imus_axes(
    tmp_path: Path, R_imu_flu: FloatArray, of_imu: bool
) -> None:
    folder = turned_office(tmp_path / "flight", R_imu_flu, None)
    office = load_flight(OFFICE).attitude
    assert office is not None
    world_body = Rotation.from_quat(np.roll(office.q_world_body, -1, axis=1))
    flu = Rotation.from_matrix(FLU)
    q = flu * world_body * flu  # to a world with z up
    q = q * Rotation.from_matrix(R_imu_flu).inv() if of_imu else q
    rows = zip(office.t_ns.tolist(), np.roll(q.as_quat(), 1, axis=1).tolist(), strict=True)
    text = "".join(f"{t}," + ",".join(map(repr, row)) + "\n" for t, row in rows)
    written(folder / "mav0" / "attitude0" / "data.csv", text)
    flight = load_flight(folder)
    assert flight.attitude is not None
    off = Rotation.from_quat(np.roll(flight.attitude.q_world_body, -1, axis=1)).inv() * world_body
    assert off.magnitude().max() < 1e-4


def test_a_rotation_is_printed_without_a_negative_zero() -> None:
    assert "roll, pitch, yaw of -90, 0, 90 degrees" in sentence((radians(-90), radians(-0.4), radians(90)))
