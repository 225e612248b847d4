"""What corridors are made of: every element stands, and shows in the picture, where its configuration says."""

from __future__ import annotations

from math import radians, tan
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fusion.simulate import SceneConfig
from fusion.simulate.config import rotation
from fusion.simulate.render.kernels import trace
from fusion.simulate.render.mesh import (
    EMISSION,
    JOINT_ALBEDO,
    JOINT_U,
    ORIGIN_U,
    POINTS,
    SCALE_U,
    SHIFT_U,
    TEXTURE,
)
from fusion.simulate.render.view import View, render_linear
from fusion.simulate.scene.build import Scene, build_scene
from fusion.simulate.scene.config import StripConfig, WallConfig
from fusion.simulate.scene.plan import corridor_length_m, floor_plan, outline, part_at
from fusion.simulate.scene.random_scene import is_night
from fusion.simulate.scene.textures import texture_set
from vision import Camera

FloatArray = npt.NDArray[np.float64]

CAMERA = Camera.from_fov(320, 240, radians(80))
CELL_M = 0.4
BARE: dict[str, Any] = {
    "length_m": 14, "width_m": 2.4, "height_m": 2.7, "floor": "carpet", "skirting_height_m": 0, "door_spacing_m": 0,
    "poster_spacing_m": 0, "sign_spacing_m": 0, "furniture_spacing_m": 0, "lamp_off_share": 0, "parallel_std_rad": 0,
}  # fmt: skip
PLACE = np.array([2.0, 0.2, -1.4])
LEFT, RIGHT, UP, DOWN = (0, -1, 0), (0, 1, 0), (0, 0, -1), (0, 0, 1)
POSE = rotation(radians(5), radians(-2), radians(3))


def bare(**changes: Any) -> Scene:
    return build_scene(SceneConfig.model_validate(BARE | changes), 1, CELL_M)


def seen(scene: Scene, place: FloatArray = PLACE) -> FloatArray:
    return render_linear(scene.mesh, View.of(CAMERA), [place], [POSE]).astype(float)


def pixels_of(points: FloatArray, place: FloatArray = PLACE) -> FloatArray:
    """Where world points (n, 3) are seen from the place."""
    return CAMERA.project((points - place) @ POSE @ CAMERA.R_body_camera)


def distance(scene: Scene, origin: tuple[float, float, float], towards: tuple[float, float, float]) -> float:
    """Distance to what a ray meets."""
    return float(trace(scene.mesh.table, scene.mesh.nodes, *origin, *towards, 1e9, False)[1])


def on_surface(surface: str, s: FloatArray, at_m: float, out_m: float = 0.0) -> FloatArray:
    """World points (n, 3) along a line on one of the bare corridor's surfaces."""
    half, height = BARE["width_m"] / 2, BARE["height_m"]
    y, z = {
        "floor": (at_m, -out_m),
        "ceiling": (at_m, out_m - height),
        "left": (out_m - half, -at_m),
        "right": (half - out_m, -at_m),
    }[surface]
    return np.stack([s, np.full(len(s), y), np.full(len(s), z)], axis=1)


# --- what runs along ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("on", "at_m"),
    [("floor", -0.7), ("floor", 0.5), ("ceiling", 0.9), ("left", 1.1), ("right", 0.6), ("right", 1.9)],
)
def test_a_painted_line_is_seen_where_the_camera_model_says(on: str, at_m: float) -> None:
    line = StripConfig.model_validate({"on": on, "at_m": at_m, "width_m": 0.12, "albedo": 1.0})
    plain, painted = (seen(bare(strips=strips, ambient=1.0)) for strips in ((), (line,)))
    changed = painted > 1.2 * plain
    s = np.linspace(0.5, 14.0, 2000)
    near, far, middle = (pixels_of(on_surface(on, s, at_m + e)) for e in (-0.06, 0.06, 0.0))
    ahead = np.isfinite(near).all(axis=1) & np.isfinite(far).all(axis=1)
    outline_px = np.concatenate([near[ahead], far[ahead][::-1]]).astype(np.float32)
    rows, columns = np.nonzero(changed)
    assert len(rows) > 60
    for x, y in zip(columns.tolist(), rows.tolist(), strict=True):
        assert cv2.pointPolygonTest(outline_px, (x, y), True) > -1.0
    inside = (
        ahead & (middle > 2).all(axis=1) & (middle[:, 0] < 317) & (middle[:, 1] < 237) & (s > 2.5) & (s < 8)
    )
    assert np.count_nonzero(inside) > 100
    assert np.mean([changed[round(y), round(x)] for x, y in middle[inside]]) > 0.98


@pytest.mark.parametrize(
    ("strip", "ray", "expected_m"),
    [
        # a rail in front of the left wall, a duct under the ceiling, a pipe on the floor, a ledge on the right
        ({"on": "left", "at_m": 0.9, "width_m": 0.1, "depth_m": 0.05, "gap_m": 0.04}, ((6, 0, -0.9), LEFT), 1.11),
        ({"on": "right", "at_m": 0.4, "width_m": 0.1, "depth_m": 0.15}, ((6, 0, -0.4), RIGHT), 1.05),
        ({"on": "ceiling", "at_m": 0.7, "width_m": 0.3, "depth_m": 0.2}, ((6.6, 0.7, -1), UP), 1.5),
        ({"on": "ceiling", "at_m": -0.7, "width_m": 0.2, "gap_m": 0.1, "round": True}, ((6.6, -0.7, -1), UP), 1.4),
        ({"on": "floor", "at_m": 0.8, "width_m": 0.2, "round": True}, ((6, 0.8, -1), DOWN), 0.8),
        ({"on": "left", "at_m": 1.5, "width_m": 0.1, "gap_m": 0.05, "round": True}, ((6, 0, -1.5), LEFT), 1.05),
    ],
)  # fmt: skip
def test_what_stands_out_is_met_where_it_stands(strip: dict[str, Any], ray: Any, expected_m: float) -> None:
    tolerance = 0.006 if strip.get("round") else 1e-6  # a pipe has flat facets
    with_it, without = bare(strips=(strip,)), bare()
    assert distance(with_it, *ray) == pytest.approx(expected_m, abs=tolerance)
    assert distance(without, *ray) > expected_m + 0.03
    origin, (dx, dy, dz) = ray
    mirrored = (origin[0], -origin[1], origin[2]), (dx, -dy, dz)
    if dy != 0 or abs(origin[1]) > 0.3:  # it is on one side only
        assert distance(with_it, *mirrored) == pytest.approx(distance(without, *mirrored))


def test_a_strip_ends_where_it_ends_and_a_grate_has_slots() -> None:
    strip = {"on": "floor", "at_m": 0.0, "width_m": 0.3, "depth_m": 0.1, "from_m": 4, "to_m": 9}
    scene = bare(strips=(strip | {"slot_spacing_m": 0.05},))
    heights = [distance(scene, (s, 0, -1), (0, 0, 1)) for s in (3.9, 4.1, 8.9, 9.1)]
    assert heights == pytest.approx([1.0, 0.9, 0.9, 1.0])
    dashed = bare(strips=(strip | {"dash_m": 1.0},))
    heights = [distance(dashed, (s, 0, -1), (0, 0, 1)) for s in (3.9, 4.5, 5.5, 6.5, 7.5, 8.5, 9.1)]
    assert heights == pytest.approx([1.0, 0.9, 1.0, 0.9, 1.0, 0.9, 1.0])
    slotted = scene.mesh.table[scene.mesh.table[:, JOINT_U] == 0.05]
    assert len(slotted) > 0
    assert slotted[:, JOINT_ALBEDO] == pytest.approx(0.125)


@pytest.mark.parametrize("turn_rad", [-1.2, -0.4, 0.0, 0.7])
def test_planks_lie_at_their_angle_to_the_corridor(turn_rad: float) -> None:
    scene = bare(
        floor="planks",
        floor_tile_m=0.8,
        floor_joint_m=0.4,
        floor_joint_ratio=0.1,
        floor_turn_rad=turn_rad,
        floor_gloss=0.0,
        ambient=1.0,
        parallel_std_rad=0.0,
    )
    picture = seen(scene)
    s, y = (v.ravel() for v in np.meshgrid(np.linspace(2.5, 6.0, 40), np.linspace(-0.9, 0.9, 40)))
    px = pixels_of(np.stack([s, y, np.zeros(len(s))], axis=1)).round()
    inside = (px > 1).all(axis=1) & (px[:, 0] < 318) & (px[:, 1] < 238)
    # Across the planks, from the left wall, where the first joint begins.
    across = (np.cos(turn_rad) * (y + BARE["width_m"] / 2) - np.sin(turn_rad) * s)[inside] % 0.8
    light = picture[px[inside, 1].astype(int), px[inside, 0].astype(int)]
    joint, plank = (across > 0.1) & (across < 0.3), (across > 0.5) & (across < 0.7)
    assert min(joint.sum(), plank.sum()) > 50
    assert np.percentile(light[joint], 95) < 0.5 * np.percentile(light[plank], 5)


def test_each_wall_has_its_own_skirting_and_lower_part() -> None:
    left = WallConfig(skirting_height_m=0.2, skirting_depth_m=0.03, albedo=0.8)
    right = WallConfig(
        skirting_height_m=0.08, skirting_depth_m=0.01, lower_height_m=1.2, lower_albedo=0.1, albedo=0.8
    )
    scene = bare(left_wall=left, right_wall=right, ambient=1.0)
    depths = [1.2 - distance(scene, (6, 0, -h), (0, side, 0)) for side in (-1, 1) for h in (0.05, 0.15, 0.3)]
    assert depths == pytest.approx([0.03, 0.03, 0.0, 0.01, 0.0, 0.0])
    picture, s = seen(scene), np.linspace(4, 5, 20)

    def brightness(side: str, h: float) -> float:
        return float(np.mean([picture[round(y), round(x)] for x, y in pixels_of(on_surface(side, s, h))]))

    assert brightness("right", 1.0) < 0.3 * brightness("right", 1.4)
    assert brightness("left", 1.0) > 0.8 * brightness("left", 1.4)


def test_a_coving_leaves_no_edge_between_floor_and_wall() -> None:
    same = {"floor_albedo": 0.6, "floor": "vinyl", "wall_albedo": 0.36, "ambient": 0.2, "floor_gloss": 0.0}
    sharp, rounded = (
        seen(bare(**same, floor_coving_m=radius, floor_upstand_m=up))
        for radius, up in ((0.0, 0.0), (0.1, 0.4))
    )
    steepest = []
    for picture in (sharp, rounded):
        slopes = []
        for x, y in pixels_of(on_surface("right", np.linspace(4.6, 6.4, 9), 0.0)):
            column = picture[round(y) - 14 : round(y) + 15, round(x)]
            slopes.append(np.abs(np.diff(column)).max() / column.mean())
        steepest.append(float(np.median(slopes)))
    assert steepest[1] < 0.5 * steepest[0]
    edge = bare(floor_coving_m=0.1)
    # the corner is filled by a quarter of a cylinder
    diagonal = distance(edge, (6, 0.2, -1.0), (0, 2**-0.5, 2**-0.5))
    assert diagonal == pytest.approx(2**0.5 * (1 - 0.1 * (1 - 2**-0.5)), abs=0.003)
    assert distance(bare(ceiling_coving_m=0.1), (6.6, 0.2, -1.7), (0, 2**-0.5, -(2**-0.5))) == pytest.approx(
        diagonal, abs=0.003
    )


def test_bricks_and_tiles_go_on_from_one_piece_of_wall_to_the_next() -> None:
    wall = {"finish": "brick", "brick_m": (0.25, 0.08)}
    scene = build_scene(
        SceneConfig.model_validate(BARE | {"left_wall": wall, "door_spacing_m": 2.5, "end": "wall"}),
        3,
        CELL_M,
    )
    brick = texture_set().number["brick"]
    table = scene.mesh.table[scene.mesh.table[:, TEXTURE] == brick]
    table = table[np.abs(table[:, POINTS + 1] + 1.2) < 0.05]  # not the rooms behind
    assert len(table) > 6
    # the place in the texture over the place in the world is one and the same
    u = (table[:, SHIFT_U] - table[:, SCALE_U] * table[:, POINTS]) % 1.0
    v = (table[:, SHIFT_U + 1] + table[:, SCALE_U + 1] * table[:, POINTS + 2]) % 1.0
    assert np.abs((u - u[0] + 0.5) % 1.0 - 0.5).max() < 0.02
    assert np.abs((v - v[0] + 0.5) % 1.0 - 0.5).max() < 1e-6
    tiles = bare(right_wall={"finish": "tiles", "brick_m": (0.2, 0.2)}).mesh.table
    tiled = tiles[tiles[:, JOINT_U] == 0.2]
    assert np.allclose(tiled[:, ORIGIN_U], tiled[:, POINTS], atol=0.01)


# --- the building -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("slope", [0.08, -0.1])
def test_a_slopes_corners_lead_to_a_vanishing_point_above_or_below_the_horizon(slope: float) -> None:
    scene = bare(slope_rad=slope, floor_albedo=0.05, wall_albedo=0.9)
    place = PLACE - np.array([0.0, 0.0, tan(slope) * PLACE[0]])
    picture = seen(scene, place)
    ahead = np.array([np.cos(slope), 0.0, -np.sin(slope)])
    vanishing = pixels_of(place + ahead[None], place)[0]
    level = pixels_of(place + np.array([[1.0, 0.0, 0.0]]), place)[0]
    assert np.sign(level[1] - vanishing[1]) == np.sign(slope)  # up in the picture is less
    assert np.hypot(*(level - vanishing)) == pytest.approx(CAMERA.fx_px * tan(abs(slope)), rel=0.1)
    # the dark floor's edge points there
    edges = []
    for side in (-1.2, 1.2):
        s = np.linspace(4.0, 9.0, 30)
        for x, y in pixels_of(np.stack([s, np.full(30, side), -tan(slope) * s], axis=1), place):
            if 8 < y < 230 and 8 < x < 310:
                column = picture[round(y) - 5 : round(y) + 6, round(x)]
                edges.append(round(y) - 5 + int(np.argmin(np.diff(column))) + 0.5 - y)
    assert len(edges) > 30
    assert abs(np.median(edges)) < 0.6
    # a post stays upright
    points = scene.mesh.table[:, POINTS:].reshape(-1, 4, 3)
    walls = points[np.abs(points[:, :, 1]).min(axis=1) > 1.15]
    uprights = [b - a for quad in walls for a, b in zip(quad, np.roll(quad, -1, axis=0), strict=True)]
    steep = [abs(e[2]) for e in uprights if abs(e[0]) < 1e-9 and abs(e[1]) < 1e-9 and abs(e[2]) > 1e-6]
    assert max(steep) == pytest.approx(2.7, abs=1e-6)


@pytest.mark.parametrize(("moves", "middle_m"), [("both", 0.0), ("left", 0.4), ("right", -0.4)])
def test_a_step_changes_the_width_and_moves_the_middle(moves: str, middle_m: float) -> None:
    scene = bare(width_step={"at_m": 7, "width_m": 1.6, "moves": moves})
    before = [distance(scene, (5, 0, -1.3), (0, side, 0)) for side in (-1, 1)]
    after = [distance(scene, (10, 0, -1.3), (0, side, 0)) for side in (-1, 1)]
    assert before == pytest.approx([1.2, 1.2])
    assert sum(after) == pytest.approx(1.6)
    assert (after[1] - after[0]) / 2 == pytest.approx(middle_m)
    part = part_at(scene.rooms, 0, 10.0)
    assert (part.width_m, part.y_m) == pytest.approx((1.6, middle_m))
    assert part_at(scene.rooms, 0, 6.9).width_m == 2.4
    assert corridor_length_m(scene.rooms, 0) == pytest.approx(14.0)
    # the step itself is a wall, and the way on is free
    face_y = 1.0 if moves in ("both", "right") else -1.0
    assert distance(scene, (5, face_y, -1.3), (1, 0, 0)) == pytest.approx(2.0)
    assert distance(scene, (5, middle_m, -1.3), (1, 0, 0)) > 8.9


@given(st.floats(3, 17), st.floats(1.0, 4.0), st.sampled_from(["left", "right", "both"]), st.booleans())
@settings(max_examples=40, deadline=None)
def test_walls_round_a_step_have_the_inside_on_one_side_only(
    at_m: float, width_m: float, moves: str, junction: bool
) -> None:
    junctions = ({"at_m": at_m - 0.5, "angle_rad": 1.5, "width_m": 1.6, "length_m": 9},) if junction else ()
    step = {"at_m": at_m, "width_m": width_m, "moves": moves}
    config = SceneConfig.model_validate(
        {"length_m": 20, "width_m": 2.2, "width_step": step, "junctions": junctions}
    )
    rooms, _ = floor_plan(config)
    for wall in outline(rooms):
        if wall.length_m < 0.3:
            continue
        ends = 0.1 / wall.length_m
        points = wall.start + np.linspace(ends, 1 - ends, 15)[:, None] * (wall.end - wall.start)

        def inside(at: FloatArray) -> npt.NDArray[np.bool_]:
            return np.asarray(np.any([room.contains(at) for room in rooms], axis=0))

        assert inside(points + 0.004 * wall.inward).all()
        assert not inside(points - 0.004 * wall.inward).any()


def test_a_partition_hides_the_hall_up_to_its_height() -> None:
    scene = bare(open_hall_m=(3, 12), open_hall_right=True, partition_height_m=1.0)
    assert distance(scene, (7, 0, -0.5), (0, 1, 0)) == pytest.approx(1.2)
    assert distance(scene, (7, 0, -1.4), (0, 1, 0)) > 8
    assert distance(scene, (7, 0, -1.4), (0, -1, 0)) == pytest.approx(1.2)


def test_beams_and_pillars_stand_out() -> None:
    scene = bare(beam_spacing_m=3.0, beam_m=(0.2, 0.25), pilaster_spacing_m=2.0, pilaster_m=(0.4, 0.15))
    ceiling = [distance(scene, (s, 0.9, -1.0), (0, 0, -1)) for s in np.arange(1.0, 13.0, 0.05).tolist()]
    assert min(ceiling) == pytest.approx(1.7 - 0.25)
    assert 0.03 < np.mean(np.array(ceiling) < 1.6) < 0.12
    for side in (-1, 1):
        walls = [distance(scene, (s, 0.0, -1.3), (0, side, 0)) for s in np.arange(1.0, 13.0, 0.05).tolist()]
        assert min(walls) == pytest.approx(1.2 - 0.15)
        assert np.mean(np.array(walls) < 1.1) == pytest.approx(0.2, abs=0.06)


def test_alcoves_open_into_the_wall_and_doors_stand_ajar() -> None:
    config = BARE | {"door_spacing_m": 2.5, "alcove_share": 1.0}
    scene = build_scene(SceneConfig.model_validate(config), 3, CELL_M)
    depths = np.array(
        [distance(scene, (s, 0.0, -1.9), (0, 1, 0)) - 1.2 for s in np.arange(1, 13, 0.1).tolist()]
    )
    assert 0.15 < depths.max() < 1.15
    doors = {"door_spacing_m": 2.5, "open_door_share": 1.0, "length_m": 20}
    reaches = []
    for share in (0.0, 1.0):
        scene = build_scene(SceneConfig.model_validate(BARE | doors | {"ajar_share": share}), 3, CELL_M)
        # how far one looks into the rooms behind: a leaf that is ajar stands in the way
        depth = [distance(scene, (s, 0.0, -1.4), (0, 1, 0)) - 1.2 for s in np.arange(1, 19, 0.02).tolist()]
        reaches.append(float(np.mean(np.array(depth) > 1.2)))
    assert reaches[0] > 0.2
    assert reaches[1] < 0.6 * reaches[0]


def test_the_sun_shines_through_the_panes_and_things_cast_shadows() -> None:
    windows = {
        "side": "left", "sill_m": 0.8, "head_m": 2.2, "pane_m": 1.0, "pier_m": 0.5, "from_m": 1.0,
        "sun": 20.0, "sun_azimuth_rad": 0.3, "sun_elevation_rad": 0.75,
    }  # fmt: skip
    scene = bare(windows=windows, end="wall", lamp_radiance=0.5)
    assert np.count_nonzero(scene.mesh.table[:, EMISSION] == 6.0) == 8  # panes
    picture, place = seen(scene), PLACE
    floor = np.array([(s, y) for s in np.arange(3.5, 7.0, 0.05) for y in np.arange(-0.6, 1.1, 0.05)])
    points = np.column_stack([floor, np.zeros(len(floor))])
    # back along the sun to the wall: at y = -1.2, so much further along and so high
    way = floor[:, 1] + 1.2
    s_wall, h_wall = floor[:, 0] + way * tan(0.3), way / np.cos(0.3) * tan(0.75)
    # how far inside a pane (positive), or outside
    phase = (s_wall - 1.0) % 1.5
    depth = np.minimum.reduce([np.minimum(phase, 1.0 - phase), h_wall - 0.8, 2.2 - h_wall])
    px = pixels_of(points, place).round().astype(int)
    inside = (px[:, 0] > 2) & (px[:, 0] < 317) & (px[:, 1] > 2) & (px[:, 1] < 237)
    lit = np.array([picture[y, x] for x, y in px[inside]])
    depth = depth[inside]
    assert np.count_nonzero(depth > 0.08) > 50
    assert lit[depth > 0.08].min() > 2 * np.median(lit[depth < -0.08])
    assert np.percentile(lit[depth < -0.08], 95) < 0.5 * lit[depth > 0.08].min()
    # a beam above hides the sun from what lies behind it
    shaded = seen(bare(windows=windows, end="wall", lamp_radiance=0.5, strips=(
        {"on": "floor", "at_m": -0.9, "width_m": 0.1, "depth_m": 0.9, "gap_m": 0.6},
    )))  # fmt: skip
    lit_then = np.array([shaded[y, x] for x, y in px[inside]])
    assert (lit_then[depth > 0.08] < 0.5 * lit[depth > 0.08]).any()


def test_clutter_stands_on_the_side_it_is_given() -> None:
    crowd = {
        "boxes_spacing_m": 1.5,
        "plants_spacing_m": 2.0,
        "furniture_spacing_m": 3.0,
        "people": 5,
        "length_m": 20,
    }
    boxes = bare(**crowd, clutter_side="right").obstacles
    assert len(boxes) > 6
    assert (boxes[:, 1] + boxes[:, 4] > 0).all()
    both = bare(**crowd).obstacles
    assert (both[:, 1] > 0).any()
    assert (both[:, 4] < 0).any()


def test_lamps_hang_off_the_middle() -> None:
    for offset in (0.0, 0.5):
        table = bare(lamp_offset_m=offset, lamp_size_m=(0.3, 0.3), lamp_round=True, end="wall").mesh.table
        lamps = table[(table[:, EMISSION] > 5) & (table[:, POINTS + 2] < -2.5)].reshape(-1, table.shape[1])
        centres = lamps[:, POINTS:].reshape(-1, 4, 3)[:, :, 1].mean(axis=1)
        assert np.median(centres) == pytest.approx(offset, abs=0.03)


# --- drawn at random ----------------------------------------------------------------------------------------------


def test_every_feature_is_in_a_sensible_share_of_random_corridors() -> None:
    scenes = [SceneConfig.random(seed) for seed in range(300)]

    def strips(scene: SceneConfig, *surfaces: str) -> list[StripConfig]:
        return [strip for strip in scene.strips if strip.on in surfaces]

    walls = ("left", "right")
    shares = {
        "brick": [s.wall_of("left").finish == "brick" for s in scenes],
        "wall tiles": ["tiles" in (s.wall_of("right").finish, s.wall_of("right").lower_finish) for s in scenes],
        "unequal walls": [s.left_wall != s.right_wall for s in scenes],
        "gloss": [s.floor_gloss > 0.05 for s in scenes],
        "coving": [s.floor_coving_m > 0 for s in scenes],
        "beams": [s.beam_spacing_m > 0 for s in scenes],
        "pilasters": [s.pilaster_spacing_m > 0 for s in scenes],
        "deep pillars": [s.pilaster_spacing_m > 0 and s.pilaster_m[1] > 0.2 for s in scenes],
        "deep beams": [s.beam_spacing_m > 0 and s.beam_m[1] > 0.3 for s in scenes],
        "along a wall": [bool(strips(s, "left", "right")) for s in scenes],
        "along the floor": [bool(strips(s, "floor")) for s in scenes],
        "along the ceiling": [bool(strips(s, "ceiling")) for s in scenes],
        "low cabinets": [any(c.depth_m > 0.07 and c.width_m > 0.4 for c in strips(s, *walls)) for s in scenes],
        "kerb": [any(k.depth_m > 0.0 for k in strips(s, "floor")) for s in scenes],
        "pipe near the floor": [any(p.round and p.at_m < 0.4 for p in strips(s, *walls)) for s in scenes],
        "border below a bulkhead": [
            any(c.depth_m > 0.0 and c.at_m == f.at_m for c in strips(s, "ceiling") for f in strips(s, "floor"))
            for s in scenes
        ],
        "gutter": [any(strip.slot_spacing_m for strip in strips(s, "floor")) for s in scenes],
        "alcoves": [s.alcove_share > 0 for s in scenes],
        "ajar": [s.ajar_share > 0 for s in scenes],
        "windows": [s.windows is not None for s in scenes],
        "sun": [s.windows is not None and s.windows.sun > 0 for s in scenes],
        "open side": [s.open_hall_m is not None for s in scenes],
        "slope": [s.slope_rad != 0 for s in scenes],
        "step": [s.width_step is not None for s in scenes],
        "narrower behind a junction": [bool(s.junctions) and s.width_step is not None for s in scenes],
        "one-sided clutter": [s.clutter_side != "both" for s in scenes],
        "people": [s.people > 0 for s in scenes],
        "lamps aside": [s.lamp_offset_m != 0 for s in scenes],
        "night": [is_night(seed) for seed in range(300)],
    }  # fmt: skip
    for name, found in shares.items():
        assert 0.04 < np.mean(found) < 0.8, name


def test_a_plain_office_has_nothing_of_it() -> None:
    plain = [SceneConfig.random_office(seed) for seed in range(30)]
    fields = ("strips", "windows", "width_step", "slope_rad", "left_wall", "alcove_share", "floor_coving_m")
    assert all(
        getattr(scene, name) == SceneConfig.model_fields[name].default for scene in plain for name in fields
    )


@given(st.integers(0, 2**31), st.floats(1.2, 4.0), st.floats(5.0, 40.0))
@settings(max_examples=30, deadline=None)
def test_a_random_corridor_keeps_what_is_fixed(seed: int, width_m: float, length_m: float) -> None:
    scene = SceneConfig.random(seed, width_m=width_m, length_m=length_m)
    assert (scene.width_m, scene.length_m) == (width_m, length_m)
    assert SceneConfig.random(seed, slope_rad=0.05).slope_rad == 0.05
    assert SceneConfig.random(seed, wall="brick").wall_of("right").finish == "brick"
    assert SceneConfig.random(seed, junctions=({"at_m": 6.0},)).slope_rad == 0.0
