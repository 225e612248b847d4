from __future__ import annotations

import numpy as np
import pytest
from filterpy.kalman import ExtendedKalmanFilter
from hypothesis import given, settings
from hypothesis import strategies as st

from fusion.estimator.ekf import CorridorEKF
from fusion.estimator.filterpy_ekf import FilterpyEKF
from fusion.estimator.models import ProcessNoise, ScalarMeasurement
from tests.fusion.process_model import propagate, transition

NOISE = ProcessNoise(0.0075, 1e-4, 0.009)


def random_filter(seed: int) -> tuple[CorridorEKF, np.random.Generator]:
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(3, 3))
    return CorridorEKF(rng.normal(size=3), A @ A.T + 0.1 * np.eye(3)), rng


def theirs_like(ekf: CorridorEKF) -> ExtendedKalmanFilter:
    """filterpy's own filter in the same state."""
    theirs = ExtendedKalmanFilter(3, 1)
    theirs.x, theirs.P = ekf.x.copy(), ekf.P.copy()
    return theirs


def assert_same(ekf: CorridorEKF, theirs: ExtendedKalmanFilter, *names: str) -> None:
    for name in names:
        ours, expected = getattr(ekf, name), getattr(theirs, name)
        assert np.shape(ours) == np.shape(expected), name
        size = max(1.0, float(np.abs(expected).max()))
        np.testing.assert_allclose(ours, expected, rtol=0, atol=1e-12 * size, err_msg=name)


seeds = st.integers(0, 1_000_000)


@settings(deadline=None)  # the first filter may have to compile
@given(seeds, st.floats(-4.0, 1.0))
def test_update_equals_filterpys(seed: int, decade: float) -> None:
    core, rng = random_filter(seed)
    H, R, residual = rng.normal(size=3), 10.0**decade, float(rng.normal())
    ekf, theirs = FilterpyEKF(core), theirs_like(core)
    assert ekf.likelihood > 0.0  # of no measurement yet; must not be kept
    z = float(H @ theirs.x) + residual
    theirs.update(np.array([z]), lambda x: H[None, :], lambda x: H[None, :] @ x, R=R)
    gate = ekf.update(ScalarMeasurement(residual, H, R))
    assert gate.accepted
    assert_same(ekf, theirs, "x", "P", "x_post", "P_post", "K", "y", "S", "SI")
    assert ekf.mahalanobis == pytest.approx(theirs.mahalanobis, rel=1e-9)
    assert ekf.log_likelihood == pytest.approx(theirs.log_likelihood, rel=1e-9)
    assert ekf.likelihood == pytest.approx(theirs.likelihood, rel=1e-9)


@settings(deadline=None)
@given(seeds)
def test_predict_equals_filterpys(seed: int) -> None:
    ekf, rng = random_filter(seed)
    F, B = rng.normal(size=(3, 3)), rng.normal(size=(3, 3))
    Q = B @ B.T
    theirs = theirs_like(ekf)
    theirs.F, theirs.Q = F, Q
    theirs.predict()
    ekf.predict(F @ ekf.x, F, Q)
    assert_same(ekf, theirs, "x", "P", "x_prior", "P_prior", "F", "Q")


@settings(deadline=None)
@given(seeds, st.floats(1e-4, 0.5), st.floats(-1, 1))
def test_a_step_of_the_process_model_equals_filterpys_prediction(seed: int, dt: float, turned: float) -> None:
    ekf, _ = random_filter(seed)
    theirs = theirs_like(ekf)
    x_next = propagate(ekf.x, dt, turned)
    ekf.advance(dt, turned, NOISE)
    theirs.F, theirs.Q = ekf.F, ekf.Q
    theirs.predict_x = lambda u=0: setattr(theirs, "x", x_next)  # as filterpy asks for non-linear models
    theirs.predict()
    assert_same(ekf, theirs, "x", "P", "x_prior", "P_prior")


def test_many_steps_stay_filterpys() -> None:
    ekf, rng = random_filter(3)
    theirs = theirs_like(ekf)
    for _ in range(200):
        ekf.advance(0.005, float(rng.normal(0, 0.01)), NOISE)
        theirs.F, theirs.Q = ekf.F.copy(), ekf.Q.copy()
        theirs.predict_x = lambda u=0: setattr(theirs, "x", ekf.x_prior.copy())
        theirs.predict()
        H, residual = np.eye(3)[rng.integers(3)], float(rng.normal(0, 0.1))
        z = float(H @ theirs.x) + residual
        theirs.update(np.array([z]), lambda x, H=H: H[None, :], lambda x, H=H: H[None, :] @ x, R=0.01)
        ekf.update(ScalarMeasurement(residual, H, 0.01))
    np.testing.assert_allclose(ekf.P, theirs.P, rtol=0, atol=1e-12)
    np.testing.assert_allclose(ekf.x, theirs.x, rtol=0, atol=1e-12)


def test_every_change_is_noted_for_the_smoother() -> None:
    ekf, _ = random_filter(4)
    x0, P0 = ekf.x, ekf.P
    ekf.update(ScalarMeasurement(0.1, np.eye(3)[0], 1.0))  # before anything moves
    ekf.advance(0.01, 0.0, NOISE)
    ekf.update(ScalarMeasurement(0.1, np.eye(3)[1], 1.0))
    ekf.correct(ekf.x + 0.1)
    ekf.widen(2, 4.0)
    first, moved, widened = ekf.nodes
    assert first.F is None
    assert first.x_prior is x0
    assert first.P_prior is P0
    assert moved.x_prior is not moved.x
    np.testing.assert_array_equal(moved.x, widened.x_prior)
    np.testing.assert_array_equal(widened.P, moved.P + 4.0 * np.diag([0, 0, 1.0]))
    assert widened.x is ekf.x
    assert widened.P is ekf.P
    ekf.load(ekf.x, ekf.P)
    assert ekf.nodes == []


def test_advance_is_a_prediction_by_the_process_model() -> None:
    ekf, _ = random_filter(1)
    twin = CorridorEKF(ekf.x, ekf.P)
    F, Q = transition(0.01, NOISE, 0.1)
    twin.predict(propagate(ekf.x, 0.01, 0.02), F, Q)
    ekf.advance(0.01, 0.02, NOISE, 0.1)
    np.testing.assert_allclose(ekf.x, twin.x, rtol=1e-14)
    np.testing.assert_allclose(ekf.P, twin.P, rtol=1e-12)


@pytest.mark.parametrize(
    "measurement",
    [
        None,
        ScalarMeasurement(float("nan"), np.eye(3)[0], 1.0),
        ScalarMeasurement(0.1, np.eye(3)[0], float("nan")),
    ],
)
def test_no_number_changes_nothing_and_leaves_no_old_innovation(
    measurement: ScalarMeasurement | None,
) -> None:
    ekf, _ = random_filter(2)
    ekf.update(ScalarMeasurement(0.3, np.eye(3)[0], 1.0))
    x, P = ekf.x, ekf.P
    gate = ekf.update(measurement)
    assert not gate.accepted
    assert ekf.x is x
    assert ekf.P is P
    assert np.isnan(gate.test_ratio)
    assert np.isnan(ekf.y).all()


def test_gate_is_the_innovation_squared_over_gate_squared() -> None:
    ekf = CorridorEKF(np.zeros(3), np.eye(3) * 3.0)
    inside = ekf.update(ScalarMeasurement(3.99, np.eye(3)[0], 1.0), gate_sigma=2.0, R=100.0)
    assert inside.accepted
    assert inside.test_ratio == pytest.approx(3.99**2 / (4 * 4))
    ekf = CorridorEKF(np.zeros(3), np.eye(3) * 3.0)
    outside = ekf.update(ScalarMeasurement(4.01, np.eye(3)[0], 1.0), gate_sigma=2.0)
    assert not outside.accepted
    assert outside.test_ratio > 1.0
    np.testing.assert_array_equal(ekf.x, 0)


def test_larger_variance_for_the_update_only() -> None:
    ekf = CorridorEKF(np.zeros(3), np.eye(3))
    ekf.update(ScalarMeasurement(1.0, np.eye(3)[0], 1.0), gate_sigma=3.0, R=3.0)
    assert ekf.x[0] == pytest.approx(0.25)
    assert ekf.P[0, 0] == pytest.approx(0.75)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 1000))
def test_covariance_stays_symmetric_and_positive(seed: int) -> None:
    ekf, rng = random_filter(seed)
    F, Q = transition(0.005, NOISE)
    for _ in range(300):
        ekf.predict(propagate(ekf.x, 0.005, 0.0), F, Q)
        H = np.eye(3)[rng.integers(3)]
        ekf.update(ScalarMeasurement(float(rng.normal()), H, float(10 ** rng.uniform(-9, 2))))
    np.testing.assert_array_equal(ekf.P, ekf.P.T)
    scale = np.sqrt(np.diag(ekf.P))
    assert (np.linalg.eigvalsh(ekf.P / np.outer(scale, scale)) > -1e-9).all()
    assert (scale > 0).all()
