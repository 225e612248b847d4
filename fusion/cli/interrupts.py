"""Handling of interrupts (Ctrl-C): they end the program at once, without incomplete files.

Raising `KeyboardInterrupt`, as Python does, is not safe: libraries swallow it in callbacks and destructors, and
a callback from compiled code that raises can crash the process. Imports as little as possible, since Ctrl-C before
`leave_at_once` ends in Python's traceback.
"""

from __future__ import annotations

import os
import signal
import sys

TYPE_CHECKING = False
if TYPE_CHECKING:
    from types import FrameType

EXIT_CODE = 130
_WORDS = b"corridor: interrupted\n"
_CLEAR_LINE_AND_SHOW_CURSOR = b"\r\x1b[2K\x1b[?25h"  # a progress bar hides the cursor


def leave_at_once() -> None:
    """Let an interrupt end the program at once, unless interrupts are ignored."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _leave)


def _leave(number: int, frame: FrameType | None) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    abandon_drafts = getattr(sys.modules.get("fusion.files"), "abandon_drafts", None)
    if abandon_drafts is not None:
        abandon_drafts()
    if os.isatty(2):
        os.write(2, _CLEAR_LINE_AND_SHOW_CURSOR)
    os.write(2, _WORDS)
    os._exit(EXIT_CODE)


class Raised:
    """Lets an interrupt raise `KeyboardInterrupt` within its block, to end other processes first."""

    def __enter__(self) -> None:
        self._ends_at_once = signal.getsignal(signal.SIGINT) is _leave
        if self._ends_at_once:
            signal.signal(signal.SIGINT, signal.default_int_handler)

    def __exit__(self, *error: object) -> None:
        if self._ends_at_once:
            signal.signal(signal.SIGINT, _leave)


def was_interrupted(error: BaseException | None) -> bool:
    """Whether an error or one of its causes was an interrupt."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error is not None
