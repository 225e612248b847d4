"""Values of a stream at times between its samples."""

from __future__ import annotations

import numpy as np

from fusion.flight import AttitudeStream, FloatArray, TimeArray, VectorStream
from fusion.logs.samples import BoolArray, IndexArray

MAX_ATTITUDE_GAP_NS = 500_000_000


def interpolated(samples: VectorStream, t_ns: TimeArray, max_gap_ns: int) -> FloatArray:
    """Values (m, 3) at times (m,); NaN outside the samples and in their gaps."""
    before, after, share, known = _around(samples.t_ns, t_ns, max_gap_ns)
    values = (1.0 - share) * samples.xyz[before] + share * samples.xyz[after]
    return np.where(known[:, None], values, np.nan)


def attitude_at(
    attitude: AttitudeStream,
    t_ns: TimeArray,
    max_gap_ns: int = MAX_ATTITUDE_GAP_NS,
    hold_ns: int = 0,
) -> tuple[FloatArray, BoolArray]:
    """Attitude between samples, by normalised linear interpolation of neighbours, which are close together.

    Parameters
    ----------
    attitude
        At least one sample.
    t_ns
        Times (m,).
    max_gap_ns
        Longest step between samples that is interpolated.
    hold_ns
        Time for which the nearest sample is held, beyond the ends and in longer steps.

    Returns
    -------
    q_world_body, known
        Unit quaternions (m, 4), and whether the attitude is known (m,).
    """
    before, after, share, known = _around(attitude.t_ns, t_ns, max_gap_ns)
    q0, q1 = attitude.q_world_body[before], attitude.q_world_body[after]
    q1 = np.where(np.sum(q0 * q1, axis=1, keepdims=True) < 0.0, -q1, q1)
    q = (1.0 - share) * q0 + share * q1
    length = np.linalg.norm(q, axis=1, keepdims=True)
    q = np.where(length > 0.1, q / np.maximum(length, 0.1), q0)
    to_before, to_after = np.abs(t_ns - attitude.t_ns[before]), np.abs(attitude.t_ns[after] - t_ns)
    held = ~known & (np.minimum(to_before, to_after) <= hold_ns)
    nearest = np.where((to_before <= to_after)[:, None], q0, q1)
    return np.where(held[:, None], nearest, q), known | held


def _around(
    known_ns: TimeArray, t_ns: TimeArray, max_gap_ns: int
) -> tuple[IndexArray, IndexArray, FloatArray, BoolArray]:
    """Find the samples around each time (m,), its fraction between them (m, 1), and whether they are close."""
    last = len(known_ns) - 1
    after = np.clip(np.searchsorted(known_ns, t_ns), 0, last)
    exact = known_ns[after] == t_ns
    before = np.where(exact, after, np.clip(after - 1, 0, last))
    gap_ns = known_ns[after] - known_ns[before]
    inside = (t_ns > known_ns[before]) & (t_ns < known_ns[after]) & (gap_ns <= max_gap_ns)
    share = np.where(inside, (t_ns - known_ns[before]) / np.maximum(gap_ns, 1), 0.0)
    return before, after, share[:, None], np.asarray(exact | inside)
