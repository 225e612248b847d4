"""A flight's row in the fleet's table: one list of fields defines columns, types, units and documentation."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any, NamedTuple

from fusion.evaluation.checks import CHECKS
from fusion.result.summary import Level

Value = str | float | int | None


class WorkerLostError(Exception):
    """The worker of a flight died at every attempt, or was ended because the flight took too long."""


def slug(name: str) -> str:
    """Return a check's name as part of a column's: lower case, words joined by underscores."""
    return re.sub(r"[^a-z0-9]+", "_", name.lower().replace("'s", "")).strip("_")


#: Name of each check by its part of the columns' names, in the order of the report.
CHECK_NAMES: Mapping[str, str] = {slug(rule.name): rule.name for rule in CHECKS}


@dataclass(frozen=True, slots=True)
class CheckOutcome:
    """Level of a check on one flight, and the finding, in convenient units."""

    level: Level
    value: str


def _column(unit: str, meaning: str, default: Any = None) -> Any:
    return field(default=default, metadata={"unit": unit, "meaning": meaning})


@dataclass(frozen=True, slots=True, kw_only=True)
class FleetRow:
    """One flight of a fleet; each field except ``checks`` is a column. None and an empty text mean unknown.

    Angles and offsets are positive right, in SI units and radians. Errors are the causal filter's against
    ``corridor_truth.csv``, in the rows with status tracking, unless the name says otherwise.
    """

    flight: str = _column("", "Name of the flight, unique in the table", "")
    verdict: str = _column(
        "", "fail, warn, pass, not_judged; without a result: unusable (the log), error (anything else)", ""
    )
    reason: str = _column("", "Why there is no result; empty where there is one", "")
    vehicle: str = _column("", "Which vehicle flew", "")
    date: str = _column("", "Start of the flight, ISO 8601, UTC where it has a time", "")
    path: str = _column("", "What was fused", "")
    output: str = _column(
        "", "Folder of the flight's output, seen from the table; empty without a result", ""
    )
    method: str = _column("", "How the pictures were measured", "")
    duration_s: float | None = _column("s", "Length of the flight")
    frames: int | None = _column("1", "Camera frames")
    frames_used_share: float | None = _column("1", "Share of the frames that the filter used")
    commonest_rejection: str = _column("", "Commonest reason for which frames were not used", "")
    frame_rate_hz: float | None = _column("Hz", "Nominal rate of the frames")
    imu_rate_hz: float | None = _column("Hz", "Nominal rate of the IMU")
    corridors: int | None = _column("1", "Corridors flown")
    problems: int | None = _column("1", "Problems of the log, of reading and of samples")
    failing_checks: int | None = _column("1", "Checks at fail")
    warning_checks: int | None = _column("1", "Checks at warn")

    initialising_share: float | None = _column("1", "Share of the estimates before the first fix")
    tracking_share: float | None = _column("1", "Share of the estimates that are tracking")
    coasting_share: float | None = _column("1", "Share of the estimates that are coasting")
    lost_share: float | None = _column("1", "Share of the estimates that are lost")
    coasts: int | None = _column("1", "Stretches of coasting or lost, after the first fix")
    longest_without_frame_s: float | None = _column("s", "Longest time without a used frame")

    heading_rmse_rad: float | None = _column("rad", "RMSE of the heading")
    heading_p95_rad: float | None = _column("rad", "95th percentile of the heading's absolute error")
    heading_max_rad: float | None = _column("rad", "Largest error of the heading")
    heading_bias_rad: float | None = _column("rad", "Mean error of the heading")
    heading_nees: float | None = _column("1", "Mean heading error squared over variance; 1 if consistent")
    heading_error_over_sigma_p90: float | None = _column("1", "90th percentile of heading error over sigma")
    smoothed_heading_rmse_rad: float | None = _column("rad", "RMSE of the smoother's heading")
    vision_heading_rmse_rad: float | None = _column("rad", "RMSE of single frames' headings")
    lateral_offset_rmse_m: float | None = _column("m", "RMSE of the lateral offset")
    lateral_offset_rmse_norm: float | None = _column("1", "RMSE of the lateral offset over half the width")
    lateral_offset_max_norm: float | None = _column(
        "1", "Largest error of the lateral offset over half the width"
    )
    smoothed_lateral_offset_rmse_norm: float | None = _column("1", "RMSE of the smoother's lateral offset")

    heading_std_rad: float | None = _column("rad", "Median sigma of the heading while tracking")
    lateral_offset_norm_std: float | None = _column("1", "Median sigma of the offset over half the width")
    offset_known_share: float | None = _column("1", "Share of tracking in which the offset was known")
    innovation_ratio: float | None = _column("1", "Median innovation over its sigma; 1: as expected")
    over_gate_share: float | None = _column("1", "Share of the frames that contradicted the prediction")

    gyro_bias_rad_s: float | None = _column("rad/s", "Bias of the yaw rate at the end, smoothed")
    gyro_bias_change_rad_s: float | None = _column("rad/s", "Range over which the bias changed")
    camera_late_s: float | None = _column("s", "How late the frames' stamps are against the IMU's turning")
    imu_yaw_step_rad: float | None = _column("rad", "Largest step of the IMU's own yaw; 0 without one")
    gyro_noise_rad_s_sqrt_hz: float | None = _column(
        "rad/s/sqrt(Hz)", "White noise of the gyroscope in flight"
    )
    accel_noise_m_s2_sqrt_hz: float | None = _column(
        "m/s^2/sqrt(Hz)", "White noise of the accelerometer in flight"
    )
    gyro_noise_used_rad_s_sqrt_hz: float | None = _column(
        "rad/s/sqrt(Hz)", "Gyroscope noise that the filter assumed"
    )

    vision_ms_median: float | None = _column("ms", "Median time to measure a frame")
    vision_ms_p95: float | None = _column("ms", "95th percentile of the time to measure a frame")
    fuse_s: float | None = _column("s", "Wall clock of fusing")
    times_real_time: float | None = _column("1", "Length of the flight over the wall clock of fusing")
    total_s: float | None = _column("s", "Wall clock of all: hashing, reading, fusing, writing")
    peak_memory_mb: float | None = _column("MB", "Peak memory of the worker up to the end of this flight")
    worker: str = _column("", "Machine and process that fused it", "")
    lost_workers: int = _column("1", "Worker processes that died while they fused it", 0)

    log_bytes: int | None = _column("B", "Size of the flight's files")
    log_hash: str = _column("", "SHA-256 of the flight's files, first 16 digits", "")
    log_stamp: str = _column("", "The same of their names, sizes and times of change", "")
    config_hash: str = _column("", "SHA-256 of settings, method and calibration file, first 16 digits", "")
    version: str = _column("", "Version of corridor-fusion with a hash of its source", "")
    libraries: str = _column("", "Versions of Python and of the libraries that affect the numbers", "")

    checks: Mapping[str, CheckOutcome] = field(default_factory=dict)

    @property
    def has_result(self) -> bool:
        """Whether the flight was fused."""
        return not self.reason


COLUMNS = {f.name: f for f in fields(FleetRow) if f.name != "checks"}
_NUMBERS = {
    name: int if str(f.type).startswith("int") else float for name, f in COLUMNS.items() if f.type != "str"
}


def flat(row: FleetRow) -> dict[str, Value]:
    """Return a row's columns by name: its fields, then level and value of each check; no byte that is not UTF-8."""
    found: dict[str, Value] = {name: _encodable(getattr(row, name)) for name in COLUMNS}
    for key in CHECK_NAMES:
        outcome = row.checks.get(key)
        found[f"check_{key}_level"] = "" if outcome is None else str(outcome.level)
        found[f"check_{key}_value"] = "" if outcome is None else outcome.value
    return found


def _encodable(value: Value) -> Value:
    return value.encode("utf-8", "backslashreplace").decode() if isinstance(value, str) else value


def row_from(values: Mapping[str, Any]) -> FleetRow:
    """Make a row from its columns; unknown columns of other versions are left out, missing ones are unknown.

    Raises
    ------
    ValueError
        If a number or a level is invalid.
    """
    known: dict[str, Any] = {}
    for name, found in COLUMNS.items():
        value = values.get(name)
        if value is None or value == "":
            continue
        kind = _NUMBERS.get(name)
        known[found.name] = str(value) if kind is None else kind(value)
    checks = {
        name.removeprefix("check_").removesuffix("_level"): CheckOutcome(
            Level(level), str(values.get(name.removesuffix("_level") + "_value") or "")
        )
        for name, level in values.items()
        if name.startswith("check_") and name.endswith("_level") and level
    }
    return FleetRow(**known, checks=checks)


class ColumnFacts(NamedTuple):
    """Name, type (str, int or float), unit and meaning of a column; texts have no unit."""

    name: str
    kind: type
    unit: str
    meaning: str


def column_facts() -> list[ColumnFacts]:
    """Return the description of each column of the table, in order."""
    facts = [
        ColumnFacts(name, _NUMBERS.get(name, str), f.metadata["unit"], f.metadata["meaning"])
        for name, f in COLUMNS.items()
    ]
    for key, name in CHECK_NAMES.items():
        facts.append(ColumnFacts(f"check_{key}_level", str, "", f"{name}: pass, warn, fail or not_judged"))
        facts.append(
            ColumnFacts(f"check_{key}_value", str, "", f"{name}: what was found, in units for people")
        )
    return facts
