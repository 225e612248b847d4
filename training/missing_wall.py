"""Fit the weights of `vision.lateral.walls`, which detect that a side wall is missing.

``python -m training.missing_wall`` renders simulated corridors with and without an open hall beside them, measures
them with the packaged network, and fits a logistic regression of the missing wall on the evidence of all pictures
with an estimated offset. It prints the weights in the form used in the module, and their performance on corridors
left out of the fit (cross-validation). Some of the evidence is the network's output, so a new network needs new
weights. Seeds are fixed.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import radians
from typing import Annotated

import numpy as np
import numpy.typing as npt
import typer
from scipy.optimize import minimize

from fusion.simulate import ImagingConfig, SceneConfig, random_views
from training.offset_views import FloatArray, measured_frame
from vision import Attitude, Camera, extract_lines, measure_lines
from vision.lateral import walls
from vision.lateral.learned import corner_scores
from vision.lateral.mixture import UNIFORM_DENSITY
from vision.lateral.offset import combined_offset
from vision.lateral.polar import polar_picture
from vision.lateral.walls import MissingWallEvidence, missing_wall_evidence

SIZES = ((320, 240), (640, 480))
FIELD_OF_VIEW_RAD = radians(72.0)
TILT_STD_RAD = radians(0.5)  # of the roll and pitch that come with a picture
SCENES, VIEWS_PER_SCENE, SEED = 240, 4, 4100
FOLDS = 5
LOST_SHARE = 0.05  # accepted loss of estimates between two walls
WRONG_NORM = 0.1
RIDGE = 0.5


@dataclass(frozen=True, slots=True)
class EstimatedView:
    """Evidence of a picture with an estimated offset, whether a hall is beside it, whether the estimate is wrong."""

    evidence: MissingWallEvidence
    is_beside_hall: bool
    is_wrong: bool
    scene_seed: int


def draw_scene(seed: int) -> SceneConfig:
    """Draw a corridor, every other one with an open hall along its whole length; offices and others alternate."""
    draw = SceneConfig.random_office if seed % 4 < 2 else SceneConfig.random
    if seed % 2 == 0:
        return draw(seed, open_hall_m=None)
    length_m = draw(seed).length_m
    hall_m = (0.2, length_m - 0.2)
    return draw(seed, open_hall_m=hall_m, open_hall_right=seed % 8 < 4, length_m=length_m, slope_rad=0.0)


def draw_imaging(seed: int) -> ImagingConfig:
    """Draw the camera's quality for the corridor of the same seed."""
    return (ImagingConfig.random_office if seed % 4 < 2 else ImagingConfig.random)(seed)


def estimated_views(n_scenes: int, seed: int) -> Iterator[EstimatedView]:
    """Measure pictures as `vision.measure_lines` does, up to the test for a missing wall."""
    for number, size in enumerate(SIZES):
        camera = Camera.from_fov(*size, FIELD_OF_VIEW_RAD)
        views = random_views(
            camera,
            n_scenes // len(SIZES) * VIEWS_PER_SCENE,
            seed + number,
            scene=draw_scene,
            imaging=draw_imaging,
            max_heading_rad=radians(35.0),
            min_ahead_m=2.0,
            views_per_scene=VIEWS_PER_SCENE,
        )
        for index, view in enumerate(views):
            rng = np.random.default_rng((view.scene_seed, index, 12))
            roll, pitch = rng.normal(0.0, TILT_STD_RAD, 2).tolist()
            attitude = Attitude(view.roll_rad + roll, view.pitch_rad + pitch)
            lines = extract_lines(view.image, camera)
            found = measure_lines(lines, camera, attitude)
            frame = measured_frame(view.image, camera, attitude)
            if frame is None or found.line_class is None:
                continue
            R_corridor_camera = frame[0]
            by_lines, by_regions = found.offset_evidence
            estimate = combined_offset(by_lines, by_regions)
            if estimate is None:
                continue
            evidence = missing_wall_evidence(
                lines.geometry(),
                found.line_class,
                R_corridor_camera,
                corner_scores(polar_picture(view.image, camera, R_corridor_camera)),
                float(by_lines.likelihood(estimate.offset_norm)) / UNIFORM_DENSITY,
            )
            yield EstimatedView(
                evidence,
                view.scene_seed % 2 == 1,
                abs(estimate.offset_norm - view.lateral_offset_norm) > WRONG_NORM,
                view.scene_seed,
            )


def fit(evidence: FloatArray, is_missing: npt.NDArray[np.bool_]) -> FloatArray:
    """Fit weights (k,) to evidence (n, k), and shift the bias so that `LOST_SHARE` of views with walls are lost."""
    share = np.where(is_missing, np.sqrt((~is_missing).sum() / max(is_missing.sum(), 1)), 1.0)
    sign = np.where(is_missing, -1.0, 1.0)

    def loss(weights: FloatArray) -> float:
        misfit = share @ np.logaddexp(0.0, sign * (evidence @ weights))
        return float(misfit + RIDGE * weights[1:] @ weights[1:])

    weights: FloatArray = minimize(loss, np.zeros(evidence.shape[1])).x
    weights[0] -= np.quantile(evidence[~is_missing] @ weights, 1.0 - LOST_SHARE)
    return weights


def describe(name: str, kept: npt.NDArray[np.bool_], found: list[EstimatedView]) -> str:
    """Describe how many estimates remain beside halls and between two walls, and how many of these are wrong."""
    parts = []
    for where, beside in (("beside a hall", True), ("between walls", False)):
        these = [k for a, k in zip(found, kept, strict=True) if a.is_beside_hall == beside]
        wrong = [k and a.is_wrong for a, k in zip(found, kept, strict=True) if a.is_beside_hall == beside]
        parts.append(f"{where} {sum(these)} of {len(these)} answers remain, {sum(wrong)} wrong")
    return f"{name}: {'; '.join(parts)}"


def main(
    scenes: Annotated[int, typer.Option(min=20, help="Corridors to render.")] = SCENES, seed: int = SEED
) -> None:
    """Fit the weights and print them."""
    found = list(estimated_views(scenes, seed))
    evidence = np.array([a.evidence for a in found])
    is_missing = np.array([a.is_beside_hall for a in found])
    fold = np.array([a.scene_seed // 8 % FOLDS for a in found])
    log_odds = np.empty(len(found))
    for k in range(FOLDS):
        log_odds[fold == k] = evidence[fold == k] @ fit(evidence[fold != k], is_missing[fold != k])
    print(describe("all", np.ones(len(found), bool), found))
    print(describe("weights in the package", evidence @ np.array(walls.WEIGHTS) <= 0.0, found))
    print(describe("fitted, corridors left out", log_odds <= 0.0, found))
    weights = MissingWallEvidence(*fit(evidence, is_missing).tolist())
    print("WEIGHTS = MissingWallEvidence(")
    for name, weight in weights._asdict().items():
        print(f"    {name}={weight:.2f},")
    print(")")


if __name__ == "__main__":
    typer.run(main)
