"""The streaming estimator: the public class that live programs and the offline path call once per sample.

Each sample is checked (`input_checks`), its time stamp is admitted (`arrivals`), and the sample is inserted into the
`timeline`, which passes samples to the `engine` in order of time and replays them after a late one. Estimates come
from the state after the newest sample (`estimate`).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from math import isfinite
from typing import TYPE_CHECKING, Any

import numpy.typing as npt

from fusion.estimator.arrivals import TAKE, Admission, Arrivals
from fusion.estimator.config import FusionConfig
from fusion.estimator.diagnostics import Covariance, Innovations, covariance_of, innovations_of
from fusion.estimator.engine import Engine
from fusion.estimator.estimate import Estimate, estimate_of
from fusion.estimator.events import EventLog
from fusion.estimator.faults import Fault
from fusion.estimator.fixed_lag import FixedLag
from fusion.estimator.frame_update import FrameResult, FrameSample, Measure, extract_features
from fusion.estimator.gyro_checks import GOOD
from fusion.estimator.imu_yaw import AttitudeSample
from fusion.estimator.input_checks import (
    checked_config,
    checked_measurement,
    float_list,
    number,
    vector,
    whole_nanoseconds,
    within_bounds,
)
from fusion.estimator.lateral.status import reliable
from fusion.estimator.notices import Status
from fusion.estimator.propagation import ImuSample
from fusion.estimator.range_width import RangeSample
from fusion.estimator.records import new_record
from fusion.estimator.resets import Resets
from fusion.estimator.seed import HeadingSeed, WidthChange
from fusion.estimator.state import SOURCES, Entry, Sample, State
from fusion.estimator.timeline import Timeline
from fusion.estimator.velocity import VelocitySample
from vision.errors import InputError
from vision.measurement import Attitude, FrameMeasurement, Prior, Reason

if TYPE_CHECKING:
    from fusion.estimator.filterpy_ekf import FilterpyEKF
    from fusion.estimator.frame_update import Features
    from vision import Camera
    from vision.lines.line_set import LineSet

CLOCK_RESET_SAMPLES = 50
ALONE = 16  # samples processed one by one after one that cannot be processed with those after it
MAX_BEHIND_S = 1.0  # largest lag of the caller's clock behind the newest sample
MAX_SILENCE_S = 600.0  # largest lead of the caller's clock: sensors that fall silent are missed long before
MAX_AHEAD_NS = 500_000_000  # longest prediction: beyond it the last rate is no longer valid

__all__ = ["CorridorEstimator", "Estimate", "FrameResult", "Status"]


class CorridorEstimator:
    """Heading and lateral offset from gyroscope, attitude and camera, sample by sample.

    Samples may arrive out of order and up to ``config.buffer_s`` late; the result is bit-identical to that of samples
    in order. Samples that are later than that, repeated or not finite are counted in `counters` and otherwise
    ignored. A stamp far ahead of the IMU's clock is ignored until the next one confirms it. Status and reason take
    the latency of the sources into account: they report wrong clocks, and a source that is always late counts as
    silent later. Rejected frames, resets and changes of status are logged, see `fusion.estimator.events`.

    Not thread-safe: call it from one thread. Lines can be extracted in another one (`vision.extract_lines`).

    Parameters
    ----------
    config
        Settings; None for the defaults.
    camera
        Needed for `add_frame` and `add_lines`, not for `add_measurement`.
    method
        ``geometric``, or ``paper`` for the article's measurement.
    on_final
        Called, in order of time, with each `fusion.estimator.state.Entry` that has left the buffer and is final.

    Raises
    ------
    InputError
        If the method is unknown, ``camera`` is not a `vision.Camera`, or ``config`` not a `FusionConfig`.
    """

    def __init__(
        self,
        config: FusionConfig | None = None,
        camera: Camera | None = None,
        method: str = "geometric",
        *,
        on_final: Callable[[Entry], None] | None = None,
    ) -> None:
        if method not in ("geometric", "paper"):
            raise InputError(f"method {method!r} is unknown", remedy="use geometric or paper")
        if camera is not None:
            _check_camera(camera)
        self.config = checked_config(config)
        self.camera = camera
        self.method = method
        self.counters: Counter[str] = Counter()
        self.last_frame: FrameResult | None = None
        ahead_m, right_m = (0.0, 0.0) if camera is None else camera.p_body_camera_m.tolist()[:2]
        self._engine = Engine(self.config, (ahead_m, right_m))
        lag_s = self.config.fixed_lag_s
        self._lag = None if lag_s is None else FixedLag(round(lag_s * 1e9), self.config)
        self._on_final = on_final
        self._events = EventLog(self.config)
        self._timeline = Timeline(
            self._engine,
            round(self.config.buffer_s * 1e9),
            self.counters,
            self._finalise,
        )
        self._arrivals = Arrivals(round(self.config.buffer_s * 1e9), self.counters)
        self._resets = Resets()
        self._delay_ns = round(self.config.camera_delay_s * 1e9)
        self._late_in_a_row = 0

    @property
    def ekf(self) -> FilterpyEKF:
        """The filter at the newest sample, an ``ExtendedKalmanFilter`` of filterpy, for inspection.

        Its ``x``, ``P``, ``F``, ``Q``, ``K``, ``y``, ``S`` and ``likelihood`` are those of the last prediction and
        the last update; the state is that of `fusion.estimator.models`. Writing to it has no effect on the estimator.
        The first call loads filterpy and scipy, which takes half a second and 40 MiB: make it before take-off.
        """
        return self._engine.filterpy_ekf()

    def add(self, sample: Sample) -> Entry | None:
        """Add a sample of any kind.

        Values are only checked for use by the filter; the methods below check their arguments as well. An error
        raised while a frame is measured goes to the caller, and the frame has no effect.

        Parameters
        ----------
        sample
            For instance a `fusion.estimator.propagation.ImuSample`; each kind has ``t_ns``, integer nanoseconds.

        Returns
        -------
        Entry or None
            The result so far; None if the sample is held back, or rejected and counted.
        """
        if fault := sample.fault():
            self.counters[fault] += 1
            self._arrivals.refuse(type(sample), fault)
            return None
        admission = self._arrivals.admit(sample, self._timeline.newest_ns)
        return self._insert(sample) if admission is TAKE else self._without_taking(sample, admission)

    def add_in_order(self, samples: Iterable[Sample]) -> None:
        """Add samples in order of time, as `add` does one by one; gyroscope samples and attitudes in less time."""
        taken: list[Sample] = []
        newest_ns = self._timeline.newest_ns
        for sample in samples:
            if fault := sample.fault():
                self.counters[fault] += 1
                self._arrivals.refuse(type(sample), fault)
                continue
            admission = self._arrivals.admit(sample, newest_ns)
            if admission is TAKE:
                taken.append(sample)
                newest_ns = sample.t_ns if newest_ns is None else max(newest_ns, sample.t_ns)
                continue
            self._insert_in_order(taken)
            self._without_taking(sample, admission)
            taken, newest_ns = [], self._timeline.newest_ns
        self._insert_in_order(taken)

    def _insert_in_order(self, samples: list[Sample]) -> None:
        """Insert admitted samples; those that are not processed together one by one."""
        timeline, place, wait = self._timeline, 0, 0
        while place < len(samples):
            count = 0 if wait > 0 else timeline.append_run(samples[place:])
            if count:
                self._late_in_a_row = 0
                for kind, number in Counter(map(type, samples[place : place + count])).items():
                    self.counters[SOURCES[kind].name] += number
            else:
                wait = ALONE if wait == 0 else wait - 1
                self._insert(samples[place])
                count = 1
            place += count

    def _without_taking(self, sample: Sample, admission: Admission) -> Entry | None:
        """Follow another decision about a sample than to take it; the result is that of `add`."""
        if admission is Admission.WAIT:
            return None
        if admission is Admission.LATE:
            return self._late(sample)
        released = self._arrivals.released()
        if admission is Admission.JUMPED:
            self._timeline.note_jump()
        else:
            self._set_back(released[0].t_ns)
        return [self._insert(held) for held in released][-1]

    def _insert(self, sample: Sample) -> Entry | None:
        self._late_in_a_row = 0
        timeline, kind = self._timeline, type(sample)
        before = timeline.state
        entry = timeline.insert(sample)
        name = SOURCES[kind].name
        self.counters[f"{name}_duplicate" if entry is None else name] += 1
        if entry is not None and kind is ImuSample:
            verdict = entry.after.checks.gyro.verdict
            if verdict is not GOOD:
                self.counters[f"imu_{verdict}"] += 1
        # A gyroscope sample in order only propagates.
        if (
            kind is not ImuSample
            or timeline.entries[-1] is not entry
            or before.reckoning.gyro_done_rad != 0.0
        ):
            self._count_resets(before)
        return entry

    def _count_resets(self, before: State) -> None:
        """Count a reset if the newest estimate has jumped."""
        after = self._timeline.state
        if after is not before:
            half_m = after.width.half_m(self.config)
            self._resets = self._resets.after(before, after, self._engine.offset_model(after), half_m)

    def _late(self, sample: Sample) -> Entry | None:
        """Count a late sample; many in a row mean that the clock was set back."""
        self.counters[f"{SOURCES[type(sample)].name}_late"] += 1
        self._late_in_a_row += 1
        if self._late_in_a_row < CLOCK_RESET_SAMPLES:
            return None
        self._arrivals.restart()
        self._set_back(sample.t_ns)
        return self.add(sample)

    def _set_back(self, t_ns: int) -> None:
        self.counters["clock_set_back"] += 1
        before = self._timeline.state
        self._timeline.restart(t_ns)
        self._count_resets(before)
        if self._lag is not None:
            self._lag.clear()

    def add_imu(self, t_ns: int, gyro: npt.ArrayLike, accel: npt.ArrayLike | None = None) -> None:
        """Add a sample of the gyroscope and, if present, of the accelerometer.

        Values that are not finite or physically impossible are counted and ignored.

        Parameters
        ----------
        t_ns
            Time, integer nanoseconds.
        gyro
            Angular rate (3,), rad/s, body FRD.
        accel
            Specific force (3,), m/s^2, body FRD: (0, 0, -9.81) level and at rest. None without an accelerometer.

        Raises
        ------
        InputError
            If the time is not an integer of nanoseconds, or a value does not consist of three numbers.
        """
        force = None
        if accel is not None:
            ax, ay, az = vector(accel, "accel")
            if isfinite(ax) and isfinite(ay) and isfinite(az):
                force = (ax, ay, az)
        self.add(new_record(ImuSample, (whole_nanoseconds(t_ns), vector(gyro, "gyro"), force)))

    def add_attitude(self, t_ns: int, q_world_body: npt.ArrayLike) -> None:
        """Add an attitude from the vehicle's own filter; one that is not a unit quaternion is counted and ignored.

        Parameters
        ----------
        t_ns
            Time, integer nanoseconds.
        q_world_body
            Unit quaternion (4,) w, x, y, z, from body FRD to a world whose z points down.

        Raises
        ------
        InputError
            If the time is not an integer of nanoseconds, or the quaternion does not consist of four numbers.
        """
        w, x, y, z = float_list(q_world_body, 4, "q_world_body")
        self.add(AttitudeSample(whole_nanoseconds(t_ns), (w, x, y, z)))

    def add_velocity(self, t_ns: int, v_body: npt.ArrayLike) -> None:
        """Add a velocity, for instance from optical flow or wheels; one that is not finite is counted and ignored.

        Parameters
        ----------
        t_ns
            Time, integer nanoseconds.
        v_body
            Velocity (3,), m/s, body FRD.

        Raises
        ------
        InputError
            If the time is not an integer of nanoseconds, or the velocity does not consist of three numbers.
        """
        self.add(VelocitySample(whole_nanoseconds(t_ns), vector(v_body, "v_body")))

    def add_range(self, t_ns: int, distance_m: float) -> None:
        """Add a distance to the floor; one that is not positive, or beyond 100 m, is counted and ignored.

        Multiplied by the width per height that frames measure, it gives the corridor's width and thus offsets in
        metres, if the configuration sets neither the width nor the camera's height.

        Parameters
        ----------
        t_ns
            Time, integer nanoseconds.
        distance_m
            Distance along the body's z axis (down), metres, from the camera's position.

        Raises
        ------
        InputError
            If the time is not an integer of nanoseconds, or the distance is not a number.
        """
        self.add(RangeSample(whole_nanoseconds(t_ns), number(distance_m, "distance_m")))

    def add_frame(self, t_ns: int, image: npt.NDArray[Any]) -> FrameResult:
        """Add a picture; an unusable one is counted as unreadable.

        The result's ``cause`` gives the reason (another size than the camera's, floats). It is part of the estimate's
        ``reason`` until a frame can be read again.

        Parameters
        ----------
        t_ns
            Time stamp, integer nanoseconds: mid-exposure, or later than that by ``config.camera_delay_s``.
        image
            Grey (h, w), BGR (h, w, 3) or BGRA (h, w, 4), uint8 or uint16.

        Returns
        -------
        FrameResult
            The outcome for now; a late sample may still change it.

        Raises
        ------
        InputError
            If the estimator has no camera, or the time is not an integer of nanoseconds.
        """
        camera = self._camera()
        try:
            features = extract_features(image, camera, self.method)
        except InputError as error:
            return self.add_unreadable_frame(t_ns, error.problem)
        return self.add_features(t_ns, features)

    def add_features(self, t_ns: int, features: Features) -> FrameResult:
        """Add what `fusion.estimator.frame_update.extract_features` returned, for instance in another thread.

        Parameters
        ----------
        t_ns
            As for `add_frame`.
        features
            A `vision.lines.line_set.LineSet` or a `FrameMeasurement`.

        Returns
        -------
        FrameResult
            As for `add_frame`.

        Raises
        ------
        InputError
            As for `add_lines` or `add_measurement`.
        """
        if isinstance(features, FrameMeasurement):
            return self.add_measurement(t_ns, features)
        return self.add_lines(t_ns, features)

    def add_lines(self, t_ns: int, lines: LineSet) -> FrameResult:
        """Add a picture whose lines were extracted elsewhere, for instance in another thread.

        Parameters
        ----------
        t_ns
            As for `add_frame`.
        lines
            Result of `vision.extract_lines` with the estimator's camera.

        Returns
        -------
        FrameResult
            As for `add_frame`.

        Raises
        ------
        InputError
            If the estimator has no camera, or the time is not an integer of nanoseconds.
        """
        from vision import measure_lines

        camera = self._camera()

        def measure(attitude: Attitude | None, prior: Prior, lateral: bool) -> FrameMeasurement:
            return measure_lines(lines, camera, attitude, prior, lateral=lateral)

        return self._add_frame(t_ns, measure, lines.ends_px.tobytes())

    def add_measurement(self, t_ns: int, measurement: FrameMeasurement) -> FrameResult:
        """Add a frame that was measured elsewhere.

        A field with an impossible value (an offset of more than three half widths, an elevation of 30 degrees) is
        counted, ``frame_offset_out_of_range`` for instance, and treated as not measured.

        Parameters
        ----------
        t_ns
            As for `add_frame`.
        measurement
            The measurement; its arrays of offset evidence and wall profiles are copied.

        Returns
        -------
        FrameResult
            As for `add_frame`.

        Raises
        ------
        InputError
            If the time is not an integer of nanoseconds, or the measurement or one of its numbers is of another type.
        """
        measurement, refused = within_bounds(checked_measurement(measurement))
        self.counters.update(refused)
        return self._add_frame(t_ns, measurement)

    def add_unreadable_frame(self, t_ns: int, cause: str = "") -> FrameResult:
        """Add a frame without a picture, so that it is counted.

        Parameters
        ----------
        t_ns
            As for `add_frame`.
        cause
            Why there is no picture; part of the estimate's ``reason`` until a frame can be read again.

        Returns
        -------
        FrameResult
            Not accepted, with ``cause``.

        Raises
        ------
        InputError
            If the time is not an integer of nanoseconds.
        """
        self.last_frame = replace(self._add_frame(t_ns, None), cause=cause)
        return self.last_frame

    def seed(
        self,
        t_ns: int,
        heading_rad: float,
        heading_std_rad: float,
        corridor_width_m: float | None = None,
    ) -> None:
        """Set the heading at a time from another source, before the first frame or in flight.

        It replaces the estimated heading, which counts as a reset, and starts tracking. Unlike a frame's heading, it
        also determines which way along the corridor the vehicle faces. Frames then correct it as usual.

        Parameters
        ----------
        t_ns
            Time, integer nanoseconds; within ``config.buffer_s`` of the newest sample.
        heading_rad, heading_std_rad
            Heading from the corridor's axis, radians, positive turned right, and its standard deviation.
        corridor_width_m
            Width of the corridor from then on, metres; None leaves it unchanged.

        Raises
        ------
        InputError
            If a value is impossible, or the time is beyond the buffer or already has a seed.
        """
        samples: list[Sample] = [HeadingSeed.checked(t_ns, heading_rad, heading_std_rad)]
        if corridor_width_m is not None:
            samples.append(WidthChange.checked(t_ns, corridor_width_m))
        self._insert_set_values(samples)

    def set_corridor_width(self, t_ns: int, width_m: float | None) -> None:
        """Set the corridor's width from a time on, in place of ``config.corridor_width_m``.

        The offset in half widths does not change. None: the width is no longer known, and is estimated again from the
        camera's height or the range sensor, if there is one.

        Parameters
        ----------
        t_ns
            Time, integer nanoseconds; within ``config.buffer_s`` of the newest sample.
        width_m
            0.2 to 100 m, or None.

        Raises
        ------
        InputError
            As for `seed`.
        """
        self._insert_set_values([WidthChange.checked(t_ns, width_m)])

    def _insert_set_values(self, samples: list[Sample]) -> None:
        """Insert values set by the caller; they are not checked against the sensors' clocks."""
        t_ns, newest_ns, buffer_ns = samples[0].t_ns, self._timeline.newest_ns, self._timeline.buffer_ns
        if newest_ns is not None and abs(t_ns - newest_ns) > buffer_ns:
            raise InputError(
                f"t_ns = {t_ns} is {(t_ns - newest_ns) * 1e-9:+.2f} s from the newest sample",
                remedy=f"seed within buffer_s = {buffer_ns * 1e-9:g} s of it, or after reset()",
            )
        if any(map(self._timeline.holds, samples)):  # checked first: insert all of them, or none
            raise InputError(f"t_ns = {t_ns} already has another value", remedy="use a time 1 ns later")
        for sample in samples:
            self._insert(sample)

    def reset(self) -> None:
        """Discard all samples, estimates and values set in flight; keep configuration and `counters`.

        It counts as a reset at once, with a jump of zero, since the heading is then unknown. It counts again when the
        heading becomes known, with the jump from the last known heading.
        """
        before = self._timeline.state
        self._timeline.restart_from(self._engine.reset_state(before))
        self._arrivals.restart()
        if self._lag is not None:
            self._lag.clear()
        self.last_frame = None
        self._late_in_a_row = 0
        self.counters["reset"] += 1
        self._count_resets(before)
        self._resets = self._resets.with_heading_step(0.0)

    def estimate(self, now_ns: int | None = None, *, at_ns: int | None = None) -> Estimate:
        """Return the newest estimate, predicted to the newest sample or to a later time.

        Parameters
        ----------
        now_ns
            The present time on the sensors' clock, integer nanoseconds: status and ages then also show sources that
            have fallen silent since the newest sample. None: the time of the newest sample. ``timestamp_ns`` remains
            that of the newest sample, or ``at_ns``. A time more than 1 s before the newest sample, or 600 s after
            it, is taken for that of another clock or unit, and reported in ``reason``.
        at_ns
            Time to predict to, integer nanoseconds, for instance the time at which the actuators act. Heading and
            lateral offset are propagated with their last rates; sigmas grow by the process noise and by the possible
            change of the rate since it was measured. A time before the newest sample returns that sample's estimate.
            The prediction ends 0.5 s ahead; ``timestamp_ns`` and ``reason`` then show it. Status and ages remain
            those at ``now_ns``.

        Returns
        -------
        Estimate
            Radians, metres and seconds; unknown numbers are NaN.

        Raises
        ------
        InputError
            If a time is not an integer of nanoseconds.
        """
        state = self._timeline.state
        judged_ns = None if now_ns is None else whole_nanoseconds(now_ns)
        behind_s = 0.0
        if judged_ns is not None and state.t_ns is not None:
            behind_s, judged_ns = (state.t_ns - judged_ns) * 1e-9, max(judged_ns, state.t_ns)
        newest = estimate_of(state, self.config, judged_ns, self._arrivals, self._resets)
        if state.t_ns is not None:
            newest = replace(newest, timestamp_ns=state.t_ns)
        if not -MAX_SILENCE_S <= behind_s <= MAX_BEHIND_S:
            sense = "before" if behind_s > 0.0 else "after"
            remedy = "give nanoseconds of the samples' clock"
            message = f"now_ns is {abs(behind_s):.0f} s {sense} the newest sample: {remedy}"
            reason = f"{newest.reason}; {message}" if newest.reason else message
            newest = replace(newest, reason=reason, faults=newest.faults | Fault.IMU_CLOCK)
        if newest.reason and self.last_frame is not None and self.last_frame.cause:
            newest = replace(newest, reason=f"{newest.reason}; {self.last_frame.cause}")
        if at_ns is None or state.t_ns is None:
            return newest
        ahead_ns = whole_nanoseconds(at_ns) - state.t_ns
        if ahead_ns <= 0:
            return newest
        end_ns = state.t_ns + min(ahead_ns, MAX_AHEAD_NS)
        moved = self._engine.predicted(state, end_ns)
        e = estimate_of(moved, self.config, judged_ns or state.t_ns, self._arrivals, self._resets)
        reason = newest.reason
        if end_ns < at_ns:
            message = f"predicted {MAX_AHEAD_NS * 1e-9:g} s ahead, not the {ahead_ns * 1e-9:.2f} s asked for"
            reason = f"{reason}; {message}" if reason else message
        # Status and faults are those of the newest sample; the prediction only widens the sigmas.
        return replace(e, timestamp_ns=end_ns, status=newest.status, reason=reason, faults=newest.faults)

    def covariance(self) -> Covariance:
        """Mean and covariance of all states, at the newest sample.

        Returns
        -------
        Covariance
            Names, mean (n,) and matrix (n, n) in one order: ``heading_rad``, ``gyro_bias_rad_s`` and
            ``imu_yaw_offset_rad``, then, while the lateral offset is known, the four states of its filter. Each name
            ends with its unit. See `fusion.estimator.diagnostics.Covariance`.
        """
        state = self._timeline.state
        model = self._engine.offset_model(state)
        return covariance_of(state, model, reliable(state.lateral, model).known)

    def innovations(self) -> Innovations:
        """Last innovation of each source with its variance and test ratio, as PX4's EKF2 logs them.

        Returns
        -------
        Innovations
            Frames' heading and IMU yaw in rad, lateral offset in half widths, velocity across the corridor in m/s;
            NaN for a source without a measurement so far. See `fusion.estimator.diagnostics.Innovations`.
        """
        return innovations_of(self._timeline.state)

    def smoothed(self) -> Estimate:
        """Return the estimate of ``config.fixed_lag_s`` ago, smoothed with all measurements since.

        It is for the last sample at or before the newest sample's time less the lag, or for the first sample while
        the flight is shorter. Status and ages are those at that time.

        Raises
        ------
        InputError
            If the configuration sets no lag.
        """
        if self._lag is None:
            raise InputError(
                "the estimator keeps no window to smooth", remedy="set fixed_lag_s = 1.0 (0.25 to 2 s)"
            )
        return self._lag.smoothed(self._timeline.entries)

    def finish(self) -> None:
        """End the flight: pass the entries still in the buffer to ``on_final``."""
        self._arrivals.finish()
        self._timeline.finish()
        self._events.finish()

    def _finalise(self, entries: Sequence[Entry]) -> None:
        self._events.take(entries)
        if self._lag is not None:
            for entry in entries:
                self._lag.keep(entry)
        if self._on_final is not None:
            for entry in entries:
                self._on_final(entry)

    def _camera(self) -> Camera:
        if self.camera is None:
            raise InputError(
                "the estimator has no camera", remedy="give one: CorridorEstimator(config, camera)"
            )
        return self.camera

    def _add_frame(
        self, t_ns: int, measure: Measure | FrameMeasurement | None, picture: bytes = b""
    ) -> FrameResult:
        t_ns = whole_nanoseconds(t_ns)
        stamps = self._arrivals.frames
        taken_ns = t_ns - self._delay_ns - stamps.moved_ns
        sample = FrameSample(taken_ns, t_ns, measure, picture, abs(stamps.shift_s))
        newest_ns = self._timeline.newest_ns
        entry = self.add(sample)
        if entry is None or entry.frame is None:
            ahead = newest_ns is not None and sample.t_ns > newest_ns
            self.last_frame = FrameResult(t_ns, None, False, Reason.AHEAD if ahead else Reason.LATE)
        else:
            self.last_frame = entry.frame
            self.counters[f"frame_{entry.frame.reason}"] += 1
            if self._arrivals.frames.shift_s != 0.0:
                self._check_frame_stamps(entry, entry.frame.measurement)
        return self.last_frame

    def _check_frame_stamps(self, entry: Entry, m: FrameMeasurement | None) -> None:
        """Use a frame as evidence of whether the camera's clock has stepped, or only the frames' transport delay.

        A step of the clock is subtracted from later stamps.
        """
        stamps = self._arrivals.frames
        before = self._timeline.at(entry.t_ns - round(stamps.shift_s * 1e9))
        if m is None or before is None or not (m.accepted and 0.0 < m.heading_std_rad < 1.0):
            return
        turned = (entry.after.reckoning.raw_theta_rad, before.reckoning.raw_theta_rad)
        moved_ns = stamps.moved_ns
        stamps.add_evidence(entry.t_ns, m.heading_rad, m.heading_std_rad, turned)
        self.counters["camera_clock_moved"] += stamps.moved_ns != moved_ns


def _check_camera(camera: object) -> None:
    """Raise `InputError` unless the argument is a camera: a common mistake is the path of its calibration."""
    from vision import Camera

    if not isinstance(camera, Camera):
        raise InputError(
            f"camera = {camera!r} is no Camera", remedy='load it: vision.Camera.from_yaml("sensor.yaml")'
        )
