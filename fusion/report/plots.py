"""Plots of a fused flight, each drawn into the caller's ``Axes``, for the report and notebooks.

Time is seconds since `FusionResult.origin_ns`; angles are drawn in degrees, positive right. Series are thinned to
their extremes, so that a long flight is drawn as fast as a short one. No global state of matplotlib is changed.
"""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import NullLocator

from fusion.estimator.smoothed_table import half_widths_m
from fusion.estimator.tables import Table
from fusion.evaluation.errors import TruthAt, interpolate_truth
from fusion.flight import AttitudeStream, CorridorTruth, Flight, FloatArray, TimeArray
from fusion.report.drawing import (
    FAINT,
    FILTER,
    HYPOTHESIS,
    IMU_YAW,
    INK,
    NO_CUTS,
    RAW_YAW,
    REJECTED,
    SMOOTHED,
    STATUS_COLOUR,
    VISION,
    draw_band,
    draw_dots,
    draw_line,
    mark_beyond,
    plain_axes,
    widen_y_axis,
)
from fusion.report.series import IndexArray, thin_points
from fusion.result.result import FusionResult
from fusion.result.table_rows import runs
from vision.rotations import wrap, yaw_of

_RATIO_SHOWN = (2.2e-4, 6e1)  # values beyond are drawn at the edge of the axis


def seconds(t_ns: TimeArray, origin_ns: int) -> FloatArray:
    """Seconds (n,) since the origin, exact to the nanosecond."""
    return np.asarray((np.asarray(t_ns, dtype=np.int64) - origin_ns) / 1e9, dtype=np.float64)


def plot_heading(ax: Axes, result: FusionResult, flight: Flight) -> None:
    """Draw the heading with its two-sigma band, over the headings of the frames and the IMU's yaw."""
    origin, table = result.origin_ns, result.estimates
    t, heading = seconds(table["timestamp_ns"], origin), np.degrees(table["heading_rad"])
    cuts = _cuts(table, heading)
    draw_band(ax, t, heading, 2 * np.degrees(table["heading_std_rad"]), cuts, FILTER, "two sigma")
    if flight.attitude is not None:
        _plot_imu_yaw(ax, flight.attitude, table, origin)
    frames = result.frames
    _plot_frames(ax, seconds(frames["timestamp_ns"], origin), np.degrees(frames["heading_rad"]), frames)
    if flight.truth is not None:
        _plot_truth(ax, flight.truth, np.degrees(flight.truth.heading_rad), origin)
    draw_line(ax, t, heading, cuts, FILTER, 1.5, "filter")
    _decorate(ax, result, "Heading, degrees right")
    _limit(ax, table, heading, 2 * np.degrees(table["heading_std_rad"]), least=2.0)
    if flight.attitude is not None:
        widen_y_axis(ax, np.degrees(aligned_imu_yaw(flight.attitude, table)[1]))
    mark_beyond(ax, t, heading)


def plot_offset(ax: Axes, result: FusionResult, flight: Flight) -> None:
    """Draw the lateral offset with its two-sigma band, in metres if the corridor's width is known."""
    origin, table, frames = result.origin_ns, result.estimates, result.frames
    metres = bool(np.isfinite(table["lateral_offset_m"]).any())
    unit = "m" if metres else "norm"
    std = table["lateral_offset_std_m" if metres else "lateral_offset_norm_std"]
    t, offset = seconds(table["timestamp_ns"], origin), table[f"lateral_offset_{unit}"]
    cuts = _cuts(table, np.zeros_like(offset))
    draw_band(ax, t, offset, 2 * std, cuts, FILTER, "two sigma")
    half = half_widths_m(table, result.config) if metres else np.ones(len(table))
    _plot_hypotheses(ax, result.offset_hypotheses, table, half, origin)
    row = np.clip(np.searchsorted(table["timestamp_ns"], frames["timestamp_ns"], side="right") - 1, 0, None)
    seen = half[row] * frames["lateral_offset_norm"]
    _plot_frames(ax, seconds(frames["timestamp_ns"], origin), seen, frames)
    if flight.truth is not None:
        with np.errstate(divide="ignore", invalid="ignore"):
            scale = 1.0 if metres else 2.0 / flight.truth.corridor_width_m
        _plot_truth(ax, flight.truth, flight.truth.lateral_offset_m * scale, origin)
    smooth = result.smoothed
    t_smooth = seconds(smooth["timestamp_ns"], origin)
    smooth_offset = smooth[f"lateral_offset_{unit}"]
    draw_line(ax, t_smooth, smooth_offset, _cuts(smooth, np.zeros(len(smooth))), SMOOTHED, 1.1, "smoother")
    draw_line(ax, t, offset, cuts, FILTER, 1.5, "filter")
    _decorate(ax, result, "Offset, m right" if metres else "Offset, half widths right")
    _limit(ax, table, offset, 2 * std, least=0.1)
    _walls(ax, t, half)
    mark_beyond(ax, t, offset)


def plot_innovations(ax: Axes, result: FusionResult) -> None:
    """Draw each frame's innovation, with its gate."""
    frames = result.frames
    t, innovation = (
        seconds(frames["timestamp_ns"], result.origin_ns),
        np.degrees(frames["innovation_rad"]),
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        gate = np.abs(innovation) / np.sqrt(frames["test_ratio"])
    gate[~np.isfinite(gate)] = np.nan
    known = np.isfinite(gate)
    top = 1.6 * float(np.percentile(gate[known], 95)) if known.any() else np.inf
    draw_band(ax, t[known], np.zeros(known.sum()), gate[known], NO_CUTS, FAINT, "gate")
    ax.axhline(0.0, color=FAINT, lw=0.6, zorder=1)
    if known.any():
        ax.set_ylim(-top, top)
    _plot_frames(ax, t, np.clip(innovation, -0.95 * top, 0.95 * top), frames)  # NaN stays
    _decorate(ax, result, "Innovation, degrees")


def plot_test_ratio(ax: Axes, result: FusionResult) -> None:
    """Draw each frame's test ratio, innovation squared over gate squared; above 1 the frame is rejected."""
    frames = result.frames
    t = seconds(frames["timestamp_ns"], result.origin_ns)
    ax.set_yscale("log")
    ax.set_ylim(1e-4, 1e2)
    ax.yaxis.set_minor_locator(NullLocator())
    ax.axhline(1.0, color=REJECTED, lw=0.9, zorder=1, label="limit of the test ratio")
    _plot_frames(ax, t, np.clip(frames["test_ratio"], *_RATIO_SHOWN), frames)
    _decorate(ax, result, "Test ratio")


def plot_gyro_bias(ax: Axes, result: FusionResult) -> None:
    """Draw the gyroscope's bias about the vertical, by filter and smoother."""
    _plot_state(ax, result, "gyro_bias_rad_s", "Gyro bias, degrees/s")


def plot_imu_yaw_offset(ax: Axes, result: FusionResult) -> None:
    """Draw the offset of the IMU's yaw from the first corridor's axis; steps are disturbances."""
    _plot_state(ax, result, "imu_yaw_offset_rad", "IMU yaw offset, degrees")


def plot_heading_error(ax: Axes, result: FusionResult, truth: CorridorTruth) -> None:
    """Draw heading less truth for filter and smoother, with the filter's two-sigma band about zero."""
    _plot_error(ax, result, truth, "heading_rad", "heading_std_rad", "Heading error, degrees")


def plot_offset_error(ax: Axes, result: FusionResult, truth: CorridorTruth) -> None:
    """Draw lateral offset less truth for filter and smoother, in centimetres or percent of half the width."""
    if np.isfinite(result.estimates["lateral_offset_m"]).any():
        names, label = ("lateral_offset_m", "lateral_offset_std_m"), "Offset error, cm"
    else:
        names, label = ("lateral_offset_norm", "lateral_offset_norm_std"), "Offset error, % of half width"
    _plot_error(ax, result, truth, *names, label)


def aligned_imu_yaw(attitude: AttitudeStream, table: Table) -> tuple[FloatArray, FloatArray]:
    """Convert the IMU's yaw (n,), at its own times, to the present corridor's axis in two ways.

    Returns
    -------
    tuple
        Yaw less the filter's offset at that time, and yaw less the constant that fits the first second of tracking;
        both in radians, less the turn between corridors, NaN outside the table.
    """
    yaw = yaw_of(attitude.q_world_body)
    t = attitude.t_ns
    row = np.clip(np.searchsorted(table["timestamp_ns"], t, side="right") - 1, 0, len(table) - 1)
    inside = (t >= table["timestamp_ns"][0]) & (t <= table["timestamp_ns"][-1])
    turned = yaw - table["corridor_turn_rad"][row]
    aligned = np.where(inside, wrap(turned - table["imu_yaw_offset_rad"][row]), np.nan)
    difference = wrap(turned - table["heading_rad"][row])
    tracking = inside & (table["status"][row] == "tracking") & np.isfinite(difference)
    if not tracking.any():
        return aligned, np.full(len(yaw), np.nan)
    first = tracking & (t <= t[tracking][0] + 1_000_000_000)
    start = np.angle(np.mean(np.exp(1j * difference[first])))
    return aligned, np.where(inside, wrap(turned - start), np.nan)


def mark_status(ax: Axes, result: FusionResult) -> None:
    """Colour the bottom of the axes by status, and draw a vertical line where a new corridor begins."""
    table = result.estimates
    t = seconds(table["timestamp_ns"], result.origin_ns)
    for status, colour in STATUS_COLOUR.items():
        spans = [(t[a], t[min(b, len(t) - 1)] - t[a]) for a, b in runs(table["status"] == status)]
        if spans:
            place = ax.get_xaxis_transform()
            ax.broken_barh(spans, (0.0, 0.028), facecolor=colour, lw=0, transform=place, zorder=4)
    for k in np.flatnonzero(np.diff(table["corridor_index"])) + 1:
        ax.axvline(t[k], color=INK, lw=0.9, ls=(0, (1, 2)), zorder=2)


def _plot_imu_yaw(ax: Axes, attitude: AttitudeStream, table: Table, origin_ns: int) -> None:
    aligned, raw = aligned_imu_yaw(attitude, table)
    t = seconds(attitude.t_ns, origin_ns)
    row = np.clip(np.searchsorted(table["timestamp_ns"], attitude.t_ns, side="right") - 1, 0, len(table) - 1)
    switches = np.flatnonzero(np.diff(table["corridor_index"][row])) + 1
    for yaw, colour, label in (
        (raw, RAW_YAW, "IMU yaw less a constant"),
        (aligned, IMU_YAW, "IMU yaw less its offset"),
    ):
        degrees = np.degrees(yaw)
        draw_line(ax, t, degrees, np.union1d(switches, _wraps(degrees)), colour, 1.0, label)


def _plot_state(ax: Axes, result: FusionResult, name: str, label: str) -> None:
    for table, colour, width, word in (
        (result.smoothed, SMOOTHED, 1.1, "smoother"),
        (result.estimates, FILTER, 1.5, "filter"),
    ):
        values = np.degrees(table[name])
        t = seconds(table["timestamp_ns"], result.origin_ns)
        draw_line(ax, t, values, _wraps(values), colour, width, word)
    _decorate(ax, result, label)


def _plot_error(
    ax: Axes, result: FusionResult, truth: CorridorTruth, name: str, std_name: str, label: str
) -> None:
    scale = 180 / np.pi if name == "heading_rad" else 100.0
    origin, everything = result.origin_ns, []
    for table, colour, width, word in (
        (result.smoothed, SMOOTHED, 1.1, "smoother"),
        (result.estimates, FILTER, 1.3, "filter"),
    ):
        at = interpolate_truth(truth, table["timestamp_ns"])
        error = table[name] - _truth_of(at, name)
        error = (wrap(error) if name == "heading_rad" else error) * scale
        error[at.in_junction] = np.nan
        t = seconds(table["timestamp_ns"], origin)
        if word == "filter":
            band = 2 * scale * table[std_name]
            draw_band(ax, t, np.zeros_like(t), band, NO_CUTS, FILTER, "two sigma")
        draw_line(ax, t, error, NO_CUTS, colour, width, word)
        tracked = table["status"] == "tracking"
        everything.append(np.abs(error[tracked]))
    ax.axhline(0.0, color=FAINT, lw=0.6, zorder=1)
    worst = np.concatenate(everything)
    worst = worst[np.isfinite(worst)]
    if worst.size:
        top = 1.25 * float(worst.max())
        usual = band[tracked & np.isfinite(band)]
        if usual.size:  # show its edges, unless that would flatten the lines
            top = max(top, min(1.25 * float(np.median(usual)), 5.0 * top))
        ax.set_ylim(-top, top)
        mark_beyond(ax, t, error)
    _decorate(ax, result, label)


def _truth_of(at: TruthAt, name: str) -> FloatArray:
    """Return the truth of a column of the estimates."""
    columns = {
        "heading_rad": at.heading_rad,
        "lateral_offset_m": at.lateral_offset_m,
        "lateral_offset_norm": at.lateral_offset_norm,
    }
    return columns[name]


def _plot_truth(ax: Axes, truth: CorridorTruth, values: FloatArray, origin_ns: int) -> None:
    t = seconds(truth.t_ns, origin_ns)
    cuts = np.flatnonzero(np.diff(truth.corridor_id)) + 1
    draw_line(ax, t, values, np.union1d(cuts, _wraps(values)), INK, 0.9, "truth", style=(0, (4, 2)))


def _plot_hypotheses(ax: Axes, hypotheses: Table, table: Table, half: FloatArray, origin_ns: int) -> None:
    """Draw the filter's other hypotheses of the offset."""
    some = hypotheses[hypotheses["probability"] < 0.9]
    row = np.clip(np.searchsorted(table["timestamp_ns"], some["timestamp_ns"], side="right") - 1, 0, None)
    y = some["lateral_offset_norm"] * half[row]
    x, y = thin_points(seconds(some["timestamp_ns"], origin_ns), y, limit=1500)
    draw_dots(ax, x, y, HYPOTHESIS, "other hypotheses")


def _plot_frames(ax: Axes, t: FloatArray, values: FloatArray, frames: Table) -> None:
    """Draw accepted frames as dots and rejected ones as crosses."""
    used = frames["accepted"]
    draw_dots(ax, *thin_points(t[used], values[used]), VISION, "frame used")
    x, y = thin_points(t[~used], values[~used], limit=800)
    if len(x):
        ax.plot(x, y, "x", color=REJECTED, ms=4.2, mew=0.9, ls="none", label="frame rejected", zorder=3)


def _cuts(table: Table, degrees: FloatArray) -> IndexArray:
    changes = np.flatnonzero(np.diff(table["corridor_index"])) + 1
    return np.asarray(np.union1d(changes, _wraps(degrees)), dtype=np.int64)


def _wraps(degrees: FloatArray) -> IndexArray:
    return np.asarray(np.flatnonzero(np.abs(np.diff(degrees)) > 180.0) + 1, dtype=np.int64)


def _limit(ax: Axes, table: Table, values: FloatArray, half: FloatArray, *, least: float) -> None:
    """Fit the y axis to the estimates while tracking and coasting; ignore a wide start and outliers."""
    rows = (table["status"] == "tracking") & np.isfinite(values + half)
    if not rows.any():
        return
    line = values[rows | ((table["status"] == "coasting") & np.isfinite(values))]
    low = min(np.percentile(values[rows] - half[rows], 0.5), line.min())
    high = max(np.percentile(values[rows] + half[rows], 99.5), line.max())
    margin = 0.12 * max(high - low, least)
    ax.set_ylim(low - 1.3 * margin, high + margin)


def _walls(ax: Axes, t: FloatArray, half: FloatArray) -> None:
    """Limit the axis to slightly beyond the widest corridor's walls, and draw each corridor's walls."""
    low, high = ax.get_ylim()
    known = half[half > 0]  # excludes NaN, too
    if not known.size:
        return
    widest = float(known.max())
    low, high = max(low, -1.15 * widest), min(high, 1.15 * widest)
    ax.set_ylim(low, high)
    several = np.ptp(known) > 1e-6
    for side in (-1.0, 1.0):
        if several:
            cuts = np.flatnonzero(np.abs(np.diff(half)) > 1e-6) + 1
            draw_line(ax, t, side * half, cuts, INK, 1.8, "wall")
        elif low < side * widest < high:
            ax.axhline(side * widest, color=INK, lw=1.8, zorder=2, label="wall")


def _decorate(ax: Axes, result: FusionResult, label: str) -> None:
    mark_status(ax, result)
    plain_axes(ax, "Time, s", label)
    table = result.estimates
    if len(table) > 1:
        end = seconds(table["timestamp_ns"][-1:], result.origin_ns)[0]
        ax.set_xlim(-0.005 * end, 1.005 * end)
