"""Independent single views of random corridors with exact truth, for measuring a single-frame method."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import radians

import numpy as np
import numpy.typing as npt

from fusion.simulate.config import ImagingConfig, rotation
from fusion.simulate.imaging import Picture, Sensor, mean_radiance, through_jpeg
from fusion.simulate.render import View, render_linear
from fusion.simulate.scene import Scene, build_scene
from fusion.simulate.scene_config import SceneConfig
from vision import Camera

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class RandomView:
    """One picture and what it was taken from; signs and frames as in `vision.measurement`.

    Parameters
    ----------
    image
        Grey picture (h, w).
    heading_rad, lateral_offset_norm
        Relative to the corridor: turned right and right of the centre line are positive; the offset is over half
        the width.
    roll_rad, pitch_rad
        Exact attitude of the body.
    height_m, width_m
        Of the camera above the floor, and of the corridor.
    ahead_m
        From the camera to the corridor's end.
    scene_seed
        What the corridor was drawn from.
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


def random_views(
    camera: Camera,
    n: int,
    seed: int = 0,
    *,
    scene: SceneConfig | None = None,
    imaging: ImagingConfig | None = None,
    max_heading_rad: float = radians(25.0),
    max_offset_norm: float = 0.7,
    tilt_std_rad: float = radians(3.0),
    min_ahead_m: float = 4.0,
    views_per_scene: int = 10,
) -> Iterator[RandomView]:
    """Yield n views of random corridors; the same arguments give the same pictures.

    Parameters
    ----------
    camera
        Any `vision.Camera`; its size is the pictures' size.
    scene, imaging
        Fixed conditions; by default a new corridor and a new camera quality are drawn for every scene.
    max_heading_rad, max_offset_norm
        Heading and offset are uniform within these.
    tilt_std_rad
        Of roll and of pitch.
    min_ahead_m
        Nearest that the end of the corridor may be.
    views_per_scene
        Pictures taken in one corridor before the next is built (building takes longer than a picture).
    """
    view = View.of(camera)
    for start in range(0, n, views_per_scene):
        scene_seed = seed * 100003 + start // views_per_scene
        config = scene or SceneConfig.random(scene_seed)
        built = build_scene(config, scene_seed)
        quality = imaging or ImagingConfig.random(scene_seed)
        for k in range(start, min(start + views_per_scene, n)):
            rng = np.random.default_rng((scene_seed, k, 4))
            limits = (max_heading_rad, max_offset_norm, tilt_std_rad, min_ahead_m)
            yield _take(built, view, quality, rng, limits, scene_seed)


def _take(
    scene: Scene,
    view: View,
    quality: ImagingConfig,
    rng: np.random.Generator,
    limits: tuple[float, float, float, float],
    scene_seed: int,
) -> RandomView:
    config = scene.config
    max_heading, max_offset, tilt_std, min_ahead = limits
    heading, offset = (
        float(rng.uniform(-max_heading, max_heading)),
        float(rng.uniform(-max_offset, max_offset)),
    )
    roll, pitch = rng.normal(0.0, tilt_std, 2).tolist()
    s = float(rng.uniform(0.5, max(0.6, config.length_m - min_ahead)))
    height = float(rng.uniform(0.3, 0.75)) * config.height_m
    place = scene.rooms[0].to_world(s, offset * config.width_m / 2)
    origin = np.array([*place, -height])
    radiance = render_linear(scene.mesh, view, origin, rotation(heading, pitch, roll))
    sensor = Sensor.of(quality, view, mean_radiance(radiance))
    image = through_jpeg(sensor.develop(radiance, rng), quality.jpeg_quality)
    return RandomView(
        image,
        view.camera,
        heading,
        offset,
        roll,
        pitch,
        height,
        config.width_m,
        config.length_m - s,
        scene_seed,
    )
