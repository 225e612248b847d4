from __future__ import annotations

from math import cos, pi, radians, sin

import cv2
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from vision.paper.lines import (
    FittedLines,
    adjust_intensity,
    canny_high_threshold,
    connect_edges,
    detect_edges,
    equalise_histogram,
    find_lines,
    fit_lines,
    grey,
    orientation_bin,
    respond_45_degrees,
)


def pixels(*levels_and_counts: tuple[int, int]) -> np.ndarray:
    """Picture of one row that holds each level so many times."""
    return np.repeat(*np.array(levels_and_counts).T).astype(np.uint8)[None]


def half_plane(angle_deg: float, shape: tuple[int, int] = (120, 160)) -> np.ndarray:
    """Dark on one side of a line through the middle at this angle from the x axis, bright on the other."""
    y, x = np.indices(shape)
    across = (y - shape[0] / 2) * cos(radians(angle_deg)) - (x - shape[1] / 2 + 0.25) * sin(
        radians(angle_deg)
    )
    return np.where(across > 0, 200, 40).astype(np.uint8)


def fit_one(points: np.ndarray) -> FittedLines:
    return fit_lines(points[:, 0], points[:, 1], np.zeros(len(points), dtype=np.intp), 1)


def same_direction(a_rad: float, b_rad: float, tolerance_rad: float = 1e-9) -> bool:
    return abs(sin(a_rad - b_rad)) <= tolerance_rad


class TestPreprocessing:
    def test_grey_takes_the_luminance(self) -> None:
        blue, green, red = (np.eye(3, dtype=np.uint8)[i][None, None] * 255 for i in range(3))
        assert [int(grey(c)[0, 0]) for c in (blue, green, red)] == [29, 150, 76]  # 0.114, 0.587, 0.299 of 255

    def test_intensity_saturates_one_percent_at_each_end(self) -> None:
        image = pixels((0, 1), (100, 30), (125, 29), (150, 39), (255, 1))
        expected = pixels((0, 31), (128, 29), (255, 40))
        np.testing.assert_array_equal(adjust_intensity(image), expected)

    def test_intensity_of_one_level_stays(self) -> None:
        image = np.full((4, 5), 77, dtype=np.uint8)
        np.testing.assert_array_equal(adjust_intensity(image), image)

    def test_equalisation_of_four_levels(self) -> None:
        image = np.array([[10, 20], [30, 40]], dtype=np.uint8)
        np.testing.assert_array_equal(equalise_histogram(image, bins=4), [[0, 85], [170, 255]])

    def test_equalisation_counts_the_extreme_levels_in_full(self) -> None:
        image = np.array([[0, 0], [255, 255]], dtype=np.uint8)
        np.testing.assert_array_equal(equalise_histogram(image, bins=4), [[85, 85], [255, 255]])

    def test_equalisation_of_a_flat_histogram_keeps_64_levels(self) -> None:
        image = np.arange(256, dtype=np.uint8).reshape(16, 16)
        expected = np.floor(np.arange(256) // 4 * 255 / 63 + 0.5)
        np.testing.assert_array_equal(equalise_histogram(image).ravel(), expected)

    def test_the_kernel_answers_to_rising_lines_only(self) -> None:
        rising = np.fliplr(np.eye(7, dtype=np.uint8)) * 10
        assert respond_45_degrees(rising)[3, 3] == 60
        assert respond_45_degrees(np.fliplr(rising))[3, 3] == 0  # 2 * 10 - 2 * 10: falling
        for flat in (np.eye(1, 9, 4), np.ones((1, 9)), np.arange(9.0)[None]):
            bars = np.repeat(flat, 9, axis=0).astype(np.uint8) * 20
            assert not respond_45_degrees(bars).any()
            assert not respond_45_degrees(bars.T.copy()).any()

    def test_the_kernel_keeps_bytes_and_cuts_negatives(self) -> None:
        dot = np.zeros((5, 5), dtype=np.uint8)
        dot[2, 2] = 200
        response = respond_45_degrees(dot)
        assert response.dtype == np.uint8
        np.testing.assert_array_equal(response[1:4, 1:4], [[0, 0, 255], [0, 255, 0], [255, 0, 0]])


class TestCanny:
    def test_threshold_is_the_seventieth_percentile_to_a_64th(self) -> None:
        assert canny_high_threshold(np.repeat([0.0, 1.0], [75, 25])) == 1 / 64
        assert canny_high_threshold(np.repeat([0.0, 32 / 63, 1.0], [60, 20, 20])) == 33 / 64
        assert canny_high_threshold(np.repeat([0.0, 1.0], [70, 30])) == 1.0  # 70 % is not above 70 %

    def test_a_step_is_one_edge_where_it_is(self) -> None:
        image = np.full((60, 80), 50, dtype=np.uint8)
        image[:, 40:] = 180
        edges = detect_edges(image)
        assert (edges.sum(axis=1) == 1).all()
        assert set(np.nonzero(edges)[1]) <= {39, 40}

    def test_nothing_gives_no_edge(self) -> None:
        assert not detect_edges(np.full((60, 80), 9, dtype=np.uint8)).any()


class TestConnectedComponents:
    @pytest.mark.parametrize("angle_deg", [0, 22.5, 45, 67.5, 90, 112.5, 135, 157.5])
    def test_orientation_bins_are_centred_on_eighths_of_pi(self, angle_deg: float) -> None:
        image = half_plane(angle_deg)
        bins = orientation_bin(image, np.array([80]), np.array([60]))
        gradient = (angle_deg + 90) % 180
        assert bins[0] == round(gradient / 22.5) % 8

    @pytest.mark.parametrize("angle_deg", [10, 35, 45, 60, 100, 140, 170])
    def test_a_straight_edge_is_one_line(self, angle_deg: float) -> None:
        image = half_plane(angle_deg)
        lines = connect_edges(image, detect_edges(image))
        length = np.hypot(lines[:, 2] - lines[:, 0], lines[:, 3] - lines[:, 1])
        assert length.max() > 115
        assert length.sum() - length.max() < 10  # the picture's border may bend off a few pixels
        x0, y0, x1, y1 = lines[length.argmax()] - (80, 60, 80, 60)
        assert same_direction(np.arctan2(y1 - y0, x1 - x0), radians(angle_deg), 0.01)
        across = (y0 + y1) / 2 * cos(radians(angle_deg)) - (x0 + x1) / 2 * sin(radians(angle_deg))
        assert abs(across) < 1

    def test_a_corner_is_two_lines(self) -> None:
        image = np.full((120, 160), 40, dtype=np.uint8)
        image[60:, 80:] = 200
        lines = connect_edges(image, detect_edges(image))
        angles = np.abs(np.arctan2(lines[:, 3] - lines[:, 1], lines[:, 2] - lines[:, 0]))
        assert sorted(angles) == pytest.approx([0, pi / 2], abs=0.05)

    def test_short_and_bent_components_are_no_lines(self) -> None:
        image = half_plane(90, (480, 640))  # the gradient is the same everywhere that matters here
        edges = np.zeros(image.shape, dtype=bool)
        edges[100:119, 320] = True  # 19 pixels, below 0.025 x 800 = 20
        assert len(connect_edges(image, edges)) == 0
        edges[100:120, 320] = True
        assert len(connect_edges(image, edges)) == 1
        edges[100:120, 320:323] = True  # a block 3 wide: eigenvalue ratio (400 - 1) / (9 - 1) = 50
        assert len(connect_edges(image, edges)) == 0

    def test_no_edge_is_no_line(self) -> None:
        image = np.zeros((60, 80), dtype=np.uint8)
        assert connect_edges(image, np.zeros(image.shape, dtype=bool)).shape == (0, 4)

    def test_only_oblique_lines_pass_the_kernel(self) -> None:
        image = np.full((240, 320), 40, dtype=np.uint8)
        cv2.rectangle(image, (40, 40), (140, 200), 200, -1)
        assert len(find_lines(image)) == 0
        assert len(find_lines(image, kernel_feeds_canny=False)) == 4


class TestEigenFit:
    def test_equations_1_to_4_on_a_line_along_x(self) -> None:
        line = fit_one(np.column_stack((np.arange(21.0), np.full(21, 5.0))))
        assert line.midpoint_px[0] == pytest.approx([10, 5])
        assert line.theta_rad[0] == pytest.approx(0)
        assert line.rho_px[0] == pytest.approx(10)  # as printed: along the line; its distance would be 5
        assert line.eigenvalue_ratio[0] > 1e12
        assert line.ends_px[0] == pytest.approx([0, 5, 20, 5])

    def test_equations_1_to_4_on_a_vertical_and_an_oblique_line(self) -> None:
        vertical = fit_one(np.column_stack((np.full(11, 7.0), np.arange(11.0))))
        assert vertical.theta_rad[0] == pytest.approx(pi / 2)
        assert vertical.rho_px[0] == pytest.approx(5)
        along = np.arange(-10.0, 11.0)
        theta = radians(-30)
        oblique = fit_one(np.column_stack((100 + along * cos(theta), 50 + along * sin(theta))))
        assert oblique.theta_rad[0] == pytest.approx(theta)
        assert oblique.rho_px[0] == pytest.approx(100 * cos(theta) + 50 * sin(theta))
        assert oblique.ends_px[0] == pytest.approx([91.339746, 55, 108.660254, 45])

    def test_eigenvalue_ratio_of_two_rows_of_pixels(self) -> None:
        x, y = (c.ravel().astype(float) for c in np.meshgrid(np.arange(10), [0, 1]))
        assert fit_one(np.column_stack((x, y))).eigenvalue_ratio[0] == pytest.approx((10**2 - 1) / (2**2 - 1))

    def test_sets_are_fitted_each_on_its_own(self) -> None:
        x = np.array([0.0, 5, 1, 5, 2, 5])
        y = np.array([3.0, 0, 3, 1, 3, 2])
        lines = fit_lines(x, y, np.array([0, 1, 0, 1, 0, 1]), 2)
        assert lines.theta_rad == pytest.approx([0, pi / 2])
        assert lines.ends_px == pytest.approx(np.array([[0, 3, 2, 3], [5, 0, 5, 2]]))

    def test_a_single_point_has_no_ratio(self) -> None:
        assert np.isnan(fit_one(np.array([[3.0, 4.0]])).eigenvalue_ratio[0])

    @given(st.integers(0, 2**32 - 1), st.floats(-pi, pi), st.floats(-500, 500), st.floats(-500, 500))
    def test_the_line_turns_with_its_points(self, seed: int, turn: float, dx: float, dy: float) -> None:
        points = np.random.default_rng(seed).normal(size=(12, 2)) * (20.0, 2.0)
        before = fit_one(points)
        assume(before.eigenvalue_ratio[0] > 4)  # a round set has no direction to turn
        rotation = np.array([[cos(turn), -sin(turn)], [sin(turn), cos(turn)]])
        after = fit_one(points @ rotation.T + (dx, dy))
        assert same_direction(after.theta_rad[0], before.theta_rad[0] + turn, 1e-6)
        assert after.eigenvalue_ratio[0] == pytest.approx(before.eigenvalue_ratio[0], rel=1e-6)
        assert -pi / 2 < after.theta_rad[0] <= pi / 2
        turned_ends = before.ends_px.reshape(2, 2) @ rotation.T + (dx, dy)
        found_ends = after.ends_px.reshape(2, 2)
        assert np.allclose(found_ends, turned_ends) or np.allclose(found_ends, turned_ends[::-1])
