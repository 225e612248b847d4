"""The options of ``corridor simulate`` on top of a settings file."""

from __future__ import annotations

import re
from math import radians
from pathlib import Path
from typing import Any

from fusion.simulate import SimulationConfig
from vision.errors import InputError


def simulation_config(
    file: Path | None = None,
    *,
    seed: int | None = None,
    duration_s: float | None = None,
    width_m: float | None = None,
    size: str | None = None,
    turn_deg: float | None = None,
) -> SimulationConfig:
    """Read a settings file and apply the options; None keeps a setting.

    Parameters
    ----------
    file
        TOML, see `SimulationConfig`; None for the defaults.
    seed
        Seed of all random numbers.
    duration_s
        Length of the flight; the first corridor grows with it.
    width_m
        Width of the first corridor.
    size
        Of the pictures, ``640x480``.
    turn_deg
        Angle of a turn into a second corridor halfway through the flight, positive right.

    Raises
    ------
    InputError
        With the file or the setting, its value and the remedy.
    """
    config = SimulationConfig() if file is None else SimulationConfig.from_toml(file)
    values = config.model_dump()
    scene, motion = values["scene"], values["motion"]
    _set(values, "seed", seed)
    _set(motion, "duration_s", duration_s)
    _set(scene, "width_m", width_m)
    if size is not None:
        values["camera"] |= _size(size)
    way_m = motion["speed_m_s"] * motion["duration_s"]
    if duration_s is not None:
        scene["length_m"] = max(scene["length_m"], motion["start_m"] + way_m + 5.0)
    if turn_deg is not None:
        if not 30.0 <= abs(turn_deg) <= 150.0:
            raise InputError(
                f"--turn {turn_deg:g} is not a turn", remedy="give 30 to 150 degrees, to the left negative"
            )
        junction = {
            "at_m": motion["start_m"] + way_m / 2,
            "angle_rad": radians(turn_deg),
            "length_m": way_m / 2 + 10,
        }
        scene["junctions"], motion["route"] = (junction,), (2,)
    return SimulationConfig.from_values(values)


def _set(section: dict[str, Any], name: str, value: float | None) -> None:
    if value is not None:
        section[name] = value


def _size(text: str) -> dict[str, int]:
    match = re.fullmatch(r"([0-9]+)x([0-9]+)", text)
    if match is None:
        raise InputError(f"--size is {text!r}", remedy="give width and height in pixels, such as 640x480")
    return {"width_px": int(match[1]), "height_px": int(match[2])}
