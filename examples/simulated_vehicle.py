"""The world for `control_loop.py`: a multirotor between rendered walls, and what its sensors say.

Nothing here knows the estimator. World z down, x along the first corridor, y right of it; body FRD.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace
from math import atan, cos, exp, inf, pi, radians, sin, sqrt, tan
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fusion.simulate import SimulationConfig
from fusion.simulate.config import rotation
from fusion.simulate.imu import quaternions
from fusion.simulate.motion import GRAVITY_M_S2, plan_flight
from fusion.simulate.render.view import View, exposure_moments, render_linear
from fusion.simulate.scene.build import Scene, build_scene
from fusion.simulate.scene.plan import Meeting, Room, floor_plan
from fusion.simulate.sensor import Sensor, mean_radiance, through_jpeg
from vision import Camera

FloatArray = npt.NDArray[np.float64]
Image = npt.NDArray[np.uint8]

MAX_STEP_S = 0.0025
YAW_LAG_S = 0.12
SPEED_LAG_S = 0.5
MAX_ACCELERATION_M_S2 = 2.5
TILT_PER_S = 12.0  # natural frequency of the attitude loop, critically damped
GUST_M_S2, GUST_TIME_S = 0.1, 1.0
START_OFFSET_M, START_YAW_RAD = 0.35, radians(8)
FLOW_HZ, FLOW_STD_M_S = 25.0, 0.05
NEAR_M = 1.0  # how near the things are that speed blurs


def junction_config(
    turn_rad: float = -pi / 2,
    size_px: tuple[int, int] = (320, 240),
    frame_hz: float = 20.0,
    seed: int = 3,
    start_m: float = 3.0,
) -> SimulationConfig:
    """Return a corridor with a side corridor after 12 m, and the camera, IMU and attitude filter that fly there."""
    return SimulationConfig.from_values(
        {
            "seed": seed,
            "scene": {
                "length_m": 18.0,
                "junctions": [{"at_m": 12.0, "angle_rad": turn_rad, "width_m": 2.2, "length_m": 16.0}],
            },
            "motion": {"route": [2], "start_m": start_m},
            "camera": {"width_px": size_px[0], "height_px": size_px[1], "rate_hz": frame_hz},
            "light_cell_m": 0.25,
        }
    )


@dataclass(frozen=True, slots=True)
class Body:
    """The vehicle's true state at an instant: metres, radians, seconds; rates are those of the Euler angles."""

    t_s: float
    x: float
    y: float
    height: float
    yaw: float
    vx: float = 0.0
    vy: float = 0.0
    pitch: float = 0.0
    roll: float = 0.0
    yaw_rate: float = 0.0
    pitch_rate: float = 0.0
    roll_rate: float = 0.0
    ax: float = 0.0
    ay: float = 0.0

    def rotation(self) -> FloatArray:
        """R_world_body (3, 3)."""
        return rotation(self.yaw, self.pitch, self.roll)

    def rates(self) -> FloatArray:
        """Body rates (3,) that a perfect gyroscope reads."""
        sr, cr, sp, cp = sin(self.roll), cos(self.roll), sin(self.pitch), cos(self.pitch)
        return np.array(
            [
                self.roll_rate - self.yaw_rate * sp,
                self.pitch_rate * cr + self.yaw_rate * sr * cp,
                self.yaw_rate * cr * cp - self.pitch_rate * sr,
            ]
        )

    def shifted(self, dt_s: float) -> Body:
        """Carry on at constant rates, for the short time of an exposure."""
        return replace(
            self,
            t_s=self.t_s + dt_s,
            x=self.x + dt_s * self.vx,
            y=self.y + dt_s * self.vy,
            yaw=self.yaw + dt_s * self.yaw_rate,
            pitch=self.pitch + dt_s * self.pitch_rate,
            roll=self.roll + dt_s * self.roll_rate,
        )


def flown(
    body: Body, dt_s: float, yaw_rate_rad_s: float, speed_m_s: float, gust_m_s2: tuple[float, float]
) -> Body:
    """Fly on for ``dt_s`` under a command.

    The yaw rate follows with a lag. The vehicle's own speed loop asks for accelerations, which come from tilting the
    thrust, so that roll and pitch go with every manoeuvre; gusts push besides.
    """
    c, s = cos(body.yaw), sin(body.yaw)
    forward, right = c * body.vx + s * body.vy, c * body.vy - s * body.vx
    pitch, pitch_rate = _tilted(body.pitch, body.pitch_rate, -_tilt_for(speed_m_s - forward), dt_s)
    roll, roll_rate = _tilted(body.roll, body.roll_rate, _tilt_for(-right), dt_s)
    push, slide = -GRAVITY_M_S2 * tan(pitch), GRAVITY_M_S2 * tan(roll) / cos(pitch)
    ax, ay = c * push - s * slide + gust_m_s2[0], s * push + c * slide + gust_m_s2[1]
    vx, vy = body.vx + dt_s * ax, body.vy + dt_s * ay
    yaw_rate = body.yaw_rate + dt_s / YAW_LAG_S * (yaw_rate_rad_s - body.yaw_rate)
    return Body(
        body.t_s + dt_s,
        body.x + dt_s * vx,
        body.y + dt_s * vy,
        body.height,
        body.yaw + dt_s * yaw_rate,
        vx,
        vy,
        pitch,
        roll,
        yaw_rate,
        pitch_rate,
        roll_rate,
        ax,
        ay,
    )


def _tilt_for(speed_error_m_s: float) -> float:
    acceleration = min(max(speed_error_m_s / SPEED_LAG_S, -MAX_ACCELERATION_M_S2), MAX_ACCELERATION_M_S2)
    return atan(acceleration / GRAVITY_M_S2)


def _tilted(angle: float, rate: float, wanted: float, dt_s: float) -> tuple[float, float]:
    rate += dt_s * TILT_PER_S * (TILT_PER_S * (wanted - angle) - 2 * rate)
    return angle + dt_s * rate, rate


class Eye:
    """The vehicle's camera: renders what it sees from the true pose.

    Parameters
    ----------
    config
        Scene, lens and picture chain. The scene is furnished clear of the way that the configuration would fly.
    """

    def __init__(self, config: SimulationConfig) -> None:
        rooms, meetings = floor_plan(config.scene)
        way = plan_flight(config.motion, rooms, meetings, config.seed)
        path = way.position(np.arange(0.0, way.duration_s, 0.1))
        self.camera: Camera = config.camera.camera()
        self._config = config
        self._scene: Scene = build_scene(config.scene, config.seed, config.light_cell_m, path)
        self._view = View.of(self.camera)
        small = View.of(self.camera.resized(self.camera.width_px // 4, self.camera.height_px // 4))
        level = [  # the exposure is set once, for the whole flight
            mean_radiance(render_linear(self._scene.mesh, small, [place], [np.eye(3)], 1))
            for place in path[:: max(1, len(path) // 5)]
        ]
        self._sensor = Sensor.of(config.imaging, self._view, float(np.mean(level)))
        self._rng = np.random.default_rng((config.seed, 9))

    def picture(self, body: Body) -> Image:
        """Take a picture (h, w) whose exposure has its middle now: blurred by motion, noisy, through JPEG."""
        exposure_s = self.camera.exposure_s
        speed = sqrt(body.vx**2 + body.vy**2)
        turned = (float(np.linalg.norm(body.rates())) + 0.5 * speed / NEAR_M) * exposure_s
        moments, grid = exposure_moments(self._view, exposure_s, turned, self._config.edge_samples)
        poses = [body.shifted(moment) for moment in moments.tolist()]
        rotations = [pose.rotation() for pose in poses]
        origins = [
            np.array([pose.x, pose.y, -pose.height]) + R @ self.camera.p_body_camera_m
            for pose, R in zip(poses, rotations, strict=True)
        ]
        radiance = render_linear(self._scene.mesh, self._view, origins, rotations, grid)
        return through_jpeg(self._sensor.develop(radiance, self._rng), self._config.imaging.jpeg_quality)


class Vehicle:
    """A multirotor in the rooms of a scene, with gyroscope, accelerometer, attitude filter and optical flow.

    Parameters
    ----------
    config
        The scene's floor plan, the sensors' errors, and where the flight starts.
    """

    def __init__(self, config: SimulationConfig) -> None:
        if config.imu is None or config.attitude is None:
            raise ValueError("the vehicle needs an IMU and an attitude filter")
        self._imu, self._ahrs = config.imu, config.attitude
        self.rooms, self.meetings = floor_plan(config.scene)
        self._rng = rng = np.random.default_rng((config.seed, 20))
        x, y = self.rooms[0].to_world(config.motion.start_m, START_OFFSET_M).tolist()
        self.body = Body(0.0, x, y, config.motion.height_m, START_YAW_RAD)
        self._gyro_bias = rng.normal(0.0, self._imu.gyro_bias_std_rad_s, 3)
        self._accel_bias = rng.normal(0.0, self._imu.accel_bias_std_m_s2, 3)
        self._gust = rng.normal(0.0, GUST_M_S2, 2)
        self._tilt_error = rng.normal(0.0, self._ahrs.tilt_std_rad, 2)
        self._yaw_error = float(rng.uniform(-pi, pi))

    def fly(self, dt_s: float, yaw_rate_rad_s: float, speed_m_s: float) -> None:
        """Carry on for ``dt_s`` under a command."""
        steps = max(1, round(dt_s / MAX_STEP_S))
        keep = exp(-dt_s / GUST_TIME_S)
        self._gust = keep * self._gust + self._rng.normal(0.0, GUST_M_S2 * sqrt(1 - keep * keep), 2)
        gust = (float(self._gust[0]), float(self._gust[1]))
        for _ in range(steps):
            self.body = flown(self.body, dt_s / steps, yaw_rate_rad_s, speed_m_s, gust)

    def read_imu(self, dt_s: float) -> tuple[FloatArray, FloatArray]:
        """Gyroscope and accelerometer (3,) each, sampled every ``dt_s``."""
        imu, rng = self._imu, self._rng
        self._gyro_bias = self._gyro_bias + rng.normal(0.0, imu.gyro_random_walk * sqrt(dt_s), 3)
        gyro = self.body.rates() + self._gyro_bias + rng.normal(0.0, imu.gyro_noise_density / sqrt(dt_s), 3)
        force = self.body.rotation().T @ np.array([self.body.ax, self.body.ay, -GRAVITY_M_S2])
        return gyro, force + self._accel_bias + rng.normal(0.0, imu.accel_noise_density / sqrt(dt_s), 3)

    def read_attitude(self, dt_s: float) -> FloatArray:
        """Attitude filter's quaternion (4,): tilt wanders about the truth, yaw is off by anything, and drifts."""
        ahrs, rng = self._ahrs, self._rng
        keep = exp(-dt_s / ahrs.tilt_time_s)
        self._tilt_error = keep * self._tilt_error + rng.normal(0.0, ahrs.tilt_std_rad * sqrt(1 - keep**2), 2)
        self._yaw_error += ahrs.yaw_drift_rad_s * dt_s + float(rng.normal(0.0, ahrs.yaw_walk * sqrt(dt_s)))
        a, b = self._tilt_error.tolist()
        wrong = rotation(self._yaw_error, 0.0, 0.0) @ rotation(0.0, b, a)
        return np.asarray(quaternions((wrong @ self.body.rotation())[None])[0])

    def read_flow(self) -> FloatArray:
        """Velocity (3,) in the body, as optical flow and a range finder give it."""
        velocity = self.body.rotation().T @ np.array([self.body.vx, self.body.vy, 0.0])
        return np.asarray(velocity + self._rng.normal(0.0, FLOW_STD_M_S, 3))

    def in_room(self, number: int) -> tuple[float, float, float]:
        """Metres along and right of a room's centre line, and heading relative to it."""
        room, body = self.rooms[number], self.body
        s, y = room.to_room([body.x, body.y])[0].tolist()
        return s, y, (body.yaw - room.yaw_rad + pi) % (2 * pi) - pi

    def clearance_m(self) -> float:
        """Distance to the nearest wall, at least; negative inside one."""
        return max(self._inside(room) for room in self.rooms if room.is_corridor)

    def _inside(self, room: Room) -> float:
        s, y = room.to_room([self.body.x, self.body.y])[0].tolist()
        return float(min(room.width_m / 2 - abs(y), s, room.length_m - s))

    def to_junction_m(self) -> float:
        """Metres to go along the first corridor to where the centre lines meet; infinite where none do."""
        ahead: Meeting | None = next((m for m in self.meetings if m.parent == 0), None)
        return inf if ahead is None else ahead.parent_s_m - self.in_room(0)[0]


class Samples(NamedTuple):
    """What the sensors have ready in a control period; pictures come with the time of their exposure."""

    imu: tuple[FloatArray, FloatArray]
    attitude: FloatArray | None
    flow: FloatArray | None
    pictures: list[tuple[int, Image]]


class World:
    """Vehicle and camera, moved on by one control period at a time.

    Parameters
    ----------
    config
        Scene, camera and sensors.
    start_ns, period_ns
        Time at the start, and length of a control period.
    transfer_s
        How much later than its exposure a picture is delivered.
    has_flow
        Whether there is optical flow.
    blackout_s
        From when to when the camera sees nothing.
    """

    def __init__(
        self,
        config: SimulationConfig,
        start_ns: int,
        period_ns: int,
        transfer_s: float,
        has_flow: bool = True,
        blackout_s: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        self.eye, self.vehicle = Eye(config), Vehicle(config)
        self.now_ns, self.period_ns, self.n_pictures = start_ns, period_ns, 0
        self._start_ns, self._transfer_ns = start_ns, round(transfer_s * 1e9)
        self._blackout_s, self._dark = blackout_s, np.zeros_like(self.eye.picture(self.vehicle.body))
        attitude_hz = config.attitude.rate_hz if config.attitude else 50.0
        rates_hz = {
            "attitude": attitude_hz,
            "flow": FLOW_HZ if has_flow else 0.0,
            "eye": config.camera.rate_hz,
        }
        self._interval_ns = {name: round(1e9 / hz) for name, hz in rates_hz.items() if hz > 0}
        self._due_ns = {name: start_ns + interval for name, interval in self._interval_ns.items()}
        self._on_the_way: deque[tuple[int, Image]] = deque()

    def advance(self, yaw_rate_rad_s: float, speed_m_s: float) -> Samples:
        """Fly for a period under a command, and read what is due then."""
        self.now_ns += self.period_ns
        now_s, dt_s = (self.now_ns - self._start_ns) * 1e-9, self.period_ns * 1e-9
        self.vehicle.fly(dt_s, yaw_rate_rad_s, speed_m_s)
        if self._is_due("eye"):
            start_s, end_s = self._blackout_s
            seen = self._dark if start_s <= now_s < end_s else self.eye.picture(self.vehicle.body)
            self._on_the_way.append((self.now_ns, seen))
            self.n_pictures += 1
        pictures = []
        while self._on_the_way and self._on_the_way[0][0] + self._transfer_ns <= self.now_ns:
            pictures.append(self._on_the_way.popleft())
        attitude_s = self._interval_ns["attitude"] * 1e-9
        return Samples(
            self.vehicle.read_imu(dt_s),
            self.vehicle.read_attitude(attitude_s) if self._is_due("attitude") else None,
            self.vehicle.read_flow() if self._is_due("flow") else None,
            pictures,
        )

    def _is_due(self, name: str) -> bool:
        if name not in self._due_ns or self.now_ns < self._due_ns[name]:
            return False
        self._due_ns[name] += self._interval_ns[name]
        return True
