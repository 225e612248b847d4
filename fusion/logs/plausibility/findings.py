"""What a check of a log found: one sentence, what to do about it, and whether fusing would go wrong."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from math import asin, atan2, pi, radians

import numpy as np
import numpy.typing as npt


class Severity(StrEnum):
    """How sure it is, and what follows."""

    WARNING = "warning"  # likely, or harmless enough: fused, and reported
    ERROR = "error"  # certain, and the answer would be wrong: refused


@dataclass(frozen=True, slots=True)
class Finding:
    """Something that is implausible about a stream.

    Parameters
    ----------
    severity
        Whether the flight can be fused all the same.
    stream
        ``camera``, ``imu``, ``attitude``, ``velocity``, ``position`` or ``range``.
    kind
        A short fixed word, such as ``gyro_unit``.
    text
        What is wrong and what shows it, in words.
    remedy
        What the user can do.
    """

    severity: Severity
    stream: str
    kind: str
    text: str
    remedy: str

    @property
    def sentence(self) -> str:
        """Stream, text and remedy in one line, for a flight's ``problems``."""
        return f"{self.stream}: {self.text} ({self.remedy})"


@dataclass(frozen=True, slots=True)
class Advice:
    """What to change, worded for the kind of log that a flight came from.

    Parameters
    ----------
    is_folder
        Whether it is a flight folder in the ASL layout, whose files state their axes in ``mav0/body.yaml`` and whose
        units are fixed; else the manifest says so.
    """

    is_folder: bool = False

    def frame(self, stream: str, frame: str) -> str:
        """Return how to name a stream's axes."""
        if self.is_folder:
            return f"correct body_frame in mav0/body.yaml, or T_BS in mav0/{stream}0/sensor.yaml"
        other = "mount_rad = [3.1416, 0, 0]" if stream == "imu" else "use = false"
        return f'set frame = "{frame}" for [{stream}] in flight.toml if it is a CSV, else {other}'

    def mounting(self, stream: str, up: npt.NDArray[np.float64]) -> str:
        """Return how to say that a sensor's axes are not the body's, of which it sees this direction (3,) as up."""
        if self.is_folder:
            return f"give its mounting as T_BS in mav0/{stream}0/sensor.yaml"
        roll = _rounded(atan2(-up[1], -up[2]))
        pitch = _rounded(asin(max(-1.0, min(1.0, up[0]))))
        return (
            f"if it is mounted so, set mount_rad = [{roll:.4g}, {pitch:.4g}, YAW] for [{stream}] in flight.toml; "
            "YAW, positive right, is not to be seen from gravity; where the camera looks along one of its axes, "
            'camera_axis = "-z" or another for [imu] is enough'
        )

    def unit(self, stream: str, key: str, unit: str, factor: str) -> str:
        """Return how to correct a unit.

        Parameters
        ----------
        stream
            Name of the stream in a manifest.
        key, unit
            What to write into its column map.
        factor
            What to multiply the numbers by where there is no column map.
        """
        if self.is_folder:
            return f"multiply its columns in mav0/{stream}0/data.csv by {factor}"
        return f'set {key} = "{unit}" in [{stream}.columns] of flight.toml, or correct the logger'

    def leave_out(self, stream: str) -> str:
        """Return how to do without a stream."""
        if self.is_folder:
            return f"take mav0/{stream}0 away to fuse without it"
        return f"set use = false for [{stream}] in flight.toml to fuse without it"

    def clock(self, stream: str, lag_s: float) -> str:
        """Return how to shift the camera's clock, since the vehicle's own streams usually share one."""
        shift = f"add {lag_s:.3f} to [camera] clock_offset_s in flight.toml if both began together"
        return f"{shift}, `corridor align` finds the rest; or {self.leave_out(stream)}"


def _rounded(angle_rad: float) -> float:
    """Return the nearest quarter turn, where it is near: sensors are mounted so."""
    quarter = round(angle_rad / (pi / 2)) * pi / 2
    return quarter + 0.0 if abs(angle_rad - quarter) < radians(15) else angle_rad
