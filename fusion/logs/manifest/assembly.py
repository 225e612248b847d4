"""Assemble a flight from the streams of its manifest, on one clock, with its camera corrected."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, TypeVar

from fusion.flight import CorridorTruth, Flight, FrameStream, TimeArray
from fusion.logs.contents import Kind, LogContents, UndecidedError
from fusion.logs.csv import phone_folder
from fusion.logs.manifest.manifest import Manifest, StreamSource, camera_problems, files_of
from fusion.logs.manifest.sources import ManifestLog
from fusion.logs.pictures.camera_folder import check_size, darkness_problem
from fusion.logs.plausibility.clocks import is_unix, span
from fusion.logs.plausibility.flight import check_flight
from fusion.logs.samples import Problems, WithProblems
from fusion.logs.topic_choice import TABLES, WORDS, contents_in_words
from fusion.settings.toml import toml_value
from vision import Camera, InputError

AnyStream = TypeVar("AnyStream", bound=Any)

VIDEO_HINT = (
    "give the video too: corridor fuse {log} --video VIDEO --camera CAM.yaml, or name it in a flight.toml"
)


def assemble_flight(manifest: Manifest, camera: Camera | Path | None = None) -> Flight:
    """Read the streams that a manifest names or leaves to be chosen, on one clock.

    Parameters
    ----------
    manifest
        With absolute paths, as `fusion.logs.manifest.file.read_manifest` returns it.
    camera
        Calibration to use instead of the manifest's; the manifest's corrections apply to either.

    Returns
    -------
    Flight
        Its ``manifest`` names every chosen topic.

    Raises
    ------
    InputError
        In one line: file, field, value and remedy.
    """
    if isinstance(camera, Path):
        manifest, camera = manifest.with_calibration(camera), None
    return flight_of(ManifestLog(manifest, camera=camera))


def flight_of(sources: ManifestLog) -> Flight:
    """Return the sources of the streams to be fused.

    Raises
    ------
    InputError
        In one line: file, field, value and remedy.
    """
    for key, path in files_of(sources.manifest):
        if not path.exists():
            raise InputError(f"there is no such file or folder ({key})", file=path, remedy="check the path")
    return _Assembly(sources).flight()


def checked_flight(sources: ManifestLog, path: Path) -> Flight:
    """Read a flight, and reject it if its streams contradict each other, for `corridor fuse` and `inspect` alike.

    Parameters
    ----------
    sources
        The sources to be fused.
    path
        The path that the user gave, for messages.

    Raises
    ------
    InputError
        In one line: file, field, value and remedy.
    """
    flight = flight_of(sources)
    files = {name: s.file for name, s in sources.manifest.streams().items() if s.file is not None}
    return check_flight(flight, path, files, sources.advice())


class _Assembly:
    """A flight being assembled: problems so far, and the chosen topics."""

    def __init__(self, sources: ManifestLog) -> None:
        self.sources = sources
        self.problems: list[str] = []
        self._changes: dict[str, StreamSource] = {}

    def flight(self) -> Flight:
        """Read all streams, first the pictures, which every flight needs."""
        sources = self.sources
        log, topic = self._picture_topic()
        frames = self._collect_problems(sources.frames(topic))
        camera = self._camera(log, topic)
        check_size(frames, camera, log.path)
        dark = darkness_problem(frames)
        self._note(() if dark is None else (dark,))
        return Flight(
            sources.manifest.name or self._name(log),
            camera,
            frames,
            self._stream(Kind.IMU, sources.imu, frames.t_ns),
            self._stream(Kind.ATTITUDE, sources.attitude, frames.t_ns),
            self._stream(Kind.POSITION, sources.position, frames.t_ns),
            self._stream(Kind.VELOCITY, sources.velocity, frames.t_ns),
            self._truth(frames),
            range=self._stream(Kind.RANGE, sources.range, frames.t_ns),
            problems=tuple(self.problems),
            corridor_width_m=sources.manifest.corridor_width_m,
            manifest=sources.manifest.model_copy(
                update={**self._changes, "body_from_imu_rad": self._body_from_imu()}
            ),
        )

    def _body_from_imu(self) -> tuple[float, float, float] | None:
        """Rotation that was found, unless the manifest determines it."""
        rig = self.sources.rig.value
        return None if rig is None or rig.looks_up_rad is not None else rig.mount_rad

    def _note(self, problems: Problems) -> None:
        """Add problems, each only once even if a file or topic is read twice."""
        self.problems += [text for text in problems if text not in self.problems]

    def _collect_problems(self, read: WithProblems[AnyStream]) -> AnyStream:
        self._note(read.problems)
        return read.value

    def _picture_topic(self) -> tuple[LogContents, str]:
        source = self.sources.manifest.camera
        log = self.sources.log(Kind.FRAMES)
        if log is None:
            raise InputError("no pictures are named", remedy="give a log, or a video with --video")
        self._note(log.problems)
        topic = self._collect_problems(self.sources.choose(Kind.FRAMES))
        if topic is None:
            path = source.file or self.sources.manifest.log or log.path
            remedy = log.pictures_remedy or VIDEO_HINT.format(log=path.name)
            raise InputError(
                f"{log.format} without pictures; it contains {contents_in_words(log)}",
                file=path,
                remedy=remedy,
            )
        self._changes["camera"] = source.model_copy(update={"topic": topic})
        return log, topic

    def _camera(self, log: LogContents, topic: str) -> Camera:
        camera = self.sources.camera(topic)
        self._note(self.sources.rig.problems)
        if camera is None:
            missing = log.calibration_file(topic)
            raise InputError(
                "contains no calibration of the camera" if missing is None else "there is no such file",
                file=missing or log.path,
                remedy="add the calibration: name it with --camera, or under [camera] in flight.toml"
                + self._alignment_remedy(),
            )
        self._note(camera_problems(camera))
        return camera

    def _alignment_remedy(self) -> str:
        """Explain how to find the focal length; `corridor align` takes a log or a manifest, not single files."""
        manifest, imu = self.sources.manifest, self.sources.log(Kind.IMU)
        if imu is None or not any(topic.kind is Kind.IMU for topic in imu.topics):
            return ""
        declared = manifest.model_dump(mode="json", exclude_defaults=True)
        if imu.format == phone_folder.FORMAT:
            declared["imu"] = {"camera_axis": phone_folder.CAMERA_AXIS} | declared.get("imu", {})
        if declared.keys() == {"log"}:
            return f"; where there is none, `corridor align {manifest.log} --write` finds the focal length"
        lines = ", ".join(_lines(declared))
        return (
            "; where there is none, `corridor align flight.toml --write` finds the focal length, with these lines in "
            f"flight.toml: {lines}"
        )

    def _stream(
        self, kind: Kind, read: Callable[[str], WithProblems[AnyStream]], frame_t_ns: TimeArray
    ) -> AnyStream | None:
        log, source = self.sources.log(kind), self.sources.source(kind)
        if log is None:
            return None
        self._note(log.problems)
        topic = self._collect_problems(self.sources.choose(kind))
        if topic is None:
            if source.file is not None:
                raise InputError(
                    f"contains no {WORDS[kind]}; it contains {contents_in_words(log)}",
                    file=source.file,
                    remedy=f"name another file under [{TABLES[kind]}], or the columns of this one",
                )
            return None
        try:
            stream = self._collect_problems(read(topic))
        except InputError as error:
            # Streams that were not requested are optional; range finders are often carried beyond their reach.
            is_dispensable = kind is Kind.RANGE or isinstance(error, UndecidedError)
            if not is_dispensable or source.file is not None or source.topic is not None:
                raise
            self._note((f"{log.path.name}: {error.problem}: left out; {error.remedy}",))
            return None
        self._changes[TABLES[kind]] = source.model_copy(update={"topic": topic})
        self._check_clock(log.file_of(topic), TABLES[kind], stream.t_ns, frame_t_ns)
        return stream

    def _truth(self, frames: FrameStream) -> CorridorTruth | None:
        from fusion.logs.asl import TRUTH_NAME

        truth = self._collect_problems(self.sources.truth())
        if truth is not None:
            log = self.sources.whole_log()
            beside = (log.path if log is not None else Path()) / TRUTH_NAME
            self._check_clock(self.sources.manifest.truth or beside, "truth", truth.t_ns, frames.t_ns)
        return truth

    def _name(self, log: LogContents) -> str:
        log = self.sources.whole_log() or log  # the whole log knows its root, even if only a part was named
        return log.path.name if log.path.is_dir() else log.path.stem

    def _check_clock(self, file: Path, table: str, t_ns: TimeArray, frame_t_ns: TimeArray) -> None:
        """Raise `InputError` if a stream and the frames do not overlap in time."""
        if t_ns[0] <= frame_t_ns[-1] and t_ns[-1] >= frame_t_ns[0]:
            return
        lag_s = float(t_ns[0] - frame_t_ns[0]) * 1e-9 + self.sources.manifest.camera.clock_offset_s
        zero = (
            "" if is_unix(t_ns) == is_unix(frame_t_ns) else "; one is Unix time, the other counts from zero"
        )
        raise InputError(
            f"covers {span(t_ns)}, the frames {span(frame_t_ns)}{zero}",
            file=file,
            remedy=f"if both began together, set clock_offset_s = {lag_s:.3f} for [camera] in flight.toml, or give "
            f"--clock-offset {lag_s:.3f}; `corridor align` finds the rest; or leave the {table} out",
        )


def _lines(values: Mapping[str, Any], table: str = "") -> Iterator[str]:
    """Yield the lines of a manifest with these values, each with its table's name before the key."""
    for key, value in values.items():
        if isinstance(value, Mapping):
            yield from _lines(value, f"{table}{key}.")
        else:
            yield f"{table}{key} = {toml_value(value)}"
