"""Quantities for the comparison of flights: displayed names and units, and the better direction."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from math import degrees

import numpy as np

from fusion.fleet.row import FleetRow
from fusion.flight import FloatArray

_DEGREES = degrees(1.0)


@dataclass(frozen=True, slots=True)
class Quantity:
    """A column of the fleet's table as displayed.

    Parameters
    ----------
    column
        In `fusion.fleet.row.FleetRow`.
    title, short
        Name, and short name for a table's header.
    factor, unit, decimals
        Factor from the column's unit to the displayed one, and its decimals.
    sign
        1 if more is better, -1 if less is, 0 if neither.
    least
        Smallest reported change, in the displayed unit.
    """

    column: str
    title: str
    short: str
    factor: float
    unit: str
    decimals: int
    sign: int = 0
    least: float = 0.0

    @property
    def unit_word(self) -> str:
        """The unit for an axis label."""
        return "degrees" if self.unit == "°" else self.unit

    def of(self, row: FleetRow) -> float | None:
        """Return a flight's value in the displayed unit; None if it is unknown."""
        value = getattr(row, self.column)
        return None if value is None else self.factor * float(value)

    def values(self, rows: Iterable[FleetRow]) -> FloatArray:
        """Return the known values (n,)."""
        return np.array([value for row in rows if (value := self.of(row)) is not None])

    def text(self, value: float | None) -> str:
        """Return a value with its unit."""
        if value is None:
            return ""
        space = "" if self.unit in ("", "°", "°/s") else " "
        return f"{value:.{self.decimals}f}{space}{self.unit}"


#: In the order of the page.
QUANTITIES = (
    Quantity("heading_rmse_rad", "Heading error, RMSE", "Heading error", _DEGREES, "°", 2, -1, 0.02),
    Quantity(
        "lateral_offset_rmse_norm",
        "Offset error, RMSE, of half the width",
        "Offset error",
        100.0,
        "%",
        1,
        -1,
        0.5,
    ),
    Quantity(
        "heading_error_over_sigma_p90",
        "Heading error over sigma, 90th percentile",
        "Error over sigma",
        1.0,
        "",
        2,
        -1,
        0.2,
    ),
    Quantity("frames_used_share", "Frames used", "Frames used", 100.0, "%", 1, 1, 2.0),
    Quantity("tracking_share", "Time tracking", "Tracking", 100.0, "%", 1, 1, 1.0),
    Quantity(
        "longest_without_frame_s", "Longest time without a used frame", "Without frame", 1.0, "s", 1, -1, 0.5
    ),
    Quantity("offset_known_share", "Offset known while tracking", "Offset known", 100.0, "%", 0, 1, 5.0),
    Quantity("heading_std_rad", "Heading sigma, median", "Heading sigma", _DEGREES, "°", 2),
    Quantity("innovation_ratio", "Innovations over their sigma, median", "Innovations", 1.0, "", 2),
    Quantity("gyro_bias_rad_s", "Gyroscope bias at the end", "Gyro bias", _DEGREES, "°/s", 2),
    Quantity("camera_late_s", "Camera's stamps late by", "Camera late", 1000.0, "ms", 1),
    Quantity("gyro_noise_rad_s_sqrt_hz", "Gyroscope noise in flight", "Gyro noise", _DEGREES, "°/s/√Hz", 3),
    Quantity("vision_ms_median", "Time to measure a frame, median", "Frame time", 1.0, "ms", 1),
    Quantity("times_real_time", "Times as fast as real time", "Real time", 1.0, "", 1),
)


def worst_first_key(row: FleetRow) -> tuple[float, ...]:
    """Return the sort key for the worst first: verdict, failing checks, warnings, error or sigma of the heading."""
    heading = row.heading_rmse_rad if row.heading_rmse_rad is not None else row.heading_std_rad
    return (
        rank(row.verdict),
        -(row.failing_checks or 0),
        -(row.warning_checks or 0),
        -(heading or 0.0),
    )


_RANKS: Callable[[str], int] = ("error", "unusable", "fail", "warn", "not_judged", "pass").index


def rank(verdict: str) -> int:
    """Return the place of a verdict from the worst, 0, to the best."""
    return _RANKS(verdict)
