"""A clock that stands still while pixel loops are compiled, which happens once on a machine."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from numba.core import event


class Stopwatch(event.Listener):
    """Seconds of wall clock since some moment, and those that numba compiled for.

    Code that is taken from numba's cache on disk is not compiled.

    Attributes
    ----------
    compile_s
        Seconds spent on compilation so far.
    """

    def __init__(self) -> None:
        self.compile_s = 0.0
        self._started: list[float] = []  # of compilations under way: what one calls is compiled within it

    def on_start(self, event: Any) -> None:
        """Note when a compilation starts."""
        self._started.append(time.perf_counter())

    def on_end(self, event: Any) -> None:
        """Count a compilation that no other contains."""
        started = self._started.pop()
        if not self._started:
            self.compile_s += time.perf_counter() - started

    def seconds(self) -> float:
        """Return the time, without that of compilation."""
        return time.perf_counter() - self.compile_s


@contextmanager
def stopwatch() -> Iterator[Stopwatch]:
    """Give a clock that hears of every compilation within the block."""
    clock = Stopwatch()
    with event.install_listener("numba:compile", clock):
        yield clock
