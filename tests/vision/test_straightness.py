"""How much a lens bends straight lines: found from pictures of corridors, and not found where it does not."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from math import degrees, hypot, radians, tan

import cv2
import numpy as np
import pytest

from fusion.simulate import random_views
from vision import Camera
from vision.axis.field_of_view import FieldOfView, _fov_of_bent_picture, estimate_field_of_view
from vision.cameras.camera import Distortion
from vision.images import GreyImage
from vision.lines.straightness import (
    NO_BEND,
    Bend,
    camera_of_bend,
    check_distortion,
    estimate_bend,
    straightening_camera,
)

WIDTH, HEIGHT = 480, 360
HALF_DIAGONAL = 0.5 * hypot(WIDTH, HEIGHT)


def fisheye(fov_deg: float, k: tuple[float, ...] = (0.0,) * 4) -> Camera:
    """Return an equidistant camera of a horizontal field of view (of one without coefficients)."""
    focal = 0.5 * WIDTH / radians(0.5 * fov_deg)
    centre = (0.5 * (WIDTH - 1), 0.5 * (HEIGHT - 1))
    return Camera(WIDTH, HEIGHT, focal, focal, *centre, Distortion.EQUIDISTANT, k)


@cache
def pictures(kind: str) -> tuple[GreyImage, ...]:
    camera = {"fisheye": fisheye(120.0), "straight": Camera.from_fov(WIDTH, HEIGHT, radians(85.0))}[kind]
    return tuple(view.image for view in random_views(camera, 8, seed=31, views_per_scene=2, light_cell_m=0.5))


def test_an_equidistant_lens_is_found() -> None:
    found = estimate_bend(pictures("fisheye"))
    true_rad = HALF_DIAGONAL / fisheye(120.0).fx_px
    assert found.rad == pytest.approx(true_rad, rel=0.03)
    assert found.std_rad < 0.03
    assert abs(found.rad - true_rad) < 4.0 * found.std_rad
    assert found.radius_px(WIDTH, HEIGHT) == pytest.approx(fisheye(120.0).fx_px, rel=0.03)


def test_a_lens_that_bends_nothing_is_taken_for_one() -> None:
    assert estimate_bend(pictures("straight")) is NO_BEND
    for image in pictures("straight"):
        assert estimate_bend([image]).rad < 0.3


def test_blank_and_noisy_pictures_do_not_tell() -> None:
    noise = np.random.default_rng(0).integers(0, 256, (HEIGHT, WIDTH), dtype=np.uint8)
    for image in (np.full((HEIGHT, WIDTH), 90, np.uint8), noise):
        assert estimate_bend([image] * 3) is NO_BEND


@pytest.mark.parametrize("focal_of_radius", [0.6, 1.0, 1.15])
def test_the_camera_of_a_bend_maps_rays_by_its_formula(focal_of_radius: float) -> None:
    bend = Bend(1.1, 0.01)
    radius = bend.radius_px(WIDTH, HEIGHT)
    camera = camera_of_bend(WIDTH, HEIGHT, focal_of_radius * radius, bend)
    seen_px = np.linspace(0.0, 0.99 * HALF_DIAGONAL, 40)
    angle = np.arctan(np.tan(seen_px / radius) / focal_of_radius)
    rays = np.column_stack([np.sin(angle), np.zeros(40), np.cos(angle)])
    np.testing.assert_allclose(camera.project(rays)[:, 0] - camera.cx_px, seen_px, atol=0.5)
    if focal_of_radius == 1.0:  # an equidistant lens
        np.testing.assert_allclose(camera.coefficients, 0.0, atol=1e-6)


def test_straightened_lines_are_straight() -> None:
    """A straight line seen through a lens of the bend lies on one plane of the straightening camera's rays."""
    bend = Bend(1.2, 0.01)
    radius = bend.radius_px(WIDTH, HEIGHT)
    camera = camera_of_bend(WIDTH, HEIGHT, 0.8 * radius, bend)
    line = np.linspace([-0.8, 0.5, 1.0], [0.9, 0.3, 1.0], 9)
    straight = straightening_camera(WIDTH, HEIGHT, bend.rad).undistort(camera.project(line))
    offset = straight - straight[0]
    direction = offset[-1] / np.linalg.norm(offset[-1])
    np.testing.assert_allclose(offset[:, 0] * direction[1] - offset[:, 1] * direction[0], 0.0, atol=3e-3)


def test_field_of_view_of_a_fisheye_is_found() -> None:
    found = estimate_field_of_view(pictures("fisheye"))
    assert found.measured
    assert degrees(found.horizontal_rad) == pytest.approx(120.0, rel=0.05)
    assert abs(degrees(found.horizontal_rad) - 120.0) < 3.0 * degrees(found.std_rad)
    camera = found.camera(WIDTH, HEIGHT)
    pixels = np.array([[0.0, 180.0], [60.0, 40.0], [300.0, 350.0], [479.0, 0.0]])
    cosine = (camera.rays(pixels) * fisheye(120.0).rays(pixels)).sum(axis=1)
    assert np.degrees(np.arccos(cosine)).max() < 3.0


def test_where_right_angles_do_not_tell_a_strong_bend_does() -> None:
    untold = FieldOfView(radians(65.0), radians(20.0), measured=False, n_tried=4)
    strong, weak = Bend(1.3, 0.02), Bend(0.4, 0.02)
    found = _fov_of_bent_picture(untold, strong, straightening_camera(WIDTH, HEIGHT, strong.rad))
    assert found.measured
    # As of an equidistant lens: the angle grows with the distance from the centre.
    assert found.horizontal_rad == pytest.approx(WIDTH / strong.radius_px(WIDTH, HEIGHT), rel=1e-6)
    assert found.focal_std_share == pytest.approx(0.15)
    other = _fov_of_bent_picture(untold, weak, straightening_camera(WIDTH, HEIGHT, weak.rad))
    assert not other.measured
    assert other.bend is weak


def test_the_camera_has_the_field_of_view_said() -> None:
    for fov_deg, bend in ((70.0, NO_BEND), (70.0, Bend(0.5, 0.01)), (130.0, Bend(1.3, 0.01))):
        view = FieldOfView(radians(fov_deg), 0.01, measured=True, bend=bend)
        camera = view.camera(WIDTH, HEIGHT)
        left = camera.rays([[-0.5, camera.cy_px]])[0]
        assert 2.0 * degrees(np.arctan2(-left[0], left[2])) == pytest.approx(fov_deg, abs=0.4)
    assert view.camera(WIDTH, HEIGHT).fx_px < 0.5 * WIDTH / tan(radians(45.0))


BARREL = (-0.28, 0.07, 0.0, 0.0)
LENSES = {
    "pinhole": Camera.from_fov(WIDTH, HEIGHT, radians(85.0)),
    "barrel": replace(
        Camera.from_fov(WIDTH, HEIGHT, radians(85.0)), distortion=Distortion.RADTAN, coefficients=BARREL
    ),
    "fisheye": fisheye(120.0),
}


@cache
def seen_through(lens: str) -> tuple[GreyImage, ...]:
    return tuple(v.image for v in random_views(LENSES[lens], 8, seed=32, views_per_scene=2, light_cell_m=0.5))


def without_distortion(camera: Camera) -> Camera:
    return replace(camera, distortion=Distortion.NONE, coefficients=())


@pytest.mark.parametrize("lens", LENSES)
def test_a_correct_distortion_is_not_doubted(lens: str) -> None:
    assert check_distortion(seen_through(lens), LENSES[lens]) is None
    for image in seen_through(lens):
        assert check_distortion([image], LENSES[lens]) is None


@pytest.mark.parametrize("lens", ["barrel", "fisheye"])
def test_a_distortion_that_is_left_out_is_found_with_its_size(lens: str) -> None:
    camera = LENSES[lens]
    taken = without_distortion(camera)
    found = check_distortion(seen_through(lens), taken)
    assert found is not None
    edge_px = np.array([[taken.cx_px + share * HALF_DIAGONAL, taken.cy_px] for share in (0.5, 0.7)])
    stretch = camera.undistort(edge_px)[:, 0] / taken.undistort(edge_px)[:, 0]
    # The stretch of the model is quadratic in the distance; the lens's own only about.
    assert found.corner_share == pytest.approx(
        float((stretch[1] / stretch[0] - 1.0) / (0.49 - 0.25)), rel=0.5
    )
    assert found.corner_share > 4.0 * found.std


def test_a_distortion_of_pictures_already_rectified_is_found() -> None:
    found = check_distortion(seen_through("pinhole"), LENSES["barrel"])
    assert found is not None
    assert found.corner_share < 0.0


def test_curved_edges_are_no_sign_of_a_wrong_distortion() -> None:
    rings = np.full((HEIGHT, WIDTH), 90, np.uint8)
    for radius in range(20, 300, 16):
        cv2.circle(rings, (WIDTH // 2, HEIGHT // 2), radius, 200, 2, cv2.LINE_AA)
    blank = np.full((HEIGHT, WIDTH), 90, np.uint8)
    for image in (rings, blank):
        assert check_distortion([image] * 3, LENSES["pinhole"]) is None
