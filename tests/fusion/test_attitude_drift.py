"""Attitude without a gyroscope: innovations of one sign are no noise, and are neither averaged nor kept silent."""

from __future__ import annotations

from dataclasses import replace
from math import degrees, pi, radians

import numpy as np
import pytest

from fusion import CorridorEstimator
from fusion.estimator.attitude_drift import MAX_DENSITY, AttitudeDrift
from fusion.estimator.faults import Fault
from fusion.estimator.models import Gate
from tests.fusion.simulated import Function, Scene, config_for, drifting, give, simulate, weaving, wrap

MS = 1_000_000
TRUE = weaving(3, radians(25), 4.0)
Row = tuple[float, float, float, Fault]  # time s, error and sigma of the heading in degrees, faults


def fly(
    yaw: Function | None = None, frames_late_s: float = 0.0, seed: int = 3, rate_hz: float = 25.0
) -> list[Row]:
    """Fly with attitude and frames alone; ``yaw`` is the attitude's yaw instead of the true one."""
    offset = (
        (lambda t: 0.7 + yaw(t) - TRUE(t)) if yaw else (lambda t: np.full_like(np.asarray(t, float), 0.7))
    )
    scene = Scene(
        seed=seed,
        heading=TRUE,
        gyro_noise=0.004,
        attitude_hz=50,
        yaw_offset=offset,
        frame_hz=rate_hz,
        frame_sigma_rad=(radians(0.2), radians(0.5)),
    )
    estimator, rows = CorridorEstimator(config_for(scene)), []
    for s in simulate(scene).samples:
        if s.kind == "imu":
            continue
        late_ns = round(frames_late_s * 1e9) if s.kind == "frame" else 0
        give(estimator, replace(s, t_ns=s.t_ns + late_ns))
        if s.kind == "frame" and s.t_ns > 2000 * MS:
            e = estimator.estimate()
            t_s = e.timestamp_ns * 1e-9
            error = degrees(float(wrap(e.heading_rad - TRUE(np.array(t_s)))))
            rows.append((t_s, abs(error), degrees(e.heading_std_rad), e.faults))
    return rows


def silent_s(rows: list[Row]) -> float:
    """Longest time for which the heading was off by more than four sigma and no fault was reported."""
    longest, since = 0.0, None
    for t_s, error, sigma, faults in rows:
        if error > 4.0 * sigma and not faults:
            since = t_s if since is None else since
            longest = max(longest, t_s - since)
        else:
            since = None
    return longest


@pytest.mark.parametrize(
    "yaw",
    [
        lambda t: TRUE(np.asarray(t) - 0.5),
        lambda t: TRUE(np.asarray(t) - 0.2),
        lambda t: TRUE(np.minimum(t, 6.0)),
        lambda t: -TRUE(t),
    ],
    ids=["0.5 s late", "0.2 s late", "frozen", "wrong sign"],
)
def test_a_wrong_yaw_is_told_and_the_heading_follows_the_frames(yaw: Function) -> None:
    rows = fly(yaw)
    assert silent_s(rows) < 0.3
    assert any(faults & Fault.HEADING_CONTESTED for *_, faults in rows)
    assert np.sqrt(np.mean([(error / sigma) ** 2 for _, error, sigma, _ in rows])) < 2.0


def test_frames_stamped_late_are_told_and_in_the_sigma() -> None:
    rows = fly(frames_late_s=0.3)
    assert silent_s(rows) < 0.3
    assert np.sqrt(np.mean([(error / sigma) ** 2 for _, error, sigma, _ in rows])) < 2.5
    assert any(faults & Fault.HEADING_CONTESTED for *_, faults in rows)


@pytest.mark.parametrize("seed", [1, 2, 3, 4, 5])
@pytest.mark.parametrize("rate_hz", [5.0, 25.0])
def test_a_sound_attitude_is_not_accused(seed: int, rate_hz: float) -> None:
    rows = fly(seed=seed, rate_hz=rate_hz)
    assert not any(faults for *_, faults in rows)
    assert max(sigma for _, _, sigma, _ in rows) < 1.0


def test_a_yaw_at_random_leaves_a_filter_that_recovers() -> None:
    noise = drifting(1, 3.0, 0.05, 20.0)
    rows = fly(lambda t: TRUE(t) + np.where(np.asarray(t) < 8.0, 4.0 * noise(t), 0.0))
    _, error, sigma, _ = rows[-1]
    assert min(error, 180.0 - error) < 1.0  # such a yaw does not tell which way the vehicle faces
    assert sigma < 10.0


def innovation(residual_rad: float) -> Gate:
    return Gate(True, residual_rad, 0.0, radians(0.5) ** 2)


def test_a_steady_innovation_widens_the_heading_and_white_ones_do_not() -> None:
    drift, widened = AttitudeDrift(), 0.0
    for _ in range(25):
        drift, variance = drift.with_innovation(innovation(radians(1.0)), 0.04, 0.0)
        widened += variance
    assert drift.undecided_std_rad > radians(0.5)
    assert widened > radians(0.5) ** 2
    rng = np.random.default_rng(0)
    drift = AttitudeDrift()
    for value in rng.normal(0.0, radians(0.5), 2000):
        drift, variance = drift.with_innovation(innovation(float(value)), 0.04, 0.0)
        assert variance == 0.0


def test_the_drift_is_bounded_and_forgotten() -> None:
    drift = AttitudeDrift()
    for _ in range(200):
        drift, _ = drift.with_innovation(innovation(pi / 2), 0.04, 0.0)
    assert drift.density == MAX_DENSITY
    for k in range(1500):
        drift, _ = drift.with_innovation(innovation(radians(0.1) * (-1) ** k), 0.04, 0.0)
    assert drift.undecided_std_rad < radians(1.5)
    assert drift.interrupted().density == drift.density
