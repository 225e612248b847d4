"""Compare outputs of fused flights with ground truth: the computation of ``corridor evaluate``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, TypeVar

import numpy as np

from fusion.estimator.tables import ESTIMATE_DTYPE, Table
from fusion.evaluation.errors import evaluate, interpolate_truth
from fusion.evaluation.truth import Truth
from fusion.flight import CorridorTruth, FloatArray, TimeArray
from fusion.result.conventions import Frame, table_in_frame
from fusion.result.record import Record
from fusion.result.summary import CorridorErrors, TableErrors
from fusion.result.summary_json import read_summary
from fusion.result.tables_csv import read_table
from vision.errors import InputError
from vision.rotations import wrap

Errors = TypeVar("Errors", TableErrors, CorridorErrors)

SENSE_NS = 500_000_000  # interval over which the signs of turns are compared
MIN_TURNS, MIN_TURN_RAD = 6, 0.02
TABLES = {"causal": "estimates.csv", "smoothed": "smoothed.csv"}


@dataclass(frozen=True, slots=True, eq=False)
class Output:
    """An output folder of `corridor fuse`: its tables in FRD, and flight and method from its summary."""

    folder: Path
    name: str
    causal: Table
    smoothed: Table
    flight: str | None
    method: str | None


@dataclass(frozen=True, slots=True, eq=False)
class RemovedConstants(Record):
    """Constants removed from one corridor's differences by alignment: medians of estimate minus truth."""

    optional = frozenset({"lateral_offset_m", "lateral_offset_norm"})

    heading_rad: float
    lateral_offset_m: float | None = None
    lateral_offset_norm: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class ComparedTable(Record):
    """Errors of one table, and the constants removed by corridor; None if not aligned."""

    errors: TableErrors
    removed: Mapping[str, RemovedConstants] | None

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON object: the errors, and ``removed`` beside them."""
        removed = None if self.removed is None else {name: c.to_dict() for name, c in self.removed.items()}
        return self.errors.to_dict() | {"removed": removed}


@dataclass(frozen=True, slots=True, eq=False)
class ComparedOutput(Record):
    """One output folder compared with the truth; ``overlap_s`` of its ``duration_s`` are within the truth's time."""

    name: str
    folder: str
    flight: str | None
    method: str | None
    overlap_s: float
    duration_s: float
    causal: ComparedTable
    smoothed: ComparedTable


@dataclass(frozen=True, slots=True, eq=False)
class ErrorsOverTime:
    """Estimate less truth at a table's times (n,), NaN if not judged; the offset in the requested unit."""

    t_ns: TimeArray
    heading_rad: FloatArray
    lateral_offset: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class TruthFacts(Record):
    """The truth of a comparison; ``aligned``: constants between it and the estimates were removed."""

    source: str
    rows: int
    first_ns: int
    last_ns: int
    fixed_axis: bool
    aligned: bool
    problems: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Comparison(Record):
    """A ground truth, and outputs compared with it."""

    truth: TruthFacts
    outputs: tuple[ComparedOutput, ...]


def read_outputs(folders: Sequence[str | Path]) -> list[Output]:
    """Read output folders; each is named by the shortest part of its path that is unique.

    Raises
    ------
    InputError
        If one is not an output folder, or its tables are damaged or empty.
    """
    paths = [Path(folder) for folder in folders]
    names = _short_names(paths)
    return [_read_output(path, name) for path, name in zip(paths, names, strict=True)]


def _short_names(paths: Sequence[Path]) -> list[str]:
    parts = [path.resolve().parts for path in paths]
    for depth in range(1, max(len(p) for p in parts) + 1):
        names = ["/".join(p[-depth:]) for p in parts]
        if len(set(names)) == len(set(parts)):
            return names
    return [str(path) for path in paths]


def _read_output(folder: Path, name: str) -> Output:
    remedy = "give a folder that corridor fuse wrote"
    if not folder.is_dir():
        problem = "is a file, not an output folder" if folder.exists() else "no such folder"
        raise InputError(problem, file=folder, remedy=remedy)
    missing = [file for file in (*TABLES.values(), "summary.json") if not (folder / file).exists()]
    if missing:
        raise InputError(f"contains no {missing[0]}", file=folder, remedy=remedy)
    try:
        summary = read_summary(folder / "summary.json")
        frame = Frame(summary.get("frame", Frame.FRD))
    except (OSError, ValueError) as error:
        problem = "is not the summary of a fused flight"
        raise InputError(problem, file=folder / "summary.json", remedy=remedy) from error
    tables = {}
    for kind, file in TABLES.items():
        table = read_table(folder / file, ESTIMATE_DTYPE)
        if not len(table):
            raise InputError("contains no rows", file=folder / file, remedy="the flight had nothing to fuse")
        tables[kind] = table_in_frame(table, frame)  # converting twice restores the original
    return Output(
        folder, name, tables["causal"], tables["smoothed"], summary.get("flight"), summary.get("method")
    )


def compare(outputs: Sequence[Output], truth: Truth, *, align: bool = False) -> Comparison:
    """Compare outputs with ground truth.

    Parameters
    ----------
    outputs
        From `read_outputs`.
    truth
        From `fusion.evaluation.truth_file.read_truth`.
    align
        Remove the constant between estimate and truth from heading and offset, per corridor of the truth, for a truth
        whose zero is not the corridor's axis and centre line. The constants are part of the result.

    Returns
    -------
    Comparison
        The errors of each output's causal and smoothed estimates; ``to_dict()`` gives plain values for JSON.

    Raises
    ------
    InputError
        If an output and the truth have no time in common.
    """
    t = truth.corridor.t_ns
    compared = tuple(_compare_output(output, truth, align) for output in outputs)
    problems = truth.problems
    if any(_turn_oppositely(output.causal, truth) for output in outputs):
        problems += (
            "the truth turns the other way than the estimates: its angles count the other way than was taken; "
            f"add --truth-frame {'frd' if truth.frame is Frame.ROS else 'ros'}",
        )
    facts = TruthFacts(
        source=truth.source,
        rows=len(t),
        first_ns=int(t[0]),
        last_ns=int(t[-1]),
        fixed_axis=truth.fixed_axis,
        aligned=align,
        problems=problems,
    )
    return Comparison(facts, compared)


def errors_over_time(
    table: Table, truth: Truth, unit: Literal["m", "norm"], *, align: bool = False
) -> ErrorsOverTime:
    """Return the differences of one table that `compare` judges, row by row.

    Parameters
    ----------
    table
        ``causal`` or ``smoothed`` of an `Output`.
    truth, align
        As for `compare`.
    unit
        Of the offset: metres or half widths.
    """
    rows = _to_first_axis(table) if truth.fixed_axis else table
    corridor = _aligned(truth.corridor, rows)[0] if align else truth.corridor
    at = interpolate_truth(corridor, rows["timestamp_ns"])
    judged = at.known & ~at.in_junction & (rows["status"] == "tracking")
    offset = rows[f"lateral_offset_{unit}"] - (at.lateral_offset_m if unit == "m" else at.lateral_offset_norm)
    return ErrorsOverTime(
        rows["timestamp_ns"],
        np.where(judged, wrap(rows["heading_rad"] - at.heading_rad), np.nan),
        np.where(judged & (truth.offset in (unit, "both")), offset, np.nan),
    )


def _turn_oppositely(table: Table, truth: Truth) -> bool:
    """Whether truth and estimates turn at the same times, but in opposite directions."""
    rows = _to_first_axis(table) if truth.fixed_axis else table
    sampled = interpolate_truth(truth.corridor, rows["timestamp_ns"])
    own, true = rows["heading_rad"], sampled.heading_rad
    step = max(len(rows) // max(int((rows["timestamp_ns"][-1] - rows["timestamp_ns"][0]) // SENSE_NS), 1), 1)
    turned, truly = (np.asarray(wrap(angle[step::step] - angle[:-step:step])) for angle in (own, true))
    known = np.isfinite(turned) & np.isfinite(truly)
    if np.count_nonzero(known) < MIN_TURNS or min(turned[known].std(), truly[known].std()) < MIN_TURN_RAD:
        return False
    return bool(np.corrcoef(turned[known], truly[known])[0, 1] < -0.7)


def _compare_output(output: Output, truth: Truth, align: bool) -> ComparedOutput:
    t, own = truth.corridor.t_ns, output.causal["timestamp_ns"]
    overlap_s = (min(int(t[-1]), int(own[-1])) - max(int(t[0]), int(own[0]))) / 1e9
    if overlap_s <= 0:
        spans = " and ".join(f"{s[0] / 1e9:.3f} to {s[-1] / 1e9:.3f} s" for s in (own, t))
        apart_s = (int(own[0]) - int(t[0])) / 1e9
        raise InputError(
            f"estimates and truth have no time in common: {spans}",
            file=output.folder,
            remedy=f"if both began together, add --truth-shift {apart_s:.3f}; 37 s lie between TAI and UTC",
        )
    return ComparedOutput(
        name=output.name,
        folder=str(output.folder),
        flight=output.flight,
        method=output.method,
        overlap_s=overlap_s,
        duration_s=(int(own[-1]) - int(own[0])) / 1e9,
        causal=_compare_table(output.causal, truth, align),
        smoothed=_compare_table(output.smoothed, truth, align),
    )


def _compare_table(table: Table, truth: Truth, align: bool) -> ComparedTable:
    rows = _to_first_axis(table) if truth.fixed_axis else table
    corridor, removed = _aligned(truth.corridor, rows) if align else (truth.corridor, None)
    errors = evaluate(rows, corridor)
    corridors = {name: _without_unknown_offset(part, truth) for name, part in errors.corridors.items()}
    return ComparedTable(replace(_without_unknown_offset(errors, truth), corridors=corridors), removed)


def _without_unknown_offset(errors: Errors, truth: Truth) -> Errors:
    """Leave out offsets that the truth does not have in this unit."""
    return replace(
        errors,
        lateral_offset_m=errors.lateral_offset_m if truth.offset in ("m", "both") else None,
        lateral_offset_norm=errors.lateral_offset_norm if truth.offset in ("norm", "both") else None,
    )


def _to_first_axis(table: Table) -> Table:
    """Convert headings to the first corridor's axis; offsets are unknown beyond that corridor."""
    turned = table.copy()
    turned["heading_rad"] = wrap(table["heading_rad"] + table["corridor_turn_rad"])
    elsewhere = table["corridor_index"] != table["corridor_index"][0]
    for name in ("lateral_offset_m", "lateral_offset_norm"):
        turned[name][elsewhere] = np.nan
    return turned


def _aligned(truth: CorridorTruth, table: Table) -> tuple[CorridorTruth, dict[str, RemovedConstants]]:
    """Shift the truth by the median difference of the judged rows, per corridor."""
    at = interpolate_truth(truth, table["timestamp_ns"])
    judged = at.known & ~at.in_junction & (table["status"] == "tracking")
    heading, offset = truth.heading_rad.copy(), truth.lateral_offset_m.copy()
    removed: dict[str, RemovedConstants] = {}
    for number in np.unique(at.corridor_id[judged]):
        rows, mine = judged & (at.corridor_id == number), truth.corridor_id == number
        difference = wrap(table["heading_rad"] - at.heading_rad)[rows]
        middle = float(np.angle(np.mean(np.exp(1j * difference))))
        turn = middle + float(np.median(wrap(difference - middle)))
        heading[mine] += turn
        apart_m = (table["lateral_offset_m"] - at.lateral_offset_m)[rows]
        apart_norm = (table["lateral_offset_norm"] - at.lateral_offset_norm)[rows]
        constants = RemovedConstants(turn)
        if np.isfinite(apart_m).any():
            shift = float(np.nanmedian(apart_m))
            offset[mine] += shift
            constants = RemovedConstants(turn, lateral_offset_m=shift)
        elif np.isfinite(apart_norm).any():
            shift = float(np.nanmedian(apart_norm))
            offset[mine] += shift * (float(np.median(truth.corridor_width_m[mine])) / 2)
            constants = RemovedConstants(turn, lateral_offset_norm=shift)
        removed[str(number)] = constants
    return replace(truth, heading_rad=heading, lateral_offset_m=offset), removed
