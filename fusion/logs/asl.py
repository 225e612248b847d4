"""Flight folders in the ASL / EuRoC layout.

``mav0/cam0`` is required; ``imu0``, ``attitude0``, ``position0`` and ``velocity0`` are read where they
exist, and so is ``corridor_truth.csv`` beside ``mav0``. Files give the body's axes as ``mav0/body.yaml`` says
(``flu`` with world z up where it is absent) and turn into FRD with world z down here, once. Each sensor's
``T_BS`` (body from sensor) is applied as a rotation; its lever arm is ignored: what it adds to the specific
force is small beside the accelerations of flight, which the estimator has to distrust anyway.

``state_groundtruth_estimate0`` is the answer and never becomes an input; `read_ground_truth` reads it for
tests and benchmarks.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np

from fusion.flight import (
    AttitudeStream,
    CorridorTruth,
    Flight,
    FloatArray,
    ImuStream,
    TimeArray,
    VectorStream,
)
from fusion.logs.csv_table import CsvTable, read_table
from fusion.logs.pictures import check_size, read_frames
from fusion.logs.samples import MIN_IMU_STEP_NS, MIN_STEP_NS, BoolArray, counted, finite, keep_good
from vision import Camera, InputError
from vision.calibration import read_body_frame, read_yaml, rotation_of_transform, to_frd
from vision.camera import BodyFrame

QUATERNION_TOLERANCE = 0.05  # of its length; more is not rounding but damage

_TRUTH_COLUMNS = ("heading_rad", "lateral_offset_m", "corridor_width_m", "corridor_id", "in_junction")
_GROUND_TRUTH = "state_groundtruth_estimate0"


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
    """A ``mav0`` under reading: its path, its axes, and what went wrong so far."""

    path: Path
    body_frame: BodyFrame
    problems: list[str]

    def table(self, stream: str, columns: tuple[str, ...], min_step_ns: int = MIN_STEP_NS) -> CsvTable | None:
        """Read a stream's ``data.csv``; None where the log has no such stream."""
        path = self.path / stream / "data.csv"
        if not path.exists():
            if path.parent.exists():
                self.problems.append(f"{stream} has no data.csv, stream left out")
            return None
        return read_table(path, columns, self.problems, label=f"{stream}/data.csv", min_step_ns=min_step_ns)

    def sensor(self, stream: str) -> dict[str, Any]:
        """Read a stream's ``sensor.yaml``; empty where it has none."""
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

    def keep(self, good: BoolArray, stream: str, what: str, t_ns: TimeArray) -> None:
        """Report rows that are not good; `InputError` where none is."""
        path, label = self.path / stream / "data.csv", f"{stream}/data.csv"
        keep_good(good, t_ns, what, label, self.problems, file=path, remedy="take the folder away")


def recognises(path: Path) -> bool:
    """Whether a folder is a flight in the ASL layout, or the ``mav0`` of one."""
    return path.is_dir() and ((path / "mav0").is_dir() or (path / "cam0").is_dir())


def load(path: Path, camera: Camera | Path | None = None) -> Flight:
    """Read a flight folder; see `fusion.logs.load_flight`."""
    root = path.resolve()
    mav0 = root / "mav0" if (root / "mav0").is_dir() else root
    root = mav0.parent if mav0.name == "mav0" else mav0
    folder = _Folder(mav0, read_body_frame(mav0 / "body.yaml"), [])
    frames = read_frames(mav0 / "cam0", folder.problems)
    if not isinstance(camera, Camera):
        camera = _read_camera(folder, camera)
    mount_problem = camera.mount_problem()
    if mount_problem is not None:
        folder.problems.append(mount_problem)
    check_size(frames, camera)
    imu, attitude = _read_imu(folder), _read_attitude(folder)
    position = _read_vectors(folder, "position0", ("p_x", "p_y", "p_z"), in_body=False)
    velocity = _read_vectors(folder, "velocity0", ("v_x", "v_y", "v_z"), in_body=True)
    truth = _read_corridor_truth(root / "corridor_truth.csv", folder.problems)
    streams = {"imu0": imu, "attitude0": attitude, "position0": position, "velocity0": velocity}
    for name, stream in streams.items():
        if stream is not None:
            _check_clock(mav0 / name / "data.csv", stream.t_ns, frames.t_ns)
    if truth is not None:
        _check_clock(root / "corridor_truth.csv", truth.t_ns, frames.t_ns)
    return Flight(
        root.name, camera, frames, imu, attitude, position, velocity, truth, problems=tuple(folder.problems)
    )


def read_ground_truth(path: str | Path) -> GroundTruth:
    """Read ``state_groundtruth_estimate0`` of a flight folder, turned into FRD and world z down."""
    root = Path(path)
    mav0 = root / "mav0" if (root / "mav0").is_dir() else root
    folder = _Folder(mav0, read_body_frame(mav0 / "body.yaml"), [])
    columns = ("p_x", "p_y", "p_z", "q_w", "q_x", "q_y", "q_z", "v_x", "v_y", "v_z")
    biases = ("b_w_x", "b_w_y", "b_w_z", "b_a_x", "b_a_y", "b_a_z")
    table = folder.table(_GROUND_TRUTH, columns + biases)
    if table is None:
        raise InputError(
            f"has no {_GROUND_TRUTH}/data.csv", file=mav0, remedy="give a flight with ground truth"
        )
    R_world = to_frd(folder.body_frame)
    q = _attitude_in_frd(folder, _GROUND_TRUTH, table.values[:, 3:7])
    return GroundTruth(table.t_ns, table.values[:, 0:3] @ R_world.T, q, table.values[:, 7:10] @ R_world.T)


def _read_camera(folder: _Folder, path: Path | None) -> Camera:
    if path is None:
        path = folder.path / "cam0" / "sensor.yaml"
        if not path.exists():
            raise InputError(
                "there is no such file", file=path, remedy="add the calibration, or name one with --camera"
            )
    return Camera.from_yaml(path, body_frame=folder.body_frame)


def _read_imu(folder: _Folder) -> ImuStream | None:
    columns = ("w_x", "w_y", "w_z", "a_x", "a_y", "a_z")
    table = folder.table("imu0", columns, min_step_ns=MIN_IMU_STEP_NS)
    if table is None:
        return None
    good = finite(table.values[:, :3])
    folder.keep(good, "imu0", "a gyro value that is not finite", table.t_ns)
    t_ns, values = table.t_ns[good], table.values[good]
    no_accel = ~finite(values[:, 3:])
    if no_accel.any():
        values[no_accel, 3:] = np.nan
        folder.problems.append(f"imu0/data.csv: {counted(int(no_accel.sum()), 'row')} without acceleration")
    sensor = folder.sensor("imu0")
    R_frd_imu = folder.R_frd_sensor("imu0", sensor)
    accel_m_s2 = values[:, 3:] @ R_frd_imu.T
    if not no_accel.all() and float(np.nanmedian(accel_m_s2[:, 2])) > 5.0:
        folder.problems.append(
            "imu0/data.csv: gravity points up in the body, so its axes are probably not "
            f"{folder.body_frame} as taken: check body.yaml and imu0's T_BS"
        )
    return ImuStream(
        t_ns,
        values[:, :3] @ R_frd_imu.T,
        accel_m_s2,
        gyro_noise_density=_noise(folder, sensor, "gyroscope_noise_density"),
        gyro_random_walk=_noise(folder, sensor, "gyroscope_random_walk"),
    )


def _noise(folder: _Folder, sensor: dict[str, Any], key: str) -> float | None:
    value = sensor.get(key)
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float) or not (isfinite(value) and value > 0.0):
        raise InputError(
            f"{key} is {value!r}",
            file=folder.path / "imu0" / "sensor.yaml",
            remedy="give a positive number, or leave the line out",
        )
    return float(value)


def _read_attitude(folder: _Folder) -> AttitudeStream | None:
    table = folder.table("attitude0", ("q_w", "q_x", "q_y", "q_z"))
    if table is None:
        return None
    length = np.linalg.norm(table.values, axis=1)
    good = np.abs(length - 1.0) <= QUATERNION_TOLERANCE  # NaN is not
    folder.keep(good, "attitude0", "a quaternion that is not of unit length", table.t_ns)
    q_world_body = _attitude_in_frd(folder, "attitude0", table.values[good])
    down_z = 1.0 - 2.0 * (q_world_body[:, 1] ** 2 + q_world_body[:, 2] ** 2)
    if float(np.median(down_z)) < 0.0:
        folder.problems.append(
            "attitude0/data.csv: the vehicle is upside down most of the time, so its axes are probably not "
            f"{folder.body_frame} as taken: check body.yaml and attitude0's T_BS"
        )
    return AttitudeStream(table.t_ns[good], q_world_body)


def _attitude_in_frd(folder: _Folder, stream: str, q_world_sensor: FloatArray) -> FloatArray:
    """Turn quaternions (n, 4) sensor to file's world into unit ones, body FRD to world z down."""
    q = q_world_sensor / np.linalg.norm(q_world_sensor, axis=1, keepdims=True)
    R_frd_sensor = folder.R_frd_sensor(stream, folder.sensor(stream))
    R_down_world = to_frd(folder.body_frame)  # the world turns about x as the body does
    if np.array_equal(R_frd_sensor, R_down_world):
        return np.asarray(q * np.array([1.0, 1.0, *np.diag(R_down_world)[1:]]))
    from scipy.spatial.transform import Rotation

    scalar_last = np.roll(q, -1, axis=1)
    rotation = Rotation.from_quat(scalar_last) * Rotation.from_matrix(R_frd_sensor).inv()
    return np.roll((Rotation.from_matrix(R_down_world) * rotation).as_quat(), 1, axis=1)


def _read_vectors(
    folder: _Folder, stream: str, columns: tuple[str, ...], *, in_body: bool
) -> VectorStream | None:
    table = folder.table(stream, columns)
    if table is None:
        return None
    good = finite(table.values)
    folder.keep(good, stream, "a value that is not finite", table.t_ns)
    R = folder.R_frd_sensor(stream, folder.sensor(stream)) if in_body else to_frd(folder.body_frame)
    return VectorStream(table.t_ns[good], table.values[good] @ R.T)


def _read_corridor_truth(path: Path, problems: list[str]) -> CorridorTruth | None:
    if not path.exists():
        return None
    table = read_table(
        path, _TRUTH_COLUMNS, problems, label=path.name, min_step_ns=MIN_IMU_STEP_NS, by_name=True
    )
    heading_rad, offset_m, width_m, corridor_id, in_junction = table.values.T
    numbered = np.isfinite(corridor_id) & np.isfinite(in_junction)
    if not numbered.all():
        raise InputError(
            f"corridor_id or in_junction is missing at {table.t_ns[~numbered][0]}",
            file=path,
            remedy="give whole numbers in every row, in_junction 0 or 1",
        )
    return CorridorTruth(
        table.t_ns, heading_rad, offset_m, width_m, corridor_id.astype(np.int64), in_junction != 0.0
    )


def _check_clock(path: Path, t_ns: TimeArray, frame_t_ns: TimeArray) -> None:
    if t_ns[0] > frame_t_ns[-1] or t_ns[-1] < frame_t_ns[0]:
        raise InputError(
            f"covers {t_ns[0]} to {t_ns[-1]} ns, the frames {frame_t_ns[0]} to {frame_t_ns[-1]} ns",
            file=path,
            remedy="put both on one clock, or take the stream away",
        )
