"""Camera files: both formats, the direction of each one's extrinsic, and every way to get them wrong."""

from __future__ import annotations

from math import cos, isnan, radians, sin
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from tests.files import HALLWAY, OFFICE, written
from vision import Camera, InputError
from vision.cameras.calibration import read_body_frame, read_yaml
from vision.cameras.camera import BodyFrame, Distortion

OFFICE_CAMERA = OFFICE / "mav0" / "cam0" / "sensor.yaml"
HALLWAY_CAMERA = HALLWAY / "mav0" / "cam0" / "sensor.yaml"

EUROC = """%YAML:1.0
# a comment
sensor_type: camera
T_BS:
  cols: 4
  rows: 4
  data: [{T_BS}]
rate_hz: 20
resolution: [752, 480]
camera_model: pinhole
intrinsics: [458.654, 457.296, 367.215, 248.375] #fu, fv, cu, cv
distortion_model: radial-tangential
distortion_coefficients: [-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05]
"""
KALIBR = """cam0:
  T_cam_imu:
  - [{0}, 0.065]
  - [{1}, -0.0207]
  - [{2}, -0.0081]
  - [0.0, 0.0, 0.0, 1.0]
  cam_overlaps: [1]
  camera_model: pinhole
  distortion_coeffs: [0.003482389402249, 0.000715034845216, -0.002053236141871, 0.00020293673591811182]
  distortion_model: equidistant
  intrinsics: [190.97847715128717, 190.9733070521226, 254.93170605935475, 256.8974428996504]
  resolution: [512, 512]
  rostopic: /cam0/image_raw
cam1:
  camera_model: omni
"""


def numbers(row: npt.ArrayLike) -> str:
    return ", ".join(repr(float(v)) for v in np.asarray(row).ravel())


def euroc(R_body_camera: npt.ArrayLike) -> str:
    T = np.eye(4)
    T[:3, :3] = R_body_camera
    T[:3, 3] = [0.1, -0.02, 0.03]
    return EUROC.format(T_BS=numbers(T))


def kalibr(R_camera_imu: npt.ArrayLike) -> str:
    return KALIBR.format(*(numbers(row) for row in np.asarray(R_camera_imu)))


# A camera on a body with x forward, y left, z up, turned 25 degrees to the right and pitched 10 degrees down.
# By hand, its right is (-s, -c, 0); its view (C c, -C s, -S); its down is view cross right.
c, s, C, S = cos(radians(25)), sin(radians(25)), cos(radians(10)), sin(radians(10))
RIGHT_FLU, VIEW_FLU, DOWN_FLU = [-s, -c, 0.0], [C * c, -C * s, -S], [-S * c, S * s, -C]
R_FLU_CAMERA = np.array([RIGHT_FLU, DOWN_FLU, VIEW_FLU]).T
# In FRD the y and z components change their signs: the view then has +S, down, and +C s, right.
RIGHT_FRD, VIEW_FRD, DOWN_FRD = [-s, c, 0.0], [C * c, C * s, S], [-S * c, -S * s, C]


def check_tilted(camera: Camera) -> None:
    np.testing.assert_allclose(camera.R_body_camera @ [1.0, 0.0, 0.0], RIGHT_FRD, atol=1e-12)
    np.testing.assert_allclose(camera.R_body_camera @ [0.0, 1.0, 0.0], DOWN_FRD, atol=1e-12)
    np.testing.assert_allclose(camera.R_body_camera @ [0.0, 0.0, 1.0], VIEW_FRD, atol=1e-12)


def test_euroc_takes_the_camera_to_the_body(tmp_path: Path) -> None:
    check_tilted(Camera.from_yaml(written(tmp_path / "sensor.yaml", euroc(R_FLU_CAMERA))))
    check_tilted(Camera.from_yaml(written(tmp_path / "sensor.yaml", euroc(R_FLU_CAMERA)), body_frame="flu"))


def test_kalibr_takes_the_imu_to_the_camera(tmp_path: Path) -> None:
    check_tilted(Camera.from_yaml(written(tmp_path / "sensor.yaml", kalibr(R_FLU_CAMERA.T))))


@pytest.mark.parametrize("text", [euroc, lambda R: kalibr(np.transpose(R))], ids=["euroc", "kalibr"])
def test_a_body_in_frd_is_taken_as_it_is(tmp_path: Path, text: object) -> None:
    R_frd_camera = np.array([RIGHT_FRD, DOWN_FRD, VIEW_FRD]).T
    assert callable(text)
    check_tilted(Camera.from_yaml(written(tmp_path / "sensor.yaml", text(R_frd_camera)), body_frame="frd"))


@pytest.mark.parametrize(
    ("body", "axis"),
    [("body_frame: frd", [C * c, -C * s, -S]), ("body_frame: FLU", VIEW_FRD), (None, VIEW_FRD)],
)
def test_the_body_frame_is_read_beside_the_sensor_folder(
    tmp_path: Path, body: str | None, axis: list[float]
) -> None:
    path = written(tmp_path / "mav0/cam0/sensor.yaml", euroc(R_FLU_CAMERA))
    if body is not None:
        written(tmp_path / "mav0/body.yaml", body)
    np.testing.assert_allclose(Camera.from_yaml(path).R_body_camera[:, 2], axis, atol=1e-12)
    np.testing.assert_allclose(
        Camera.from_yaml(path, body_frame="flu").R_body_camera[:, 2], VIEW_FRD, atol=1e-12
    )


def test_euroc_fields(tmp_path: Path) -> None:
    times = "exposure_s: 4e-3\nline_delay: 6.5e-5\n"
    camera = Camera.from_yaml(written(tmp_path / "sensor.yaml", euroc(R_FLU_CAMERA) + times))
    assert (camera.width_px, camera.height_px) == (752, 480)
    assert (camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px) == (458.654, 457.296, 367.215, 248.375)
    assert camera.distortion is Distortion.RADTAN
    assert camera.coefficients == (-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05)
    assert camera.exposure_s == 0.004
    assert camera.line_delay_s == 6.5e-5
    assert isnan(Camera.from_yaml(written(tmp_path / "sensor.yaml", euroc(R_FLU_CAMERA))).exposure_s)


def test_kalibr_fields(tmp_path: Path) -> None:
    camera = Camera.from_yaml(written(tmp_path / "sensor.yaml", kalibr(R_FLU_CAMERA.T)))
    assert (camera.width_px, camera.height_px) == (512, 512)
    assert camera.fx_px == 190.97847715128717
    assert camera.distortion is Distortion.EQUIDISTANT
    assert camera.coefficients[3] == 0.00020293673591811182


def test_another_camera_of_a_chain(tmp_path: Path) -> None:
    both = kalibr(R_FLU_CAMERA.T).split("cam1:")[0]
    path = written(
        tmp_path / "sensor.yaml", both + both.replace("cam0", "cam1").replace("[512, 512]", "[640, 480]")
    )
    assert Camera.from_yaml(path).width_px == 512
    assert Camera.from_yaml(path, cam="cam1").width_px == 640
    with pytest.raises(InputError, match=r"no camera cam2 in this chain \(choose one of: cam0, cam1\)"):
        Camera.from_yaml(path, cam="cam2")


@pytest.mark.parametrize(
    ("old", "new", "distortion", "count"),
    [
        ("camera_model: pinhole", "camera_model: pinhole-equi", Distortion.EQUIDISTANT, 4),
        ("camera_model: pinhole\n", "camera_model: pinhole-equi\n", Distortion.EQUIDISTANT, 4),
        ("distortion_model: equidistant", "distortion_model: radtan", Distortion.RADTAN, 4),
    ],
)
def test_names_of_kalibr_models(
    tmp_path: Path, old: str, new: str, distortion: Distortion, count: int
) -> None:
    camera = Camera.from_yaml(written(tmp_path / "sensor.yaml", kalibr(R_FLU_CAMERA.T).replace(old, new)))
    assert camera.distortion is distortion
    assert len(camera.coefficients) == count


def test_a_model_named_once_is_enough(tmp_path: Path) -> None:
    text = kalibr(R_FLU_CAMERA.T).replace("camera_model: pinhole", "camera_model: pinhole-radtan")
    text = text.replace("  distortion_model: equidistant\n", "")
    assert Camera.from_yaml(written(tmp_path / "sensor.yaml", text)).distortion is Distortion.RADTAN


@pytest.mark.parametrize("coefficients", ["[]", "[0, 0, 0, 0]", "null"])
def test_no_distortion(tmp_path: Path, coefficients: str) -> None:
    head, _ = euroc(R_FLU_CAMERA).split("distortion_model")
    text = f"{head}distortion_model: none\ndistortion_coefficients: {coefficients}\n"
    camera = Camera.from_yaml(written(tmp_path / "sensor.yaml", text))
    assert camera.distortion is Distortion.NONE
    assert camera.coefficients == ()


@pytest.mark.parametrize("count", [4, 5, 8])
def test_counts_of_radial_tangential_coefficients(tmp_path: Path, count: int) -> None:
    text = euroc(R_FLU_CAMERA).replace("0.00019359, 1.76187114e-05", ", ".join(["1e-4"] * (count - 2)))
    assert len(Camera.from_yaml(written(tmp_path / "sensor.yaml", text)).coefficients) == count


def test_opencv_matrix_and_nested_rows(tmp_path: Path) -> None:
    flat = euroc(R_FLU_CAMERA)
    tagged = flat.replace("T_BS:\n", "T_BS: !!opencv-matrix\n").replace("  rows: 4\n", "  rows: 4\n  dt: d\n")
    nested = f"T_BS: {[[*row, 0.0] for row in R_FLU_CAMERA.tolist()] + [[0, 0, 0, 1]]}\n"
    nested += flat[flat.index("rate_hz") :]
    check_tilted(Camera.from_yaml(written(tmp_path / "sensor.yaml", tagged)))
    check_tilted(Camera.from_yaml(written(tmp_path / "sensor.yaml", nested)))


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        (
            "1.76187114e-05]",
            "1e-5, 0.0, 0.0]",
            "distortion_coefficients has 6 numbers instead of 4 or 5 or 8",
        ),
        (", 0.07395907, 0.00019359, 1.76187114e-05", "", "distortion_coefficients has 1 numbers instead of"),
        ("1.76187114e-05", ".nan", r"distortion_coefficients is .*\(every number must be finite\)"),
        ("1.76187114e-05", "tiny", "distortion_coefficients is .* not a list of numbers"),
        ("[-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05]", "7", "is 7, not a list of numbers"),
        ("resolution: [752, 480]\n", "", r"resolution is missing \(write \[width, height\]\)"),
        ("[752, 480]", "[752]", "resolution has 1 numbers instead of 2"),
        ("[752, 480]", "[752, 0]", r"resolution is \[752.0, 0.0\] \(write"),
        ("[752, 480]", "[752.5, 480]", "resolution is .*whole pixels"),
        ("[752, 480]", "[376, 240]", r"principal point \(367.215, 248.375\) outside the resolution 376x240"),
        ("[458.654,", "[-458.654,", r"intrinsics has the focal length fu = -458.654 \(it must be positive"),
        ("457.296,", "0,", "intrinsics has the focal length fv = 0"),
        ("248.375]", "]", r"intrinsics has 3 numbers instead of 4 \(write \[fu, fv, cu, cv\]\)"),
        ("camera_model: pinhole\n", "", "camera_model is missing"),
        ("camera_model: pinhole", "camera_model: omni", "camera_model is 'omni' .*supported are pinhole"),
        ("camera_model: pinhole", "camera_model: ds", "camera_model is 'ds'"),
        ("camera_model: pinhole", "camera_model: eucm-none", "camera_model is 'eucm'"),
        (
            "camera_model: pinhole",
            "camera_model: pinhole-equi",
            "camera_model is 'pinhole-equi' but distortion",
        ),
        ("radial-tangential", "fov", "distortion_model is 'fov' .*radtan, equidistant or none"),
        ("distortion_model: radial-tangential\n", "", "distortion_model is missing"),
        ("radial-tangential", "none", "though distortion_model is none"),
        ("radial-tangential", "", "distortion_model is missing"),
        ("rate_hz: 20", "exposure_s: true", "exposure_s is True"),
        ("rate_hz: 20", "exposure_s: fast", "exposure_s is 'fast'"),
        ("rate_hz: 20", "exposure_s: -1.0", "exposure_s is -1.0"),
        ("rate_hz: 20", "line_delay: no", "line_delay is 'no' .*give seconds from row to row"),
        ("rate_hz: 20", "line_delay: 33", r"line_delay 33 would take 1.58e\+04 s to read 480 rows"),
        ("T_BS:", "T_SB:", r"T_BS is missing \(add T_BS, body from camera; straight ahead"),
        ("  data: [", "  data: [1.0, ", "T_BS does not contain 16 numbers"),
        ("  data: [", "  dat: [", "T_BS.data is missing"),
        ("  cols: 4\n", "  cols: 4\n cols: [", "is not valid YAML in line"),
    ],
)
def test_what_is_wrong_in_a_sensor_file_is_named(tmp_path: Path, old: str, new: str, match: str) -> None:
    text = euroc(R_FLU_CAMERA)
    assert old in text
    path = written(tmp_path / "sensor.yaml", text.replace(old, new))
    with pytest.raises(InputError, match=match) as caught:
        Camera.from_yaml(path)
    assert caught.value.file == path
    assert caught.value.remedy
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        (
            "distortion_coeffs: [",
            "distortion_coeffs: [0.1, ",
            "cam0.distortion_coeffs has 5 numbers instead of 4",
        ),
        ("camera_model: pinhole", "camera_model: omni", "cam0.camera_model is 'omni'"),
        ("resolution: [512, 512]", "resolution: here", "cam0.resolution is 'here', not a list of numbers"),
        ("  - [0.0, 0.0, 0.0, 1.0]\n", "", "cam0.T_cam_imu does not contain 16 numbers"),
        ("  - [0.0, 0.0, 0.0, 1.0]", "  - [0.0, 0.0, 0.5, 1.0]", "cam0.T_cam_imu has the last row"),
    ],
)
def test_what_is_wrong_in_a_chain_is_named(tmp_path: Path, old: str, new: str, match: str) -> None:
    text = kalibr(R_FLU_CAMERA.T)
    assert old in text
    path = written(tmp_path / "camchain.yaml", text.replace(old, new))
    with pytest.raises(InputError, match=match) as caught:
        Camera.from_yaml(path)
    assert caught.value.file == path


@pytest.mark.parametrize(
    ("R", "match"),
    [
        (2.0 * R_FLU_CAMERA, "T_BS's rotation is not a rotation: off orthonormal by 3"),
        (-R_FLU_CAMERA, "not a rotation.*determinant -1"),
        (np.zeros((3, 3)), "not a rotation: off orthonormal by 1, determinant 0"),
    ],
)
def test_a_transform_that_does_not_rotate(tmp_path: Path, R: npt.NDArray[np.float64], match: str) -> None:
    path = written(tmp_path / "sensor.yaml", euroc(R))
    with pytest.raises(InputError, match=match) as caught:
        Camera.from_yaml(path)
    assert caught.value.file == path


@pytest.mark.parametrize("frame", ["flu", "frd"])
def test_the_remedy_for_a_missing_extrinsic_looks_straight_ahead(tmp_path: Path, frame: BodyFrame) -> None:
    """What the message advises to paste in is itself right."""
    lines = euroc(np.eye(3)).splitlines(keepends=True)
    start = next(i for i, line in enumerate(lines) if "T_" in line)
    count = 4
    without = "".join(lines[:start] + lines[start + count :])
    with pytest.raises(InputError, match="is missing") as caught:
        Camera.from_yaml(written(tmp_path / "sensor.yaml", without), body_frame=frame)
    assert caught.value.remedy is not None
    example = caught.value.remedy[caught.value.remedy.index("[") :]
    pasted = f"T_BS: {{data: {example}}}\n"
    camera = Camera.from_yaml(
        written(tmp_path / "sensor.yaml", "".join([*lines[:start], pasted, *lines[start + count :]])),
        body_frame=frame,
    )
    np.testing.assert_array_equal(camera.R_body_camera, [[0, 0, 1], [1, 0, 0], [0, 1, 0]])


def test_a_chain_of_cameras_alone_is_taken_as_straight_ahead(tmp_path: Path) -> None:
    lines = kalibr(np.eye(3)).splitlines(keepends=True)
    start = next(i for i, line in enumerate(lines) if "T_" in line)
    camera = Camera.from_yaml(
        written(tmp_path / "camchain.yaml", "".join(lines[:start] + lines[start + 5 :]))
    )
    assert camera.mount_assumed
    np.testing.assert_array_equal(camera.R_body_camera, [[0, 0, 1], [1, 0, 0], [0, 1, 0]])


def test_files_that_are_none(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none\.yaml: there is no such file"):
        Camera.from_yaml(tmp_path / "none.yaml")
    with pytest.raises(InputError, match="cannot be read as text"):
        Camera.from_yaml(tmp_path)
    binary = tmp_path / "b.yaml"
    binary.write_bytes(b"\xff\xd8\xff\xe0")
    with pytest.raises(InputError, match="cannot be read as text"):
        Camera.from_yaml(binary)
    with pytest.raises(InputError, match="does not contain a YAML mapping"):
        read_yaml(written(tmp_path / "sensor.yaml", "- 1\n- 2\n"))
    with pytest.raises(InputError, match="does not contain a YAML mapping"):
        read_yaml(written(tmp_path / "sensor.yaml", ""))


def test_body_frame_files(tmp_path: Path) -> None:
    assert read_body_frame(tmp_path / "body.yaml") == "flu"
    assert read_body_frame(written(tmp_path / "body.yaml", "body_frame: frd\n")) == "frd"
    with pytest.raises(InputError, match=r"body\.yaml: body_frame is 'ned' \(write flu"):
        read_body_frame(written(tmp_path / "body.yaml", "body_frame: ned\n"))
    # As in the public EuRoC flights.
    assert read_body_frame(written(tmp_path / "body.yaml", "%YAML:1.0\ncomment: any vehicle\n")) == "flu"
    with pytest.raises(InputError, match="body_frame is 'enu'"):
        Camera.from_yaml(OFFICE_CAMERA, body_frame="enu")  # type: ignore[arg-type]


def test_the_sample_flight() -> None:
    camera = Camera.from_yaml(OFFICE_CAMERA)
    assert (camera.width_px, camera.height_px, camera.fx_px, camera.cx_px) == (640, 480, 466.0, 319.5)
    np.testing.assert_array_equal(camera.R_body_camera, [[0, 0, 1], [1, 0, 0], [0, 1, 0]])
    assert camera.mount_problem() is None
    assert camera.exposure_s == 0.008


def test_the_real_flight() -> None:
    if not HALLWAY_CAMERA.exists():
        pytest.skip("the shared flights are not here")
    camera = Camera.from_yaml(HALLWAY_CAMERA)
    assert camera.coefficients[4] == 0.047875485130274044
    np.testing.assert_array_equal(camera.R_body_camera, [[0, 0, 1], [1, 0, 0], [0, 1, 0]])


def test_both_files_place_the_camera_alike(tmp_path: Path) -> None:
    # camera 6 cm ahead, 2 cm left and 1 cm above the body's centre (FLU), looking straight ahead
    euroc = tmp_path / "sensor.yaml"
    euroc.write_text(
        "T_BS: {data: [0, 0, 1, 0.06, -1, 0, 0, 0.02, 0, -1, 0, 0.01, 0, 0, 0, 1]}\n"
        "resolution: [640, 480]\nintrinsics: [466, 466, 319.5, 239.5]\ncamera_model: pinhole\n"
        "distortion_model: radial-tangential\ndistortion_coefficients: [0, 0, 0, 0]\n"
    )
    kalibr = tmp_path / "camchain.yaml"  # the inverse: p_camera = R (p_imu - t)
    kalibr.write_text(
        "cam0:\n  T_cam_imu:\n  - [0, -1, 0, 0.02]\n  - [0, 0, -1, 0.01]\n  - [1, 0, 0, -0.06]\n  - [0, 0, 0, 1]\n"
        "  resolution: [640, 480]\n  intrinsics: [466, 466, 319.5, 239.5]\n  camera_model: pinhole\n"
        "  distortion_model: radtan\n  distortion_coeffs: [0, 0, 0, 0]\n"
    )
    for path in (euroc, kalibr):
        camera = Camera.from_yaml(path, body_frame="flu")
        np.testing.assert_allclose(camera.p_body_camera_m, [0.06, -0.02, -0.01], atol=1e-12)
