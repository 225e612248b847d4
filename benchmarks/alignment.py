"""Time offset, focal length and mounting put wrong by known amounts, and what `align_flight` finds of them.

    python benchmarks/alignment.py [--flights 4] [--seconds 15] [--only office] [--quick]

prints for the sample flight and two simulated ones (a straight corridor; a fisheye round a corner) what was injected,
what was found, its sigma and the error over sigma; then the heading's error after fusing the spoilt flight and the
aligned one; then, over pieces of these and of further simulated flights of which nothing was spoilt, the root mean
square of error over sigma, which is 1 where sigma is honest. Errors of one flight are the same whatever is injected,
so only the pieces tell that.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Iterator
from dataclasses import replace
from math import degrees, nan, radians
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fusion import Flight, fuse_flight, load_flight
from fusion.alignment import Alignment, Quantity, align_flight, apply_alignment
from fusion.alignment.mount import mount_rotation
from fusion.alignment.views import scaled_focal
from fusion.flight import ChosenFrames, FrameStream
from fusion.simulate import SimulationConfig, simulate_flight
from fusion.simulate.config import CameraConfig
from vision.cameras.camera import Distortion

OFFICE = Path(__file__).resolve().parent.parent / "data" / "office"
OFFSETS_S = (-1.9, -0.4, 0.013, 1.7)
FOCALS = (0.95, 1.05)
YAWS_DEG = (-3.0, 3.0)
PIECE_S = 7.5
FIRST_SEED = 21


class Spoilt(NamedTuple):
    """What an alignment has to correct by."""

    offset_s: float = 0.0
    focal: float = 1.0
    yaw_deg: float = 0.0

    def of(self, flight: Flight) -> Flight:
        """Return the flight put wrong."""
        camera = scaled_focal(flight.camera, 1.0 / self.focal)
        turned = mount_rotation(np.array([0.0, 0.0, radians(self.yaw_deg)])).T @ camera.R_body_camera
        frames = replace(flight.frames, t_ns=flight.frames.t_ns - round(self.offset_s * 1e9))
        return replace(flight, frames=frames, camera=replace(camera, R_body_camera=turned))


CASES = (
    Spoilt(),
    *(Spoilt(offset_s=value) for value in OFFSETS_S),
    *(Spoilt(focal=value) for value in FOCALS),
    *(Spoilt(yaw_deg=value) for value in YAWS_DEG),
    Spoilt(1.2, 0.9, 3.0),
)


def flights(folder: Path, seconds: float, only: str | None) -> Iterator[Flight]:
    """Yield the sample flight and simulated ones, or only the one named."""
    if only in (None, "office"):
        yield load_flight(OFFICE)
    straight = SimulationConfig.model_validate({"seed": 3, "motion": {"duration_s": seconds}})
    corner = simulation(seconds)
    for name, config in (("straight", straight), ("fisheye", corner)):
        if only in (None, name):
            yield load_flight(simulate_flight(config, folder / name))


def simulation(seconds: float) -> SimulationConfig:
    """Return a fisheye in a corridor that is left for another half way."""
    from fusion.cli.simulate_options import simulation_config

    config = simulation_config(None, seed=8, duration_s=seconds + 8.0, turn_deg=-75.0)
    camera = CameraConfig(
        width_px=480,
        height_px=360,
        distortion=Distortion.EQUIDISTANT,
        coefficients=(0.01, -0.005, 0.002, -0.001),
        horizontal_fov_rad=1.9,
    )
    return config.model_copy(update={"camera": camera})


def heading_rmse_deg(flight: Flight) -> float:
    """Fuse a flight and return the heading's RMSE, degrees; NaN without one."""
    errors = fuse_flight(flight).summary["errors"]["filter"]["heading"]
    return degrees(errors["rmse_rad"]) if errors["rmse_rad"] is not None else nan


def cell(quantity: Quantity, injected: float) -> str:
    """Injected, found, sigma, error over sigma."""
    scale, digits = {"clock_offset_s": (1e3, 1), "focal_scale": (1.0, 4)}.get(
        quantity.name, (degrees(1.0), 2)
    )
    z = (quantity.value - injected) / quantity.sigma
    numbers = (f"{scale * value:9.{digits}f}" for value in (injected, quantity.value, quantity.sigma))
    return " ".join((*numbers, f"{z:5.1f}"))


def print_found(flight: Flight, cases: tuple[Spoilt, ...]) -> None:
    """Print what `align_flight` finds of errors put into a flight."""
    head = f"{'injected':>9} {'found':>9} {'sigma':>9} {'z':>5}"
    print(f"\n{flight.name}: {len(flight.frames.t_ns)} frames")
    print(f"{'time offset, ms':^35} | {'focal length, factor':^35} | {'mounting yaw, degrees':^35}")
    print(" | ".join([head] * 3) + " | seconds")
    for case in cases:
        started = time.perf_counter()
        found = align_flight(case.of(flight))
        took = time.perf_counter() - started
        cells = (
            cell(found.clock_offset, case.offset_s),
            cell(found.focal_scale, case.focal),
            cell(found.mount_yaw, radians(case.yaw_deg)),
        )
        print(" | ".join(cells) + f" | {took:7.1f}", flush=True)
    found = align_flight(flight, camera_known=False)
    true, said = flight.camera.fx_px, found.camera.fx_px
    print(
        f"of the camera nothing known: focal length {said:.1f} px, truly {true:.1f}: {said / true - 1:+.2%}"
    )


def print_fused(flight: Flight) -> None:
    """Print the heading's RMSE with errors put in, before and after the alignment."""
    print(f"\n{flight.name}: heading RMSE of the causal filter, degrees")
    print(f"{'offset ms':>10} {'focal':>6} {'yaw deg':>8} | {'unspoilt':>9} {'spoilt':>9} {'aligned':>9}")
    good = heading_rmse_deg(flight)
    for case in (Spoilt(offset_s=1.7), Spoilt(focal=0.95), Spoilt(yaw_deg=3.0), Spoilt(-0.4, 1.05, -3.0)):
        bad = case.of(flight)
        aligned = apply_alignment(bad, align_flight(bad))
        errors = " ".join(
            f"{value:9.2f}" for value in (good, heading_rmse_deg(bad), heading_rmse_deg(aligned))
        )
        print(f"{1e3 * case.offset_s:10.0f} {case.focal:6.2f} {case.yaw_deg:8.1f} | {errors}", flush=True)


def pieces(flight: Flight) -> Iterator[Alignment]:
    """Yield the alignment of each piece of a flight."""
    t_s = (flight.frames.t_ns - flight.frames.t_ns[0]) * 1e-9
    for k in range(int((t_s[-1] + 0.5) // PIECE_S)):
        index = np.flatnonzero((t_s >= k * PIECE_S) & (t_s < (k + 1) * PIECE_S))
        stream = FrameStream(flight.frames.t_ns[index], ChosenFrames(flight.frames.source, index))
        yield align_flight(replace(flight, frames=stream))


def print_honesty(alignments: list[Alignment]) -> None:
    """Print how errors over sigma are distributed."""
    told = [found for found in alignments if found.clock_offset.usable]
    print(
        f"\nerror over sigma in {len(alignments)} pieces of {PIECE_S:g} s, {len(told)} of which tell the offset"
    )
    print(f"{'':16} {'mean':>6} {'rms':>6} {'worst':>6} {'median sigma':>13}")
    for number, name in enumerate(quantity.name for quantity in alignments[0].quantities):
        one = [found.quantities[number] for found in told]
        z = np.array([(q.value - q.neutral) / q.sigma for q in one])
        sigma = float(np.median([q.sigma for q in one]))
        unit = {"clock_offset_s": f"{1e3 * sigma:.1f} ms", "focal_scale": f"{sigma:.4f}"}
        shown = unit.get(name, f"{degrees(sigma):.2f} deg")
        rms, worst = float(np.sqrt(np.mean(z**2))), float(np.abs(z).max())
        print(f"{name:16} {z.mean():6.2f} {rms:6.2f} {worst:6.2f} {shown:>13}")


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--flights", type=int, default=4, help="further simulated flights for the pieces")
    parser.add_argument("--seconds", type=float, default=15.0, help="length of the simulated flights")
    parser.add_argument("--only", choices=("office", "straight", "fisheye"), help="only this flight")
    parser.add_argument(
        "--quick", action="store_true", help="one case each, nothing fused, no further flights"
    )
    arguments = parser.parse_args()
    alignments: list[Alignment] = []
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        for flight in flights(folder, arguments.seconds, arguments.only):
            print_found(flight, CASES[-1:] if arguments.quick else CASES)
            if not arguments.quick:
                print_fused(flight)
            alignments += pieces(flight)
        for seed in range(FIRST_SEED, FIRST_SEED + (0 if arguments.quick else arguments.flights)):
            config = SimulationConfig.random_office(seed, motion={"duration_s": arguments.seconds})
            alignments += pieces(load_flight(simulate_flight(config, folder / f"random_{seed}")))
    print_honesty(alignments)


if __name__ == "__main__":
    main()
