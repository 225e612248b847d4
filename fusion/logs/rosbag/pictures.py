"""Pictures in bags, read one message at a time."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from fusion.logs.rosbag.encoded import codec_of, refusal_of
from fusion.logs.rosbag.file import Bag, Message, one_line
from fusion.logs.rosbag.messages import PICTURES, RosType
from vision import InputError
from vision.images import GreyImage, decode_grey, decode_image, to_grey

DEPTHS = (10, 12, 14)  # of sensors whose pictures use the lowest of 16 bits
DEPTH_SAMPLES = 5
_PICTURE_TYPES = frozenset(kind.value for kind in PICTURES)
MAX_SIDE_PX = 1 << 15
FORWARD_NS = 2_000_000_000  # beyond it, seeking is cheaper than reading on

# Encodings of sensor_msgs/Image: channels and bytes of each.
_PLAIN = {
    "mono8": (1, 1), "8UC1": (1, 1), "mono16": (1, 2), "16UC1": (1, 2), "bgr8": (3, 1), "8UC3": (3, 1),
    "rgb8": (3, 1), "bgra8": (4, 1), "8UC4": (4, 1), "rgba8": (4, 1), "bgr16": (3, 2), "rgb16": (3, 2),
}  # fmt: skip
_BAYER = {
    "bayer_rggb8": "BG",
    "bayer_bggr8": "RG",
    "bayer_gbrg8": "GR",
    "bayer_grbg8": "GB",
}  # OpenCV's names
_YUV422 = {
    "yuv422": 1,
    "uyvy": 1,
    "UYVY": 1,
    "yuv422_yuy2": 0,
    "yuyv": 0,
    "YUYV": 0,
}  # position of the brightness
_BAYER_16 = {name.replace("8", "16"): code for name, code in _BAYER.items()}
GREY_16 = ("mono16", "16UC1", *_BAYER_16)
_PLANAR = ("nv12", "nv21", "nv24")  # brightness first
ENCODINGS = (*_PLAIN, *_BAYER, *_BAYER_16, *_YUV422, *_PLANAR)


class BagPictures:
    """Pictures of one topic; a `fusion.flight.FrameSource`.

    Parameters
    ----------
    path
        The bag.
    topic
        Its topic.
    received_ns
        Receipt of each message (n,), its position in the bag.
    repeat
        Number of earlier messages of the topic with the same time (n,).
    depth_bits
        Number of the 16 bits that the sensor uses.
    """

    def __init__(
        self,
        path: Path,
        topic: str,
        received_ns: npt.NDArray[np.int64],
        repeat: npt.NDArray[np.int64],
        depth_bits: int = 16,
    ) -> None:
        self.path, self.topic, self.depth_bits = path, topic, depth_bits
        self.received_ns, self.repeat = received_ns, repeat
        self._lock = threading.Lock()  # a bag has only one read position
        self._bag: Bag | None = None
        self._messages: Iterator[Message] | None = None
        self._at = (-1, 0)  # time and number of the last message read

    def __reduce__(self) -> tuple[Any, ...]:
        return BagPictures, (self.path, self.topic, self.received_ns, self.repeat, self.depth_bits)

    def read(self, index: int) -> GreyImage:
        """Decode a picture."""
        with self._lock:
            message = self._message(index)
        try:
            return grey(message, self.depth_bits)
        except InputError as error:
            raise self._unreadable(error.problem, int(self.received_ns[index])) from error

    def packet(self, index: int) -> bytes:
        """Return the bytes of a ``CompressedImage``."""
        with self._lock:
            return bytes(self._message(index).data)

    def used_bits(self) -> int:
        """Estimate how many of 16 bits the pictures use, from a few of them; 16 for pictures of 8 bits."""
        bits = 0
        for index in np.unique(np.linspace(0, len(self.received_ns) - 1, DEPTH_SAMPLES).astype(int)).tolist():
            with suppress(InputError):
                words = _words(self._message(index))
                if words is None:
                    return 16
                bits = max(bits, int(words.max()).bit_length())
        return next((depth for depth in DEPTHS if bits <= depth), 16) if bits else 16

    def _message(self, index: int) -> Any:
        wanted = (int(self.received_ns[index]), int(self.repeat[index]))
        try:
            message = self._find(wanted)
        except InputError:
            raise
        except Exception as error:  # rosbags raises any exception on damaged files
            self._messages = None
            raise self._unreadable(f"picture cannot be read: {one_line(error)}", wanted[0]) from error
        if message is None:
            self._messages = None
            raise self._unreadable("picture is no longer there", wanted[0])
        connection, _, raw = message
        assert self._bag is not None
        if connection.msgtype not in _PICTURE_TYPES:
            raise self._unreadable(f"is a {connection.msgtype}, no picture", wanted[0])
        try:
            return self._bag.decode(connection.msgtype, raw)
        except InputError as error:
            raise self._unreadable(error.problem, wanted[0]) from error

    def _find(self, wanted: tuple[int, int]) -> Message | None:
        if self._bag is None:
            self._bag = Bag(self.path)
        if self._messages is None or not self._at < wanted <= (self._at[0] + FORWARD_NS, 0):
            connections = [c for c in self._bag.connections if c.topic == self.topic]
            self._messages = self._bag.messages(connections, wanted[0])
            self._at = (-1, 0)
        for message in self._messages:
            t_ns = message[1]
            self._at = (t_ns, self._at[1] + 1 if t_ns == self._at[0] else 0)
            if self._at == wanted:
                return message
            if t_ns > wanted[0] + FORWARD_NS:
                break
        return None

    def _unreadable(self, what: str, received_ns: int) -> InputError:
        return InputError(
            f"{self.topic}, received at {received_ns}: {what}",
            file=self.path,
            remedy="the bag is damaged there",
        )


def describe(message: Any, kind: str) -> str:
    """Size and encoding of a picture, in words."""
    if kind == RosType.COMPRESSED:
        return f"compressed, {message.format}"
    return f"{message.width}x{message.height} {message.encoding}"


def refusal(message: Any, kind: str) -> str | None:
    """Reason why pictures like this one cannot be read; None if they can."""
    if kind == RosType.COMPRESSED:
        codec = codec_of(message.format)
        if codec is not None:
            return refusal_of(codec)
        return "compressed depth" if "compressedDepth" in message.format else None
    return None if message.encoding in ENCODINGS else f"encoding {message.encoding}"


def grey(message: Any, depth_bits: int = 16) -> GreyImage:
    """Convert an Image or CompressedImage to grey uint8 (h, w); from 16 bits, the highest 8 of those used.

    Raises
    ------
    InputError
        If it cannot be decoded, or its encoding is unknown.
    """
    words = _words(message)
    if words is not None:
        pixels = np.asarray(np.minimum(words >> (depth_bits - 8), 255), dtype=np.uint8)
        return _without_colours(pixels, str(getattr(message, "encoding", "")).replace("16", "8"))
    if hasattr(message, "format"):
        return decode_image(np.asarray(message.data, dtype=np.uint8))
    width, height, encoding = int(message.width), int(message.height), str(message.encoding)
    if encoding not in ENCODINGS:
        raise InputError(f"picture is of encoding {encoding}", remedy=f"known are {', '.join(ENCODINGS)}")
    data = np.asarray(message.data, dtype=np.uint8)
    if encoding in _PLANAR:
        return to_grey(_rows(data, width, height, int(message.step) or width, width))
    channels, depth = _PLAIN.get(encoding, (2 if encoding in _YUV422 else 1, 1))
    used = width * channels * depth
    pixels = _rows(data, width, height, int(message.step) or used, used)
    if encoding in _YUV422:
        return to_grey(pixels[:, _YUV422[encoding] :: 2])
    if encoding in _BAYER:
        return _without_colours(pixels, encoding)
    if depth == 2:  # colour
        words = np.ascontiguousarray(pixels).view(">u2" if message.is_bigendian else "<u2")
        pixels = (words >> 8).astype(np.uint8)
    shaped = pixels.reshape(height, width, channels)
    if encoding.startswith("rgb"):
        shaped = shaped[:, :, [2, 1, 0, 3][:channels]]
    return to_grey(shaped)


def _without_colours(pixels: GreyImage, encoding: str) -> GreyImage:
    """Brightness (h, w) from a Bayer mosaic; other pictures unchanged."""
    if encoding not in _BAYER:
        return pixels
    import cv2

    return to_grey(cv2.cvtColor(pixels, getattr(cv2, f"COLOR_Bayer{_BAYER[encoding]}2GRAY")))


def _words(message: Any) -> npt.NDArray[np.uint16] | None:
    """Pixels (h, w) of a grey picture of 16 bits; None for any other."""
    if hasattr(message, "format"):
        if not str(message.format).startswith(GREY_16):
            return None
        image = decode_grey(np.asarray(message.data, dtype=np.uint8))
        return image if image.dtype == np.uint16 else None
    if message.encoding not in GREY_16:
        return None
    width, height = int(message.width), int(message.height)
    data = np.asarray(message.data, dtype=np.uint8)
    pixels = _rows(data, width, height, int(message.step) or 2 * width, 2 * width)
    return np.ascontiguousarray(pixels).view(">u2" if message.is_bigendian else "<u2").astype(np.uint16)


def _rows(data: npt.NDArray[np.uint8], width: int, height: int, step: int, used: int) -> GreyImage:
    """Rows (h, used) of bytes, without padding."""
    if not (0 < width <= MAX_SIDE_PX and 0 < height <= MAX_SIDE_PX and step >= used):
        raise InputError(f"picture has the size {width}x{height} and rows of {step} bytes, which cannot be")
    if data.size < step * height:
        raise InputError(f"picture has {data.size} bytes instead of {step * height}")
    return np.ascontiguousarray(data[: step * height].reshape(height, step)[:, :used])
