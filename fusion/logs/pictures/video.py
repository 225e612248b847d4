"""Video files by PyAV: every frame with its own time stamp, decoded on request.

The flight's time of a frame is the video's own time, counted from its first frame, plus ``start_ns``; or row by row
from a CSV of frame times, if the recorder wrote one (``libcamera-vid --save-pts``, the logs of most scripts). Raw
streams (``.h264``) have no time stamps and need such a file; AVI has only a nominal rate, which is used and reported.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from fusion.flight import ChosenFrames, FrameStream, TimeArray
from fusion.logs.contents import Kind, Topic
from fusion.logs.csv.column_map import ColumnMap
from fusion.logs.pictures.gpmf import Telemetry, read_telemetry
from fusion.logs.pictures.video_frames import VideoFrames
from fusion.logs.samples import Problems, WithProblems, counted, in_order
from fusion.logs.series import Series, SeriesLog, Where, no_such_topic
from vision import InputError
from vision.images import is_heic
from vision.limits import check_pixels

if TYPE_CHECKING:
    from av.container import InputContainer
    from av.video.stream import VideoStream

SUFFIXES = frozenset(
    {".mp4", ".m4v", ".mov", ".mkv", ".webm", ".avi", ".ts", ".mts", ".m2ts", ".mpg", ".mpeg", ".wmv", ".flv"}
    | {".3gp", ".ogv", ".mjpg", ".mjpeg", ".h264", ".264", ".h265", ".265", ".hevc"}
)
GPMF_TOPIC = "gopro"
# A playlist named like a video would make FFmpeg open the listed files, even over the network.
_LOCAL_VIDEO = {
    "protocol_whitelist": "file",
    "format_whitelist": "mov,matroska,avi,mpegts,mpeg,asf,flv,ogg,mjpeg,h264,hevc,mpegvideo,m4v",
}
_EXTRA = "install it: pip install 'corridor-fusion[video]'"
_TIMES = (
    "name a CSV with the time of each frame, times under [camera] in flight.toml, or their rate, rate_hz = 30"
)


@dataclass(frozen=True, slots=True, eq=False)
class VideoIndex:
    """Index of one video stream from its packets, frames in presentation order.

    Parameters
    ----------
    pts
        Presentation time stamps (n,), strictly increasing, in units of ``time_base``; frame numbers if ``numbered``.
    key_pts
        Of the key frames (k,).
    time_base
        Seconds per unit.
    numbered
        Whether frames can only be identified by counting them: the file has no time stamps of its own.
    rows
        Number (n,) of each frame among all frames of the camera, including those with a repeated time stamp.
    delivered
        Number of all frames of the camera.
    """

    pts: npt.NDArray[np.int64]
    key_pts: npt.NDArray[np.int64]
    time_base: Fraction
    numbered: bool
    rows: npt.NDArray[np.int64]
    delivered: int


def recognises(path: Path) -> bool:
    """Whether a file is a video, by its first bytes or its extension."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        head = file.read(12)
    magic = (
        (head[4:8] == b"ftyp" and not is_heic(head))
        or head[:4] == b"\x1a\x45\xdf\xa3"
        or (head[:4] == b"RIFF" and head[8:] == b"AVI ")
    )
    return magic or path.suffix.lower() in SUFFIXES


def open_log(path: Path) -> VideoLog:
    """Open a video with its own clock."""
    return open_video(path)


def open_video(
    path: Path,
    *,
    start_ns: int = 0,
    times: Path | None = None,
    columns: ColumnMap | str | None = None,
    rate_hz: float | None = None,
) -> VideoLog:
    """Open a video and find its frames' times.

    Parameters
    ----------
    path
        The file.
    start_ns
        Time of its first frame.
    times, columns
        A CSV with the time of each frame instead, a row per frame in presentation order; its columns.
    rate_hz
        Frame rate of a file without time stamps.

    Raises
    ------
    InputError
        If PyAV is not installed, the file is not a video, it has no frames, or there are no times.
    """
    with open_container(path) as container:
        streams = [stream for stream in container.streams.video if not _is_cover(stream)]
        if not streams:
            raise InputError("contains no video stream", file=path, remedy="give a video with pictures")
        packets, problems = _read_packets(path, container, streams)
        indices = {stream.index: _index(container, stream, packets[stream.index]) for stream in streams}
        declared = None if rate_hz is None else Fraction(rate_hz).limit_denominator(10**6)
        nominal = declared or _nominal_rate(container, streams[0])
        note = _note(container)
        first = indices[streams[0].index]
        telemetry = None
        if times is None and len(first.pts) and container.streams.data:
            telemetry = read_telemetry(container, float(first.pts[0] * first.time_base), start_ns)
        problems += tuple(_cut_ends(path, container, streams, packets, indices))
    videos: dict[str, _Video] = {}
    for number, index in indices.items():
        name = "video" if len(indices) == 1 else f"video{number}"
        if not len(index.pts):
            continue
        repeated = index.delivered - len(index.pts)
        if repeated:
            problems += (
                f"{path.name}: {counted(repeated, 'frame')} with the time stamp of another left out",
            )
        if times is not None:
            (t_ns, rows), more = _listed_times(path, index, times, columns)
        else:
            t_ns, more = _times(path, index, nominal, start_ns, is_declared=declared is not None)
            rows = np.arange(len(index.pts))
        problems += more
        videos[name] = _Video(t_ns, rows, index, number)
    if not videos:
        raise InputError("contains no frames", file=path, remedy="it was not written whole; copy it again")
    return VideoLog(path, videos, note, problems, telemetry)


def open_container(path: Path) -> InputContainer:
    """Open a video file with PyAV.

    Raises
    ------
    InputError
        If PyAV is not installed, or the file cannot be opened.
    """
    try:
        import av
    except ImportError as error:
        raise InputError("reading videos needs PyAV", file=path, remedy=_EXTRA) from error
    try:
        container = av.open(str(path.absolute()), "r", options=_LOCAL_VIDEO)
        for stream in container.streams.video:
            if stream.codec_context is None:  # other properties are then missing, too
                raise InputError("contains a video that cannot be decoded", remedy="convert it to H.264")
            check_pixels(stream.width or 0, stream.height or 0)
        return container
    except InputError as error:
        raise InputError(error.problem, file=path, remedy=error.remedy) from error
    except (av.error.FFmpegError, ValueError) as error:
        cause = getattr(error, "strerror", None) or str(error)
        raise InputError(
            f"does not open as a video: {cause}",
            file=path,
            remedy="it is not a video, or was not written to its end: give the original, or repair it",
        ) from error


def _is_cover(stream: VideoStream) -> bool:
    """Whether a stream is a cover picture."""
    return "attached_pic" in str(stream.disposition).lower()


@dataclass(slots=True)
class _Packets:
    """Time stamps of one stream's packets, in the order of the file."""

    pts: list[int] = field(default_factory=list)
    key_pts: list[int] = field(default_factory=list)
    without: int = 0
    seen: int = 0  # including empty packets and frames that are not shown


def _read_packets(
    path: Path, container: InputContainer, streams: list[VideoStream]
) -> WithProblems[dict[int, _Packets]]:
    """Read the time stamps of the file's packets by stream, without decoding."""
    from av.error import FFmpegError

    packets = {stream.index: _Packets() for stream in streams}
    try:
        for packet in container.demux(streams):
            found = packets[packet.stream_index]
            found.seen += packet.dts is not None or bool(packet.size)  # an empty packet is a dropped frame
            if not packet.size or packet.is_discard:
                continue
            if packet.pts is None:
                found.without += 1
            else:
                found.pts.append(packet.pts)
                if packet.is_keyframe:
                    found.key_pts.append(packet.pts)
    except (FFmpegError, ValueError) as error:
        cause = getattr(error, "strerror", None) or str(error)
        problem = f"{path.name}: the file is damaged ({cause}); what lies beyond is lost"
        return WithProblems(packets, (problem,))
    return WithProblems(packets)


def _index(container: InputContainer, stream: VideoStream, packets: _Packets) -> VideoIndex:
    time_base = Fraction(stream.time_base or Fraction(1, 1))
    pts = np.unique(np.array(packets.pts, dtype=np.int64))
    # AVI stores no time stamps, and FFmpeg's are wrong for reordered frames.
    made_up = container.format.name == "avi" and bool(getattr(stream.codec_context, "has_b_frames", False))
    if made_up or packets.without > len(pts):
        count = len(packets.pts) + packets.without
        number = np.arange(count)
        return VideoIndex(number, np.zeros(1, dtype=np.int64), time_base, True, number, count)
    # A frame with a repeated time stamp cannot be sought, but it has a row in the camera's list.
    rows = np.searchsorted(np.sort(packets.pts), pts)
    key_pts = np.unique(np.array(packets.key_pts, dtype=np.int64))
    return VideoIndex(pts, key_pts, time_base, False, rows, len(packets.pts))


def _nominal_rate(container: InputContainer, stream: VideoStream) -> Fraction | None:
    """Return the frame rate of an AVI, which has no other times; None for other files."""
    return stream.average_rate if container.format.name == "avi" else None


def _times(
    path: Path, index: VideoIndex, nominal: Fraction | None, start_ns: int, *, is_declared: bool = False
) -> WithProblems[TimeArray]:
    """Return the times (n,) of the frames by the video's own clock."""
    problems: Problems = ()
    if is_declared and not index.numbered:
        raise InputError(
            "has times of its own: rate_hz does not go with it", file=path, remedy="take rate_hz away"
        )
    if nominal is not None and not is_declared:
        problems += (
            f"{path.name}: AVI stores no times; its nominal rate of {float(nominal):g} frames a second is taken",
        )
    if index.numbered and nominal is None:
        raise InputError("has no time stamps", file=path, remedy=_TIMES)
    unit_s = 1 / nominal if index.numbered and nominal is not None else index.time_base
    ticks = index.pts - index.pts[0]
    # Integer arithmetic keeps every digit, even in hours of video.
    seconds, rest = np.divmod(ticks * unit_s.numerator, unit_s.denominator)
    rest_ns = (rest * 10**9 + unit_s.denominator // 2) // unit_s.denominator
    return WithProblems(np.asarray(start_ns + seconds * 10**9 + rest_ns), problems)


def _listed_times(
    path: Path, index: VideoIndex, times: Path, columns: ColumnMap | str | None
) -> WithProblems[tuple[TimeArray, npt.NDArray[np.int64]]]:
    """Return the times (m,) in a file, and their frame numbers (m,); frames with damaged rows are left out."""
    from fusion.logs.csv.times import read_times

    listed, problems = read_times(times, columns)
    n_rows, n_frames = int(listed.row[-1]) + 1, index.delivered
    if n_rows == len(index.pts) < n_frames:  # written by a script that read the video, not by the recorder
        index = replace(index, rows=np.arange(len(index.pts)), delivered=len(index.pts))
    elif n_rows != n_frames:
        problems += (
            f"{times.name} has {counted(n_rows, 'row')}, {path.name} {counted(n_frames, 'frame')}: "
            f"the first {min(n_rows, n_frames)} of both are taken together",
        )
    frame = np.clip(np.searchsorted(index.rows, listed.row), 0, len(index.rows) - 1)
    here = index.rows[frame] == listed.row
    return WithProblems((listed.t_ns[here], frame[here]), problems)


def _note(container: InputContainer) -> str:
    """Return the creation time of the video, if declared."""
    made = container.metadata.get("creation_time")
    return f"made {made}" if made else ""


def _cut_ends(
    path: Path,
    container: InputContainer,
    streams: list[VideoStream],
    packets: dict[int, _Packets],
    indices: dict[int, VideoIndex],
) -> Iterator[str]:
    """Yield a sentence for each stream that ends well before the duration in its header."""
    for stream in streams:
        index = indices[stream.index]
        if index.numbered or not len(index.pts):
            continue
        if container.duration is None:
            continue
        is_end = container.format.name.startswith("matroska")  # its duration starts at zero
        declared_s = (container.duration + (0 if is_end else container.start_time or 0)) * 1e-6
        step_s = float(np.median(np.diff(index.pts)) * index.time_base) if len(index.pts) > 1 else 0.1
        end_s = float(index.pts[-1] * index.time_base) + step_s
        # Sound may last longer than the pictures. Missing frames may have been dropped or left out by an
        # edit list; only missing frames at the end are lost.
        tolerance_s = 1.0 if len(container.streams) > 1 else 4 * step_s
        if stream.frames > packets[stream.index].seen:
            tolerance_s = 0.5 * step_s
        if declared_s - end_s > tolerance_s:
            yield (
                f"{path.name}: cut short: {counted(len(index.pts), 'frame')} up to {end_s:.1f} s, "
                f"its header declares {declared_s:.1f} s"
            )


@dataclass(frozen=True, slots=True, eq=False)
class _Video:
    """One stream: frame times and numbers, its packets, its number in the file."""

    t_ns: TimeArray
    rows: npt.NDArray[np.int64]
    index: VideoIndex
    stream: int


class VideoLog(SeriesLog):
    """A video as `fusion.logs.contents.LogContents`: pictures, and the recorded IMU, if any."""

    def __init__(
        self,
        path: Path,
        videos: dict[str, _Video],
        note: str,
        problems: Problems,
        telemetry: Telemetry | None = None,
    ) -> None:
        series = []
        if telemetry is not None:
            topic = Topic(GPMF_TOPIC, Kind.IMU, telemetry.t_ns, "GoPro's telemetry; axes of the sensor")
            series.append(Series(topic, partial(telemetry.imu, Where(path, f"{path.name} ({GPMF_TOPIC})"))))
            self.body_frame = "frd"  # axes unchanged
        super().__init__(path, "video", series, problems)
        frames = (Topic(name, Kind.FRAMES, video.t_ns, note) for name, video in videos.items())
        self.topics = (*frames, *self.topics)
        self._videos = videos

    def frames(self, topic: str) -> WithProblems[FrameStream]:
        """Pictures, decoded one at a time."""
        if topic not in self._videos:
            raise no_such_topic(self.path, self.topics, Kind.FRAMES, topic)
        video = self._videos[topic]
        index, problems = in_order(video.t_ns, self.path.name, file=self.path, remedy=_TIMES)
        source = VideoFrames(
            self.path, video.stream, video.index.pts, video.index.key_pts, video.index.numbered
        )
        problems += source.check()
        return WithProblems(FrameStream(video.t_ns[index], ChosenFrames(source, video.rows[index])), problems)
