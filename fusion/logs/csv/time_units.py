"""Time stamps of unknown unit: whole numbers, decimals or dates, turned into integer nanoseconds."""

from __future__ import annotations

import re
from datetime import UTC, datetime

import numpy as np
import numpy.typing as npt

from fusion.flight import TimeArray
from fusion.logs.csv.column_map import TIME_NAMES, TimeUnit

NS: dict[TimeUnit, int] = {"ns": 1, "us": 1_000, "ms": 1_000_000, "s": 1_000_000_000}
_IN_WORDS = {"ns": "nanoseconds", "us": "microseconds", "ms": "milliseconds", "s": "seconds", "iso": "dates"}
_SPELLINGS: dict[str, TimeUnit] = {unit: unit for unit in NS} | {
    "nsec": "ns",
    "nanoseconds": "ns",
    "usec": "us",
    "µs": "us",
    "microseconds": "us",
    "msec": "ms",
    "millis": "ms",
    "milliseconds": "ms",
    "sec": "s",
    "secs": "s",
    "seconds": "s",
}
_YEAR_2001_S, _YEAR_2100_S = 978_307_200, 4_102_444_800
_TYPICAL_STEP_S, _LONGEST_STEP_S = 0.02, 100.0
MISSING = np.iinfo(np.int64).min


def unit_named(name: str, bracket: str) -> TimeUnit | None:
    """Return the unit that a column's name ends in, as in ``time_ms``, or that follows it in brackets."""
    for word in (bracket, name.rsplit("_", 1)[-1] if "_" in name else ""):
        unit = _SPELLINGS.get(word.strip().lower())
        if unit is not None:
            return unit
    return None


def is_time_name(name: str) -> int | None:
    """Return how clearly a column's name means time stamps, 0 the clearest; None where it does not."""
    plain = name.strip().lower().lstrip("#").strip()
    stem, _, last = plain.rpartition("_")
    candidates = (plain, stem if last in _SPELLINGS else plain)
    return next((rank for rank, known in enumerate(TIME_NAMES) if known in candidates), None)


def guess_unit(values: npt.NDArray[np.generic]) -> TimeUnit:
    """Guess the unit of numbers (n,): by the date they would be, else by a step that sensors have."""
    numbers = values.astype(np.float64)
    middle = float(np.median(numbers))
    steps = np.abs(np.diff(numbers))
    step = float(np.median(steps[steps > 0])) if np.any(steps > 0) else 1.0
    for unit, ns in NS.items():
        if _YEAR_2001_S <= middle * ns / 1e9 <= _YEAR_2100_S and step * ns / 1e9 < _LONGEST_STEP_S:
            return unit
    return min(NS, key=lambda unit: abs(np.log(step * NS[unit] / 1e9 / _TYPICAL_STEP_S)))


def in_words(unit: TimeUnit) -> str:
    """Name a unit in words."""
    return _IN_WORDS[unit]


def to_ns(values: npt.NDArray[np.generic], unit: TimeUnit) -> TimeArray:
    """Turn time stamps (n,) into nanoseconds; `MISSING` where the text is no time."""
    if unit == "iso":
        return np.array([_date_ns(str(text)) for text in values.tolist()], dtype=np.int64)
    if values.dtype.kind == "i":
        ok = np.abs(values) < 2**62 // NS[unit]
        return np.where(ok, np.where(ok, values, 0) * NS[unit], MISSING)
    numbers = values.astype(np.float64)
    # Whole and broken part apart: the fraction of a large number keeps its digits.
    ok = np.isfinite(numbers) & (np.abs(numbers) < 2**62 / NS[unit])
    numbers = np.where(ok, numbers, 0.0)
    whole = np.floor(numbers)
    # Seconds since 1970 have room for 240 ns: what a float adds below its own resolution is no measurement.
    quantum = 10 ** max(
        0, int(np.ceil(np.log10(float(np.spacing(np.abs(numbers).max(initial=1.0))) * NS[unit])))
    )
    part = np.rint((numbers - whole) * NS[unit] / quantum).astype(np.int64) * quantum
    t_ns = whole.astype(np.int64) * NS[unit] + part
    return np.where(ok, t_ns, MISSING)


def decimal_to_ns(text: str, unit: TimeUnit) -> int:
    """Turn a decimal number in a unit into nanoseconds without a float in between, whose digits would not do.

    Raises
    ------
    ValueError, OverflowError
        Where the text is no number, or no finite one.
    """
    scale = NS[unit]
    digits = len(str(scale)) - 1
    match = re.fullmatch(r"([+-]?)(\d+)(?:\.(\d*))?", text)
    if match is None:
        return round(float(text) * scale)
    part = (match[3] or "")[:digits].ljust(digits, "0")
    t_ns = int(match[2]) * scale + (int(part) if part else 0)
    return -t_ns if match[1] == "-" else t_ns


def _date_ns(text: str) -> int:
    try:
        moment = datetime.fromisoformat(text.strip())
    except ValueError:
        return MISSING
    moment = moment if moment.tzinfo is not None else moment.replace(tzinfo=UTC)
    whole = int(moment.replace(microsecond=0).timestamp())
    return whole * 10**9 + moment.microsecond * 1000
