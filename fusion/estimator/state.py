"""What the engine knows at one instant, and the `Estimate` it reports of it."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from math import cos, hypot, isfinite, nan, pi, sin, sqrt
from statistics import median
from typing import NamedTuple

import numpy as np

from fusion.estimator.camera_delay import Delay, camera_delay, spread_by_delay
from fusion.estimator.config import FusionConfig
from fusion.estimator.imu_yaw_check import Trace, YawWatch
from fusion.estimator.models import BIAS, OFFSET, PSI, FloatArray, V, Y, wrap, wrap_axis
from fusion.estimator.noise_adaptation import Trust
from fusion.estimator.range_width import Heights, Widths
from fusion.estimator.tilt import Tilt, Vector
from fusion.estimator.votes import Vote
from vision.measurement import position_from_offset

UNKNOWN_HEADING_STD_RAD = pi / 2
UNKNOWN_OFFSET_STD_RAD = 10.0
UNKNOWN_LATERAL_STD = 1.0
VELOCITY_AGE_S = 0.5


class Status(StrEnum):
    """How far the heading can be relied on; the words of the ``status`` column."""

    INITIALISING = "initialising"  # no heading yet
    TRACKING = "tracking"  # recent frames confirm it
    COASTING = "coasting"  # carried on by gyroscope or attitude alone
    LOST = "lost"  # carried on for too long, or too uncertain


class Mode(StrEnum):
    """What carries the heading between frames."""

    NONE = "none"  # a rate assumed constant
    ATTITUDE = "attitude"  # yaw increments of the attitude stream
    GYRO = "gyro"


@dataclass(frozen=True, slots=True)
class Estimate:
    """Heading and lateral offset at one instant; unknown numbers are NaN.

    The fields up to ``vision_age_s`` are the columns of ``estimates.csv``.

    Parameters
    ----------
    timestamp_ns
        Time of the newest sample, to which the estimate is predicted.
    heading_rad, heading_std_rad
        Relative to the corridor being flown, positive turned right, in [-pi, pi).
    lateral_offset_m, lateral_offset_std_m, lateral_offset_norm, lateral_offset_norm_std
        Right of the centre line; in metres where the width is known, and over half the width.
    position
        left, centre or right; empty where unknown.
    yaw_rate_rad_s, gyro_bias_rad_s
        Level yaw rate, corrected by the bias, and the bias.
    imu_yaw_offset_rad
        The IMU's yaw minus the heading in the first corridor's frame.
    corridor_index, corridor_turn_rad
        0 for the first corridor; angle of the present one's axis from the first one's, positive right.
    status, vision_age_s
        A `Status`; time since the last frame that was used.
    reason
        Why the status is what it is, or what is amiss though tracking; empty where all is well.
    gyro_age_s, attitude_age_s, lateral_age_s
        Time since the last sample of each, and since the last lateral offset used.
    heading_test_ratio, lateral_test_ratio, imu_yaw_test_ratio
        Of the last innovation of each: squared over gate squared; above 1 rejected.
    lateral_velocity_norm_s, lateral_velocity_norm_s_std, lateral_velocity_m_s, lateral_velocity_std_m_s
        How fast the lateral offset grows, by all that moves it: heading and speed, where a velocity stream tells it,
        and drift. In half widths per second, and in metres per second where the width is known.
    along_velocity_m_s
        Speed along the corridor in the sense of its axis, from the velocity stream; NaN without.
    reset_count, reset_heading_rad
        How often the heading jumped (another corridor, a recovery, found again after loss), and by how much at the
        last time, new minus old: a controller that needs continuity takes the step off whenever the count goes up.
    lateral_reset_count, reset_lateral_norm, reset_lateral_m
        The same for the lateral offset; its step is counted from the last one known to the first one known again.
    roll_rad, pitch_rad
        The tilt in use.
    camera_delay_s, camera_delay_std_s
        How late the frames are stamped, as configured or as estimated; NaN sigma where it is not estimated.
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


def _start_covariance() -> FloatArray:
    return np.diag(
        [UNKNOWN_HEADING_STD_RAD**2, 0.02**2, UNKNOWN_OFFSET_STD_RAD**2, UNKNOWN_LATERAL_STD**2, 0.3**2]
    )


class PreviousAxis(NamedTuple):
    """The corridor left last: axis in the dead-reckoned frame, index, turn, when, lateral offsets used by then."""

    axis_rad: float
    corridor_index: int
    corridor_turn_rad: float
    left_ns: int
    n_lateral: int


@dataclass(eq=False)
class State:
    """Everything the engine's next step depends on.

    Every value in it is immutable or never written into, so that `copy` is a complete snapshot at the price of
    one dictionary. Angles named ``theta`` are in the dead-reckoned frame: the sum of all yaw increments since the
    start, without corrections.
    """

    x: FloatArray = field(default_factory=lambda: np.zeros(5))
    P: FloatArray = field(default_factory=_start_covariance)
    t_ns: int | None = None
    tilt: Tilt = field(default_factory=Tilt)
    mode: Mode = Mode.NONE
    gyro_bias: tuple[float, float] = (0.0, 0.02**2)  # mean, variance, put by while another mode runs

    t_gyro_ns: int | None = None
    gyro: Vector = (0.0, 0.0, 0.0)
    gyro_done_rad: float = 0.0  # already propagated since t_gyro_ns
    rate_rad_s: float = 0.0  # level yaw rate, at t_gyro_ns or over the last attitude interval
    t_attitude_ns: int | None = None
    yaw_rad: float = nan  # of the last attitude sample
    yaw_done_rad: float = 0.0  # already propagated since then
    theta_rad: float = 0.0
    raw_theta_rad: float = 0.0  # the same without taking off the bias
    attitude_interval_s: float = nan
    t_velocity_ns: int | None = None
    velocity_interval_s: float = nan
    forward_m_s: float = 0.0
    sideways_m_s: float = 0.0
    t_range_ns: int | None = None
    range_interval_s: float = nan
    heights: Heights = field(default_factory=Heights)

    imu_yaw_known: bool = False
    imu_yaw_coupled: bool = False  # whether o is correlated with the rest
    imu_yaw_rejects: int = 0
    yaw_watch: YawWatch = field(default_factory=YawWatch)
    yaw_traces: tuple[Trace, ...] = ()
    imu_yaw_ratio: float = nan

    acquired: bool = False  # a heading was found and not lost since
    ever_acquired: bool = False
    corridor_index: int = 0
    n_corridors: int = 1
    corridor_turn_rad: float = 0.0
    reset_count: int = 0
    reset_heading_rad: float = 0.0

    t_frame_ns: int | None = None
    frame_interval_s: float = nan
    t_vision_ns: int | None = None  # last frame used
    n_accepted: int = 0
    support_s: float = 0.0  # time over which frames have confirmed the present axis
    anchor_rad: float = nan  # axis in the dead-reckoned frame when a frame last confirmed it
    facing_rad: float = 0.0  # pi where it then faced against the axis
    heading_trust: Trust = field(default_factory=Trust)
    votes: tuple[Vote, ...] = ()
    recent: tuple[
        tuple[int, float, bool], ...
    ] = ()  # time, heading, linked: of the last frames that saw an axis
    heading_ratio: float = nan
    rival: tuple[float, int, int] | None = None  # axis that rejected frames agree on, since when, seen last
    previous_axis: PreviousAxis | None = None
    elevation: tuple[float, float] = (0.0, (3.0 * pi / 180) ** 2)  # mean, variance

    lateral_acquired: bool = False
    t_lateral_ns: int | None = None
    n_lateral: int = 0
    lateral_trust: Trust = field(default_factory=Trust)
    lateral_votes: tuple[Vote, ...] = ()
    lateral_ratio: float = nan
    lateral_left: tuple[float, float] = (nan, nan)  # last offset known, half widths and metres, while none is
    lateral_reset_count: int = 0
    lateral_reset: tuple[float, float] = (0.0, 0.0)  # last step, half widths and metres
    width_per_height: float = nan
    n_width: int = 0
    widths: Widths = field(default_factory=Widths)
    delay: Delay | None = None  # of the camera, where it is estimated

    def copy(self) -> State:
        """Snapshot of the state."""
        twin = object.__new__(State)
        twin.__dict__.update(self.__dict__)
        return twin


def half_width_m(state: State, config: FusionConfig) -> float:
    """Half the corridor's width, metres; NaN where neither it nor the camera's height is told or measured."""
    if config.corridor_width_m is not None:
        return 0.5 * config.corridor_width_m
    if config.camera_height_m is not None:
        return 0.5 * config.camera_height_m * state.width_per_height
    return 0.5 * state.widths.width_m


def next_interval_s(old_s: float, last_ns: int | None, t_ns: int) -> float:
    """Mean time between a source's samples, with the newest; NaN before the second."""
    if last_ns is None:
        return old_s
    interval_s = (t_ns - last_ns) * 1e-9
    return 0.8 * old_s + 0.2 * min(interval_s, 3 * old_s) if isfinite(old_s) else interval_s


def _age_limit_s(interval_s: float, config: FusionConfig) -> float:
    return max(config.coasting_after_s, 2.5 * interval_s) if isfinite(interval_s) else config.coasting_after_s


def frame_age_limit_s(state: State, config: FusionConfig) -> float:
    """Age of vision at which it counts as interrupted: cameras of one frame per second are not always coasting."""
    return _age_limit_s(state.frame_interval_s, config)


def seconds_since(t_ns: int, then_ns: int | None) -> float:
    """Age in seconds; NaN where it never was."""
    return nan if then_ns is None else (t_ns - then_ns) * 1e-9


def is_moving(state: State, t_ns: int) -> bool:
    """Whether the velocity stream tells how the vehicle moves."""
    return seconds_since(t_ns, state.t_velocity_ns) <= VELOCITY_AGE_S


def judge(state: State, config: FusionConfig, t_ns: int, heading_std_rad: float) -> tuple[Status, str]:
    """Status at ``t_ns`` and its reason; sources that have fallen silent are told of whatever the status."""
    if not state.ever_acquired:
        return Status.INITIALISING, "waiting for frames that agree" if state.votes else "no usable frame yet"
    age, limit = seconds_since(t_ns, state.t_vision_ns), frame_age_limit_s(state, config)
    if heading_std_rad > config.lost_heading_std_rad:
        status, reasons = Status.LOST, ["heading is too uncertain"]
    elif age > config.lost_after_s:
        status, reasons = Status.LOST, [f"no usable frame for {age:.0f} s"]
    elif age > limit:
        silent = seconds_since(t_ns, state.t_frame_ns) > limit
        status, reasons = Status.COASTING, ["no frames arrive" if silent else "frames are rejected"]
    else:
        status, reasons = Status.TRACKING, []
        if state.lateral_acquired and seconds_since(t_ns, state.t_lateral_ns) > limit:
            reasons.append("frames show no lateral offset")
    if seconds_since(t_ns, state.t_gyro_ns) > config.gyro_gap_s:
        reasons.append("gyroscope is silent")
    if seconds_since(t_ns, state.t_attitude_ns) > _age_limit_s(state.attitude_interval_s, config):
        reasons.append("attitude is silent")
    if seconds_since(t_ns, state.t_velocity_ns) > _age_limit_s(state.velocity_interval_s, config):
        reasons.append("velocity is silent")
    if seconds_since(t_ns, state.t_range_ns) > _age_limit_s(state.range_interval_s, config):
        reasons.append("range sensor is silent")
    return status, "; ".join(reasons)


class _Motion(NamedTuple):
    """Rate of the lateral offset and its standard deviation, half widths per second; speed along the axis, m/s."""

    lateral: float = nan
    lateral_std: float = nan
    along: float = nan


def _motion(state: State, t_ns: int, half_m: float) -> _Motion:
    psi, v, p = float(state.x[PSI]), float(state.x[V]), state.P
    along, c, lateral = nan, 0.0, 0.0
    if is_moving(state, t_ns):
        along = state.forward_m_s * cos(psi) - state.sideways_m_s * sin(psi)
        across = state.forward_m_s * sin(psi) + state.sideways_m_s * cos(psi)
        scale = half_m if half_m > 0.0 else 1.0  # as the filter does where the width is unknown
        c, lateral = along / scale, across / scale
    if not state.lateral_acquired:
        return _Motion(along=along)
    variance = float(p[V, V]) + 2.0 * c * float(p[PSI, V]) + c * c * float(p[PSI, PSI])
    return _Motion(lateral + v, sqrt(max(variance, 0.0)), along)


def describe(state: State, config: FusionConfig, t_ns: int | None = None) -> Estimate:
    """Report a state, at its own time or (ages and status only) at a later one."""
    if state.t_ns is None:
        return Estimate(0 if t_ns is None else t_ns, reason="no sample yet")
    t = state.t_ns if t_ns is None else t_ns
    psi, bias, offset, y, _ = state.x.tolist()
    p = state.P
    heading, heading_std = psi, spread_by_delay(sqrt(float(p[PSI, PSI])), state.delay, state.t_ns)
    delay_s, delay_std_s = camera_delay(state.delay, config)
    if not state.ever_acquired:
        heading, heading_std = _provisional(state)
    status, reason = judge(state, config, t, heading_std)
    norm = norm_std = nan
    if state.lateral_acquired:
        norm, norm_std = y, sqrt(float(p[Y, Y]))
    half = half_width_m(state, config)
    motion = _motion(state, t, half)
    position = position_from_offset(norm, config.position_dead_band_norm)
    gyro = state.mode is Mode.GYRO
    rate = -bias if state.mode is Mode.NONE else state.rate_rad_s - bias
    gx, gy, gz = state.tilt.down
    return Estimate(
        timestamp_ns=t,
        heading_rad=wrap(heading),
        heading_std_rad=heading_std,
        lateral_offset_m=norm * half,
        lateral_offset_std_m=norm_std * half,
        lateral_offset_norm=norm,
        lateral_offset_norm_std=norm_std,
        position="" if position is None else str(position),
        yaw_rate_rad_s=rate,
        gyro_bias_rad_s=bias if gyro else nan,
        imu_yaw_offset_rad=wrap(offset) if state.imu_yaw_known else nan,
        corridor_index=state.corridor_index,
        corridor_turn_rad=state.corridor_turn_rad,
        status=str(status),
        vision_age_s=seconds_since(t, state.t_vision_ns),
        reason=reason,
        gyro_age_s=seconds_since(t, state.t_gyro_ns),
        attitude_age_s=seconds_since(t, state.t_attitude_ns),
        lateral_age_s=seconds_since(t, state.t_lateral_ns),
        heading_test_ratio=state.heading_ratio,
        lateral_test_ratio=state.lateral_ratio,
        imu_yaw_test_ratio=state.imu_yaw_ratio,
        lateral_velocity_norm_s=motion.lateral,
        lateral_velocity_norm_s_std=motion.lateral_std,
        lateral_velocity_m_s=motion.lateral * half,
        lateral_velocity_std_m_s=motion.lateral_std * half,
        along_velocity_m_s=motion.along,
        reset_count=state.reset_count,
        reset_heading_rad=state.reset_heading_rad,
        lateral_reset_count=state.lateral_reset_count,
        reset_lateral_norm=state.lateral_reset[0],
        reset_lateral_m=state.lateral_reset[1],
        roll_rad=float(np.arctan2(gy, gz)),
        pitch_rad=float(np.arctan2(-gx, hypot(gy, gz))),
        camera_delay_s=delay_s,
        camera_delay_std_s=delay_std_s,
    )


def _provisional(state: State) -> tuple[float, float]:
    """Heading before the start is settled: what the frames so far say, with a wide sigma."""
    if not state.votes:
        return nan, nan
    newest = state.votes[-1].value
    axis = newest + median(wrap_axis(vote.value - newest) for vote in state.votes)
    return wrap_axis(state.theta_rad - axis), UNKNOWN_HEADING_STD_RAD / (3.0 + len(state.votes))


__all__ = [
    "BIAS",
    "OFFSET",
    "PSI",
    "Estimate",
    "Mode",
    "State",
    "Status",
    "V",
    "Y",
    "describe",
    "half_width_m",
]
