"""Rows exposed one after the other: their lines are brought to the moment of the middle row."""

from __future__ import annotations

from dataclasses import replace
from math import degrees, radians
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fusion import FusionConfig, fuse_flight
from fusion.logs import load_flight
from fusion.simulate import SimulationConfig, office_views, simulate_flight
from vision import Attitude, Camera, InputError, Prior, measure_frame
from vision.cameras.camera import Distortion
from vision.lines.line_set import LineSet
from vision.lines.rolling_shutter import correct_rolling_shutter
from vision.lines.segments import extract_lines
from vision.rotations import rotation_from_angles

FORWARD = Camera.from_fov(8, 8, 1.0).R_body_camera
RATES = (0.3, -0.5, 1.2)
CAMERAS = {
    "pinhole": Camera(640, 480, 466.0, 466.0, 319.5, 239.5, line_delay_s=4e-5),
    "upwards": Camera(640, 480, 466.0, 466.0, 319.5, 239.5, line_delay_s=-6e-5),
    "fisheye": Camera(
        640, 480, 300.0, 300.0, 322.0, 236.0, Distortion.EQUIDISTANT, (0.01, 0.0, 0.0, 0.0), line_delay_s=4e-5
    ),
    "pitched": Camera(
        640,
        480,
        466.0,
        466.0,
        319.5,
        239.5,
        R_body_camera=Rotation.from_euler("y", -20, degrees=True).as_matrix() @ FORWARD,
        line_delay_s=7e-5,
    ),
}


def seen_while_turning(camera: Camera, ray: np.ndarray) -> np.ndarray:
    """Pixel of a direction (3,), optical frame of the middle row's moment, as its own row sees it."""
    rate = camera.R_body_camera.T @ RATES
    pixel = camera.project(ray)[0]
    for _ in range(20):
        seconds = (pixel[1] - 0.5 * (camera.height_px - 1)) * camera.line_delay_s
        pixel = camera.project(Rotation.from_rotvec(-rate * seconds).apply(ray))[0]
    return np.asarray(pixel)


def line_set(camera: Camera, start: np.ndarray, end: np.ndarray) -> LineSet:
    """Lines between pixels (n, 2) of the picture."""
    ends = [camera.undistort(p) for p in (start, end)]
    scale, centre = (camera.fx_px, camera.fy_px), (camera.cx_px, camera.cy_px)
    lines = extract_lines(np.zeros((camera.height_px, camera.width_px), np.uint8), camera)
    one = np.ones((len(start), 1))
    return replace(
        lines,
        ends_px=np.hstack([p * scale + centre for p in ends]),
        length_px=np.ones(len(start)),
        sigma_rad=np.full(len(start), 1e-3),
    ).with_ends(*(np.hstack([p, one]) for p in ends))


@pytest.mark.parametrize("name", CAMERAS)
def test_planes_are_those_of_the_middle_row(name: str) -> None:
    camera = CAMERAS[name]
    rays = camera.rays(np.random.default_rng(1).uniform(0.1, 0.9, (24, 2)) * (640, 480))
    pixels = np.array([seen_while_turning(camera, ray) for ray in rays])
    found = correct_rolling_shutter(line_set(camera, pixels[:12], pixels[12:]), camera, RATES)
    normal = np.cross(rays[:12], rays[12:])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    np.testing.assert_allclose(found.normal, normal, atol=3e-5)
    np.testing.assert_allclose((found.normal * found.direction).sum(axis=1), 0.0, atol=1e-12)
    before = line_set(camera, pixels[:12], pixels[12:])
    assert np.abs(before.normal - normal).max() > 3e-3


def test_without_rates_or_delay_nothing_changes() -> None:
    camera = replace(Camera.from_fov(320, 240, radians(70)), line_delay_s=8e-5)
    view = next(iter(office_views(camera, 1, seed=5)))
    attitude = Attitude(view.roll_rad, view.pitch_rad)
    plain = measure_frame(view.image, replace(camera, line_delay_s=0.0), attitude)
    for measured_with, prior in (
        (camera, None),
        (replace(camera, line_delay_s=0.0), Prior(body_rates_rad_s=RATES)),
    ):
        assert measure_frame(view.image, measured_with, attitude, prior).heading_rad == plain.heading_rad


def test_headings_while_turning_fast_are_those_of_the_middle_row() -> None:
    # Looking down, it sees all lines below the axis, and at other times than the axis.
    ahead = Camera.from_fov(320, 240, radians(70))
    R_body_camera = rotation_from_angles(0.0, radians(-15.0), 0.0) @ ahead.R_body_camera
    camera = replace(ahead, line_delay_s=0.033 / 240, R_body_camera=R_body_camera)
    errors: dict[bool, list[float]] = {False: [], True: []}
    for rate in (radians(120.0), radians(-120.0)):
        for view in office_views(camera, 8, seed=6, yaw_rate_rad_s=rate, views_per_scene=4):
            for corrected, found in errors.items():
                prior = Prior(body_rates_rad_s=(0.0, 0.0, rate) if corrected else None)
                m = measure_frame(view.image, camera, Attitude(view.roll_rad, view.pitch_rad), prior)
                if m.accepted:
                    found.append(abs(degrees(m.heading_rad - view.heading_rad)))
    assert len(errors[True]) >= 14
    assert len(errors[False]) >= 8
    assert np.median(errors[True]) < 0.12
    assert np.median(errors[True]) < 0.2 * np.median(errors[False])


def test_scaled_pictures_are_read_in_the_same_time() -> None:
    half = CAMERAS["pinhole"].resized(320, 240)
    assert half.line_delay_s * 240 == pytest.approx(CAMERAS["pinhole"].line_delay_s * 480)


def test_milliseconds_are_refused() -> None:
    with pytest.raises(InputError, match=r"line_delay 33 would take .* to read 480 rows .*give seconds"):
        replace(CAMERAS["pinhole"], line_delay_s=33.0)


def test_the_filter_corrects_rows_by_its_gyroscope(tmp_path: Path) -> None:
    """A simulated flight carries its camera's delay, and its frames are better for it."""
    values: dict[str, Any] = {
        "seed": 8,
        "light_cell_m": 0.5,
        "scene": {"length_m": 20},
        "camera": {
            "width_px": 320,
            "height_px": 240,
            "line_delay_s": 1.4e-4,
            "exposure_s": 0.001,
            "rate_hz": 10,
        },
        "motion": {"duration_s": 3.0, "start_m": 2.0, "heading_rate_rad_s": 2.0},
    }
    flight = load_flight(simulate_flight(SimulationConfig.from_values(values), tmp_path / "flight"))
    assert flight.camera.line_delay_s == pytest.approx(1.4e-4)
    assert flight.truth is not None
    typical = {}
    for delay_s in (0.0, flight.camera.line_delay_s):
        frames = fuse_flight(
            replace(flight, camera=replace(flight.camera, line_delay_s=delay_s)), FusionConfig()
        ).frames
        error = frames["heading_rad"] - np.interp(
            frames["timestamp_ns"], flight.truth.t_ns, flight.truth.heading_rad
        )
        typical[delay_s] = degrees(float(np.median(np.abs(error[frames["accepted"]]))))
    assert typical[flight.camera.line_delay_s] < 0.85 * typical[0.0]
