"""Several opened logs as one: a data set with pictures and sensors in separate files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from fusion.flight import AttitudeStream, FrameStream, ImuStream, RangeStream, VectorStream
from fusion.logs.contents import Kind, LogContents, Topic
from fusion.logs.samples import Problems, WithProblems
from fusion.logs.series import no_such_topic
from vision import Camera, InputError


@dataclass(frozen=True, slots=True)
class Part:
    """A topic of another log: the log, and the topic's name in it."""

    log: LogContents
    topic: str


class CompositeLog(LogContents):
    """`LogContents` of several logs.

    Parameters
    ----------
    path, log_format
        Its path, and the name of its format.
    parts
        The topics, by kind and by name in the composite log.
    problems
        Problems of finding the parts; the parts' problems are added.
    camera_file
        Path of a calibration of its pictures, or None.
    """

    def __init__(
        self,
        path: Path,
        log_format: str,
        parts: Mapping[tuple[Kind, str], Part],
        problems: Problems = (),
        camera_file: Path | None = None,
    ) -> None:
        self.path, self.format = path, log_format
        self._parts = dict(parts)
        self._camera_file = camera_file
        self.topics = tuple(self._topic(kind, name, part) for (kind, name), part in self._parts.items())
        logs = {id(part.log): part.log for part in self._parts.values()}
        part_problems = (problem for log in logs.values() for problem in log.problems)
        self.problems = tuple(dict.fromkeys((*problems, *part_problems)))

    @staticmethod
    def _topic(kind: Kind, name: str, part: Part) -> Topic:
        (topic,) = (t for t in part.log.topics if t.kind is kind and t.name == part.topic)
        return Topic(name, kind, topic.t_ns, topic.note)

    def _part(self, kind: Kind, name: str) -> Part:
        if (kind, name) not in self._parts:
            raise no_such_topic(self.path, self.topics, kind, name)
        return self._parts[kind, name]

    def frames(self, topic: str) -> WithProblems[FrameStream]:
        """Pictures, decoded one at a time on request."""
        part = self._part(Kind.FRAMES, topic)
        return part.log.frames(part.topic)

    def camera(self, topic: str) -> Camera | None:
        """Read the data set's calibration."""
        if self._camera_file is not None:
            return Camera.from_yaml(self._camera_file)
        part = self._part(Kind.FRAMES, topic)
        return part.log.camera(part.topic)

    def imu(self, topic: str) -> WithProblems[ImuStream]:
        """Gyroscope and accelerometer, body FRD."""
        part = self._part(Kind.IMU, topic)
        return part.log.imu(part.topic)

    def attitude(self, topic: str) -> WithProblems[AttitudeStream]:
        """Body FRD to world z down."""
        part = self._part(Kind.ATTITUDE, topic)
        return part.log.attitude(part.topic)

    def position(self, topic: str) -> WithProblems[VectorStream]:
        """World, z down."""
        part = self._part(Kind.POSITION, topic)
        return part.log.position(part.topic)

    def velocity(self, topic: str) -> WithProblems[VectorStream]:
        """Body FRD."""
        part = self._part(Kind.VELOCITY, topic)
        return part.log.velocity(part.topic)

    def range(self, topic: str) -> WithProblems[RangeStream]:
        """Distance to the floor along the body's z."""
        raise InputError("contains no distances", file=self.path, remedy="leave [range] out")

    def file_of(self, topic: str) -> Path:
        """Return the file with a topic's times."""
        return next((p.log.path for (_, name), p in self._parts.items() if name == topic), self.path)
