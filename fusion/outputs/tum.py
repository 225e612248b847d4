"""Estimates as a trajectory in TUM's format, for evo: ``timestamp_s x y z qx qy qz qw``."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from fusion.estimator.tables import Table
from fusion.flight import FloatArray, VectorStream
from fusion.result.conventions import Frame


def write_tum(
    table: Table, path: Path, frame: Frame, facts: Mapping[str, str], velocity: VectorStream | None
) -> None:
    """Write the rows with a known heading and, if the flight has any offsets, a known offset.

    Yaw is the heading, y the lateral offset, both of the corridor being flown; z is zero. x is the distance
    along the corridor if the log has a forward speed, else zero. A comment in the file's first lines states this.

    Parameters
    ----------
    table
        Rows of `fusion.estimator.tables.ESTIMATE_DTYPE`, in FRD.
    path
        The file.
    frame
        Sign convention of the file.
    facts
        Metadata of the file.
    velocity
        Body FRD; None if the log has none.
    """
    sign = -1.0 if frame is Frame.ROS else 1.0
    y, unit_y, what_y = _aside(table)
    keep = np.isfinite(table["heading_rad"]) & np.isfinite(y)
    x, what_x = _along(table, velocity)
    half = sign * table["heading_rad"][keep] / 2
    side = "left" if frame is Frame.ROS else "right"
    lines = [
        *(f"# {name}: {facts[name]}" for name in ("flight", "software", "software_version", "frame")),
        f"# offset_unit: {unit_y}",
        f"# {facts['conventions']}",
        f"# x: {what_x}. y: {what_y}, positive {side}. z: not known, 0.",
        "# rotation: yaw only, the heading from the axis of the corridor being flown; roll and pitch are left out.",
        f"# {keep.sum()} of {len(table)} rows: those before heading and offset are known are left out.",
        "# timestamp_s x y z qx qy qz qw",
    ]
    rows = zip(
        table["timestamp_ns"][keep].tolist(),
        x[keep].tolist(),
        (sign * y[keep] + 0.0).tolist(),
        np.sin(half).tolist(),
        np.cos(half).tolist(),
        strict=True,
    )
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.write("\n".join(lines) + "\n")
        file.writelines(
            f"{_seconds(t_ns)} {px:.9g} {py:.9g} 0 0 0 {qz:.12g} {qw:.12g}\n" for t_ns, px, py, qz, qw in rows
        )


def _seconds(t_ns: int) -> str:
    """Seconds with all digits of the nanoseconds, which a float64 of Unix time would lose."""
    whole, rest = divmod(abs(t_ns), 1_000_000_000)
    return f"{'-' if t_ns < 0 else ''}{whole}.{rest:09d}"


def _aside(table: Table) -> tuple[FloatArray, str, str]:
    for name, unit, words in (
        ("lateral_offset_m", "m", "lateral offset from the centre line, m"),
        (
            "lateral_offset_norm",
            "half widths",
            "lateral offset over half the corridor's width, which is not known",
        ),
    ):
        if np.isfinite(table[name]).any():
            return table[name], unit, words
    return np.zeros(len(table)), "none", "lateral offset, never known in this flight, 0"


def _along(table: Table, velocity: VectorStream | None) -> tuple[FloatArray, str]:
    if velocity is None or not len(velocity.t_ns) or not len(table):
        return np.zeros(len(table)), "not known, 0 (the log has no forward speed)"
    t = table["timestamp_ns"]
    t_s = (t - t[0]) / 1e9
    at_s = (velocity.t_ns - t[0]) / 1e9
    u, v = (np.interp(t_s, at_s, velocity.xyz[:, k], left=0.0, right=0.0) for k in (0, 1))
    psi = table["heading_rad"]
    speed = np.nan_to_num(u * np.cos(psi) - v * np.sin(psi))
    way = np.concatenate(([0.0], np.cumsum((speed[1:] + speed[:-1]) / 2 * np.diff(t_s))))
    return (
        way,
        "way along the corridors, m, from the first row: the log's velocity turned by the heading",
    )
