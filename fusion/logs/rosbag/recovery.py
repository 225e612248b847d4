"""Recovery of truncated bags without an index or an end: complete messages are found and sorted.

Formats: http://wiki.ros.org/Bags/Format/2.0 and https://mcap.dev/spec
"""

from __future__ import annotations

import struct
from bisect import bisect_left
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, NamedTuple

from fusion.logs.rosbag.unpack import unpack_bz2, unpack_lz4
from fusion.logs.samples import Problems, counted
from vision import InputError

if TYPE_CHECKING:
    from rosbags.interfaces import Connection

_MESSAGE, _CHUNK, _CONNECTION = 2, 5, 7
_MCAP_CHUNK, _MCAP_DATA_END, _MCAP_LAST = 6, 15, 15
_MAX_HEADER = 1 << 16


class _Record(NamedTuple):
    """A record of a ROS 1 bag: its header's fields, and the position of its data."""

    fields: dict[bytes, bytes]
    start: int
    end: int

    @property
    def op(self) -> int:
        """Kind of the record; 0 if missing."""
        return int.from_bytes(self.fields.get(b"op", b"\0"), "little")


class _Entry(NamedTuple):
    """A message: time of receipt, connection, chunk, and its first and last byte in the chunk."""

    t_ns: int
    connection: int
    chunk: int
    start: int
    end: int


class UnindexedRos1:
    """A ROS 1 bag without its index, read like a `rosbags.rosbag1.Reader`."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.connections: list[Connection] = []
        self.problems: Problems = ()
        self._bio: BinaryIO | None = None
        self._chunks: list[tuple[int, int, str]] = []
        self._entries: list[_Entry] = []
        self._cached: tuple[int, bytes] = (-1, b"")

    @property
    def start_time(self) -> int:
        """Receipt of the first message."""
        return self._entries[0].t_ns if self._entries else 0

    def open(self) -> None:
        """Find all complete messages."""
        self._bio = self.path.open("rb")
        size = self.path.stat().st_size
        self._bio.readline()
        at, damaged = self._bio.tell(), 0
        while (record := _record_at(self._bio, at, size)) is not None:
            if record.op == _CHUNK:
                compression = record.fields.get(b"compression", b"none").decode(errors="replace")
                self._chunks.append((record.start, min(record.end, size) - record.start, compression))
                damaged += not self._index_chunk(len(self._chunks) - 1)
            at = record.end
        self._entries.sort(key=lambda entry: entry.t_ns)
        if damaged:
            self.problems = (f"{counted(damaged, 'chunk')} of the bag damaged or torn",)

    def close(self) -> None:
        """Close the file."""
        if self._bio is not None:
            self._bio.close()

    def messages(
        self, connections: Collection[Connection], start: int | None = None, stop: int | None = None
    ) -> Iterator[tuple[Connection, int, bytes]]:
        """Messages in the order of receipt."""
        wanted = {connection.id: connection for connection in connections}
        first = 0 if start is None else bisect_left(self._entries, start, key=lambda entry: entry.t_ns)
        for entry in self._entries[first:]:
            if stop is not None and entry.t_ns >= stop:
                return
            if entry.connection in wanted:
                content = self._content(entry.chunk)
                yield wanted[entry.connection], entry.t_ns, content[entry.start : entry.end]

    def _content(self, number: int) -> bytes:
        if self._cached[0] != number:
            assert self._bio is not None
            start, length, compression = self._chunks[number]
            self._bio.seek(start)
            self._cached = (number, _decompressed(self._bio.read(length), compression))
        return self._cached[1]

    def _index_chunk(self, number: int) -> bool:
        """Index a chunk's messages; False if it is damaged or truncated."""
        from io import BytesIO

        try:
            content = self._content(number)
        except InputError:  # a limit, not damage
            raise
        except Exception:  # any decompressor's error
            return False
        bio, at = BytesIO(content), 0
        while (record := _record_at(bio, at, len(content))) is not None:
            if record.end > len(content):
                break
            if record.op == _CONNECTION:
                self._add_connection(record.fields, _fields(content[record.start : record.end]))
            elif record.op == _MESSAGE and len(record.fields.get(b"time", b"")) == 8:
                seconds, nanoseconds = struct.unpack("<II", record.fields[b"time"])
                connection = int.from_bytes(record.fields.get(b"conn", b""), "little")
                t_ns = seconds * 1_000_000_000 + nanoseconds
                self._entries.append(_Entry(t_ns, connection, number, record.start, record.end))
            at = record.end
        return at == len(content)

    def _add_connection(self, fields: dict[bytes, bytes], about: dict[bytes, bytes]) -> None:
        from rosbags.interfaces import (
            Connection,
            ConnectionExtRosbag1,
            MessageDefinition,
            MessageDefinitionFormat,
        )

        number = int.from_bytes(fields.get(b"conn", b""), "little")
        if any(known.id == number for known in self.connections):
            return
        kind = about.get(b"type", b"").decode(errors="replace")
        topic = fields.get(b"topic", b"").decode(errors="replace")
        self.connections.append(
            Connection(
                number,
                topic,
                kind if "/msg/" in kind else kind.replace("/", "/msg/"),
                MessageDefinition(MessageDefinitionFormat.NONE, ""),
                about.get(b"md5sum", b"").decode(errors="replace"),
                0,
                ConnectionExtRosbag1(None, None),
                self,
            )
        )


def _record_at(bio: BinaryIO, at: int, size: int) -> _Record | None:
    """Read a record's header; None at the end, or if there is no record."""
    bio.seek(at)
    raw = bio.read(4)
    length = int.from_bytes(raw, "little")
    if len(raw) < 4 or not 0 < length <= min(_MAX_HEADER, size - at):
        return None
    fields = _fields(bio.read(length))
    raw = bio.read(4)
    if b"op" not in fields or len(raw) < 4:
        return None
    start = at + 8 + length
    return _Record(fields, start, start + int.from_bytes(raw, "little"))


def _fields(header: bytes) -> dict[bytes, bytes]:
    """Fields ``name=value`` of a header; those after damage are lost."""
    fields: dict[bytes, bytes] = {}
    at = 0
    while at + 4 <= len(header):
        length = int.from_bytes(header[at : at + 4], "little")
        name, found, value = header[at + 4 : at + 4 + length].partition(b"=")
        if not found:
            break
        fields[name] = value
        at += 4 + length
    return fields


def _decompressed(data: bytes, compression: str) -> bytes:
    if compression == "bz2":
        return unpack_bz2(data)
    return unpack_lz4(data) if compression == "lz4" else data


def index_mcap(reader: Any) -> str:
    """Open a `rosbags` MCAP reader on a file without summary, up to the last complete record; report the loss.

    Raises
    ------
    InputError
        If no chunk and no message is complete.
    """
    from rosbags.rosbag2.storage_mcap import ChunkInfo

    reader.bio = reader.path.open("rb")
    size = reader.path.stat().st_size
    chunks, at = [], 8
    while (end := _mcap_record_end(reader.bio, at, size)) is not None:
        opcode, start = end[0], at + 9
        if opcode == _MCAP_CHUNK:
            header = _mcap_chunk(reader.bio, start, end[1])
            if header is None:
                break
            times, compression, packed, unpacked = header
            chunks.append(ChunkInfo(*times, at, end[1] - at, {}, 0, compression, packed, unpacked, {}))
        if opcode == 1:
            reader.data_start = end[1]
        at = end[1]
        if opcode == _MCAP_DATA_END:
            break
    reader.data_end = at
    reader.meta_scan()
    counts = reader.statistics.channel_message_counts
    if not counts:
        raise InputError(
            "contains no whole message", file=reader.path, remedy="the recording was cut too early"
        )
    reader.connections = [c._replace(msgcount=counts.get(c.id, 0)) for c in reader.connections]
    for chunk in chunks:
        chunk.channel_count.update(counts)
    reader.chunks = chunks
    lost = size - at
    return f"{lost} of {size} bytes at its end are lost" if lost else "nothing seems to be lost"


def _mcap_record_end(bio: BinaryIO, at: int, size: int) -> tuple[int, int] | None:
    """Kind and end of a record, or None if it is not complete."""
    bio.seek(at)
    head = bio.read(9)
    if len(head) < 9 or not 1 <= head[0] <= _MCAP_LAST:
        return None
    end = at + 9 + int.from_bytes(head[1:], "little")
    return (head[0], end) if end <= size else None


def _mcap_chunk(bio: BinaryIO, start: int, end: int) -> tuple[tuple[int, int], str, int, int] | None:
    """First and last time, compression, packed and unpacked size of an intact chunk; else None."""
    from rosbags.rosbag2.storage_mcap import decompress

    bio.seek(start)
    content = bio.read(end - start)
    try:
        first, last, unpacked, crc, length = struct.unpack_from("<QQQII", content)
        compression = content[32 : 32 + length].decode()
        (packed,) = struct.unpack_from("<Q", content, 32 + length)
        decompress(content[40 + length : 40 + length + packed], compression, unpacked, crc)
    except Exception:  # any decompressor's error
        return None
    return (first, last), compression, packed, unpacked
