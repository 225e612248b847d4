"""Contents of a log, and what can be fused: `corridor inspect` for any format, without reading every picture.

Each topic is described by its times, IMUs and cameras also by their samples. If one stream cannot be read, the others
are still described.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from fusion.flight import AttitudeStream, FrameStream, GreyImage, ImuStream, RangeStream, VectorStream
from fusion.inspection.advice import Sentence, advise
from fusion.inspection.findings import CameraFindings, StreamFindings
from fusion.inspection.imu import inspect_imu
from fusion.inspection.pictures import inspect_pictures
from fusion.inspection.times import share_covered, time_stream
from fusion.logs.contents import Kind, LogContents, Topic
from fusion.logs.manifest.manifest import camera_problems
from fusion.logs.pictures.camera_folder import darkness_problem
from fusion.logs.plausibility.findings import Advice, Finding
from fusion.logs.plausibility.flight import Streams, examine_streams
from fusion.logs.plausibility.lens import examine_lens
from fusion.logs.samples import Problems, WithProblems
from fusion.logs.topic_choice import choose_topic
from vision import Camera, InputError

#: Name of each kind of stream in a manifest and in `Streams`.
_NAMES = {kind: "camera" if kind is Kind.FRAMES else kind.value for kind in Kind}


@dataclass(frozen=True, slots=True)
class Inspection:
    """Description of a log.

    Parameters
    ----------
    path, format
        Path and format of the log.
    streams
        All topics, the chosen ones of each kind first.
    problems
        Of the whole file.
    findings
        Implausible properties of the chosen streams.
    advice
        What can be fused, what is missing and how to supply it, one sentence each.
    first_picture
        The chosen camera's first picture that can be decoded, grey (h, w).
    """

    path: str
    format: str
    streams: tuple[StreamFindings, ...]
    problems: Problems
    findings: tuple[Finding, ...]
    advice: tuple[Sentence, ...]
    first_picture: GreyImage | None = field(default=None, repr=False)


def inspect_log(
    log: LogContents,
    *,
    name: str | None = None,
    choose: Callable[[Kind], WithProblems[str | None]] | None = None,
    advice: Advice = Advice(),  # noqa: B008  # frozen
    refusal: InputError | None = None,
) -> Inspection:
    """Describe an opened log.

    Parameters
    ----------
    log
        Of any format, see `fusion.logs.contents`.
    name
        Name to use instead of its path.
    choose
        Chooses the topic of each kind to fuse; default `fusion.logs.topic_choice.choose_topic`.
    advice
        Words the remedies.
    refusal
        Reason why `corridor fuse` would reject it, if any.
    """
    name = str(log.path) if name is None else name
    chosen, unclear = _chosen(log, choose or partial(choose_topic, log))
    pictures = [t.t_ns for t in log.topics if t.kind is Kind.FRAMES and t.name in chosen[t.kind]]
    reading = _Reading(log, chosen)
    streams: list[StreamFindings] = []
    for topic in sorted(log.topics, key=lambda t: (list(Kind).index(t.kind), t.name not in chosen[t.kind])):
        found = reading.stream(topic)
        if pictures and topic.kind is not Kind.FRAMES:
            found = replace(found, frames_covered=share_covered(pictures[0], topic.t_ns))
        streams.append(found)
    alive, findings = examine_streams(reading.streams, advice)
    if reading.lens is not None:
        findings.append(reading.lens)
    return Inspection(
        name,
        log.format,
        tuple(streams),
        tuple(log.problems),
        tuple(findings),
        tuple(advise(name, _as_fused(streams, alive), findings, unclear, refusal)),
        reading.first_picture,
    )


def _as_fused(found: list[StreamFindings], alive: Streams) -> list[StreamFindings]:
    """Return the streams as they would be fused.

    Without constant streams and a dead accelerometer, and with the times after reading.
    """
    times = alive.times()
    kept = []
    for stream in found:
        if stream.chosen:
            if _NAMES[stream.kind] not in times:
                continue
            stream = replace(stream, timing=time_stream(times[_NAMES[stream.kind]]))
        kept.append(stream)
    if alive.imu is None or np.isfinite(alive.imu.accel_m_s2).any():
        return kept
    return [
        replace(stream, imu=replace(stream.imu, usual_accel_m_s2=None))
        if stream.chosen and stream.imu is not None
        else stream
        for stream in kept
    ]


def _chosen(
    log: LogContents, choose: Callable[[Kind], WithProblems[str | None]]
) -> tuple[dict[Kind, set[str]], dict[Kind, str]]:
    """Return the topic of each kind that would be fused, and the reason if there is no clear choice."""
    chosen: dict[Kind, set[str]] = {}
    unclear: dict[Kind, str] = {}
    for kind in Kind:
        chosen[kind] = set()
        try:
            name, problems = choose(kind)
        except InputError as error:
            name, problems = None, (f"{error.problem}: {error.remedy}",)
        if name is not None:
            chosen[kind] = {name}
        if problems:
            unclear[kind] = problems[0]
    return chosen, unclear


class _Reading:
    """A log under inspection; the chosen streams are kept for joint checks."""

    def __init__(self, log: LogContents, chosen: dict[Kind, set[str]]) -> None:
        self.log = log
        self.first_picture: GreyImage | None = None
        self.streams = Streams()
        self.lens: Finding | None = None
        self._chosen = chosen

    def stream(self, topic: Topic) -> StreamFindings:
        """Describe a topic; a reading error becomes its ``error``."""
        is_chosen = topic.name in self._chosen[topic.kind]
        found = StreamFindings(topic.name, topic.kind, topic.note, is_chosen, time_stream(topic.t_ns))
        try:
            examined, problems = self._with_samples(topic, found)
        except InputError as error:
            return replace(found, error=str(error))
        return replace(examined, problems=problems)

    def _with_samples(self, topic: Topic, found: StreamFindings) -> WithProblems[StreamFindings]:
        kept, name = self.streams, topic.name
        stream: FrameStream | ImuStream | AttitudeStream | VectorStream | RangeStream
        match found.kind:
            case Kind.FRAMES:
                stream, problems = frames, _ = self.log.frames(name)
                pictures, first = inspect_pictures(frames)
                dark = darkness_problem(frames) if found.chosen else None
                problems += () if dark is None else (dark,)
                if found.chosen:
                    self.first_picture = first
                    self.streams = replace(kept, frames_t_ns=frames.t_ns)
                camera, more = self._camera(name)
                problems += more
                if camera is not None:
                    found = replace(found, camera=CameraFindings.of(camera))
                    self.lens = examine_lens(frames, camera) if found.chosen else None
                found = replace(found, pictures=pictures)
            case Kind.IMU:
                stream, problems = imu, _ = self.log.imu(name)
                if found.chosen:
                    self.streams = replace(kept, imu=imu)
                found = replace(found, imu=inspect_imu(imu))
            case Kind.ATTITUDE:
                stream, problems = attitude, _ = self.log.attitude(name)
                if found.chosen:
                    self.streams = replace(kept, attitude=attitude)
            case Kind.POSITION:
                stream, problems = position, _ = self.log.position(name)
                if found.chosen:
                    self.streams = replace(kept, position=position)
            case Kind.VELOCITY:
                stream, problems = velocity, _ = self.log.velocity(name)
                if found.chosen:
                    self.streams = replace(kept, velocity=velocity)
            case Kind.RANGE:
                stream, problems = distance, _ = self.log.range(name)
                least, usual, most = np.percentile(distance.distance_m, [0, 50, 100]).tolist()
                found = replace(found, distances_m=(least, usual, most))
                if found.chosen:
                    self.streams = replace(kept, range=distance)
        if len(stream.t_ns) == len(topic.t_ns) and not np.isin(stream.t_ns, topic.t_ns).all():
            found = replace(found, timing=time_stream(stream.t_ns))  # reading changed its times
        return WithProblems(found, problems)

    def _camera(self, name: str) -> WithProblems[Camera | None]:
        try:
            camera = self.log.camera(name)
        except InputError as error:
            return WithProblems(None, (str(error),))
        if camera is None:
            return WithProblems(None)
        return WithProblems(camera, camera_problems(camera))
