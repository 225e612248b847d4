"""Where things land in rendered pictures, against the camera model; and what light, blur and noise do."""

from __future__ import annotations

import os
import subprocess
import sys
from math import radians
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fusion.simulate.config import ImagingConfig, rotation
from fusion.simulate.render.kernels import hit_distance, joint_share, texture_value, trace
from fusion.simulate.render.lighting import bake
from fusion.simulate.render.mesh import (
    ALBEDO,
    EMISSION,
    LIGHT_START,
    POINTS,
    SUN_COUNT,
    Material,
    Mesh,
    build_tree,
)
from fusion.simulate.render.view import Image, View, render_linear
from fusion.simulate.scene.build import build_scene
from fusion.simulate.scene.builder import Builder
from fusion.simulate.scene.config import Floor, SceneConfig
from fusion.simulate.scene.plan import floor_plan
from fusion.simulate.scene.textures import texture_set
from fusion.simulate.sensor import Sensor
from vision import Camera
from vision.cameras.camera import Distortion

FloatArray = npt.NDArray[np.float64]

PINHOLE = Camera.from_fov(160, 120, radians(70))
CAMERAS = {
    "pinhole": PINHOLE,
    "radtan": Camera(160, 120, 100, 101, 80.3, 58.9, Distortion.RADTAN, (-0.25, 0.08, 0.001, -0.002)),
    "equidistant": Camera(160, 120, 62, 62, 79.0, 60.5, Distortion.EQUIDISTANT, (0.02, -0.01, 0.003, 0.0)),
    "mounted": Camera(
        160, 120, 110, 110, 79.5, 59.5, R_body_camera=rotation(0.1, -0.15, 0.08) @ PINHOLE.R_body_camera
    ),
}


def mesh_of(builder: Builder) -> Mesh:
    table, cells = builder.table(texture_set().number)
    nodes, order = build_tree(table[:, POINTS:].reshape(-1, 4, 3))
    return Mesh(
        np.ascontiguousarray(table[order]),
        nodes,
        np.zeros(cells, np.float32),
        texture_set().copies,
        np.zeros(SUN_COUNT),
    )


def lamp(corner: FloatArray, a: FloatArray, b: FloatArray) -> Mesh:
    """A glowing parallelogram in the dark, seen from the origin."""
    builder = Builder(np.random.default_rng(0))
    builder.quad(corner, a, b, -corner, Material(1.0, emission=1.0))
    return mesh_of(builder)


def outline_px(camera: Camera, R: FloatArray, corners: list[FloatArray]) -> FloatArray:
    """Outline of a polygon of world points seen from the origin, finely divided."""
    share = np.linspace(0, 1, 200, endpoint=False)[:, None]
    points = np.concatenate(
        [a + share * (b - a) for a, b in zip(corners, corners[1:] + corners[:1], strict=True)]
    )
    return camera.project(points @ R @ camera.R_body_camera)


def area_and_centroid(polygon: FloatArray) -> tuple[float, FloatArray]:
    x, y = polygon.T
    xn, yn = np.roll(x, -1), np.roll(y, -1)
    cross = x * yn - xn * y
    area = cross.sum() / 2
    return abs(area), np.array([((x + xn) * cross).sum(), ((y + yn) * cross).sum()]) / (6 * area)


@pytest.mark.parametrize("name", CAMERAS)
def test_a_surface_covers_the_pixels_that_the_camera_model_says(name: str) -> None:
    camera = CAMERAS[name]
    R = rotation(0.12, 0.07, -0.2)
    corner, a, b = np.array([3.0, -0.6, -0.5]), np.array([0.9, 1.1, 0.1]), np.array([-0.2, 0.2, 1.2])
    picture = render_linear(lamp(corner, a, b), View.of(camera), [np.zeros(3)], [R], grid=8)
    area, centroid = area_and_centroid(
        outline_px(camera, R, [corner, corner + a, corner + a + b, corner + b])
    )
    y, x = np.mgrid[: camera.height_px, : camera.width_px]
    seen = picture.sum()
    assert area > 300
    assert seen == pytest.approx(area, rel=2e-3)
    assert (picture * x).sum() / seen == pytest.approx(centroid[0], abs=0.02)
    assert (picture * y).sum() / seen == pytest.approx(centroid[1], abs=0.02)


def test_the_nearest_surface_hides_the_others_and_a_back_is_not_seen() -> None:
    builder = Builder(np.random.default_rng(0))
    for x, light in ((4.0, 1.0), (2.0, 0.5), (3.0, 0.25)):
        edge = np.array([0.0, 6.0, 0.0]), np.array([0.0, 0.0, 6.0])
        facing = np.array([1.0, 0, 0]) if x == 3.0 else np.array([-1.0, 0, 0])
        builder.quad(np.array([x, -3.0, -3.0]), *edge, facing, Material(1.0, emission=light))
    picture = render_linear(mesh_of(builder), View.of(PINHOLE), [np.zeros(3)], [np.eye(3)])
    assert np.allclose(picture, 0.5)


def edge_profile(picture: Image, row: float, column: float, normal: FloatArray) -> float:
    """Signed distance along the normal from a point to the steepest change, from second differences."""
    import cv2

    steps = np.arange(-4, 4.01, 0.25)
    x = (column + steps * normal[0]).astype(np.float32)
    y = (row + steps * normal[1]).astype(np.float32)
    values = cv2.remap(picture, x[None], y[None], cv2.INTER_CUBIC)[0].astype(float)
    slope = np.abs(np.gradient(values, steps))
    slope[np.abs(steps) > 3] = 0
    weight = np.where(slope > 0.3 * slope.max(), slope, 0)
    return float((weight * steps).sum() / weight.sum())


@pytest.mark.parametrize("name", CAMERAS)
def test_corridor_corners_stand_where_they_project_to(name: str) -> None:
    camera = CAMERAS[name].resized(320, 240)
    bare = SceneConfig(
        length_m=12, floor=Floor.CARPET, floor_albedo=0.05, wall_albedo=0.9, skirting_height_m=0, door_spacing_m=0,
        poster_spacing_m=0, sign_spacing_m=0, furniture_spacing_m=0, lamp_off_share=0, parallel_std_rad=0,
    )  # fmt: skip
    scene = build_scene(bare, 1)
    R, origin = rotation(radians(6), radians(-2), radians(3)), np.array([2.0, 0.25, -1.3])
    picture = render_linear(scene.mesh, View.of(camera), [origin], [R])
    errors = []
    for side in (-1.1, 1.1):
        s = np.linspace(3.2, 8.0, 60)
        points = np.stack([s, np.full(60, side), np.zeros(60)], axis=1)
        pixels = camera.project((points - origin) @ R @ camera.R_body_camera)
        along = np.gradient(pixels, axis=0)
        along /= np.linalg.norm(along, axis=1)[:, None]
        for (x, y), (tx, ty) in zip(pixels, along, strict=True):
            if 8 < x < 311 and 8 < y < 231:
                errors.append(edge_profile(picture, y, x, np.array([-ty, tx])))
    assert len(errors) > 40
    assert abs(np.median(errors)) < 0.08
    assert np.percentile(np.abs(errors), 90) < 0.35


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000))
def test_the_tree_finds_what_testing_every_surface_finds(seed: int) -> None:
    rng = np.random.default_rng(seed)
    builder = Builder(rng)
    for _ in range(40):
        corner, a, b = rng.uniform(-5, 5, 3), rng.normal(0, 1, 3), rng.normal(0, 1, 3)
        builder.quad(corner, a, b, rng.normal(0, 1, 3), Material(0.5), ellipse=bool(rng.random() < 0.2))
    mesh = mesh_of(builder)
    for _ in range(30):
        o, d = rng.uniform(-3, 3, 3), rng.normal(0, 1, 3)
        d /= np.linalg.norm(d)
        every = [hit_distance(mesh.table, i, *o, *d)[0] for i in range(len(mesh.table))]
        (ox, oy, oz), (dx, dy, dz) = o.tolist(), d.tolist()
        found, t, _, _ = trace(mesh.table, mesh.nodes, ox, oy, oz, dx, dy, dz, 1e9, False)
        assert t == pytest.approx(min(every))
        assert found == (-1 if min(every) >= 1e9 else int(np.argmin(every)))


def test_light_falls_off_like_the_solid_angle_and_shadows_are_dark() -> None:
    builder = Builder(np.random.default_rng(0), light_cell_m=0.1)
    down, up = np.array([0.0, 0, 1]), np.array([0.0, 0, -1])
    side = np.array([0.2, 0, 0]), np.array([0, 0.2, 0])
    builder.quad(np.array([-0.1, -0.1, -3.0]), *side, down, Material(1.0, emission=10.0))
    builder.quad(
        np.array([-0.05, -0.05, 0.0]), np.array([0.1, 0, 0]), np.array([0, 0.1, 0]), up, Material(0.0)
    )
    builder.quad(np.array([0.0, 4.95, 0.0]), np.array([0.1, 0, 0]), np.array([0, 0.1, 0]), up, Material(0.0))
    builder.quad(
        np.array([-0.5, 2.0, -1.5]), np.array([1.0, 0, 0]), np.array([0, 1.0, 0]), down, Material(0.0)
    )
    mesh = bake(mesh_of(builder), 0.0)
    light = {}
    for row in mesh.table:
        if row[EMISSION] == 0 and row[ALBEDO] == 0:
            light[round(float(row[POINTS + 1]), 2)] = float(mesh.lightmap[int(row[LIGHT_START])])
    assert light[-0.05] == pytest.approx(
        10 * 0.04 / 9 / np.pi, rel=0.01
    )  # radiance times solid angle over pi
    assert light[4.95] == 0.0  # behind the board, which is seen from below


def test_textures_keep_their_mean_when_seen_from_afar() -> None:
    textures = texture_set()
    number = textures.number["wood"]
    full = textures.copies[number * 511 * 511 :][: 256 * 256]
    for width in (1.0, 4.0):
        value = texture_value(textures.copies, number, 0.3, 0.7, width, width)
        assert value == pytest.approx(full.mean(), abs=1e-3)
    along = [texture_value(textures.copies, number, u, 0.5, 1 / 256, 1.0) for u in np.linspace(0, 1, 50)]
    assert np.std(along) > 0.05  # averaged along the grain only, the grain stays


@given(st.floats(-3, 3), st.floats(0.001, 2.0))
def test_joints_cover_their_share(x: float, footprint: float) -> None:
    share = joint_share(x, footprint, 0.5, 0.05)
    fine = np.linspace(x - footprint / 2, x + footprint / 2, 20001)
    assert share == pytest.approx(np.mean(np.mod(fine, 0.5) < 0.05), abs=2e-3)


def test_motion_blurs_over_the_path_and_the_rolling_shutter_leans() -> None:
    mesh = lamp(np.array([2.0, -0.2, -2.0]), np.array([0, 0.4, 0.0]), np.array([0, 0, 4.0]))
    view = View.of(PINHOLE)
    still = render_linear(mesh, view, [np.zeros(3)], [np.eye(3)])
    turns = [rotation(a, 0, 0) for a in np.linspace(-0.04, 0.04, 33).tolist()]
    blurred = render_linear(mesh, view, [np.zeros(3)] * 33, turns)
    rows = np.array([rotation(a, 0, 0) for a in np.linspace(-0.04, 0.04, 120).tolist()])
    leaning = render_linear(mesh, view, [np.zeros(3)], [rows])
    half = slice(0, 80)

    def width(picture: npt.NDArray[np.float32]) -> float:
        line = picture[60, half].astype(float)
        return float(np.count_nonzero((line > 0.02) & (line < 0.98)))

    travel = 0.08 * PINHOLE.fx_px
    assert width(blurred) - width(still) == pytest.approx(travel, abs=2.0)
    centre = [float((row * np.arange(160)).sum() / row.sum()) for row in leaning[[5, 60, 115]].astype(float)]
    # the lower rows see from further right, and what they see moves left
    assert centre[0] - centre[2] == pytest.approx(travel * 110 / 119, rel=0.03)


def test_the_sensors_noise_is_shot_noise_and_read_noise() -> None:
    view = View.of(Camera.from_fov(200, 200, 0.2))
    config = ImagingConfig(
        brightness=0.25, full_well_electrons=4000, read_noise_electrons=10, defocus_px=0, bloom=0, vignetting=0,
        gamma=1.0,
    )  # fmt: skip
    sensor = Sensor.of(config, view, 1.0)
    picture = sensor.develop(np.ones((200, 200), np.float32), np.random.default_rng(1)).astype(float)
    electrons = 1000.0
    expected = 255 * np.hypot(np.sqrt(electrons), 10) / 4000
    assert picture.mean() == pytest.approx(0.25 * 255, abs=0.2)
    assert picture.std() == pytest.approx(np.hypot(expected, 1 / 12**0.5), rel=0.03)
    silent = Sensor.of(config.model_copy(update={"noise": False}), view, 1.0)
    assert silent.develop(np.ones((200, 200), np.float32), np.random.default_rng(1)).std() == 0


def test_a_wide_lens_shows_what_lies_beside_it_and_nothing_outside_its_circle() -> None:
    camera = Camera(200, 200, 55, 55, 99.5, 99.5, Distortion.EQUIDISTANT, (0.0, -0.05, 0.0, 0.0))
    scene = build_scene(SceneConfig(length_m=6), 2)
    picture = render_linear(scene.mesh, View.of(camera), [np.array([2.0, 0.0, -1.3])], [np.eye(3)])
    rays = camera.rays(np.array([[x, 100.0] for x in range(200)]))
    inside = np.asarray(np.isfinite(rays).all(axis=1))
    assert 0 < inside.sum() < 200
    lit = picture[100] > 0
    assert lit[2:-2].tolist() == inside[2:-2].tolist() or np.count_nonzero(lit != inside) <= 2


def test_people_and_furniture_leave_the_path_free() -> None:
    crowded = SceneConfig(length_m=15, people=30, furniture_spacing_m=1.0)
    path = np.stack([np.linspace(0, 15, 200), np.zeros(200), np.full(200, -1.2)], axis=1)
    scene = build_scene(crowded, 3, 0.5, path)
    assert len(scene.obstacles) > 5
    low, high = scene.obstacles[:, None, :3], scene.obstacles[:, None, 3:]
    assert not ((path > low) & (path < high)).all(axis=2).any()
    assert floor_plan(crowded)[0][0].contains(path[:, :2], 0.1).all()


def test_code_on_disk_is_not_used_after_an_inner_function_changed(tmp_path: Path) -> None:
    (tmp_path / "loops.py").write_text(
        "import parts\nfrom fusion.simulate.render.compile import outer\n"
        "@outer(parts)\ndef twice(x):\n    return 2 * parts.step(x)\n"
    )

    def answer(step: str) -> str:
        text = f"from fusion.simulate.render.compile import inner\n@inner\ndef step(x):\n    return {step}\n"
        (tmp_path / "parts.py").write_text(text)
        code = "import loops; print(loops.twice(5), sum(loops.twice.stats.cache_hits.values()))"
        # Byte code of a file that changes within a second, and not in size, would pass for that of the new one.
        environment = os.environ | {"PYTHONDONTWRITEBYTECODE": "1"}
        command = [sys.executable, "-c", code]
        done = subprocess.run(
            command, cwd=tmp_path, capture_output=True, text=True, check=True, env=environment
        )
        return done.stdout.strip()

    assert answer("x + 1") == "12 0"
    assert answer("x + 1") == "12 1"
    assert answer("x + 3") == "16 0"
