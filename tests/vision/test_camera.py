"""Projection and its inverse, against OpenCV where OpenCV is right and against the model where it is not."""

from __future__ import annotations

import pickle
from math import cos, inf, nan, pi, radians, sin, sqrt

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vision.cameras.camera import Camera, Distortion
from vision.cameras.lens import Equidistant, RadialTangential
from vision.errors import InputError
from vision.types import FloatArray

# The analogue fisheye-like lens of a Crazyflie: OpenCV's own inverse fails on it.
STRONG = Camera(
    640,
    480,
    210.24118591854983,
    211.4846805698751,
    318.51182284207556,
    252.48457990317036,
    Distortion.RADTAN,
    (
        0.19941623511989434,
        -0.20736409267316344,
        0.0007040531507409564,
        0.0008060182732909919,
        0.047875485130274044,
    ),
)
EUROC = Camera(
    752,
    480,
    458.654,
    457.296,
    367.215,
    248.375,
    Distortion.RADTAN,
    (-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05),
)
RATIONAL = Camera(
    640, 480, 600.0, 601.0, 320.0, 240.0, Distortion.RADTAN, (0.4, -0.5, 5e-4, -3e-4, -0.05, 0.7, -0.4, -0.15)
)
FISHEYE = Camera(
    512,
    512,
    190.97847715128717,
    190.9733070521226,
    254.93170605935475,
    256.8974428996504,
    Distortion.EQUIDISTANT,
    (0.0034823894022493434, 0.0007150348452162257, -0.0020532361418706202, 0.00020293673591811182),
)
PLAIN = Camera(640, 480, 466.0, 466.0, 319.5, 239.5)
CAMERAS = {"strong": STRONG, "euroc": EUROC, "rational": RATIONAL, "fisheye": FISHEYE, "plain": PLAIN}

each_camera = pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS.keys())


def picture_grid(camera: Camera, step_px: float = 7.0) -> FloatArray:
    """Pixels (n, 2) over the whole picture, its very edges included."""
    u = np.append(np.arange(-0.5, camera.width_px - 0.5, step_px), camera.width_px - 0.5)
    v = np.append(np.arange(-0.5, camera.height_px - 0.5, step_px), camera.height_px - 0.5)
    return np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)


def matrix(camera: Camera) -> FloatArray:
    return np.array([[camera.fx_px, 0.0, camera.cx_px], [0.0, camera.fy_px, camera.cy_px], [0.0, 0.0, 1.0]])


def rays_in_front(n: int = 400, widest: float = 1.2) -> FloatArray:
    rng = np.random.default_rng(5)
    xy = rng.uniform(-widest, widest, (n, 2))
    return np.concatenate([xy, np.ones((n, 1))], axis=1) * rng.uniform(0.5, 20.0, (n, 1))


@pytest.mark.parametrize("name", ["strong", "rational", "plain"])
def test_projection_equals_opencv(name: str) -> None:
    camera = CAMERAS[name]
    rays = rays_in_front(widest=0.6)
    coefficients = np.array(camera.coefficients or (0.0,) * 4)
    expected, _ = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), matrix(camera), coefficients)
    np.testing.assert_allclose(camera.project(rays), expected.reshape(-1, 2), rtol=0, atol=1e-9)


def test_fisheye_projection_equals_opencv() -> None:
    rays = rays_in_front(widest=3.0)
    expected, _ = cv2.fisheye.projectPoints(
        rays[:, None, :], np.zeros(3), np.zeros(3), matrix(FISHEYE), np.array(FISHEYE.coefficients)
    )
    np.testing.assert_allclose(FISHEYE.project(rays), expected.reshape(-1, 2), rtol=0, atol=1e-9)


def test_pinhole_by_hand() -> None:
    np.testing.assert_allclose(PLAIN.project([[1.0, -2.0, 4.0]]), [[319.5 + 116.5, 239.5 - 233.0]])
    np.testing.assert_allclose(PLAIN.undistort([[319.5, 239.5 + 466.0]]), [[0.0, 1.0]])
    np.testing.assert_allclose(PLAIN.rays([[319.5 + 466.0, 239.5]]), [[sqrt(0.5), 0.0, sqrt(0.5)]])


def test_equidistant_by_hand() -> None:
    camera = Camera(400, 400, 100.0, 100.0, 199.5, 199.5, Distortion.EQUIDISTANT, (0.0, 0.0, 0.0, 0.0))
    ray = [[sin(1.0), 0.0, cos(1.0)]]
    np.testing.assert_allclose(camera.project(ray), [[299.5, 199.5]], atol=1e-12)
    np.testing.assert_allclose(camera.rays([[299.5, 199.5]]), ray, atol=1e-14)


@each_camera
def test_round_trip_over_the_whole_picture(camera: Camera) -> None:
    grid = picture_grid(camera)
    if camera is FISHEYE:  # its image circle ends inside the picture: 180 degrees off the axis
        rays = camera.rays(grid)
        inside = np.isfinite(rays[:, 0])
        assert inside.mean() > 0.95
        grid = grid[inside]
    else:
        normalised = camera.undistort(grid)
        assert np.isfinite(normalised).all()
        rays = np.concatenate([normalised, np.ones((len(grid), 1))], axis=1)
        np.testing.assert_allclose(camera.project(rays), grid, rtol=0, atol=1e-9)
    np.testing.assert_allclose(camera.project(camera.rays(grid)), grid, rtol=0, atol=1e-9)


def test_opencv_fails_where_ours_does_not() -> None:
    """The reason for an inverse of our own; should OpenCV mend its own, this says so."""
    corner = np.array([[[0.0, 0.0]]])
    theirs = cv2.undistortPoints(corner, matrix(STRONG), np.array(STRONG.coefficients)).reshape(1, 2)
    back = STRONG.project(np.append(theirs, [[1.0]], axis=1))
    assert not np.allclose(back, corner.reshape(1, 2), atol=1.0)
    assert np.allclose(STRONG.project(STRONG.rays([[0.0, 0.0]])), 0.0, atol=1e-9)


@settings(max_examples=200, deadline=None)
@given(
    k1=st.floats(-0.5, 0.5),
    k2=st.floats(-0.3, 0.3),
    p1=st.floats(-0.003, 0.003),
    p2=st.floats(-0.003, 0.003),
    k3=st.floats(-0.1, 0.1),
    radius=st.floats(0.0, 0.93),
    direction=st.floats(-pi, pi),
)
def test_any_radial_tangential_lens_inverts(
    k1: float, k2: float, p1: float, p2: float, k3: float, radius: float, direction: float
) -> None:
    camera = Camera(640, 480, 300.0, 310.0, 321.0, 238.0, Distortion.RADTAN, (k1, k2, p1, p2, k3))
    assert isinstance(camera._lens, RadialTangential) or not any(camera.coefficients)
    fold = camera._lens.max_radius if isinstance(camera._lens, RadialTangential) else inf
    r = radius * min(fold, 2.0)
    ray = np.array([[r * cos(direction), r * sin(direction), 1.0]])
    pixel = camera.project(ray)
    np.testing.assert_allclose(camera.undistort(pixel), ray[:, :2], rtol=0, atol=1e-9)


@settings(max_examples=200, deadline=None)
@given(k=st.tuples(*[st.floats(-0.05, 0.05)] * 4), share=st.floats(0.0, 0.98), direction=st.floats(-pi, pi))
def test_any_fisheye_inverts(k: tuple[float, float, float, float], share: float, direction: float) -> None:
    camera = Camera(640, 480, 200.0, 205.0, 321.0, 238.0, Distortion.EQUIDISTANT, k)
    assert isinstance(camera._lens, Equidistant)
    angle = share * camera._lens.max_angle_rad
    ray = np.array([[sin(angle) * cos(direction), sin(angle) * sin(direction), cos(angle)]])
    np.testing.assert_allclose(camera.rays(camera.project(ray)), ray, rtol=0, atol=1e-8)


def test_nothing_past_the_fold_of_a_barrel_lens() -> None:
    """With k1 = -1/3 the radius r - r^3/3 turns back at r = 1, distorted 2/3."""
    camera = Camera(640, 480, 300.0, 300.0, 320.0, 240.0, Distortion.RADTAN, (-1.0 / 3.0, 0.0, 0.0, 0.0))
    pixels = camera.project([[0.999, 0.0, 1.0], [1.001, 0.0, 1.0], [0.0, 1.5, 1.0], [2.0, 0.0, 1.0]])
    np.testing.assert_allclose(pixels[0, 0], 320.0 + 300.0 * (0.999 - 0.999**3 / 3.0))
    assert np.isnan(pixels[1:]).all()
    beyond = camera.undistort(
        [[320.0 + 300.0 * 0.666, 240.0], [320.0 + 300.0 * 0.667, 240.0], [600.0, 240.0]]
    )
    assert np.isfinite(beyond[0]).all()
    assert 0.95 < beyond[0, 0] < 1.0
    assert np.isnan(beyond[1:]).all()
    assert np.isnan(camera.rays([[600.0, 240.0]])).all()


def test_the_fold_of_a_rational_lens_is_its_pole_or_turn() -> None:
    """1 / (1 - r^2): grows up to the pole at r = 1, and is negative past it."""
    camera = Camera(
        640, 480, 300.0, 300.0, 320.0, 240.0, Distortion.RADTAN, (0.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0)
    )
    pixels = camera.project([[0.5, 0.0, 1.0], [1.2, 0.0, 1.0]])
    np.testing.assert_allclose(pixels[0], [320.0 + 300.0 * 0.5 / 0.75, 240.0])
    assert np.isnan(pixels[1]).all()
    far = camera.undistort([[320.0 + 300.0 * 50.0, 240.0]])
    np.testing.assert_allclose(far[0, 0], (sqrt(1.0 + 4.0 * 50.0**2) - 1.0) / (2.0 * 50.0), rtol=1e-9)


def test_fisheye_sees_behind_itself_but_only_so_far() -> None:
    angle = radians(100.0)
    ray = np.array([[sin(angle), 0.0, cos(angle)]])
    pixel = FISHEYE.project(ray)
    np.testing.assert_allclose(FISHEYE.rays(pixel), ray, atol=1e-12)
    assert np.isnan(FISHEYE.undistort(pixel)).all()
    turning = Camera(
        640, 480, 200.0, 200.0, 320.0, 240.0, Distortion.EQUIDISTANT, (-1.0 / 3.0, 0.0, 0.0, 0.0)
    )
    assert np.isnan(turning.project([[sin(1.01), 0.0, cos(1.01)]])).all()
    assert np.isfinite(turning.project([[sin(0.99), 0.0, cos(0.99)]])).all()
    assert np.isnan(turning.rays([[320.0 + 200.0 * 0.67, 240.0]])).all()
    assert np.isfinite(turning.project([[0.0, 0.0, 1.0]])).all()
    assert np.isnan(turning.project([[0.0, 0.0, -1.0], [0.0, 0.0, 0.0]])).all()


@each_camera
def test_behind_the_camera_is_nowhere(camera: Camera) -> None:
    behind = camera.project([[0.0, 0.0, -1.0], [0.0, 0.0, 0.0]])
    assert np.isnan(behind).all()


@each_camera
def test_nan_stays_with_its_own_point(camera: Camera) -> None:
    pixels = np.array([[100.0, 100.0], [nan, 100.0], [300.0, 200.0]])
    rays = camera.rays(pixels)
    assert np.isnan(rays[1]).all()
    np.testing.assert_allclose(camera.project(rays)[[0, 2]], pixels[[0, 2]], atol=1e-9)
    np.testing.assert_array_equal(rays[[0, 2]], camera.rays(pixels[[0, 2]]))


@each_camera
@pytest.mark.parametrize("n", [0, 1, 2])
def test_shapes_of_few_points(camera: Camera, n: int) -> None:
    points = np.full((n, 2), 250.0)
    assert camera.undistort(points).shape == (n, 2)
    assert camera.rays(points).shape == (n, 3)
    assert camera.project(np.ones((n, 3))).shape == (n, 2)


@each_camera
@pytest.mark.parametrize("size", [(320, 240), (161, 119), (1280, 960)])
def test_resized_projects_to_the_scaled_pixel(camera: Camera, size: tuple[int, int]) -> None:
    small = camera.resized(*size)
    rays = rays_in_front(widest=0.5)
    scale = np.array(size) / [camera.width_px, camera.height_px]
    np.testing.assert_allclose(small.project(rays), (camera.project(rays) + 0.5) * scale - 0.5, atol=1e-9)
    assert (small.width_px, small.height_px) == size
    np.testing.assert_array_equal(small.R_body_camera, camera.R_body_camera)


def test_resized_agrees_with_resized_pictures() -> None:
    """A blob drawn by the big camera, the picture halved: its centroid is where the small one projects."""
    ray = np.array([[0.13, -0.21, 1.0]])
    (u, v) = PLAIN.project(ray)[0]
    y, x = np.mgrid[0:480, 0:640]
    picture = np.exp(-((x - u) ** 2 + (y - v) ** 2) / (2.0 * 6.0**2))
    half = cv2.resize(picture, (320, 240), interpolation=cv2.INTER_AREA)
    y, x = np.mgrid[0:240, 0:320]
    centroid = [(half * x).sum() / half.sum(), (half * y).sum() / half.sum()]
    np.testing.assert_allclose(PLAIN.resized(320, 240).project(ray)[0], centroid, atol=1e-6)


def test_from_fov_spans_the_picture_edge_to_edge() -> None:
    camera = Camera.from_fov(640, 480, radians(90.0))
    edges = camera.undistort([[-0.5, 239.5], [639.5, 239.5]])
    np.testing.assert_allclose(edges, [[-1.0, 0.0], [1.0, 0.0]], atol=1e-12)
    assert camera.fx_px == camera.fy_px
    np.testing.assert_array_equal(camera.R_body_camera @ [0.0, 0.0, 1.0], [1.0, 0.0, 0.0])
    np.testing.assert_array_equal(camera.R_body_camera @ [0.0, 1.0, 0.0], [0.0, 0.0, 1.0])
    with pytest.raises(InputError, match=r"field of view is 3\.2 rad"):
        Camera.from_fov(640, 480, 3.2)


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"width_px": 0}, "resolution 0x480"),
        ({"fx_px": -466.0}, "focal length fx_px is -466"),
        ({"fy_px": nan}, "focal length fy_px is nan"),
        ({"cx_px": inf}, "principal point cx_px is inf"),
        ({"coefficients": (0.1,)}, "distortion model none has 1 coefficients"),
        ({"distortion": Distortion.RADTAN, "coefficients": (0.1,) * 6}, "has 6 coefficients .*4 or 5 or 8"),
        ({"distortion": Distortion.EQUIDISTANT, "coefficients": (0.1,) * 5}, "has 5 coefficients"),
        ({"distortion": Distortion.RADTAN, "coefficients": (0.1, nan, 0.0, 0.0)}, "not finite"),
        ({"R_body_camera": np.diag([1.0, 1.0, -1.0])}, "not a rotation.*determinant -1"),
        ({"R_body_camera": 2.0 * np.eye(3)}, "not a rotation: off orthonormal by 3"),
        ({"R_body_camera": np.eye(4)}, "not a 3x3 matrix"),
    ],
)
def test_what_is_no_camera_is_refused(change: dict[str, object], match: str) -> None:
    good = {"width_px": 640, "height_px": 480, "fx_px": 466.0, "fy_px": 466.0, "cx_px": 319.5, "cy_px": 239.5}
    with pytest.raises(InputError, match=match):
        Camera(**{**good, **change})  # type: ignore[arg-type]


def test_a_rotation_printed_to_four_digits_becomes_exact() -> None:
    angle = radians(12.0)
    exact = np.array([[cos(angle), -sin(angle), 0.0], [sin(angle), cos(angle), 0.0], [0.0, 0.0, 1.0]])
    camera = Camera(640, 480, 466.0, 466.0, 319.5, 239.5, R_body_camera=np.round(exact, 4))
    np.testing.assert_allclose(camera.R_body_camera @ camera.R_body_camera.T, np.eye(3), atol=1e-15)
    np.testing.assert_allclose(camera.R_body_camera, exact, atol=1e-4)


def test_a_camera_cannot_be_changed_and_survives_a_process_border() -> None:
    with pytest.raises(AttributeError):
        STRONG.fx_px = 1.0  # type: ignore[misc]
    with pytest.raises(ValueError, match="read-only"):
        STRONG.R_body_camera[0, 0] = 5.0
    copy = pickle.loads(pickle.dumps(STRONG))
    np.testing.assert_array_equal(copy.rays([[10.0, 20.0]]), STRONG.rays([[10.0, 20.0]]))


def test_wrong_picture_size_is_named() -> None:
    PLAIN.require_size(640, 480)
    with pytest.raises(InputError, match=r"a\.jpg: picture is 320x240, the camera's 640x480 \("):
        PLAIN.require_size(320, 240, file="a.jpg")


@pytest.mark.parametrize(("yaw_deg", "warns"), [(0.0, False), (59.0, False), (61.0, True), (180.0, True)])
def test_a_camera_that_does_not_look_ahead_is_reported(yaw_deg: float, warns: bool) -> None:
    c, s = cos(radians(yaw_deg)), sin(radians(yaw_deg))
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    camera = Camera(640, 480, 466.0, 466.0, 319.5, 239.5, R_body_camera=turn @ PLAIN.R_body_camera)
    problem = camera.mount_problem()
    assert (problem is not None) == warns
    if problem is not None:
        assert f"{yaw_deg:.0f} degrees away from the body's x axis" in problem
