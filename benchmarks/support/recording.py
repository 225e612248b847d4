"""A flight as the samples that reached the estimator, and what was true: what faults are put into.

Simulated flights come from `tests.fusion.simulated`, logged ones from a flight folder, whose pictures are measured
once.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import radians
from pathlib import Path
from typing import Any, Literal, cast

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from fusion import CorridorEstimator, FusionConfig, load_flight
from fusion.flight import Flight
from tests.fusion.simulated import Scene, Simulated, config_for, simulate, weaving
from vision import InputError

FloatArray = npt.NDArray[np.float64]
Kind = Literal["imu", "attitude", "velocity", "frame"]

FRAME_LATENCY_S = 0.05  # from mid-exposure to the estimator; stamps are right
ELEVATION_STD_RAD = radians(0.2)


@dataclass(frozen=True, slots=True, eq=False)
class Event:
    """A sample on its way to the estimator.

    Parameters
    ----------
    kind
        Which of the estimator's ``add_`` methods takes it.
    true_ns, stamp_ns, arrival_ns
        When it was measured, what its stamp says, and when it arrives.
    values
        Arguments behind the time.
    is_gross
        Whether it is a frame of a wrong direction: background errors that no fault has put in.
    """

    kind: Kind
    true_ns: int
    stamp_ns: int
    arrival_ns: int
    values: tuple[Any, ...]
    is_gross: bool = False

    @property
    def t_s(self) -> float:
        """Time of measurement, s."""
        return self.true_ns * 1e-9

    def give(self, estimator: CorridorEstimator) -> None:
        """Hand the sample to an estimator."""
        if self.kind == "imu":
            estimator.add_imu(self.stamp_ns, *self.values)
        elif self.kind == "attitude":
            estimator.add_attitude(self.stamp_ns, *self.values)
        elif self.kind == "velocity":
            estimator.add_velocity(self.stamp_ns, *self.values)
        else:
            estimator.add_measurement(self.stamp_ns, *self.values)


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """Events in order of arrival; truth (n,) at times (n,) s: heading and offset in the corridor flown, and tilt.

    ``simulated`` is what an oracle needs; None where the flight was logged.
    """

    events: tuple[Event, ...]
    config: FusionConfig
    t_s: FloatArray
    heading_rad: FloatArray
    lateral_norm: FloatArray
    roll_rad: FloatArray
    pitch_rad: FloatArray
    simulated: Simulated | None = None

    def with_events(self, events: list[Event]) -> Recording:
        """Return the same flight with other samples."""
        return replace(self, events=tuple(sorted(events, key=lambda e: e.arrival_ns)))


def base_scene(seed: int, seconds: float, **changes: Any) -> Scene:
    """Make a scene without faults: everything a vehicle has, all of it as told, 3 % of the frames gross."""
    values: dict[str, Any] = {
        "duration_s": seconds,
        "seed": seed,
        "heading": weaving(seed, radians(12), 6.0),
        "frame_sigma_rad": (radians(0.5), radians(0.5)),
        "gross": 0.03,
        "delay_s": FRAME_LATENCY_S,
        "attitude_hz": 50.0,
        "accel": True,
    }
    return Scene(**(values | changes))


def simulated_recording(scene: Scene, **config: Any) -> Recording:
    """Simulate a scene, as the estimator is told of it: noise as it is, correlation as by default."""
    simulated = simulate(scene)
    gross = {round(row[0] * 1e9): bool(row[3]) for row in simulated.frames.tolist()}
    rng = np.random.default_rng((scene.seed, 11))
    events = []
    for s in simulated.samples:
        values = s.values
        if s.kind == "frame":
            elevation = float(rng.normal(0.0, ELEVATION_STD_RAD))
            measurement = replace(values[0], elevation_rad=elevation, elevation_std_rad=ELEVATION_STD_RAD)
            values = (measurement,)
        kind = cast(Kind, s.kind)
        events.append(Event(kind, s.t_ns, s.t_ns, s.arrival_ns, values, gross.get(s.t_ns, False)))
    told: dict[str, Any] = {
        "imu_yaw_std_rad": scene.yaw_std_rad,
        "imu_yaw_walk": max(scene.yaw_walk, 1e-4),
        "heading_correlation_s": FusionConfig().heading_correlation_s,
    }
    roll, pitch = (weaving(scene.seed + k, scene.tilt_rad, 2.0 + k)(simulated.t_s) for k in (1, 2))
    heading = simulated.heading - scene.axis(simulated.t_s)
    return Recording(
        tuple(events),
        config_for(scene, **(told | config)),
        simulated.t_s,
        heading,
        simulated.lateral,
        roll,
        pitch,
        simulated,
    )


def logged_recording(folder: Path) -> Recording:
    """Read a flight folder with ``corridor_truth.csv`` and measure its pictures once, in an undisturbed flight.

    Raises
    ------
    InputError
        Where the log lacks what faults are put into: truth, IMU and attitude.
    """
    flight = load_flight(folder)
    if flight.truth is None or flight.imu is None or flight.attitude is None:
        raise InputError(f"{folder}: truth, IMU or attitude is missing", remedy="use a simulated flight")
    zero = int(flight.imu.t_ns[0])
    truth = flight.truth
    half_m = 0.5 * truth.corridor_width_m
    angles = Rotation.from_quat(flight.attitude.q_world_body, scalar_first=True).as_euler("ZYX")
    t_s = np.asarray((truth.t_ns - zero) * 1e-9, dtype=np.float64)
    attitude_s = (flight.attitude.t_ns - zero) * 1e-9
    config = FusionConfig(
        corridor_width_m=float(truth.corridor_width_m[0]),
        gyro_noise_density=flight.imu.gyro_noise_density,
        gyro_bias_walk=flight.imu.gyro_random_walk,
    )
    return Recording(
        tuple(_logged_events(flight, config, zero)),
        config,
        t_s,
        np.unwrap(truth.heading_rad),
        truth.lateral_offset_m / half_m,
        np.interp(t_s, attitude_s, angles[:, 2]),
        np.interp(t_s, attitude_s, angles[:, 1]),
    )


def _logged_events(flight: Flight, config: FusionConfig, zero_ns: int) -> list[Event]:
    """Return a flight's events in order of arrival, times from its first IMU sample on."""
    assert flight.imu is not None
    assert flight.attitude is not None
    latency_ns = round(FRAME_LATENCY_S * 1e9)
    events = []
    for t_ns, gyro, accel in zip(
        (flight.imu.t_ns - zero_ns).tolist(),
        flight.imu.gyro_rad_s.tolist(),
        flight.imu.accel_m_s2.tolist(),
        strict=True,
    ):
        events.append(Event("imu", t_ns, t_ns, t_ns, (tuple(gyro), tuple(accel))))
    for t_ns, q in zip(
        (flight.attitude.t_ns - zero_ns).tolist(), flight.attitude.q_world_body.tolist(), strict=True
    ):
        events.append(Event("attitude", t_ns, t_ns, t_ns, (tuple(q),)))
    estimator = CorridorEstimator(config, flight.camera)
    frames = []
    pending = sorted(events, key=lambda e: e.stamp_ns)
    for k, t_ns in enumerate((flight.frames.t_ns - zero_ns).tolist()):
        while pending and pending[0].stamp_ns <= t_ns:
            pending.pop(0).give(estimator)
        measured = estimator.add_frame(t_ns, flight.frames.read(k)).measurement
        if measured is not None and t_ns >= 0:
            frames.append(Event("frame", t_ns, t_ns, t_ns + latency_ns, (measured.without_lines(),)))
    return sorted([*events, *frames], key=lambda e: e.arrival_ns)
