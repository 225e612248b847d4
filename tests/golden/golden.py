"""Estimates put by, so that a change of the estimator cannot pass unnoticed.

Each golden flight has two files here: what the estimator is given of the camera (or, for simulated flights, of all
sensors), and what it then says, every twentieth row of the filter's table and of the smoother's. The pictures
themselves are not measured again: vision may differ in the last bits from machine to machine, the estimator may not.
"""

from __future__ import annotations

import csv
import gzip
import io
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import fields
from enum import IntEnum
from math import nan, radians
from pathlib import Path
from typing import Any

import numpy as np

from fusion import Flight, FusionConfig, load_flight
from fusion.estimator.estimator import CorridorEstimator
from fusion.estimator.frame_update import FrameResult
from fusion.estimator.propagation import ImuSample
from fusion.estimator.state import Entry
from fusion.estimator.tables import ESTIMATE_DTYPE, Table
from fusion.offline.table_builder import TableBuilder
from vision.measurement import FrameMeasurement, Position, Reason

HERE = Path(__file__).resolve().parent
OFFICE = HERE.parents[1] / "data" / "office"
EVERY = 20
TOLERANCE = 1e-9
RENEW = "python -m tests.golden.renew"


class Kind(IntEnum):
    """Kinds of samples in the files, in the order in which those of one instant are given."""

    IMU = 0
    ATTITUDE = 1
    VELOCITY = 2
    RANGE = 3
    FRAME = 4


Give = tuple[int, Kind, tuple[Any, ...]]  # when, to what, with which values
SCALARS = tuple(
    f.name
    for f in fields(FrameMeasurement)
    if f.name not in ("lines_px", "line_class", "wall_lines_px", "offset_evidence", "wall_profiles")
)
PAIRS = {"vp_px": 2, "vp_cov_px2": 4}


# --- frame measurements as rows of text ---


def frame_columns() -> list[str]:
    names = []
    for name in SCALARS:
        names += [f"{name}_{i}" for i in range(PAIRS[name])] if name in PAIRS else [name]
    return names


def frame_cells(m: FrameMeasurement) -> list[str]:
    cells: list[str] = []
    for name in SCALARS:
        value = getattr(m, name)
        cells += [_cell(v) for v in np.ravel(value).tolist()] if name in PAIRS else [_cell(value)]
    return cells


def frame_from(row: dict[str, str]) -> FrameMeasurement:
    def number(name: str) -> float:
        return float(row[name]) if row.get(name) else nan

    values: dict[str, Any] = {
        name: number(name) for name in SCALARS if name not in (*PAIRS, "accepted", "reason", "position")
    }
    cov = [number(f"vp_cov_px2_{i}") for i in range(4)]
    return FrameMeasurement(
        **values
        | {
            "accepted": row["accepted"] == "1",
            "reason": Reason(row["reason"]),
            "position": Position(row["position"]) if row["position"] else None,
            "n_lines": int(row["n_lines"]),
            "n_inliers": int(row["n_inliers"]),
            "vp_px": (number("vp_px_0"), number("vp_px_1")),
            "vp_cov_px2": ((cov[0], cov[1]), (cov[2], cov[3])),
        }
    )


def _cell(value: Any) -> str:
    if value is None or value != value:
        return ""
    if isinstance(value, (bool, np.bool_)):
        return str(int(value))
    return f"{value:.10g}" if isinstance(value, float) else str(value)


# --- files ---


def write_rows(path: Path, columns: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(rows)
    # No time stamp inside, so that the same rows are the same file.
    path.write_bytes(gzip.compress(text.getvalue().encode(), 9, mtime=0))


def read_rows(path: Path) -> list[dict[str, str]]:
    with gzip.open(path, "rt", encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def write_table(path: Path, filtered: Table, smoothed: Table) -> None:
    names = ESTIMATE_DTYPE.names or ()
    rows = [
        [which, *("" if v != v else f"{v:.13g}" if isinstance(v, float) else str(v) for v in row.item())]
        for which, table in (("filter", filtered), ("smoother", smoothed))
        for row in table[::EVERY]
    ]
    write_rows(path, ["table", *names], rows)


def read_table(path: Path) -> dict[str, Table]:
    found: dict[str, list[tuple[Any, ...]]] = {"filter": [], "smoother": []}
    for row in read_rows(path):
        cells = (row.get(name, "") for name in ESTIMATE_DTYPE.names or ())  # a new column is not in old files
        kinds = (ESTIMATE_DTYPE[i].kind for i in range(len(ESTIMATE_DTYPE.names or ())))
        found[row["table"]].append(tuple(_value(c, k) for c, k in zip(cells, kinds, strict=True)))
    return {which: np.array(rows, dtype=ESTIMATE_DTYPE) for which, rows in found.items()}


def _value(cell: str, kind: str) -> Any:
    if kind == "U":
        return cell
    return int(cell) if kind == "i" else float(cell or "nan")


def differences(name: str, expected: Table, found: Table) -> Iterator[str]:
    """One line for each column in which two tables differ."""
    if len(expected) != len(found):
        yield f"{name}: {len(found)} rows, not {len(expected)}"
        return
    for column in ESTIMATE_DTYPE.names or ():
        a, b = expected[column], found[column]
        if a.dtype.kind == "f":
            off = np.where(np.isnan(a) & np.isnan(b), 0.0, np.abs(b - a))
            wrong = ~(off <= TOLERANCE)  # a NaN on one side only is wrong too
            size = f", by up to {np.nanmax(off[wrong], initial=0.0):.3g}" if wrong.any() else ""
        else:
            wrong, size = a != b, ""
        if wrong.any():
            k = int(np.argmax(wrong))
            yield (
                f"{name}: {column} differs in {int(wrong.sum())} of {len(a)} rows{size}; first at "
                f"{int(expected['timestamp_ns'][k])} ns: {b[k]}, not {a[k]}; if that is meant: {RENEW}"
            )


# --- flights ---


def drive(gives: list[Give], config: FusionConfig, flight: Flight | None = None) -> tuple[Table, Table]:
    """Filter's and smoother's table of these samples."""
    recorder = TableBuilder(config, (ImuSample,))
    estimator = CorridorEstimator(config, None if flight is None else flight.camera, on_final=recorder.take)
    call: dict[Kind, Callable[..., Any]] = {
        Kind.IMU: estimator.add_imu,
        Kind.ATTITUDE: estimator.add_attitude,
        Kind.VELOCITY: estimator.add_velocity,
        Kind.FRAME: estimator.add_measurement,
    }
    for t_ns, kind, values in sorted(gives, key=lambda give: give[:2]):
        call[kind](t_ns, *values)
    estimator.finish()
    recorder.finish()
    return recorder.estimates(), recorder.smoothed()


def office(frames: Path = HERE / "office_frames.csv.gz") -> tuple[Table, Table]:
    """The sample flight, its pictures as measured when the file was made."""
    flight = load_flight(OFFICE)
    measured = [(int(row["timestamp_ns"]), Kind.FRAME, (frame_from(row),)) for row in read_rows(frames)]
    return drive([*_sensors(flight), *measured], office_config(flight), flight)


def office_config(flight: Flight) -> FusionConfig:
    imu = flight.imu
    if imu is None:
        raise ValueError("the sample flight has lost its gyroscope")
    return FusionConfig(
        corridor_width_m=2.2,
        gyro_noise_density=imu.gyro_noise_density,
        gyro_bias_walk=imu.gyro_random_walk,
    )


def measure_office() -> list[list[str]]:
    """Measure the pictures of the sample flight as the estimator does, with what it expects of each."""

    flight = load_flight(OFFICE)
    seen: dict[int, FrameMeasurement] = {}

    def keep(entry: Entry) -> None:
        result: FrameResult | None = entry.frame
        if result is not None and result.measurement is not None:
            seen[result.timestamp_ns] = result.measurement

    estimator = CorridorEstimator(office_config(flight), flight.camera, on_final=keep)
    call: dict[Kind, Callable[..., object]] = {
        Kind.IMU: estimator.add_imu,
        Kind.ATTITUDE: estimator.add_attitude,
    }
    pictures = [(int(t), Kind.FRAME, (i,)) for i, t in enumerate(flight.frames.t_ns)]
    for t_ns, kind, values in sorted([*_sensors(flight), *pictures], key=lambda give: give[:2]):
        if kind is Kind.FRAME:
            estimator.add_frame(t_ns, flight.frames.read(values[0]))
        else:
            call[kind](t_ns, *values)
    estimator.finish()
    return [[str(t_ns), *frame_cells(m)] for t_ns, m in seen.items()]


def _sensors(flight: Flight) -> Iterator[Give]:
    if flight.imu is None or flight.attitude is None:
        raise ValueError("the sample flight has lost a sensor")
    imu, attitude = flight.imu, flight.attitude
    for t, gyro, accel in zip(imu.t_ns, imu.gyro_rad_s, imu.accel_m_s2, strict=True):
        yield int(t), Kind.IMU, (gyro, accel)
    for t, q in zip(attitude.t_ns, attitude.q_world_body, strict=True):
        yield int(t), Kind.ATTITUDE, (q,)


# --- a simulated flight with what the sample flight lacks: a junction, gross errors, drop-outs, a step of the yaw ---

JUNCTION_COLUMNS = ("timestamp_ns", "kind", *(f"v{i}" for i in range(5)))
JUNCTION_TURN_RAD = radians(75)


def simulate_junction() -> list[list[str]]:
    from tests.fusion.simulated import Scene, plus, simulate, turning, weaving

    simulated = simulate(
        Scene(
            duration_s=16.0,
            seed=12,
            heading=plus(weaving(12, radians(8)), turning((7.0, 1.5, JUNCTION_TURN_RAD))),
            axis=lambda t: np.where(np.asarray(t) < 7.75, 0.0, JUNCTION_TURN_RAD),
            gyro_hz=50,
            frame_hz=15,
            gross=0.1,
            dropouts=[(3.5, 5.0)],
            attitude_hz=10,
            yaw_offset=lambda t: 0.7 + np.where(np.asarray(t) > 11, radians(15), 0.0),
        )
    )
    rows = []
    for sample in simulated.samples:
        kind, values = Kind[sample.kind.upper()], sample.values
        if kind is Kind.IMU or kind is Kind.ATTITUDE:
            numbers = values[0]
        else:
            m = values[0]
            numbers = (m.heading_rad, m.heading_std_rad, m.lateral_offset_norm, m.lateral_offset_norm_std)
        cells = [f"{v:.7g}" for v in numbers]
        rows.append([str(sample.t_ns), kind.name, *cells, *[""] * (5 - len(cells))])
    return rows


def junction(inputs: Path = HERE / "junction_inputs.csv.gz") -> tuple[Table, Table]:
    """A simulated turn into another corridor, from the samples in the file."""
    gives: list[Give] = []
    for row in read_rows(inputs):
        kind = Kind[row["kind"]]
        numbers = [float(row[f"v{i}"]) for i in range(5) if row[f"v{i}"]]
        if kind is Kind.FRAME:
            heading, heading_std, lateral, lateral_std = numbers
            measurement = FrameMeasurement(
                True,
                Reason.OK,
                n_lines=60,
                n_inliers=30,
                heading_rad=heading,
                heading_std_rad=heading_std,
                lateral_offset_norm=lateral,
                lateral_offset_norm_std=lateral_std,
            )
            gives.append((int(row["timestamp_ns"]), kind, (measurement,)))
        else:
            gives.append((int(row["timestamp_ns"]), kind, (numbers,)))
    config = FusionConfig(corridor_width_m=2.2, imu_yaw_use="always", imu_yaw_std_rad=radians(0.3))
    return drive(gives, config)


FLIGHTS: dict[str, Callable[[], tuple[Table, Table]]] = {"office": office, "junction": junction}


def golden_file(name: str) -> Path:
    return HERE / f"{name}_estimates.csv.gz"
