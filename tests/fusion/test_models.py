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
    Y,
    heading_model,
    imu_yaw_model,
    imu_yaw_offset_model,
    lateral_model,
    level_yaw_rate,
)
from tests.fusion.process_model import propagate, transition
from vision.rotations import wrap, wrap_axis

NOISE = ProcessNoise(heading=0.0075, bias=3e-4, offset=0.009, v_std=0.4, v_time_s=0.8)
angles = st.floats(-50.0, 50.0)
compiling = settings(deadline=None)  # the first call may have to compile
states = st.tuples(angles, st.floats(-0.5, 0.5), angles, st.floats(-2, 2), st.floats(-2, 2)).map(np.array)
steps = st.floats(1e-4, 2.0)


def finite_difference(
    function: Callable[[np.ndarray], np.ndarray], x: np.ndarray, h: float = 1e-5
) -> np.ndarray:
    return np.stack([(function(x + h * e) - function(x - h * e)) / (2 * h) for e in np.eye(len(x))], axis=-1)


@compiling
@given(states, steps, st.floats(-1, 1), st.floats(-3, 3), st.floats(-1, 1))
def test_transition_is_the_derivative_of_the_propagation(
    x: np.ndarray, dt: float, turned: float, forward: float, sideways: float
) -> None:
    middle = x[PSI] + 0.5 * (turned - x[1] * dt)
    F, _ = transition(dt, NOISE, forward * cos(middle) - sideways * sin(middle))
    numeric = finite_difference(lambda s: propagate(s, dt, turned, NOISE, forward, sideways), x)
    np.testing.assert_allclose(F, numeric, atol=1e-6)


@compiling
@given(st.floats(1e-3, 2.0), st.floats(-3, 3))
def test_noise_is_that_of_the_continuous_model(dt: float, c: float) -> None:
    """Van Loan's integral of the continuous model, in a form that shares nothing with the closed one."""
    A = np.zeros((5, 5))
    A[0, 1], A[3, 0], A[3, 4], A[4, 4] = -1, c, 1, -1 / NOISE.v_time_s
    W = np.diag([NOISE.heading**2, NOISE.bias**2, NOISE.offset**2, 0, 2 * NOISE.v_std**2 / NOISE.v_time_s])
    big = expm(np.block([[-A, W], [np.zeros((5, 5)), A.T]]) * dt)
    F, Q = transition(dt, NOISE, c)
    np.testing.assert_allclose(F, big[5:, 5:].T, atol=1e-10)
    np.testing.assert_allclose(Q, big[5:, 5:].T @ big[:5, 5:], atol=1e-10)


@compiling
@given(states, steps, st.floats(-1, 1), st.floats(-3, 3), st.floats(-1, 1), st.floats(0, 0.1))
def test_one_call_is_the_three(
    x: np.ndarray, dt: float, turned: float, forward: float, sideways: float, gap: float
) -> None:
    A = np.random.default_rng(1).normal(size=(5, 5))
    P = A @ A.T
    ekf = CorridorEKF(x, P)
    ekf.advance(dt, turned, NOISE, forward, sideways, gap)
    x_next, F, Q_next, P_next = ekf.x, ekf.F, ekf.Q, ekf.P
    middle = x[PSI] + 0.5 * (turned - x[1] * dt)
    expected_F, Q = transition(dt, NOISE, forward * cos(middle) - sideways * sin(middle), gap)
    np.testing.assert_array_equal(x_next, propagate(x, dt, turned, NOISE, forward, sideways))
    np.testing.assert_allclose(F, expected_F, rtol=0, atol=1e-12)
    np.testing.assert_allclose(Q_next, Q, rtol=0, atol=1e-12)
    np.testing.assert_allclose(P_next, expected_F @ P @ expected_F.T + Q, rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal(P_next, P_next.T)


@compiling
@given(st.floats(1e-4, 0.5), st.floats(1e-4, 0.5), st.floats(-3, 3))
def test_two_steps_are_one(a: float, b: float, c: float) -> None:
    Fa, Qa = transition(a, NOISE, c)
    Fb, Qb = transition(b, NOISE, c)
    F, Q = transition(a + b, NOISE, c)
    np.testing.assert_allclose(F, Fb @ Fa, atol=1e-12)
    np.testing.assert_allclose(Q, Fb @ Qa @ Fb.T + Qb, atol=1e-12)


@pytest.mark.parametrize("dt", [1e-5, 5e-4, 0.005, 0.0399999, 0.0400001, 0.3, 5.0])
def test_noise_is_positive_at_any_step(dt: float) -> None:
    _, Q = transition(dt, NOISE, 0.7)
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
            [wrap_axis(model(x - h * e).residual - model(x + h * e).residual) / (2 * h) for e in np.eye(5)]
        )
        np.testing.assert_allclose(H, numeric, atol=1e-6)

    agrees(lambda s: heading_model(s, z, 1.0))
    agrees(lambda s: imu_yaw_model(s, z, 0.4, 1.0))
    if abs(cos(x[PSI])) > 1e-3:
        h = 1e-6
        model = [lateral_model(x + h * sign * np.eye(5)[Y], 0.3, 1.0) for sign in (-1, 1)]
        slope = (model[0].residual - model[1].residual) / (2 * h)
        assert slope == pytest.approx(model[0].H[Y], abs=1e-6)


def test_offset_model_leaves_everything_else_alone_and_counts_the_heading_as_noise() -> None:
    x, P = np.array([0.2, 0.0, 0.5, 0.0, 0.0]), np.diag([0.04, 1, 1, 1, 1.0])
    m = imu_yaw_offset_model(x, P, 1.0, 0.1, 0.01)
    assert m.residual == pytest.approx(1.0 - 0.2 - 0.1 - 0.5)
    assert pytest.approx(0.05) == m.R
    np.testing.assert_array_equal(m.H, [0, 0, 1, 0, 0])


@given(angles)
def test_wrapping(angle: float) -> None:
    assert -pi <= wrap(angle) < pi
    assert sin(wrap(angle)) == pytest.approx(sin(angle), abs=1e-9)
    assert -pi / 2 <= wrap_axis(angle) < pi / 2
    assert sin(2 * wrap_axis(angle)) == pytest.approx(sin(2 * angle), abs=1e-9)


def test_a_corridor_looks_alike_from_both_ends() -> None:
    facing_back = np.array([pi - 0.1, 0, 0, 0.3, 0])
    assert heading_model(facing_back, -0.1, 1.0).residual == pytest.approx(0, abs=1e-12)
    assert lateral_model(facing_back, -0.3, 1.0).residual == pytest.approx(0, abs=1e-12)
