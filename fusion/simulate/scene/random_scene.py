"""Random corridors: plain offices, and corridors of all kinds of buildings."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from fusion.simulate.scene.config import Ceiling, End, Floor, Side, Sides, Surface, WallConfig, WallFinish
from fusion.simulate.scene.draw import Draw
from fusion.simulate.scene.random_strips import draw_strips, draw_wall_linings

NIGHT_SHARE = 0.25
FREE_HALF_M = 0.6
FLOORS = (Floor.TILES, Floor.CARPET, Floor.CARPET_TILES, Floor.VINYL, Floor.TERRAZZO)
BOTH_WALLS = {"wall", "wall_albedo", "skirting_height_m", "skirting_albedo"}  # settings of both walls at once


def is_night(seed: int) -> bool:
    """Return whether the corridor and camera of a seed are drawn for a night with few lamps on."""
    return bool(np.random.default_rng((seed, 11)).random() < NIGHT_SHARE)


def draw_office(seed: int) -> dict[str, object]:
    """Draw the settings of a plain, well-lit office corridor."""
    rng = np.random.default_rng((seed, 1))
    pick = rng.choice
    floor = Floor(str(pick(FLOORS, p=[0.3, 0.15, 0.1, 0.3, 0.15])))
    glossy = floor in (Floor.TILES, Floor.VINYL, Floor.TERRAZZO)
    lamps = ((1.2, 0.6), (0.6, 0.6), (0.3, 1.2), (1.4, 0.15), (0.12, 1.4))
    return {
        "length_m": float(rng.uniform(16, 40)),
        "width_m": float(rng.uniform(1.5, 3.2)),
        "height_m": float(rng.uniform(2.3, 3.2)),
        "end": End(str(pick(list(End), p=[0.4, 0.3, 0.1, 0.2]))),
        "wall": WallFinish(str(pick(list(WallFinish)[:4], p=[0.6, 0.2, 0.1, 0.1]))),
        "wall_albedo": float(rng.uniform(0.45, 0.85)),
        "floor": floor,
        "floor_albedo": float(rng.uniform(0.12, 0.55)),
        "floor_gloss": float(rng.uniform(0.01, 0.10)) if glossy else 0.0,
        "floor_roughness_rad": float(rng.uniform(0.004, 0.05)),
        "ceiling": Ceiling(str(pick(list(Ceiling), p=[0.4, 0.5, 0.1]))),
        "ceiling_albedo": float(rng.uniform(0.55, 0.9)),
        "skirting_height_m": float(pick([0.0, rng.uniform(0.05, 0.16)], p=[0.15, 0.85])),
        "skirting_albedo": float(pick([rng.uniform(0.03, 0.2), rng.uniform(0.3, 0.8)], p=[0.7, 0.3])),
        "door_spacing_m": float(rng.uniform(2.2, 7.0)),
        "door_recess_m": float(pick([0.03, rng.uniform(0.05, 0.3)])),
        "door_frame_albedo": float(rng.uniform(0.08, 0.8)),
        "open_door_share": float(rng.uniform(0.0, 0.25)),
        "poster_spacing_m": float(rng.uniform(2.0, 9.0)),
        "sign_spacing_m": float(rng.uniform(2.0, 6.0)),
        "furniture_spacing_m": float(pick([0.0, rng.uniform(3.0, 12.0)], p=[0.2, 0.8])),
        "people": int(pick([0, 1, 2, 3], p=[0.6, 0.2, 0.1, 0.1])),
        "lockers_share": float(pick([0.0, rng.uniform(0.2, 0.8)], p=[0.85, 0.15])),
        "radiator_spacing_m": float(pick([0.0, rng.uniform(4.0, 9.0)], p=[0.7, 0.3])),
        "pipes": int(pick([0, 1, 2, 4], p=[0.7, 0.1, 0.1, 0.1])),
        "cable_tray": bool(rng.random() < 0.15),
        "handrail": bool(rng.random() < 0.12),
        "lamp_spacing_m": float(rng.uniform(1.8, 4.5)),
        "lamp_size_m": lamps[int(rng.integers(len(lamps)))],
        "lamp_off_share": float(pick([0.0, rng.uniform(0.0, 0.5)])),
        "daylight": float(rng.uniform(1.0, 12.0)),
        "ambient": float(rng.uniform(0.005, 0.05)),
    }


def draw_building(seed: int, fixed: Mapping[str, Any]) -> dict[str, Any]:
    """Draw the settings of a corridor of any kind of building, consistent with those ``fixed``."""
    draw, night = Draw(seed), is_night(seed)
    values: dict[str, Any] = {
        "length_m": draw.between(12, 40),
        "width_m": draw.scale(1.3, 3.8),
        "height_m": draw.between(2.2, 3.5),
    }
    values |= {name: fixed[name] for name in values if name in fixed}
    values |= _plan(draw, values, fixed)
    values |= _surfaces(draw)
    if BOTH_WALLS & set(fixed):
        values |= {"left_wall": None, "right_wall": None}
    values |= _openings(draw, values | dict(fixed), night)
    values |= _contents(draw)
    values |= _light(draw, values["width_m"], night)
    values["strips"] = draw_strips(draw, values["width_m"], values["height_m"])
    values |= _structure(seed, values)
    return values | {"strips": (*values["strips"], *draw_wall_linings(seed, values["width_m"]))}


def _plan(draw: Draw, size: Mapping[str, Any], fixed: Mapping[str, Any]) -> dict[str, Any]:
    """Draw a junction, a step in the width, an open side or a slope: one of them, or none."""
    length, width = size["length_m"], size["width_m"]
    kind = draw.one_of("plain", "junction", "step", "hall", "slope", p=(0.48, 0.17, 0.12, 0.12, 0.11))
    own = {"junctions", "open_hall_m", "width_step", "slope_rad"} & set(fixed)
    if own or length < 10 or kind == "plain":
        return {}
    place = draw.between(0.3, 0.75) * length
    narrower = max(1.2, width * draw.between(0.55, 0.85))
    if kind == "junction":
        angle = draw.one_of(-1.0, 1.0) * draw.one_of(np.pi / 2, draw.between(0.9, 2.2), p=(0.7, 0.3))
        across = draw.between(1.4, 3.0)
        junction = {
            "at_m": place, "angle_rad": float(angle), "width_m": across, "length_m": draw.between(8, 14),
            "crossing": draw.chance(0.5),
        }  # fmt: skip
        found: dict[str, Any] = {"junctions": (junction,)}
        if draw.chance(0.5):  # the corridor is narrower beyond it
            behind = min(place + 0.45 * across, length - 1.5)
            found["width_step"] = {"at_m": behind, "width_m": narrower}
        return found
    if kind == "step":
        wider = width * draw.between(1.15, 1.6)
        moves = draw.one_of(*Sides)
        if moves is not Sides.BOTH:  # the centre line of the first part stays free
            narrower = max(narrower, width / 2 + FREE_HALF_M)
        return {"width_step": {"at_m": place, "width_m": draw.one_of(narrower, wider), "moves": moves}}
    if kind == "hall":
        end = min(length - 0.5, place + draw.between(3, length))
        low = draw.one_of(0.0, draw.between(0.8, 1.2), p=(0.4, 0.6))
        start = draw.one_of(0.2, place, p=(0.4, 0.6))
        return {"open_hall_m": (start, end), "open_hall_right": draw.chance(0.5), "partition_height_m": low}
    return {"slope_rad": draw.one_of(-1.0, 1.0) * draw.between(0.01, 0.085)}


def _wall(draw: Draw) -> WallConfig:
    finish = draw.one_of(
        WallFinish.PLASTER, WallFinish.BRICK, WallFinish.BLOCKS, WallFinish.PANELS, WallFinish.TILES,
        p=(0.46, 0.22, 0.12, 0.08, 0.12),
    )  # fmt: skip
    lower = draw.one_of(WallFinish.PLASTER, WallFinish.TILES, WallFinish.PANELS, p=(0.6, 0.3, 0.1))
    tile = draw.between(0.1, 0.3)
    unit = {
        WallFinish.BRICK: (draw.between(0.2, 0.32), draw.between(0.06, 0.11)),
        WallFinish.BLOCKS: draw.one_of((0.4, 0.2), (0.3, 0.15), (0.5, 0.25)),
    }.get(finish, draw.one_of((tile, tile), (0.2, 0.1), (0.15, 0.075)))
    contrast = draw.between(0.4, 2.2)
    gloss = draw.between(0.01, 0.08) if WallFinish.TILES in (finish, lower) else 0.0
    albedo = draw.between(0.15, 0.6) if finish is WallFinish.BRICK else draw.between(0.3, 0.85)
    return WallConfig(
        finish=finish,
        albedo=albedo,
        lower_height_m=draw.one_of(0.0, draw.between(0.7, 1.6), p=(0.65, 0.35)),
        lower_finish=lower,
        lower_albedo=draw.one_of(albedo * draw.between(0.4, 0.9), draw.albedo()),
        brick_m=unit,
        brick_contrast=draw.one_of(contrast, -contrast, p=(0.45, 0.55)),
        gloss=gloss,
        skirting_height_m=draw.one_of(0.0, draw.between(0.04, 0.22), p=(0.2, 0.8)),
        skirting_depth_m=draw.between(0.004, 0.03),
        skirting_albedo=draw.one_of(draw.albedo(), albedo * draw.between(0.8, 1.0)),
    )


def _surfaces(draw: Draw) -> dict[str, Any]:
    """Draw walls, floor and ceiling; sometimes the walls differ, or their skirting boards."""
    left = _wall(draw)
    kind = draw.one_of("alike", "skirting", "own", p=(0.6, 0.2, 0.2))
    right = left if kind == "alike" else _wall(draw)
    if kind == "skirting":
        names = ("skirting_height_m", "skirting_depth_m", "skirting_albedo")
        right = left.model_copy(update={name: getattr(right, name) for name in names})
    floor = draw.one_of(*FLOORS, p=(0.32, 0.18, 0.1, 0.28, 0.12))
    polished = draw.chance(0.4)
    gloss = draw.between(0.05, 0.22) if polished else draw.between(0.0, 0.05)
    tile = draw.between(0.15, 0.9)
    coving = draw.one_of(0.0, draw.between(0.02, 0.12), p=(0.82, 0.18))
    return {
        "left_wall": left,
        "right_wall": right,
        "wall_albedo": left.albedo,
        "floor": floor,
        "floor_albedo": draw.scale(0.08, 0.6),
        "floor_gloss": gloss if floor in (Floor.TILES, Floor.VINYL, Floor.TERRAZZO) else 0.0,
        "floor_roughness_rad": draw.scale(0.003, 0.02) if polished else draw.between(0.008, 0.03),
        "floor_tile_m": tile,
        "floor_tile_start_m": (tile * draw.between(0, 1), tile * draw.between(0, 1)),
        "floor_joint_ratio": draw.one_of(draw.between(0.3, 0.9), draw.between(1.2, 1.8), p=(0.75, 0.25)),
        "floor_coving_m": coving,
        "floor_upstand_m": draw.one_of(0.0, coving + draw.between(0.01, 0.1), p=(0.4, 0.6))
        if coving
        else 0.0,
        "ceiling_coving_m": draw.one_of(0.0, draw.between(0.03, 0.15), p=(0.87, 0.13)),
        "ceiling": draw.one_of(*Ceiling, p=(0.45, 0.35, 0.2)),
        "ceiling_albedo": draw.between(0.3, 0.9),
        "beam_spacing_m": draw.one_of(0.0, draw.between(1.5, 5.0), p=(0.75, 0.25)),
        "beam_m": (draw.between(0.1, 0.35), draw.between(0.08, 0.3)),
        "beam_albedo": draw.albedo(),
        "pilaster_spacing_m": draw.one_of(0.0, draw.between(2.0, 6.0), p=(0.85, 0.15)),
        "pilaster_m": (draw.between(0.15, 0.5), draw.between(0.04, 0.2)),
        "pilaster_albedo": draw.between(0.2, 0.8),
        "parallel_std_rad": draw.scale(0.0005, 0.004),
    }


def _structure(seed: int, values: Mapping[str, Any]) -> dict[str, Any]:
    """Sometimes draw a building's visible frame: deep pillars, deep beams, or soffits along both walls.

    It uses separate random numbers, so that the rest of a corridor is the same with and without it.
    """
    draw = Draw(seed, stream=12)
    width, height = values["width_m"], values["height_m"]
    kind = draw.one_of(None, "pillars", "beams", "portals", "soffits", p=(0.72, 0.07, 0.07, 0.07, 0.07))
    spacing, albedo = draw.between(1.8, 6.0), draw.between(0.2, 0.85)
    found: dict[str, Any] = {}
    if kind in ("pillars", "portals"):
        deep = draw.between(0.08, 0.16) * width
        found |= {
            "pilaster_spacing_m": spacing,
            "pilaster_m": (draw.between(0.2, 0.7), deep),
            "pilaster_albedo": albedo,
        }
    if kind in ("beams", "portals"):
        deep = draw.between(0.08, 0.2) * height
        found |= {"beam_spacing_m": spacing, "beam_m": (draw.between(0.15, 0.6), deep), "beam_albedo": albedo}
    if kind == "soffits":
        wide, deep = draw.between(0.08, 0.25) * width, draw.between(0.1, 0.4)
        sides = draw.one_of((-1, 1), (-1,), (1,), p=(0.6, 0.2, 0.2))
        soffit = {"on": Surface.CEILING, "width_m": wide, "depth_m": deep, "albedo": albedo}
        soffits = ({"at_m": side * (width - wide) / 2, **soffit} for side in sides)
        found["strips"] = (*values["strips"], *soffits)
    return found


def _openings(draw: Draw, values: Mapping[str, Any], night: bool) -> dict[str, Any]:
    """Draw doors, alcoves, the end and windows."""
    side, has_windows = draw.one_of(*Side), draw.chance(0.2)
    sill = draw.one_of(draw.between(0.0, 0.2), draw.between(0.6, 1.2))
    windows = {
        "side": side,
        "sill_m": sill,
        "head_m": min(draw.between(max(1.8, sill + 0.6), 2.6), values["height_m"] - 0.15),
        "pane_m": draw.between(0.5, 2.0),
        "pier_m": draw.one_of(draw.between(0.1, 0.2), draw.between(0.3, 1.2)),
        "from_m": draw.between(0.5, 5.0),
        "sun": 0.0 if night or draw.chance(0.4) else draw.scale(2.0, 20.0),
        "sun_azimuth_rad": draw.between(-1.0, 1.0),
        "sun_elevation_rad": draw.between(0.25, 1.1),
    }
    beside = values.get("junctions") or values.get("open_hall_m")
    return {
        "windows": None if beside or not has_windows else windows,
        "end": draw.one_of(*End, p=(0.45, 0.25, 0.08, 0.22)),
        "door_spacing_m": draw.one_of(0.0, draw.between(2.2, 9.0), p=(0.08, 0.92)),
        "door_recess_m": draw.one_of(0.03, draw.between(0.05, 0.3)),
        "door_frame_albedo": draw.albedo(),
        "open_door_share": draw.between(0.0, 0.35),
        "ajar_share": draw.one_of(0.0, 0.5),
        "alcove_share": draw.one_of(0.0, draw.between(0.1, 0.5), p=(0.75, 0.25)),
    }


def _contents(draw: Draw) -> dict[str, Any]:
    """Draw the objects in the corridor."""

    def spacing(share: float, low: float, high: float) -> float:
        return float(draw.one_of(0.0, draw.between(low, high), p=(1 - share, share)))

    return {
        "poster_spacing_m": spacing(0.85, 2.0, 10.0),
        "sign_spacing_m": spacing(0.9, 2.0, 8.0),
        "furniture_spacing_m": spacing(0.6, 2.5, 12.0),
        "boxes_spacing_m": spacing(0.3, 2.0, 9.0),
        "plants_spacing_m": spacing(0.25, 2.5, 10.0),
        "radiator_spacing_m": spacing(0.25, 3.0, 9.0),
        "lockers_share": draw.one_of(0.0, draw.between(0.2, 0.8), p=(0.88, 0.12)),
        "people": draw.one_of(0, draw.count(1, 3), draw.count(4, 9), p=(0.55, 0.3, 0.15)),
        "clutter_side": draw.one_of(Sides.BOTH, Sides.LEFT, Sides.RIGHT, p=(0.4, 0.3, 0.3)),
    }


def _light(draw: Draw, width_m: float, night: bool) -> dict[str, Any]:
    lamps = ((1.2, 0.6), (0.6, 0.6), (0.3, 1.2), (1.4, 0.15), (0.12, 1.4), (0.3, 0.3))
    size = draw.one_of(*lamps)
    return {
        "lamp_size_m": (min(size[0], 0.6 * width_m), size[1]),
        "lamp_round": size[0] == size[1],
        "lamp_spacing_m": draw.between(2.5, 8.0) if night else draw.between(1.6, 5.0),
        "lamp_offset_m": draw.one_of(0.0, draw.between(-0.35, 0.35) * width_m, p=(0.6, 0.4)),
        "lamp_off_share": draw.between(0.0, 0.75) if night else draw.one_of(0.0, draw.between(0.0, 0.5)),
        "lamp_radiance": draw.between(3.0, 14.0),
        "daylight": draw.scale(0.02, 0.3) if night else draw.between(1.0, 12.0),
        "ambient": draw.scale(0.002, 0.03) if night else draw.between(0.005, 0.05),
    }
