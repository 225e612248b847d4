"""Clocks: the computer's own, and the offsets of an autopilot's and a camera's clock from it.

Times in flight are those of `HostClock`: nanoseconds since 1970 at the start, then monotonic. An
autopilot's times start at its boot, a stream's anywhere.
"""

from __future__ import annotations

import time
from collections import deque
from enum import StrEnum
from typing import NamedTuple

MAX_AGE_NS = 1_000_000_000  # of a sample when it is received
MAX_AHEAD_NS = 50_000_000  # of a sample's time after its receipt: tolerance for a wrong clock offset
STRANGE_SAMPLES = 10  # in a row outside these limits: the clock has changed
JUMP_NS = 100_000_000  # between two replies: the autopilot has rebooted
KEPT_REPLIES = 32
NEEDED_REPLIES = 4
REPLY_PATIENCE_NS = 3_000_000_000  # with samples but no reply: the autopilot does not support TIMESYNC
WINDOW_NS = 10_000_000_000


class HostClock:
    """The computer's clock: nanoseconds since 1970 at the start, and from then on monotonic."""

    def __init__(self) -> None:
        self.monotonic_offset_ns = time.time_ns() - time.monotonic_ns()

    def now_ns(self) -> int:
        """Return the time."""
        return time.monotonic_ns() + self.monotonic_offset_ns


class LeastLatency:
    """Offset of a clock known only from one-way stamps: the smallest recent difference of receipt and stamp.

    The result is late by the smallest latency, which `camera_delay_s` can correct.
    """

    def __init__(self) -> None:
        self._began_ns = 0  # of the present window
        self._least_ns: int | None = None  # in the present window
        self._earlier_ns: int | None = None  # in the previous window

    def offset_ns(self, stamp_ns: int, received_ns: int) -> int:
        """Add a stamp and its time of receipt; return the offset to add to stamps."""
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
    ONE_WAY = "one way"  # no replies; by the smallest latency


class _Reply(NamedTuple):
    round_trip_ns: int
    offset_ns: int


class AutopilotClock:
    """The autopilot's clock against the computer's, by MAVLink's TIMESYNC.

    Of the last replies, the one with the shortest round trip is used, as in NTP's clock filter. Without replies, the
    smallest latency of the samples is used instead.
    """

    def __init__(self) -> None:
        self.restarts = 0
        self._forget()

    def _forget(self) -> None:
        self._replies: deque[_Reply] = deque(maxlen=KEPT_REPLIES)
        self._one_way = LeastLatency()
        self._first_ns: int | None = None  # receipt of the first sample
        self._waited_ns = 0  # since then
        self._strange = 0

    @property
    def state(self) -> SyncState:
        """Source of the offset."""
        if len(self._replies) >= NEEDED_REPLIES:
            return SyncState.SYNCHRONISED
        return SyncState.ONE_WAY if self._waited_ns > REPLY_PATIENCE_NS else SyncState.WAITING

    @property
    def round_trip_ns(self) -> int | None:
        """Shortest round trip of the last replies."""
        return min(self._replies).round_trip_ns if self._replies else None

    def replied(self, asked_ns: int, autopilot_ns: int, received_ns: int) -> bool:
        """Process a reply to TIMESYNC; False if it is implausible.

        Parameters
        ----------
        asked_ns
            Time of the request, by the computer's clock.
        autopilot_ns
            Time of the reply, by the autopilot's clock.
        received_ns
            Time of receipt, by the computer's clock.
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
        """Start again, because the autopilot has rebooted."""
        self.restarts += 1
        self._forget()

    def host_ns(self, stamp_ns: int, received_ns: int) -> int | None:
        """Convert the time of a sample to the computer's clock; None if unknown or implausible.

        Parameters
        ----------
        stamp_ns
            Stamp of the autopilot.
        received_ns
            Time of receipt.
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
    """Converts a camera's stamps to the computer's clock.

    A driver stamps pictures by the computer's time since 1970 or its monotonic clock; a stream by its sender's clock,
    whose offset is known only from the smallest latency.

    Parameters
    ----------
    monotonic_offset_ns
        From the monotonic clock to the computer's, `HostClock.monotonic_offset_ns`.
    """

    def __init__(self, monotonic_offset_ns: int) -> None:
        self._offsets_ns = (0, monotonic_offset_ns)
        self._one_way = LeastLatency()

    def host_ns(self, stamp_ns: int | None, received_ns: int) -> int:
        """Time of a picture; the time of receipt if it has no stamp."""
        if stamp_ns is None:
            return received_ns
        for offset_ns in self._offsets_ns:
            if received_ns - MAX_AGE_NS <= stamp_ns + offset_ns <= received_ns:
                return stamp_ns + offset_ns
        return stamp_ns + self._one_way.offset_ns(stamp_ns, received_ns)
