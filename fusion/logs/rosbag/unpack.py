"""Decompression of chunks in bags, within bounds: a few kilobytes may expand to gigabytes.

rosbags decompresses a chunk without a limit; `bound_rosbags` replaces its functions with these.
"""

from __future__ import annotations

import bz2
from collections.abc import Callable
from functools import cache
from types import SimpleNamespace
from typing import Any, BinaryIO, Protocol

from vision import InputError

MAX_UNPACKED = 1 << 27  # bytes of a chunk or message; a recorder closes a chunk after some megabytes
FREE_UNPACKED = 1 << 24  # up to here any ratio is allowed: dark pictures compress a thousandfold
MAX_RATIO = 200
_PIECE = 1 << 22


class Decompressor(Protocol):
    """Common interface of the decompressors of bz2, lz4 and zstd."""

    @property
    def eof(self) -> bool:
        """Whether the end of a stream was reached."""

    @property
    def needs_input(self) -> bool:
        """Whether more input is needed."""

    @property
    def unused_data(self) -> bytes | None:
        """Bytes after the end of the stream."""

    def decompress(self, data: bytes, /, max_length: int = -1) -> bytes:
        """Unpack some more."""


def unpack(packed: bytes, new: Callable[[], Decompressor]) -> bytes:
    """Unpack bytes, one stream after another.

    Raises
    ------
    InputError
        If the result is too large.
    EOFError
        If they end within a stream.
    """
    bound = unpacked_bound(len(packed))
    parts: list[bytes] = []
    size, rest = 0, packed
    while rest:
        stream = new()
        part = stream.decompress(rest, _PIECE)
        while True:
            parts.append(part)
            size += len(part)
            if size > bound:
                raise _too_large(len(packed), bound)
            if stream.eof:
                break
            if stream.needs_input:
                raise EOFError("the packed data end within a stream")
            part = stream.decompress(b"", _PIECE)
        rest = stream.unused_data or b""
    return b"".join(parts)


def unpacked_bound(packed_bytes: int) -> int:
    """Return the largest allowed size for this many packed bytes."""
    return min(MAX_UNPACKED, max(FREE_UNPACKED, MAX_RATIO * packed_bytes))


def _too_large(packed_bytes: int, bound: int) -> InputError:
    return InputError(
        f"{packed_bytes} packed bytes become more than {bound}, which no recorder writes",
        remedy="unpack the bag with ROS's own tools if you trust it",
    )


def unpack_bz2(packed: bytes) -> bytes:
    """Unpack bz2, see `unpack`."""
    return unpack(packed, bz2.BZ2Decompressor)


def unpack_lz4(packed: bytes) -> bytes:
    """Unpack lz4 frames, see `unpack`."""
    from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]

    return unpack(packed, LZ4FrameDecompressor)


def unpack_zstd(packed: bytes) -> bytes:
    """Unpack zstd frames, see `unpack`."""
    return unpack(packed, _zstd().ZstdDecompressor)


def _zstd() -> Any:
    from rosbags.rosbag2 import reader

    zstd = vars(reader)["zstd"]  # of the standard library or its backport, as rosbags uses
    return getattr(zstd, "whole", zstd)


class _BoundedFile:
    """A packed file read piece by piece, with an error if it becomes too large for the disk."""

    def __init__(self, file: Any, packed_bytes: int) -> None:
        self._file = file
        self._packed_bytes = packed_bytes
        self._left = self._bound = max(FREE_UNPACKED, MAX_RATIO * packed_bytes)

    def __enter__(self) -> _BoundedFile:
        return self

    def __exit__(self, *error: object) -> None:
        self._file.close()

    def read(self, size: int = -1) -> bytes:
        """Read unpacked bytes; one piece if no size is given.

        Raises
        ------
        InputError
            If they exceed the bound.
        """
        part = bytes(self._file.read(size if size > 0 else _PIECE))
        self._left -= len(part)
        if self._left < 0:
            raise _too_large(self._packed_bytes, self._bound)
        return part


def _open_zstd(file: BinaryIO, mode: str = "rb") -> _BoundedFile:
    size = file.seek(0, 2)
    file.seek(0)
    return _BoundedFile(_zstd().open(file, mode), size)


@cache
def bound_rosbags() -> None:
    """Make rosbags decompress within the bounds above, once per process."""
    from rosbags.rosbag1 import reader as ros1
    from rosbags.rosbag2 import reader as ros2
    from rosbags.rosbag2 import storage_mcap as mcap

    ros1.decompressors.update(bz2=unpack_bz2, lz4=unpack_lz4)
    mcap.DECOMPRESSORS.update(
        lz4=lambda data, size: unpack_lz4(data), zstd=lambda data, size: unpack_zstd(data)
    )
    # rosbags looks these functions up in a module at each use.
    vars(ros2)["zstd"] = SimpleNamespace(decompress=unpack_zstd, open=_open_zstd, whole=_zstd())
