"""Samples added together give what they give one by one, bit for bit, also where some are faulty."""

from __future__ import annotations

from dataclasses import fields, is_dataclass
from math import cos, sin
from typing import Any

import numpy as np
import pytest

from fusion.estimator.config import FusionConfig
from fusion.estimator.estimator import CorridorEstimator
from fusion.estimator.imu_yaw import AttitudeSample
from fusion.estimator.propagation import ImuSample
from fusion.estimator.state import Entry, Sample
from tests.fusion.simulated import quaternion
from vision.measurement import FrameMeasurement, Reason

STEP_NS = 5_000_000


def samples_of(seed: int, with_attitude: bool, with_accel: bool) -> list[Sample]:
    """Return ten seconds of samples with spikes, a gap, a frozen and a clipped gyroscope, and steps of the yaw."""
    rng = np.random.default_rng(seed)
    out: list[Sample] = []
    for k in range(2000):
        t_ns, rate = k * STEP_NS, 0.3 * sin(0.01 * k)
        p, q, r = (rng.normal(0.0, 0.01, 3) + np.array((0.0, 0.0, rate))).tolist()
        if k in (400, 401, 900):
            r += 30.0
        if 1200 <= k < 1230:
            p, q, r = 0.0, 0.0, 0.1
        if 1300 <= k < 1304:
            r = 40.0
        accel = (0.1, rng.normal(0.0, 0.1), -9.8) if with_accel and k % 50 else None
        if not 600 <= k < 640:
            out.append(ImuSample(t_ns, (p, q, r), accel))
        if with_attitude and k % 4 == 0:
            half = 15.0 * (1.0 - cos(0.01 * k)) * 0.005 + (0.4 if k > 1500 else 0.0) + rng.normal(0.0, 0.001)
            out.append(AttitudeSample(t_ns + 1_000_000 * (k % 3), (cos(half), 0.0, 0.0, sin(half))))
    return out


@pytest.mark.parametrize(
    "config", [FusionConfig(), FusionConfig(imu_yaw_use="always", camera_delay_std_s=0.02)]
)
@pytest.mark.parametrize("with_attitude", [True, False])
@pytest.mark.parametrize("with_accel", [True, False])
def test_as_one_by_one(config: FusionConfig, with_attitude: bool, with_accel: bool) -> None:
    assert_equal(config, samples_of(1, with_attitude, with_accel))


@pytest.mark.parametrize(
    ("kind", "with_accel"),
    [
        ("right", True),
        ("wrong sign", True),
        ("frozen", True),
        ("silent", True),
        ("silent", False),
        ("wrong for a while", True),
        ("wrong for a while", False),
    ],
)
def test_attitude_against_the_gyroscope(kind: str, with_accel: bool) -> None:
    wrong = assert_equal(FusionConfig(), rolling(kind, with_accel))
    assert any(wrong) == (kind not in ("right", "silent"))
    assert not (kind == "wrong for a while" and wrong[-1])


def rolling(kind: str, with_accel: bool) -> list[Sample]:
    """Return 20 s of a vehicle that rolls; from 2 s on its attitude is wrong, for 4 s at least, or silent."""
    rng = np.random.default_rng(2)
    out: list[Sample] = []
    for k in range(4000):
        t_ns, roll, rate = k * STEP_NS, 0.1 * sin(0.02 * k), 0.3 * sin(0.01 * k)
        true = (0.4 * cos(0.02 * k), rate * sin(roll), rate * cos(roll))
        p, q, r = (rng.normal(0.0, 0.01, 3) + np.array(true)).tolist()
        out.append(
            ImuSample(t_ns, (p, q, r), (0.0, -9.8 * sin(roll), -9.8 * cos(roll)) if with_accel else None)
        )
        if k % 4 or (kind == "silent" and 400 <= k < 1200):
            continue
        if k >= 400 and (k < 1200 or kind != "wrong for a while"):
            roll = {"wrong sign": -roll, "wrong for a while": -roll, "frozen": 0.05}.get(kind, roll)
        yaw = 0.15 * (1.0 - cos(0.01 * k))
        out.append(AttitudeSample(t_ns + 1_000_000 * (k % 3), quaternion(roll, 0.0, yaw)))
    return out


def assert_equal(config: FusionConfig, samples: list[Sample]) -> list[bool]:
    """Compare both ways to add samples; return whether the attitude was taken to be wrong along them."""
    finals: tuple[list[Entry], list[Entry]] = ([], [])
    both = [CorridorEstimator(config, on_final=found.append) for found in finals]
    waiting: list[Sample] = []
    for i, sample in enumerate(samples):
        both[0].add(sample)
        waiting.append(sample)
        if i % 20 == 10:
            both[1].add_in_order(waiting)
            waiting.clear()
            heading_rad = 15.0 * (1.0 - cos(0.01 * sample.t_ns / STEP_NS)) * 0.01
            frame = FrameMeasurement(
                True, Reason.OK, n_inliers=9, heading_rad=heading_rad, heading_std_rad=0.02
            )
            for estimator in both:
                estimator.add_measurement(sample.t_ns - 60_000_000 * (i % 3), frame)
            assert str(both[0].estimate()) == str(both[1].estimate())
    both[1].add_in_order(waiting)
    for estimator in both:
        estimator.finish()
    assert both[0].counters == both[1].counters
    assert str(both[0].estimate()) == str(both[1].estimate())
    assert len(finals[0]) == len(finals[1])
    compared: set[tuple[int, int]] = set()
    for one, other in zip(*finals, strict=True):
        assert_equal_numbers(one.after, other.after, compared)
        assert [node.P.tolist() for node in one.nodes] == [node.P.tolist() for node in other.nodes]
    assert both[0].estimate().status == "tracking"
    return [entry.after.tilt.check.is_wrong for entry in finals[1]]


def assert_equal_numbers(one: Any, other: Any, compared: set[tuple[int, int]]) -> None:
    """Compare all numbers of two states, NaN equal to NaN; what successive states share is compared once."""
    if one is other or (id(one), id(other)) in compared:
        return
    if isinstance(one, float):
        assert one == other or (one != one and other != other), (one, other)
    elif isinstance(one, np.ndarray):
        assert np.array_equal(one, other, equal_nan=True), (one, other)
    elif isinstance(one, tuple | list):
        for pair in zip(one, other, strict=True):
            assert_equal_numbers(*pair, compared)
        compared.add((id(one), id(other)))
    elif is_dataclass(one):
        for field in fields(one):
            assert_equal_numbers(getattr(one, field.name), getattr(other, field.name), compared)
        compared.add((id(one), id(other)))
    else:
        assert one == other
