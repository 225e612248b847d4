"""ASL / EuRoC folders: conversions by hand, whole flights, and everything that can be wrong with a log."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import dataclass
from math import cos, degrees, radians, sin
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fusion.logs import load_flight, open_log
from fusion.logs.asl import read_ground_truth
from tests.files import HALLWAY, OFFICE
from tests.pictures import picture_paths
from vision import Attitude, Camera, InputError

T0 = 1_600_001_000_000_000_000
N_FRAMES = 8
IDENTITY = "data: [1,0,0,0, 0,1,0,0, 0,0,1,0, 0,0,0,1]"
SENSOR = """%YAML:1.0
T_BS:
  data: [0,0,1,0, -1,0,0,0, 0,-1,0,0, 0,0,0,1]
resolution: [16, 12]
camera_model: pinhole
intrinsics: [10.0, 10.0, 7.5, 5.5]
distortion_model: none
"""


def times(n: int, step_ns: int) -> list[int]:
    return [T0 + i * step_ns for i in range(n)]


def csv(header: str, t_ns: list[int], *values: object) -> str:
    return header + "".join(f"{t},{','.join(str(v) for v in values)}\n" for t in t_ns)


@dataclass
class Folder:
    """A small flight on disk, to be spoilt by a test."""

    path: Path

    def write(self, name: str, text: str) -> None:
        file = self.path / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text, encoding="utf-8", newline="")

    def read(self, name: str) -> str:
        return (self.path / name).read_text(encoding="utf-8")

    def edit(self, name: str, change: Callable[[list[str]], list[str]]) -> None:
        """Change a file's lines (without their breaks); line 0 is the header."""
        self.write(name, "".join(f"{line}\n" for line in change(self.read(name).splitlines())))


@pytest.fixture
def folder(tmp_path: Path) -> Folder:
    made = Folder(tmp_path / "flight")
    made.write("mav0/cam0/sensor.yaml", SENSOR)
    t_ns = times(N_FRAMES, 50_000_000)
    made.write("mav0/cam0/data.csv", "#timestamp [ns],filename\n" + "".join(f"{t},{t}.png\n" for t in t_ns))
    (made.path / "mav0/cam0/data").mkdir()
    picture = cv2.imencode(".png", np.full((12, 16), 99, np.uint8))[1].tobytes()
    for t in t_ns:
        (made.path / f"mav0/cam0/data/{t}.png").write_bytes(picture)
    made.write(
        "mav0/imu0/data.csv",
        csv(
            "#timestamp [ns],w_x,w_y,w_z,a_x,a_y,a_z\n", times(40, 10_000_000), 0.1, 0.2, 0.3, 1.0, 2.0, 9.81
        ),
    )
    made.write(
        "mav0/attitude0/data.csv",
        csv("#timestamp [ns],qw,qx,qy,qz\n", times(20, 20_000_000), 1.0, 0.0, 0.0, 0.0),
    )
    return made


# ---------------------------------------------------------------------------------------------- finding it


@pytest.mark.parametrize("inside", ["", "mav0", "mav0/../mav0"])
def test_flight_folder_or_mav0(folder: Folder, inside: str) -> None:
    flight = load_flight(str(folder.path / inside))
    assert flight.name == "flight"
    assert flight.problems == ()
    assert len(flight.frames.t_ns) == N_FRAMES
    assert flight.frames.t_ns.dtype == np.int64
    assert flight.frames.t_ns[1] == T0 + 50_000_000
    assert picture_paths(flight)[1].name == f"{T0 + 50_000_000}.png"
    assert picture_paths(flight)[1].is_file()
    assert flight.imu is not None
    assert len(flight.imu.t_ns) == 40
    assert flight.attitude is not None
    assert (flight.position, flight.velocity, flight.truth) == (None, None, None)


def test_what_is_no_flight(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"gone: there is no such file or folder \(check the path\)"):
        load_flight(tmp_path / "gone")
    with pytest.raises(
        InputError, match=r"is not a flight of a known format \(give a flight\.toml, ASL / EuRoC folder"
    ):
        load_flight(tmp_path)
    (tmp_path / "log.bin").write_bytes(b"x")
    with pytest.raises(InputError, match=r"log\.bin: is not a flight of a known format"):
        load_flight(tmp_path / "log.bin")


def test_a_folder_of_flights_names_one_of_them(folder: Folder) -> None:
    (folder.path.parent / "a.csv").write_text("t,gx,gy,gz\n1,2,3,4\n")
    with pytest.raises(InputError, match=rf"such as {folder.path}; `corridor batch {folder.path.parent}`"):
        load_flight(folder.path.parent)


def test_missing_parts(folder: Folder) -> None:
    sensor = folder.path / "mav0/cam0/sensor.yaml"
    sensor.unlink()
    with pytest.raises(InputError, match=r"sensor\.yaml: there is no such file \(add the calibration"):
        load_flight(folder.path)
    camera = Camera.from_fov(16, 12, 1.0)
    assert load_flight(folder.path, camera).camera is camera
    shutil.rmtree(folder.path / "mav0/cam0")
    with pytest.raises(
        InputError, match=r"without pictures; it contains .*imu0.*\(a flight needs cam0/data\.csv"
    ):
        load_flight(folder.path)


def test_streams_are_optional(folder: Folder) -> None:
    shutil.rmtree(folder.path / "mav0/imu0")
    (folder.path / "mav0/attitude0/data.csv").unlink()
    flight = load_flight(folder.path)
    assert flight.imu is None
    assert flight.attitude is None
    assert flight.problems == ("attitude0 has no data.csv, stream left out",)


@pytest.mark.parametrize("stream", ["imu0", "attitude0", "position0", "velocity0"])
def test_sensor_files_are_optional(folder: Folder, stream: str) -> None:
    folder.write("mav0/position0/data.csv", csv("", times(9, 50_000_000), 1.0, 2.0, 3.0))
    folder.write("mav0/velocity0/data.csv", csv("", times(9, 50_000_000), 1.0, 2.0, 3.0))
    folder.write(f"mav0/{stream}/sensor.yaml", f"sensor_type: x\nT_BS: {{{IDENTITY}}}\n")
    assert load_flight(folder.path).problems == ()
    folder.write(f"mav0/{stream}/sensor.yaml", f"T_BS: {{{IDENTITY.replace('1,0,0,0, 0', '2,0,0,0, 0')}}}\n")
    if stream == "position0":  # in the world already
        assert load_flight(folder.path).problems == ()
        return
    with pytest.raises(InputError, match=rf"{stream}/sensor\.yaml: T_BS's rotation is not a rotation"):
        load_flight(folder.path)


# ---------------------------------------------------------------------------------------------- conversions


def test_imu_flu_to_frd(folder: Folder) -> None:
    imu = load_flight(folder.path).imu
    assert imu is not None
    np.testing.assert_allclose(imu.gyro_rad_s, np.tile([0.1, -0.2, -0.3], (40, 1)))
    np.testing.assert_allclose(imu.accel_m_s2, np.tile([1.0, -2.0, -9.81], (40, 1)))
    assert (imu.gyro_noise_density, imu.gyro_random_walk) == (None, None)


def test_imu_already_frd(folder: Folder) -> None:
    folder.write("mav0/body.yaml", "body_frame: frd\n")
    folder.write("mav0/imu0/data.csv", csv("", times(40, 10_000_000), 0.1, 0.2, 0.3, 1.0, 2.0, -9.81))
    flight = load_flight(folder.path)
    assert flight.imu is not None
    np.testing.assert_allclose(flight.imu.gyro_rad_s[0], [0.1, 0.2, 0.3])
    np.testing.assert_allclose(flight.imu.accel_m_s2[0], [1.0, 2.0, -9.81])
    # The camera's T_BS, made for FLU, now has it look ahead but hang upside down.
    np.testing.assert_allclose(flight.camera.R_body_camera @ [0.0, 1.0, 0.0], [0.0, 0.0, -1.0])


def test_imu_turned_on_the_body(folder: Folder) -> None:
    """The IMU's x points to the body's left, its y backwards; z stays up."""
    folder.write("mav0/imu0/sensor.yaml", "T_BS: {data: [0,-1,0,0.3, 1,0,0,0, 0,0,1,0, 0,0,0,1]}\n")
    imu = load_flight(folder.path).imu
    assert imu is not None
    # (0.1 left, 0.2 back, 0.3 up) is (-0.2, 0.1, 0.3) in FLU and (-0.2, -0.1, -0.3) in FRD.
    np.testing.assert_allclose(imu.gyro_rad_s[0], [-0.2, -0.1, -0.3])
    np.testing.assert_allclose(imu.accel_m_s2[0], [-2.0, -1.0, -9.81])


def test_gyro_noise_is_read(folder: Folder) -> None:
    folder.write(
        "mav0/imu0/sensor.yaml", "gyroscope_noise_density: 1.6968e-04\ngyroscope_random_walk: 1.9393e-05\n"
    )
    imu = load_flight(folder.path).imu
    assert imu is not None
    assert (imu.gyro_noise_density, imu.gyro_random_walk) == (1.6968e-04, 1.9393e-05)
    for bad in ("-0.1", "true", "low", "[1, 2]", ".inf"):
        folder.write("mav0/imu0/sensor.yaml", f"gyroscope_noise_density: {bad}\n")
        with pytest.raises(
            InputError, match=r"sensor\.yaml: gyroscope_noise_density is .* \(give a positive"
        ):
            load_flight(folder.path)


@pytest.mark.parametrize("frame", ["flu", "frd"])
def test_attitude_signs(folder: Folder, frame: str) -> None:
    """Nose 30 degrees left and 10 up, right side 5 down."""
    z, y, x = {"flu": (30.0, -10.0, 5.0), "frd": (-30.0, 10.0, 5.0)}[frame]
    q = Rotation.from_euler("ZYX", [z, y, x], degrees=True).as_quat(scalar_first=True)
    folder.write("mav0/body.yaml", f"body_frame: {frame}\n")
    shutil.rmtree(folder.path / "mav0/imu0")
    folder.write("mav0/attitude0/data.csv", csv("", times(20, 20_000_000), *q))
    stream = load_flight(folder.path).attitude
    assert stream is not None
    attitude = Attitude.from_quaternion(stream.q_world_body[7])
    assert degrees(attitude.roll_rad) == pytest.approx(5.0)
    assert degrees(attitude.pitch_rad) == pytest.approx(10.0)
    yaw, _, _ = Rotation.from_quat(stream.q_world_body[7], scalar_first=True).as_euler("ZYX", degrees=True)
    assert yaw == pytest.approx(-30.0)


def test_attitude_sensor_turned_on_the_body(folder: Folder) -> None:
    """The same attitude told by a sensor that is yawed 90 degrees left on the body."""
    q_body = Rotation.from_euler("ZYX", [30.0, -10.0, 5.0], degrees=True)
    q_sensor = q_body * Rotation.from_rotvec([0.0, 0.0, 90.0], degrees=True)
    text = csv("", times(20, 20_000_000), *q_body.as_quat(scalar_first=True))
    folder.write("mav0/attitude0/data.csv", text)
    plain = load_flight(folder.path).attitude
    folder.write(
        "mav0/attitude0/data.csv", csv("", times(20, 20_000_000), *q_sensor.as_quat(scalar_first=True))
    )
    folder.write("mav0/attitude0/sensor.yaml", "T_BS: {data: [0,-1,0,0, 1,0,0,0, 0,0,1,0, 0,0,0,1]}\n")
    turned = load_flight(folder.path).attitude
    assert plain is not None
    assert turned is not None
    same = np.abs(np.einsum("ij,ij->i", plain.q_world_body, turned.q_world_body))  # q and -q are one rotation
    np.testing.assert_allclose(same, 1.0, atol=1e-12)


def test_position_and_velocity(folder: Folder) -> None:
    folder.write("mav0/position0/data.csv", csv("#t,x,y,z\n", times(9, 50_000_000), 1.0, 2.0, 3.0))
    folder.write("mav0/velocity0/data.csv", csv("#t,x,y,z\n", times(9, 50_000_000), 1.0, 2.0, 3.0))
    c, s = cos(radians(20.0)), sin(radians(20.0))  # the velocity sensor is yawed 20 degrees left
    folder.write(
        "mav0/velocity0/sensor.yaml", f"T_BS: {{data: [{c},{-s},0,0, {s},{c},0,0, 0,0,1,0, 0,0,0,1]}}"
    )
    flight = load_flight(folder.path)
    assert flight.position is not None
    assert flight.velocity is not None
    np.testing.assert_allclose(flight.position.xyz[0], [1.0, -2.0, -3.0])
    np.testing.assert_allclose(flight.velocity.xyz[0], [c - 2.0 * s, -(s + 2.0 * c), -3.0])


def test_distances_to_the_floor(folder: Folder) -> None:
    rows = [
        f"{t},{d}\n"
        for t, d in zip(times(9, 50_000_000), [1.4, "", "nan", 0, -1, "inf", 1.5, 1.6, 1.7], strict=True)
    ]
    folder.write("mav0/range0/data.csv", "#timestamp [ns],distance [m]\n" + "".join(rows))
    flight = load_flight(folder.path)
    assert flight.range is not None
    assert flight.range.distance_m.tolist() == [1.4, 1.5, 1.6, 1.7]
    assert flight.range.t_ns.tolist() == [times(9, 50_000_000)[i] for i in (0, 6, 7, 8)]
    assert any("range0/data.csv: 5 rows dropped: no distance" in text for text in flight.problems)


@pytest.mark.parametrize(("value", "said"), [(0.0, "no distance within"), (45.0, "no corridor is that high")])
def test_distances_that_cannot_be_leave_the_flight_without(folder: Folder, value: float, said: str) -> None:
    folder.write("mav0/range0/data.csv", csv("#t,d\n", times(9, 50_000_000), value))
    flight = load_flight(folder.path)
    assert flight.range is None
    assert any(said in text and "left out" in text for text in flight.problems)


def test_camera_file_in_place_of_the_log_s_own(folder: Folder, tmp_path: Path) -> None:
    """Its extrinsic means the body of this log, so that body.yaml counts wherever the file lies."""
    chain = tmp_path / "camchain.yaml"
    chain.write_text(
        "cam0:\n  camera_model: pinhole\n  distortion_model: none\n  intrinsics: [9, 9, 7, 5]\n"
        "  resolution: [16, 12]\n  T_cam_imu: [[0,1,0,0],[0,0,1,0],[1,0,0,0],[0,0,0,1]]\n",
        encoding="utf-8",
    )
    folder.write("mav0/body.yaml", "body_frame: frd\n")
    folder.write("mav0/imu0/data.csv", csv("", times(40, 10_000_000), 0.1, 0.2, 0.3, 1.0, 2.0, -9.81))
    flight = load_flight(folder.path, str(chain))
    assert flight.camera.fx_px == 9.0
    np.testing.assert_allclose(flight.camera.R_body_camera, [[0, 0, 1], [1, 0, 0], [0, 1, 0]])


# ---------------------------------------------------------------------------------------------- dirty streams


def test_bad_gyro_rows_are_dropped(folder: Folder) -> None:
    def spoil(lines: list[str]) -> list[str]:
        lines[3] = lines[3].replace("0.1,", "nan,")
        lines[6] = lines[6].replace("0.3,", "-inf,")
        lines[9] = lines[9].replace("0.2,", ",")
        return lines

    folder.edit("mav0/imu0/data.csv", spoil)
    flight = load_flight(folder.path)
    assert flight.imu is not None
    assert len(flight.imu.t_ns) == 37
    assert np.isfinite(flight.imu.gyro_rad_s).all()
    assert flight.problems == (
        f"imu0/data.csv: 3 rows dropped: a gyro value that is not finite (first at {T0 + 2 * 10_000_000})",
    )


def test_missing_acceleration_keeps_the_gyro(folder: Folder) -> None:
    folder.edit("mav0/imu0/data.csv", lambda lines: [*lines[:5], lines[5].replace("9.81", "nan"), *lines[6:]])
    flight = load_flight(folder.path)
    assert flight.imu is not None
    assert len(flight.imu.t_ns) == 40
    assert np.isnan(flight.imu.accel_m_s2[4]).all()
    assert np.isfinite(np.delete(flight.imu.accel_m_s2, 4, axis=0)).all()
    assert flight.problems == ("imu0/data.csv: 1 row without acceleration",)


def test_no_good_row_at_all(folder: Folder) -> None:
    folder.write("mav0/imu0/data.csv", csv("", times(40, 10_000_000), "nan", 0.2, 0.3, 1.0, 2.0, 9.81))
    with pytest.raises(InputError, match=r"imu0/data\.csv: every row has a gyro value that is not finite"):
        load_flight(folder.path)


@pytest.mark.parametrize("bad", ["0,0,0,0", "0.5,0,0,0", "nan,0,0,0", "1,1,0,0"])
def test_quaternions_that_are_none(folder: Folder, bad: str) -> None:
    folder.edit(
        "mav0/attitude0/data.csv", lambda lines: [*lines[:4], f"{lines[4].split(',')[0]},{bad}", *lines[5:]]
    )
    flight = load_flight(folder.path)
    assert flight.attitude is not None
    assert len(flight.attitude.t_ns) == 19
    np.testing.assert_allclose(np.linalg.norm(flight.attitude.q_world_body, axis=1), 1.0)
    assert flight.problems == (
        "attitude0/data.csv: 1 row dropped: a quaternion that is not of unit length "
        f"(first at {T0 + 3 * 20_000_000})",
    )


def test_rounded_quaternions_become_unit(folder: Folder) -> None:
    folder.write("mav0/attitude0/data.csv", csv("", times(20, 20_000_000), 0.97, 0.0, 0.0, 0.25))
    flight = load_flight(folder.path)
    assert flight.problems == ()
    assert flight.attitude is not None
    np.testing.assert_allclose(np.linalg.norm(flight.attitude.q_world_body, axis=1), 1.0)


def test_axes_taken_wrongly_are_refused(folder: Folder) -> None:
    """A log in FRD without a body.yaml: gravity and attitude show that FLU cannot be right."""
    folder.write("mav0/imu0/data.csv", csv("", times(40, 10_000_000), 0.1, 0.2, 0.3, 1.0, 2.0, -9.81))
    with pytest.raises(
        InputError, match=r"imu: gravity reads \+9\.8 along z instead of -9.8: axes look like FLU"
    ):
        load_flight(folder.path)
    shutil.rmtree(folder.path / "mav0" / "imu0")
    folder.write("mav0/attitude0/data.csv", csv("", times(20, 20_000_000), 0.0, 1.0, 0.0, 0.0))
    with pytest.raises(
        InputError, match=r"attitude: the vehicle is upside down most of the time, .*body_frame in"
    ):
        load_flight(folder.path)


def test_camera_that_looks_elsewhere_is_reported(folder: Folder) -> None:
    folder.write(
        "mav0/cam0/sensor.yaml", SENSOR.replace("0,0,1,0, -1,0,0,0, 0,-1,0,0", "1,0,0,0, 0,1,0,0, 0,0,1,0")
    )
    (problem,) = load_flight(folder.path).problems
    assert problem.startswith("the camera looks 90 degrees away from the body's x axis")


@pytest.mark.parametrize("stream", ["imu0", "attitude0"])
def test_clocks_that_never_meet(folder: Folder, stream: str) -> None:
    folder.edit(
        f"mav0/{stream}/data.csv",
        lambda lines: [
            lines[0],
            *(f"{i * 10_000_000},{line.split(',', 1)[1]}" for i, line in enumerate(lines[1:])),
        ],
    )
    with pytest.raises(
        InputError,
        match=rf"{stream}/data\.csv: covers 0.0 to .* s, the frames 2020-.*Unix time.*"
        "if both began together, set clock_offset_s",
    ):
        load_flight(folder.path)


# ---------------------------------------------------------------------------------------------- frames


def test_missing_pictures_stay_as_frames(folder: Folder) -> None:
    for i in (2, 5):
        (folder.path / f"mav0/cam0/data/{T0 + i * 50_000_000}.png").unlink()
    flight = load_flight(folder.path)
    assert len(picture_paths(flight)) == N_FRAMES
    assert flight.problems == (f"cam0/data.csv: 2 pictures missing in data/ (first {T0 + 100_000_000}.png)",)


def test_no_picture_at_all(folder: Folder) -> None:
    shutil.rmtree(folder.path / "mav0/cam0/data")
    with pytest.raises(
        InputError, match=r"data\.csv: none of its 8 pictures is in data/, such as .*\.png \(copy"
    ):
        load_flight(folder.path)


def test_times_from_picture_names(folder: Folder) -> None:
    listed = load_flight(folder.path).frames
    (folder.path / "mav0/cam0/data.csv").unlink()
    (folder.path / "mav0/cam0/data/thumb.png").write_bytes(b"x")
    (folder.path / "mav0/cam0/data/notes.txt").write_bytes(b"x")
    flight = load_flight(folder.path)
    np.testing.assert_array_equal(flight.frames.t_ns, listed.t_ns)
    assert picture_paths(flight) == picture_paths(listed)
    assert flight.problems == (
        "cam0/data.csv is missing: times taken from the names of 8 pictures",
        "cam0/data: 1 picture not named by a time left out (first thumb.png)",
    )


def test_names_in_the_order_of_numbers(folder: Folder) -> None:
    """9 s comes before 10 s, although "10..." sorts before "9..."."""
    data = folder.path / "mav0/cam0/data"
    picture = next(data.iterdir()).read_bytes()
    shutil.rmtree(data)
    data.mkdir()
    for second in (8, 9, 10, 11):
        (data / f"{second}000000000.png").write_bytes(picture)
    (folder.path / "mav0/cam0/data.csv").unlink()
    for stream in ("imu0", "attitude0"):
        shutil.rmtree(folder.path / "mav0" / stream)
    frames = load_flight(folder.path).frames
    assert frames.t_ns.tolist() == [8 * 10**9, 9 * 10**9, 10**10, 11 * 10**9]
    assert [path.stem for path in picture_paths(frames)] == [str(t) for t in frames.t_ns]


def test_neither_list_nor_names(folder: Folder) -> None:
    (folder.path / "mav0/cam0/data.csv").unlink()
    for path in (folder.path / "mav0/cam0/data").iterdir():
        path.rename(path.with_name(f"frame_{path.name}"))
    with pytest.raises(
        InputError, match=r"data\.csv: is missing, and no picture in data/ is named by its time"
    ):
        load_flight(folder.path)


def test_broken_rows_of_the_list(folder: Folder) -> None:
    def spoil(lines: list[str]) -> list[str]:
        lines[2] = "when,what.png"
        lines[4] = lines[4].split(",")[0] + ","
        return [*lines[:6], lines[6] + ",extra", *lines[7:]]

    folder.edit("mav0/cam0/data.csv", spoil)
    flight = load_flight(folder.path)
    assert len(flight.frames.t_ns) == N_FRAMES - 3
    assert flight.problems == (
        "cam0/data.csv: 3 rows not of time and name dropped, the first is 'when,what.png'",
    )


def test_list_shuffled_and_repeated(folder: Folder) -> None:
    clean = load_flight(folder.path).frames
    folder.edit(
        "mav0/cam0/data.csv", lambda lines: [lines[0], lines[3], lines[1], lines[2], lines[1], *lines[4:]]
    )
    flight = load_flight(folder.path)
    np.testing.assert_array_equal(flight.frames.t_ns, clean.t_ns)
    assert picture_paths(flight) == picture_paths(clean)
    assert flight.problems == (
        f"cam0/data.csv: times go backwards in 2 places (first at {T0}), rows sorted",
        f"cam0/data.csv: 1 row with a repeated time (first {T0}) dropped",
    )


def test_windows_line_ends_and_no_header(folder: Folder) -> None:
    clean = load_flight(folder.path)
    for name in ("mav0/cam0/data.csv", "mav0/imu0/data.csv"):
        folder.write(name, "\r\n".join(folder.read(name).splitlines()[1:]) + "\r\n")
    flight = load_flight(folder.path)
    assert flight.problems == ()
    assert picture_paths(flight) == picture_paths(clean)
    assert flight.imu is not None
    assert clean.imu is not None
    np.testing.assert_array_equal(flight.imu.gyro_rad_s, clean.imu.gyro_rad_s)


def test_columns_in_the_order_that_the_header_names(folder: Folder) -> None:
    clean = load_flight(folder.path)

    def moved(*order: int) -> Callable[[list[str]], list[str]]:
        return lambda rows: [",".join(row.split(",")[i] for i in order) for row in rows]

    folder.edit("mav0/imu0/data.csv", moved(0, 4, 5, 6, 1, 2, 3))
    folder.edit("mav0/attitude0/data.csv", moved(0, 2, 3, 4, 1))
    flight = load_flight(folder.path)
    assert flight.problems == ()
    assert flight.imu is not None
    assert clean.imu is not None
    assert flight.attitude is not None
    assert clean.attitude is not None
    np.testing.assert_array_equal(flight.imu.gyro_rad_s, clean.imu.gyro_rad_s)
    np.testing.assert_array_equal(flight.imu.accel_m_s2, clean.imu.accel_m_s2)
    np.testing.assert_array_equal(flight.attitude.q_world_body, clean.attitude.q_world_body)


@pytest.mark.parametrize(
    "change",
    [lambda row: '"' + row.replace(",", '","') + '"', lambda row: row.replace(",", ";").replace(".0", ",0")],
    ids=["quotes", "decimal commas"],
)
def test_quotes_and_other_separators_in_every_file(folder: Folder, change: Callable[[str], str]) -> None:
    clean = load_flight(folder.path)
    for name in ("cam0", "imu0", "attitude0"):
        folder.edit(f"mav0/{name}/data.csv", lambda rows: [rows[0], *(change(row) for row in rows[1:])])
    flight = load_flight(folder.path)
    assert flight.problems == ()
    assert picture_paths(flight) == picture_paths(clean)
    assert repr(flight) == repr(clean)
    np.testing.assert_array_equal(
        [topic.t_ns for topic in open_log(folder.path).topics if topic.name == "imu0"],
        [np.array(times(40, 10_000_000))],
    )


def test_pictures_of_another_size(folder: Folder) -> None:
    folder.write("mav0/cam0/sensor.yaml", SENSOR.replace("[16, 12]", "[32, 24]"))
    with pytest.raises(
        InputError, match=r"\.png: picture is 16x12, the camera's 32x24 \(give the calibration"
    ):
        load_flight(folder.path)


@pytest.mark.parametrize(
    ("size", "words"),
    [
        ("[20, 12]", "cut out of the larger ones"),
        ("[32, 24]", "rescale_calibration = true"),
        ("[32, 18]", "cut out of the larger ones"),
    ],
)
def test_the_remedy_for_another_size_is_that_of_a_cut_or_of_a_scaled_picture(
    folder: Folder, size: str, words: str
) -> None:
    folder.write("mav0/cam0/sensor.yaml", SENSOR.replace("[16, 12]", size))
    with pytest.raises(InputError, match="picture is 16x12") as caught:
        load_flight(folder.path)
    remedy = caught.value.remedy or ""
    assert words in remedy
    assert ("rescale_calibration" in remedy) == words.startswith("rescale")


def test_pictures_with_a_few_pixels_cut_off_are_not_taken_for_scaled_ones(folder: Folder) -> None:
    for path in (folder.path / "mav0/cam0/data").iterdir():
        path.write_bytes(cv2.imencode(".png", np.full((479, 639), 99, np.uint8))[1].tobytes())
    text = SENSOR.replace("[16, 12]", "[640, 480]").replace(
        "[10.0, 10.0, 7.5, 5.5]", "[466, 466, 319.5, 239.5]"
    )
    folder.write("mav0/cam0/sensor.yaml", text)
    with pytest.raises(
        InputError, match=r"639x479.*first column and row .* write resolution: \[639, 479\]\)"
    ):
        load_flight(folder.path)
    folder.write(
        "mav0/cam0/sensor.yaml", text.replace("319.5, 239.5", "318.5, 238.5").replace("640, 480", "639, 479")
    )
    assert load_flight(folder.path).camera.width_px == 639


@pytest.mark.parametrize(("focal", "name"), [("0.466, 0.466", "fx = 0.466"), ("10.0, 0.79", "fy = 0.79")])
def test_a_focal_length_that_is_not_in_pixels(folder: Folder, focal: str, name: str) -> None:
    folder.write("mav0/cam0/sensor.yaml", SENSOR.replace("10.0, 10.0", focal))
    with pytest.raises(
        InputError,
        match=rf"sensor\.yaml: the focal length {name} is not in pixels of a picture 16 wide \(give pixels",
    ):
        load_flight(folder.path)


def test_an_undecodable_first_picture_does_not_stop_the_check(folder: Folder) -> None:
    (folder.path / f"mav0/cam0/data/{T0}.png").write_bytes(b"torn")
    assert load_flight(folder.path).problems == ()
    folder.write("mav0/cam0/sensor.yaml", SENSOR.replace("[16, 12]", "[32, 24]"))
    with pytest.raises(InputError, match="picture is 16x12"):
        load_flight(folder.path)


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("", "is empty"),
        ("\n \n", "is empty"),
        ("#timestamp [ns],filename\n", "has a header but no rows"),
        ("#timestamp [ns],filename\n12.5,a.png\n12.6,b.png\n", r"timestamp 12.5 is not a whole number"),
        (f"{T0},a.png,1\n{T0 + 1},b.png,1\n", "has rows of 3 columns instead of 2"),
        (f"{T0}\n{T0 + 1}\n", "has rows of 1 column instead of 2"),
        ("one,a.png\ntwo,b.png\nthree,c.png\n", "has no row of time and file name"),
        ("".join(f"{50_000 * i},{i}.png\n" for i in range(9)), "50000 apart.*microseconds: multiply by 1000"),
    ],
)
def test_frame_lists_of_no_use(folder: Folder, text: str, match: str) -> None:
    folder.write("mav0/cam0/data.csv", text)
    with pytest.raises(InputError, match=rf"cam0/data\.csv: .*{match}") as caught:
        load_flight(folder.path)
    assert caught.value.remedy
    assert "\n" not in str(caught.value)


# ---------------------------------------------------------------------------------------------- truth


TRUTH = "timestamp_ns,heading_rad,lateral_offset_m,corridor_width_m,corridor_id,in_junction\n"


def test_corridor_truth_by_name_and_by_order(folder: Folder) -> None:
    folder.write("corridor_truth.csv", csv(TRUTH, times(9, 50_000_000), 0.1, -0.2, 2.2, 3, 1))
    truth = load_flight(folder.path / "mav0").truth
    assert truth is not None
    assert truth.heading_rad[0] == 0.1
    assert truth.lateral_offset_m[0] == -0.2
    assert truth.corridor_width_m[0] == 2.2
    assert truth.corridor_id.dtype == np.int64
    assert truth.corridor_id[0] == 3
    assert truth.in_junction.dtype == np.bool_
    assert truth.in_junction.all()
    other = "timestamp_ns,in_junction,note,corridor_id,heading_rad,lateral_offset_m,corridor_width_m\n"
    folder.write("corridor_truth.csv", csv(other, times(9, 50_000_000), 0, 7, 3, "", -0.2, 2.2))
    truth = load_flight(folder.path).truth
    assert truth is not None
    assert np.isnan(truth.heading_rad).all()
    assert truth.lateral_offset_m[0] == -0.2
    assert not truth.in_junction.any()


def test_corridor_truth_of_no_use(folder: Folder) -> None:
    folder.write("corridor_truth.csv", csv(TRUTH.replace("heading", "yaw"), times(9, 50_000_000), *[0.0] * 5))
    with pytest.raises(InputError, match=r"corridor_truth\.csv: has no column heading_rad"):
        load_flight(folder.path)
    folder.write("corridor_truth.csv", csv(TRUTH, times(9, 50_000_000), 0.1, 0.0, 2.2, "", 0))
    with pytest.raises(InputError, match=f"corridor_id or in_junction is missing at {T0}"):
        load_flight(folder.path)


# ---------------------------------------------------------------------------------------------- whole flights


def test_office_loads_whole() -> None:
    flight = load_flight(OFFICE)
    assert (flight.name, flight.problems) == ("office", ())
    assert flight.imu is not None
    assert flight.attitude is not None
    assert flight.truth is not None
    assert [len(s.t_ns) for s in (flight.frames, flight.imu, flight.attitude, flight.truth)] == [
        300,
        3001,
        751,
        3001,
    ]
    assert (flight.imu.gyro_noise_density, flight.imu.gyro_random_walk) == (0.005, 0.0001)
    assert all(path.is_file() for path in picture_paths(flight))


def test_office_gyro_turns_as_the_heading_does() -> None:
    """Integrated FRD gyro z against the truth: slope +1, but for the drift of its bias."""
    flight = load_flight(OFFICE)
    assert flight.imu is not None
    assert flight.truth is not None
    t_s = (flight.imu.t_ns - flight.imu.t_ns[0]) * 1e-9
    rate = flight.imu.gyro_rad_s[:, 2]
    turned = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(t_s))])
    heading = np.interp(flight.imu.t_ns, flight.truth.t_ns, flight.truth.heading_rad)
    columns = np.stack([heading, t_s, np.ones_like(t_s)], axis=1)
    slope, bias, _ = np.linalg.lstsq(columns, turned, rcond=None)[0]
    assert slope == pytest.approx(1.0, abs=0.01)
    assert np.corrcoef(turned - bias * t_s, heading)[0, 1] > 0.999


def test_office_gravity_and_attitude_have_the_right_signs() -> None:
    flight = load_flight(OFFICE)
    truth = read_ground_truth(OFFICE)
    assert flight.imu is not None
    assert flight.attitude is not None
    assert flight.truth is not None
    np.testing.assert_allclose(flight.imu.accel_m_s2.mean(axis=0), [0.0, 0.0, -9.81], atol=0.3)
    yaw, pitch, roll = Rotation.from_quat(truth.q_world_body, scalar_first=True).as_euler("ZYX").T
    np.testing.assert_allclose(yaw, flight.truth.heading_rad, atol=1e-8)
    np.testing.assert_allclose(truth.p_world_m[:, 1], flight.truth.lateral_offset_m, atol=1e-6)
    seen = [Attitude.from_quaternion(q) for q in flight.attitude.q_world_body]
    for angle, ahrs in ((roll, [a.roll_rad for a in seen]), (pitch, [a.pitch_rad for a in seen])):
        exact = np.interp(flight.attitude.t_ns, truth.t_ns, angle)
        assert np.polyfit(exact, ahrs, 1)[0] == pytest.approx(1.0, abs=0.1)
        assert np.degrees(np.abs(exact - ahrs).max()) < 1.5


def test_ground_truth_is_asked_for_by_name(folder: Folder) -> None:
    with pytest.raises(InputError, match=r"mav0: has no state_groundtruth_estimate0/data\.csv"):
        read_ground_truth(folder.path)


def test_the_real_flight_loads_whole() -> None:
    if not HALLWAY.exists():
        pytest.skip("the shared flights are not here")
    flight = load_flight(HALLWAY)
    assert (flight.name, flight.problems) == ("mononav_hallway", ())
    assert (flight.imu, flight.velocity, flight.truth) == (None, None, None)
    assert flight.attitude is not None
    assert flight.position is not None
    assert len(flight.frames.t_ns) == len(flight.attitude.t_ns) == len(flight.position.t_ns) == 91
    assert (np.diff(flight.frames.t_ns) > 0).all()
    # It turns about 65 degrees to the left on its way, so the yaw falls; and it flies above the floor.
    yaw = Rotation.from_quat(flight.attitude.q_world_body, scalar_first=True).as_euler("ZYX")[:, 0]
    assert degrees(np.unwrap(yaw)[75] - yaw[10]) == pytest.approx(-65.0, abs=15.0)
    assert (flight.position.xyz[:, 2] < 0.0).all()


def test_pictures_that_are_numbered_are_not_named_by_their_times(folder: Folder) -> None:
    data = folder.path / "mav0" / "cam0" / "data"
    (folder.path / "mav0" / "cam0" / "data.csv").unlink()
    for number, path in enumerate(sorted(data.iterdir())):
        path.rename(data / f"{number}.png")
    with pytest.raises(
        InputError, match=r"the pictures in data/ are numbered \(0\.png \.\.\.\), not named by"
    ):
        load_flight(folder.path)
