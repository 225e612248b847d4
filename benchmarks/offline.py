"""What fusing a logged flight costs: the sample flight beside the decoding of its pictures, and logs of hours.

    python benchmarks/offline.py [--hours 0.33 1 3]

The sample flight is also fused as a video of 640x480, once kept to one core and once to two, where pictures are
decoded and lines found ahead of the filter. A long log is the sample flight played to and fro, with one picture a
second. Each is fused by one thread in a process of its own, whose peak of memory is the flight's.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from math import ceil
from pathlib import Path
from typing import NamedTuple

import av
import cv2
import numpy as np

from fusion import Flight, fuse_flight, load_flight
from fusion.flight import AttitudeStream, ChosenFrames, FrameStream, ImuStream
from fusion.logs.pictures.video import open_video

OFFICE = Path(__file__).parents[1] / "data" / "office"
HOUR_AIM_S, HOUR_AIM_MIB = 40.0, 1024.0
FRAME_STEP_S = 1.0
CORES_AIM = 1.5  # times as fast on two as on one
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
    cv2.setNumThreads(1)
    fuse_flight(long_flight(20.0 / 3600.0), jobs=1)
    flight, before_mib, started = long_flight(hours), held_mib(), time.process_time()
    fuse_flight(flight, jobs=1)
    return Cost(time.process_time() - started, held_mib(), before_mib)


def print_office() -> None:
    """Print what the sample flight costs beside reading its pictures."""
    flight = load_flight(OFFICE)
    fuse_flight(flight, jobs=1)
    ratios = []
    for _ in range(3):
        started = time.process_time()
        for k in range(len(flight.frames.t_ns)):
            flight.frames.read(k)
        read = time.process_time()
        fuse_flight(flight, jobs=1)
        ratios.append(((time.process_time() - read) / (read - started), read - started))
    ratio, read_s = sorted(ratios)[1]
    print(
        f"sample flight: {ratio:.2f} times the decoding of its pictures, {ratio * read_s:.2f} s of CPU, warm"
    )


def write_video(flight: Flight, path: Path) -> None:
    """Write a flight's pictures as H.264."""
    with av.open(str(path), "w") as file:
        stream = file.add_stream("h264", rate=15, options={"crf": "18"})
        stream.width, stream.height, stream.pix_fmt = (
            flight.camera.width_px,
            flight.camera.height_px,
            "yuv420p",
        )
        for number in range(len(flight.frames.t_ns)):
            picture = av.VideoFrame.from_ndarray(flight.frames.read(number), format="gray")
            picture.pts = number
            file.mux(stream.encode(picture.reformat(format="yuv420p")))
        file.mux(stream.encode())


def wall_s_on(cores: int, video: Path) -> float:
    """Fuse the sample flight, its pictures from a video, on so many cores; return the median of five runs."""
    os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:cores])
    office, seconds = load_flight(OFFICE), []
    source = open_video(video).frames("video").value.source
    flight = replace(office, frames=FrameStream(office.frames.t_ns, source))
    for _ in range(6):
        started = time.perf_counter()
        fuse_flight(flight)
        seconds.append(time.perf_counter() - started)
    return sorted(seconds[1:])[2]


def print_cores() -> None:
    """Print how much faster two cores fuse than one."""
    with tempfile.TemporaryDirectory() as folder:
        video = Path(folder) / "office.mp4"
        write_video(load_flight(OFFICE), video)
        one, two = (
            float(subprocess.check_output([sys.executable, __file__, "--on-cores", str(n), str(video)]))
            for n in (1, 2)
        )
    print(
        f"as a video: {one:.2f} s on one core, {two:.2f} s on two: {one / two:.2f} times as fast, aim {CORES_AIM:g}"
    )


def main() -> None:
    """Print the tables, or run as the process that one row measures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--hours", type=float, nargs="+", default=[0.33, 1.0, 3.0])
    parser.add_argument("--cost-of", type=float, help=argparse.SUPPRESS)
    parser.add_argument("--on-cores", nargs=2, metavar=("CORES", "VIDEO"), help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.cost_of is not None:
        print(json.dumps(cost_of(arguments.cost_of)))
        return
    if arguments.on_cores is not None:
        print(wall_s_on(int(arguments.on_cores[0]), Path(arguments.on_cores[1])))
        return
    print_office()
    if hasattr(os, "sched_setaffinity") and len(os.sched_getaffinity(0)) > 1:
        print_cores()
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
