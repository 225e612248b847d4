"""Walls that are not parallel, and bends: the filter neither averages their error away nor believes odd frames."""

from __future__ import annotations

from dataclasses import replace
from math import inf, nan, radians

import numpy as np
import pytest

from fusion import CorridorEstimator, Estimate
from tests.fusion.simulated import Scene, config_for, frame
from vision import Reason

MS = 1_000_000
STD, SPLIT = radians(0.1), radians(1.0)


def after_frames(splits: list[float], error_rad: float, *, rejected: bool = False) -> Estimate:
    """Return the estimate after 8 s; frames in turn state these splits, and those without one are as wrong."""
    rng = np.random.default_rng(1)
    estimator = CorridorEstimator(config_for(Scene(gyro_noise=0.003)))
    for k in range(800):
        estimator.add_imu(k * 10 * MS, (0.0, 0.0, float(rng.normal(0.0, 0.02))))
        if k % 5:
            continue
        split = splits[k // 5 % len(splits)]
        true = split if 0.0 < split < inf else 0.0
        seen = frame(
            float(rng.normal(error_rad, STD)),
            float(np.hypot(STD, true)),
            heading_split_std_rad=split,
            heading_lasting_std_rad=0.95 * true,
        )
        if rejected and true > 0.0:
            seen = replace(seen, accepted=False, reason=Reason.UNCERTAIN)
        estimator.add_measurement(k * 10 * MS, seen)
    return estimator.estimate()


@pytest.mark.parametrize("splits", [[SPLIT], [SPLIT, SPLIT, 0.0], [SPLIT, 0.0, 0.0]])
@pytest.mark.parametrize("rejected", [False, True])
def test_frames_that_do_not_show_the_split_are_as_uncertain(splits: list[float], rejected: bool) -> None:
    if rejected and 0.0 not in splits:
        return
    found = after_frames(splits, radians(1.5), rejected=rejected)
    assert abs(found.heading_rad) < 2.5 * found.heading_std_rad
    assert found.heading_std_rad > 0.6 * SPLIT


def test_a_split_in_few_frames_does_not_count() -> None:
    alone = after_frames([0.0], 0.0)
    few = after_frames([SPLIT, *[0.0] * 8], 0.0)
    assert few.heading_std_rad < 1.2 * alone.heading_std_rad


@pytest.mark.parametrize("value", [nan, -0.01, inf])
def test_a_split_that_is_no_part_of_sigma_counts_as_zero(value: float) -> None:
    found, plain = after_frames([value], 0.0), after_frames([0.0], 0.0)
    assert (found.heading_rad, found.heading_std_rad) == (plain.heading_rad, plain.heading_std_rad)
