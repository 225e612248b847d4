"""Calibrations of SLAM systems, OpenCV's XML and ROS's INI: written as those programs publish them."""

from __future__ import annotations

import json
from contextlib import suppress
from math import radians
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.files import written
from tests.vision.test_calibration_formats import opencv_file
from vision import Camera, InputError
from vision.cameras.camera import Distortion

# A camera that looks a little down on an IMU in FLU, and its position.
R_IMU_CAMERA = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]) @ Rotation.from_euler(
    "x", -5, degrees=True
).as_matrix()  # fmt: skip
POSE = np.eye(4)
POSE[:3, :3], POSE[:3, 3] = R_IMU_CAMERA, [0.06, 0.01, -0.02]
DATA = "[" + ", ".join(f"{v:.12g}" for v in POSE.ravel()) + "]"
MATRIX = f"!!opencv-matrix\n   rows: 4\n   cols: 4\n   dt: d\n   data: {DATA}\n"
LENS = (461.5, 460.5, 365.25, 248.5)
RADTAN, FISHEYE = (-0.2917, 0.0823, 5.333e-05, -1.578e-04), (-0.0053, 0.0423, -0.0395, 0.0068)

VINS = """%YAML:1.0
---
model_type: PINHOLE
camera_name: camera
image_width: 752
image_height: 480
distortion_parameters:
   k1: -0.2917
   k2: 0.0823
   p1: 5.333e-05
   p2: -1.578e-04
projection_parameters:
   fx: 461.5
   fy: 460.5
   cx: 365.25
   cy: 248.5
"""
VINS_MONO = VINS + (
    "extrinsicRotation: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n"
    f"   data: [{', '.join(f'{v:.12g}' for v in R_IMU_CAMERA.ravel())}]\n"
    "extrinsicTranslation: !!opencv-matrix\n   rows: 3\n   cols: 1\n   dt: d\n   data: [0.06, 0.01, -0.02]\n"
)
KANNALA_BRANDT = """%YAML:1.0
---
model_type: KANNALA_BRANDT
camera_name: camera
image_width: 752
image_height: 480
projection_parameters:
   k2: -0.0053
   k3: 0.0423
   k4: -0.0395
   k5: 0.0068
   mu: 461.5
   mv: 460.5
   u0: 365.25
   v0: 248.5
"""
ORB_SLAM3 = f"""%YAML:1.0
File.version: "1.0"
Camera.type: "KannalaBrandt8"
Camera1.fx: 461.5
Camera1.fy: 460.5
Camera1.cx: 365.25
Camera1.cy: 248.5
Camera1.k1: -0.0053
Camera1.k2: 0.0423
Camera1.k3: -0.0395
Camera1.k4: 0.0068
Camera.width: 752
Camera.height: 480
Camera.fps: 20
IMU.T_b_c1: {MATRIX}
IMU.NoiseGyro: 1.7e-4
"""
ORB_SLAM2 = """%YAML:1.0
Camera.fx: 461.5
Camera.fy: 460.5
Camera.cx: 365.25
Camera.cy: 248.5
Camera.k1: -0.2917
Camera.k2: 0.0823
Camera.p1: 5.333e-05
Camera.p2: -1.578e-04
Camera.width: 752
Camera.height: 480
"""
STELLA = """Camera:
  name: "EuRoC monocular"
  setup: "monocular"
  model: "perspective"
  fx: 461.5
  fy: 460.5
  cx: 365.25
  cy: 248.5
  k1: -0.2917
  k2: 0.0823
  p1: 5.333e-05
  p2: -1.578e-04
  k3: 0.0
  fps: 20.0
  cols: 752
  rows: 480
"""
OKVIS = f"""%YAML:1.0
cameras:
     - {{T_SC:
        {DATA},
        image_dimension: [752, 480],
        distortion_coefficients: [-0.2917, 0.0823, 5.333e-05, -1.578e-04],
        distortion_type: radialtangential,
        focal_length: [461.5, 460.5],
        principal_point: [365.25, 248.5]}}
"""
QUATERNION = Rotation.from_matrix(R_IMU_CAMERA).as_quat()
BASALT = json.dumps(
    {
        "value0": {
            "T_imu_cam": [
                dict(
                    zip(
                        ("px", "py", "pz", "qx", "qy", "qz", "qw"),
                        [0.06, 0.01, -0.02, *QUATERNION],
                        strict=True,
                    )
                )
            ],
            "intrinsics": [
                {
                    "camera_type": "kb4",
                    "intrinsics": dict(
                        zip(("fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4"), (*LENS, *FISHEYE), strict=True)
                    ),
                }
            ],
            "resolution": [[752, 480]],
        }
    }
)


@pytest.mark.parametrize(
    ("name", "text", "fisheye", "posed"),
    [
        ("vins.yaml", VINS, False, False),
        ("vins_mono.yaml", VINS_MONO, False, True),
        ("kannala_brandt.yaml", KANNALA_BRANDT, True, False),
        ("orb_slam3.yaml", ORB_SLAM3, True, True),
        ("orb_slam2.yaml", ORB_SLAM2, False, False),
        ("orb_slam_tbc.yaml", ORB_SLAM2 + f"Tbc: {MATRIX}", False, True),
        ("stella.yaml", STELLA, False, False),
        ("okvis.yaml", OKVIS, False, True),
        ("basalt.json", BASALT, True, True),
    ],
)
def test_every_number_is_where_it_belongs(
    tmp_path: Path, name: str, text: str, fisheye: bool, posed: bool
) -> None:
    camera = Camera.from_yaml(written(tmp_path / name, text))
    assert (camera.width_px, camera.height_px) == (752, 480)
    assert (camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px) == LENS
    assert camera.distortion is (Distortion.EQUIDISTANT if fisheye else Distortion.RADTAN)
    assert camera.coefficients[:4] == (FISHEYE if fisheye else RADTAN)
    assert camera.mount_assumed == (not posed)
    if posed:
        np.testing.assert_allclose(camera.R_body_camera, np.diag([1.0, -1.0, -1.0]) @ R_IMU_CAMERA, atol=1e-9)
        np.testing.assert_allclose(camera.p_body_camera_m, [0.06, -0.01, 0.02])
        up_rad = np.arcsin(-camera.R_body_camera[2, 2])
        assert up_rad == pytest.approx(-radians(5)) or up_rad == pytest.approx(radians(5))


def test_vins_fusions_configuration_names_the_file_of_each_camera(tmp_path: Path) -> None:
    written(tmp_path / "cam0_pinhole.yaml", VINS)
    text = f'%YAML:1.0\nimu: 1\nnum_of_cam: 1\ncam0_calib: "cam0_pinhole.yaml"\nbody_T_cam0: {MATRIX}'
    camera = Camera.from_yaml(written(tmp_path / "euroc_mono_imu.yaml", text))
    assert camera.coefficients == RADTAN
    np.testing.assert_allclose(camera.p_body_camera_m, [0.06, -0.01, 0.02])
    assert not camera.mount_assumed


@pytest.mark.parametrize(
    ("text", "match"),
    [
        (
            VINS.replace("PINHOLE", "MEI"),
            r"model_type is 'MEI', a lens model that is not known here \(calibrate",
        ),
        (STELLA.replace("perspective", "equirectangular"), "Camera.model is 'equirectangular', a lens model"),
        ("Camera:\n  model: equirectangular\n  cols: 1920\n  rows: 960\n", "'equirectangular', a lens model"),
        (ORB_SLAM3.replace("KannalaBrandt8", "Ocam"), "Camera.type is 'Ocam', a lens model"),
        (OKVIS.replace("radialtangential", "eucm"), "distortion_type is 'eucm', a lens model"),
        (BASALT.replace("kb4", "ds"), "camera_type is 'ds', a lens model"),
        (ORB_SLAM2.replace("Camera.width: 752\n", ""), r"Camera\.cols is missing|Camera\.width is missing"),
        (VINS.replace("fx: 461.5", "fx: x"), "fx is 'x'"),
        (BASALT.replace('"qw"', '"w"'), "qw is missing"),
    ],
)
def test_what_cannot_be_used_is_named(tmp_path: Path, text: str, match: str) -> None:
    name = "camera.json" if text.startswith("{") else "camera.yaml"
    with pytest.raises(InputError, match=match):
        Camera.from_yaml(written(tmp_path / name, text))


@pytest.mark.parametrize("text", [VINS_MONO, ORB_SLAM3, OKVIS, STELLA, BASALT])
def test_a_file_cut_anywhere_is_the_camera_or_a_line(tmp_path: Path, text: str) -> None:
    name = "camera.json" if text.startswith("{") else "camera.yaml"
    for end in range(0, len(text), 23):
        path = written(tmp_path / name, text[:end])
        with suppress(InputError):
            assert Camera.from_yaml(path).width_px == 752


# --- XML and INI -------------------------------------------------------------------------------------------------


def test_opencvs_xml_is_its_yaml(tmp_path: Path) -> None:
    coefficients = [0.1, -0.2, 0.001, 0.002, 0.03]
    xml = Camera.from_yaml(opencv_file(tmp_path / "camera.xml", coefficients))
    yaml = Camera.from_yaml(opencv_file(tmp_path / "camera.yaml", coefficients))
    assert xml.coefficients == yaml.coefficients == tuple(coefficients)
    assert (xml.width_px, xml.fx_px, xml.cx_px) == (yaml.width_px, yaml.fx_px, yaml.cx_px)


def test_xml_that_would_fill_the_memory_is_refused_unread(tmp_path: Path) -> None:
    bomb = '<?xml version="1.0"?><!DOCTYPE a [<!ENTITY a "ha"><!ENTITY b "&a;&a;">]><opencv_storage/>'
    with pytest.raises(InputError, match="declares entities"):
        Camera.from_yaml(written(tmp_path / "a.xml", bomb))
    with pytest.raises(InputError, match="XML of another kind, svg"):
        Camera.from_yaml(written(tmp_path / "b.xml", "<svg></svg>"))
    with pytest.raises(InputError, match="is not valid XML"):
        Camera.from_yaml(written(tmp_path / "c.xml", "<opencv_storage><a>"))


INI = """# oST version 5.0 parameters


[image]

width
640

height
480

[narrow_stereo/left]

camera matrix
461.500000 0.000000 365.250000
0.000000 460.500000 248.500000
0.000000 0.000000 1.000000

distortion
-0.291700 0.082300 0.000053 -0.000158 0.000000

rectification
1.000000 0.000000 0.000000
0.000000 1.000000 0.000000
0.000000 0.000000 1.000000

projection
400.000000 0.000000 330.000000 0.000000
0.000000 410.000000 240.000000 0.000000
0.000000 0.000000 1.000000 0.000000
"""


def test_ross_ini_gives_the_raw_picture(tmp_path: Path) -> None:
    camera = Camera.from_yaml(written(tmp_path / "ost.ini", INI))
    assert (camera.width_px, camera.height_px) == (640, 480)
    assert (camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px) == LENS
    assert camera.coefficients == (-0.2917, 0.0823, 0.000053, -0.000158, 0.0)
    assert camera.mount_assumed
    with pytest.raises(InputError, match="distortion_coefficients is missing"):
        Camera.from_yaml(written(tmp_path / "cut.ini", INI[: INI.index("-0.2917")]))
