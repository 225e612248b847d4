"""Units of the numbers in logs: their factors to SI, and the unit that fits a measured factor.

Raw counts are written as fractions of a unit, as in data sheets: ``deg/s/16.4``, ``g/2048``.
"""

from __future__ import annotations

import re
from math import log, pi

_G_M_S2, _DEG = 9.80665, pi / 180.0
#: Factor of each unit to SI.
_SI = (
    {"rad/s": 1.0, "deg/s": _DEG, "mrad/s": 1e-3, "rad": 1.0, "deg": _DEG, "mdeg": _DEG * 1e-3}
    | {"mdeg/s": _DEG * 1e-3}
    | {"m/s2": 1.0, "g": _G_M_S2, "mg": _G_M_S2 * 1e-3, "cm/s2": 1e-2}
    | {"m/s": 1.0, "dm/s": 0.1, "cm/s": 0.01, "mm/s": 1e-3, "m": 1.0, "dm": 0.1, "cm": 0.01, "mm": 1e-3}
)
_COUNTS = re.compile(r"(deg/s|g)/(\d{1,9}(?:\.\d{1,6})?)")


#: Counts per degree per second in the usual ranges of 250 to 2000, and per g in those of 2 to 64.
_GYRO_COUNTS = (131.0, 114.3, 65.5, 57.14, 32.8, 28.57, 16.4, 14.29)
_ACCEL_COUNTS = (16384.0, 8192.0, 4096.0, 2048.0, 1024.0, 512.0, 256.0)
_WITHIN = {"deg/s": 1.06, "g": 1.2}  # half the distance between the nearest two
_NAMES = {"deg/s": ("rad/s", "deg/s", "mrad/s"), "g": ("m/s2", "g", "mg")}


def in_si(unit: str) -> float:
    """Return the factor of a unit to SI; for ``g/2048`` or ``deg/s/16.4``, of one count of a sensor."""
    counts = _COUNTS.fullmatch(unit)
    return _SI[unit] if counts is None else _SI[counts[1]] / float(counts[2])


def unit_of_size(size: float, base: str) -> tuple[str, bool]:
    """Return the unit that fits a measured factor to SI, and whether the factor is that of a common unit.

    Parameters
    ----------
    size
        Measured factor to SI.
    base
        ``deg/s`` or ``g``: the base of raw counts, if no named unit fits.
    """
    counts = _GYRO_COUNTS if base == "deg/s" else _ACCEL_COUNTS
    known = (*_NAMES[base], *(f"{base}/{count:g}" for count in counts))
    nearest = min(known, key=lambda unit: abs(log(in_si(unit) / size)))
    if abs(log(in_si(nearest) / size)) < log(_WITHIN[base]):
        return nearest, True
    number = in_si(base) / size
    return f"{base}/{number:.0f}" if number >= 1000.0 else f"{base}/{number:.4g}", False


def is_counts(unit: str) -> bool:
    """Whether a unit is a raw count of a sensor."""
    counts = _COUNTS.fullmatch(unit)
    return counts is not None and float(counts[2]) > 0.0


def unit_in_words(unit: str) -> str:
    """Return a unit for a sentence: ``degrees/s``, ``counts, 2048 to a g``."""
    counts = _COUNTS.fullmatch(unit)
    words = {"deg/s": "degrees/s", "mg": "thousandths of g", "m/s2": "m/s^2"}
    if counts is None:
        return words.get(unit, unit)
    return f"counts, {counts[2]} to a {'g' if counts[1] == 'g' else 'degree/s'}"
