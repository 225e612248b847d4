"""Faults of gyroscope, corridor, axis, clocks and camera while flying, and what is asked of each."""

from __future__ import annotations

from dataclasses import replace
from math import inf, nan, pi, radians
from typing import Any

import numpy as np

from tests.fusion.simulated import Function, plus, turning, weaving

from . import injections as put
from .fault_score import Bound, Fault
from .injections import Injection, together

START_S = 8.0
QUIET_GYRO = 0.003  # rad/s/sqrt(Hz): a good MEMS gyroscope, as told

_HELD = Bound(within=1.5, after=1.3)  # steady errors reach 0.9 degree


def recovering(
    within: float, after: float = 1.3, recovery_s: float = 1.0, told_s: float | None = None, **more: Any
) -> Bound:
    """Return a bound whose error is small again some time after the fault."""
    return Bound(within=within, after=after, recovery_s=recovery_s, told_s=told_s, **more)


def _bending(deg_per_s: float, start_s: float, end_s: float) -> Function:
    return lambda t: radians(deg_per_s) * (np.clip(t, start_s, end_s) - start_s)


def _along(axis: Function, **more: Any) -> dict[str, object]:
    """Return a scene whose corridor bends and whose vehicle follows it."""
    return {"axis": axis, "heading": plus(weaving(0, radians(4), 6.0), axis), **more}


def _turning_fast(amplitude_deg: float, period_s: float) -> dict[str, object]:
    return {"heading": weaving(0, radians(amplitude_deg), period_s)}


NO_ATTITUDE: dict[str, object] = {"attitude_hz": 0.0}

QUIET = [
    Fault("no fault", "none", None, Bound(within=1.5, quiet=True), seconds=40.0, flights=3),
    Fault("no fault, no attitude", "none", None, Bound(within=1.5, quiet=True), scene=NO_ATTITUDE, flights=3),
    Fault(
        "no fault, turns of 60 deg/s", "none", None, Bound(within=2.0, quiet=True), scene=_turning_fast(40, 4)
    ),
]

_S_BEND = turning((START_S, 6.0, radians(30)), (START_S + 7.0, 6.0, radians(-30)))
_BY_PEER = Bound(within=1.2, by_peer=True)


def _bias(name: str, rate: put.Profile, bound: Bound, seconds: float = 50.0, **scene: object) -> Fault:
    return Fault(
        name, "F1", put.gyro_added(rate, START_S), bound, end_s=START_S, seconds=seconds, scene=scene
    )


BIAS = [
    _bias(
        "gyro bias steps 2 deg/s, noise 0.003",
        put.constant(2),
        replace(_BY_PEER, recovery_s=20.0, after=1.0),
        gyro_noise=QUIET_GYRO,
    ),
    _bias(
        "gyro bias steps 10 deg/s, noise 0.003",
        put.constant(10),
        replace(_BY_PEER, recovery_s=20.0, after=1.0),
        gyro_noise=QUIET_GYRO,
    ),
    _bias("gyro bias grows 0.05 deg/s^2, noise 0.003", put.ramp(0.05), _BY_PEER, gyro_noise=QUIET_GYRO),
    _bias("gyro bias steps 2 deg/s", put.constant(2), replace(_BY_PEER, recovery_s=20.0, after=1.3)),
    _bias("gyro bias steps 10 deg/s", put.constant(10), replace(_BY_PEER, recovery_s=20.0, after=1.3)),
    _bias(
        "gyro bias steps 10 deg/s, no attitude",
        put.constant(10),
        replace(_BY_PEER, recovery_s=20.0, after=1.3),
        attitude_hz=0.0,
    ),
    Fault(
        "gyro scale 3 % off, turns to 150 deg/s",
        "F1",
        put.gyro_scaled(1.03, START_S),
        Bound(within=3.0),
        seconds=30.0,
        scene=_turning_fast(80, 2.5),
    ),
    Fault(
        "gyro scale 3 % off, 400 deg turned in 4 s",
        "F1",
        put.gyro_scaled(1.03, START_S),
        replace(_BY_PEER, after=1.3),
        end_s=13.0,
        seconds=25.0,
        scene={"heading": plus(weaving(0, radians(5), 6.0), turning((9.0, 4.0, radians(400))))},
    ),
    Fault(
        "bend of 2 deg/s for 10 s, noise 0.003",
        "F1",
        None,
        replace(_BY_PEER, recovery_s=15.0, after=1.0),
        end_s=18.0,
        seconds=50.0,
        scene=_along(_bending(2, START_S, 18.0), gyro_noise=QUIET_GYRO),
    ),
    Fault(
        "bend of 2 deg/s for 10 s",
        "F1",
        None,
        replace(_BY_PEER, recovery_s=15.0, after=1.3),
        end_s=18.0,
        seconds=50.0,
        scene=_along(_bending(2, START_S, 18.0)),
    ),
    Fault(
        "bend of 5 deg/s for 6 s",
        "F1",
        None,
        replace(_BY_PEER, recovery_s=15.0, after=1.3),
        end_s=14.0,
        seconds=40.0,
        scene=_along(_bending(5, START_S, 14.0)),
    ),
    Fault(
        "S-bend of 30 degrees",
        "F1",
        None,
        replace(_BY_PEER, recovery_s=10.0, after=1.3),
        end_s=21.0,
        seconds=40.0,
        scene=_along(_S_BEND),
    ),
]


def _wrong_axis(angle_deg: float, length_s: float, **scene: object) -> Fault:
    name = f"axis {angle_deg:g} deg off for {length_s:g} s" + (", no attitude" if scene else "")
    end_s = START_S + length_s
    seen = put.axis_off(put.constant(angle_deg), START_S, end_s)
    return Fault(name, "F2", seen, _HELD, end_s=end_s, scene=scene)


WRONG_AXIS = [
    *(_wrong_axis(angle, 2.0) for angle in (3, 5, 10, 15, 19, 30)),
    *(_wrong_axis(angle, 6.0) for angle in (3, 4)),
    _wrong_axis(5, 5.0),
    _wrong_axis(12, 5.0),
    _wrong_axis(10, 2.0, **NO_ATTITUDE),
    Fault(
        "axis turns off 1 deg/s for 10 s",
        "F2",
        put.axis_off(put.ramp(1), START_S, 18.0),
        _HELD,
        end_s=18.0,
        seconds=30.0,
    ),
]

TURNS = _turning_fast(30, 4)  # to 35 deg/s: what a wrong time does depends on them
_FOUND = Bound(within=2.0, told_s=1.0)


def _clock(name: str, injection: Injection, bound: Bound, **more: Any) -> Fault:
    return Fault(name, "F3", injection, bound, scene=TURNS, **more)


def _jump(name: str, injection: Injection) -> Fault:
    return _clock(name, injection, recovering(2.0, recovery_s=4.0), end_s=START_S)


CLOCK = [
    _clock(
        "camera clock 0.6 s ahead from the start",
        put.stamps_shifted("frame", 0.6, 0.0),
        Bound(within=2.0, told_s=3.0),
        start_s=0.0,
    ),
    _clock(
        "camera clock 0.6 s behind from the start",
        put.stamps_shifted("frame", -0.6, 0.0),
        Bound(within=2.0, told_s=3.0),
        start_s=0.0,
    ),
    _clock("camera clock jumps 0.6 s ahead", put.stamps_shifted("frame", 0.6, START_S), _FOUND),
    _clock("camera clock jumps 3 s ahead", put.stamps_shifted("frame", 3.0, START_S), _FOUND),
    _clock("camera clock jumps 0.6 s back", put.stamps_shifted("frame", -0.6, START_S), _FOUND),
    _jump("camera clock jumps 0.1 s ahead", put.stamps_shifted("frame", 0.1, START_S)),
    _jump("camera clock jumps 0.1 s back", put.stamps_shifted("frame", -0.1, START_S)),
    _jump("IMU clock jumps 0.1 s ahead", put.stamps_shifted("imu", 0.1, START_S)),
    _clock(
        "one frame stamped 100 s ahead",
        put.stamp_once("frame", 100.0, START_S),
        recovering(2.0),
        end_s=START_S,
    ),
    _clock(
        "one IMU sample stamped 100 s ahead",
        put.stamp_once("imu", 100.0, START_S),
        recovering(2.0),
        end_s=START_S,
    ),
    _clock(
        "one IMU sample stamped 5 s ahead",
        put.stamp_once("imu", 5.0, START_S),
        recovering(2.0),
        end_s=START_S,
    ),
    _clock(
        "one attitude stamped 100 s ahead",
        put.stamp_once("attitude", 100.0, START_S),
        recovering(2.0),
        end_s=START_S,
    ),
    _clock(
        "IMU clock 1 h ahead from the start",
        put.stamps_shifted("imu", 3600.0, 0.0),
        Bound(within=2.0, told_s=3.0),
        start_s=0.0,
    ),
    _clock(
        "attitude clock jumps 0.6 s ahead", put.stamps_shifted("attitude", 0.6, START_S), recovering(2.0, inf)
    ),
    _clock("frame stamps jitter by 15 ms", put.stamps_jitter("frame", 0.015, START_S), recovering(2.0, inf)),
    _clock("IMU stamps jitter by 2 ms", put.stamps_jitter("imu", 0.002, START_S), recovering(2.0, inf)),
]

_SPIKES = Bound(within=3.0, at_once=4.0, after=1.3)
_HALF_TURN = put.gyro_added(lambda _: pi, START_S, START_S + 1.0)
HALF_TURN = [
    Fault("180 deg/s for 1 s", "F4", _HALF_TURN, recovering(3.0), end_s=START_S + 1.0),
    Fault(
        "180 deg/s for 1 s, no attitude",
        "F4",
        _HALF_TURN,
        Bound(within=3.0),
        end_s=START_S + 1.0,
        scene=NO_ATTITUDE,
    ),
    Fault(
        "gyro +10 rad/s in 10 % for 3 s", "F4", put.gyro_spikes(10.0, 0.1, START_S, 11.0), _SPIKES, end_s=11.0
    ),
    Fault(
        "gyro +35 rad/s in 5 % for 1 s", "F4", put.gyro_spikes(35.0, 0.05, START_S, 9.0), _SPIKES, end_s=9.0
    ),
    Fault(
        "gyro +35 rad/s in 1 % for 3 s", "F4", put.gyro_spikes(35.0, 0.01, START_S, 11.0), _SPIKES, end_s=11.0
    ),
    Fault(
        "gyro +35 rad/s in 1 % for 3 s, no attitude",
        "F4",
        put.gyro_spikes(35.0, 0.01, START_S, 11.0),
        _SPIKES,
        end_s=11.0,
        scene=NO_ATTITUDE,
    ),
]

REFUSED = [
    Fault(
        "no axis found for 15 s",
        "F5",
        put.frames_refused(START_S, 23.0),
        recovering(4.0),
        end_s=23.0,
        seconds=30.0,
    ),
    Fault(
        "no axis found for 10 s, gyro bias steps 3 deg/s",
        "F5",
        together([put.frames_refused(START_S, 18.0), put.gyro_added(put.constant(3), START_S, 18.0)]),
        recovering(5.0, recovery_s=2.0),
        end_s=18.0,
        seconds=26.0,
    ),
    Fault(
        "random axes for 10 s",
        "F5",
        put.axis_random(START_S, 18.0),
        recovering(4.0),
        end_s=18.0,
        seconds=26.0,
    ),
    Fault(
        "random axes for 10 s, gyro bias steps 10 deg/s",
        "F5",
        together([put.axis_random(START_S, 18.0), put.gyro_added(put.constant(10), START_S, 18.0)]),
        recovering(5.0, recovery_s=2.0),
        end_s=18.0,
        seconds=26.0,
    ),
    Fault(
        "random axes for 10 s, gyro bias steps 10 deg/s, no attitude",
        "F5",
        together([put.axis_random(START_S, 18.0), put.gyro_added(put.constant(10), START_S, 18.0)]),
        Bound(within=5.0),
        end_s=18.0,
        seconds=26.0,
        scene=NO_ATTITUDE,
    ),
]


def _clip(limit_deg_s: float) -> put.Injection:
    limit = radians(limit_deg_s)
    return put.gyro_mapped(lambda rate: min(max(rate, -limit), limit), 0.0)


_BRIDGED = replace(_HELD, at_once=3.0)
_WHIP = turning((START_S, 0.5, radians(80)), (START_S + 2.0, 0.5, radians(-80)))
IMPOSSIBLE = [
    *(
        Fault(
            f"one gyro sample of {rate:g} rad/s", "F6", put.gyro_once(rate, START_S), _BRIDGED, end_s=START_S
        )
        for rate in (35.0, 300.0, 1e6, 1e308)
    ),
    Fault(
        "one gyro sample of 300 rad/s, no attitude",
        "F6",
        put.gyro_once(300.0, START_S),
        _BRIDGED,
        end_s=START_S,
        scene=NO_ATTITUDE,
    ),
    Fault(
        "gyro clipped at 250 deg/s, turns of 320 deg/s",
        "F6",
        _clip(250),
        recovering(3.0),
        end_s=START_S + 2.5,
        scene={"heading": plus(weaving(0, radians(5), 6.0), _WHIP)},
    ),
    Fault(
        "gyro frozen for 3 s while turning",
        "F6",
        put.repeated("imu", START_S, 11.0),
        recovering(3.0),
        end_s=11.0,
        scene=TURNS,
    ),
    Fault(
        "gyro says zero for 5 s while turning",
        "F6",
        put.gyro_axes((0.0, 0.0, 0.0), START_S),
        recovering(3.0, inf),
        scene=TURNS,
    ),
    Fault(
        "gyro NaN for 2 s", "F6", put.gyro_mapped(lambda _: nan, START_S, 10.0), recovering(3.0), end_s=10.0
    ),
]

FROZEN = [
    Fault(
        "camera frozen for 15 s while turning",
        "F7",
        put.repeated("frame", START_S, 23.0),
        recovering(1.5),
        end_s=23.0,
        seconds=30.0,
    ),
    Fault(
        "camera frozen for 15 s, slow turn of 12 deg",
        "F7",
        put.repeated("frame", START_S, 23.0),
        recovering(1.5),
        end_s=23.0,
        seconds=30.0,
        scene={"heading": turning((9.0, 8.0, radians(12)))},
    ),
    Fault(
        "camera frozen for 3 s, no attitude",
        "F7",
        put.repeated("frame", START_S, 11.0),
        recovering(1.5),
        end_s=11.0,
        scene=NO_ATTITUDE,
    ),
]
