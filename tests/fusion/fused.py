"""A flight in one corridor with drawn pictures, and the result of a filter whose errors are known."""

from __future__ import annotations

from math import radians
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from fusion.estimator.config import FusionConfig
from fusion.estimator.tables import ESTIMATE_DTYPE, FRAME_DTYPE, Table
from fusion.flight import AttitudeStream, CorridorTruth, Flight, FloatArray, FrameStream, ImuStream, TimeArray
from fusion.logs.pictures.camera_folder import PictureFiles
from fusion.result.result import FusionResult
from vision import Camera

T0_NS = 1_600_000_000_000_000_000
WIDTH_M = 2.0
CAMERA_HEIGHT_M = 1.2


Fused = tuple[FusionResult, Flight]


def corridor_picture(path: Path, camera: Camera, heading_rad: float, offset_m: float) -> None:
    """Draw the four edges of a corridor, and some joints along its floor, as the camera would see them."""
    picture = np.full((camera.height_px, camera.width_px), 200, dtype=np.uint8)
    c, s = np.cos(heading_rad), np.sin(heading_rad)
    R_body_corridor = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    for y in (-1.0, -0.5, 0.4, 1.0):
        for z in (CAMERA_HEIGHT_M, -1.3) if abs(y) == 1.0 else (CAMERA_HEIGHT_M,):
            ends = np.array([[1.5, y - offset_m, z], [40.0, y - offset_m, z]])
            points = camera.project(ends @ R_body_corridor.T @ camera.R_body_camera)
            if np.isfinite(points).all():
                a, b = (tuple(int(v) for v in np.round(p * 16)) for p in points)
                cv2.line(picture, a, b, 60, 2, cv2.LINE_AA, 4)
    cv2.imwrite(str(path), cv2.GaussianBlur(picture, (3, 3), 0.7))


def make_flight(
    folder: Path,
    *,
    duration_s: float = 12.0,
    imu_hz: float = 50.0,
    frame_hz: float = 10.0,
    pictures: bool = True,
    seed: int = 3,
) -> Fused:
    """Build a flight that swings in one corridor, and the result of a filter with known errors.

    Filter errors are white with the sigma that the table states (0.3 degrees, 2 cm); vision's are twice that.
    The IMU's yaw is off by 40 degrees and steps by 12 more between 6 and 8 s.
    """
    rng = np.random.default_rng(seed)
    camera = Camera.from_fov(320, 240, radians(70))
    t = np.arange(0.0, duration_s, 1 / imu_hz)
    t_frame = np.arange(0.0, duration_s, 1 / frame_hz)

    def heading(at: FloatArray) -> FloatArray:
        return radians(12) * np.sin(2 * np.pi * at / 8.0)

    def offset(at: FloatArray) -> FloatArray:
        return 0.3 * np.cos(2 * np.pi * at / 11.0)

    def nanoseconds(at: FloatArray) -> TimeArray:
        return T0_NS + np.round(at * 1e9).astype(np.int64)

    yaw_offset = radians(40) + np.where((t > 6) & (t < 8), radians(12), 0.0)
    estimates = np.zeros(len(t), dtype=ESTIMATE_DTYPE)
    estimates["timestamp_ns"] = nanoseconds(t)
    estimates["heading_std_rad"] = radians(0.3)
    estimates["heading_rad"] = heading(t) + rng.normal(0, radians(0.3), len(t))
    estimates["lateral_offset_std_m"], estimates["lateral_offset_norm_std"] = 0.02, 0.02
    estimates["lateral_offset_m"] = offset(t) + rng.normal(0, 0.02, len(t))
    estimates["lateral_offset_norm"] = estimates["lateral_offset_m"] / (WIDTH_M / 2)
    estimates["yaw_rate_rad_s"] = np.gradient(heading(t), t)
    estimates["gyro_bias_rad_s"] = 0.01 * (1 - np.exp(-t))
    estimates["imu_yaw_offset_rad"] = yaw_offset
    estimates["status"] = np.where(t < 0.5, "initialising", "tracking")
    estimates["vision_age_s"] = np.where(t < 0.5, np.nan, t % (1 / frame_hz))
    smoothed = estimates.copy()
    smoothed["heading_rad"] = heading(t) + rng.normal(0, radians(0.1), len(t))

    frames = np.zeros(len(t_frame), dtype=FRAME_DTYPE)
    frames["timestamp_ns"] = nanoseconds(t_frame)
    frames["accepted"], frames["reason"] = True, "ok"
    frames["n_lines"], frames["n_inliers"] = 12, 8
    frames["innovation_rad"] = rng.normal(0, radians(0.6), len(t_frame))
    frames["test_ratio"] = (frames["innovation_rad"] / (4 * radians(0.6))) ** 2
    frames["heading_rad"] = heading(t_frame) + frames["innovation_rad"]
    frames["heading_std_rad"] = radians(0.6)
    frames["lateral_offset_norm"] = offset(t_frame) / (WIDTH_M / 2)
    vp = camera.project(
        np.column_stack([np.cos(heading(t_frame)), -np.sin(heading(t_frame)), 0 * t_frame])
        @ camera.R_body_camera
    )
    frames["vp_x_px"], frames["vp_y_px"] = vp.T
    frames["vision_ms"] = 3.0

    yaw = np.where((t > 6) & (t < 8), radians(12), 0.0) + radians(40) + heading(t)
    paths = tuple(folder / f"{k}.png" for k in range(len(frames)))
    flight = Flight(
        name="swing",
        camera=camera,
        frames=FrameStream(
            frames["timestamp_ns"].copy(),
            PictureFiles(paths),
        ),
        imu=ImuStream(estimates["timestamp_ns"].copy(), np.zeros((len(t), 3)), np.zeros((len(t), 3))),
        attitude=AttitudeStream(
            estimates["timestamp_ns"].copy(),
            np.column_stack([np.cos(yaw / 2), 0 * t, 0 * t, np.sin(yaw / 2)]),
        ),
        truth=CorridorTruth(
            t_ns=estimates["timestamp_ns"].copy(),
            heading_rad=heading(t),
            lateral_offset_m=offset(t),
            corridor_width_m=np.full(len(t), WIDTH_M),
            corridor_id=np.ones(len(t), dtype=np.int64),
            in_junction=np.zeros(len(t), dtype=bool),
        ),
    )
    if pictures:
        for path, heading_rad, offset_m in zip(paths, heading(t_frame), offset(t_frame), strict=True):
            corridor_picture(path, camera, heading_rad, offset_m)
    result = FusionResult(
        flight_name="swing <one>",
        config=FusionConfig(corridor_width_m=WIDTH_M),
        estimates=estimates,
        smoothed=smoothed,
        frames=frames,
        problems=(),
    )
    return result, flight


def table_with(table: Table, **columns: tuple[Any, Any]) -> Table:
    """Copy a table, some rows (an index or a slice) of some columns replaced by a value."""
    table = table.copy()
    for name, (rows, value) in columns.items():
        table[name][rows] = value
    return table
