"""Builds the published `Estimate` from a state and a time. Pure functions."""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce
from math import hypot, nan, sqrt
from operator import or_
from statistics import median
from typing import TYPE_CHECKING, Any

import numpy as np

from fusion.estimator.camera_delay import camera_delay, spread_by_delay
from fusion.estimator.config import FusionConfig
from fusion.estimator.faults import Fault
from fusion.estimator.frame_update import FrameSample
from fusion.estimator.lateral.status import LateralReason, LateralStatus, readout, reason_of
from fusion.estimator.lateral.updates import offset_model
from fusion.estimator.models import PSI, level_yaw_rate
from fusion.estimator.notices import ArrivalTimes, Status, notices_of, status_of
from fusion.estimator.propagation import UNKNOWN_HEADING_STD_RAD, ImuSample, Mode
from fusion.estimator.resets import Resets
from fusion.estimator.sample_times import seconds_since
from vision.measurement import position_from_offset
from vision.rotations import wrap, wrap_axis

if TYPE_CHECKING:
    from fusion.estimator.state import State


@dataclass(frozen=True, slots=True)
class Estimate:
    """Heading and lateral offset at one instant; unknown numbers are NaN.

    The fields up to ``vision_age_s`` are the columns of ``estimates.csv``,
    `fusion.estimator.tables.ESTIMATE_COLUMNS`.

    Parameters
    ----------
    timestamp_ns
        Time to which the estimate is predicted: that of the newest sample, or the requested later time.
    heading_rad, heading_std_rad
        Relative to the corridor being flown, positive turned right, in [-pi, pi). The sigma contains those of an
        estimated camera delay, of the errors that successive frames have in common, and, without a gyroscope, of a
        disagreement of frames and attitude.
    lateral_offset_m, lateral_offset_std_m, lateral_offset_norm, lateral_offset_norm_std
        Right of the centre line; in metres if the width is known, and in half widths.
    position
        left, centre or right; empty where unknown.
    yaw_rate_rad_s, gyro_bias_rad_s
        Level yaw rate, corrected by the bias, and the bias.
    imu_yaw_offset_rad
        The IMU's yaw minus the heading in the first corridor's frame.
    corridor_index, corridor_turn_rad
        0 for the first corridor; angle from the first corridor's axis to the present one's, positive right, in
        [-pi, pi).
    status, vision_age_s
        A `Status`; time since the last frame that was used or the last seeded heading.
    reason
        Reason for the status, or a fault while tracking; empty if there is none.
    gyro_age_s, attitude_age_s, lateral_age_s
        Time since the last sample of each, and since the last lateral offset used.
    heading_test_ratio, lateral_test_ratio, imu_yaw_test_ratio
        Last innovation of each, squared over gate squared. Heading and IMU yaw are rejected above 1. The lateral
        offset is never rejected; its ratio is only reported.
    lateral_velocity_norm_s, lateral_velocity_norm_s_std, lateral_velocity_m_s, lateral_velocity_std_m_s
        Rate of the lateral offset: from heading and speed, if there is a velocity stream, and from drift. In half
        widths per second, and in metres per second if the width is known.
    along_velocity_m_s
        Speed along the corridor, positive in the direction of its axis, from the velocity stream; NaN without one.
    reset_count, reset_heading_rad, reset_heading_total_rad
        Number of jumps of the heading (another corridor, a recovery, the first heading after loss or a gap, a late
        sample that changed a published estimate, a seed or a reset), the last jump (new minus old), and the sum of
        all jumps. A controller that needs continuity subtracts the sum: heading less sum is continuous, modulo a
        turn, even if several jumps lie between two calls. The count never decreases. Corrections below 2 degrees do
        not count.
    lateral_reset_count, reset_lateral_norm, reset_lateral_m, reset_lateral_total_norm
        The same for the lateral offset; after a gap, its jump is from the last known offset to the next known one.
    roll_rad, pitch_rad
        The tilt in use.
    camera_delay_s, camera_delay_std_s
        Delay of the frames' time stamps, as configured or as estimated; sigma is NaN if it is not estimated.
    lateral_status, lateral_probability
        A `LateralStatus`; the probability that the offset is within 0.1 half widths of the most probable hypothesis,
        whether or not the offset is reported.
    lateral_reason
        Why the lateral offset is unknown or coasting, a `fusion.estimator.lateral.status.LateralReason`; empty while
        it is known.
    faults
        The faults in ``reason`` as a bit field, see `fusion.estimator.faults.Fault`.
    """

    timestamp_ns: int
    heading_rad: float = nan
    heading_std_rad: float = nan
    lateral_offset_m: float = nan
    lateral_offset_std_m: float = nan
    lateral_offset_norm: float = nan
    lateral_offset_norm_std: float = nan
    position: str = ""
    yaw_rate_rad_s: float = nan
    gyro_bias_rad_s: float = nan
    imu_yaw_offset_rad: float = nan
    corridor_index: int = 0
    corridor_turn_rad: float = 0.0
    status: str = Status.INITIALISING
    vision_age_s: float = nan
    reason: str = ""
    gyro_age_s: float = nan
    attitude_age_s: float = nan
    lateral_age_s: float = nan
    heading_test_ratio: float = nan
    lateral_test_ratio: float = nan
    imu_yaw_test_ratio: float = nan
    lateral_velocity_norm_s: float = nan
    lateral_velocity_norm_s_std: float = nan
    lateral_velocity_m_s: float = nan
    lateral_velocity_std_m_s: float = nan
    along_velocity_m_s: float = nan
    reset_count: int = 0
    reset_heading_rad: float = 0.0
    lateral_reset_count: int = 0
    reset_lateral_norm: float = 0.0
    reset_lateral_m: float = 0.0
    roll_rad: float = nan
    pitch_rad: float = nan
    camera_delay_s: float = nan
    camera_delay_std_s: float = nan
    lateral_status: str = LateralStatus.UNKNOWN
    lateral_probability: float = 0.0
    faults: Fault = Fault.NONE
    reset_heading_total_rad: float = 0.0
    reset_lateral_total_norm: float = 0.0
    lateral_reason: str = LateralReason.NO_FRAME


def estimate_of(
    state: State,
    config: FusionConfig,
    t_ns: int | None = None,
    arrivals: ArrivalTimes | None = None,
    resets: Resets | None = None,
) -> Estimate:
    """Report a state at its own time; ages and status may be those at a later time.

    ``arrivals`` as in `status_of`; ``resets`` are the published jumps. None: those of the state, without sums.
    """
    resets = _resets_of(state) if resets is None else resets
    if state.t_ns is None:
        return Estimate(
            0 if t_ns is None else t_ns,
            reason="no sample yet",
            faults=Fault.NOT_STARTED,
            **_reset_fields(resets),
        )
    t = state.t_ns if t_ns is None else t_ns
    reckoning, axis, lateral, half = state.reckoning, state.axis, state.lateral, state.width.half_m(config)
    psi, bias, yaw_offset = state.x.tolist()
    heading, heading_std = heading_of(state)
    if arrivals is not None and axis.ever_acquired:
        heading_std = hypot(heading_std, _late_gyro_std(state, arrivals.latency_ns(ImuSample) * 1e-9, config))
    limit = state.frames.age_limit_s(config)
    if arrivals is not None:
        limit += arrivals.latency_ns(FrameSample) * 1e-9
    model = lateral.model or offset_model(config)
    found = readout(lateral, model, psi, state.velocity, t, limit)
    reason = LateralReason.NONE
    if found.status is not LateralStatus.KNOWN:
        is_old = not seconds_since(t, lateral.t_ns) <= limit  # NaN before the first
        is_unseen = not seconds_since(t, axis.t_vision_ns) <= limit
        reason = reason_of(lateral, is_old, is_unseen, found.probability > model.known_probability)
    position = position_from_offset(found.offset, config.position_dead_band_norm)
    notices = notices_of(state, config, t, heading_std, arrivals)
    delay_s, delay_std_s = camera_delay(state.delay, config)
    gx, gy, gz = state.tilt.down
    return Estimate(
        t,
        wrap(heading),
        heading_std,
        found.offset * half,
        found.offset_std * half,
        found.offset,
        found.offset_std,
        "" if position is None else str(position),
        reckoning.yaw_rate(bias),
        bias if reckoning.mode is Mode.GYRO else nan,
        wrap(yaw_offset) if state.imu_yaw.known else nan,
        axis.corridor_index,
        axis.corridor_turn_rad,
        str(status_of(state, config, t, heading_std, arrivals)),
        seconds_since(t, axis.t_vision_ns),
        reason="; ".join(notice.text for notice in notices),
        gyro_age_s=seconds_since(t, reckoning.t_gyro_ns),
        attitude_age_s=reckoning.attitude.age_s(t),
        lateral_age_s=seconds_since(t, lateral.t_ns),
        heading_test_ratio=axis.test_ratio,
        lateral_test_ratio=lateral.test_ratio,
        imu_yaw_test_ratio=state.imu_yaw.test_ratio,
        lateral_velocity_norm_s=found.rate,
        lateral_velocity_norm_s_std=found.rate_std,
        lateral_velocity_m_s=found.rate * half,
        lateral_velocity_std_m_s=found.rate_std * half,
        along_velocity_m_s=found.along_m_s,
        roll_rad=float(np.arctan2(gy, gz)),
        pitch_rad=float(np.arctan2(-gx, hypot(gy, gz))),
        camera_delay_s=delay_s,
        camera_delay_std_s=delay_std_s,
        lateral_status=str(found.status),
        lateral_reason=str(reason),
        lateral_probability=found.probability,
        faults=reduce(or_, (notice.fault for notice in notices), Fault.NONE),
        **_reset_fields(resets),
    )


def heading_of(state: State) -> tuple[float, float]:
    """Return the heading and its standard deviation."""
    if not state.axis.ever_acquired:
        return _provisional_heading(state)
    std = hypot(sqrt(float(state.P[PSI, PSI])), state.axis.common_std_rad)
    return float(state.x[PSI]), std if state.t_ns is None else spread_by_delay(std, state.delay, state.t_ns)


def _late_gyro_std(state: State, latency_s: float, config: FusionConfig) -> float:
    """Return the sigma of a turn that attitudes have measured and the gyroscope's late samples have not yet.

    IMU samples that always come late, and attitudes stamped ahead, look alike. In the second case the yaw lags by
    the lead; the turn at the last gyroscope's rate, less the yaw's increment, tells by how much the heading is off.
    ``latency_s`` is the IMU samples' usual delay behind the newest stamp.
    """
    d = state.reckoning
    age_s = seconds_since(state.t_ns or 0, d.t_gyro_ns)
    if d.mode is not Mode.ATTITUDE or not config.gyro_gap_s < age_s <= latency_s + config.gyro_gap_s:
        return 0.0
    rate_rad_s = level_yaw_rate(d.gyro_rad_s, state.tilt.down) - d.stored_gyro_bias[0]
    return abs(rate_rad_s * age_s - d.gyro_done_rad)


def _reset_fields(resets: Resets) -> dict[str, Any]:
    """Return the fields of an `Estimate` that report jumps."""
    return {
        "reset_count": resets.heading_count,
        "reset_heading_rad": resets.heading_rad,
        "reset_heading_total_rad": resets.heading_total_rad,
        "lateral_reset_count": resets.lateral_count,
        "reset_lateral_norm": resets.lateral_norm,
        "reset_lateral_m": resets.lateral_m,
        "reset_lateral_total_norm": resets.lateral_total_norm,
    }


def _resets_of(state: State) -> Resets:
    axis, lateral = state.axis, state.lateral
    step_norm, step_m = lateral.reset_norm, lateral.reset_m
    return Resets(axis.reset_count, axis.reset_heading_rad, nan, lateral.reset_count, step_norm, step_m, nan)


def _provisional_heading(state: State) -> tuple[float, float]:
    """Return a heading before acquisition: the median of the frames so far, with a wide sigma."""
    votes = state.axis.votes
    if not votes:
        return nan, nan
    newest = votes[-1].value
    axis = newest + median(wrap_axis(vote.value - newest) for vote in votes)
    return wrap_axis(state.reckoning.theta_rad - axis), UNKNOWN_HEADING_STD_RAD / (3.0 + len(votes))
