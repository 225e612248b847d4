"""A fused flight in a notebook: pandas frames, and what a cell shows that ends with it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fusion.evaluation.checks import run_checks
from fusion.result.summary import Check, Counts, Level, Summary
from tests.fusion.fused import Fused, make_flight
from vision.errors import InputError

pd = pytest.importorskip("pandas")


@pytest.fixture(scope="module")
def fused(tmp_path_factory: pytest.TempPathFactory) -> Fused:
    return make_flight(tmp_path_factory.mktemp("flight"), duration_s=3.0, pictures=False)


def test_a_table_is_the_same_in_pandas(fused: Fused) -> None:
    result, _ = fused
    for name in ("estimates", "smoothed", "frames"):
        frame, table = result.to_pandas(name), getattr(result, name)
        assert tuple(frame.columns) == table.dtype.names
        for column in frame.columns:
            assert np.array_equal(
                frame[column].to_numpy(), table[column], equal_nan=table[column].dtype.kind == "f"
            )


def test_seconds_count_from_the_first_row_and_degrees_are_named(fused: Fused) -> None:
    result, _ = fused
    frame = result.to_pandas("frames", seconds=True, degrees=True)
    assert frame.index.name == "time_s"
    assert frame.index[0] == pytest.approx((result.frames["timestamp_ns"][0] - result.origin_ns) / 1e9)
    assert min(result.to_pandas(seconds=True).index[0], frame.index[0]) == 0.0
    assert not [name for name in frame.columns if "_rad" in name]
    assert np.allclose(frame["heading_deg"], np.degrees(result.frames["heading_rad"]), equal_nan=True)
    rates = result.to_pandas(degrees=True)["yaw_rate_deg_s"]
    assert np.allclose(rates, np.degrees(result.estimates["yaw_rate_rad_s"]))
    assert "heading_rad" in result.to_pandas("frames").columns  # the table itself stays as it is


def test_an_unknown_table_is_refused_with_those_that_there_are(fused: Fused) -> None:
    with pytest.raises(InputError, match=r"no table 'frame'.*estimates, smoothed, frames"):
        fused[0].to_pandas("frame")  # type: ignore[arg-type]


def test_a_repr_is_one_short_line(fused: Fused) -> None:
    result, flight = fused
    counted = replace(
        result,
        overview=Summary(flight="hall", duration_s=3.0, counts=Counts(frames=30, accepted=28, estimates=150)),
    )
    assert repr(counted) == ("FusionResult(hall: not_judged, 3.0 s, 28 of 30 frames used, 150 estimates)")
    assert repr(flight).startswith(f"Flight({flight.name}: 30 frames, 150 IMU samples, 150 attitudes")
    assert len(repr(flight)) < 200


def test_a_cell_shows_what_is_amiss_and_nothing_that_a_log_could_inject(fused: Fused, tmp_path: Path) -> None:
    result, flight = fused
    checks = (
        *run_checks(result, flight),
        Check("Light", Level.WARN, "<dark>", "", "It is dark.", "Switch it on."),
    )
    shown = replace(result, overview=Summary(flight="<b>hall</b>\x1b[2J", checks=checks))._repr_html_()
    assert "&lt;b&gt;hall&lt;/b&gt;" in shown
    assert "\x1b" not in shown
    assert "&lt;dark&gt;" in shown
    assert "Switch it on." in shown
