"""Atomic writing of files and folders: after an error or a kill while writing, the previous ones are unchanged.

A draft is a hidden file beside its target, ``.NAME.corridor-XXXXXXXX.partial``. It is flushed to the disk before it
is renamed to the target. When the same target is written again, drafts of a killed run are deleted and its backups
restored; the drafts of a running process are locked and kept.
"""

from __future__ import annotations

import os
import re
import secrets
import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from errno import ENOTDIR
from hashlib import file_digest
from pathlib import Path

from vision.errors import InputError

try:
    from fcntl import LOCK_EX, LOCK_NB, flock
except ImportError:  # no such locks on Windows: there, no draft is regarded as left behind
    flock = None  # type: ignore[assignment]

_POSIX = os.name == "posix"

_at_work: dict[Path, Path] = {}  # this process's drafts and their targets


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
    """Provide a draft to write to; it is renamed to ``path`` if the block succeeds. Creates missing parents.

    Links are followed; a device or a pipe such as ``/dev/stdout`` is written to directly.

    Raises
    ------
    InputError
        With ``path``, if it cannot be written.
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
    """Provide a draft to fill; it replaces ``folder`` with all its contents if the block succeeds.

    Parameters
    ----------
    folder
        Absolute, without links. Missing parents are created.
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
    """Restore a file's or folder's backup from a killed run, and delete the run's drafts."""
    for left in left_behind(target.parent, f".{target.name}"):
        if left.suffix == ".old" and not target.exists():
            left.rename(target)
        else:
            remove(left)


def left_behind(folder: Path, prefix: str = "") -> list[Path]:
    """Return a folder's drafts with this prefix that no running process holds."""
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
    """Provide the path of a draft, which is deleted at the end if it still exists.

    Parameters
    ----------
    target
        Target of the draft, in the same folder.
    prefix
        Prefix of the draft's name, for `left_behind`.
    """
    draft = target.with_name(f"{prefix}.corridor-{secrets.token_hex(4)}.partial")
    _at_work[draft] = target
    try:
        yield draft
    finally:
        remove(draft)
        del _at_work[draft]


def abandon_drafts() -> None:
    """Delete all drafts of this process, and restore backups, before the process ends at once."""
    for draft, target in list(_at_work.items()):
        remove(draft)
        aside = draft.with_suffix(".old")
        if not target.exists() and aside.exists():
            with suppress(OSError):
                aside.rename(target)
        else:
            remove(aside)


def remove(path: Path) -> None:
    """Delete a file or a folder as far as possible."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
        return
    with suppress(OSError):
        path.unlink(missing_ok=True)


@contextmanager
def locked(path: Path) -> Iterator[None]:
    """Lock a file or folder in use; the system releases the lock when the process ends."""
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
    """Flush a file's content, or a folder's list of names, to the disk."""
    if path.is_dir() and not _POSIX:
        return
    handle = os.open(path, os.O_RDONLY if _POSIX else os.O_RDWR)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def tree_to_disk(folder: Path) -> None:
    """Flush a folder and all its contents to the disk."""
    for inside, _, names in os.walk(folder, topdown=False):
        for name in names:
            to_disk(Path(inside, name))
        to_disk(Path(inside))


def is_inside_folder(name: str) -> bool:
    """Whether a file name read from a file refers to that file's folder or below."""
    path = os.path.normpath(name.replace("\\", "/"))
    return not os.path.isabs(path) and path.split("/")[0] != ".." and "\0" not in name


def check_name(path: Path) -> None:
    """Raise `InputError` if a path is not text, so that no file could name it."""
    encoding = sys.getfilesystemencoding()
    try:
        str(path).encode("utf-8")
    except UnicodeEncodeError as error:
        remedy = "rename it" if encoding == "utf-8" else "rename it, or use a locale with UTF-8"
        raise InputError(
            f"the name contains bytes that are not {encoding}", file=path, remedy=remedy
        ) from error


def error_text(error: Exception) -> str:
    """Return the system's text for an error, without number and path."""
    return (error.strerror or str(error)) if isinstance(error, OSError) else str(error)
