"""Bags as files: ROS 1, ROS 2 (sqlite3 or MCAP, alone or in a folder), opened with rosbags, complete or truncated.

After a power loss, a bag has no index. rosbags rejects it; here the index is rebuilt in memory from the complete
messages.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from fusion.logs.csv.rows import read_head
from fusion.logs.rosbag.messages import RosType
from fusion.logs.rosbag.unpack import bound_rosbags
from fusion.logs.samples import Problems
from vision import InputError
from vision.limits import check_yaml, read_text

if TYPE_CHECKING:
    from rosbags.interfaces import Connection

ROS1_MAGIC = b"#ROSBAG V"
MCAP_MAGIC = b"\x89MCAP0\r\n"
SQLITE_MAGIC = b"SQLite format 3\x00"
METADATA = "metadata.yaml"
_SUFFIXES = (".db3", ".db3-wal", ".db3-shm", ".mcap", ".yaml")  # of a recorder's files in its folder
METADATA_KEY = "rosbag2_bagfile_information"

FIRST_SKIP_NS = 1_000_000
MAX_SKIPS = 200

Message = tuple["Connection", int, bytes]  # connection, time of receipt, bytes


class Reader(Protocol):
    """Common interface of the readers of rosbags."""

    connections: list[Connection]

    def open(self) -> None:
        """Open the file and read its index."""

    def close(self) -> None:
        """Close the file."""

    def messages(
        self, connections: Collection[Connection], start: int | None = None, stop: int | None = None
    ) -> Iterator[Message]:
        """Messages in the order of receipt."""


def magic_of(path: Path) -> bytes:
    """First bytes of a file."""
    with path.open("rb") as file:
        return file.read(16)


def bag_files_in(folder: Path) -> list[Path]:
    """Bag files of ROS 2 in a folder, by their first bytes."""
    files = [path for path in sorted(folder.iterdir()) if path.suffix in (".db3", ".mcap") and path.is_file()]
    return [path for path in files if magic_of(path).startswith((MCAP_MAGIC, SQLITE_MAGIC))]


def recognises(path: Path) -> bool:
    """Whether a file begins like a bag, or a folder contains one of ROS 2."""
    if path.is_file():
        return magic_of(path).startswith((ROS1_MAGIC, MCAP_MAGIC, SQLITE_MAGIC))
    if not path.is_dir():
        return False
    metadata = path / METADATA
    if metadata.is_file() and METADATA_KEY in "".join(read_head(metadata)):
        return True
    only_bags = all(child.suffix in _SUFFIXES for child in path.iterdir())
    return only_bags and bool(bag_files_in(path))


class Bag:
    """An open bag.

    Parameters
    ----------
    path
        A ``.bag``, ``.db3`` or ``.mcap`` file, or the folder of a ROS 2 bag.

    Raises
    ------
    InputError
        If rosbags is not installed or the file cannot be read.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.problems: Problems = ()
        self.ros2 = True
        try:
            import rosbags.rosbag2  # noqa: F401
        except ImportError:
            raise InputError(
                "is a ROS bag, which rosbags reads", file=path, remedy="pip install 'corridor-fusion[ros]'"
            ) from None
        bound_rosbags()
        try:
            self._open()
            self._check_format()
        except InputError as error:
            raise InputError(error.problem, file=error.file or path, remedy=error.remedy) from error
        except Exception as error:  # rosbags raises any exception on damaged files
            raise InputError(
                f"cannot be opened: {one_line(error, path)}",
                file=path,
                remedy="the bag is damaged; copy it again, or try `ros2 bag reindex` or sqlite3's `.recover`",
            ) from error

    def _open(self) -> None:
        from rosbags.rosbag2 import Reader as Reader2

        plugins: dict[str, Any] = dict(Reader2.STORAGE_PLUGINS)
        path = self.path
        if path.is_dir() and not (path / METADATA).is_file():
            path = self._only_storage(path)
        if path.is_dir():
            self.format = "ROS 2 bag"
            check_yaml(read_text(path / METADATA, "a bag's metadata"))
            self._reader: Reader = plugins["dir"](path)
            self._reader.open()
            return
        magic = magic_of(path)
        if magic.startswith(SQLITE_MAGIC):
            self.format = "ROS 2 bag (sqlite3)"
            self._reader = plugins[".db3"](path)
            self._reader.open()
        elif magic.startswith(MCAP_MAGIC):
            self.format = "ROS 2 bag (MCAP)"
            self._reader = self._open_mcap(plugins[".mcap"], path)
        else:
            self.format, self.ros2 = "ROS 1 bag", False
            self._reader = self._open_ros1(path)

    def _check_format(self) -> None:
        formats = {str(getattr(c.ext, "serialization_format", "cdr")) for c in self.connections}
        other = ", ".join(sorted(formats - {"cdr", ""}))
        if self.ros2 and other:
            raise InputError(
                f"its messages are serialized as {other}, not as cdr, which ROS 2 writes",
                file=self.path,
                remedy="record or convert it with the serialization format cdr, as `ros2 bag convert` does",
            )

    def _only_storage(self, folder: Path) -> Path:
        storages = bag_files_in(folder)
        if len(storages) != 1:
            raise InputError(
                f"has {len(storages)} bag files and no {METADATA}",
                file=folder,
                remedy="run `ros2 bag reindex`",
            )
        self.problems += (f"{METADATA} is missing: the recorder was not stopped; {storages[0].name} is read",)
        return storages[0]

    def _open_ros1(self, path: Path) -> Reader:
        from rosbags.rosbag1 import Reader as Reader1

        from fusion.logs.rosbag.recovery import UnindexedRos1

        whole = Reader1(path)
        try:
            whole.open()
            return whole
        except Exception as error:
            reason = one_line(error)
        recovered = UnindexedRos1(path)
        recovered.open()
        if recovered.start_time == 0:
            raise InputError(
                f"contains no whole message ({reason})", file=path, remedy="the recording was cut too early"
            )
        self.problems += (f"the bag has no sound index ({reason}); it was rebuilt", *recovered.problems)
        return recovered

    def _open_mcap(self, plugin: Any, path: Path) -> Reader:
        from fusion.logs.rosbag.recovery import index_mcap

        reader: Reader = plugin(path)
        try:
            reader.open()
            return reader
        except Exception as error:
            reason = one_line(error)
        if "Profile is not ros2" in reason:
            raise InputError(
                "is an MCAP file of another profile than ros2",
                file=path,
                remedy="only ROS 2 messages are read; convert it",
            )
        reader = plugin(path)
        lost = index_mcap(reader)
        self.problems += (f"the bag has no sound index ({reason}); it was rebuilt, {lost}",)
        return reader

    @property
    def connections(self) -> list[Connection]:
        """The recorded topics."""
        return self._reader.connections

    def messages(self, connections: Collection[Connection], start_ns: int | None = None) -> Iterator[Message]:
        """Messages in the order of receipt, from a given time; damage raises the errors of rosbags."""
        for connection, t_ns, raw in self._reader.messages(list(connections), start=start_ns):
            yield connection, t_ns, bytes(raw)

    def decode(self, msgtype: str, raw: bytes) -> Any:
        """Decode a message with rosbags.

        Raises
        ------
        InputError
            If it cannot be decoded.
        """
        store = _STORES.get(self.ros2) or _STORES.setdefault(self.ros2, _typestore(self.ros2))
        try:
            if self.ros2:
                return store.deserialize_cdr(raw, msgtype)
            return store.deserialize_ros1(raw, msgtype)
        except Exception as error:  # rosbags raises any exception on damaged bytes
            raise InputError(f"message does not decode: {one_line(error)}", file=self.path) from error

    def start_ns(self) -> int:
        """Receipt of the first message, by the index; 0 if implausible."""
        # The readers of rosbags have it in one of two places, those of damaged bags in neither.
        start = getattr(self._reader, "start_time", None)
        metadata = getattr(self._reader, "metadata", None)
        if start is None and metadata is not None:
            start = metadata.start_time
        return 0 if start is None or start >= 2**62 else int(start)

    def close(self) -> None:
        """Close the file; values already read stay valid."""
        with suppress(Exception):  # closing a damaged file may fail
            self._reader.close()


class SkippingMessages:
    """Messages of a bag in the order of receipt; damaged stretches are skipped, and reported in ``problems``."""

    def __init__(self, bag: Bag, connections: Collection[Connection]) -> None:
        self.problems: Problems = ()
        self._bag, self._connections = bag, connections

    def __iter__(self) -> Iterator[Message]:
        if not self._connections:
            return
        skips, skip_ns = 0, FIRST_SKIP_NS
        at_ns: int | None = None
        first_ns: int | None = None
        while True:
            try:
                for connection, t_ns, raw in self._bag.messages(self._connections, at_ns):
                    yield connection, t_ns, raw
                    at_ns, skip_ns = t_ns + 1, FIRST_SKIP_NS
                break
            except InputError as error:  # a limit, not damage
                raise InputError(error.problem, file=self._bag.path, remedy=error.remedy) from error
            except Exception as error:  # rosbags raises any exception on damaged bytes
                skips += 1
                at_ns = self._bag.start_ns() if at_ns is None else at_ns
                first_ns = at_ns if first_ns is None else first_ns
                reason = one_line(error)
                at_ns += skip_ns
                skip_ns *= 2
                if skips > MAX_SKIPS or at_ns >= 2**62:
                    break
        if first_ns is not None:
            self.problems = (
                f"parts of the bag are damaged and were skipped, the first near {first_ns} ({reason})",
            )


def _typestore(ros2: bool) -> Any:
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    if ros2:
        return get_typestore(Stores.LATEST)
    store = get_typestore(Stores.ROS1_NOETIC)
    if RosType.TRANSFORMS not in store.types:
        store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", RosType.TRANSFORMS))
    return store


_STORES: dict[bool, Any] = {}  # building one takes a tenth of a second


def one_line(error: Exception, path: Path | None = None) -> str:
    """Return the text of an exception of rosbags, without the path."""
    text = " ".join(str(error).split())
    if path is not None:
        text = text.replace(f"{path}: ", "").replace(str(path), path.name)
    return (text or type(error).__name__)[:120]
