"""Flight folders in the ASL / EuRoC layout.

``mav0/cam0`` is required; ``imu0``, ``attitude0``, ``position0``, ``velocity0`` and ``range0`` are read if
they exist (or another number), and so is ``corridor_truth.csv`` beside ``mav0``. The body's axes are declared in
``mav0/body.yaml`` (default: ``flu`` with world z up) and converted to FRD with world z down here. Each sensor's
``T_BS`` (body from sensor) is applied as a rotation. Its lever arm is ignored: the effect on the specific force is
small compared with the accelerations in flight, for which the estimator allows anyway.

``state_groundtruth_estimate0`` is never used as an input; `read_ground_truth` reads it for tests and benchmarks.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np

from fusion.flight import (
    AttitudeStream,
    CorridorTruth,
    FloatArray,
    FrameStream,
    ImuStream,
    RangeStream,
    TimeArray,
    VectorStream,
)
from fusion.logs.contents import Kind, Topic
from fusion.logs.csv.rows import parse_time
from fusion.logs.csv.stamped_table import STAMP, CsvTable, read_table
from fusion.logs.pictures.camera_folder import read_frames
from fusion.logs.samples import (
    MIN_IMU_STEP_NS,
    MIN_STEP_NS,
    BoolArray,
    Problems,
    WithProblems,
    counted,
    finite,
    report_dropped,
)
from fusion.logs.series import QUATERNION_TOLERANCE, Series, SeriesLog, Stream, Where, range_stream
from vision import Camera, InputError
from vision.cameras.calibration import read_body_frame, read_yaml, rotation_of_transform, to_frd
from vision.cameras.camera import BodyFrame
from vision.limits import check_is_file

TRUTH_NAME = "corridor_truth.csv"
_TRUTH_COLUMNS = ("heading_rad", "lateral_offset_m", "corridor_width_m", "corridor_id", "in_junction")
_GROUND_TRUTH = "state_groundtruth_estimate0"
_KINDS = {
    "cam": Kind.FRAMES,
    "imu": Kind.IMU,
    "attitude": Kind.ATTITUDE,
    "position": Kind.POSITION,
    "velocity": Kind.VELOCITY,
    "range": Kind.RANGE,
}


@dataclass(frozen=True, slots=True, eq=False)
class GroundTruth:
    """Full state of the vehicle from ``state_groundtruth_estimate0``; for tests and benchmarks only.

    Parameters
    ----------
    t_ns
        Times (n,).
    p_world_m
        Position (n, 3) in the world, z down.
    q_world_body
        Unit quaternions (n, 4), w x y z, body FRD to world z down.
    v_world_m_s
        Velocity (n, 3) in the world, z down.
    """

    t_ns: TimeArray
    p_world_m: FloatArray
    q_world_body: FloatArray
    v_world_m_s: FloatArray


@dataclass(frozen=True, slots=True)
class _Folder:
    """A ``mav0``: its path, and the body axes of its files."""

    path: Path
    body_frame: BodyFrame

    def table(
        self, stream: str, columns: tuple[str, ...], *roles: str, min_step_ns: int = MIN_STEP_NS
    ) -> WithProblems[CsvTable]:
        """Read a stream's ``data.csv``; its columns are those of the roles."""
        path = self.path / stream / "data.csv"
        label = f"{stream}/data.csv"
        return read_table(path, columns, label=label, min_step_ns=min_step_ns, roles=roles)

    def sensor(self, stream: str) -> dict[str, Any]:
        """Read a stream's ``sensor.yaml``; empty if it has none."""
        path = self.path / stream / "sensor.yaml"
        return read_yaml(path) if path.exists() else {}

    def R_frd_sensor(self, stream: str, sensor: dict[str, Any]) -> FloatArray:
        """Rotation (3, 3) from a sensor's axes to body FRD; without ``T_BS`` these are the body's."""
        R_body_sensor = np.eye(3)
        if sensor.get("T_BS") is not None:
            try:
                R_body_sensor = rotation_of_transform(sensor["T_BS"], "T_BS")
            except InputError as error:
                path = self.path / stream / "sensor.yaml"
                raise InputError(error.problem, file=path, remedy=error.remedy) from error
        return to_frd(self.body_frame) @ R_body_sensor

    def dropped(self, good: BoolArray, stream: str, what: str, t_ns: TimeArray) -> Problems:
        """Report the rows of a stream that are not good; `InputError` if none is.

        Parameters
        ----------
        good, t_ns
            Rows (n,) to keep, and their times (n,).
        stream
            Name of the sensor's folder.
        what
            Fault of the other rows.
        """
        path, label = self.path / stream / "data.csv", f"{stream}/data.csv"
        return report_dropped(good, t_ns, what, label, file=path, remedy="take the folder away")


def recognises(path: Path) -> bool:
    """Whether a folder is a flight in the ASL layout, or the ``mav0`` of one."""
    return path.is_dir() and ((path / "mav0").is_dir() or (path / "cam0").is_dir())


def open_log(path: Path) -> AslLog:
    """Open a flight folder, see `fusion.logs.contents`."""
    root = path.resolve()
    mav0 = root / "mav0" if (root / "mav0").is_dir() else root
    return AslLog(mav0, mav0.parent if mav0.name == "mav0" else mav0)


class AslLog(SeriesLog):
    """A flight folder as `fusion.logs.contents.LogContents`; topics are the folders of its sensors."""

    pictures_remedy = "a flight needs cam0/data.csv and cam0/data/ in its mav0"

    def __init__(self, mav0: Path, root: Path) -> None:
        body_frame = read_body_frame(mav0 / "body.yaml")
        folder = _Folder(mav0, body_frame)
        series: list[Series] = []
        cameras: list[Topic] = []
        problems: Problems = ()
        for path in sorted(entry for entry in mav0.iterdir() if entry.is_dir()):
            kind = _KINDS.get(path.name.rstrip("0123456789"))
            if kind is Kind.FRAMES:
                cameras.append(Topic(path.name, kind, _raw_times(path)))
            elif kind is not None and (path / "data.csv").exists():
                topic = Topic(path.name, kind, _raw_times(path))
                series.append(Series(topic, partial(_READERS[kind], folder, path.name)))
            elif kind is not None:
                problems += (f"{path.name} has no data.csv, stream left out",)
        super().__init__(root, "ASL / EuRoC folder", series, problems)
        self.topics = tuple(sorted((*cameras, *self.topics), key=lambda topic: topic.name))
        self.body_frame = body_frame
        self._mav0 = mav0

    def calibration_file(self, topic: str) -> Path:
        """Return the path of a camera's calibration."""
        return self._mav0 / topic / "sensor.yaml"

    def file_of(self, topic: str) -> Path:
        """Return the file with a topic's times."""
        return self._mav0 / topic / "data.csv"

    def frames(self, topic: str) -> WithProblems[FrameStream]:
        """Pictures of a camera."""
        return read_frames(self._mav0 / topic)

    def camera(self, topic: str) -> Camera | None:
        """Read the calibration in the camera's folder."""
        path = self.calibration_file(topic)
        return Camera.from_yaml(path, body_frame=self.body_frame) if path.exists() else None

    def truth(self) -> WithProblems[CorridorTruth | None]:
        """Read ``corridor_truth.csv`` beside ``mav0``; None if there is none."""
        path = self.path / TRUTH_NAME
        return read_corridor_truth(path) if path.exists() else WithProblems(None)


def _raw_times(folder: Path) -> TimeArray:
    """Read the times of a stream, unsorted, from its ``data.csv``, or else from its pictures' names."""
    path = folder / "data.csv"
    if not path.exists():
        names = sorted(os.listdir(folder / "data")) if (folder / "data").is_dir() else []
        fields = [Path(name).stem for name in names]
        return np.array([t for field in fields if (t := parse_time(field)) is not None], dtype=np.int64)
    check_is_file(path)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            return np.loadtxt(path, dtype=np.int64, delimiter=",", usecols=0, comments="#", ndmin=1)
        except (OSError, ValueError, OverflowError, Warning):  # damaged: read it line by line
            pass
    with suppress(OSError), path.open(encoding="utf-8", errors="replace") as file:
        stamps = (STAMP.match(line) for line in file)
        times = (parse_time(stamp[1]) for stamp in stamps if stamp is not None)
        return np.array([t_ns for t_ns in times if t_ns is not None], dtype=np.int64)
    return np.zeros(0, dtype=np.int64)


def read_ground_truth(path: str | Path) -> GroundTruth:
    """Read ``state_groundtruth_estimate0`` of a flight folder, converted to FRD and world z down."""
    root = Path(path)
    mav0 = root / "mav0" if (root / "mav0").is_dir() else root
    folder = _Folder(mav0, read_body_frame(mav0 / "body.yaml"))
    columns = ("p_x", "p_y", "p_z", "q_w", "q_x", "q_y", "q_z", "v_x", "v_y", "v_z")
    biases = ("b_w_x", "b_w_y", "b_w_z", "b_a_x", "b_a_y", "b_a_z")
    if not (mav0 / _GROUND_TRUTH / "data.csv").exists():
        raise InputError(
            f"has no {_GROUND_TRUTH}/data.csv", file=mav0, remedy="give a flight with ground truth"
        )
    table = folder.table(_GROUND_TRUTH, columns + biases, "position", "quaternion", "velocity").value
    R_world = to_frd(folder.body_frame)
    q = _attitude_in_frd(folder, _GROUND_TRUTH, table.values[:, 3:7])
    return GroundTruth(table.t_ns, table.values[:, 0:3] @ R_world.T, q, table.values[:, 7:10] @ R_world.T)


def _read_imu(folder: _Folder, stream: str) -> WithProblems[ImuStream]:
    columns = ("w_x", "w_y", "w_z", "a_x", "a_y", "a_z")
    table, problems = folder.table(stream, columns, "gyro", "accel", min_step_ns=MIN_IMU_STEP_NS)
    good = finite(table.values[:, :3])
    problems += folder.dropped(good, stream, "a gyro value that is not finite", table.t_ns)
    t_ns, values = table.t_ns[good], table.values[good]
    no_accel = ~finite(values[:, 3:])
    if no_accel.any():
        values[no_accel, 3:] = np.nan
        problems += (f"{stream}/data.csv: {counted(int(no_accel.sum()), 'row')} without acceleration",)
    sensor = folder.sensor(stream)
    R_frd_imu = folder.R_frd_sensor(stream, sensor)
    accel_m_s2 = values[:, 3:] @ R_frd_imu.T
    imu = ImuStream(
        t_ns,
        values[:, :3] @ R_frd_imu.T,
        accel_m_s2,
        gyro_noise_density=_noise(folder, stream, sensor, "gyroscope_noise_density"),
        gyro_random_walk=_noise(folder, stream, sensor, "gyroscope_random_walk"),
    )
    return WithProblems(imu, problems)


def _noise(folder: _Folder, stream: str, sensor: dict[str, Any], key: str) -> float | None:
    value = sensor.get(key)
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float) or not (isfinite(value) and value > 0.0):
        raise InputError(
            f"{key} is {value!r}",
            file=folder.path / stream / "sensor.yaml",
            remedy="give a positive number, or leave the line out",
        )
    return float(value)


def _read_attitude(folder: _Folder, stream: str) -> WithProblems[AttitudeStream]:
    table, problems = folder.table(stream, ("q_w", "q_x", "q_y", "q_z"), "quaternion")
    length = np.linalg.norm(table.values, axis=1)
    good = np.abs(length - 1.0) <= QUATERNION_TOLERANCE  # NaN is not
    problems += folder.dropped(good, stream, "a quaternion that is not of unit length", table.t_ns)
    q_world_body = _attitude_in_frd(folder, stream, table.values[good])
    return WithProblems(AttitudeStream(table.t_ns[good], q_world_body), problems)


def _attitude_in_frd(folder: _Folder, stream: str, q_world_sensor: FloatArray) -> FloatArray:
    """Convert quaternions (n, 4) from sensor to the file's world into unit ones from body FRD to world z down."""
    q = q_world_sensor / np.linalg.norm(q_world_sensor, axis=1, keepdims=True)
    R_frd_sensor = folder.R_frd_sensor(stream, folder.sensor(stream))
    R_down_world = to_frd(folder.body_frame)  # the world is rotated about x like the body
    if np.array_equal(R_frd_sensor, R_down_world):
        return np.asarray(q * np.array([1.0, 1.0, *np.diag(R_down_world)[1:]]))
    from scipy.spatial.transform import Rotation

    scalar_last = np.roll(q, -1, axis=1)
    rotation = Rotation.from_quat(scalar_last) * Rotation.from_matrix(R_frd_sensor).inv()
    return np.roll((Rotation.from_matrix(R_down_world) * rotation).as_quat(), 1, axis=1)


def _read_position(folder: _Folder, stream: str) -> WithProblems[VectorStream]:
    return _read_vectors(folder, stream, ("p_x", "p_y", "p_z"), "position", to_frd(folder.body_frame))


def _read_velocity(folder: _Folder, stream: str) -> WithProblems[VectorStream]:
    R_frd_sensor = folder.R_frd_sensor(stream, folder.sensor(stream))
    return _read_vectors(folder, stream, ("v_x", "v_y", "v_z"), "velocity", R_frd_sensor)


def _read_vectors(
    folder: _Folder, stream: str, columns: tuple[str, ...], role: str, R: FloatArray
) -> WithProblems[VectorStream]:
    table, problems = folder.table(stream, columns, role)
    good = finite(table.values)
    problems += folder.dropped(good, stream, "a value that is not finite", table.t_ns)
    return WithProblems(VectorStream(table.t_ns[good], table.values[good] @ R.T), problems)


def _read_range(folder: _Folder, stream: str) -> WithProblems[RangeStream]:
    table, problems = folder.table(stream, ("distance",), "range")
    where = Where(folder.path / stream / "data.csv", f"{stream}/data.csv")
    distances, more = range_stream(table.t_ns, table.values[:, 0], where)
    return WithProblems(distances, problems + more)


_READERS: dict[Kind, Callable[[_Folder, str], WithProblems[Stream]]] = {
    Kind.IMU: _read_imu,
    Kind.ATTITUDE: _read_attitude,
    Kind.POSITION: _read_position,
    Kind.VELOCITY: _read_velocity,
    Kind.RANGE: _read_range,
}


def read_corridor_truth(path: Path) -> WithProblems[CorridorTruth]:
    """Read a ``corridor_truth.csv``; its columns may be in any order."""
    table, problems = read_table(
        path, _TRUTH_COLUMNS, label=path.name, min_step_ns=MIN_IMU_STEP_NS, by_name=True
    )
    heading_rad, offset_m, width_m, corridor_id, in_junction = table.values.T
    numbered = np.isfinite(corridor_id) & np.isfinite(in_junction)
    if not numbered.all():
        raise InputError(
            f"corridor_id or in_junction is missing at {table.t_ns[~numbered][0]}",
            file=path,
            remedy="give whole numbers in every row, in_junction 0 or 1",
        )
    truth = CorridorTruth(
        table.t_ns, heading_rad, offset_m, width_m, corridor_id.astype(np.int64), in_junction != 0.0
    )
    return WithProblems(truth, problems)
