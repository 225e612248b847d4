"""How fast the simulator is, and how its pictures compare with path-traced flights.

``python benchmarks/simulator.py [--frames N]`` prints frames a second on one core for each picture size, and then
what single frames make of the flights ``office``, ``clutter`` and ``night`` (``data/office``, ``../shared/flights``),
of plain simulated offices and of random simulated corridors by day and by night: the noise in the pictures, the lines
found, and how many of them belong to the corridor's axis; the heading's error with its stated sigma; and of the
lateral offset what share is answered, the answers' errors, whether the likeliest pair of corners is right, and
whether both floor corners are among the lines at all. The attitude given is the exact one, so what differs is the
pictures. A random corridor should be as hard as ``clutter`` and ``night``; a plain office as easy as ``office``.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import degrees, pi, radians
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
from lateral_weights import RIGHT, WRONG, picture_of, weights_in_use

from fusion import load_flight
from fusion.logs.asl import read_ground_truth
from fusion.simulate import (
    ImagingConfig,
    RandomView,
    SceneConfig,
    SimulationConfig,
    office_views,
    random_views,
)
from fusion.simulate.exposure import FlyingCamera
from fusion.simulate.motion import rotations
from fusion.simulate.scene.random_scene import is_night
from fusion.simulate.sensor import through_jpeg
from support.scores import number, percent, table
from vision import Attitude, Camera, measure_frame
from vision.lines.segments import extract_lines

ROOT = Path(__file__).resolve().parents[1]
FLIGHTS = {
    "office": ROOT / "data" / "office",
    "clutter": ROOT.parent / "shared" / "flights" / "clutter",
    "night": ROOT.parent / "shared" / "flights" / "night",
}
SIZES_PX = ((640, 480), (320, 240), (160, 120))
COMPARED_PX = (640, 480)
ON_AXIS_RAD = radians(1.5)
CORNER_RAD = radians(1.0)  # about the axis: a line so near a corner is the corner's
LONG_SHARE = 0.08  # of the picture's width: lines long enough that their direction means something
ATTITUDE_STD_RAD = radians(0.1)
SEED = 3
VIEWS_PER_SCENE = 2


@dataclass(frozen=True, slots=True, eq=False)
class Sample:
    """A picture, its camera, and the truth: roll, pitch, heading, the camera's offset, height and the width."""

    image: npt.NDArray[np.uint8]
    camera: Camera
    roll_rad: float
    pitch_rad: float
    heading_rad: float
    offset_norm: float
    height_m: float
    width_m: float
    slope_rad: float = 0.0

    @property
    def R_corridor_camera(self) -> npt.NDArray[np.float64]:
        """Rotation (3, 3) from the optical frame to the level one along the corridor: ahead, right, down."""
        R: npt.NDArray[np.float64] = rotations(np.array([[self.roll_rad, self.pitch_rad, self.heading_rad]]))[
            0
        ]
        return R @ self.camera.R_body_camera

    @property
    def attitude(self) -> Attitude:
        """Exact roll and pitch."""
        return Attitude(self.roll_rad, self.pitch_rad, ATTITUDE_STD_RAD)


def of_flight(folder: Path, size: tuple[int, int], count: int) -> Iterator[Sample]:
    """Frames of a path-traced flight, scaled."""
    flight, state = load_flight(folder), read_ground_truth(folder)
    truth = flight.truth
    if truth is None:
        raise ValueError(f"{folder} has no truth")
    camera = flight.camera.resized(*size)
    chosen = np.linspace(0, len(flight.frames.t_ns) - 1, count).round().astype(int)
    for k in np.unique(chosen).tolist():
        row = int(np.argmin(np.abs(state.t_ns - flight.frames.t_ns[k])))
        at = int(np.argmin(np.abs(truth.t_ns - flight.frames.t_ns[k])))
        attitude = Attitude.from_quaternion(state.q_world_body[row])
        heading, width = float(truth.heading_rad[at]), float(truth.corridor_width_m[at])
        R = rotations(np.array([[attitude.roll_rad, attitude.pitch_rad, heading]]))[0]
        _, right, down = R @ flight.camera.p_body_camera_m
        offset = float(truth.lateral_offset_m[at]) + right
        image = np.asarray(cv2.resize(flight.frames.read(k), size, interpolation=cv2.INTER_AREA), np.uint8)
        height = -float(state.p_world_m[row, 2]) - down
        yield Sample(
            image, camera, attitude.roll_rad, attitude.pitch_rad, heading, 2 * offset / width, height, width
        )


def of_views(views: Iterator[RandomView]) -> Iterator[Sample]:
    """Single views of simulated corridors."""
    for v in views:
        yield Sample(
            v.image, v.camera, v.roll_rad, v.pitch_rad, v.heading_rad, v.lateral_offset_norm, v.height_m, v.width_m,
            v.slope_rad,
        )  # fmt: skip


def axis_residuals(sample: Sample) -> npt.NDArray[np.float64]:
    """Angle (n,) of every long line from the direction to the true vanishing point, radians, in [-pi/2, pi/2)."""
    lines = extract_lines(sample.image, sample.camera).ends_px
    ahead = np.array([np.cos(sample.slope_rad), 0.0, -np.sin(sample.slope_rad)])
    vanishing = sample.camera.project((sample.R_corridor_camera.T @ ahead)[None])[0]
    along, middle = lines[:, 2:] - lines[:, :2], (lines[:, 2:] + lines[:, :2]) / 2
    towards = vanishing - middle
    keep = np.hypot(*along.T) > LONG_SHARE * sample.camera.width_px
    turn = np.arctan2(towards[keep, 1], towards[keep, 0]) - np.arctan2(along[keep, 1], along[keep, 0])
    return np.asarray((turn + pi / 2) % pi - pi / 2)


def sees_floor_corners(sample: Sample) -> bool:
    """Tell whether a line was found on either corner of wall and floor."""
    lines = extract_lines(sample.image, sample.camera)
    normals = lines.normal @ sample.R_corridor_camera.T  # of the planes through the camera and each line
    ahead = np.array([np.cos(sample.slope_rad), 0.0, -np.sin(sample.slope_rad)])
    for side in (-1.0, 1.0):
        corner = np.array([0.0, sample.width_m / 2 * (side - sample.offset_norm), sample.height_m])
        plane = np.cross(ahead, corner)
        cosine = np.abs(normals @ (plane / np.linalg.norm(plane)))
        below = (lines.centre @ sample.R_corridor_camera.T) @ corner > 0
        if not (below & (cosine > np.cos(CORNER_RAD))).any():
            return False
    return True


def noise_of(image: npt.NDArray[np.uint8]) -> float:
    """Noise of a picture in grey levels, from what is left of it across flat places (Immerkaer 1996)."""
    kernel = np.array([[1.0, -2.0, 1.0], [-2.0, 4.0, -2.0], [1.0, -2.0, 1.0]])
    left = cv2.filter2D(image.astype(np.float64), -1, kernel)
    return float(np.median(np.abs(left)) / 0.6745 / 6.0)


def likeliest_is_right(sample: Sample) -> bool:
    """Tell whether the likeliest pair of corners gives the offset; a picture without one does not."""
    found = picture_of(sample.image, sample.camera, sample.attitude, sample.offset_norm, True)
    if found is None or not len(found.offset):
        return False
    score = found.evidence @ weights_in_use()
    return bool(abs(found.offset[np.argmax(score)] - sample.offset_norm) < RIGHT)


def row_of(name: str, samples: Iterator[Sample]) -> list[str]:
    """Measure the pictures and sum them up in a line of the table."""
    headings, ratios, found, residuals, noise = [], [], [], [], []
    offsets, offset_ratios, likeliest, seen = [], [], [], []
    for sample in samples:
        answer = measure_frame(sample.image, sample.camera, sample.attitude)
        noise.append(noise_of(sample.image))
        found.append(answer.n_lines)
        residuals.append(axis_residuals(sample))
        likeliest.append(likeliest_is_right(sample))
        seen.append(sees_floor_corners(sample))
        if not answer.accepted:
            continue
        error = (answer.heading_rad - sample.heading_rad + pi / 2) % pi - pi / 2
        headings.append(error)
        ratios.append(abs(error) / answer.heading_std_rad)
        if np.isfinite(answer.lateral_offset_norm):
            offsets.append(answer.lateral_offset_norm - sample.offset_norm)
            offset_ratios.append(abs(offsets[-1]) / answer.lateral_offset_norm_std)
    every, total = np.abs(np.concatenate(residuals)), len(found)
    on_axis = every[every < ON_AXIS_RAD]
    cells: list[Any] = [name, total, number(float(np.median(noise)), 1), number(float(np.median(found)), 0)]
    cells += [number(len(on_axis) / total, 1), percent(len(headings) / total)]
    cells += [number(degrees(q), 2) for q in np.percentile(np.abs(headings), [50, 90, 100]).tolist()]
    cells += [number(float(np.percentile(ratios, 90)), 1), percent(len(offsets) / total)]
    if offsets:
        size = np.abs(offsets)
        cells += [number(float(np.median(size)), 3), percent(float(np.mean(size > WRONG)), 1)]
        cells += [number(float(np.percentile(offset_ratios, 90)), 1)]
    else:
        cells += ["", "", ""]
    return [str(c) for c in [*cells, percent(float(np.mean(likeliest))), percent(float(np.mean(seen)))]]


HEAD = [
    "", "pictures", "noise", "lines", "on axis", "accepted", "heading 50 %", "90 %", "worst", "90 % z",
    "offset told", "50 %", "wrong", "90 % z", "likeliest right", "corners among lines",
]  # fmt: skip


def seed_of(seed: int, night: bool) -> int:
    """Return the first of the seeds that go with a seed whose corridor is drawn for the night, or for the day."""
    return next(s for s in range(100 * seed, 100 * seed + 100) if is_night(s) == night)


def compare(frames: int) -> None:
    """Print what single frames make of flights and of simulated corridors."""
    size, rows = COMPARED_PX, []
    for name, folder in FLIGHTS.items():
        if folder.is_dir():
            rows.append(row_of(name, of_flight(folder, size, frames)))
        else:
            print(f"skipped: {name}, for {folder} is not there", file=sys.stderr)
    camera = replace(load_flight(FLIGHTS["office"]).camera, exposure_s=0.008).resized(*size)
    drawn: dict[str, Any] = {"views_per_scene": VIEWS_PER_SCENE, "min_ahead_m": 1.0}
    rows.append(row_of("plain offices", of_views(office_views(camera, frames, SEED, **drawn))))
    for name, night in (("random, by day", False), ("random, by night", True)):

        def scene(seed: int, night: bool = night) -> SceneConfig:
            return SceneConfig.random(seed_of(seed, night))

        def imaging(seed: int, night: bool = night) -> ImagingConfig:
            return ImagingConfig.random(seed_of(seed, night))

        views = random_views(camera, frames, SEED, scene=scene, imaging=imaging, **drawn)
        rows.append(row_of(name, of_views(views)))
    print(f"single frames at {size[0]}x{size[1]}; heading in degrees, offset over half the width")
    print(table(HEAD, rows))


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
    """Print the comparison."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--frames", type=int, default=100, help="pictures of each kind")
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    for size in SIZES_PX:
        print(f"{size[0]}x{size[1]}: simulated at {frames_a_second(size)}")
    compare(arguments.frames)


if __name__ == "__main__":
    main()
