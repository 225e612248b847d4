"""What holds for every stream of samples: numbers are numbers, order does not matter, left is like right.

A stream is a short flight (gyroscope at 100 Hz, frames at 20 Hz, attitude at 25 Hz) among whose samples others are
strewn: plausible ones that contradict it, or any numbers at all.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import astuple, fields, replace
from itertools import pairwise
from math import hypot, inf, isfinite, pi, remainder
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from fusion import CorridorEstimator, Estimate, FusionConfig
from fusion.estimator.faults import Fault
from fusion.estimator.resets import STEP_RAD
from fusion.estimator.state import Entry
from tests.fusion.simulated import Sample as TimedSample
from tests.fusion.simulated import frame, give, mirrored, quaternion, two_places
from vision import FrameMeasurement
from vision.lateral.parallax import PROFILES_SHAPE
from vision.rotations import wrap_axis

MS = 1_000_000
LENGTH_MS = 2400
BUFFER_MS = 500
CONFIG = FusionConfig(corridor_width_m=2.2)
EXAMPLES = settings(
    max_examples=25, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow]
)


class Stream(list[TimedSample]):
    """Samples in order of time; of two with one time and kind the first given stays."""

    def __init__(self, base: Iterable[TimedSample], more: Iterable[TimedSample] = ()) -> None:
        self.strewn = tuple(more)
        unique = {(s.t_ns, s.kind): s for s in reversed([*base, *self.strewn])}
        super().__init__(sorted(unique.values(), key=lambda s: s.t_ns))

    def __repr__(self) -> str:
        """Show what is not of the plain flight: all of it would hide what matters."""
        return f"flight of {len(self)} samples, among them {self.strewn}"


small = st.floats(-1.0, 1.0)
wild = st.floats(width=64)  # NaN, infinite, 1e308
when = st.integers(600, LENGTH_MS - 100)


def sample(kind: str, t_ms: float, *values: Any) -> TimedSample:
    t_ns = round(t_ms * MS)
    return TimedSample(kind, t_ns, t_ns, values)


def strewn(number: st.SearchStrategy[float]) -> st.SearchStrategy[TimedSample]:
    """One sample of any kind made of such numbers; its stamp is its kind's own, so that none coincide."""
    vector, positive = st.tuples(number, number, number), number.map(abs)
    gyro = st.builds(lambda t, g, a: sample("imu", t + 0.1, g, a), when, vector, vector)
    attitude = st.builds(
        lambda t, r, p, y: sample("attitude", t + 0.2, quaternion(r, p, y)),
        when,
        small,
        small,
        st.floats(-3, 3),
    )
    velocity = st.builds(lambda t, v: sample("velocity", t + 0.3, v), when, vector)
    frames = st.builds(
        lambda t, *n: sample("frame", t + 0.4, _measurement(*n)),
        when,
        number,
        positive,
        number,
        positive,
        number,
        positive,
        positive,
    )
    return st.one_of(gyro, attitude, velocity, frames)


def _measurement(
    heading: float,
    std: float,
    offset: float,
    offset_std: float,
    elevation: float,
    elevation_std: float,
    width: float,
) -> FrameMeasurement:
    return frame(
        heading,
        std,
        offset,
        offset_std,
        elevation_rad=elevation,
        elevation_std_rad=elevation_std,
        width_per_height=width,
    )


def flight(amplitude_rad: float, rate_rad_s: float, with_attitude: bool, ambiguous: bool = False) -> Stream:
    """Weave in a corridor: samples of all kinds, exact, in order; ambiguous frames show two lateral offsets.

    They also show both walls, at rest.
    """
    evidence = (two_places(0.2, -0.5),) if ambiguous else ()
    walls = (
        np.random.default_rng(0).normal(0.0, 0.1, PROFILES_SHAPE).astype(np.float32) if ambiguous else None
    )
    t = np.arange(0, LENGTH_MS, 10)
    rate = amplitude_rad * rate_rad_s * np.cos(rate_rad_s * t * 1e-3)
    stream = [
        sample("imu", ms, (0.0, 0.0, float(r)), (0.0, 0.0, -9.8))
        for ms, r in zip(t.tolist(), rate, strict=True)
    ]
    for ms in range(3, LENGTH_MS, 50):
        heading = amplitude_rad * float(np.sin(rate_rad_s * ms * 1e-3))
        seen = frame(heading, 0.01, 0.2, 0.02, offset_evidence=evidence, wall_profiles=walls)
        stream.append(sample("frame", ms, seen))
    for ms in range(6, LENGTH_MS if with_attitude else 0, 40):
        yaw = 0.7 + amplitude_rad * float(np.sin(rate_rad_s * ms * 1e-3))
        stream.append(sample("attitude", ms, quaternion(0.02, -0.03, yaw)))
    return Stream(stream)


flights = st.builds(flight, st.floats(0.0, 0.5), st.floats(0.5, 4.0), st.booleans(), st.booleans())


plausible = st.builds(Stream, flights, st.lists(strewn(small), max_size=12))
anything = st.builds(Stream, flights, st.lists(strewn(wild), max_size=12))


def run(
    stream: Iterable[TimedSample],
    on_final: Callable[[Entry], None] | None = None,
    config: FusionConfig = CONFIG,
) -> list[Estimate]:
    """Give the samples in this order; the estimate after each."""
    estimator = CorridorEstimator(config, on_final=on_final)
    estimates = []
    with np.errstate(all="ignore"):
        for s in stream:
            give(estimator, s)
            estimates.append(estimator.estimate())
    estimator.finish()
    return estimates


def end_of(stream: Iterable[TimedSample]) -> Estimate:
    """Give the samples in this order; the estimate after the last."""
    estimator = CorridorEstimator(CONFIG)
    with np.errstate(all="ignore"):
        for s in stream:
            give(estimator, s)
    return estimator.estimate()


def numbers(e: Estimate) -> list[float]:
    return [v for v in astuple(e) if isinstance(v, float)]


def bits(e: Estimate) -> tuple[str, ...]:
    """An estimate such that equal ones compare equal, NaN with NaN, and no others do."""
    return tuple(v.hex() if isinstance(v, float) else repr(v) for v in astuple(e))


def check_sound(estimates: Sequence[Estimate]) -> None:
    """Numbers are finite or, where unknown, NaN; a heading once found is never unknown."""
    for e in estimates:
        assert not any(abs(v) == inf for v in numbers(e)), e
        if e.status != "initialising":
            assert isfinite(e.heading_rad)
            assert isfinite(e.heading_std_rad)
            assert isfinite(e.yaw_rate_rad_s)
        if isfinite(e.heading_rad):
            assert -pi <= e.heading_rad < pi
            assert e.heading_std_rad > 0.0
        assert isfinite(e.lateral_offset_norm) == isfinite(e.lateral_offset_norm_std)
        assert e.lateral_offset_norm_std != e.lateral_offset_norm_std or e.lateral_offset_norm_std > 0.0
        assert isfinite(e.lateral_offset_norm) == (e.lateral_status != "unknown")
        assert 0.0 <= e.lateral_probability <= 1.0 + 1e-9


@EXAMPLES
@given(plausible)
def test_every_plausible_stream_gives_sound_numbers_covariances_times_and_counts(stream: Stream) -> None:
    covariances: list[np.ndarray] = []

    def keep(entry: Entry) -> None:
        if entry.after is not None:
            covariances.append(entry.after.P)
        covariances.extend(node.P for node in entry.nodes)

    estimates = run(stream, keep)
    check_sound(estimates)
    assert len(covariances) >= len(stream)
    check_covariances(np.array(covariances))
    for name in ("timestamp_ns", "reset_count", "lateral_reset_count"):
        values = [getattr(e, name) for e in estimates]
        assert values == sorted(values), name


def check_covariances(P: np.ndarray) -> None:
    """They (n, k, k) are symmetric and positive."""
    scale = np.sqrt(np.einsum("nii->ni", P))
    assert (scale > 0.0).all()
    normalised = P / scale[:, :, None] / scale[:, None, :]
    assert np.abs(normalised - normalised.transpose(0, 2, 1)).max() < 1e-9
    assert np.linalg.eigvalsh(normalised).min() > -1e-9


@pytest.mark.parametrize(
    "stranger",
    [
        pytest.param(sample("imu", 1500.1, (0.0, 0.0, 1e308), (0.0, 0.0, -9.8)), id="rate"),
        pytest.param(sample("imu", 1500.1, (0.0, 0.0, 0.0), (1e200, 0.0, 0.0)), id="acceleration"),
        pytest.param(sample("frame", 1500.4, frame(0.0, 0.01, 1e300, 0.02)), id="offset"),
        pytest.param(
            sample("frame", 1500.4, _measurement(0, 0.01, 0, 0.02, 0, 1e200, 1)),
            id="elevation sigma",
        ),
        pytest.param(sample("velocity", 1500.3, (1e300, 1e300, 0.0)), id="velocity"),
    ],
)
def test_one_absurd_sample_makes_no_absurd_numbers(stranger: TimedSample) -> None:
    check_sound(run(Stream(flight(0.2, 2.0, False), [stranger])))


def test_one_absurd_velocity_leaves_the_offset_as_it_was() -> None:
    plain = run(Stream(flight(0.2, 2.0, False)))[-1]
    for speed in (1e3, 1e100, 1e300):
        estimates = run(Stream(flight(0.2, 2.0, False), [sample("velocity", 1500.3, (0.0, speed, 0.0))]))
        assert {e.lateral_status for e in estimates if e.timestamp_ns > 1500 * MS} == {"known"}
        assert estimates[-1].lateral_offset_norm == pytest.approx(plain.lateral_offset_norm, abs=1e-6)
        assert estimates[-1].lateral_offset_norm_std == pytest.approx(plain.lateral_offset_norm_std, rel=1e-3)


@EXAMPLES
@given(anything)
@example(Stream(flight(0.0, 1.0, False), [sample("imu", 1500.1, (0.0, 0.0, 1e308), (0.0, 0.0, -9.8))]))
def test_numbers_are_numbers_in_every_stream(stream: Stream) -> None:
    check_sound(run(stream))


def late_by(stream: Stream, delays_ms: Sequence[int]) -> list[TimedSample]:
    """Put the samples in an order of arrival that these delays make, the first ones on time."""
    order = [s.t_ns + delays_ms[k % len(delays_ms)] * MS * (k > 0) for k, s in enumerate(stream)]
    return [s for _, s in sorted(zip(order, stream, strict=True), key=lambda pair: pair[0])]


delays = st.lists(st.integers(0, BUFFER_MS - 20), min_size=3, max_size=40)


@EXAMPLES
@example(  # from .65 s on, all frames come .28 s later than before
    Stream(
        flight(1 / 3, 4 / 3, False),
        [sample("imu", 600.1, (0, 0, 0), (0, 0, 0)), sample("imu", 649.1, (0.8, 0.9, -0.5), (0, 0, 0))],
    ),
    [0, 0, 0, 280, 0, 0],
)
@example(  # the yaw takes over from a late gyroscope, with a turn of 166 degrees from before
    Stream(
        flight(0.0, 4.0, False, False),
        [
            sample("attitude", 600.2, quaternion(0.0, 0.0, 0.0)),
            sample("attitude", 1221.2, quaternion(0.0, 0.0, 2.894)),
            sample("attitude", 1652.2, quaternion(0.0, 0.0, 0.0)),
            sample("imu", 600.1, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
            sample("imu", 600.15, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
            sample("imu", 1036.1, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
        ],
    ),
    [197, 267, 278, 78, 53, 0],
)
@given(plausible, delays)
def test_order_within_the_buffer_does_not_matter(stream: Stream, delays_ms: list[int]) -> None:
    """But for what is told of the arrivals themselves, and of steps that were published meanwhile.

    Frames that from some time on all come later look like a step of the camera's clock. While that is told, their
    stamps are doubted, so the estimate is another, but no worse than its sigma says. In either case time never goes
    back, and every step is counted.
    """
    in_order, arriving_late = end_of(stream), run(late_by(stream, delays_ms))
    times = [e.timestamp_ns for e in arriving_late]
    assert times == sorted(times)
    check_continuous(arriving_late)
    late = arriving_late[-1]
    if any(Fault.CAMERA_CLOCK in e.faults for e in arriving_late):
        std = hypot(in_order.heading_std_rad, late.heading_std_rad)
        assert abs(wrap_axis(late.heading_rad - in_order.heading_rad)) < 3.0 * std
        return
    arrived = ("reason", "faults", *(f.name for f in fields(Estimate) if "reset" in f.name))
    assert bits(replace(late, **{name: getattr(in_order, name) for name in arrived})) == bits(in_order)


def test_a_recovery_that_is_taken_back_is_two_steps() -> None:
    """Ten frames that agree make a recovery; ten older ones that arrive behind them take it back."""
    samples = [sample("imu", 10 * k, (0.0, 0.0, 0.0), (0.0, 0.0, -9.8)) for k in range(240)]
    samples += [sample("frame", ms, frame(0.0)) for ms in range(3, 2000, 30)]
    samples += [sample("frame", ms, frame(0.2)) for ms in range(2003, 2390, 35)]
    late = [sample("frame", ms, frame(0.0)) for ms in range(2008, 2390, 35)]
    believing = FusionConfig(corridor_width_m=2.2, axis_jump_hold_s=0.3)
    estimates = run([*Stream(samples), *late], config=believing)
    counts = [e.reset_count for e in estimates]
    assert counts == sorted(counts)
    assert counts[-1] == 2
    assert estimates[-1].reset_heading_rad == pytest.approx(-0.2, abs=0.02)
    assert estimates[-1].reset_heading_total_rad == pytest.approx(0.0, abs=0.03)
    check_continuous(estimates)


def check_continuous(estimates: Sequence[Estimate]) -> None:
    """A heading less its counted steps moves no further than a vehicle turns and a correction below a step."""
    for before, after in pairwise(estimates):
        assert after.reset_count >= before.reset_count
        assert after.lateral_reset_count >= before.lateral_reset_count
        if before.status == "initialising" or after.status == "initialising":
            continue
        moved = after.heading_rad - before.heading_rad
        moved -= after.reset_heading_total_rad - before.reset_heading_total_rad
        dt_s = (after.timestamp_ns - before.timestamp_ns) * 1e-9
        turned = max(abs(before.yaw_rate_rad_s), abs(after.yaw_rate_rad_s)) * dt_s
        assert abs(remainder(moved, 2 * pi)) <= STEP_RAD + turned + 1e-6


MIRRORED = (
    "heading_rad",
    "lateral_offset_norm",
    "yaw_rate_rad_s",
    "gyro_bias_rad_s",
    "lateral_velocity_norm_s",
    "reset_lateral_norm",
)
THE_SAME = (
    "heading_std_rad",
    "lateral_offset_norm_std",
    "lateral_status",
    "lateral_probability",
    "lateral_age_s",
    "lateral_reset_count",
    "status",
    "reason",
    "reset_count",
    "corridor_index",
)


@EXAMPLES
@given(plausible)
def test_left_is_like_right(stream: Stream) -> None:
    for here, there in zip(run(stream), run(map(mirrored, stream)), strict=True):
        for name in MIRRORED:
            expected = -getattr(here, name)
            assert getattr(there, name) == pytest.approx(expected, abs=1e-7, nan_ok=True), name
        for name in THE_SAME:
            value = getattr(here, name)
            if isinstance(value, float):
                value = pytest.approx(value, rel=1e-6, nan_ok=True)
            assert getattr(there, name) == value, name


@EXAMPLES
@given(plausible, st.floats(-3.0, 3.0))
def test_where_the_world_calls_north_does_not_matter(stream: Stream, turn_rad: float) -> None:
    def turned(s: TimedSample) -> TimedSample:
        if s.kind != "attitude":
            return s
        w, x, y, z = s.values[0]
        c, n = np.cos(turn_rad / 2), np.sin(turn_rad / 2)
        return replace(s, values=((c * w - n * z, c * x - n * y, c * y + n * x, c * z + n * w),))

    here, there = end_of(stream), end_of(map(turned, stream))
    assert there.heading_rad == pytest.approx(here.heading_rad, abs=1e-7, nan_ok=True)
    assert there.heading_std_rad == pytest.approx(here.heading_std_rad, rel=1e-6, nan_ok=True)
    assert (there.status, there.reset_count) == (here.status, here.reset_count)


@EXAMPLES
@given(plausible, st.integers(-(10**15), 2 * 10**18))
def test_when_the_clock_began_does_not_matter(stream: Stream, shift_ns: int) -> None:
    shifted = [replace(s, t_ns=s.t_ns + shift_ns) for s in stream]
    here, there = end_of(stream), end_of(shifted)
    assert bits(replace(there, timestamp_ns=here.timestamp_ns)) == bits(here)
    assert there.timestamp_ns - here.timestamp_ns == shift_ns
