"""The pictures of a video, decoded one at a time: on from the last one, or from the key frame before."""

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
        Those of key frames (k,), ascending: a frame can be reached from the last one at or before it.
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
            If it does not decode, or a frame that it is predicted from did not.
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
        """Decode the first frame that will, so that a video of no use is refused before the work.

        Returns
        -------
        tuple of str
            What a user should know of the pictures.

        Raises
        ------
        InputError
            If none of the first frames decodes, or the pictures stand at an angle.
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
        """Return the frame of a time stamp; None if the decoder does not give it."""
        number = self._key_number(pts)
        # Decoding on is cheaper than a jump, unless there is a key frame on the way.
        if self._here is None or pts <= self._before or self._key(number) > self._here[0]:
            self._jump(self._key(number))
            # A transport stream is entered behind the key frame: from the one before, it is met on the way.
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
        """Go to a key frame, so that it is the next to come."""
        from av.error import FFmpegError

        first = key_pts <= int(self._pts[0])
        container = self._container
        if (
            container is None or first
        ):  # the beginning is reached by opening the file again: raw streams cannot seek
            container = self._open()
        if not first:
            try:
                container.seek(key_pts, stream=container.streams[self._stream])
            except FFmpegError:  # decoding on from the beginning is slow, not wrong
                container = self._open()
        self._coming = _decoded(container, self._stream, self._numbered)
        self._here = next(self._coming, None)
        # What lies between the key frame and a landing behind it is not lost, only passed over.
        landed = key_pts if self._here is None else max(self._here[0], key_pts)
        self._before = landed - 1

    def _open(self) -> InputContainer:
        from fusion.logs.pictures.video import open_container

        self.close()
        self._container = open_container(self.path)
        self._container.streams[self._stream].codec_context.thread_count = 1  # other threads log elsewhere
        return self._container


def _decoded(container: InputContainer, number: int, numbered: bool) -> Iterator[Decoded]:
    """Yield time stamp (or number) and frame; None in place of a frame that is damaged or rests on a damaged one.

    FFmpeg fills what it cannot decode with what stood there before and hands the frame out as if nothing had been;
    only its log tells. From such a packet on no frame is trusted up to the next key frame, or for `_HEALING_FRAMES`
    where a stream has none and refreshes its pictures part by part.
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
    """Decode a packet, and say whether the decoder complained."""
    from av import logging

    before, skips = logging.get_level(), logging.get_skip_repeated()
    logging.set_level(logging.ERROR)
    logging.set_skip_repeated(False)  # a complaint like the last one, of whatever video, counts as well
    try:
        with logging.Capture() as complaints:
            frames = packet.decode()
    finally:
        logging.set_level(before)
        logging.set_skip_repeated(skips)
    return frames, any("error while decoding" in text or "concealing" in text for _, _, text in complaints)


def _grey(frame: VideoFrame, path: Path) -> GreyImage:
    """Turn a decoded frame into a grey picture, upright as the video's header asks."""
    turns, rest = divmod(frame.rotation, 90)
    if rest:
        raise InputError(
            f"its header turns the pictures by {frame.rotation} degrees",
            file=path,
            remedy="convert it to one that stands upright",
        )
    image = frame.to_ndarray(format="gray")
    return np.ascontiguousarray(np.rot90(image, turns % 4) if turns % 4 else image)
