"""A camera that slips in its mount looks like a bend: sigma must contain both, and nothing else may widen it."""

from __future__ import annotations

from math import degrees, exp, radians

import numpy as np
import pytest

from fusion.estimator.estimator import CorridorEstimator
from fusion.estimator.faults import Fault
from fusion.estimator.frame_drift import HeadingComparison
from fusion.estimator.mount_slip import MEMORY_S, PAUSE_NS, SLIP_STD_RAD, SLIPPED, MountSlip
from tests.fusion.simulated import Function, Scene, config_for, give, simulate, weaving

START_S, END_S = 10.0, 30.0


def ramp(deg_per_s: float, most_deg: float = 8.0) -> Function:
    """An angle that changes from `START_S` on."""
    most_s = most_deg / abs(deg_per_s)
    return lambda t: radians(deg_per_s) * np.clip(np.asarray(t, float) - START_S, 0.0, most_s)


def flown(
    seed: int, *, slip: float = 0.0, bend: float = 0.0, steel: float = 0.0, knock_deg: float = 0.0
) -> np.ndarray:
    """Fly with a slip, bend or pull of the yaw at these rates: time, error, sigma in degrees, contested (n, 4)."""
    none = ramp(1.0, 0.0)
    of_camera, of_axis, of_yaw = (ramp(rate) if rate else none for rate in (slip, bend, steel))
    heading = weaving(seed, radians(10))
    scene = Scene(
        duration_s=END_S,
        seed=seed,
        heading=lambda t: heading(t) + of_axis(t),
        axis=lambda t: of_axis(t) - of_camera(t) - radians(knock_deg) * (np.asarray(t) > START_S),
        frame_sigma_rad=(radians(0.3), radians(0.3)),
        gyro_hz=100.0,
        gyro_noise=0.003,
        frame_hz=15.0,
        attitude_hz=50.0,
        yaw_offset=lambda t: 0.7 + of_yaw(t),
    )
    estimator = CorridorEstimator(config_for(scene))
    rows = []
    for sample in simulate(scene).samples:
        give(estimator, sample)
        if sample.kind == "frame":
            now, t = estimator.estimate(), sample.t_ns * 1e-9
            error = now.heading_rad - float(heading(np.array(t)))
            contested = bool(now.faults & Fault.HEADING_CONTESTED)
            rows.append((t, degrees(error), degrees(now.heading_std_rad), contested))
    return np.array(rows)


@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize("slip", [-2.0, 0.8, -0.8])
def test_sigma_contains_a_slip_and_it_is_reported(slip: float, seed: int) -> None:
    t, error, sigma, contested = flown(seed, slip=slip).T
    assert 0.0 < t[(contested > 0.0) & (t > START_S)][0] - START_S < (3.0 if abs(slip) < 1.0 else 1.5)
    after = t > START_S + 8.0 / abs(slip) + 2.0
    assert np.abs(error[after]).mean() == pytest.approx(8.0, abs=0.6)
    assert np.median(np.abs(error[after]) / sigma[after]) < 6.0


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("knock_deg", [-12.0, 6.0])
def test_sigma_contains_a_knock_once_it_is_accepted(knock_deg: float, seed: int) -> None:
    t, error, sigma, _ = flown(seed, knock_deg=knock_deg).T
    assert np.abs(error[(t > START_S) & (t < START_S + 5.0)]).max() < 1.5
    after = np.abs(error) > 0.5 * abs(knock_deg)
    assert after[-1]
    assert (np.abs(error[after]) / sigma[after]).max() < 5.5


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("bend", [-0.8, 2.0])
def test_a_bend_leaves_the_heading_as_it_is(bend: float, seed: int) -> None:
    t, error, sigma, _ = flown(seed, bend=bend).T
    known = t > 1.0
    assert np.sqrt(np.mean(error[known] ** 2)) < 0.3
    assert sigma.max(where=known, initial=0.0) < 4.5


@pytest.mark.parametrize("steel", [0.0, 0.8, -3.0])
def test_a_yaw_that_drifts_by_itself_widens_nothing(steel: float) -> None:
    t, error, sigma, contested = flown(3, steel=steel).T
    known = t > 2.0
    assert np.abs(error[known]).max() < 0.6
    assert sigma[known].max() < 0.4
    assert not contested[known].any()


def at(t_s: float, heading_deg: float) -> HeadingComparison:
    return HeadingComparison(round(t_s * 1e9), radians(heading_deg), 0.01, 0.0, 0.5, True)


def test_the_angle_is_measured_from_where_the_drift_began() -> None:
    """Found again after a pause shorter than `PAUSE_NS`, it is the same drift; after a longer one the next."""
    slip = MountSlip().with_drift((at(0.0, 1.0), at(2.0, 3.0)))
    assert slip.angle_rad == pytest.approx(radians(2.0))
    slip = slip.with_drift((at(5.0, 5.0), at(6.0, 7.0)))
    assert slip.angle_rad == pytest.approx(radians(6.0))
    later_s = 7.0 + PAUSE_NS * 1e-9
    slip = slip.with_drift((at(later_s, 4.0), at(later_s + 1.0, 3.0)))
    assert slip.angle_rad == pytest.approx(radians(5.0))
    assert slip.faded(MEMORY_S).angle_rad == pytest.approx(radians(5.0) * exp(-1.0))


def test_no_mount_gives_way_by_a_right_angle() -> None:
    def of(deg: float) -> float:
        return MountSlip(radians(deg)).std_rad

    assert of(0.0) == 0.0
    assert of(-3.0) == of(3.0) == pytest.approx(radians(3.0) * SLIPPED**0.5, rel=0.02)
    assert max(of(deg) for deg in range(90)) == pytest.approx(of(degrees(SLIP_STD_RAD) * 2**0.5), rel=0.01)
    assert of(90.0) < radians(0.01)
