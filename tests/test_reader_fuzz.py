"""Every reader with inputs changed at random: it reads them, or refuses them in a line, and does nothing else.

What is changed are the small files below and those in ``tests/corpus`` that failed once; words that have been trouble
are put in, parts repeated, moved, cut and flipped.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fusion import FusionConfig
from fusion.evaluation.truth_file import read_truth
from fusion.inspection.sources import inspect_path
from fusion.inspection.text import inspection_text
from fusion.logs.csv.columns import open_log as open_csv
from fusion.logs.manifest.manifest import read_manifest
from fusion.logs.pictures.camera_folder import read_frames
from fusion.pictures.attitude_file import AttitudeFile
from fusion.pictures.exif import read_header
from fusion.printable import printable
from fusion.result.tables_csv import read_table
from fusion.simulate import SimulationConfig
from tests.files import OFFICE, ROOT
from vision import Camera, InputError
from vision.cameras.calibration import read_imu_noise, read_time_shift_s
from vision.images import read_image

CORPUS = ROOT / "tests" / "corpus"
CAM = OFFICE / "mav0" / "cam0"
WORDS = (
    b"", b"\0", b"\x1b[2J", b"\xff", b"\xef\xbb\xbf", b"\r", b"\n\n", b'"', b"'", b"#", b",", b";", b"\t", b":", b"=",
    b"[", b"]", b"{", b"}", b"&a ", b"*a", b"<<: *a", b"!!python/object:os.system ", b"%YAML:1.0\n---\n", b".inf",
    b"nan", b"-", b"0", b"-1", b"1e400", b"1e-400", b"9" * 25, b"9" * 400, b"9" * 5000, b"18446744073709551616",
    b"true", b"null", b"../../x", b"~nosuchuser/x", b"/dev/zero", b"x" * 140_000, b"a." * 600, b"[" * 2000,
    b"\xe2\x80\xae",
)  # fmt: skip

CALIBRATIONS = [
    CAM.joinpath("sensor.yaml").read_bytes(),
    *(path.read_bytes() for path in sorted(CORPUS.iterdir()) if path.suffix in (".yaml", ".json")),
    b"cam0:\n  T_cam_imu: [[0,-1,0,0],[0,0,-1,0],[1,0,0,0],[0,0,0,1]]\n  camera_model: pinhole\n  intrinsics: "
    b"[460, 460, 320, 240]\n  distortion_model: equi\n  distortion_coeffs: [0.1, 0, 0, 0]\n  resolution: [640, 480]\n"
    b"  timeshift_cam_imu: 0.01\n",
]
MANIFESTS = [
    *(path.read_bytes() for path in sorted(CORPUS.glob("*manifest*"))),
    b'name = "hall"\nlog = "x"\ncorridor_width_m = 2.2\n[camera]\nclock_offset_s = 12.5\nfocal_scale = 1.1\n'
    b'[imu]\ncolumns = "tello"\nmount_rad = [0, 0.1, 0]\n',
]
SETTINGS = [
    b"corridor_width_m = 2.2\ncamera_delay_s = 0.08\ngyro_noise_density = 0.01\n",
    b"seed = 3\n[motion]\nduration_s = 4.0\n[camera]\nexposure_s = 0.01\nwidth_px = 320\n[scene]\nwidth_m = 2\n",
]
IMU = b"timestamp_ns,gx [rad/s],gy,gz,ax,ay,az\n" + b"".join(
    b"%d,0.1,0.2,0.3,0.1,0.2,9.8\n" % (10**18 + k * 5_000_000) for k in range(40)
)
TABLES = [
    IMU,
    b"pitch:0;roll:1;yaw:2;agx:1.0;agy:2;agz:-998;\n" * 20,
    b"2021-01-01 10:00:00.1 pitch:0;roll:1;yaw:2;\n" * 20,
    b"t;gx;gy\n1,5;2,5;3,5\n2,5;3,5;4,5\n",
    b"timestamp_ns,qw,qx,qy,qz\n1000000000,1,0,0,0\n1005000000,1,0,0,0\n",
    b"image,roll_rad,pitch_rad\na.jpg,0.1,0.2\nb.jpg,0,0\n",
    b"timestamp_ns,heading_deg,lateral_offset_m\n1000000000,10,0.1\n1005000000,11,0.2\n",
    b"# frame: frd\n1.0 0 0 0 0 0 0 1\n2.0 0 0 0 0 0 0.1 0.99\n",
    b"#timestamp [ns],filename\n1600001000000000000,1600001000000000000.jpg\n",
]
PICTURE = sorted((CAM / "data").iterdir())[0].read_bytes()


@st.composite
def changed(draw: st.DrawFn, corpus: list[bytes]) -> bytes:
    """One of the corpus with up to four changes."""
    data = draw(st.sampled_from(corpus))
    for _ in range(draw(st.integers(0, 4))):
        start = draw(st.integers(0, len(data)))
        end = min(len(data), start + draw(st.sampled_from((0, 0, 1, 2, 8, 40, len(data)))))
        put = draw(
            st.one_of(
                st.sampled_from(WORDS),
                st.binary(max_size=6),
                st.just(data[start:end] * 2),
                st.sampled_from(data.split(b"\n")),
            )
        )
        data = data[:start] + put + data[end:]
    return data


def calibration(path: Path) -> None:
    for read in (Camera.from_yaml, read_imu_noise, read_time_shift_s):
        try:
            read(path)
        except InputError as error:
            check(error)


def table(path: Path) -> None:
    def csv(path: Path) -> None:
        log = open_csv(path)
        for topic in log.topics:
            getattr(log, topic.kind)(topic.name)

    readers: list[Callable[[Path], Any]] = [
        csv,
        AttitudeFile.read,
        read_truth,
        lambda path: read_table(path, np.dtype([("timestamp_ns", "i8"), ("heading_rad", "f8")])),
        lambda path: inspection_text(inspect_path(path)),
    ]
    for read in readers:
        try:
            read(path)
        except InputError as error:
            check(error)


def picture(path: Path) -> None:
    read_header(path)
    assert read_image(path).ndim == 2


def check(error: InputError) -> None:
    """One line, once the console has shown it."""
    line = printable(" ".join(str(error).split()))
    assert line
    assert "\n" not in line


def survives(data: bytes, path: Path, read: Callable[[Path], Any]) -> None:
    path.write_bytes(data)
    try:
        read(path)
    except InputError as error:
        check(error)


FUZZ = settings(max_examples=150, suppress_health_check=list(HealthCheck))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("fuzz")


@FUZZ
@given(data=changed(CALIBRATIONS), suffix=st.sampled_from((".yaml", ".json")))
def test_calibrations(folder: Path, data: bytes, suffix: str) -> None:
    survives(data, folder / f"camera{suffix}", calibration)


@FUZZ
@given(data=changed(MANIFESTS))
def test_manifests(folder: Path, data: bytes) -> None:
    survives(data, folder / "flight.toml", read_manifest)


@FUZZ
@given(data=changed([*SETTINGS, (CORPUS / "fuzz_config_6adf52b1.toml").read_bytes()]))
def test_settings(folder: Path, data: bytes) -> None:
    survives(data, folder / "settings.toml", FusionConfig.from_toml)
    survives(data, folder / "settings.toml", SimulationConfig.from_toml)


@FUZZ
@given(data=changed(TABLES))
def test_tables(folder: Path, data: bytes) -> None:
    survives(data, folder / "table.csv", table)


@FUZZ
@given(data=changed([TABLES[-1]]))
def test_lists_of_pictures(folder: Path, data: bytes) -> None:
    (folder / "cam0" / "data").mkdir(parents=True, exist_ok=True)
    (folder / "cam0" / "data" / "1600001000000000000.jpg").write_bytes(PICTURE)
    survives(data, folder / "cam0" / "data.csv", lambda path: read_frames(path.parent))


@FUZZ
@given(data=changed([PICTURE[:3000], PICTURE]))
def test_pictures(folder: Path, data: bytes) -> None:
    with suppress(InputError):
        survives(data, folder / "picture.jpg", picture)
