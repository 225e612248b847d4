"""What `corridor inspect` is pointed at: one log, or the several that a ``flight.toml`` names, as one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

from fusion.flight import AttitudeStream, FrameStream, ImuStream, RangeStream, VectorStream
from fusion.inspection.log import Inspection, inspect_log
from fusion.logs import open_log
from fusion.logs.contents import Kind, LogContents, Topic
from fusion.logs.manifest.assembly import open_as_told
from fusion.logs.manifest.manifest import (
    Manifest,
    StreamSource,
    corrected_camera,
    find_manifest,
    read_manifest,
)
from fusion.logs.plausibility.flight import is_asl
from fusion.logs.plausibility.mounting import mounted
from fusion.logs.topic_choice import TABLES
from vision import Camera, InputError

Stream = TypeVar("Stream", bound=Any)


def inspect_path(path: Path) -> Inspection:
    """Describe a log file, a flight's folder or a manifest.

    Raises
    ------
    InputError
        Where there is nothing of a known format, or nothing of it can be read.
    """
    if not path.exists():
        raise InputError("there is no such file or folder", file=path, remedy="check the path")
    described = find_manifest(path)
    if described is not None:
        return inspect_log(DescribedLog(described, read_manifest(described)), name=str(path))
    return inspect_log(open_log(path), is_folder=is_asl(path), name=str(path))


class DescribedLog:
    """The streams that a manifest names, as one log: chosen topics, the flight's clock, the corrected camera.

    A file that cannot be opened is told in ``problems`` and keeps no other from being read.
    """

    format = "flight.toml"

    def __init__(self, path: Path, manifest: Manifest) -> None:
        self.path = path
        manifest = with_time_shift(manifest)
        self._manifest = manifest
        self._logs: dict[Kind, LogContents] = {}
        topics: list[Topic] = []
        problems: list[str] = []
        opened: dict[str, LogContents | None] = {}
        for kind in Kind:
            source = manifest.stream(TABLES[kind])
            file = source.file or manifest.log
            if file is None or not source.use:
                continue
            log = self._open(file, source, opened, problems)
            if log is None:
                continue
            self._logs[kind] = log
            own = "" if file == manifest.log else file.name
            found = [
                topic for topic in log.topics if topic.kind is kind and source.topic in (None, topic.name)
            ]
            if not found and (source.file is not None or source.topic is not None):
                what = source.topic or "stream of this kind"
                problems.append(f"[{TABLES[kind]}]: {file.name} has no {what}")
            topics += [self._on_the_clock(topic, source, own) for topic in found]
        self.topics = tuple(topics)
        self.problems = tuple(problems)

    @staticmethod
    def _open(
        file: Path, source: StreamSource, opened: dict[str, LogContents | None], problems: list[str]
    ) -> LogContents | None:
        told = ("columns", "frame", "times", "start_ns")
        key = repr((file, [getattr(source, name, None) for name in told]))
        if key not in opened:
            try:
                log: LogContents | None = open_as_told(file, source)
            except InputError as error:
                problems.append(str(error))
                log = None
            problems += () if log is None else [p for p in log.problems if p not in problems]
            opened[key] = log
        return opened[key]

    @staticmethod
    def _on_the_clock(topic: Topic, source: StreamSource, file: str) -> Topic:
        shift_ns = round(source.clock_offset_s * 1e9)
        shift = f"{source.clock_offset_s:+.3f} s" if shift_ns else ""
        note = "; ".join(part for part in (file, topic.note, shift) if part)
        return replace(topic, t_ns=topic.t_ns + shift_ns, note=note)

    def _read(
        self, kind: Kind, read: Callable[[str, list[str]], Stream], topic: str, problems: list[str]
    ) -> Stream:
        stream = read(topic, problems)
        source = self._manifest.stream(TABLES[kind])
        shifted: Stream = replace(stream, t_ns=stream.t_ns + round(source.clock_offset_s * 1e9))
        return mounted(shifted, source)

    def frames(self, topic: str, problems: list[str]) -> FrameStream:
        """Pictures, on the flight's clock."""
        return self._read(Kind.FRAMES, self._logs[Kind.FRAMES].frames, topic, problems)

    def camera(self, topic: str) -> Camera | None:
        """Return the calibration that the manifest names, else the log's own, with the manifest's corrections."""
        log, source = self._logs[Kind.FRAMES], self._manifest.camera
        if source.calibration is not None:
            camera: Camera | None = Camera.from_yaml(source.calibration, getattr(log, "body_frame", None))
        else:
            camera = log.camera(topic)
        return None if camera is None else corrected_camera(camera, source)

    def imu(self, topic: str, problems: list[str]) -> ImuStream:
        """Gyroscope and accelerometer, with the noise that the manifest names."""
        imu = self._read(Kind.IMU, self._logs[Kind.IMU].imu, topic, problems)
        if self._manifest.imu.noise is None:
            return imu
        from vision.cameras.calibration import read_imu_noise

        noise = read_imu_noise(self._manifest.imu.noise)
        return replace(
            imu, gyro_noise_density=noise.gyro_noise_density, gyro_random_walk=noise.gyro_random_walk
        )

    def attitude(self, topic: str, problems: list[str]) -> AttitudeStream:
        """Attitude, on the flight's clock."""
        return self._read(Kind.ATTITUDE, self._logs[Kind.ATTITUDE].attitude, topic, problems)

    def position(self, topic: str, problems: list[str]) -> VectorStream:
        """Position, on the flight's clock."""
        return self._read(Kind.POSITION, self._logs[Kind.POSITION].position, topic, problems)

    def velocity(self, topic: str, problems: list[str]) -> VectorStream:
        """Velocity, on the flight's clock."""
        return self._read(Kind.VELOCITY, self._logs[Kind.VELOCITY].velocity, topic, problems)

    def range(self, topic: str, problems: list[str]) -> RangeStream:
        """Distance to the floor, from the camera's height, on the flight's clock."""
        return self._read(Kind.RANGE, self._logs[Kind.RANGE].range, topic, problems)


def with_time_shift(manifest: Manifest) -> Manifest:
    """Return a manifest with the clock offset of a Kalibr chain where it leaves that open, as fusing does."""
    from vision.cameras.calibration import read_time_shift_s

    source = manifest.camera
    if source.calibration is None or "clock_offset_s" in source.model_fields_set:
        return manifest
    try:
        shift_s = read_time_shift_s(source.calibration)
    except InputError:  # told where the calibration is read
        shift_s = None
    if shift_s is None:
        return manifest
    return manifest.model_copy(update={"camera": source.model_copy(update={"clock_offset_s": shift_s})})
