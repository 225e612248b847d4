"""Checks time stamps in order of arrival: decides which samples to accept, and reports wrong clocks.

The IMU's stamps order time; where it is dead, the attitude's do, then the frames'. Nothing is measured in the future:

- a sample of another source ahead of that clock waits, for the clock itself may have jumped or paused;
- a sample of the clock's own source far ahead waits until the next one confirms it;
- what nothing confirms is dropped and counted (``frame_ahead``).

A source's usual delay behind the clock is its latency; it is added to the time after which the source counts as
silent. A lasting step of the latency means that either the clock or the transport delay has changed; the next turn
shows which.
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
USUAL_MEMORY = 1 / 32  # of a frame
LATENCY_MEMORY = 1 / 8
RECENT_FRAMES = 6
MIN_STEP_S = 0.04
STEP_SPREADS = 3.0  # a step is this many times the recent stamps' spread
MIN_INTERVAL_NS = 25_000  # on average; IMUs sample at up to 32 kHz
MIN_COUNTED = 50  # samples of the clock, before they are called too close
OFF_SAMPLES = 2  # in a row that a source is off before it is reported
MAX_TERM = 2.0  # of one frame's evidence on what has stepped
MIN_STD_RAD = 1e-6  # of a heading: a smaller one, squared, may be 0
COMPARED_NS = 400_000_000  # from frame to frame; the rate must change in that time
DEPENDENT_FRAMES = 4.0  # each comparison is so many times less evidence than an independent one
REPORTED_NS = 1_000_000_000  # how long a clock that was found is reported: the filter has to recover
DECIDED = 7.0  # log odds of 1000:1

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
    """What to do with a sample."""

    TAKE = "take"
    WAIT = "wait"  # nothing, for now
    LATE = "late"  # nothing: the buffer has passed it
    JUMPED = "jumped"  # the clock has: take what `Arrivals.released` returns
    SET_BACK = "set back"  # time is another: start at, then take, what `Arrivals.released` returns


TAKE = Admission.TAKE  # as a name: Python 3.11 takes long to look up a member, and each sample asks for it


class _Source:
    """Arrivals of one source."""

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
        self.last_ns = 0  # newest stamp; what counts only if interval_ns is not NaN
        self.interval_ns = nan  # mean; NaN before the first sample, 0 before the second
        self.latency_s = 0.0
        self.suspect: Sample | None = None  # far ahead, not confirmed
        self.off, self.off_s = (
            0,
            0.0,
        )  # how many in a row were ahead (negative: late), and by how much the last
        self.tick, self.progress_ns = (
            0,
            0.0,
        )  # the clock's last arrival, and how far stamps have gone since then

    @property
    def has_samples(self) -> bool:
        """Whether a sample was taken."""
        return self.interval_ns == self.interval_ns


class Arrivals:
    """Samples as they arrive.

    Parameters
    ----------
    buffer_ns
        How far behind the newest sample one may be and still be taken, and how far ahead of the clock.
    counters
        Where what is dropped is counted.
    """

    def __init__(self, buffer_ns: int, counters: Counter[str]) -> None:
        self.buffer_ns = buffer_ns
        self.counters = counters
        self.restart()

    def restart(self) -> None:
        """Forget all stamps: time is another."""
        self._sources = {kind: _Source(kind) for kind in SOURCES}
        self._clock: _Source | None = None
        self._tick = 0
        self._first = (0, 0)  # stamp and tick of the clock's first sample
        self._waiting: list[Sample] = []
        self._released: list[Sample] = []
        self.frames = FrameStamps()

    def admit(self, sample: Sample, newest_ns: int | None) -> Admission:
        """Decide about the next sample.

        Parameters
        ----------
        sample
            As it arrives.
        newest_ns
            Time of the newest sample taken; None before any.
        """
        source, t_ns, clock = self._sources[type(sample)], sample.t_ns, self._clock
        if newest_ns is None or clock is None:
            self._follow(source, t_ns)
            return self._take(source, t_ns)
        if source is clock and newest_ns - self.buffer_ns <= t_ns <= clock.last_ns + self.buffer_ns:
            return self._take(source, t_ns)  # as nearly always
        orders = source is clock or source.rank < clock.rank or self._replaces_dead_clock(source, t_ns, clock)
        if t_ns < newest_ns - self.buffer_ns:
            return self._late(source, sample, newest_ns, orders)
        if not orders:
            if t_ns > clock.last_ns + self._reach_ns(clock):
                return self._wait(source, sample, (t_ns - clock.last_ns) * 1e-9)
            return self._take(source, t_ns)
        latest_ns = clock.last_ns if source is clock else newest_ns
        if t_ns > latest_ns + self._reach_ns(source):
            return self._ahead_of_its_own(source, sample)
        self._follow(source, t_ns)
        return self._take(source, t_ns)

    def released(self) -> list[Sample]:
        """Return what was held until now, in order of time."""
        released, self._released = self._released, []
        return released

    def latency_ns(self, kind: type[Sample]) -> int:
        """How far behind the clock a source's samples usually come."""
        return round(self._sources[kind].latency_s * 1e9)

    def notices(self) -> Iterator[Notice]:
        """Say which clocks are off."""
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
        """Drop what nothing has confirmed."""
        self._drop(self._waiting)
        self._waiting = []
        for source in self._sources.values():
            self._forget_suspect(source)

    def _follow(self, source: _Source, t_ns: int) -> None:
        """Let a source order time, from this stamp on where it has not done so."""
        if source is not self._clock:
            self._clock, self._first = source, (t_ns, self._tick)

    def _reach_ns(self, source: _Source) -> float:
        """How far a stamp may jump."""
        return max(self.buffer_ns, 2.5 * source.interval_ns)  # of NaN, too, the buffer

    def _replaces_dead_clock(self, source: _Source, t_ns: int, clock: _Source) -> bool:
        """Whether the clock is dead: this source has gone on for long since its last sample."""
        if source.rank == len(CLOCKS) or not source.has_samples:
            return False
        if source.tick != self._tick:
            source.tick, source.progress_ns = self._tick, 0.0
            return False
        longest = 2.5 * source.interval_ns or 0.25 * self.buffer_ns  # one stamp far ahead is no progress
        source.progress_ns += min(max(t_ns - source.last_ns, 0), longest)
        return source.progress_ns > 0.5 * self._reach_ns(clock)

    def _take(self, source: _Source, t_ns: int) -> Admission:
        clock = self._clock
        if source is clock:
            self._tick += 1
            if source.suspect is not None:
                self._forget_suspect(source)
        elif clock is not None and source.progress_ns == 0.0:  # the clock has has_samples since the last one
            lag_s = (clock.last_ns - t_ns) * 1e-9
            memory = LATENCY_MEMORY if source.has_samples else 1.0
            source.latency_s += memory * (max(lag_s, 0.0) - source.latency_s)
            if source.name == "frame":
                self.frames.arrived(t_ns, lag_s)
        self._note(source, t_ns)
        if source.off:
            source.off = 0
            self._drop(s for s in self._waiting if type(s) is source.kind)
            self._waiting = [s for s in self._waiting if type(s) is not source.kind]
        return TAKE

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
        """Refuse, unless this is the first that is heard of a better clock: time is its own from now on."""
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
        """Wait for the next sample to confirm a jump of the clock itself, or let both through."""
        suspect, t_ns = source.suspect, sample.t_ns
        if source.interval_ns == 0.0:  # how often it speaks is not known
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
    """How far behind the clock frames arrive, and by how much that has stepped.

    A jump of a clock by J and a latency that changes by as much look alike until the vehicle turns: frames stamped J
    ahead then show the heading of J ago. Both are weighed by how the frames' heading changes from frame to frame.
    ``shift_s`` is a step that is not decided, positive where the camera's clock would have gone ahead, ``moved_ns``
    what was found to be its clock, to be taken off the stamps.
    """

    def __init__(self) -> None:
        self._usual_s = nan
        self._recent: deque[float] = deque(maxlen=RECENT_FRAMES)
        self._seen: deque[tuple[int, float, float]] = (
            deque()
        )  # time; heading less the gyroscope's, as is and shifted
        self._log_odds = 0.0  # that the stamps are right
        self.shift_s = 0.0
        self.moved_ns = 0
        self._moved_at_ns: int | None = None

    def notice(self, clock: str) -> Iterator[Notice]:
        """Say that the stamps have stepped against a clock, or did within the last second."""
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
        """Take a frame that arrives so far behind the clock."""
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
        """Weigh a frame of stepped stamps.

        Parameters
        ----------
        t_ns, heading_rad, std_rad
            Its stamp and what it measured.
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
        if self._log_odds > DECIDED:  # the stamps are right: frames take longer now, or no longer so long
            self._usual_s, self.shift_s = median(self._recent), 0.0
        elif self._log_odds < -DECIDED:
            self.moved_ns += round(self.shift_s * 1e9)
            self._moved_at_ns = t_ns
            self.shift_s = 0.0
            self._recent.clear()
