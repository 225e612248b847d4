"""Walls that are not parallel, and bends: the heading's sigma contains that the lines show no single direction."""

from __future__ import annotations

from math import degrees, radians
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from vision import Attitude, Camera, Reason, measure_lines
from vision.axis.peaks import split_variance
from vision.axis.vote import N_BINS, bin_heading
from vision.measurement import FrameMeasurement

CAMERA = Camera(640, 480, 466.0, 466.0, 319.5, 239.5)
SIGN = pytest.mark.parametrize("sign", [-1.0, 1.0])
QUICK = settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


def measured(corridor: Any, seen: Any, **of: Any) -> FrameMeasurement:
    return measure_lines(seen(corridor(noise_px=0.15, **of), CAMERA), CAMERA, Attitude(0.0, 0.0))


@SIGN
@pytest.mark.parametrize("turn_deg", [1.0, 2.0, 3.0, 4.0])
@pytest.mark.parametrize("heading_deg", [-12.0, 0.0, 7.0])
def test_walls_that_are_not_parallel_widen_the_heading(
    corridor: Any, seen: Any, sign: float, turn_deg: float, heading_deg: float
) -> None:
    turn, heading = sign * radians(turn_deg), radians(heading_deg)
    m = measured(corridor, seen, right_wall_turn_rad=turn, heading_rad=heading)
    error = abs(m.heading_rad + 0.5 * turn - heading)  # from the direction between the walls
    assert error < 2.5 * m.heading_std_rad or not m.accepted
    if turn_deg >= 2.0:
        assert m.heading_split_std_rad > 0.25 * abs(turn)
    assert m.heading_split_std_rad < m.heading_std_rad
    assert m.heading_lasting_std_rad < m.heading_std_rad


@SIGN
@pytest.mark.parametrize("radius_m", [30.0, 60.0, 100.0])
def test_a_bend_widens_the_heading(corridor: Any, seen: Any, sign: float, radius_m: float) -> None:
    rails = (-1.0, -0.7, -0.3, 0.2, 0.6)
    found = [
        measured(corridor, seen, bend_1_m=sign / radius_m, rails_m=rails, offset_norm=offset, seed=seed)
        for seed, offset in enumerate((-0.3, 0.0, 0.3))
    ]
    sure_and_wrong = [m for m in found if m.accepted and abs(m.heading_rad) > 4.0 * m.heading_std_rad]
    assert not sure_and_wrong, [(degrees(m.heading_rad), degrees(m.heading_std_rad)) for m in found]


@QUICK
@given(
    heading=st.floats(radians(-25), radians(25)),
    offset=st.floats(-0.6, 0.6),
    slope=st.floats(radians(-3), radians(3)),
    seed=st.integers(0, 1000),
)
def test_parallel_walls_show_one_direction(
    corridor: Any, seen: Any, heading: float, offset: float, slope: float, seed: int
) -> None:
    m = measured(corridor, seen, heading_rad=heading, offset_norm=offset, slope_rad=slope, seed=seed)
    assert m.reason is Reason.OK
    assert m.heading_split_std_rad == 0.0


def peak(at_rad: float, height: float) -> np.ndarray:
    apart = np.array([bin_heading(b) for b in range(N_BINS)]) - at_rad
    return np.maximum(height * (1.0 - (apart / radians(1.0)) ** 2), 0.0)


def test_a_second_direction_counts_from_what_stray_lines_do_not_reach() -> None:
    second = peak(radians(3.0), 20.0)
    alone = split_variance(second, 0.0, 40.0)
    assert alone == pytest.approx(radians(3.0) ** 2 * 20.0 / 60.0, rel=0.1)
    assert split_variance(second[::-1].copy(), 0.0, 40.0) == pytest.approx(alone, rel=0.1)
    strays = peak(radians(12.0), 18.0) + peak(radians(-12.0), 18.0)
    assert split_variance(second + strays, 0.0, 40.0) == 0.0
    on_one_side = split_variance(second + peak(radians(12.0), 18.0), 0.0, 40.0)
    assert on_one_side == pytest.approx(alone, rel=0.1)  # a bend has lines there too
    assert split_variance(peak(radians(3.0), 3.0), 0.0, 40.0) == 0.0
    assert split_variance(peak(radians(7.5), 20.0), 0.0, 40.0) == 0.0  # a rival, not a split
    assert split_variance(np.zeros(N_BINS), 0.0, 0.0) == 0.0
