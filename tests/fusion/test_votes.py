"""When votes agree: around the newest, whatever else was said before."""

from __future__ import annotations

from math import pi, radians

import pytest

from fusion.estimator.votes import MAX_VOTES, Vote, add_vote, agreement
from vision.rotations import wrap_axis

S = 1_000_000_000


def votes(*values: float, accepted: int = 0, start_s: float = 0.0) -> tuple[Vote, ...]:
    return tuple(Vote(round((start_s + 0.04 * i) * S), v, 0.01, accepted) for i, v in enumerate(values))


def test_no_votes_agree_on_nothing() -> None:
    assert agreement((), 0.1) is None


def test_the_cluster_of_the_newest_counts() -> None:
    found = agreement(votes(1.0, 0.1, 1.02, 0.12, 0.11, 0.98, 0.13), 0.05)
    assert found is not None
    assert found.n_votes == 4
    assert found.value == pytest.approx(0.115)
    assert found.share == pytest.approx(4 / 6)  # of all since the first of them
    assert found.age_s == pytest.approx(0.1)


def test_axes_agree_across_the_half_turn() -> None:
    found = agreement(votes(pi / 2 - 0.01, -pi / 2 + 0.01, pi / 2), 0.05, wrap_axis)
    assert found is not None
    assert found.n_votes == 3
    assert abs(wrap_axis(found.value - pi / 2)) < 0.011


def test_votes_that_drift_as_they_may_agree() -> None:
    """A gyroscope whose bias has a sigma of 0.02 rad/s may drift by 0.04 rad a second, not by 0.06."""
    for rate, n in ((0.04, 5), (-0.04, 5), (0.06, 1)):
        slow = tuple(Vote(k * S, rate * k, 0.002, 0) for k in range(5))
        found = agreement(slow, 0.01, drift_std_per_s=0.02)
        assert found is not None
        assert found.n_votes == n
        alone = agreement(slow, 0.01)
        assert alone is not None
        assert alone.n_votes == 1


def test_old_vote_that_agrees_by_chance_does_not_make_the_others_contested() -> None:
    """Forty frames of the present axis were accepted since the gross error of three seconds ago."""
    old = votes(0.5, accepted=100)
    found = agreement((*old, *votes(*[0.5] * 10, accepted=140, start_s=2.5)), radians(1.5))
    assert found is not None
    assert (found.n_votes, found.n_accepted, found.share) == (10, 140, 1.0)
    assert found.first_ns == round(2.5 * S)


def test_votes_among_accepted_frames_are_one_event() -> None:
    """Every other frame says so: contested it is, and to be told as such."""
    mixed = tuple(Vote(i * S // 10, 0.5, 0.01, 3 * i) for i in range(8))
    found = agreement(mixed, 0.1)
    assert found is not None
    assert (found.n_votes, found.n_accepted) == (8, 0)


def test_old_votes_and_too_many_are_let_go() -> None:
    kept: tuple[Vote, ...] = ()
    for i in range(200):
        kept = add_vote(kept, Vote(i * S // 100, 0.0, 0.01, 0), 1.0)
    assert len(kept) == MAX_VOTES
    assert len(add_vote(kept, Vote(100 * S, 0.0, 0.01, 0), 1.0)) == 1
