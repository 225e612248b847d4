"""The camera's mounting from made-up views, made by turning vectors rather than by the fit's formulas."""

from __future__ import annotations

from math import pi, radians

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fusion.alignment.mount import fit_mount, mount_angles, mount_rotation
from fusion.alignment.views import Sightings

LEVEL_STD_RAD = radians(0.5)


def wandering(rng: np.random.Generator, n: int, step_s: float, std: float, time_s: float = 4.0) -> np.ndarray:
    """A first-order process, as the error of an attitude filter."""
    keep = np.exp(-step_s / time_s)
    x = np.empty(n)
    x[0] = rng.normal(0, std)
    for k in range(1, n):
        x[k] = keep * x[k - 1] + rng.normal(0, std * np.sqrt(1 - keep**2))
    return x


def views(
    mount_deg: tuple[float, float, float],
    seed: int = 0,
    tilt_deg: float = 3.0,
    attitude_deg: float = 0.3,
    picture_deg: float = 0.1,
) -> Sightings:
    """Frames of a corridor by a camera turned on the body by roll, pitch, yaw, taken to look straight ahead."""
    rng = np.random.default_rng(seed)
    n, step = 400, 0.05
    t = np.arange(float(n)) * step
    phases = rng.uniform(0, 2 * pi, 3)
    roll = radians(tilt_deg) * np.sin(2.1 * t + phases[0])
    pitch = radians(tilt_deg) * np.sin(1.7 * t + phases[1])
    heading = radians(15) * np.sin(0.9 * t + phases[2])
    R_world_body = Rotation.from_euler("ZYX", np.stack([heading, pitch, roll], axis=1))
    R_body_mounted = Rotation.from_euler("ZYX", np.radians(mount_deg)[::-1])
    axis = (R_world_body * R_body_mounted).inv().apply([1.0, 0.0, 0.0])  # as the camera sees it
    down = (R_world_body * R_body_mounted).inv().apply([0.0, 0.0, 1.0])
    # the attitude as the vehicle has it, without yaw, by which the camera's view is turned level
    noisy = np.stack(
        [
            np.zeros(n),
            pitch + radians(attitude_deg) * wandering(rng, n, step, 1.0),
            roll + radians(attitude_deg) * wandering(rng, n, step, 1.0),
        ],
        axis=1,
    )
    level = Rotation.from_euler("ZYX", noisy)
    seen_axis, seen_down = level.apply(axis), level.apply(down)
    # The picture's own verticals are level before the axis's elevation is taken.
    lean = np.arctan2(seen_down[:, 1], seen_down[:, 2])
    pitched = np.arctan2(seen_down[:, 0], seen_down[:, 2])
    own_level = Rotation.from_euler("XYZ", np.stack([lean, -pitched, np.zeros(n)], axis=1))
    in_level = own_level.apply(seen_axis)
    noise = radians(picture_deg)
    return Sightings(
        t,
        -np.arctan2(in_level[:, 1], in_level[:, 0]) + rng.normal(0, noise, n),
        np.full(n, noise),
        np.arcsin(-in_level[:, 2]) + pitched + rng.normal(0, noise, n),
        np.full(n, noise),
        lean + rng.normal(0, noise, n),
        np.full(n, noise),
        level.as_matrix(),
        np.full(n, np.nan),
        np.full(n, np.nan),
    )


@pytest.mark.parametrize(
    "mount_deg",
    [(0.0, 0.0, 0.0), (0.0, 0.0, 3.0), (0.0, 0.0, -5.0), (2.0, -1.5, 0.0), (-1.0, 3.0, 2.0)],
    ids=str,
)
def test_each_angle_is_found(mount_deg: tuple[float, float, float]) -> None:
    fit = fit_mount(views(mount_deg), LEVEL_STD_RAD)
    assert fit is not None
    z = (np.degrees(fit.angle_rad) - mount_deg) / np.degrees(fit.std_rad)
    assert np.abs(z).max() < 3.0, (np.degrees(fit.angle_rad), z)
    assert np.degrees(fit.std_rad[2]) < 0.6


def test_an_exact_attitude_gives_exact_angles() -> None:
    fit = fit_mount(views((1.0, -1.0, 2.0), attitude_deg=1e-4, picture_deg=1e-3), LEVEL_STD_RAD)
    assert fit is not None
    np.testing.assert_allclose(np.degrees(fit.angle_rad), (1.0, -1.0, 2.0), atol=0.1)


def test_sigma_of_the_yaw_is_the_scatter_of_many() -> None:
    fits = [fit_mount(views((0.0, 0.0, 3.0), seed), LEVEL_STD_RAD) for seed in range(30)]
    z = np.array([(fit.angle_rad[2] - radians(3.0)) / fit.std_rad[2] for fit in fits if fit is not None])
    assert len(z) == 30
    assert abs(z.mean()) < 0.6
    assert 0.6 < z.std() < 1.4


def test_without_tilting_the_yaw_is_not_to_be_had() -> None:
    fit = fit_mount(views((0.0, 0.0, 3.0), tilt_deg=0.0), LEVEL_STD_RAD)
    assert fit is not None
    assert np.degrees(fit.std_rad[2]) > 1.5
    assert abs(fit.angle_rad[2] - radians(3.0)) < 3.0 * fit.std_rad[2]


def test_angles_and_rotations_are_each_others_inverse() -> None:
    angle = np.array([0.1, -0.2, 0.3])
    R = mount_rotation(angle)
    np.testing.assert_allclose(R, Rotation.from_euler("ZYX", angle[::-1]).as_matrix(), atol=1e-12)
    np.testing.assert_allclose(mount_angles(R), angle, atol=1e-12)


def test_too_few_frames_give_nothing() -> None:
    few = views((0.0, 0.0, 0.0))
    none = np.full(len(few.t_s), np.nan)
    assert fit_mount(Sightings.of_headings(few.t_s, none, none), LEVEL_STD_RAD) is None
