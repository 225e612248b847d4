"""ROS and OpenCV camera files, Kalibr's other fields and IMU noise: by hand, and through OpenCV itself."""

from __future__ import annotations

import json
from math import cos, isnan, radians, sin
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.files import ROOT, written
from vision import Camera, InputError
from vision.cameras.calibration import ImuNoise, read_imu_noise, read_time_shift_s
from vision.cameras.camera import Distortion
from vision.cameras.lens_check import lens_problem

FORWARD = [[0, 0, 1], [1, 0, 0], [0, 1, 0]]

# What camera_calibration of ROS writes; P is of the rectified picture and must not be taken for K.
ROS = """image_width: 640
image_height: 480
camera_name: head_camera
camera_matrix:
  rows: 3
  cols: 3
  data: [500.5, 0., 321.25, 0., 501.75, 238.5, 0., 0., 1.]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.28, 0.07, 0.0002, 1.8e-05, 0.01]
rectification_matrix:
  rows: 3
  cols: 3
  data: [1., 0., 0., 0., 1., 0., 0., 0., 1.]
projection_matrix:
  rows: 3
  cols: 4
  data: [400., 0., 330., 0., 0., 410., 240., 0., 0., 0., 1., 0.]
"""
# `rostopic echo -n 1 /camera_info`
ECHO = """header:
  seq: 3
  frame_id: "cam"
height: 480
width: 640
distortion_model: "rational_polynomial"
D: [0.1, -0.2, 0.001, 0.002, 0.03, 0.04, 0.05, 0.06]
K: [500.5, 0.0, 321.25, 0.0, 501.75, 238.5, 0.0, 0.0, 1.0]
R: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
P: [400.0, 0.0, 330.0, 0.0, 0.0, 410.0, 240.0, 0.0, 0.0, 0.0, 1.0, 0.0]
binning_x: 0
binning_y: 0
roi:
  x_offset: 0
  y_offset: 0
  height: 0
  width: 0
  do_rectify: False
---
"""


def check_pinhole(camera: Camera) -> None:
    assert (camera.width_px, camera.height_px) == (640, 480)
    assert (camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px) == (500.5, 501.75, 321.25, 238.5)


def test_ros_camera_info_gives_the_raw_picture(tmp_path: Path) -> None:
    camera = Camera.from_yaml(written(tmp_path / "camera.yaml", ROS))
    check_pinhole(camera)
    assert camera.distortion is Distortion.RADTAN
    assert camera.coefficients == (-0.28, 0.07, 0.0002, 1.8e-05, 0.01)
    assert isnan(camera.exposure_s)


@pytest.mark.parametrize("lower", [False, True], ids=["ROS 1", "ROS 2"])
def test_an_echoed_message(tmp_path: Path, lower: bool) -> None:
    text = ECHO
    for key in "DKRP":
        text = text.replace(f"\n{key}: ", f"\n{key.lower() if lower else key}: ")
    camera = Camera.from_yaml(written(tmp_path / "camera.yaml", text))
    check_pinhole(camera)
    assert camera.coefficients == (0.1, -0.2, 0.001, 0.002, 0.03, 0.04, 0.05, 0.06)


def test_an_equidistant_lens_of_ros(tmp_path: Path) -> None:
    text = ROS.replace("plumb_bob", "equidistant").replace(", 0.01]", "]")
    camera = Camera.from_yaml(written(tmp_path / "camera.yaml", text))
    assert camera.distortion is Distortion.EQUIDISTANT
    assert camera.coefficients == (-0.28, 0.07, 0.0002, 1.8e-05)


def test_an_equidistant_lens_without_coefficients_still_bends(tmp_path: Path) -> None:
    text = ROS.replace("plumb_bob", "equidistant").replace("[-0.28, 0.07, 0.0002, 1.8e-05, 0.01]", "[]")
    camera = Camera.from_yaml(written(tmp_path / "camera.yaml", text))
    ray = [sin(radians(40.0)), 0.0, cos(radians(40.0))]
    assert camera.project(ray)[0, 0] == pytest.approx(321.25 + 500.5 * radians(40.0))


def test_no_coefficients_are_no_distortion(tmp_path: Path) -> None:
    camera = Camera.from_yaml(
        written(
            tmp_path / "camera.yaml",
            ROS.replace("[-0.28, 0.07, 0.0002, 1.8e-05, 0.01]", "[]").replace("cols: 5", "cols: 0"),
        )
    )
    assert camera.distortion is Distortion.NONE


OPENCV_ROWS = """camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 466., 0., 319.5, 0., 466., 239.5, 0., 0., 1. ]
distortion_coefficients: !!opencv-nd-matrix
   sizes: [ 5 ]
   dt: d
   data: [ 0.1, 0.02, 0., 0., 0. ]
"""
OPENCV_YAML = f"%YAML 1.2\n---\nimage_width: 640\nimage_height: 480\n{OPENCV_ROWS}"
OPENCV_SIZE = "<image_width>640</image_width><image_height>480</image_height>"
OPENCV_XML = f"""<?xml version="1.0"?>
<opencv_storage>
{OPENCV_SIZE}
<cameraMatrix type_id="opencv-matrix">
  <rows>3</rows><cols>3</cols><dt>d</dt>
  <data>466. 0. 319.5 0. 466. 239.5 0. 0. 1.</data></cameraMatrix>
<distCoeffs type_id="opencv-nd-matrix">
  <sizes>
    5</sizes>
  <dt>d</dt>
  <data>0.1 0.02 0. 0. 0.</data></distCoeffs>
</opencv_storage>
"""


@pytest.mark.parametrize(("name", "text"), [("c.yml", OPENCV_YAML), ("c.xml", OPENCV_XML)])
def test_arrays_of_one_dimension_as_opencv_5_writes_them(tmp_path: Path, name: str, text: str) -> None:
    camera = Camera.from_yaml(written(tmp_path / name, text))
    assert (camera.width_px, camera.fx_px) == (640, 466.0)
    assert camera.coefficients == (0.1, 0.02, 0.0, 0.0, 0.0)


def test_the_remedy_for_a_missing_size_is_in_the_file_s_own_syntax(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"image_width is missing .*<image_width>640</image_width>"):
        Camera.from_yaml(written(tmp_path / "c.xml", OPENCV_XML.replace(OPENCV_SIZE, "")))


def test_a_file_without_extrinsic_says_that_straight_ahead_is_assumed(tmp_path: Path) -> None:
    camera = Camera.from_yaml(written(tmp_path / "camera.yaml", ROS))
    np.testing.assert_array_equal(camera.R_body_camera, FORWARD)
    assert camera.mount_assumed
    assert camera.resized(320, 240).mount_assumed
    problem = camera.mount_problem()
    assert problem is not None
    assert "does not say how the camera is mounted: taken as looking straight ahead" in problem


# A camera on a body in FLU, turned 25 degrees to the right and pitched 10 degrees down, 6 cm ahead, 2 cm left and
# 1 cm above its centre. By hand: right (-s, -c, 0), view (C c, -C s, -S), down = view x right; FRD negates y and z.
c, s, C, S = cos(radians(25)), sin(radians(25)), cos(radians(10)), sin(radians(10))
R_FLU_CAMERA = np.array([[-s, -c, 0.0], [-S * c, S * s, -C], [C * c, -C * s, -S]]).T
P_FLU = np.array([0.06, 0.02, 0.01])
VIEW_FRD, P_FRD = [C * c, C * s, S], [0.06, -0.02, -0.01]
T_BODY_CAMERA = np.block([[R_FLU_CAMERA, P_FLU[:, None]], [np.zeros((1, 3)), 1.0]])
T_CAMERA_BODY = np.block([[R_FLU_CAMERA.T, -R_FLU_CAMERA.T @ P_FLU[:, None]], [np.zeros((1, 3)), 1.0]])
KALIBR = """cam0:
  camera_model: pinhole
  distortion_coeffs: [0.1, 0.01, 0.0, 0.0]
  distortion_model: radtan
  intrinsics: [500.5, 501.75, 321.25, 238.5]
  resolution: [640, 480]
  timeshift_cam_imu: -0.0123
"""


def extrinsic(name: str) -> npt.NDArray[np.float64]:
    return T_CAMERA_BODY if name == "T_cam_imu" else T_BODY_CAMERA


@pytest.mark.parametrize("name", ["T_BS", "T_imu_cam", "T_cam_imu"])
@pytest.mark.parametrize("kind", ["ros", "kalibr"])
def test_which_way_each_extrinsic_runs(tmp_path: Path, name: str, kind: str) -> None:
    rows = extrinsic(name).tolist()
    text = ROS + f"{name}: {rows}\n" if kind == "ros" else KALIBR + f"  {name}: {rows}\n"
    camera = Camera.from_yaml(written(tmp_path / "camera.yaml", text))
    check_pinhole(camera)
    np.testing.assert_allclose(camera.R_body_camera[:, 2], VIEW_FRD, atol=1e-12)
    np.testing.assert_allclose(camera.p_body_camera_m, P_FRD, atol=1e-12)
    assert not camera.mount_assumed


def test_two_extrinsics_in_one_file_must_agree(tmp_path: Path) -> None:
    both = f"  T_cam_imu: {T_CAMERA_BODY.tolist()}\n  T_imu_cam: {{}}\n"
    path = written(tmp_path / "camera.yaml", KALIBR + both.format(T_BODY_CAMERA.tolist()))
    np.testing.assert_allclose(Camera.from_yaml(path).p_body_camera_m, P_FRD, atol=1e-12)
    written(tmp_path / "camera.yaml", KALIBR + both.format(T_CAMERA_BODY.tolist()))
    with pytest.raises(
        InputError, match=r"cam0.T_cam_imu and cam0.T_imu_cam place the camera differently"
    ) as e:
        Camera.from_yaml(path)
    assert e.value.file == path


def opencv_file(path: Path, coefficients: list[float], **more: float) -> Path:
    """A calibration as OpenCV's own sample writes it."""
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write("image_width", 640)
    storage.write("image_height", 480)
    for key, value in more.items():
        storage.write(key, value)
    storage.write("camera_matrix", np.array([[500.5, 0, 321.25], [0, 501.75, 238.5], [0, 0, 1]]))
    storage.write("distortion_coefficients", np.array([coefficients]).T)
    storage.write("avg_reprojection_error", 0.21)
    storage.release()
    return path


@pytest.mark.parametrize("name", ["camera.yaml", "camera.yml", "camera.json"])
@pytest.mark.parametrize("count", [4, 5, 8])
def test_what_opencv_writes_projects_as_opencv_does(tmp_path: Path, name: str, count: int) -> None:
    coefficients = [-0.28, 0.07, 2e-4, 1.8e-5, 0.01, 0.02, -0.01, 0.003][:count]
    camera = Camera.from_yaml(opencv_file(tmp_path / name, coefficients))
    check_pinhole(camera)
    assert camera.coefficients == tuple(coefficients)
    rays = np.array([[0.3, -0.2, 1.0], [-0.4, 0.1, 1.0], [0.0, 0.0, 1.0]])
    matrix = np.array([[500.5, 0, 321.25], [0, 501.75, 238.5], [0, 0, 1]])
    expected, _ = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), matrix, np.array(coefficients))
    np.testing.assert_allclose(camera.project(rays), expected[:, 0], atol=1e-9)


def test_opencvs_fisheye_projects_as_opencv_does(tmp_path: Path) -> None:
    coefficients = [-0.02, 0.01, -0.004, 0.001]
    camera = Camera.from_yaml(opencv_file(tmp_path / "camera.yml", coefficients, fisheye_model=1))
    assert camera.distortion is Distortion.EQUIDISTANT
    rays = np.array([[[0.9, -0.2, 1.0], [-0.4, 0.8, 1.0]]])
    matrix = np.array([[500.5, 0, 321.25], [0, 501.75, 238.5], [0, 0, 1]])
    expected, _ = cv2.fisheye.projectPoints(rays, np.zeros(3), np.zeros(3), matrix, np.array(coefficients))
    np.testing.assert_allclose(camera.project(rays[0]), expected[0], atol=1e-9)


def test_opencvs_plain_model_said_not_to_be_a_fisheye(tmp_path: Path) -> None:
    path = opencv_file(tmp_path / "camera.yml", [0.1, 0.05, 0.05, 0.01], fisheye_model=0)
    assert Camera.from_yaml(path).distortion is Distortion.RADTAN


@pytest.mark.parametrize("zeros", [4, 6])
def test_coefficients_beyond_eight_may_be_zero(tmp_path: Path, zeros: int) -> None:
    eight = [-0.28, 0.07, 2e-4, 1.8e-5, 0.01, 0.02, -0.01, 0.003]
    assert Camera.from_yaml(opencv_file(tmp_path / "a.yml", eight + [0.0] * zeros)).coefficients == tuple(
        eight
    )
    with pytest.raises(
        InputError, match=r"has 12 numbers instead of 4 or 5 or 8: thin prism and tilt are not"
    ):
        Camera.from_yaml(opencv_file(tmp_path / "b.yml", [*eight, 0.0, 0.0, 0.0, 0.001]))


@pytest.mark.parametrize(
    ("matrix", "coefficients", "size"),
    [
        ("camera_matrix", "distortion_coefficients", {"image_width": 640, "image_height": 480}),
        ("cameraMatrix", "distCoeffs", {"imageSize": [640, 480]}),
        ("Camera_Matrix", "Distortion_Coefficients", {"image_Width": 640, "image_Height": 480}),
        ("mtx", "dist", {"width": 640, "height": 480}),
        ("K", "D", {"image_size": [640, 480]}),
    ],
)
def test_names_that_people_use(
    tmp_path: Path, matrix: str, coefficients: str, size: dict[str, object]
) -> None:
    content = {
        matrix: [[500.5, 0.0, 321.25], [0.0, 501.75, 238.5], [0.0, 0.0, 1.0]],
        coefficients: [[-0.28, 0.07, 0.0002, 1.8e-05, 0.01]],
        **size,
    }
    camera = Camera.from_yaml(written(tmp_path / "calibration.json", json.dumps(content)))
    check_pinhole(camera)
    assert camera.coefficients == (-0.28, 0.07, 0.0002, 1.8e-05, 0.01)


@pytest.mark.parametrize("coefficients", ["[-0.02, 0.01, -0.004, 0.03]", "[-0.02, 0.01, -0.004, 0.001]"])
def test_four_coefficients_of_a_wide_lens_are_not_guessed_at(tmp_path: Path, coefficients: str) -> None:
    text = f"K: [250, 0, 320, 0, 250, 240, 0, 0, 1]\nD: {coefficients}\nimage_size: [640, 480]\n"
    with pytest.raises(
        InputError, match=r"no distortion_model; with a view of 104 degrees it may be a fisheye's"
    ):
        Camera.from_yaml(written(tmp_path / "camera.yaml", text))
    named = Camera.from_yaml(written(tmp_path / "camera.yaml", text + "distortion_model: equidistant\n"))
    assert named.distortion is Distortion.EQUIDISTANT


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        (
            "plumb_bob",
            "thin_prism",
            r"distortion_model is 'thin_prism' \(supported are plumb_bob, rational_pol",
        ),
        ("plumb_bob", "double_sphere", r"distortion_model is 'double_sphere' \(supported are plumb_bob"),
        ("plumb_bob", "equidistant", "has 5 numbers instead of 4 .the equidistant model takes k1 k2 k3 k4"),
        ("plumb_bob", "none", "though the model is none"),
        (", 0.01]", ", 0.01, 0.1, 0.1]", "distortion_coefficients has 7 numbers instead of 4 or 5 or 8"),
        ("data: [500.5", "data: [0.0", "camera_matrix is zero: the camera was never calibrated"),
        ("data: [500.5, 0.,", "data: [500.5, 9.,", r"camera_matrix is .* \(it must be \[fx, 0, cx\]"),
        ("0., 0., 1.]\nd", "0., 0., 2.]\nd", r"camera_matrix is .* \(it must be"),
        ("321.25", "1321.25", r"principal point \(1321.25, 238.5\) outside the resolution 640x480"),
        ("data: [500.5", "data: [-500.5", "camera_matrix has the focal length fu = -500.5"),
        ("data: [500.5", "data: [1., 500.5", "camera_matrix has 10 numbers instead of 9"),
        ("image_width: 640\n", "", r"image_width is missing \(add a line such as `image_width: 640`"),
        ("image_height: 480", "image_height: tall", "image_height is 'tall'"),
        ("image_height: 480", "image_height: 480.5", "in whole pixels"),
        ("camera_name: head_camera", "binning_x: 2", "binning_x is 2 .give the calibration of the pictures"),
        ("camera_name: head_camera", "roi: {width: 320, height: 480}", "roi cuts 320x480 out of 640x480"),
        ("camera_name: head_camera", "roi: {x_offset: 8}", "roi cuts 640x480 out of"),
        ("camera_name: head_camera", "exposure_s: 20", "exposure_s is 20"),
    ],
)
def test_what_is_wrong_in_a_camera_info_is_named(tmp_path: Path, old: str, new: str, match: str) -> None:
    assert old in ROS
    path = written(tmp_path / "camera.yaml", ROS.replace(old, new))
    with pytest.raises(InputError, match=match) as caught:
        Camera.from_yaml(path)
    assert caught.value.file == path
    assert caught.value.remedy
    assert "\n" not in str(caught.value)


def test_a_matrix_alone_is_not_enough(tmp_path: Path) -> None:
    text = "K: [500, 0, 320, 0, 500, 240, 0, 0, 1]\nimage_size: [640, 480]\n"
    with pytest.raises(InputError, match=r"distortion_coefficients is missing \(write zeros where"):
        Camera.from_yaml(written(tmp_path / "camera.yaml", text))
    assert (
        Camera.from_yaml(written(tmp_path / "camera.yaml", text + "D: [0, 0, 0, 0]\n")).distortion
        is Distortion.RADTAN
    )


def test_files_of_another_kind(tmp_path: Path) -> None:
    imu = written(tmp_path / "imu.yaml", "gyroscope_noise_density: 1.0e-3\nupdate_rate: 200\n")
    with pytest.raises(
        InputError, match=r"is not a camera calibration: it contains gyroscope_noise_density, update_rate"
    ):
        Camera.from_yaml(imu)
    with pytest.raises(
        InputError,
        match=r"give EuRoC sensor.yaml, Kalibr camchain.yaml, ROS camera_info \(YAML or INI\), a file of",
    ):
        Camera.from_yaml(written(tmp_path / "basalt.json", '{"value0": 1}'))
    with pytest.raises(InputError, match=r"is not valid JSON in line 2: Expecting"):
        Camera.from_yaml(written(tmp_path / "cut.json", '{"K": [1, 2],\n"D": [}'))
    with pytest.raises(InputError, match="does not contain a JSON object"):
        Camera.from_yaml(written(tmp_path / "list.json", "[1, 2]"))


@given(st.binary(max_size=300))
def test_bytes_that_are_no_calibration_are_refused(
    tmp_path_factory: pytest.TempPathFactory, data: bytes
) -> None:
    path = tmp_path_factory.mktemp("camera") / "camera.yaml"
    path.write_bytes(data)
    with pytest.raises(InputError):
        Camera.from_yaml(path)


@given(cut=st.integers(0, len(ROS) - 120))
def test_a_file_cut_anywhere_never_becomes_another_camera(
    tmp_path_factory: pytest.TempPathFactory, cut: int
) -> None:
    path = written(tmp_path_factory.mktemp("camera") / "camera.yaml", ROS[:cut])
    try:
        camera = Camera.from_yaml(path)
    except InputError as error:
        camera = None
        message = str(error)
    if camera is None:
        assert message.startswith(str(path))
        assert "\n" not in message
    else:
        check_pinhole(camera)
        assert camera.coefficients == (-0.28, 0.07, 0.0002, 1.8e-05, 0.01)


def test_the_time_shift_of_a_chain(tmp_path: Path) -> None:
    path = written(tmp_path / "camera.yaml", KALIBR)
    assert read_time_shift_s(path) == -0.0123
    assert read_time_shift_s(path, "cam1") is None
    assert read_time_shift_s(written(tmp_path / "camera.yaml", ROS)) is None
    assert (
        read_time_shift_s(
            written(tmp_path / "camera.yaml", KALIBR.replace("  timeshift_cam_imu: -0.0123\n", ""))
        )
        is None
    )
    with pytest.raises(InputError, match=r"cam0.timeshift_cam_imu is 'soon' \(give seconds\)"):
        read_time_shift_s(written(tmp_path / "camera.yaml", KALIBR.replace("-0.0123", "soon")))


@pytest.mark.parametrize(
    ("text", "shift_s"),
    [
        ('cam0_calib: "cam0.yaml"\ntd: 0.021\n', 0.021),  # VINS-Fusion: image clock + td = IMU clock
        ("cameras: []\nimageDelay: 0.03\n", -0.03),  # OKVIS
        ('{"value0": {"cam_time_offset_ns": 5000000}}', 0.005),  # Basalt
        ("td: 0.021\n", None),
    ],
)
def test_the_time_shift_of_slam_systems(tmp_path: Path, text: str, shift_s: float | None) -> None:
    found = read_time_shift_s(written(tmp_path / "camera.yaml", text))
    assert found == (None if shift_s is None else pytest.approx(shift_s))


NOISE = """accelerometer_noise_density: 0.02
accelerometer_random_walk: 1e-3
gyroscope_noise_density: 5e-3
gyroscope_random_walk: 0.0001
rostopic: /imu0
update_rate: 200.0
"""


def test_imu_noise_of_kalibr_and_of_the_sample_flight(tmp_path: Path) -> None:
    expected = ImuNoise(0.005, 0.0001, 0.02, 0.001, 200.0)
    assert read_imu_noise(written(tmp_path / "camera.yaml", NOISE)) == expected
    nested = "imu0:\n" + "".join(f"  {line}\n" for line in NOISE.splitlines()) + "  model: calibrated\n"
    assert read_imu_noise(written(tmp_path / "camera.yaml", nested)) == expected
    assert read_imu_noise(ROOT / "data" / "office" / "mav0" / "imu0" / "sensor.yaml") == expected


@pytest.mark.parametrize(
    ("text", "match"),
    [
        (NOISE.replace("5e-3", "-1"), r"gyroscope_noise_density is -1 \(give a positive number, or leave"),
        (NOISE.replace("200.0", "fast"), r"update_rate is 'fast' \(give samples a second\)"),
        (
            "type: IMU\nGyr: {unit: rad/s}\n",
            r"declares no IMU noise: it contains type, Gyr \(give Kalibr's imu.yaml",
        ),
        ("imu0:\n  gyroscope_noise_density: .nan\n", "imu0.gyroscope_noise_density is nan"),
    ],
)
def test_what_is_wrong_with_imu_noise_is_named(tmp_path: Path, text: str, match: str) -> None:
    path = written(tmp_path / "imu.yaml", text)
    with pytest.raises(InputError, match=match) as caught:
        read_imu_noise(path)
    assert caught.value.file == path


def test_partial_imu_noise(tmp_path: Path) -> None:
    noise = read_imu_noise(written(tmp_path / "camera.yaml", "gyroscope_noise_density: 0.002\n"))
    assert noise == ImuNoise(gyro_noise_density=0.002)


# ------------------------------------------------------------------------------------------- implausible lenses

# Kannala-Brandt coefficients of a stereo camera whose driver calls them plumb_bob.
FISHEYE_K = (-0.00217446, 0.03760552, -0.03640431, 0.00593686)
WIDE = """image_width: 848
image_height: 800
camera_matrix: {rows: 3, cols: 3, data: [285.6467, 0., 424.574, 0., 286.685, 408.1993, 0., 0., 1.]}
distortion_model: MODEL
distortion_coefficients: [NUMBERS]
"""


def wide_file(path: Path, model: str, numbers: tuple[float, ...]) -> Path:
    listed = ", ".join(map(str, numbers))
    return written(path, WIDE.replace("MODEL", model).replace("NUMBERS", listed))


def test_fisheye_numbers_by_another_name_are_refused_and_the_remedies_work(tmp_path: Path) -> None:
    with pytest.raises(
        InputError, match=r"p1 = -0.036.*k1 to k4 of a fisheye.*distortion_model: equidistant"
    ):
        Camera.from_yaml(wide_file(tmp_path / "wrong.yaml", "plumb_bob", (*FISHEYE_K, 0.0)))
    camera = Camera.from_yaml(wide_file(tmp_path / "right.yaml", "equidistant", FISHEYE_K))
    assert lens_problem(camera) is None
    edge = camera.project([[sin(radians(50)), 0.0, cos(radians(50))]])
    np.testing.assert_allclose(camera.rays(edge)[0], [sin(radians(50)), 0.0, cos(radians(50))], atol=1e-9)
    told = Camera.from_yaml(wide_file(tmp_path / "told.yaml", "plumb_bob", (*FISHEYE_K, 0, 0, 0, 0)))
    assert "tangential distortion" in (lens_problem(told) or "")


def test_a_distortion_that_turns_back_within_the_picture_is_told(tmp_path: Path) -> None:
    barrel = Camera.from_yaml(wide_file(tmp_path / "a.yaml", "plumb_bob", (-0.35, 0.05, 0.0, 0.0, 0.0)))
    assert "turns back within the picture" in (lens_problem(barrel) or "")
    assert lens_problem(Camera.from_yaml(written(tmp_path / "b.yaml", ROS))) is None
