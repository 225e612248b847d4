"""Pictures of a video stream in a bag: each ``CompressedImage`` holds one packet of H.264 or H.265, decoded by PyAV.

A predicted picture needs others: decoding begins at the key frame before it.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import suppress
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import numpy.typing as npt

from vision import InputError
from vision.images import GreyImage

if TYPE_CHECKING:
    from av.video.codeccontext import VideoCodecContext

CODECS = {"h264": "h264", "h.264": "h264", "avc": "h264", "h265": "hevc", "h.265": "hevc", "hevc": "hevc"}
AHEAD = 16  # packets that a decoder may buffer before it returns the first picture
_EXTRA = "pip install 'corridor-fusion[video]'"

ReadPacket = Callable[[int], bytes]


def codec_of(form: str) -> str | None:
    """Return the video codec that a ``CompressedImage.format`` names; None if it names none."""
    return CODECS.get(form.strip().lower().partition(";")[0])


def is_key_frame(packet: bytes, codec: str) -> bool:
    """Whether a packet (Annex B) is a key frame: it contains an IDR picture, or parameter sets before one."""
    at = packet.find(b"\x00\x00\x01")
    while 0 <= at < len(packet) - 3:
        kind = packet[at + 3] & 0x1F if codec == "h264" else packet[at + 3] >> 1 & 0x3F
        if kind == 5 if codec == "h264" else 16 <= kind <= 21:
            return True
        at = packet.find(b"\x00\x00\x01", at + 3)
    return False


class EncodedPictures:
    """A `fusion.flight.FrameSource` over the packets of a video stream.

    Parameters
    ----------
    codec
        ``h264`` or ``hevc``.
    read_packet
        Returns a packet's bytes by its number.
    keys
        Numbers (k,) of the key frames, ascending.
    count
        Number of packets.
    """

    def __init__(self, codec: str, read_packet: ReadPacket, keys: npt.NDArray[np.int64], count: int) -> None:
        self.codec, self.keys, self.count = codec, keys, count
        self._read_packet = read_packet
        self._lock = threading.Lock()
        self._context: VideoCodecContext | None = None
        self._fed = 0  # number of the next packet to be fed
        self._ready: dict[int, GreyImage] = {}  # decoded, not yet requested

    def __reduce__(self) -> tuple[Any, ...]:
        return EncodedPictures, (self.codec, self._read_packet, self.keys, self.count)

    def read(self, index: int) -> GreyImage:
        """Decode a picture, grey (h, w).

        Raises
        ------
        InputError
            If it, or a picture that it is predicted from, cannot be decoded.
        """
        with self._lock:
            return self._read(index)

    def _read(self, index: int) -> GreyImage:
        before = self.keys[self.keys <= index]
        if not len(before):
            raise InputError("picture is predicted from a key frame that the bag does not contain")
        key = int(before[-1])
        if self._context is None or not (key <= self._fed and (index >= self._fed or index in self._ready)):
            self._begin(key)
        while index not in self._ready and self._fed < min(index + AHEAD, self.count):
            self._feed()
        if index not in self._ready:
            self._feed_end()
        if index not in self._ready:
            self._context = None
            raise InputError("picture does not decode")
        self._ready = {number: picture for number, picture in self._ready.items() if number >= index}
        return self._ready[index]

    def _begin(self, key: int) -> None:
        import av

        context = cast("VideoCodecContext", av.CodecContext.create(self.codec, "r"))
        context.thread_count = 1
        self._context, self._fed, self._ready = context, key, {}

    def _feed(self) -> None:
        from av import Packet
        from av.error import FFmpegError

        assert self._context is not None
        packet: Packet[Any] = Packet(self._read_packet(self._fed))
        packet.pts = self._fed
        self._fed += 1
        with suppress(FFmpegError):  # reported when the picture is requested
            self._keep(self._context.decode(packet))

    def _feed_end(self) -> None:
        """Flush the decoder's buffered pictures; it accepts no more packets."""
        from av.error import FFmpegError

        if self._context is None or self._fed < self.count:
            return
        with suppress(FFmpegError):
            self._keep(self._context.decode(None))
        self._context = None

    def _keep(self, frames: list[Any]) -> None:
        for frame in frames:
            if frame.pts is not None and not frame.is_corrupt:
                self._ready[int(frame.pts)] = np.ascontiguousarray(frame.to_ndarray(format="gray"))


def refusal_of(codec: str) -> str | None:
    """Return the reason why pictures of a codec cannot be decoded; None if they can."""
    try:
        import av  # noqa: F401
    except ImportError:
        return f"{codec} video, which PyAV decodes ({_EXTRA})"
    return None
