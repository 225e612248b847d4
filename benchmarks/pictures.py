"""Every set of pictures at hand: what is measured, and whether it stays so when nothing of the corridor changes.

``python benchmarks/pictures.py`` measures the sample flight and, where they lie beside the repository, the shared
flights and the shared pictures of real corridors, each picture by itself. Then it encodes every picture again, moves
it half a pixel, mirrors it, scales it and darkens it, and prints how much heading and offset change and how many
pictures are accepted only before or only after. Pictures without a calibration are measured as ``corridor measure``
does: with a camera found from them.

So are rendered pictures as a fisheye lens takes them: simulated corridors of 120 degrees, and office and clutter bent
as by the middle of such a lens. What was found of the lens is printed beside the truth.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from math import ceil, degrees, nan, radians
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import typer

from fusion.pictures.assumed_camera import assume_views
from fusion.pictures.attitude_file import AttitudeFile
from fusion.pictures.measure import find_images
from fusion.simulate import random_views
from support.cases import (
    SHARED_FLIGHTS,
    STRETCHES,
    Case,
    Result,
    Size,
    case_of_view,
    constant_rad,
    flight_cases,
    flight_named,
    half_turn,
    less_constant,
    measure,
)
from support.harmless import HARMLESS
from support.scores import heading_score, number, percent, table
from vision import Camera
from vision.axis.field_of_view import estimate_field_of_view
from vision.cameras.camera import Distortion
from vision.images import read_image

SIZE: Size = (640, 480)
FLIGHTS = ("office", "clutter", "night", *STRETCHES)
PICTURE_SETS = ("handheld_corridor", "tello_corridor", "crazyflie_grey")
CALIBRATED = "calibrated pictures"
CHANGE_P90_DEG = {True: 0.10, False: 0.20}  # aims, of rendered and of real pictures
FLIPS = 0.02
FISHEYE_FOV_RAD = radians(120.0)
BENT_SIZE = (520, 390)  # as far as a picture of 640x480 and focal length 466 reaches
SIMULATED = 120
IMAGES, CASES = (SHARED_FLIGHTS.parent / name for name in ("images", "cases"))


@dataclass(frozen=True, slots=True)
class Repeat:
    """What a harmless change did to a set of pictures.

    Parameters
    ----------
    accepted
        Share of the changed pictures.
    flips
        Share of the pictures accepted only before, or only after.
    heading_p90_deg, heading_worst_deg
        Change of the headings of pictures accepted both times.
    offset_p90_percent
        Change of the offsets answered both times, per cent of the corridor's width.
    """

    accepted: float
    flips: float
    heading_p90_deg: float
    heading_worst_deg: float
    offset_p90_percent: float


def repeat_of(before: Sequence[Result], after: Sequence[Result], sign: float) -> Repeat:
    """Compare results of the same pictures before and after a change that turns headings by a sign."""
    pairs = list(zip(before, after, strict=True))
    both = [(a, b) for a, b in pairs if a.accepted and b.accepted]
    heading = np.array([abs(half_turn(sign * b.heading_rad - a.heading_rad)) for a, b in both])
    offset = np.array([abs(sign * b.answer_norm - a.answer_norm) for a, b in both])
    offset = offset[np.isfinite(offset)]
    return Repeat(
        accepted=float(np.mean([b.accepted for b in after])),
        flips=float(np.mean([a.accepted != b.accepted for a, b in pairs])),
        heading_p90_deg=degrees(float(np.percentile(heading, 90))) if len(heading) else nan,
        heading_worst_deg=degrees(float(heading.max())) if len(heading) else nan,
        offset_p90_percent=50.0 * float(np.percentile(offset, 90)) if len(offset) else nan,
    )


def sets_of_pictures(every: int) -> Iterator[tuple[str, list[Case] | str]]:
    """Yield the sets by name, one at a time in memory; instead of one that is not there, why it is left out."""
    for name in FLIGHTS:
        folder = flight_named(name)
        if folder is None:
            yield name, "not beside this checkout"
            continue
        for cases in flight_cases(folder, SIZE, every=every):
            yield cases[0].source.removesuffix(" 640x480"), cases
    for name in PICTURE_SETS:
        folder = IMAGES / name
        yield name, uncalibrated_cases(folder, every) if folder.is_dir() else "not beside this checkout"
    folder = CASES / "pictures"
    yield CALIBRATED, calibrated_cases(folder) if folder.is_dir() else "not beside this checkout"


def fisheye(width_px: int, height_px: int, focal_px: float) -> Camera:
    """Return an equidistant camera that looks straight ahead."""
    centre = (0.5 * (width_px - 1), 0.5 * (height_px - 1))
    return Camera(
        width_px, height_px, focal_px, focal_px, *centre, Distortion.EQUIDISTANT, (0.0, 0.0, 0.0, 0.0)
    )


def bent(case: Case) -> Case:
    """Show a picture as a fisheye lens of the same scale takes it: its middle, as far as the picture reaches."""
    camera = fisheye(*BENT_SIZE, case.camera.fx_px)
    y, x = np.mgrid[0 : camera.height_px, 0 : camera.width_px].astype(float)
    points = case.camera.project(camera.rays(np.column_stack([x.ravel(), y.ravel()])))
    u, v = points.T.reshape(2, camera.height_px, camera.width_px).astype(np.float32)
    return replace(
        case, image=np.asarray(cv2.remap(case.image, u, v, cv2.INTER_CUBIC), np.uint8), camera=camera
    )


def fisheye_cases(every: int) -> Iterator[tuple[str, list[Case]]]:
    """Yield sets of fisheye pictures with their true camera."""
    camera = fisheye(*SIZE, 0.5 * SIZE[0] / (0.5 * FISHEYE_FOV_RAD))
    views = random_views(camera, ceil(SIMULATED / every), seed=5, views_per_scene=4)
    yield "simulated fisheye", [case_of_view(v, "simulated fisheye", i, camera) for i, v in enumerate(views)]
    for name in ("office", "clutter"):
        folder = flight_named(name)
        if folder is not None:
            for cases in flight_cases(folder, SIZE, every=every):
                yield f"{name} bent", [bent(case) for case in cases]


def without_calibration(cases: Sequence[Case]) -> tuple[list[Case], str]:
    """Measure the camera from the pictures in place of the true one; say how far it is off.

    Single pictures' sigmas do not know what the camera may be off by, so that none is held against them.
    """
    true, found = cases[0].camera, estimate_field_of_view(case.image for case in cases)
    camera = found.camera(true.width_px, true.height_px)
    edge = np.array([[-0.5, true.cy_px], [true.width_px - 0.5, true.cy_px]])
    true_deg, found_deg = (
        degrees(float(np.arccos(np.prod(c.rays(edge), axis=0).sum()))) for c in (true, camera)
    )
    text = f"{found_deg:.1f} +- {degrees(found.std_rad):.1f} degrees found for {true_deg:.1f}"
    return [replace(case, camera=camera, attitude=None, exact=False) for case in cases], text


def uncalibrated_cases(folder: Path, every: int) -> list[Case]:
    """Load pictures of an unknown camera, with what `assume_views` finds of it."""
    paths = find_images([folder])
    views = assume_views(paths)
    cases = []
    for index, path in list(enumerate(paths))[::every]:
        image = read_image(path)
        cases.append(
            Case(folder.name, index, image, views.of(path, image).camera(), None, (nan,), exact=False)
        )
    return cases


def calibrated_cases(folder: Path) -> list[Case]:
    """Load the real pictures that have a calibration, a roll and a pitch."""
    camera, tilts = Camera.from_yaml(folder / "indoor.yaml"), AttitudeFile.read(folder / "tilt.csv")
    paths = [path for path in find_images([folder]) if path.name.startswith("corridor_")]
    return [
        Case(CALIBRATED, index, read_image(path), camera, tilts.of(path, None), (nan,), exact=False)
        for index, path in enumerate(paths)
    ]


def measured(cases: Sequence[Case]) -> list[Result]:
    """Measure cases by the default method."""
    return [measure(case)[0] for case in cases]


def rows_of(name: str, cases: Sequence[Case]) -> Iterator[tuple[str, ...]]:
    """Measure a set as it is and after every change: a row of the table each."""
    before = measured(cases)
    rendered = all(case.exact for case in cases)
    if cases[0].source.startswith("hallway"):
        cases = less_constant(cases, constant_rad(before))
        before = measured(cases)
    score = heading_score([r for r in before if r.error_rad == r.error_rad])
    answered = np.mean([r.accepted and r.answer_norm == r.answer_norm for r in before])
    first = (
        name,
        str(len(cases)),
        percent(float(np.mean([r.accepted for r in before]))),
        percent(float(answered)),
    )
    yield (*first, number(score.rmse, 3), number(score.worst), number(score.sigma_p90), "", "", "", "", "")
    for change, (apply, sign) in HARMLESS.items():
        changed = [apply(case) for case in cases]
        after = measured(changed)
        repeat = repeat_of(before, after, sign)
        score = heading_score([r for r in after if r.error_rad == r.error_rad])
        answered = np.mean([r.accepted and r.answer_norm == r.answer_norm for r in after])
        p90 = repeat.heading_p90_deg
        missed = [
            word
            for word, good in (
                ("change", not p90 > CHANGE_P90_DEG[rendered]),
                ("flips", repeat.flips <= FLIPS),
            )
            if not good
        ]
        aim = (
            "-" if change == "a quarter of the light" else "misses " + ", ".join(missed) if missed else "met"
        )
        yield (
            f"  {change}",
            "",
            percent(repeat.accepted),
            percent(float(answered)),
            number(score.rmse, 3),
            number(score.worst),
            number(score.sigma_p90),
            percent(repeat.flips),
            number(p90, 3),
            number(repeat.heading_worst_deg),
            number(repeat.offset_p90_percent),
            aim,
        )


def main(
    quick: Annotated[bool, typer.Option("--quick", help="A tenth of the frames.")] = False,
    every: Annotated[int, typer.Option(min=1, help="Take only every so many frames.")] = 1,
) -> None:
    """Measure every set of pictures, and again after changes that should not matter."""
    cv2.setNumThreads(1)
    rows: list[tuple[str, ...]] = []
    for name, true_cases in fisheye_cases(10 * every if quick else every):
        guessed, text = without_calibration(true_cases)
        print(f"{name}: field of view {text}")
        rows += rows_of(name, guessed)
    for name, cases in sets_of_pictures(10 * every if quick else every):
        if isinstance(cases, str):
            print(f"{name}: {cases}, skipped")
            continue
        if sys.stderr.isatty():
            print(f"\r{name}\x1b[K", end="", file=sys.stderr)
        rows += rows_of(name, cases)
    if sys.stderr.isatty():
        print("\r\x1b[K", end="", file=sys.stderr)
    print(
        "Single pictures, no prior; degrees, offsets in % of the width. Changes: of pictures accepted both times"
    )
    heads = (
        "",
        "pictures",
        "accepted",
        "offset",
        "RMSE",
        "worst",
        "|e|/s p90",
        "flips",
        "change p90",
        "worst",
        "offset p90",
        "aim",
    )
    print(table(heads, rows, left=(0, len(heads) - 1)))
    aims = f"{CHANGE_P90_DEG[True]} rendered, {CHANGE_P90_DEG[False]} real"
    print(f"  aim: heading's change p90 {aims}; flips at most {percent(FLIPS, 0)}")


if __name__ == "__main__":
    typer.run(main)
