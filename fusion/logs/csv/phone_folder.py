"""Folders of a phone's recorder, with a CSV per sensor: gyroscope and accelerometer are joined by time.

The phone's axes, x right and y up along its screen, z out of it, are not changed: its orientation is found from
gravity and the direction of its camera, see ``camera_axis`` in `fusion.logs.manifest.manifest`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fusion.flight import FloatArray, ImuStream, Remark, TimeArray, VectorStream
from fusion.logs.contents import Kind, LogContents, Topic
from fusion.logs.csv.column_map import ColumnMap
from fusion.logs.csv.column_names import map_of_names
from fusion.logs.csv.table import read_layout
from fusion.logs.csv.times import read_timed
from fusion.logs.imu_series import joined_imu
from fusion.logs.samples import WithProblems
from fusion.logs.series import Series, SeriesLog, Where
from fusion.logs.units import in_si
from vision import InputError

GYRO = "gyroscope"
ACCELS = ("totalacceleration", "accelerometer")  # the first one includes gravity in every recorder
TOPIC = "imu"
FORMAT = "folder of a phone's sensors"
CAMERA_AXIS = "-z"  # of the camera on the back


def recognises(path: Path) -> bool:
    """Whether a folder contains a gyroscope's file."""
    return path.is_dir() and GYRO in _tables(path)


def open_log(path: Path) -> LogContents:
    """Open the gyroscope, with the acceleration if there is a file for it.

    Raises
    ------
    InputError
        If the gyroscope cannot be read.
    """
    tables = _tables(path)
    (t_ns, gyro), problems = _read(tables[GYRO], "gyro")
    accel, note = None, "no acceleration"
    name = next((name for name in ACCELS if name in tables), None)
    if name is not None:
        (accel_t_ns, force), more = _read(tables[name], "accel")
        accel, note = VectorStream(accel_t_ns, force), f"acceleration from {tables[name].name}"
        problems += more
    where = Where(tables[GYRO], tables[GYRO].name)
    accel_where = where if name is None else Where(tables[name], tables[name].name)

    def read() -> WithProblems[ImuStream]:
        return joined_imu(t_ns, gyro, accel, where, accel_where)

    topic = Topic(TOPIC, Kind.IMU, t_ns, f"axes of the phone; {note}")
    log = SeriesLog(path, FORMAT, [Series(topic, read)], problems)
    log.body_frame = "frd"  # axes unchanged
    return log


def _tables(path: Path) -> dict[str, Path]:
    return {file.stem.lower(): file for file in sorted(path.iterdir()) if file.suffix.lower() == ".csv"}


def _read(file: Path, role: str) -> WithProblems[tuple[TimeArray, FloatArray]]:
    """Read times (n,) and a sensor's vectors (n, 3) in SI units, along the file's axes."""
    layout = read_layout(file)
    columns, assumed = map_of_names(layout)
    names = () if columns is None else columns.columns_of(role)
    if columns is None or not names:
        raise InputError(
            f"has no columns x, y, z of the {role}: {', '.join(layout.names[:20])}",
            file=file,
            remedy="give it alone, with its columns named under [imu.columns] of flight.toml",
        )
    places = [layout.find(name, f"columns.{role}") for name in names]
    timed, problems = read_timed(layout, ColumnMap(), places)
    unit = columns.unit_of(role) or ColumnMap.model_fields[f"{role}_unit"].default
    values = np.asarray(timed.rows.values * in_si(unit))
    own = tuple(text for text in (*assumed, *problems) if not isinstance(text, Remark))
    return WithProblems((timed.t_ns, values), own)
