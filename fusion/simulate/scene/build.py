"""Build a corridor from its configuration: rooms, walls with doorways, floor, ceiling, lamps, ends and contents."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fusion.simulate.render.lighting import bake
from fusion.simulate.render.mesh import POINTS, Material, Mesh, build_tree
from fusion.simulate.scene.builder import Builder, Frame
from fusion.simulate.scene.ceiling_fittings import build_ceiling_clutter, build_lamps, room_frame
from fusion.simulate.scene.config import Ceiling, Floor, SceneConfig, WallFinish
from fusion.simulate.scene.end_walls import build_end
from fusion.simulate.scene.furniture import build_person
from fusion.simulate.scene.plan import FloatArray, Room, Wall, floor_plan, outline
from fusion.simulate.scene.textures import texture_set
from fusion.simulate.scene.wall_fittings import (
    Opening,
    build_doorway,
    decorate,
    place_openings,
)

TRUE_M = 2.0  # walls deviate by an angle over this length
OVERLAP_M, FREE_CORNER_M = 0.02, 0.003
LAYER_M = 0.001  # floors of overlapping rooms lie this far apart


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """A lit corridor.

    Parameters
    ----------
    rooms
        Corridors in the order of their numbers, then the hall.
    obstacles
        Minimum and maximum (k, 6) of the boxes round furniture, people and what hangs on the walls.
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
        World points (k, 3) that no furniture may be near, such as a flight's path.
    """
    rng = np.random.default_rng((seed, 2))
    builder = Builder(rng, light_cell_m, np.empty((0, 3)) if keep_clear is None else keep_clear)
    rooms, _ = floor_plan(config)
    _build_floors(builder, rooms, config)
    finish = _wall_material(config)
    for wall in outline(rooms):
        _build_wall(builder, wall, rooms, config, finish)
    build_lamps(builder, rooms, config)
    build_ceiling_clutter(builder, rooms[0], config)
    for _ in range(config.people):
        s, side = float(rng.uniform(3, config.length_m - 1)), float(rng.choice([-1, 1]))
        y = side * float(rng.uniform(0.05, 0.32)) * config.width_m
        with builder.standing():
            build_person(builder, room_frame(rooms[0]), s, y)
    mesh = _light(builder, config.ambient)
    return Scene(config, tuple(rooms), mesh, np.array(builder.obstacles).reshape(-1, 6))


def _light(builder: Builder, ambient: float) -> Mesh:
    textures = texture_set()
    table, cells = builder.table(textures.number)
    nodes, order = build_tree(table[:, POINTS:].reshape(-1, 4, 3))
    mesh = Mesh(np.ascontiguousarray(table[order]), nodes, np.zeros(cells, np.float32), textures.copies)
    return bake(mesh, ambient)


def _wall_material(config: SceneConfig) -> Material:
    if config.wall is WallFinish.BRICK:
        return Material(config.wall_albedo * 0.8, "brick", (0.96, 0.6))
    if config.wall is WallFinish.PANELS:
        return Material(config.wall_albedo, "plaster", (1.5, 1.5), 1.0, (1.2, 0.0), 0.008, 0.15)
    return Material(config.wall_albedo, "plaster", (1.7, 1.7), 1.0)


def _floor_material(config: SceneConfig) -> Material:
    albedo, gloss, rough = config.floor_albedo, config.floor_gloss, config.floor_roughness_rad
    kind = config.floor
    if kind is Floor.TILES:
        return Material(albedo, "vinyl", (2.1, 2.1), 0.8, (0.6, 0.6), 0.006, albedo * 0.45, 0.0, gloss, rough)
    if kind is Floor.TERRAZZO:
        return Material(
            albedo, "speckle", (0.8, 0.8), 1.0, (1.2, 1.2), 0.004, albedo * 0.5, 0.0, gloss, rough
        )
    if kind is Floor.CARPET:
        return Material(albedo * 0.6, "carpet", (0.7, 0.7), 1.0)
    if kind is Floor.CARPET_TILES:
        return Material(albedo * 0.6, "carpet", (0.7, 0.7), 1.0, (0.5, 0.5), 0.004, albedo * 0.4)
    return Material(albedo, "vinyl", (2.3, 2.3), 1.0, (0.0, 2.0), 0.004, albedo * 0.6, 0.0, gloss, rough)


def _ceiling_material(config: SceneConfig) -> Material:
    albedo = config.ceiling_albedo
    if config.ceiling is Ceiling.BOARDS:
        return Material(albedo, "ceiling_board", (0.6, 0.6), 1.0, (0.6, 0.6), 0.02, albedo * 0.8)
    if config.ceiling is Ceiling.OPEN:
        return Material(albedo * 0.35, "vinyl", (1.5, 1.5), 2.0)
    return Material(albedo, "plaster", (2.0, 2.0), 0.6)


def _build_floors(builder: Builder, rooms: list[Room], config: SceneConfig) -> None:
    for number, room in enumerate(rooms):
        turns = builder.rng.normal(0, config.parallel_std_rad, 2).tolist()
        floor = _floor_material(config).but(joint_turn_rad=turns[0])
        ceiling = _ceiling_material(config).but(joint_turn_rad=turns[1])
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


def _build_wall(
    builder: Builder, wall: Wall, rooms: list[Room], config: SceneConfig, finish: Material
) -> None:
    frame = _wall_frame(wall)
    length = wall.length_m
    is_side = wall.side in ("left", "right")
    openings: list[Opening] = []
    if is_side and rooms[wall.room].is_corridor:
        openings = place_openings(config, length, builder.rng, _free_behind(wall, rooms, frame))
    position = 0.0
    for opening in [*openings, Opening(length, length, 0.0, False)]:
        s0, s1 = position, opening.s0_m
        askew = frame.turned((s0 + s1) / 2, 0.0, _out_of_true(builder, s1 - s0, config))
        reach = (s0 - _overlap(frame, s0, length, rooms), s1 + _overlap(frame, s1, length, rooms))
        _build_piece(builder, askew, reach, config, finish)
        if is_side and s1 - s0 > 0.4:
            decorate(builder, askew, s0 + 0.1, s1 - 0.1, config, rooms[wall.room].width_m)
        if opening.s1_m > opening.s0_m:
            _panel(builder, frame, (opening.s0_m, opening.s1_m), (opening.height_m, config.height_m), finish)
            build_doorway(builder, frame, opening, config, finish)
        position = opening.s1_m
    if not is_side:
        build_end(builder, frame, wall, config)


def _out_of_true(builder: Builder, length_m: float, config: SceneConfig) -> float:
    """Angle by which a piece of wall deviates: masons keep the ends of a long one as true as those of a short one."""
    return float(builder.rng.normal(0, config.parallel_std_rad)) * min(1.0, TRUE_M / max(length_m, 1e-3))


def _overlap(frame: Frame, s: float, length_m: float, rooms: list[Room]) -> float:
    """How far a piece runs on at the end of its wall, so that no gap opens to the next: into it, or just past it."""
    if 1e-6 < s < length_m - 1e-6:
        return 0.0
    beyond = frame.point(-OVERLAP_M if s <= 1e-6 else length_m + OVERLAP_M, 0.01, 0.0)[:2]
    is_free_corner = any(bool(room.contains(beyond).any()) for room in rooms)
    return FREE_CORNER_M if is_free_corner else OVERLAP_M


def _build_piece(
    builder: Builder, frame: Frame, s: tuple[float, float], config: SceneConfig, finish: Material
) -> None:
    """Wall from floor to ceiling with its skirting board and what runs along it."""
    if config.wall is WallFinish.TWO_TONE:
        lower = finish.but(albedo=finish.albedo * 0.55)
        _panel(builder, frame, s, (0, 1.1), lower)
        _panel(builder, frame, s, (1.1, config.height_m), finish)
    else:
        _panel(builder, frame, s, (0, config.height_m), finish)
    if config.skirting_height_m > 0:
        board = Material(config.skirting_albedo, "vinyl", (1.5, 1.5), 0.8)
        builder.box(frame, s, (0, 0.013), (0, config.skirting_height_m), board, "sSDH")
    if config.handrail and s[1] - s[0] > 0.5:
        askew = frame.turned(s[0], 0.07, float(builder.rng.normal(0, config.parallel_std_rad)))
        rail = Material(0.3, "wood", (2.0, 0.5))
        builder.box(askew, (s[0] + 0.1, s[1] - 0.1), (0.05, 0.09), (0.9, 0.95), rail)
