"""What is given to each reader when it is fuzzed: a few small files of its format, and the call that reads one.

`tests.test_reader_fuzz` changes them at random in every run of the tests, ``tests/fuzz_readers.py`` for as long as
one likes and guided by coverage. Files that failed once lie in ``tests/corpus``, in a folder named after the target.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from fractions import Fraction
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np

import fusion.logs
from fusion import FusionConfig
from fusion.evaluation.truth_file import read_truth
from fusion.inspection.sources import inspect_path
from fusion.inspection.text import inspection_text
from fusion.logs.manifest.file import read_manifest
from fusion.logs.pictures.camera_folder import read_frames
from fusion.logs.pictures.gpmf import samples_of
from fusion.pictures.attitude_file import AttitudeFile
from fusion.pictures.exif import read_header
from fusion.printable import printable
from fusion.result.tables_csv import read_table
from fusion.simulate import SimulationConfig
from tests.files import OFFICE, ROOT
from tests.fusion import damage
from vision import Camera, InputError
from vision.cameras.calibration import read_imu_noise, read_time_shift_s
from vision.images import read_image

CORPUS = ROOT / "tests" / "corpus"
CAM = OFFICE / "mav0" / "cam0"
PICTURE = sorted((CAM / "data").iterdir())[0].read_bytes()


class Target(NamedTuple):
    """A reader to fuzz: the name its file goes by, files to begin with, and what reads one."""

    file: str
    seeds: Callable[[], list[bytes]]
    read: Callable[[Path], Any]


def kept(target: str) -> list[Path]:
    """Files that failed once, of one target."""
    folder = CORPUS / target
    return sorted(folder.iterdir()) if folder.is_dir() else []


def survives(target: Target, data: bytes, folder: Path) -> None:
    """Read it: done, or refused in one line."""
    path = folder / target.file
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data)
    one_line(target.read, path)


def one_line(read: Callable[[Path], Any], path: Path) -> None:
    """Call a reader; where it refuses, one line is left once the console has shown it."""
    try:
        read(path)
    except InputError as error:
        line = printable(" ".join(str(error).split()))
        assert line
        assert "\n" not in line


def calibration(path: Path) -> None:
    for read in (Camera.from_yaml, read_imu_noise, read_time_shift_s):
        one_line(read, path)


def settings(path: Path) -> None:
    one_line(FusionConfig.from_toml, path)
    one_line(SimulationConfig.from_toml, path)


def table(path: Path) -> None:
    columns = np.dtype([("timestamp_ns", "i8"), ("heading_rad", "f8")])
    for read in (log, AttitudeFile.read, read_truth, lambda path: read_table(path, columns)):
        one_line(read, path)
    one_line(lambda path: inspection_text(inspect_path(path)), path)


def pictures_list(path: Path) -> None:
    picture = path.parent / "data" / "1600001000000000000.jpg"
    picture.parent.mkdir(exist_ok=True)
    picture.write_bytes(PICTURE)
    read_frames(path.parent)


def picture(path: Path) -> None:
    read_header(path)
    with suppress(InputError):
        assert read_image(path).ndim == 2


def log(path: Path) -> None:
    damage.read_everything(fusion.logs, path)


def gpmf(path: Path) -> None:
    for _, values in samples_of(path.read_bytes()):
        assert values.ndim == 2


def _calibrations() -> list[bytes]:
    return [
        CAM.joinpath("sensor.yaml").read_bytes(),
        *(path.read_bytes() for path in sorted(CORPUS.iterdir()) if path.suffix in (".yaml", ".json")),
        b"cam0:\n  T_cam_imu: [[0,-1,0,0],[0,0,-1,0],[1,0,0,0],[0,0,0,1]]\n  camera_model: pinhole\n  intrinsics: "
        b"[460, 460, 320, 240]\n  distortion_model: equi\n  distortion_coeffs: [0.1, 0, 0, 0]\n"
        b"  resolution: [640, 480]\n  timeshift_cam_imu: 0.01\n",
        b"%YAML:1.0\n---\nmodel_type: PINHOLE\nimage_width: 640\nimage_height: 480\ndistortion_parameters:\n"
        b"  k1: 0.1\n  k2: 0\n  p1: 0\n  p2: 0\nprojection_parameters:\n  fx: 460\n  fy: 460\n  cx: 320\n  cy: 240\n",
        b'{"value0": {"T_imu_cam": [{"px": 0, "py": 0, "pz": 0, "qx": 0.5, "qy": 0.5, "qz": 0.5, "qw": 0.5}],'
        b'"intrinsics": [{"camera_type": "kb4", "intrinsics": {"fx": 190, "fy": 190, "cx": 254, "cy": 256, "k1": 0.1,'
        b'"k2": 0, "k3": 0, "k4": 0}}], "resolution": [[512, 512]]}}',
        b"[image]\nwidth\n640\nheight\n480\n[narrow]\ncamera matrix\n460 0 320\n0 460 240\n0 0 1\n"
        b"distortion\n0.1 0 0 0 0\n",
    ]


def _manifests() -> list[bytes]:
    return [
        *(path.read_bytes() for path in sorted(CORPUS.glob("*manifest*.toml"))),
        b'name = "hall"\nlog = "x"\ncorridor_width_m = 2.2\n[camera]\nclock_offset_s = 12.5\nfocal_scale = 1.1\n'
        b'[imu]\ncolumns = "tello"\nmount_rad = [0, 0.1, 0]\n',
    ]


def _settings() -> list[bytes]:
    return [
        b"corridor_width_m = 2.2\ncamera_delay_s = 0.08\ngyro_noise_density = 0.01\n",
        b"seed = 3\n[motion]\nduration_s = 4.0\n[camera]\nexposure_s = 0.01\nwidth_px = 320\n[scene]\nwidth_m = 2\n",
        (CORPUS / "fuzz_config_6adf52b1.toml").read_bytes(),
    ]


LIST_OF_PICTURES = b"#timestamp [ns],filename\n1600001000000000000,1600001000000000000.jpg\n"


def _tables() -> list[bytes]:
    imu = b"timestamp_ns,gx [rad/s],gy,gz,ax,ay,az\n" + b"".join(
        b"%d,0.1,0.2,0.3,0.1,0.2,9.8\n" % (10**18 + k * 5_000_000) for k in range(40)
    )
    return [
        imu,
        b"pitch:0;roll:1;yaw:2;agx:1.0;agy:2;agz:-998;\n" * 20,
        b"2021-01-01 10:00:00.1 pitch:0;roll:1;yaw:2;\n" * 20,
        b"t;gx;gy\n1,5;2,5;3,5\n2,5;3,5;4,5\n",
        b"timestamp_ns,qw,qx,qy,qz\n1000000000,1,0,0,0\n1005000000,1,0,0,0\n",
        b"image,roll_rad,pitch_rad\na.jpg,0.1,0.2\nb.jpg,0,0\n",
        b"timestamp_ns,heading_deg,lateral_offset_m\n1000000000,10,0.1\n1005000000,11,0.2\n",
        b"# frame: frd\n1.0 0 0 0 0 0 0 1\n2.0 0 0 0 0 0 0.1 0.99\n",
        LIST_OF_PICTURES,
    ]


def _gyroflow() -> list[bytes]:
    rows = b"".join(b"%d,100,-20,30,10,20,-2048\n" % k for k in range(20))
    return [
        b"GYROFLOW IMU LOG\nversion,1.3\nid,x\norientation,YxZ\ntscale,0.005\ngscale,0.001\nascale,0.0005\n"
        b"t,gx,gy,gz,ax,ay,az\n" + rows
    ]


def _ulogs() -> list[bytes]:
    from tests.fusion.test_log_ulog import flying_right

    with TemporaryDirectory() as folder:
        return [flying_right(Path(folder), n=12).read_bytes()]


def _dataflash() -> list[bytes]:
    from tests.fusion.test_log_dataflash import new_log

    text = (
        b"FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns\n"
        b"FMT, 1, 43, IMU, QBffffff, TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ\n"
        b"FMT, 4, 20, ATT, QccC, TimeUS,Roll,Pitch,Yaw\n"
    ) + b"".join(
        b"IMU, %d, 0, 0.1, 0.2, 0.3, 0, 0, -9.8\nATT, %d, 1.5, -2.25, 359\n" % (k * 20_000, k * 20_000 + 5)
        for k in range(1, 12)
    )
    with TemporaryDirectory() as folder:
        return [new_log(Path(folder), n=8).read_bytes(), text]


def _tlogs() -> list[bytes]:
    from pymavlink.dialects.v10 import common as mavlink1
    from pymavlink.dialects.v20 import common as mavlink2

    from tests.fusion.test_log_tlog import Writer, flight

    return [bytes(flight(Writer(dialect), n=8).data) for dialect in (mavlink1, mavlink2)]


def _bags(*kinds: str) -> list[bytes]:
    from tests.fusion.test_log_rosbag import START_NS, Bag, flat

    files = []
    with TemporaryDirectory() as folder:
        for kind in kinds:
            path = Path(folder) / (f"{kind}.bag" if kind.startswith("ros1") else kind)
            with Bag(path, kind) as bag:
                for k in range(6):
                    t_ns = START_NS + k * 10_000_000
                    accel = (0.0, 0.0, 9.8)
                    bag.write("/imu", bag.imu(t_ns, (0.1, 0.2, 0.3), accel, (1, 0, 0, 0)), t_ns)
                    bag.write("/cam", bag.image(t_ns, np.full((4, 6), 10 * k, np.uint8)), t_ns)
                    info = bag.camera_info(t_ns, 6, 4, (5.0, 5.0, 2.5, 1.5), "plumb_bob", np.zeros(5))
                    bag.write("/cam_info", info, t_ns)
            files.append(flat(path, kind).read_bytes())
    return files


def _videos() -> list[bytes]:
    from tests.fusion.test_video import encode

    pictures = [np.full((32, 32), 20 * k, np.uint8) for k in range(6)]
    with TemporaryDirectory() as folder:
        times = np.arange(6) * 0.05
        return [
            encode(
                Path(folder) / name,
                pictures,
                codec="mpeg4",
                times_s=times,
                clock=Fraction(1, 1000),
                b_frames=0,
            ).read_bytes()
            for name in ("a.mp4", "a.mkv")
        ]


def _gpmf() -> list[bytes]:
    from tests.fusion.test_video import telemetry

    return [telemetry(np.full((4, 3), 0.1), np.full((4, 3), 9.8))]


#: Texts, whose readers are quick and our own.
TEXTS = {
    "calibration_yaml": Target("camera.yaml", _calibrations, calibration),
    "calibration_json": Target("camera.json", _calibrations, calibration),
    "calibration_ini": Target("camera.ini", _calibrations, calibration),
    "manifest": Target("flight.toml", _manifests, read_manifest),
    "settings": Target("settings.toml", _settings, settings),
    "table": Target("table.csv", _tables, table),
    "gyroflow": Target("log.gcsv", _gyroflow, log),
    "pictures_list": Target("cam0/data.csv", lambda: [LIST_OF_PICTURES], pictures_list),
    "picture": Target("picture.jpg", lambda: [PICTURE[:3000], PICTURE], picture),
    "gpmf": Target("packet.bin", _gpmf, gpmf),
}
#: Logs in binary formats; `tests.fusion.damage` cuts and flips each in the tests.
LOGS = {
    "ulog": Target("log.ulg", _ulogs, log),
    "dataflash": Target("log.BIN", _dataflash, log),
    "tlog": Target("log.tlog", _tlogs, log),
    "ros1": Target("log.bag", lambda: _bags("ros1", "ros1-lz4"), log),
    "ros2_sqlite3": Target("log.db3", lambda: _bags("sqlite3"), log),
    "ros2_mcap": Target("log.mcap", lambda: _bags("mcap"), log),
    "video": Target("log.mp4", _videos, log),
}
TARGETS = TEXTS | LOGS
