"""One pass through a bag: the times of every topic, and the numbers of topics that are not pictures."""

from __future__ import annotations

import struct
from array import array
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from fusion.flight import FloatArray, TimeArray
from fusion.logs.rosbag.file import Bag, SkippingMessages
from fusion.logs.rosbag.frames import OPTICAL_AS_FLU, Mount, StaticFrames, is_optical
from fusion.logs.rosbag.frames import TOPICS as TRANSFORM_TOPICS
from fusion.logs.rosbag.messages import PX4, WIDTH, RosType, Wire, row
from fusion.logs.samples import Problems, WithProblems, counted
from fusion.logs.series import LATEST_NS, Where
from vision import InputError

if TYPE_CHECKING:
    from rosbags.interfaces import Connection

WANTED = frozenset(kind.value for kind in RosType)
LOOKS_DOWN, LOOKS_ELSEWHERE = "looks down by /tf_static", "does not look down by /tf_static"
MIN_DOWN = 0.94  # of the beam along the body's z: within 20 degrees
T = TypeVar("T")
LATE_NS = 1_000_000_000  # between a header's time and receipt; more is reported
OTHER_CLOCK_NS = 60_000_000_000  # a larger delay means that the header is of another clock


@dataclass(slots=True, eq=False)
class _Messages:
    """Samples of a topic, from one pass through the bag."""

    name: str
    kind: RosType
    stamps_ns: array[int] = field(default_factory=lambda: array("q"))
    received_ns: array[int] = field(default_factory=lambda: array("q"))
    values: array[float] = field(default_factory=lambda: array("d"))
    first: bytes = b""
    broken: int = 0

    def take(self, wire: Wire, received_ns: int, raw: bytes) -> None:
        """Add a message; damaged ones are counted."""
        try:
            stamp_ns = wire.stamp_ns(raw, self.kind)
            values = row(self.kind, wire.numbers(raw, self.kind)) if self.kind in WIDTH else ()
        except (struct.error, IndexError):
            self.broken += 1
            return
        if not 0 <= received_ns < LATEST_NS:
            self.broken += 1
            return
        self.first = self.first or raw
        self.stamps_ns.append(stamp_ns)
        self.received_ns.append(received_ns)
        self.values.extend(values)


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """A topic's samples in the order of receipt, in FRD and z down."""

    file: Path
    name: str
    kind: RosType
    t_ns: TimeArray
    received_ns: TimeArray
    values: FloatArray
    first: bytes
    clock: str
    remarks: Problems
    axes: str = "x forward, y left, z up taken"

    def columns(self, start: int, end: int) -> FloatArray:
        """Return some of the numbers (n, k)."""
        return self.values[:, start:end]

    def where(self) -> Where:
        """Return its name for messages."""
        return Where(self.file, self.name)

    def with_remarks(self, read: WithProblems[T]) -> WithProblems[T]:
        """Return the problems of the pass through the bag, followed by those of reading."""
        return WithProblems(read.value, self.remarks + read.problems)


@dataclass(frozen=True, slots=True, eq=False)
class Gathered:
    """Result of one pass through a bag.

    Parameters
    ----------
    samples
        All usable topics.
    infos
        The first CameraInfo of each topic of this type.
    frames
        Mounting of the sensors.
    """

    samples: tuple[Samples, ...]
    infos: dict[str, bytes]
    frames: StaticFrames


def gather(bag: Bag, wire: Wire) -> WithProblems[Gathered]:
    """Read a bag in one pass."""
    found: dict[tuple[str, str], _Messages] = {}
    connections = [connection for connection in bag.connections if is_read(connection)]
    infos: dict[str, bytes] = {}
    frames = StaticFrames()
    read: Counter[str] = Counter()
    messages = SkippingMessages(bag, connections)
    for connection, received_ns, raw in messages:
        read[connection.topic] += 1
        if connection.msgtype == RosType.CAMERA_INFO:
            infos.setdefault(connection.topic, raw)
        elif connection.msgtype == RosType.TRANSFORMS:
            with suppress(InputError):  # a damaged message is treated as missing
                frames.add(bag.decode(connection.msgtype, raw).transforms)
        else:
            key = (connection.topic, connection.msgtype)
            if key not in found:
                found[key] = _Messages(connection.topic, RosType(connection.msgtype))
            found[key].take(wire, received_ns, raw)
    problems: Problems = messages.problems
    for topic in sorted({connection.topic for connection in connections}):
        promised = sum(connection.msgcount for connection in connections if connection.topic == topic)
        if read[topic] < promised:
            problems += (
                f"{topic}: {read[topic]} of {counted(promised, 'message')} in the index can be read",
            )
    gathered = sorted((topic for topic in found.values() if topic.stamps_ns), key=lambda topic: topic.name)
    samples = [_turned_into_body(_with_chosen_clock(bag, topic), wire, frames) for topic in gathered]
    elsewhere = [s for s in samples if s.kind is RosType.RANGE and s.axes == LOOKS_ELSEWHERE]
    problems += tuple(f"{s.name}: {LOOKS_ELSEWHERE}, left out" for s in elsewhere)
    kept = _on_one_clock([s for s in samples if s not in elsewhere])
    return WithProblems(Gathered(kept, infos, frames), problems)


def _with_chosen_clock(bag: Bag, found: _Messages) -> Samples:
    """Choose a topic's clock: its headers or, if these are empty, the receipt."""
    stamps_ns = np.array(found.stamps_ns, dtype=np.int64)
    received_ns = np.array(found.received_ns, dtype=np.int64)
    remarks: Problems = ()
    if found.broken:
        remarks += (f"{found.name}: {counted(found.broken, 'damaged message')} dropped",)
    empty = stamps_ns == 0
    if 2 * np.count_nonzero(empty) > len(empty):
        t_ns, clock = received_ns, "times of receipt, its headers are empty"
        remarks += (
            f"{found.name}: headers without time; the times are those of receipt, late by an unknown delay",
        )
    else:
        t_ns, clock = stamps_ns, "times of the headers"
        if empty.any():
            usual_ns = int(np.median((received_ns - stamps_ns)[~empty]))
            t_ns = np.where(empty, received_ns - usual_ns, stamps_ns)
            remarks += (
                f"{found.name}: {counted(int(empty.sum()), 'header')} without time; taken from the receipt, less the "
                f"usual delay of {usual_ns * 1e-6:.1f} ms",
            )
        late_ns = int(np.median(received_ns - stamps_ns))
        if abs(late_ns) > LATE_NS:
            clock += f", {abs(late_ns) * 1e-9:.6g} s {'before' if late_ns > 0 else 'after'} receipt"
    width = WIDTH.get(found.kind, 0)
    values = np.array(found.values, dtype=float).reshape(len(t_ns), width)
    return Samples(bag.path, found.name, found.kind, t_ns, received_ns, values, found.first, clock, remarks)


def _on_one_clock(topics: list[Samples]) -> tuple[Samples, ...]:
    """Map headers of different clocks, for example since boot and since 1970, to the clock of the receipt.

    Headers that share one clock are not changed, even if it is not the receipt's (a bag that was played back). Topics
    that share a clock are shifted together, by the shortest delay of their messages (first percentile).
    """
    late_ns = {s.name: int(np.median(s.received_ns - s.t_ns)) for s in topics}
    ordered = sorted(topics, key=lambda s: late_ns[s.name])
    clocks: list[list[Samples]] = []
    for s in ordered:
        if clocks and late_ns[s.name] - late_ns[clocks[-1][-1].name] <= OTHER_CLOCK_NS:
            clocks[-1].append(s)
        else:
            clocks.append([s])
    if len(clocks) < 2:
        return tuple(topics)
    moved: dict[int, Samples] = {}
    for clock in clocks:
        if min(abs(late_ns[s.name]) for s in clock) > OTHER_CLOCK_NS:
            by_ns = min(int(np.percentile(s.received_ns - s.t_ns, 1.0)) for s in clock)
            moved |= {id(s): _moved(s, by_ns) for s in clock}
    return tuple(moved.get(id(s), s) for s in topics)


def _moved(samples: Samples, by_ns: int) -> Samples:
    remark = (
        f"{samples.name}: its headers are of another clock than those of other topics; {by_ns * 1e-9:.3f} s added, "
        "by the message received soonest; `corridor align` finds the delay that is left"
    )
    return replace(
        samples,
        t_ns=samples.t_ns + by_ns,
        clock=f"times of the headers, put on the clock of the receipt by {by_ns * 1e-9:.3f} s",
        remarks=(*samples.remarks, remark),
    )


def is_read(connection: Connection) -> bool:
    """Whether a connection is read; only static ones of the transforms."""
    if connection.msgtype == RosType.TRANSFORMS:
        return connection.topic in TRANSFORM_TOPICS
    return connection.msgtype in WANTED


def _turned_into_body(samples: Samples, wire: Wire, frames: StaticFrames) -> Samples:
    """Rotate inertial samples into the body if transforms give the mount; note where a range sensor points."""
    if samples.kind in PX4:
        return replace(samples, axes="x forward, y right, z down")
    if samples.kind not in (RosType.IMU, RosType.RANGE):
        return samples
    frame_id = wire.frame_id(samples.first)
    mount = frames.mount(frame_id)
    if samples.kind is RosType.RANGE:
        return _with_direction_note(samples, mount)
    if mount is None and not is_optical(frame_id):
        return samples
    R = OPTICAL_AS_FLU if mount is None else mount.of_flu_sensor()
    values = samples.values.copy()
    values[:, 4:7] = samples.columns(4, 7) @ R.T
    values[:, 7:10] = samples.columns(7, 10) @ R.T
    values[:, 0:4] = _times_inverse(samples.columns(0, 4), R)
    if mount is None:
        return replace(samples, values=values, axes=f"{frame_id}: x right, y down, z forward")
    if mount.body == frame_id:
        return replace(samples, values=values)
    return replace(samples, values=values, axes=f"turned from {frame_id} into {mount.body} by /tf_static")


def _with_direction_note(samples: Samples, mount: Mount | None) -> Samples:
    """Distances with a note on where the sensor points, along its x axis (sensor_msgs/Range)."""
    if mount is None:
        remark = (
            f"{samples.name}: taken to look down, no transform tells; if it does not: [range] use = false"
        )
        return replace(samples, axes="taken to look down", remarks=(*samples.remarks, remark))
    down = float(mount.R_body_sensor[2, 0]) > MIN_DOWN
    return replace(samples, axes=LOOKS_DOWN if down else LOOKS_ELSEWHERE)


def _times_inverse(q: FloatArray, R: FloatArray) -> FloatArray:
    """Quaternions (n, 4), w x y z, times the inverse of a rotation (3, 3); any length is kept, and NaN."""
    from scipy.spatial.transform import Rotation

    w, x, y, z = Rotation.from_matrix(R.T).as_quat(scalar_first=True)
    right = np.array([[w, x, y, z], [-x, w, -z, y], [-y, z, w, -x], [-z, -y, x, w]])
    return np.asarray(q @ right)
