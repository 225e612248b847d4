"""What a log holds and what can be made of it: `corridor inspect`, for any format, without reading every picture.

Each topic is described by its times; IMUs and cameras by a look at their samples. One stream that cannot be read does
not keep the others from being described.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from fusion.flight import GreyImage
from fusion.inspection.advice import Sentence, advise
from fusion.inspection.findings import CameraFindings, StreamFindings
from fusion.inspection.imu import inspect_imu
from fusion.inspection.pictures import inspect_pictures
from fusion.inspection.times import share_covered, time_stream
from fusion.logs.contents import Kind, LogContents, Topic
from fusion.logs.plausibility.findings import Advice, Finding
from fusion.logs.plausibility.flight import Streams, examine_streams
from fusion.logs.topic_choice import choose_topic
from vision import InputError


@dataclass(frozen=True, slots=True)
class Inspection:
    """A log described.

    Parameters
    ----------
    path, format
        What was opened, and as what.
    streams
        Every topic, the chosen ones of each kind first.
    problems
        Of the file as a whole.
    findings
        What is implausible about the chosen streams.
    advice
        What can be fused, what is missing and how to supply it, one sentence each.
    first_picture
        The chosen camera's first picture that decodes, grey (h, w).
    """

    path: str
    format: str
    streams: tuple[StreamFindings, ...]
    problems: tuple[str, ...]
    findings: tuple[Finding, ...]
    advice: tuple[Sentence, ...]
    first_picture: GreyImage | None = field(default=None, repr=False)


def inspect_log(log: LogContents, *, is_folder: bool = False, name: str | None = None) -> Inspection:
    """Describe an opened log.

    Parameters
    ----------
    log
        Any format's, see `fusion.logs.contents`.
    is_folder
        Whether it is a flight folder in the ASL layout, for the wording of what to change.
    name
        What to call it; else its path.
    """
    name = str(log.path) if name is None else name
    chosen, unclear = _choose(log)
    pictures = [t.t_ns for t in log.topics if t.kind is Kind.FRAMES and t.name in chosen[t.kind]]
    reading = _Reading(log, chosen)
    streams: list[StreamFindings] = []
    for topic in sorted(log.topics, key=lambda t: (list(Kind).index(t.kind), t.name not in chosen[t.kind])):
        found = reading.stream(topic)
        if pictures and topic.kind is not Kind.FRAMES:
            found = replace(found, frames_covered=share_covered(pictures[0], topic.t_ns))
        streams.append(found)
    _, findings = examine_streams(reading.streams, Advice(is_folder=is_folder))
    return Inspection(
        name,
        log.format,
        tuple(streams),
        tuple(log.problems),
        tuple(findings),
        tuple(advise(name, streams, findings, unclear)),
        reading.first_picture,
    )


def _choose(log: LogContents) -> tuple[dict[Kind, set[str]], dict[Kind, str]]:
    """Return the topic of each kind that would be fused, and why there is none where it is not clear."""
    chosen: dict[Kind, set[str]] = {}
    unclear: dict[Kind, str] = {}
    for kind in Kind:
        said: list[str] = []
        try:
            name = choose_topic(log, kind, None, said)
        except InputError as error:
            name = None
            said.append(f"{error.problem}: {error.remedy}")
        chosen[kind] = set() if name is None else {name}
        if said:
            unclear[kind] = said[0]
    return chosen, unclear


class _Reading:
    """A log under inspection: the chosen streams are kept for what they show together."""

    def __init__(self, log: LogContents, chosen: dict[Kind, set[str]]) -> None:
        self.log = log
        self.first_picture: GreyImage | None = None
        self.streams = Streams()
        self._chosen = chosen

    def stream(self, topic: Topic) -> StreamFindings:
        """Describe a topic; what cannot be read becomes its ``error``."""
        is_chosen = topic.name in self._chosen[topic.kind]
        found = StreamFindings(topic.name, topic.kind, topic.note, is_chosen, time_stream(topic.t_ns))
        problems: list[str] = []
        try:
            found = self._looked_at(topic.name, found, problems)
        except InputError as error:
            found = replace(found, error=str(error))
        return replace(found, problems=tuple(problems))

    def _looked_at(self, name: str, found: StreamFindings, problems: list[str]) -> StreamFindings:
        kept = self.streams
        match found.kind:
            case Kind.FRAMES:
                frames = self.log.frames(name, problems)
                pictures, first = inspect_pictures(frames)
                if found.chosen:
                    self.first_picture = first
                    self.streams = replace(kept, frames_t_ns=frames.t_ns)
                return replace(found, pictures=pictures, camera=self._camera(name, problems))
            case Kind.IMU:
                imu = self.log.imu(name, problems)
                if found.chosen:
                    self.streams = replace(kept, imu=imu)
                return replace(found, imu=inspect_imu(imu))
            case Kind.ATTITUDE:
                attitude = self.log.attitude(name, problems)
                if found.chosen:
                    self.streams = replace(kept, attitude=attitude)
            case Kind.POSITION:
                position = self.log.position(name, problems)
                if found.chosen:
                    self.streams = replace(kept, position=position)
            case Kind.VELOCITY:
                velocity = self.log.velocity(name, problems)
                if found.chosen:
                    self.streams = replace(kept, velocity=velocity)
            case Kind.RANGE:
                distance = self.log.range(name, problems)
                least, usual, most = np.percentile(distance.distance_m, [0, 50, 100]).tolist()
                found = replace(found, distances_m=(least, usual, most))
                if found.chosen:
                    self.streams = replace(kept, range=distance)
        return found

    def _camera(self, name: str, problems: list[str]) -> CameraFindings | None:
        try:
            camera = self.log.camera(name)
        except InputError as error:
            problems.append(str(error))
            return None
        if camera is None:
            return None
        mounting = camera.mount_problem()
        if mounting is not None:
            problems.append(mounting)
        return CameraFindings.of(camera)
