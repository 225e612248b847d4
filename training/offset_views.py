"""Simulated pictures of corridors with their truth, for training; `training.variations` augments them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import radians

import numpy as np
import numpy.typing as npt

from fusion.simulate import RandomView, SceneConfig, random_views
from fusion.simulate.config import CameraConfig
from fusion.simulate.random_flight import draw_camera
from vision import Attitude, Camera, Prior, extract_lines, measure_lines
from vision.axis.level import level_from_verticals
from vision.axis.vanishing_point import corridor_frame, fit_axis
from vision.frame import SLOPE_STD_RAD, UNKNOWN_ATTITUDE, level_std_rad

FloatArray = npt.NDArray[np.float64]

LIGHT_CELL_M = 0.3
NEAREST_END_M = 0.6  # there a door or wall ahead fills most of the picture
VIEWS_PER_CAMERA, VIEWS_PER_SCENE = 24, 6


@dataclass(frozen=True, slots=True)
class Box:
    """Distances from the camera to the corridor's walls, floor, ceiling and end, metres."""

    left: float
    right: float
    floor: float
    ceiling: float
    ahead: float

    @property
    def offset_norm(self) -> float:
        """Offset of the camera right of the centre line over half the width."""
        return (self.left - self.right) / (self.left + self.right)


@dataclass(frozen=True, slots=True, eq=False)
class TrainingView:
    """A simulated picture with its truth.

    Parameters
    ----------
    image
        Grey picture (h, w).
    R_true
        Rotation (3, 3) from the optical frame to the corridor's axes.
    R_measured
        The same as measured in this picture; None where the heading was rejected.
    box
        Distances to the corridor's surfaces.
    is_hall
        Whether a wall is missing ahead.
    """

    image: npt.NDArray[np.uint8]
    camera: Camera
    R_true: FloatArray
    R_measured: FloatArray | None
    box: Box
    is_hall: bool = False


def draw_lens(seed: int) -> Camera:
    """Draw a camera: both lens models, fields of view of 55 to 140 degrees, two sizes, random mounting angles."""
    rng = np.random.default_rng((seed, 21))
    size = {"width_px": 320, "height_px": 240} if rng.random() < 0.65 else {"width_px": 640, "height_px": 480}
    lens = draw_camera(seed) | size
    if rng.random() < 0.2:  # wide, with a lens that is not quite a fisheye
        k = float(rng.uniform(-0.25, 0.2))
        lens |= {
            "distortion": "radtan",
            "coefficients": (k, -k * float(rng.uniform(0.2, 1.0)), 0.0, 0.0, 0.05 * k),
            "fx_px": size["width_px"] * float(rng.uniform(0.32, 0.55)),
        }
    if rng.random() < 0.3:
        lens["mount_pitch_rad"] = radians(float(rng.uniform(-12.0, 8.0)))
    return CameraConfig.model_validate(lens).camera()


def measured_frame(
    image: npt.NDArray[np.uint8], camera: Camera, attitude: Attitude | None
) -> tuple[FloatArray, float] | None:
    """Measure the corridor's axes: R_corridor_camera and the heading; None where the frame is rejected."""
    lines = extract_lines(image, camera)
    known = attitude or UNKNOWN_ATTITUDE
    std_rad = level_std_rad(known, Prior().elevation_std_rad)
    level = level_from_verticals(lines, known.R_level_body(), camera.R_body_camera, *std_rad)
    fit = fit_axis(
        lines, level.R_level_camera, elevation_std_rad=float(np.hypot(level.pitch_std_rad, SLOPE_STD_RAD))
    )
    # Without the picture, `measure_lines` uses the same lines: it cannot search at half the size.
    if fit is None or not measure_lines(replace(lines, grey=None), camera, attitude).accepted:
        return None
    return corridor_frame(level.R_level_camera, fit.heading_rad, fit.elevation_rad), fit.heading_rad


def render_views(n: int, seed: int, first_camera: int = 0) -> Iterator[TrainingView]:
    """Yield n views of random corridors, a third of them near walls and ends, or at large headings.

    Each camera takes `VIEWS_PER_CAMERA` of them; ``first_camera`` skips the cameras before it.
    """
    for block in range(first_camera, first_camera + (n + VIEWS_PER_CAMERA - 1) // VIEWS_PER_CAMERA):
        block_seed = seed * 7919 + block
        rng = np.random.default_rng((block_seed, 20))
        camera, hard = draw_lens(block_seed), rng.random() < 0.35
        scenes: dict[int, SceneConfig] = {}

        def draw(scene_seed: int, scenes: dict[int, SceneConfig] = scenes) -> SceneConfig:
            office = scene_seed % 8 == 0
            scenes[scene_seed] = (SceneConfig.random_office if office else SceneConfig.random)(scene_seed)
            return scenes[scene_seed]

        views = random_views(
            camera,
            min(VIEWS_PER_CAMERA, n - (block - first_camera) * VIEWS_PER_CAMERA),
            seed=block_seed,
            scene=draw,
            max_heading_rad=radians(40.0 if hard else 25.0),
            max_offset_norm=0.8 if hard else 0.7,
            tilt_std_rad=radians(4.0),
            min_ahead_m=NEAREST_END_M if hard else 3.0,
            yaw_rate_rad_s=float(rng.choice([0.0, 0.0, 0.0, rng.uniform(0.2, 1.5)])),
            views_per_scene=VIEWS_PER_SCENE,
            light_cell_m=LIGHT_CELL_M,
        )
        for view in views:
            yield _with_truth(view, scenes[view.scene_seed], rng)


def _with_truth(view: RandomView, scene: SceneConfig, rng: np.random.Generator) -> TrainingView:
    half = view.width_m / 2.0
    box = Box(
        half * (1.0 + view.lateral_offset_norm),
        half * (1.0 - view.lateral_offset_norm),
        view.height_m,
        scene.height_m - view.height_m,
        view.ahead_m,
    )
    level = Attitude(view.roll_rad, view.pitch_rad).R_level_body() @ view.camera.R_body_camera
    roll, pitch = rng.normal(0.0, radians(0.5), 2).tolist()
    attitude = Attitude(view.roll_rad + roll, view.pitch_rad + pitch)
    found = measured_frame(view.image, view.camera, attitude if rng.random() < 0.8 else None)
    hall = scene.open_hall_m
    return TrainingView(
        view.image,
        view.camera,
        corridor_frame(level, view.heading_rad, view.slope_rad),
        None if found is None else found[0],
        box,
        hall is not None and scene.length_m - view.ahead_m < hall[1],
    )
