"""How fast the simulator is, and how its pictures compare with the path-traced flight of ``data/office``.

``python benchmarks/simulator.py [--office FLIGHT] [--frames N]`` prints, for each picture size, frames a second on
one core, and what the line finder and the heading make of both kinds of pictures: lines found, how many of them
belong to the corridor's axis and how far from it they point, and the heading's error with its stated sigma. The
attitude given is the exact one, so what differs is the pictures.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import degrees, pi, radians
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from fusion import load_flight
from fusion.logs.asl import read_ground_truth
from fusion.simulate import ImagingConfig, SceneConfig, SimulationConfig, random_views
from fusion.simulate.exposure import FlyingCamera
from fusion.simulate.motion import rotations
from fusion.simulate.sensor import through_jpeg
from vision import Attitude, Camera, measure_frame
from vision.lines.segments import extract_lines

ROOT = Path(__file__).resolve().parents[1]
SIZES_PX = ((640, 480), (320, 240), (160, 120))
ON_AXIS_RAD = radians(1.5)
LONG_SHARE = 0.08  # of the picture's width: lines long enough that their direction means something


@dataclass(frozen=True, slots=True, eq=False)
class Sample:
    """A picture, its camera, and the exact attitude: roll, pitch and heading."""

    image: npt.NDArray[np.uint8]
    camera: Camera
    roll_rad: float
    pitch_rad: float
    heading_rad: float


def office(folder: Path, size: tuple[int, int], count: int) -> Iterator[Sample]:
    """Frames of the path-traced flight, scaled."""
    flight, state = load_flight(folder), read_ground_truth(folder)
    camera = flight.camera.resized(*size)
    chosen = np.linspace(0, len(flight.frames.t_ns) - 1, count).round().astype(int)
    for k in np.unique(chosen).tolist():
        row = int(np.argmin(np.abs(state.t_ns - flight.frames.t_ns[k])))
        attitude = Attitude.from_quaternion(state.q_world_body[row])
        w, x, y, z = state.q_world_body[row]
        heading = float(np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))
        image = cv2.resize(flight.frames.read(k), size, interpolation=cv2.INTER_AREA)
        yield Sample(image, camera, attitude.roll_rad, attitude.pitch_rad, heading)


def flown(camera: Camera, size: tuple[int, int], count: int) -> Iterator[Sample]:
    """Fly through five scenes much like the office's: the same camera and size of corridor.

    As there, the picture is taken at the camera's own size and then scaled.
    """
    for seed in range(5):
        config = SimulationConfig.from_values(
            {
                "seed": seed,
                "scene": {"end": "window", "length_m": 38, "door_spacing_m": 3.5},
                "motion": {"heading_amplitude_rad": 0.4, "heading_rate_rad_s": 1.0, "tilt_rad": 0.14},
            }
        )
        flying = FlyingCamera.prepare(config, replace(camera, exposure_s=0.008))
        for k, t in enumerate(np.linspace(0, config.motion.duration_s, count // 5).tolist()):
            image = through_jpeg(flying.picture(t, k), config.imaging.jpeg_quality)
            roll, pitch, yaw = flying.trajectory.angles(t).tolist()
            small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
            yield Sample(small, camera.resized(*size), roll, pitch, yaw)


def drawn(camera: Camera, size: tuple[int, int], count: int) -> Iterator[Sample]:
    """Single views of random corridors with random cameras, rendered at the size."""
    for v in random_views(
        camera.resized(*size), count, 3, imaging=ImagingConfig.random, scene=SceneConfig.random
    ):
        yield Sample(v.image, v.camera, v.roll_rad, v.pitch_rad, v.heading_rad)


def axis_residuals(sample: Sample) -> npt.NDArray[np.float64]:
    """Angle (n,) of every long line from the direction to the true vanishing point, radians, in [-pi/2, pi/2)."""
    lines = extract_lines(sample.image, sample.camera).ends_px
    R = rotations(np.array([[sample.roll_rad, sample.pitch_rad, sample.heading_rad]]))[0]
    vanishing = sample.camera.project((sample.camera.R_body_camera.T @ R.T @ [1.0, 0.0, 0.0])[None])[0]
    along, middle = lines[:, 2:] - lines[:, :2], (lines[:, 2:] + lines[:, :2]) / 2
    towards = vanishing - middle
    keep = np.hypot(*along.T) > LONG_SHARE * sample.camera.width_px
    turn = np.arctan2(towards[keep, 1], towards[keep, 0]) - np.arctan2(along[keep, 1], along[keep, 0])
    return np.asarray((turn + pi / 2) % pi - pi / 2)


def row_of(name: str, samples: Iterator[Sample]) -> str:
    """Measure the pictures and sum them up in a line of the table."""
    errors, ratios, found, residuals, total = [], [], [], [], 0
    for sample in samples:
        total += 1
        attitude = Attitude(sample.roll_rad, sample.pitch_rad, radians(0.1))
        answer = measure_frame(sample.image, sample.camera, attitude)
        found.append(answer.n_lines)
        residuals.append(axis_residuals(sample))
        if answer.accepted:
            error = (answer.heading_rad - sample.heading_rad + pi / 2) % pi - pi / 2
            errors.append(error)
            ratios.append(abs(error) / answer.heading_std_rad)
    every = np.abs(np.concatenate(residuals))
    on_axis = every[every < ON_AXIS_RAD]
    cells: list[Any] = [
        f"{name:24s}",
        f"{np.median(found):6.0f}",
        f"{len(on_axis) / total:8.1f}",
        f"{degrees(float(np.median(on_axis))):8.3f}",
        f"{100 * len(errors) / total:7.1f} %",
        f"{degrees(float(np.sqrt(np.mean(np.square(errors))))):8.3f}",
        f"{degrees(float(np.median(np.abs(errors)))):8.3f}",
        f"{degrees(float(np.abs(errors).max())):7.2f}",
        f"{float(np.percentile(ratios, 90)):7.2f}",
    ]
    return "  ".join(cells)


def frames_a_second(size: tuple[int, int]) -> str:
    """Time of pictures along a flight on one core, with motion blur, noise and JPEG."""
    flying = FlyingCamera.prepare(
        SimulationConfig.from_values({"camera": {"width_px": size[0], "height_px": size[1]}})
    )
    times = flying.frame_times()[::8].tolist()
    flying.picture(times[0], 0)
    begin = time.process_time()
    for k, t in enumerate(times):
        through_jpeg(flying.picture(t, k), 85)
    return f"{len(times) / (time.process_time() - begin):.0f} frames a second"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--office", type=Path, default=ROOT / "data" / "office")
    parser.add_argument("--frames", type=int, default=100, help="pictures of each kind")
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    camera = load_flight(arguments.office).camera
    head = f"{'':24s}  {'lines':>6s}  {'on axis':>8s}  {'off deg':>8s}  {'accepted':>9s}  {'rms deg':>8s}"
    for size in SIZES_PX:
        print(f"{size[0]}x{size[1]}: simulated at {frames_a_second(size)}")
        print(f"{head}  {'median':>8s}  {'worst':>7s}  {'90 % z':>7s}")
        print(row_of("path-traced office", office(arguments.office, size, arguments.frames)))
        print(row_of("simulated, office-like", flown(camera, size, arguments.frames)))
        print(row_of("simulated, random", drawn(camera, size, arguments.frames)))


if __name__ == "__main__":
    main()
