"""Bring samples that arrive late and out of order into order: roll back to before the late one, and replay.

After every sample the engine's state is kept for as long as the buffer lasts, so a late sample costs no more than
the samples behind it. The result is, bit for bit, that of the samples in order of time.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, Protocol

from fusion.estimator.frame_update import FrameResult
from fusion.estimator.propagation import Node
from fusion.estimator.state import State


class Kind(IntEnum):
    """Kinds of samples, in the order in which those of one instant are taken."""

    IMU = 0
    ATTITUDE = 1
    VELOCITY = 2
    RANGE = 3
    FRAME = 4


@dataclass(slots=True, eq=False)
class Entry:
    """A sample in the buffer, and what the engine made of it.

    Parameters
    ----------
    t_ns, kind
        Place in the order.
    payload
        Arguments for the engine.
    after
        The engine's state behind it.
    nodes
        Its steps for the smoother.
    frame
        What became of it, where it is a frame.
    """

    t_ns: int
    kind: Kind
    payload: Any
    after: State | None = None
    nodes: tuple[Node, ...] = ()
    frame: FrameResult | None = None


class Machine(Protocol):
    """What the timeline drives."""

    state: State

    def process(self, entry: Entry) -> None:
        """Take the entry's sample and fill in what came of it."""

    def restart_clock(self, t_ns: int) -> None:
        """Carry the state over to a clock that was set back."""


class Timeline:
    """Samples of the last ``buffer_ns``, in order, each with the state behind it.

    Parameters
    ----------
    machine
        The engine.
    buffer_ns
        How far behind the newest sample one may lie and still be taken.
    on_final
        Called with each entry that nothing can change any more, in order.
    """

    def __init__(
        self, machine: Machine, buffer_ns: int, on_final: Callable[[Entry], None] | None = None
    ) -> None:
        self.machine = machine
        self.buffer_ns = buffer_ns
        self.on_final = on_final
        self.entries: list[Entry] = []
        self._keys: list[tuple[int, int]] = []
        self._base = machine.state.copy()  # behind the last entry that has left the buffer
        self.replayed = 0

    @property
    def newest_ns(self) -> int | None:
        """Time of the newest sample; None before the first."""
        return self._keys[-1][0] if self._keys else None

    def is_late(self, t_ns: int) -> bool:
        """Whether a sample of this time would come after the buffer has passed it."""
        return bool(self._keys) and t_ns < self._keys[-1][0] - self.buffer_ns

    def insert(self, t_ns: int, kind: Kind, payload: Any) -> Entry | None:
        """Take a sample and bring the engine up to date; None where one of its time and kind is there already.

        The caller asks `is_late` first.
        """
        key = (t_ns, int(kind))
        keys, entries = self._keys, self.entries
        entry = Entry(t_ns, kind, payload)
        if not keys or key > keys[-1]:
            keys.append(key)
            entries.append(entry)
            self._run(entry)
            self._trim()
            return entry
        at = bisect_left(keys, key)
        if keys[at] == key:
            return None
        keys.insert(at, key)
        entries.insert(at, entry)
        before = entries[at - 1].after if at > 0 else self._base
        assert before is not None  # every entry in the buffer has been run
        self.machine.state = before.copy()
        for later in entries[at:]:
            self._run(later)
        self.replayed += len(entries) - at - 1
        return entry

    def restart(self, t_ns: int) -> None:
        """Go on at an earlier time: the samples' clock was set back."""
        self.finish()
        self.machine.state = self._base.copy()
        self.machine.restart_clock(t_ns)
        self._base = self.machine.state.copy()

    def finish(self) -> None:
        """Hand out what is still in the buffer; nothing may be inserted before it any more."""
        self._let_go(len(self.entries))

    def _run(self, entry: Entry) -> None:
        self.machine.process(entry)
        entry.after = self.machine.state.copy()

    def _trim(self) -> None:
        horizon = self._keys[-1][0] - self.buffer_ns
        # In lumps: cutting the front of a list costs its length.
        if self._keys[0][0] < horizon:
            passed = bisect_left(self._keys, (horizon, -1))
            if passed >= 16 or passed * 2 >= len(self._keys):
                self._let_go(passed)

    def _let_go(self, count: int) -> None:
        if count == 0:
            return
        gone = self.entries[:count]
        del self.entries[:count], self._keys[:count]
        last = gone[-1].after
        if last is not None:
            self._base = last
        if self.on_final is not None:
            for entry in gone:
                self.on_final(entry)
