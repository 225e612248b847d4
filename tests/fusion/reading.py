"""What tests of the readers share: streams taken with the problems that came with them."""

from __future__ import annotations

from typing import TypeVar

from fusion.logs.samples import WithProblems

T = TypeVar("T")


class Told(list[str]):
    """Problems of everything that was taken, in order."""

    def take(self, read: WithProblems[T]) -> T:
        """Return what was read, and keep its problems."""
        self += read.problems
        return read.value
