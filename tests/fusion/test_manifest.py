"""``flight.toml``: read back as written, paths from where it lies, every slip of the pen named with its remedy."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from math import radians
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fusion.logs.csv.column_map import READY_MAPS
from fusion.logs.manifest.file import find_manifest, make_manifest, read_manifest, write_manifest
from fusion.logs.manifest.manifest import CameraSource, Manifest, camera_problems, corrected_camera
from vision import Camera, InputError

FULL = """
name = "hall"
log = "log.ulg"
corridor_width_m = 2.2
truth = "corridor_truth.csv"

[camera]
file = "video.mp4"
topic = "video"
calibration = "../cam.yaml"
times = "times.csv"
clock_offset_s = -12.5
mount_yaw_rad = 0.05
mount_pitch_rad = -0.1
focal_scale = 0.98

[imu]
file = "imu.csv"
frame = "flu"
noise = "imu.yaml"

[imu.columns]
time = "t [ms]"
time_unit = "ms"
separator = ";"
header = true
gyro = ["gx", "gy", 4]
gyro_unit = "deg/s"

[attitude]
file = "state.csv"
columns = "tello"

[velocity]
use = false
"""

words = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"), min_size=1, max_size=12)
numbers = st.floats(-1e6, 1e6).map(float)


def manifest_file(folder: Path, text: str) -> Path:
    path = folder / "flight.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_every_key_is_read_and_paths_count_from_the_file(tmp_path: Path) -> None:
    (tmp_path / "hall").mkdir()
    manifest = read_manifest(manifest_file(tmp_path / "hall", FULL))
    assert manifest.log == tmp_path / "hall" / "log.ulg"
    assert manifest.camera.calibration == tmp_path / "cam.yaml"
    assert manifest.camera.clock_offset_s == -12.5
    assert manifest.imu.noise == tmp_path / "hall" / "imu.yaml"
    columns = manifest.imu.columns
    assert not isinstance(columns, str | None)
    assert columns.gyro == ("gx", "gy", 4)
    assert columns.gyro_unit == "deg/s"
    assert manifest.attitude.columns == "tello"
    assert not manifest.velocity.use
    assert manifest.position.use


def test_a_range_sensor_in_a_file_of_its_own(tmp_path: Path) -> None:
    text = """
[camera]
file = "hall.mp4"
[range]
file = "tof.csv"
above_camera_m = -0.04
clock_offset_s = 2.5
[range.columns]
range = "tof"
range_unit = "cm"
range_limits = [30, 1000]
"""
    manifest = read_manifest(manifest_file(tmp_path, text))
    assert manifest.range.file == tmp_path / "tof.csv"
    assert manifest.range.above_camera_m == -0.04
    columns = manifest.range.columns
    assert not isinstance(columns, str | None)
    assert (columns.range, columns.range_unit, columns.range_limits) == ("tof", "cm", (30.0, 1000.0))
    write_manifest(manifest, tmp_path / "again.toml")
    assert "above_camera_m = -0.04  # the sensor sits this much higher than the camera" in (
        tmp_path / "again.toml"
    ).read_text(encoding="utf-8")
    assert read_manifest(tmp_path / "again.toml") == manifest


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("above_m = 0.1", "did you mean above_camera_m"),
        ("above_camera_m = 30.0", "range.above_camera_m = 30.0"),
        ("mount_rad = [0.0, 0.0, 0.0]", "unknown key range.mount_rad"),
    ],
)
def test_what_a_range_sensor_cannot_have_is_refused(tmp_path: Path, line: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        read_manifest(manifest_file(tmp_path, f'log = "a"\n[range]\n{line}\n'))


def test_above_camera_belongs_to_the_range_sensor(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="above_camera_m belongs in \\[range\\]"):
        read_manifest(manifest_file(tmp_path, 'log = "a"\n[velocity]\nabove_camera_m = 0.1\n'))


def test_written_and_read_back_it_is_the_same(tmp_path: Path) -> None:
    manifest = read_manifest(manifest_file(tmp_path, FULL))
    (tmp_path / "deep").mkdir()
    write_manifest(manifest, tmp_path / "deep" / "again.toml", {"camera.clock_offset_s": "sigma\n1 ms"})
    text = (tmp_path / "deep" / "again.toml").read_text()
    assert 'file = "../video.mp4"' in text
    assert "clock_offset_s = -12.5  # added to this file's times; sigma 1 ms\n" in text
    assert str(tmp_path) not in text
    assert read_manifest(tmp_path / "deep" / "again.toml") == manifest


@given(
    name=words.filter(lambda name: name not in (".", "..") and not set("/\\\0") & set(name)),
    topic=words,
    offset=numbers,
    column=words,
    yaw=st.floats(-1.5, 1.5),
    scale=st.floats(0.2, 5.0),
    note=words,
)
@settings(max_examples=60, deadline=None)
def test_any_text_and_number_survives_the_file(
    tmp_path_factory: pytest.TempPathFactory,
    name: str,
    topic: str,
    offset: float,
    column: str,
    yaw: float,
    scale: float,
    note: str,
) -> None:
    manifest = make_manifest(
        {
            "name": name,
            "camera": {
                "file": "v.mp4",
                "topic": topic,
                "clock_offset_s": offset,
                "mount_yaw_rad": yaw,
                "focal_scale": scale,
            },
            "imu": {"columns": {"time": column, "gyro": [1, column, 3]}},
        },
        file=tmp_path_factory.getbasetemp() / "flight.toml",
    )
    path = tmp_path_factory.mktemp("manifest") / "flight.toml"
    write_manifest(manifest, path, {"camera.topic": note, "camera.focal_scale": note})
    assert read_manifest(path) == manifest


def test_a_value_that_is_set_to_its_default_is_written(tmp_path: Path) -> None:
    values = {"log": "a", "camera": {"mount_yaw_rad": 0.0, "clock_offset_s": 0.0}, "velocity": {"use": True}}
    write_manifest(make_manifest(values, file=tmp_path / "flight.toml"), tmp_path / "flight.toml")
    assert tomllib.loads((tmp_path / "flight.toml").read_text()) == values


def test_a_path_elsewhere_is_written_whole(tmp_path: Path) -> None:
    manifest = make_manifest({"log": "/elsewhere/log.ulg"})
    write_manifest(manifest, tmp_path / "flight.toml")
    assert 'log = "/elsewhere/log.ulg"' in (tmp_path / "flight.toml").read_text()


def test_nothing_half_written(tmp_path: Path) -> None:
    (tmp_path / "flight.toml").mkdir()
    with pytest.raises(InputError, match=r"flight\.toml: cannot be written"):
        write_manifest(make_manifest({"log": "a"}), tmp_path / "flight.toml")
    assert [entry.name for entry in tmp_path.iterdir()] == ["flight.toml"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("log = ", r"flight\.toml: is not TOML: .*\(write lines like"),
        ("", r"neither log nor \[camera\] file says where the pictures are"),
        ('log = "a"\ncolour = 1', r"unknown key colour = 1 \(known here: name, vehicle, log"),
        (
            'log = "a"\ncorridor_width = 2',
            r"unknown key corridor_width = 2 \(did you mean corridor_width_m\?\)",
        ),
        ('[camera]\nfiel = "a"', r"unknown key camera\.fiel = 'a' \(did you mean file\?\)"),
        (
            'log = "a"\n[imu]\nstart_ns = 3',
            r"unknown key imu\.start_ns = 3 \(start_ns belongs in \[camera\]\)",
        ),
        (
            'log = "a"\ncamera_height_m = 1.2',
            r"unknown key camera_height_m = 1\.2 \(.* of the filter belong in the file for --config\)",
        ),
        (
            'log = "a"\n[imu]\ngyro_noise_density = 1e-3',
            r"\(known here: file, .*noise\. Settings of the filter belong in the file for --config\)",
        ),
        ('log = "a"\n[imu]\ngyro = ["a"]', r"imu\.gyro = .* \(gyro belongs in a stream's columns\)"),
        ('log = "a"\n[imu.columns]\ngiro = 1', r"unknown key imu\.columns\.giro = 1 \(did you mean gyro\?\)"),
        (
            'log = "a"\n[imu.columns]\ngyro_unit = "deg"',
            r"\[imu\] 'deg' is not a known unit \(give rad/s, deg/s, mrad/s, mdeg/s, or deg/s/N",
        ),
        ('log = "a"\n[imu.columns]\ngyro = ["a", "b"]', r"imu\.columns\.gyro.*required"),
        (
            'log = "a"\n[imu.columns]\ngyro = ["a", "b", 0]',
            r"imu\.columns\.gyro\.2 = 0: .*greater than or equal to 1",
        ),
        (
            'log = "a"\n[imu]\ncolumns = "telo"',
            r"\[imu\] columns = 'telo' is not a known map \(did you mean tello\?\)",
        ),
        ('log = "a"\n[imu]\ncolumns = 3', r"imu\.columns = 3: it should be a table"),
        (
            'log = "a"\n[imu]\nframe = "nwu"',
            r"imu\.frame = 'nwu': input should be 'frd', 'flu', 'ned' or 'enu'",
        ),
        ('log = "a"\nimu = 3', r"imu = 3: it should be a table"),
        ("log = 3", r"log = 3: it should be a path in quotes"),
        (
            'log = "a"\ncorridor_width_m = "wide"',
            r"corridor_width_m = 'wide': .*number.*\(Width between the walls",
        ),
        ('log = "a"\ncorridor_width_m = 0.1', r"corridor_width_m = 0\.1: .*greater than 0\.2"),
        ('log = "a"\n[camera]\nclock_offset_s = nan', r"camera\.clock_offset_s = nan: .*finite"),
        ('log = "a"\n[camera]\nclock_offset_s = true', r"camera\.clock_offset_s = True: .*number"),
        ('log = "a"\n[camera]\nfocal_scale = 100', r"camera\.focal_scale = 100: .*less than or equal to 5"),
        ('log = "a"\n[camera]\nuse = false', r"\[camera\] use is false \(a flight needs its pictures\)"),
        (
            'log = "a"\n[camera]\ntimes = "t"\nstart_ns = 3',
            r"times and start_ns both say .* \(give one of them\)",
        ),
        (
            'log = "a"\n[imu.columns]\nquaternion=[1,2,3,4]\neuler=[1,2,3]',
            r"quaternion and euler say the same thing",
        ),
    ],
)
def test_a_slip_is_named_with_its_remedy(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        read_manifest(manifest_file(tmp_path, text))
    assert str(caught.value).startswith(str(tmp_path / "flight.toml"))
    assert "\n" not in str(caught.value)


def test_a_manifest_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"gone\.toml: cannot be read"):
        read_manifest(tmp_path / "gone.toml")
    for torn in (b"name = '\xff'", b"corridor_width_m = " + b"1" * 5000):
        (tmp_path / "bad.toml").write_bytes(torn)
        with pytest.raises(InputError, match="is not TOML"):
            read_manifest(tmp_path / "bad.toml")


@pytest.mark.parametrize("path", ["a\\u0000b.mp4", "~nobody_of_that_name/a.mp4"])
def test_a_path_that_cannot_be_is_refused(tmp_path: Path, path: str) -> None:
    (tmp_path / "bad.toml").write_text(f'log = "{path}"\n')
    with pytest.raises(InputError, match="names a path that cannot be"):
        read_manifest(tmp_path / "bad.toml")


def test_where_a_manifest_is_looked_for(tmp_path: Path) -> None:
    assert find_manifest(tmp_path) is None
    path = manifest_file(tmp_path, FULL)
    assert find_manifest(tmp_path) == find_manifest(path) == path
    assert find_manifest(tmp_path / "none.toml") is None
    (tmp_path / "a.csv").write_text("x")
    assert find_manifest(tmp_path / "a.csv") is None


def test_ready_maps_are_named_in_the_description() -> None:
    described = Manifest.model_fields["imu"].default_factory
    assert described is not None
    assert all(name in str(CameraSource.model_fields["columns"].description) for name in READY_MAPS)


def axis(camera: Camera) -> np.ndarray:
    return np.asarray(camera.R_body_camera @ [0.0, 0.0, 1.0])


def test_corrections_turn_the_camera_right_and_up() -> None:
    camera = Camera.from_fov(640, 480, radians(70))
    right = corrected_camera(camera, CameraSource(mount_yaw_rad=radians(3)))
    np.testing.assert_allclose(axis(right), [np.cos(radians(3)), np.sin(radians(3)), 0.0], atol=1e-12)
    up = corrected_camera(camera, CameraSource(mount_pitch_rad=radians(3)))
    np.testing.assert_allclose(axis(up), [np.cos(radians(3)), 0.0, -np.sin(radians(3))], atol=1e-12)
    long = corrected_camera(camera, CameraSource(focal_scale=1.05))
    assert long.fx_px == pytest.approx(1.05 * camera.fx_px)
    assert (long.cx_px, long.width_px) == (camera.cx_px, camera.width_px)
    assert corrected_camera(camera, CameraSource()) is camera


@pytest.mark.parametrize("key", ["mount_yaw_rad", "mount_pitch_rad", "mount_roll_rad"])
def test_a_mounting_angle_that_is_set_states_the_mounting(key: str) -> None:
    camera = replace(Camera.from_fov(640, 480, radians(70)), mount_assumed=True)
    problem = camera_problems(corrected_camera(camera, CameraSource(focal_scale=1.05)))
    assert len(problem) == 1
    assert key in problem[0]
    assert "inside cam0:" in problem[0]
    stated = corrected_camera(camera, CameraSource.model_validate({key: 0.0}))
    assert not camera_problems(stated)
    np.testing.assert_array_equal(axis(stated), axis(camera))
