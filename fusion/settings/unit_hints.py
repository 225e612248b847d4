"""Units in the names of settings, and suggestions for names or values with another unit."""

from __future__ import annotations

import re
from collections.abc import Mapping
from difflib import get_close_matches
from math import pi
from typing import Any, NamedTuple

from fusion.settings.sentences import did_you_mean

UNIT_OF_SUFFIX = {
    "_rad_s": "rad/s",
    "_m_s2": "m/s^2",
    "_m_s": "m/s",
    "_rad": "rad",
    "_m": "m",
    "_s": "s",
    "_ns": "ns",
    "_hz": "Hz",
    "_px": "px",
    "_norm": "half widths",
    "_sigma": "sigma",
    "_share": "share",
}
"""Units by the suffix of a name, the longest first."""


class Foreign(NamedTuple):
    """A unit that no setting uses: its name, the suffixes of settings it may be meant for, the factor."""

    word: str
    suffixes: tuple[str, ...]
    factor: float


def _table(*rows: tuple[str, str, tuple[str, ...], float]) -> dict[str, Foreign]:
    return {
        spelling: Foreign(word, suffixes, factor)
        for spellings, word, suffixes, factor in rows
        for spelling in spellings.split()
    }


FOREIGN = _table(
    ("mm millimetres millimeters", "millimetres", ("_m",), 1e-3),
    ("cm centimetres centimeters", "centimetres", ("_m",), 1e-2),
    ("m metres meters", "metres", ("_m",), 1.0),
    ("km", "kilometres", ("_m",), 1e3),
    ("in inch inches", "inches", ("_m",), 0.0254),
    ("ft feet foot", "feet", ("_m",), 0.3048),
    ("deg degree degrees °", "degrees", ("_rad",), pi / 180),
    ("rad radians", "radians", ("_rad",), 1.0),
    ("mrad", "milliradians", ("_rad",), 1e-3),
    ("deg_s dps deg_per_s degrees_s deg/s °/s", "degrees/s", ("_rad_s",), pi / 180),
    ("rad/s", "rad/s", ("_rad_s",), 1.0),
    ("ns nanoseconds", "nanoseconds", ("_s",), 1e-9),
    ("us microseconds", "microseconds", ("_s",), 1e-6),
    ("ms milliseconds", "milliseconds", ("_s",), 1e-3),
    ("s sec second seconds", "seconds", ("_s",), 1.0),
    ("min minutes", "minutes", ("_s",), 60.0),
    ("cm_s cm/s", "cm/s", ("_m_s",), 1e-2),
    ("m/s", "m/s", ("_m_s",), 1.0),
    ("kmh km_h km/h", "km/h", ("_m_s",), 1 / 3.6),
    ("khz", "kHz", ("_hz",), 1e3),
    ("percent pct %", "percent", ("_norm", "_share"), 1e-2),
)
_QUANTITY = re.compile(r"\s*([-+]?[0-9.]+(?:e[-+]?[0-9]+)?)\s*([^\d\s].*?)\s*", re.IGNORECASE)


def unit_of(name: str, description: str | None) -> str:
    """Return a setting's unit: from the suffix of its name, or else the beginning of its description, or empty."""
    for suffix, unit in UNIT_OF_SUFFIX.items():
        if name.endswith(suffix):
            return unit
    found = re.search(r"\b(?:rad|m)/(?:s(?:\^[23])?/)?sqrt\((?:Hz|s)\)", description or "")
    return found[0] if found else ""


def suggestion(name: str, value: Any, units: Mapping[str, str]) -> str | None:
    """Suggest which setting an unknown name may mean, with the value in its unit; None if none is near.

    Parameters
    ----------
    name, value
        As given by the user.
    units
        The known names, each with its unit from `unit_of`.
    """
    names = list(units)
    stem, foreign = _without_unit(name)
    if foreign is not None:
        for suffix in foreign.suffixes:
            match = get_close_matches(
                stem + suffix, [n for n in names if n.endswith(suffix)], n=1, cutoff=0.8
            )
            if match and unit_of(match[0], None) == UNIT_OF_SUFFIX[suffix]:
                return f"did you mean {_assignment(match[0], value, foreign)}?"
    for candidate in (name, stem):
        same = [n for n in names if n.startswith(f"{candidate}_") and n[len(candidate) :] in UNIT_OF_SUFFIX]
        same += [candidate] if candidate in units else []
        if same:
            not_in = "" if foreign is None else f", not in {foreign.word}"
            return f"did you mean {same[0]}?" + (
                f" It is in {units[same[0]]}{not_in}" if units[same[0]] else ""
            )
    return did_you_mean(name, names)


def as_number(name: str, value: Any) -> str | None:
    """Suggest how to write a value given as text with a unit, such as ``"220 cm"``; None otherwise."""
    match = _QUANTITY.fullmatch(value) if isinstance(value, str) and len(value) < 100 else None
    foreign = FOREIGN.get(match[2].lower()) if match else None
    if match is None or foreign is None:
        return None
    if not any(name.endswith(suffix) for suffix in foreign.suffixes):
        return f"it is in {unit_of(name, None)}, not in {foreign.word}" if unit_of(name, None) else None
    return f"write a number in {unit_of(name, None)}: {_assignment(name, float(match[1]), foreign)}"


def too_large(name: str, value: Any) -> str | None:
    """Suggest the value of a number beyond its bound, if it was meant in a smaller unit; None otherwise."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    for suffix, spelling in (
        ("_rad_s", "deg_s"),
        ("_rad", "deg"),
        ("_m_s", "cm_s"),
        ("_m", "cm"),
        ("_s", "ms"),
    ):
        if name.endswith(suffix):
            foreign = FOREIGN[spelling]
            return f"it is in {UNIT_OF_SUFFIX[suffix]}; {value:g} {foreign.word} are {value * foreign.factor:.6g}"
    return None


def _without_unit(name: str) -> tuple[str, Foreign | None]:
    for count in (3, 2, 1):
        stem, *unit = name.lower().rsplit("_", count)
        foreign = FOREIGN.get("_".join(unit)) if len(unit) == count else None
        if foreign is not None:
            return stem, foreign
    return name, None


def _assignment(name: str, value: Any, foreign: Foreign) -> str:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return f"{name}, in {unit_of(name, None)}"
    return f"{name} = {value * foreign.factor:.9g}"
