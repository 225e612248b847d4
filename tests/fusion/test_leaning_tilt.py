"""Without an attitude the tilt leans after the vehicle's own accelerations: the offset's sigma contains that."""

from __future__ import annotations

from math import pi

import numpy as np
import pytest

from fusion import CorridorEstimator, FusionConfig
from tests.fusion.simulated import frame

MS = 1_000_000
HALF_M = 1.1


@pytest.mark.parametrize("silent_s", [0.0, 8.0])
@pytest.mark.parametrize("period_s", [4.0, 7.0])
@pytest.mark.parametrize("seed", [0, 1])
def test_a_vehicle_that_weaves_without_an_attitude_knows_its_offset(
    silent_s: float, period_s: float, seed: int
) -> None:
    """The attitude falls silent at ``silent_s``; NEES counts from half a second later, when the tilt notices."""
    rng = np.random.default_rng(seed)
    estimator = CorridorEstimator(FusionConfig(corridor_width_m=2 * HALF_M))
    turn, phase = 2 * pi / period_s, rng.uniform(0.0, 2 * pi)
    known, ratios = [], []
    for k in range(2000):
        t_s, t_ns = 0.01 * k, k * 10 * MS
        y, rate = 0.45 * np.sin(turn * t_s + phase), 0.45 * turn * np.cos(turn * t_s + phase)  # metres
        force = (rng.normal(0.0, 0.08), rng.normal(-turn * turn * y, 0.08), rng.normal(-9.81, 0.08))
        estimator.add_imu(t_ns, tuple(rng.normal(0.0, 0.02, 3).tolist()), force)
        if k % 4 == 1 and t_s < silent_s:
            estimator.add_attitude(t_ns, (1.0, 0.0, 0.0, 0.0))
        if k % 4 == 2:
            estimator.add_measurement(
                t_ns, frame(rng.normal(0.0, 0.003), 0.003, rng.normal(y / HALF_M, 0.03), 0.03)
            )
        if k % 10 == 9 and t_s > max(silent_s + 0.5, 2.0):
            e = estimator.estimate()
            known.append(e.lateral_status == "known")
            if known[-1]:
                offset = (e.lateral_offset_norm - y / HALF_M) / e.lateral_offset_norm_std
                drift = (e.lateral_velocity_norm_s - rate / HALF_M) / e.lateral_velocity_norm_s_std
                ratios.append((offset**2, drift**2))
    assert np.mean(known) > 0.9
    assert (np.mean(ratios, axis=0) < 1.3).all()
