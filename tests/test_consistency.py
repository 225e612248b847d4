"""The benchmark of consistency: its setting is what it says, its oracle and its measures are right, it runs."""

from __future__ import annotations

import subprocess
import sys
from math import degrees
from pathlib import Path

import consistency
import numpy as np
import pytest

from support import flown, heading_peers, oracle

BENCHMARKS = Path(__file__).resolve().parent.parent / "benchmarks"


def test_the_setting_is_what_is_asked() -> None:
    scene = flown.scene_of(3, 120.0)
    assert (scene.delay_s, scene.gyro_noise, scene.frame_hz, scene.gross) == (0.08, 0.0075, 30.0, 0.05)
    assert degrees(scene.tilt_rad) == pytest.approx(15)
    assert np.degrees(scene.frame_sigma_rad) == pytest.approx([0.3, 1.0])
    lengths = [end - start for start, end in scene.dropouts]
    assert len(lengths) >= 6
    assert 1.0 <= min(lengths) <= max(lengths) <= 5.0
    t = np.arange(0, 120, 0.01)
    jumps = np.degrees(np.abs(np.diff(scene.yaw_offset(t))))
    jumps = jumps[jumps > 0]
    assert len(jumps) >= 10
    assert 10 <= jumps.min() <= jumps.max() <= 20


def test_the_oracle_is_as_good_as_its_own_covariance_says() -> None:
    """Steady state of the scalar filter: sigma^2 = ARW * sigma_frame * sqrt(interval), nearly, without a bias."""
    scene = flown.scene_of(
        0,
        60.0,
        delay_s=0.0,
        dropouts=(),
        gyro_bias_walk=1e-9,
        frame_correlation=0.0,
        frame_sigma_rad=(0.01, 0.01),
    )
    simulated = flown.simulate(scene)
    t = np.arange(5.0, 60.0, 0.05)
    error = heading_peers.heading_error(simulated, t, oracle.oracle(simulated, t))
    expected = np.sqrt(0.0075 * 0.01 * np.sqrt(1 / 30))
    assert np.sqrt((error**2).mean()) == pytest.approx(expected, rel=0.25)


def test_band_holds_what_it_should() -> None:
    rng = np.random.default_rng(0)
    right = rng.normal(size=(50, 4000)) ** 2
    assert consistency.in_band(right) == pytest.approx(0.99, abs=0.006)
    assert consistency.in_band(2.0 * right) < 0.2


def test_peers_follow_a_flight_without_faults() -> None:
    """Where no steel, no gross error and no bias is, each of them is what it is known for."""
    simulated = flown.simulate(
        flown.scene_of(
            1, 12.0, gross=0.0, gyro_bias=0.0, yaw_offset=lambda t: np.full_like(np.asarray(t, float), 0.7)
        )
    )
    t = np.arange(2.0, 12.0, 0.05)
    peers = dict(heading_peers.PEERS)
    peers |= {
        name: peer
        for name, (package, peer) in heading_peers.SLOW_PEERS.items()
        if heading_peers.installed(package)
    }
    for name, peer in peers.items():
        error = heading_peers.heading_error(simulated, t, peer(simulated, t))
        limit = 8.0 if name == "vision held" else 6.0 if "magnetometer" in name else 3.0
        assert degrees(np.sqrt((error**2).mean())) < limit, name


def test_it_runs_and_prints_what_is_asked_beside_what_is_measured() -> None:
    done = subprocess.run(
        [sys.executable, str(BENCHMARKS / "consistency.py"), "--runs", "1", "--seconds", "22"],
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert "1 runs of 22 s" in done.stdout
    for words in (
        "filter RMSE over oracle's",
        "mean NEES, lateral offset",
        "50 % gross",
        "camera's delay told as 60 +- 30 ms",
        "filterpy EKF without gates",
    ):
        assert words in done.stdout
