"""When a lateral offset is not relied on because the vehicle's motion does not lead to it."""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, nan, pi, sin

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion.estimator.config import FusionConfig
from fusion.estimator.estimator import CorridorEstimator
from fusion.estimator.lateral.gaussian_sum import OffsetReadout
from fusion.estimator.lateral.status import CONTRADICTED_S, Lateral, RecentOffsets, with_frame_outcome
from fusion.estimator.propagation import ImuSample
from fusion.estimator.tables import Table
from fusion.offline.table_builder import TableBuilder
from tests.fusion.simulated import frame

MS = 1_000_000
FRAME_S = 0.05
AT_REST = (0.0, 0.0, -9.80665)


def doubted(
    offsets: Sequence[float], rates: Sequence[float] | None = None, rate_std: float = 0.05
) -> list[bool]:
    """Say of each frame's offset whether what was relied on before contradicts it; NaN: it is not known."""
    lateral, out = Lateral(), []
    for k, offset in enumerate(offsets):
        rate = 0.0 if rates is None else rates[k]
        found = OffsetReadout(offset, 0.02, rate, rate_std, 1.0, offset == offset, 0.0)
        lateral = with_frame_outcome(lateral, found, found, round(k * FRAME_S * 1e9), nan)
        out.append(lateral.contradicted)
    return out


def test_an_offset_to_which_no_motion_leads_is_doubted_for_some_seconds() -> None:
    in_doubt = doubted([0.1] * 60 + [0.4] * 140)
    assert not any(in_doubt[:60])
    assert in_doubt[60]
    # Until half of what contradicts it is forgotten at the least, and no longer than the last of it is remembered.
    assert 0.5 * CONTRADICTED_S < FRAME_S * sum(in_doubt) <= CONTRADICTED_S + FRAME_S


def test_one_that_drifts_is_doubted_before_it_is_far_off() -> None:
    drift = [0.1] * 60 + [0.1 + 0.1 * FRAME_S * k for k in range(60)]
    in_doubt = doubted(drift)
    assert not any(in_doubt[:60])
    assert abs(drift[in_doubt.index(True)] - 0.1) < 0.15


def test_motion_that_leads_there_is_believed_however_far() -> None:
    t = FRAME_S * np.arange(200)
    weaving, rate = [0.7 * sin(x) for x in t], [0.7 * cos(x) for x in t]
    assert not any(doubted(weaving, rate))
    assert any(doubted(weaving))


def test_a_rate_of_which_little_is_known_contradicts_little() -> None:
    assert any(doubted([0.1] * 60 + [0.22] * 20))
    assert not any(doubted([0.1] * 60 + [0.22] * 20, rate_std=0.15))


def test_a_first_guess_does_not_contradict_what_follows() -> None:
    assert not any(doubted([0.5] * 4 + [0.1] * 60))
    assert not any(doubted([nan] * 40 + [0.1] * 60))


@given(
    st.lists(st.floats(-1.0, 1.0), max_size=120), st.lists(st.floats(-0.5, 0.5), min_size=120, max_size=120)
)
def test_the_mirrored_flight_is_doubted_where_this_one_is(offsets: list[float], rates: list[float]) -> None:
    rates = rates[: len(offsets)]
    assert doubted(offsets, rates) == doubted([-y for y in offsets], [-v for v in rates])


@given(st.lists(st.floats(0.001, 3.0), max_size=200))
def test_what_is_remembered_is_bounded(intervals_s: list[float]) -> None:
    recent, t_ns = RecentOffsets(), 0
    for dt_s in intervals_s:
        t_ns += round(dt_s * 1e9)
        recent = recent.propagated(0.1, t_ns).with_offset(0.0, t_ns)
        assert len(recent.t_ns) == len(recent.origin_norm) <= 41
        assert all(0 <= t_ns - t < CONTRADICTED_S * 1e9 for t in recent.t_ns)


@pytest.fixture(scope="module")
def beside_a_step() -> tuple[tuple[Table, Table], CorridorEstimator]:
    """Filter's and smoother's rows, and the estimator, of a vehicle whose frames begin to show other walls."""
    config = FusionConfig(corridor_width_m=2.0)
    recorder = TableBuilder(config, (ImuSample,))
    estimator = CorridorEstimator(config, on_final=recorder.take)
    for k in range(1200):
        t_ns = 10 * MS * k
        estimator.add_imu(t_ns, (0.0, 0.0, 0.0), AT_REST)
        if k % 5 == 0:
            estimator.add_measurement(t_ns, frame(0.1, lateral=0.1 if k < 400 else 0.5, lateral_std=0.02))
    estimator.finish()
    recorder.finish()
    return (recorder.estimates(), recorder.smoothed()), estimator


@pytest.mark.parametrize("table", [0, 1])
def test_other_walls_are_not_told_as_the_offset_until_time_has_passed(
    beside_a_step: tuple[tuple[Table, Table], CorridorEstimator], table: int
) -> None:
    rows = beside_a_step[0][table]
    t_s = 0.01 * np.arange(len(rows))
    known = rows["lateral_status"] == "known"
    offset = rows["lateral_offset_norm"]
    assert known[(t_s > 2.0) & (t_s < 3.5)].all()
    np.testing.assert_allclose(offset[known & (t_s < 7.5)], 0.1, atol=0.06)
    assert known[t_s > 8.5].all()
    np.testing.assert_allclose(offset[t_s > 8.5], 0.5, atol=0.05)
    lacking = ~known & (t_s > 2.0)
    assert (rows["lateral_reason"][lacking] == "contradicted").sum() > 0.5 * lacking.sum()
    # It is known once, unknown once and known again: no flicker.
    assert np.count_nonzero(np.diff(known[t_s > 2.0].astype(int))) == 2


def test_the_jump_is_counted_when_the_new_offset_is_told(
    beside_a_step: tuple[tuple[Table, Table], CorridorEstimator],
) -> None:
    estimate = beside_a_step[1].estimate()
    assert estimate.lateral_status == "known"
    assert estimate.lateral_reset_count == 1
    assert estimate.reset_lateral_norm == pytest.approx(0.4, abs=0.05)


def standing(offset: float) -> CorridorEstimator:
    """An estimator of a vehicle that has stood still for two seconds."""
    estimator = CorridorEstimator(FusionConfig(corridor_width_m=2.0))
    stand(estimator, 0, 200, offset)
    assert estimator.estimate().lateral_status == "known"
    return estimator


def stand(estimator: CorridorEstimator, first: int, last: int, offset: float) -> None:
    for k in range(first, last):
        estimator.add_imu(10 * MS * k, (0.0, 0.0, 0.0), AT_REST)
        if k % 5 == 0:
            estimator.add_measurement(10 * MS * k, frame(0.1, lateral=offset, lateral_std=0.02))


def test_what_is_doubted_is_not_among_the_states_of_the_covariance_either() -> None:
    estimator = standing(0.1)
    assert "lateral_offset_norm" in estimator.covariance().names
    stand(estimator, 200, 320, 0.5)
    assert estimator.estimate().lateral_status == "unknown"
    assert "lateral_offset_norm" not in estimator.covariance().names


@pytest.mark.parametrize(("turn_rad", "status"), [(pi, "unknown"), (0.5 * pi, "unknown"), (0.05, "known")])
def test_a_seed_that_turns_the_vehicle_round_or_into_another_corridor_makes_it_unknown(
    turn_rad: float, status: str
) -> None:
    estimator = standing(0.4)
    estimator.seed(1990 * MS, 0.1 + turn_rad, 0.05)
    assert estimator.estimate().lateral_status == status
