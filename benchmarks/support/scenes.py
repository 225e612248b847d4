"""Hard views of simulated corridors: what the building or the vehicle's attitude makes difficult.

A vehicle turned far aside or rolled is had by a camera mounted so on a vehicle that is not (see `case_of_view`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import islice, product
from math import pi, radians, tan
from typing import Any

import numpy as np

from fusion.simulate import JunctionConfig, RandomView, SceneConfig, office_views
from fusion.simulate.config import rotation
from vision import Camera

from .cases import SIMULATED_FOV_RAD, Case, Size, case_of_view, right_answers, size_name
from .perturb import READOUT_S, TURN_RATE_RAD_S

EXPOSURE_S = 0.008
VIEWS_PER_SCENE = 5
MAX_TRIES = 20  # views made for each one that is kept, at most


@dataclass(frozen=True, slots=True)
class Views:
    """Views of one kind.

    Parameters
    ----------
    scene
        Draws a corridor from a seed.
    options
        Further arguments of `office_views`.
    yaw_rad, roll_rad
        How far the vehicle is turned and rolled beyond what ``options`` draw: each value has its share of views.
    yaw_rate_rad_s
        How fast it turns while a rolling shutter takes the picture; likewise.
    keep
        Which views are of this kind; the others are made in vain.
    truths
        Right headings of a view given its scene, where the first corridor's is not the only one.
    """

    scene: Callable[[int], SceneConfig]
    options: dict[str, Any] = field(default_factory=dict)
    yaw_rad: tuple[float, ...] = (0.0,)
    roll_rad: tuple[float, ...] = (0.0,)
    yaw_rate_rad_s: tuple[float, ...] = (0.0,)
    keep: Callable[[RandomView], bool] = lambda view: True
    truths: Callable[[SceneConfig, float], tuple[float, ...]] | None = None


def scene_cases(kind: str, size: Size, n: int, seed: int) -> Iterator[Case]:
    """Yield about n views of a kind of `SCENES`; the same arguments give the same views."""
    views = SCENES[kind]
    variants = list(product(views.yaw_rad, views.roll_rad, views.yaw_rate_rad_s))
    straight = replace(Camera.from_fov(*size, SIMULATED_FOV_RAD), exposure_s=EXPOSURE_S)
    shares = np.diff(np.linspace(0, n, len(variants) + 1).round().astype(int)).tolist()
    index = 0
    for number, ((yaw, roll, rate), share) in enumerate(zip(variants, shares, strict=True)):
        askew = replace(straight, R_body_camera=rotation(yaw, 0.0, roll) @ straight.R_body_camera)
        made = office_views(
            replace(askew, line_delay_s=READOUT_S / size[1] if rate else 0.0),
            MAX_TRIES * share,
            seed * 31 + number,
            scene=views.scene,
            views_per_scene=VIEWS_PER_SCENE,
            yaw_rate_rad_s=rate,
            **views.options,
        )
        for view in islice(filter(views.keep, made), share):
            case = case_of_view(view, f"simulated {size_name(size)}", index, straight)
            if views.truths is not None:
                scene = views.scene(view.scene_seed)
                case = replace(case, headings_rad=views.truths(scene, case.headings_rad[0]))
            yield case
            index += 1


def _of(**fixed: Any) -> Callable[[int], SceneConfig]:
    return lambda seed: SceneConfig.random_office(seed, **fixed)


def _with_junction(seed: int) -> SceneConfig:
    """Draw a corridor that another one meets 4 m from its beginning, at 45 to 135 degrees, half of them crossing."""
    rng = np.random.default_rng((seed, 21))
    junction = JunctionConfig(
        at_m=4.0,
        angle_rad=float(rng.choice([-1.0, 1.0]) * rng.uniform(radians(45), radians(135))),
        width_m=float(rng.uniform(1.5, 3.0)),
        length_m=10.0,
        crossing=bool(rng.random() < 0.5),
    )
    return SceneConfig.random_office(seed, length_m=14.0, junctions=(junction,))


def _axes_of_junction(scene: SceneConfig, heading_rad: float) -> tuple[float, ...]:
    return right_answers(heading_rad, (heading_rad - scene.junctions[0].angle_rad,))


def _fills_the_view(view: RandomView) -> bool:
    """Tell whether both edges of the picture look at the end wall."""
    half_field, half_width_m = SIMULATED_FOV_RAD / 2, view.width_m / 2
    edges = (view.heading_rad - half_field, view.heading_rad + half_field)
    places_m = [view.lateral_offset_norm * half_width_m + view.ahead_m * tan(e) for e in edges]
    return max(abs(p) for p in places_m) < half_width_m


def _with_open_hall(seed: int) -> SceneConfig:
    length_m = SceneConfig.random_office(seed).length_m
    return SceneConfig.random_office(seed, open_hall_m=(0.2, length_m - 0.2), open_hall_right=seed % 2 == 0)


def _with_turned_floor(seed: int, **fixed: Any) -> SceneConfig:
    """Draw a corridor whose tiles, planks or stripes are laid at 8 to 82 degrees to its walls."""
    rng = np.random.default_rng((seed, 22))
    floor = str(rng.choice(["tiles", "planks", "stripes"]))
    size = float(rng.uniform(0.1, 0.3) if floor == "planks" else rng.uniform(0.25, 0.8))
    fixed |= {
        "floor": "tiles" if floor == "tiles" else "planks",
        "floor_albedo": float(rng.uniform(0.3, 0.6)),
        "floor_tile_m": size,
        "floor_joint_m": size / 2 if floor == "stripes" else float(rng.uniform(0.006, 0.02)),
        "floor_turn_rad": float(rng.choice([-1.0, 1.0]) * radians(rng.uniform(8.0, 82.0))),
    }
    return SceneConfig.random_office(seed, **fixed)


_FITTINGS = (
    *("door_spacing_m", "poster_spacing_m", "sign_spacing_m", "furniture_spacing_m", "radiator_spacing_m"),
    *("lockers_share", "people", "pipes", "cable_tray", "handrail", "skirting_height_m"),
)
BARE: dict[str, Any] = dict.fromkeys(_FITTINGS, 0) | {"wall": "plaster", "ceiling": "plaster"}


def _with_stripes(seed: int) -> SceneConfig:
    """Draw a corridor with one to six lines along its floor, whole or dashed; every other one has bare walls."""
    rng = np.random.default_rng((seed, 23))
    half_m = SceneConfig.random_office(seed).width_m / 2
    strip: dict[str, Any] = {
        "on": "floor",
        "width_m": float(rng.uniform(0.04, 0.15)),
        "albedo": float(rng.uniform(0.6, 0.9)),
        "dash_m": float(rng.choice([0.0, rng.uniform(0.2, 0.8)])),
    }
    places = rng.uniform(-0.9, 0.9, int(rng.integers(1, 7))) * half_m
    starts = rng.uniform(0.0, 1.0, len(places))
    strips = tuple(
        {**strip, "at_m": at, "from_m": start}
        for at, start in zip(places.tolist(), starts.tolist(), strict=True)
    )
    return SceneConfig.random_office(seed, strips=strips, floor_albedo=0.25, **(BARE if seed % 2 else {}))


#: Kinds of views by name.
SCENES: dict[str, Views] = {
    # Looking at a side wall from 75 degrees on, the corridor's lines meet far outside the picture.
    "side wall fills the view": Views(
        _of(), {"max_heading_rad": radians(8.0)}, yaw_rad=tuple(radians(a) for a in (-90, -75, 75, 90))
    ),
    # A wide corridor, so that the picture is filled from farther away too.
    "end wall fills the view": Views(
        _of(length_m=4.1, width_m=4.0),
        {"min_ahead_m": 0.5, "max_offset_norm": 0.3, "max_heading_rad": radians(12.0)},
        keep=_fills_the_view,
    ),
    "across a junction": Views(
        _with_junction, {"min_ahead_m": 8.0, "max_heading_rad": pi / 2}, truths=_axes_of_junction
    ),
    "roll 8 to 20 deg": Views(
        _of(), {"tilt_std_rad": radians(2.0)}, roll_rad=tuple(radians(a) for a in (-18, -12, 12, 18))
    ),
    "yaw 25 to 45 deg": Views(
        _of(), {"max_heading_rad": radians(10.0)}, yaw_rad=(radians(-35.0), radians(35.0))
    ),
    "rolling shutter, drawn": Views(_of(), yaw_rate_rad_s=(-TURN_RATE_RAD_S, TURN_RATE_RAD_S)),
    "one side wall missing": Views(_with_open_hall),
    "lockers": Views(_of(lockers_share=0.95, door_spacing_m=12.0)),
    "floor tiles": Views(_of(floor="tiles", floor_albedo=0.5, floor_gloss=0.08, skirting_height_m=0.0)),
    "floor at an angle": Views(_with_turned_floor),
    "floor at an angle, bare walls": Views(partial(_with_turned_floor, **BARE)),
    "stripes along the floor": Views(_with_stripes),
    "staircase ahead": Views(_of(length_m=8.5, end="stairs"), {"min_ahead_m": 3.5}),
    "dead end": Views(_of(length_m=7.0, end="wall"), {"min_ahead_m": 1.5}),
}
