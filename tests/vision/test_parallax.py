"""Lateral offset and displacement from the motion parallax of both walls."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fusion.simulate import office_views
from vision import Attitude, Camera, Prior, measure_frame
from vision.lateral.parallax import (
    COTANGENT_STEP,
    FIRST_COTANGENT,
    MAX_RELATIVE,
    MIN_OFFSET_STD,
    N_ALONG,
    N_BANDS,
    PROFILES_SHAPE,
    Profiles,
    are_profiles,
    compare,
    motion_likelihood,
    wall_profiles,
)

COTANGENTS = FIRST_COTANGENT + COTANGENT_STEP * np.arange(N_ALONG)
CAMERA = Camera.from_fov(320, 240, 1.2)
AHEAD = np.eye(3)[[2, 0, 1]]  # optical axes (right, down, ahead) to the corridor's (ahead, right, down)


class Walls:
    """Brightness along two walls: a sum of waves of random lengths, another in each band."""

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        self.waves = rng.uniform(1.0, 12.0, (2, N_BANDS, 12))
        self.phases = rng.uniform(0.0, 2.0 * np.pi, (2, N_BANDS, 12))

    def profiles(self, offset_norm: float, ahead_norm: float) -> Profiles:
        """Return what is seen from a place; half widths."""
        out = np.empty(PROFILES_SHAPE, np.float32)
        for wall, distance in enumerate((1.0 - offset_norm, 1.0 + offset_norm)):
            z = ahead_norm + COTANGENTS * distance
            waves = np.sin(z[:, None, None] * self.waves[wall] + self.phases[wall])
            out[wall] = 0.1 * waves.mean(axis=-1)
        return out


def turned(profiles: Profiles) -> Profiles:
    """Exchange right and left."""
    return profiles[::-1].copy()


@settings(max_examples=30, deadline=None)
@given(
    seed=st.integers(0, 1000),
    offset=st.floats(-0.5, 0.5),
    ahead=st.floats(0.15, 0.4),
    aside=st.floats(-0.1, 0.1),
)
def test_motion_is_found(seed: int, offset: float, ahead: float, aside: float) -> None:
    walls = Walls(seed)
    found = compare(walls.profiles(offset - aside, 0.0), walls.profiles(offset, ahead))
    moved = found.displacement_norm + found.displacement_per_offset * offset
    assert abs(moved - aside) < max(3.0 * found.displacement_std_norm, 0.01)
    assert found.displacement_std_norm < 0.04
    assert float(found.offset.likelihood(offset)) > 0.5  # better than chance
    assert found.offset.std_norm.min() >= MIN_OFFSET_STD  # no finer than the offsets that are compared


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 1000), offset=st.floats(-0.5, 0.5), aside=st.floats(-0.1, 0.1))
def test_a_mirrored_corridor_gives_the_mirrored_answer(seed: int, offset: float, aside: float) -> None:
    walls = Walls(seed)
    before, now = walls.profiles(offset - aside, 0.0), walls.profiles(offset, 0.3)
    found, mirrored = motion_likelihood(before, now), motion_likelihood(turned(before), turned(now))
    np.testing.assert_allclose(found, mirrored[::-1, ::-1], rtol=1e-6, atol=1e-9)


def test_the_further_ahead_the_better_the_offset_shows() -> None:
    walls, offset = Walls(3), 0.3

    def likelihood(ahead: float) -> float:
        found = compare(walls.profiles(offset, 0.0), walls.profiles(offset, ahead))
        return float(found.offset.likelihood(offset))

    assert likelihood(0.0) < likelihood(0.2) < likelihood(0.4)


def blank(rng: np.random.Generator) -> Profiles:
    """Return walls without any texture."""
    return np.zeros(PROFILES_SHAPE, np.float32)


def noisy(rng: np.random.Generator) -> Profiles:
    """Return noise, as in the dark."""
    return rng.normal(0.0, 0.1, PROFILES_SHAPE).astype(np.float32)


def unseen(rng: np.random.Generator) -> Profiles:
    """Return walls that are outside the picture."""
    return np.full(PROFILES_SHAPE, np.nan, np.float32)


@pytest.mark.parametrize("seen", [blank, noisy, unseen])
def test_walls_that_show_nothing_tell_nothing(seen: Callable[[np.random.Generator], Profiles]) -> None:
    rng = np.random.default_rng(2)
    for _ in range(10):
        found = compare(seen(rng), seen(rng))
        assert np.isnan(found.displacement_norm)
        assert found.offset.likelihood(np.linspace(-0.8, 0.8, 9)) == pytest.approx(0.5, abs=0.35)


def test_brightness_of_the_whole_picture_does_not_count() -> None:
    rng = np.random.default_rng(1)
    grey = np.clip(rng.normal(90.0, 25.0, (240, 320)), 1, 150).astype(np.uint8)
    brighter = np.rint(grey * 1.5).astype(np.uint8)
    one, other = (wall_profiles(picture, CAMERA, AHEAD) for picture in (grey, brighter))
    np.testing.assert_allclose(one, other, atol=0.01)


def test_profiles_are_nan_outside_the_picture() -> None:
    narrow = Camera.from_fov(320, 240, 0.8)  # sees cotangents from 1 / tan(0.4) on
    found = wall_profiles(np.full((240, 320), 90, np.uint8), narrow, AHEAD)
    assert found.shape == PROFILES_SHAPE
    assert found.dtype == np.float32
    seen: npt.NDArray[np.bool_] = np.array(np.isfinite(found).all(axis=(0, 2)))
    first = int(np.argmax(seen))
    assert not seen[:first].any()
    assert pytest.approx(1.0 / np.tan(0.4), abs=0.1) == COTANGENTS[first]
    assert np.abs(found[:, first:]).max() < 1e-6


def test_accepted_frames_have_profiles_and_others_have_none() -> None:
    (view,) = office_views(CAMERA, 1, seed=3)
    attitude = Attitude(view.roll_rad, view.pitch_rad)
    found = measure_frame(view.image, CAMERA, attitude)
    assert found.accepted
    assert found.wall_profiles is not None
    assert are_profiles(found.wall_profiles)
    assert found.without_lines().wall_profiles is None
    nothing = measure_frame(np.full((240, 320), 90, np.uint8), CAMERA, attitude)
    assert nothing.wall_profiles is None
    assert measure_frame(view.image, CAMERA, attitude, lateral=False).wall_profiles is None


def test_profiles_are_about_the_heading_that_is_expected() -> None:
    """The prior turns with the gyro; the frame's own heading is noise of each frame."""
    (view,) = office_views(CAMERA, 1, seed=3)
    attitude = Attitude(view.roll_rad, view.pitch_rad)
    own = measure_frame(view.image, CAMERA, attitude)

    def profiles(error_rad: float, std_rad: float) -> Profiles:
        prior = Prior(heading_rad=own.heading_rad + error_rad, heading_std_rad=std_rad)
        found = measure_frame(view.image, CAMERA, attitude, prior).wall_profiles
        assert found is not None
        return found

    assert own.wall_profiles is not None
    assert not np.array_equal(profiles(0.004, 0.003), own.wall_profiles, equal_nan=True)
    assert np.array_equal(profiles(0.004, 0.1), own.wall_profiles, equal_nan=True)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("shape", np.zeros((2, N_ALONG, N_BANDS + 1), np.float32)),
        ("type", np.zeros(PROFILES_SHAPE)),
        ("infinite", np.full(PROFILES_SHAPE, np.inf, np.float32)),
        ("too large", np.full(PROFILES_SHAPE, 2.0 * MAX_RELATIVE, np.float32)),
        ("a list", [[0.0]]),
    ],
)
def test_what_are_no_profiles(name: str, value: object) -> None:
    assert not are_profiles(value)
    assert are_profiles(np.full(PROFILES_SHAPE, np.nan, np.float32))
