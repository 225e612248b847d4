"""What an interrupt (Ctrl-C) does: while modules load and at the end it ends the program at once, else it is raised.

A library that is interrupted while it loads may swallow that, or fail in ways of its own; nothing is half written
then. Imports as little as it can, since Ctrl-C before `leave_at_once` ends in Python's own traceback.
"""

from __future__ import annotations

import os
import signal

TYPE_CHECKING = False
if TYPE_CHECKING:
    from types import FrameType

EXIT_CODE = 130
_WORDS = b"corridor: interrupted\n"


def leave_at_once() -> None:
    """Let an interrupt end the program without more ado, unless interrupts are ignored."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _leave)


def _leave(number: int, frame: FrameType | None) -> None:
    os.write(2, _WORDS)
    os._exit(EXIT_CODE)


class Raised:
    """Lets an interrupt raise `KeyboardInterrupt` within its block, so that what is being written is cleared."""

    def __enter__(self) -> None:
        self._ends_at_once = signal.getsignal(signal.SIGINT) is _leave
        if self._ends_at_once:
            signal.signal(signal.SIGINT, signal.default_int_handler)

    def __exit__(self, *error: object) -> None:
        if self._ends_at_once:
            signal.signal(signal.SIGINT, _leave)


def was_interrupted(error: BaseException | None) -> bool:
    """Whether an error, or one that it came from, was an interrupt."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error is not None
