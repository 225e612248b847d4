"""ROS 1 bags, ROS 2 bags (sqlite3 or MCAP) and plain MCAP files, read with rosbags.

Bodies x forward, y left, z up and worlds with z up (REP 103, REP 105) are converted to FRD and z down. Times are
those of the messages' headers, the times of measurement, not of receipt; a topic with empty headers keeps the times
of receipt, which is reported.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from functools import partial
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
    Remark,
    TimeArray,
    VectorStream,
)
from fusion.logs.contents import Kind, LogContents, Topic
from fusion.logs.imu_series import imu_stream, is_measured, joined_imu
from fusion.logs.rosbag.attachments import attached_camera
from fusion.logs.rosbag.encoded import EncodedPictures, codec_of, is_key_frame
from fusion.logs.rosbag.file import Bag, recognises
from fusion.logs.rosbag.frames import StaticFrames
from fusion.logs.rosbag.messages import (
    IMUS,
    PICTURES,
    POSES,
    TWISTS,
    RosType,
    Wire,
    camera_from_info,
)
from fusion.logs.rosbag.pictures import GREY_16, BagPictures, describe, refusal
from fusion.logs.rosbag.topics import Samples, gather, is_read
from fusion.logs.samples import MIN_STEP_NS, Problems, WithProblems, counted
from fusion.logs.series import (
    MAX_POSITION,
    MAX_VELOCITY,
    Series,
    SeriesLog,
    Stream,
    attitude_stream,
    no_such_topic,
    range_stream,
    usable,
    vector_stream,
    velocity_stream,
)
from fusion.logs.velocity_axes import Axes, axes_of_velocity
from vision import Camera, InputError

__all__ = ["open_log", "recognises"]

WORLDS = (
    "map",
    "odom",
    "world",
    "earth",
    "enu",
    "local_origin",
)  # frames of velocities that are not along the body's axes


_ACCESSORIES = {RosType.TRANSFORMS: "transforms", RosType.CAMERA_INFO: "calibrations"}


class RosLog(SeriesLog):
    """`LogContents` of a bag."""

    def __init__(
        self,
        bag: Bag,
        series: list[Series],
        pictures: dict[str, Samples],
        notes: dict[str, str],
        formats: dict[str, str],
        infos: dict[str, bytes],
        mounts: StaticFrames,
        problems: Problems,
        refused: Problems,
    ) -> None:
        super().__init__(bag.path, bag.format, series, problems)
        self._bag = bag
        self._pictures = pictures
        self._formats = formats
        self._infos = infos
        self._mounts = mounts
        topics = [Topic(p.name, Kind.FRAMES, p.t_ns, notes[p.name]) for p in pictures.values()]
        self.topics = (*topics, *self.topics)
        if refused and not topics:
            self.pictures_remedy = (
                f"{refused[0]}: republish them as mono8, bgr8 or JPEG, or give the video with --video"
            )

    def frames(self, topic: str) -> WithProblems[FrameStream]:
        """Pictures, decoded one at a time on request."""
        if topic not in self._pictures:
            raise no_such_topic(self.path, self.topics, Kind.FRAMES, topic)
        samples = self._pictures[topic]
        index, problems = samples.with_remarks(usable(samples.t_ns, samples.where(), MIN_STEP_NS))
        received_ns = samples.received_ns
        source = BagPictures(self.path, topic, received_ns[index], _repeats(received_ns)[index])
        codec = codec_of(self._formats[topic])
        if codec is not None:
            video, more = _video(self.path, topic, source, codec, len(index))
            return WithProblems(FrameStream(samples.t_ns[index], video), problems + more)
        bits = source.used_bits() if self._formats[topic].startswith(GREY_16) else 16
        if bits < 16:
            source = BagPictures(self.path, topic, source.received_ns, source.repeat, bits)
            problems += (Remark(f"{topic}: its pictures fill {bits} of 16 bits, read by that depth"),)
        return WithProblems(FrameStream(samples.t_ns[index], source), problems)

    def camera(self, topic: str) -> Camera | None:
        """Calibration from the CameraInfo beside these pictures; straight ahead unless transforms give the mount."""
        name = _info_of(topic, list(self._infos), list(self._pictures))
        if name is None:
            return attached_camera(self.path)
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
    """Read a bag once: the times of its topics, and the numbers of all but pictures.

    Raises
    ------
    InputError
        If rosbags is not installed, the bag cannot be read, or contains no usable topic.
    """
    bag = Bag(path)
    try:
        return _opened(bag)
    finally:
        bag.close()


def _opened(bag: Bag) -> RosLog:
    wire = Wire(bag.ros2)
    gathered, problems = gather(bag, wire)
    problems = bag.problems + problems
    pictures, notes, formats, refused = _pictures(bag, [s for s in gathered.samples if s.kind in PICTURES])
    series, left_out = _series(wire, [s for s in gathered.samples if s.kind not in PICTURES])
    problems += refused + left_out
    if not series and not pictures:
        types = {c.msgtype for c in bag.connections if is_read(c)}
        if types and types <= {RosType.TRANSFORMS, RosType.CAMERA_INFO}:
            what = " and ".join(word for kind, word in _ACCESSORIES.items() if kind in types)
            raise InputError(
                f"holds {what}, but no pictures and no IMU",
                file=bag.path,
                remedy="give the bag with the sensors' topics: sensor_msgs/Imu, and Image or CompressedImage",
            )
        if types:
            raise InputError(
                f"none of its messages can be read ({'; '.join(problems) or 'it contains none'})",
                file=bag.path,
                remedy="copy the bag again",
            )
        kinds = sorted({connection.msgtype for connection in bag.connections})
        raise InputError(
            f"contains none of the message types that are read, but {', '.join(kinds[:6]) or 'nothing'}",
            file=bag.path,
            remedy="record sensor_msgs/Imu, and Image or CompressedImage with CameraInfo",
        )
    return RosLog(bag, series, pictures, notes, formats, gathered.infos, gathered.frames, problems, refused)


def _pictures(
    bag: Bag, topics: Iterable[Samples]
) -> tuple[dict[str, Samples], dict[str, str], dict[str, str], Problems]:
    """Readable picture topics with note and format, and the reasons why others are not readable."""
    found: dict[str, Samples] = {}
    notes: dict[str, str] = {}
    formats: dict[str, str] = {}
    problems: Problems = ()
    for samples in topics:
        try:
            message = bag.decode(samples.kind, samples.first)
            reason = refusal(message, samples.kind)
            what, form = (
                describe(message, samples.kind),
                str(message.format if samples.kind is RosType.COMPRESSED else message.encoding),
            )
            if getattr(message, "encoding", "") == "16UC1" and "depth" in samples.name:
                reason = "distances (16UC1)"
        except InputError:
            reason, what, form = None, "its first picture does not decode", ""
        if reason is None:
            found[samples.name] = samples
            notes[samples.name] = f"{what}; {samples.clock}"
            formats[samples.name] = form
        else:
            problems += (f"{samples.name}: pictures of {reason} left out",)
    return found, notes, formats, problems


def _video(
    path: Path, topic: str, packets: BagPictures, codec: str, count: int
) -> WithProblems[EncodedPictures]:
    """Find the key frames of a video stream, where decoding starts."""
    keys = np.flatnonzero([is_key_frame(packets.packet(number), codec) for number in range(count)])
    if not len(keys):
        raise InputError(
            f"{topic}: none of its {counted(count, 'packet')} of {codec} begins a picture of its own",
            file=path,
            remedy="record it from the camera's start, or with key frames every second",
        )
    problems: Problems = ()
    if keys[0] > 0:
        before = counted(int(keys[0]), "picture")
        problems = (f"{topic}: {before} before the first key frame cannot be decoded",)
    return WithProblems(EncodedPictures(codec, packets.packet, keys, count), problems)


def _series(wire: Wire, topics: list[Samples]) -> WithProblems[list[Series]]:
    """Topics of numbers by kind, in the order of preference."""
    imus = [s for s in topics if s.kind in IMUS]
    inertial, problems = _inertial(imus)
    oriented = [s for s in imus if _any_quaternion(s.columns(0, 4))]
    poses = sorted((s for s in topics if s.kind in POSES), key=lambda s: POSES.index(s.kind))
    twists = sorted((s for s in topics if s.kind in TWISTS), key=lambda s: TWISTS.index(s.kind))
    attitudes = [
        _one(s, Kind.ATTITUDE, f"orientation of the IMU, {s.axes}", partial(_read_attitude, 0))
        for s in oriented
    ]
    attitudes += [
        _one(s, Kind.ATTITUDE, "body FRD to NED", partial(_read_attitude, 0))
        for s in topics
        if s.kind is RosType.PX4_ATTITUDE
    ]
    attitudes += [_one(s, Kind.ATTITUDE, _frame(wire, s), partial(_read_attitude, 3)) for s in poses]
    found = [*inertial, *attitudes]
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
            problems += (f"{s.name}: a velocity in {frame}, left out: no attitude to turn it into the body",)
    found += [_one(s, Kind.RANGE, s.axes, _read_range) for s in topics if s.kind is RosType.RANGE]
    return WithProblems(found, problems)


def _inertial(imus: list[Samples]) -> WithProblems[list[Series]]:
    """IMUs; a gyroscope and an accelerometer in separate topics, as of RealSense, are joined."""
    with_gyro = [s for s in imus if is_measured(s.columns(4, 7)).any()]
    accels = [s for s in imus if s not in with_gyro and is_measured(s.columns(7, 10)).any()]
    lone = [s for s in with_gyro if not is_measured(s.columns(7, 10)).any()]
    found: list[Series] = []
    left = list(accels)
    for gyro in with_gyro:
        own = [a for a in accels if _of_device(a.name) == _of_device(gyro.name)]
        if gyro in lone and not own and len(lone) == len(accels) == 1:
            own = accels
        if gyro not in lone or len(own) != 1:
            found.append(_one(gyro, Kind.IMU, gyro.axes, _read_imu))
            continue
        note = f"{gyro.axes}; acceleration from {own[0].name}"
        found.append(_one(gyro, Kind.IMU, note, partial(_read_joined, own[0])))
        left = [a for a in left if a is not own[0]]
    return WithProblems(found, tuple(f"{a.name}: an accelerometer without gyroscope, left out" for a in left))


def _of_device(topic: str) -> str:
    """Name of a sensor's topic without the word for the sensor."""
    return re.sub(r"gyro(scope)?|acc(el(erometer)?)?", "", topic, flags=re.IGNORECASE)


def _one(samples: Samples, kind: Kind, note: str, read: Callable[[Samples], WithProblems[Stream]]) -> Series:
    topic = Topic(samples.name, kind, samples.t_ns, f"{note}; {samples.clock}")
    return Series(topic, lambda: samples.with_remarks(read(samples)))


def _frame(wire: Wire, samples: Samples) -> str:
    return f"in {wire.frame_id(samples.first) or 'a frame without name'}, z up taken"


def _any_quaternion(q: FloatArray) -> bool:
    """Whether any of these (n, 4) is a quaternion: drivers without an attitude write zeros."""
    return bool((np.abs(np.linalg.norm(np.nan_to_num(q), axis=1) - 1.0) < 0.05).any())


def _read_imu(samples: Samples) -> WithProblems[ImuStream]:
    where = samples.where()
    return imu_stream(samples.t_ns, samples.columns(4, 7), samples.columns(7, 10), where)


def _read_joined(accel: Samples, gyro: Samples) -> WithProblems[ImuStream]:
    force = VectorStream(accel.t_ns, accel.columns(7, 10))
    return joined_imu(gyro.t_ns, gyro.columns(4, 7), force, gyro.where(), accel.where())


def _read_attitude(start: int, samples: Samples) -> WithProblems[AttitudeStream]:
    return attitude_stream(samples.t_ns, samples.columns(start, start + 4), samples.where())


def _read_position(samples: Samples) -> WithProblems[VectorStream]:
    return vector_stream(samples.t_ns, samples.columns(0, 3), samples.where(), MAX_POSITION)


def _velocity_columns(samples: Samples) -> FloatArray:
    start = 7 if samples.kind is RosType.ODOMETRY else 0
    return samples.columns(start, start + 3)


def _read_velocity(samples: Samples) -> WithProblems[VectorStream]:
    """Velocity along the body's axes, as defined; some odometry is along the world's, detected by its pose."""
    velocity = _velocity_columns(samples)
    if samples.kind is RosType.ODOMETRY:
        pose = samples.columns(0, 3), samples.columns(3, 7)
        if axes_of_velocity(samples.t_ns, *pose, velocity) is Axes.WORLD:
            attitude = attitude_stream(samples.t_ns, pose[1], samples.where()).value
            stream, problems = velocity_stream(samples.t_ns, velocity, attitude, samples.where())
            problem = f"{samples.name}: its velocity is along the world's axes, as its positions move; turned"
            return WithProblems(stream, (Remark(problem), *problems))
    return vector_stream(samples.t_ns, velocity, samples.where(), MAX_VELOCITY)


def _read_world_velocity(turning: Series, samples: Samples) -> WithProblems[VectorStream]:
    attitude = turning.read().value  # its problems are reported when it is read itself
    where = samples.where()
    return velocity_stream(samples.t_ns, _velocity_columns(samples), cast(AttitudeStream, attitude), where)


def _read_range(samples: Samples) -> WithProblems[RangeStream]:
    distance_m, low_m, high_m = samples.values.T
    return range_stream(samples.t_ns, distance_m, samples.where(), limits_m=(low_m, high_m))


def _repeats(t_ns: TimeArray) -> npt.NDArray[np.int64]:
    """Count earlier samples of the same time (n,), for sorted times."""
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
