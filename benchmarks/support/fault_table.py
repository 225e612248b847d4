"""All faults, singly and in pairs: within 1.5 times a good system, or told within half a second."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from .fault_score import Bound, Fault
from .faults_in_flight import BIAS, CLOCK, FROZEN, HALF_TURN, IMPOSSIBLE, QUIET, REFUSED, WRONG_AXIS
from .faults_of_input import DEAD, DELAY, HANDED_OVER, LATERAL, STATISTICS, VALUES, YAW
from .faults_of_vehicle import VEHICLE
from .injections import Injection, together

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
    *VEHICLE,
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
]


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
