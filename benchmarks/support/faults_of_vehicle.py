"""Errors of sensors that work within their specification; required: no harm, or a report."""

from __future__ import annotations

from math import cos, exp, floor, pi, radians
from typing import Any

import numpy as np

from tests.fusion.simulated import plus, turning, weaving

from . import injections as put
from .fault_score import Bound, Fault
from .faults_in_flight import START_S, TURNS, recovering
from .injections import Injection, together

_HARMLESS = Bound(within=1.5, quiet=True)
_TOLD = Bound(within=2.0, told_s=1.0)
_IN_TURNS = Bound(within=2.5)  # what is late by a few hundredths of a second shows there, and only there
_FROM_THE_START = Bound(within=2.0, told_s=5.0)
_LONG_S, _LATE_S = 40.0, 30.0  # by then the IMU's yaw corrects the heading
_AROUND_A_CORNER = plus(
    weaving(0, radians(5), 6.0), turning((START_S, 2.0, radians(40)), (11.5, 2.0, radians(-40)))
)
_Z_IS_Y = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]])


def _on_a_grid(t_s: float) -> float:
    return floor(100.0 * t_s) / 100.0


def _steel(t_s: float) -> float:
    return radians(25) * exp(-(((t_s - 2.5) / 1.2) ** 2))


def _wrong(name: str, injection: Injection, bound: Bound, **more: Any) -> Fault:
    return Fault(name, "F15", injection, bound, scene=TURNS, **more)


def _late(name: str, injection: Injection) -> Fault:
    """Return what befalls an IMU yaw that the filter has come to rely on, while no frame comes for 2 s."""
    blind = put.dropped("frame", _LATE_S + 1.0, _LATE_S + 3.0)
    bound = Bound(within=2.0, after=1.3)
    return Fault(
        name,
        "F15",
        together([injection, blind]),
        bound,
        start_s=_LATE_S,
        end_s=_LATE_S + 3.0,
        seconds=_LONG_S,
    )


VEHICLE = [
    _wrong("gyro y and z exchanged", put.gyro_mounted(_Z_IS_Y), _FROM_THE_START, start_s=0.0),
    _wrong("gyro z turns the wrong way", put.gyro_mounted(np.diag([1.0, 1.0, -1.0]), START_S), _TOLD),
    _wrong(
        "gyro z stuck for 3 s",
        put.gyro_z_stuck(START_S, START_S + 3.0),
        recovering(2.5, recovery_s=5.0),
        end_s=11.0,
    ),
    _wrong("gyro samples held for 25 ms", put.held("imu", 5, START_S), _IN_TURNS),
    _wrong("gyro lags by 60 ms", put.gyro_lagging(0.06, START_S), _IN_TURNS),
    _wrong("IMU thinned to 20 Hz", put.thinned("imu", 10, START_S), Bound(within=1.5)),
    _wrong(
        "gyro off by 3 deg/s in 2 of 4 s",
        put.gyro_added(lambda t: radians(3) * (t % 4.0 < 2.0), START_S),
        Bound(within=2.0),
    ),
    _wrong(
        "gyro warms up by 4 deg/s in 8 s",
        put.gyro_added(lambda t: radians(4) * (1.0 - exp(-t / 8.0)), 0.0),
        Bound(within=1.5),
    ),
    _wrong("yaw turns the wrong way", put.yaw_mapped(-1.0, 0.0), _HARMLESS),
    _wrong("yaw frozen", put.yaw_mapped(0.0, START_S), _HARMLESS),
    _late("yaw frozen, frames drop out for 2 s", put.yaw_mapped(0.0, _LATE_S)),
    _late("steel passes by, frames drop out for 2 s", put.yaw_pulled(_steel, _LATE_S)),
    _late("yaw drifts 3 deg/s, frames drop out for 2 s", put.yaw_pulled(put.ramp(3), _LATE_S)),
    _wrong(
        "stamps on a grid of 10 ms",
        together([put.stamped(kind, _on_a_grid, 0.0) for kind in ("imu", "attitude", "frame")]),
        Bound(within=1.5),
        start_s=0.0,
    ),
    _wrong(
        "frames stamped in pairs", put.stamped("frame", lambda t: floor(15.0 * t) / 15.0, START_S), _IN_TURNS
    ),
    _wrong("frames twice", put.held("frame", 2, START_S), _IN_TURNS),
    _wrong(
        "frame stamps twice as far apart", put.stamped("frame", lambda t: 2.0 * t - START_S, START_S), _TOLD
    ),
    _wrong(
        "exposure moves stamps by 0 to 40 ms",
        put.stamped("frame", lambda t: t + 0.02 * (1.0 - cos(pi * (t - START_S) / 3.0)), START_S),
        _IN_TURNS,
    ),
    _wrong(
        "camera clock 1 % fast", put.stamped("frame", lambda t: t + 0.01 * (t - START_S), START_S), _IN_TURNS
    ),
    _wrong("frames show what was 0.17 s ago", put.frames_old(5, START_S), _TOLD),
    _wrong("frames mirrored", put.frames_mirrored(), _FROM_THE_START, start_s=0.0),
    _wrong("frames mirrored from 8 s on", put.frames_mirrored(START_S), _TOLD),
    Fault(
        "axis 90 deg off for 3 s around a corner",
        "F15",
        put.axis_off(put.constant(90), START_S, 11.0),
        recovering(1.5),
        end_s=11.0,
        scene={"heading": _AROUND_A_CORNER},
    ),
    _wrong(
        "axis 8 deg off in half of the frames for 4 s",
        put.axis_off_at_times(radians(8), 0.5, START_S, 12.0),
        recovering(1.5),
        end_s=12.0,
    ),
    _wrong("frame sigma told 10 times too narrow", put.sigma_scaled(0.1), Bound(within=1.5), start_s=2.0),
]
