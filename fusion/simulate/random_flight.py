"""Random flights for random corridors: lens and mount, motion and inertial sensors."""

from __future__ import annotations

from math import radians, tan
from typing import Any

import numpy as np

from fusion.simulate.config import ImagingConfig, least_half_width_m
from fusion.simulate.scene.config import SceneConfig
from fusion.simulate.scene.random_scene import is_night

NIGHT_EXPOSURE_S = 0.02
WALL_CLEARANCE_M, PILLAR_CLEARANCE_M = 0.3, 0.1
NEAREST_START_M = 0.6
BARREL_REACH = 0.4  # r (1 + k r^2 + 0.3 k^2 r^4), of a barrel, reaches at most 0.41 / sqrt(-k)
CORNER_OVER_EDGE = 1.27  # of a picture of 4:3


def draw_flight(seed: int, fixed: dict[str, Any]) -> dict[str, Any]:
    """Draw a `SimulationConfig`'s settings; sections given as dictionaries are completed."""
    scene = fixed.get("scene")
    if not isinstance(scene, SceneConfig):
        scene = SceneConfig.random(seed, **(scene or {}))
    imaging = fixed.get("imaging")
    if not isinstance(imaging, ImagingConfig):
        imaging = ImagingConfig.random(seed, **(imaging or {}))
    values: dict[str, Any] = {"seed": seed, **fixed, "scene": scene, "imaging": imaging}
    motion = fixed.get("motion", {})
    if isinstance(motion, dict):
        values["motion"] = _motion(seed, scene, motion)
    for name, draw in (("camera", draw_camera), ("imu", draw_imu)):
        given = fixed.get(name, {})
        if isinstance(given, dict):
            values[name] = draw(seed) | given
    return values


def draw_camera(seed: int) -> dict[str, Any]:
    """Draw a lens, its field of view, the mount and the shutter."""
    rng = np.random.default_rng((seed, 16))
    kind = str(rng.choice(["none", "radtan", "equidistant"], p=[0.45, 0.3, 0.25]))
    barrel, fish = float(rng.uniform(-0.28, 0.02)), rng.normal(0.0, 0.01, 4).tolist()
    plain_fov, skew = radians(rng.uniform(55, 95)), rng.normal(0.0, 5e-4, 2).tolist()
    barrel_fov, fish_fov = radians(rng.uniform(55, 80)), radians(rng.uniform(80, 140))
    barrel = max(barrel, -((BARREL_REACH / (CORNER_OVER_EDGE * tan(barrel_fov / 2))) ** 2))
    coefficients, fov_rad = {
        "none": ((), plain_fov),
        "radtan": ((barrel, 0.3 * barrel**2, *skew), barrel_fov),
        "equidistant": (tuple(fish), fish_fov),
    }[kind]
    return {
        "distortion": kind,
        "coefficients": coefficients,
        "horizontal_fov_rad": fov_rad,
        "mount_pitch_rad": float(rng.choice([0.0, rng.uniform(-1, 1)], p=[0.3, 0.7])) * radians(6),
        "mount_roll_rad": radians(float(rng.normal(0.0, 0.7))),
        "mount_yaw_rad": radians(float(rng.normal(0.0, 1.0))),
        "exposure_s": NIGHT_EXPOSURE_S if is_night(seed) else float(rng.uniform(0.001, 0.012)),
        "line_delay_s": float(rng.choice([0.0, rng.uniform(1e-5, 6e-5)], p=[0.6, 0.4])),
    }


def _motion(seed: int, scene: SceneConfig, given: dict[str, Any]) -> dict[str, Any]:
    """Draw the vehicle's motion within the free space of the corridor; some flights reach its end."""
    rng = np.random.default_rng((seed, 17))
    pillar_m = scene.pilaster_m[1] if scene.pilaster_spacing_m else 0.0
    free = max(0.0, least_half_width_m(scene) - max(WALL_CLEARANCE_M, pillar_m + PILLAR_CLEARANCE_M))
    route: tuple[int, ...] = ()
    if scene.junctions and rng.random() < 0.4:
        route = (2,)
        free = min(free, max(0.0, scene.junctions[0].width_m / 2 - WALL_CLEARANCE_M))
    amplitude = float(rng.uniform(0.1, 0.7)) * free
    margin, duration = float(rng.uniform(1.0, 2.5)), float(given.get("duration_s", 15.0))
    way = scene.length_m - margin - NEAREST_START_M
    speed = min(float(np.exp(rng.uniform(np.log(0.3), np.log(2.0)))), way / (0.9 * duration))
    latest = max(0.0, way - speed * duration)
    start = NEAREST_START_M + latest * float(rng.choice([rng.uniform(0, 1), 1.0], p=[0.6, 0.4]))
    if route:
        start = NEAREST_START_M
    heading = radians(float(rng.uniform(2, 25)))
    top = scene.height_m - max(0.35, scene.beam_m[1] + 0.15 if scene.beam_spacing_m else 0.0)
    drawn = {
        "duration_s": duration,
        "speed_m_s": speed,
        "start_m": start,
        "height_m": float(rng.uniform(0.4, min(2.2, top - 0.15))),
        "height_amplitude_m": float(rng.uniform(0.01, 0.12)),
        "heading_amplitude_rad": heading,
        "heading_rate_rad_s": heading * float(rng.uniform(0.8, 3.0)),
        "lateral_amplitude_m": amplitude,
        "lateral_rate_m_s": amplitude * float(rng.uniform(0.5, 1.5)),
        "lateral_mean_m": float(rng.uniform(-1, 1)) * (free - amplitude),
        "tilt_rad": radians(float(rng.uniform(2, 9))),
        "tilt_rate_rad_s": radians(float(rng.uniform(10, 50))),
        "end_margin_m": margin,
        "route": route,
    }
    return drawn | given


def draw_imu(seed: int) -> dict[str, Any]:
    """Draw inertial sensors between good and poor, most of them shaken by the rotors."""
    rng = np.random.default_rng((seed, 18))

    def between(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    return {
        "gyro_noise_density": between(1e-3, 1e-2),
        "gyro_bias_std_rad_s": between(1e-3, 2e-2),
        "gyro_random_walk": between(2e-5, 3e-4),
        "accel_noise_density": between(2e-3, 4e-2),
        "accel_bias_std_m_s2": between(0.02, 0.3),
        "accel_random_walk": between(2e-4, 3e-3),
        "gyro_scale_std": between(1e-3, 1e-2),
        "accel_scale_std": between(1e-3, 1e-2),
        "misalignment_std_rad": between(1e-3, 1e-2),
        "vibration_m_s2": 0.0 if rng.random() < 0.25 else between(0.1, 3.0),
        "rotor_hz": float(rng.uniform(80, 320)),
    }
