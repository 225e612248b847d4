"""Whether the lateral offset is known, right and honest, on every flight at hand.

``python benchmarks/lateral.py`` fuses ``data/office`` and, where they lie beside the repository, ``clutter`` and
``night`` from nine start times each, and corridors drawn at random by the simulator, from seeds that nothing was
fitted to. For each it prints, at the times of the frames: RMSE in centimetres where the offset is known, how much
of the time it is, how often it is then wrong (by more than 0.1 half widths), the 90th percentile of error over
sigma, and the time from the first accepted frame until it is known; for the causal filter and for the smoother,
beside what is aimed at. ``--sensors`` flies everything also without accelerometer, and with one that vibrates.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from math import nan
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import numpy.typing as npt
import typer

from fusion import Flight, FusionConfig, fuse_flight, load_flight
from fusion.flight import CorridorTruth, FrameStream
from fusion.simulate import SimulationConfig, simulate_flight
from support.cases import flight_named
from support.scores import number, percent, rms, table
from vision import extract_lines, measure_lines

FloatArray = npt.NDArray[np.float64]

START_TIMES_S = tuple(range(9))
FIRST_SEED = 9000
KNOWN_STD_NORM = 0.12  # a wider offset is as good as none
WRONG_NORM = 0.1
VIBRATION_M_S2 = 3.0
MIN_CLEAR_S = 3.0  # of flight left after a start time


@dataclass(frozen=True, slots=True)
class Aim:
    """What is to be reached; centimetres and shares."""

    rmse_cm: float
    known: float
    wrong: float


AIMS = {
    "office": Aim(2.0, 0.98, 0.005),
    "clutter": Aim(5.0, 0.90, 0.01),
    "night": Aim(4.0, 0.95, 0.005),
    "random": Aim(5.0, 0.90, 0.01),
}
SIGMA_P90 = (1.0, 2.4)
FIRST_KNOWN_S = (1.5, 4.0)  # median, 90th percentile


@dataclass(frozen=True, slots=True, eq=False)
class Errors:
    """Offsets at the times of a flight's frames: error and half width, metres; error over sigma; whether known."""

    error_m: FloatArray
    half_m: FloatArray
    ratio: FloatArray
    known: npt.NDArray[np.bool_]
    first_s: float

    @property
    def is_wrong(self) -> npt.NDArray[np.bool_]:
        """Which are known and wrong."""
        return self.known & (np.abs(self.error_m) > WRONG_NORM * self.half_m)


@dataclass(frozen=True, slots=True)
class Score:
    """One row of the table, of the filter or of the smoother."""

    rmse_cm: float
    known: float
    wrong: float
    sigma_p90: float
    first_s: float


def errors_of(rows: npt.NDArray[Any], frames: npt.NDArray[Any], truth: CorridorTruth) -> Errors:
    """Compare a table of estimates with the truth where frames are, outside junctions."""
    t = frames["timestamp_ns"]
    at = np.clip(np.searchsorted(rows["timestamp_ns"], t, side="right") - 1, 0, None)
    in_corridor = np.interp(t, truth.t_ns, truth.in_junction) < 0.5
    t, at = t[in_corridor], at[in_corridor]
    width_m = np.interp(t, truth.t_ns, truth.corridor_width_m)
    offset_m = np.interp(t, truth.t_ns, truth.lateral_offset_m)
    norm, std = rows["lateral_offset_norm"][at], rows["lateral_offset_norm_std"][at]
    error_m = 0.5 * width_m * norm - offset_m
    known = np.isfinite(norm) & (std < KNOWN_STD_NORM)
    accepted = frames["timestamp_ns"][frames["accepted"]]
    first_s = nan
    if known.any() and len(accepted):
        first_s = max(0.0, float(t[known][0] - accepted[0]) * 1e-9)
    return Errors(error_m, 0.5 * width_m, np.abs(error_m) / (0.5 * width_m * std), known, first_s)


def score(errors: Errors) -> Score:
    k = errors.known
    return Score(
        rmse_cm=100.0 * rms(errors.error_m[k]),
        known=float(k.mean()) if len(k) else nan,
        wrong=float(errors.is_wrong.sum() / k.sum()) if k.any() else nan,
        sigma_p90=float(np.percentile(errors.ratio[k], 90)) if k.any() else nan,
        first_s=errors.first_s,
    )


def from_time(flight: Flight, start_s: float) -> Flight:
    """Return the flight as if the log had begun later."""
    if start_s <= 0.0:
        return flight
    start_ns = int(flight.frames.t_ns[0]) + round(start_s * 1e9)

    def rows(t_ns: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
        return np.flatnonzero(t_ns >= start_ns)

    frames: FrameStream = flight.frames.chosen(rows(flight.frames.t_ns))
    imu, attitude = flight.imu, flight.attitude
    if imu is not None:
        k = rows(imu.t_ns)
        imu = replace(imu, t_ns=imu.t_ns[k], gyro_rad_s=imu.gyro_rad_s[k], accel_m_s2=imu.accel_m_s2[k])
    if attitude is not None:
        k = rows(attitude.t_ns)
        attitude = replace(attitude, t_ns=attitude.t_ns[k], q_world_body=attitude.q_world_body[k])
    return replace(flight, frames=frames, imu=imu, attitude=attitude)


def with_accelerometer(flight: Flight, sensor: str) -> Flight:
    """Return the flight with its accelerometer as it is, without one (``none``), or shaken (``vibrating``)."""
    if sensor == "as it is" or flight.imu is None:
        return flight
    accel = flight.imu.accel_m_s2
    if sensor == "none":
        accel = np.full_like(accel, nan)
    else:
        accel = accel + np.random.default_rng(0).normal(0.0, VIBRATION_M_S2, accel.shape)
    return replace(flight, imu=replace(flight.imu, accel_m_s2=accel))


def flights(n_random: int) -> Iterator[tuple[str, str, Flight]]:
    """Yield kind, name and flight, one at a time in memory."""
    for kind in ("office", "clutter", "night"):
        folder = flight_named(kind)
        if folder is None:
            continue
        flight = load_flight(folder)
        length_s = float(flight.frames.t_ns[-1] - flight.frames.t_ns[0]) * 1e-9
        for start_s in START_TIMES_S if kind != "office" else (0,):
            if start_s + MIN_CLEAR_S <= length_s:
                yield kind, f"{kind} from {start_s} s", from_time(flight, start_s)
    with tempfile.TemporaryDirectory() as scratch:
        for seed in range(FIRST_SEED, FIRST_SEED + n_random):
            folder = simulate_flight(
                SimulationConfig.random(
                    seed, camera={"width_px": 640, "height_px": 480}, motion={"duration_s": 20.0}
                ),
                Path(scratch) / str(seed),
            )
            yield "random", f"random {seed}", load_flight(folder)


def cells(name: str, scores: Sequence[Score]) -> list[str]:
    row = [name]
    for s in scores:
        row += [number(s.rmse_cm, 1), percent(s.known), percent(s.wrong), number(s.sigma_p90)]
    return [*row, number(scores[0].first_s, 1)]


def misses(kind: str, scores: Sequence[Score]) -> str:
    """Name what the filter misses of its aims; ``met`` where nothing."""
    s, aim = scores[0], AIMS[kind]
    checks = (
        ("RMSE", s.rmse_cm <= aim.rmse_cm),
        ("known", s.known >= aim.known),
        ("wrong", s.wrong <= aim.wrong),
        ("sigma", SIGMA_P90[0] <= s.sigma_p90 <= SIGMA_P90[1]),
    )
    return ", ".join(name for name, met in checks if not met) or "met"


def summed_up(kind: str, rows: Sequence[Sequence[Score]], errors: Sequence[Errors]) -> str:
    """Return a sentence on all flights of one kind."""
    aim = AIMS[kind]
    filtered = [s[0] for s in rows]
    first = np.array([s.first_s for s in filtered])
    known = np.concatenate([e.known for e in errors])
    wrong = np.concatenate([e.is_wrong for e in errors])
    ratio = np.concatenate([e.ratio[e.known] for e in errors])
    found = first[np.isfinite(first)]
    waited = (float(np.median(found)), float(np.percentile(found, 90))) if len(found) else (nan, nan)
    rmse_cm = float(np.nanmedian([s.rmse_cm for s in filtered])) if len(found) else nan
    sigma_p90 = float(np.percentile(ratio, 90)) if len(ratio) else nan
    parts = (
        f"median RMSE {number(rmse_cm, 1)} cm (aim {aim.rmse_cm:g})",
        f"known {percent(float(known.mean()))} (aim {100 * aim.known:g} %)",
        f"wrong {percent(wrong.sum() / max(known.sum(), 1), 2)} of it (aim {100 * aim.wrong:g} %)",
        f"|error| / sigma p90 {number(sigma_p90)} (aim {SIGMA_P90[0]:g} to {SIGMA_P90[1]:g})",
        f"first known after {number(waited[0], 1)} s in the median, {number(waited[1], 1)} s p90 "
        f"(aim {FIRST_KNOWN_S[0]:g}, {FIRST_KNOWN_S[1]:g}), never {len(first) - len(found)} of {len(first)}",
    )
    return f"{kind}: " + "; ".join(parts)


def print_cost(every: int = 5) -> None:
    """Print what the offset's evidence costs a frame."""
    folder = flight_named("office")
    if folder is None:
        return
    flight = load_flight(folder)
    took: dict[bool, list[float]] = {True: [], False: []}
    for i in range(0, len(flight.frames.t_ns), every):
        lines = extract_lines(flight.frames.read(i), flight.camera)
        for lateral in (False, True):
            before = time.perf_counter()
            measure_lines(lines, flight.camera, lateral=lateral)
            took[lateral].append(1e3 * (time.perf_counter() - before))
    without, whole = np.median(took[False][2:]), np.median(took[True][2:])
    print(
        f"cost of the evidence from lines, office: {whole - without:.2f} ms a frame beside {without:.2f} ms without"
    )


HEADS = (
    "", "filter cm", "known", "wrong", "sigma p90", "smoother cm", "known", "wrong", "sigma p90", "first s", "missed",
)  # fmt: skip


def main(
    n_random: Annotated[int, typer.Option("--random", min=0, help="Flights of random corridors.")] = 6,
    sensors: Annotated[
        bool, typer.Option(help="Also without accelerometer, and with a vibrating one.")
    ] = False,
) -> None:
    """Score the lateral offset on every flight at hand."""
    variants = ("as it is", "none", "vibrating") if sensors else ("as it is",)
    rows: dict[str, list[list[str]]] = {v: [] for v in variants}
    scores: dict[tuple[str, str], list[list[Score]]] = {}
    errors: dict[tuple[str, str], list[Errors]] = {}
    for kind, name, flight in flights(n_random):
        if flight.truth is None:
            continue
        for variant in variants:
            result = fuse_flight(with_accelerometer(flight, variant), FusionConfig())
            both = [
                errors_of(rows_, result.frames, flight.truth) for rows_ in (result.estimates, result.smoothed)
            ]
            of_both = [score(e) for e in both]
            rows[variant].append([*cells(name, of_both), misses(kind, of_both)])
            scores.setdefault((variant, kind), []).append(of_both)
            errors.setdefault((variant, kind), []).append(both[0])
    for variant in variants:
        print(f"accelerometer {variant}")
        print(table(HEADS, rows[variant], left=(0, len(HEADS) - 1)), "\n")
        for kind in AIMS:
            if (variant, kind) in scores:
                print(summed_up(kind, scores[variant, kind], errors[variant, kind]))
        print()
    print_cost()


if __name__ == "__main__":
    typer.run(main)
