"""Pictures measured in one thread while samples arrive in another: the numbers are those of one thread."""

from __future__ import annotations

import queue
import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import astuple
from functools import partial
from typing import Any

import numpy as np
import pytest

import vision
from fusion import CorridorEstimator, Flight, FusionConfig, load_flight
from tests.files import OFFICE
from vision import FrameMeasurement, extract_lines, measure_frame, measure_lines
from vision.images import GreyImage

N_FRAMES = 24


@pytest.fixture(scope="module")
def office() -> Flight:
    return load_flight(OFFICE)


@pytest.fixture(scope="module")
def pictures(office: Flight) -> list[GreyImage]:
    return [office.frames.read(index) for index in range(N_FRAMES)]


def plain(measurement: FrameMeasurement) -> list[str]:
    """Everything but what it took, exact."""
    names = [name for name in FrameMeasurement.__dataclass_fields__ if name not in ("vision_ms", "lines")]
    return [repr(getattr(measurement, name)) for name in names]


def test_pictures_measured_at_once_give_what_one_by_one_gives(
    office: Flight, pictures: list[GreyImage]
) -> None:
    one_by_one = [plain(measure_frame(picture, office.camera)) for picture in pictures]
    with ThreadPoolExecutor(4) as pool:
        for _ in range(3):
            at_once = list(pool.map(lambda picture: plain(measure_frame(picture, office.camera)), pictures))
            assert at_once == one_by_one


def fly(office: Flight, lines_of: Any, **config: Any) -> CorridorEstimator:
    """Give the estimator the flight's beginning; ``lines_of`` says what was seen in a picture."""
    assert office.imu is not None
    estimator = CorridorEstimator(FusionConfig(corridor_width_m=2.0, **config), office.camera)
    next_frame = 0
    for t_ns, gyro, accel in zip(office.imu.t_ns, office.imu.gyro_rad_s, office.imu.accel_m_s2, strict=True):
        estimator.add_imu(int(t_ns), gyro, accel)
        # A picture comes 100 ms late, when it has been measured.
        while next_frame < N_FRAMES and office.frames.t_ns[next_frame] + 100_000_000 <= t_ns:
            estimator.add_lines(int(office.frames.t_ns[next_frame]), lines_of(next_frame))
            next_frame += 1
        if next_frame == N_FRAMES:
            return estimator
    raise AssertionError


def test_lines_found_in_another_thread_while_samples_arrive(
    office: Flight, pictures: list[GreyImage]
) -> None:
    waiting: queue.Queue[Any] = queue.Queue(maxsize=4)

    def find_lines() -> None:
        for picture in pictures:
            waiting.put(extract_lines(picture, office.camera))

    alone = fly(office, lambda index: extract_lines(pictures[index], office.camera))
    for _ in range(2):
        camera_thread = threading.Thread(target=find_lines)
        camera_thread.start()
        together = fly(office, lambda index: waiting.get(timeout=300))
        camera_thread.join()
        assert list(map(repr, astuple(together.estimate()))) == list(map(repr, astuple(alone.estimate())))
        assert together.counters == alone.counters


def test_the_offset_is_known_from_every_second_picture_too(
    office: Flight, pictures: list[GreyImage], monkeypatch: pytest.MonkeyPatch
) -> None:
    searched: list[bool] = []

    def counted(*args: Any, lateral: bool, **options: Any) -> FrameMeasurement:
        searched.append(lateral)
        return measure_lines(*args, lateral=lateral, **options)

    monkeypatch.setattr(vision, "measure_lines", counted)
    lines = [extract_lines(picture, office.camera) for picture in pictures]
    every = fly(office, lines.__getitem__).estimate()
    assert all(searched)
    searched.clear()
    estimator = fly(office, lines.__getitem__, lateral_rate_hz=10.0)
    second = estimator.estimate()
    assert sum(searched) == pytest.approx(len(searched) / 2, abs=1)
    assert second.lateral_offset_norm == pytest.approx(every.lateral_offset_norm, abs=0.03)
    assert second.heading_rad == pytest.approx(every.heading_rad, abs=1e-3)
    estimator.reset()
    searched.clear()
    estimator.add_lines(int(office.frames.t_ns[N_FRAMES]), lines[-1])
    assert searched == [True]


def test_estimators_in_threads_of_their_own_do_not_meet(office: Flight, pictures: list[GreyImage]) -> None:
    lines = [extract_lines(picture, office.camera) for picture in pictures]
    alone = list(map(repr, astuple(fly(office, lines.__getitem__).estimate())))
    with ThreadPoolExecutor(3) as pool:
        runs = [pool.submit(partial(fly, office, lines.__getitem__)) for _ in range(3)]
        for run in runs:
            assert list(map(repr, astuple(run.result().estimate()))) == alone


def test_a_reader_of_pictures_may_be_shared(office: Flight, pictures: list[GreyImage]) -> None:
    with ThreadPoolExecutor(4) as pool:
        for index, picture in enumerate(pool.map(office.frames.read, range(N_FRAMES))):
            np.testing.assert_array_equal(picture, pictures[index])
