"""How the estimator behaves when something is wrong: a table of faults, each with what is asked, and random flights.

    python benchmarks/faults.py [--only WORDS] [--random 1000] [--seconds 20] [--processes 2] [--shared ../shared]

Each fault is put into the samples of a simulated flight (gyroscope 0.0075 rad/s/sqrt(Hz), frames of 0.5 degree at
30 Hz that arrive 50 ms later, 3 % of them gross, attitude at 50 Hz), some also into logged flights whose pictures
are measured once, with what an undisturbed filter expects of them. Asked: an error within 1.5 times that of a good
system, or the status or a reason that tells of it within 0.5 s; no exception; no number that is none; and never
longer than 0.5 s *silent*, which is tracking beyond 4 sigma without a reason. `worst` is the largest error while
nothing is told, in degrees, or in per cent of half the width for the lateral offset, `asked` what it may be for
longer than 0.5 s, `sigmas` the same over sigma; `told` the time from the fault's start until something is; `after`
the largest error once the time for recovery has passed. A good system, where the table needs one, is a plain Kalman
filter of heading and bias with the same settings; for statistics it is the oracle of `consistency.py`.

Random flights have one to three faults of random kind, time and size; counted are those silent for more than 1 s.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from math import isfinite
from multiprocessing import get_context
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
sys.path.insert(0, str(Path(__file__).parent))

from fusion import load_flight
from support.fault_score import Fault, Outcome, fly, judge, merged, plain_kalman, silent_s
from support.fault_table import BY_NAME, FAULTS, ON_LOGGED
from support.flight_checks import FLIGHT_CHECKS
from support.oracle import oracle
from support.random_faults import random_faults
from support.recording import Recording, base_scene, logged_recording, simulated_recording
from support.scores import number, table
from tests.fusion.simulated import weaving, wrap

ROOT = Path(__file__).parents[1]
RANDOM_SILENT_S = 1.0
RANDOM_GYRO_HZ = 100.0  # half the base scene's, for half the time
WORST_SHOWN = 15


def on_recording(fault: Fault, clean: Recording, seed: int = 0) -> Outcome:
    """Put a fault into a flight and judge it."""
    with np.errstate(all="ignore"):
        recording = (
            clean if fault.injection is None else fault.injection(clean, np.random.default_rng((seed, 3)))
        )
        trace = fly(recording, fault.quantity)
        peer_worst, ratio = 0.0, float("nan")
        if fault.bound.by_peer:
            peer = plain_kalman(recording, trace.t_s)
            error = np.degrees(wrap(peer - np.interp(trace.t_s, clean.t_s, clean.heading_rad)))
            peer_worst = float(np.abs(error[trace.t_s >= fault.start_s]).max())
        if fault.bound.over_oracle is not None and clean.simulated is not None:
            best = oracle(clean.simulated, trace.t_s)
            error = np.degrees(wrap(best - np.interp(trace.t_s, clean.t_s, clean.heading_rad)))
            ratio = float(np.sqrt(np.nanmean(trace.error**2) / np.mean(error**2)))
        return judge(fault, trace, peer_worst, ratio)


def on_simulated(fault: Fault) -> Outcome:
    """Fly a fault's simulated flights."""
    outcomes = []
    for seed in range(fault.flights):
        scene = base_scene(seed, fault.seconds, **fault.scene)
        outcomes.append(on_recording(fault, simulated_recording(scene, **fault.config), seed))
    return merged(fault, outcomes)


def on_random(seed: int, seconds: float = 20.0) -> tuple[str, float, int, int]:
    """Fly a random flight: its faults, seconds silent, exceptions, estimates that are not numbers."""
    rng = np.random.default_rng((seed, 78))
    heading = weaving(seed, np.radians(rng.uniform(3, 40)), rng.uniform(3, 8))
    attitude_hz = float(rng.choice([0.0, 50.0, 50.0]))
    scene = base_scene(seed, seconds, heading=heading, attitude_hz=attitude_hz, gyro_hz=RANDOM_GYRO_HZ)
    names, inject = random_faults(seed)
    with np.errstate(all="ignore"):
        trace = fly(inject(simulated_recording(scene), rng))
    return names, silent_s(trace), trace.exceptions, trace.not_finite


def mapped(work: Callable[[Any], Any], tasks: Sequence[Any], processes: int) -> Iterator[Any]:
    """Do the work in so many processes, results in order."""
    if processes < 2:
        yield from map(work, tasks)
        return
    with get_context("fork").Pool(processes) as pool:
        yield from pool.imap(work, tasks, chunksize=1 if len(tasks) < 300 else 10)


def row(fault: Fault, outcome: Outcome) -> tuple[str, ...]:
    """Return a fault's line of the table."""
    verdict = "pass" if not outcome.failures else "FAIL: " + ", ".join(outcome.failures)
    told = "-" if not isfinite(outcome.told_s) else f"{outcome.told_s:.2f}"
    asked = "-" if not isfinite(outcome.within) else number(outcome.within, 1)
    return (
        fault.name,
        fault.group,
        number(outcome.worst, 1),
        asked,
        number(outcome.worst_sigma, 1),
        number(outcome.silent_s),
        told,
        number(outcome.after, 1),
        number(outcome.over_peer),
        number(outcome.nees),
        verdict,
        outcome.said[:60],
    )


HEADS = ("", "row", "worst", "asked", "sigmas", "silent s", "told s", "after", "/oracle", "NEES", "", "said")
LEFT = (0, 1, 10, 11)


def print_faults(title: str, judged: Iterable[tuple[Fault, Outcome]]) -> None:
    """Print a table and its sums."""
    done = list(judged)
    print(f"\n{title}")
    print(table(HEADS, [row(*each) for each in done], LEFT))
    passed = sum(not outcome.failures for _, outcome in done)
    silent = sum("silent" in outcome.failures for _, outcome in done)
    exceptions = sum(outcome.exceptions > 0 for _, outcome in done)
    print(f"{passed} of {len(done)} pass; silent beyond 0.5 s: {silent}; with exceptions: {exceptions}")


def print_random(flights: Sequence[tuple[str, float, int, int]], seconds: float) -> None:
    """Print how many random flights were silent, and what was in the worst."""
    silent = [flight for flight in flights if flight[1] > RANDOM_SILENT_S]
    kinds, of = Counter[str](), Counter[str]()
    for names, silent_for_s, *_ in flights:
        for name in names.split(" + "):
            of[name] += 1
            kinds[name] += silent_for_s > RANDOM_SILENT_S
    print(f"\n{len(flights)} random flights of {seconds:g} s with one to three faults")
    rows = [
        ("silent for more than 1 s", "0", str(len(silent))),
        ("silent for more than 0.5 s", "", str(sum(flight[1] > 0.5 for flight in flights))),
        ("with exceptions", "0", str(sum(flight[2] > 0 for flight in flights))),
        ("with numbers that are none", "0", str(sum(flight[3] > 0 for flight in flights))),
    ]
    print(table(("flights", "asked", "measured"), rows))
    print("\nFlights silent for more than 1 s, by what was in them")
    print(
        table(("", "silent", "of"), [(name, str(n), str(of[name])) for name, n in kinds.most_common() if n])
    )
    print("\nThe worst")
    worst = sorted(silent, key=lambda flight: -flight[1])[:WORST_SHOWN]
    print(table(("", "silent s"), [(names, f"{s:.1f}") for names, s, *_ in worst]))


def _by_name(name: str) -> Outcome:
    return on_simulated(next(fault for fault in FAULTS if fault.name == name))


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", default="", help="faults whose name or row contains this")
    parser.add_argument("--random", type=int, default=1000, help="random flights (default: 1000)")
    parser.add_argument("--seconds", type=float, default=20.0, help="length of a random flight (default: 20)")
    parser.add_argument("--processes", type=int, default=2, help="default: 2")
    parser.add_argument("--shared", type=Path, default=ROOT.parent / "shared", help="where flights/ lies")
    options = parser.parse_args()
    started = perf_counter()
    chosen = [f for f in FAULTS if options.only in f.name or options.only == f.group]
    outcomes = mapped(_by_name, [f.name for f in chosen], options.processes)
    print_faults(f"{len(chosen)} faults in simulated flights", zip(chosen, outcomes, strict=True))
    logged = [BY_NAME[name] for name in ON_LOGGED if BY_NAME[name] in chosen]
    folders = [
        ROOT / "data" / "office",
        *(options.shared / "flights" / name for name in ("clutter", "night")),
    ]
    for folder in folders if logged else []:
        if folder.is_dir():
            clean = logged_recording(folder)
            print_faults(
                f"{folder.name}: {len(logged)} faults", [(f, on_recording(f, clean)) for f in logged]
            )
    if options.only in ("", "checks"):
        office = load_flight(folders[0])
        checks = [(name, *check(office)) for name, check in FLIGHT_CHECKS.items()]
        print(f"\n{len(checks)} faults of a flight made by hand, and of a program")
        print(
            table(
                ("", "", "what happens"),
                [(n, "pass" if ok else "FAIL", said[:110]) for n, ok, said in checks],
                (0, 1, 2),
            )
        )
    if options.random > 0:
        flights = list(
            mapped(partial(on_random, seconds=options.seconds), range(options.random), options.processes)
        )
        print_random(flights, options.seconds)
    print(f"\ntook {perf_counter() - started:.0f} s")


if __name__ == "__main__":
    main()
