"""What a frame says of the offset, as a mixture: a density, symmetric, wide where two kinds of evidence disagree."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from vision import Attitude, Camera, measure_lines
from vision.lateral.geometric import MIN_CANNOT_TELL
from vision.lateral.mixture import N_BINS, OffsetMixture, cannot_tell, combine, mixture_of_components
from vision.lateral.offset import combined_offset

GRID = np.linspace(-1.5, 1.5, 30001)
CAMERA = Camera(640, 480, 466.0, 466.0, 319.5, 239.5)
LEVEL = Attitude(0.0, 0.0)


def mixture(*parts: tuple[float, float, float]) -> OffsetMixture:
    """Weight, offset and sigma of each component."""
    weight, offset, std = np.array(parts, dtype=float).reshape(-1, 3).T
    return OffsetMixture(weight, offset, std, np.full(len(weight), np.nan))


def mass(m: OffsetMixture, low: float, high: float) -> float:
    inside = (m.offset_norm > low) & (m.offset_norm < high)
    return float(m.weight[inside].sum())


some_components = arrays(
    float, st.tuples(st.integers(1, 300), st.just(3)), elements=st.floats(0.0, 1.0, width=32)
).map(lambda a: np.column_stack([a[:, 0], 1.9 * a[:, 1] - 0.95, (0.005 + 0.05 * a[:, 2]) ** 2, a[:, 0]]))


def test_likelihood_of_one_component_is_its_gaussian_and_half_of_what_it_cannot_tell() -> None:
    m = mixture((0.8, 0.1, 0.02))
    assert m.cannot_tell == pytest.approx(0.2)
    assert m.likelihood(0.1) == pytest.approx(0.1 + 0.8 / (0.02 * np.sqrt(2 * np.pi)))
    assert m.likelihood([0.9, -0.9]) == pytest.approx([0.1, 0.1])
    assert cannot_tell().likelihood(0.3) == 0.5


@given(some_components, st.floats(0.01, 10.0))
def test_merging_keeps_weight_mean_and_variance(rows: np.ndarray[Any, Any], odds: float) -> None:
    rows[:, 0] += 1e-3
    m = mixture_of_components(rows, odds, 0.0)
    assert len(m.weight) <= N_BINS
    assert np.all(np.diff(m.offset_norm) > 0)
    total = rows[:, 0].sum() + odds
    kept = m.weight.sum()
    assert kept == pytest.approx(rows[:, 0].sum() / total, abs=N_BINS * 1e-4)
    share = rows[:, 0] / rows[:, 0].sum()
    mean = m.weight @ m.offset_norm / kept
    assert mean == pytest.approx(share @ rows[:, 1], abs=0.02)
    variance = share @ (rows[:, 2] + rows[:, 1] ** 2) - (share @ rows[:, 1]) ** 2
    assert m.weight @ (m.std_norm**2 + m.offset_norm**2) / kept - mean**2 == pytest.approx(variance, abs=0.03)


@given(some_components)
def test_a_mirrored_picture_gives_the_mirrored_mixture(rows: np.ndarray[Any, Any]) -> None:
    m = mixture_of_components(rows, 1.0, 1e-6)
    mirrored = mixture_of_components(rows * np.array([1.0, -1.0, 1.0, 1.0]), 1.0, 1e-6)
    np.testing.assert_allclose(
        mirrored.likelihood(-GRID[::100]), m.likelihood(GRID[::100]), rtol=0.5, atol=0.3
    )


def test_combined_evidence_that_agrees_is_sharper_and_surer() -> None:
    a, b = mixture((0.9, 0.10, 0.03)), mixture((0.8, 0.12, 0.03))
    both = combine(a, b)
    assert mass(both, 0.0, 0.2) > 0.98
    assert both.offset_norm[np.argmax(both.weight)] == pytest.approx(0.11, abs=1e-3)
    assert both.std_norm[np.argmax(both.weight)] < 0.03


def test_combined_evidence_that_disagrees_is_wide() -> None:
    a, b = mixture((0.9, 0.4, 0.02)), mixture((0.9, -0.3, 0.02))
    both = combine(a, b)
    assert mass(both, 0.3, 0.5) == pytest.approx(mass(both, -0.4, -0.2), rel=1e-6)
    assert mass(both, 0.3, 0.5) < 0.5
    assert both.cannot_tell > max(a.cannot_tell, b.cannot_tell)


def test_evidence_that_cannot_tell_changes_little() -> None:
    a = mixture((0.6, 0.4, 0.02), (0.2, -0.3, 0.02))
    both = combine(a, cannot_tell())
    np.testing.assert_allclose(
        both.likelihood([0.4, -0.3, 0.0]), a.likelihood([0.4, -0.3, 0.0]), rtol=0.06, atol=0.03
    )


@given(st.floats(0.1, 0.9), st.floats(0.1, 0.9), st.floats(-0.8, 0.8), st.floats(-0.8, 0.8))
def test_combining_is_symmetric_and_integrates_to_one(w: float, v: float, y: float, z: float) -> None:
    a, b = mixture((w, y, 0.03)), mixture((v, z, 0.04))
    one, other = combine(a, b), combine(b, a)
    np.testing.assert_allclose(one.likelihood(GRID), other.likelihood(GRID), rtol=1e-9)
    outside = 0.5 * one.cannot_tell  # the uniform part lies in (-1, 1) only
    assert np.trapezoid(one.likelihood(GRID), GRID) - outside == pytest.approx(1.0, abs=0.01)


def test_less_sure_keeps_the_shares() -> None:
    m = mixture((0.75, 0.1, 0.02), (0.25, 0.5, 0.02)).less_sure(0.2)
    assert m.weight == pytest.approx([0.6, 0.2])
    assert m.less_sure(0.1) is m


def test_a_wider_mixture_has_the_variances_added() -> None:
    m = mixture((0.6, 0.4, 0.03), (0.2, -0.3, 0.04))
    assert m.wider(0.04).std_norm == pytest.approx([0.05, 0.04 * 2**0.5])
    assert (m.wider(0.04).weight == m.weight).all()


def test_a_frame_carries_the_mixture_and_it_holds_the_answer(corridor: Any, seen: Any) -> None:
    lines = seen(corridor(offset_norm=0.2, heading_rad=0.05), CAMERA)
    m = measure_lines(lines, CAMERA, LEVEL)
    (evidence,) = m.offset_evidence
    assert evidence.cannot_tell == pytest.approx(MIN_CANNOT_TELL)  # lines alone are never surer
    near = mass(evidence, m.lateral_offset_norm - 0.05, m.lateral_offset_norm + 0.05)
    assert near > 0.95 * (1.0 - evidence.cannot_tell)
    widths = evidence.width_per_height[np.abs(evidence.offset_norm - 0.2) < 0.03]
    assert np.nanmedian(widths) == pytest.approx(2.2 / 1.4, rel=0.05)
    assert m.without_lines().offset_evidence == ()


def test_one_wall_alone_leaves_no_place_sure(corridor: Any, seen: Any) -> None:
    m = measure_lines(seen(corridor(walls=(1,), heading_rad=-0.1), CAMERA), CAMERA, LEVEL)
    (evidence,) = m.offset_evidence
    assert evidence.likelihood(np.linspace(-0.9, 0.9, 181)).max() < 10.0


@settings(max_examples=20, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(offset=st.floats(-0.6, 0.6))
def test_mirrored_corridors_have_mirrored_mixtures(corridor: Any, seen: Any, offset: float) -> None:
    def evidence(y: float) -> OffsetMixture:
        (found,) = measure_lines(seen(corridor(offset_norm=y), CAMERA), CAMERA, LEVEL).offset_evidence
        return found

    there, back = evidence(offset), evidence(-offset)
    assert mass(there, offset - 0.05, offset + 0.05) == pytest.approx(
        mass(back, -offset - 0.05, -offset + 0.05), abs=0.1
    )


def test_without_the_lateral_offset_the_heading_is_the_same(corridor: Any, seen: Any) -> None:
    lines = seen(corridor(offset_norm=0.2, heading_rad=0.05), CAMERA)
    whole, heading = measure_lines(lines, CAMERA, LEVEL), measure_lines(lines, CAMERA, LEVEL, lateral=False)
    assert heading.heading_rad == whole.heading_rad
    assert heading.offset_evidence == ()
    assert np.isnan(heading.lateral_offset_norm)


@pytest.mark.parametrize("roll_rad", [-0.02, 0.0, 0.03])
def test_vertical_lines_alone_tell_the_roll_that_the_attitude_lacks(
    corridor: Any, seen: Any, roll_rad: float
) -> None:
    lines = seen(corridor(roll_rad=roll_rad, heading_rad=0.1), CAMERA)
    m = measure_lines(lines, CAMERA, Attitude(0.01, 0.0, 0.02))
    assert m.roll_correction_rad == pytest.approx(roll_rad - 0.01, abs=0.002)
    assert 0.0 < m.roll_correction_std_rad < 0.01


def test_without_vertical_lines_nothing_adds_to_the_roll(corridor: Any, seen: Any) -> None:
    m = measure_lines(seen(corridor(posts=False), CAMERA), CAMERA, Attitude(0.01, 0.0, 0.02))
    assert np.isnan(m.roll_correction_rad)


def with_width(m: OffsetMixture, width: float) -> OffsetMixture:
    return replace(m, width_per_height=np.full(len(m.weight), width))


def test_lines_and_regions_that_agree_answer_though_neither_does_alone() -> None:
    lines = mixture((0.35, 0.20, 0.005), (0.35, -0.30, 0.005))
    answer = combined_offset(lines, mixture((0.98, 0.17, 0.06)))
    assert answer is not None
    assert answer.offset_norm == pytest.approx(0.20, abs=0.01)
    assert 0.005 < answer.offset_norm_std < 0.06


def test_a_wide_distribution_with_peaks_at_either_side_is_one_answer() -> None:
    """A bench hides one corner: nothing tells where between the peaks the middle is, but that it is there."""
    answer = combined_offset(cannot_tell(), mixture((0.67, -0.08, 0.06), (0.31, 0.08, 0.05)))
    assert answer is not None
    assert answer.offset_norm == pytest.approx(-0.03, abs=0.01)
    assert 0.09 < answer.offset_norm_std < 0.12
    apart = mixture((0.67, -0.18, 0.06), (0.31, 0.18, 0.05))
    assert combined_offset(cannot_tell(), apart) is None


def test_where_lines_and_regions_disagree_the_answer_is_wide_or_none() -> None:
    lines = mixture((0.7, 0.6, 0.005))
    assert combined_offset(lines, mixture((0.7, -0.3, 0.05))) is None
    sure = combined_offset(lines, mixture((0.99, -0.07, 0.08)))
    assert sure is not None
    assert sure.offset_norm == pytest.approx(-0.07, abs=0.01)
    assert sure.offset_norm_std > 0.08
    assert combined_offset(cannot_tell(), cannot_tell()) is None


def test_a_prediction_chooses_between_answers_and_does_not_move_them() -> None:
    lines, regions = (
        mixture((0.4, 0.5, 0.01), (0.3, -0.1, 0.01)),
        mixture((0.5, 0.5, 0.03), (0.5, -0.1, 0.03)),
    )
    assert combined_offset(lines, regions) is None
    chosen = combined_offset(lines, regions, 0.45, 0.05)
    assert chosen is not None
    assert chosen.offset_norm == pytest.approx(0.5, abs=1e-3)


def test_width_is_answered_only_where_lines_and_regions_see_the_same() -> None:
    """Carpet stripes are symmetric: taken for the corners they leave the offset right and the width too small."""
    lines, regions = mixture((0.7, 0.1, 0.01)), mixture((0.95, 0.1, 0.05))
    for by_regions, width in ((2.1, 2.0), (2.9, np.nan), (np.nan, np.nan)):
        answer = combined_offset(with_width(lines, 2.0), with_width(regions, by_regions))
        assert answer is not None
        assert answer.offset_norm == pytest.approx(0.1)
        np.testing.assert_equal(answer.width_per_height, width)


@given(some_components, some_components)
def test_the_mirrored_evidence_gives_the_mirrored_answer(
    a: np.ndarray[Any, Any], b: np.ndarray[Any, Any]
) -> None:
    def mirrored(m: OffsetMixture) -> OffsetMixture:
        return OffsetMixture(m.weight[::-1], -m.offset_norm[::-1], m.std_norm[::-1], m.width_per_height[::-1])

    lines, regions = (mixture_of_components(rows + 1e-3, 0.1, 0.0) for rows in (a, b))
    there, back = combined_offset(lines, regions), combined_offset(mirrored(lines), mirrored(regions))
    if there is not None and back is not None:
        # Bins that merge components are mirrored but for their edges.
        assert there.offset_norm == pytest.approx(-back.offset_norm, abs=0.05)
