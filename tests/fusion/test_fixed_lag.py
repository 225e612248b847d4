"""The smoother in flight says what the offline one would, had the flight ended at that moment."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import fields
from math import degrees, isnan, radians
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from fusion.estimator.config import FusionConfig
from fusion.estimator.estimate import Estimate
from fusion.estimator.estimator import CorridorEstimator
from fusion.estimator.propagation import ImuSample
from fusion.estimator.tables import ESTIMATE_DTYPE, Table
from fusion.offline.table_builder import TableBuilder
from tests.fusion.simulated import Scene, Simulated, config_for, give, plus, simulate, turning, weaving, wrap
from vision.errors import InputError

MS = 1_000_000
TURN = radians(80)
SIMULATED = simulate(
    Scene(
        duration_s=8.0,
        seed=5,
        heading=plus(weaving(5, radians(8)), turning((4.0, 1.2, TURN))),
        axis=lambda t: np.where(np.asarray(t) < 4.6, 0.0, TURN),
        gyro_hz=100,
        frame_hz=20,
        gross=0.05,
        attitude_hz=25,
        dropouts=[(2.0, 2.8)],
        delay_s=0.06,
    )
)


def until(end_ns: int, lag_s: float, **config: Any) -> tuple[Estimate, Table]:
    """The fixed-lag estimate once all samples that arrived by then are in, and the offline table of the same ones."""
    settings_ = config_for(SIMULATED.scene, fixed_lag_s=lag_s, **config)
    tables = TableBuilder(settings_, (ImuSample,))
    estimator = CorridorEstimator(settings_, on_final=tables.take)
    for sample in SIMULATED.samples:
        if sample.arrival_ns <= end_ns:
            give(estimator, sample)
    found = estimator.smoothed()
    estimator.finish()
    tables.finish()
    return found, tables.smoothed()


@settings(max_examples=10, deadline=None)
@example(620, 1.3, 0.5)  # a change of corridor in the window, put back to before the lag
@example(560, 2.0, 3.0)
@given(st.integers(30, 799), st.sampled_from([0.25, 0.5, 1.3, 2.0]), st.sampled_from([0.08, 0.5, 3.0]))
def test_equals_the_offline_smoother_of_what_was_known(at: int, lag_s: float, buffer_s: float) -> None:
    end_ns = at * 10 * MS
    found, table = until(end_ns, lag_s, buffer_s=buffer_s)
    wanted_ns = max(end_ns - round(lag_s * 1e9), 0)
    (row,) = table[table["timestamp_ns"] == wanted_ns]
    for name, expected in zip(ESTIMATE_DTYPE.names or (), row.item(), strict=True):
        value = getattr(found, name)
        assert type(value) is type(expected), name
        if isinstance(expected, float):
            assert value == pytest.approx(expected, rel=0, abs=1e-9, nan_ok=True), name
        else:
            assert value == expected, name


def errors(lag_s: float, simulated: Simulated) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Errors of filter and fixed lag at the same times, and the sigma of the latter."""
    estimator = CorridorEstimator(config_for(simulated.scene, fixed_lag_s=lag_s))
    causal: dict[int, float] = {}
    rows = []
    for i, sample in enumerate(simulated.samples):
        give(estimator, sample)
        now = estimator.estimate()
        causal[now.timestamp_ns] = now.heading_rad
        if i % 25 == 0 and now.timestamp_ns > 4_000 * MS:
            late = estimator.smoothed()
            truth = np.interp(late.timestamp_ns * 1e-9, simulated.t_s, simulated.heading)
            before = wrap(causal[late.timestamp_ns] - truth)
            rows.append((before, wrap(late.heading_rad - truth), late.heading_std_rad))
    filtered, smoothed, std = np.array(rows).T
    return filtered, smoothed, std


def test_it_is_better_than_the_filter_was_and_as_good_as_it_says() -> None:
    simulated = simulate(Scene(duration_s=20.0, seed=8, gyro_hz=100, frame_hz=20, gross=0.05))
    filtered, smoothed, std = errors(1.0, simulated)
    assert np.sqrt(np.mean(smoothed**2)) < 0.8 * np.sqrt(np.mean(filtered**2))
    assert (np.abs(smoothed) < 4 * std).all()


def test_a_change_of_corridor_is_put_back_to_the_turn_once_it_is_known() -> None:
    estimator = CorridorEstimator(config_for(SIMULATED.scene, fixed_lag_s=2.0))
    causal_s = smoothed_s = 99.0
    for sample in SIMULATED.samples:
        give(estimator, sample)
        if estimator.estimate().corridor_index == 1:
            now_s = estimator.estimate().timestamp_ns * 1e-9
            causal_s = min(causal_s, now_s)
            late = estimator.smoothed()
            if late.corridor_index == 1:
                smoothed_s = min(smoothed_s, late.timestamp_ns * 1e-9)
                truth = np.interp(late.timestamp_ns * 1e-9, SIMULATED.t_s, SIMULATED.heading) - TURN
                assert degrees(abs(wrap(late.heading_rad - truth))) < 1.5
    assert causal_s > 5.0
    assert smoothed_s == pytest.approx(4.6, abs=0.2)


def test_before_the_lag_is_over_it_is_the_first_sample_that_is_told_of() -> None:
    estimator = CorridorEstimator(FusionConfig(fixed_lag_s=0.5))
    assert estimator.smoothed().reason == "no sample yet"
    estimator.add_imu(7 * MS, (0, 0, 0))
    first = estimator.smoothed()
    assert (first.timestamp_ns, first.status) == (7 * MS, "initialising")
    assert isnan(first.heading_rad)
    estimator.add_imu(300 * MS, (0, 0, 0))
    assert estimator.smoothed().timestamp_ns == 7 * MS
    estimator.add_imu(600 * MS, (0, 0, 0))
    assert estimator.smoothed().timestamp_ns == 7 * MS
    estimator.add_imu(900 * MS, (0, 0, 0))
    assert estimator.smoothed().timestamp_ns == 300 * MS


def test_asking_for_it_changes_nothing() -> None:
    quiet, asked = (CorridorEstimator(config_for(SIMULATED.scene, fixed_lag_s=lag)) for lag in (None, 1.0))
    for sample in SIMULATED.samples:
        give(quiet, sample)
        give(asked, sample)
        if sample.kind == "frame":
            asked.smoothed()
    assert all(repr(getattr(quiet.estimate(), f.name)) == repr(getattr(asked.estimate(), f.name))
               for f in fields(Estimate))  # fmt: skip


def test_it_survives_the_end_of_the_flight_and_a_clock_that_is_set_back() -> None:
    estimator = CorridorEstimator(FusionConfig(fixed_lag_s=0.25))
    for i in range(200):
        estimator.add_imu(i * 10 * MS + 10_000 * MS, (0, 0, 0))
    before = estimator.smoothed()
    for i in range(60):
        estimator.add_imu(i * 10 * MS, (0, 0, 0))
    assert estimator.smoothed().timestamp_ns < 600 * MS < before.timestamp_ns
    for i in range(60, 100):
        estimator.add_imu(i * 10 * MS, (0, 0, 0))
    late = estimator.smoothed()
    assert late.timestamp_ns == 740 * MS
    estimator.finish()
    assert repr(estimator.smoothed()) == repr(late)


def test_it_has_to_be_asked_for() -> None:
    with pytest.raises(InputError, match="set fixed_lag_s"):
        CorridorEstimator().smoothed()
    for lag_s in (0.2, 2.1):
        with pytest.raises(InputError, match="fixed_lag_s = "):
            FusionConfig(fixed_lag_s=lag_s)


def test_nothing_is_compiled_in_flight() -> None:
    """In a process of its own: in this one the smoother may have been compiled long ago."""
    program = (
        "from fusion import CorridorEstimator, FusionConfig\n"
        "from fusion.estimator.smoother import rts\n"
        "CorridorEstimator(FusionConfig(fixed_lag_s=0.5))\n"
        "assert rts.signatures"
    )
    subprocess.run([sys.executable, "-c", program], check=True)
