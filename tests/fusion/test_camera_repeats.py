"""A camera that is frozen: its frames are not used, counted, and told of; an exact simulation at rest is not one."""

from __future__ import annotations

import numpy as np
import pytest

from fusion import CorridorEstimator
from fusion.estimator.camera_repeats import Repeats
from fusion.estimator.faults import Fault
from fusion.estimator.frame_update import FrameSample
from fusion.estimator.gyro_checks import GyroCheck
from fusion.estimator.propagation import DeadReckoning, Mode
from tests.fusion.simulated import frame
from vision import FrameMeasurement

FROZEN_S = 2.0


def flown(gyro_std: float, turn_rad_s: float, until_s: float) -> CorridorEstimator:
    """Fly straight, then turn; from `FROZEN_S` on the camera gives one measurement again and again."""
    estimator, rng, heading = CorridorEstimator(), np.random.default_rng(1), 0.0
    held: FrameMeasurement | None = None
    for k in range(round(until_s * 200)):
        rate = turn_rad_s if k >= FROZEN_S * 200 else 0.0
        heading += rate / 200
        p, q, r = rng.normal(0.0, gyro_std, 3) if gyro_std else (0.0, 0.0, 0.0)
        estimator.add_imu(k * 5_000_000, (p, q, r + rate), (0.0, 0.0, -9.8))
        if k % 7 == 0:
            m = frame(heading + float(rng.normal(0.0, 0.005)), 0.005)
            if k >= FROZEN_S * 200:
                m = held = held or m
            estimator.add_measurement(k * 5_000_000, m)
    return estimator


@pytest.mark.parametrize("gyro_std", [0.0, 0.05])
@pytest.mark.parametrize("turn_rad_s", [0.1, 0.5])
def test_a_frozen_camera_is_told_within_half_a_second(gyro_std: float, turn_rad_s: float) -> None:
    estimate = flown(gyro_std, turn_rad_s, FROZEN_S + 0.5).estimate()
    assert estimate.faults & Fault.CAMERA_FROZEN
    assert "camera repeats the same picture" in estimate.reason
    assert estimate.heading_rad == pytest.approx(0.5 * turn_rad_s, abs=0.02)


def test_its_frames_are_counted_and_vision_ages() -> None:
    estimator = flown(0.05, 0.3, FROZEN_S + 2.0)
    assert estimator.counters["frame_repeated"] > 45
    assert estimator.estimate().vision_age_s > 1.7
    assert estimator.estimate().status == "coasting"


def test_at_rest_without_noise_equal_frames_are_true() -> None:
    estimator = flown(0.0, 0.0, FROZEN_S + 3.0)
    assert estimator.counters["frame_repeated"] == 0
    assert (estimator.estimate().status, estimator.estimate().reason) == ("tracking", "")


@pytest.mark.parametrize(
    ("mode", "turned_rad", "found"), [(Mode.GYRO, 1e-6, 1), (Mode.GYRO, 0.0, 0), (Mode.NONE, 0.0, 1)]
)
def test_equal_pictures_repeat_unless_nothing_moved(mode: Mode, turned_rad: float, found: int) -> None:
    sample = FrameSample(0, 0, lambda attitude, prior, lateral: frame(0.0), b"lines")
    before = Repeats().with_frame(sample, DeadReckoning(mode=mode), GyroCheck())
    after = before.with_frame(sample, DeadReckoning(mode=mode, raw_theta_rad=turned_rad), GyroCheck())
    assert after.found == found
    other = sample._replace(picture=b"others")
    assert after.with_frame(other, DeadReckoning(mode=mode, raw_theta_rad=1.0), GyroCheck()).found == 0
