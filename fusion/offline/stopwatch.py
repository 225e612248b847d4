"""A clock that stops while pixel loops are compiled, which happens once per machine."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from numba.core import event


class Stopwatch(event.Listener):
    """Seconds of wall clock, without those spent on compilation by numba.

    Code loaded from numba's cache on disk is not compiled.

    Attributes
    ----------
    compile_s
        Seconds spent on compilation so far.
    """

    def __init__(self) -> None:
        self.compile_s = 0.0
        self._started: list[float] = []  # of running compilations, which may be nested

    def on_start(self, event: Any) -> None:
        """Record the start of a compilation."""
        self._started.append(time.perf_counter())

    def on_end(self, event: Any) -> None:
        """Add the time of a compilation that is not nested."""
        started = self._started.pop()
        if not self._started:
            self.compile_s += time.perf_counter() - started

    def seconds(self) -> float:
        """Return the time without compilation."""
        return time.perf_counter() - self.compile_s


@contextmanager
def stopwatch() -> Iterator[Stopwatch]:
    """Provide a clock that is notified of every compilation within the block."""
    clock = Stopwatch()
    with event.install_listener("numba:compile", clock):
        yield clock
