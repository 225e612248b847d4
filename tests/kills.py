"""End a writer at each of its operations on files, as a kill would, and look at what is left."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from itertools import count
from pathlib import Path
from typing import Any, cast

DONE = 0
KILLED = 9
_CHANGES = {
    "os.rename",
    "os.remove",
    "os.mkdir",
    "os.rmdir",
    "os.link",
    "os.symlink",
    "os.truncate",
    "os.chmod",
}


def kill_at_every_change(
    write: Callable[[], None], folder: Path, prepare: Callable[[], None], check: Callable[[], None]
) -> int:
    """Prepare a folder and write, killed before the first change in it, before the second, and so on.

    Each time ``check`` looks at what is left. Opening a file to write, renaming, removing, making and removing a
    folder, and waiting for the disk are changes; between opening and waiting a file is half written.

    Returns
    -------
    int
        How many kills there were: the last run was not killed any more.
    """
    for number in count(1):
        prepare()
        if _in_child(write, folder, number) == DONE:
            return number - 1
        check()
    raise AssertionError


def _in_child(write: Callable[[], None], folder: Path, number: int) -> int:
    sys.stdout.flush()
    sys.stderr.flush()
    child = os.fork()
    if child == 0:
        try:
            _end_at(folder, number)
            write()
            os._exit(DONE)
        except BaseException:
            os._exit(1)
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    assert code in (DONE, KILLED), code
    return code


def _end_at(folder: Path, number: int) -> None:
    """End this process before its change of that number below a folder."""
    seen = 0

    def counted() -> None:
        nonlocal seen
        seen += 1
        if seen == number:
            os._exit(KILLED)

    def hook(event: str, arguments: tuple[Any, ...]) -> None:
        changes = event in _CHANGES or (event == "open" and _writes(arguments))
        if changes and any(_below(argument, folder) for argument in arguments):
            counted()

    fsync = os.fsync

    def counted_fsync(handle: int) -> None:
        counted()
        fsync(handle)

    os.fsync = cast("Any", counted_fsync)
    sys.addaudithook(hook)


def _writes(arguments: tuple[Any, ...]) -> bool:
    flags = arguments[2]
    return isinstance(flags, int) and bool(flags & (os.O_WRONLY | os.O_RDWR | os.O_CREAT))


def _below(argument: object, folder: Path) -> bool:
    # Removing a tree names its files by their folder's handle: a name without a folder counts too.
    return isinstance(argument, str | Path) and (
        not os.path.isabs(argument) or Path(argument).is_relative_to(folder)
    )
