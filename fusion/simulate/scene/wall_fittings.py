"""Objects in and on the walls: doors with the rooms behind them, posters, boards, signs.

Every function builds in the wall's own frame: s along the wall, d out of it into the room, h above the floor.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fusion.simulate.render.mesh import Material
from fusion.simulate.scene.builder import Builder, Frame
from fusion.simulate.scene.config import SceneConfig, WallConfig
from fusion.simulate.scene.furniture import (
    build_boxes,
    build_furniture,
    build_lockers,
    build_plant,
    build_radiator,
)
from fusion.simulate.scene.materials import floor_material, wall_material
from fusion.simulate.scene.plan import Room, room_frame
from fusion.simulate.scene.textures import BOARDS, POSTERS, SIGNS

DOOR_HEIGHT_M = 2.05
SKEW_RAD = 0.006  # tilt of hanging sheets


@dataclass(frozen=True, slots=True)
class Opening:
    """A doorway: from s0 to s1 along the wall; ``is_open`` shows the room behind it.

    With ``alcove_m`` it is an alcove that deep.
    """

    s0_m: float
    s1_m: float
    height_m: float
    is_open: bool
    alcove_m: float = 0.0


def place_openings(
    config: SceneConfig, length_m: float, rng: np.random.Generator, free_behind: list[tuple[float, float]]
) -> list[Opening]:
    """Draw doorways along a wall; rooms are built only in the free stretches ``free_behind``."""
    openings: list[Opening] = []
    if config.door_spacing_m <= 0:
        return openings
    s = float(rng.uniform(0.4, config.door_spacing_m))
    while True:
        width = float(rng.choice([0.85, 0.95, 1.05, 1.7], p=[0.3, 0.4, 0.2, 0.1]))
        if s + width > length_m - 0.35:
            return openings
        height = min(DOOR_HEIGHT_M + float(rng.choice([0.0, 0.1])), config.height_m - 0.12)
        free = any(a < s - 1.2 and s + width + 1.2 < b for a, b in free_behind)
        if config.alcove_share > 0 and free and rng.random() < config.alcove_share:
            width = min(float(rng.uniform(0.8, 3.0)), length_m - 0.36 - s)
            height = float(rng.choice([2.1, config.height_m - 0.25, config.height_m]))
            height = min(height, config.height_m)
            openings.append(Opening(s, s + width, height, False, float(rng.uniform(0.2, 1.1))))
        else:
            is_open = bool(free and rng.random() < config.open_door_share)
            openings.append(Opening(s, s + width, height, is_open))
        s += width + max(0.5, float(rng.gamma(3.0, max(config.door_spacing_m - width, 0.6) / 3.0)))


def build_doorway(
    builder: Builder, frame: Frame, opening: Opening, config: SceneConfig, wall: Material
) -> None:
    """Frame, reveal, and either the door leaf or the lit room behind."""
    rng = builder.rng
    s0, s1, top = opening.s0_m, opening.s1_m, opening.height_m
    trim = Material(config.door_frame_albedo, "metal", (1.0, 1.0), 0.7)
    jamb, proud = float(rng.uniform(0.04, 0.09)), float(rng.uniform(0.008, 0.03))
    builder.box(frame, (s0 - jamb, s0), (0, proud), (0, top + jamb), trim, "sSDH")
    builder.box(frame, (s1, s1 + jamb), (0, proud), (0, top + jamb), trim, "sSDH")
    builder.box(frame, (s0, s1), (0, proud), (top, top + jamb), trim, "DhH")
    deep = 0.22 if opening.is_open else config.door_recess_m
    builder.quad(
        frame.point(s0, -deep, 0), frame.vector(0, deep, 0), frame.vector(0, 0, top), frame.along, trim
    )
    builder.quad(
        frame.point(s1, -deep, 0), frame.vector(0, deep, 0), frame.vector(0, 0, top), -frame.along, trim
    )
    lintel = frame.point(s0, -deep, top)
    builder.quad(lintel, frame.vector(s1 - s0, 0, 0), frame.vector(0, deep, 0), frame.vector(0, 0, -1), trim)
    sill = Material(config.floor_albedo * 0.8)
    across = frame.vector(s1 - s0, 0, 0)
    builder.quad(frame.point(s0, -deep, 0), across, frame.vector(0, deep, 0), frame.vector(0, 0, 1), sill)
    if opening.is_open:
        _build_room(builder, frame, opening, config, wall, deep)
    else:
        _build_leaf(builder, frame, opening, deep)


def _build_leaf(builder: Builder, frame: Frame, opening: Opening, deep: float) -> None:
    rng = builder.rng
    s0, s1, top = opening.s0_m, opening.s1_m, opening.height_m
    wooden = rng.random() < 0.6
    albedo = float(rng.uniform(0.12, 0.4)) if wooden else float(rng.choice([0.15, 0.3, 0.6, 0.75]))
    leaf = Material(albedo, "wood" if wooden else "metal", (0.7, 2.2), 1.0 if wooden else 0.5)
    leaves = [(s0, s1)] if s1 - s0 < 1.3 else [(s0, (s0 + s1) / 2 - 0.004), ((s0 + s1) / 2 + 0.004, s1)]
    dark = Material(0.04)
    if len(leaves) == 2:
        gap = frame.point(s0, -deep - 0.01, 0)
        builder.quad(gap, frame.vector(s1 - s0, 0, 0), frame.vector(0, 0, top), frame.out, dark)
    for a, b in leaves:
        corner = frame.point(a + 0.004, -deep, 0.006)
        builder.quad(
            corner, frame.vector(b - a - 0.008, 0, 0), frame.vector(0, 0, top - 0.01), frame.out, leaf
        )
        if rng.random() < 0.3:  # a glazed panel
            low, high = (1.1, 1.8) if rng.random() < 0.6 else (0.3, 1.85)
            inset = 0.15 * (b - a) if rng.random() < 0.5 else 0.35 * (b - a)
            glass = Material(float(rng.choice([0.05, 0.25, 0.6])), "vinyl", (1.0, 1.0), 2.0)
            rim = Material(float(rng.uniform(0.08, 0.6)))
            builder.box(
                frame,
                (a + inset - 0.03, b - inset + 0.03),
                (-deep, -deep + 0.012),
                (low - 0.03, high + 0.03),
                rim,
                "sSDhH",
            )
            pane = frame.point(a + inset, -deep + 0.013, low)
            builder.quad(
                pane, frame.vector(b - a - 2 * inset, 0, 0), frame.vector(0, 0, high - low), frame.out, glass
            )
        steel = Material(0.45)
        side = b - 0.09 if rng.random() < 0.5 else a + 0.09
        builder.box(frame, (side - 0.02, side + 0.02), (-deep, -deep + 0.01), (0.93, 1.13), steel, "sSDhH")
        turn = -1 if side > (a + b) / 2 else 1
        lever = sorted((side, side + turn * 0.12))
        builder.box(frame, (lever[0], lever[1]), (-deep + 0.04, -deep + 0.06), (1.03, 1.05), steel, "sSDhH")
        if rng.random() < 0.25:
            plate = frame.point(a + 0.02, -deep + 0.003, 0.01)
            builder.quad(plate, frame.vector(b - a - 0.04, 0, 0), frame.vector(0, 0, 0.28), frame.out, steel)


def _build_room(
    builder: Builder, frame: Frame, opening: Opening, config: SceneConfig, wall: Material, deep: float
) -> None:
    """Build a small lit room behind an open door."""
    rng = builder.rng
    a, b = opening.s0_m - float(rng.uniform(0.2, 1.0)), opening.s1_m + float(rng.uniform(0.2, 1.0))
    back, high = -deep - float(rng.uniform(2.0, 3.0)), config.height_m - 0.05
    floor = Material(config.floor_albedo * float(rng.uniform(0.7, 1.3)), "vinyl", (2.0, 2.0))
    along, out, up = frame.vector(b - a, 0, 0), frame.vector(0, -deep - back, 0), frame.vector(0, 0, high)
    corner = frame.point(a, back, 0)
    builder.quad(corner, along, up, frame.out, wall)
    builder.quad(corner, out, up, frame.along, wall)
    builder.quad(corner + along, out, up, -frame.along, wall)
    builder.quad(corner + frame.vector(0, 0, 0.001), along, out, frame.vector(0, 0, 1), floor)
    builder.quad(corner + up, along, out, frame.vector(0, 0, -1), Material(0.8))
    for s0, s1 in ((a, opening.s0_m), (opening.s1_m, b)):
        builder.quad(frame.point(s0, -deep, 0), frame.vector(s1 - s0, 0, 0), up, -frame.out, wall)
    lamp = Material(
        1.0, emission=config.lamp_radiance * float(rng.choice([0.0, 0.8, 1.6], p=[0.15, 0.45, 0.4]))
    )
    middle = frame.point((a + b) / 2 - 0.4, (back - deep) / 2 - 0.4, high - 0.01)
    builder.quad(middle, frame.vector(0.8, 0, 0), frame.vector(0, 0.8, 0), frame.vector(0, 0, -1), lamp)
    if rng.random() < 0.6:
        shade = Material(float(rng.uniform(0.1, 0.6)), "wood", (1.0, 1.0))
        builder.box(
            frame, (a + 0.1, b - 0.3), (back, back + 0.5), (0, float(rng.uniform(0.7, 1.8))), shade, "sSDH"
        )
    _swing_leaf(builder, frame, opening, deep, config.ajar_share)


def _swing_leaf(builder: Builder, frame: Frame, opening: Opening, deep: float, ajar_share: float) -> None:
    """Build an open door's leaf, swung into the room behind."""
    rng = builder.rng
    leaf = Material(float(rng.uniform(0.12, 0.6)), "wood", (0.7, 2.2))
    wide, swing = opening.s1_m - opening.s0_m, float(rng.uniform(0.9, 1.9))
    if ajar_share > 0 and rng.random() < ajar_share:
        swing = float(rng.uniform(0.08, 0.6))
    hinge, turn = (opening.s0_m, -swing) if rng.random() < 0.5 else (opening.s1_m, swing)
    turned = frame.turned(hinge, -deep, turn)
    span = (hinge, hinge + wide) if turn < 0 else (hinge - wide, hinge)
    builder.box(turned, span, (-deep - 0.04, -deep), (0.01, opening.height_m - 0.01), leaf, "sSdDH")


def hang_sheet(
    builder: Builder, frame: Frame, s: float, low: float, size: tuple[float, float], texture: str
) -> None:
    """Hang a poster, board or sign, a few millimetres to centimetres thick and slightly tilted."""
    rng = builder.rng
    thick = float(rng.choice([0.003, 0.012, 0.025]))
    face = Material(float(rng.uniform(0.6, 0.9)), texture)
    rim = Material(float(rng.uniform(0.1, 0.7)))
    skew = float(rng.normal(0, SKEW_RAD))
    along = frame.vector(size[0] * np.cos(skew), 0, size[0] * np.sin(skew))
    up = frame.vector(-size[1] * np.sin(skew), 0, size[1] * np.cos(skew))
    out = frame.vector(0, thick, 0)
    back = frame.point(s, 0, low)
    rims = ((back, along, -up), (back + up, along, up), (back, up, -along), (back + along, up, along))
    for corner, edge, facing in rims:
        builder.quad(corner, edge, out, facing, rim)
    # text runs from left to right for either direction of the wall
    if np.cross(along, up) @ frame.out < 0:
        back, along = back + along, -along
    builder.quad(back + out, along, up, frame.out, face)


def decorate(
    builder: Builder, frame: Frame, s0: float, s1: float, config: SceneConfig, room_m: float
) -> None:
    """Fill a piece of wall between two doorways with objects."""
    rng = builder.rng
    lockers = rng.random() < config.lockers_share
    if lockers and s1 - s0 > 0.9:
        with builder.standing():
            build_lockers(builder, frame, s0 + 0.1, s1 - 0.1)
        return
    s = s0 + 0.12
    rates = (
        ("poster", config.poster_spacing_m, 0.75),
        ("sign", config.sign_spacing_m, 0.3),
        ("furniture", config.furniture_spacing_m, 1.0),
        ("radiator", config.radiator_spacing_m, 1.2),
        ("boxes", config.boxes_spacing_m, 1.0),
        ("plant", config.plants_spacing_m, 0.6),
    )
    present = [(name, 1 / spacing, size) for name, spacing, size in rates if spacing > 0]
    if not present:
        return
    weights = np.array([rate for _, rate, _ in present])
    while True:
        s += float(rng.exponential(1 / weights.sum())) * 0.6 + 0.05
        name, _, size = present[int(rng.choice(len(present), p=weights / weights.sum()))]
        if s + size > s1 - 0.08:
            return
        build = _BUILD[name]
        with builder.standing():
            s += build(builder, frame, s, s1, room_m)


def build_alcove(
    builder: Builder, frame: Frame, opening: Opening, config: SceneConfig, look: WallConfig, start_m: float
) -> None:
    """Build a recess in the wall: its back and sides like the wall, its floor like the corridor's."""
    s0, s1, top, deep = opening.s0_m, opening.s1_m, opening.height_m, opening.alcove_m
    along, inwards, up = frame.vector(s1 - s0, 0, 0), frame.vector(0, deep, 0), frame.vector(0, 0, top)
    back = wall_material(look, look.finish, look.albedo, (start_m + s0, 0.0))
    side = back.but(origin_m=None)
    builder.quad(frame.point(s0, -deep, 0), along, up, frame.out, back)
    builder.quad(frame.point(s0, -deep, 0), inwards, up, frame.along, side)
    builder.quad(frame.point(s1, -deep, 0), inwards, up, -frame.along, side)
    floor = floor_material(config).but(joint_spacing_m=(0.0, 0.0))
    builder.quad(frame.point(s0, -deep, 0), along, inwards, frame.vector(0, 0, 1), floor)
    builder.quad(frame.point(s0, -deep, top), along, inwards, frame.vector(0, 0, -1), Material(0.7))
    rng = builder.rng
    if deep > 0.35 and rng.random() < 0.5:
        with builder.standing():
            deep_m = min(0.45, deep - 0.05)
            box = Material(float(rng.uniform(0.05, 0.6)), "wood", (1.0, 0.7))
            high = float(rng.uniform(0.4, 1.8))
            builder.box(frame, (s0 + 0.1, s1 - 0.15), (-deep, -deep + deep_m), (0, high), box, "sSDH")


def build_pilasters(
    builder: Builder,
    frame: Frame,
    s: tuple[float, float],
    config: SceneConfig,
    look: WallConfig,
    start_m: float,
) -> None:
    """Build the pilasters that fall on a piece of wall between two doorways."""
    spacing = config.pilaster_spacing_m
    wide, deep = config.pilaster_m
    stuff = Material(config.pilaster_albedo, "blocks", (1.6, 1.6))
    first = int(np.ceil((s[0] + start_m + 0.15) / spacing))
    for k in range(first, first + int((s[1] - s[0]) / spacing) + 1):
        place = k * spacing - start_m
        if s[0] + 0.15 < place and place + wide < s[1] - 0.15:
            with builder.standing():
                builder.box(frame, (place, place + wide), (0, deep), (0, config.height_m), stuff, "sSD")


def build_partition(builder: Builder, rooms: list[Room], config: SceneConfig) -> None:
    """Build the low wall between the first corridor and the open hall."""
    if config.open_hall_m is None or config.partition_height_m == 0:
        return
    low, high = config.open_hall_m
    half, top = config.width_m / 2, config.partition_height_m
    look = config.wall_of("right" if config.open_hall_right else "left")
    material = wall_material(look, look.finish, look.albedo)
    frame = room_frame(rooms[0])
    d = (half, half + 0.1) if config.open_hall_right else (-half - 0.1, -half)
    builder.box(frame, (low, high), d, (0, top), material, "sSdD")
    cap = Material(0.35, "wood", (1.5, 0.5))
    builder.box(frame, (low, high), (d[0] - 0.02, d[1] + 0.02), (top, top + 0.03), cap)


def _poster(builder: Builder, frame: Frame, s: float, s1: float, room_m: float) -> float:
    rng = builder.rng
    if rng.random() < 0.35:
        size = (min(float(rng.uniform(0.8, 2.0)), s1 - s - 0.05), float(rng.uniform(0.7, 1.1)))
        hang_sheet(builder, frame, s, 1.0, size, str(rng.choice(BOARDS)))
    else:
        wide = float(rng.uniform(0.3, 0.65))
        size = (wide, wide * float(rng.uniform(1.2, 1.5)))
        hang_sheet(builder, frame, s, float(rng.uniform(1.1, 1.35)), size, str(rng.choice(POSTERS)))
    return size[0]


def _sign(builder: Builder, frame: Frame, s: float, s1: float, room_m: float) -> float:
    rng = builder.rng
    kind = rng.random()
    if kind < 0.5:
        wide = float(rng.uniform(0.12, 0.25))
        hang_sheet(builder, frame, s, 1.5, (wide, wide * 0.8), str(rng.choice(SIGNS)))
    elif kind < 0.8:  # switch or socket
        low = float(rng.choice([0.25, 1.05]))
        builder.box(frame, (s, s + 0.085), (0, 0.012), (low, low + 0.085), Material(0.85), "sSDhH")
    else:  # extinguisher with its bracket
        red = Material(0.16)
        builder.prism(frame, (s + 0.1, 0.1), (0.075, 0.075), (0.55, 1.05), red, 8)
        builder.prism(frame, (s + 0.1, 0.1), (0.03, 0.03), (1.05, 1.15), Material(0.05), 6)
    return 0.25


_BUILD = {
    "poster": _poster,
    "sign": _sign,
    "furniture": build_furniture,
    "radiator": build_radiator,
    "boxes": build_boxes,
    "plant": build_plant,
}
