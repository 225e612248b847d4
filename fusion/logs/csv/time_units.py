"""Convert time stamps of unknown unit to integer nanoseconds: integers, decimals or dates."""

from __future__ import annotations

import re
from datetime import UTC, datetime

import numpy as np
import numpy.typing as npt

from fusion.flight import TimeArray
from fusion.logs.csv.column_map import TIME_NAMES, TimeUnit

NS: dict[TimeUnit, int] = {"ns": 1, "us": 1_000, "ms": 1_000_000, "s": 1_000_000_000}
_UNIT_NS = NS | {
    "100us": 100_000,
    "days": 86_400 * 10**9,
}  # also the units that are never guessed from the steps
_IN_WORDS = {
    "ns": "nanoseconds",
    "us": "microseconds",
    "ms": "milliseconds",
    "s": "seconds",
    "iso": "dates",
} | {
    "100us": "tenths of milliseconds",
    "days": "days",
}
_UNIT_OF_NAMES: dict[str, TimeUnit] = {"sampletimefine": "100us", "datenum": "days"}
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
#: Days from a calendar's zero to 1970, and the range of days of a log: Excel's and MATLAB's calendars.
_CALENDARS = ((25_569, (36_526, 73_051)), (719_529, (730_486, 767_011)))
_LONGEST_STEP_DAYS = 1e-4
MISSING = np.iinfo(np.int64).min


def unit_named(name: str, bracket: str) -> TimeUnit | None:
    """Return the unit at the end of a column's name, as in ``time_ms``, or in brackets after it."""
    if name.strip().lower() in _UNIT_OF_NAMES:
        return _UNIT_OF_NAMES[name.strip().lower()]
    for word in (bracket, name.rsplit("_", 1)[-1] if "_" in name else ""):
        unit = _SPELLINGS.get(word.strip().lower())
        if unit is not None:
            return unit
    return None


def is_time_name(name: str) -> int | None:
    """Rank how clearly a column's name means time stamps, 0 the clearest; None if it does not."""
    plain = name.strip().lower().lstrip("#").strip()
    stem, _, last = plain.rpartition("_")
    candidates = (plain, stem if last in _SPELLINGS else plain)
    return next((rank for rank, known in enumerate(TIME_NAMES) if known in candidates), None)


def guess_unit(values: npt.NDArray[np.generic]) -> TimeUnit:
    """Guess the unit of numbers (n,): by a plausible date, or else by a plausible sampling interval."""
    numbers = values.astype(np.float64)
    middle = float(np.median(numbers))
    steps = np.abs(np.diff(numbers))
    step = float(np.median(steps[steps > 0])) if np.any(steps > 0) else 1.0
    if step < _LONGEST_STEP_DAYS and any(low < middle < high for _, (low, high) in _CALENDARS):
        return "days"
    for unit, ns in NS.items():
        if _YEAR_2001_S <= middle * ns / 1e9 <= _YEAR_2100_S and step * ns / 1e9 < _LONGEST_STEP_S:
            return unit
    return min(NS, key=lambda unit: abs(np.log(step * NS[unit] / 1e9 / _TYPICAL_STEP_S)))


def in_words(unit: TimeUnit) -> str:
    """Name a unit in words."""
    return _IN_WORDS[unit]


def to_ns(values: npt.NDArray[np.generic], unit: TimeUnit) -> TimeArray:
    """Convert time stamps (n,) to nanoseconds; `MISSING` if the text is not a time."""
    if unit == "iso":
        return dates_to_ns(values)
    if unit == "days":
        numbers = values.astype(np.float64)
        epoch = next((zero for zero, (low, high) in _CALENDARS if low < np.median(numbers) < high), 0)
        return to_ns((numbers - epoch) * 86_400.0, "s")
    if values.dtype.kind == "i":
        ok = np.abs(values) < 2**62 // _UNIT_NS[unit]
        return np.where(ok, np.where(ok, values, 0) * _UNIT_NS[unit], MISSING)
    numbers = values.astype(np.float64)
    # Integer part and fraction are separate, so that the fraction of a large number keeps its digits.
    ok = np.isfinite(numbers) & (np.abs(numbers) < 2**62 / _UNIT_NS[unit])
    numbers = np.where(ok, numbers, 0.0)
    whole = np.floor(numbers)
    # Seconds since 1970 have a resolution of 240 ns; digits below a float's resolution are noise.
    quantum = 10 ** max(
        0, int(np.ceil(np.log10(float(np.spacing(np.abs(numbers).max(initial=1.0))) * _UNIT_NS[unit])))
    )
    part = np.rint((numbers - whole) * _UNIT_NS[unit] / quantum).astype(np.int64) * quantum
    t_ns = whole.astype(np.int64) * _UNIT_NS[unit] + part
    return np.where(ok, t_ns, MISSING)


def decimal_to_ns(text: str, unit: TimeUnit) -> int:
    """Convert a decimal number in a unit to nanoseconds without a float, whose resolution is too coarse.

    Raises
    ------
    ValueError, OverflowError
        If the text is not a finite number.
    """
    scale = NS[unit]
    digits = len(str(scale)) - 1
    match = re.fullmatch(r"([+-]?)(\d+)(?:\.(\d*))?", text)
    if match is None:
        return round(float(text) * scale)
    part = (match[3] or "")[:digits].ljust(digits, "0")
    t_ns = int(match[2]) * scale + (int(part) if part else 0)
    return -t_ns if match[1] == "-" else t_ns


_CLOCK = r"(\d{1,2}):(\d{2}):(\d{2})(?:[.,:](\d+))?\s*([AaPp]\.?[Mm]\.?)?"
_DAY = r"(\d{4})[-/.](\d{1,2})[-/.](\d{1,2})|(\d{1,2})[./-](\d{1,2})[./-](\d{4})"
_DATE = re.compile(rf"(?:{_DAY})[T ,]\s*{_CLOCK}\s*(\S.*)?")
_TIME_OF_DAY = re.compile(_CLOCK)
DAY_NS = 86_400_000_000_000
MONTHS, HOURS = 12, 12


def is_date(text: str) -> bool:
    """Whether a text is a time of day, with or without a date."""
    return _date_ns(text, month_first=False) != MISSING or _date_ns(text, month_first=True) != MISSING


def dates_to_ns(values: npt.NDArray[np.generic]) -> TimeArray:
    """Convert dates or times of day (n,) to nanoseconds; times of day from midnight, also past the next one."""
    texts = [str(text).strip() for text in values.tolist()]
    month_first = _is_month_first(texts)
    t_ns = np.array([_date_ns(text, month_first) for text in texts], dtype=np.int64)
    known = np.flatnonzero(t_ns != MISSING)
    if len(known) and _TIME_OF_DAY.fullmatch(texts[known[0]]):
        midnights = np.cumsum(np.diff(t_ns[known], prepend=t_ns[known[0]]) < -DAY_NS // 2)
        t_ns[known] += midnights * DAY_NS
    return t_ns


def _is_month_first(texts: list[str]) -> bool | None:
    """Determine the order of day and month in dates with the year last, over all rows; None if both fit.

    With dots the day comes first, with AM and PM the month; otherwise a number above 12 is the day.
    """
    for text in texts:
        found = _DATE.fullmatch(text.strip().strip('"'))
        if found is None or found[1]:
            continue
        if "." in text[: found.end(6)]:
            return False
        if found[11] or int(found[5]) > MONTHS:
            return True
        if int(found[4]) > MONTHS:
            return False
    return None


def _date_ns(text: str, month_first: bool | None) -> int:
    """Nanoseconds since 1970, or since midnight for a time of day; `MISSING` if the text is neither."""
    text = text.strip().strip('"')
    alone, dated = _TIME_OF_DAY.fullmatch(text), _DATE.fullmatch(text)
    found = alone or dated
    if found is None:
        return MISSING
    groups = found.groups()
    hour, minute, second, fraction, half = groups[:5] if alone else groups[6:11]
    part_ns = int((fraction or "")[:9].ljust(9, "0"))
    hours = int(hour) if half is None else int(hour) % HOURS + (HOURS if half[0] in "Pp" else 0)
    day_ns = ((hours * 60 + int(minute)) * 60 + int(second)) * 10**9 + part_ns
    if alone:
        return day_ns
    year, month, day = groups[:3]
    if not year:
        if month_first is None:
            return MISSING
        year, month, day = groups[5], *(groups[3:5] if month_first else groups[4:2:-1])
    try:
        # fromisoformat reads the time zone; fractions of any length are added here
        zone = datetime.fromisoformat(f"{year}-{int(month):02}-{int(day):02}T00:00:00{groups[11] or ''}")
    except ValueError:
        return MISSING
    zone = zone if zone.tzinfo is not None else zone.replace(tzinfo=UTC)
    return int(zone.timestamp()) * 10**9 + day_ns
