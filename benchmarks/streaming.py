"""What the estimator's calls cost in flight at 1 kHz, with frames that come 300 ms late: time, pauses and memory.

    python benchmarks/streaming.py [--seconds 120]

The sample flight is played to and fro, its IMU interpolated to 1 kHz, its lines found beforehand, as a camera's
thread would. Each frame rolls the filter back by 300 samples and replays them. Printed are the time of each call, how
the process's memory grows after the first quarter of the flight, and what is left for Python's garbage collector,
which is off, as in ``examples/pilot.py``: its full pass takes milliseconds.
"""

from __future__ import annotations

import argparse
import gc
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from offline import long_flight

from fusion import CorridorEstimator, Flight, FusionConfig
from fusion.flight import ChosenFrames
from support.clock import clock
from vision import extract_lines, warm_up
from vision.lines.line_set import LineSet

IMU_HZ, LATE_NS = 1000.0, 300_000_000
AIMS_MS = {"add_imu": 0.150, "add_lines": 3.0}  # 99th percentiles
GROWTH_AIM_MIB = 1.0


class Call(NamedTuple):
    """A call of the estimator: when it comes, its name, its sample's time, and its arguments."""

    at_ns: int
    name: str
    t_ns: int
    arguments: tuple[Any, ...]


class Run(NamedTuple):
    """Milliseconds (n,) of the calls by name; memory, MiB, once a second; objects left that only a collector ends."""

    calls_ms: dict[str, np.ndarray]
    memory_mib: np.ndarray
    in_cycles: int


def calls_of(flight: Flight, lines: list[LineSet]) -> list[Call]:
    """Return all calls in the order in which they come; ``lines`` (n,) are those of the frames."""
    imu, attitude = flight.imu, flight.attitude
    assert imu is not None
    assert attitude is not None
    t_ns = np.arange(imu.t_ns[0], imu.t_ns[-1], round(1e9 / IMU_HZ))
    axes = [np.interp(t_ns, imu.t_ns, v) for v in (*imu.gyro_rad_s.T, *imu.accel_m_s2.T)]
    noise = np.random.default_rng(1).normal(
        0.0, 0.02, (3, len(t_ns))
    )  # without, samples in between are too smooth
    gyro, accel = np.stack(axes[:3] + noise, axis=1), np.stack(axes[3:], axis=1)
    found = [Call(t, "add_imu", t, (gyro[i], accel[i])) for i, t in enumerate(t_ns.tolist())]
    found += [
        Call(t, "add_attitude", t, (q,))
        for t, q in zip(attitude.t_ns.tolist(), attitude.q_world_body, strict=True)
    ]
    found += [
        Call(t + LATE_NS, "add_lines", t, (seen,))
        for t, seen in zip(flight.frames.t_ns.tolist(), lines, strict=True)
    ]
    return sorted(found, key=lambda call: call.at_ns)


def lines_of(flight: Flight) -> list[LineSet]:
    """Find the lines of all frames, each picture's once."""
    source, found = flight.frames.source, {}
    assert isinstance(source, ChosenFrames)
    for number, picture in enumerate(source.index.tolist()):
        if picture not in found:
            found[picture] = extract_lines(flight.frames.read(number), flight.camera)
    return [found[picture] for picture in source.index.tolist()]


def memory_mib() -> float:
    """Return what the process holds in memory now."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 2**20


def flown(calls: list[Call], flight: Flight) -> Run:
    """Make the calls; after each sample of the IMU the estimate is asked for, as a controller does."""
    estimator = CorridorEstimator(FusionConfig(buffer_s=0.5), flight.camera)
    warm_up(flight.camera)
    gc.collect()
    gc.freeze()
    gc.disable()
    names = ("add_imu", "add_attitude", "add_lines")
    methods = {name: getattr(estimator, name) for name in names}
    # Written once now: a list would grow, and pages of zeros are only given when they are written.
    spent_s = {name: np.full(len(calls), np.nan) for name in (*names, "estimate")}
    made = dict.fromkeys(spent_s, 0)

    def note(name: str, before: float) -> None:
        spent_s[name][made[name]] = clock() - before
        made[name] += 1

    memory, next_ns = [], calls[0].at_ns
    for call in calls:
        before = clock()
        methods[call.name](call.t_ns, *call.arguments)
        note(call.name, before)
        if call.name == "add_imu":
            before = clock()
            estimator.estimate()
            note("estimate", before)
        if call.at_ns >= next_ns:
            memory.append(memory_mib())
            next_ns += 1_000_000_000
    in_cycles = gc.collect()
    gc.enable()
    # What happens once (imports, caches) is over after a second.
    calls_ms = {name: 1e3 * spent_s[name][n // len(memory) : n] for name, n in made.items()}
    return Run(calls_ms, np.array(memory), in_cycles)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=120.0, help="of flight (default: 120)")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    flight = long_flight(options.seconds / 3600.0, frame_step_s=1 / 15)
    calls = calls_of(flight, lines_of(flight))
    run = flown(calls, flight)
    rate_hz = len(flight.frames.t_ns) / len(run.memory_mib)
    print(
        f"IMU {IMU_HZ:g} Hz, attitude 50 Hz, frames {rate_hz:.0f} Hz and {LATE_NS // 1_000_000} ms late; milliseconds"
    )
    print(f"{'':16}{'calls':>8}{'median':>10}{'99 %':>10}{'aim':>8}{'most':>10}")
    for name, times in run.calls_ms.items():
        aim = f"{AIMS_MS[name]:8.3f}" if name in AIMS_MS else f"{'':8}"
        print(
            f"{name:16}{len(times):8}{np.median(times):10.3f}{np.percentile(times, 99):10.3f}{aim}{times.max():10.3f}"
        )
    growth = run.memory_mib[-1] - run.memory_mib[len(run.memory_mib) // 4]
    print(
        f"\nmemory: {run.memory_mib[-1]:.0f} MiB, of which {growth:.1f} came in the last three quarters (aim "
        f"{GROWTH_AIM_MIB:g}); objects left for the garbage collector: {run.in_cycles} (aim 0)"
    )


if __name__ == "__main__":
    main()
