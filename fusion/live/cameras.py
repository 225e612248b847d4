"""Cameras: a device, a network stream, a video in real time, a folder.

Each yields pictures with their time of exposure by the computer's clock, and ends with the last one; `CameraThread`
reopens live sources.
"""

from __future__ import annotations

import logging
import os
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy.typing as npt

from fusion.flight import FrameStream
from fusion.live.clock import CameraClock
from fusion.logs import open_log
from fusion.logs.contents import Kind
from fusion.logs.pictures.camera_folder import PICTURE_SUFFIXES
from vision import Camera, InputError, read_image

STREAMS = ("rtsp://", "rtsps://", "udp://", "rtp://", "tcp://", "http://", "https://")
OPEN_S, READ_S = 5.0, 2.0  # timeouts of a stream
AGAIN_S = 0.5
LOOK_S = 0.005  # polling interval of a folder
HALF_WRITTEN_NS = 500_000_000  # until then, a picture that cannot be decoded may be incomplete


class Picture(NamedTuple):
    """A picture, grey or colour; None if it cannot be read."""

    t_ns: int
    image: npt.NDArray[Any] | None


class CameraSource(Protocol):
    """Where pictures come from."""

    @property
    def is_live(self) -> bool:
        """Whether to reopen the source when it ends."""

    def pictures(self, stop: threading.Event) -> Iterator[Picture]:
        """Yield pictures as they arrive, until the end or ``stop``.

        Raises
        ------
        InputError
            If it cannot be opened, or fails.
        """


class Clock(Protocol):
    """The computer's clock, `fusion.live.clock.HostClock`."""

    monotonic_offset_ns: int

    def now_ns(self) -> int:
        """Return the time."""


def camera_source(text: str, camera: Camera, clock: Clock) -> CameraSource:
    """Return the source that an argument names.

    Parameters
    ----------
    text
        A device, ``/dev/video0``; a stream, ``rtsp://...`` or ``udp://...``; a video or a recorded flight, played in
        real time; a folder of pictures, played by their times, or an empty one in which pictures will appear.
    camera
        Calibration; pictures of its size are requested from a device.
    clock
        The computer's.

    Raises
    ------
    InputError
        If there is no such file, or it contains no pictures.
    """
    if text.startswith(STREAMS):
        return VideoStream(text, None, {}, clock)
    path = Path(text)
    if path.is_char_device():
        options = {"video_size": f"{camera.width_px}x{camera.height_px}"}
        return VideoStream(text, "v4l2", options, clock)
    if path.is_dir() and not any(path.iterdir()):
        return WatchedFolder(path, clock)
    log = open_log(path)
    topic = next((t.name for t in log.topics if t.kind is Kind.FRAMES), None)
    if topic is None:
        raise InputError("contains no pictures", file=path, remedy="give a video, or a folder of pictures")
    return PlayedFrames(log.frames(topic).value, clock)


class VideoStream:
    """A camera device or a network stream, decoded by FFmpeg."""

    is_live = True

    def __init__(self, url: str, form: str | None, options: dict[str, str], clock: Clock) -> None:
        try:
            import av  # noqa: F401
        except ImportError:
            raise InputError(
                f"camera {url} is read by PyAV", remedy="pip install 'corridor-fusion[live]'"
            ) from None
        self._url, self._form, self._clock = url, form, clock
        self._options = {"fflags": "nobuffer", "flags": "low_delay", **options}

    def pictures(self, stop: threading.Event) -> Iterator[Picture]:
        """Decode pictures as they arrive."""
        import av

        clock = CameraClock(self._clock.monotonic_offset_ns)
        try:
            with av.open(
                self._url, format=self._form, options=self._options, timeout=(OPEN_S, READ_S)
            ) as file:
                stream = file.streams.video[0]
                stream.codec_context.thread_count = 1  # frame threading would delay the pictures
                for frame in file.decode(stream):
                    received_ns = self._clock.now_ns()
                    if stop.is_set():
                        return
                    stamp_ns = None if frame.time is None else round(frame.time * 1e9)
                    yield Picture(clock.host_ns(stamp_ns, received_ns), frame.to_ndarray(format="gray"))
        except (av.error.FFmpegError, IndexError) as error:
            raise InputError(
                f"camera {self._url}: {error}", remedy="check the camera and its address"
            ) from error


class PlayedFrames:
    """Pictures of a video, a folder or a log, in real time."""

    is_live = False

    def __init__(self, frames: FrameStream, clock: Clock) -> None:
        self._frames, self._clock = frames, clock

    def pictures(self, stop: threading.Event) -> Iterator[Picture]:
        """Play once."""
        times = self._frames.t_ns.tolist()
        start_ns = self._clock.now_ns()
        for k, t_ns in enumerate(times):
            due_ns = start_ns + t_ns - times[0]
            while (left_ns := due_ns - self._clock.now_ns()) > 0:
                if stop.wait(min(left_ns * 1e-9, 0.1)):
                    return
            try:
                yield Picture(due_ns, self._frames.read(k))
            except InputError:
                yield Picture(due_ns, None)


class WatchedFolder:
    """A folder into which another program writes pictures, preferably by renaming.

    If a file's name is an integer, it is the picture's time in nanoseconds since 1970; else the file's time is used.
    """

    is_live = True

    def __init__(self, folder: Path, clock: Clock) -> None:
        self._folder, self._clock = folder, clock
        self._seen: set[str] = set()

    def pictures(self, stop: threading.Event) -> Iterator[Picture]:
        """Yield each new picture once."""
        clock = CameraClock(self._clock.monotonic_offset_ns)
        while not stop.wait(LOOK_S):
            for entry in self._new():
                image = None
                try:
                    written_ns = entry.stat().st_mtime_ns
                    image = read_image(entry.path)
                except OSError:
                    continue  # already deleted
                except InputError:
                    if time.time_ns() - written_ns < HALF_WRITTEN_NS:
                        continue
                self._seen.add(entry.name)
                stem = Path(entry.name).stem
                stamp_ns = int(stem) if stem.isdecimal() else written_ns
                yield Picture(clock.host_ns(stamp_ns, self._clock.now_ns()), image)

    def _new(self) -> list[os.DirEntry[str]]:
        try:
            with os.scandir(self._folder) as entries:
                found = [
                    entry
                    for entry in entries
                    if Path(entry.name).suffix.lower() in PICTURE_SUFFIXES
                    and not entry.name.startswith(".")
                    and entry.name not in self._seen
                ]
        except OSError as error:
            raise InputError(f"cannot be read: {error.strerror}", file=self._folder) from error
        return sorted(found, key=lambda entry: entry.name)


class CameraThread:
    """Reads pictures from a source in a separate thread, and reopens it after a failure.

    Parameters
    ----------
    source
        The camera.
    offer
        Called with each picture, in the camera's thread.
    """

    def __init__(self, source: CameraSource, offer: Callable[[Picture], object]) -> None:
        self.reopened = 0
        self.ended = threading.Event()
        self._source, self._offer = source, offer
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="camera", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the thread."""
        self._stop.set()
        self._thread.join(READ_S + 1.0)

    def _run(self) -> None:
        last_error = ""
        while not self._stop.is_set():
            try:
                for picture in self._source.pictures(self._stop):
                    self._offer(picture)
                    last_error = ""
            except InputError as error:
                if str(error) != last_error:  # once, not at every attempt
                    last_error = str(error)
                    logging.getLogger(__name__).warning("%s", last_error)
            except Exception:  # a damaged stream may raise any error in a decoder
                logging.getLogger(__name__).exception("the camera failed")
            if not self._source.is_live:
                break
            if not self._stop.wait(AGAIN_S):
                self.reopened += 1
        self.ended.set()
