"""The offset by the network: as good as its figures say, symmetric, silent where there is nothing to tell."""

from __future__ import annotations

import json
from dataclasses import fields, replace
from functools import cache
from importlib.resources import files
from math import pi, radians

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import ndtr

import vision.frame
from training.offset_views import Box, TrainingView, render_views
from training.scores import OffsetScores
from training.variations import corner_angles
from vision import Attitude, Camera, Prior, extract_lines, measure_lines
from vision.axis.level import level_from_verticals
from vision.axis.vanishing_point import corridor_frame
from vision.cameras.camera import Distortion
from vision.frame import level_std_rad
from vision.lateral.learned import (
    N_QUARTER,
    WEIGHTS_FILE,
    CornerScores,
    aspect_at,
    corner_scores,
    learned_mixture,
    likeliest_corners,
    mixture_of,
)
from vision.lateral.mixture import OffsetMixture
from vision.lateral.polar import ANGLES, DIRECTIONS, N_ANGLES, N_RADII, polar_picture

CAMERA = Camera.from_fov(320, 240, radians(80))
R_LEVEL_CAMERA = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])  # looks ahead
FIGURES = json.loads((files("vision.lateral") / WEIGHTS_FILE.replace(".onnx", ".json")).read_text())


@cache
def rendered() -> list[TrainingView]:
    return list(render_views(FIGURES["test_views"]["views"], FIGURES["test_views"]["seed"]))


def seen(view: TrainingView) -> OffsetMixture:
    assert view.R_measured is not None
    return learned_mixture(view.image, view.camera, view.R_measured)


def mass(mixture: OffsetMixture, low: float, high: float) -> float:
    """Return the probability of an offset between two, the share of "cannot tell" aside."""
    z = (np.array([[high], [low]]) - mixture.offset_norm) / mixture.std_norm
    above, below = ndtr(z)
    return float(mixture.weight @ (above - below))


def test_the_weights_give_the_stated_figures() -> None:
    stated, views = FIGURES["test_views"], [v for v in rendered() if v.R_measured is not None]
    found = OffsetScores.of([seen(v) for v in views], [v.box.offset_norm for v in views])
    # By rounding, which differs between processors, a picture more or less is accepted.
    assert found.n == pytest.approx(stated["n"], abs=2)
    assert found.within >= stated["within"] - 0.03
    assert found.sure >= stated["sure"] - 0.05
    assert found.sure_wrong <= stated["sure_wrong"] + 0.02
    assert found.nll == pytest.approx(stated["nll"], abs=0.1)


def test_a_mirrored_polar_picture_gives_the_mirrored_answer() -> None:
    mirrored = (N_ANGLES // 2 - 1 - np.arange(N_ANGLES)) % N_ANGLES
    for view in rendered():
        polar = polar_picture(view.image, view.camera, view.R_true)
        here = mixture_of(corner_scores(polar))
        there = mixture_of(corner_scores(np.ascontiguousarray(polar[:, :, mirrored])))
        assert there.weight == pytest.approx(here.weight, abs=1e-4)
        assert there.offset_norm == pytest.approx(-here.offset_norm, abs=1e-4)
        assert there.std_norm == pytest.approx(here.std_norm, abs=1e-4)


def test_a_mirrored_picture_gives_the_mirrored_answer() -> None:
    camera = replace(CAMERA, R_body_camera=R_LEVEL_CAMERA)
    views = [v for v in rendered() if v.camera.distortion is Distortion.NONE]
    for view in views[:6]:
        picture = np.asarray(cv2.resize(view.image, (camera.width_px, camera.height_px)), np.uint8)
        R = corridor_frame(R_LEVEL_CAMERA, 0.1, 0.02)
        R_mirrored = corridor_frame(R_LEVEL_CAMERA, -0.1, 0.02)
        here = learned_mixture(picture, camera, R)
        there = learned_mixture(np.ascontiguousarray(picture[:, ::-1]), camera, R_mirrored)
        for low in np.arange(-1.0, 1.0, 0.25):
            # narrow peaks move by some thousandths with the resampling: compare probabilities, not densities
            assert mass(here, low, low + 0.25) == pytest.approx(mass(there, -low - 0.25, -low), abs=0.05)


@pytest.mark.parametrize("kind", ["blank", "dark", "noise", "ramp"])
def test_where_there_is_nothing_to_see_it_cannot_tell(kind: str) -> None:
    shape = (CAMERA.height_px, CAMERA.width_px)
    picture = {
        "blank": np.full(shape, 160, np.uint8),
        "dark": np.zeros(shape, np.uint8),
        "noise": np.random.default_rng(1).integers(0, 256, shape).astype(np.uint8),
        "ramp": np.tile(np.linspace(40, 200, shape[1]).astype(np.uint8), (shape[0], 1)),
    }[kind]
    mixture = learned_mixture(picture, CAMERA, corridor_frame(R_LEVEL_CAMERA, 0.0, 0.0))
    assert (
        mixture.likelihood(np.linspace(-0.95, 0.95, 39)).max() < 2.0
    )  # no place four times as likely as chance


def test_an_axis_that_is_none_is_not_answered_for() -> None:
    sure = []
    for view in rendered():
        R = corridor_frame(view.R_true, radians(25.0), radians(5.0))
        sure.append(OffsetScores.of([learned_mixture(view.image, view.camera, R)], [0.0]).sure)
    assert np.mean(sure) < 0.1


def test_too_few_lines_leave_what_the_picture_says_about_the_expected_axis(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    view = next(v for v in rendered() if v.R_measured is not None and not v.is_hall)
    lines = extract_lines(view.image, view.camera)
    per_line = {f.name for f in fields(lines)} - {"width_px", "height_px", "threshold", "extract_ms", "grey"}
    few = replace(lines, **{name: getattr(lines, name)[:3] for name in per_line})
    monkeypatch.setattr(vision.frame, "extract_coarse_lines", lambda grey, camera: few)
    attitude, expected = Attitude(0.0, 0.0), Prior(heading_rad=0.1, heading_std_rad=radians(0.5))
    found = measure_lines(few, view.camera, attitude, expected)
    tilt_std = level_std_rad(attitude, expected.elevation_std_rad)
    level = level_from_verticals(few, attitude.R_level_body(), view.camera.R_body_camera, *tilt_std)
    about = learned_mixture(view.image, view.camera, corridor_frame(level.R_level_camera, 0.1, 0.0))
    (evidence,) = found.offset_evidence
    assert not found.accepted
    assert evidence.likelihood([-0.5, 0.0, 0.5]) == pytest.approx(about.likelihood([-0.5, 0.0, 0.5]))
    for unknown in (
        Prior(),
        replace(expected, heading_std_rad=radians(2.0)),
        replace(expected, heading_rad=0.8),
    ):
        assert measure_lines(few, view.camera, attitude, unknown).offset_evidence == ()


def test_equal_input_gives_equal_bits() -> None:
    view = rendered()[0]
    first, again = (learned_mixture(view.image, view.camera, view.R_true) for _ in range(2))
    for name in ("weight", "offset_norm", "std_norm", "width_per_height"):
        assert getattr(first, name).tobytes() == getattr(again, name).tobytes()


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=60, deadline=None)
def test_whatever_the_corners_are_the_weights_are_probabilities(seed: int) -> None:
    rng = np.random.default_rng(seed)
    corner = rng.dirichlet(np.full(N_QUARTER, 10.0 ** rng.uniform(-2, 1)), size=4)
    mixture = mixture_of(CornerScores(corner, rng.random(3) ** 3))
    assert (mixture.weight >= 0.0).all()
    assert mixture.weight.sum() <= 1.0 + 1e-9
    assert (np.abs(mixture.offset_norm) < 1.0).all()
    assert (mixture.std_norm > 0.0).all()


@given(offset=st.floats(-0.8, 0.8), width=st.floats(1.2, 3.0), height=st.floats(0.6, 1.8))
@settings(max_examples=60, deadline=None)
def test_corners_at_known_angles_give_the_offset_and_the_width(
    offset: float, width: float, height: float
) -> None:
    half = width / 2.0
    box = Box(half * (1.0 + offset), half * (1.0 - offset), height, 2.6 - height, 20.0)
    angles = corner_angles(box)
    quarters = np.array([pi - angles[1], angles[0], angles[2] - pi, 2.0 * pi - angles[3]])
    place = np.clip(quarters / (pi / 2) * N_QUARTER - 0.5, 0, N_QUARTER - 1.001)
    corner = np.zeros((4, N_QUARTER))
    low = place.astype(int)
    corner[np.arange(4), low], corner[np.arange(4), low + 1] = 1.0 - (place - low), place - low
    found = CornerScores(corner, np.full(3, 0.01))
    mixture = mixture_of(found)
    best = mixture.weight.argmax()
    assert mixture.offset_norm[best] == pytest.approx(offset, abs=0.045)  # columns are 1.9 degrees wide
    assert mixture.width_per_height[best] == pytest.approx(width / height, rel=0.1)
    # Whatever the place of the camera
    assert aspect_at(found, offset)[0] == pytest.approx(2.6 / width, rel=0.06)
    assert np.isnan(aspect_at(found, offset + 0.4)).all()
    assert likeliest_corners(found) == pytest.approx(angles[[1, 0, 2, 3]], abs=radians(1.0))


LENSES = [
    Camera.from_fov(640, 480, radians(90)),
    replace(CAMERA, distortion=Distortion.RADTAN, coefficients=(-0.2, 0.04, 0.001, -0.001)),
    Camera(640, 480, 260.0, 260.0, 320.0, 238.0, Distortion.EQUIDISTANT, (0.01, -0.004, 0.0, 0.0)),
]


@pytest.mark.parametrize("camera", LENSES, ids=["none", "radtan", "equidistant"])
def test_the_polar_picture_undoes_lens_and_attitude(camera: Camera) -> None:
    """A picture whose brightness is the angle about the axis comes out with upright stripes only."""
    R = corridor_frame(R_LEVEL_CAMERA, 0.2, -0.05)
    y, x = np.mgrid[: camera.height_px, : camera.width_px]
    rays = camera.rays(np.column_stack([x.ravel(), y.ravel()])) @ R.T
    angle = np.arctan2(rays[:, 2], rays[:, 1])
    brightness = np.nan_to_num(128.0 + 100.0 * np.cos(2.0 * angle)).reshape(x.shape)
    polar = polar_picture(np.round(brightness).astype(np.uint8), camera, R)
    outer = slice(N_RADII // 3, None)
    seen_there = polar[1, outer] > 0
    expected = np.broadcast_to(np.cos(2.0 * ANGLES), (N_RADII, N_ANGLES))[outer][seen_there]
    assert seen_there.sum() > 800
    assert np.corrcoef(polar[0, outer][seen_there], expected)[0, 1] > 0.99


@pytest.mark.parametrize("fov_deg", [15.0, 20.0, 30.0, 45.0, 55.0])
def test_a_narrow_lens_fills_as_much_of_the_polar_picture_as_any_trained_on(fov_deg: float) -> None:
    camera = Camera.from_fov(320, 240, np.radians(fov_deg))
    R = corridor_frame(R_LEVEL_CAMERA, 0.0, 0.0)
    seen = polar_picture(np.full((240, 320), 128, np.uint8), camera, R)[1].mean()
    assert 0.25 < seen < 0.5


def test_the_corridor_frame_is_a_rotation_along_the_axis() -> None:
    R = corridor_frame(np.eye(3), 0.3, 0.1)
    assert pytest.approx(np.eye(3), abs=1e-12) == R @ R.T
    assert np.linalg.det(R) == pytest.approx(1.0)
    assert R[0] == pytest.approx([np.cos(0.1) * np.cos(0.3), -np.cos(0.1) * np.sin(0.3), -np.sin(0.1)])
    assert DIRECTIONS.shape == (N_RADII, N_ANGLES, 3)
