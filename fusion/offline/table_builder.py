"""Tables of a fused flight, built from the entries that leave the estimator's buffer."""

from __future__ import annotations

from array import array
from bisect import bisect_left, bisect_right
from typing import Any

import numpy as np

from fusion.estimator.config import FusionConfig
from fusion.estimator.events import Event, EventFinder
from fusion.estimator.filter_table import filter_table, run_table
from fusion.estimator.frame_update import FrameResult
from fusion.estimator.gyro_run import GyroRun
from fusion.estimator.gyro_run_kernel import PATH_S
from fusion.estimator.lateral.smoother import OffsetSteps
from fusion.estimator.notices import status_of
from fusion.estimator.sample_times import SampleTimes
from fusion.estimator.smoothed_table import smoothed_table
from fusion.estimator.smoother import Steps
from fusion.estimator.state import Entry, State
from fusion.estimator.tables import ESTIMATE_DTYPE, Table
from vision.measurement import FrameMeasurement, position_from_offset

MIN_TOGETHER = 8  # entries; fewer are taken one by one
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
        self._together: list[Entry] = []  # consecutive entries of one run
        self.last: State | None = None

    def take(self, entry: Entry) -> None:
        """Take the next entry in order of time."""
        together, run = self._together, entry.run
        if together and (run is not together[0].run or entry.place != together[-1].place + 1):
            self._take_together()
        if run is None:
            self._take(entry)
        else:
            self._together.append(entry)

    def _take_together(self) -> None:
        """Take entries of one run: their first and last instants one by one, those between as arrays."""
        entries, self._together = self._together, []
        run, status = entries[0].run, ""
        first = bisect_right(entries, entries[0].t_ns, key=lambda entry: entry.t_ns)
        last = bisect_left(entries, entries[-1].t_ns, key=lambda entry: entry.t_ns)
        if isinstance(run, GyroRun) and last - first >= MIN_TOGETHER:
            status = run_status(run, entries[0].place, entries[-1].place, self.config)
        if not status:
            first = last = len(entries)
        for entry in entries[:first]:
            self._take(entry)
        if isinstance(run, GyroRun) and first < last:
            self._take_alike(run, entries[first:last], status)
        for entry in entries[last:]:
            self._take(entry)

    def _take_alike(self, run: GyroRun, entries: list[Entry], status: str) -> None:
        """Take entries of whole instants that have no events."""
        self.events += self._finder.skip_to(entries[-1])
        if self._pending is not None:
            self._close_instant(self._pending)
        self._pack()
        place = entries[0].place
        places = slice(place, place + len(entries))
        t_ns = run.good.t_ns[places]
        is_row = np.array([self._makes_row(type(entry.sample), entry.t_ns) for entry in entries])
        ends = np.flatnonzero(np.append(np.diff(t_ns) > 0, True))
        ends = ends[np.logical_or.reduceat(is_row, np.append(0, ends[:-1] + 1))]
        self._row_steps.extend((self.steps.count - 1 + np.cumsum(run.makes_step[places])[ends]).tolist())
        self.steps.add_block(run.block(places))
        path_s = run.propagated[places, PATH_S]
        self.offset_steps.add_motion(t_ns.tolist(), path_s, lambda i: run.offset(place + i))
        if len(ends):
            self._append(run_table(run, ends + place, status, self.config))

    def _take(self, entry: Entry) -> None:
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
        if self._together:
            self._take_together()
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
        self._append(filter_table(self._rows, self._statuses, self.config))
        self._rows, self._statuses = [], []

    def _append(self, rows: Table) -> None:
        n = len(self._table)
        self._table.resize(n + len(rows), refcheck=False)  # in place: there is no other reference
        self._table[n:] = rows


def run_status(run: GyroRun, first: int, last: int, config: FusionConfig) -> str:
    """Return the status after all samples of a run from one to another; empty if it changes or is to be computed.

    While the heading is not too uncertain, the status depends on the age of the frames alone.
    """
    s, std_rad = run.start, float(run.heading_std_rad(np.arange(first, last + 1)).max())
    if not s.axis.ever_acquired or s.delay is not None or std_rad > 0.99 * config.lost_heading_std_rad:
        return ""
    before, after = (status_of(s, config, int(run.good.t_ns[place]), std_rad) for place in (first, last))
    return str(before) if before is after else ""


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
