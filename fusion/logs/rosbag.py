"""ROS 1 bags, ROS 2 bags (sqlite3 or MCAP) and plain MCAP files, read with rosbags.

Bodies x forward, y left, z up and worlds with z up (REP 103, REP 105) turn into FRD and z down. Times are those of
the messages' headers, which say when a sample was taken, not when it was received; a topic whose headers are empty
keeps the times of receipt, and says so.
"""

from __future__ import annotations

import struct
from array import array
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, cast

import numpy as np
import numpy.typing as npt

from fusion.flight import AttitudeStream, FloatArray, FrameStream, ImuStream, TimeArray, VectorStream
from fusion.logs.contents import Kind, LogContents, Topic
from fusion.logs.rosbag_file import Bag, recognises
from fusion.logs.rosbag_frames import TOPICS as TRANSFORM_TOPICS
from fusion.logs.rosbag_frames import StaticFrames
from fusion.logs.rosbag_messages import (
    PICTURES,
    POSES,
    TWISTS,
    WIDTH,
    RosType,
    Wire,
    camera_from_info,
    row,
)
from fusion.logs.rosbag_pictures import BagPictures, describe, refusal
from fusion.logs.samples import MIN_STEP_NS, counted
from fusion.logs.series import (
    MAX_POSITION,
    MAX_VELOCITY,
    Series,
    SeriesLog,
    Stream,
    Where,
    attitude_stream,
    imu_stream,
    no_such_topic,
    usable,
    vector_stream,
    velocity_stream,
)
from vision import Camera, InputError

if TYPE_CHECKING:
    from rosbags.interfaces import Connection

__all__ = ["open_log", "recognises"]

WORLDS = (
    "map",
    "odom",
    "world",
    "earth",
    "enu",
    "local_origin",
)  # frames of a velocity that is not the body's
WANTED = frozenset(kind.value for kind in RosType)
LATE_NS = 1_000_000_000  # between a header and its receipt; more means another clock


@dataclass(slots=True, eq=False)
class _Gathered:
    """What one pass through the bag finds of a topic."""

    name: str
    kind: RosType
    stamps_ns: array[int] = field(default_factory=lambda: array("q"))
    received_ns: array[int] = field(default_factory=lambda: array("q"))
    values: array[float] = field(default_factory=lambda: array("d"))
    first: bytes = b""
    broken: int = 0

    def take(self, wire: Wire, received_ns: int, raw: bytes) -> None:
        """Note a message; one that is damaged is counted."""
        try:
            stamp_ns = wire.stamp_ns(raw)
            values = row(self.kind, wire.numbers(raw, self.kind)) if self.kind in WIDTH else ()
        except (struct.error, IndexError):
            self.broken += 1
            return
        self.first = self.first or raw
        self.stamps_ns.append(stamp_ns)
        self.received_ns.append(received_ns)
        self.values.extend(values)


@dataclass(frozen=True, slots=True, eq=False)
class _Samples:
    """A topic's samples in the order of receipt, in FRD and z down."""

    file: Path
    name: str
    kind: RosType
    t_ns: TimeArray
    received_ns: TimeArray
    values: FloatArray
    first: bytes
    clock: str
    remarks: tuple[str, ...]
    axes: str = "x forward, y left, z up taken"

    def columns(self, start: int, end: int) -> FloatArray:
        """Return some of the numbers (n, k)."""
        return self.values[:, start:end]

    def where(self, problems: list[str]) -> Where:
        """Where to report what is wrong with it."""
        problems += [remark for remark in self.remarks if remark not in problems]
        return Where(self.file, self.name, problems)


class RosLog(SeriesLog):
    """`LogContents` of a bag."""

    def __init__(
        self,
        bag: Bag,
        series: list[Series],
        pictures: dict[str, _Samples],
        notes: dict[str, str],
        infos: dict[str, bytes],
        mounts: StaticFrames,
    ) -> None:
        super().__init__(bag.path, bag.format, series, bag.problems)
        self._bag = bag
        self._pictures = pictures
        self._infos = infos
        self._mounts = mounts
        topics = [Topic(p.name, Kind.FRAMES, p.t_ns, notes[p.name]) for p in pictures.values()]
        self.topics = (*topics, *self.topics)

    def frames(self, topic: str, problems: list[str]) -> FrameStream:
        """Pictures, decoded one at a time when asked for."""
        if topic not in self._pictures:
            raise no_such_topic(self.path, self.topics, Kind.FRAMES, topic)
        samples = self._pictures[topic]
        index = usable(samples.t_ns, samples.where(problems), MIN_STEP_NS)
        received_ns = samples.received_ns
        source = BagPictures(self.path, topic, received_ns[index], _repeats(received_ns)[index])
        return FrameStream(samples.t_ns[index], source)

    def camera(self, topic: str) -> Camera | None:
        """Calibration from the CameraInfo beside these pictures; it looks straight ahead unless transforms tell."""
        name = _info_of(topic, list(self._infos), list(self._pictures))
        if name is None:
            return None
        try:
            info = self._bag.decode(RosType.CAMERA_INFO, self._infos[name])
            mount = self._mounts.mount(info.header.frame_id)
            rectified = "rect" in _base(topic).rsplit("/", 1)[-1]
            return camera_from_info(info, name, rectified=rectified, mount=mount)
        except InputError as error:
            raise InputError(error.problem, file=self.path, remedy=error.remedy) from error
        except (ValueError, IndexError, TypeError, AttributeError) as error:
            raise InputError(
                f"{name} is damaged", file=self.path, remedy="give a camera file instead"
            ) from error


def open_log(path: Path) -> LogContents:
    """Go through a bag once, for the times of its topics and the numbers of the small ones.

    Raises
    ------
    InputError
        Where rosbags is not installed, the bag is past reading, or holds no topic of use.
    """
    bag = Bag(path)
    wire = Wire(bag.ros2)
    gathered, infos, frames = _gather(bag, wire)
    samples = [_put_right(bag, found) for found in gathered if len(found.stamps_ns)]
    samples = [_turned_into_body(s, wire, frames) if s.kind is RosType.IMU else s for s in samples]
    pictures, notes = _pictures(bag, [s for s in samples if s.kind in PICTURES])
    series = _series(bag, wire, [s for s in samples if s.kind not in PICTURES])
    if not series and not pictures:
        if any(_of_use(connection) for connection in bag.connections):
            raise InputError(
                f"none of its messages can be read ({'; '.join(bag.problems) or 'it holds none'})",
                file=path,
                remedy="copy the bag again",
            )
        kinds = sorted({connection.msgtype for connection in bag.connections})
        raise InputError(
            f"holds none of the message types that are read, but {', '.join(kinds[:6]) or 'nothing'}",
            file=path,
            remedy="record sensor_msgs/Imu, and Image or CompressedImage with CameraInfo",
        )
    return RosLog(bag, series, pictures, notes, infos, frames)


def _gather(bag: Bag, wire: Wire) -> tuple[list[_Gathered], dict[str, bytes], StaticFrames]:
    """Every topic of use, the first CameraInfo of each that has one, and how the sensors are mounted."""
    found: dict[tuple[str, str], _Gathered] = {}
    connections = [connection for connection in bag.connections if _of_use(connection)]
    infos: dict[str, bytes] = {}
    frames = StaticFrames()
    if connections:
        for connection, received_ns, raw in bag.messages(connections, problems=bag.problems):
            if connection.msgtype == RosType.CAMERA_INFO:
                infos.setdefault(connection.topic, raw)
                continue
            if connection.msgtype == RosType.TRANSFORMS:
                with suppress(InputError):  # a damaged one is one that is not there
                    frames.add(bag.decode(connection.msgtype, raw).transforms)
                continue
            key = (connection.topic, connection.msgtype)
            if key not in found:
                found[key] = _Gathered(connection.topic, RosType(connection.msgtype))
            found[key].take(wire, received_ns, raw)
    return sorted(found.values(), key=lambda topic: topic.name), infos, frames


def _put_right(bag: Bag, found: _Gathered) -> _Samples:
    """Choose a topic's clock: its headers, or where these are empty, the receipt."""
    stamps_ns = np.array(found.stamps_ns, dtype=np.int64)
    received_ns = np.array(found.received_ns, dtype=np.int64)
    remarks = []
    if found.broken:
        remarks.append(f"{found.name}: {counted(found.broken, 'damaged message')} dropped")
    empty = stamps_ns == 0
    if 2 * np.count_nonzero(empty) > len(empty):
        t_ns, clock = received_ns, "times of receipt, its headers are empty"
        remarks.append(
            f"{found.name}: headers without time; the times are those of receipt, late by an unknown delay"
        )
    else:
        t_ns, clock = np.where(empty, -1, stamps_ns), "times of the headers"
        late_ns = int(np.median(received_ns - stamps_ns))
        if abs(late_ns) > LATE_NS:
            clock += f", {abs(late_ns) * 1e-9:.6g} s {'before' if late_ns > 0 else 'after'} receipt"
    width = WIDTH.get(found.kind, 0)
    values = np.array(found.values, dtype=float).reshape(len(t_ns), width)
    return _Samples(
        bag.path, found.name, found.kind, t_ns, received_ns, values, found.first, clock, tuple(remarks)
    )


def _of_use(connection: Connection) -> bool:
    """Whether a connection is read; of the transforms only those that never change."""
    if connection.msgtype == RosType.TRANSFORMS:
        return connection.topic in TRANSFORM_TOPICS
    return connection.msgtype in WANTED


def _turned_into_body(samples: _Samples, wire: Wire, frames: StaticFrames) -> _Samples:
    """Inertial samples in the axes of the body, where transforms tell how the sensor is mounted."""
    frame_id = wire.frame_id(samples.first)
    mount = frames.mount(frame_id)
    if mount is None:
        return samples
    R = mount.of_flu_sensor()
    values = samples.values.copy()
    values[:, 4:7] = samples.columns(4, 7) @ R.T
    values[:, 7:10] = samples.columns(7, 10) @ R.T
    values[:, 0:4] = _times_inverse(samples.columns(0, 4), R)
    return replace(samples, values=values, axes=f"turned from {frame_id} into {mount.body} by /tf_static")


def _times_inverse(q: FloatArray, R: FloatArray) -> FloatArray:
    """Quaternions (n, 4), w x y z, times the inverse of a rotation (3, 3); any length is kept, and NaN."""
    from scipy.spatial.transform import Rotation

    w, x, y, z = Rotation.from_matrix(R.T).as_quat(scalar_first=True)
    right = np.array([[w, x, y, z], [-x, w, -z, y], [-y, z, w, -x], [-z, -y, x, w]])
    return np.asarray(q @ right)


def _pictures(bag: Bag, topics: Iterable[_Samples]) -> tuple[dict[str, _Samples], dict[str, str]]:
    """Picture topics that can be read, and a note on each; the others are named in the bag's problems."""
    found: dict[str, _Samples] = {}
    notes: dict[str, str] = {}
    for samples in topics:
        try:
            message = bag.decode(samples.kind, samples.first)
            reason = refusal(message, samples.kind)
            what = describe(message, samples.kind)
        except InputError:
            reason, what = None, "its first picture does not decode"
        if reason is None:
            found[samples.name] = samples
            notes[samples.name] = f"{what}; {samples.clock}"
        else:
            bag.problems.append(f"{samples.name}: pictures of {reason} left out")
    return found, notes


def _series(bag: Bag, wire: Wire, topics: list[_Samples]) -> list[Series]:
    """Topics of numbers by kind, the one to prefer first."""
    imus = [s for s in topics if s.kind is RosType.IMU]
    inertial = [s for s in imus if np.isfinite(s.columns(4, 7)).all(axis=1).any()]
    oriented = [s for s in imus if _any_quaternion(s.columns(0, 4))]
    poses = sorted((s for s in topics if s.kind in POSES), key=lambda s: POSES.index(s.kind))
    twists = sorted((s for s in topics if s.kind in TWISTS), key=lambda s: TWISTS.index(s.kind))
    found = [_one(s, Kind.IMU, s.axes, _read_imu) for s in inertial]
    attitudes = [
        _one(s, Kind.ATTITUDE, f"orientation of the IMU, {s.axes}", partial(_read_attitude, 0))
        for s in oriented
    ]
    attitudes += [_one(s, Kind.ATTITUDE, _frame(wire, s), partial(_read_attitude, 3)) for s in poses]
    found += attitudes
    found += [_one(s, Kind.POSITION, _frame(wire, s), _read_position) for s in poses]
    for s in twists:
        frame = wire.frame_id(s.first) if s.kind is not RosType.ODOMETRY else ""
        if frame.strip("/") not in WORLDS:
            found.append(_one(s, Kind.VELOCITY, "of the body", _read_velocity))
        elif attitudes:
            turning = attitudes[0]
            note = f"of {frame}, turned into the body by {turning.topic.name}"
            found.append(_one(s, Kind.VELOCITY, note, partial(_read_world_velocity, turning)))
        else:
            bag.problems.append(
                f"{s.name}: a velocity in {frame}, left out: no attitude to turn it into the body"
            )
    return found


def _one(samples: _Samples, kind: Kind, note: str, read: Callable[[_Samples, list[str]], Stream]) -> Series:
    topic = Topic(samples.name, kind, samples.t_ns, f"{note}; {samples.clock}")
    return Series(topic, partial(read, samples))


def _frame(wire: Wire, samples: _Samples) -> str:
    return f"in {wire.frame_id(samples.first) or 'a frame without name'}, z up taken"


def _any_quaternion(q: FloatArray) -> bool:
    """Whether any of these (n, 4) is one: drivers without an attitude leave zeros."""
    return bool((np.abs(np.linalg.norm(np.nan_to_num(q), axis=1) - 1.0) < 0.05).any())


def _read_imu(samples: _Samples, problems: list[str]) -> ImuStream:
    where = samples.where(problems)
    return imu_stream(samples.t_ns, samples.columns(4, 7), samples.columns(7, 10), where)


def _read_attitude(start: int, samples: _Samples, problems: list[str]) -> AttitudeStream:
    return attitude_stream(samples.t_ns, samples.columns(start, start + 4), samples.where(problems))


def _read_position(samples: _Samples, problems: list[str]) -> VectorStream:
    return vector_stream(samples.t_ns, samples.columns(0, 3), samples.where(problems), MAX_POSITION)


def _velocity_columns(samples: _Samples) -> FloatArray:
    start = 7 if samples.kind is RosType.ODOMETRY else 0
    return samples.columns(start, start + 3)


def _read_velocity(samples: _Samples, problems: list[str]) -> VectorStream:
    return vector_stream(samples.t_ns, _velocity_columns(samples), samples.where(problems), MAX_VELOCITY)


def _read_world_velocity(turning: Series, samples: _Samples, problems: list[str]) -> VectorStream:
    attitude = turning.read([])  # its own problems are told where it is asked for
    where = samples.where(problems)
    return velocity_stream(samples.t_ns, _velocity_columns(samples), cast(AttitudeStream, attitude), where)


def _repeats(t_ns: TimeArray) -> npt.NDArray[np.int64]:
    """How many samples of the same time come before each (n,), of times in order."""
    starts = np.concatenate([[True], np.diff(t_ns) != 0])
    number = np.arange(len(t_ns))
    return np.asarray(number - np.maximum.accumulate(np.where(starts, number, 0)))


def _base(topic: str) -> str:
    """Topic of the uncompressed pictures."""
    return topic.removesuffix("/compressed").rstrip("/")


def _info_of(topic: str, infos: list[str], pictures: list[str]) -> str | None:
    """Topic of the CameraInfo that belongs to a picture topic: beside it; else the only one, if both are alone."""
    beside = f"{_base(topic).rpartition('/')[0]}/camera_info"
    if beside in infos:
        return beside
    cameras = {_base(picture).rpartition("/")[0] for picture in pictures}
    return infos[0] if len(infos) == 1 and len(cameras) == 1 else None
