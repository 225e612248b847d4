"""The part of the frames' errors that successive frames have in common stays in the heading's sigma."""

from __future__ import annotations

from dataclasses import replace
from math import inf, nan, sqrt

import numpy as np
import pytest

from fusion import CorridorEstimator
from fusion.estimator.propagation import ImuSample
from fusion.offline.table_builder import TableBuilder
from tests.fusion.simulated import Scene, config_for, frame, give, simulate, wrap

MS = 1_000_000
SHARE = 0.45  # of a frame's sigma


def sigma_after(lasting_std_rad: float, std_rad: float = 0.01) -> float:
    """Return the heading's sigma after many frames of equal sigma, at rest."""
    estimator = CorridorEstimator(config_for(Scene(gyro_noise=1e-5)))
    for k in range(400):
        estimator.add_imu(k * 10 * MS, (0.0, 0.0, 0.0))
        if k % 5 == 0:
            seen = frame(0.1, std_rad, heading_lasting_std_rad=lasting_std_rad)
            estimator.add_measurement(k * 10 * MS, seen)
    found = estimator.estimate()
    assert estimator.covariance().variance("heading_rad") == pytest.approx(found.heading_std_rad**2)
    return found.heading_std_rad


def test_the_mean_of_many_frames_keeps_what_they_have_in_common() -> None:
    alone = sigma_after(0.0)
    assert alone < 0.003
    assert sigma_after(0.005) == pytest.approx(sqrt(alone**2 + 0.005**2))


@pytest.mark.parametrize("value", [nan, -0.005, 0.02, inf])
def test_a_part_that_is_none_of_the_whole_counts_as_zero(value: float) -> None:
    assert sigma_after(value) == sigma_after(0.0)


def normalised_errors(stated: bool) -> tuple[float, float]:
    """Return the mean square of error over sigma, of filter and smoother, over flights with a common error each."""
    squares: list[list[np.ndarray]] = [[], []]
    for seed in range(12):
        simulated = simulate(
            Scene(seed=seed, duration_s=10.0, gyro_hz=100.0, frame_hz=20.0, gyro_noise=0.003)
        )
        common = np.random.default_rng(seed).normal(0.0, SHARE)
        config = config_for(simulated.scene)
        builder = TableBuilder(config, (ImuSample,))
        estimator = CorridorEstimator(config, on_final=builder.take)
        for s in simulated.samples:
            if s.kind == "frame":
                (m,) = s.values
                truth = np.interp(s.t_ns * 1e-9, simulated.t_s, simulated.heading)
                white = float(wrap(m.heading_rad - truth)) * sqrt(1.0 - SHARE**2)
                seen = float(truth) + white + common * m.heading_std_rad
                part = SHARE * m.heading_std_rad if stated else 0.0
                s = replace(s, values=(replace(m, heading_rad=seen, heading_lasting_std_rad=part),))
            give(estimator, s)
        estimator.finish()
        builder.finish()
        for out, table in zip(squares, (builder.estimates(), builder.smoothed()), strict=True):
            truth = np.interp(table["timestamp_ns"] * 1e-9, simulated.t_s, simulated.heading)
            error = wrap(table["heading_rad"] - truth) / table["heading_std_rad"]
            out.append(error[len(error) // 5 :: 5] ** 2)
    return float(np.concatenate(squares[0]).mean()), float(np.concatenate(squares[1]).mean())


def test_sigmas_are_honest_about_errors_that_frames_have_in_common() -> None:
    assert normalised_errors(stated=True) == pytest.approx((1.0, 1.0), abs=0.4)
    assert min(normalised_errors(stated=False)) > 1.6
