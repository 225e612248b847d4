"""Common functions of the log readers: clean times, clean samples, read topics on request."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import numpy as np
import numpy.typing as npt

from fusion.flight import (
    AttitudeStream,
    FloatArray,
    FrameStream,
    ImuStream,
    RangeStream,
    TimeArray,
    VectorStream,
)
from fusion.logs.contents import Kind, LogContents, Topic
from fusion.logs.interpolation import attitude_at
from fusion.logs.samples import (
    MIN_IMU_STEP_NS,
    BoolArray,
    IndexArray,
    Problems,
    WithProblems,
    counted,
    finite,
    in_order,
    report_dropped,
)
from vision import Camera, InputError

Stream = ImuStream | AttitudeStream | VectorStream | RangeStream
Read = Callable[[], WithProblems[Stream]]

QUATERNION_TOLERANCE = 0.05  # of its length; a larger deviation is damage
LATEST_NS = 2**62  # the year 2116; later times are damaged

STRAY_WINDOW = 11  # samples; detects up to five adjacent damaged ones
STRAY_NS = 500_000_000
LONE_PAUSE_NS, LONG_PAUSE_NS = 5_000_000_000, 60_000_000_000  # beside one row, beside rows of the usual step
CLOCK_BACK_NS = 1_000_000_000  # less is jitter, and samples are sorted
CLOCK_AHEAD_NS = 3_600_000_000_000

# Beyond any vehicle's motion in any unit, so the sample is damaged.
MAX_POSITION = 1e7
MAX_VELOCITY = 1e4
MAX_DISTANCE_M = 100.0


@dataclass(frozen=True, slots=True)
class Where:
    """Name of a stream for messages, and its file."""

    file: Path
    label: str

    def dropped(self, good: BoolArray, t_ns: TimeArray, what: str) -> Problems:
        """Report the rows (n,) that are not good; the caller drops them. `InputError` if none is good."""
        if not good.any():
            raise InputError(
                f"{self.label}: every row has {what}", file=self.file, remedy="choose another topic"
            )
        return report_dropped(good, t_ns, what, self.label)


def nanoseconds(ticks: npt.NDArray[np.generic], tick_ns: int) -> TimeArray:
    """Convert whole ticks (n,) to nanoseconds; implausible times become `LATEST_NS`."""
    unsigned = ticks.astype(np.uint64)
    ok = unsigned < LATEST_NS // tick_ns
    return np.where(ok, unsigned * np.uint64(tick_ns), LATEST_NS).astype(np.int64)


def usable(t_ns: TimeArray, where: Where, min_step_ns: int = MIN_IMU_STEP_NS) -> WithProblems[IndexArray]:
    """Index (m,) of the samples with plausible times, in the order of time.

    Damaged times, far from those of neighbouring samples, are dropped. If the clock was set back, or far ahead, only
    the longest stretch is used: sorting would interleave two flights.

    Raises
    ------
    InputError
        If no sample is left, or the times cannot be nanoseconds.
    """
    problems: Problems = ()
    possible = (t_ns >= 0) & (t_ns < LATEST_NS)
    index = np.flatnonzero(possible)
    if len(index) < len(t_ns):
        problems += where.dropped(possible, t_ns, "a time that cannot be one")
    if len(index) == 0:
        raise InputError(f"{where.label} has no samples", file=where.file, remedy="choose another topic")
    steps = np.diff(t_ns[index])
    if steps.size and (steps.min() < 0 or steps.max() > STRAY_NS):
        kept, strays = _without_strays(t_ns[index], where)
        index = index[kept]
        stretch, jumps = _longest_stretch(t_ns[index], where)
        index = index[stretch]
        problems += strays + jumps
    order, disorder = in_order(
        t_ns[index],
        where.label,
        min_step_ns,
        file=where.file,
        remedy="its times are wrong or in another unit; choose another topic",
    )
    return WithProblems(np.asarray(index[order]), problems + disorder)


def _without_strays(t_ns: TimeArray, where: Where) -> WithProblems[IndexArray]:
    from scipy.ndimage import median_filter

    half = min(STRAY_WINDOW, len(t_ns)) // 2
    around = median_filter(t_ns, 2 * half + 1, mode="nearest")
    if half:  # with a mirrored or repeated end, damaged samples there could be the majority
        around[:half], around[len(t_ns) - half :] = around[half], around[len(t_ns) - half - 1]
    limit_ns = max(STRAY_NS, 8 * int(np.median(np.abs(np.diff(t_ns)))))
    good = np.abs(t_ns - around) <= limit_ns
    if not good.any():
        return WithProblems(np.arange(len(t_ns)))
    _restore_short_runs(t_ns, good)
    return WithProblems(np.flatnonzero(good), where.dropped(good, t_ns, "a time far from its neighbours'"))


def _restore_short_runs(t_ns: TimeArray, good: BoolArray) -> None:
    """Mark short runs of rows (n,) between two pauses, or between a pause and the log's end, as good again."""
    edges = np.flatnonzero(np.diff(np.concatenate([[True], good, [True]])))
    usual_ns = max(int(np.median(np.abs(np.diff(t_ns)))), 1)
    for first, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        around = t_ns[max(first - 1, 0) : end + 1]
        steps, inside = np.diff(around), np.diff(t_ns[first:end])
        is_even = len(inside) > 0 and bool(((4 * inside > usual_ns) & (inside < 4 * usual_ns)).all())
        longest_ns = LONG_PAUSE_NS if is_even else LONE_PAUSE_NS
        good[first:end] = bool((steps > 0).all()) and bool((steps < longest_ns).all())


def _longest_stretch(t_ns: TimeArray, where: Where) -> WithProblems[slice]:
    steps = np.diff(t_ns)
    cuts = np.flatnonzero((steps < -CLOCK_BACK_NS) | (steps > CLOCK_AHEAD_NS)) + 1
    if cuts.size == 0:
        return WithProblems(slice(None))
    edges = [0, *cuts.tolist(), len(t_ns)]
    lengths = np.diff(edges)
    longest = int(np.argmax(lengths))
    jump_s = float(steps[cuts[0] - 1]) * 1e-9
    problem = (
        f"{where.label}: the clock jumps by {jump_s:+.3g} s at {t_ns[cuts[0] - 1]}; only the longest of "
        f"{len(lengths)} stretches is used, {counted(len(t_ns) - int(lengths[longest]), 'sample')} left out"
    )
    return WithProblems(slice(edges[longest], edges[longest + 1]), (problem,))


def attitude_stream(t_ns: TimeArray, q_world_body: FloatArray, where: Where) -> WithProblems[AttitudeStream]:
    """Clean and normalise quaternions (n, 4), w x y z, body FRD to world z down."""
    index, problems = usable(t_ns, where)
    t_ns, q_world_body = t_ns[index], q_world_body[index]
    with np.errstate(over="ignore", invalid="ignore"):
        length = np.linalg.norm(q_world_body, axis=1)
    good = np.abs(length - 1.0) <= QUATERNION_TOLERANCE  # NaN is not
    problems += where.dropped(good, t_ns, "a quaternion that is not of unit length")
    return WithProblems(AttitudeStream(t_ns[good], q_world_body[good] / length[good, None]), problems)


def vector_stream(
    t_ns: TimeArray, xyz: FloatArray, where: Where, limit: float, what: str = "a missing or impossible value"
) -> WithProblems[VectorStream]:
    """Clean positions or velocities.

    Parameters
    ----------
    t_ns, xyz
        Times (n,) and vectors (n, 3), as read.
    where
        Name of the stream.
    limit
        Largest plausible component, in the unit of ``xyz``.
    what
        Fault of the dropped rows.
    """
    index, problems = usable(t_ns, where)
    t_ns, xyz = t_ns[index], xyz[index]
    good = within(xyz, limit)
    problems += where.dropped(good, t_ns, what)
    return WithProblems(VectorStream(t_ns[good], xyz[good]), problems)


def range_stream(
    t_ns: TimeArray,
    distance_m: FloatArray,
    where: Where,
    *,
    limits_m: tuple[npt.ArrayLike, npt.ArrayLike] = (0.0, MAX_DISTANCE_M),
    trusted: BoolArray | None = None,
) -> WithProblems[RangeStream]:
    """Clean distances (n,) to the floor, without those out of the sensor's range.

    Parameters
    ----------
    t_ns, distance_m
        As read.
    where
        Name of the stream.
    limits_m
        Range of the sensor, one or (n,) each; NaN, or an upper limit of zero, means no limit.
    trusted
        Rows (n,) that the sensor does not flag as invalid.
    """
    low_m, high_m = (np.broadcast_to(np.asarray(limit, dtype=float), distance_m.shape) for limit in limits_m)
    with np.errstate(invalid="ignore"):  # NaN is no limit; a sensor without an echo may report its limit
        low_m = np.where(low_m > 0.0, low_m, 0.0)
        high_m = np.where(high_m > 0.0, np.minimum(high_m, MAX_DISTANCE_M), MAX_DISTANCE_M)
        good = (distance_m > low_m) & (distance_m < high_m)
    if trusted is not None:
        good &= trusted
    index, problems = usable(t_ns, where)
    t_ns, distance_m, good = t_ns[index], distance_m[index], good[index]
    problems += where.dropped(good, t_ns, "no distance within the sensor's reach")
    return WithProblems(RangeStream(t_ns[good], distance_m[good]), problems)


def within(values: FloatArray, limit: float) -> BoolArray:
    """Rows (n,) of (n, k) that are numbers within a limit."""
    with np.errstate(invalid="ignore"):
        return finite(values) & (np.abs(values) < limit).all(axis=1)


def quaternions(roll_rad: FloatArray, pitch_rad: FloatArray, yaw_rad: FloatArray) -> FloatArray:
    """Quaternions (n, 4), w x y z, of yaw, then pitch, then roll (n,): body to world of FRD and NED."""
    cr, sr = np.cos(roll_rad / 2), np.sin(roll_rad / 2)
    cp, sp = np.cos(pitch_rad / 2), np.sin(pitch_rad / 2)
    cy, sy = np.cos(yaw_rad / 2), np.sin(yaw_rad / 2)
    return np.stack(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ],
        axis=1,
    )


def into_body(q_world_body: FloatArray, v_world: FloatArray) -> FloatArray:
    """Rotate vectors (n, 3) from the world into the body, one quaternion (n, 4) each."""
    w, u = q_world_body[:, :1], -q_world_body[:, 1:]
    t = 2.0 * np.cross(u, v_world)
    return np.asarray(v_world + w * t + np.cross(u, t))


def velocity_stream(
    t_ns: TimeArray, v_world_m_s: FloatArray, attitude: AttitudeStream, where: Where
) -> WithProblems[VectorStream]:
    """Clean velocities in the world and rotate them into the body by the attitude at their times.

    Velocities outside the attitude's time, or in a gap of more than half a second, are dropped.

    Parameters
    ----------
    t_ns, v_world_m_s
        Times (n,) and velocities (n, 3), world z down, as read.
    attitude
        Body FRD to the same world.
    where
        Name of the stream.
    """
    world, problems = vector_stream(t_ns, v_world_m_s, where, MAX_VELOCITY)
    q_world_body, known = attitude_at(attitude, world.t_ns)
    problems += where.dropped(known, world.t_ns, "no attitude to turn it into the body")
    return WithProblems(VectorStream(world.t_ns[known], into_body(q_world_body, world.xyz)[known]), problems)


@dataclass(frozen=True, slots=True, eq=False)
class Series:
    """A topic and its reading function."""

    topic: Topic
    read: Read


class SeriesLog(LogContents):
    """`LogContents` of a log without pictures, or with pictures that a subclass reads."""

    def __init__(
        self, path: Path, log_format: str, series: Sequence[Series], problems: Sequence[str]
    ) -> None:
        self.path = path
        self.format = log_format
        self.topics = tuple(item.topic for item in series)
        self.problems = tuple(problems)
        self._read = {(item.topic.kind, item.topic.name): item.read for item in series}

    def frames(self, topic: str) -> WithProblems[FrameStream]:
        """Raise `InputError`: these logs have no pictures."""
        raise InputError(
            f"{self.format} carries no pictures", file=self.path, remedy="give the pictures from another file"
        )

    def camera(self, topic: str) -> Camera | None:
        """Return None: these logs have no calibration."""
        return None

    def imu(self, topic: str) -> WithProblems[ImuStream]:
        """Gyroscope and accelerometer, body FRD."""
        return cast(WithProblems[ImuStream], self._stream(Kind.IMU, topic))

    def attitude(self, topic: str) -> WithProblems[AttitudeStream]:
        """Body FRD to world z down."""
        return cast(WithProblems[AttitudeStream], self._stream(Kind.ATTITUDE, topic))

    def position(self, topic: str) -> WithProblems[VectorStream]:
        """World, z down."""
        return cast(WithProblems[VectorStream], self._stream(Kind.POSITION, topic))

    def velocity(self, topic: str) -> WithProblems[VectorStream]:
        """Body FRD."""
        return cast(WithProblems[VectorStream], self._stream(Kind.VELOCITY, topic))

    def range(self, topic: str) -> WithProblems[RangeStream]:
        """Distance to the floor along the body's z."""
        return cast(WithProblems[RangeStream], self._stream(Kind.RANGE, topic))

    def _stream(self, kind: Kind, topic: str) -> WithProblems[Stream]:
        if (kind, topic) not in self._read:
            raise no_such_topic(self.path, self.topics, kind, topic)
        return self._read[kind, topic]()


def no_such_topic(path: Path, topics: Sequence[Topic], kind: Kind, name: str) -> InputError:
    """Return the error for a missing topic, which lists the topics of its kind.

    Parameters
    ----------
    path
        The log.
    topics
        The log's topics.
    kind, name
        The requested topic.
    """
    there = ", ".join(topic.name for topic in topics if topic.kind == kind)
    return InputError(
        f"has no {kind} topic {name}",
        file=path,
        remedy=f"choose one of {there}" if there else f"it has no topic to read as {kind}",
    )
