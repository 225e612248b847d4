"""The estimates of the flights in the repository are those put by in tests/golden, to 1e-9."""

from __future__ import annotations

from math import degrees

import numpy as np
import pytest

from tests.golden import golden
from vision.measurement import FrameMeasurement, Position, Reason


@pytest.mark.parametrize("name", golden.FLIGHTS)
def test_estimates_are_those_put_by(name: str) -> None:
    expected = golden.read_table(golden.golden_file(name))
    changes = [
        line
        for which, table in zip(("filter", "smoother"), golden.FLIGHTS[name](), strict=True)
        for line in golden.differences(f"{name} {which}", expected[which], table[:: golden.EVERY])
    ]
    assert not changes, "\n".join(changes)


def test_what_is_put_by_is_a_flight_worth_keeping() -> None:
    office = golden.read_table(golden.golden_file("office"))["filter"]
    assert (office["status"] == "tracking").mean() > 0.95
    junction = golden.read_table(golden.golden_file("junction"))
    for table in junction.values():
        assert set(table["corridor_index"].tolist()) == {0, 1}
        assert abs(table["corridor_turn_rad"][-1] - golden.JUNCTION_TURN_RAD) < np.radians(2)
    assert "coasting" in junction["filter"]["status"]
    offset = np.degrees(junction["filter"]["imu_yaw_offset_rad"])
    assert offset[-1] - offset[len(offset) // 2] == pytest.approx(15, abs=3)
    assert all(path.stat().st_size < 100_000 for path in golden.HERE.glob("*.gz"))


def test_a_change_is_noticed() -> None:
    table = golden.read_table(golden.golden_file("office"))["filter"]
    assert not list(golden.differences("same", table, table.copy()))
    for column, change in (("heading_rad", 2e-9), ("lateral_offset_m", -1e-6), ("gyro_bias_rad_s", np.nan)):
        other = table.copy()
        other[column][40] += change
        (line,) = golden.differences("office filter", table, other)
        assert f"{column} differs in 1 of" in line
        assert golden.RENEW in line
    other = table.copy()
    other["status"][3], other["corridor_index"][5] = "lost", 2
    assert len(list(golden.differences("office filter", table, other))) == 2
    (line,) = golden.differences("office filter", table, table[:-1])
    assert "rows" in line


def test_measurements_survive_being_written() -> None:
    m = FrameMeasurement(
        accepted=True,
        reason=Reason.OK,
        n_lines=40,
        n_inliers=21,
        vp_px=(319.25, 240.5),
        vp_cov_px2=((1.5, 0.25), (0.25, 2.0)),
        heading_rad=0.125,
        heading_std_rad=0.01,
        position=Position.LEFT,
    )
    row = dict(zip(golden.frame_columns(), golden.frame_cells(m), strict=True))
    back = golden.frame_from(row)
    assert repr(back) == repr(m)
    assert degrees(back.heading_rad) == degrees(0.125)
