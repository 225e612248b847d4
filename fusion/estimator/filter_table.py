"""Builds the filter's table from states in order of time.

The values are those of `fusion.estimator.estimate.estimate_of`. A flight has millions of rows, so the rows between
two frames are computed together.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain, groupby
from math import nan
from typing import TYPE_CHECKING

import numpy as np

from fusion.estimator.config import FusionConfig
from fusion.estimator.estimate import heading_of
from fusion.estimator.gyro_run import GyroRun
from fusion.estimator.gyro_run_kernel import PATH_S, RATE
from fusion.estimator.lateral.gaussian_sum import OffsetModel, OffsetState, lasting_variances, motion_noise
from fusion.estimator.lateral.kernels import N_LATERAL, MotionNoise, fill_transition, moved
from fusion.estimator.lateral.mixture_kernels import summarised
from fusion.estimator.lateral.status import LateralReason, LateralStatus, reason_of
from fusion.estimator.lateral.updates import offset_model
from fusion.estimator.models import BIAS, N_STATES, PSI, YAW_OFFSET, FloatArray
from fusion.estimator.propagation import Mode
from fusion.estimator.tables import ESTIMATE_DTYPE, Table, position_names
from vision.compiled import compiled
from vision.rotations import wrap
from vision.types import BoolArray, IntArray

if TYPE_CHECKING:
    from fusion.estimator.state import State


def filter_table(states: Sequence[State], statuses: Sequence[str], config: FusionConfig) -> Table:
    """Report states of a complete log as rows of `fusion.estimator.tables.ESTIMATE_DTYPE`.

    Parameters
    ----------
    states
        At least one state; all after the first sample.
    statuses
        The `fusion.estimator.notices.Status` of each.
    config
        Settings.
    """
    n, reckoned = len(states), [s.reckoning for s in states]
    mode, (no_mode, _, by_gyro) = [d.mode for d in reckoned], Mode
    table = np.empty(n, dtype=ESTIMATE_DTYPE)
    x = np.concatenate([s.x for s in states]).reshape(n, N_STATES)
    P = np.concatenate([s.P for s in states]).reshape(n, N_STATES, N_STATES)
    common = np.array([s.axis.common_std_rad for s in states])
    heading, std, bias = x[:, PSI].copy(), np.hypot(np.sqrt(P[:, PSI, PSI]), common), x[:, BIAS]
    for k, s in enumerate(states):
        if s.delay is not None or not s.axis.ever_acquired:
            heading[k], std[k] = heading_of(s)
    table["timestamp_ns"] = [d.t_ns for d in reckoned]
    table["heading_rad"], table["heading_std_rad"] = wrap(heading), std
    rate = np.array([d.rate_rad_s for d in reckoned]) - bias
    table["yaw_rate_rad_s"] = np.where([m is no_mode for m in mode], -bias, rate)
    table["gyro_bias_rad_s"] = np.where([m is by_gyro for m in mode], bias, nan)
    known = [s.imu_yaw.known for s in states]
    table["imu_yaw_offset_rad"] = np.where(known, wrap(x[:, YAW_OFFSET]), nan)
    table["status"] = statuses
    first = 0
    for _, group in groupby(states, _between_frames):
        like = list(group)
        numbers = chain.from_iterable(state.lateral.offset.path for state in like)
        paths = np.fromiter(numbers, np.float64).reshape(len(like), -1)
        _fill_by_frame(table[first : first + len(like)], like[0], paths, config)
        first += len(like)
    table["position"] = position_names(table["lateral_offset_norm"], config)
    return table


def run_table(run: GyroRun, places: IntArray, status: str, config: FusionConfig) -> Table:
    """Report the states after samples of a run, as `filter_table` does: all have the same status.

    The heading must be known, and the camera's delay configured.
    """
    s, table = run.start, np.empty(len(places), dtype=ESTIMATE_DTYPE)
    x, propagated = run.x[places], run.propagated[places]
    table["timestamp_ns"] = run.good.t_ns[places]
    table["heading_rad"] = wrap(x[:, PSI])
    table["heading_std_rad"] = run.heading_std_rad(places)
    table["yaw_rate_rad_s"] = propagated[:, RATE] - x[:, BIAS]
    table["gyro_bias_rad_s"] = x[:, BIAS]
    table["imu_yaw_offset_rad"] = wrap(x[:, YAW_OFFSET]) if s.imu_yaw.known else nan
    table["status"] = status
    paths = np.ascontiguousarray(propagated[:, PATH_S : PATH_S + len(s.lateral.offset.path)])
    _fill_by_frame(table, s, paths, config)
    table["position"] = position_names(table["lateral_offset_norm"], config)
    return table


def _between_frames(s: State) -> tuple[object, ...]:
    """Return the key of rows that are computed together: the parts of the state that only frames change."""
    lateral, offset = s.lateral, s.lateral.offset
    kept = (s.axis, s.width, s.frames, offset.x, offset.P, offset.weight, lateral.model, lateral.section)
    return (*map(id, kept), offset.spread2, lateral.t_ns, lateral.contradicted)


def _fill_by_frame(rows: Table, s: State, paths: FloatArray, config: FusionConfig) -> None:
    """Fill in the columns that depend on frames, for states between two frames that differ by paths (n, 6)."""
    axis, lateral, half_m = s.axis, s.lateral, s.width.half_m(config)
    rows["corridor_index"], rows["corridor_turn_rad"] = axis.corridor_index, axis.corridor_turn_rad
    rows["vision_age_s"] = _ages_s(rows, axis.t_vision_ns)
    rows["lateral_age_s"] = ages_s = _ages_s(rows, lateral.t_ns)
    offset, std, probable, narrow = _offsets_along(
        lateral.offset, paths, lateral.model or offset_model(config)
    )
    known = probable & narrow & (not lateral.contradicted)
    offset, std = np.where(known, offset, nan), np.where(known, std, nan)
    rows["lateral_offset_m"], rows["lateral_offset_std_m"] = offset * half_m, std * half_m
    rows["lateral_offset_norm"], rows["lateral_offset_norm_std"] = offset, std
    limit_s = s.frames.age_limit_s(config)
    recent = ages_s <= limit_s
    by_age = np.where(recent, LateralStatus.KNOWN, LateralStatus.COASTING)
    rows["lateral_status"] = np.where(known, by_age, LateralStatus.UNKNOWN)
    rows["lateral_reason"] = LateralReason.NONE
    lacking = ~(known & recent)
    if lacking.any():
        seen = rows["vision_age_s"] <= limit_s
        reasons = [reason_of(lateral, k < 4, k % 4 < 2, k % 2 == 1) for k in range(8)]
        rows["lateral_reason"][lacking] = np.array(reasons)[4 * recent + 2 * seen + probable][lacking]


def _ages_s(rows: Table, then_ns: int | None) -> FloatArray:
    """Return the age (n,) at each row; NaN if ``then_ns`` is None."""
    if then_ns is None:
        return np.full(len(rows), nan)
    return np.asarray((rows["timestamp_ns"] - then_ns) * 1e-9)


def _offsets_along(
    state: OffsetState, paths: FloatArray, model: OffsetModel
) -> tuple[FloatArray, FloatArray, BoolArray, BoolArray]:
    """Return offset (n,), sigma (n,), whether it is probable, and narrow enough, at the ends of paths (n, 6)."""
    n = len(paths)
    if not len(state.x):
        return np.full(n, nan), np.full(n, nan), np.zeros(n, np.bool_), np.zeros(n, np.bool_)
    found = np.empty((n, 3))
    hypotheses, noise = (state.x, state.P, state.weight[:-1]), motion_noise(model)
    shared = (model.tolerance_norm, lasting_variances(state, model), model.scale_std)
    _summarise_along(hypotheses, paths, noise, shared, found)
    offset, std, probability = found.T
    return offset, std, probability > model.known_probability, std < model.known_std_norm


@compiled
def _summarise_along(
    hypotheses: tuple[FloatArray, FloatArray, FloatArray],
    paths: FloatArray,
    noise: MotionNoise,
    shared: tuple[float, tuple[float, float], float],
    out: FloatArray,
) -> None:
    """Fill in offset, standard deviation and probability (n, 3) at the ends of paths (n, 6) of the same hypotheses.

    ``hypotheses`` are x (k, 4), P (k, 4, 4) and weight (k,), ``noise`` is that of
    `fusion.estimator.lateral.kernels.fill_transition`, ``shared`` what `summarised` takes last.
    """
    x, P, weight = hypotheses
    tolerance, lasting, scale = shared
    F, Q = np.empty((N_LATERAL, N_LATERAL)), np.empty((N_LATERAL, N_LATERAL))
    x_end, P_end = np.empty_like(x), np.empty_like(P)
    for k in range(len(paths)):
        x_there, P_there = x, P
        if paths[k, 0] > 0.0:
            path = (paths[k, 0], paths[k, 1], paths[k, 2], paths[k, 3], paths[k, 4], paths[k, 5])
            fill_transition(path, noise, False, F, Q)
            moved(x, P, F, Q, x_end, P_end)
            x_there, P_there = x_end, P_end
        offset, std, _, _, probability = summarised(x_there, P_there, weight, tolerance, lasting, scale)
        out[k, 0], out[k, 1], out[k, 2] = offset, std, probability
