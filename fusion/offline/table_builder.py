"""Tables of a fused flight, built from the entries that leave the estimator's buffer."""

from __future__ import annotations

from array import array
from typing import Any

import numpy as np

from fusion.estimator.config import FusionConfig
from fusion.estimator.events import Event, EventFinder
from fusion.estimator.filter_table import filter_table
from fusion.estimator.frame_update import FrameResult
from fusion.estimator.lateral.smoother import OffsetSteps
from fusion.estimator.sample_times import SampleTimes
from fusion.estimator.smoothed_table import smoothed_table
from fusion.estimator.smoother import Steps
from fusion.estimator.state import Entry, State
from fusion.estimator.tables import ESTIMATE_DTYPE, Table
from vision.measurement import FrameMeasurement, position_from_offset

BLOCK_ROWS = 512  # few, so that waiting entries stay in the processor's cache


class TableBuilder:
    """Collects, from the entries that leave the buffer, the rows of the tables and the smoother's steps.

    Each sample of the first kind makes a row; a sample of another kind only while those before it are silent.
    """

    def __init__(self, config: FusionConfig, row_kinds: tuple[type[object], ...]) -> None:
        self.config = config
        self._row_times = dict.fromkeys(row_kinds, SampleTimes())
        self.frames: list[tuple[Any, ...]] = []
        self.steps = Steps()
        self.offset_steps = OffsetSteps()
        self.events: list[Event] = []
        self._finder = EventFinder(config)
        self._rows: list[State] = []
        self._statuses: list[str] = []
        self._table = np.empty(0, ESTIMATE_DTYPE)  # finished rows
        self._smoothed: Table | None = None
        self._row_steps = array("q")  # index of the last step of each row's instant
        self._pending: Entry | None = None
        self._pending_is_row = False
        self.last: State | None = None

    def take(self, entry: Entry) -> None:
        """Take the next entry in order of time."""
        self.events += self._finder.take(entry)
        pending = self._pending
        if pending is not None and entry.t_ns > pending.t_ns:
            self._close_instant(pending)
        self.steps.add(entry.nodes)
        self.last = entry.after
        lateral = self.last.lateral
        self.offset_steps.add(entry.t_ns, lateral.step, lateral.offset)
        if entry.frame is not None:
            self.frames.append(frame_row(entry.frame, self.config))
        self._pending = entry
        self._pending_is_row |= self._makes_row(type(entry.sample), entry.t_ns)

    def _makes_row(self, kind: type[object], t_ns: int) -> bool:
        times = self._row_times
        if kind not in times:
            return False
        times[kind] = times[kind].with_sample(t_ns)
        for better in times:
            if better is kind:
                break
            if not times[better].is_silent(t_ns, self.config):
                return False
        return True

    def finish(self) -> None:
        """Close the last instant."""
        self.events += self._finder.finish()
        if self._pending is not None:
            self._close_instant(self._pending)

    def _close_instant(self, last: Entry) -> None:
        # A row is the state after all samples of its time, in any order of arrival.
        if self._pending_is_row:
            rows = self._rows
            rows.append(last.after)
            self._statuses.append(self._finder.status)
            self._row_steps.append(self.steps.count - 1)
            if len(rows) >= BLOCK_ROWS:
                self._pack()
        self._pending, self._pending_is_row = None, False

    def estimates(self) -> Table:
        """Return the filter's table."""
        self._pack()
        return self._table

    def smoothed(self) -> Table:
        """Return the smoother's table: the same rows, with every number from the whole flight."""
        if self._smoothed is None:
            row_steps = np.array(self._row_steps, dtype=np.int64)
            self._smoothed = smoothed_table(
                self.estimates(), row_steps, self.steps, self.offset_steps, self.config
            )
        return self._smoothed

    def _pack(self) -> None:
        if not self._rows:
            return
        n = len(self._table)
        self._table.resize(n + len(self._rows), refcheck=False)  # in place: there is no other reference
        self._table[n:] = filter_table(self._rows, self._statuses, self.config)
        self._rows, self._statuses = [], []


def frame_row(result: FrameResult, config: FusionConfig) -> tuple[Any, ...]:
    """Return a frame's result in the order of `fusion.estimator.tables.FRAME_DTYPE`."""
    m = result.measurement or FrameMeasurement(False, result.reason)
    position = position_from_offset(m.lateral_offset_norm, config.position_dead_band_norm) or m.position
    return (
        result.timestamp_ns,
        result.accepted,
        str(result.reason),
        m.n_lines,
        m.n_inliers,
        *m.vp_px,
        m.heading_rad,
        m.heading_std_rad,
        m.lateral_offset_norm,
        m.lateral_offset_norm_std,
        "" if position is None else str(position),
        m.paper_yaw_rad,
        result.innovation_rad,
        result.test_ratio,
        m.vision_ms,
    )
