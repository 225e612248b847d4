"""The streams of a manifest: file and topic of each, times and axes.

`corridor fuse` and `corridor inspect` both read a manifest through `ManifestLog`, so that they see the same streams.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from fusion.files import check_name
from fusion.flight import (
    AttitudeStream,
    CorridorTruth,
    FrameStream,
    ImuStream,
    RangeStream,
    Remark,
    VectorStream,
)
from fusion.logs.contents import Kind, LogContents, Topic
from fusion.logs.csv.column_map import ColumnMap
from fusion.logs.csv.columns import CsvLog
from fusion.logs.manifest.manifest import Manifest, StreamSource, corrected_camera, files_of
from fusion.logs.manifest.opening import (
    converted,
    medium_of,
    on_flights_clock,
    open_as_declared,
    with_time_shift,
)
from fusion.logs.pictures.camera_folder import check_focal_length, size_of_pictures
from fusion.logs.plausibility.findings import Advice, Medium
from fusion.logs.plausibility.imu import Gravity, gravity_of
from fusion.logs.plausibility.mounting import mounted, mounted_imu
from fusion.logs.plausibility.rig import (
    Rig,
    body_from_camera_axis,
    find_body_from_imu,
    turned_attitude,
    turned_camera,
    turned_velocity,
)
from fusion.logs.plausibility.rig import sentence as rig_sentence
from fusion.logs.samples import Problems, WithProblems
from fusion.logs.topic_choice import RANKED_FORMATS, TABLES, choose_topic
from vision import Camera, InputError
from vision.cameras.calibration import to_frd

AnyStream = TypeVar("AnyStream", bound=Any)


class ManifestLog(LogContents):
    """The streams that a manifest names, as one log: on the flight's clock, along the body's axes.

    Parameters
    ----------
    manifest
        With absolute paths. A clock offset that is not set is taken from the camera's calibration, if that is a
        Kalibr chain.
    path
        The manifest's file; None if there is none.
    camera
        Calibration to use instead of the manifest's; the manifest's corrections apply to either.
    """

    def __init__(self, manifest: Manifest, path: Path | None = None, camera: Camera | None = None) -> None:
        for _, file in files_of(manifest):
            check_name(file)
        self._described = path is not None
        self.path = path or manifest.log or manifest.camera.file or Path()
        self._shift_error: InputError | None = None
        try:
            self.manifest = with_time_shift(manifest)
        except InputError as error:  # raised when the calibration is read
            self.manifest, self._shift_error = manifest, error
        self._given_camera = camera
        self._opened: dict[tuple[Path, str], LogContents | InputError] = {}
        self._streams: dict[tuple[Kind, str], WithProblems[Any]] = {}

    def source(self, kind: Kind) -> StreamSource:
        """Return the manifest's table of a kind of stream."""
        return self.manifest.stream(TABLES[kind])

    def log(self, kind: Kind) -> LogContents | None:
        """Open the file of a kind of stream, once for all streams in it; None if the stream has no file.

        Raises
        ------
        InputError
            If the file cannot be opened.
        """
        source = self.source(kind)
        path = source.file or self.manifest.log
        if path is None or not source.use:
            return None
        key = (path, repr(source.open_options()))
        if key not in self._opened:
            try:
                self._opened[key] = open_as_declared(path, source)
            except InputError as error:
                self._opened[key] = error
        opened = self._opened[key]
        if isinstance(opened, InputError):
            raise opened
        return opened

    def advice(self) -> Advice:
        """Return advice on correcting streams, by the medium of each; opens only an IMU's table."""
        media: dict[str, Medium] = {}
        frames: dict[str, str] = {}
        for kind in Kind:
            source = self.source(kind)
            columns = source.columns
            frame = source.frame or (columns.frame if isinstance(columns, ColumnMap) else None)
            if frame is not None:
                frames[TABLES[kind]] = frame
            path = source.file or self.manifest.log
            if path is not None and path.exists():
                media[TABLES[kind]] = medium_of(path, source)
        taken: Mapping[str, float] = {}
        columns = self.manifest.imu.columns
        if media.get("imu") is Medium.TABLE:
            with suppress(InputError):
                log = self.log(Kind.IMU)
                taken = log.units_taken if isinstance(log, CsvLog) else {}
        elif isinstance(columns, ColumnMap):
            taken = columns.units_taken
        return Advice(media, taken, frames)

    def whole_log(self) -> LogContents | None:
        """Return the log that the manifest names for everything, if it was opened."""
        for (path, _), log in self._opened.items():
            if path == self.manifest.log and not isinstance(log, InputError):
                return log
        return None

    def choose(self, kind: Kind) -> WithProblems[str | None]:
        """Name the topic that a kind of stream is read from; None if there is none, or no clear choice.

        Raises
        ------
        InputError
            If the file cannot be opened, does not contain the manifest's topic, or contains several cameras or IMUs.
        """
        log = self.log(kind)
        return WithProblems(None) if log is None else choose_topic(log, kind, self.source(kind).topic)

    @property
    def format(self) -> str:  # type: ignore[override]
        """Format in words; that of the log if there is only one."""
        log = None if self._described else self.whole_log()
        return "flight.toml" if log is None else log.format

    @cached_property
    def topics(self) -> tuple[Topic, ...]:  # type: ignore[override]
        """All topics of the files that can be opened."""
        return tuple(topic for kind in Kind for topic in self._topics(kind))

    @cached_property
    def problems(self) -> Problems:  # type: ignore[override]
        """Problems of the files, and streams of the manifest that they do not contain."""
        found: list[str] = []
        for kind in Kind:
            source = self.source(kind)
            try:
                log = self.log(kind)
            except InputError as error:
                found.append(str(error))
                continue
            if log is None:
                continue
            found += log.problems
            if not self._topics(kind) and (source.file is not None or source.topic is not None):
                file = source.file or self.manifest.log or self.path
                what = source.topic or "stream of this kind"
                found.append(f"[{TABLES[kind]}]: {file.name} has no {what}")
        return tuple(dict.fromkeys((*found, *self.rig.problems)))

    def _topics(self, kind: Kind) -> list[Topic]:
        try:
            log = self.log(kind)
        except InputError:  # reported in `problems`
            return []
        source = self.source(kind)
        if log is None:
            return []
        own = "" if source.file is None or source.file == self.manifest.log else source.file.name
        shift = f"{source.clock_offset_s:+.3f} s" if source.clock_offset_s else ""
        rate = f"clock x {source.clock_rate:g}" if source.clock_rate != 1.0 else ""
        return [
            replace(
                topic,
                t_ns=on_flights_clock(topic.t_ns, source),
                note="; ".join(part for part in (own, topic.note, rate, shift) if part),
            )
            for topic in log.topics
            if topic.kind is kind and source.topic in (None, topic.name)
        ]

    def _read(
        self, kind: Kind, read: Callable[[LogContents], Callable[[str], WithProblems[AnyStream]]], topic: str
    ) -> WithProblems[AnyStream]:
        """Read a topic on the flight's clock, in SI units, corrected for the sensor's mounting."""
        if (kind, topic) not in self._streams:
            log, source = self.log(kind), self.source(kind)
            if log is None:
                raise InputError(f"names no {TABLES[kind]}", file=self.path, remedy="name it, or give a log")
            stream, problems = read(log)(topic)
            t_ns = on_flights_clock(stream.t_ns, source)
            shifted: Any = stream if t_ns is stream.t_ns else replace(stream, t_ns=t_ns)
            if isinstance(source.columns, ColumnMap) and not isinstance(log, CsvLog):
                shifted = converted(shifted, kind, source.columns)
            self._streams[kind, topic] = WithProblems(mounted(shifted, source), problems)
        found: WithProblems[AnyStream] = self._streams[kind, topic]
        return found

    @cached_property
    def rig(self) -> WithProblems[Rig | None]:
        """Common mounting of IMU and camera: as declared in the manifest, else as found; None: as read."""
        declared = self.manifest.body_from_imu_rad
        if declared is not None:
            return WithProblems(Rig(declared))
        try:
            log, gravity = self.log(Kind.IMU), self._gravity
            topic = self.choose(Kind.FRAMES).value
            if self.manifest.imu.camera_axis is not None and log is not None:
                return self._rig_by_axis(log, gravity)
            is_known = self._given_camera is not None or self.manifest.imu.mount_rad is not None
            if is_known or log is None or log.format in RANKED_FORMATS or gravity is None or topic is None:
                return WithProblems(None)
            camera = self._camera_as_calibrated(topic)
        except InputError:  # reported when that stream itself is read
            return WithProblems(None)
        found = None if camera is None else find_body_from_imu(gravity, camera)
        return (
            WithProblems(None) if found is None else WithProblems(Rig(found), (Remark(rig_sentence(found)),))
        )

    def _rig_by_axis(self, log: LogContents, gravity: Gravity | None) -> WithProblems[Rig | None]:
        """Find the IMU's mounting from gravity and the camera axis declared in the manifest."""
        name = str(self.manifest.imu.camera_axis)
        axis = np.zeros(3)
        axis["xyz".index(name[-1])] = -1.0 if name.startswith("-") else 1.0
        frame = log.body_frame or ("frd" if log.format in RANKED_FORMATS else "flu")
        found = None if gravity is None else body_from_camera_axis(gravity, to_frd(frame) @ axis)
        if found is None:
            text = f"[imu] camera_axis = {name!r} is of no use: gravity is not seen, or the camera looks along it"
            return WithProblems(None, (text,))
        return WithProblems(found, (Remark(rig_sentence(found.mount_rad)),))

    @cached_property
    def _gravity(self) -> Gravity | None:
        """Gravity along the axes that the chosen IMU is read in; None if there is none."""
        topic = self.choose(Kind.IMU).value
        return None if topic is None else gravity_of(self._imu_as_read(topic).value)

    def _gravity_or_none(self) -> Gravity | None:
        try:
            return self._gravity
        except InputError:  # reported when the IMU is read
            return None

    def _chosen_imu(self) -> ImuStream | None:
        try:
            topic = self.choose(Kind.IMU).value
            return None if topic is None else self.imu(topic).value
        except InputError:  # reported when the IMU is read
            return None

    def _imu_as_read(self, topic: str) -> WithProblems[ImuStream]:
        return self._read(Kind.IMU, lambda log: log.imu, topic)

    def frames(self, topic: str) -> WithProblems[FrameStream]:
        """Pictures, on the flight's clock."""
        return self._read(Kind.FRAMES, lambda log: log.frames, topic)

    def camera(self, topic: str) -> Camera | None:
        """Return the calibration that the manifest names, else the log's own, with the manifest's corrections."""
        camera, rig = self._camera_as_calibrated(topic), self.rig.value
        if camera is None:
            return None
        if rig is not None and self._given_camera is None:
            camera = turned_camera(camera, rig)
        if self.manifest.camera.rescale_calibration:
            camera = self._rescaled(camera, topic)
        return corrected_camera(camera, self.manifest.camera)

    def _rescaled(self, camera: Camera, topic: str) -> Camera:
        size = size_of_pictures(self.frames(topic).value)
        if size is None or size == (camera.width_px, camera.height_px):
            return camera
        if not camera.is_scaled_to(*size):
            raise InputError(
                f"rescale_calibration = true, but pictures of {size[0]}x{size[1]} are none of {camera.width_px}x"
                f"{camera.height_px} that were scaled: they were cut, or stretched",
                file=self.path,
                remedy="give the calibration of these pictures",
            )
        return camera.resized(*size)

    def _camera_as_calibrated(self, topic: str) -> Camera | None:
        if self._shift_error is not None:
            raise self._shift_error
        log, source = self.log(Kind.FRAMES), self.manifest.camera
        camera = self._given_camera
        if camera is None and source.calibration is not None:
            camera = Camera.from_yaml(source.calibration, None if log is None else log.body_frame)
        if camera is None and log is not None:
            camera = log.camera(topic)
        if camera is not None:
            own = (
                None
                if log is None or self._given_camera is not None
                else log.calibration_file(topic) or log.path
            )
            check_focal_length(camera, source.calibration or own)
        return camera

    def imu(self, topic: str) -> WithProblems[ImuStream]:
        """Gyroscope and accelerometer, with the noise that the manifest names."""
        imu, problems = self._imu_as_read(topic)
        if self.rig.value is not None:
            imu = mounted_imu(imu, self.rig.value.mount_rad)
        if self.manifest.imu.noise is not None:
            from vision.cameras.calibration import read_imu_noise

            noise = read_imu_noise(self.manifest.imu.noise)
            imu = replace(
                imu, gyro_noise_density=noise.gyro_noise_density, gyro_random_walk=noise.gyro_random_walk
            )
        return WithProblems(imu, problems)

    def attitude(self, topic: str) -> WithProblems[AttitudeStream]:
        """Attitude, on the flight's clock."""
        attitude, problems = self._read(Kind.ATTITUDE, lambda log: log.attitude, topic)
        if self.rig.value is not None:
            gravity, imu = self._gravity_or_none(), self._chosen_imu()
            attitude = turned_attitude(attitude, imu, gravity, self.rig.value.mount_rad)
        return WithProblems(attitude, problems)

    def position(self, topic: str) -> WithProblems[VectorStream]:
        """Position, on the flight's clock."""
        return self._read(Kind.POSITION, lambda log: log.position, topic)

    def velocity(self, topic: str) -> WithProblems[VectorStream]:
        """Velocity, on the flight's clock."""
        velocity, problems = self._read(Kind.VELOCITY, lambda log: log.velocity, topic)
        if self.rig.value is not None and self.log(Kind.VELOCITY) is self.log(Kind.IMU):
            velocity = turned_velocity(velocity, self.rig.value.mount_rad)
        return WithProblems(velocity, problems)

    def range(self, topic: str) -> WithProblems[RangeStream]:
        """Distance to the floor, from the camera's height, on the flight's clock."""
        return self._read(Kind.RANGE, lambda log: log.range, topic)

    def truth(self) -> WithProblems[CorridorTruth | None]:
        """Read the ground truth: from the file that the manifest names, else from its log."""
        from fusion.logs.asl import read_corridor_truth

        if self.manifest.truth is not None:
            return read_corridor_truth(self.manifest.truth)
        log = self.whole_log()
        return WithProblems(None) if log is None else log.truth()
