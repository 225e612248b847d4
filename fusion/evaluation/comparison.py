"""Outputs of fused flights against a truth, side by side: what ``corridor evaluate`` computes."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fusion.estimator.tables import ESTIMATE_DTYPE, Table
from fusion.evaluation.errors import evaluate, interpolate_truth, wrap_angle
from fusion.evaluation.truth_file import Truth
from fusion.flight import CorridorTruth
from fusion.outputs.folder import read_table
from fusion.result.conventions import Frame, table_in_frame
from vision.errors import InputError

TABLES = {"causal": "estimates.csv", "smoothed": "smoothed.csv"}


@dataclass(frozen=True, slots=True, eq=False)
class Output:
    """An output folder as `fusion.outputs.folder.write_outputs` made it: tables in FRD, and the summary."""

    folder: Path
    name: str
    tables: dict[str, Table]
    summary: dict[str, Any]


def read_outputs(folders: Sequence[str | Path]) -> list[Output]:
    """Read output folders; each is named by as much of its path as tells it from the others.

    Raises
    ------
    InputError
        Where one is no output folder, or its tables are torn or hold nothing.
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
        raise InputError(f"holds no {missing[0]}", file=folder, remedy=remedy)
    try:
        summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
        frame = Frame(summary.get("frame", Frame.FRD))
    except (OSError, ValueError, AttributeError) as error:
        problem = "is not the summary of a fused flight"
        raise InputError(problem, file=folder / "summary.json", remedy=remedy) from error
    tables = {}
    for kind, file in TABLES.items():
        table = read_table(folder / file, ESTIMATE_DTYPE)
        if not len(table):
            raise InputError("holds no rows", file=folder / file, remedy="the flight had nothing to fuse")
        tables[kind] = table_in_frame(table, frame)  # turning twice leaves what was
    return Output(folder, name, tables, summary)


def compare(outputs: Sequence[Output], truth: Truth, *, align: bool = False) -> dict[str, Any]:
    """Compare outputs with a truth.

    Parameters
    ----------
    outputs
        From `read_outputs`.
    truth
        From `fusion.evaluation.truth_file.read_truth`.
    align
        Take the constant between estimate and truth out of heading and offset, per corridor of the truth: for a
        truth whose zero is not the corridor's axis and centre line. The constants are told.

    Returns
    -------
    dict
        Plain values, ready for JSON: ``truth`` (``source``, ``rows``, ``first_ns``, ``last_ns``, ``fixed_axis``,
        ``problems``) and ``outputs``, each with ``name``, ``folder``, ``flight``, ``method``, ``overlap_s`` and,
        under ``causal`` and ``smoothed``, what `fusion.evaluation.errors.evaluate` returns and ``removed``, the
        constants by corridor (None where not aligned).

    Raises
    ------
    InputError
        Where an output and the truth have no time in common.
    """
    t = truth.corridor.t_ns
    return {
        "truth": {
            "source": truth.source,
            "rows": len(t),
            "first_ns": int(t[0]),
            "last_ns": int(t[-1]),
            "fixed_axis": truth.fixed_axis,
            "aligned": align,
            "problems": list(truth.problems),
        },
        "outputs": [_compare_one(output, truth, align) for output in outputs],
    }


def _compare_one(output: Output, truth: Truth, align: bool) -> dict[str, Any]:
    t, own = truth.corridor.t_ns, output.tables["causal"]["timestamp_ns"]
    overlap_s = (min(int(t[-1]), int(own[-1])) - max(int(t[0]), int(own[0]))) / 1e9
    if overlap_s <= 0:
        spans = " and ".join(f"{s[0] / 1e9:.3f} to {s[-1] / 1e9:.3f} s" for s in (own, t))
        raise InputError(
            f"estimates and truth have no time in common: {spans}",
            file=output.folder,
            remedy="is it the same flight, and the same clock?",
        )
    found: dict[str, Any] = {
        "name": output.name,
        "folder": str(output.folder),
        "flight": output.summary.get("flight"),
        "method": output.summary.get("method"),
        "overlap_s": overlap_s,
        "duration_s": (int(own[-1]) - int(own[0])) / 1e9,
    }
    for kind, table in output.tables.items():
        rows = _to_first_axis(table) if truth.fixed_axis else table
        corridor, removed = _aligned(truth.corridor, rows) if align else (truth.corridor, None)
        errors = evaluate(rows, corridor)
        for part in (errors, *errors["corridors"].values()):
            for unit in ("m", "norm"):
                if truth.offset not in (unit, "both"):
                    part.pop(f"lateral_offset_{unit}", None)
        found[kind] = errors | {"removed": removed}
    return found


def _to_first_axis(table: Table) -> Table:
    """Refer headings to the first corridor's axis; beyond that corridor its centre line says nothing."""
    turned = table.copy()
    turned["heading_rad"] = wrap_angle(table["heading_rad"] + table["corridor_turn_rad"])
    elsewhere = table["corridor_index"] != table["corridor_index"][0]
    for name in ("lateral_offset_m", "lateral_offset_norm"):
        turned[name][elsewhere] = np.nan
    return turned


def _aligned(truth: CorridorTruth, table: Table) -> tuple[CorridorTruth, dict[str, Any]]:
    """Shift the truth by the median difference of the rows that are judged, corridor by corridor."""
    at = interpolate_truth(truth, table["timestamp_ns"])
    judged = at.known & ~at.in_junction & (table["status"] == "tracking")
    heading, offset = truth.heading_rad.copy(), truth.lateral_offset_m.copy()
    removed: dict[str, Any] = {}
    for number in np.unique(at.corridor_id[judged]):
        rows, mine = judged & (at.corridor_id == number), truth.corridor_id == number
        difference = wrap_angle(table["heading_rad"] - at.heading_rad)[rows]
        middle = float(np.angle(np.mean(np.exp(1j * difference))))
        turn = middle + float(np.median(wrap_angle(difference - middle)))
        heading[mine] += turn
        removed[str(number)] = {"heading_rad": turn}
        for name, values in (
            ("lateral_offset_m", at.lateral_offset_m),
            ("lateral_offset_norm", at.lateral_offset_norm),
        ):
            apart = (table[name] - values)[rows]
            if np.isfinite(apart).any():
                shift = float(np.nanmedian(apart))
                scale = 1.0 if name.endswith("_m") else float(np.median(truth.corridor_width_m[mine])) / 2
                offset[mine] += shift * scale
                removed[str(number)][name] = shift
                break
    return (
        CorridorTruth(
            truth.t_ns,
            heading,
            offset,
            truth.corridor_width_m,
            truth.corridor_id,
            truth.in_junction,
        ),
        removed,
    )
