from __future__ import annotations

from collections.abc import Callable
from math import cos, pi, sin

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from fusion.estimator.ekf import CorridorEKF
from fusion.estimator.models import (
    PSI,
    ProcessNoise,
    ScalarMeasurement,
    heading_model,
    imu_yaw_model,
    imu_yaw_offset_model,
    level_yaw_rate,
)
from tests.fusion.process_model import propagate, transition
from vision.rotations import wrap, wrap_axis

NOISE = ProcessNoise(heading=0.0075, bias=3e-4, offset=0.009)
angles = st.floats(-50.0, 50.0)
compiling = settings(deadline=None)  # the first call may have to compile
states = st.tuples(angles, st.floats(-0.5, 0.5), angles).map(np.array)
steps = st.floats(1e-4, 2.0)


@compiling
@given(st.floats(1e-3, 2.0))
def test_noise_is_that_of_the_continuous_model(dt: float) -> None:
    """Van Loan's integral of the continuous model, in a form that shares nothing with the closed one."""
    A = np.zeros((3, 3))
    A[0, 1] = -1
    W = np.diag([NOISE.heading**2, NOISE.bias**2, NOISE.offset**2])
    big = expm(np.block([[-A, W], [np.zeros((3, 3)), A.T]]) * dt)
    F, Q = transition(dt, NOISE)
    np.testing.assert_allclose(F, big[3:, 3:].T, atol=1e-10)
    np.testing.assert_allclose(Q, big[3:, 3:].T @ big[:3, 3:], atol=1e-10)


@compiling
@given(states, steps, st.floats(-1, 1), st.floats(0, 0.1))
def test_one_call_is_the_three(x: np.ndarray, dt: float, turned: float, gap: float) -> None:
    A = np.random.default_rng(1).normal(size=(3, 3))
    P = A @ A.T
    ekf = CorridorEKF(x, P)
    ekf.advance(dt, turned, NOISE, gap)
    x_next, F, Q_next, P_next = ekf.x, ekf.F, ekf.Q, ekf.P
    expected_F, Q = transition(dt, NOISE, gap)
    np.testing.assert_allclose(x_next, propagate(x, dt, turned), rtol=0, atol=1e-12)
    np.testing.assert_allclose(F, expected_F, rtol=0, atol=1e-12)
    np.testing.assert_allclose(Q_next, Q, rtol=0, atol=1e-12)
    np.testing.assert_allclose(P_next, expected_F @ P @ expected_F.T + Q, rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal(P_next, P_next.T)


@compiling
@given(st.floats(1e-4, 0.5), st.floats(1e-4, 0.5))
def test_two_steps_are_one(a: float, b: float) -> None:
    Fa, Qa = transition(a, NOISE)
    Fb, Qb = transition(b, NOISE)
    F, Q = transition(a + b, NOISE)
    np.testing.assert_allclose(F, Fb @ Fa, atol=1e-12)
    np.testing.assert_allclose(Q, Fb @ Qa @ Fb.T + Qb, atol=1e-12)


@pytest.mark.parametrize("dt", [1e-5, 5e-4, 0.005, 0.0399999, 0.0400001, 0.3, 5.0])
def test_noise_is_positive_at_any_step(dt: float) -> None:
    _, Q = transition(dt, NOISE)
    scale = np.sqrt(np.diag(Q))
    assert (np.linalg.eigvalsh(Q / np.outer(scale, scale)) > 0).all()
    np.testing.assert_array_equal(Q, Q.T)


def test_a_gap_adds_to_the_heading_only() -> None:
    _, without = transition(0.01, NOISE)
    _, gap = transition(0.01, NOISE, heading_variance=0.3)
    difference = gap - without
    assert difference[PSI, PSI] == pytest.approx(0.3)
    difference[PSI, PSI] = 0
    np.testing.assert_array_equal(difference, 0)


@given(st.floats(-1.3, 1.3), st.floats(-1.3, 1.3), st.tuples(*[st.floats(-5, 5)] * 3))
def test_level_rate_is_the_euler_rate(roll: float, pitch: float, gyro: tuple[float, float, float]) -> None:
    down = (-sin(pitch), sin(roll) * cos(pitch), cos(roll) * cos(pitch))
    expected = (gyro[1] * sin(roll) + gyro[2] * cos(roll)) / cos(pitch)
    assert level_yaw_rate(gyro, down) == pytest.approx(expected, abs=1e-9)


def test_level_rate_stays_finite_when_yaw_has_no_meaning() -> None:
    assert abs(level_yaw_rate((1.0, 1.0, 1.0), (-1.0, 0.0, 0.0))) < 10


@given(states, angles)
def test_measurement_derivatives(x: np.ndarray, z: float) -> None:
    def agrees(model: Callable[[np.ndarray], ScalarMeasurement]) -> None:
        H = model(x).H
        h = 1e-6
        numeric = np.array(
            [wrap_axis(model(x - h * e).residual - model(x + h * e).residual) / (2 * h) for e in np.eye(3)]
        )
        np.testing.assert_allclose(H, numeric, atol=1e-6)

    agrees(lambda s: heading_model(s, z, 1.0))
    agrees(lambda s: imu_yaw_model(s, z, 0.4, 1.0))


def test_offset_model_leaves_everything_else_alone_and_counts_the_heading_as_noise() -> None:
    x, P = np.array([0.2, 0.0, 0.5]), np.diag([0.04, 1, 1.0])
    m = imu_yaw_offset_model(x, P, 1.0, 0.1, 0.01)
    assert m.residual == pytest.approx(1.0 - 0.2 - 0.1 - 0.5)
    assert pytest.approx(0.05) == m.R
    np.testing.assert_array_equal(m.H, [0, 0, 1])


@given(angles)
def test_wrapping(angle: float) -> None:
    assert -pi <= wrap(angle) < pi
    assert sin(wrap(angle)) == pytest.approx(sin(angle), abs=1e-9)
    assert -pi / 2 <= wrap_axis(angle) < pi / 2
    assert sin(2 * wrap_axis(angle)) == pytest.approx(sin(2 * angle), abs=1e-9)


def test_a_corridor_looks_alike_from_both_ends() -> None:
    facing_back = np.array([pi - 0.1, 0, 0])
    assert heading_model(facing_back, -0.1, 1.0).residual == pytest.approx(0, abs=1e-12)
