"""The benchmark of the estimator's calls: its samples are what it says, and both filters follow the flight."""

from __future__ import annotations

import subprocess
import sys
from math import degrees
from pathlib import Path

import numpy as np
import pytest
import step

from fusion import CorridorEstimator, FusionConfig

BENCHMARKS = Path(__file__).resolve().parent.parent / "benchmarks"


def samples(seconds: float, late_ns: int = 0) -> list[step.Sample]:
    rng = np.random.default_rng(0)
    made = [
        *step.imu(rng, 0.0, seconds),
        *step.attitudes(rng, 0.0, seconds),
        *step.frames(rng, 0.0, seconds, late_ns),
    ]
    return sorted(made, key=lambda s: s.at_ns)


def test_samples_come_at_the_rates_that_are_printed() -> None:
    made = samples(10.0)
    counts = {name: sum(s.name == name for s in made) for name in {s.name for s in made}}
    assert counts == {"add_imu": 2000, "add_attitude": 500, "add_measurement": 300}
    imu_ns = np.diff([s.t_ns for s in made if s.name == "add_imu"])
    assert len(set(imu_ns.tolist())) > 1900  # no two steps of one length, which would be cheaper
    assert np.abs(imu_ns - 5_000_000).max() <= 2 * step.JITTER_NS


def test_late_frames_are_taken_and_roll_back_over_80_ms() -> None:
    made = samples(5.0, step.LATE_NS)
    estimator = CorridorEstimator(FusionConfig())
    newest_ns, rolled_back = 0, []
    for sample in made:
        if sample.name == "add_measurement":
            rolled_back.append(newest_ns - sample.t_ns)
        newest_ns = max(newest_ns, sample.t_ns)
        getattr(estimator, sample.name)(sample.t_ns, *sample.arguments)
    assert estimator.counters["frame_late"] == 0
    assert estimator.counters["frame_ok"] > 0.95 * len(rolled_back)
    assert np.median(rolled_back) == pytest.approx(80e6, abs=5e6)


def test_both_filters_follow_the_flight() -> None:
    made = samples(20.0)
    ours, plain = CorridorEstimator(FusionConfig()), step.PlainEkf()
    for sample in made:
        getattr(ours, sample.name)(sample.t_ns, *sample.arguments)
        if sample.name != "add_attitude":
            getattr(plain, sample.name)(sample.t_ns, *sample.arguments)
    heading, _, offset = step.truth(20.0)
    estimate = ours.estimate()
    assert estimate.status == "tracking"
    assert degrees(abs(estimate.heading_rad - heading)) < 1.0
    assert degrees(abs(float(plain.x[0]) - heading)) < 1.0
    assert abs(estimate.lateral_offset_norm - offset) < 0.05
    assert abs(float(plain.x[3]) - offset) < 0.05


def test_it_prints_its_tables() -> None:
    command = [
        sys.executable,
        str(BENCHMARKS / "step.py"),
        "--seconds",
        "2",
        "--minutes",
        "1",
        "--steps",
        "3000",
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    rows = {line[:34].strip(): line[34:].split() for line in done.stdout.splitlines()}
    for name in ("add_imu", "add_attitude", "add_measurement", "estimate", "add_imu, speed known"):
        assert float(rows[name][1]) > 0
    assert float(rows["add_measurement, 80 ms late"][0]) == 59
    assert float(rows["plain filterpy EKF"][0]) > 0
    assert "Covariance over 3000 steps, looked at 3 times: symmetric and positive" in done.stdout


def test_covariance_stays_symmetric_and_positive() -> None:
    ekf, health = step.worn(40_000, seed=1)
    assert (health.looked_at, health.bad, health.asymmetry) == (40, 0, 0.0)
    assert health.smallest > 0
    assert np.isfinite(ekf.x).all()


@pytest.mark.parametrize(
    "bad",
    [
        np.diag([1.0, 1.0, -1.0]),
        np.array([[1.0, 1.1], [1.1, 1.0]]),
        np.array([[1.0, 0.1], [0.1 + 1e-16, 1.0]]),
    ],
)
def test_bad_covariance_is_told(bad: np.ndarray) -> None:
    with np.errstate(invalid="ignore"):
        assert step.Health().with_covariance(bad).bad == 1
