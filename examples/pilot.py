"""What a flight controller has to write to steer by the estimate: copy this file, and put your own gains in it.

`VisionThread` measures pictures beside the control loop; `Pilot` takes samples as they come, and turns the estimate
into a command once per control period. Neither knows of the simulation that `control_loop.py` flies them in.

What runs where: the control thread owns the estimator and is the only one to call it. Finding the lines of a picture
takes most of vision's time and needs nothing but the picture, so it happens in the vision thread (the compiled loops
let other threads run meanwhile); what is left, `CorridorEstimator.add_lines`, takes about a millisecond, brings the
state back to when the picture was taken, and carries it forward again. The control thread never waits for a picture.
"""

from __future__ import annotations

import gc
import logging
import queue
import sys
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from math import atan2, isnan, pi, radians

import numpy as np
import numpy.typing as npt

from fusion import CorridorEstimator, Estimate
from fusion.estimator.estimate import Status
from vision import Camera, InputError, extract_lines, warm_up
from vision.lines.segments import LineSet

Image = npt.NDArray[np.uint8]

SAME_CORRIDOR_RAD = radians(30)  # axes nearer than this are those of one corridor


def make_ready(camera: Camera) -> None:
    """Get slow things over with before take-off: load or compile machine code, and make Python prompt.

    A thread that computes keeps others off the interpreter for up to 5 ms by default, two control periods; and the
    garbage collector's full passes take longer the more objects there are, most of which will never go.
    """
    warm_up(camera)
    sys.setswitchinterval(0.0005)
    gc.collect()
    gc.freeze()


class VisionThread:
    """Finds the lines of pictures in a thread of its own. Of pictures that wait, only the newest is kept.

    Parameters
    ----------
    camera
        That the pictures come from.
    extract
        What is done to a picture.
    """

    def __init__(self, camera: Camera, extract: Callable[[Image, Camera], LineSet] = extract_lines) -> None:
        self.dropped = 0
        self._camera, self._extract = camera, extract
        self._waiting: queue.Queue[tuple[int, Image] | None] = queue.Queue(maxsize=1)
        self._finished: queue.SimpleQueue[tuple[int, LineSet | None]] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._run, name="vision", daemon=True)
        self._thread.start()

    def offer(self, t_ns: int, image: Image) -> None:
        """Hand over a picture, never waiting: one that has waited till now gives way to it."""
        self._put((t_ns, image))

    def finished(self) -> Iterator[tuple[int, LineSet | None]]:
        """Time stamps and lines of the pictures measured since the last call; None where one could not be read."""
        while True:
            try:
                yield self._finished.get_nowait()
            except queue.Empty:
                return

    def wait(self) -> None:
        """Wait until all that was offered is measured. For tests and simulations; a control loop must not."""
        self._waiting.join()

    def close(self) -> None:
        """End the thread, once it is through with the picture in hand."""
        self._put(None)
        self._thread.join()

    def _put(self, item: tuple[int, Image] | None) -> None:
        while True:
            try:
                self._waiting.put_nowait(item)
            except queue.Full:
                try:
                    self._waiting.get_nowait()
                except queue.Empty:
                    continue  # the thread has just taken it
                self._waiting.task_done()
                self.dropped += 1
            else:
                return

    def _run(self) -> None:
        while (item := self._waiting.get()) is not None:
            t_ns, image = item
            try:
                lines = self._extract(image, self._camera)
            except InputError:
                lines = None
            except Exception:  # whatever is wrong with one picture must not end vision
                logging.getLogger(__name__).exception("picture of %d ns could not be measured", t_ns)
                lines = None
            self._finished.put((t_ns, lines))
            self._waiting.task_done()


@dataclass(frozen=True, slots=True)
class Command:
    """What the vehicle is asked to do.

    Parameters
    ----------
    yaw_rate_rad_s
        Positive turns right.
    speed_m_s
        Forward; 0 is to hover.
    """

    yaw_rate_rad_s: float
    speed_m_s: float


HOVER = Command(0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Gains:
    """How the pilot flies. The heading is the offset's derivative: the two loops make a PD controller of the offset.

    Parameters
    ----------
    cruise_m_s, turn_m_s
        Speed along a corridor, and from the call for a turn until the new corridor is held.
    coasting_share
        Of the cruising speed, while no frame confirms the heading.
    look_ahead_m
        The nose points at the centre line this far ahead.
    heading_per_s
        Yaw rate per heading error.
    max_approach_rad
        Greatest heading towards the centre line.
    max_yaw_rate_rad_s, turn_rate_rad_s
        Greatest yaw rate in a corridor, and in a turn.
    heading_std_rad, offset_std_m
        Sigmas up to which it flies at full speed, and beyond which it hovers, or leaves the offset alone.
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


class Pilot:
    """Flies down the middle of a corridor, and into another one when told to turn.

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
        self.estimator, self.vision, self.gains = estimator, vision, gains or Gains()
        self.estimate: Estimate = estimator.estimate()
        self.is_turning = False
        self._axis_rad = 0.0  # of the corridor flown, or turned into, seen from the first one
        self._left_index = 0  # corridor that the turn leaves

    def on_imu(self, t_ns: int, gyro_rad_s: npt.ArrayLike, accel_m_s2: npt.ArrayLike) -> None:
        """Take an IMU sample, body FRD."""
        self.estimator.add_imu(t_ns, gyro_rad_s, accel_m_s2)

    def on_attitude(self, t_ns: int, q_world_body: npt.ArrayLike) -> None:
        """Take the attitude filter's quaternion, w x y z, body FRD to a world whose z points down."""
        self.estimator.add_attitude(t_ns, q_world_body)

    def on_velocity(self, t_ns: int, v_body_m_s: npt.ArrayLike) -> None:
        """Take a velocity, body FRD, where the vehicle has one."""
        self.estimator.add_velocity(t_ns, v_body_m_s)

    def on_picture(self, t_ns: int, image: Image) -> None:
        """Take a picture; ``t_ns`` is when it was exposed, however late it comes."""
        self.vision.offer(t_ns, image)

    def turn(self, angle_rad: float) -> None:
        """Turn into the corridor that opens here, positive right."""
        self.is_turning = True
        self._left_index = self.estimate.corridor_index
        self._axis_rad = self.estimate.corridor_turn_rad + angle_rad

    def control(self, now_ns: int) -> Command:
        """Return the command for this control period."""
        for t_ns, lines in self.vision.finished():
            if lines is None:
                self.estimator.add_unreadable_frame(t_ns)
            else:
                self.estimator.add_lines(t_ns, lines)
        e = self.estimate = self.estimator.estimate(now_ns)
        if e.status in (Status.INITIALISING, Status.LOST):
            return HOVER  # and let the camera look: only frames can help
        is_meant = abs(_wrap(e.corridor_turn_rad - self._axis_rad)) < SAME_CORRIDOR_RAD
        if is_meant and e.corridor_index != self._left_index and e.status == Status.TRACKING:
            self.is_turning = False
        if self.is_turning or not is_meant:
            return self._swing(e)
        self._axis_rad = e.corridor_turn_rad
        return self._follow(e)

    def _swing(self, e: Estimate) -> Command:
        """Bring the nose along the corridor that is meant, vision or not; how far off its middle is not known yet."""
        # Heading plus turn goes on smoothly where what the heading is measured from changes.
        error = _wrap(e.heading_rad + e.corridor_turn_rad - self._axis_rad)
        g = self.gains
        return Command(_limit(-g.heading_per_s * error, g.turn_rate_rad_s), g.turn_m_s)

    def _follow(self, e: Estimate) -> Command:
        """Point the nose at the centre line some way ahead; the less is known, the slower."""
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


def _share(std: float, limits: tuple[float, float]) -> float:
    """Return 1 up to the first limit, 0 beyond the second and where unknown."""
    good, bad = limits
    return 0.0 if isnan(std) else min(max((bad - std) / (bad - good), 0.0), 1.0)


def _limit(value: float, greatest: float) -> float:
    return min(max(value, -greatest), greatest)


def _wrap(angle_rad: float) -> float:
    return (angle_rad + pi) % (2 * pi) - pi
