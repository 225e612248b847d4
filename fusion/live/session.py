"""`corridor live`: runs the core with link, camera, recording and viewer, until it is stopped.

One thread processes all events in order: bytes from the link's thread, lines from the vision thread, ticks of the
clock. Only this thread uses the estimator. It never waits for the camera, the disk or the viewer.
"""

from __future__ import annotations

import gc
import queue
import sys
import threading
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
import numpy.typing as npt

from fusion.estimator.config import FusionConfig
from fusion.estimator.estimate import Estimate
from fusion.estimator.frame_update import FrameResult
from fusion.estimator.notices import Status
from fusion.live.cameras import CameraSource, CameraThread, Clock, Picture
from fusion.live.clock import HostClock, SyncState
from fusion.live.core import LiveCore
from fusion.live.link import Link
from fusion.live.recording import Recorder
from fusion.live.settings import LiveSettings
from fusion.live.vision_thread import Measured, VisionThread
from vision import Camera, InputError, warm_up
from vision.images import to_grey

DEFAULT_DELAY_STD_S = 0.02  # of the camera's delay, if not configured: the delay is then estimated in flight
LINGER_S = 0.5  # after the last picture of a camera that has an end
KEPT_LATENCIES = 100_000
LONGEST_WAIT_S = 0.05


class Viewer(Protocol):
    """Receives pictures and estimates to show; must not block."""

    def frame(self, t_ns: int, image: npt.NDArray[np.uint8], result: FrameResult) -> None:
        """Show a picture and its measurement."""

    def estimate(self, now_ns: int, e: Estimate) -> None:
        """Show an estimate that was sent."""

    def close(self) -> None:
        """End."""


@dataclass(slots=True)
class LiveStatistics:
    """State of a run; latencies are from a picture's stamp until the first message that includes it is sent."""

    estimates: int = 0
    packets_sent: int = 0
    frames: int = 0
    frames_used: int = 0
    frames_dropped: int = 0
    camera_reopened: int = 0
    link_reopened: int = 0
    not_recorded: int = 0
    late_ticks: int = 0
    statuses: dict[str, int] = field(default_factory=dict)
    latency_s: deque[float] = field(default_factory=lambda: deque(maxlen=KEPT_LATENCIES))

    def latency_ms(self, percentile: float) -> float:
        """Percentile of the latency, milliseconds; NaN before the first."""
        return float(np.percentile(self.latency_s, percentile)) * 1e3 if self.latency_s else float("nan")


def live_config(config: FusionConfig | None) -> FusionConfig:
    """Return the estimator's settings in flight: the camera's delay is estimated, unless its sigma is set."""
    config = FusionConfig() if config is None else config
    if "camera_delay_std_s" in config.model_fields_set:
        return config
    return config.model_copy(update={"camera_delay_std_s": DEFAULT_DELAY_STD_S})


class LiveSession:
    """A run of `corridor live`.

    Parameters
    ----------
    link_address
        See `fusion.live.link.Link`.
    source, camera
        Where pictures come from, and their calibration.
    config, settings
        Of the estimator, as from `live_config`, and of what is sent.
    recorder, viewer
        None for none.
    clock
        The computer's.

    Raises
    ------
    InputError
        If the link cannot be opened.
    """

    def __init__(
        self,
        link_address: str,
        source: CameraSource,
        camera: Camera,
        config: FusionConfig,
        settings: LiveSettings | None = None,
        *,
        recorder: Recorder | None = None,
        viewer: Viewer | None = None,
        clock: Clock | None = None,
    ) -> None:
        self.statistics = LiveStatistics()
        self.ready = threading.Event()  # set once start-up is complete and events are processed
        self.core = LiveCore(config, camera, settings, sink=recorder)
        self._camera, self._source = camera, source
        self._clock: Clock = clock or HostClock()
        self._recorder, self._viewer = recorder, viewer
        self._events: queue.SimpleQueue[tuple[int, bytes] | None] = queue.SimpleQueue()
        self._stop = threading.Event()
        self._not_sent: list[int] = []  # stamps of frames since the last tick
        self._first_picture = True
        self._refusal: InputError | None = None
        self._link = Link(link_address, lambda data: self._events.put((self._clock.now_ns(), data)))

    def stop(self) -> None:
        """Make `run` end soon; callable from any thread or signal handler."""
        self._stop.set()
        self._events.put(None)

    def run(
        self, duration_s: float | None = None, every_s: Callable[[LiveSession], object] | None = None
    ) -> None:
        """Run until `stop`, the end of the pictures, or a time.

        Parameters
        ----------
        duration_s
            How long at most.
        every_s
            Called about once a second.

        Raises
        ------
        InputError
            If the pictures are not those of the calibration.
        """
        warm_up(self._camera)
        sys.setswitchinterval(0.0005)  # limits the time that a computing thread blocks others
        gc.collect()
        gc.freeze()
        vision = VisionThread(self._camera, on_finished=lambda: self._events.put(None))
        pictures = CameraThread(self._source, lambda picture: self._offer(vision, picture))
        self.ready.set()
        try:
            self._loop(vision, pictures, duration_s, every_s)
        finally:
            pictures.close()
            vision.close()
            self._link.close()
            for other in (self._recorder, self._viewer):
                if other is not None:
                    other.close()
            self._count(vision, pictures)
        if self._refusal is not None:
            raise self._refusal

    def _offer(self, vision: VisionThread, picture: Picture) -> None:
        """Hand a picture to vision, in the camera's thread; reject sizes other than calibrated."""
        image = np.empty((0, 0), np.uint8)
        if picture.image is not None:
            with suppress(InputError):  # counted as unreadable
                image = to_grey(picture.image)
            if image.size and self._first_picture:
                self._first_picture = False
                try:
                    self._camera.require_size(image.shape[1], image.shape[0])
                except InputError as error:
                    self._refusal = error
                    self.stop()
        vision.offer(picture.t_ns, image)

    def _loop(
        self,
        vision: VisionThread,
        pictures: CameraThread,
        duration_s: float | None,
        every_s: Callable[[LiveSession], object] | None,
    ) -> None:
        clock, period_ns = self._clock, round(1e9 / self.core.settings.rate_hz)
        start_ns = clock.now_ns()
        tick_ns, told_ns, ended_ns = start_ns, start_ns, None
        while not self._stop.is_set():
            now_ns = clock.now_ns()
            if duration_s is not None and now_ns - start_ns > duration_s * 1e9:
                return
            if pictures.ended.is_set():
                ended_ns = ended_ns or now_ns
                if now_ns - ended_ns > LINGER_S * 1e9:
                    return
            if now_ns >= tick_ns:
                self._tick(now_ns)
                self.statistics.late_ticks += now_ns - tick_ns > period_ns
                tick_ns = max(tick_ns + period_ns, now_ns)
                if every_s is not None and now_ns - told_ns > 1_000_000_000:
                    told_ns = now_ns
                    self._count(vision, pictures)
                    every_s(self)
                continue
            try:
                event = self._events.get(timeout=min((tick_ns - now_ns) * 1e-9, LONGEST_WAIT_S))
            except queue.Empty:
                continue
            if event is None:
                for measured in vision.finished():
                    self._frame(measured)
            else:
                self._bytes(*event)

    def _bytes(self, received_ns: int, data: bytes) -> None:
        if self._recorder is not None:
            self._recorder.received(received_ns, data)
        self._send(received_ns, self.core.on_bytes(received_ns, data))

    def _frame(self, measured: Measured) -> None:
        t_ns, lines, image, _ = measured
        if self._recorder is not None:
            self._recorder.picture(self._clock.now_ns(), t_ns, None if lines is None else image)
        result = self.core.on_frame(t_ns, lines)
        self.statistics.frames += 1
        self.statistics.frames_used += result.accepted
        self._not_sent.append(t_ns)
        if self._viewer is not None and lines is not None:
            self._viewer.frame(t_ns, image, result)

    def _tick(self, now_ns: int) -> None:
        packets = self.core.on_tick(now_ns)
        e, statistics = self.core.estimate, self.statistics
        if self._recorder is not None:
            self._recorder.estimate(now_ns, e)
        self._send(now_ns, packets)
        sent_ns = self._clock.now_ns()
        if self.core.vehicle is not None:
            delay_ns = round(e.camera_delay_s * 1e9) if e.camera_delay_s == e.camera_delay_s else 0
            statistics.latency_s.extend((sent_ns - t_ns + delay_ns) * 1e-9 for t_ns in self._not_sent)
        self._not_sent.clear()
        statistics.estimates += 1
        statistics.statuses[e.status] = statistics.statuses.get(e.status, 0) + 1
        if self._viewer is not None:
            self._viewer.estimate(now_ns, e)

    def _send(self, now_ns: int, packets: list[bytes]) -> None:
        for packet in packets:
            self._link.send(packet)
            if self._recorder is not None:
                self._recorder.sent(now_ns, packet)
        self.statistics.packets_sent += len(packets)

    def _count(self, vision: VisionThread, pictures: CameraThread) -> None:
        statistics = self.statistics
        statistics.frames_dropped, statistics.camera_reopened = vision.dropped, pictures.reopened
        statistics.link_reopened = self._link.reopened
        if self._recorder is not None:
            statistics.not_recorded = self._recorder.lost


def status_line(session: LiveSession) -> str:
    """Status in one line, for a terminal or a journal."""
    core, s = session.core, session.statistics
    e = core.estimate
    parts = [str(e.status)]
    if e.heading_rad == e.heading_rad:
        parts.append(f"heading {np.degrees(e.heading_rad):+.1f} ± {np.degrees(e.heading_std_rad):.1f} deg")
    offset = (e.lateral_offset_m, e.lateral_offset_std_m, "m")
    if offset[0] != offset[0]:
        offset = (e.lateral_offset_norm, e.lateral_offset_norm_std, "half widths")
    if offset[0] == offset[0]:
        parts.append(f"offset {offset[0]:+.2f} ± {offset[1]:.2f} {offset[2]}")
    if e.status != Status.TRACKING and e.reason:
        parts.append(e.reason)
    if core.vehicle is None:
        parts.append("no autopilot heard yet")
    elif core.clock.state is not SyncState.SYNCHRONISED:
        parts.append(f"autopilot's clock: {core.clock.state}")
    parts.append(f"latency p50 {s.latency_ms(50):.0f} p99 {s.latency_ms(99):.0f} ms")
    parts.append(f"{s.frames_dropped} of {s.frames + s.frames_dropped} frames dropped")
    return ", ".join(parts)
