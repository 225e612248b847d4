"""Simulated flights of the setting that the consistency benchmark asks for, and the estimator flown through them.

The sensors are those of `tests.fusion.simulated`, written apart from the filter.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import nan, radians
from typing import Any

import numpy as np
import numpy.typing as npt

from fusion import CorridorEstimator, FusionConfig
from fusion.estimator.lateral.smoother import OffsetSteps, at_times, smoothed_offsets
from fusion.estimator.lateral.updates import offset_model
from fusion.estimator.models import PSI
from fusion.estimator.smoother import Steps
from fusion.estimator.state import Entry
from tests.fusion.simulated import Scene, Simulated, config_for, drifting, give, simulate, weaving, wrap

FloatArray = npt.NDArray[np.float64]

EVERY_S = 0.05
SETTLED_S = 2.0  # errors count from here on
LATERAL_SPEED_M_S, HALF_WIDTH_M = 0.3, 1.1
CORRELATION = 0.5  # from frame to frame


def steel(seed: int, seconds: float) -> Callable[[FloatArray], FloatArray]:
    """Return the IMU yaw's offset: it jumps by 10 to 20 degrees every 4 to 12 s, and back."""
    rng = np.random.default_rng((seed, 5))
    times, offsets, t = [-1.0], [0.7], 0.0
    while t < seconds:
        t += rng.uniform(4.0, 12.0)
        size = radians(rng.uniform(10, 20)) * rng.choice([-1.0, 1.0])
        times.append(t)
        offsets.append(0.7 + size if len(times) % 2 == 0 else 0.7)
    starts, values = np.array(times), np.array(offsets)
    return lambda when: values[np.searchsorted(starts, np.asarray(when, float), side="right") - 1]


def scene_of(seed: int, seconds: float, **changes: Any) -> Scene:
    """Make a flight: 80 ms delay, 30 frames/s of 0.3 to 1 degree, 5 % gross, drop-outs to 5 s, tilt to 15, steel."""
    rng = np.random.default_rng(seed)
    dropouts = [
        (float(start), float(start + rng.uniform(1.0, 5.0))) for start in np.arange(8.0, seconds - 8.0, 15.0)
    ]
    values: dict[str, Any] = {
        "duration_s": seconds,
        "seed": seed,
        "heading": weaving(seed, radians(rng.uniform(5, 25)), rng.uniform(4, 10)),
        "tilt_rad": radians(15),
        "gyro_noise": 0.0075,
        "yaw_walk": 0.0075,
        "gyro_bias": float(rng.normal(0, 0.02)),
        "frame_correlation": CORRELATION,
        "gross": 0.05,
        "delay_s": 0.08,
        "dropouts": dropouts,
        "attitude_hz": 50.0,
        "yaw_offset": steel(seed, seconds),
        "half_width_m": HALF_WIDTH_M,
        "lateral": drifting(seed, LATERAL_SPEED_M_S / HALF_WIDTH_M, 1.0, seconds),
    }
    return Scene(**(values | changes))


def stamped_late(simulated: Simulated, late_s: float) -> Simulated:
    """Return the flight with its frames stamped, and arriving, later than they were taken."""
    late_ns = round(late_s * 1e9)
    samples = [
        replace(s, t_ns=s.t_ns + late_ns, arrival_ns=s.arrival_ns + late_ns) if s.kind == "frame" else s
        for s in simulated.samples
    ]
    return replace(simulated, samples=sorted(samples, key=lambda s: s.arrival_ns))


def told(scene: Scene) -> dict[str, Any]:
    """Return the settings that say over what time the frames' errors resemble each other."""
    rho = scene.frame_correlation
    time_s = -1.0 / (scene.frame_hz * np.log(rho)) if rho else 0.0
    return {"heading_correlation_s": time_s}


def settings(scene: Scene, **changes: Any) -> FusionConfig:
    """Return what a user would know of this scene's sensors."""
    known = {"imu_yaw_std_rad": scene.yaw_std_rad, "imu_yaw_walk": scene.yaw_walk}
    return config_for(scene, **(known | told(scene) | changes))


@dataclass(frozen=True, slots=True)
class Flown:
    """Errors (n,) and sigmas (n,) at times (n,), radians and half widths; smoothed ones beside the filter's."""

    t_s: FloatArray
    heading: FloatArray
    heading_std: FloatArray
    smoothed: FloatArray
    smoothed_std: FloatArray
    lateral: FloatArray
    lateral_std: FloatArray
    lateral_smoothed: FloatArray
    camera_delay_s: tuple[float, float] = (nan, nan)  # at the end, and its sigma


def fly(simulated: Simulated, config: FusionConfig, smooth: bool = True) -> Flown:
    """Run the estimator over the samples in order of arrival, and ask it every 50 ms."""
    steps, offset_steps, stamps = Steps(), OffsetSteps(), []

    def keep(entry: Entry) -> None:
        steps.add(entry.nodes)
        offset_steps.add(entry.t_ns, entry.after.lateral.step, entry.after.lateral.offset)
        stamps.extend([entry.t_ns] * len(entry.nodes))

    estimator = CorridorEstimator(config, on_final=keep if smooth else None)
    rows, next_s = [], SETTLED_S
    for sample in simulated.samples:
        give(estimator, sample)
        if sample.kind == "imu" and sample.t_ns * 1e-9 >= next_s:
            next_s += EVERY_S
            e = estimator.estimate()
            rows.append((e.timestamp_ns * 1e-9, e.heading_rad, e.heading_std_rad, e.lateral_offset_norm,
                         e.lateral_offset_norm_std))  # fmt: skip
    end = estimator.estimate()
    estimator.finish()
    t, heading, std, lateral, lateral_std = np.array(rows).T
    truth = np.interp(t, simulated.t_s, simulated.heading)
    offset = np.interp(t, simulated.t_s, simulated.lateral)
    smoothed = smoothed_std = lateral_smoothed = np.full(len(t), np.nan)
    if smooth:
        states = steps.smoothed()
        at = np.searchsorted(np.array(stamps) * 1e-9, t, side="right") - 1
        smoothed, smoothed_std = wrap(states.x[at, PSI] - truth), np.sqrt(states.variance[at, PSI])
        offsets = smoothed_offsets(offset_steps.steps, offset_model(config))
        found, _, known = at_times(np.array(offset_steps.t_ns) * 1e-9, offsets, t)
        lateral_smoothed = np.where(known, found, np.nan) - offset
    return Flown(
        t,
        wrap(heading - truth),
        std,
        smoothed,
        smoothed_std,
        lateral - offset,
        lateral_std,
        lateral_smoothed,
        (end.camera_delay_s, end.camera_delay_std_s),
    )


def recovery_s(seed: int, by_gyro: bool) -> float:
    """Inject a heading error of 30 to 90 degrees; return after how many seconds of good frames it is gone.

    The error is put into the filter's state, or (``by_gyro``) made by a gyroscope that claims such a turn within
    0.3 s. It is gone when the heading is right to three of the worst frame's standard deviations, and stays so.
    Infinite where it never is, or where the filter believes in another corridor.
    """
    rng = np.random.default_rng((seed, 7))
    error = radians(rng.uniform(30, 90)) * rng.choice([-1.0, 1.0])
    start_s, length_s = 6.0, 0.3 if by_gyro else 0.0
    scene = Scene(duration_s=12.0, seed=seed, heading=weaving(seed, radians(15)), gross=0.05)
    simulated = simulate(scene)
    estimator = CorridorEstimator(settings(scene))
    times, wrong = [], []
    injected = False
    for sample in simulated.samples:
        t = sample.t_ns * 1e-9
        if by_gyro and sample.kind == "imu" and start_s <= t < start_s + length_s:
            (p, q, r), accel = sample.values
            estimator.add_imu(sample.t_ns, (p, q, r + error / length_s), accel)
        else:
            give(estimator, sample)
        if not by_gyro and not injected and t >= start_s:
            timeline = estimator._timeline
            x = timeline.state.x
            timeline.state = timeline.state._replace(x=x + error * np.eye(len(x))[PSI])
            injected = True
        if sample.kind == "frame" and t > start_s + length_s:
            e = estimator.estimate()
            truth = float(np.interp(t, simulated.t_s, simulated.heading))
            times.append(t)
            wrong.append(abs(wrap(e.heading_rad - truth)) > radians(3) or e.corridor_index != 0)
    if wrong[-1]:
        return float("inf")
    last = int(np.flatnonzero(wrong)[-1]) + 1 if any(wrong) else 0
    good = simulated.frames[(simulated.frames[:, 3] == 0) & (simulated.frames[:, 0] > start_s + length_s)]
    return float((good[:, 0] <= times[last] + 1e-6).sum() / scene.frame_hz)


__all__ = [
    "EVERY_S",
    "SETTLED_S",
    "Flown",
    "fly",
    "recovery_s",
    "scene_of",
    "settings",
    "simulate",
    "stamped_late",
    "told",
]
