"""Folders of public data sets: TUM RGB-D, UZH-FPV and KITTI raw drives.

========= ============================================== ==========================================================
data set  pictures                                       sensors
========= ============================================== ==========================================================
TUM RGB-D ``rgb.txt``: time and file                     none that is used: its accelerometer has no gyroscope beside
UZH-FPV   ``images.txt``, ``left_images.txt``            ``imu.txt``: the camera's own IMU
KITTI     ``image_00/data``, ``image_00/timestamps.txt`` ``oxts``: the vehicle's, x forward, y left, z up
========= ============================================== ==========================================================

Ground truth (``groundtruth.txt``) is never used as an input.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np

from fusion.flight import AttitudeStream, FloatArray, ImuStream, TimeArray, VectorStream
from fusion.logs.composite import CompositeLog, Part
from fusion.logs.contents import Kind, LogContents, Topic
from fusion.logs.csv import columns
from fusion.logs.csv.times import read_times
from fusion.logs.imu_series import imu_stream
from fusion.logs.pictures import picture_folder
from fusion.logs.samples import Problems, WithProblems, counted
from fusion.logs.series import (
    MAX_VELOCITY,
    Series,
    SeriesLog,
    Where,
    attitude_stream,
    quaternions,
    vector_stream,
)
from vision import InputError

PICTURE_LISTS = ("rgb.txt", "images.txt", "left_images.txt", "right_images.txt")
IMU_FILE, OXTS = "imu.txt", "oxts"
OXTS_COLUMNS = 30
ANGLES, VELOCITY, ACCEL, GYRO = slice(3, 6), slice(8, 11), slice(11, 14), slice(17, 20)
_FLIP = np.array([1.0, -1.0, -1.0])  # x forward, y left, z up to x forward, y right, z down


def recognises(path: Path) -> bool:
    """Whether a folder has the layout of one of these data sets."""
    return path.is_dir() and bool(_lists(path) or _cameras(path) or _is_camera(path))


def open_log(path: Path) -> LogContents:
    """Open the pictures and sensors of a data set.

    Raises
    ------
    InputError
        If its pictures or their times cannot be read.
    """
    if _lists(path):
        return _listed(path)
    return _kitti(path)


def _lists(path: Path) -> list[Path]:
    return [path / name for name in PICTURE_LISTS if (path / name).is_file()]


def _listed(path: Path) -> CompositeLog:
    """Pictures by lists of time and file, and an IMU's text file beside them."""
    parts: dict[tuple[Kind, str], Part] = {}
    problems: Problems = ()
    for text in _lists(path):
        folder = path / _folder_of_pictures(text)
        name = text.stem.removesuffix("_images").removesuffix("images") or "images"
        log = picture_folder.open_folder(folder, times=text)
        parts[Kind.FRAMES, name] = Part(log, picture_folder.TOPIC)
    if (path / IMU_FILE).is_file():
        imu = columns.open_log(path / IMU_FILE)
        parts |= {(t.kind, t.name): Part(imu, t.name) for t in imu.topics if t.kind is Kind.IMU}
    if (path / "accelerometer.txt").is_file():
        problems += ("accelerometer.txt: an accelerometer without gyroscope, left out",)
    camera = next((c for c in (path / "calibration.yaml", path / "camchain.yaml") if c.is_file()), None)
    what = "TUM RGB-D folder" if (path / PICTURE_LISTS[0]).is_file() else "UZH-FPV folder"
    return CompositeLog(path, what, parts, problems, camera)


def _folder_of_pictures(text: Path) -> Path:
    names = read_times(text, None).value.names
    if not names:
        raise InputError("lists no pictures", file=text, remedy="a line is time and file name")
    return Path(names[0].strip().strip('"')).parent


def _is_camera(path: Path) -> bool:
    return (path / "data").is_dir() and (path / "timestamps.txt").is_file() and path.name.startswith("image")


def _cameras(path: Path) -> list[Path]:
    return [c for c in sorted(path.glob("image_0*")) if _is_camera(c)]


def _kitti(path: Path) -> CompositeLog:
    """Cameras of a raw drive, and its inertial navigation."""
    parts: dict[tuple[Kind, str], Part] = {}
    problems: Problems = ()
    for camera in [path] if _is_camera(path) else _cameras(path):
        log = picture_folder.open_folder(camera / "data", times=camera / "timestamps.txt")
        parts[Kind.FRAMES, camera.name] = Part(log, picture_folder.TOPIC)
    if (path / OXTS / "timestamps.txt").is_file():
        oxts = _open_oxts(path / OXTS)
        parts |= {(topic.kind, topic.name): Part(oxts, topic.name) for topic in oxts.topics}
    return CompositeLog(path, "KITTI raw drive", parts, problems)


def _open_oxts(path: Path) -> SeriesLog:
    """Read a file per sample: 30 numbers, SI and radians, of a body x forward, y left, z up."""
    listed = read_times(path / "timestamps.txt", None).value
    files = sorted((path / "data").glob("*.txt"))
    t_ns, rows, bad = [], [], 0
    for row, time_ns in zip(listed.row.tolist(), listed.t_ns.tolist(), strict=True):
        numbers = _numbers(files[row]) if row < len(files) else None
        if numbers is None:
            bad += 1
            continue
        t_ns.append(time_ns)
        rows.append(numbers)
    if not rows:
        raise InputError("contains no sample that can be read", file=path, remedy="take the folder away")
    problems = (f"oxts: {counted(bad, 'sample')} that cannot be read left out",) if bad else ()
    times, values, where = np.array(t_ns, dtype=np.int64), np.array(rows), Where(path, OXTS)
    note = "axes flu, of the inertial navigation"
    readers = (
        (Kind.IMU, partial(_imu, times, values, where)),
        (Kind.ATTITUDE, partial(_attitude, times, values, where)),
        (Kind.VELOCITY, partial(_velocity, times, values, where)),
    )
    series = [Series(Topic(OXTS, kind, times, note), read) for kind, read in readers]
    return SeriesLog(path, "KITTI oxts", series, problems)


def _numbers(file: Path) -> Sequence[float] | None:
    try:
        numbers = [float(field) for field in file.read_text(encoding="utf-8").split()]
    except (OSError, ValueError):
        return None
    return numbers if len(numbers) >= OXTS_COLUMNS else None


def _imu(t_ns: TimeArray, values: FloatArray, where: Where) -> WithProblems[ImuStream]:
    return imu_stream(t_ns, values[:, GYRO] * _FLIP, values[:, ACCEL] * _FLIP, where)


def _attitude(t_ns: TimeArray, values: FloatArray, where: Where) -> WithProblems[AttitudeStream]:
    q_up = quaternions(*values[:, ANGLES].T)  # from a body z up to a world z up
    return attitude_stream(t_ns, q_up * np.array([1.0, 1.0, -1.0, -1.0]), where)


def _velocity(t_ns: TimeArray, values: FloatArray, where: Where) -> WithProblems[VectorStream]:
    return vector_stream(t_ns, values[:, VELOCITY] * _FLIP, where, MAX_VELOCITY)
