"""Where the weights of `vision.lateral.hypotheses` come from, and what they are worth.

``python benchmarks/lateral_weights.py`` renders corridors, fits the weights anew by maximum likelihood (that the
hypotheses within 3 % of the true offset hold the probability, or that none is relied on where none is right), and
prints them beside those in use; then, on corridors the fit has not seen and on ``data/office``, what share of the
pictures is answered and what share of the answers is a wrong corner. Open halls, whose second wall is missing, teach
silence. Weights that are zero in use, and that of flying near a wall, which no simulator knows, stay as they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import hypot, log, nan, radians
from typing import Annotated

import numpy as np
import numpy.typing as npt
import typer
from numpy.lib.recfunctions import structured_to_unstructured
from scipy.optimize import minimize

from fusion.simulate.scene.config import SceneConfig
from fusion.simulate.single_views import office_views
from support.cases import flight_cases, flight_named
from support.scores import number, percent, table
from vision import Attitude, Camera, extract_lines, measure_lines
from vision.axis.level import level_from_verticals
from vision.axis.vanishing_point import fit_axis
from vision.frame import SLOPE_STD_RAD
from vision.lateral.corner_pairs import EVIDENCE, N_EVIDENCE, PictureCorners, find_corner_pairs
from vision.lateral.hypotheses import BIAS, POSITION_TERMS, SAME_OFFSET, WEIGHTS, offset_hypotheses
from vision.lateral.offset import MIN_PROBABILITY
from vision.types import FloatArray, RecordArray

LENSES = (((320, 240), 70.0), ((640, 480), 90.0), ((320, 240), 95.0), ((640, 480), 75.0))
ATTITUDE_STD_RAD = radians(0.5)
RIGHT = 0.06  # in offset: 3 % of the width
WRONG = 0.10
RIDGE = 1e-4
FIXED = [(EVIDENCE.names or ()).index("near_wall"), N_EVIDENCE + (EVIDENCE.names or ()).index("near_wall")]


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """The hypotheses of one picture: what the weights multiply (k, 38), offset (k,), true offset (NaN: none)."""

    evidence: FloatArray
    offset: FloatArray
    truth: float
    held_out: bool


def weights_in_use() -> FloatArray:
    """Return the product's weights as one vector: floor, ceiling, biases."""
    return np.concatenate([WEIGHTS.floor, WEIGHTS.ceiling, structured_to_unstructured(WEIGHTS.bias)[0]])


def evidence_of(hypotheses: RecordArray, picture: PictureCorners) -> FloatArray:
    """Return what the weights multiply to give the log odds of hypotheses, (k, 38): floor, ceiling, bias."""
    n = N_EVIDENCE
    f, c = hypotheses["floor"], hypotheses["ceiling"]
    out = np.zeros((len(hypotheses), 2 * n + 4))
    out[f >= 0, :n] = structured_to_unstructured(picture.floor.evidence)[f[f >= 0]]
    out[c >= 0, n : 2 * n] = structured_to_unstructured(picture.ceiling.evidence)[c[c >= 0]]
    joint = (f >= 0) & (c >= 0)
    for term in POSITION_TERMS:
        out[joint, n + term] = 0.0
    out[:, 2 * n] = f >= 0
    out[:, 2 * n + 1] = f < 0
    out[:, 2 * n + 2] = joint
    out[f >= 0, 2 * n + 3] = np.log(np.bincount(f[f >= 0]))[f[f >= 0]]
    return out


def picture_of(
    image: npt.NDArray[np.uint8], camera: Camera, attitude: Attitude, truth: float, held_out: bool
) -> Picture | None:
    """Measure a picture as `vision.measure_lines` does, up to the hypotheses; None where its heading is rejected."""
    lines = extract_lines(image, camera)
    if not measure_lines(lines, camera, attitude).accepted:
        return None
    std_rad = attitude.std_rad
    level = level_from_verticals(lines, attitude.R_level_body(), camera.R_body_camera, std_rad, std_rad)
    axis = fit_axis(lines, level.R_level_camera, elevation_std_rad=hypot(level.pitch_std_rad, SLOPE_STD_RAD))
    if axis is None:
        return None
    corners = find_corner_pairs(lines, axis, level.R_level_camera)
    hypotheses = offset_hypotheses(corners, WEIGHTS)
    return Picture(evidence_of(hypotheses, corners), hypotheses["offset"].copy(), truth, held_out)


def open_hall(seed: int) -> SceneConfig:
    """Draw an office corridor with an open hall along all of it."""
    length_m = SceneConfig.random_office(seed).length_m
    return SceneConfig.random_office(seed, open_hall_m=(0.0, length_m), open_hall_right=bool(seed % 2))


def simulated(views: int, seed: int) -> list[Picture]:
    """Render corridors, and a fifth as many open halls, and survey them; a third of the scenes is held out."""
    rng = np.random.default_rng(seed)
    pictures = []
    for k, (size, fov_deg) in enumerate(LENSES):
        camera = Camera.from_fov(*size, radians(fov_deg))
        corridors = office_views(camera, views, seed + k, views_per_scene=4)
        halls = office_views(camera, views // 5, seed + 100 + k, views_per_scene=4, scene=open_hall)
        for hall, many in ((False, corridors), (True, halls)):
            for view in many:
                roll, pitch = rng.normal((view.roll_rad, view.pitch_rad), ATTITUDE_STD_RAD)
                truth = nan if hall else view.lateral_offset_norm
                found = picture_of(
                    view.image, view.camera, Attitude(roll, pitch), truth, view.scene_seed % 3 == 0
                )
                if found is not None:
                    pictures.append(found)
    return pictures


def office(size: tuple[int, int]) -> list[Picture]:
    """Measure pictures of the sample flight at one size."""
    folder = flight_named("office")
    cases = flight_cases(folder, size)[0] if folder is not None else []
    found = [
        picture_of(c.image, c.camera, c.attitude, c.offset_norm, True)
        for c in cases
        if c.attitude is not None
    ]
    return [p for p in found if p is not None]


def likelihood(
    weights: FloatArray, pictures: Sequence[Picture], free: npt.NDArray[np.bool_]
) -> tuple[float, FloatArray]:
    """Negative log-likelihood a picture, and its gradient in the free weights."""
    total, gradient = 0.0, np.zeros(len(weights))
    for p in pictures:
        odds = np.exp(np.minimum(p.evidence @ weights, 100.0))
        right = np.abs(p.offset - p.truth) < RIGHT
        held, everything = float(odds @ right), float(odds.sum()) + 1.0
        if not right.any():
            held, share = 1.0, np.zeros(len(odds))
        else:
            share = odds * right / held
        total += log(everything / held)
        gradient += (odds / everything - share) @ p.evidence
    n = len(pictures)
    penalty = float(RIDGE * weights[free] @ weights[free])
    slope: FloatArray = np.where(free, gradient / n + 2.0 * RIDGE * weights, 0.0)
    return total / n + penalty, slope


def fitted(pictures: Sequence[Picture], start: FloatArray) -> FloatArray:
    """Fit the weights that are not held, by maximum likelihood."""
    free = start != 0.0
    free[FIXED] = False
    answer = minimize(
        likelihood, start, args=(pictures, free), jac=True, method="L-BFGS-B", options={"maxiter": 200}
    )
    return np.asarray(answer.x)


def worth(weights: FloatArray, pictures: Sequence[Picture]) -> list[str]:
    """How many pictures are answered, and how many answers are a wrong corner."""
    answered = wrong = 0
    for p in pictures:
        if not len(p.offset):
            continue
        odds = np.exp(np.minimum(p.evidence @ weights, 100.0))
        offset = p.offset[np.argmax(odds)]
        for _ in range(2):
            near = np.abs(p.offset - offset) < SAME_OFFSET
            offset = odds[near] @ p.offset[near] / odds[near].sum()
        if odds[near].sum() / (odds.sum() + 1.0) >= MIN_PROBABILITY:
            answered += 1
            wrong += not abs(offset - p.truth) < WRONG
    return [str(len(pictures)), percent(answered / len(pictures)), percent(wrong / max(answered, 1), 2)]


def main(
    views: Annotated[int, typer.Option(min=20, help="Corridors a lens; there are four.")] = 600,
    seed: Annotated[int, typer.Option(help="Other corridors.")] = 1000,
) -> None:
    """Fit the weights of the lateral offset's evidence anew, and compare."""
    used = weights_in_use()
    pictures = simulated(views, seed)
    seen = [p for p in pictures if not p.held_out]
    anew = fitted(seen, used)
    n = N_EVIDENCE
    print(f"Weights of a floor's and a ceiling's pair, in use and fitted to {len(seen)} pictures")
    columns = (used[:n], anew[:n], used[n : 2 * n], anew[n : 2 * n])
    rows = [
        [name, *(number(column[k], 3) for column in columns)] for k, name in enumerate(EVIDENCE.names or ())
    ]
    print(table(["evidence", "floor, in use", "anew", "ceiling, in use", "anew"], rows))
    rows = [
        [b, number(used[2 * n + k], 3), number(anew[2 * n + k], 3)] for k, b in enumerate(BIAS.names or ())
    ]
    print(table(["odds of a pair of", "in use", "anew"], rows), "\n")
    rest = [p for p in pictures if p.held_out]
    sets = {
        "corridors not fitted to": [p for p in rest if np.isfinite(p.truth)],
        "open halls not fitted to": [p for p in rest if not np.isfinite(p.truth)],
        "office 640x480": office((640, 480)),
        "office 320x240": office((320, 240)),
    }
    rows = [[name, *worth(used, some), *worth(anew, some)[1:]] for name, some in sets.items() if some]
    print(table(["", "pictures", "answered, in use", "wrong corner", "answered, anew", "wrong corner"], rows))


if __name__ == "__main__":
    typer.run(main)
