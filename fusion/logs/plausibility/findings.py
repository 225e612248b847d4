"""Findings of the checks of a log: a sentence, a remedy, and whether the flight can be fused."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from math import asin, atan2, pi, radians

import numpy as np
import numpy.typing as npt


class Severity(StrEnum):
    """Severity of a finding, and its consequence."""

    WARNING = "warning"  # likely, or nearly harmless: fused, and reported
    ERROR = "error"  # certain, and the result would be wrong: rejected


@dataclass(frozen=True, slots=True)
class Finding:
    """An implausible property of a stream.

    Parameters
    ----------
    severity
        Whether the flight can be fused nevertheless.
    stream
        ``camera``, ``imu``, ``attitude``, ``velocity``, ``position`` or ``range``.
    kind
        A short fixed word, such as ``gyro_unit``.
    text
        The fault and its evidence, in words.
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


class Medium(StrEnum):
    """Medium that a stream is read from; decides how its axes or units are corrected."""

    FOLDER = "folder"  # a flight folder in the ASL layout, whose files state their axes; its units are fixed
    TABLE = "table"  # a CSV, with axes, columns and units in the manifest
    LOG = "log"  # any other format: its axes are known, but a sensor's mounting or unit may differ


@dataclass(frozen=True, slots=True)
class Advice:
    """Remedies, worded for the medium of each stream.

    Parameters
    ----------
    media
        Medium of each stream by its name in a manifest; a log by default.
    taken
        Factor to SI of ``gyro_unit`` and ``accel_unit`` with which the file was read; 1 if missing.
    frames
        Axes of streams declared in the manifest.
    """

    media: Mapping[str, Medium] = field(default_factory=dict)
    taken: Mapping[str, float] = field(default_factory=dict)
    frames: Mapping[str, str] = field(default_factory=dict)

    def medium(self, stream: str) -> Medium:
        """Return the medium of a stream."""
        return self.media.get(stream, Medium.LOG)

    def frame(self, stream: str, frame: str) -> str:
        """Return how to declare a stream's axes."""
        match self.medium(stream):
            case Medium.FOLDER:
                return f"correct body_frame in mav0/body.yaml, or T_BS in mav0/{stream}0/sensor.yaml"
            case Medium.TABLE:
                other = "frd" if self._is_declared_z_up(stream) else frame
                return f'set frame = "{other}" for [{stream}] in flight.toml'
            case Medium.LOG if stream == "imu":
                return "set mount_rad = [3.1416, 0, 0] for [imu] in flight.toml"
        return self.leave_out(stream)

    def reversed_axes(self, stream: str) -> str:
        """Return the remedy if a stream's y and z are opposite to those assumed."""
        if self.medium(stream) is Medium.LOG:
            return "y and z of its axes point the other way than this format has them"
        return (
            "axes look like FRD, not FLU" if self._is_declared_z_up(stream) else "axes look like FLU, not FRD"
        )

    def _is_declared_z_up(self, stream: str) -> bool:
        return self.frames.get(stream) in ("flu", "enu")

    def mounting(self, stream: str, up: npt.NDArray[np.float64]) -> str:
        """Return how to declare a sensor's mounting, if up on the body is this direction (3,) of the sensor."""
        if self.medium(stream) is Medium.FOLDER:
            return f"give its mounting as T_BS in mav0/{stream}0/sensor.yaml"
        roll = _rounded(atan2(-up[1], -up[2]))
        pitch = _rounded(asin(max(-1.0, min(1.0, up[0]))))
        return (
            f"if it is mounted so, set mount_rad = [{roll:.4g}, {pitch:.4g}, 0] for [{stream}] in flight.toml, the "
            "third number is the yaw, which gravity cannot determine; where the camera looks along one of its axes, "
            'camera_axis = "-z" or another for [imu] is enough'
        )

    def unit(self, stream: str, key: str, unit: str, factor: str) -> str:
        """Return how to correct a unit.

        Parameters
        ----------
        stream
            Name of the stream in a manifest.
        key, unit
            Entry in its column map.
        factor
            Factor for the numbers in a flight folder.
        """
        if self.medium(stream) is Medium.FOLDER:
            return f"multiply its columns in mav0/{stream}0/data.csv by {factor}"
        return f'set {key} = "{unit}" in [{stream}.columns] of flight.toml, or correct the logger'

    def quaternion_order(self) -> str:
        """Return how to declare an order of quaternions other than w, x, y, z."""
        match self.medium("attitude"):
            case Medium.FOLDER:
                return "write w, x, y, z into mav0/attitude0/data.csv"
            case Medium.TABLE:
                return "name the columns in the order w, x, y, z: quaternion in [attitude.columns] of flight.toml"
        return self.leave_out("attitude")

    def conjugated(self) -> str:
        """Return the remedy for quaternions from world to body."""
        match self.medium("attitude"):
            case Medium.FOLDER:
                return "negate x, y, z in mav0/attitude0/data.csv"
            case Medium.TABLE:
                return f"negate x, y, z in the file, or {self.leave_out('attitude')}"
        return self.leave_out("attitude")

    def leave_out(self, stream: str) -> str:
        """Return how to leave out a stream."""
        if self.medium(stream) is Medium.FOLDER:
            return f"take mav0/{stream}0 away to fuse without it"
        return f"set use = false for [{stream}] in flight.toml to fuse without it"

    def clock(self, stream: str, lag_s: float) -> str:
        """Return how to shift the camera's clock; the vehicle's own streams usually share one."""
        shift = f"add {lag_s:.3f} to [camera] clock_offset_s in flight.toml if both began together"
        return f"{shift}, `corridor align` finds the rest; or {self.leave_out(stream)}"


def _rounded(angle_rad: float) -> float:
    """Return the nearest quarter turn, if it is near, as usual for mounted sensors."""
    quarter = round(angle_rad / (pi / 2)) * pi / 2
    return quarter + 0.0 if abs(angle_rad - quarter) < radians(15) else angle_rad
