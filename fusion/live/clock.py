"""Clocks: the computer's own, and how those of an autopilot and of a camera relate to it.

Times in flight are those of `HostClock`: nanoseconds since 1970 as the clock stood at the start, going on without
steps. An autopilot counts from its boot, a stream from wherever it likes.
"""

from __future__ import annotations

import time
from collections import deque
from enum import StrEnum
from typing import NamedTuple

MAX_AGE_NS = 1_000_000_000  # of a sample when it is received
MAX_AHEAD_NS = 50_000_000  # of a sample's time after its receipt, for what a clock's offset may be wrong
STRANGE_SAMPLES = 10  # in a row, outside these: the clock is another one
JUMP_NS = 100_000_000  # between two replies: the autopilot has booted again
KEPT_REPLIES = 32
NEEDED_REPLIES = 4
REPLY_PATIENCE_NS = 3_000_000_000  # with samples but no reply: it does not answer
WINDOW_NS = 10_000_000_000


class HostClock:
    """The computer's clock: nanoseconds since 1970 at the start, and from then on monotonic."""

    def __init__(self) -> None:
        self.monotonic_offset_ns = time.time_ns() - time.monotonic_ns()

    def now_ns(self) -> int:
        """Return the time."""
        return time.monotonic_ns() + self.monotonic_offset_ns


class LeastLatency:
    """Offset of a clock whose stamps only come one way: the least difference between receipt and stamp of late.

    What it gives is late by the least latency, which `camera_delay_s` can tell.
    """

    def __init__(self) -> None:
        self._began_ns = 0  # the present window
        self._least_ns: int | None = None  # in it
        self._earlier_ns: int | None = None  # in the one before

    def offset_ns(self, stamp_ns: int, received_ns: int) -> int:
        """Take a stamp and its receipt; return what to add to stamps."""
        difference_ns = received_ns - stamp_ns
        if self._least_ns is not None and abs(difference_ns - self._least_ns) > MAX_AGE_NS:
            self._least_ns = self._earlier_ns = None  # the clock was set
        if self._least_ns is None or received_ns - self._began_ns > WINDOW_NS:
            self._began_ns, self._earlier_ns = received_ns, self._least_ns
            self._least_ns = difference_ns
        self._least_ns = min(self._least_ns, difference_ns)
        return self._least_ns if self._earlier_ns is None else min(self._least_ns, self._earlier_ns)


class SyncState(StrEnum):
    """How well the autopilot's clock is known."""

    WAITING = "waiting"  # for replies to TIMESYNC
    SYNCHRONISED = "synchronised"
    ONE_WAY = "one way"  # it does not reply; by least latency


class _Reply(NamedTuple):
    round_trip_ns: int
    offset_ns: int


class AutopilotClock:
    """The autopilot's clock against the computer's, by MAVLink's TIMESYNC.

    Of the last replies the one with the shortest round trip counts, as in NTP's clock filter. Where none comes, the
    least latency of the samples stands in.
    """

    def __init__(self) -> None:
        self.restarts = 0
        self._forget()

    def _forget(self) -> None:
        self._replies: deque[_Reply] = deque(maxlen=KEPT_REPLIES)
        self._one_way = LeastLatency()
        self._first_ns: int | None = None  # receipt of the first sample
        self._waited_ns = 0  # from then on
        self._strange = 0

    @property
    def state(self) -> SyncState:
        """How its offset is known."""
        if len(self._replies) >= NEEDED_REPLIES:
            return SyncState.SYNCHRONISED
        return SyncState.ONE_WAY if self._waited_ns > REPLY_PATIENCE_NS else SyncState.WAITING

    @property
    def round_trip_ns(self) -> int | None:
        """Shortest round trip of the last replies."""
        return min(self._replies).round_trip_ns if self._replies else None

    def replied(self, asked_ns: int, autopilot_ns: int, received_ns: int) -> bool:
        """Take a reply to TIMESYNC; False if it cannot be one.

        Parameters
        ----------
        asked_ns
            When it was asked, by the computer's clock.
        autopilot_ns
            When the autopilot answered, by its own.
        received_ns
            When the answer came.
        """
        round_trip_ns = received_ns - asked_ns
        if not 0 <= round_trip_ns <= MAX_AGE_NS or not 0 < autopilot_ns < 2**62:
            return False
        reply = _Reply(round_trip_ns, asked_ns + round_trip_ns // 2 - autopilot_ns)
        if self._replies and abs(reply.offset_ns - self._replies[-1].offset_ns) > JUMP_NS + round_trip_ns:
            self.restart()
        self._replies.append(reply)
        return True

    def restart(self) -> None:
        """Start again, as the autopilot has."""
        self.restarts += 1
        self._forget()

    def host_ns(self, stamp_ns: int, received_ns: int) -> int | None:
        """Turn the time of a sample into the computer's; None if that is not known, or cannot be.

        Parameters
        ----------
        stamp_ns
            As the autopilot stamped it.
        received_ns
            When it was received.
        """
        if self._first_ns is None:
            self._first_ns = received_ns
        self._waited_ns = received_ns - self._first_ns
        one_way_ns = self._one_way.offset_ns(stamp_ns, received_ns)
        state = self.state
        if state is SyncState.WAITING:
            return None
        offset_ns = min(self._replies).offset_ns if state is SyncState.SYNCHRONISED else one_way_ns
        t_ns = stamp_ns + offset_ns
        if received_ns - MAX_AGE_NS <= t_ns <= received_ns + MAX_AHEAD_NS:
            self._strange = 0
            return t_ns
        self._strange += 1
        if self._strange >= STRANGE_SAMPLES:
            self.restart()
        return None


class CameraClock:
    """Turns a camera's stamps into the computer's time.

    A driver stamps pictures by the computer's clock since 1970 or by its monotonic one; a stream by its sender's, to
    which only the least latency relates it.

    Parameters
    ----------
    monotonic_offset_ns
        From the monotonic clock to the computer's, `HostClock.monotonic_offset_ns`.
    """

    def __init__(self, monotonic_offset_ns: int) -> None:
        self._offsets_ns = (0, monotonic_offset_ns)
        self._one_way = LeastLatency()

    def host_ns(self, stamp_ns: int | None, received_ns: int) -> int:
        """Time of a picture; that of its receipt where it carries none."""
        if stamp_ns is None:
            return received_ns
        for offset_ns in self._offsets_ns:
            if received_ns - MAX_AGE_NS <= stamp_ns + offset_ns <= received_ns:
                return stamp_ns + offset_ns
        return stamp_ns + self._one_way.offset_ns(stamp_ns, received_ns)
