"""The field of view from pictures of corridors: known cameras are found, and what cannot tell does not."""

from __future__ import annotations

from collections.abc import Callable
from math import degrees, radians, tan
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from fusion.simulate import office_views
from tests.files import OFFICE, SHARED
from tests.pictures import read_grey
from vision import Camera, InputError, measure_lines
from vision.axis.field_of_view import (
    MAX_PICTURES,
    FieldOfView,
    estimate_field_of_view,
    field_of_view_of_lines,
    lines_of,
    ordinary_field_of_view,
)
from vision.axis.right_angles import (
    N_PARAMETERS,
    RightAngles,
    _nominal_axes,
    _solve,
    fit_right_angles,
    slack_std,
)
from vision.lines.line_set import LineSet
from vision.lines.segments import extract_lines

IMAGES = SHARED / "images"
OFFICE_PICTURES = OFFICE / "mav0" / "cam0" / "data"
OFFICE_FOV_DEG = degrees(2 * np.arctan(320 / 466.0))

Seen = Callable[[Any, Camera], LineSet]


def camera_of(fov_deg: float, width: int = 640, height: int = 480) -> Camera:
    return Camera.from_fov(width, height, radians(fov_deg))


def error_deg(found: FieldOfView, true_deg: float) -> float:
    return abs(degrees(found.horizontal_rad) - true_deg)


class TestCorridorsOfLines:
    @pytest.mark.parametrize("fov_deg", [40.0, 60.0, 85.0])
    @pytest.mark.parametrize("pitch_deg", [-7.0, 6.0])
    def test_one_pitched_view_tells(
        self, corridor: Any, seen: Seen, fov_deg: float, pitch_deg: float
    ) -> None:
        camera = camera_of(fov_deg)
        look = corridor(
            pitch_rad=radians(pitch_deg), heading_rad=radians(3), roll_rad=radians(2), noise_px=0.1
        )
        found = field_of_view_of_lines([seen(look, camera)], camera)
        assert found.measured
        assert error_deg(found, fov_deg) < 3.0
        assert error_deg(found, fov_deg) < 2.0 * degrees(found.std_rad)

    def test_what_the_lines_were_found_with_does_not_matter(self, corridor: Any, seen: Seen) -> None:
        true, assumed = camera_of(50), camera_of(80)
        lines = seen(corridor(pitch_rad=radians(6), noise_px=0.1), true)
        one = field_of_view_of_lines([lines], true)
        other = field_of_view_of_lines([lines_of(lines, true, assumed)], assumed)
        assert one.horizontal_rad == pytest.approx(other.horizontal_rad, abs=1e-3)
        assert one.std_rad == pytest.approx(other.std_rad, rel=0.05)

    def test_a_level_camera_that_looks_straight_along_cannot_tell(self, corridor: Any, seen: Seen) -> None:
        camera = camera_of(50)
        found = field_of_view_of_lines([seen(corridor(noise_px=0.1), camera)], camera)
        assert not found.measured
        assert (found.horizontal_rad, found.std_rad) == (radians(65), radians(20))
        assert (found.n_used, found.n_tried) == (0, 1)

    def test_stray_lines_cannot_tell(self, corridor: Any, seen: Seen) -> None:
        camera = camera_of(60)
        views = [corridor(along=False, posts=False, n_random=60, seed=seed) for seed in range(5)]
        found = field_of_view_of_lines([seen(view, camera) for view in views], camera)
        assert not found.measured
        assert found.n_used == 0

    def test_more_pictures_are_surer(self, corridor: Any, seen: Seen) -> None:
        camera = camera_of(60)
        views = [
            seen(corridor(pitch_rad=radians(pitch), heading_rad=radians(5), noise_px=0.3, seed=seed), camera)
            for seed, pitch in enumerate((-6, -4, -3, 3, 4, 5, 6, 7))
        ]
        few, many = field_of_view_of_lines(views[:1], camera), field_of_view_of_lines(views, camera)
        assert many.n_used == len(views)
        assert many.std_rad < 0.6 * few.std_rad
        assert error_deg(many, 60) < 1.0

    def test_pictures_of_another_camera_among_them_do_not_capture_it(self, corridor: Any, seen: Seen) -> None:
        camera, stranger = camera_of(60), camera_of(100)
        views = [
            seen(corridor(pitch_rad=radians(pitch), noise_px=0.2), camera) for pitch in (-7, -5, -4, 4, 6, 8)
        ]
        views[2:4] = [seen(corridor(pitch_rad=radians(pitch), noise_px=0.2), stranger) for pitch in (-5, 6)]
        assert error_deg(field_of_view_of_lines(views, camera), 60) < 2.0

    def test_an_optical_axis_off_the_centre_makes_it_less_sure_not_wrong(
        self, corridor: Any, seen: Seen
    ) -> None:
        """One percent of the width, the same in all pictures, all pitched to the same side."""
        off = Camera(640, 480, 554.3, 554.3, 319.5 + 6.4, 239.5 - 6.4)
        views = [seen(corridor(pitch_rad=radians(p), noise_px=0.1), off) for p in (5.0, 5.5, 6.0, 6.5)]
        found = field_of_view_of_lines(views, camera_of(60))
        assert found.measured
        assert error_deg(found, 60) < 2.5 * degrees(found.std_rad)
        assert degrees(found.std_rad) > 1.0

    def test_enough_is_enough(self, corridor: Any, seen: Seen) -> None:
        camera = camera_of(60)
        lines = seen(corridor(pitch_rad=radians(6)), camera)
        asked = iter([lines] * (MAX_PICTURES + 5))
        assert field_of_view_of_lines(asked, camera).n_used == MAX_PICTURES
        assert len(list(asked)) == 5


class TestPictures:
    @pytest.mark.parametrize("fov_deg", [45.0, 70.0, 90.0])
    def test_simulated_folders(self, fov_deg: float) -> None:
        views = office_views(
            camera_of(fov_deg, 400, 300), 6, seed=round(fov_deg), views_per_scene=6, light_cell_m=0.5
        )
        found = estimate_field_of_view(view.image for view in views)
        assert found.measured
        assert found.n_used >= 4
        assert error_deg(found, fov_deg) < min(4.0, 2.5 * degrees(found.std_rad))

    def test_the_sample_flight(self) -> None:
        pictures = [read_grey(path) for path in sorted(OFFICE_PICTURES.iterdir())[10:200:20]]
        found = estimate_field_of_view(pictures)
        assert found.measured
        assert error_deg(found, OFFICE_FOV_DEG) < 3.0

    def test_upright_pictures(self) -> None:
        """Cut out of the middle: the same focal length, another shape."""
        views = office_views(camera_of(75, 480, 360), 5, seed=8, views_per_scene=5, light_cell_m=0.5)
        found = estimate_field_of_view(view.image[:, 120:360] for view in views)
        true_deg = degrees(2 * np.arctan(0.5 * tan(radians(75 / 2))))
        assert found.measured
        assert error_deg(found, true_deg) < 4.0

    def test_blank_and_noisy_pictures_do_not_tell(self) -> None:
        rng = np.random.default_rng(0)
        blank = np.full((120, 160), 90, np.uint8)
        noise = rng.integers(0, 255, (120, 160)).astype(np.uint8)
        found = estimate_field_of_view([blank, noise, blank])
        assert not found.measured
        assert found.n_tried == 3

    def test_no_pictures_or_different_ones_are_refused(self) -> None:
        with pytest.raises(InputError, match="no pictures"):
            estimate_field_of_view([])
        with pytest.raises(InputError, match="160x120"):
            estimate_field_of_view([np.zeros((100, 160), np.uint8), np.zeros((120, 160), np.uint8)])

    def test_walked_through_a_university(self) -> None:
        """No calibration exists; two halves of the pictures agree, and with it far more of them can be measured."""
        folder = IMAGES / "handheld_corridor"
        if not folder.is_dir():
            pytest.skip("the shared pictures are not here")
        pictures = [read_grey(folder / f"{i}.jpg") for i in range(2, 84, 4)]
        first, second = estimate_field_of_view(pictures[::2]), estimate_field_of_view(pictures[1::2])
        assert first.measured
        assert second.measured
        between = abs(first.horizontal_rad - second.horizontal_rad)
        assert between < 2.0 * np.hypot(first.std_rad, second.std_rad)
        accepted = {
            fov: sum(measure_lines(extract_lines(p, camera), camera).accepted for p in pictures)
            for fov, camera in (
                (fov, Camera.from_fov(512, 384, fov)) for fov in (first.horizontal_rad, radians(70))
            )
        }
        assert accepted[first.horizontal_rad] > 1.3 * accepted[radians(70)]

    def test_pictures_cropped_off_their_centre_are_not_trusted(self) -> None:
        """A nano drone's 200x200 window, noisy, wide, off the centre: rather nothing than 120 degrees."""
        folder = IMAGES / "crazyflie_grey"
        if not folder.is_dir():
            pytest.skip("the shared pictures are not here")
        pictures = [read_grey(path) for path in sorted(folder.glob("*.pgm"))]
        assert not estimate_field_of_view(pictures).measured


class TestOrdinary:
    def test_the_longer_side_counts(self) -> None:
        wide, upright = ordinary_field_of_view(640, 480), ordinary_field_of_view(480, 640)
        assert wide.horizontal_rad == pytest.approx(radians(65))
        assert tan(upright.horizontal_rad / 2) == pytest.approx(0.75 * tan(wide.horizontal_rad / 2))
        assert upright.std_rad < wide.std_rad
        assert not wide.measured


class TestLinesOf:
    def test_as_if_found_with_the_other_camera(self) -> None:
        image = next(iter(office_views(camera_of(70, 320, 240), 1, seed=4))).image
        one, other = camera_of(50, 320, 240), camera_of(90, 320, 240)
        there, direct = lines_of(extract_lines(image, one), one, other), extract_lines(image, other)
        assert len(there) == len(direct) > 10
        for name in ("ends_px", "centre", "direction", "normal", "sigma_rad", "arc_rad"):
            np.testing.assert_allclose(getattr(there, name), getattr(direct, name), rtol=1e-6, atol=1e-9)


ANGLE = st.floats(-1.0, 1.0)


class TestRightAngles:
    @settings(max_examples=30, deadline=None)
    @given(
        st.tuples(ANGLE, ANGLE, ANGLE),
        st.lists(st.floats(-0.05, 0.05), min_size=5, max_size=5),
        st.floats(0.4, 2.5),
    )
    def test_the_axes_slopes_are_their_derivatives(
        self, turn: tuple[float, float, float], slack: list[float], stretch: float
    ) -> None:
        rotation, loose = Rotation.from_rotvec(turn).as_matrix(), np.array(slack)
        axes, step = _nominal_axes(rotation, loose, stretch), 1e-6
        for p in range(N_PARAMETERS):
            change = step * np.eye(N_PARAMETERS)[p]
            turned = Rotation.from_rotvec(change[:3]).as_matrix() @ rotation
            moved = _nominal_axes(turned, loose + change[3:], stretch)
            np.testing.assert_allclose((moved.ray - axes.ray) / step, axes.slopes[:, p], atol=1e-4)

    def test_cholesky(self) -> None:
        rng = np.random.default_rng(1)
        root = rng.normal(size=(8, 8))
        matrix, right, x = root @ root.T + np.eye(8), rng.normal(size=8), np.empty(8)
        _solve(matrix.copy(), right, x)
        np.testing.assert_allclose(x, np.linalg.solve(matrix, right))

    @pytest.mark.parametrize("stretch", [0.7, 1.0, 1.6])
    def test_axes_that_start_a_little_off_find_their_lines(
        self, corridor: Any, seen: Seen, stretch: float
    ) -> None:
        nominal, true = camera_of(65), Camera(640, 480, *(stretch * camera_of(65).fx_px,) * 2, 319.5, 239.5)
        look = corridor(pitch_rad=radians(5), heading_rad=radians(-8), roll_rad=radians(3))
        lines = lines_of(seen(look, true), true, nominal)
        exact = (look.rotation() @ true.R_body_camera).T  # columns: the corridor's axes in the optical frame
        near = Rotation.from_rotvec([0.01, -0.012, 0.008]).as_matrix() @ exact
        geometry, direction_std = lines.geometry(), np.sqrt(12.0) * lines.sigma_rad / lines.arc_rad
        start, loose = RightAngles(0.0, near, np.zeros(5)), slack_std(0.01)
        found = fit_right_angles(geometry, direction_std, stretch, loose, start, radians(2))
        assert found.score > 10.0
        np.testing.assert_allclose(found.rotation, exact, atol=2e-3)
        np.testing.assert_array_equal(start.rotation, near)  # the start is left as it was
        wrong = fit_right_angles(geometry, direction_std, 1.4 * stretch, loose, found, radians(2))
        assert wrong.score < found.score - 5.0
