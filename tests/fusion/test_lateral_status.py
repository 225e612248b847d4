"""When a lateral offset is not relied on because the vehicle's motion does not lead to it."""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, nan, sin

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion.estimator.config import FusionConfig
from fusion.estimator.estimator import CorridorEstimator
from fusion.estimator.lateral_offset import OffsetReadout
from fusion.estimator.lateral_status import CONTRADICTED_S, Lateral, ReliedOn, judged_by_motion
from fusion.estimator.propagation import ImuSample
from fusion.estimator.tables import Table
from fusion.offline.fuse import Recorder
from tests.fusion.simulated import frame

MS = 1_000_000
FRAME_S = 0.05
AT_REST = (0.0, 0.0, -9.80665)


def judged(
    offsets: Sequence[float], rates: Sequence[float] | None = None, rate_std: float = 0.05
) -> list[bool]:
    """Say of each frame's offset whether what was relied on before contradicts it; NaN: it is not known."""
    lateral, out = Lateral(), []
    for k, offset in enumerate(offsets):
        rate = 0.0 if rates is None else rates[k]
        found = OffsetReadout(offset, 0.02, rate, rate_std, 1.0, offset == offset, 0.0)
        lateral = judged_by_motion(lateral, round(k * FRAME_S * 1e9), found)
        out.append(lateral.contradicted)
    return out


def test_an_offset_to_which_no_motion_leads_is_doubted_for_some_seconds() -> None:
    doubted = judged([0.1] * 60 + [0.4] * 140)
    assert not any(doubted[:60])
    assert doubted[60]
    # Until half of what contradicts it is forgotten at the least, and no longer than the last of it is remembered.
    assert 0.5 * CONTRADICTED_S < FRAME_S * sum(doubted) <= CONTRADICTED_S + FRAME_S


def test_one_that_drifts_is_doubted_before_it_is_far_off() -> None:
    drift = [0.1] * 60 + [0.1 + 0.1 * FRAME_S * k for k in range(60)]
    doubted = judged(drift)
    assert not any(doubted[:60])
    assert abs(drift[doubted.index(True)] - 0.1) < 0.15


def test_motion_that_leads_there_is_believed_however_far() -> None:
    t = FRAME_S * np.arange(200)
    weaving, rate = [0.7 * sin(x) for x in t], [0.7 * cos(x) for x in t]
    assert not any(judged(weaving, rate))
    assert any(judged(weaving))


def test_a_rate_of_which_little_is_known_contradicts_little() -> None:
    assert any(judged([0.1] * 60 + [0.22] * 20))
    assert not any(judged([0.1] * 60 + [0.22] * 20, rate_std=0.15))


def test_a_first_guess_does_not_contradict_what_follows() -> None:
    assert not any(judged([0.5] * 4 + [0.1] * 60))
    assert not any(judged([nan] * 40 + [0.1] * 60))


@given(
    st.lists(st.floats(-1.0, 1.0), max_size=120), st.lists(st.floats(-0.5, 0.5), min_size=120, max_size=120)
)
def test_the_mirrored_flight_is_doubted_where_this_one_is(offsets: list[float], rates: list[float]) -> None:
    rates = rates[: len(offsets)]
    assert judged(offsets, rates) == judged([-y for y in offsets], [-v for v in rates])


@given(st.lists(st.floats(0.001, 3.0), max_size=200))
def test_what_is_remembered_is_bounded(intervals_s: list[float]) -> None:
    relied_on, t_ns = ReliedOn(), 0
    for dt_s in intervals_s:
        t_ns += round(dt_s * 1e9)
        relied_on = relied_on.moved_on(0.1, t_ns).with_offset(0.0, t_ns)
        assert len(relied_on.t_ns) == len(relied_on.origin_norm) <= 41
        assert all(0 <= t_ns - t < CONTRADICTED_S * 1e9 for t in relied_on.t_ns)


@pytest.fixture(scope="module")
def beside_a_step() -> tuple[Table, Table]:
    """Filter's and smoother's rows of a vehicle that stands still while its frames begin to show other walls."""
    config = FusionConfig(corridor_width_m=2.0)
    recorder = Recorder(config, (ImuSample,))
    estimator = CorridorEstimator(config, on_final=recorder.take)
    for k in range(1200):
        t_ns = 10 * MS * k
        estimator.add_imu(t_ns, (0.0, 0.0, 0.0), AT_REST)
        if k % 5 == 0:
            estimator.add_measurement(t_ns, frame(0.1, lateral=0.1 if k < 400 else 0.5, lateral_std=0.02))
    estimator.finish()
    recorder.finish()
    return recorder.estimates(), recorder.smoothed()


@pytest.mark.parametrize("table", [0, 1])
def test_other_walls_are_not_told_as_the_offset_until_time_has_passed(
    beside_a_step: tuple[Table, Table], table: int
) -> None:
    rows = beside_a_step[table]
    t_s = 0.01 * np.arange(len(rows))
    known = rows["lateral_status"] == "known"
    offset = rows["lateral_offset_norm"]
    assert known[(t_s > 2.0) & (t_s < 3.5)].all()
    np.testing.assert_allclose(offset[known & (t_s < 4.0)], 0.1, atol=0.05)
    assert not known[(t_s > 5.0) & (t_s < 6.0)].any()
    assert known[t_s > 8.5].all()
    np.testing.assert_allclose(offset[t_s > 8.5], 0.5, atol=0.05)
