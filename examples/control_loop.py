"""Control a simulated vehicle down a corridor and round a corner by the estimate, in a loop with a fixed period.

``python examples/control_loop.py [--seconds 28] [--rate 400] [--no-wall-clock]``

The loop is that of a flight controller: in every period it reads the IMU and the other sensors, and asks
`pilot.Pilot` for a command. `pilot.py` contains the code that a flight controller needs, and nothing else; the
vehicle and its rendered surroundings are in `simulated_vehicle.py`.

The simulated time follows the wall clock while the pilot and the vision thread work, and stops while the world is
rendered. A slow call therefore has the same effect as in flight. With ``--no-wall-clock`` the simulation runs as fast
as it can, vision takes a fixed time, and every run gives the same result.
"""

from __future__ import annotations

import argparse
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from math import pi, radians
from typing import Any

from flight_record import CALLS, Flight, Row, judge, table
from pilot import HOVER, Command, Image, Pilot, make_ready
from simulated_vehicle import Samples, World, junction_config

from fusion import CorridorEstimator, FusionConfig
from fusion.live.vision_thread import VisionThread
from fusion.simulate import SimulationConfig
from vision import Camera, InputError, extract_lines
from vision.lines.line_set import LineSet

START_NS = 1_000_000_000
TRANSFER_S = 0.020  # from mid-exposure until the picture is in memory: shutter, read-out, cable
VISION_S = 0.010  # what vision takes where the wall clock does not say
TURN_FROM_M = 0.95  # before the middle of the junction
STOP_FROM_M = 2.5  # before the end of the last corridor


class Clock:
    """The vehicle's time, nanoseconds.

    Parameters
    ----------
    follows_wall
        Whether to wait for the wall clock; otherwise every period begins at once, and on time.
    """

    def __init__(self, follows_wall: bool) -> None:
        self._follows_wall = follows_wall
        self._behind_ns = time.perf_counter_ns() - START_NS

    def now_ns(self) -> int:
        """Return the vehicle's time."""
        return time.perf_counter_ns() - self._behind_ns

    def wait_until(self, t_ns: int) -> None:
        """Sleep until then, if it is not past."""
        if not self._follows_wall:
            self._behind_ns = time.perf_counter_ns() - t_ns
        while (left_ns := t_ns - self.now_ns()) > 0:
            time.sleep(left_ns * 1e-9)

    @contextmanager
    def stopped(self) -> Iterator[None]:
        """Stand still meanwhile."""
        before_ns = time.perf_counter_ns()
        yield
        self._behind_ns += time.perf_counter_ns() - before_ns


def fly(
    config: SimulationConfig,
    seconds: float,
    rate_hz: float = 400.0,
    *,
    wall_clock: bool = True,
    has_flow: bool = True,
    blackout_s: tuple[float, float] = (0.0, 0.0),
) -> Flight:
    """Fly through the scene of a configuration, steered by the estimate.

    Parameters
    ----------
    has_flow
        Whether the vehicle has optical flow, which tells its speed.
    blackout_s
        From when to when the camera sees nothing.
    """
    started = time.perf_counter()
    delay_s = TRANSFER_S + (0.0 if wall_clock else VISION_S)
    world = World(config, START_NS, round(1e9 / rate_hz), delay_s, has_flow, blackout_s)
    make_ready(world.eye.camera)
    flight = Flight(seconds, rate_hz)

    def extract(image: Image, camera: Camera) -> LineSet:
        flight.vision_threads.add(threading.get_ident())
        return extract_lines(image, camera)

    estimator = CorridorEstimator(FusionConfig(corridor_width_m=config.scene.width_m), world.eye.camera)
    _watch(estimator, flight, world)
    vision = VisionThread(world.eye.camera, extract)
    try:
        _loop(flight, world, Pilot(estimator, vision), Clock(wall_clock), wait_for_vision=not wall_clock)
    finally:
        vision.close()
    flight.pictures, flight.dropped = world.n_pictures, vision.dropped
    flight.used = estimator.counters["frame_ok"]
    flight.took_s = time.perf_counter() - started
    return flight


def _watch(estimator: CorridorEstimator, flight: Flight, world: World) -> None:
    """Time every call that the pilot makes, and note how old frames are when they are used."""
    for name in CALLS[:-1]:
        setattr(estimator, name, flight.watch.watched(name, getattr(estimator, name)))
    add_lines: Callable[..., Any] = estimator.add_lines

    def used(t_ns: int, lines: LineSet) -> Any:
        flight.frame_ages_s.append((world.now_ns - t_ns) * 1e-9)
        return add_lines(t_ns, lines)

    setattr(estimator, "add_lines", used)  # noqa: B010


def _loop(flight: Flight, world: World, pilot: Pilot, clock: Clock, *, wait_for_vision: bool) -> None:
    """Run the control loop until the time is up or the end of the last corridor is near."""
    period = flight.watch.watched("control period", _period)
    command = HOVER
    flight.control_thread = threading.get_ident()
    clock.wait_until(world.now_ns)
    for _ in range(round(flight.seconds * flight.rate_hz)):
        clock.wait_until(world.now_ns + world.period_ns)
        with clock.stopped():
            samples = world.advance(command.yaw_rate_rad_s, command.speed_m_s)
            if wait_for_vision:
                for t_ns, image in samples.pictures:
                    pilot.on_picture(t_ns, image)
                    pilot.vision.wait()
                samples.pictures.clear()
        command = period(pilot, samples, world.now_ns)
        flight.missed += clock.now_ns() > world.now_ns + world.period_ns
        with clock.stopped():
            _note(flight, world, pilot, command)
            if _lead(flight, world, pilot):
                return


def _period(pilot: Pilot, samples: Samples, now_ns: int) -> Command:
    """Do what the vehicle's computer does in a control period."""
    pilot.on_imu(now_ns, *samples.imu)
    if samples.attitude is not None:
        pilot.on_attitude(now_ns, samples.attitude)
    if samples.flow is not None:
        pilot.on_velocity(now_ns, samples.flow)
    for t_ns, image in samples.pictures:
        pilot.on_picture(t_ns, image)
    return pilot.control(now_ns)


def _note(flight: Flight, world: World, pilot: Pilot, command: Command) -> None:
    """Compare what the pilot knows with the truth."""
    vehicle, e = world.vehicle, pilot.estimate
    room = 0
    if flight.turned_s is not None:
        angle = vehicle.meetings[0].angle_rad
        room = 1 if abs(vehicle.in_room(1)[2]) < abs(angle) / 2 else 0
    _, offset, heading = vehicle.in_room(room)
    _, held_offset, held_heading = vehicle.in_room(min(e.corridor_index, len(vehicle.rooms) - 1))
    error = (e.heading_rad - held_heading + pi) % (2 * pi) - pi
    flight.rows.append(
        Row(
            (world.now_ns - START_NS) * 1e-9,
            str(e.status),
            e.corridor_index,
            pilot.is_turning,
            room,
            heading,
            offset,
            vehicle.clearance_m(),
            error,
            e.lateral_offset_m - held_offset,
            command.speed_m_s,
        )
    )


def _lead(flight: Flight, world: World, pilot: Pilot) -> bool:
    """Be the mission: call for the turn at the junction; True where the way is at its end."""
    vehicle = world.vehicle
    if flight.turned_s is None and vehicle.to_junction_m() < TURN_FROM_M:
        pilot.turn(vehicle.meetings[0].angle_rad)
        flight.turned_s = flight.rows[-1].t_s
    room = 0 if flight.turned_s is None else 1
    return vehicle.rooms[room].length_m - vehicle.in_room(room)[0] < STOP_FROM_M


def main(arguments: Sequence[str] | None = None) -> int:
    """Fly, and print how it went; 0 where it went well."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=28.0, help="longest flight (default: 28)")
    parser.add_argument("--rate", type=float, default=400.0, help="of the control loop, Hz (default: 400)")
    parser.add_argument("--frames", type=float, default=20.0, help="pictures a second (default: 20)")
    parser.add_argument(
        "--turn", type=float, default=-90.0, help="at the junction, degrees (default: -90, left)"
    )
    parser.add_argument("--seed", type=int, default=3, help="of the corridor and the noise (default: 3)")
    parser.add_argument(
        "--blackout",
        type=float,
        nargs=2,
        default=(0.0, 0.0),
        metavar=("FROM", "TO"),
        help="no sight, seconds",
    )
    parser.add_argument("--no-flow", action="store_true", help="without optical flow")
    parser.add_argument(
        "--no-wall-clock", action="store_true", help="as fast as it goes, the same every time"
    )
    options = parser.parse_args(arguments)
    if not 25 <= options.rate <= 2000 or not options.seconds >= 0.5:
        parser.error("--rate is 25 to 2000 Hz, --seconds at least 0.5")
    try:
        config = junction_config(radians(options.turn), frame_hz=options.frames, seed=options.seed)
    except InputError as error:
        parser.error(str(error))
    flight = fly(
        config,
        options.seconds,
        options.rate,
        wall_clock=not options.no_wall_clock,
        has_flow=not options.no_flow,
        blackout_s=tuple(options.blackout),
    )
    print("\n".join(table(flight)))
    return 1 if judge(flight).problems else 0


if __name__ == "__main__":
    sys.exit(main())
