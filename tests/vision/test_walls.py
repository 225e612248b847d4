"""A side wall that is missing: no answer, unless the corridor's width is known."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from math import isfinite, radians

import numpy as np
import pytest

from fusion.simulate import SceneConfig, office_views
from fusion.simulate.single_views import RandomView
from training.missing_wall import LOST_SHARE, fit
from vision import Attitude, Camera, FrameMeasurement, Prior, measure_frame

CAMERA = replace(Camera.from_fov(320, 240, radians(70.0)), exposure_s=0.008)
SEED = 555


@cache
def views(hall: bool) -> tuple[RandomView, ...]:
    """Views of random corridors, between two walls or beside an open hall."""

    def scene(seed: int) -> SceneConfig:
        length_m = SceneConfig.random_office(seed).length_m
        side = {"open_hall_m": (0.2, length_m - 0.2), "open_hall_right": seed % 2 == 0} if hall else {}
        return SceneConfig.random_office(seed, **side)

    return tuple(office_views(CAMERA, 40, SEED, scene=scene, views_per_scene=4, light_cell_m=0.4))


def measured(hall: bool, prior: Prior | None = None) -> list[tuple[FrameMeasurement, float]]:
    """Measure views; with the true offset of each that is accepted."""
    found = []
    for view in views(hall):
        m = measure_frame(view.image, CAMERA, Attitude(view.roll_rad, view.pitch_rad), prior)
        if m.accepted:
            found.append((m, view.lateral_offset_norm))
    return found


def test_beside_an_open_hall_the_offset_is_seldom_answered_and_else_nearly_always() -> None:
    beside_hall, between_walls = measured(hall=True), measured(hall=False)
    answered = [isfinite(m.lateral_offset_norm) for m, _ in beside_hall]
    wrong = [abs(m.lateral_offset_norm - y) > 0.1 for m, y in beside_hall]  # NaN is not
    assert np.mean(answered) < 0.35
    assert np.mean(wrong) < 0.15
    assert np.mean([isfinite(m.lateral_offset_norm) for m, _ in between_walls]) > 0.85


def test_what_is_known_of_the_width_stands_in_for_the_wall() -> None:
    alone = measured(hall=True)
    known = measured(hall=True, prior=Prior(width_per_height=1.6))
    answered = [np.mean([isfinite(m.lateral_offset_norm) for m, _ in found]) for found in (alone, known)]
    assert answered[1] > answered[0]
    for (m, _), (other, _) in zip(alone, known, strict=True):
        assert m.heading_rad == other.heading_rad


def test_the_fit_loses_as_many_ordinary_answers_as_it_may_and_finds_what_tells() -> None:
    rng = np.random.default_rng(1)
    is_missing = np.arange(6000) % 3 == 0
    telling, chance = rng.normal(2.0 * is_missing, 1.0), rng.normal(size=6000)
    evidence = np.column_stack([np.ones(6000), telling, chance])
    weights = fit(evidence, is_missing)
    lost = evidence @ weights > 0.0
    assert np.mean(lost[~is_missing]) == pytest.approx(LOST_SHARE, abs=0.001)
    # Two Gaussians of unit variance, 2 apart: their log-odds rise by 2 per unit.
    assert weights[1] == pytest.approx(2.0, abs=0.2)
    assert abs(weights[2]) < 0.1
    assert np.mean(lost[is_missing]) > 0.5
