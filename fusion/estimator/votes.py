"""Votes: rejected measurements that are kept until several agree. Pure functions.

Votes agree if they lie within ``max(spread, 2.5 sigma)`` of a common centre. The centre is the median of the votes
near the newest one. Used for headings (`fusion.estimator.corridor_axis`).
"""

from __future__ import annotations

from collections.abc import Callable
from statistics import median
from typing import NamedTuple

MAX_VOTES = 60
AGREEING_SHARE = 0.4
CONTESTED_SHARE = 0.25
MAX_ACCEPTED_BETWEEN = 5  # two votes with more accepted frames between them belong to different events


class Vote(NamedTuple):
    """A rejected measurement, kept until others confirm it.

    Parameters
    ----------
    t_ns
        Time of the frame.
    value
        The measurement, in coordinates in which the true value is constant.
    std
        Its standard deviation.
    n_accepted
        Number of frames that the filter had accepted by then.
    linked
        Whether the picture has changed only gradually since a frame that the filter accepted.
    """

    t_ns: int
    value: float
    std: float
    n_accepted: int
    linked: bool = False


class Agreement(NamedTuple):
    """Votes that agree: number, median, the standard deviation of one vote, and the time of the first.

    ``age_s`` is the time from the median vote to the newest. ``share`` is their part of all votes since the first of
    them; ``n_accepted`` and ``linked_share`` are the count at the first vote and the part of linked ones.
    """

    n_votes: int
    value: float
    std: float
    first_ns: int
    age_s: float
    share: float
    n_accepted: int
    linked_share: float


def agreement(
    votes: tuple[Vote, ...],
    spread: float,
    difference: Callable[[float], float] = lambda d: d,
    drift_std_per_s: float = 0.0,
) -> Agreement | None:
    """Find the votes that agree with the newest one.

    Parameters
    ----------
    votes
        In order of time.
    spread
        Smallest tolerance for votes that agree; widened to 2.5 of their standard deviations.
    difference
        Wraps a difference if the values are angles.
    drift_std_per_s
        Standard deviation of the drift rate of the coordinates. The tolerance is widened to 2.5 times the drift in
        the time between two votes.
    """
    if not votes:
        return None
    newest = votes[-1]

    def offsets_from(centre: float, centre_ns: float) -> list[tuple[float, Vote]]:
        def reach(v: Vote) -> float:
            drift_std = drift_std_per_s * abs(v.t_ns - centre_ns) * 1e-9
            return max(spread, 2.5 * max(v.std, newest.std, drift_std))

        return [(d, v) for v in votes if abs(d := difference(v.value - centre)) <= reach(v)]

    # First around the newest vote, then around the votes near it: the newest may lie at the edge of the cluster.
    members = offsets_from(newest.value, newest.t_ns)
    centre = newest.value + median(d for d, _ in members)
    members = offsets_from(centre, median(v.t_ns for _, v in members))
    if not members:
        return None
    # Drop an old outlier that agrees by chance.
    start = max(
        (
            k
            for k in range(1, len(members))
            if members[k][1].n_accepted - members[k - 1][1].n_accepted > MAX_ACCEPTED_BETWEEN
        ),
        default=0,
    )
    members = members[start:]
    first = members[0][1]
    since = sum(1 for v in votes if v.t_ns >= first.t_ns)
    return Agreement(
        n_votes=len(members),
        value=centre + median(d for d, _ in members),
        std=median(v.std for _, v in members),
        first_ns=first.t_ns,
        age_s=(newest.t_ns - median(v.t_ns for _, v in members)) * 1e-9,
        share=len(members) / since,
        n_accepted=first.n_accepted,
        linked_share=sum(v.linked for _, v in members) / len(members),
    )


def is_contested(found: Agreement, n_accepted: int) -> bool:
    """Whether the filter, with ``n_accepted`` frames by now, has accepted too many others since the first vote."""
    return n_accepted - found.n_accepted > CONTESTED_SHARE * found.n_votes


def add_vote(votes: tuple[Vote, ...], vote: Vote, max_age_s: float) -> tuple[Vote, ...]:
    """Append a vote and drop old ones."""
    oldest = vote.t_ns - round(max_age_s * 1e9)
    return (*(v for v in votes[-(MAX_VOTES - 1) :] if v.t_ns >= oldest), vote)
