"""Whether the lateral offset is known, right, honest and cheap, on every flight at hand, beside what is aimed at.

``python benchmarks/lateral.py`` fuses ``data/office`` and, where they lie beside the repository, ``clutter`` and
``night`` from nine start times each, and corridors drawn at random by the simulator, from seeds that nothing was
fitted to. For each it prints, at the times of the frames: RMSE in centimetres where the offset is known, how much
of the time it is, how often it is then wrong (by more than 0.1 half widths), the 90th percentile of error over
sigma, and the time from the first accepted frame until it is known; for the causal filter and for the smoother.
Then every aim with what was found. ``--sensors`` flies everything also without accelerometer, and with one that
vibrates.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from math import isfinite, nan
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import numpy.typing as npt
import typer
from scipy.stats import chi2

from fusion import Flight, FusionConfig, fuse_flight, load_flight
from fusion.estimator.lateral.gaussian_sum import (
    OffsetModel,
    OffsetState,
    frame_evidence,
    initial_offset_state,
    propagate,
    readout,
    update,
)
from fusion.estimator.tables import Table
from fusion.flight import CorridorTruth, FrameStream
from fusion.simulate import SimulationConfig, simulate_flight
from support.cases import flight_named
from support.scores import number, percent, rms, table
from vision import extract_lines, measure_lines
from vision.lateral.mixture import OffsetMixture

FloatArray = npt.NDArray[np.float64]

START_TIMES_S = tuple(range(9))
FIRST_SEED = 9000
KNOWN_STD_NORM = 0.12  # a wider offset is as good as none
WRONG_NORM = 0.1
VIBRATION_M_S2 = 3.0
MIN_CLEAR_S = 3.0  # of flight left after a start time
STEP_AHEAD_S = 5.0  # before a step in the width, for which the walls in view are those ahead


@dataclass(frozen=True, slots=True)
class Aim:
    """What is to be reached; centimetres and shares."""

    rmse_cm: float
    known: float
    wrong: float
    smoothed_cm: float = nan


AIMS = {
    "office": Aim(2.0, 0.98, 0.005, 1.5),
    "clutter": Aim(5.0, 0.90, 0.01),
    "night": Aim(4.0, 0.95, 0.005),
    "random": Aim(5.0, 0.90, 0.01),
}
SIGMA_P90, SIGMA_P90_OF_ALL = (1.0, 2.4), (1.2, 2.0)
FIRST_KNOWN_S = (1.5, 4.0)  # median, 90th percentile
EVIDENCE_MS, FILTER_MS = 1.5, 0.3
HALLWAY_KNOWN, HALLWAY_ROUGH = 0.8, 0.05
HALLWAY_FRAMES = 46  # of the first corridor, as its README says; a turn by 65 degrees follows
SMOOTH_S = 1.0  # over which a smooth offset is a parabola
IMU_PER_FRAME, FRAME_S = 10, 0.05


@dataclass(frozen=True, slots=True, eq=False)
class Errors:
    """Offsets at the times of a flight's frames: error and half width, metres; error over sigma; whether known.

    ``coasted`` is error over sigma where each stretch ends over which the filter has carried the offset on,
    ``before_step`` says where the corridor gets narrower or wider within `STEP_AHEAD_S`.
    """

    error_m: FloatArray
    half_m: FloatArray
    ratio: FloatArray
    known: npt.NDArray[np.bool_]
    first_s: float
    coasted: FloatArray
    before_step: npt.NDArray[np.bool_]

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


def errors_of(rows: Table, frames: Table, truth: CorridorTruth) -> Errors:
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
    ratio = np.abs(error_m) / (0.5 * width_m * std)
    coasting = known & (rows["lateral_status"][at] == "coasting")
    accepted = frames["timestamp_ns"][frames["accepted"]]
    first_s = nan
    if known.any() and len(accepted):
        first_s = max(0.0, float(t[known][0] - accepted[0]) * 1e-9)
    coasted = ratio[:-1][coasting[:-1] & ~coasting[1:]]
    ahead = np.searchsorted(t, t + int(STEP_AHEAD_S * 1e9), side="right")
    before_step = np.array([np.ptp(width_m[k:end]) > 0.0 for k, end in enumerate(ahead)], dtype=bool)
    return Errors(error_m, 0.5 * width_m, ratio, known, first_s, coasted, before_step)


def score(errors: Errors) -> Score:
    """Score the offsets of one flight or of several."""
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
    """Format a row of scores."""
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


Form = Callable[[float], str]


def aim_row(what: str, found: float, low: float, high: float, form: Form) -> list[str]:
    """Return a row of the table of aims: what, found, aim, whether it is met; a dash where nothing was measured."""
    if low <= 0.0:
        aim = f"at most {form(high)}"
    else:
        aim = f"at least {form(low)}" if form is share else f"{form(low)} to {form(high)}"
    return [what, form(found), aim, "-" if found != found else "met" if low <= found <= high else "missed"]


def plain(value: float) -> str:
    """Format a number."""
    return number(value)


def share(value: float) -> str:
    """Format a share as per cent."""
    return percent(value)


def centimetres(value: float) -> str:
    """Format a length."""
    return f"{number(value, 1)} cm"


def seconds(value: float) -> str:
    """Format a time."""
    return f"{number(value, 1)} s"


def milliseconds(value: float) -> str:
    """Format a short time."""
    return f"{number(value)} ms"


def aims_of_kind(kind: str, rows: Sequence[Sequence[Score]], errors: Sequence[Errors]) -> list[list[str]]:
    """Return the rows of the table of aims for all flights of one kind."""
    aim, name = AIMS[kind], f"{kind}, {len(rows)} flights" if len(rows) > 1 else kind
    cm, smoothed_cm = (float(np.nanmedian([s[k].rmse_cm for s in rows])) for k in range(2))
    known = np.concatenate([e.known for e in errors])
    wrong = float(np.concatenate([e.is_wrong for e in errors]).sum() / max(known.sum(), 1))
    steady = np.concatenate([~e.before_step for e in errors])
    wrong_where_steady = np.concatenate([e.is_wrong for e in errors])[steady].sum()
    known_where_steady = np.concatenate([e.known for e in errors])[steady].sum()
    found = [
        aim_row(name + ": filter, median flight", cm, 0.0, aim.rmse_cm, centimetres),
        aim_row(name + ": known", float(known.mean()), aim.known, 1.0, share),
        aim_row(name + ": wrong, of known", wrong, 0.0, aim.wrong, share),
        aim_row(name + ": |error| / sigma, p90", _sigma_p90(errors), *SIGMA_P90, plain),
    ]
    if not steady.all():
        share_wrong = float(wrong_where_steady / max(known_where_steady, 1))
        found.append(aim_row(name + ": wrong, no step ahead", share_wrong, 0.0, aim.wrong, share))
    if isfinite(aim.smoothed_cm):
        found.append(aim_row(name + ": smoother", smoothed_cm, 0.0, aim.smoothed_cm, centimetres))
    return found


def _sigma_p90(errors: Sequence[Errors]) -> float:
    ratio = np.concatenate([e.ratio[e.known] for e in errors])
    return float(np.percentile(ratio, 90)) if len(ratio) else nan


def aims_of_all(errors: Sequence[Errors]) -> list[list[str]]:
    """Return the rows of the table of aims that are for all flights together."""
    first = np.array([e.first_s for e in errors])
    never = int(np.isnan(first).sum())
    waited = np.percentile(np.where(np.isnan(first), np.inf, first), (50, 90), method="lower").tolist()
    coasted = np.concatenate([e.coasted for e in errors])
    n = max(len(coasted), 1)
    nees = float(np.mean(coasted**2)) if len(coasted) else nan
    low, high = (chi2.ppf((0.005, 0.995), n) / n).tolist()
    return [
        aim_row("all: |error| / sigma, p90", _sigma_p90(errors), *SIGMA_P90_OF_ALL, plain),
        aim_row(f"all: NEES where coasting ends, {len(coasted)} stretches", nees, low, high, plain),
        aim_row("all: first known, median", waited[0], 0.0, FIRST_KNOWN_S[0], seconds),
        aim_row(f"all: first known, p90; {never} never", waited[1], 0.0, FIRST_KNOWN_S[1], seconds),
    ]


def filtered(state: OffsetState, evidence: Sequence[OffsetMixture], model: OffsetModel) -> OffsetState:
    """Do what the filter does between two frames, and with one."""
    for _ in range(IMU_PER_FRAME):
        state = propagate(state, FRAME_S / IMU_PER_FRAME, 0.0, (0.0, 0.0, -9.81), (0.0, 0.0, 1.0))
    state = update(state, frame_evidence(evidence, FRAME_S, 0.0, (0.0, 0.0)), model)
    readout(state, model)
    return state


def aims_of_cost(every: int = 5) -> list[list[str]]:
    """Return the rows of the table of aims on what the offset costs a frame, 640x480, one thread."""
    folder = flight_named("office")
    if folder is None:
        return []
    cv2.setNumThreads(1)
    flight, clock = load_flight(folder), time.process_time  # of this process: a busy machine does not count
    state, model = initial_offset_state(), OffsetModel()
    times = []
    for i in range(0, len(flight.frames.t_ns), every):
        lines = extract_lines(flight.frames.read(i), flight.camera)
        t = [clock()]
        measure_lines(lines, flight.camera, lateral=False)
        t.append(clock())
        found = measure_lines(lines, flight.camera)
        t.append(clock())
        if found.offset_evidence:
            state = filtered(state, found.offset_evidence, model)
            times.append(1e3 * np.diff([*t, clock()]))
    alone, whole, part = np.median(times[2:], axis=0).tolist()
    return [
        aim_row(
            f"cost: evidence, beside {alone:.2f} ms of heading", whole - alone, 0.0, EVIDENCE_MS, milliseconds
        ),
        aim_row(f"cost: filter, {IMU_PER_FRAME} IMU samples and a frame", part, 0.0, FILTER_MS, milliseconds),
    ]


def aims_of_hallway() -> list[list[str]]:
    """Return the rows of the table of aims on the real hallway's first corridor, whose offset nobody measured."""
    folder = flight_named("mononav_hallway")
    if folder is None:
        return []
    flight = load_flight(folder)
    rows = fuse_flight(flight, FusionConfig()).estimates
    rows = rows[rows["timestamp_ns"] <= flight.frames.t_ns[HALLWAY_FRAMES - 1]]
    offset, t_s = rows["lateral_offset_norm"], 1e-9 * (rows["timestamp_ns"] - rows["timestamp_ns"][0])
    known = np.isfinite(offset)
    rough = []
    for t in t_s[known]:
        near = known & (np.abs(t_s - t) <= SMOOTH_S / 2)
        if near.sum() > 3:
            parabola = np.polynomial.Polynomial.fit(t_s[near], offset[near], 2)
            rough.append(rms(offset[near] - parabola(t_s[near])))
    return [
        aim_row("hallway: known, first corridor", float(known.mean()), HALLWAY_KNOWN, 1.0, share),
        aim_row("hallway: roughest second, half widths", max(rough, default=nan), 0.0, HALLWAY_ROUGH, plain),
    ]


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
        aims = [
            row
            for kind in AIMS
            if (variant, kind) in scores
            for row in aims_of_kind(kind, scores[variant, kind], errors[variant, kind])
        ]
        aims += aims_of_all([e for kind in AIMS for e in errors.get((variant, kind), [])])
        if variant == variants[0]:
            aims += [*aims_of_cost(), *aims_of_hallway()]
        print(table(("", "found", "aim", ""), aims, left=(0, 3)), "\n")


if __name__ == "__main__":
    typer.run(main)
