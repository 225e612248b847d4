"""One row of the fleet's table, from a fused flight."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any

import numpy as np

from fusion.estimator.tables import Table
from fusion.evaluation.checks_filter import (
    INNOVATIONS_OVER_GATE,
    INNOVATIONS_OVER_SIGMA,
    LONGEST_COAST,
    OFFSET_KNOWN,
)
from fusion.evaluation.checks_frames import CAMERA_TIME
from fusion.evaluation.checks_input import IMU_YAW_STEPS
from fusion.evaluation.verdict import CheckRule
from fusion.fleet.row import CheckOutcome, slug
from fusion.flight import Flight, FloatArray
from fusion.inspection.imu import inspect_imu
from fusion.result.result import FusionResult
from fusion.result.summary import FlightErrors, Level, Summary
from fusion.result.table_rows import runs

_UNIX_NS = (
    978_307_200 * 10**9,
    4_102_444_800 * 10**9,
)  # 2001 to 2100: times in this range are absolute


def measures(result: FusionResult, flight: Flight) -> dict[str, Any]:
    """Return the fields of `fusion.fleet.row.FleetRow` that a flight's result fills, by name.

    Parameters
    ----------
    result, flight
        Result of `fusion.fuse_flight`, and its flight.
    """
    summary = result.overview
    rejected = [reason for reason in summary.counts.by_reason if reason != "ok"]
    timings = summary.timings
    found: dict[str, Any] = {
        "verdict": str(summary.verdict),
        "method": summary.method,
        "duration_s": summary.duration_s,
        "frames": summary.counts.frames,
        "frames_used_share": _share(summary.counts.accepted, summary.counts.frames),
        "commonest_rejection": rejected[0] if rejected else "",
        "frame_rate_hz": summary.rates.frames_hz,
        "imu_rate_hz": summary.rates.imu_hz,
        "corridors": len(summary.corridors),
        "problems": len(set(flight.problems) | set(result.problems)),
        "failing_checks": sum(check.level is Level.FAIL for check in summary.checks),
        "warning_checks": sum(check.level is Level.WARN for check in summary.checks),
        "checks": {slug(check.name): CheckOutcome(check.level, check.value) for check in summary.checks},
        "longest_without_frame_s": _number(summary, LONGEST_COAST),
        "offset_known_share": _number(summary, OFFSET_KNOWN),
        "innovation_ratio": _number(summary, INNOVATIONS_OVER_SIGMA),
        "over_gate_share": _number(summary, INNOVATIONS_OVER_GATE),
        "camera_late_s": _number(summary, CAMERA_TIME),
        "imu_yaw_step_rad": _number(summary, IMU_YAW_STEPS),
        "gyro_noise_used_rad_s_sqrt_hz": result.config.gyro_noise_density,
        **{f"{word}_share": summary.status_share.get(word, 0.0) for word in _STATUSES},
        **_from_tables(result),
        **_noise(flight),
        **(_errors(summary.errors) if summary.errors is not None else {}),
    }
    if timings is not None:
        found |= {
            "vision_ms_median": timings.vision_ms_median,
            "vision_ms_p95": timings.vision_ms_p95,
            "fuse_s": timings.total_s,
            "times_real_time": timings.times_real_time,
        }
    return found


_STATUSES = ("initialising", "tracking", "coasting", "lost")


def started(flight: Flight) -> str:
    """Return the time of the first frame, ISO 8601, if the log's clock is absolute; else an empty text."""
    first_ns = int(flight.frames.t_ns[0]) if len(flight.frames.t_ns) else 0
    if not _UNIX_NS[0] < first_ns < _UNIX_NS[1]:
        return ""
    return datetime.fromtimestamp(first_ns // 10**9, UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def _share(part: int, whole: int) -> float | None:
    return part / whole if whole else None


def _number(summary: Summary, rule: CheckRule) -> float | None:
    return next((check.number for check in summary.checks if check.name == rule.name), None)


def _from_tables(result: FusionResult) -> dict[str, Any]:
    table = result.estimates
    tracking = table["status"] == "tracking"
    first = int(np.argmax(tracking)) if tracking.any() else len(table)
    bias = result.smoothed["gyro_bias_rad_s"]
    bias = bias[np.isfinite(bias)]
    return {
        "coasts": len(runs(~tracking[first:])),
        "heading_std_rad": _median(table, "heading_std_rad", tracking),
        "lateral_offset_norm_std": _median(table, "lateral_offset_norm_std", tracking),
        "gyro_bias_rad_s": float(bias[-1]) if bias.size else None,
        "gyro_bias_change_rad_s": float(np.ptp(bias)) if bias.size else None,
    }


def _median(table: Table, name: str, rows: FloatArray) -> float | None:
    values = table[name][rows]
    values = values[np.isfinite(values)]
    return float(np.median(values)) if values.size else None


def _noise(flight: Flight) -> dict[str, Any]:
    imu = None if flight.imu is None else inspect_imu(flight.imu)
    if imu is None:
        return {}
    return {
        "gyro_noise_rad_s_sqrt_hz": imu.in_flight.gyro,
        "accel_noise_m_s2_sqrt_hz": imu.in_flight.accel,
    }


def _errors(errors: FlightErrors) -> dict[str, Any]:
    heading, metres, norm = (
        errors.filter.heading,
        errors.filter.lateral_offset_m,
        errors.filter.lateral_offset_norm,
    )
    smoothed = errors.smoothed.lateral_offset_norm
    return {
        "heading_rmse_rad": heading.rmse,
        "heading_p95_rad": heading.p95,
        "heading_max_rad": heading.max,
        "heading_bias_rad": heading.bias,
        "heading_nees": heading.nees_mean,
        "heading_error_over_sigma_p90": heading.error_over_sigma_p90,
        "smoothed_heading_rmse_rad": errors.smoothed.heading.rmse,
        "vision_heading_rmse_rad": errors.vision.heading.rmse,
        "lateral_offset_rmse_m": None if metres is None else metres.rmse,
        "lateral_offset_rmse_norm": None if norm is None else norm.rmse,
        "lateral_offset_max_norm": None if norm is None else norm.max,
        "smoothed_lateral_offset_rmse_norm": None if smoothed is None else smoothed.rmse,
    }
