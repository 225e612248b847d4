"""How well the network of `vision.lateral.learned` tells the lateral offset from single frames, and what it costs.

``python benchmarks/learned_offset.py`` prints, for each flight with known truth and for simulated corridors that
the network was not trained on: the share of frames whose likeliest offset is within 0.10 half widths, the share that
is sure (more than 0.9 of the probability within 0.10 of it) and how many of these are wrong, the median error, and
the 90th percentile of error over sigma of the sure ones. The corridor's axis is the one that vision finds in the same
picture; frames whose axis it does not accept are left out. The first half of the simulated pictures also served to
calibrate "cannot tell". ``--drawings`` writes pictures with the likeliest corners, also of flights without truth.
"""

from __future__ import annotations

from collections.abc import Callable
from math import inf
from pathlib import Path
from time import perf_counter
from typing import Annotated

import cv2
import numpy as np
import typer

from fusion.logs import load_flight
from support.cases import Case, attitudes_at, flight_cases, flight_folders
from training.offset_views import TrainingView, measured_frame, render_views
from training.scores import OffsetScores
from vision import Attitude, Camera
from vision.images import GreyImage, to_grey
from vision.lateral.learned import corner_scores, learned_mixture, likeliest_corners, mixture_of
from vision.lateral.polar import WIDEST_TAN, polar_picture

SIZE = (640, 480)
HELD_OUT_SEED = 900
COLOURS = (
    (0, 255, 255),
    (0, 190, 255),
    (255, 120, 0),
    (255, 0, 200),
)  # floor left, right, ceiling left, right


def line_of_flight(cases: list[Case]) -> str:
    """Score the network on a flight's frames, as a line."""
    known = [case for case in cases if case.offset_norm == case.offset_norm]
    axes = [measured_frame(case.image, case.camera, case.attitude) for case in known]
    pairs = [(case, axis[0]) for case, axis in zip(known, axes, strict=True) if axis is not None]
    mixtures = [learned_mixture(case.image, case.camera, R) for case, R in pairs]
    scores = OffsetScores.of(mixtures, [case.offset_norm for case, _ in pairs])
    return f"{len(pairs)} of {len(known)} frames: {scores.line()}"


def line_of_views(views: list[TrainingView]) -> str:
    """Score the network on simulated views, as a line."""
    pairs = [(view, view.R_measured) for view in views if view.R_measured is not None]
    mixtures = [learned_mixture(view.image, view.camera, R) for view, R in pairs]
    scores = OffsetScores.of(mixtures, [view.box.offset_norm for view, _ in pairs])
    return f"{len(pairs)} of {len(views)} frames: {scores.line()}"


def cost_ms(view: TrainingView, repeats: int = 200) -> dict[str, float]:
    """Fastest time of each step on this thread, milliseconds."""
    polar = polar_picture(view.image, view.camera, view.R_true)
    found = corner_scores(polar)
    steps: dict[str, Callable[[], object]] = {
        "resample": lambda: polar_picture(view.image, view.camera, view.R_true),
        "network": lambda: corner_scores(polar),
        "mixture": lambda: mixture_of(found),
        "together": lambda: learned_mixture(view.image, view.camera, view.R_true),
    }
    best = dict.fromkeys(steps, inf)
    for _ in range(repeats):
        for name, step in steps.items():
            started = perf_counter()
            step()
            best[name] = min(best[name], 1e3 * (perf_counter() - started))
    return best


def drawn(image: GreyImage, camera: Camera, attitude: Attitude | None) -> GreyImage:
    """Draw the likeliest corners into a picture: thick where one angle holds most of the probability."""
    out = np.asarray(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR), np.uint8)
    axis = measured_frame(image, camera, attitude)
    if axis is None:
        return out
    found = corner_scores(polar_picture(image, camera, axis[0]))
    radii = np.geomspace(0.05, 2.0 * WIDEST_TAN, 60)
    for colour, angle, p in zip(COLOURS, likeliest_corners(found), found.corner, strict=True):
        rays = np.stack([np.ones_like(radii), radii * np.cos(angle), radii * np.sin(angle)], axis=1)
        points = camera.project(rays @ axis[0])
        points = points[np.isfinite(points).all(axis=1)]
        sure = p[max(0, p.argmax() - 2) : p.argmax() + 3].sum() > 0.5
        cv2.polylines(
            out, [np.clip(np.round(points), -9999, 9999).astype(np.int32)], False, colour, 2 if sure else 1
        )
    mixture = mixture_of(found)
    told = " ".join(
        f"{y:+.2f}+-{s:.2f} ({w:.0%})"
        for w, y, s in zip(mixture.weight, mixture.offset_norm, mixture.std_norm, strict=True)
    )
    cv2.putText(out, told, (4, 14), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (0, 0, 255), 1)
    return out


def draw_flight(folder: Path, out: Path, every: int) -> None:
    """Draw the corners it is sure of into pictures of a flight."""
    flight = load_flight(folder)
    attitudes = attitudes_at(flight.attitude, flight.frames.t_ns)
    for i in range(0, len(flight.frames.t_ns), every):
        picture = drawn(to_grey(flight.frames.read(i)), flight.camera, attitudes[i])
        cv2.imwrite(str(out / f"{flight.name}_{i:04d}.png"), picture)


def main(
    views: Annotated[int, typer.Option(help="Simulated pictures.")] = 480,
    drawings: Annotated[Path | None, typer.Option(help="Folder for pictures with corners.")] = None,
    every: Annotated[int, typer.Option(help="Of the drawings: one in so many frames.")] = 20,
) -> None:
    """Print the scores, and draw pictures where asked."""
    cv2.setNumThreads(1)
    for folder in flight_folders():
        for cases in flight_cases(folder, SIZE):
            if any(case.offset_norm == case.offset_norm for case in cases):
                print(f"{folder.name:18s}", line_of_flight(cases))
        if drawings is not None:
            drawings.mkdir(parents=True, exist_ok=True)
            draw_flight(folder, drawings, every)
    simulated = list(render_views(views, HELD_OUT_SEED))
    for name, is_hall in (("simulated", False), ("simulated halls", True)):
        some = [view for view in simulated if view.is_hall == is_hall]
        if some:
            print(f"{name:18s}", line_of_views(some))
    large = next((v for v in simulated if v.image.shape == SIZE[::-1]), simulated[0])
    print("ms:", ", ".join(f"{name} {ms:.2f}" for name, ms in cost_ms(large).items()))


if __name__ == "__main__":
    typer.run(main)
