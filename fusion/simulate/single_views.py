"""Independent single views of random corridors with exact truth, for measuring a single-frame method."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from math import radians
from typing import Any

import numpy as np
import numpy.typing as npt

from fusion.simulate.config import ImagingConfig, rotation
from fusion.simulate.render.view import Image, View, exposure_moments, render_linear
from fusion.simulate.scene.build import Scene, build_scene
from fusion.simulate.scene.config import SceneConfig
from fusion.simulate.scene.plan import part_at
from fusion.simulate.sensor import Picture, Sensor, mean_radiance, through_jpeg
from vision import Camera

FloatArray = npt.NDArray[np.float64]

MIN_CLEARANCE_M = 0.3


@dataclass(frozen=True, slots=True, eq=False)
class RandomView:
    """One picture and its ground truth; signs and frames as in `vision.measurement`.

    Parameters
    ----------
    image
        Grey picture (h, w).
    heading_rad, lateral_offset_norm
        Relative to the corridor: turned right and right of the centre line are positive; the offset is over half
        the width.
    roll_rad, pitch_rad
        Exact attitude of the body.
    height_m, width_m, ceiling_m
        Of the camera above the floor, of the corridor, and of the ceiling above the floor.
    ahead_m
        From the camera to the corridor's end.
    scene_seed
        Seed of the corridor.
    slope_rad
        Slope by which the corridor rises ahead.
    """

    image: Picture
    camera: Camera
    heading_rad: float
    lateral_offset_norm: float
    roll_rad: float
    pitch_rad: float
    height_m: float
    width_m: float
    ahead_m: float
    scene_seed: int
    slope_rad: float
    ceiling_m: float


@dataclass(frozen=True, slots=True)
class _Limits:
    """Distributions of the poses."""

    heading_rad: float
    offset_norm: float
    tilt_std_rad: float
    ahead_m: float
    rate_rad_s: float


def random_views(
    camera: Camera,
    n: int,
    seed: int = 0,
    *,
    scene: SceneConfig | Callable[[int], SceneConfig] = SceneConfig.random,
    imaging: ImagingConfig | Callable[[int], ImagingConfig] = ImagingConfig.random,
    max_heading_rad: float = radians(25.0),
    max_offset_norm: float = 0.7,
    tilt_std_rad: float = radians(3.0),
    min_ahead_m: float = 4.0,
    yaw_rate_rad_s: float = 0.0,
    views_per_scene: int = 10,
    light_cell_m: float = 0.2,
) -> Iterator[RandomView]:
    """Yield n views of random corridors; the same arguments give the same pictures.

    Parameters
    ----------
    camera
        Any `vision.Camera`; its size is the pictures' size. The body's origin is the camera's position.
    scene, imaging
        Fixed conditions, or functions that draw them from a seed: a new corridor for every ``views_per_scene``
        pictures. ``lambda seed: SceneConfig.random(seed, end="stairs")`` fixes some of it.
    max_heading_rad, max_offset_norm
        Heading and offset are uniform within these.
    tilt_std_rad
        Of roll and of pitch.
    min_ahead_m
        Smallest distance to the end of the corridor.
    yaw_rate_rad_s
        Turn rate during the exposure: blurs the picture over the camera's ``exposure_s``, skews it by its
        ``line_delay_s``. The truth is that of the middle of the exposure.
    views_per_scene
        Pictures taken in one corridor before the next is built (building takes longer than a picture).
    light_cell_m
        Resolution of the lighting.
    """
    view = View.of(camera)
    limits = _Limits(max_heading_rad, max_offset_norm, tilt_std_rad, min_ahead_m, yaw_rate_rad_s)
    for start in range(0, n, views_per_scene):
        scene_seed = seed * 100003 + start // views_per_scene
        built = _built(scene(scene_seed) if callable(scene) else scene, scene_seed, light_cell_m)
        quality = imaging(scene_seed) if callable(imaging) else imaging
        for k in range(start, min(start + views_per_scene, n)):
            rng = np.random.default_rng((scene_seed, k, 4))
            yield _take(built, view, quality, rng, limits, scene_seed)


# Building takes longer than a picture; a scene needs a megabyte, and all share the textures.
@lru_cache(maxsize=64)
def _built(config: SceneConfig, seed: int, light_cell_m: float) -> Scene:
    return build_scene(config, seed, light_cell_m)


def office_views(camera: Camera, n: int, seed: int = 0, **options: Any) -> Iterator[RandomView]:
    """Yield n views of plain, well-lit office corridors; the options are those of `random_views`."""
    office = {"scene": SceneConfig.random_office, "imaging": ImagingConfig.random_office}
    return random_views(camera, n, seed, **(office | options))


def _take(
    scene: Scene,
    view: View,
    quality: ImagingConfig,
    rng: np.random.Generator,
    limits: _Limits,
    scene_seed: int,
) -> RandomView:
    config = scene.config
    heading = float(rng.uniform(-limits.heading_rad, limits.heading_rad))
    offset = float(rng.uniform(-limits.offset_norm, limits.offset_norm))
    roll, pitch = rng.normal(0.0, limits.tilt_std_rad, 2).tolist()
    origin = _free_place(scene, offset, limits.ahead_m, rng)
    height_m = -float(origin[2])
    origin[2] -= np.tan(config.slope_rad) * origin[0]
    radiance = _exposed(scene, view, origin, rotation(heading, pitch, roll), limits)
    sensor = Sensor.of(quality, view, mean_radiance(radiance), scene_seed)
    image = through_jpeg(sensor.develop(radiance, rng), quality.jpeg_quality)
    return RandomView(
        image,
        view.camera,
        heading_rad=heading,
        lateral_offset_norm=offset,
        roll_rad=roll,
        pitch_rad=pitch,
        height_m=height_m,
        width_m=part_at(scene.rooms, 0, float(origin[0])).width_m,
        ahead_m=config.length_m - float(origin[0]),
        scene_seed=scene_seed,
        slope_rad=config.slope_rad,
        ceiling_m=config.height_m,
    )


def _free_place(scene: Scene, offset_norm: float, min_ahead_m: float, rng: np.random.Generator) -> FloatArray:
    """Draw a position along the first corridor at an offset, if possible not inside furniture.

    The floor is assumed to be level.
    """
    config = scene.config
    origin = np.zeros(3)
    for _ in range(30):
        s = float(rng.uniform(0.5, max(0.6, config.length_m - min_ahead_m)))
        part = part_at(scene.rooms, 0, s)
        place = part.to_world(s - part.x_m, offset_norm * part.width_m / 2)
        origin = np.array([*place, -float(rng.uniform(0.3, 0.75)) * config.height_m])
        low, high = scene.obstacles[:, :3] - MIN_CLEARANCE_M, scene.obstacles[:, 3:] + MIN_CLEARANCE_M
        if not ((origin > low) & (origin < high)).all(axis=1).any():
            break
    return origin


def _exposed(scene: Scene, view: View, origin: FloatArray, R: FloatArray, limits: _Limits) -> Image:
    """Light of an exposure while the body turns at a constant rate about the vertical."""
    rate, exposure_s = limits.rate_rad_s, np.nan_to_num(view.camera.exposure_s)
    if rate == 0.0:
        return render_linear(scene.mesh, view, [origin], [R])
    moments, grid = exposure_moments(view, float(exposure_s), abs(rate) * float(exposure_s), 4)
    height, line_delay_s = view.camera.height_px, view.camera.line_delay_s
    rows = (np.arange(height) - (height - 1) / 2) * line_delay_s
    rotations = []
    for moment in moments.tolist():
        turned = [rotation(rate * (moment + row), 0.0, 0.0) @ R for row in rows.tolist()]
        rotations.append(np.array(turned) if line_delay_s != 0.0 else rotation(rate * moment, 0.0, 0.0) @ R)
    return render_linear(scene.mesh, view, [origin] * len(moments), rotations, grid)
