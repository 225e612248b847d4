"""Build a corridor from its configuration: rooms, walls with doorways, floor, ceiling, lamps, ends and contents."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fusion.simulate.render.lighting import bake
from fusion.simulate.render.mesh import POINTS, Material, Mesh, build_tree
from fusion.simulate.scene.builder import Builder, Frame
from fusion.simulate.scene.ceiling_fittings import build_ceiling_clutter, build_lamps
from fusion.simulate.scene.config import SceneConfig, Sides, StripConfig, Surface, WallConfig
from fusion.simulate.scene.end_walls import build_end
from fusion.simulate.scene.furniture import build_person
from fusion.simulate.scene.materials import ceiling_material, floor_material, wall_material
from fusion.simulate.scene.plan import FloatArray, Room, Wall, floor_plan, outline, part_at, room_frame
from fusion.simulate.scene.strips import build_coving, build_strip
from fusion.simulate.scene.textures import texture_set
from fusion.simulate.scene.wall_fittings import (
    Opening,
    build_alcove,
    build_doorway,
    build_partition,
    build_pilasters,
    decorate,
    place_openings,
)
from fusion.simulate.scene.windows import build_windows, sun_of

TRUE_M = 2.0  # walls deviate by an angle over this length
OVERLAP_M, FREE_CORNER_M = 0.02, 0.003
LAYER_M = 0.001  # distance between floors of overlapping rooms


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """A lit corridor.

    Parameters
    ----------
    rooms
        Corridors in the order of their numbers, then the hall, then the second part of the first corridor.
    obstacles
        Minimum and maximum (k, 6) of the boxes around furniture, people and objects on the walls, before the floor
        is inclined.
    """

    config: SceneConfig
    rooms: tuple[Room, ...]
    mesh: Mesh
    obstacles: FloatArray


def build_scene(
    config: SceneConfig, seed: int, light_cell_m: float = 0.15, keep_clear: FloatArray | None = None
) -> Scene:
    """Build and light a corridor; the same arguments give the same scene.

    Parameters
    ----------
    keep_clear
        World points (k, 3) to keep free of furniture, such as a flight's path, before the floor is inclined.
    """
    rng = np.random.default_rng((seed, 2))
    builder = Builder(rng, light_cell_m, np.empty((0, 3)) if keep_clear is None else keep_clear)
    rooms, _ = floor_plan(config)
    _build_floors(builder, rooms, config)
    for wall in outline(rooms):
        _build_wall(builder, wall, rooms, config)
    build_lamps(builder, rooms, config)
    parts = [room for number, room in enumerate(rooms) if number == 0 or room.part_of == 0]
    for room in parts:
        build_ceiling_clutter(builder, room, config)
    _build_strips(builder, parts, config)
    build_partition(builder, rooms, config)
    for _ in range(config.people):
        s, side = float(rng.uniform(3, config.length_m - 1)), float(rng.choice([-1, 1]))
        side = {Sides.LEFT: -1.0, Sides.RIGHT: 1.0}.get(config.clutter_side, side)
        part = part_at(rooms, 0, s)
        y = side * float(rng.uniform(0.05, 0.32)) * part.width_m
        with builder.standing():
            build_person(builder, room_frame(part), s - part.x_m, y)
    builder.incline(config.slope_rad)
    mesh = _light(builder, config.ambient, sun_of(config, rooms[0]))
    return Scene(config, tuple(rooms), mesh, np.array(builder.obstacles).reshape(-1, 6))


def _light(builder: Builder, ambient: float, sun: FloatArray) -> Mesh:
    textures = texture_set()
    table, cells = builder.table(textures.number)
    nodes, order = build_tree(table[:, POINTS:].reshape(-1, 4, 3))
    mesh = Mesh(np.ascontiguousarray(table[order]), nodes, np.zeros(cells, np.float32), textures.copies, sun)
    return bake(mesh, ambient)


def _build_strips(builder: Builder, parts: list[Room], config: SceneConfig) -> None:
    """Build the strips along the floor and the ceiling of the first corridor; walls build their own."""
    for layer, strip in enumerate(config.strips):
        if strip.on not in (Surface.FLOOR, Surface.CEILING):
            continue
        for part in parts:
            begin = max(strip.from_m - part.x_m, 0.0)
            end = min((strip.to_m or config.length_m) - part.x_m, part.length_m)
            shifted = strip.model_copy(update={"at_m": strip.at_m - part.y_m})
            if end > begin and abs(shifted.at_m) + strip.width_m / 2 < part.width_m / 2 + 0.05:
                build_strip(builder, room_frame(part), (begin, end), shifted, config.height_m, layer)


def _build_floors(builder: Builder, rooms: list[Room], config: SceneConfig) -> None:
    for number, room in enumerate(rooms):
        turns = builder.rng.normal(0, config.parallel_std_rad, 2).tolist()
        floor = floor_material(config)
        floor = floor.but(joint_turn_rad=floor.joint_turn_rad + turns[0])
        ceiling = ceiling_material(config).but(joint_turn_rad=turns[1])
        corner = np.array([*room.to_world(0, -room.width_m / 2), LAYER_M * number])
        along = np.array([*(room.direction * room.length_m), 0.0])
        across = np.array([*(room.right * room.width_m), 0.0])
        up = np.array([0.0, 0.0, -1.0])
        builder.quad(corner, along, across, up, floor)
        builder.quad(corner + (config.height_m + 2 * LAYER_M * number) * up, along, across, -up, ceiling)


def _wall_frame(wall: Wall) -> Frame:
    along = (wall.end - wall.start) / wall.length_m
    return Frame(np.array([*wall.start, 0.0]), np.array([*along, 0.0]), np.array([*wall.inward, 0.0]))


def _panel(
    builder: Builder, frame: Frame, s: tuple[float, float], h: tuple[float, float], material: Material
) -> None:
    if s[1] - s[0] > 1e-3 and h[1] - h[0] > 1e-3:
        corner = frame.point(s[0], 0, h[0])
        builder.quad(
            corner, frame.vector(s[1] - s[0], 0, 0), frame.vector(0, 0, h[1] - h[0]), frame.out, material
        )


def _free_behind(wall: Wall, rooms: list[Room], frame: Frame) -> list[tuple[float, float]]:
    """Stretches of a wall with no other room within 4 m behind it."""
    free: list[tuple[float, float]] = []
    step, begin = 0.25, -1.0
    places = np.arange(0.0, wall.length_m + step, step)
    for s in places.tolist():
        probes = np.array([frame.point(s, -d, 0)[:2] for d in (0.3, 1.0, 2.0, 3.0, 4.0)])
        taken = any(
            bool(room.contains(probes, 0.1).any()) for number, room in enumerate(rooms) if number != wall.room
        )
        if taken and begin >= 0:
            free.append((begin, s))
            begin = -1.0
        elif not taken and begin < 0:
            begin = s
    if begin >= 0:
        free.append((begin - (5.0 if begin == 0 else 0), wall.length_m + 5.0))
    return free


def _build_wall(builder: Builder, wall: Wall, rooms: list[Room], config: SceneConfig) -> None:
    frame, length, room = _wall_frame(wall), wall.length_m, rooms[wall.room]
    is_side = wall.side in ("left", "right")
    is_first = is_side and (wall.room == 0 or room.part_of == 0)
    start_m = wall.s0_m + (room.x_m if is_first else 0.0)
    look = config.wall_of(wall.side if room.is_corridor else "hall")
    windows = config.windows if wall.room == 0 else None
    windows = windows if windows is not None and windows.side == wall.side else None
    openings: list[Opening] = []
    if is_side and room.is_corridor and windows is None:
        openings = place_openings(config, length, builder.rng, _free_behind(wall, rooms, frame))
    strips = [strip for strip in config.strips if is_first and strip.on == wall.side]
    fitted = _fittings_on(wall.side, config, windows is not None)
    position = 0.0
    for opening in [*openings, Opening(length, length, 0.0, False)]:
        s0, s1 = position, opening.s0_m
        angle = 0.0 if windows else _wall_deviation(builder, s1 - s0, config)
        askew = frame.turned((s0 + s1) / 2, 0.0, angle)
        reach = (s0 - _overlap(frame, s0, length, rooms), s1 + _overlap(frame, s1, length, rooms))
        _build_piece(builder, askew, reach, config, look, start_m)
        _build_wall_strips(builder, askew, reach, strips, config, start_m)
        if is_side and s1 - s0 > 0.4:
            if config.pilaster_spacing_m > 0:
                build_pilasters(builder, askew, (s0, s1), config, look, start_m)
            decorate(builder, askew, s0 + 0.1, s1 - 0.1, fitted, room.width_m)
        if opening.s1_m > opening.s0_m:
            over = opening.s0_m, opening.s1_m
            _build_bands(builder, frame, over, (opening.height_m, config.height_m), look, start_m)
            above = [s for s in strips if s.at_m - s.width_m / 2 > opening.height_m + 0.1]
            _build_wall_strips(builder, frame, over, above, config, start_m)
            if opening.alcove_m > 0:
                build_alcove(builder, frame, opening, config, look, start_m)
            else:
                build_doorway(builder, frame, opening, config, wall_material(look, look.finish, look.albedo))
        position = opening.s1_m
    if windows is not None:
        build_windows(builder, frame, windows, config, (start_m, start_m + length))
    goes_on = wall.side == "far" and any(other.part_of == wall.room for other in rooms)
    came_from = wall.side == "near" and room.part_of is not None
    if not (is_side or goes_on or came_from):
        build_end(builder, frame, wall, config)


def _fittings_on(side: str, config: SceneConfig, has_windows: bool) -> SceneConfig:
    """Return the settings without the objects that are not at this wall."""
    without: dict[str, object] = {}
    if side in ("left", "right") and config.clutter_side not in (Sides.BOTH, side):
        names = (
            "furniture_spacing_m",
            "boxes_spacing_m",
            "plants_spacing_m",
            "radiator_spacing_m",
            "lockers_share",
        )
        without |= dict.fromkeys(names, 0.0)
    if has_windows:
        without |= {"poster_spacing_m": 0.0, "sign_spacing_m": 0.0, "lockers_share": 0.0}
    return config.model_copy(update=without) if without else config


def _build_wall_strips(
    builder: Builder, frame: Frame, s: tuple[float, float], strips: list[StripConfig], config: SceneConfig,
    start_m: float,
) -> None:  # fmt: skip
    for layer, strip in enumerate(strips):
        begin = max(s[0], strip.from_m - start_m)
        end = min(s[1], (strip.to_m or config.length_m) - start_m)
        if end > begin:
            build_strip(builder, frame, (begin, end), strip, config.height_m, layer)


def _wall_deviation(builder: Builder, length_m: float, config: SceneConfig) -> float:
    """Angular deviation of a piece of wall: the offset at its ends does not depend on its length."""
    return float(builder.rng.normal(0, config.parallel_std_rad)) * min(1.0, TRUE_M / max(length_m, 1e-3))


def _overlap(frame: Frame, s: float, length_m: float, rooms: list[Room]) -> float:
    """Extension of a piece at the end of its wall that avoids a gap: into the next wall, or slightly past it."""
    if 1e-6 < s < length_m - 1e-6:
        return 0.0
    beyond = frame.point(-OVERLAP_M if s <= 1e-6 else length_m + OVERLAP_M, 0.01, 0.0)[:2]
    is_free_corner = any(bool(room.contains(beyond).any()) for room in rooms)
    return FREE_CORNER_M if is_free_corner else OVERLAP_M


def _build_bands(
    builder: Builder,
    frame: Frame,
    s: tuple[float, float],
    h: tuple[float, float],
    look: WallConfig,
    start_m: float,
) -> None:
    """Build a piece of wall between two heights, with another finish of its lower part if configured."""
    edge = min(look.lower_height_m, h[1])
    for low, high, finish, albedo in (
        (h[0], edge, look.lower_finish, look.lower_albedo),
        (max(h[0], edge), h[1], look.finish, look.albedo),
    ):
        _panel(builder, frame, s, (low, high), wall_material(look, finish, albedo, (start_m + s[0], low)))


def _build_piece(
    builder: Builder,
    frame: Frame,
    s: tuple[float, float],
    config: SceneConfig,
    look: WallConfig,
    start_m: float,
) -> None:
    """Build a wall from floor to ceiling with its skirting board or coving and its strips."""
    _build_bands(builder, frame, s, (0.0, config.height_m), look, start_m)
    if config.floor_coving_m > 0:
        finish, albedo = (
            (look.lower_finish, look.lower_albedo) if look.lower_height_m > 0 else (look.finish, look.albedo)
        )
        stuff = wall_material(look, finish, albedo)
        if config.floor_upstand_m > 0:
            stuff = floor_material(config).but(joint_spacing_m=(0.0, 0.0))
            upstand = max(config.floor_upstand_m, config.floor_coving_m + 0.01)
            builder.box(frame, s, (0, 0.003), (config.floor_coving_m, upstand), stuff, "DH")
        build_coving(builder, frame, s, config.floor_coving_m, stuff)
    elif look.skirting_height_m > 0:
        board = Material(look.skirting_albedo, "vinyl", (1.5, 1.5), 0.8)
        builder.box(frame, s, (0, look.skirting_depth_m), (0, look.skirting_height_m), board, "sSDH")
    if config.ceiling_coving_m > 0:
        stuff = ceiling_material(config).but(joint_spacing_m=(0.0, 0.0))
        build_coving(builder, frame, s, config.ceiling_coving_m, stuff, config.height_m)
    if config.handrail and s[1] - s[0] > 0.5:
        askew = frame.turned(s[0], 0.07, float(builder.rng.normal(0, config.parallel_std_rad)))
        rail = Material(0.3, "wood", (2.0, 0.5))
        builder.box(askew, (s[0] + 0.1, s[1] - 0.1), (0.05, 0.09), (0.9, 0.95), rail)
