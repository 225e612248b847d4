"""Checks of what the log carried: the gyroscope, the IMU's own yaw, holes, and what reading had to mend."""

from __future__ import annotations

from math import degrees
from typing import TYPE_CHECKING

import numpy as np

from fusion.estimator.tables import Table
from fusion.evaluation.verdict import Check, Level, Limits, level_of, not_judged, worst_of
from fusion.flight import Flight, FloatArray, TimeArray
from fusion.report.series import runs

if TYPE_CHECKING:
    from fusion.offline.fuse import FusionResult


def check_gyro_bias(result: FusionResult, flight: Flight, limits: Limits) -> Check:
    """Judge the size of the gyroscope's bias, as the smoother knows it."""
    good, bad = (degrees(v) for v in limits.gyro_bias_rad_s)
    name, limit = "Gyro bias", f"pass to {good:g}°/s, fail above {bad:g}°/s"
    bias = result.smoothed["gyro_bias_rad_s"]
    bias = bias[np.isfinite(bias)]
    if flight.imu is None or not bias.size:
        return not_judged(name, limit, "The flight has no gyroscope stream.")
    worst, change = float(np.abs(bias).max()), float(np.ptp(bias))
    level = level_of(worst, limits.gyro_bias_rad_s)
    side = "right" if bias[-1] >= 0 else "left"
    value = f"{abs(degrees(bias[-1])):.2f}°/s to the {side} at the end, changed by {degrees(change):.2f}°/s"
    if level is Level.PASS:
        return Check(name, level, value, limit, "The gyroscope's zero is where a calibrated one has it.")
    meaning = "The gyroscope turns while the vehicle does not, more than a calibrated one should."
    action = (
        "Calibrate it at rest; a scale or unit error of the log looks the same when the flight turns much."
    )
    return Check(name, level, value, limit, meaning, action)


def check_imu_yaw(result: FusionResult, flight: Flight, limits: Limits) -> Check:
    """Look for steps of the vehicle's own yaw against the corridor."""
    name, limit = "Steps of the IMU's yaw", f"warn from {degrees(limits.yaw_step_rad):g}° within 1 s"
    table = result.smoothed
    if flight.attitude is None or not np.isfinite(table["imu_yaw_offset_rad"]).any():
        return not_judged(name, limit, "The flight has no attitude stream.")
    steps = yaw_steps(table, limits.yaw_step_rad)
    if not steps:
        drift = _spread(table["imu_yaw_offset_rad"])
        meaning = "The vehicle's own yaw agrees with the corridor but for a slow drift."
        return Check(name, Level.PASS, f"None; drift {degrees(drift):.1f}°", limit, meaning)
    largest = max(abs(step) for _, step in steps)
    times = ", ".join(f"{t:.0f}" for t, _ in steps[:6]) + (" ..." if len(steps) > 6 else "")
    value = f"{len(steps)}, the largest {degrees(largest):.1f}°, at {times} s"
    meaning = (
        "The vehicle's own yaw jumped against the corridor, as it does near steel; vision held the heading."
    )
    return Check(
        name, Level.WARN, value, limit, meaning, "Do not steer by the vehicle's own yaw in this corridor."
    )


def yaw_steps(table: Table, least_rad: float) -> list[tuple[float, float]]:
    """Find steps of the IMU yaw offset: (seconds since the table's start, size in radians) of each.

    A step is a change of at least ``least_rad`` within a second, outside the filter's first two seconds.
    """
    t_s = (table["timestamp_ns"] - table["timestamp_ns"][0]) / 1e9
    offset = table["imu_yaw_offset_rad"]
    usable = np.isfinite(offset) & (table["status"] != "initialising") & (t_s >= 2.0)
    if usable.sum() < 3:
        return []
    t, unwrapped = t_s[usable], np.unwrap(offset[usable])
    grid = np.arange(t[0], t[-1], 0.1)
    sampled = np.interp(grid, t, unwrapped)
    if len(sampled) <= 10:
        return []
    change = sampled[10:] - sampled[:-10]
    found = []
    for a, b in runs(np.abs(change) >= least_rad):
        k = a + int(np.argmax(np.abs(change[a:b])))
        found.append((float(grid[k] + 0.5), float(change[k])))
    return found


def _spread(angle_rad: FloatArray) -> float:
    finite = angle_rad[np.isfinite(angle_rad)]
    return float(np.ptp(np.unwrap(finite)))


def check_rates(result: FusionResult, flight: Flight, limits: Limits) -> Check:
    """Judge how often frames and inertial samples come."""
    name = "Rates of the streams"
    limit = (
        f"frames: pass from {limits.frame_rate_hz[0]:g} Hz, fail below {limits.frame_rate_hz[1]:g}; "
        f"IMU: {limits.inertial_rate_hz[0]:g}, {limits.inertial_rate_hz[1]:g}"
    )
    rates = {word: _rate_hz(t_ns) for word, t_ns in _streams(flight)}
    if rates.get("frames") is None:
        return not_judged(name, limit, "There are not two frames.")
    value = ", ".join(f"{word} {rate:.3g} Hz" for word, rate in rates.items() if rate is not None)
    inertial = [rate for word, rate in rates.items() if word != "frames" and rate is not None]
    levels = [level_of(rates["frames"] or 0.0, limits.frame_rate_hz)]
    levels.append(level_of(max(inertial), limits.inertial_rate_hz) if inertial else Level.WARN)
    level = worst_of(*levels)
    if level is Level.PASS:
        return Check(name, level, value, limit, "Often enough for the motion of a small vehicle.")
    if not inertial:
        meaning = "Nothing inertial was logged: between frames the heading is guesswork."
        return Check(name, level, value, limit, meaning, "Log the gyroscope, or at least the attitude.")
    slow = "Frames" if levels[0] is level else "Inertial samples"
    meaning = f"{slow} come so seldom that a turn between two of them is known only roughly."
    return Check(
        name, level, value, limit, meaning, "Raise the logging rate; the IMU needs no more than 200 Hz."
    )


def _streams(flight: Flight) -> list[tuple[str, TimeArray]]:
    found: list[tuple[str, TimeArray]] = [("frames", flight.frames.t_ns)]
    found += [("IMU", flight.imu.t_ns)] if flight.imu is not None else []
    found += [("attitude", flight.attitude.t_ns)] if flight.attitude is not None else []
    return found


def _rate_hz(t_ns: TimeArray) -> float | None:
    """Nominal rate: holes do not lower the median interval."""
    return float(1e9 / np.median(np.diff(t_ns))) if len(t_ns) > 1 else None


def check_gaps(result: FusionResult, flight: Flight, limits: Limits) -> Check:
    """Judge the longest hole in any stream."""
    good, bad = limits.frame_gap_s
    name, limit = "Gaps in the log", f"pass to {good:g} s, fail above {bad:g} s"
    worst, where, count = 0.0, "", 0
    for word, t_ns in _streams(flight):
        step = np.diff(t_ns) / 1e9
        if not step.size:
            continue
        count += int(np.count_nonzero(step > max(good, 3.0 * float(np.median(step)))))
        if step.max() > worst:
            k = int(np.argmax(step))
            worst, where = float(step.max()), f"{word}, at {(t_ns[k] - flight.frames.t_ns[0]) / 1e9:.1f} s"
    level = level_of(worst, limits.frame_gap_s)
    if level is Level.PASS:
        return Check(
            name, level, f"Longest {worst:.2f} s", limit, "Every stream runs through without a hole."
        )
    meaning = f"{count} hole{'s' if count != 1 else ''} in the log left the filter without input."
    action = "Look for dropped messages: a full card, a slow link or a camera that restarts."
    return Check(name, level, f"{worst:.2f} s ({where})", limit, meaning, action)


def check_reading(result: FusionResult, flight: Flight, limits: Limits) -> Check:
    """Judge what reading the log and fusing it had to drop or mend."""
    name, limit = "Input", "pass without problems"
    problems = all_problems(result, flight)
    if not problems:
        return Check(
            name, Level.PASS, "No problems", limit, "Every row and picture of the log could be used."
        )
    value = f"{len(problems)} problem{'s' if len(problems) != 1 else ''}"
    meaning = "Parts of the log were dropped or mended on reading."
    return Check(
        name, Level.WARN, value, limit, meaning, "Read the list below and judge whether they matter."
    )


def all_problems(result: FusionResult, flight: Flight) -> tuple[str, ...]:
    """Every problem of reading and fusing, once each, in order."""
    return tuple(dict.fromkeys((*flight.problems, *result.problems)))
