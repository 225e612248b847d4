"""Files and folders that appear whole: an error or a kill while writing leaves what was there before.

A draft lies hidden beside its target, as ``.NAME.corridor-XXXXXXXX.partial``. It is on the disk before it takes the
target's name. What a killed run left is cleared, and what it had set aside put back, when the same target is next
written; the drafts of a run still at work are locked and stay.
"""

from __future__ import annotations

import os
import re
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from errno import ENOTDIR
from hashlib import file_digest
from pathlib import Path

from vision.errors import InputError

try:
    from fcntl import LOCK_EX, LOCK_NB, flock
except ImportError:  # no such locks on Windows: there nothing is taken for left behind
    flock = None  # type: ignore[assignment]

_POSIX = os.name == "posix"

_at_work: dict[Path, Path] = {}  # this process's drafts and what each becomes


def sha256_of(path: Path) -> str:
    """Return the SHA-256 of a file's content, hexadecimal.

    Raises
    ------
    OSError
        If it cannot be read.
    """
    with path.open("rb") as file:
        return file_digest(file, "sha256").hexdigest()


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Give a draft to write to; it takes the name ``path`` if the block succeeds. Parents are made as needed.

    A link is followed; a device or a pipe such as ``/dev/stdout`` is written to as it is.

    Raises
    ------
    InputError
        Naming ``path``, where it cannot be written.
    """
    try:
        if path.exists() and not path.is_file() and not path.is_dir():
            yield path
            return
        target = path.resolve()
        _make_folder(target.parent)
        restore(target)
        with draft_of(target, f".{target.name}") as draft:
            draft.touch(exist_ok=False)
            with locked(draft):
                yield draft
                to_disk(draft)
                draft.replace(target)
                to_disk(target.parent)
    except OSError as error:
        raise InputError(
            f"cannot be written: {error_text(error)}", file=path, remedy="choose another place"
        ) from error


@contextmanager
def replacing_folder(folder: Path) -> Iterator[Path]:
    """Give a draft to fill; it takes the place of ``folder`` and all that is in it if the block succeeds.

    Parameters
    ----------
    folder
        Absolute and free of links. Its parents are made as needed.
    """
    _make_folder(folder.parent)
    restore(folder)
    with draft_of(folder, f".{folder.name}") as draft:
        draft.mkdir()
        with locked(draft):
            yield draft
            tree_to_disk(draft)
            _swap(draft, folder)


def _swap(draft: Path, folder: Path) -> None:
    if not folder.exists() or not any(folder.iterdir()):
        draft.replace(folder)
        to_disk(folder.parent)
        return
    aside = draft.with_suffix(".old")
    with locked(folder):
        folder.rename(aside)
        try:
            draft.rename(folder)
        except OSError:
            with suppress(OSError):
                aside.rename(folder)
            raise
        to_disk(folder.parent)
        shutil.rmtree(aside, ignore_errors=True)


def restore(target: Path) -> None:
    """Put back what a killed run had set aside of a file or folder, and clear the drafts that it left."""
    for left in left_behind(target.parent, f".{target.name}"):
        if left.suffix == ".old" and not target.exists():
            left.rename(target)
        else:
            remove(left)


def left_behind(folder: Path, prefix: str = "") -> list[Path]:
    """Return drafts in a folder that no running process holds, by the name they begin with."""
    if flock is None or not folder.is_dir():
        return []
    ours = re.compile(re.escape(prefix) + r"\.corridor-[0-9a-f]{8}\.(partial|complete|old)")
    return [path for path in sorted(folder.iterdir()) if ours.fullmatch(path.name) and not _is_held(path)]


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except FileExistsError as error:
        raise NotADirectoryError(ENOTDIR, os.strerror(ENOTDIR), str(folder)) from error


@contextmanager
def draft_of(target: Path, prefix: str = "") -> Iterator[Path]:
    """Give the path of a draft, removed at the end where it is still there.

    Parameters
    ----------
    target
        What the draft becomes: it lies beside it.
    prefix
        What the draft's name begins with, for `left_behind` to find.
    """
    draft = target.with_name(f"{prefix}.corridor-{secrets.token_hex(4)}.partial")
    _at_work[draft] = target
    try:
        yield draft
    finally:
        remove(draft)
        del _at_work[draft]


def abandon_drafts() -> None:
    """Remove all drafts of this process, and put back what was set aside for them: for one about to end at once."""
    for draft, target in list(_at_work.items()):
        remove(draft)
        aside = draft.with_suffix(".old")
        if not target.exists() and aside.exists():
            with suppress(OSError):
                aside.rename(target)
        else:
            remove(aside)


def remove(path: Path) -> None:
    """Remove a file or a folder as far as that can be done."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
        return
    with suppress(OSError):
        path.unlink(missing_ok=True)


@contextmanager
def locked(path: Path) -> Iterator[None]:
    """Hold a file or folder that is being worked on; the system lets go of it when the process ends."""
    if flock is None:
        yield
        return
    handle = os.open(path, os.O_RDONLY)
    try:
        with suppress(OSError):  # a file system without locks
            flock(handle, LOCK_EX | LOCK_NB)
        yield
    finally:
        os.close(handle)


def _is_held(path: Path) -> bool:
    try:
        handle = os.open(path, os.O_RDONLY | os.O_NOFOLLOW)
    except OSError:
        return True
    try:
        flock(handle, LOCK_EX | LOCK_NB)
    except OSError:
        return True
    finally:
        os.close(handle)
    return False


def to_disk(path: Path) -> None:
    """Wait until a file's content, or a folder's list of names, is on the disk."""
    if path.is_dir() and not _POSIX:
        return
    handle = os.open(path, os.O_RDONLY if _POSIX else os.O_RDWR)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def tree_to_disk(folder: Path) -> None:
    """Wait until a folder and all in it is on the disk."""
    for inside, _, names in os.walk(folder, topdown=False):
        for name in names:
            to_disk(Path(inside, name))
        to_disk(Path(inside))


def stays_inside(name: str) -> bool:
    """Whether a file name that was read from a file names something in that file's folder or below."""
    path = os.path.normpath(name.replace("\\", "/"))
    return not os.path.isabs(path) and path.split("/")[0] != ".." and "\0" not in name


def error_text(error: Exception) -> str:
    """Return what the system says of an error, without its number and path."""
    return (error.strerror or str(error)) if isinstance(error, OSError) else str(error)
