"""Does the estimator know the corridor it is in? Simulated junctions, side corridors and turns on the spot.

    python benchmarks/junctions.py [--count 1000]

Of each kind of flight the table counts those that end with a wrong ``corridor_index`` or a ``corridor_turn_rad`` more
than 10 degrees off, and tells the worst heading error in the last two seconds, relative to the true corridor.

A turn into another corridor has any angle of 30 to 150 degrees to either side and takes 1 to 4 seconds. The corridors
are seen in one of three ways: the nearer one all the time; with a stretch of up to 2.5 seconds in which frames are
lost; or as a camera sees them, no farther than 45 degrees to the side, and what it sees between is at random nothing,
or the walls across the old corridor. A side corridor passed is seen instead of the one being flown for up to 2
seconds. A turn on the spot, by 180 degrees, leads back. In all flights the vehicle weaves, 5 % of the frames are
gross, errors correlate, and frames are 80 ms late.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from math import degrees, pi, radians
from time import perf_counter
from typing import Any

import numpy as np
import numpy.typing as npt

from fusion import CorridorEstimator
from support.flown import settings
from support.scores import table
from tests.fusion.simulated import Scene, give, plus, simulate, turning, weaving, wrap

FloatArray = npt.NDArray[np.float64]
Function = Callable[[FloatArray], FloatArray]

START_S, END_S = 5.0, 6.0  # before and after the manoeuvre
LATE_S = 2.0
WRONG_TURN_RAD = radians(10)
VIEW_RAD = radians(45)


@dataclass(frozen=True, slots=True)
class Case:
    """A flight and what should come of it."""

    scene: Scene
    corridor: int
    turn_rad: float


@dataclass(frozen=True, slots=True)
class Outcome:
    """Whether the corridor is right at the end, and the worst heading error in the last seconds, radians."""

    right: bool
    late_rad: float
    said: str


def scene(seed: int, seconds: float, heading: Function, axis: Function, **changes: Any) -> Scene:
    """Make a flight that weaves besides."""
    rng = np.random.default_rng((seed, 2))
    values: dict[str, Any] = {
        "seed": seed,
        "duration_s": seconds,
        "heading": plus(heading, weaving(seed, radians(rng.uniform(0, 8)), rng.uniform(4, 8))),
        "axis": axis,
        "gyro_hz": 100.0,
        "gyro_bias": float(rng.normal(0, 0.01)),
        "frame_correlation": 0.5,
        "gross": 0.05,
        "delay_s": 0.08,
    }
    return Scene(**(values | changes))


def turned(seed: int, how: str) -> Case:
    """Make a turn into another corridor."""
    rng = np.random.default_rng((seed, 3))
    angle = radians(rng.uniform(30, 150)) * rng.choice([-1.0, 1.0])
    length = rng.uniform(1.0, 4.0)
    middle, seconds = START_S + length / 2, START_S + length + END_S
    heading, gaps = turning((START_S, length, angle)), []
    axis = pieces((middle, angle))
    if how == "lost":
        gap = rng.uniform(0.2, 2.5)
        gaps = [(middle - gap / 2, middle + gap / 2)]
    elif how == "seen as by a camera":
        t = np.arange(START_S, START_S + length, 0.01)
        psi = heading(t)
        blind = t[(np.abs(psi) > VIEW_RAD) & (np.abs(angle - psi) > VIEW_RAD)]
        if len(blind) and rng.uniform() < 0.5:
            gaps = [(float(blind[0]), float(blind[-1]))]
        elif len(blind):
            across = (pi / 2) * np.sign(angle)
            axis = pieces((float(blind[0]), across), (float(blind[-1]), angle))
    return Case(scene(seed, seconds, heading, axis, dropouts=gaps), 1, float(angle))


def passed(seed: int) -> Case:
    """Make a flight straight on past a side corridor."""
    rng = np.random.default_rng((seed, 4))
    angle = radians(rng.uniform(30, 150)) * rng.choice([-1.0, 1.0])
    start, length = START_S, rng.uniform(0.2, 2.0)
    axis = pieces((start, angle), (start + length, 0.0))
    return Case(scene(seed, start + length + END_S, turning(), axis), 0, 0.0)


def about(seed: int) -> Case:
    """Make a turn on the spot, by half a circle, half of them with a stretch in which frames are lost."""
    rng = np.random.default_rng((seed, 5))
    angle, length = pi * rng.choice([-1.0, 1.0]), rng.uniform(1.5, 5.0)
    gap = rng.choice([0.0, rng.uniform(0.2, length)])
    middle = START_S + length / 2
    gaps = [(middle - gap / 2, middle + gap / 2)]
    heading = turning((START_S, length, angle))
    return Case(scene(seed, START_S + length + END_S, heading, pieces(), dropouts=gaps), 0, 0.0)


def pieces(*changes: tuple[float, float]) -> Function:
    """Return the direction of the axis that frames see: zero, and from each (time, angle) on that angle."""
    starts, angles = np.array([-1.0, *(t for t, _ in changes)]), np.array([0.0, *(a for _, a in changes)])
    return lambda t: angles[np.searchsorted(starts, np.asarray(t, float), side="right") - 1]


def fly(case: Case) -> Outcome:
    """Run the estimator through the flight."""
    simulated = simulate(case.scene)
    estimator = CorridorEstimator(settings(case.scene))
    late, seconds = 0.0, case.scene.duration_s
    for count, sample in enumerate(simulated.samples):
        give(estimator, sample)
        if sample.t_ns * 1e-9 > seconds - LATE_S and count % 5 == 0:
            e = estimator.estimate()
            truth = float(np.interp(e.timestamp_ns * 1e-9, simulated.t_s, simulated.heading)) - case.turn_rad
            late = max(late, abs(float(wrap(e.heading_rad - truth))))
    e = estimator.estimate()
    off = abs(float(wrap(e.corridor_turn_rad - case.turn_rad)))
    right = e.corridor_index == case.corridor and off <= WRONG_TURN_RAD
    said = f"corridor {e.corridor_index}, turned {degrees(e.corridor_turn_rad):.0f} degrees, {e.status}"
    return Outcome(right, late, said)


KINDS: dict[str, Callable[[int], Case]] = {
    "turn, corridors seen all the time": lambda seed: turned(seed, "always"),
    "turn, frames lost": lambda seed: turned(seed, "lost"),
    "turn, seen as by a camera": lambda seed: turned(seed, "seen as by a camera"),
    "side corridor passed": passed,
    "turn on the spot, 180 degrees": about,
}
TURNS = 3  # the first three kinds


def shares(count: int) -> Iterator[tuple[str, range]]:
    """Yield kinds and their seeds: ``count`` turns into other corridors, and a quarter as many of the others."""
    first = 0
    for k, name in enumerate(KINDS):
        n = count // TURNS + (k < count % TURNS) if k < TURNS else max(count // 4, 1)
        yield name, range(first, first + n)
        first += n


def main() -> None:
    """Print the table, and what was said in the flights that ended wrong."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=1000, help="turns into other corridors (default: 1000)")
    options = parser.parse_args()
    started, rows, complaints = perf_counter(), [], []
    flights = n_wrong = 0
    for name, seeds in shares(max(options.count, TURNS)):
        outcomes = {seed: fly(KINDS[name](seed)) for seed in seeds}
        wrong = [seed for seed, outcome in outcomes.items() if not outcome.right]
        right = [outcome.late_rad for outcome in outcomes.values() if outcome.right]
        rows.append((name, str(len(seeds)), str(len(wrong)), f"{degrees(max(right, default=0.0)):.2f}"))
        for seed in wrong:
            turn = degrees(KINDS[name](seed).turn_rad)
            complaints.append(f"  {name}, seed {seed}, {turn:.0f} degrees: {outcomes[seed].said}")
        flights += len(seeds)
        n_wrong += len(wrong)
    print(table(("", "flights", "wrong corridor", "worst heading error at the end, degrees"), rows))
    print("\n".join(["", *complaints, ""]) if complaints else "")
    print(f"{n_wrong} of {flights} wrong (asked: none); took {perf_counter() - started:.0f} s")


if __name__ == "__main__":
    main()
