"""Run the streaming estimator over a logged flight, then the backward pass."""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from fusion.estimator.config import FusionConfig
from fusion.estimator.estimator import CorridorEstimator
from fusion.estimator.faults import Fault
from fusion.estimator.frame_update import FrameSample, extract_features
from fusion.estimator.imu_yaw import AttitudeSample
from fusion.estimator.input_checks import checked_config
from fusion.estimator.propagation import ImuSample
from fusion.estimator.records import new_record
from fusion.estimator.smoothed_table import hypotheses_table
from fusion.estimator.state import Sample, State
from fusion.estimator.tables import FRAME_DTYPE, Table
from fusion.flight import Flight, ImuStream
from fusion.logs.plausibility.lens import examine_lens
from fusion.offline.flight_checks import check_flight
from fusion.offline.prefetch import prefetch_features, usable_cores
from fusion.offline.stopwatch import Stopwatch, stopwatch
from fusion.offline.summary import summarise
from fusion.offline.table_builder import BLOCK_ROWS, TableBuilder
from fusion.progress import Progress
from fusion.result.result import FusionResult, Timings
from vision.errors import InputError

if TYPE_CHECKING:
    from fusion.estimator.frame_update import Features

NEW_OBJECTS = 20_000  # threshold of the garbage collector
MAX_JOBS = 8  # by default; more threads than this do not help the filter


def fuse_flight(
    flight: Flight,
    config: FusionConfig | None = None,
    *,
    method: str = "geometric",
    progress: Progress | None = None,
    jobs: int | None = None,
) -> FusionResult:
    """Fuse a logged flight with the causal filter and the smoother, and evaluate the result.

    Pictures are read one by one. One that cannot be decoded becomes a row with the reason ``unreadable``. A frame is
    fused at its time stamp minus ``config.camera_delay_s``; the table of frames keeps the time stamp.

    Parameters
    ----------
    flight
        From `fusion.load_flight`, or constructed by the caller.
    config
        Settings; None for the defaults. Gyroscope noise that is not set is taken from the log.
    method
        ``geometric``, or ``paper`` for the article's measurement.
    progress
        Called with (done, total) frames.
    jobs
        Number of threads, including this one; the others decode pictures and find their lines ahead of the filter.
        The result is bit for bit the same for any number. None: one per core that the process may use, at most
        `MAX_JOBS`.

    Returns
    -------
    FusionResult
        Tables of filter, smoother and frames, and the summary with the verdict; errors if the flight has ground
        truth.

    Raises
    ------
    InputError
        If the method is unknown, the flight has no frames, a stream is not in order of time or has another shape,
        ``jobs`` is below 1, or an argument has another type.
    """
    if jobs is not None and jobs < 1:
        raise InputError(f"jobs = {jobs}", remedy="give 1 or more, or None for one per core")
    check_flight(flight)
    settings = _with_declared_values(checked_config(config), flight)
    tables = TableBuilder(settings, _row_kinds(flight))
    estimator = CorridorEstimator(settings, flight.camera, method, on_final=tables.take)
    threads = (jobs or min(usable_cores(), MAX_JOBS)) - 1
    smoothed, timings = _filter_and_smooth(estimator, tables, flight, threads, progress)
    result = FusionResult(
        flight_name=flight.name,
        config=settings,
        estimates=tables.estimates(),
        smoothed=smoothed,
        frames=np.array(tables.frames, dtype=FRAME_DTYPE),
        problems=(
            *flight.problems,
            *_sample_problems(estimator),
            *_lens_problems(flight),
            *_camera_problems(tables.last, settings),
        ),
        offset_hypotheses=hypotheses_table(tables.offset_steps),
    )
    return replace(
        result, overview=summarise(result, flight, method, estimator.counters, timings, tables.events)
    )


def _filter_and_smooth(
    estimator: CorridorEstimator,
    tables: TableBuilder,
    flight: Flight,
    threads: int,
    progress: Progress | None,
) -> tuple[Table, Timings]:
    """Run the filter over the whole flight into the tables, then the smoother; return its table and the times."""
    with stopwatch() as clock, _reduced_garbage_collection():
        started = clock.seconds()
        extract = partial(extract_features, camera=flight.camera, method=estimator.method)
        with closing(prefetch_features(flight.frames, extract, threads)) as pictures:
            vision_s = _feed(estimator, flight, pictures, progress, clock)
        estimator.finish()
        tables.finish()
        filtered = clock.seconds()
        smoothed = tables.smoothed()
        ended = clock.seconds()
    timings = Timings(
        vision_s, filtered - started - vision_s, ended - filtered, ended - started, clock.compile_s
    )
    return smoothed, timings


@contextmanager
def _reduced_garbage_collection() -> Iterator[None]:
    """Reduce the work of the garbage collector, which samples and states do not need.

    Some thousand of them are alive at a time and would be scanned repeatedly. Most of the existing objects are
    modules, which stay.
    """
    first, *others = gc.get_threshold()
    frozen = gc.get_freeze_count() > 0  # the caller manages frozen objects itself
    if first:  # 0: it is off
        gc.set_threshold(max(first, NEW_OBJECTS), *others)
    if not frozen:
        gc.freeze()
    try:
        yield
    finally:
        gc.set_threshold(first, *others)
        if not frozen:
            gc.unfreeze()


def _with_declared_values(config: FusionConfig, flight: Flight) -> FusionConfig:
    """Fill in unset settings that the flight declares: gyroscope noise, the corridor's width."""
    declared: dict[str, float | None] = {
        "corridor_width_m": config.corridor_width_m or flight.corridor_width_m
    }
    imu = flight.imu
    if imu is None:
        return config.model_copy(update=declared)
    declared |= {
        "gyro_noise_density": config.gyro_noise_density or imu.gyro_noise_density,
        "gyro_bias_walk": config.gyro_bias_walk or imu.gyro_random_walk,
    }
    return config.model_copy(update=declared)


def _any_finite(rows: npt.NDArray[np.float64]) -> bool:
    """Whether any row (n, k) can be used."""
    return bool(np.isfinite(rows).all(axis=1).any())


def _row_kinds(flight: Flight) -> tuple[type[object], ...]:
    """Kinds of sample that propagate and so make rows: the best first, the others as substitutes."""
    found: list[type[object]] = [FrameSample]
    if flight.attitude is not None and _any_finite(flight.attitude.q_world_body):
        found.insert(0, AttitudeSample)
    if flight.imu is not None and _any_finite(flight.imu.gyro_rad_s):
        found.insert(0, ImuSample)
    return tuple(found)


def _feed(
    estimator: CorridorEstimator,
    flight: Flight,
    pictures: Iterator[Features | None],
    progress: Progress | None,
    clock: Stopwatch,
) -> float:
    """Pass all samples to the estimator, in order of measurement time; return the seconds spent on pictures."""
    vision_s = 0.0
    delay_ns = round(estimator.config.camera_delay_s * 1e9)
    total = len(flight.frames.t_ns)

    def add_frame(t_ns: int, i: int) -> None:
        nonlocal vision_s
        before = clock.seconds()
        if (features := next(pictures)) is None:
            estimator.add_unreadable_frame(t_ns + delay_ns)
        else:
            estimator.add_features(t_ns + delay_ns, features)
        vision_s += clock.seconds() - before
        if progress is not None:
            progress(i + 1, total)

    waiting: list[Sample] = []  # gyroscope samples and attitudes since the last other sample

    def add_waiting() -> None:
        estimator.add_in_order(waiting)
        waiting.clear()

    streams: list[tuple[npt.NDArray[np.int64], Callable[[int, int], object]]] = []
    if (imu := flight.imu) is not None:
        imu_samples = _imu_samples(imu)
        streams.append((imu.t_ns, lambda t_ns, i: waiting.append(next(imu_samples))))
    if (attitude := flight.attitude) is not None:
        q = np.asarray(attitude.q_world_body, np.float64)
        rows = zip(_rows(attitude.t_ns), _rows(q), strict=True)
        attitudes = (AttitudeSample(t_ns, tuple(q)) for t_ns, q in rows)
        streams.append((attitude.t_ns, lambda t_ns, i: waiting.append(next(attitudes))))
    n_waiting = len(streams)
    if (velocity := flight.velocity) is not None:
        v = velocity.xyz
        streams.append((velocity.t_ns, lambda t_ns, i: estimator.add_velocity(t_ns, v[i])))
    if (ranges := flight.range) is not None:
        distance_m = ranges.distance_m
        streams.append((ranges.t_ns, lambda t_ns, i: estimator.add_range(t_ns, float(distance_m[i]))))
    streams.append((flight.frames.t_ns - delay_ns, add_frame))
    counts = [len(times) for times, _ in streams]
    t_ns = np.concatenate([np.asarray(times, np.int64) for times, _ in streams])
    order = np.argsort(t_ns, kind="stable")  # samples of equal time in the order of the streams
    t_ns, stream = t_ns[order], np.repeat(np.arange(len(streams), dtype=np.int8), counts)[order]
    order -= np.cumsum([0, *counts])[stream]  # number within the sample's stream
    give = [add for _, add in streams]
    for t, k, i in zip(_rows(t_ns), _rows(stream), _rows(order), strict=True):
        if waiting and (k >= n_waiting or len(waiting) >= BLOCK_ROWS):
            add_waiting()
        give[k](t, i)
    add_waiting()
    return vision_s


def _imu_samples(imu: ImuStream) -> Iterator[ImuSample]:
    """Yield the gyroscope samples, each with the specific force if that is a number."""
    gyros, accels = (np.asarray(values, np.float64) for values in (imu.gyro_rad_s, imu.accel_m_s2))
    is_known = np.asarray(np.isfinite(accels).all(axis=1))
    columns: list[npt.NDArray[Any]] = [imu.t_ns, gyros, accels, is_known]
    for t_ns, gyro, accel, known in zip(*map(_rows, columns), strict=True):
        yield new_record(ImuSample, (t_ns, tuple(gyro), tuple(accel) if known else None))


def _rows(values: npt.NDArray[Any]) -> Iterator[Any]:
    """Yield rows as Python lists, which the estimator processes faster; few at a time, to save memory."""
    for start in range(0, len(values), BLOCK_ROWS):
        yield from values[start : start + BLOCK_ROWS].tolist()


def _lens_problems(flight: Flight) -> Iterator[str]:
    """Report a distortion that the pictures contradict."""
    found = examine_lens(flight.frames, flight.camera)
    if found is not None:
        yield found.sentence


def _camera_problems(last: State | None, config: FusionConfig) -> Iterator[str]:
    """Report the whole flight's evidence on the camera's calibration."""
    if last is not None:
        for notice in last.checks.installation.notices(config.gyro_scale_std):
            if notice.fault in (Fault.FOCAL_LENGTH, Fault.CAMERA_YAW):
                yield notice.text


def _sample_problems(estimator: CorridorEstimator) -> Iterator[str]:
    what = {
        "imu_not_finite": "gyroscope samples that are not numbers were skipped",
        "imu_out_of_range": "gyroscope samples beyond its range were skipped",
        "imu_spike": "gyroscope samples that jumped as no vehicle can were held back",
        "imu_clipped": "gyroscope samples were clipped at the end of its range",
        "imu_frozen": "gyroscope samples that repeated the ones before were skipped",
        "attitude_not_unit": "attitudes that are not unit quaternions were skipped",
        "velocity_not_finite": "velocities that are not numbers were skipped",
        "velocity_out_of_range": "velocities that no vehicle indoors reaches were skipped",
        "range_not_positive": "distances to the floor that can be none were skipped",
        "range_out_of_range": "distances to the floor beyond 100 m, which none indoors is, were skipped: give metres",
        "imu_ahead": "IMU samples stamped far ahead of all others were skipped",
        "attitude_ahead": "attitudes stamped far ahead of all others were skipped",
        "frame_ahead": "frames stamped far ahead of all others were skipped",
        "clock_set_back": "times the samples' clock was set back",
    }
    for name, sentence in what.items():
        if estimator.counters[name]:
            yield f"{estimator.counters[name]} {sentence}"
