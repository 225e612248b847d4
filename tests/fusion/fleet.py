"""A small fleet of simulated flights for tests, and its workers seen from outside."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from fusion.fleet.journal import read_journal
from fusion.simulate import SimulationConfig, simulate_flight
from tests.files import written

SMALL = {
    "light_cell_m": 0.5,
    "camera": {"width_px": 240, "height_px": 180, "rate_hz": 10.0},
    "motion": {"duration_s": 2.0},
    "imu": {"rate_hz": 100.0},
}


def simulate(folder: Path, seed: int = 2) -> Path:
    """Simulate a flight of 21 small pictures."""
    simulate_flight(SimulationConfig.random_office(seed, **SMALL), folder)
    return folder


def make_fleet(folder: Path, flight: Path, count: int) -> Path:
    """Make a folder of as many flights, all of one log, two vehicles, a day apart."""
    for k in range(count):
        text = f'log = "{flight}"\nvehicle = "mav{k % 2 + 1}"\n'
        written(folder / f"2026-03-{k + 1:02d}" / "flight.toml", text)
    return folder


@contextmanager
def first_worker_killed(out: Path) -> Iterator[list[int]]:
    """Kill the process that fused the first flight as soon as that is done: it is at another flight by then."""
    killed: list[int] = []

    def kill() -> None:
        while not ended.is_set():
            for row in read_journal(out).values():
                killed.append(int(row.worker.rpartition(":")[2]))
                os.kill(killed[0], signal.SIGKILL)
                return
            time.sleep(0.005)

    ended, killer = threading.Event(), threading.Thread(target=kill)
    killer.start()
    try:
        yield killed
    finally:
        ended.set()
        killer.join()
