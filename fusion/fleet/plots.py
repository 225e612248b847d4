"""Plots of a fleet: distribution of a quantity over the flights, and its trend with date and vehicle."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime
from itertools import groupby
from typing import Any

import matplotlib.dates
import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from fusion.fleet.quantities import Quantity
from fusion.fleet.row import FleetRow
from fusion.flight import FloatArray
from fusion.report.drawing import FAINT, FILTER, GRID, IMU_YAW, INK, RAW_YAW, REJECTED, SMOOTHED

VEHICLE_COLOURS = (FILTER, REJECTED, SMOOTHED, IMU_YAW, RAW_YAW)
_dates: Any = matplotlib.dates  # not typed
OTHERS = "other vehicles"
_EDGE_SHARE = 0.98  # of the values within the scale; those beyond are in the last bin


def day_of(row: FleetRow) -> float | None:
    """Return a flight's date as matplotlib's number of days; None if it is unknown."""
    try:
        return float(_dates.date2num(datetime.fromisoformat(row.date))) if row.date else None
    except ValueError:
        return None


def plot_distribution(ax: Axes, quantity: Quantity, values: FloatArray) -> None:
    """Draw a histogram with its median; values beyond the 98th percentile are counted in the outermost bins."""
    low, high = (
        np.quantile(values, [1 - _EDGE_SHARE, _EDGE_SHARE])
        if len(values) > 50
        else (values.min(), values.max())
    )
    if high - low < 1e-9 + 1e-6 * abs(low):
        low, high = low - 0.5 * max(abs(low), 1.0) * 0.1, high + 0.5 * max(abs(high), 1.0) * 0.1
    bins = np.linspace(low, high, min(30, max(6, round(2 * len(values) ** 0.5))) + 1)
    counts, _ = np.histogram(np.clip(values, low, high), bins)
    ax.bar(bins[:-1], counts, np.diff(bins), align="edge", color=FILTER, edgecolor="none", alpha=0.75)
    ax.axvline(float(np.median(values)), color=REJECTED, lw=1.6, label="median")
    ax.set_xlabel(quantity.unit_word, color=INK)
    ax.set_ylabel("flights", color=INK)
    _plain(ax)
    ax.xaxis.set_major_locator(MaxNLocator(5))
    ax.yaxis.set_major_locator(MaxNLocator(4, integer=True))


def plot_drift(ax: Axes, quantity: Quantity, rows: Sequence[FleetRow], vehicles: Sequence[str]) -> None:
    """Draw each flight's value over its date, a colour per vehicle, and the median of each vehicle by day.

    Parameters
    ----------
    quantity
        Quantity to draw.
    rows
        Flights; those without the value or without a date are left out.
    vehicles
        Vehicles with their own colour, from `drawn_vehicles`.
    """
    for k, vehicle in enumerate(vehicles):
        points = sorted(
            (day, value)
            for row in rows
            if (row.vehicle if row.vehicle in vehicles else OTHERS) == vehicle
            and (day := day_of(row)) is not None
            and (value := quantity.of(row)) is not None
        )
        if not points:
            continue
        colour = VEHICLE_COLOURS[k] if k < len(VEHICLE_COLOURS) else FAINT
        days, values = np.array(points).T
        ax.plot(days, values, ".", color=colour, ms=6, alpha=0.55, label=vehicle or "flights")
        medians = [(day, float(np.median([v for _, v in same]))) for day, same in _by_day(points)]
        if len(medians) > 1:
            ax.plot(*np.array(medians).T, color=colour, lw=1.4)
    ax.set_ylabel(quantity.unit_word, color=INK)
    locator = _dates.AutoDateLocator(minticks=3, maxticks=7)
    ax.xaxis.set_major_locator(locator)
    ax.xaxis.set_major_formatter(_dates.ConciseDateFormatter(locator))
    _plain(ax)


def _by_day(points: Sequence[tuple[float, float]]) -> list[tuple[float, list[tuple[float, float]]]]:
    days = [(key, list(same)) for key, same in groupby(points, key=lambda point: int(point[0]))]
    return [(float(np.mean([day for day, _ in same])), same) for _, same in days]


def drawn_vehicles(rows: Sequence[FleetRow]) -> list[str]:
    """Return the vehicles with their own colour, by number of flights, and a name for the rest."""
    count: dict[str, int] = {}
    for row in rows:
        count[row.vehicle] = count.get(row.vehicle, 0) + 1
    names = sorted(count, key=lambda name: (-count[name], name))
    shown = names[: len(VEHICLE_COLOURS)]
    return [*shown, OTHERS] if len(names) > len(shown) else shown


def _plain(ax: Axes) -> None:
    ax.grid(True, color=GRID, lw=0.6)
    ax.set_axisbelow(True)
    ax.tick_params(colors=FAINT, labelcolor=INK, length=0)
    for side in ("top", "right", "left"):
        ax.spines[side].set_visible(False)
    ax.spines["bottom"].set_color(GRID)
