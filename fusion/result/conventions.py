"""Meaning, unit and frame of each column, and the conversion of a table to ROS's conventions.

Internally and by default everything is FRD: heading, turns and offsets are positive to the right. ROS (REP 103)
has bodies in FLU and worlds in ENU, so the same numbers are positive to the left, counter-clockwise seen from
above. The names are the same; a file's metadata and ``summary.json`` name the convention.
"""

from __future__ import annotations

from collections.abc import Mapping
from copy import deepcopy
from enum import StrEnum
from importlib.metadata import version
from typing import Any

from fusion.estimator.tables import ESTIMATE_COLUMNS, FRAME_COLUMNS, Column, Table


class Frame(StrEnum):
    """Sign convention of written files."""

    FRD = "frd"
    ROS = "ros"


COLUMNS: Mapping[str, Column] = {c.name: c for c in (*ESTIMATE_COLUMNS, *FRAME_COLUMNS)}

_SIDE = {Frame.FRD: "right (clockwise from above)", Frame.ROS: "left (counter-clockwise from above)"}
_CONVENTIONS = {
    Frame.FRD: "Body FRD (x forward, y right, z down), world z down. Angles, rates and offsets count positive right.",
    Frame.ROS: "ROS, REP 103: body FLU (x forward, y left, z up), world z up. Angles, rates and offsets count "
    "positive left; column names are those of FRD.",
}


def column_metadata(name: str, frame: Frame) -> dict[str, str]:
    """Return unit, frame and description of a column, empty ones left out."""
    column = COLUMNS[name]
    found = {
        "unit": column.unit,
        "frame": column.frame,
        "description": column.meaning.format(side=_SIDE[frame]),
    }
    return {key: text for key, text in found.items() if text}


def file_facts(summary: Mapping[str, Any], frame: Frame) -> dict[str, str]:
    """Return the metadata of every exported file: conventions, software, flight, method."""
    return {
        "frame": str(frame),
        "conventions": _CONVENTIONS[frame] + " SI units and radians; integer nanoseconds of the log's clock. "
        "Unknown numbers are missing values.",
        "software": "corridor-fusion",
        "software_version": version("corridor-fusion"),
        "flight": str(summary.get("flight", "")),
        "method": str(summary.get("method", "")),
    }


def table_in_frame(table: Table, frame: Frame) -> Table:
    """Convert a table between FRD and ROS's conventions, in either direction; the same table if nothing changes.

    Parameters
    ----------
    table
        Rows of `fusion.estimator.tables.ESTIMATE_DTYPE` or `fusion.estimator.tables.FRAME_DTYPE`.
    frame
        `Frame.FRD` keeps the signs, `Frame.ROS` reverses them.
    """
    if frame is Frame.FRD:
        return table
    turned = table.copy()
    for name in turned.dtype.names or ():
        if COLUMNS[name].flips:
            turned[name] = 0.0 - turned[name]  # not negated: avoids -0 in the files
    return turned


def summary_in_frame(summary: Mapping[str, Any], frame: Frame) -> dict[str, Any]:
    """Name the frame in a summary, and reverse its signed values: turns of corridors, mean errors."""
    found: dict[str, Any] = deepcopy(dict(summary)) | {"frame": str(frame)}
    if frame is Frame.ROS:
        for corridor in found.get("corridors") or ():
            corridor["turn_rad"] = 0.0 - corridor["turn_rad"]
        _turn_biases(found.get("errors"))
    return found


def _turn_biases(errors: Any) -> None:
    if not isinstance(errors, dict):
        return
    for name, value in errors.items():
        if name.startswith("bias_") and value is not None:
            errors[name] = 0.0 - value
        else:
            _turn_biases(value)
