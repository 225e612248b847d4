"""When to keep silent: single frames measured under everything that goes wrong in corridors.

``python benchmarks/perturbations.py`` spoils every frame of the flights (``data/office`` and, where it lies beside
the repository, ``mononav_hallway``, at 640x480 and 320x240) and of simulated corridors, and draws hard views of
simulated corridors. Each frame is measured by itself, with roll and pitch as a log has them and no prior. The table
counts the accepted errors, above all those beyond 3 degrees, and the frames rejected although they were right.

What is right: the heading relative to the corridor being flown. Where another one meets it, relative to that one is
as good if the camera looks along it more, or at most 15 degrees less, than along the first; while the hallway's
vehicle turns from one corridor into the other, either will do. No answer is as good, every other answer is an error.
The hallway is judged by the vehicle's own yaw less one constant for each of its two corridors, taken from the frames
as they are; as that yaw is not exact, its frames do not count for |error|/sigma.
"""

from __future__ import annotations

import csv
import multiprocessing
import sys
import time
import zlib
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, fields, replace
from math import ceil, degrees
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import typer

from support.cases import (
    STRETCHES,
    Case,
    Result,
    Size,
    constant_rad,
    describe,
    flight_cases,
    flight_named,
    less_constant,
    measure,
    simulated_cases,
    size_name,
    turn_cases,
)
from support.perturb import ON_PICTURES
from support.scenes import SCENES, scene_cases
from support.scores import GROSS_DEG, heading_score, number, offset_score, percent, reasons_of, table
from vision.overlay import draw_overlay

SIZES: tuple[Size, ...] = ((640, 480), (320, 240))
SIMULATED = {(320, 240): 300, (640, 480): 100}  # views of the simulated corridors that pictures are spoilt of
DRAWN = {(320, 240): 240, (640, 480): 60}  # views of each kind in SCENES
OFFICE_PARTS = 3
JUNCTION = "across a junction"
SEED = 7


@dataclass(frozen=True, slots=True)
class Task:
    """Frames of one source under some perturbations, for one process to work on.

    Parameters
    ----------
    source
        ``simulated``, the name of a flight, or a kind of `SCENES`.
    names
        Perturbations of `ON_PICTURES`, or the kind itself.
    every, part, parts
        Take only every so many frames, and of these only one part.
    overlays
        Folder for pictures of the accepted errors above 3 degrees.
    """

    source: str
    size: Size
    names: tuple[str, ...]
    every: int
    part: int = 0
    parts: int = 1
    overlays: Path | None = None


def tasks_of(names: Sequence[str], every: int, overlays: Path | None) -> list[Task]:
    """Cut the work into pieces, largest first."""
    spoilt = tuple(name for name in names if name in ON_PICTURES)
    tasks = []
    for size in SIZES:
        if spoilt:
            parts = range(OFFICE_PARTS)
            tasks += [Task("office", size, spoilt, every, part, OFFICE_PARTS, overlays) for part in parts]
            tasks.append(Task("simulated", size, spoilt, every, overlays=overlays))
        if spoilt or JUNCTION in names:
            also = (JUNCTION,) if JUNCTION in names else ()
            tasks.append(Task("mononav_hallway", size, spoilt + also, every, overlays=overlays))
        drawn = [name for name in names if name in SCENES]
        tasks += [Task(name, size, (name,), every, overlays=overlays) for name in drawn]
    return [t for t in tasks if t.source not in ("office", *STRETCHES) or flight_named(t.source) is not None]


def run(task: Task) -> list[Result]:
    """Measure a task's frames."""
    cv2.setNumThreads(1)
    if task.source in SCENES:
        n = ceil(DRAWN[task.size] / task.every)
        return _measured(scene_cases(task.source, task.size, n, SEED), task.source, task)
    if task.source == "simulated":
        cases = list(simulated_cases(task.size, ceil(SIMULATED[task.size] / task.every), SEED))
        return _spoilt(cases, task)
    folder = flight_named(task.source)
    if folder is None:
        return []
    if task.source not in STRETCHES:
        stretches = flight_cases(folder, task.size, every=task.every)
        return [r for cases in stretches for r in _spoilt(cases[task.part :: task.parts], task)]
    # The constants come from all the frames, however few are then spoilt.
    results, constants = [], []
    for cases in flight_cases(folder, task.size):
        constants.append(constant_rad([measure(case)[0] for case in cases]))
        results += _spoilt(less_constant(cases[:: task.every], constants[-1]), task)
    if JUNCTION in task.names:
        results += _measured(turn_cases(folder, task.size, constants, every=task.every), JUNCTION, task)
    return results


def _spoilt(cases: Sequence[Case], task: Task) -> list[Result]:
    results: list[Result] = []
    for name in task.names:
        if name in ON_PICTURES:
            results += _measured((_perturbed(case, name) for case in cases), name, task)
    return results


def _perturbed(case: Case, name: str) -> Case:
    return ON_PICTURES[name](case, np.random.default_rng((zlib.crc32(name.encode()), case.index)))


def _measured(cases: Iterator[Case] | Sequence[Case], name: str, task: Task) -> list[Result]:
    results = []
    for case in cases:
        result, found = measure(case)
        result = replace(result, perturbation=name)
        if task.overlays is not None and is_gross(result):
            picture = draw_overlay(case.image, case.camera, found)
            line = np.full((24, picture.shape[1], 3), 32, np.uint8)
            cv2.putText(line, describe(result), (6, 17), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (255, 255, 255), 1)
            file = f"{name} {case.source} {case.index}.png".replace(" ", "_").replace("%", "pc")
            cv2.imwrite(str(task.overlays / file), np.vstack([picture, line]))
        results.append(result)
    return results


def is_gross(result: Result) -> bool:
    """Whether an accepted heading is beyond the limit of gross errors."""
    return result.accepted and degrees(abs(result.error_rad)) > GROSS_DEG


def print_table(title: str, names: Sequence[str], results: Sequence[Result]) -> None:
    """Print a row of scores for each kind of picture."""
    heads = (
        "",
        "frames",
        "accepted",
        "RMSE",
        "median",
        "worst",
        "> 3",
        "|e|/s p90",
        "silenced",
        "rejected, % of frames",
    )
    rows = []
    for name in names:
        mine = [r for r in results if r.perturbation == name]
        if mine:
            s = heading_score(mine)
            rows.append(
                (
                    name,
                    str(s.frames),
                    percent(s.accepted),
                    number(s.rmse),
                    number(s.median),
                    number(s.worst, 1),
                    str(s.gross),
                    number(s.sigma_p90),
                    percent(s.silenced_right, 0),
                    reasons_of(mine),
                )
            )
    if rows:
        print(f"{title}\n{table(heads, rows, left=(0, len(heads) - 1))}\n")


def print_offsets(names: Sequence[str], results: Sequence[Result]) -> None:
    """Print the lateral offsets of frames whose truth has one."""
    heads = ("", "frames", "answered", "RMSE", "median", "worst", "wrong corner", "|e|/s p90")
    rows = []
    for name in names:
        mine = [r for r in results if r.perturbation == name and r.offset_norm == r.offset_norm]
        if mine:
            s = offset_score(mine)
            numbers = (number(s.rmse), number(s.median), number(s.worst, 1), percent(s.wrong_corner))
            rows.append((name, str(s.frames), percent(s.answered), *numbers, number(s.sigma_p90)))
    if rows:
        print(f"Lateral offset, % of the width; wrong corner: error above 5 %\n{table(heads, rows)}\n")


def write_csv(path: Path, results: Sequence[Result]) -> None:
    """Write a row per frame."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, [f.name for f in fields(Result)])
        writer.writeheader()
        for result in results:
            row = asdict(result)
            writer.writerow({k: f"{v:.6g}" if isinstance(v, float) else v for k, v in row.items()})


def chosen(only: Sequence[str]) -> list[str]:
    """Names that contain one of the words; all without any."""
    names = [*ON_PICTURES, *SCENES]
    picked = [name for name in names if not only or any(word in name for word in only)]
    if not picked:
        raise typer.BadParameter(f"nothing is called {', '.join(only)}; known: {', '.join(names)}")
    return picked


def main(
    quick: Annotated[bool, typer.Option("--quick", help="A tenth of the frames.")] = False,
    every: Annotated[int, typer.Option(min=1, help="Take only every so many frames.")] = 1,
    only: Annotated[list[str] | None, typer.Option(help="Perturbations with this word; repeatable.")] = None,
    csv_file: Annotated[Path | None, typer.Option("--csv", help="Write a row per frame.")] = None,
    overlays: Annotated[
        Path | None, typer.Option(help="Folder for pictures of accepted errors above 3 degrees.")
    ] = None,
    processes: Annotated[int, typer.Option(min=1, max=2)] = 2,
) -> None:
    """Measure single frames under perturbations: what is accepted, and how wrong it is (degrees)."""
    names, started = chosen(only or []), time.perf_counter()
    if overlays is not None:
        overlays.mkdir(parents=True, exist_ok=True)
    for name in ("office", *STRETCHES):
        if flight_named(name) is None:
            print(f"flight {name}: not in this checkout, skipped")
    tasks, results = tasks_of(names, 10 * every if quick else every, overlays), []
    pool = ProcessPoolExecutor(processes, mp_context=multiprocessing.get_context("spawn"))
    with pool:
        for done, (task, found) in enumerate(zip(tasks, pool.map(run, tasks), strict=True), start=1):
            results += found
            if sys.stderr.isatty():
                print(
                    f"\r{done}/{len(tasks)} {task.source} {size_name(task.size)}\x1b[K",
                    end="",
                    file=sys.stderr,
                )
    if sys.stderr.isatty():
        print("\r\x1b[K", end="", file=sys.stderr)
    print(
        "Single frames, no prior; heading in degrees over accepted frames. silenced: rejected though right within 1.5"
    )
    print_table("Pictures of flights and of simulated corridors, spoilt", list(ON_PICTURES), results)
    print_table("Simulated corridors, drawn so (the junction with the hallway's turn)", list(SCENES), results)
    print_offsets(names, results)
    if csv_file is not None:
        write_csv(csv_file, results)
    total = heading_score(results)
    print(
        f"took {time.perf_counter() - started:.0f} s; {percent(total.accepted)} accepted, RMSE {number(total.rmse)}"
    )
    print(
        f"total: {total.frames} frames, {total.gross} accepted errors above {GROSS_DEG:g} degrees"
        f" ({total.across} took what runs square to the corridor for it)"
    )


if __name__ == "__main__":
    typer.run(main)
