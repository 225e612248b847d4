"""Gyroflow's IMU logs (``.gcsv``), written by action cameras and loggers beside their video.

Lines of ``key,value`` are followed by a table ``t,gx,gy,gz,ax,ay,az`` of counts: ``tscale`` converts them to seconds,
``gscale`` to rad/s and ``ascale`` to g. Axes are the sensor's own and are not changed: ``camera_axis`` declares the
one along which the camera looks, see `fusion.logs.manifest.manifest`; the rest follows from gravity.

Format: https://docs.gyroflow.xyz/app/technical-details/gcsv-format
"""

from __future__ import annotations

from math import isfinite
from pathlib import Path

import numpy as np

from fusion.flight import ImuStream
from fusion.logs.contents import Kind, LogContents, Topic
from fusion.logs.csv.rows import read_head
from fusion.logs.csv.table import Layout, read_columns
from fusion.logs.imu_series import imu_stream
from fusion.logs.samples import WithProblems
from fusion.logs.series import Series, SeriesLog, Where
from vision import InputError

MAGICS = ("GYROFLOW IMU LOG", "CAMERA IMU LOG")
GYRO, ACCEL = ("gx", "gy", "gz"), ("ax", "ay", "az")
ONE_G_M_S2 = 9.80665
LONGEST_S = 1e9


def recognises(path: Path) -> bool:
    """Whether a file begins like these logs."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return file.read(32).startswith(tuple(magic.encode() for magic in MAGICS))


def open_log(path: Path) -> LogContents:
    """Read the log.

    Raises
    ------
    InputError
        If its table or a scale is missing.
    """
    lines = read_head(path)
    start = next((i for i, line in enumerate(lines) if line.strip().startswith("t,")), None)
    if start is None:
        raise InputError("has no table of samples", file=path, remedy="copy the whole file from the camera")
    header = dict(line.strip().split(",", 1) for line in lines[:start] if "," in line)
    names = tuple(name.strip() for name in lines[start].split(","))
    if any(name not in names for name in GYRO):
        raise InputError(
            "its table has no gx, gy, gz", file=path, remedy="copy the whole file from the camera"
        )
    with_accel = all(name in names for name in ACCEL)
    wanted = [names.index(name) for name in (*GYRO, *(ACCEL if with_accel else ()))]
    layout = Layout(path, ",", names, ("",) * len(names), start + 1, False, False, ())
    rows, problems = read_columns(layout, 0, wanted, "f8")
    seconds = rows.first.astype(float) * _scale(header, "tscale", path)
    sound = np.isfinite(seconds) & (np.abs(seconds) < LONGEST_S)
    t_ns = np.where(sound, np.rint(np.where(sound, seconds, 0.0) * 1e9), -1).astype(np.int64)
    gyro = rows.values[:, :3] * _scale(header, "gscale", path)
    accel = np.full_like(gyro, np.nan)
    if with_accel:
        accel = rows.values[:, 3:] * (_scale(header, "ascale", path) * ONE_G_M_S2)

    def read() -> WithProblems[ImuStream]:
        return imu_stream(t_ns, gyro, accel, Where(path, path.name))

    note = f"axes of the sensor; orientation {header.get('orientation', 'not told')} of the camera is not applied"
    log = SeriesLog(path, "Gyroflow IMU log", [Series(Topic("imu", Kind.IMU, t_ns, note), read)], problems)
    log.body_frame = "frd"  # axes unchanged
    return log


def _scale(header: dict[str, str], name: str, path: Path) -> float:
    try:
        scale = float(header[name])
    except (KeyError, ValueError):
        scale = float("nan")
    if not isfinite(scale) or scale <= 0.0:
        raise InputError(
            f"{name} is {header.get(name, 'missing')}",
            file=path,
            remedy="give the factor that the logger documents",
        )
    return scale
