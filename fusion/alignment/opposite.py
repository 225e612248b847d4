"""Advice for a flight in which vision and inertial sensors measure opposite turns."""

from __future__ import annotations

from math import cos

import numpy as np

from fusion.flight import Flight
from fusion.logs.contents import Kind
from fusion.logs.manifest.manifest import ImuSource, Manifest
from fusion.logs.manifest.sources import ManifestLog
from fusion.logs.plausibility.findings import Advice, Medium


def opposite_remedy(flight: Flight) -> str:
    """Name the setting that is likely wrong, by gravity and the axes that the flight's manifest declares.

    Gravity alone cannot distinguish an IMU with axes forward, left, up from one that reports gravity's pull along
    forward, right, down. The turns seen by the camera can.
    """
    imu, manifest = flight.imu, flight.manifest
    sources = ManifestLog(manifest) if isinstance(manifest, Manifest) else None
    advice = Advice() if sources is None else sources.advice()
    if imu is None or not np.isfinite(imu.accel_m_s2).any():
        stream = "attitude" if imu is None else "imu"
        return f"Axes are likely forward, left, up: {advice.frame(stream, 'flu')}."
    declared = sources.manifest.imu if sources is not None else ImuSource()
    if declared.mount_rad is not None and cos(declared.mount_rad[0]) < 0.0:
        return (
            "Take mount_rad of [imu] away and set accel_sign = -1 in [imu.columns] of flight.toml: the accelerometer "
            "gives gravity's pull, the axes are as they should be."
        )
    upside_down = (
        "if the camera hangs upside down, set mount_roll_rad = 3.1416 for [camera] in flight.toml; if its pictures "
        "are mirrored, mirror them back"
    )
    log = sources.log(Kind.IMU) if sources is not None and advice.medium("imu") is Medium.TABLE else None
    if log is not None:
        other = "frd" if log.body_frame == "flu" else "flu"
        told_so = f'set frame = "{other}" for [imu] and accel_sign = -1 in [imu.columns] of flight.toml'
        return f"If the file gives gravity's pull, {told_so}; {upside_down}."
    return f"By gravity the IMU is as told, so the camera is not: {upside_down}."
