"""Write a simulated flight as an ASL folder, atomically: pictures, sensors, ground truth."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from fusion.files import error_text, replacing_folder
from fusion.progress import Progress
from fusion.simulate.config import SimulationConfig
from fusion.simulate.exposure import FlyingCamera
from fusion.simulate.imu import (
    AttitudeSamples,
    ImuSamples,
    quaternions,
    read_attitude,
    read_imu,
    read_range,
    sample_times,
)
from fusion.simulate.sensor import encode_jpeg
from vision import Camera, InputError
from vision.cameras.calibration import to_frd
from vision.cameras.camera import Distortion

FloatArray = npt.NDArray[np.float64]

TRUTH_RATE_HZ = 200.0
_LENS_NAMES = {
    Distortion.NONE: "none",
    Distortion.RADTAN: "radial-tangential",
    Distortion.EQUIDISTANT: "equidistant",
}


def simulate_flight(
    config: SimulationConfig,
    out_dir: str | Path,
    progress: Progress | None = None,
    camera: Camera | None = None,
) -> Path:
    """Simulate a flight and write its folder; the same configuration gives the same bytes.

    Parameters
    ----------
    out_dir
        The folder to create; it must not exist, or must be empty.
    progress
        Called with (done, total) frames.
    camera
        Replaces the lens and mount in ``config.camera``.

    Returns
    -------
    Path
        ``out_dir``.

    Raises
    ------
    InputError
        If the folder exists and is not empty, or cannot be written.
    """
    out = Path(out_dir).absolute()
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise InputError("is there already", file=out, remedy="name a folder that does not exist yet")
    try:
        with replacing_folder(out) as draft:
            _write(config, draft, progress or (lambda done, total: None), camera)
    except OSError as error:
        raise InputError(f"cannot be written: {error_text(error)}", file=out) from error
    return out


def _write(config: SimulationConfig, root: Path, progress: Progress, camera: Camera | None) -> None:
    flying = FlyingCamera.prepare(config, camera)
    mav0 = root / "mav0"
    R_file = to_frd(config.body_frame)
    imu: ImuSamples | None = None
    if config.imu is not None:
        times = sample_times(flying.trajectory.duration_s, config.imu.rate_hz)
        imu = read_imu(flying.trajectory.truth(times), config.imu, config.seed)
        _write_imu(mav0 / "imu0", config, imu, R_file)
    if config.attitude is not None:
        samples = read_attitude(flying.trajectory, config.attitude, imu, config.seed)
        _write_attitude(mav0 / "attitude0", config, samples, R_file)
    if config.range is not None:
        ranges = read_range(flying.trajectory, config.range, flying.camera.p_body_camera_m, config.seed)
        stamps = _stamps(config, ranges.t_s)
        _table(
            mav0 / "range0" / "data.csv",
            "#timestamp [ns],distance [m]",
            stamps,
            ranges.distance_m[:, None],
            4,
        )
        (mav0 / "range0" / "sensor.yaml").write_text(
            "sensor_type: range\ncomment: simulated; beside the camera, looks down along the body's z\n"
            f"rate_hz: {config.range.rate_hz:g}\n",
            encoding="utf-8",
        )
    _write_truth(root, config, flying, imu, R_file)
    (mav0 / "body.yaml").write_text(
        f"body_frame: {config.body_frame}   # {_AXES[config.body_frame]}\n", encoding="utf-8"
    )
    (root / "README.md").write_text(_readme(config, flying), encoding="utf-8")
    _write_camera(mav0 / "cam0", config, flying, R_file, progress)


_AXES = {
    "flu": "x forward, y left, z up; world z up",
    "frd": "x forward, y right, z down; world z down",
}


def _stamps(config: SimulationConfig, t_s: FloatArray) -> list[int]:
    return [config.start_ns + round(t * 1e9) for t in t_s.tolist()]


def _table(path: Path, header: str, stamps: list[int], values: FloatArray, digits: int = 9) -> None:
    """Write a table whose first column is the time stamp."""
    path.parent.mkdir(parents=True, exist_ok=True)
    rows = (
        f"{t}," + ",".join(f"{v:.{digits}f}" for v in row)
        for t, row in zip(stamps, values.tolist(), strict=True)
    )
    path.write_text("\n".join([header, *rows, ""]), encoding="utf-8")


def _transform(R: FloatArray, p: FloatArray) -> str:
    rows = [", ".join(f"{v:.12g}" for v in [*R[k].tolist(), float(p[k])]) for k in range(3)]
    body = ",\n         ".join([*rows, "0, 0, 0, 1"])
    return f"T_BS:\n  cols: 4\n  rows: 4\n  data: [{body}]\n"


def _write_imu(folder: Path, config: SimulationConfig, imu: ImuSamples, R_file: FloatArray) -> None:
    header = (
        "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],"
        "a_RS_S_x [m s^-2],a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]"
    )
    values = np.hstack([imu.gyro_rad_s @ R_file.T, imu.accel_m_s2 @ R_file.T])
    _table(folder / "data.csv", header, _stamps(config, imu.t_s), values)
    c = config.imu
    assert c is not None
    densities = {
        "gyroscope_noise_density": (c.gyro_noise_density, "rad/s/sqrt(Hz)"),
        "gyroscope_random_walk": (c.gyro_random_walk, "rad/s^2/sqrt(Hz)"),
        "accelerometer_noise_density": (c.accel_noise_density, "m/s^2/sqrt(Hz)"),
        "accelerometer_random_walk": (c.accel_random_walk, "m/s^3/sqrt(Hz)"),
    }
    # a density of zero is left out
    lines = [f"{name}: {value:.9g}   # {unit}\n" for name, (value, unit) in densities.items() if value > 0]
    text = "sensor_type: imu\ncomment: simulated; axes are the body's\n" + _transform(np.eye(3), np.zeros(3))
    (folder / "sensor.yaml").write_text(text + f"rate_hz: {c.rate_hz:g}\n" + "".join(lines), encoding="utf-8")


def _write_attitude(
    folder: Path, config: SimulationConfig, samples: AttitudeSamples, R_file: FloatArray
) -> None:
    # body and world are both rotated about x
    q = samples.q_world_body * np.array([1.0, 1.0, R_file[1, 1], R_file[2, 2]])
    _table(folder / "data.csv", "#timestamp [ns],qw,qx,qy,qz", _stamps(config, samples.t_s), q)
    assert config.attitude is not None
    (folder / "sensor.yaml").write_text(
        "sensor_type: attitude\ncomment: simulated attitude filter; yaw off by a constant, drift and disturbance\n"
        f"rate_hz: {config.attitude.rate_hz:g}\n"
        f'convention: "q = (w,x,y,z), v_world = R(q) v_body; {_AXES[config.body_frame]}"\n',
        encoding="utf-8",
    )


def _write_truth(
    root: Path, config: SimulationConfig, flying: FlyingCamera, imu: ImuSamples | None, R_file: FloatArray
) -> None:
    """Write ``corridor_truth.csv`` and the full state, at the IMU's times (or at 200 Hz)."""
    times = sample_times(flying.trajectory.duration_s, TRUTH_RATE_HZ) if imu is None else imu.t_s
    truth, stamps = flying.trajectory.truth(times), _stamps(config, times)
    rows = [
        f"{t},{heading:.9f},{offset:.6f},{width:.4f},{corridor},{junction}"
        for t, heading, offset, width, corridor, junction in zip(
            stamps,
            truth.heading_rad.tolist(),
            truth.lateral_offset_m.tolist(),
            truth.corridor_width_m.tolist(),
            truth.corridor_id.tolist(),
            truth.in_junction.astype(int).tolist(),
            strict=True,
        )
    ]
    header = "timestamp_ns,heading_rad,lateral_offset_m,corridor_width_m,corridor_id,in_junction"
    (root / "corridor_truth.csv").write_text("\n".join([header, *rows, ""]), encoding="utf-8")
    folder = root / "mav0" / "state_groundtruth_estimate0"
    q = quaternions(truth.R_world_body) * np.array([1.0, 1.0, R_file[1, 1], R_file[2, 2]])
    biases = np.zeros((len(times), 6))
    if imu is not None:
        biases = np.hstack([imu.gyro_bias_rad_s @ R_file.T, imu.accel_bias_m_s2 @ R_file.T])
    values = np.hstack([truth.p_world_m @ R_file.T, q, truth.v_world_m_s @ R_file.T, biases])
    header = (
        "#timestamp,p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z [],"
        "v_RS_R_x [m s^-1],v_RS_R_y [m s^-1],v_RS_R_z [m s^-1],"
        "b_w_RS_S_x [rad s^-1],b_w_RS_S_y [rad s^-1],b_w_RS_S_z [rad s^-1],"
        "b_a_RS_S_x [m s^-2],b_a_RS_S_y [m s^-2],b_a_RS_S_z [m s^-2]"
    )
    _table(folder / "data.csv", header, stamps, values)
    text = f"sensor_type: visual-inertial\ncomment: exact; {_AXES[config.body_frame]}, x along corridor 1\n"
    (folder / "sensor.yaml").write_text(text + _transform(np.eye(3), np.zeros(3)), encoding="utf-8")


def _write_camera(
    folder: Path, config: SimulationConfig, flying: FlyingCamera, R_file: FloatArray, progress: Progress
) -> None:
    (folder / "data").mkdir(parents=True)
    c = flying.camera
    lens = f"distortion_model: {_LENS_NAMES[c.distortion]}\n"
    lens += f"distortion_coefficients: [{', '.join(f'{k:.12g}' for k in c.coefficients)}]\n"
    exposure = (
        "" if np.isnan(c.exposure_s) else f"exposure_s: {c.exposure_s:.9g}   # stamps are at mid-exposure\n"
    )
    if c.line_delay_s != 0.0:
        exposure += f"line_delay: {c.line_delay_s:.9g}   # s from row to row; stamps are the middle row's\n"
    intrinsics = ", ".join(f"{v:.12g}" for v in (c.fx_px, c.fy_px, c.cx_px, c.cy_px))
    (folder / "sensor.yaml").write_text(
        "sensor_type: camera\ncomment: rendered; optical frame x right, y down, z forward\n"
        + _transform(R_file @ c.R_body_camera, R_file @ c.p_body_camera_m)
        + f"rate_hz: {config.camera.rate_hz:g}\nresolution: [{c.width_px}, {c.height_px}]\n"
        + f"camera_model: pinhole\nintrinsics: [{intrinsics}]   # fu, fv, cu, cv\n"
        + lens
        + exposure,
        encoding="utf-8",
    )
    times = flying.frame_times().tolist()
    quality = config.imaging.jpeg_quality
    suffix = "png" if quality is None else "jpg"
    rows = ["#timestamp [ns],filename"]
    for number, t in enumerate(times):
        picture = flying.picture(t, number)
        name = f"{flying.stamp_ns(t)}.{suffix}"
        data = (
            encode_jpeg(picture, quality)
            if quality is not None
            else cv2.imencode(".png", picture)[1].tobytes()
        )
        (folder / "data" / name).write_bytes(data)
        rows.append(f"{flying.stamp_ns(t)},{name}")
        progress(number + 1, len(times))
    (folder / "data.csv").write_text("\n".join([*rows, ""]), encoding="utf-8")


def _readme(config: SimulationConfig, flying: FlyingCamera) -> str:
    scene, c = config.scene, flying.camera
    offset = config.camera.time_offset_s
    clock = f", frames stamped {1e3 * offset:g} ms late" if offset else ""
    shutter = (
        f", rolling shutter {1e6 * config.camera.line_delay_s:g} us a row"
        if config.camera.line_delay_s
        else ""
    )
    return (
        f"# {len(flying.frame_times())} simulated frames of a corridor, {scene.width_m:g} m wide\n"
        f"Rendered with exact truth, seed {config.seed}: {c.width_px}x{c.height_px} at {config.camera.rate_hz:g} Hz, "
        f"lens {c.distortion}{shutter}{clock}. Truth in `corridor_truth.csv`.\n"
    )
