"""A flight out of what its manifest names: topics chosen, clocks put together, camera corrected."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

from fusion.flight import CorridorTruth, Flight, FrameStream, TimeArray
from fusion.logs import open_log
from fusion.logs.contents import Kind, LogContents
from fusion.logs.manifest.manifest import (
    CameraSource,
    Manifest,
    StreamSource,
    corrected_camera,
    files_of,
)
from fusion.logs.pictures.camera_folder import check_size
from fusion.logs.plausibility.clocks import is_unix, span
from fusion.logs.plausibility.mounting import mounted
from fusion.logs.topic_choice import TABLES, WORDS, choose_topic, holdings
from vision import Camera, InputError

AnyStream = TypeVar("AnyStream", bound=Any)

VIDEO_HINT = (
    "give the video too: corridor fuse {log} --video VIDEO --camera CAM.yaml, or name it in a flight.toml"
)


def assemble_flight(manifest: Manifest, camera: Camera | Path | None = None) -> Flight:
    """Read the streams that a manifest names, or leaves to be found, onto one clock.

    Parameters
    ----------
    manifest
        With absolute paths, as `fusion.logs.manifest.manifest.read_manifest` returns it.
    camera
        Calibration to use instead of the manifest's; the manifest's corrections apply to either.

    Returns
    -------
    Flight
        Its ``manifest`` names every topic that was chosen.

    Raises
    ------
    InputError
        One line naming file, field, value and remedy.
    """
    for key, path in files_of(manifest):
        if not path.exists():
            raise InputError(f"there is no such file or folder ({key})", file=path, remedy="check the path")
    if isinstance(camera, Path):
        chosen = manifest.camera.model_copy(update={"calibration": camera.absolute()})
        manifest, camera = manifest.model_copy(update={"camera": chosen}), None
    return _Assembly(manifest, camera).flight()


class _Assembly:
    """One flight under way: logs opened so far, what went wrong, which topics were chosen."""

    def __init__(self, manifest: Manifest, camera: Camera | None) -> None:
        self.manifest = manifest
        self.problems: list[str] = []
        self._given_camera = camera
        self._logs: dict[tuple[object, ...], LogContents] = {}
        self._changes: dict[str, StreamSource] = {}

    def flight(self) -> Flight:
        """Read everything; the pictures first, since without them all else is in vain."""
        self._take_time_shift()
        log, topic = self._picture_topic()
        frames = self._shifted(log.frames(topic, self.problems), self.manifest.camera)
        camera = self._camera(log, topic)
        check_size(frames, camera, log.path)
        imu = self._stream(Kind.IMU, lambda log: log.imu, frames.t_ns)
        noise = self.manifest.imu.noise
        if imu is not None and noise is not None:
            from vision.cameras.calibration import read_imu_noise

            declared = read_imu_noise(noise)
            imu = replace(
                imu,
                gyro_noise_density=declared.gyro_noise_density,
                gyro_random_walk=declared.gyro_random_walk,
            )
        return Flight(
            self.manifest.name or self._name(log),
            camera,
            frames,
            imu,
            self._stream(Kind.ATTITUDE, lambda log: log.attitude, frames.t_ns),
            self._stream(Kind.POSITION, lambda log: log.position, frames.t_ns),
            self._stream(Kind.VELOCITY, lambda log: log.velocity, frames.t_ns),
            self._truth(frames),
            range=self._stream(Kind.RANGE, lambda log: log.range, frames.t_ns),
            problems=tuple(self.problems),
            corridor_width_m=self.manifest.corridor_width_m,
            manifest=self.manifest.model_copy(update=self._changes),
        )

    def _take_time_shift(self) -> None:
        """Take the camera's clock offset from a Kalibr chain, where the manifest leaves it open."""
        from vision.cameras.calibration import read_time_shift_s

        source = self.manifest.camera
        if source.calibration is None or "clock_offset_s" in source.model_fields_set:
            return
        shift_s = read_time_shift_s(source.calibration)
        if shift_s is not None:
            source = source.model_copy(update={"clock_offset_s": shift_s})
            self.manifest = self.manifest.model_copy(update={"camera": source})

    def _open(self, path: Path, source: StreamSource) -> LogContents:
        """Open a file once, however many streams come from it; the file's own problems are told once."""
        told = (
            source.columns,
            source.frame,
            getattr(source, "times", None),
            getattr(source, "start_ns", None),
        )
        key = (path, *(repr(value) for value in told))
        if key not in self._logs:
            self._logs[key] = open_as_told(path, source)
            self.problems += [text for text in self._logs[key].problems if text not in self.problems]
        return self._logs[key]

    def _picture_topic(self) -> tuple[LogContents, str]:
        source = self.manifest.camera
        path = source.file or self.manifest.log
        if path is None:
            raise InputError("no pictures are named", remedy="give a log, or a video with --video")
        log = self._open(path, source)
        topic = choose_topic(log, Kind.FRAMES, source.topic, self.problems)
        if topic is None:
            remedy = getattr(log, "no_pictures", None) or VIDEO_HINT.format(log=path.name)
            raise InputError(
                f"{log.format} without pictures; it holds {holdings(log)}", file=path, remedy=remedy
            )
        self._changes["camera"] = source.model_copy(update={"topic": topic})
        return log, topic

    def _camera(self, log: LogContents, topic: str) -> Camera:
        source = self.manifest.camera
        camera = self._given_camera
        if camera is None and source.calibration is not None:
            camera = Camera.from_yaml(source.calibration, body_frame=getattr(log, "body_frame", None))
        if camera is None:
            camera = log.camera(topic)
        if camera is None:
            missing = getattr(log, "calibration_file", None)
            raise InputError(
                "holds no calibration of the camera" if missing is None else "there is no such file",
                file=log.path if missing is None else missing(topic),
                remedy="add the calibration: name it with --camera, or under [camera] in flight.toml",
            )
        camera = corrected_camera(camera, source)
        mount_problem = camera.mount_problem()
        if mount_problem is not None:
            self.problems.append(mount_problem)
        return camera

    def _stream(
        self,
        kind: Kind,
        reader: Callable[[LogContents], Callable[[str, list[str]], AnyStream]],
        frame_t_ns: TimeArray,
    ) -> AnyStream | None:
        table = TABLES[kind]
        source = self.manifest.stream(table)
        path = source.file or self.manifest.log
        if path is None or not source.use:
            return None
        log = self._open(path, source)
        topic = choose_topic(log, kind, source.topic, self.problems)
        if topic is None:
            if source.file is not None:
                raise InputError(
                    f"holds no {WORDS[kind]}, only {holdings(log)}",
                    file=path,
                    remedy=f"name another file under [{table}], or the columns of this one",
                )
            return None
        try:
            read = reader(log)(topic, self.problems)
        except InputError as error:
            if kind is not Kind.RANGE or source.file is not None or source.topic is not None:
                raise
            self.problems.append(
                f"{error.problem}: left out"
            )  # range finders are often carried beyond their reach
            return None
        stream = mounted(self._shifted(read, source), source)
        self._changes[table] = source.model_copy(update={"topic": topic})
        file = getattr(log, "file_of", lambda topic: log.path)(topic)
        _check_clock(file, table, stream.t_ns, frame_t_ns, self.manifest.camera.clock_offset_s)
        return stream

    def _shifted(self, stream: AnyStream, source: StreamSource) -> AnyStream:
        """Put a stream onto the flight's clock."""
        shift_ns = round(source.clock_offset_s * 1e9)
        shifted: AnyStream = replace(stream, t_ns=stream.t_ns + shift_ns) if shift_ns else stream
        return shifted

    def _whole_log(self) -> LogContents | None:
        """Return the log that the manifest names for everything, if it was opened."""
        return next((log for key, log in self._logs.items() if key[0] == self.manifest.log), None)

    def _truth(self, frames: FrameStream) -> CorridorTruth | None:
        from fusion.logs.asl import TRUTH_NAME, read_corridor_truth

        if self.manifest.truth is not None:
            path = self.manifest.truth
            truth: CorridorTruth | None = read_corridor_truth(path, self.problems)
        else:
            log = self._whole_log()
            read = getattr(log, "truth", None)
            truth = read(self.problems) if read is not None else None
            path = (log.path if log is not None else Path()) / TRUTH_NAME
        if truth is not None:
            _check_clock(path, "truth", truth.t_ns, frames.t_ns, self.manifest.camera.clock_offset_s)
        return truth

    def _name(self, log: LogContents) -> str:
        log = self._whole_log() or log  # it knows its own root, where only a part of it was named
        return log.path.name if log.path.is_dir() else log.path.stem


def open_as_told(path: Path, source: StreamSource) -> LogContents:
    """Open a file as a manifest's table says: with its column map and axes, its frame times, its start.

    Raises
    ------
    InputError
        Where it does not open, or a key does not go with this kind of file.
    """
    from fusion.logs.csv import columns
    from fusion.logs.pictures import picture_folder as folder
    from fusion.logs.pictures import video

    if isinstance(source, CameraSource):
        if video.recognises(path):
            _refuse(source, ("frame",), path, "a video")
            return video.open_video(
                path, start_ns=source.start_ns or 0, times=source.times, columns=source.columns
            )
        if folder.recognises(path) and (source.times is not None or source.columns is not None):
            _refuse(source, ("start_ns", "frame"), path, "a folder of pictures")
            return folder.open_folder(path, times=source.times, columns=source.columns)
        _refuse(source, ("times", "start_ns", "columns", "frame"), path, "a log with pictures of its own")
        return open_log(path)
    if source.columns is not None or source.frame is not None:
        if not path.is_file() or (source.columns is None and not columns.recognises(path)):
            _refuse(source, ("columns", "frame"), path, "a log with columns and axes of its own")
        return columns.open_columns(path, source.columns, source.frame)
    return open_log(path)


def _refuse(source: StreamSource, keys: tuple[str, ...], path: Path, what: str) -> None:
    for key in keys:
        if getattr(source, key) is not None:
            raise InputError(f"is {what}: {key} does not go with it", file=path, remedy=f"take {key} away")


def _check_clock(
    file: Path, table: str, t_ns: TimeArray, frame_t_ns: TimeArray, clock_offset_s: float
) -> None:
    """Raise `InputError` where a stream and the frames have no time in common."""
    if t_ns[0] <= frame_t_ns[-1] and t_ns[-1] >= frame_t_ns[0]:
        return
    lag_s = float(t_ns[0] - frame_t_ns[0]) * 1e-9 + clock_offset_s
    zero = "" if is_unix(t_ns) == is_unix(frame_t_ns) else "; one is Unix time, the other counts from zero"
    raise InputError(
        f"covers {span(t_ns)}, the frames {span(frame_t_ns)}{zero}",
        file=file,
        remedy="put both on one clock: with [camera] clock_offset_s in flight.toml, or --clock-offset; "
        f"if both began together it is {lag_s:.3f}; or leave the {table} out",
    )
