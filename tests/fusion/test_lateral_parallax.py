"""Motion parallax of the walls, as the filter of the lateral offset takes it in."""

from __future__ import annotations

from dataclasses import replace
from math import nan

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fusion import FusionConfig
from fusion.estimator.estimator import CorridorEstimator
from fusion.estimator.lateral.gaussian_sum import (
    FrameEvidence,
    OffsetModel,
    OffsetState,
    Path,
    frame_evidence,
    initial_offset_state,
    transition,
    update,
)
from fusion.estimator.lateral.kernels import S, V, Y
from fusion.estimator.lateral.parallax import (
    BASELINE_S,
    INTERVAL_S,
    MAX_VIEW_S,
    WallParallax,
    WallView,
    compare_walls,
    with_parallax,
)
from tests.fusion.simulated import frame
from vision.lateral.mixture import OffsetMixture
from vision.lateral.parallax import PROFILES_SHAPE, Profiles

MS = 1_000_000
MODEL = OffsetModel()
NO_COMPONENTS = np.zeros((0, 3))
PATHS = st.builds(
    lambda t_s, a1, a2: Path(t_s, t_s, a1, a2, 0.0),
    st.floats(0.01, 1.0),
    st.floats(-1.0, 1.0),
    st.floats(-1.0, 1.0),
)


def at(offset_norm: float, frames: int = 10) -> OffsetState:
    """Know the offset, and little of its rate."""
    state = initial_offset_state()
    said = OffsetMixture(*(np.array([v]) for v in (0.95, offset_norm, 0.02, nan)))
    for _ in range(frames):
        state = update(state, frame_evidence([said], 0.3, 0.0, (0.0, 0.0)), MODEL)
    return state


def moved(
    displacement_norm: float, side: float = 1.0, swing_m: float = 0.0, per_offset: float = 0.0
) -> WallParallax:
    """Tell how far the camera moved in .3 s, and nothing else."""
    path = Path(0.3, 0.3, 0.0, 0.0, 0.0)
    return WallParallax(
        NO_COMPONENTS, side, 0.0, path, 10.0, displacement_norm, per_offset, 0.006**2, swing_m
    )


@given(PATHS, PATHS)
def test_two_paths_are_one(first: Path, second: Path) -> None:
    one, other = (transition(path, MODEL)[0] for path in (first, second))
    whole, _ = transition(first.followed_by(second), MODEL)
    np.testing.assert_allclose(whole, other @ one, atol=1e-9)


def test_paths_lead_nowhere_from_nowhere() -> None:
    path = Path(0.2, 0.2, 0.1, 0.02, 0.001)
    assert Path().followed_by(path) == path == path.followed_by(Path())


@settings(max_examples=40)
@given(st.floats(-0.1, 0.1))
def test_a_displacement_tells_the_rate(displacement_norm: float) -> None:
    state = with_parallax(at(0.1), moved(displacement_norm), MODEL)
    best = int(np.argmax(state.weight[:-1]))
    assert state.x[best, V] == pytest.approx(displacement_norm / 0.3, abs=0.06)
    assert state.x[best, Y] == pytest.approx(0.1, abs=0.05)
    assert state.P[best, V, V] < at(0.1).P[best, V, V]


def test_flying_back_the_camera_moves_the_other_way() -> None:
    ahead, back = (with_parallax(at(0.1), moved(0.06, side), MODEL) for side in (1.0, -1.0))
    assert ahead.x[0, V] == pytest.approx(0.2, abs=0.05)
    assert back.x[0, V] == pytest.approx(-0.2, abs=0.05)


def test_a_camera_that_swings_has_not_moved_the_body() -> None:
    s = at(0.1).x[0, S]
    state = with_parallax(at(0.1), moved(0.05 * s, swing_m=0.05), MODEL)
    assert state.x[0, V] == pytest.approx(0.0, abs=0.03)


def test_the_displacement_is_read_at_the_offset() -> None:
    state = with_parallax(at(0.4), moved(0.1, per_offset=-0.25), MODEL)
    assert state.x[0, V] == pytest.approx(0.0, abs=0.03)


def test_an_absurd_displacement_hardly_counts() -> None:
    before = at(0.1)
    after = with_parallax(before, moved(5.0), MODEL)
    assert abs(after.x[0, Y] - before.x[0, Y]) < 3.5 * np.sqrt(before.P[0, Y, Y])


@pytest.mark.parametrize("displacement_norm", [nan, 0.05])
def test_parallax_moves_weights_and_forgets_nothing(displacement_norm: float) -> None:
    two = initial_offset_state()
    both = OffsetMixture(*(np.array(v) for v in ([0.45, 0.45], [0.3, -0.3], [0.02, 0.02], [nan, nan])))
    for _ in range(10):
        two = update(two, frame_evidence([both], 0.3, 0.0, (0.0, 0.0)), MODEL)
    said = moved(displacement_norm)._replace(components=np.array([[0.85, 0.28, 0.1**2]]), dt_s=0.3)
    after = with_parallax(two, said, MODEL)
    right = after.weight[:-1][after.x[:, Y] > 0.0].sum()
    assert right > 0.6 > two.weight[:-1][two.x[:, Y] > 0.0].sum()
    assert after.weight[-1] < two.weight[-1] + 1e-3
    assert after.spread2 == two.spread2
    assert after.evidence_age_s == two.evidence_age_s


def test_before_any_frame_the_walls_alone_make_hypotheses_but_no_rate() -> None:
    said = moved(0.05)._replace(components=np.array([[0.85, 0.28, 0.1**2]]), dt_s=0.3)
    state = with_parallax(initial_offset_state(), said, MODEL)
    assert len(state.x) == 1
    assert state.x[0, V] == 0.0


def profiles(seed: int = 0) -> Profiles:
    """Return some texture: waves along each wall."""
    waves, phases = np.random.default_rng(seed).uniform(0.1, 1.0, (2, 8, *PROFILES_SHAPE[::2]))
    along = np.arange(PROFILES_SHAPE[1])[:, None]
    found = np.sin(along * waves[..., None, :] + 2.0 * np.pi * phases[..., None, :]).sum(axis=0)
    return np.asarray(0.03 * found, np.float32)


def test_frames_are_compared_with_one_long_enough_ago() -> None:
    evidence = FrameEvidence(NO_COMPONENTS, 0.05)
    views: tuple[WallView, ...] = ()
    compared, most = [], 0
    for k in range(60):  # frames every .05 s
        views, motion = compare_walls(views, profiles(), evidence)
        most = max(most, len(views))
        if motion is not None:
            compared.append((k, motion.path.t_s, motion.dt_s))
        views = tuple(view.propagated(Path(0.05, 0.05, 0.0, 0.0, 0.0)) for view in views)
    assert most < 5
    assert all(BASELINE_S - 1e-6 <= t_s < BASELINE_S + INTERVAL_S + 0.05 for _, t_s, _ in compared)
    steps = np.diff([k for k, _, _ in compared]) * 0.05
    np.testing.assert_allclose(steps, [dt_s for _, _, dt_s in compared[1:]], atol=1e-9)
    assert INTERVAL_S - 1e-9 <= steps.min() <= steps.max() < INTERVAL_S + 0.05 + 1e-9


def test_rare_frames_are_compared_until_other_walls_are_in_view() -> None:
    evidence = FrameEvidence(NO_COMPONENTS, 1.0)
    views, motion = compare_walls((), profiles(), evidence)
    assert motion is None
    for wait_s, is_compared in ((1.0, True), (2.0 * MAX_VIEW_S, False)):
        later = tuple(view.propagated(Path(wait_s, 0.0, 0.0, 0.0, 0.0)) for view in views)
        assert (compare_walls(later, profiles(), evidence)[1] is not None) == is_compared


def test_a_vehicle_that_has_turned_round_sees_other_walls() -> None:
    views, _ = compare_walls((), profiles(), FrameEvidence(NO_COMPONENTS, 0.3))
    later = tuple(view.propagated(Path(0.4, 0.0, 0.0, 0.0, 0.0)) for view in views)
    views, motion = compare_walls(later, profiles(), FrameEvidence(NO_COMPONENTS, 0.3, side=-1.0))
    assert motion is None
    assert views[-1].side == -1.0


def test_frames_without_profiles_leave_the_views_as_they_are() -> None:
    views, _ = compare_walls((), profiles(), FrameEvidence(NO_COMPONENTS, 0.3))
    assert compare_walls(views, None, FrameEvidence(NO_COMPONENTS, 0.3)) == (views, None)


def test_still_walls_say_that_the_vehicle_does_not_move_aside() -> None:
    """Without accelerometer the rate is told by the walls alone."""

    def least_rate_std(walls: Profiles | None) -> float:
        estimator = CorridorEstimator(FusionConfig(corridor_width_m=2.0))
        least = 1.0
        for i in range(200):
            estimator.add_imu(i * 10 * MS, (0.0, 0.0, 0.0))
            if i % 5 == 0:
                seen = frame(0.0, 0.01, 0.2, 0.02)
                estimator.add_measurement(i * 10 * MS, replace(seen, wall_profiles=walls))
            found = estimator.estimate()
            if i > 100:
                assert found.lateral_velocity_norm_s == pytest.approx(0.0, abs=0.05)
                least = min(least, found.lateral_velocity_norm_s_std)
        return least

    assert least_rate_std(profiles()) < 0.8 * least_rate_std(None)


def test_what_are_no_profiles_is_counted_and_left_out() -> None:
    estimator = CorridorEstimator(FusionConfig(corridor_width_m=2.0))
    for i in range(100):
        estimator.add_imu(i * 10 * MS, (0.0, 0.0, 0.0))
        if i % 5 == 0:
            bad = np.full(PROFILES_SHAPE, np.inf, np.float32)
            estimator.add_measurement(i * 10 * MS, replace(frame(0.0, 0.01, 0.2, 0.02), wall_profiles=bad))
    assert estimator.counters["frame_walls_out_of_range"] == 20
    assert estimator.estimate().lateral_offset_norm == pytest.approx(0.2, abs=0.02)
