"""Fuse a fleet of simulated flights, change a setting, and compare the two results.

``python examples/compare_configurations.py [--flights 6] [--seconds 4] [--jobs 2] [--out fleet]``

Two vehicles fly down different corridors. The gyroscope of the second is three times as noisy as its log declares,
and one log is truncated. The fleet is fused twice: as it is, and with the correct noise for the second vehicle. The
printed numbers are from the rows of the two tables; ``fleet.html`` in both folders shows them.

Worker processes import this file again, so the code that starts them is under ``if __name__ == "__main__"``.
"""

from __future__ import annotations

import argparse
import sys
from math import degrees
from pathlib import Path

import numpy as np

from fusion.fleet.batch import BatchSettings, Fleet, fuse_fleet
from fusion.fleet.comparison import Change, compare_fleets
from fusion.fleet.quantities import worst_first_key
from fusion.simulate import SimulationConfig, simulate_flight

DAY_NS = 86_400 * 10**9
NOISY = 3.0


def make_flights(folder: Path, count: int, seconds: float) -> None:
    """Simulate flights of two vehicles, a day apart; the last log is torn."""
    for k in range(count):
        config = SimulationConfig.random_office(
            k + 1,
            start_ns=1_770_000_000 * 10**9 + k * DAY_NS,
            motion={"duration_s": seconds},
            camera={"width_px": 320, "height_px": 240, "rate_hz": 10.0},
            light_cell_m=0.5,
        )
        if k % 2 and config.imu is not None:
            noise = NOISY * config.imu.gyro_noise_density
            config = config.model_copy(
                update={"imu": config.imu.model_copy(update={"gyro_noise_density": noise})}
            )
        flight = folder / f"mav{k % 2 + 1}" / f"hall_{k + 1}"
        simulate_flight(config, flight)
        if k % 2:
            declare_less_noise(flight / "mav0" / "imu0" / "sensor.yaml")
    (folder / "mav1" / "hall_1" / "mav0" / "cam0" / "data.csv").write_text("", encoding="utf-8")


def declare_less_noise(sensor: Path) -> None:
    """Let a log say of its gyroscope what its data sheet would, not what is true."""
    lines = sensor.read_text(encoding="utf-8").splitlines()
    for k, line in enumerate(lines):
        name, _, value = line.partition(":")
        if name == "gyroscope_noise_density":
            lines[k] = f"{name}: {float(value.split('#')[0]) / NOISY!r}"
    sensor.write_text("\n".join(lines) + "\n", encoding="utf-8")


def write_list(file: Path, noise: float) -> Path:
    """Write a list that gives the second vehicle settings of its own."""
    file.with_name("mav2.toml").write_text(f"gyro_noise_density = {noise!r}\n", encoding="utf-8")
    text = '[[flight]]\npath = "mav1"\nvehicle = "mav1"\n'
    text += '[[flight]]\npath = "mav2"\nvehicle = "mav2"\nconfig = "mav2.toml"\n'
    file.write_text(text, encoding="utf-8")
    return file


def told(fleet: Fleet) -> list[str]:
    """Return a line per vehicle, and one for the worst flight."""
    lines = []
    for vehicle in sorted({row.vehicle for row in fleet.rows}):
        rows = [row for row in fleet.rows if row.vehicle == vehicle]
        errors = [row.heading_rmse_rad for row in rows if row.heading_rmse_rad is not None]
        ratios = [
            row.heading_error_over_sigma_p90 for row in rows if row.heading_error_over_sigma_p90 is not None
        ]
        lines.append(
            f"{vehicle}: {len(rows)} flights, heading error {degrees(float(np.median(errors))):.2f} degrees, "
            f"over sigma {np.median(ratios):.1f} at the 90th percentile (medians)"
        )
    worst = min(fleet.rows, key=worst_first_key)
    return [*lines, f"worst: {worst.flight}, {worst.verdict}{': ' + worst.reason if worst.reason else ''}"]


def main(arguments: list[str]) -> int:
    """Make the flights, fuse them twice, and print what the change did."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--flights", type=int, default=6)
    parser.add_argument("--seconds", type=float, default=4.0)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("fleet"))
    options = parser.parse_args(arguments)
    flights = options.out / "flights"
    make_flights(flights, options.flights, options.seconds)
    settings = BatchSettings(jobs=options.jobs)

    before = fuse_fleet([flights], options.out / "before", settings, notify=print)
    print("\n".join(told(before)))

    measured = [row.gyro_noise_rad_s_sqrt_hz for row in before.rows if row.vehicle == "mav2"]
    noise = float(np.median([value for value in measured if value is not None]))
    listed = write_list(flights / "list.toml", noise)
    after = fuse_fleet([listed], options.out / "after", settings, against=before.rows, notify=print)
    print(f"\nwith {noise:.4f} rad/s/sqrt(Hz) for mav2, as its flights show:")
    print("\n".join(told(after)))

    found = compare_fleets(before.rows, after.rows)
    print(", ".join(f"{found.count(change)} {change}" for change in Change))
    print(f"open {options.out / 'after' / 'fleet.html'}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
