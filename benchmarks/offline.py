"""What fusing a logged flight costs: the sample flight beside the decoding of its pictures, and logs of hours.

    python benchmarks/offline.py [--hours 0.33 1 3]

A long log is the sample flight played to and fro, with one picture a second. Each is fused in a process of its own,
whose peak of memory is the flight's.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import time
from dataclasses import replace
from math import ceil
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fusion import Flight, fuse_flight, load_flight
from fusion.flight import AttitudeStream, ChosenFrames, FrameStream, ImuStream

OFFICE = Path(__file__).parents[1] / "data" / "office"
HOUR_AIM_S, HOUR_AIM_MIB = 40.0, 1024.0
FRAME_STEP_S = 1.0
MIB = 1024.0 if sys.platform != "darwin" else 1024.0**2  # ru_maxrss is in KiB but for macOS


class Cost(NamedTuple):
    """CPU seconds of filter and smoother together, MiB held at most, and the same before the fusion began."""

    cpu_s: float
    peak_mib: float
    before_mib: float


def to_and_fro(n: int, times: int) -> np.ndarray:
    """Return indices that run through n samples forwards and backwards, so many times."""
    runs = [np.arange(n) if k % 2 == 0 else np.arange(n)[::-1] for k in range(times)]
    return np.concatenate(runs)


def long_flight(hours: float, frame_step_s: float = FRAME_STEP_S) -> Flight:
    """Return the sample flight played to and fro; where it runs back, the gyroscope reads the opposite."""
    office = load_flight(OFFICE)
    imu, attitude, frames = office.imu, office.attitude, office.frames
    assert imu is not None
    assert attitude is not None
    start_ns = int(imu.t_ns[0])
    seconds = (int(imu.t_ns[-1]) - start_ns) * 1e-9
    times = ceil(3600.0 * hours / seconds)

    def stamps(t_ns: np.ndarray, index: np.ndarray) -> np.ndarray:
        step_ns = int(np.median(np.diff(t_ns)))
        return start_ns + step_ns * np.arange(len(index), dtype=np.int64)

    samples = to_and_fro(len(imu.t_ns), times)
    sign = np.repeat([1.0 if k % 2 == 0 else -1.0 for k in range(times)], len(imu.t_ns))
    attitudes = to_and_fro(len(attitude.t_ns), times)
    pictures = to_and_fro(len(frames.t_ns), times)
    every = round(frame_step_s * 1e9 / float(np.median(np.diff(frames.t_ns))))
    played = pictures[::every]
    return replace(
        office,
        frames=FrameStream(stamps(frames.t_ns, pictures)[::every], ChosenFrames(frames.source, played)),
        imu=ImuStream(
            stamps(imu.t_ns, samples),
            imu.gyro_rad_s[samples] * sign[:, None],
            imu.accel_m_s2[samples],
            imu.gyro_noise_density,
            imu.gyro_random_walk,
        ),
        attitude=AttitudeStream(stamps(attitude.t_ns, attitudes), attitude.q_world_body[attitudes]),
        truth=None,
    )


def held_mib() -> float:
    """Return the largest memory that the process has held."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / MIB


def cost_of(hours: float) -> Cost:
    """Fuse a long flight in this process, the compiled code loaded before."""
    fuse_flight(long_flight(20.0 / 3600.0))
    flight, before_mib, started = long_flight(hours), held_mib(), time.process_time()
    fuse_flight(flight)
    return Cost(time.process_time() - started, held_mib(), before_mib)


def print_office() -> None:
    """Print what the sample flight costs beside reading its pictures."""
    flight = load_flight(OFFICE)
    fuse_flight(flight)
    ratios = []
    for _ in range(3):
        started = time.process_time()
        for k in range(len(flight.frames.t_ns)):
            flight.frames.read(k)
        read = time.process_time()
        fuse_flight(flight)
        ratios.append(((time.process_time() - read) / (read - started), read - started))
    ratio, read_s = sorted(ratios)[1]
    print(
        f"sample flight: {ratio:.2f} times the decoding of its pictures, {ratio * read_s:.2f} s of CPU, warm"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--hours", type=float, nargs="+", default=[0.33, 1.0, 3.0])
    parser.add_argument("--cost-of", type=float, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.cost_of is not None:
        print(json.dumps(cost_of(arguments.cost_of)))
        return
    print_office()
    print(
        f"\n{'hours':>8}{'CPU, s':>10}{'s an hour':>11}{'aim':>6}{'peak, MiB':>12}{'aim':>7}{'before, MiB':>13}"
    )
    for hours in arguments.hours:
        command = [sys.executable, __file__, "--cost-of", str(hours)]
        cost = Cost(*json.loads(subprocess.check_output(command)))
        aims = (f"{HOUR_AIM_S:.0f}", f"{HOUR_AIM_MIB:.0f}") if hours == 1.0 else ("", "")
        print(
            f"{hours:8.2f}{cost.cpu_s:10.1f}{cost.cpu_s / hours:11.1f}{aims[0]:>6}{cost.peak_mib:12.0f}{aims[1]:>7}"
            f"{cost.before_mib:13.0f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
