"""What the estimator tells of the lateral offset: status, probability, columns, in any order and in a mirror."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from math import isnan, radians
from pathlib import Path

import numpy as np
import pytest

from fusion.estimator.config import FusionConfig
from fusion.estimator.estimate import Estimate, estimate_of
from fusion.estimator.estimator import CorridorEstimator
from fusion.estimator.filter_table import filter_table
from fusion.estimator.propagation import ImuSample
from fusion.estimator.smoothed_table import hypotheses_table
from fusion.estimator.state import Entry
from fusion.estimator.tables import ESTIMATE_DTYPE, Table, estimate_row
from fusion.offline.table_builder import TableBuilder
from fusion.result.tables_csv import read_table, write_table
from tests.fusion.simulated import (
    Sample,
    Scene,
    config_for,
    frame,
    give,
    mirrored,
    plus,
    simulate,
    turning,
    two_places,
    weaving,
)
from tests.golden import golden
from vision.lateral.mixture import OffsetMixture
from vision.measurement import FrameMeasurement

MS = 1_000_000
AT_REST = (0.0, 0.0, -9.80665)
TURN = radians(75)
SCENE = Scene(
    duration_s=9.0,
    seed=21,
    heading=plus(weaving(21, radians(8)), turning((5.5, 1.2, TURN))),
    axis=lambda t: np.where(np.asarray(t) < 6.1, 0.0, TURN),
    lateral=weaving(22, 0.5, 6.0),
    tilt_rad=radians(4),
    gyro_hz=100,
    frame_hz=20,
    gross=0.05,
    attitude_hz=25,
    accel=True,
    dropouts=[(3.0, 4.2)],
)


def ambiguous(sample: Sample) -> Sample:
    """Let a frame show a second place, which stays where it is, beside the one that it has measured."""
    if sample.kind != "frame":
        return sample
    (m,) = sample.values
    evidence = (two_places(m.lateral_offset_norm, 0.7),)
    return replace(sample, values=(replace(m, offset_evidence=evidence),))


SAMPLES = [ambiguous(s) for s in simulate(SCENE).samples]


def hover(
    estimator: CorridorEstimator, t_ns: int, seconds: float, m: FrameMeasurement | None
) -> list[Estimate]:
    """Stay where the vehicle is for a while; the estimate after every sample of the IMU."""
    estimates = []
    for i in range(round(seconds * 100)):
        t_ns += 10 * MS
        estimator.add_imu(t_ns, (0.0, 0.0, 0.0), AT_REST)
        estimates.append(estimator.estimate())
        if m is not None and i % 4 == 0:
            estimator.add_measurement(t_ns, m)
    return estimates


def test_it_is_unknown_then_known_then_carried_on_and_then_unknown_again() -> None:
    estimator = CorridorEstimator(FusionConfig(corridor_width_m=2.0))
    seen = frame(0.1, lateral=0.3, lateral_std=0.02)
    before = estimator.estimate()
    assert (before.lateral_status, before.lateral_probability) == ("unknown", 0.0)
    assert isnan(before.lateral_age_s)

    found = hover(estimator, 0, 3.0, seen)
    assert [e.lateral_status for e in found[:20]] == ["unknown"] * 20  # one frame alone is not believed
    assert {e.lateral_status for e in found[150:]} == {"known"}
    assert all(e.lateral_probability > 0.9 for e in found[150:])
    assert all(e.lateral_age_s <= 0.04 + 1e-9 for e in found[150:])

    alone = hover(estimator, 3000 * MS, 10.0, None)
    changes = [
        e.lateral_status for i, e in enumerate(alone) if e.lateral_status != alone[i - 1].lateral_status
    ]
    assert changes[-2:] == ["coasting", "unknown"]
    carried_on = [e for e in alone if e.lateral_status == "coasting"]
    assert len(carried_on) > 10
    assert (np.diff([e.lateral_offset_norm_std for e in carried_on]) > 0.0).all()
    assert (np.diff([e.lateral_probability for e in carried_on]) < 0.0).all()
    assert alone[-1].lateral_age_s == pytest.approx(10.0, abs=0.05)
    for value in (
        alone[-1].lateral_offset_norm,
        alone[-1].lateral_offset_norm_std,
        alone[-1].lateral_offset_m,
    ):
        assert isnan(value)
    assert alone[-1].position == ""

    again = hover(estimator, 13_000 * MS, 2.0, seen)
    assert again[-1].lateral_status == "known"
    assert (again[-1].lateral_reset_count, alone[-1].lateral_reset_count) == (1, 0)


def test_two_places_as_likely_as_each_other_are_unknown_but_their_probability_is_told() -> None:
    estimator = CorridorEstimator(FusionConfig(corridor_width_m=2.0))
    seen = frame(0.1, lateral=0.3, lateral_std=0.02, offset_evidence=(two_places(0.3, -0.4, 0.45),))
    estimates = hover(estimator, 0, 4.0, seen)
    assert {e.lateral_status for e in estimates} == {"unknown"}
    assert all(isnan(e.lateral_offset_norm) for e in estimates)
    assert estimates[-1].lateral_probability == pytest.approx(0.5, abs=0.1)


def test_evidence_is_used_where_a_frame_holds_it_and_an_answer_alone_is_one_component() -> None:
    nan = np.array([np.nan])
    said = OffsetMixture(np.array([0.97]), np.array([-0.2]), np.array([0.03]), nan)
    plain = frame(0.1, lateral=-0.2, lateral_std=0.03)
    told, alone, otherwise = (
        hover(CorridorEstimator(), 0, 2.0, m)[-1]
        for m in (
            replace(plain, lateral_offset_norm=0.5, offset_evidence=(said,)),
            plain,
            replace(plain, offset_evidence=(replace(said, offset_norm=np.array([0.1])),)),
        )
    )
    assert told.lateral_offset_norm == alone.lateral_offset_norm == pytest.approx(-0.2, abs=0.01)
    assert told.lateral_offset_norm_std == alone.lateral_offset_norm_std
    assert otherwise.lateral_offset_norm == pytest.approx(0.1, abs=0.01)


def test_the_tables_end_with_status_and_age(tmp_path: Path) -> None:
    assert ESTIMATE_DTYPE.names == (
        *("timestamp_ns", "heading_rad", "heading_std_rad", "lateral_offset_m", "lateral_offset_std_m"),
        *("lateral_offset_norm", "lateral_offset_norm_std", "position", "yaw_rate_rad_s", "gyro_bias_rad_s"),
        *("imu_yaw_offset_rad", "corridor_index", "corridor_turn_rad", "status", "vision_age_s"),
        *("lateral_status", "lateral_age_s", "lateral_reason"),
    )
    estimator = CorridorEstimator()
    found = hover(estimator, 0, 2.0, frame(0.1, lateral=0.3, lateral_std=0.02))
    rows = [found[0], found[-1], *hover(estimator, 2000 * MS, 0.3, None)[-1:]]
    write_table(np.array([estimate_row(e) for e in rows], ESTIMATE_DTYPE), tmp_path / "estimates.csv")
    lines = (tmp_path / "estimates.csv").read_text().splitlines()
    assert lines[0].endswith(",status,vision_age_s,lateral_status,lateral_age_s,lateral_reason")
    assert [line.split(",")[-3:] for line in lines[1:]] == [
        ["unknown", "", "no_frame"],
        ["known", "0.03", ""],
        ["coasting", "0.33", "no_frame"],
    ]
    assert read_table(tmp_path / "estimates.csv", ESTIMATE_DTYPE)["lateral_status"][1] == "known"


@pytest.mark.parametrize("name", golden.FLIGHTS)
def test_in_every_row_the_offset_is_empty_where_it_is_unknown_and_only_there(name: str) -> None:
    for table in golden.FLIGHTS[name]():
        unknown = table["lateral_status"] == "unknown"
        assert 0.0 < unknown.mean() < 0.5
        for column in ("lateral_offset_norm", "lateral_offset_norm_std"):
            np.testing.assert_array_equal(np.isnan(table[column]), unknown)
        np.testing.assert_array_equal(table["position"] == "", unknown)
        np.testing.assert_array_equal(table["lateral_reason"] == "", table["lateral_status"] == "known")


class Flown:
    """A whole flight: the tables, and the hypotheses behind them."""

    def __init__(self, samples: Iterable[Sample], buffer_s: float = 0.5) -> None:
        config = config_for(SCENE, buffer_s=buffer_s)
        self.recorder = TableBuilder(config, (ImuSample,))
        self.states: list[bytes] = []
        estimator = CorridorEstimator(config, on_final=self._take)
        for sample in samples:
            give(estimator, sample)
        estimator.finish()
        self.recorder.finish()

    def _take(self, entry: Entry) -> None:
        self.recorder.take(entry)
        offset = entry.after.lateral.offset
        self.states.append(b"".join(a.tobytes() for a in (offset.x, offset.P, offset.weight)))

    def tables(self) -> tuple[Table, Table, Table]:
        steps = self.recorder.offset_steps
        return self.recorder.estimates(), self.recorder.smoothed(), hypotheses_table(steps)


@pytest.fixture(scope="module")
def in_order() -> Flown:
    return Flown(SAMPLES)


def test_this_flight_tests_something(in_order: Flown) -> None:
    filtered, smoothed, hypotheses = in_order.tables()
    assert set(filtered["lateral_status"].tolist()) == {"unknown", "known", "coasting"}
    assert set(filtered["corridor_index"].tolist()) == {0, 1}
    _, count = np.unique(hypotheses["timestamp_ns"], return_counts=True)
    assert (count > 1).mean() > 0.25
    assert np.isfinite(smoothed["lateral_offset_norm"]).mean() > 0.5


@pytest.mark.parametrize("seed", range(3))
def test_late_samples_give_the_bits_of_the_flight_in_order(in_order: Flown, seed: int) -> None:
    """Every sample late by its own while, frames by most; filter, hypotheses and smoother are the same."""
    rng = np.random.default_rng(seed)
    longest_ms = {"imu": 30, "attitude": 60, "frame": 450}
    arrival = [s.t_ns + int(rng.uniform(0, longest_ms[s.kind]) * MS) * (k > 0) for k, s in enumerate(SAMPLES)]
    late = Flown(SAMPLES[k] for k in np.argsort(arrival, kind="stable"))
    assert late.states == in_order.states
    for here, there in zip(in_order.tables(), late.tables(), strict=True):
        assert here.tobytes() == there.tobytes()


def test_a_row_is_what_the_table_holds_of_the_estimate() -> None:
    config, states = config_for(SCENE), []
    estimator = CorridorEstimator(config, on_final=lambda entry: states.append(entry.after))
    for sample in SAMPLES:
        give(estimator, sample)
    estimator.finish()
    estimates = [estimate_of(state, config) for state in states]
    table = filter_table(states, [e.status for e in estimates], config)
    expected = np.array([estimate_row(e) for e in estimates], dtype=ESTIMATE_DTYPE)
    assert table.tobytes() == expected.tobytes()
    assert set(table["status"]) == {"initialising", "tracking", "coasting"}
    assert set(table["lateral_status"]) == {"unknown", "known", "coasting"}


def test_the_mirrored_flight_has_the_mirrored_offset(in_order: Flown) -> None:
    there = Flown(map(mirrored, SAMPLES))
    for a, b in zip(in_order.tables()[:2], there.tables()[:2], strict=True):
        np.testing.assert_array_equal(a["lateral_status"], b["lateral_status"])
        np.testing.assert_array_equal(a["lateral_reason"], b["lateral_reason"])
        np.testing.assert_allclose(a["lateral_offset_norm"], -b["lateral_offset_norm"], rtol=0, atol=1e-7)
        np.testing.assert_allclose(a["lateral_offset_norm_std"], b["lateral_offset_norm_std"], rtol=1e-6)
        np.testing.assert_array_equal(a["lateral_age_s"], b["lateral_age_s"])
