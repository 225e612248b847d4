"""The faults and what is asked of each: within 1.5 times a good system, or told within half a second."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from math import inf, nan, pi, radians, sin
from typing import Any

import numpy as np

from tests.fusion.simulated import Function, plus, turning, weaving

from . import injections as put
from .fault_score import Bound, Fault
from .injections import Injection, together

START_S = 8.0
QUIET_GYRO = 0.003  # rad/s/sqrt(Hz): a good MEMS gyroscope, as told
FLU = (1.0, -1.0, -1.0)

_HELD = Bound(within=1.5, after=1.3)  # steady errors reach 0.9 degree


def _constant(value_deg: float) -> put.Profile:
    return lambda _: radians(value_deg)


def _ramp(deg_per_s: float) -> put.Profile:
    return lambda t: radians(deg_per_s) * t


def _within(
    within: float, after: float = 1.3, recovery_s: float = 1.0, told_s: float | None = None, **more: Any
) -> Bound:
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
    Fault("no fault, turns of 60 deg/s", "none", None, Bound(within=2.0, quiet=True), scene=_turning_fast(40, 4)),
]

_S_BEND = turning((START_S, 6.0, radians(30)), (START_S + 7.0, 6.0, radians(-30)))
_BY_PEER = Bound(within=1.2, by_peer=True)


def _bias(name: str, rate: put.Profile, bound: Bound, seconds: float = 50.0, **scene: object) -> Fault:
    return Fault(name, "F1", put.gyro_added(rate, START_S), bound, end_s=START_S, seconds=seconds, scene=scene)


BIAS = [
    _bias("gyro bias steps 2 deg/s, noise 0.003", _constant(2), replace(_BY_PEER, recovery_s=20.0, after=1.0),
          gyro_noise=QUIET_GYRO),
    _bias("gyro bias steps 10 deg/s, noise 0.003", _constant(10), replace(_BY_PEER, recovery_s=20.0, after=1.0),
          gyro_noise=QUIET_GYRO),
    _bias("gyro bias grows 0.05 deg/s^2, noise 0.003", _ramp(0.05), _BY_PEER, gyro_noise=QUIET_GYRO),
    _bias("gyro bias steps 2 deg/s", _constant(2), replace(_BY_PEER, recovery_s=20.0, after=1.3)),
    _bias("gyro bias steps 10 deg/s", _constant(10), replace(_BY_PEER, recovery_s=20.0, after=1.3)),
    _bias("gyro bias steps 10 deg/s, no attitude", _constant(10), replace(_BY_PEER, recovery_s=20.0, after=1.3),
          attitude_hz=0.0),
    _bias("gyro scale 3 % off, turns of 200 deg/s", _constant(0), _within(4.0, inf), 30.0,
          **_turning_fast(80, 2.5)),
    Fault("bend of 2 deg/s for 10 s, noise 0.003", "F1", None, replace(_BY_PEER, recovery_s=15.0, after=1.0), end_s=18.0,
          seconds=50.0, scene=_along(_bending(2, START_S, 18.0), gyro_noise=QUIET_GYRO)),
    Fault("bend of 2 deg/s for 10 s", "F1", None, replace(_BY_PEER, recovery_s=15.0, after=1.3), end_s=18.0, seconds=50.0,
          scene=_along(_bending(2, START_S, 18.0))),
    Fault("bend of 5 deg/s for 6 s", "F1", None, replace(_BY_PEER, recovery_s=15.0, after=1.3), end_s=14.0, seconds=40.0,
          scene=_along(_bending(5, START_S, 14.0))),
    Fault("S-bend of 30 degrees", "F1", None, replace(_BY_PEER, recovery_s=10.0, after=1.3), end_s=21.0, seconds=40.0,
          scene=_along(_S_BEND)),
]  # fmt: skip
_scale = put.gyro_mapped(lambda rate: 1.03 * rate, START_S)
BIAS = [replace(f, injection=_scale) if "scale" in f.name else f for f in BIAS]


def _wrong_axis(angle_deg: float, length_s: float, **scene: object) -> Fault:
    name = f"axis {angle_deg:g} deg off for {length_s:g} s" + (", no attitude" if scene else "")
    end_s = START_S + length_s
    seen = put.axis_off(_constant(angle_deg), START_S, end_s)
    return Fault(name, "F2", seen, _HELD, end_s=end_s, scene=scene)


WRONG_AXIS = [
    *(_wrong_axis(angle, 2.0) for angle in (3, 5, 10, 15, 19, 30)),
    _wrong_axis(5, 5.0),
    _wrong_axis(12, 5.0),
    _wrong_axis(10, 2.0, **NO_ATTITUDE),
    Fault("axis turns off 1 deg/s for 10 s", "F2", put.axis_off(_ramp(1), START_S, 18.0), _HELD, end_s=18.0, seconds=30.0),
]

_TURNS = _turning_fast(30, 4)  # to 35 deg/s: what a wrong time does depends on them
_FOUND = Bound(within=2.0, told_s=1.0)


def _clock(name: str, injection: Injection, bound: Bound, **more: Any) -> Fault:
    return Fault(name, "F3", injection, bound, scene=_TURNS, **more)


CLOCK = [
    _clock("camera clock 0.6 s ahead from the start", put.stamps_shifted("frame", 0.6, 0.0), Bound(2.0, told_s=3.0),
           start_s=0.0),
    _clock("camera clock 0.6 s behind from the start", put.stamps_shifted("frame", -0.6, 0.0), Bound(2.0, told_s=3.0),
           start_s=0.0),
    _clock("camera clock jumps 0.6 s ahead", put.stamps_shifted("frame", 0.6, START_S), _FOUND),
    _clock("camera clock jumps 3 s ahead", put.stamps_shifted("frame", 3.0, START_S), _FOUND),
    _clock("camera clock jumps 0.6 s back", put.stamps_shifted("frame", -0.6, START_S), _FOUND),
    _clock("camera clock jumps 0.1 s ahead", put.stamps_shifted("frame", 0.1, START_S), _within(2.0, inf)),
    _clock("camera clock jumps 0.1 s back", put.stamps_shifted("frame", -0.1, START_S), _within(2.0, inf)),
    _clock("one frame stamped 100 s ahead", put.stamp_once("frame", 100.0, START_S), _within(2.0), end_s=START_S),
    _clock("one IMU sample stamped 100 s ahead", put.stamp_once("imu", 100.0, START_S), _within(2.0), end_s=START_S),
    _clock("one IMU sample stamped 5 s ahead", put.stamp_once("imu", 5.0, START_S), _within(2.0), end_s=START_S),
    _clock("one attitude stamped 100 s ahead", put.stamp_once("attitude", 100.0, START_S), _within(2.0), end_s=START_S),
    _clock("IMU clock jumps 0.1 s ahead", put.stamps_shifted("imu", 0.1, START_S), _within(2.0, inf)),
    _clock("IMU clock 1 h ahead from the start", put.stamps_shifted("imu", 3600.0, 0.0), Bound(2.0, told_s=3.0),
           start_s=0.0),
    _clock("attitude clock jumps 0.6 s ahead", put.stamps_shifted("attitude", 0.6, START_S), _within(2.0, inf)),
    _clock("frame stamps jitter by 15 ms", put.stamps_jitter("frame", 0.015, START_S), _within(2.0, inf)),
    _clock("IMU stamps jitter by 2 ms", put.stamps_jitter("imu", 0.002, START_S), _within(2.0, inf)),
]  # fmt: skip

_HALF_TURN = put.gyro_added(lambda _: pi, START_S, START_S + 1.0)
HALF_TURN = [
    Fault("180 deg/s for 1 s", "F4", _HALF_TURN, _within(3.0), end_s=START_S + 1.0),
    Fault("180 deg/s for 1 s, no attitude", "F4", _HALF_TURN, Bound(within=3.0), end_s=START_S + 1.0, scene=NO_ATTITUDE),
    Fault("gyro +10 rad/s in 10 % for 3 s", "F4", put.gyro_spikes(10.0, 0.1, START_S, 11.0), _within(3.0), end_s=11.0),
    Fault("gyro +35 rad/s in 5 % for 1 s", "F4", put.gyro_spikes(35.0, 0.05, START_S, 9.0), _within(3.0), end_s=9.0),
    Fault("gyro +35 rad/s in 1 % for 3 s", "F4", put.gyro_spikes(35.0, 0.01, START_S, 11.0), _within(3.0), end_s=11.0),
    Fault("gyro +35 rad/s in 1 % for 3 s, no attitude", "F4", put.gyro_spikes(35.0, 0.01, START_S, 11.0), _within(3.0),
          end_s=11.0, scene=NO_ATTITUDE),
]  # fmt: skip

REFUSED = [
    Fault("no axis found for 15 s", "F5", put.frames_refused(START_S, 23.0), _within(4.0), end_s=23.0, seconds=30.0),
    Fault("no axis found for 10 s, gyro bias steps 3 deg/s", "F5",
          together([put.frames_refused(START_S, 18.0), put.gyro_added(_constant(3), START_S, 18.0)]), _within(5.0, recovery_s=2.0),
          end_s=18.0, seconds=26.0),
    Fault("random axes for 10 s", "F5", put.axis_random(START_S, 18.0), _within(4.0), end_s=18.0, seconds=26.0),
    Fault("random axes for 10 s, gyro bias steps 10 deg/s", "F5",
          together([put.axis_random(START_S, 18.0), put.gyro_added(_constant(10), START_S, 18.0)]), _within(5.0, recovery_s=2.0),
          end_s=18.0, seconds=26.0),
    Fault("random axes for 10 s, gyro bias steps 10 deg/s, no attitude", "F5",
          together([put.axis_random(START_S, 18.0), put.gyro_added(_constant(10), START_S, 18.0)]), Bound(5.0),
          end_s=18.0, seconds=26.0, scene=NO_ATTITUDE),
]  # fmt: skip


def _clip(limit_deg_s: float) -> put.Injection:
    limit = radians(limit_deg_s)
    return put.gyro_mapped(lambda rate: min(max(rate, -limit), limit), 0.0)


_WHIP = turning((START_S, 0.5, radians(80)), (START_S + 2.0, 0.5, radians(-80)))
IMPOSSIBLE = [
    *(Fault(f"one gyro sample of {rate:g} rad/s", "F6", put.gyro_once(rate, START_S), _HELD, end_s=START_S)
      for rate in (35.0, 300.0, 1e6, 1e308)),
    Fault("one gyro sample of 300 rad/s, no attitude", "F6", put.gyro_once(300.0, START_S), _HELD, end_s=START_S,
          scene=NO_ATTITUDE),
    Fault("gyro clipped at 250 deg/s, turns of 320 deg/s", "F6", _clip(250), _within(3.0), end_s=START_S + 2.5,
          scene={"heading": plus(weaving(0, radians(5), 6.0), _WHIP)}),
    Fault("gyro frozen for 3 s while turning", "F6", put.repeated("imu", START_S, 11.0), _within(3.0), end_s=11.0, scene=_TURNS),
    Fault("gyro says zero for 5 s while turning", "F6", put.gyro_axes((0.0, 0.0, 0.0), START_S), _within(3.0, inf),
          scene=_TURNS),
    Fault("gyro NaN for 2 s", "F6", put.gyro_mapped(lambda _: nan, START_S, 10.0), _within(3.0), end_s=10.0),
]  # fmt: skip

FROZEN = [
    Fault("camera frozen for 15 s while turning", "F7", put.repeated("frame", START_S, 23.0), _within(1.5), end_s=23.0,
          seconds=30.0),
    Fault("camera frozen for 15 s, slow turn of 12 deg", "F7", put.repeated("frame", START_S, 23.0), _within(1.5), end_s=23.0,
          seconds=30.0, scene={"heading": turning((9.0, 8.0, radians(12)))}),
    Fault("camera frozen for 3 s, no attitude", "F7", put.repeated("frame", START_S, 11.0), _within(1.5), end_s=11.0,
          scene=NO_ATTITUDE),
]  # fmt: skip

DELAY = [
    Fault(f"camera delay of {delay:g} s, told", "F9", put.late("frame", delay, stamped=True),
          Bound(within=2.0, quiet=True), config={"camera_delay_s": delay, "buffer_s": 1.0})
    for delay in (0.2, 0.4, 0.6)
] + [
    Fault("frames arrive 0.3 s late, rightly stamped", "F9", put.late("frame", 0.3, stamped=False),
          Bound(within=2.0, quiet=True))
]  # fmt: skip

_STEADY = Bound(within=2.5, over_oracle=1.1, nees=(0.7, 1.4), quiet=True)


def _statistic(name: str, injection: Injection | None = None, seconds: float = 40.0, **scene: object) -> Fault:
    return Fault(name, "F10", injection, _STEADY, start_s=0.0, seconds=seconds, flights=4, scene=scene)


def _correlated(time_s: float) -> Fault:
    seconds = 60.0 if time_s > 1.0 else 40.0
    return _statistic(
        f"frame errors correlated over {time_s:g} s, not told", None, seconds, frame_correlation=np.exp(-1 / (30 * time_s))
    )


STATISTICS = [
    *(_statistic(f"frames of {hz:g} Hz", frame_hz=hz) for hz in (1.0, 60.0, 120.0)),
    *(_correlated(time_s) for time_s in (0.5, 2.0, 10.0)),
    _statistic("frame sigma told 2 times too wide", put.sigma_scaled(2.0)),
    _statistic("frame sigma told 3 times too wide", put.sigma_scaled(3.0)),
    _statistic("frame sigma told 2.5 times too narrow", put.sigma_scaled(0.4)),
]


def _corner(offset_norm: float, length_s: float) -> Fault:
    end_s = START_S + length_s
    name = f"corner {offset_norm:g} half widths off for {length_s:g} s"
    return Fault(name, "F11", put.corner_off(offset_norm, START_S, end_s), Bound(12.0, 12.0), end_s=end_s, quantity="lateral")


LATERAL = [_corner(0.15, 1.0), _corner(0.4, 0.6), _corner(0.4, 3.0)]

_TOLD = Bound(within=2.0, told_s=0.5)
DEAD = [
    Fault("IMU dies at 5 of 15 s", "F12", put.dropped("imu", 5.0), replace(_TOLD, within=3.0), start_s=5.0, seconds=15.0),
    Fault("IMU dies at 5 of 15 s, no attitude", "F12", put.dropped("imu", 5.0), replace(_TOLD, within=5.0), start_s=5.0,
          seconds=15.0, scene=NO_ATTITUDE),
    Fault("attitude dies", "F12", put.dropped("attitude", START_S), _TOLD),
    Fault("frames die", "F12", put.dropped("frame", START_S), _TOLD),
    Fault("IMU drops out for 0.3 s", "F12", put.dropped("imu", START_S, 8.3), _within(2.0), end_s=8.3),
    Fault("IMU drops out for 3 s", "F12", put.dropped("imu", START_S, 11.0), _within(3.0, told_s=0.5), end_s=11.0),
    Fault("frames drop out for 5 s", "F12", put.dropped("frame", START_S, 13.0), _within(3.0, told_s=0.5), end_s=13.0),
    Fault("attitude drops out for 5 s", "F12", put.dropped("attitude", START_S, 13.0), _within(2.0, told_s=0.5), end_s=13.0),
]  # fmt: skip


def _handed_over(name: str, injection: Injection, within: float = 2.0, **scene: object) -> Fault:
    """Return what is wrong from the first sample on; told within 5 s of flight."""
    return Fault(name, "F13", injection, Bound(within, told_s=5.0), start_s=0.0, scene=_TURNS | scene)


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
    _handed_over("gyro bias of 20 deg/s", put.gyro_added(_constant(20), 0.0)),
    _handed_over("gyro bias of 20 deg/s, no attitude", put.gyro_added(_constant(20), 0.0), **NO_ATTITUDE),
]


def _values(name: str, **changes: Any) -> Fault:
    return Fault(name, "F14", put.frames_with(START_S, 11.0, **changes), _within(2.0), end_s=11.0)


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
    Fault("velocities NaN", "F14", put.velocities((nan, nan, nan), START_S, 11.0), _within(2.0), end_s=11.0),
    Fault("velocities of 1e300", "F14", put.velocities((1e300, 1e300, 0.0), START_S, 11.0), _within(2.0), end_s=11.0),
]

_BOTH = Bound(within=1.5, after=1.3)
YAW = [
    Fault("IMU yaw jumps 30 deg", "yaw", put.yaw_off(radians(30), START_S), _BOTH, end_s=START_S, seconds=30.0),
    Fault("IMU yaw jumps 180 deg", "yaw", put.yaw_off(pi, START_S), _BOTH, end_s=START_S, seconds=30.0),
    Fault("IMU yaw off 20 deg for 3 s", "yaw", put.yaw_off(radians(20), START_S, 11.0), _BOTH, end_s=11.0),
]

SINGLE: list[Fault] = [
    *QUIET,
    *BIAS,
    *WRONG_AXIS,
    *CLOCK,
    *HALF_TURN,
    *REFUSED,
    *IMPOSSIBLE,
    *FROZEN,
    *DELAY,
    *STATISTICS,
    *LATERAL,
    *DEAD,
    *HANDED_OVER,
    *VALUES,
    *YAW,
]
BY_NAME = {fault.name: fault for fault in SINGLE}

PAIRS = [
    ("gyro bias steps 2 deg/s", "axis 5 deg off for 2 s"),
    ("gyro bias steps 10 deg/s", "frames drop out for 5 s"),
    ("axis 10 deg off for 2 s", "attitude dies"),
    ("axis 10 deg off for 2 s", "IMU yaw jumps 30 deg"),
    ("180 deg/s for 1 s", "frames drop out for 5 s"),
    ("180 deg/s for 1 s", "IMU yaw jumps 30 deg"),
    ("camera clock jumps 0.1 s back", "axis 5 deg off for 2 s"),
    ("one IMU sample stamped 5 s ahead", "one gyro sample of 300 rad/s"),
    ("gyro +35 rad/s in 1 % for 3 s", "frame stamps jitter by 15 ms"),
    ("IMU drops out for 3 s", "axis 10 deg off for 2 s"),
    ("IMU drops out for 3 s", "frames drop out for 5 s"),
    ("camera frozen for 3 s, no attitude", "gyro bias steps 2 deg/s"),
    ("lateral offset of 1e300", "gyro NaN for 2 s"),
    ("random axes for 10 s", "IMU yaw jumps 30 deg"),
]  # fmt: skip


def pair(a: Fault, b: Fault) -> Fault:
    """Put two faults into one flight: the wider of the two bounds holds, from the later end on."""
    inject: Sequence[Injection] = [f.injection for f in (a, b) if f.injection is not None]
    bound = Bound(
        within=max(a.bound.within, b.bound.within, 2.0),
        after=max(a.bound.after, b.bound.after),
        recovery_s=max(a.bound.recovery_s, b.bound.recovery_s, 2.0),
        by_peer=False,
    )
    return Fault(
        name=f"{a.name} + {b.name}",
        group="pair",
        injection=together(inject),
        bound=replace(bound, within=6.0) if "bias" in a.name + b.name else bound,
        start_s=min(a.start_s, b.start_s),
        end_s=max(a.end_s, b.end_s),
        seconds=max(a.seconds, b.seconds),
        scene=a.scene | b.scene,
        config=a.config | b.config,
    )


FAULTS: list[Fault] = [*SINGLE, *(pair(BY_NAME[a], BY_NAME[b]) for a, b in PAIRS)]

ON_LOGGED = (
    "no fault",
    "gyro bias steps 10 deg/s",
    "axis 5 deg off for 2 s",
    "axis 15 deg off for 2 s",
    "camera clock jumps 0.1 s ahead",
    "one IMU sample stamped 100 s ahead",
    "180 deg/s for 1 s",
    "gyro +35 rad/s in 1 % for 3 s",
    "one gyro sample of 300 rad/s",
    "camera frozen for 3 s, no attitude",
    "IMU dies at 5 of 15 s",
    "attitude upside down",
    "gyro bias of 20 deg/s",
    "lateral offset of 1e300",
    "IMU yaw jumps 30 deg",
)

Draw = Callable[[np.random.Generator, float, float], Injection]
"""Makes an injection between two times, its size by chance."""


def _sign(rng: np.random.Generator) -> float:
    return float(rng.choice([-1.0, 1.0]))


def _drawn_sine(rng: np.random.Generator, start_s: float, end_s: float) -> Injection:
    size, rate = radians(rng.uniform(2, 20)), rng.uniform(0.5, 3.0)
    return put.axis_off(lambda t: size * sin(rate * t), start_s, end_s)


DRAWS: dict[str, Draw] = {
    "gyro bias": lambda r, a, b: put.gyro_added(_constant(_sign(r) * r.uniform(0.5, 15)), a),
    "gyro bias for a while": lambda r, a, b: put.gyro_added(_constant(_sign(r) * r.uniform(2, 60)), a, b),
    "gyro drift": lambda r, a, b: put.gyro_added(_ramp(_sign(r) * r.uniform(0.05, 1)), a),
    "gyro scale": lambda r, a, b: put.gyro_mapped(lambda w, k=r.uniform(0.9, 1.1): k * w, a),
    "half turn": lambda r, a, b: put.gyro_added(_constant(_sign(r) * r.uniform(120, 240)), a, a + 1.0),
    "gyro spikes": lambda r, a, b: put.gyro_spikes(_sign(r) * r.uniform(5, 35), r.uniform(0.005, 0.1), a, b),
    "gyro sample impossible": lambda r, a, b: put.gyro_once(_sign(r) * 10.0 ** r.uniform(1.5, 308), a),
    "gyro frozen": lambda r, a, b: put.repeated("imu", a, b),
    "gyro NaN": lambda r, a, b: put.gyro_mapped(lambda _: nan, a, b),
    "IMU dropout": lambda r, a, b: put.dropped("imu", a, b),
    "axis off": lambda r, a, b: put.axis_off(_constant(_sign(r) * r.uniform(2, 80)), a, b),
    "axis turns off": lambda r, a, b: put.axis_off(_ramp(_sign(r) * r.uniform(0.5, 8)), a, b),
    "axis sways": _drawn_sine,
    "axes random": lambda r, a, b: put.axis_random(a, b),
    "no axis": lambda r, a, b: put.frames_refused(a, b),
    "frame dropout": lambda r, a, b: put.dropped("frame", a, b),
    "camera frozen": lambda r, a, b: put.repeated("frame", a, b),
    "camera clock jumps": lambda r, a, b: put.stamps_shifted("frame", r.uniform(-0.8, 0.8), a),
    "one frame stamp": lambda r, a, b: put.stamp_once("frame", _sign(r) * 10.0 ** r.uniform(-1, 4), a),
    "one IMU stamp": lambda r, a, b: put.stamp_once("imu", _sign(r) * 10.0 ** r.uniform(-1, 4), a),
    "frame stamps jitter": lambda r, a, b: put.stamps_jitter("frame", r.uniform(0.005, 0.05), a, b),
    "frame sigma": lambda r, a, b: put.sigma_scaled(float(np.exp(r.uniform(-1.2, 1.2))), a),
    "frames late": lambda r, a, b: put.late("frame", r.uniform(0.1, 0.45), stamped=False, start_s=a),
    "attitude dropout": lambda r, a, b: put.dropped("attitude", a, b),
    "IMU yaw jumps": lambda r, a, b: put.yaw_off(r.uniform(-pi, pi), a, b),
    "attitude tilted": lambda r, a, b: put.attitude_tilted(_sign(r) * radians(r.uniform(2, 20)), a),
}


def random_faults(seed: int) -> tuple[str, Injection]:
    """Return one to three random faults, each of 0.2 to 6 s or for good, from 4 to 15 s on."""
    rng = np.random.default_rng((seed, 77))
    names = rng.choice(list(DRAWS), size=int(rng.integers(1, 4)), replace=False).tolist()
    injections = []
    for name in names:
        start_s = float(rng.uniform(4, 15))
        injections.append(DRAWS[name](rng, start_s, start_s + float(np.exp(rng.uniform(np.log(0.2), np.log(6.0))))))
    return " + ".join(names), together(injections)
