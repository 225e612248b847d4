"""What a program may hand over, and what becomes of it: counted, or refused in a line that names the argument."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import astuple, replace
from math import inf, isnan, nan, pi
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion import CorridorEstimator, Flight, FusionConfig, fuse_flight
from fusion.estimator.input_checks import float_list, whole_nanoseconds, within_bounds
from fusion.flight import FrameStream, ImuStream
from tests.fusion.simulated import frame
from vision import Camera, FrameMeasurement, InputError, Reason
from vision.lateral.mixture import OffsetMixture
from vision.lateral.parallax import PROFILES_SHAPE

MS = 1_000_000


@given(st.integers(-(2**62) + 1, 2**62 - 1))
def test_whole_numbers_of_any_kind_are_times(t_ns: int) -> None:
    assert whole_nanoseconds(t_ns) == t_ns
    found = whole_nanoseconds(np.int64(t_ns))
    assert (found, type(found)) == (t_ns, int)


@pytest.mark.parametrize(
    "t_ns", [1000.005, 1e18, np.float64(3.0), "3", None, np.array([1, 2]), 2**62, 10**30]
)
def test_other_times_are_refused_by_name(t_ns: Any) -> None:
    with pytest.raises(InputError, match=r"t_ns = .*nanoseconds"):
        whole_nanoseconds(t_ns)


Call = Callable[[CorridorEstimator, Any, Any], object]
CALLS: list[tuple[str, Call, Any]] = [
    ("gyro", lambda e, t, v: e.add_imu(t, v), (0.0, 0.0, 0.0)),
    ("accel", lambda e, t, v: e.add_imu(t, (0.0, 0.0, 0.0), v), (0.0, 0.0, -9.8)),
    ("q_world_body", lambda e, t, v: e.add_attitude(t, v), (1.0, 0.0, 0.0, 0.0)),
    ("v_body", lambda e, t, v: e.add_velocity(t, v), (0.0, 0.0, 0.0)),
]


@pytest.mark.parametrize(("name", "call", "good"), CALLS)
@pytest.mark.parametrize("wrong", [(0.0, 0.0), np.zeros((3, 1)), np.zeros(5), "north", None, ("a", "b", "c")])
def test_a_wrong_shape_is_refused_by_the_argument_s_name(
    name: str, call: Call, good: Any, wrong: Any
) -> None:
    estimator = CorridorEstimator()
    if name != "accel" or wrong is not None:
        with pytest.raises(InputError, match=name):
            call(estimator, 0, wrong)
    with pytest.raises(InputError, match="t_ns"):
        call(estimator, 0.5, good)
    assert not estimator.counters
    for kind in (list, tuple, np.array):
        call(estimator, np.int64(10), kind(good))
    assert sum(estimator.counters.values()) == 3


def test_distances_and_frames_are_refused_by_name_too() -> None:
    estimator = CorridorEstimator()
    with pytest.raises(InputError, match="distance_m"):
        estimator.add_range(0, "far")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="t_ns"):
        estimator.add_measurement(0.5, frame(0.0))  # type: ignore[arg-type]


@given(st.lists(st.floats(), min_size=3, max_size=3))
def test_any_three_numbers_are_a_vector(values: list[float]) -> None:
    assert repr(float_list(values, 3, "v")) == repr(values)


# --- bounds of a measurement ---


def mixture(offset: float = 0.2, std: float = 0.05, weight: float = 0.9) -> OffsetMixture:
    return OffsetMixture(*(np.array([v]) for v in (weight, offset, std, nan)))


@pytest.mark.parametrize(
    ("field", "value", "counted"),
    [
        ("lateral_offset_norm", 1e300, "offset"),
        ("lateral_offset_norm", -inf, "offset"),
        ("lateral_offset_norm_std", 1e300, "offset"),
        ("elevation_rad", -0.6, "elevation"),
        ("elevation_std_rad", 1e200, "elevation"),
        ("roll_correction_rad", 1e300, "roll"),
        ("width_per_height", 1e308, "width"),
        ("width_per_height", -1.0, "width"),
        ("corridor_aspect", 5e-324, "aspect"),
        ("corridor_aspect_std", inf, "aspect"),
    ],
)
def test_a_field_out_of_bounds_is_taken_out_alone(field: str, value: float, counted: str) -> None:
    good = frame(
        0.1,
        0.01,
        0.2,
        0.02,
        elevation_rad=0.01,
        elevation_std_rad=0.01,
        roll_correction_rad=0.0,
        roll_correction_std_rad=0.02,
        width_per_height=1.5,
        corridor_aspect=1.2,
        corridor_aspect_std=0.1,
    )
    assert within_bounds(good) == (good, ())
    changes: dict[str, Any] = {field: value}
    found, names = within_bounds(replace(good, **changes))
    assert names == (f"frame_{counted}_out_of_range",)
    assert isnan(getattr(found, field))
    assert (found.accepted, found.heading_rad) == (True, 0.1)


@pytest.mark.parametrize("bad", [mixture(1e300), mixture(std=nan), mixture(std=0.0), mixture(weight=nan)])
def test_evidence_out_of_bounds_is_taken_out(bad: OffsetMixture) -> None:
    good = mixture()
    found, names = within_bounds(frame(0.1, offset_evidence=(bad, good)))
    (kept,) = found.offset_evidence
    assert repr(kept.fields()) == repr(good.fields())
    assert names == ("frame_offset_out_of_range",)


ONE, TWO, COLUMN = np.array([0.5]), np.array([0.2, 0.3]), np.array([[0.5], [0.4]])


@pytest.mark.parametrize(
    "bad",
    [
        OffsetMixture(TWO, ONE, TWO, TWO),
        OffsetMixture(0.5, 0.2, 0.1, 1.5),  # type: ignore[arg-type]
        OffsetMixture(COLUMN, COLUMN, COLUMN, COLUMN),
        OffsetMixture(ONE + 0j, ONE, ONE, ONE),  # type: ignore[arg-type]
        OffsetMixture(ONE, ONE, ONE, None),  # type: ignore[arg-type]
        OffsetMixture(["a"], ["b"], ["c"], ["d"]),  # type: ignore[arg-type]
        (0.5, 0.2, 0.1, 1.5),
    ],
)
def test_evidence_of_another_shape_is_counted_and_left_out(bad: Any) -> None:
    good, lists = mixture(), OffsetMixture([0.5], [0.2], [0.1], [nan])  # type: ignore[arg-type]
    estimator = CorridorEstimator()
    for k in range(20):
        estimator.add_imu(k * 50 * MS, (0.0, 0.0, 0.0))
        estimator.add_measurement(k * 50 * MS, frame(0.1, offset_evidence=(good, bad, lists)))
    assert estimator.counters["frame_offset_out_of_range"] == 20
    assert estimator.last_frame is not None
    assert estimator.last_frame.measurement is not None
    assert len(estimator.last_frame.measurement.offset_evidence) == 2


def test_arrays_are_copied_contiguous_and_of_the_type_that_is_compiled() -> None:
    table = np.full((4, 6), 0.2, np.float32)
    given = OffsetMixture(*(row[::2] for row in table))  # type: ignore[arg-type]
    profiles = np.zeros(PROFILES_SHAPE, np.float32, order="F")
    found, names = within_bounds(frame(0.1, offset_evidence=(given,), wall_profiles=profiles))
    table[:], profiles[:] = nan, nan
    assert names == ()
    assert found.wall_profiles is not None
    assert found.wall_profiles.flags.c_contiguous
    assert not found.wall_profiles.any()
    for array in astuple(found.offset_evidence[0]):
        assert (array.dtype, array.flags.c_contiguous) == (np.float64, True)
        assert array == pytest.approx(0.2)


def test_a_heading_that_is_none_takes_the_frame_with_it() -> None:
    found, names = within_bounds(frame(1e300))
    assert (found.accepted, found.reason, names) == (False, Reason.UNCERTAIN, ("frame_heading_out_of_range",))
    assert within_bounds(frame(nan))[1] == ()  # refused as not measured
    assert within_bounds(frame(-pi))[1] == ()


def test_refused_values_are_counted_and_leave_the_offset_alone() -> None:
    estimator = CorridorEstimator(FusionConfig(corridor_width_m=2.0))
    for i in range(300):
        estimator.add_imu(i * 10 * MS, (0.0, 0.0, 0.0), (0.0, 0.0, -9.8))
        if i % 5 == 0:
            offset = 1e300 if 100 < i < 200 else 0.2
            estimator.add_measurement(i * 10 * MS, frame(0.1, 0.01, offset, 0.02))
        if i % 10 == 0:
            estimator.add_velocity(i * 10 * MS, (1e300, 0.0, 0.0))
    found = estimator.estimate()
    assert estimator.counters["frame_offset_out_of_range"] == 19
    assert estimator.counters["velocity_out_of_range"] == 30
    assert found.heading_rad == pytest.approx(0.1, abs=0.01)
    assert found.lateral_offset_norm == pytest.approx(0.2, abs=0.02)


# --- what raises ---


def test_a_measurement_that_raises_leaves_no_trace() -> None:
    def fly(estimator: CorridorEstimator, first: int, last: int) -> None:
        for i in range(first, last):
            estimator.add_imu(i * 5 * MS, (0.0, 0.0, 0.2))
            if i % 6 == 0:
                estimator.add_measurement(i * 5 * MS, frame(0.2 * i * 0.005))

    def measure(*_: object) -> FrameMeasurement:
        raise np.linalg.LinAlgError("SVD did not converge")

    well, hurt = CorridorEstimator(), CorridorEstimator()
    for estimator in (well, hurt):
        fly(estimator, 0, 400)
    for ahead_ms in (-22, 1):
        with pytest.raises(np.linalg.LinAlgError):
            hurt._add_frame(2000 * MS + ahead_ms * MS, measure)
        assert (hurt.ekf.x == well.ekf.x).all()
    for estimator in (well, hurt):
        fly(estimator, 400, 500)
    assert repr(hurt.estimate()) == repr(well.estimate())


def test_a_measurement_that_raises_in_a_replay_is_dropped_and_counted() -> None:
    calls = []

    def measure(*_: object) -> FrameMeasurement:
        calls.append(0)
        if len(calls) > 1:
            raise np.linalg.LinAlgError("SVD did not converge")
        return frame(0.1)

    estimator = CorridorEstimator()
    for i in range(100):
        estimator.add_imu(i * 5 * MS, (0.0, 0.0, 0.0))
    estimator._add_frame(490 * MS, measure)
    estimator.add_imu(489 * MS, (0.0, 0.0, 0.0))  # comes late
    estimator.add_imu(488 * MS, (0.0, 0.0, 0.0))
    assert len(calls) == 2
    assert estimator.counters["frame_failed"] == 1


# --- a flight made by hand ---


class NoPictures:
    def read(self, index: int) -> Any:
        raise InputError(f"picture {index} is missing")


def by_hand(frames_ns: np.ndarray, imu_ns: np.ndarray) -> Flight:
    camera = Camera(width_px=64, height_px=48, fx_px=50.0, fy_px=50.0, cx_px=31.5, cy_px=23.5)
    n = len(imu_ns)
    imu = ImuStream(imu_ns, np.zeros((n, 3)), np.tile([0.0, 0.0, -9.8], (n, 1)))
    return Flight("by hand", camera, FrameStream(frames_ns, NoPictures()), imu)


def test_times_that_go_back_are_refused_with_their_row() -> None:
    ordered, back = np.arange(0, 100) * 10 * MS, np.arange(0, 100) * 10 * MS
    back[[40, 41]] = back[[41, 40]]
    with pytest.raises(InputError, match=r"flight.imu.t_ns goes back in row 41, from 410000000 to 400000000"):
        fuse_flight(by_hand(ordered[::5], back))
    with pytest.raises(InputError, match=r"flight.frames.t_ns goes back"):
        fuse_flight(by_hand(ordered[::-5], ordered))
    with pytest.raises(InputError, match=r"flight.frames.t_ns is float64"):
        fuse_flight(by_hand(ordered[::5] * 1e-9, ordered))
    assert len(fuse_flight(by_hand(ordered[::5], ordered)).estimates) == 100
