"""Status of the heading at a time, its reasons, and the faults of all sources. Pure functions."""

from __future__ import annotations

from collections.abc import Iterator
from enum import StrEnum
from typing import TYPE_CHECKING, Protocol

from fusion.estimator.config import FusionConfig
from fusion.estimator.faults import Fault, Notice
from fusion.estimator.frame_update import FrameSample
from fusion.estimator.hypotheses import CONTESTED_S, Hypothesis
from fusion.estimator.imu_yaw import AttitudeSample
from fusion.estimator.propagation import ImuSample
from fusion.estimator.range_width import RangeSample
from fusion.estimator.sample_times import seconds_since
from fusion.estimator.velocity import VelocitySample

if TYPE_CHECKING:
    from fusion.estimator.state import Sample, State

MAX_REJECTED_SHARE = 0.5  # of the frames of the last half second; beyond it the heading is coasting
TILT_NOT_TURNING = "attitude does not roll and pitch as the gyroscope does: check its frame, sign and stamps"
REFUSED_SAMPLES = 20  # impossible values in a row before a source is reported that was never used
REFUSED = {
    "imu_not_finite": "gyroscope is not finite",
    "attitude_not_unit": "attitude is no unit quaternion",
    "velocity_not_finite": "velocity is not finite",
    "velocity_out_of_range": "velocity is out of range: give m/s",
    "range_out_of_range": "range is out of range: give metres",
    "range_not_positive": "range is not positive",
}
CONTESTED = {
    Hypothesis.WELL: "contested: the frames' headings are biased against the prediction",
    Hypothesis.GYRO: "contested: frames drift against the gyroscope",
    Hypothesis.SPIKE: "contested: the gyroscope jumped",
    Hypothesis.BEND: "contested: frames drift against gyroscope and IMU yaw",
    Hypothesis.AXIS: "contested: frames show another axis",
    Hypothesis.STAMPS: "contested: frames show turns sooner or later than the gyroscope",
}


class Status(StrEnum):
    """Reliability of the heading; the values of the ``status`` column."""

    INITIALISING = "initialising"  # no heading yet
    TRACKING = "tracking"  # recent frames confirm it
    COASTING = "coasting"  # propagated by gyroscope or attitude alone
    LOST = "lost"  # propagated for too long, or too uncertain


class ArrivalTimes(Protocol):
    """Latencies and clock checks of live samples: `fusion.estimator.arrivals.Arrivals`. Not used for logs."""

    def latency_ns(self, kind: type[Sample]) -> int:
        """Usual delay of a source's samples behind the newest stamp, nanoseconds."""

    def refused(self, kind: type[Sample]) -> tuple[str, int]:
        """Fault of a source's last samples, and how many in a row had impossible values."""

    def notices(self) -> Iterator[Notice]:
        """Report wrong clocks."""


def status_of(
    state: State,
    config: FusionConfig,
    t_ns: int,
    heading_std_rad: float,
    arrivals: ArrivalTimes | None = None,
) -> Status:
    """Return the status at a time.

    The usual latency is allowed for: frames that always arrive 0.3 s late are not reported missing before that.

    Parameters
    ----------
    state
        State of the estimator.
    config
        Settings.
    t_ns
        Time, nanoseconds; not before the state.
    heading_std_rad
        Standard deviation of the heading.
    arrivals
        Latencies and clock checks of live samples; not used for logs.
    """
    axis = state.axis
    if not axis.ever_acquired:
        return Status.INITIALISING
    if heading_std_rad > config.lost_heading_std_rad:
        return Status.LOST
    seen_ns = t_ns if arrivals is None else _seen_ns(state, t_ns, arrivals)
    age = seconds_since(seen_ns, axis.t_vision_ns)
    if age > config.lost_after_s:
        return Status.LOST
    if age > state.frames.age_limit_s(config) or axis.diagnosis.rejected_share > MAX_REJECTED_SHARE:
        return Status.COASTING
    return Status.TRACKING


def notices_of(
    state: State,
    config: FusionConfig,
    t_ns: int,
    heading_std_rad: float,
    arrivals: ArrivalTimes | None = None,
) -> list[Notice]:
    """Return the reasons for the status, and all faults of other sources. Arguments as in `status_of`."""
    axis, clocks = state.axis, [] if arrivals is None else list(arrivals.notices())
    status = status_of(state, config, t_ns, heading_std_rad, arrivals)
    if status is Status.INITIALISING:
        clocks = [*clocks, *_installation_notices(state, config)]
        text = "waiting for frames that agree" if axis.votes else "no usable frame yet"
        return clocks or [Notice(Fault.NOT_STARTED, text)]
    seen_ns = _seen_ns(state, t_ns, arrivals)
    age, limit = seconds_since(seen_ns, axis.t_vision_ns), state.frames.age_limit_s(config)
    notices = []
    if status is Status.TRACKING:
        contested = axis.diagnosis.reported
        if contested is not None and seconds_since(t_ns, contested.t_ns) < CONTESTED_S:
            notices.append(Notice(Fault.HEADING_CONTESTED, CONTESTED[contested.hypothesis]))
        if state.lateral.contradicted:
            notices.append(Notice(Fault.NO_LATERAL_OFFSET, "lateral offset jumped further than the motion"))
        elif state.lateral.n_used and seconds_since(seen_ns, state.lateral.t_ns) > limit:
            notices.append(Notice(Fault.NO_LATERAL_OFFSET, "frames show no lateral offset"))
    elif heading_std_rad > config.lost_heading_std_rad:
        notices.append(Notice(Fault.HEADING_UNCERTAIN, "heading is too uncertain"))
    else:
        silent = age > limit and state.frames.is_silent(seen_ns, config)
        text = "no frames arrive" if silent else "frames are rejected"
        if status is Status.LOST:
            text = f"no usable frame for {age:.0f} s"
        notices.append(Notice(Fault.FRAMES_SILENT if silent else Fault.FRAMES_REJECTED, text))
    if (frozen := state.checks.repeats.notice()) is not None:
        notices = [n for n in notices if n.fault is not Fault.FRAMES_REJECTED] + [frozen]
    if clocks:  # frames do arrive, with unusable stamps
        notices = [n for n in notices if n.text != "no frames arrive"] + clocks
    return [*notices, *_sensor_notices(state, config, t_ns, arrivals)]


def _seen_ns(state: State, t_ns: int, arrivals: ArrivalTimes | None) -> int:
    """Return the time up to which a missing frame is known to be missing: now, less the frames' latency."""
    latency_ns = 0 if arrivals is None else arrivals.latency_ns(FrameSample)
    return t_ns if not latency_ns else max(t_ns - latency_ns, state.frames.last_ns or 0)


def _installation_notices(state: State, config: FusionConfig) -> Iterator[Notice]:
    yield from state.checks.installation.notices(config.gyro_scale_std)
    if state.tilt.check.is_wrong:
        yield Notice(Fault.TILT_WRONG, TILT_NOT_TURNING)


def _sensor_notices(
    state: State, config: FusionConfig, t_ns: int, arrivals: ArrivalTimes | None
) -> Iterator[Notice]:
    """Yield the faults of all sources except the camera: silent sources, gyroscope, installation."""

    def due_ns(kind: type[Sample]) -> int:
        return t_ns if arrivals is None else t_ns - arrivals.latency_ns(kind)

    reckoning = state.reckoning
    if (wrong := state.checks.gyro.notice(t_ns)) is not None:
        yield wrong
    yield from _installation_notices(state, config)
    if (narrow := state.width.notice(config)) is not None:
        yield narrow
    if state.velocity.is_known(t_ns) and (contradicted := state.lateral.speed_check.notice()) is not None:
        yield contradicted
    found: tuple[tuple[Fault, type[Sample], str], ...] = (
        (Fault.GYRO_SILENT, ImuSample, reckoning.gyro_silence(due_ns(ImuSample), config)),
        (
            Fault.ATTITUDE_SILENT,
            AttitudeSample,
            reckoning.attitude_silence(due_ns(AttitudeSample), config),
        ),
        (Fault.VELOCITY_SILENT, VelocitySample, state.velocity.silence(due_ns(VelocitySample), config)),
        (Fault.RANGE_SILENT, RangeSample, state.width.silence(due_ns(RangeSample), config)),
    )
    for fault, kind, text in found:
        cause, count = ("", 0) if arrivals is None else arrivals.refused(kind)
        if text or count >= REFUSED_SAMPLES:
            yield Notice(fault, REFUSED.get(cause, text))
