"""A vehicle in corridors, and what its sensors would say: written apart from the filter, from the definitions.

Heading in the world is a smooth function of time; corridors are directions in that world. Nothing here uses the
filter's models: body rates come from the Euler angles by the textbook kinematics, errors from their own draws.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from math import pi, radians
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from fusion.estimator.config import FusionConfig
from fusion.estimator.estimator import CorridorEstimator
from vision.lateral.mixture import OffsetMixture
from vision.measurement import FrameMeasurement, Reason

Function = Callable[[np.ndarray], np.ndarray]
FREE_NORM = 0.7  # how far from the centre line a vehicle strays, half widths


def wrap(angle: Any) -> Any:
    return (np.asarray(angle) + pi) % (2 * pi) - pi


def wrap_half(angle: Any) -> Any:
    return (np.asarray(angle) + pi / 2) % pi - pi / 2


def weaving(seed: int, amplitude_rad: float = radians(15), period_s: float = 6.0) -> Function:
    """Smooth wandering about zero: a few sinusoids of random phase."""
    rng = np.random.default_rng(seed)
    rates = 2 * pi / period_s * rng.uniform(0.4, 1.6, 4)
    phases = rng.uniform(0, 2 * pi, 4)
    weights = rng.uniform(0.5, 1.0, 4)
    weights *= amplitude_rad / weights.sum()
    return lambda t: (weights * np.sin(np.multiply.outer(t, rates) + phases)).sum(axis=-1)


def drifting(seed: int, std: float, time_s: float, duration_s: float) -> Function:
    """Position between the walls; its velocity is near to a first-order process of this deviation and time."""
    rng, dt = np.random.default_rng(seed), 0.002
    n = int(duration_s / dt) + 2
    keep = np.exp(-dt / time_s)
    velocity = np.empty(n)
    velocity[0] = rng.normal(0, std)
    kicks = rng.normal(0, std * np.sqrt(1 - keep**2), n)
    for i in range(1, n):
        velocity[i] = keep * velocity[i - 1] + kicks[i]
    position, times = np.cumsum(velocity) * dt, np.arange(n) * dt
    between = FREE_NORM * np.sin(
        (position - position.mean()) / FREE_NORM
    )  # alone, it would stray through a wall
    return lambda t: np.interp(t, times, between)


def turning(*turns: tuple[float, float, float]) -> Function:
    """Sum of smooth turns (start s, length s, angle rad)."""

    def heading(t: np.ndarray) -> np.ndarray:
        total = np.zeros_like(np.asarray(t, float))
        for start, length, angle in turns:
            part = np.clip((t - start) / length, 0, 1)
            total = total + angle * (part - np.sin(2 * pi * part) / (2 * pi))
        return total

    return heading


def plus(*functions: Function) -> Function:
    return lambda t: sum((f(t) for f in functions), start=np.zeros_like(np.asarray(t, float)))


@dataclass
class Scene:
    """What flies and what senses; see `simulate`."""

    duration_s: float = 20.0
    seed: int = 0
    heading: Function = field(default_factory=lambda: weaving(0))
    axis: Function = field(default=lambda t: np.zeros_like(np.asarray(t, float)))  # that frames see
    tilt_rad: float = radians(10)
    gyro_hz: float = 200.0
    gyro_noise: float = 0.0075
    gyro_bias: float = 0.01
    gyro_bias_walk: float = 1e-4
    frame_hz: float = 30.0
    frame_sigma_rad: tuple[float, float] = (radians(0.3), radians(1.0))
    frame_correlation: float = 0.0
    gross: float = 0.0
    gross_rad: float = radians(60)
    dropouts: Sequence[tuple[float, float]] = ()
    delay_s: float = 0.0
    attitude_hz: float = 0.0
    attitude_std_rad: float = radians(0.2)
    yaw_offset: Function = field(default=lambda t: np.full_like(np.asarray(t, float), 0.7))
    yaw_walk: float = 0.002
    yaw_std_rad: float = radians(0.2)
    yaw_shares_gyro: bool = False
    accel: bool = False  # of gravity and the lateral motion, which must be smooth then
    half_width_m: float = 1.1
    speed_m_s: float = 0.0
    lateral: Function = field(
        default_factory=lambda: weaving(99, amplitude_rad=0.5, period_s=9.0)
    )  # half widths
    lateral_sigma: float = 0.02


@dataclass
class Sample:
    kind: str
    t_ns: int
    arrival_ns: int
    values: tuple[Any, ...]


@dataclass
class Simulated:
    scene: Scene
    t_s: np.ndarray
    t_ns: np.ndarray
    heading: np.ndarray  # in the world, unwrapped
    lateral: np.ndarray
    bias: np.ndarray
    level_rate: np.ndarray  # as the gyroscope gives it, bias and noise included
    frames: np.ndarray  # time s, heading seen, sigma, whether it is gross
    samples: list[Sample]  # in order of arrival

    def heading_in(self, axis_rad: Any) -> np.ndarray:
        return np.asarray(wrap(self.heading - axis_rad))


def simulate(scene: Scene) -> Simulated:
    rng = np.random.default_rng(scene.seed + 1000)
    dt = 1 / scene.gyro_hz
    t = np.arange(round(scene.duration_s * scene.gyro_hz) + 1) * dt
    t_ns = np.round(t * 1e9).astype(np.int64)
    roll_of, pitch_of = (
        weaving(scene.seed + 1, scene.tilt_rad, 3.0),
        weaving(scene.seed + 2, scene.tilt_rad, 4.0),
    )

    def rate(f: Function, at: np.ndarray) -> np.ndarray:
        h = 1e-4
        return np.asarray((f(at + h) - f(at - h)) / (2 * h))

    psi, roll, pitch = scene.heading(t), roll_of(t), pitch_of(t)
    dpsi, droll, dpitch = rate(scene.heading, t), rate(roll_of, t), rate(pitch_of, t)
    true_rates = np.stack(
        [
            droll - dpsi * np.sin(pitch),
            dpitch * np.cos(roll) + dpsi * np.sin(roll) * np.cos(pitch),
            -dpitch * np.sin(roll) + dpsi * np.cos(roll) * np.cos(pitch),
        ],
        axis=1,
    )
    down = np.stack([-np.sin(pitch), np.sin(roll) * np.cos(pitch), np.cos(roll) * np.cos(pitch)], axis=1)
    # Error of the level yaw rate, put on the vertical through the body: level rate = true + bias + noise exactly.
    bias = scene.gyro_bias + np.cumsum(rng.normal(0, scene.gyro_bias_walk * np.sqrt(dt), len(t)))
    noise = rng.normal(0, scene.gyro_noise / np.sqrt(dt), len(t))
    gyro = true_rates + (bias + noise)[:, None] * down
    samples: list[Sample] = []
    force = _specific_force(scene, t, psi, roll, pitch) if scene.accel else None
    for i in range(len(t)):
        accel = None if force is None else tuple((force[i] + rng.normal(0, 0.05, 3)).tolist())
        samples.append(Sample("imu", int(t_ns[i]), int(t_ns[i]), (tuple(gyro[i].tolist()), accel)))
    _attitudes(
        scene, np.random.default_rng(scene.seed + 2000), t, np.cumsum(noise) * dt, samples, roll_of, pitch_of
    )
    frames = _frames(scene, np.random.default_rng(scene.seed + 3000), samples)
    samples.sort(key=lambda s: s.arrival_ns)
    return Simulated(scene, t, t_ns, psi, scene.lateral(t), bias, dpsi + bias + noise, frames, samples)


def _specific_force(
    scene: Scene, t: np.ndarray, psi: np.ndarray, roll: np.ndarray, pitch: np.ndarray
) -> np.ndarray:
    """Acceleration across the corridor less gravity, m/s^2, in the body (n, 3)."""
    h = 1e-3
    across = scene.half_width_m * (scene.lateral(t + h) - 2 * scene.lateral(t) + scene.lateral(t - h)) / h**2
    relative = psi - scene.axis(t)
    level = np.stack(
        [across * np.sin(relative), across * np.cos(relative), np.full_like(t, -9.80665)], axis=1
    )
    body_to_level = Rotation.from_euler("ZYX", np.stack([np.zeros_like(t), pitch, roll], axis=1))
    return np.asarray(body_to_level.inv().apply(level))


def _attitudes(
    scene: Scene,
    rng: np.random.Generator,
    t: np.ndarray,
    gyro_drift: np.ndarray,
    samples: list[Sample],
    roll_of: Function,
    pitch_of: Function,
) -> None:
    if not scene.attitude_hz:
        return
    at = np.arange(0, scene.duration_s, 1 / scene.attitude_hz)
    drift = np.cumsum(rng.normal(0, scene.yaw_walk / np.sqrt(scene.attitude_hz), len(at)))
    if scene.yaw_shares_gyro:
        drift = drift + np.interp(at, t, gyro_drift)
    yaw = scene.heading(at) + scene.yaw_offset(at) + drift + rng.normal(0, scene.yaw_std_rad, len(at))
    roll = roll_of(at) + rng.normal(0, scene.attitude_std_rad, len(at))
    pitch = pitch_of(at) + rng.normal(0, scene.attitude_std_rad, len(at))
    for i, when in enumerate(at):
        stamp = round(float(when) * 1e9)
        samples.append(Sample("attitude", stamp, stamp, (quaternion(roll[i], pitch[i], yaw[i]),)))


def quaternion(roll: float, pitch: float, yaw: float) -> tuple[float, float, float, float]:
    """Quaternion w, x, y, z of Z-Y-X Euler angles."""
    cr, sr, cp, sp = np.cos(roll / 2), np.sin(roll / 2), np.cos(pitch / 2), np.sin(pitch / 2)
    cy, sy = np.cos(yaw / 2), np.sin(yaw / 2)
    return (
        float(cr * cp * cy + sr * sp * sy),
        float(sr * cp * cy - cr * sp * sy),
        float(cr * sp * cy + sr * cp * sy),
        float(cr * cp * sy - sr * sp * cy),
    )


def _frames(scene: Scene, rng: np.random.Generator, samples: list[Sample]) -> np.ndarray:
    rows = []
    error = lateral_error = 0.0
    for k in range(int(scene.duration_s * scene.frame_hz)):
        when = (k + 0.37) / scene.frame_hz
        sigma = rng.uniform(*scene.frame_sigma_rad)
        rho = scene.frame_correlation
        error = rho * error + np.sqrt(1 - rho**2) * rng.normal()
        lateral_error = rho * lateral_error + np.sqrt(1 - rho**2) * rng.normal()
        is_gross, wrong = rng.uniform() < scene.gross, rng.uniform(-scene.gross_rad, scene.gross_rad)
        if any(a <= when < b for a, b in scene.dropouts):
            continue
        relative = float(scene.heading(np.array(when)) - scene.axis(np.array(when)))
        offset = float(scene.lateral(np.array(when)))
        seen = wrap_half(relative + (wrong if is_gross else sigma * error))
        lateral = (1 if np.cos(relative) > 0 else -1) * offset + scene.lateral_sigma * lateral_error
        if is_gross:
            lateral = rng.uniform(-1, 1)
        measurement = frame(float(seen), sigma, float(lateral), scene.lateral_sigma)
        stamp = round(float(when) * 1e9)
        samples.append(Sample("frame", stamp, stamp + int(scene.delay_s * 1e9), (measurement,)))
        rows.append((when, seen, sigma, float(is_gross)))
    return np.array(rows).reshape(-1, 4)


def frame(
    heading_rad: float,
    std_rad: float = radians(0.5),
    lateral: float = float("nan"),
    lateral_std: float = float("nan"),
    **changes: Any,
) -> FrameMeasurement:
    values: dict[str, Any] = {
        "accepted": True,
        "reason": Reason.OK,
        "n_lines": 60,
        "n_inliers": 30,
        "heading_rad": heading_rad,
        "heading_std_rad": std_rad,
        "lateral_offset_norm": lateral,
        "lateral_offset_norm_std": lateral_std,
    }
    return FrameMeasurement(**(values | changes))


def mirrored(s: Sample) -> Sample:
    """What the same sensors would say in a world seen in a mirror that swaps left and right."""
    if s.kind == "imu":
        (p, q, r), accel = s.values
        return replace(s, values=((-p, q, -r), accel and (accel[0], -accel[1], accel[2])))
    if s.kind == "attitude":
        w, x, y, z = s.values[0]
        return replace(s, values=((w, -x, y, -z),))
    if s.kind == "velocity":
        x, y, z = s.values[0]
        return replace(s, values=((x, -y, z),))
    m = s.values[0]
    evidence = tuple(replace(e, offset_norm=-e.offset_norm) for e in m.offset_evidence)
    sides = {"heading_rad": -m.heading_rad, "lateral_offset_norm": -m.lateral_offset_norm}
    walls = None if m.wall_profiles is None else m.wall_profiles[::-1].copy()
    return replace(s, values=(replace(m, offset_evidence=evidence, wall_profiles=walls, **sides),))


def two_places(offset: float, other: float, weight: float = 0.7, std: float = 0.02) -> OffsetMixture:
    """What a frame says that leaves open which of two offsets is right, the first with this probability."""
    nan = np.full(2, np.nan)
    return OffsetMixture(np.array([weight, 0.9 - weight]), np.array([offset, other]), np.full(2, std), nan)


def give(estimator: CorridorEstimator, sample: Sample) -> None:
    if sample.kind == "imu":
        estimator.add_imu(sample.t_ns, *sample.values)
    elif sample.kind == "attitude":
        estimator.add_attitude(sample.t_ns, *sample.values)
    elif sample.kind == "velocity":
        estimator.add_velocity(sample.t_ns, *sample.values)
    elif sample.kind == "range":
        estimator.add_range(sample.t_ns, *sample.values)
    else:
        estimator.add_measurement(sample.t_ns, *sample.values)


@dataclass
class Run:
    estimator: CorridorEstimator
    t_s: np.ndarray
    heading: np.ndarray
    std: np.ndarray
    lateral: np.ndarray
    lateral_std: np.ndarray
    corridor: np.ndarray
    turn: np.ndarray
    status: np.ndarray


def config_for(scene: Scene, **changes: Any) -> FusionConfig:
    values: dict[str, Any] = {
        "gyro_noise_density": scene.gyro_noise,
        "gyro_bias_walk": scene.gyro_bias_walk,
        "corridor_width_m": 2 * scene.half_width_m,
        "heading_correlation_s": 0.0,
    }
    return FusionConfig(**(values | changes))


def run(
    simulated: Simulated, config: FusionConfig | None = None, kinds: Sequence[str] = (), every: int = 10
) -> Run:
    """Drive the estimator in order of arrival; note the estimate at every n-th sample of the first kind given."""
    estimator = CorridorEstimator(config or config_for(simulated.scene))
    kinds = kinds or ("imu", "attitude", "velocity", "frame")
    clock = kinds[0]
    rows = list(_rows(estimator, simulated.samples, kinds, clock, every))
    columns = [np.array(column) for column in zip(*rows, strict=True)]
    return Run(estimator, *columns)


def _rows(
    estimator: CorridorEstimator, samples: Sequence[Sample], kinds: Sequence[str], clock: str, every: int
) -> Iterator[tuple[Any, ...]]:
    count = 0
    for sample in samples:
        if sample.kind not in kinds:
            continue
        give(estimator, sample)
        if sample.kind == clock:
            count += 1
            if count % every == 0:
                e = estimator.estimate()
                yield (
                    e.timestamp_ns * 1e-9,
                    e.heading_rad,
                    e.heading_std_rad,
                    e.lateral_offset_norm,
                    e.lateral_offset_norm_std,
                    e.corridor_index,
                    e.corridor_turn_rad,
                    e.status,
                )


def heading_error(result: Run, simulated: Simulated, axis_rad: Any = 0.0) -> np.ndarray:
    """Estimate minus truth at each row, wrapped."""
    truth = np.interp(result.t_s, simulated.t_s, simulated.heading)
    return np.asarray(wrap(result.heading - truth + axis_rad))
