"""Events of a flight, with times and values: rejected frames, jumps, changes of corridor and status.

Events are found from entries that have left the buffer and are final. They are therefore identical to those of the
sorted log, and delayed by ``config.buffer_s``. A program that needs them without delay reads the `Estimate`.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum

from fusion.estimator.config import FusionConfig
from fusion.estimator.estimate import heading_of
from fusion.estimator.lateral.updates import offset_model
from fusion.estimator.notices import notices_of, status_of
from fusion.estimator.resets import Resets, only_propagated
from fusion.estimator.state import Entry, State

LOGGER = logging.getLogger("fusion.estimator")
logging.getLogger("fusion").addHandler(logging.NullHandler())  # silent unless the program configures logging


class EventKind(StrEnum):
    """Kind of an event."""

    FRAME_REJECTED = "frame_rejected"
    HEADING_RESET = "heading_reset"
    LATERAL_RESET = "lateral_reset"
    CORRIDOR_CHANGED = "corridor_changed"
    STATUS_CHANGED = "status_changed"


@dataclass(frozen=True, slots=True)
class Event:
    """An event at an instant.

    Parameters
    ----------
    timestamp_ns
        Time of the event; for a frame, its time stamp.
    kind
        Kind of the event.
    values
        Its values by name; units are in the names.
    """

    timestamp_ns: int
    kind: EventKind
    values: Mapping[str, float | str] = field(default_factory=dict)

    def __str__(self) -> str:
        pairs = (
            f"{name}={value:.6g}" if isinstance(value, float) else f"{name}={value}"
            for name, value in self.values.items()
        )
        return " ".join((f"t_ns={self.timestamp_ns}", str(self.kind), *pairs))


class EventFinder:
    """Finds the events of a flight in its entries, given in order of time."""

    def __init__(self, config: FusionConfig) -> None:
        self._config = config
        self._before: State | None = None  # after the last completed instant
        self.status = ""  # at the last completed instant
        self._resets = Resets()
        self._open: Entry | None = None

    def take(self, entry: Entry) -> list[Event]:
        """Add the next entry; return the events that it completes."""
        last = self._open
        found = [] if last is None or entry.t_ns == last.t_ns else self._close(last)
        self._open = entry
        frame = entry.frame
        if frame is not None and not frame.accepted:
            values: dict[str, float | str] = {"reason": str(frame.reason)}
            if frame.test_ratio == frame.test_ratio:
                values |= {"innovation_rad": frame.innovation_rad, "test_ratio": frame.test_ratio}
            found.append(Event(frame.timestamp_ns, EventKind.FRAME_REJECTED, values))
        return found

    def skip_to(self, entry: Entry) -> list[Event]:
        """Pass over entries up to one that completes its instant, all without events; return those of the last."""
        found = self.finish()
        self._before = entry.after
        return found

    def finish(self) -> list[Event]:
        """Return the events of the last instant."""
        last, self._open = self._open, None
        return [] if last is None else self._close(last)

    def _close(self, entry: Entry) -> list[Event]:
        """Compare the state after all samples of an instant with that of the one before."""
        old, new, t_ns = self._before, entry.after, entry.t_ns
        self._before = new
        found: list[Event] = []
        if old is not None and not only_propagated(old, new, entry.sample):
            if new.axis.corridor_index != old.axis.corridor_index:
                index, turn_rad = new.axis.corridor_index, new.axis.corridor_turn_rad
                values: dict[str, float | str] = {"corridor_index": index, "corridor_turn_rad": turn_rad}
                found.append(Event(t_ns, EventKind.CORRIDOR_CHANGED, values))
            found += self._resets_since(old, new, t_ns)
        _, heading_std = heading_of(new)
        status = status_of(new, self._config, t_ns, heading_std)
        if status != self.status:
            notices = notices_of(new, self._config, t_ns, heading_std)
            reason = "; ".join(notice.text for notice in notices)
            values = {"before": self.status, "status": str(status), "reason": reason}
            found.append(Event(t_ns, EventKind.STATUS_CHANGED, values))
            self.status = str(status)
        return found

    def _resets_since(self, old: State, new: State, t_ns: int) -> Iterator[Event]:
        model = new.lateral.model or offset_model(self._config)
        before = self._resets
        self._resets = after = before.after(old, new, model, new.width.half_m(self._config))
        if after.heading_count != before.heading_count:
            yield Event(t_ns, EventKind.HEADING_RESET, {"step_rad": after.heading_rad})
        if after.lateral_count != before.lateral_count:
            steps = {"step_norm": after.lateral_norm, "step_m": after.lateral_m}
            yield Event(t_ns, EventKind.LATERAL_RESET, steps)


class EventLog:
    """Logs events to the logger ``fusion.estimator`` at level INFO; has no cost while the level is disabled.

    Each record has its `Event` as ``record.event``.
    """

    def __init__(self, config: FusionConfig) -> None:
        self._config = config
        self._finder: EventFinder | None = None

    def take(self, entries: Sequence[Entry]) -> None:
        """Add the next entries in order of time."""
        if not LOGGER.isEnabledFor(logging.INFO):
            self._finder = None
            return
        if self._finder is None:
            self._finder = EventFinder(self._config)
        for entry in entries:
            self._log(self._finder.take(entry))

    def finish(self) -> None:
        """Log the events of the last instant."""
        if self._finder is not None:
            self._log(self._finder.finish())

    def _log(self, events: list[Event]) -> None:
        for event in events:
            LOGGER.info("%s", event, extra={"event": event})
