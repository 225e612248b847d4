"""Fly a simulated vehicle down a corridor and round a corner by the MAVLink messages of `corridor live` alone.

``python examples/live_loopback.py [--seconds 20] [--record flight.mcap]``

The vehicle of `simulated_vehicle.py` sends IMU and attitude over UDP on this machine, as an autopilot does
(`live_autopilot.py`), and writes its pictures into a folder in place of a camera. A `fusion.live` session in another
thread measures them and answers with ODOMETRY, DEBUG_VECT and NAMED_VALUE_FLOAT. The control laws of `pilot.Steering`
turn these into yaw rate and speed.

The simulated time stops while the world is rendered, and while the vehicle's loop is late on a busy machine.
"""

from __future__ import annotations

import argparse
import socket
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from math import degrees, pi, radians
from pathlib import Path

import cv2
import numpy as np
from control_loop import STOP_FROM_M, TURN_FROM_M
from flight_record import BODY_RADIUS_M
from live_autopilot import Autopilot, Heard
from pilot import HOVER, Steering
from simulated_vehicle import Image, World, junction_config

from fusion import Estimate, FusionConfig
from fusion.live.cameras import WatchedFolder
from fusion.live.recording import Recorder
from fusion.live.session import LiveSession, LiveStatistics, live_config
from fusion.live.settings import LiveSettings
from fusion.simulate import SimulationConfig

TRANSFER_S = 0.02  # from mid-exposure until the picture is in the folder
START_NS = 1_700_000_000_000_000_000  # counted from 1970, as a computer's clock is


class SharedClock:
    """The vehicle's time, for the session's threads too; it can stand still for all at once, and does at first.

    Parameters
    ----------
    start_ns
        When it begins.
    """

    monotonic_offset_ns = 0

    def __init__(self, start_ns: int) -> None:
        self._behind_ns = 0
        self._stopped_at_ns: int | None = start_ns
        self._end_ns = start_ns

    def now_ns(self) -> int:
        """Return the time."""
        stopped_at_ns = self._stopped_at_ns
        if stopped_at_ns is not None:
            return stopped_at_ns
        return min(time.perf_counter_ns() - self._behind_ns, self._end_ns)

    def run_until(self, t_ns: int) -> None:
        """Sleep until then; the time goes on no further before the next call."""
        self._end_ns = t_ns
        while (left_ns := t_ns - self.now_ns()) > 0:
            time.sleep(left_ns * 1e-9)

    @contextmanager
    def stopped(self) -> Iterator[None]:
        """Stand still meanwhile."""
        self._stopped_at_ns = self.now_ns()
        yield
        self._behind_ns = time.perf_counter_ns() - self._stopped_at_ns
        self._stopped_at_ns = None


@dataclass
class Outcome:
    """How it went: a row per control period."""

    heard: Heard
    statistics: LiveStatistics
    t_s: list[float] = field(default_factory=list)
    clearance_m: list[float] = field(default_factory=list)
    yaw_error_rad: list[float] = field(default_factory=list)
    offset_error_m: list[float] = field(default_factory=list)
    offset_m: list[float] = field(default_factory=list)
    status: list[str] = field(default_factory=list)
    corridor: list[int] = field(default_factory=list)
    room: int = 0

    def note(self, t_s: float, world: World, e: Estimate) -> None:
        """Compare what was said with the truth."""
        vehicle = world.vehicle
        _, offset_m, _ = vehicle.in_room(self.room)
        _, held_offset_m, _ = vehicle.in_room(min(e.corridor_index, len(vehicle.rooms) - 1))
        yaw_error_rad = e.heading_rad + e.corridor_turn_rad - vehicle.in_room(0)[2]
        self.t_s.append(t_s)
        self.clearance_m.append(vehicle.clearance_m())
        self.yaw_error_rad.append((yaw_error_rad + pi) % (2 * pi) - pi)
        self.offset_error_m.append(e.lateral_offset_m - held_offset_m)
        self.offset_m.append(offset_m)
        self.status.append(str(e.status))
        self.corridor.append(e.corridor_index)


def free_port() -> int:
    """Return a UDP port that nothing listens to."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def fly(
    config: SimulationConfig,
    seconds: float,
    rate_hz: float = 100.0,
    record: Path | None = None,
    reboot_at_s: float = -1.0,
) -> Outcome:
    """Fly until the end of the last corridor, or for so many seconds.

    Parameters
    ----------
    config
        Scene, camera and sensors.
    seconds, rate_hz
        Longest flight, and control periods a second.
    record
        Where the session writes its recording.
    reboot_at_s
        When the autopilot boots again; never, where negative.
    """
    clock = SharedClock(START_NS)
    world = World(config, START_NS, round(1e9 / rate_hz), TRANSFER_S, has_flow=False)
    settings = live_config(FusionConfig(corridor_width_m=config.scene.width_m))
    port = free_port()
    with tempfile.TemporaryDirectory() as folder:
        camera, sending = world.eye.camera, LiveSettings()
        recorder = None if record is None else Recorder(record, settings, camera, sending)
        session = LiveSession(
            f"udpin:127.0.0.1:{port}",
            WatchedFolder(Path(folder), clock),
            camera,
            settings,
            sending,
            recorder=recorder,
            clock=clock,
        )
        thread = threading.Thread(target=session.run, name="corridor live")
        thread.start()
        session.ready.wait()
        autopilot = Autopilot(f"udpout:127.0.0.1:{port}", clock.now_ns)
        try:
            outcome = _loop(world, clock, autopilot, Path(folder), round(seconds * rate_hz), reboot_at_s)
        finally:
            session.stop()
            thread.join()
            autopilot.close()
    outcome.statistics = session.statistics
    return outcome


def _loop(
    world: World, clock: SharedClock, autopilot: Autopilot, folder: Path, periods: int, reboot_at_s: float
) -> Outcome:
    steering, vehicle, command = Steering(), world.vehicle, HOVER
    outcome = Outcome(autopilot.heard, LiveStatistics())
    for period in range(periods):
        with clock.stopped():
            samples = world.advance(command.yaw_rate_rad_s, command.speed_m_s)
        clock.run_until(world.now_ns)
        if period == round(reboot_at_s * 1e9 / world.period_ns):
            autopilot.reboot()
        autopilot.send_imu(world.now_ns, *samples.imu)
        if samples.attitude is not None:
            autopilot.send_attitude(world.now_ns, samples.attitude)
        for taken_ns, image in samples.pictures:
            _put(folder, taken_ns, image)
        autopilot.poll()
        e = autopilot.heard.estimate()
        command = steering.steer(e)
        outcome.note((world.now_ns - START_NS) * 1e-9, world, e)
        if outcome.room == 0 and vehicle.to_junction_m() < TURN_FROM_M:
            steering.turn(vehicle.meetings[0].angle_rad)
            outcome.room = 1
        if vehicle.rooms[outcome.room].length_m - vehicle.in_room(outcome.room)[0] < STOP_FROM_M:
            break
    return outcome


def _put(folder: Path, taken_ns: int, image: Image) -> None:
    """Write a picture under another name first, so that it appears whole."""
    draft = folder / ".draft.png"
    cv2.imwrite(str(draft), image)
    draft.rename(folder / f"{taken_ns}.png")


def table(outcome: Outcome) -> str:
    """Say how it went."""
    heard, s = outcome.heard, outcome.statistics
    errors = np.abs(outcome.yaw_error_rad)
    flown = [
        f"flown {outcome.t_s[-1]:.1f} s, into corridor {outcome.corridor[-1] + 1}, "
        f"nearest to a wall {min(outcome.clearance_m):.2f} m",
        f"yaw error {degrees(float(np.sqrt(np.nanmean(errors**2)))):.2f} deg RMS, "
        f"offset error {float(np.sqrt(np.nanmean(np.square(outcome.offset_error_m)))):.3f} m RMS",
        f"frames {s.frames}, used {s.frames_used}, dropped {s.frames_dropped}; estimates {s.estimates}",
        f"latency from shutter to message p50 {s.latency_ms(50):.0f} ms, p99 {s.latency_ms(99):.0f} ms",
        "heard " + ", ".join(f"{name} {n}" for name, n in sorted(heard.counts.items())),
    ]
    return "\n".join([*flown, *(f"pilot reads: {text}" for text in heard.texts)])


def main(arguments: Sequence[str] | None = None) -> int:
    """Fly, and print how it went; 0 where it stayed clear of the walls."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=28.0, help="longest flight (default: 28)")
    parser.add_argument(
        "--turn", type=float, default=-90.0, help="at the junction, degrees (default: -90, left)"
    )
    parser.add_argument(
        "--start", type=float, default=3.0, help="metres from the corridor's end (default: 3)"
    )
    parser.add_argument("--reboot", type=float, default=-1.0, help="when the autopilot boots again, seconds")
    parser.add_argument("--record", type=Path, metavar="FILE.mcap", help="write a recording")
    options = parser.parse_args(arguments)
    config = junction_config(radians(options.turn), (160, 120), 15.0, start_m=options.start)
    outcome = fly(config, options.seconds, record=options.record, reboot_at_s=options.reboot)
    print(table(outcome))
    return 0 if min(outcome.clearance_m) > BODY_RADIUS_M else 1


if __name__ == "__main__":
    sys.exit(main())
