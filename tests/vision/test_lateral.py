"""Lateral offset: the right corners among what resembles them, silence where the walls do not tell."""

from __future__ import annotations

from math import exp, nan, radians
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from fusion.simulate.single_views import office_views
from vision import Attitude, Camera, FrameMeasurement, Prior, measure_frame, measure_lines
from vision.lateral.corner_candidates import CORNER, MAX_CORNERS, CornerCandidates
from vision.lateral.corner_pairs import N_EVIDENCE, PAIR, PictureCorners, pair_corners, rising_order
from vision.lateral.hypotheses import (
    HYPOTHESIS,
    POSITION_TERMS,
    WEIGHTS,
    most_probable_offset,
    offset_hypotheses,
    width_log_odds,
)

CAMERA = Camera(640, 480, 466.0, 466.0, 319.5, 239.5)
QUICK = settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
LEVEL = Attitude(0.0, 0.0)


def measured(seen: Any, corridor: Any, **about: Any) -> FrameMeasurement:
    m: FrameMeasurement = measure_lines(seen(corridor(**about), CAMERA), CAMERA, LEVEL)
    assert m.accepted
    return m


def test_floor_corners_and_not_the_skirting_boards_give_the_width(corridor: Any, seen: Any) -> None:
    m = measured(seen, corridor, offset_norm=0.2, heading_rad=0.05)
    assert m.lateral_offset_norm == pytest.approx(0.2, abs=0.005)
    assert m.width_per_height == pytest.approx(2.2 / 1.4, rel=0.01)  # the boards would give 2.2 / 1.3


@pytest.mark.parametrize("joints", [(-0.5,), (0.3,), (-0.6, 0.1, 0.7)])
def test_joints_of_the_floor_are_no_corners(corridor: Any, seen: Any, joints: tuple[float, ...]) -> None:
    for offset in (-0.3, 0.0, 0.3):
        m = measured(seen, corridor, offset_norm=offset, joints=joints)
        assert np.isnan(m.lateral_offset_norm) or m.lateral_offset_norm == pytest.approx(offset, abs=0.02)


def test_rails_of_one_wall_are_no_corners(corridor: Any, seen: Any) -> None:
    for offset in (-0.3, 0.0, 0.3):
        m = measured(seen, corridor, offset_norm=offset, left_rails_m=(0.5, 0.8, 1.1))
        assert np.isnan(m.lateral_offset_norm) or m.lateral_offset_norm == pytest.approx(offset, abs=0.02)


@pytest.mark.parametrize("wall", [-1, 1])
def test_one_wall_alone_gives_a_heading_and_no_offset(corridor: Any, seen: Any, wall: int) -> None:
    m = measured(seen, corridor, walls=(wall,), heading_rad=-0.1 * wall)
    assert m.heading_rad == pytest.approx(-0.1 * wall, abs=radians(0.05))
    assert np.isnan(m.lateral_offset_norm)
    assert m.position is None


@QUICK
@given(offset=st.floats(-0.6, 0.6), prior=st.floats(-0.8, 0.8))
def test_a_prior_never_moves_the_answer(corridor: Any, seen: Any, offset: float, prior: float) -> None:
    """It chooses: the answer is the one without it, or none."""
    lines = seen(corridor(offset_norm=offset), CAMERA)
    alone = measure_lines(lines, CAMERA, LEVEL)
    assume(np.isfinite(alone.lateral_offset_norm))
    m = measure_lines(lines, CAMERA, LEVEL, Prior(lateral_offset_norm=prior, lateral_offset_norm_std=0.05))
    if np.isfinite(m.lateral_offset_norm):
        assert m.lateral_offset_norm == pytest.approx(alone.lateral_offset_norm, abs=1e-6)


def hypotheses(*odds: tuple[float, float]) -> np.ndarray:
    """Floor pairs at these offsets with these odds."""
    return np.array([(y, 0.004, -1.5, np.log(q), k, -1) for k, (y, q) in enumerate(odds)], HYPOTHESIS)


def test_probability_is_shared_between_the_answers_and_none() -> None:
    found = most_probable_offset(hypotheses((0.3, 90.0), (0.31, 9.0), (-0.2, 900.0)), np.zeros(3), nan, nan)
    assert found.offset == pytest.approx(-0.2)
    assert found.probability == pytest.approx(900 / 1000)
    assert found.floor == 2
    assert found.floor_share == pytest.approx(1.0)
    joined = most_probable_offset(hypotheses((0.3, 90.0), (0.31, 9.0)), np.zeros(2), nan, nan)
    assert joined.offset == pytest.approx((90 * 0.3 + 9 * 0.31) / 99)
    assert joined.probability == pytest.approx(99 / 100)


def test_a_prior_settles_what_the_picture_leaves_open() -> None:
    rows = hypotheses((0.3, 500.0), (-0.3, 80.0))
    assert most_probable_offset(rows, np.zeros(2), nan, nan).probability < 0.9
    chosen = most_probable_offset(rows, np.zeros(2), 0.3, 0.04)
    assert chosen.offset == pytest.approx(0.3)
    assert chosen.probability == pytest.approx(500 / (500 + 80 * 0.1 + 1), rel=1e-3)
    against = most_probable_offset(
        rows, np.zeros(2), -0.3, 0.04
    )  # what a lost filter would like to hear is not answered
    assert against.probability < 0.9


def test_a_known_width_settles_which_pair_of_the_floor_it_is() -> None:
    pairs = np.zeros(2, PAIR)
    pairs["width"] = 1.6, 2.4
    rows = hypotheses((0.3, 60.0), (-0.3, 60.0))
    for known, chosen in ((1.6, 0), (2.4, 1)):
        odds = width_log_odds(pairs["width"], known, WEIGHTS)
        assert odds[chosen] > 1.0 > -1.0 > odds[1 - chosen]
        found = most_probable_offset(rows, odds, nan, nan)
        assert found.floor == chosen
        assert found.probability > 0.95
    np.testing.assert_array_equal(width_log_odds(pairs["width"], nan, WEIGHTS), [0.0, 0.0])
    # A width that no pair has leaves strong evidence its say.
    against = most_probable_offset(rows, width_log_odds(pairs["width"], 5.0, WEIGHTS), nan, nan)
    assert 0.3 < against.probability < 0.6


@QUICK
@given(offset=st.floats(-0.6, 0.6), width=st.floats(0.5, 6.0))
def test_a_known_width_never_moves_the_answer(corridor: Any, seen: Any, offset: float, width: float) -> None:
    lines = seen(corridor(offset_norm=offset), CAMERA)
    alone = measure_lines(lines, CAMERA, LEVEL)
    assume(np.isfinite(alone.lateral_offset_norm))
    m = measure_lines(lines, CAMERA, LEVEL, Prior(width_per_height=width))
    if np.isfinite(m.lateral_offset_norm):
        assert m.lateral_offset_norm == pytest.approx(alone.lateral_offset_norm, abs=1e-6)


def test_evidence_beyond_the_range_of_exp_is_no_trouble() -> None:
    rows = hypotheses((0.1, 1.0))
    rows["log_odds"] = 800.0
    assert most_probable_offset(rows, np.zeros(1), nan, nan).probability == pytest.approx(1.0)
    rows["log_odds"] = -800.0
    assert most_probable_offset(rows, np.zeros(1), nan, nan).probability < exp(-100)


def test_there_is_a_weight_for_every_piece_of_evidence() -> None:
    assert WEIGHTS.floor.shape == WEIGHTS.ceiling.shape == (N_EVIDENCE,)


def cross_section(half_width: float, offset: float, below: float, above: float) -> PictureCorners:
    """The four corners of a corridor, as seen from a place in its cross-section; nothing else."""
    corners = np.zeros((4, MAX_CORNERS), CORNER)
    for quadrant in range(4):
        height = below if quadrant < 2 else above
        wall = half_width + (offset if quadrant % 2 == 0 else -offset)
        corners[quadrant, 0]["slope"] = height / wall
        corners[quadrant, 0]["angle"] = np.arctan2(height, wall)
        for name, value in (("angle_std", 0.002), ("length", 0.4), ("polarity", 1.0), ("contrast", 100.0)):
            corners[quadrant, 0][name] = value
    candidates = CornerCandidates(corners, np.ones(4, np.int64))
    return PictureCorners(candidates, *pair_corners(candidates))


@settings(deadline=None)
@given(offset=st.floats(-0.6, 0.6), half_width=st.floats(0.8, 1.6))
def test_corners_give_offset_and_width_whatever_the_height(offset: float, half_width: float) -> None:
    picture = cross_section(half_width, offset * half_width, below=1.2, above=1.5)
    for pairs, height in ((picture.floor, 1.2), (picture.ceiling, 1.5)):
        assert pairs.pair["offset"] == pytest.approx(offset, abs=1e-9)
        assert pairs.pair["width"] == pytest.approx(2.0 * half_width / height)
        assert pairs.evidence["same_polarity"] == pytest.approx(1.0)
        assert pairs.evidence["length_gap"] == pytest.approx(0.0)


def test_log_odds_are_the_weighted_sum_of_the_evidence() -> None:
    picture = cross_section(1.1, 0.2, below=1.2, above=1.5)
    ceiling, floor, joint = offset_hypotheses(picture, WEIGHTS)
    assert [(h["floor"], h["ceiling"]) for h in (ceiling, floor, joint)] == [(-1, 0), (0, -1), (0, 0)]
    of_floor = WEIGHTS.floor @ picture.floor.evidence.view(np.float64)
    of_ceiling = WEIGHTS.ceiling @ picture.ceiling.evidence.view(np.float64)
    bias = WEIGHTS.bias[0]
    choice = bias["choice"] * np.log(2)  # two hypotheses have the floor's pair
    assert ceiling["log_odds"] == pytest.approx(of_ceiling + bias["ceiling"])
    assert floor["log_odds"] == pytest.approx(of_floor + bias["floor"] + choice)
    weight, evidence = WEIGHTS.ceiling.copy(), picture.ceiling.evidence.view(np.float64)
    weight[list(POSITION_TERMS)] = 0.0
    expected = of_floor + weight @ evidence + bias["floor"] + bias["joint"] + choice
    assert joint["log_odds"] == pytest.approx(expected)


def test_simulated_corridors_have_hardly_a_wrong_corner() -> None:
    """Boards, lockers, pipes, carts, floor joints, doors: never seen before, no attitude error."""
    camera = Camera.from_fov(320, 240, radians(85))
    error, sigma, accepted = [], [], 0
    for view in office_views(camera, 80, seed=31, views_per_scene=2, light_cell_m=0.8):
        m = measure_frame(view.image, view.camera, Attitude(view.roll_rad, view.pitch_rad))
        accepted += m.accepted
        if m.accepted and np.isfinite(m.lateral_offset_norm):
            error.append(m.lateral_offset_norm - view.lateral_offset_norm)
            sigma.append(m.lateral_offset_norm_std)
    wrong = np.abs(error) > 0.1  # 5 % of the width
    assert accepted >= 70
    assert len(error) >= 0.35 * accepted
    assert wrong.sum() <= 1
    assert np.percentile(np.abs(error) / np.array(sigma), 90) < 2.6


@given(st.lists(st.floats(-5.0, 5.0), max_size=300))
def test_order_of_offsets_is_a_permutation_that_sorts(values: list[float]) -> None:
    order = rising_order(np.array(values, dtype=float)).tolist()
    assert sorted(order) == list(range(len(values)))
    assert [values[i] for i in order] == sorted(values)
