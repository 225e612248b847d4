"""Checks of the log: the gyroscope, the IMU's own yaw, gaps, and repairs on reading."""

from __future__ import annotations

from math import degrees

import numpy as np

from fusion.estimator.tables import Table
from fusion.evaluation.verdict import CheckRule, Finding, Limits, level_of, nothing_to_judge, worst_of
from fusion.flight import Flight, FloatArray, Remark, TimeArray
from fusion.logs.samples import counted
from fusion.result.result import FusionResult
from fusion.result.summary import Level
from fusion.result.table_rows import runs


def _gyro_bias(result: FusionResult, flight: Flight, limits: Limits) -> Finding:
    """Size of the bias, by the smoother."""
    bias = result.smoothed["gyro_bias_rad_s"]
    bias = bias[np.isfinite(bias)]
    if flight.imu is None or not bias.size:
        return nothing_to_judge("The flight has no gyroscope stream.")
    worst, change = float(np.abs(bias).max()), float(np.ptp(bias))
    side = "right" if bias[-1] >= 0 else "left"
    text = f"{abs(degrees(bias[-1])):.2f}°/s to the {side} at the end, changed by {degrees(change):.2f}°/s"
    return Finding(text, worst)


def _gyro_bias_limit(limits: Limits) -> str:
    good, bad = (degrees(v) for v in limits.gyro_bias_rad_s)
    return f"pass to {good:g}°/s, fail above {bad:g}°/s"


GYRO_BIAS = CheckRule(
    name="Gyro bias",
    measure=_gyro_bias,
    pass_fail=lambda limits: limits.gyro_bias_rad_s,
    limit=_gyro_bias_limit,
    good="The bias is that of a calibrated gyroscope.",
    bad="The bias is larger than that of a calibrated gyroscope.",
    remedy="Calibrate the gyroscope at rest. In a flight with many turns, a wrong scale or unit has the same effect.",
)


_FOLLOWS_YAW = (
    "The vehicle's yaw jumped relative to the corridor, as it does near steel. Without a gyroscope, the estimated "
    "heading follows it until pictures correct it."
)


def _imu_yaw_steps(result: FusionResult, flight: Flight, limits: Limits) -> Finding:
    table = result.smoothed
    if flight.attitude is None or not np.isfinite(table["imu_yaw_offset_rad"]).any():
        return nothing_to_judge("The flight has no attitude stream.")
    steps = yaw_steps(table, limits.yaw_step_rad)
    if not steps:
        drift = _spread(table["imu_yaw_offset_rad"])
        return Finding(f"None; drift {degrees(drift):.1f}°", 0.0, level=Level.PASS)
    largest = max(abs(step) for _, step in steps)
    times = ", ".join(f"{t:.0f}" for t, _ in steps[:6]) + (" ..." if len(steps) > 6 else "")
    text = f"{len(steps)}, the largest {degrees(largest):.1f}°, at {times} s"
    return Finding(text, largest, level=Level.WARN, meaning=None if flight.imu is not None else _FOLLOWS_YAW)


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


IMU_YAW_STEPS = CheckRule(
    name="Steps of the IMU's yaw",
    measure=_imu_yaw_steps,
    limit=lambda limits: f"warn from {degrees(limits.yaw_step_rad):g}° within 1 s",
    good="The vehicle's own yaw agrees with the corridor, except for a slow drift.",
    bad="The vehicle's yaw jumped relative to the corridor, as it does near steel; the estimated heading did not.",
    remedy="Do not control by the vehicle's own yaw in this corridor.",
)


def _stream_rates(result: FusionResult, flight: Flight, limits: Limits) -> Finding:
    rates = {word: _rate_hz(t_ns) for word, t_ns in _streams(flight)}
    if rates.get("frames") is None:
        return nothing_to_judge("There are fewer than two frames.")
    text = ", ".join(f"{word} {rate:.3g} Hz" for word, rate in rates.items() if rate is not None)
    inertial = [rate for word, rate in rates.items() if word != "frames" and rate is not None]
    levels = [level_of(rates["frames"] or 0.0, limits.frame_rate_hz)]
    levels.append(level_of(max(inertial), limits.inertial_rate_hz) if inertial else Level.WARN)
    level = worst_of(*levels)
    if level is Level.PASS:
        return Finding(text, rates["frames"], level=level)
    if not inertial:
        meaning = "The log has no inertial sensor: the heading between frames is extrapolated."
        return Finding(
            text,
            rates["frames"],
            level=level,
            meaning=meaning,
            action="Log the gyroscope, or at least the attitude.",
        )
    slow = "Frames" if levels[0] is level else "Inertial samples"
    meaning = f"{slow} are so rare that a turn between two of them is known only roughly."
    return Finding(text, rates["frames"], level=level, meaning=meaning)


def _streams(flight: Flight) -> list[tuple[str, TimeArray]]:
    found: list[tuple[str, TimeArray]] = [("frames", flight.frames.t_ns)]
    found += [("IMU", flight.imu.t_ns)] if flight.imu is not None else []
    found += [("attitude", flight.attitude.t_ns)] if flight.attitude is not None else []
    return found


def _rate_hz(t_ns: TimeArray) -> float | None:
    """Nominal rate, from the median interval, so that gaps do not lower it."""
    return float(1e9 / np.median(np.diff(t_ns))) if len(t_ns) > 1 else None


RATES = CheckRule(
    name="Rates of the streams",
    measure=_stream_rates,
    limit=lambda limits: (
        f"frames: pass from {limits.frame_rate_hz[0]:g} Hz, fail below {limits.frame_rate_hz[1]:g}; "
        f"IMU: {limits.inertial_rate_hz[0]:g}, {limits.inertial_rate_hz[1]:g}"
    ),
    good="The rates suit the motion of a small vehicle.",
    remedy="Increase the logging rate. The IMU needs no more than 200 Hz.",
)


def _longest_gap(result: FusionResult, flight: Flight, limits: Limits) -> Finding:
    good = limits.frame_gap_s[0]
    worst, where, count = 0.0, "", 0
    last_ns = max(int(t_ns[-1]) for _, t_ns in _streams(flight) if len(t_ns))
    for word, t_ns in _streams(flight):
        step = np.diff(np.append(t_ns, last_ns)) / 1e9  # a stream that ends early has a gap up to the end
        if not step.size:
            continue
        count += int(np.count_nonzero(step > max(good, 3.0 * float(np.median(step)))))
        if step.max() > worst:
            k = int(np.argmax(step))
            worst, where = float(step.max()), f"{word}, at {(t_ns[k] - flight.frames.t_ns[0]) / 1e9:.1f} s"
    if level_of(worst, limits.frame_gap_s) is Level.PASS:
        return Finding(f"Longest {worst:.2f} s", worst)
    meaning = f"{counted(count, 'gap')} in the log left the filter without input."
    return Finding(f"{worst:.2f} s ({where})", worst, meaning=meaning)


GAPS = CheckRule(
    name="Gaps in the log",
    measure=_longest_gap,
    pass_fail=lambda limits: limits.frame_gap_s,
    limit=lambda limits: f"pass to {limits.frame_gap_s[0]:g} s, fail above {limits.frame_gap_s[1]:g} s",
    good="No stream has a gap.",
    remedy="Look for dropped messages: a full memory card, a slow link or a camera that restarts.",
)


def _problems(result: FusionResult, flight: Flight, limits: Limits) -> Finding:
    found = [text for text in all_problems(result, flight) if not isinstance(text, Remark)]
    if not found:
        return Finding("No problems", 0.0, level=Level.PASS)
    first = "" if len(found) == 1 else "The first: "
    text = f"{first}{found[0].rstrip('.')}."
    return Finding(counted(len(found), "problem"), float(len(found)), level=Level.WARN, meaning=text)


def all_problems(result: FusionResult, flight: Flight) -> tuple[str, ...]:
    """Return every problem of reading and fusing, once each, in order."""
    return tuple(dict.fromkeys((*flight.problems, *result.problems)))


PROBLEMS = CheckRule(
    name="Input",
    measure=_problems,
    limit=lambda limits: "pass without problems",
    good="Every row and picture of the log could be used.",
    remedy="Check in the list below whether they matter.",
)
