"""The vote over heading and elevation: its prior, what it finds beside a peak, and rendered slopes."""

from __future__ import annotations

import csv
from math import degrees, pi, radians

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion.simulate import SceneConfig, random_views
from tests.files import SHARED
from tests.pictures import read_grey
from vision import Attitude, Camera, measure_frame
from vision.axis.elevation import elevation_information, elevation_log_prior, elevations_to_try
from vision.axis.peaks import (
    MAX_ONE_SIDED,
    RIVAL_DISTANCE_RAD,
    VOTE_TEMPERATURE,
    HeadingVote,
    corridor_score,
    find_rival,
)
from vision.axis.vote import BIN_RAD, N_BINS, bin_heading
from vision.types import FloatArray

PICTURES = SHARED / "cases" / "pictures"
HEADINGS = -0.5 * pi + (np.arange(N_BINS) + 0.5) * BIN_RAD


def vote_of(log_likelihood: FloatArray) -> HeadingVote:
    """A vote at one elevation, every heading of it a peak."""
    scores = np.stack([log_likelihood, np.zeros(N_BINS)])[:, None, :]
    best = int(np.argmax(log_likelihood))
    return HeadingVote(
        scores, np.zeros(1), radians(0.5), log_likelihood, np.zeros(N_BINS), best, 0, log_likelihood[best]
    )


@given(std=st.floats(radians(0.2), radians(12)), elevation=st.floats(radians(-8), radians(8)))
def test_the_information_is_the_gradient_of_the_prior(std: float, elevation: float) -> None:
    step = 1e-6
    gradient = (elevation_log_prior(elevation + step, std) - elevation_log_prior(elevation - step, std)) / (
        2 * step
    )
    assert -elevation * elevation_information(elevation, std) == pytest.approx(gradient, rel=1e-3, abs=1e-2)


def test_a_level_corridor_is_expected_and_a_slope_is_possible() -> None:
    std = radians(0.4)
    assert elevation_log_prior(0.0, std) == pytest.approx(0.0, abs=0.03)
    assert elevation_log_prior(std, std) == pytest.approx(-0.5, abs=0.03)
    assert -12.0 < elevation_log_prior(radians(4.8), std) < -6.0  # a Gaussian alone: -72
    assert elevation_information(0.0, std) == pytest.approx(1 / std**2, rel=0.02)
    assert elevation_information(radians(4.8), std) < 1 / radians(2.5) ** 2


@given(std=st.floats(radians(0.1), radians(20)))
def test_the_elevations_to_try_are_symmetric_and_reach_slopes(std: float) -> None:
    found, each_std = elevations_to_try(std)
    assert len(found) <= 23
    # Each stands for what lies half-way to its neighbours, at most for all that is likely.
    np.testing.assert_allclose(each_std, np.minimum(std, 0.4 * np.gradient(found)))
    assert found == pytest.approx(-found[::-1])
    assert found[-1] >= radians(4.0)
    assert np.diff(found).max() <= radians(1.0) + 1e-12


@given(shift=st.floats(-1.0, 1.0), sigma_bins=st.floats(0.5, 3.0))
def test_one_peak_has_no_excess_wherever_the_bins_lie(shift: float, sigma_bins: float) -> None:
    heading = bin_heading(400) + shift * BIN_RAD
    sigma = sigma_bins * BIN_RAD
    peak = np.asarray(-0.5 * ((HEADINGS - heading) / sigma) ** 2, dtype=np.float64)
    found = find_rival(vote_of(peak), peak, heading, 0.0)
    assert found.excess_variance < (0.1 * sigma) ** 2


@given(apart=st.floats(radians(2), radians(7)), behind=st.floats(0.0, 3.0), shift=st.floats(0.0, 1.0))
def test_two_peaks_add_the_variance_of_the_choice(apart: float, behind: float, shift: float) -> None:
    heading = bin_heading(300) + shift * BIN_RAD
    sigma = 1.5 * BIN_RAD
    peaks = np.maximum(
        -0.5 * ((HEADINGS - heading) / sigma) ** 2,
        -behind - 0.5 * ((HEADINGS - heading - apart) / sigma) ** 2,
    )
    odds = np.exp(-behind / VOTE_TEMPERATURE)
    excess = find_rival(vote_of(peaks), peaks, heading, 0.0).excess_variance
    assert excess == pytest.approx(odds / (1 + odds) * apart**2, rel=0.15)


@given(shift=st.floats(0.0, 1.0), apart=st.floats(radians(1.5), radians(3)))
def test_elevations_that_miss_the_axis_do_not_split_its_peak(shift: float, apart: float) -> None:
    """Left and right lines meet at the axis's elevation; beside it each side has a peak of its own."""
    sigma, heading = 1.5 * BIN_RAD, bin_heading(300) + shift * BIN_RAD
    left, right = (-0.5 * ((HEADINGS - heading - d) / sigma) ** 2 for d in (-0.5 * apart, 0.5 * apart))
    missed = np.maximum(np.maximum(left, right), -30.0)
    met = np.asarray(20.0 - 0.5 * ((HEADINGS - heading) / sigma) ** 2, dtype=np.float64)
    split = find_rival(vote_of(missed), missed, heading, 0.0).excess_variance
    whole = find_rival(vote_of(missed), met, heading, 0.0).excess_variance
    assert split > (0.3 * apart) ** 2
    assert whole < (0.1 * sigma) ** 2


def test_a_flat_vote_does_not_tell_at_all() -> None:
    found = find_rival(vote_of(np.zeros(N_BINS)), np.zeros(N_BINS), 0.3, 0.0)
    assert found.excess_variance == RIVAL_DISTANCE_RAD**2


@given(below=st.floats(0.0, 200.0), above=st.floats(0.0, 200.0), more=st.floats(0.0, 200.0))
def test_lines_in_one_plane_tell_no_more_than_that_it_has_a_pattern(
    below: float, above: float, more: float
) -> None:
    score = corridor_score(below, above)
    assert score == corridor_score(above, below)
    assert score <= corridor_score(below + more, above) <= score + more + 1e-9
    assert corridor_score(below, 0.0) == min(below, MAX_ONE_SIDED)
    assert below + above >= score >= min(below + above, MAX_ONE_SIDED + min(below, above)) - 1e-9


def test_a_rival_is_judged_at_the_elevation_of_the_axis() -> None:
    """Two headings at elevations of their own: one tilt error explains only one of them."""
    elevation = np.array([radians(-2), 0.0, radians(2)])
    scores = np.zeros((2, 3, N_BINS))
    first, second = 360, 400
    scores[:, 2, first], scores[:, 0, second] = 15.0, 12.5
    marginal = scores.sum(axis=0).max(axis=0)
    log_prior = np.full(N_BINS, -np.inf)
    log_prior[[first, second]] = 0.0
    voted = HeadingVote(scores, elevation, radians(0.3), marginal, log_prior, first, 2, 30.0)
    own = find_rival(voted, marginal, bin_heading(first), radians(2))
    assert own.bin == second
    assert own.score < 1.0
    assert find_rival(voted, marginal, bin_heading(first), radians(-2)).score == pytest.approx(25.0, abs=0.1)


@pytest.mark.parametrize("slope_rad", [-0.08, 0.03, 0.08])
def test_a_rendered_slope_gives_no_gross_error(slope_rad: float) -> None:
    camera = Camera.from_fov(320, 240, radians(70))
    accepted = 0
    views = random_views(
        camera,
        24,
        7,
        scene=lambda seed: SceneConfig.random_office(seed, slope_rad=slope_rad),
        views_per_scene=4,
    )
    for view in views:
        found = measure_frame(view.image, camera, Attitude(view.roll_rad, view.pitch_rad))
        if found.accepted:
            accepted += 1
            assert abs(degrees(found.heading_rad - view.heading_rad)) < 1.5
    assert accepted >= 11  # 12, 14 and 13 were


@pytest.mark.parametrize(
    ("name", "heading_deg"),
    [("corridor_0120.jpg", -1.89), ("corridor_0135.jpg", -1.53), ("corridor_0148.jpg", None)],
)
def test_a_real_corridor_that_the_horizon_alone_splits_is_accepted(
    name: str, heading_deg: float | None
) -> None:
    if not PICTURES.is_dir():
        pytest.skip("the shared pictures are not here")
    with (PICTURES / "tilt.csv").open(encoding="utf-8") as file:
        tilt = {row["image"]: row for row in csv.DictReader(file)}[name]
    camera = Camera.from_yaml(PICTURES / "indoor.yaml")
    attitude = Attitude(float(tilt["roll_rad"]), float(tilt["pitch_rad"]))
    found = measure_frame(read_grey(PICTURES / name), camera, attitude)
    assert found.accepted
    if heading_deg is not None:
        assert degrees(found.heading_rad) == pytest.approx(heading_deg, abs=0.2)
