"""Faults by chance: kind, time and size, for flights of which none may be silently wrong."""

from __future__ import annotations

from collections.abc import Callable
from math import nan, pi, radians, sin

import numpy as np

from . import injections as put
from .injections import Injection, together

Draw = Callable[[np.random.Generator, float, float], Injection]
"""Makes an injection between two times, its size by chance."""


def _sign(rng: np.random.Generator) -> float:
    return float(rng.choice([-1.0, 1.0]))


def _drawn_sine(rng: np.random.Generator, start_s: float, end_s: float) -> Injection:
    size, rate = radians(rng.uniform(2, 20)), rng.uniform(0.5, 3.0)
    return put.axis_off(lambda t: size * sin(rate * t), start_s, end_s)


DRAWS: dict[str, Draw] = {
    "gyro bias": lambda r, a, b: put.gyro_added(put.constant(_sign(r) * r.uniform(0.5, 15)), a),
    "gyro bias for a while": lambda r, a, b: put.gyro_added(put.constant(_sign(r) * r.uniform(2, 60)), a, b),
    "gyro drift": lambda r, a, b: put.gyro_added(put.ramp(_sign(r) * r.uniform(0.05, 1)), a),
    "gyro scale": lambda r, a, b: put.gyro_scaled(r.uniform(0.9, 1.1), a),
    "half turn": lambda r, a, b: put.gyro_added(put.constant(_sign(r) * r.uniform(120, 240)), a, a + 1.0),
    "gyro spikes": lambda r, a, b: put.gyro_spikes(_sign(r) * r.uniform(5, 35), r.uniform(0.005, 0.1), a, b),
    "gyro sample impossible": lambda r, a, b: put.gyro_once(_sign(r) * 10.0 ** r.uniform(1.5, 308), a),
    "gyro frozen": lambda r, a, b: put.repeated("imu", a, b),
    "gyro NaN": lambda r, a, b: put.gyro_mapped(lambda _: nan, a, b),
    "IMU dropout": lambda r, a, b: put.dropped("imu", a, b),
    "axis off": lambda r, a, b: put.axis_off(put.constant(_sign(r) * r.uniform(2, 80)), a, b),
    "axis turns off": lambda r, a, b: put.axis_off(put.ramp(_sign(r) * r.uniform(0.5, 8)), a, b),
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
        injections.append(
            DRAWS[name](rng, start_s, start_s + float(np.exp(rng.uniform(np.log(0.2), np.log(6.0)))))
        )
    return " + ".join(names), together(injections)
