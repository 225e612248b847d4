"""Checks time stamps in order of arrival: decides which samples to accept, and reports wrong clocks.

The IMU's stamps are the reference clock; without IMU samples those of the attitude are, then those of the frames. No
sample can be measured in the future, so:

- a sample of another source ahead of the reference clock is held back, since that clock may have jumped or paused;
- a sample of the reference source far ahead of its last one is held back until the next one confirms it;
- a sample that is never confirmed is dropped and counted (``frame_ahead``).

The usual delay of a source behind the newest stamp of all is its latency, a low-pass filtered mean; it is added to
the time after which the source counts as silent. For the reference clock, only samples that follow one of another
source count: the first of each burst. A lasting step of the frames' delay behind the reference clock means that the
camera's clock or the transport delay has changed; the next turn decides between the two (`FrameStamps`).
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterable, Iterator
from enum import Enum
from math import nan
from statistics import median

from fusion.estimator.faults import Fault, Notice
from fusion.estimator.state import SOURCES, Sample
from vision.rotations import wrap_axis

CLOCKS = ("imu", "attitude", "frame")
MAX_WAITING = 32
USUAL_MEMORY = 1 / 32  # gain per frame of the usual latency
LATENCY_MEMORY = 1 / 8  # gain per sample of the latency
RECENT_FRAMES = 6
MIN_STEP_S = 0.04
STEP_SPREADS = 3.0  # a step is larger than this many times the spread of the recent latencies
MIN_INTERVAL_NS = 25_000  # mean interval; IMUs sample at up to 32 kHz
MIN_COUNTED = 50  # samples of the clock before their interval is judged
OFF_SAMPLES = 2  # samples in a row with a wrong stamp before the source is reported
MAX_TERM = 2.0  # bound of one comparison's log likelihood ratio
MIN_STD_RAD = 1e-6  # lower bound of a heading's sigma, whose square would otherwise underflow
COMPARED_NS = 400_000_000  # between compared frames; the turn rate must change in that time
DEPENDENT_FRAMES = 4.0  # correlated comparisons per independent one
REPORTED_NS = 1_000_000_000  # for which a step of the clock is reported: the filter needs time to recover
DECIDED = 7.0  # log odds of about 1000:1

_FAULTS = {"imu": Fault.IMU_CLOCK, "attitude": Fault.ATTITUDE_CLOCK, "frame": Fault.CAMERA_CLOCK}
_WORDS = {
    "imu": ("IMU", "IMU samples"),
    "attitude": ("attitude", "attitudes"),
    "frame": ("camera", "frames"),
    "velocity": ("velocity", "velocities"),
    "range": ("range sensor", "ranges"),
    "heading_seed": ("seed", "seeds"),
    "width_change": ("width", "widths"),
}


class Admission(Enum):
    """Decision about a sample."""

    TAKE = "take"  # insert it
    WAIT = "wait"  # it is held back
    LATE = "late"  # ignore it: it is older than the buffer
    JUMPED = "jumped"  # the clock jumped ahead: insert the samples of `Arrivals.released`
    SET_BACK = "set back"  # the clock was set back: restart, then insert the samples of `Arrivals.released`


TAKE = Admission.TAKE  # member lookup of an enum is slow in Python 3.11, and needed for each sample


class _Source:
    """Arrivals of one source: stamps, interval, latency, and samples with a wrong stamp."""

    __slots__ = (
        "interval_ns",
        "kind",
        "last_ns",
        "latency_s",
        "name",
        "off",
        "off_s",
        "progress_ns",
        "rank",
        "suspect",
        "tick",
    )

    def __init__(self, kind: type[Sample]) -> None:
        self.kind, self.name = kind, SOURCES[kind].name
        self.rank = CLOCKS.index(self.name) if self.name in CLOCKS else len(CLOCKS)
        self.last_ns = 0  # newest stamp; valid only if interval_ns is not NaN
        self.interval_ns = nan  # mean; NaN before the first sample, 0 before the second
        self.latency_s = 0.0
        self.suspect: Sample | None = None  # far ahead, not yet confirmed
        # Number of samples in a row that were ahead (negative: late), and by how much the last one was.
        self.off, self.off_s = 0, 0.0
        # Count of the reference clock's samples at the last arrival, and progress of the stamps since then.
        self.tick, self.progress_ns = 0, 0.0

    @property
    def has_samples(self) -> bool:
        """Whether a sample has been accepted."""
        return self.interval_ns == self.interval_ns


class Arrivals:
    """Decides about samples in order of arrival.

    Parameters
    ----------
    buffer_ns
        Largest lag behind the newest sample, and largest lead ahead of the clock, of an accepted sample.
    counters
        Counters of dropped samples.
    """

    def __init__(self, buffer_ns: int, counters: Counter[str]) -> None:
        self.buffer_ns = buffer_ns
        self.counters = counters
        self.restart()

    def restart(self) -> None:
        """Forget all stamps, after a reset of the clock."""
        self._sources = {kind: _Source(kind) for kind in SOURCES}
        self._clock: _Source | None = None
        self._tick = 0
        self._others_came = True  # since the clock's last sample
        self._first = (0, 0)  # stamp and tick of the clock's first sample
        self._waiting: list[Sample] = []
        self._refused: dict[type[Sample], tuple[str, int]] = {}  # impossible values: fault, number in a row
        self._released: list[Sample] = []
        self.frames = FrameStamps()

    def admit(self, sample: Sample, newest_ns: int | None) -> Admission:
        """Decide about the next sample.

        Parameters
        ----------
        sample
            The sample.
        newest_ns
            Time of the newest accepted sample; None before any.
        """
        if self._refused:
            self._refused.pop(type(sample), None)
        source, t_ns, clock = self._sources[type(sample)], sample.t_ns, self._clock
        if newest_ns is None or clock is None:
            self._follow(source, t_ns)
            return self._take(source, t_ns, t_ns if newest_ns is None else newest_ns)
        if source is clock and newest_ns - self.buffer_ns <= t_ns <= clock.last_ns + self.buffer_ns:
            return self._take(source, t_ns, newest_ns)  # the usual case
        orders = source is clock or source.rank < clock.rank or self._replaces_dead_clock(source, t_ns, clock)
        if t_ns < newest_ns - self.buffer_ns:
            return self._late(source, sample, newest_ns, orders)
        if not orders:
            if t_ns > clock.last_ns + self._reach_ns(clock):
                return self._wait(source, sample, (t_ns - clock.last_ns) * 1e-9)
            return self._take(source, t_ns, newest_ns)
        latest_ns = clock.last_ns if source is clock else newest_ns
        if t_ns > latest_ns + self._reach_ns(source):
            return self._ahead_of_its_own(source, sample)
        self._follow(source, t_ns)
        return self._take(source, t_ns, newest_ns)

    def released(self) -> list[Sample]:
        """Return the samples that a decision has released, in order of time."""
        released, self._released = self._released, []
        return released

    def refuse(self, kind: type[Sample], fault: str) -> None:
        """Note that a sample has impossible values; ``fault`` is the name under which it is counted."""
        self._refused[kind] = (fault, self.refused(kind)[1] + 1)

    def refused(self, kind: type[Sample]) -> tuple[str, int]:
        """Return the fault of a source's last samples, and how many in a row had impossible values."""
        return self._refused.get(kind, ("", 0))

    def latency_ns(self, kind: type[Sample]) -> int:
        """Return the usual delay of a source's samples behind the newest stamp."""
        return round(self._sources[kind].latency_s * 1e9)

    def notices(self) -> Iterator[Notice]:
        """Yield the faults of the clocks."""
        clock = "IMU" if self._clock is None else _WORDS[self._clock.name][0]
        for source in self._sources.values():
            fault, (word, samples) = _FAULTS.get(source.name, Fault.OTHER_CLOCK), _WORDS[source.name]
            if source.off >= OFF_SAMPLES:
                yield Notice(fault, f"{word} clock is {source.off_s:.2f} s ahead of the {clock}'s")
            elif source.off <= -OFF_SAMPLES:
                yield Notice(fault, f"{samples} come too late, or their clock is {source.off_s:.2f} s behind")
        yield from self.frames.notice(clock)
        first_ns, first_tick = self._first
        if self._clock is not None and (count := self._tick - first_tick - 1) >= MIN_COUNTED:
            apart_ns = (self._clock.last_ns - first_ns) / count
            if apart_ns < MIN_INTERVAL_NS:
                fault, samples = _FAULTS.get(self._clock.name, Fault.OTHER_CLOCK), _WORDS[self._clock.name][1]
                apart = f"{samples} are {1e-3 * apart_ns:.3g} microseconds apart"
                yield Notice(fault, f"{apart}: times must be nanoseconds")

    def finish(self) -> None:
        """Drop samples that were never confirmed."""
        self._drop(self._waiting)
        self._waiting = []
        for source in self._sources.values():
            self._forget_suspect(source)

    def _follow(self, source: _Source, t_ns: int) -> None:
        """Make a source the reference clock, from this stamp on if it was not."""
        if source is not self._clock:
            self._clock, self._first, self._others_came = source, (t_ns, self._tick), True
            self.frames.clock_changed()

    def _reach_ns(self, source: _Source) -> float:
        """Return the largest accepted step of a source's stamps."""
        return max(self.buffer_ns, 2.5 * source.interval_ns)  # the buffer if the interval is NaN

    def _replaces_dead_clock(self, source: _Source, t_ns: int, clock: _Source) -> bool:
        """Whether the reference clock has stopped: this source's stamps have advanced long past its last sample."""
        if source.rank == len(CLOCKS) or not source.has_samples:
            return False
        if source.tick != self._tick:
            source.tick, source.progress_ns = self._tick, 0.0
            return False
        longest = 2.5 * source.interval_ns or 0.25 * self.buffer_ns  # a single stamp far ahead must not count
        source.progress_ns += min(max(t_ns - source.last_ns, 0), longest)
        return source.progress_ns > 0.5 * self._reach_ns(clock) + 1e9 * clock.latency_s

    def _take(self, source: _Source, t_ns: int, newest_ns: int) -> Admission:
        clock = self._clock
        if source is clock:
            self._tick += 1
            if self._others_came:
                self._note_latency(source, newest_ns - t_ns)
                self._others_came = False
            if source.suspect is not None:
                self._forget_suspect(source)
        else:
            self._others_came = True
            if clock is not None and source.progress_ns == 0.0:  # a clock sample arrived since the last one
                self._note_latency(source, newest_ns - t_ns)
                if source.name == "frame":
                    self.frames.arrived(t_ns, (clock.last_ns - t_ns) * 1e-9)
        self._note(source, t_ns)
        if source.off:
            source.off = 0
            self._drop(s for s in self._waiting if type(s) is source.kind)
            self._waiting = [s for s in self._waiting if type(s) is not source.kind]
        return TAKE

    def _note_latency(self, source: _Source, lag_ns: int) -> None:
        memory = LATENCY_MEMORY if source.has_samples else 1.0
        source.latency_s += memory * (max(lag_ns * 1e-9, 0.0) - source.latency_s)

    def _note(self, source: _Source, t_ns: int) -> None:
        known, step_ns = source.interval_ns, t_ns - source.last_ns
        if known != known:  # NaN: the first
            source.last_ns, source.interval_ns = t_ns, 0.0
        elif step_ns > 0:
            source.interval_ns = known + 0.125 * (min(step_ns, 3 * known) - known) if known else step_ns
            source.last_ns = t_ns

    def _wait(self, source: _Source, sample: Sample, ahead_s: float) -> Admission:
        source.off, source.off_s = max(source.off, 0) + 1, ahead_s
        self._waiting.append(sample)
        self._drop(self._waiting[:-MAX_WAITING])
        self._waiting = self._waiting[-MAX_WAITING:]
        return Admission.WAIT

    def _late(self, source: _Source, sample: Sample, newest_ns: int, orders: bool) -> Admission:
        """Reject a late sample, unless it is among the first of a better clock: that becomes the reference."""
        suspect = source.suspect
        if source.has_samples or not orders:
            source.off, source.off_s = min(source.off, 0) - 1, (newest_ns - sample.t_ns) * 1e-9
            return Admission.LATE
        if suspect is None or not 0 < sample.t_ns - suspect.t_ns <= self.buffer_ns:
            source.suspect = sample
            return Admission.WAIT
        self.restart()
        source = self._sources[type(sample)]
        self._follow(source, suspect.t_ns)
        self._release([suspect, sample])
        return Admission.SET_BACK

    def _ahead_of_its_own(self, source: _Source, sample: Sample) -> Admission:
        """Hold back a jump of the reference clock until the next sample confirms it; then release both."""
        suspect, t_ns = source.suspect, sample.t_ns
        if source.interval_ns == 0.0:  # its interval is not known
            self._release([sample])
            return Admission.JUMPED
        if suspect is None or not 0 < t_ns - suspect.t_ns <= self._reach_ns(source):
            self._forget_suspect(source)
            source.suspect = sample
            return Admission.WAIT
        source.suspect = None
        near = [s for s in self._waiting if abs(s.t_ns - t_ns) <= self.buffer_ns]
        self._drop(s for s in self._waiting if abs(s.t_ns - t_ns) > self.buffer_ns)
        self._waiting = []
        self._follow(source, t_ns)
        self._release([*near, suspect, sample])
        return Admission.JUMPED

    def _release(self, samples: list[Sample]) -> None:
        self._released = sorted(samples, key=lambda s: (s.t_ns, SOURCES[type(s)].order))
        self._tick += 1
        for sample in self._released:
            source = self._sources[type(sample)]
            source.off = 0
            self._note(source, sample.t_ns)

    def _forget_suspect(self, source: _Source) -> None:
        if source.suspect is not None:
            self._drop([source.suspect])
            source.suspect = None

    def _drop(self, samples: Iterable[Sample]) -> None:
        for sample in samples:
            self.counters[f"{SOURCES[type(sample)].name}_ahead"] += 1


class FrameStamps:
    """Latency of the frames, and steps of it.

    A step J of the camera's clock and a change of the latency by J are indistinguishable until the vehicle turns:
    after a step of the clock, frames show the heading of J before their stamps. The log odds of the two hypotheses
    are summed from the change of heading minus gyroscope's angle between frames, at the stamps and at the stamps less
    J. ``shift_s`` is an undecided step, positive if the camera's clock would have moved ahead; ``moved_ns`` is the
    step attributed to the clock, to be subtracted from the stamps.
    """

    def __init__(self) -> None:
        self._recent: deque[float] = deque(maxlen=RECENT_FRAMES)
        self._seen: deque[tuple[int, float, float]] = (
            deque()
        )  # time; heading less the gyroscope's, as is and shifted
        self._log_odds = 0.0  # that the stamps are right
        self.moved_ns = 0
        self._moved_at_ns: int | None = None
        self.clock_changed()

    def clock_changed(self) -> None:
        """Forget the latencies behind another clock than the present one."""
        self._usual_s, self.shift_s = nan, 0.0
        self._recent.clear()

    def notice(self, clock: str) -> Iterator[Notice]:
        """Report a step of the stamps against a clock, undecided or within the last second."""
        moved_s = self.shift_s
        text = "or latency has changed"
        if moved_s == 0.0:
            if self._moved_at_ns is None:
                return
            moved_s, text = self.moved_ns * 1e-9, "which is subtracted from now on"
        sense = "ahead" if moved_s > 0 else "back"
        yield Notice(
            Fault.CAMERA_CLOCK,
            f"camera clock has moved {abs(moved_s):.2f} s {sense} against the {clock}'s, {text}",
        )

    def arrived(self, t_ns: int, lag_s: float) -> None:
        """Add the latency of a frame."""
        if self._moved_at_ns is not None and t_ns - self._moved_at_ns > REPORTED_NS:
            self._moved_at_ns = None
        recent = self._recent
        recent.append(lag_s)
        if len(recent) < RECENT_FRAMES:
            return
        middle, spread = median(recent), max(recent) - min(recent)
        if self._usual_s != self._usual_s:  # NaN: the first ones
            self._usual_s = middle
        step = self._usual_s - middle
        if abs(step) > max(MIN_STEP_S, STEP_SPREADS * spread):
            if self.shift_s == 0.0:
                self._log_odds = 0.0
                self._seen.clear()
            self.shift_s = step
        elif abs(step) < MIN_STEP_S:
            self.shift_s = 0.0
            self._usual_s += USUAL_MEMORY * (middle - self._usual_s)

    def add_evidence(
        self, t_ns: int, heading_rad: float, std_rad: float, turned_rad: tuple[float, float]
    ) -> None:
        """Add a frame's evidence about a step of the stamps.

        Parameters
        ----------
        t_ns, heading_rad, std_rad
            Stamp and measurement of the frame.
        turned_rad
            The gyroscope's angle at the stamp, and at the stamp less the step.
        """
        now = (t_ns, heading_rad - turned_rad[0], heading_rad - turned_rad[1])
        seen = self._seen
        seen.append(now)
        while t_ns - seen[0][0] > COMPARED_NS:
            then = seen.popleft()
            as_stamped, as_shifted = wrap_axis(now[1] - then[1]), wrap_axis(now[2] - then[2])
            std = max(std_rad, MIN_STD_RAD)
            term = (as_shifted * as_shifted - as_stamped * as_stamped) / (4.0 * std * std)
            self._log_odds += min(max(term, -MAX_TERM), MAX_TERM) / DEPENDENT_FRAMES
        if self._log_odds > DECIDED:  # the stamps are right: the transport delay has changed
            self._usual_s, self.shift_s = median(self._recent), 0.0
        elif self._log_odds < -DECIDED:
            self.moved_ns += round(self.shift_s * 1e9)
            self._moved_at_ns = t_ns
            self.shift_s = 0.0
            self._recent.clear()
