"""Pictures of a video, decoded one at a time, from the last one or from the preceding key frame."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, cast

import numpy as np
import numpy.typing as npt

from fusion.logs.samples import Problems, counted
from vision import InputError
from vision.images import GreyImage

if TYPE_CHECKING:
    from av.container import InputContainer
    from av.packet import Packet
    from av.video.frame import VideoFrame
    from av.video.stream import VideoStream

_CHECKED_FRAMES = 30
_HEALING_FRAMES = 60
_NOWHERE = -(2**63)

Decoded = tuple[int, "VideoFrame | None"]


class VideoFrames:
    """A `fusion.flight.FrameSource` over one stream of a video file; memory holds one picture at a time.

    Parameters
    ----------
    path, stream
        The file, and the stream's number in it.
    pts
        Presentation time stamps (n,) of the frames, ascending; frame numbers where ``numbered``.
    key_pts
        Of the key frames (k,), ascending; decoding of a frame starts at the last one at or before it.
    numbered
        Whether frames are identified by counting from the beginning, since the file has no time stamps of its own.
    """

    def __init__(
        self,
        path: Path,
        stream: int,
        pts: npt.NDArray[np.int64],
        key_pts: npt.NDArray[np.int64],
        numbered: bool,
    ) -> None:
        self.path = path
        self._stream = stream
        self._pts = pts
        self._key_pts = key_pts
        self._numbered = numbered
        self._container: InputContainer | None = None
        self._coming: Iterator[Decoded] = iter(())
        self._here: Decoded | None = None  # the last frame that came out of the decoder; None at the end
        self._before = _NOWHERE  # time stamp of the one before it

    def read(self, index: int) -> GreyImage:
        """Decode a frame, grey (h, w).

        Raises
        ------
        InputError
            If it, or a frame that it is predicted from, cannot be decoded.
        """
        frame = self._frame(int(self._pts[index]))
        if frame is None:
            raise InputError(
                f"frame {index} does not decode",
                file=self.path,
                remedy="the file is damaged there; copy it again",
            )
        return _grey(frame, self.path)

    def check(self) -> Problems:
        """Decode the first frame that can be decoded, so that an unusable video is rejected at once.

        Returns
        -------
        tuple of str
            Remarks on the pictures for the user.

        Raises
        ------
        InputError
            If none of the first frames can be decoded, or the pictures are rotated by an odd angle.
        """
        tries = min(_CHECKED_FRAMES, len(self._pts))
        for index in range(tries):
            frame = self._frame(int(self._pts[index]))
            if frame is None:
                continue
            _grey(frame, self.path)
            if frame.rotation % 360:
                return (
                    f"{self.path.name}: pictures are turned by {frame.rotation % 360} degrees, as its header asks: "
                    "the calibration must be of the turned pictures",
                )
            return ()
        raise InputError(
            f"none of its first {counted(tries, 'frame')} decodes",
            file=self.path,
            remedy="the file is damaged, or its codec is not supported: convert it",
        )

    def close(self) -> None:
        """Close the file; the next read opens it again."""
        if self._container is not None:
            self._container.close()
        self._container, self._coming, self._here, self._before = None, iter(()), None, _NOWHERE

    def _frame(self, pts: int) -> VideoFrame | None:
        """Return the frame of a time stamp; None if the decoder does not return it."""
        number = self._key_number(pts)
        # Decoding forward is cheaper than seeking, unless there is a key frame in between.
        if self._here is None or pts <= self._before or self._key(number) > self._here[0]:
            self._jump(self._key(number))
            # Seeking in a transport stream lands after the key frame, so start at the previous one.
            if number and (self._here is None or self._here[0] > self._key(number)):
                self._jump(self._key(number - 1))
        while self._here is not None and self._here[0] < pts:
            self._before = self._here[0]
            self._here = next(self._coming, None)
        return self._here[1] if self._here is not None and self._here[0] == pts else None

    def _key_number(self, pts: int) -> int:
        """Return the number of the last key frame at or before a time stamp."""
        if self._numbered:
            return 0
        return max(int(np.searchsorted(self._key_pts, pts, side="right")) - 1, 0)

    def _key(self, number: int) -> int:
        return int(self._key_pts[number]) if number else int(self._pts[0])

    def _jump(self, key_pts: int) -> None:
        """Seek to a key frame, so that it is decoded next."""
        from av.error import FFmpegError

        first = key_pts <= int(self._pts[0])
        container = self._container
        if container is None or first:  # reopening gives the beginning: raw streams cannot seek
            container = self._open()
        if not first:
            try:
                container.seek(key_pts, stream=container.streams[self._stream])
            except FFmpegError:  # decoding from the beginning is slow, but correct
                container = self._open()
        self._coming = _decoded(container, self._stream, self._numbered)
        self._here = next(self._coming, None)
        # Frames between the key frame and the position of the seek are skipped, not lost.
        landed = key_pts if self._here is None else max(self._here[0], key_pts)
        self._before = landed - 1

    def _open(self) -> InputContainer:
        from fusion.logs.pictures.video import open_container

        self.close()
        self._container = open_container(self.path)
        self._container.streams[self._stream].codec_context.thread_count = 1  # other threads log elsewhere
        return self._container


def _decoded(container: InputContainer, number: int, numbered: bool) -> Iterator[Decoded]:
    """Yield time stamp (or number) and frame; None for a frame that is damaged or predicted from a damaged one.

    FFmpeg conceals damaged parts with earlier picture content and reports this only in its log. After such a packet,
    no frame is used until the next key frame, or for `_HEALING_FRAMES` frames if the stream has no key frames and
    refreshes its pictures part by part.
    """
    from av.error import FFmpegError

    packets = cast("Iterator[Packet[VideoStream]]", container.demux(container.streams[number]))
    count, suspect, damaged_at = 0, 0, _NOWHERE
    while True:
        packet, broken = None, False
        frames: list[VideoFrame] = []
        try:
            packet = next(packets)
            frames, broken = _decode(packet)
        except StopIteration:
            return
        except FFmpegError as error:
            if isinstance(error, EOFError):
                return
            broken, count = True, count + 1
        if broken:
            stamp = packet.pts if packet is not None else None
            suspect, damaged_at = _HEALING_FRAMES, max(damaged_at, _NOWHERE if stamp is None else stamp)
        for frame in frames:
            stamp = count if numbered else frame.pts
            count += 1
            if stamp is None:
                continue
            if frame.key_frame and (numbered or stamp > damaged_at):
                suspect, damaged_at = 0, _NOWHERE
            yield stamp, None if suspect or frame.is_corrupt else frame
            suspect = max(suspect - 1, 0)


def _decode(packet: Packet[VideoStream]) -> tuple[list[VideoFrame], bool]:
    """Decode a packet; return also whether the decoder reported an error."""
    from av import logging

    before, skips = logging.get_level(), logging.get_skip_repeated()
    logging.set_level(logging.ERROR)
    logging.set_skip_repeated(False)  # repeated messages, even of another video, count as well
    try:
        with logging.Capture() as complaints:
            frames = packet.decode()
    finally:
        logging.set_level(before)
        logging.set_skip_repeated(skips)
    return frames, any("error while decoding" in text or "concealing" in text for _, _, text in complaints)


def _grey(frame: VideoFrame, path: Path) -> GreyImage:
    """Convert a decoded frame to a grey picture, rotated as declared in the video's header."""
    turns, rest = divmod(frame.rotation, 90)
    if rest:
        raise InputError(
            f"its header turns the pictures by {frame.rotation} degrees",
            file=path,
            remedy="convert it to one that stands upright",
        )
    image = frame.to_ndarray(format="gray")
    return np.ascontiguousarray(np.rot90(image, turns % 4) if turns % 4 else image)
