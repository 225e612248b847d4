"""Line segments: sub-pixel positions, direction, what noise and darkness change, lenses."""

from __future__ import annotations

from math import atan2, cos, radians, sin

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.vision.corridor_lines import lines_between
from vision import Camera, InputError, Reason, measure_frame
from vision.cameras.camera import Distortion
from vision.compiled import compiled
from vision.lines.fitting import (
    FITTED_LINE,
    MAX_RMS_PX,
    MIN_PIXELS,
    _are_of_one_edge,
    _fill_middle,
    _next_in_line,
)
from vision.lines.preparation import estimate_noise_and_blockiness
from vision.lines.segments import extract_lines
from vision.types import RecordArray

CAMERA = Camera(640, 480, 466.0, 466.0, 319.5, 239.5)


def half_plane(
    angle_rad: float,
    offset_px: float,
    width: int = 640,
    height: int = 480,
    dark: float = 60,
    bright: float = 180,
) -> npt.NDArray[np.uint8]:
    """Picture of an edge through the centre plus ``offset_px``, anti-aliased by area."""
    k = 4
    y, x = np.mgrid[0 : height * k, 0 : width * k]
    u = (x + 0.5) / k - 0.5 - (width - 1) / 2
    v = (y + 0.5) / k - 0.5 - (height - 1) / 2
    inside = np.clip(0.5 + k * (-sin(angle_rad) * u + cos(angle_rad) * v - offset_px), 0.0, 1.0)
    share = inside.reshape(height, k, width, k).mean(axis=(1, 3))
    return np.asarray(np.round(dark + (bright - dark) * share), dtype=np.uint8)


@settings(max_examples=12, deadline=None)
@given(st.floats(-1.5, 1.5), st.floats(-20.0, 20.0))
def test_an_edge_is_found_to_a_twentieth_of_a_pixel(angle_rad: float, offset_px: float) -> None:
    lines = extract_lines(half_plane(angle_rad, offset_px, 320, 240), CAMERA.resized(320, 240))
    best = int(np.argmax(lines.length_px))
    x0, y0, x1, y1 = lines.ends_px[best]
    direction = atan2(y1 - y0, x1 - x0)
    assert abs(sin(direction - angle_rad)) < radians(0.1)
    middle = ((x0 + x1) / 2 - 159.5, (y0 + y1) / 2 - 119.5)
    distance = -sin(angle_rad) * middle[0] + cos(angle_rad) * middle[1]
    assert distance == pytest.approx(offset_px, abs=0.05)


def test_bright_is_on_the_right_and_the_normal_points_to_it() -> None:
    lines = extract_lines(half_plane(0.0, 10.0), CAMERA)  # bright below
    x0, _, x1, _ = lines.ends_px[0]
    assert x1 > x0
    assert lines.normal[0] @ [0, 1, 0] > 0.99
    lines = extract_lines(255 - half_plane(0.0, 10.0), CAMERA)
    x0, _, x1, _ = lines.ends_px[0]
    assert x1 < x0
    assert lines.normal[0] @ [0, -1, 0] > 0.99


def test_a_thin_line_is_two_edges_and_a_blank_picture_none() -> None:
    image = np.full((480, 640), 200, np.uint8)
    assert len(extract_lines(image, CAMERA)) == 0
    cv2.line(image, (50, 100), (600, 100), 40, 5)
    lines = extract_lines(image, CAMERA)
    assert len(lines) == 2
    assert sorted(np.round(lines.ends_px[:, 1]).tolist()) == [97.0, 102.0] or np.ptp(lines.ends_px[:, 1]) > 4


def test_noise_alone_gives_next_to_no_lines() -> None:
    rng = np.random.default_rng(1)
    image = np.clip(rng.normal(100, 8, (480, 640)), 0, 255).astype(np.uint8)
    assert estimate_noise_and_blockiness(image)[0] == pytest.approx(8.0, rel=0.05)
    assert len(extract_lines(image, CAMERA)) < 5


@pytest.mark.parametrize(("light", "noise"), [(1.0, 0.0), (0.15, 1.0), (1.0, 8.0)])
def test_threshold_follows_light_and_noise(light: float, noise: float) -> None:
    rng = np.random.default_rng(2)
    image = half_plane(0.4, 5.0).astype(float) * light + rng.normal(0, noise, (480, 640))
    lines = extract_lines(np.clip(np.round(image), 0, 255).astype(np.uint8), CAMERA)
    assert lines.length_px.max() > 300
    assert lines.length_px[lines.length_px > 100].sum() > 450


def test_opposite_edges_never_join() -> None:
    image = np.full((240, 320), 120, np.uint8)
    image[:120, :160] = 200
    image[120:, 160:] = 200  # a chequerboard corner: the edge turns over in the middle
    lines = extract_lines(image, CAMERA.resized(320, 240))
    assert lines.length_px.max() < 165


def test_small_and_large_pictures_come_back_in_their_own_pixels() -> None:
    for width, height in ((80, 60), (160, 120), (1280, 960), (2560, 1920)):
        scale = width / 640
        image = cv2.resize(half_plane(0.3, 0.0), (width, height), interpolation=cv2.INTER_AREA)
        lines = extract_lines(image, CAMERA.resized(width, height))
        x0, y0, x1, y1 = lines.ends_px[int(np.argmax(lines.length_px))]
        assert atan2(y1 - y0, x1 - x0) == pytest.approx(0.3, abs=0.006) or atan2(
            y0 - y1, x0 - x1
        ) == pytest.approx(0.3, abs=0.006)
        centre = ((width - 1) / 2, (height - 1) / 2)
        off = -sin(0.3) * ((x0 + x1) / 2 - centre[0]) + cos(0.3) * ((y0 + y1) / 2 - centre[1])
        assert abs(off) < 0.1 * max(scale, 1.0)


def test_a_fisheye_bends_edges_and_the_fit_is_straight() -> None:
    fisheye = Camera(
        640, 480, 210.0, 210.0, 319.5, 239.5, Distortion.EQUIDISTANT, (0.02, -0.01, 0.003, -0.0005)
    )
    x, y = np.meshgrid(np.arange(640.0), np.arange(480.0))
    rays = fisheye.rays(np.column_stack([x.ravel(), y.ravel()]))
    normal = np.array([0.3, 0.9, -0.35])
    normal /= np.linalg.norm(normal)
    sine = (rays @ normal).reshape(480, 640)
    image = np.clip(120 + 15000 * sine, 60, 180).astype(np.uint8)  # soft over about one pixel
    lines = extract_lines(image, fisheye)
    longest = np.argsort(-lines.arc_rad)[:2]
    assert lines.arc_rad[longest].sum() > radians(60)
    for i in longest:
        assert abs(lines.normal[i] @ normal) > cos(radians(0.3))


def test_every_threads_frames_are_their_own() -> None:
    from concurrent.futures import ThreadPoolExecutor

    pictures = [half_plane(a, 0.0) for a in (0.1, 0.5, 0.9, 1.3)]
    alone = [extract_lines(p, CAMERA).ends_px for p in pictures]
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(lambda p: extract_lines(p, CAMERA).ends_px, pictures * 5))
    for i, ends in enumerate(together):
        np.testing.assert_array_equal(ends, alone[i % 4])


def test_a_picture_of_another_size_is_refused() -> None:
    with pytest.raises(InputError, match="320"):
        extract_lines(np.zeros((240, 320), np.uint8), CAMERA)


def test_blockiness_tells_compression_from_structure() -> None:
    clean = np.clip(half_plane(0.5, 3.0) + np.random.default_rng(0).normal(0, 2, (480, 640)), 0, 255).astype(
        np.uint8
    )
    assert estimate_noise_and_blockiness(clean)[1] < 1.3
    packed = cv2.imdecode(
        cv2.imencode(".jpg", clean, [cv2.IMWRITE_JPEG_QUALITY, 10])[1], cv2.IMREAD_GRAYSCALE
    )
    assert estimate_noise_and_blockiness(np.asarray(packed, np.uint8))[1] > 1.7


@pytest.mark.parametrize("noise", [0.5, 3.0, 7.0])
def test_a_fine_picture_is_searched_at_three_quarters_of_its_size(noise: float) -> None:
    """Whatever its noise: what is seen must not change at some level of it."""
    rng = np.random.default_rng(3)
    image = np.full((480, 640), 60.0)
    image[:, 100:106] = 90.0  # two edges so near to each other that blur would let one pull at the other
    image[:, 106:] = 120.0
    noisy = np.clip(image + rng.normal(0.0, noise, image.shape), 0, 255).astype(np.uint8)
    lines = extract_lines(noisy, CAMERA)
    long = lines.length_px > 60.0
    assert lines.length_px[long].sum() > 700.0
    assert (lines.n_pixels[long] / lines.length_px[long]).max() == pytest.approx(0.75, abs=0.1)
    off_px = lines.ends_px[long][:, 0] - 99.5
    assert np.abs(off_px - 6.0 * np.round(off_px / 6.0)).max() < 0.5


@pytest.mark.parametrize("angle_rad", [0.3, 1.2, -0.8, 2.6])
@pytest.mark.parametrize("width", [320, 640])
def test_an_edge_with_gaps_is_one_line(angle_rad: float, width: int) -> None:
    """What covers parts of an edge does not make it tell less of where it points."""
    image = half_plane(angle_rad, 3.0, width, width * 3 // 4)
    for x, y in ((0.35, 0.4), (0.5, 0.5), (0.62, 0.58), (0.35, 0.6), (0.62, 0.42)):
        cv2.circle(image, (round(x * width), round(0.75 * y * width)), width // 40, 120, -1)
    lines = extract_lines(image, CAMERA.resized(width, width * 3 // 4))
    long = np.flatnonzero(lines.length_px > 0.3 * width)
    assert len(long) == 1
    x0, y0, x1, y1 = lines.ends_px[long[0]]
    assert atan2(y1 - y0, x1 - x0) == pytest.approx(angle_rad, abs=radians(0.1))
    inner = extract_lines(
        half_plane(angle_rad, 3.0, width, width * 3 // 4), CAMERA.resized(width, width * 3 // 4)
    )
    assert lines.length_px[long[0]] > 0.8 * inner.length_px.max()


def test_parallel_edges_and_edges_at_an_angle_are_not_joined() -> None:
    """Two edges one behind the other are one line only if they are in line with each other."""
    image = np.full((480, 640), 60, np.uint8)
    image[100:, 60:300] = 180
    image[103:, 330:560] = 180  # three pixels lower
    cv2.fillPoly(image, [np.array([[60, 300], [300, 300], [560, 312], [560, 340], [60, 340]])], 20)
    lines = extract_lines(image, CAMERA)
    level = np.abs(lines.ends_px[:, 1] - lines.ends_px[:, 3]) < 0.02 * lines.length_px
    upper = level & (lines.ends_px[:, 1] < 150) & (lines.length_px > 100)
    assert np.sort(lines.ends_px[upper][:, 1]) == pytest.approx([99.5, 102.5], abs=0.3)
    assert lines.length_px[upper].max() < 250
    bent = (lines.ends_px[:, 1] > 290) & (lines.ends_px[:, 1] < 315) & (lines.length_px > 100)
    assert bent.sum() == 2


@compiled
def joined_pairs(lines: RecordArray, floor_px: float) -> tuple[int, int]:
    """Count the pairs that are of one edge, and those among them that a list of the second line alone comes to."""
    pairs = found = 0
    following, middles = np.full(len(lines), -1), np.empty((len(lines), 3))
    for i in range(len(lines)):
        _fill_middle(lines[i], floor_px, middles[i])
    for i in range(len(lines)):
        for j in range(len(lines)):
            if i != j and _are_of_one_edge(lines[i], lines[j], floor_px):
                pairs += 1
                found += _next_in_line(lines[i], middles[i], middles, following, j) == j
    return pairs, found


def test_what_tells_lines_apart_at_once_passes_no_fragment_over() -> None:
    """Of the pairs that are of one edge, it leaves none out, however uncertain the lines are."""
    rng = np.random.default_rng(7)
    lines = np.zeros(400, FITTED_LINE)
    length, angle = rng.uniform(7.0, 60.0, len(lines)), rng.normal(0.5, 0.05, len(lines))
    x, y = rng.uniform(0.0, 300.0, len(lines)), rng.normal(0.0, 3.0, len(lines))
    x, y = x * cos(0.5) - y * sin(0.5), x * sin(0.5) + y * cos(0.5)
    lines["x0"], lines["y0"] = x - 0.5 * length * np.cos(angle), y - 0.5 * length * np.sin(angle)
    lines["x1"], lines["y1"] = x + 0.5 * length * np.cos(angle), y + 0.5 * length * np.sin(angle)
    lines["length"], lines["n_pixels"] = length, np.maximum(length, MIN_PIXELS)
    lines["rms"] = rng.uniform(0.0, MAX_RMS_PX, len(lines))
    pairs, found = joined_pairs(lines, 0.055)
    assert pairs > 500
    assert found == pairs


@pytest.mark.parametrize("at", [0.2, 0.5, 0.9])
def test_a_line_cut_in_two_lies_where_it_lay(at: float) -> None:
    lines = lines_between(np.array([[100.0, 50.0, 300.0, 350.0], [20.0, 400.0, 600.0, 420.0]]), CAMERA)
    x, y = lines.ends_px[0, :2] + at * (lines.ends_px[0, 2:] - lines.ends_px[0, :2])

    def ray_of(x: float, y: float) -> npt.NDArray[np.float64]:
        ray = np.array([(x - CAMERA.cx_px) / CAMERA.fx_px, (y - CAMERA.cy_px) / CAMERA.fy_px, 1.0])
        return np.asarray(ray / np.linalg.norm(ray))

    cut = lines.cut(np.array([True, False]), ray_of(x, y))
    assert cut.ends_px[0] == pytest.approx(lines.ends_px[1])
    assert cut.ends_px[1, :2] == pytest.approx(lines.ends_px[0, :2])
    assert cut.ends_px[2, 2:] == pytest.approx(lines.ends_px[0, 2:])
    assert cut.ends_px[1, 2:] == pytest.approx(cut.ends_px[2, :2])
    # Where along the line it is cut goes by angles, not by pixels: near enough, as the plane is the same.
    assert cut.ends_px[1, 2:] == pytest.approx([x, y], abs=10.0)
    assert cut.length_px[1:].sum() == pytest.approx(lines.length_px[0])
    assert cut.arc_rad[1:].sum() == pytest.approx(lines.arc_rad[0])
    np.testing.assert_allclose(cut.normal[1:], lines.normal[[0, 0]])
    np.testing.assert_allclose(np.cross(cut.centre, cut.direction), cut.normal, atol=1e-9)
    # each part's plane spans from end to end
    for part in (1, 2):
        angles = [
            np.arctan2(cut.direction[part] @ end, cut.centre[part] @ end)
            for end in (ray_of(*cut.ends_px[part, :2]), ray_of(*cut.ends_px[part, 2:]))
        ]
        assert angles == pytest.approx([-0.5 * cut.arc_rad[part], 0.5 * cut.arc_rad[part]], abs=0.03)


@pytest.mark.parametrize(("width", "height"), [(1, 1), (1, 2000), (2000, 1), (3, 1200)])
def test_a_picture_too_thin_for_lines_has_none(width: int, height: int) -> None:
    camera = Camera(
        width_px=width, height_px=height, fx_px=500.0, fy_px=500.0, cx_px=0.5 * width, cy_px=0.5 * height
    )
    noise = np.random.default_rng(0).integers(0, 255, (height, width)).astype(np.uint8)
    assert len(extract_lines(noise, camera)) == 0
    assert measure_frame(noise, camera).reason is Reason.TOO_FEW_LINES
