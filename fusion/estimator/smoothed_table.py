"""Builds the table of smoothed estimates from the filter's table and steps."""

from __future__ import annotations

from math import nan, sqrt

import numpy as np
import numpy.typing as npt

from fusion.estimator.config import FusionConfig
from fusion.estimator.lateral.gaussian_sum import OffsetModel, OffsetReadout
from fusion.estimator.lateral.kernels import Y
from fusion.estimator.lateral.smoother import KNOWN_PROBABILITY, OffsetSteps, at_times, smoothed_offsets
from fusion.estimator.lateral.status import LateralReason, LateralStatus
from fusion.estimator.lateral.updates import offset_model
from fusion.estimator.models import BIAS, PSI, YAW_OFFSET, FloatArray
from fusion.estimator.smoother import SmoothedSteps, Steps
from fusion.estimator.tables import HYPOTHESIS_DTYPE, Table, position_names
from vision.rotations import wrap, wrap_axis

KNOWN_IMU_YAW_STD_RAD = 0.5


def smoothed_table(
    table: Table,
    row_steps: npt.NDArray[np.int64],
    steps: Steps,
    offset_steps: OffsetSteps,
    config: FusionConfig,
) -> Table:
    """Smooth a filter's table.

    Status, ages and corridor are the filter's, except that a change of corridor, which the filter only detects after
    the turn, is moved back to the turn.

    Parameters
    ----------
    table
        Filter's table of `fusion.estimator.tables.ESTIMATE_DTYPE`.
    row_steps
        Index (n,) of the last step before each row.
    steps
        Steps of the engine; they are consumed.
    offset_steps
        Steps of the lateral offset.
    config
        Settings.
    """
    if (row_steps < 0).all():  # no rows, or none after a step
        return table.copy()
    found = steps.smoothed()
    out = table.copy()
    _smooth_heading(out, table, row_steps, found)
    _smooth_offset(out, offset_steps, config)
    _move_corridor_changes(out, row_steps, found, config)
    half_m = half_widths_m(table, config)
    out["lateral_offset_m"] = out["lateral_offset_norm"] * half_m
    out["lateral_offset_std_m"] = out["lateral_offset_norm_std"] * half_m
    out["position"] = position_names(out["lateral_offset_norm"], config)
    return out


def _smooth_heading(out: Table, table: Table, row_steps: npt.NDArray[np.int64], found: SmoothedSteps) -> None:
    """Fill in the states of the heading's filter."""
    at = found.x[row_steps]
    std = np.sqrt(np.maximum(found.variance[row_steps], 0.0))
    # The filter's sigma also contains errors outside its covariance: by the camera's delay, and common to all frames.
    outside = np.maximum(table["heading_std_rad"] ** 2 - found.filter_variance[row_steps], 0.0)
    outside[table["status"] == "initialising"] = 0.0
    std[:, PSI] = np.sqrt(std[:, PSI] ** 2 + outside)
    started = bool((table["status"] != "initialising").any())
    heading = at[:, PSI] if started else np.full(len(table), nan)
    out["heading_rad"] = wrap(heading)
    out["heading_std_rad"] = std[:, PSI] if started else nan
    # The raw rate is the filter's corrected rate plus its bias; only the bias changes by smoothing.
    out["yaw_rate_rad_s"] = table["yaw_rate_rad_s"] + found.filter_bias[row_steps] - at[:, BIAS]
    out["gyro_bias_rad_s"] = np.where(np.isfinite(table["gyro_bias_rad_s"]), at[:, BIAS], nan)
    known = (std[:, YAW_OFFSET] < KNOWN_IMU_YAW_STD_RAD) & np.isfinite(table["imu_yaw_offset_rad"]).any()
    out["imu_yaw_offset_rad"] = np.where(known, wrap(at[:, YAW_OFFSET]), nan)


def _smooth_offset(out: Table, steps: OffsetSteps, config: FusionConfig) -> None:
    """Fill in the smoothed lateral offset; after the last step the filter's equals the smoother's."""
    if not steps.steps:
        return
    offsets = smoothed_offsets(steps.steps, offset_model(config))
    start_ns, step_ns = steps.t_ns[0], np.array(steps.t_ns, dtype=np.int64)
    t_s: FloatArray = (out["timestamp_ns"] - start_ns).astype(np.float64) * 1e-9
    step_t_s: FloatArray = (step_ns - start_ns).astype(np.float64) * 1e-9
    within = (t_s >= 0.0) & (t_s <= step_t_s[-1])
    offset, std, known = at_times(step_t_s, offsets, t_s[within])
    out["lateral_offset_norm"][within] = np.where(known, offset, nan)
    out["lateral_offset_norm_std"][within] = np.where(known, std, nan)
    known = np.isfinite(out["lateral_offset_norm"])
    unknown = out["lateral_status"] == LateralStatus.UNKNOWN
    out["lateral_status"][known & unknown] = LateralStatus.KNOWN
    out["lateral_status"][~known] = LateralStatus.UNKNOWN
    out["lateral_reason"][known & unknown] = LateralReason.NONE
    # The filter gives no reason where only the smoother, whose limits are stricter, finds the offset unknown.
    unexplained = ~known & (out["lateral_reason"] == LateralReason.NONE)
    reasons = np.array([_reason_of(step) for step in offsets])
    after = np.clip(np.searchsorted(step_t_s, t_s[unexplained]), 1, len(offsets) - 1)
    out["lateral_reason"][unexplained] = np.where(
        reasons[after] == LateralReason.NONE, reasons[after - 1], reasons[after]
    )


def _reason_of(step: OffsetReadout) -> LateralReason:
    """Return why a smoothed offset is unknown."""
    if step.known:
        return LateralReason.NONE
    if not step.probability > KNOWN_PROBABILITY:
        return LateralReason.AMBIGUOUS
    narrow = step.std_norm < OffsetModel().known_std_norm
    return LateralReason.CONTRADICTED if narrow else LateralReason.UNCERTAIN


def _move_corridor_changes(
    out: Table,
    row_steps: npt.NDArray[np.int64],
    steps: SmoothedSteps,
    config: FusionConfig,
) -> None:
    """Begin each corridor where the heading became nearer to its axis than to that of the last one."""
    index = out["corridor_index"]
    for row in np.flatnonzero(np.diff(index)) + 1:
        step = int(row_steps[row])
        while step > int(row_steps[row - 1]) and not steps.forgets_heading[step]:
            step -= 1
        if not steps.forgets_heading[step]:
            continue
        turn = float(steps.x[step - 1, PSI] - steps.x[step, PSI])
        # The old corridor lasts at least until its last accepted frame.
        age_s = float(out["vision_age_s"][row - 1])
        last_ns = int(out["timestamp_ns"][row - 1]) - (round(age_s * 1e9) if age_s == age_s else 0)
        back = row - 1
        while back >= 0 and out["timestamp_ns"][back] > last_ns:
            old = float(steps.x[row_steps[back], PSI])
            if abs(wrap_axis(old - turn)) >= abs(wrap_axis(old)):
                break
            elapsed_s = (int(out["timestamp_ns"][row]) - int(out["timestamp_ns"][back])) * 1e-9
            out["heading_rad"][back] = wrap(old - turn)
            out["heading_std_rad"][back] = (
                max(steps.variance[step, PSI], 0.0) + config.gyro_noise**2 * elapsed_s
            ) ** 0.5
            out["lateral_offset_norm"][back] = out["lateral_offset_norm_std"][back] = nan
            out["lateral_status"][back] = LateralStatus.UNKNOWN
            out["lateral_reason"][back] = LateralReason.NO_OFFSET
            out["corridor_index"][back] = out["corridor_index"][row]
            out["corridor_turn_rad"][back] = out["corridor_turn_rad"][row]
            back -= 1


def hypotheses_table(steps: OffsetSteps, least_probability: float = 0.02) -> Table:
    """Return the hypotheses after each step, rows of `fusion.estimator.tables.HYPOTHESIS_DTYPE`."""
    rows = []
    for t_ns, step in zip(steps.t_ns, steps.steps, strict=True):
        after = step.after
        if after.path.t_s > 0.0:  # a step of motion alone
            continue
        for x, P, weight in zip(after.x, after.P, after.weight[:-1].tolist(), strict=True):
            if weight >= least_probability:
                rows.append((t_ns, float(x[Y]), sqrt(float(P[Y, Y])), weight))
    return np.array(rows, dtype=HYPOTHESIS_DTYPE)


def half_widths_m(table: Table, config: FusionConfig) -> FloatArray:
    """Return the half width (n,) of each row's corridor: as configured, else the last estimate; NaN without one."""
    if config.corridor_width_m is not None:
        return np.full(len(table), 0.5 * config.corridor_width_m)
    norm = table["lateral_offset_norm_std"]
    ratio = np.where(norm > 0, table["lateral_offset_std_m"] / np.where(norm > 0, norm, 1.0), nan)
    half = np.full(len(table), nan)
    for corridor in np.unique(table["corridor_index"]):
        rows = table["corridor_index"] == corridor
        known = ratio[rows & np.isfinite(ratio)]
        if known.size:
            half[rows] = known[-1]
    return half
