"""What `corridor batch` costs over fusing flights one by one, and what more workers bring.

    python benchmarks/fleet.py [--flights 200] [--distinct 10] [--seconds 10] [--reports] [--rows 20000]

Simulates some distinct flights (320x240, 20 Hz, IMU 200 Hz) and makes a fleet of manifests that name them in turn.
Each flight is fused plainly in this process (`load_flight`, `fuse_flight`, `write_outputs`) and, turn by turn, as
a worker does; then the fleet by one worker, by two, and again with nothing to do. Besides wall clock it tells
processor time, on which other programs of the machine weigh less. Targets: two workers at least 1.8 times as fast
as one (beside it stands what two processes gain that only calculate, the most that the machine allows), at most 50
ms of overhead per flight, in the worker and in the process that hands the flights out.

The last lines are what a model of the cost needs: seconds to start a worker, and to find, stamp, journal and tabulate
a flight, from a table of ``--rows`` made-up rows; what workers and this process hold; and what Dask's scheduler takes
of a processor for each flight beside the local processes.
"""

from __future__ import annotations

import argparse
import os
import resource
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fusion import FusionConfig, fuse_flight, load_flight, write_outputs
from fusion.fleet.batch import BatchSettings, Fleet, fuse_fleet
from fusion.fleet.discovery import FoundFlight, find_flights
from fusion.fleet.fingerprint import stamp_of
from fusion.fleet.journal import Journal, read_journal
from fusion.fleet.page import write_page
from fusion.fleet.row import FleetRow
from fusion.fleet.tables import write_tables
from fusion.fleet.task import Task
from fusion.fleet.worker import fuse_task, limit_threads, process_id
from fusion.fleet.workers import local_workers

SPEEDUP_TARGET, OVERHEAD_TARGET_MS = 1.8, 50.0


class Cost(NamedTuple):
    """Seconds of wall clock, and of processors in this process and those that it has ended."""

    wall_s: float
    cpu_s: float


def cost_of(work: Callable[[], object]) -> Cost:
    """Return the wall time and processor time of some work."""
    wall, cpu = time.perf_counter(), cpu_s()
    work()
    return Cost(time.perf_counter() - wall, cpu_s() - cpu)


def cpu_s() -> float:
    """Processor time of this process and of its children, seconds."""
    own = resource.getrusage(resource.RUSAGE_SELF)
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return own.ru_utime + own.ru_stime + children.ru_utime + children.ru_stime


def simulate(folder: Path, distinct: int, seconds: float) -> list[Path]:
    """Simulate distinct logs into a folder and return their folders."""
    from fusion.simulate import SimulationConfig, simulate_flight  # each worker would load it with this file

    found = []
    for seed in range(1, distinct + 1):
        config = SimulationConfig.random_office(seed, motion={"duration_s": seconds})
        simulate_flight(config, folder / f"log{seed}")
        found.append(folder / f"log{seed}")
    return found


def make_fleet(folder: Path, logs: list[Path], count: int) -> Path:
    """Make a fleet of so many flights that share the logs; return its folder."""
    for k in range(count):
        flight = folder / f"mav{k % 3}" / f"{k:06d}"
        flight.mkdir(parents=True)
        (flight / "flight.toml").write_text(f'log = "{logs[k % len(logs)]}"\n', encoding="utf-8")
    return folder


def turn_by_turn(source: Path, work: Path, reports: bool) -> tuple[list[Cost], list[Cost]]:
    """Fuse each flight plainly, then as a worker does, so that what the machine does meanwhile touches both."""
    settings = FusionConfig()
    plain, as_task = [], []
    for flight in find_flights([source]):

        def fuse(flight: FoundFlight = flight) -> None:
            loaded = load_flight(flight.path)
            write_outputs(fuse_flight(loaded), loaded, work / "plain" / flight.name, report=reports)

        task = Task(flight, work / "tasks", settings, "", None, "geometric", reports, "", 0)
        plain.append(cost_of(fuse))
        as_task.append(cost_of(partial(fuse_task, task)))
    return plain, as_task


def print_costs(source: Path, work: Path, count: int, reports: bool) -> Fleet:
    """Print what fusing a fleet costs with one worker and with two; return it."""
    limit_threads()
    warm = find_flights([source])[0].path
    loaded = load_flight(warm)
    write_outputs(fuse_flight(loaded), loaded, work / "warm", report=reports)
    costs: dict[int, Cost] = {}
    fleets: dict[int, Fleet] = {}
    print(f"{'':<12}{'wall s':>10}{'flights/s':>12}{'processor s':>14}{'ms a flight':>14}")
    plain, as_task = turn_by_turn(source, work, reports)
    for name, turns in (("plainly", plain), ("as a worker", as_task)):
        print_cost(name, Cost(sum(c.wall_s for c in turns), sum(c.cpu_s for c in turns)), count)
    for jobs in (1, 2):

        def run(jobs: int = jobs) -> None:
            fleets[jobs] = fuse_fleet(
                [source], work / f"out{jobs}", BatchSettings(jobs=jobs, reports=reports)
            )

        costs[jobs] = cost_of(run)
        print_cost(f"{jobs} worker{'s' if jobs > 1 else ''}", costs[jobs], count)
    again = cost_of(lambda: fuse_fleet([source], work / "out2", BatchSettings(jobs=2, reports=reports)))
    print(
        f"two workers are {costs[1].wall_s / costs[2].wall_s:.2f} times as fast as one (target {SPEEDUP_TARGET})"
    )
    print(
        f"two processes that only calculate are {speed_of_two_processes(100_000 * count):.2f} times as fast as one"
    )
    busy = [costs[jobs].cpu_s / (jobs * costs[jobs].wall_s) for jobs in (1, 2)]
    print(
        f"processors had for one worker {busy[0]:.0%}, for two {busy[1]:.0%} of the time each: less, others had them"
    )
    for what, part in (("processor", "cpu_s"), ("wall clock", "wall_s")):
        extra = [getattr(b, part) - getattr(a, part) for a, b in zip(plain, as_task, strict=True)]
        print(f"overhead in the worker, {what}: {1000 * np.median(extra):.1f} ms a flight (median)")
    start = start_of_a_worker()
    print(f"start of a worker: {start.wall_s:.1f} s, {start.cpu_s:.1f} s of the processor")
    print(f"again, nothing to do: {again.wall_s:.1f} s, {1000 * again.wall_s / count:.1f} ms a flight")
    same = [a.heading_rmse_rad for a in fleets[1].rows] == [b.heading_rmse_rad for b in fleets[2].rows]
    print(f"rows of one and two workers: {'the same' if same else 'DIFFERENT'}")
    return fleets[1]


def count_up(steps: int) -> int:
    """Work that needs a processor and no memory."""
    return sum(k * k for k in range(steps))


def speed_of_two_processes(steps: int) -> float:
    """Return how many times as fast as one two processes are that only calculate: what the machine allows."""
    with ProcessPoolExecutor(2, get_context("spawn")) as pool:
        list(pool.map(count_up, (1000, 1000)))  # both are there
        one = cost_of(lambda: pool.submit(count_up, steps).result())
        two = cost_of(lambda: list(pool.map(count_up, (steps, steps))))
    return 2.0 * one.wall_s / two.wall_s


def print_cost(name: str, cost: Cost, count: int) -> None:
    """Print a row of the table."""
    each_ms = 1000 * cost.cpu_s / count
    numbers = f"{cost.wall_s:>10.1f}{count / cost.wall_s:>12.2f}{cost.cpu_s:>14.1f}{each_ms:>14.1f}"
    print(f"{name:<12}{numbers}", flush=True)


def start_of_a_worker() -> Cost:
    """Return what it costs to start a process and to load all that fusing needs."""

    def start() -> None:
        with local_workers(1, None, None, print) as workers:
            worker = workers._worker()
            assert worker._pool.submit(limit_threads).result() is None
            assert worker._pool.submit(process_id).result() != os.getpid()

    return cost_of(start)


def print_model(fleet: Fleet, source: Path, work: Path, rows: int) -> None:
    """Print the constants of the model of the cost."""
    found = cost_of(lambda: find_flights([source]))
    count = len(fleet.rows)
    flights = find_flights([source])
    stamped = cost_of(lambda: [stamp_of(flight.path) for flight in flights])
    before_mb = held_mb()
    many = many_rows(fleet.rows, rows)
    folder = work / "many"
    folder.mkdir()
    journal = Journal(folder, [])

    def journal_some() -> None:
        for row in many[:1000]:
            journal.add(row)

    journalled = cost_of(journal_some)
    journal.close()
    Journal(folder, many).close()
    read = cost_of(lambda: read_journal(folder))
    tables = cost_of(lambda: write_tables(many, folder))
    page = cost_of(lambda: write_page(many, folder, rows))
    size = {
        name: (folder / name).stat().st_size
        for name in ("fleet.jsonl", "fleet.csv", "fleet.parquet", "fleet.html")
    }
    outputs = sum(file.stat().st_size for file in (work / "out1" / "flights").rglob("*") if file.is_file())
    peaks = [row.peak_memory_mb for row in fleet.rows if row.peak_memory_mb is not None]
    handed_out = (found.wall_s + stamped.wall_s) / count + journalled.wall_s / min(rows, 1000)
    print(
        f"handing out a flight {1000 * handed_out:8.2f} ms, of {OVERHEAD_TARGET_MS:.0f} with that in the worker"
    )
    print(f"find a flight        {1000 * found.wall_s / count:8.2f} ms")
    print(f"stamp a flight       {1000 * stamped.wall_s / count:8.2f} ms")
    print(f"journal a row        {1000 * journalled.wall_s / min(rows, 1000):8.2f} ms")
    print(f"read a row back      {1000 * read.wall_s / rows:8.2f} ms")
    print(f"tables, per row      {1000 * tables.wall_s / rows:8.2f} ms")
    print(f"page of {rows} rows  {page.wall_s:8.2f} s")
    print("bytes per row        " + ", ".join(f"{name} {bytes_ / rows:.0f}" for name, bytes_ in size.items()))
    print(f"outputs per flight   {outputs / count / 1e6:8.2f} MB")
    first, last = (np.median(part) for part in (peaks[: len(peaks) // 4 or 1], peaks[-len(peaks) // 4 :]))
    print(f"a worker holds       {first:8.0f} MB after its first flights, {last:.0f} MB after its last")
    print(f"{rows} rows take at most {held_mb() - before_mb:.0f} MB more, tables and page being written")


def print_cluster(work: Path, count: int) -> None:
    """Tell what handing a flight out costs with processes of this machine and with Dask, whose scheduler runs here.

    The flights are not there, so that their workers have next to nothing to do.
    """
    import distributed

    work.mkdir()
    flights = work / "missing.toml"
    flights.write_text("".join(f'[[flight]]\npath = "{k:06d}"\n' for k in range(count)), encoding="utf-8")
    local = BatchSettings(jobs=2)
    local_cluster: Any = distributed.LocalCluster
    with local_cluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        dask = replace(local, scheduler=cluster.scheduler_address)
        for name, settings in (("2 processes", local), ("Dask", dask)):
            fuse_fleet([flights], work / "warm", replace(settings, redo=True))  # workers start, modules load
            wall, own = time.perf_counter(), time.process_time()
            fuse_fleet([flights], work / name, settings)
            own, wall = time.process_time() - own, time.perf_counter() - wall
            print(
                f"handing out by {name:<12}{1000 * own / count:6.2f} ms of this process, "
                f"{1000 * wall / count:.2f} ms of wall clock a flight"
            )


def held_mb() -> float:
    """Return the most that this process has held."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1000


def many_rows(rows: tuple[FleetRow, ...], count: int) -> list[FleetRow]:
    """Repeat rows under new names up to a count."""
    return [replace(rows[k % len(rows)], flight=f"{k:06d}") for k in range(count)]


def main() -> None:
    """Make a fleet and print what it costs."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--flights", type=int, default=200)
    parser.add_argument("--distinct", type=int, default=10, help="simulated logs that the flights share")
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--reports", action="store_true", help="with a report.html per flight")
    parser.add_argument("--rows", type=int, default=20_000)
    parser.add_argument("--logs", type=Path, help="folder of flights to use instead of simulated ones")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        work = Path(name)
        if options.logs is None:
            logs = simulate(work / "logs", options.distinct, options.seconds)
        else:
            logs = [flight.path for flight in find_flights([options.logs])]
        source = make_fleet(work / "fleet", logs, options.flights)
        flights, load = f"{options.flights} flights of {len(logs)} logs", os.getloadavg()[0]
        print(f"{flights}, {os.cpu_count()} cores, load before {load:.1f}", flush=True)
        fleet = print_costs(source, work, options.flights, options.reports)
        print_model(fleet, source, work, options.rows)
        print_cluster(work / "cluster", 5 * options.flights)


if __name__ == "__main__":
    main()
