"""Who is wrong: known answers for the decision, and for the slopes and means it is taken from."""

from __future__ import annotations

from math import nan, radians

import numpy as np
import pytest

from fusion.estimator.hypotheses import (
    MIN_POINTS,
    Evidence,
    Hypothesis,
    Innovations,
    Sight,
    Slope,
    judge,
    slopes,
    with_sight,
)

QUIET = (0.003, 0.003)  # rad/sqrt(s), gyroscope and IMU yaw


def slope(deg_per_s: float, std_deg_per_s: float = 0.3, misfit: float = 1.0) -> Slope:
    return Slope(radians(deg_per_s), radians(std_deg_per_s), 0.0, 0.01, misfit, 30)


def verdict_of(gyro: Slope, yaw: Slope | None, before: Hypothesis = Hypothesis.WELL) -> Hypothesis:
    return judge(Evidence(gyro, yaw, radians(0.3), False), before).likeliest


def sights(
    seconds: float, drift: float = 0.0, turn: float = 0.0, yaw_follows: bool = True
) -> tuple[Sight, ...]:
    """Thirty frames a second of 0.5 degree; the gyroscope has a drift (rad/s), the vehicle turns (rad/s)."""
    rng = np.random.default_rng(1)
    made = []
    for k in range(round(30 * seconds) + 1):
        t = k / 30
        heading = turn * t + rng.normal(0.0, radians(0.5))
        yaw = 0.7 + (turn if yaw_follows else turn + drift) * t
        made.append(Sight(round(t * 1e9), heading, radians(0.5), (turn + drift) * t, yaw, True))
    return tuple(made)


@pytest.mark.parametrize(
    ("gyro", "yaw", "who"),
    [
        (slope(0.1), slope(0.1), Hypothesis.WELL),
        (slope(0.1), None, Hypothesis.WELL),
        (slope(5.0), slope(0.1), Hypothesis.GYRO),
        (slope(5.0), None, Hypothesis.GYRO),
        (slope(-5.0), slope(-5.0), Hypothesis.BEND),
        (slope(0.1), slope(8.0), Hypothesis.WELL),  # steel pulls the IMU's yaw away
        (slope(180.0), slope(0.1), Hypothesis.SPIKE),
        (slope(5.0, misfit=6.0), None, Hypothesis.SPIKE),  # on no line
    ],
)
def test_known_answers(gyro: Slope, yaw: Slope | None, who: Hypothesis) -> None:
    assert verdict_of(gyro, yaw) is who
    mirrored = gyro._replace(rate_rad_s=-gyro.rate_rad_s)
    assert verdict_of(mirrored, yaw and yaw._replace(rate_rad_s=-yaw.rate_rad_s)) is who


def test_probabilities_add_up_to_one() -> None:
    for rate in (0.0, 0.5, 1.0, 3.0, 300.0, 1e4):
        verdict = judge(Evidence(slope(rate), slope(0.5 * rate), 0.01, False))
        assert sum(verdict.probabilities) == pytest.approx(1.0)
        assert all(0.0 <= p <= 1.0 for p in verdict.probabilities)


def test_frames_that_jump_show_another_axis_and_too_few_show_nothing() -> None:
    assert judge(Evidence(None, None, 0.01, True)).of(Hypothesis.AXIS) == 1.0
    assert judge(Evidence(None, None, 0.01, False)).of(Hypothesis.WELL) == 1.0


def test_what_was_found_goes_on_by_weaker_evidence_and_ends_without() -> None:
    weak, none = slope(1.0), slope(0.0)
    assert verdict_of(weak, None) is Hypothesis.WELL
    assert verdict_of(weak, None, Hypothesis.GYRO) is Hypothesis.GYRO
    assert verdict_of(none, None, Hypothesis.GYRO) is Hypothesis.WELL


def test_the_slope_is_the_drift_whatever_the_vehicle_turns() -> None:
    drift = radians(4.0)
    for turn in (0.0, radians(30.0)):
        seen = sights(1.0, drift, turn)
        gyro, yaw = slopes(seen, 1.0, turn, 0.0, QUIET)
        assert gyro is not None
        assert yaw is not None
        assert gyro.rate_rad_s == pytest.approx(-drift, abs=3 * gyro.rate_std)
        assert yaw.rate_rad_s == pytest.approx(0.0, abs=3 * yaw.rate_std)
        assert gyro.rate_std < radians(0.6)


def test_a_known_bias_is_no_slope() -> None:
    gyro, _ = slopes(sights(1.0, radians(4.0)), 1.0, 0.0, radians(4.0), QUIET)
    assert gyro is not None
    assert gyro.rate_rad_s == pytest.approx(0.0, abs=3 * gyro.rate_std)


def test_no_slope_without_frames_that_follow_each_other() -> None:
    seen = sights(1.0)
    assert slopes(seen[: MIN_POINTS - 1], 1.0, 0.0, 0.0, QUIET) == (None, None)
    half = tuple(s._replace(linked=k % 2 == 0) for k, s in enumerate(seen))
    assert slopes(half, 1.0, 0.0, 0.0, QUIET) == (None, None)
    assert slopes(tuple(s._replace(yaw_rad=nan) for s in seen), 1.0, 0.0, 0.0, QUIET)[1] is None


def test_sights_are_spaced_and_let_go() -> None:
    kept: tuple[Sight, ...] = ()
    for s in sights(5.0):
        kept = with_sight(kept, s, 30_000_000)
    assert kept[-1].t_ns - kept[0].t_ns <= 3_000_000_000
    assert with_sight(kept, kept[-1]._replace(t_ns=kept[-1].t_ns + 1000), 30_000_000) == kept


@pytest.mark.parametrize("rho", [0.0, 0.5])
def test_one_sided_innovations_are_systematic_and_white_ones_are_not(rho: float) -> None:
    rng = np.random.default_rng(0)
    white, one_sided, z = Innovations(), Innovations(), 0.0
    sigmas, found = [], 0
    for _ in range(3000):
        z = rho * z + np.sqrt(1 - rho * rho) * rng.normal()
        white = white.with_innovation(z, 1 / 30, rho)
        found += white.systematic
        sigmas.append((white.short_sigmas, white.long_sigmas))
    assert found < 10
    assert np.std(np.array(sigmas)[300:], axis=0) == pytest.approx([1.0, 1.0], rel=0.35)
    for k in range(30):
        one_sided = one_sided.with_innovation(2.0, 1 / 30, rho)
        assert not (one_sided.systematic and k < 2)
    assert one_sided.systematic


def test_a_gross_error_is_not_systematic() -> None:
    assert not Innovations().with_innovation(1000.0, 1 / 30, 0.0).with_innovation(0.0, 1 / 30, 0.0).systematic
