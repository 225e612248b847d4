"""A template for a flight controller that uses the estimate: copy this file, and insert your own gains.

`Steering` turns an estimate into a command. `Pilot` receives samples as they arrive and computes a command from the
estimate once per control period, while a `fusion.live.vision_thread.VisionThread` measures pictures. Both are
independent of the simulation in `control_loop.py`.

Threads: only the control thread calls the estimator. Finding the lines of a picture takes most of the time of a
measurement and needs nothing but the picture, so it runs in the vision thread (the compiled loops release the
interpreter's lock). The rest, `CorridorEstimator.add_lines`, takes some two milliseconds at 640x480: it goes back to
the time of the picture, updates the state, and replays the samples since. The control thread never waits for a
picture.
"""

from __future__ import annotations

import gc
import sys
from dataclasses import dataclass
from math import atan2, isnan, pi, radians

import numpy as np
import numpy.typing as npt

from fusion import CorridorEstimator, Estimate
from fusion.estimator.notices import Status
from fusion.live.vision_thread import VisionThread
from vision import Camera, warm_up

Image = npt.NDArray[np.uint8]

SAME_CORRIDOR_RAD = radians(30)  # axes nearer than this are those of one corridor


def make_ready(camera: Camera) -> None:
    """Prepare for take-off: load or compile machine code, and reduce the latency of Python.

    By default, a thread that computes blocks others for up to 5 ms, two control periods, and the garbage collector
    stops everything for milliseconds. The estimator does not need it: its objects have no reference cycles.
    """
    warm_up(camera)
    sys.setswitchinterval(0.0005)
    gc.collect()
    gc.disable()


@dataclass(frozen=True, slots=True)
class Command:
    """A command to the vehicle.

    Parameters
    ----------
    yaw_rate_rad_s
        Positive turns right.
    speed_m_s
        Forward; 0 to hover.
    """

    yaw_rate_rad_s: float
    speed_m_s: float


HOVER = Command(0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Gains:
    """Gains and limits. The heading is the offset's derivative: the two loops are a PD controller of the offset.

    Parameters
    ----------
    cruise_m_s, turn_m_s
        Speed along a corridor, and from the start of a turn until the new corridor is tracked.
    coasting_share
        Share of the cruising speed while no frame confirms the heading.
    look_ahead_m
        The nose points at the centre line this far ahead.
    heading_per_s
        Yaw rate per heading error.
    max_approach_rad
        Largest heading towards the centre line.
    max_yaw_rate_rad_s, turn_rate_rad_s
        Largest yaw rate in a corridor, and in a turn.
    heading_std_rad, offset_std_m
        Sigmas up to which it flies at full speed, and above which it hovers, or ignores the offset.
    """

    cruise_m_s: float = 0.9
    turn_m_s: float = 0.4
    coasting_share: float = 0.4
    look_ahead_m: float = 1.6
    heading_per_s: float = 2.5
    max_approach_rad: float = radians(20)
    max_yaw_rate_rad_s: float = radians(40)
    turn_rate_rad_s: float = radians(50)
    heading_std_rad: tuple[float, float] = (radians(1.5), radians(8))
    offset_std_m: tuple[float, float] = (0.1, 0.4)


class Steering:
    """Control laws: along the centre line of a corridor, and into another one on command."""

    def __init__(self, gains: Gains | None = None) -> None:
        self.gains = gains or Gains()
        self.estimate = Estimate(0)
        self.is_turning = False
        self._axis_rad = 0.0  # of the corridor flown, or turned into, seen from the first one
        self._left_index = 0  # corridor that the turn leaves

    def turn(self, angle_rad: float) -> None:
        """Start a turn into another corridor at this junction, positive right."""
        self.is_turning = True
        self._left_index = self.estimate.corridor_index
        self._axis_rad = self.estimate.corridor_turn_rad + angle_rad

    def steer(self, e: Estimate) -> Command:
        """Return the command for an estimate."""
        self.estimate = e
        if e.status in (Status.INITIALISING, Status.LOST):
            return HOVER  # until frames give a heading
        is_meant = abs(_wrap(e.corridor_turn_rad - self._axis_rad)) < SAME_CORRIDOR_RAD
        if is_meant and e.corridor_index != self._left_index and e.status == Status.TRACKING:
            self.is_turning = False
        if self.is_turning or not is_meant:
            return self._swing(e)
        self._axis_rad = e.corridor_turn_rad
        return self._follow(e)

    def _swing(self, e: Estimate) -> Command:
        """Turn the nose along the intended corridor, also without vision; its lateral offset is not known yet."""
        # Heading plus turn is continuous where the reference of the heading changes.
        error = _wrap(e.heading_rad + e.corridor_turn_rad - self._axis_rad)
        g = self.gains
        return Command(_limit(-g.heading_per_s * error, g.turn_rate_rad_s), g.turn_m_s)

    def _follow(self, e: Estimate) -> Command:
        """Point the nose at the centre line some distance ahead; fly slower the larger the sigmas."""
        g = self.gains
        is_sure = _share(e.heading_std_rad, g.heading_std_rad)
        is_placed = _share(e.lateral_offset_std_m, g.offset_std_m)
        approach = 0.0
        if is_placed > 0.0:
            approach = _limit(-is_placed * atan2(e.lateral_offset_m, g.look_ahead_m), g.max_approach_rad)
        yaw_rate = _limit(g.heading_per_s * (approach - e.heading_rad), g.max_yaw_rate_rad_s)
        speed = g.cruise_m_s * is_sure * (0.5 + 0.5 * is_placed)
        if e.status != Status.TRACKING:
            speed = min(speed, g.coasting_share * g.cruise_m_s)
        return Command(yaw_rate, speed)


class Pilot(Steering):
    """Control laws together with an estimator.

    Parameters
    ----------
    estimator
        With a camera.
    vision
        Measures the pictures.
    """

    def __init__(
        self, estimator: CorridorEstimator, vision: VisionThread, gains: Gains | None = None
    ) -> None:
        super().__init__(gains)
        self.estimator, self.vision = estimator, vision
        self.estimate = estimator.estimate()

    def on_imu(self, t_ns: int, gyro_rad_s: npt.ArrayLike, accel_m_s2: npt.ArrayLike) -> None:
        """Take an IMU sample, body FRD."""
        self.estimator.add_imu(t_ns, gyro_rad_s, accel_m_s2)

    def on_attitude(self, t_ns: int, q_world_body: npt.ArrayLike) -> None:
        """Take the attitude filter's quaternion, w x y z, body FRD to a world whose z points down."""
        self.estimator.add_attitude(t_ns, q_world_body)

    def on_velocity(self, t_ns: int, v_body_m_s: npt.ArrayLike) -> None:
        """Take a velocity, body FRD, if the vehicle has one."""
        self.estimator.add_velocity(t_ns, v_body_m_s)

    def on_picture(self, t_ns: int, image: Image) -> None:
        """Take a picture; ``t_ns`` is the middle of its exposure, however late it arrives."""
        self.vision.offer(t_ns, image)

    def control(self, now_ns: int) -> Command:
        """Return the command for this control period."""
        for t_ns, lines, _, cause in self.vision.finished():
            if lines is None:
                self.estimator.add_unreadable_frame(t_ns, cause)
            else:
                self.estimator.add_lines(t_ns, lines)
        return self.steer(self.estimator.estimate(now_ns))


def _share(std: float, limits: tuple[float, float]) -> float:
    """Return 1 up to the first limit, 0 above the second and if unknown, and in between linearly."""
    good, bad = limits
    return 0.0 if isnan(std) else min(max((bad - std) / (bad - good), 0.0), 1.0)


def _limit(value: float, greatest: float) -> float:
    return min(max(value, -greatest), greatest)


def _wrap(angle_rad: float) -> float:
    return (angle_rad + pi) % (2 * pi) - pi
