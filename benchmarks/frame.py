"""What a frame costs, in units of ``cv2.GaussianBlur`` + ``cv2.Canny``, and how exact the answer is.

``python benchmarks/frame.py`` times everything in one process, on one thread, on the same frames of ``data/office``.
On every frame the unit and each measurement take turns, twice; the second turns count, when both find the caches
alike, and a ratio is the median over frames of one turn's time over the other's. Times are those the thread had the
processor (where the system tells them finely enough), so that other processes' turns do not count. ``--with-peer``
adds lu-vp-detect 1.0.4 from PyPI, in an environment of its own under the user's cache folder (it wants OpenCV 4); its
ratio is to the unit timed there.
"""

from __future__ import annotations

import gc
import json
import os
import subprocess
import sys
import tracemalloc
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from math import degrees, nan
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import cv2
import numpy as np
import typer

from support.cases import Case, Size, flight_cases, flight_named, size_name
from support.clock import clock
from support.peer import PEER, Peer, environment_folder, make_environment
from support.ransac import heading_by_ransac, segments
from support.scores import number, percent, rms, table
from vision import Attitude, FrameMeasurement, extract_lines, measure_frame, measure_lines
from vision.images import GreyImage

SIZES: tuple[Size, ...] = ((640, 480), (320, 240))
LSD = "OpenCV's LSD"
LINES = "lines"
UNIT = "GaussianBlur + Canny"
TURNS = 2
WARM_UP_FRAMES, GROWTH_FRAMES = 200, 2000
# By the picture's size. The offset is by lines alone, but in `measure_frame`, where the network looks as well.
AIMS: dict[Size, dict[str, float]] = {
    (640, 480): {LINES: 1.35, "heading": 1.7, "heading + offset": 2.3, "measure_frame": 4.0},
    (320, 240): {LINES: 1.3, "heading": 2.0, "heading + offset": 2.8, "measure_frame": 6.0},
}


@dataclass(slots=True)
class Contender:
    """A way to measure a frame, with its times and errors as they come.

    Parameters
    ----------
    run
        Returns the heading in radians, NaN where it does not answer.
    times_s, ratios, errors_deg
        Per frame.
    """

    run: Callable[[Case], float]
    answers: bool = True
    times_s: list[float] = field(default_factory=list)
    ratios: list[float] = field(default_factory=list)
    errors_deg: list[float] = field(default_factory=list)


def unit(case: Case) -> float:
    """Blur and find edges as OpenCV does: the unit of the table."""
    cv2.Canny(cv2.GaussianBlur(case.image, (5, 5), 0), 50, 150)
    return nan


def lines(case: Case) -> float:
    """Find the lines only."""
    extract_lines(case.image, case.camera)
    return nan


def _answer(found: FrameMeasurement) -> float:
    return found.heading_rad if found.accepted else nan


def heading(case: Case) -> float:
    """Measure the heading alone."""
    return _answer(measure_frame(case.image, case.camera, lateral=False))


def heading_and_geometric_offset(case: Case) -> float:
    """Without the picture there are no regions for the network to look at."""
    found = extract_lines(case.image, case.camera, keep_picture=False)
    return _answer(measure_lines(found, case.camera))


def whole(case: Case) -> float:
    """Measure a frame as a user calls it."""
    return _answer(measure_frame(case.image, case.camera))


def whole_with_attitude(case: Case) -> float:
    """Measure a frame whose attitude is known."""
    return _answer(measure_frame(case.image, case.camera, case.attitude))


def paper(case: Case) -> float:
    """Measure by the article's method."""
    return _answer(measure_frame(case.image, case.camera, method="paper"))


def lsd(case: Case) -> float:
    """Find line segments by OpenCV's LSD."""
    segments(case.image)
    return nan


def ransac(case: Case) -> float:
    """Measure the heading by RANSAC on LSD's segments."""
    return heading_by_ransac(case.image, case.camera, case.attitude or Attitude(0.0, 0.0))


def contenders() -> dict[str, Contender]:
    """Return what is timed, by name."""
    return {
        UNIT: Contender(unit, answers=False),
        LINES: Contender(lines, answers=False),
        "heading": Contender(heading),
        "heading + offset": Contender(heading_and_geometric_offset),
        "measure_frame": Contender(whole),
        "with attitude": Contender(whole_with_attitude),
        LSD: Contender(lsd, answers=False),
        "LSD + RANSAC": Contender(ransac),
        "paper": Contender(paper),
    }


def timed(run: Callable[[Case], float], case: Case) -> tuple[float, float]:
    """Run a contender on a case; return its answer and the seconds it took."""
    started = clock()
    answer = run(case)
    return answer, clock() - started


def race(cases: Sequence[Case], python: Path | None) -> dict[str, Contender]:
    """Let everything measure every frame, in turns with the unit."""
    field_ = contenders()
    for one in field_.values():
        one.run(cases[0])
    with ExitStack() as stack:
        peer = None
        if python is not None:
            peer = stack.enter_context(Peer(python, [c.image for c in cases], cases[0].camera))
            peer.measure(0, cases[0].attitude or Attitude(0.0, 0.0))
            field_[PEER] = Contender(lambda case: nan)
        for frame, case in enumerate(cases):
            for name, one in field_.items():
                for _ in range(TURNS):
                    if name == PEER and peer is not None:
                        reply = peer.measure(frame, case.attitude or Attitude(0.0, 0.0))
                        answer, taken, beside = reply.heading_rad, 1e-3 * reply.ms, 1e-3 * reply.unit_ms
                    else:
                        beside = timed(unit, case)[1]
                        answer, taken = timed(one.run, case)
                one.times_s.append(taken)
                one.ratios.append(taken / beside)
                if one.answers:
                    one.errors_deg.append(degrees(case.error_rad(answer)))
    return field_


def print_race(size: Size, field_: dict[str, Contender], frames: int) -> None:
    """Print times and errors of all at one size."""
    print(f"\noffice at {size_name(size)}, {frames} frames, one thread; heading errors in degrees")
    heads = ("", "ms", "ms p90", "units", "aim", "answers", "RMSE", "median", "worst")
    rows = []
    for name, one in field_.items():
        ms = 1e3 * np.array(one.times_s)
        error = np.array([abs(e) for e in one.errors_deg if e == e])
        rows.append(
            (
                name,
                number(float(np.median(ms))),
                number(float(np.percentile(ms, 90))),
                number(float(np.median(one.ratios))),
                number(AIMS[size].get(name, nan)),
                percent(len(error) / len(one.errors_deg)) if one.errors_deg else "-",
                number(rms(error), 3),
                number(float(np.median(error)) if len(error) else nan, 3),
                number(float(error.max()) if len(error) else nan),
            )
        )
    print(table(heads, rows))
    ours = float(np.median(field_["heading"].ratios))
    faster = float(np.median(field_[LSD].ratios)) / float(np.median(field_[LINES].ratios))
    print(f"  lines against OpenCV's LSD: {faster:.1f} times faster (aim 1)")
    if PEER in field_:
        # Each is held against the unit of its own OpenCV; by the clock the same comes out but for that.
        clock = np.median(field_[PEER].times_s) / np.median(field_["heading"].times_s)
        print(
            f"  heading against lu-vp-detect: {np.median(field_[PEER].ratios) / ours:.0f} times faster"
            f" (aim 30; by the clock {clock:.0f})"
        )


FIRST_CALL = """
import json, sys, time
started = time.perf_counter()
import numpy as np
from vision import Camera, measure_frame
imported = time.perf_counter()
camera = Camera.from_fov(320, 240, 1.2)
image = np.load(sys.argv[1])
measure_frame(image, camera)
first = time.perf_counter()
measure_frame(image, camera)
print(json.dumps([imported - started, first - imported, time.perf_counter() - first]))
"""


def print_first_call(image: GreyImage) -> None:
    """Time the first frame of a new process: with an empty cache of compiled code, and with it filled."""
    print("\nFirst frame of a new process, seconds (320x240)")
    rows = []
    with TemporaryDirectory(prefix="corridor-first-") as folder:
        frame = Path(folder) / "frame.npy"
        np.save(frame, image)
        for name in ("compiling", "from the cache"):
            done = subprocess.run(
                [sys.executable, "-c", FIRST_CALL, str(frame)],
                env=os.environ | {"NUMBA_CACHE_DIR": str(Path(folder) / "cache")},
                check=True,
                stdout=subprocess.PIPE,
                text=True,
            )
            seconds = json.loads(done.stdout.splitlines()[-1])
            rows.append((name, *(f"{s:.3f}" for s in seconds)))
    print(table(("", "import vision", "first frame", "second frame"), rows))


def resident_mib() -> float:
    """Memory this process holds; NaN where the system does not say."""
    try:
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    except (OSError, ValueError, IndexError):
        return nan
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


def print_growth(cases: Sequence[Case], frames: int) -> None:
    """Show what memory many frames leave behind, after the first ones have made their buffers."""
    for k in range(WARM_UP_FRAMES):
        whole(cases[k % len(cases)])
    gc.collect()
    before_mib = resident_mib()
    for k in range(frames):
        whole(cases[k % len(cases)])
    gc.collect()
    after_mib = resident_mib()
    tracemalloc.start()
    traced = []
    for part in (WARM_UP_FRAMES, frames // 4):
        for k in range(part):
            whole(cases[k % len(cases)])
        gc.collect()
        traced.append(tracemalloc.get_traced_memory()[0])
    tracemalloc.stop()
    print(
        f"\nMemory at {size_name(cases[0].image.shape[::-1])} after {WARM_UP_FRAMES} frames and after {frames} more"
    )
    print(f"  resident: {before_mib:.1f} MiB, then {after_mib:.1f} MiB: {after_mib - before_mib:+.1f} MiB")
    print(
        f"  allocated by Python and numpy over {frames // 4} frames, traced:"
        f" {(traced[1] - traced[0]) / 1024:+.1f} KiB"
    )


def peer_python(wanted: bool) -> Path | None:
    """Return the interpreter of the peer's environment, made if need be; None without one."""
    if not wanted:
        print(f"{PEER}: skipped, not asked for (--with-peer makes an environment for it)")
        return None
    try:
        return make_environment(environment_folder())
    except RuntimeError as error:
        print(f"{PEER}: skipped, its environment cannot be made: {error}")
        return None


def main(
    quick: Annotated[bool, typer.Option("--quick", help="A tenth of the frames.")] = False,
    every: Annotated[int, typer.Option(min=1, help="Take only every so many frames.")] = 1,
    with_peer: Annotated[bool, typer.Option("--with-peer", help="Add lu-vp-detect from PyPI.")] = False,
    first_call: Annotated[bool, typer.Option(help="Time compilation too.")] = True,
) -> None:
    """Time single frames against blur and Canny, with the error of each answer beside its time."""
    cv2.setNumThreads(1)
    folder = flight_named("office")
    if folder is None:
        print("flight office: not in this checkout, nothing to time")
        return
    step = 10 * every if quick else every
    print(f"OpenCV {cv2.__version__}, numpy {np.__version__}; medians, units: {UNIT} on the same frame")
    python = peer_python(with_peer)
    small: list[Case] = []
    for size in SIZES:
        cases = [c for stretch in flight_cases(folder, size, every=step) for c in stretch]
        print_race(size, race(cases, python), len(cases))
        small = cases
    print_growth(small, max(GROWTH_FRAMES // step, WARM_UP_FRAMES))
    if first_call:
        print_first_call(small[0].image)


if __name__ == "__main__":
    typer.run(main)
