"""The offset by the network: as good as its figures say, symmetric, silent where there is nothing to tell."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from importlib.resources import files
from math import pi, radians
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from training.offset_views import TrainingView, corner_angles, render_views
from training.scores import OffsetScores
from vision import Camera
from vision.cameras.camera import Distortion
from vision.lateral.learned import (
    N_QUARTER,
    WEIGHTS_FILE,
    CornerScores,
    corner_scores,
    learned_mixture,
    likeliest_corners,
    mixture_of,
)
from vision.lateral.mixture import OffsetMixture
from vision.lateral.polar import ANGLES, DIRECTIONS, N_ANGLES, N_RADII, corridor_frame, polar_picture

CAMERA = Camera.from_fov(320, 240, radians(80))
R_LEVEL_CAMERA = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])  # looks ahead
FIGURES = json.loads(files("vision.lateral").joinpath(WEIGHTS_FILE).with_suffix(".json").read_text())


@cache
def test_views() -> list[TrainingView]:
    return [v for v in render_views(FIGURES["test_views"]["n"], FIGURES["test_views"]["seed"])]


def seen(view: TrainingView) -> OffsetMixture:
    assert view.R_measured is not None
    return learned_mixture(view.image, view.camera, view.R_measured)
