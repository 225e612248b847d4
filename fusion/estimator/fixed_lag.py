"""Fixed-lag smoother in flight: smooths the estimate ``lag`` ago with all samples since.

The smoothers of `fusion.estimator.smoother` and `fusion.estimator.lateral.smoother` run over the window of the lag,
so the result equals that of the offline smoother for a flight that ends now.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import chain

import numpy as np

from fusion.estimator.config import FusionConfig
from fusion.estimator.estimate import Estimate, estimate_of
from fusion.estimator.lateral.smoother import OffsetSteps, ends_step
from fusion.estimator.smoothed_table import smoothed_table
from fusion.estimator.smoother import Node, Steps, compile_smoother
from fusion.estimator.state import SOURCES, Entry, State
from fusion.estimator.tables import ESTIMATE_DTYPE, estimate_row


class FixedLag:
    """Samples that have left the timeline's buffer but not yet the lag.

    Parameters
    ----------
    lag_ns
        Lag of the smoothed estimate.
    config
        Settings.
    """

    def __init__(self, lag_ns: int, config: FusionConfig) -> None:
        self.lag_ns = lag_ns
        self.config = config
        compile_smoother()
        self._passed: deque[Entry] = deque()
        self._dropped: Entry | None = None  # last one dropped with a step of the lateral offset

    def keep(self, entry: Entry) -> None:
        """Add an entry that has left the buffer, in order of time."""
        passed = self._passed
        passed.append(entry)
        while passed[0].t_ns < entry.t_ns - self.lag_ns and passed[1].t_ns <= entry.t_ns - self.lag_ns:
            gone = passed.popleft()
            lateral, last = gone.after.lateral, self._dropped
            if lateral.step is not None or (
                last is not None and ends_step(lateral.offset.path, last.after.lateral.offset.path)
            ):
                self._dropped = gone

    def clear(self) -> None:
        """Forget everything: the samples' clock was set back."""
        self._passed.clear()
        self._dropped = None

    def smoothed(self, buffer: Sequence[Entry]) -> Estimate:
        """Smooth over the lag's window: the entries that have left the buffer, and those in it."""
        entries = [*self._passed, *buffer]
        if not entries:
            return Estimate(0, reason="no sample yet")
        wanted_ns = entries[-1].t_ns - self.lag_ns
        first = max(bisect_right(entries, wanted_ns, key=lambda e: e.t_ns) - 1, 0)
        window = entries[first:]
        target, newest = window[0].after, window[-1].after
        whole = _axis(target) != _axis(newest)
        instants = list(_instants(window)) if whole else [0, len(window) - 1]
        rows = [estimate_of(window[i].after, self.config) for i in instants]
        table = np.array([estimate_row(row) for row in rows], dtype=ESTIMATE_DTYPE)
        steps = Steps()
        steps.add([Node(None, target.x, target.P, target.x, target.P)])
        steps.add(chain.from_iterable(entry.nodes for entry in window[1:]))
        ends = np.cumsum([0, *(len(entry.nodes) for entry in window[1:])])
        offset_steps = OffsetSteps()
        # The offset is interpolated between its steps: the last one before the window is needed too.
        if self._dropped is not None:
            offset_steps.begin(self._dropped.t_ns, self._dropped.after.lateral.offset)
        for entry in entries:
            lateral = entry.after.lateral
            offset_steps.add(entry.t_ns, lateral.step, lateral.offset)
        row = smoothed_table(table, ends[instants], steps, offset_steps, self.config)[0]
        found = replace(rows[0], **dict(zip(ESTIMATE_DTYPE.names or (), row.item(), strict=True)))
        if target.width.set_width_m is None:
            return found
        half_m = target.width.half_m(self.config)
        norm, std = found.lateral_offset_norm, found.lateral_offset_norm_std
        return replace(found, lateral_offset_m=norm * half_m, lateral_offset_std_m=std * half_m)


def _axis(state: State) -> tuple[int, int]:
    return state.axis.corridor_index, state.axis.reset_count


def _instants(window: Sequence[Entry]) -> Iterator[int]:
    """Yield the indices of the offline table's rows: the first, then the last entry of each row's time."""
    sources = [SOURCES[type(entry.sample)] for entry in window]
    rows_of = min((source for source in sources if source.propagates), default=None)
    yield 0
    is_row = False
    for i, entry in enumerate(window[1:], 1):
        is_row |= sources[i] is rows_of
        last = i == len(window) - 1 or window[i + 1].t_ns > entry.t_ns
        if last:
            if is_row:
                yield i
            is_row = False
