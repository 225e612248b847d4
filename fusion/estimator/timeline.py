"""Buffer of recent samples: accepts samples in any order and passes them to the engine in order of time.

The state after every sample is kept while the sample is in the buffer. A late sample is handled by rolling back to
the state before it and replaying the samples after it, so its cost is proportional to its delay. The result is
bit-identical to that of the samples in order.

A frame is measured again in each replay, by a function that may raise. The error of a new sample goes to the caller,
and the buffer is unchanged; a sample that raises in a replay is dropped and counted.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections import Counter
from collections.abc import Callable, Sequence

from fusion.estimator.engine import Engine
from fusion.estimator.state import SOURCES, Entry, Sample, State, sensed_after


class Timeline:
    """Samples of the last ``buffer_ns`` in order of time, each with the state after it.

    Parameters
    ----------
    engine
        Processes samples in order.
    buffer_ns
        Largest lag of an accepted sample behind the newest one.
    counters
        Counters of samples that raise in a replay, by source.
    on_final
        Called in order of time with the entries that have left the buffer and are final.
    """

    def __init__(
        self,
        engine: Engine,
        buffer_ns: int,
        counters: Counter[str],
        on_final: Callable[[Sequence[Entry]], None] | None = None,
    ) -> None:
        self.engine = engine
        self.buffer_ns = buffer_ns
        self.counters = counters
        self.on_final = on_final
        self.state = engine.initial_state()
        self.entries: list[Entry] = []
        self._keys: list[tuple[int, int]] = []
        self._base = self.state  # after the last entry that has left the buffer
        self._before_jump: State | None = None

    @property
    def newest_ns(self) -> int | None:
        """Time of the newest sample; None without any."""
        return self._keys[-1][0] if self._keys else None

    def at(self, t_ns: int) -> State | None:
        """Return the state after the last sample up to a time; None if the buffer does not reach back so far."""
        place = bisect_right(self.entries, t_ns, key=lambda entry: entry.t_ns)
        return self.entries[place - 1].after if place > 0 else None

    def holds(self, sample: Sample) -> bool:
        """Whether a sample of this time and kind is in the buffer."""
        key = (sample.t_ns, SOURCES[type(sample)].order)
        at = bisect_left(self._keys, key)
        return at < len(self._keys) and self._keys[at] == key

    def insert(self, sample: Sample) -> Entry | None:
        """Insert a sample and process it; return None if one of the same time and kind is in the buffer already.

        The sample must not be older than the buffer.
        """
        key = (sample.t_ns, SOURCES[type(sample)].order)
        keys, entries = self._keys, self.entries
        newest = not keys or key > keys[-1]
        at = len(keys) if newest else bisect_left(keys, key)
        if not newest and keys[at] == key:
            return None
        before = self.state if newest else entries[at - 1].after if at > 0 else self._base
        try:
            entry = self.engine.process(before, sample)
        except Exception:
            self.engine.ekf.load(self.state.x, self.state.P)
            raise
        if newest:
            keys.append(key)
            entries.append(entry)
            self.state = entry.after
            self._trim()
        else:
            self._replay(at, key, entry, before)
        return entry

    def append_run(self, samples: Sequence[Sample]) -> int:
        """Append the leading samples that are processed together; return how many: none if the first is not newest.

        The samples are in order of time.
        """
        if not samples or self.newest_ns is None:
            return 0
        keys = [(sample.t_ns, SOURCES[type(sample)].order) for sample in samples]
        run = None if keys[0] <= self._keys[-1] else self.engine.process_run(self.state, samples)
        if run is None:
            return 0
        self._keys += keys[: run.count]
        self.entries += [Entry.of_run(sample, run, k) for k, sample in enumerate(samples[: run.count])]
        self.state = self.entries[-1].after
        self._trim()
        return run.count

    def _replay(self, at: int, key: tuple[int, int], entry: Entry, before: State) -> None:
        """Insert an entry at a place, with the state before it, and replay the samples after it."""
        keys, entries = self._keys[at:], self.entries[at:]
        new_keys, replayed = [key], [entry]
        sensed = self.entries[at - 1].sensed if at > 0 else sensed_after(before)
        place = 0
        while place < len(entries):
            count = self.engine.replay_gyro_samples(replayed[-1].after, entries[place:], sensed)
            if count > 0:
                replayed += entries[place : place + count]
                new_keys += keys[place : place + count]
                place += count
                sensed = entries[place - 1].sensed
                continue
            later = entries[place]
            try:
                earlier = (sensed, later.sensed)
                replayed.append(self.engine.process(replayed[-1].after, later.sample, earlier))
                new_keys.append(keys[place])
            except Exception:
                self.counters[f"{SOURCES[type(later.sample)].name}_failed"] += 1
                self.engine.ekf.load(replayed[-1].after.x, replayed[-1].after.P)
            sensed = later.sensed
            place += 1
        self._keys[at:], self.entries[at:] = new_keys, replayed
        self.state = replayed[-1].after

    def note_jump(self) -> None:
        """Store the state before a jump of the clock, to return to it if the jump turns out to be wrong."""
        self._before_jump = self.state

    def restart(self, t_ns: int) -> None:
        """Continue at an earlier time: later stamps were wrong, or the samples' clock was set back."""
        before, self._before_jump = self._before_jump, None
        if before is not None and before.t_ns is not None and before.t_ns <= t_ns:
            right = bisect_right(self.entries, before.t_ns, key=lambda entry: entry.t_ns)
            del self.entries[right:], self._keys[right:]
            self.finish()
            self.state = self._base = before
            return
        self.finish()
        self.state = self._base = self.engine.clock_set_back(self._base, t_ns)

    def restart_from(self, state: State) -> None:
        """Continue from a given state, after passing out the entries in the buffer."""
        self.finish()
        self._before_jump = None
        self.state = self._base = state
        self.engine.ekf.load(state.x, state.P)

    def finish(self) -> None:
        """Pass out all entries in the buffer; samples can no longer be inserted before them."""
        self._release_entries(len(self.entries))

    def _trim(self) -> None:
        keys = self._keys
        horizon = keys[-1][0] - self.buffer_ns
        # In batches of 16, or half of the buffer: deleting from the front of a list costs its length.
        if keys[min(15, (len(keys) - 1) // 2)][0] < horizon:
            self._release_entries(bisect_left(keys, (horizon, -1)))

    def _release_entries(self, count: int) -> None:
        if count == 0:
            return
        gone = self.entries[:count]
        del self.entries[:count], self._keys[:count]
        self._base = gone[-1].after
        if self.on_final is not None:
            self.on_final(gone)
