"""A day of flight through the streaming estimator: whether memory and the cost of a step stay what they were.

    python benchmarks/endurance.py [--hours 24] [--every 1]

feeds IMU samples at 200 Hz and measurements at 30 Hz, 80 ms late, and asks for the estimate after each frame. A line
for each simulated hour: what the process holds, the median and the 99th percentile of a step, and how far the heading
is off. The last lines compare the last hour with the second, the first one in which everything has been loaded.
"""

from __future__ import annotations

import argparse
import gc
from collections.abc import Callable
from math import degrees
from pathlib import Path
from typing import NamedTuple

import numpy as np
from step import LATE_NS, Sample, frames, imu, truth

from fusion import CorridorEstimator, FusionConfig
from support.clock import clock

BLOCK_S = 60.0


class Stretch(NamedTuple):
    """A stretch of flight: hours at its end, memory held, cost of calls in microseconds, error of the heading."""

    hours: float
    held_mib: float
    imu_us: float
    imu_99_us: float
    frame_us: float
    frame_99_us: float
    heading_off_deg: float


def held_mib() -> float:
    """Return the memory that the process holds, MiB; NaN where the system does not tell it."""
    gc.collect()
    status = Path("/proc/self/status")
    if not status.exists():
        return float("nan")
    line = next(line for line in status.read_text().splitlines() if line.startswith("VmRSS"))
    return int(line.split()[1]) / 1024


class Flight:
    """A flight that goes on: the same weaving for as long as it is asked for."""

    def __init__(self, seed: int = 4) -> None:
        self.estimator = CorridorEstimator(FusionConfig(corridor_width_m=2.2))
        self._rng = np.random.default_rng(seed)
        self._at_s = 0.0

    def on(self, seconds: float) -> Stretch:
        """Fly on; return what that stretch cost."""
        costs: dict[str, list[float]] = {"add_imu": [], "add_measurement": []}
        for _ in range(max(round(seconds / BLOCK_S), 1)):
            length_s = min(BLOCK_S, seconds)
            samples = [
                *imu(self._rng, self._at_s, length_s),
                *frames(self._rng, self._at_s, length_s, LATE_NS),
            ]
            samples.sort(key=lambda sample: sample.at_ns)
            self._feed(samples, costs)
            self._at_s += length_s
        imu_us, frame_us = (1e6 * np.array(costs[name]) for name in ("add_imu", "add_measurement"))
        estimate = self.estimator.estimate()
        off_rad = estimate.heading_rad - truth(estimate.timestamp_ns * 1e-9)[0]
        return Stretch(
            self._at_s / 3600.0,
            held_mib(),
            float(np.median(imu_us)),
            float(np.percentile(imu_us, 99)),
            float(np.median(frame_us)),
            float(np.percentile(frame_us, 99)),
            degrees(off_rad),
        )

    def _feed(self, samples: list[Sample], costs: dict[str, list[float]]) -> None:
        estimator = self.estimator
        calls: dict[str, Callable[..., object]] = {
            "add_imu": estimator.add_imu,
            "add_measurement": estimator.add_measurement,
        }
        for _, name, t_ns, arguments in samples:
            before = clock()
            calls[name](t_ns, *arguments)
            if name == "add_measurement":
                estimator.estimate()
            costs[name].append(clock() - before)


def main() -> None:
    """Print a line for each stretch, and how the last compares with an early one."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--hours", type=float, default=24.0, help="of flight (default: 24)")
    parser.add_argument("--every", type=float, default=1.0, help="hours of flight to a line (default: 1)")
    options = parser.parse_args()
    print("hours      MiB   IMU sample us   99 %    frame us   99 %   heading off, degrees")
    flight, found = Flight(), []
    for _ in range(max(round(options.hours / options.every), 1)):
        s = flight.on(options.every * 3600.0)
        found.append(s)
        print(
            f"{s.hours:5.2f} {s.held_mib:8.1f} {s.imu_us:15.1f} {s.imu_99_us:6.0f} {s.frame_us:11.0f} "
            f"{s.frame_99_us:6.0f} {s.heading_off_deg:11.2f}",
            flush=True,
        )
    first, last = found[min(1, len(found) - 1)], found[-1]
    print(
        f"memory: {last.held_mib - first.held_mib:+.1f} MiB from hour {first.hours:g} to hour {last.hours:g}"
    )
    print(f"an IMU sample: {last.imu_us / first.imu_us:.2f} times its cost then; a frame: ", end="")
    print(f"{last.frame_us / first.frame_us:.2f} times")


if __name__ == "__main__":
    main()
