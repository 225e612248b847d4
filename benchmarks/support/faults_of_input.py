"""Faults of what the estimator is told, handed or no longer given, and what is asked of each."""

from __future__ import annotations

from dataclasses import replace
from math import inf, nan, pi, radians
from typing import Any

import numpy as np

from . import injections as put
from .fault_score import Bound, Fault
from .faults_in_flight import NO_ATTITUDE, START_S, TURNS, recovering
from .injections import Injection

FLU = (1.0, -1.0, -1.0)

DELAY = [
    Fault(
        f"camera delay of {delay:g} s, told",
        "F9",
        put.late("frame", delay, stamped=True),
        Bound(within=2.0, quiet=True),
        config={"camera_delay_s": delay, "buffer_s": 1.0},
    )
    for delay in (0.2, 0.4, 0.6)
] + [
    Fault(
        "frames arrive 0.3 s late, rightly stamped",
        "F9",
        put.late("frame", 0.3, stamped=False),
        Bound(within=2.0, quiet=True),
    )
]

_STEADY = Bound(within=2.5, over_oracle=1.1, nees=(0.7, 1.4), quiet=True)


def _statistic(
    name: str,
    injection: Injection | None = None,
    seconds: float = 40.0,
    flights: int = 3,
    **scene: object,
) -> Fault:
    # Without an attitude, which the oracle does not see either; 1 Hz needs five frames to start.
    return Fault(
        name,
        "F10",
        injection,
        _STEADY,
        start_s=7.0,
        seconds=seconds,
        flights=flights,
        scene=NO_ATTITUDE | scene,
    )


def _correlated(time_s: float) -> Fault:
    # A minute has few independent errors that last for seconds: NEES of one flight scatters by a half.
    seconds, flights = (60.0, 10) if time_s > 1.0 else (40.0, 3)
    return _statistic(
        f"frame errors correlated over {time_s:g} s, not told",
        None,
        seconds,
        flights,
        frame_correlation=np.exp(-1 / (30 * time_s)),
    )


STATISTICS = [
    _statistic("frames of 1 Hz", frame_hz=1.0, gross=0.0),  # a gross one makes it coast, rightly
    *(_statistic(f"frames of {hz:g} Hz", frame_hz=hz) for hz in (60.0, 120.0)),
    *(_correlated(time_s) for time_s in (0.5, 2.0, 10.0)),
    _statistic("frame sigma told 2 times too wide", put.sigma_scaled(2.0)),
    _statistic("frame sigma told 3 times too wide", put.sigma_scaled(3.0)),
    _statistic("frame sigma told 2.5 times too narrow", put.sigma_scaled(0.4)),
]


def _corner(offset_norm: float, length_s: float) -> Fault:
    end_s = START_S + length_s
    name = f"corner {offset_norm:g} half widths off for {length_s:g} s"
    return Fault(
        name,
        "F11",
        put.corner_off(offset_norm, START_S, end_s),
        Bound(within=12.0, after=12.0),
        end_s=end_s,
        quantity="lateral",
    )


LATERAL = [_corner(0.15, 1.0), _corner(0.4, 0.6), _corner(0.4, 3.0)]

_TOLD = Bound(within=2.0, told_s=0.5)
DEAD = [
    Fault(
        "IMU dies at 5 of 15 s",
        "F12",
        put.dropped("imu", 5.0),
        replace(_TOLD, within=3.0),
        start_s=5.0,
        seconds=15.0,
    ),
    Fault(
        "IMU dies at 5 of 15 s, no attitude",
        "F12",
        put.dropped("imu", 5.0),
        replace(_TOLD, within=5.0),
        start_s=5.0,
        seconds=15.0,
        scene=NO_ATTITUDE,
    ),
    Fault("attitude dies", "F12", put.dropped("attitude", START_S), _TOLD),
    Fault("frames die", "F12", put.dropped("frame", START_S), _TOLD),
    Fault("IMU drops out for 0.3 s", "F12", put.dropped("imu", START_S, 8.3), recovering(2.0), end_s=8.3),
    Fault(
        "IMU drops out for 3 s",
        "F12",
        put.dropped("imu", START_S, 11.0),
        recovering(3.0, told_s=0.5),
        end_s=11.0,
    ),
    Fault(
        "frames drop out for 5 s",
        "F12",
        put.dropped("frame", START_S, 13.0),
        recovering(3.0, told_s=0.5),
        end_s=13.0,
    ),
    Fault(
        "attitude drops out for 5 s",
        "F12",
        put.dropped("attitude", START_S, 13.0),
        recovering(2.0, told_s=0.5),
        end_s=13.0,
    ),
]


def _handed_over(name: str, injection: Injection, **scene: object) -> Fault:
    """Return what is wrong from the first sample on; told within 5 s of flight."""
    return Fault(name, "F13", injection, Bound(within=2.0, told_s=5.0), start_s=0.0, scene=TURNS | scene)


HANDED_OVER = [
    _handed_over("principal point off by 50 px", put.calibration_wrong(right_px=50.0)),
    _handed_over("focal length told 30 % too long", put.calibration_wrong(focal_factor=1.3)),
    _handed_over("focal length told 30 % too short", put.calibration_wrong(focal_factor=0.7)),
    _handed_over("attitude upside down", put.attitude_upside_down()),
    _handed_over("attitude rolled by 10 deg", put.attitude_tilted(radians(10), 0.0)),
    _handed_over("accelerometer FLU, no attitude", put.accel_mapped(FLU), **NO_ATTITUDE),
    _handed_over("gyro FLU", put.gyro_axes(FLU)),
    _handed_over("gyro FLU, no attitude", put.gyro_axes(FLU), **NO_ATTITUDE),
    _handed_over("gyro in deg/s", put.gyro_mapped(lambda rate: rate * 180 / pi, 0.0)),
    _handed_over("gyro bias of 20 deg/s", put.gyro_added(put.constant(20), 0.0)),
    _handed_over("gyro bias of 20 deg/s, no attitude", put.gyro_added(put.constant(20), 0.0), **NO_ATTITUDE),
]


def _values(name: str, **changes: Any) -> Fault:
    return Fault(name, "F14", put.frames_with(START_S, 11.0, **changes), recovering(2.0), end_s=11.0)


VALUES = [
    _values("lateral offset of 1e300", lateral_offset_norm=1e300),
    _values("lateral sigma of 1e-300", lateral_offset_norm_std=1e-300),
    _values("elevation sigma of 1e200", elevation_rad=0.0, elevation_std_rad=1e200),
    _values("elevation of 1e300", elevation_rad=1e300, elevation_std_rad=1.0),
    _values("width per height of 1e308", width_per_height=1e308),
    _values("heading of 1e300", heading_rad=1e300),
    _values("heading sigma of 1e-300", heading_std_rad=1e-300),
    _values("heading infinite", heading_rad=inf),
    _values("-5 inliers", n_inliers=-5),
    Fault(
        "velocities NaN", "F14", put.velocities((nan, nan, nan), START_S, 11.0), recovering(2.0), end_s=11.0
    ),
    Fault(
        "velocities of 1e300",
        "F14",
        put.velocities((1e300, 1e300, 0.0), START_S, 11.0),
        recovering(2.0),
        end_s=11.0,
    ),
]

_BOTH = Bound(within=1.5, after=1.3)
YAW = [
    Fault(
        "IMU yaw jumps 30 deg", "yaw", put.yaw_off(radians(30), START_S), _BOTH, end_s=START_S, seconds=30.0
    ),
    Fault("IMU yaw jumps 180 deg", "yaw", put.yaw_off(pi, START_S), _BOTH, end_s=START_S, seconds=30.0),
    Fault("IMU yaw off 20 deg for 3 s", "yaw", put.yaw_off(radians(20), START_S, 11.0), _BOTH, end_s=11.0),
]
