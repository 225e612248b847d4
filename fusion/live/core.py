"""The estimator between a link and a camera, as a state machine without clock, thread or socket.

All input comes as one of three calls, each with its time: bytes from the link, a picture's lines, a tick. They return
the packets to send. The same calls in the same order give the same packets, bit for bit; recordings are replayed this
way.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

from fusion.estimator.config import FusionConfig
from fusion.estimator.estimate import Estimate
from fusion.estimator.estimator import CorridorEstimator
from fusion.estimator.notices import Status
from fusion.live.clock import AutopilotClock, LeastLatency, SyncState
from fusion.live.packets import PacketWriter
from fusion.live.pose import PoseTracker
from fusion.live.samples import (
    ARDUPILOT,
    Distance,
    Imu,
    Orientation,
    Quaternion,
    Velocity,
    attitude_of,
    imu_of,
    range_of,
    velocity_of,
)
from fusion.live.settings import LiveSettings, SendPosition
from fusion.logs.autopilot.tlog import ATTITUDES, IMUS, POSITION, RANGE

if TYPE_CHECKING:
    from fusion.estimator.frame_update import FrameResult
    from vision import Camera
    from vision.lines.line_set import LineSet

GROUND_STATION, NO_AUTOPILOT = 6, 8  # type and autopilot in HEARTBEAT of components that are not autopilots
AUTOPILOT_COMPONENT = 1
HEARTBEAT_NS = 1_000_000_000
ASK_TIME_NS, ASK_TIME_SOON_NS = 500_000_000, 100_000_000
ASK_STREAMS_NS = 5_000_000_000
BETTER_MESSAGE_NS = 1_000_000_000  # after which a message of lower rank is used
TEXT_NS = 1_000_000_000  # between two texts to the pilot
ATTITUDE_HZ, RANGE_HZ, VELOCITY_HZ = 50.0, 20.0, 25.0
LONGEST_NS = 2**62  # a larger stamp is damaged
UNIX_NS = 10**18  # larger times count from 1970, smaller ones from boot, as in MAVLink
MESSAGE_IDS = {
    "RAW_IMU": 27,
    "ATTITUDE": 30,
    "ATTITUDE_QUATERNION": 31,
    POSITION: 32,
    "HIGHRES_IMU": 105,
    RANGE: 132,
}


class SampleSink(Protocol):
    """Receives each sample as the estimator uses it, by the computer's clock: a recording."""

    def imu(self, t_ns: int, sample: Imu) -> None:
        """Take an IMU sample."""

    def attitude(self, t_ns: int, sample: Orientation) -> None:
        """Take an attitude."""

    def distance(self, t_ns: int, sample: Distance) -> None:
        """Take a distance to the floor."""

    def velocity(self, t_ns: int, sample: Velocity) -> None:
        """Take a velocity."""


class Vehicle(NamedTuple):
    """Make of the autopilot."""

    system_id: int
    component_id: int
    autopilot: int


class LiveCore:
    """Packets, frames and ticks in; packets out.

    Parameters
    ----------
    config, camera
        For the estimator.
    settings
        Messages to send and to request.
    sink
        Receives the samples.
    """

    def __init__(
        self,
        config: FusionConfig,
        camera: Camera,
        settings: LiveSettings | None = None,
        sink: SampleSink | None = None,
    ) -> None:
        from pymavlink.dialects.v20 import ardupilotmega

        self.config, self.settings = config, settings or LiveSettings()
        self.estimator = CorridorEstimator(config, camera)
        self.counters: Counter[str] = Counter()
        self.clock = AutopilotClock()
        self._unix_clock = LeastLatency()  # of messages with times since 1970
        self.vehicle: Vehicle | None = None
        self.estimate = self.estimator.estimate()
        self._sink = sink
        self._parser: Any = ardupilotmega.MAVLink(None)
        self._parser.robust_parsing = True
        self._writer = PacketWriter()
        self._pose = PoseTracker()
        self._heard_ns: dict[str, int] = {}  # receipt of each sensor's last message
        self._imu_since_asked = 0
        self._first_tick_ns: int | None = None
        self._q_world_body: Quaternion | None = None
        self._due_ns = dict.fromkeys(("heartbeat", "time", "streams", "plots", "text"), 0)
        self._told = (str(Status.INITIALISING), 0, "")
        self._handlers: dict[str, Callable[[int, Any], list[bytes]]] = {
            "HEARTBEAT": self._on_heartbeat,
            "TIMESYNC": self._on_timesync,
            **dict.fromkeys(IMUS, self._on_imu),
            **dict.fromkeys(ATTITUDES, self._on_attitude),
            RANGE: self._on_range,
            POSITION: self._on_velocity,
        }

    # In

    def on_bytes(self, received_ns: int, data: bytes) -> list[bytes]:
        """Process bytes received on the link; return the packets to send in reply."""
        answers: list[bytes] = []
        for message in self._parser.parse_buffer(data) or ():
            kind = message.get_type()
            if kind == "BAD_DATA":
                self.counters["bad_data"] += 1
                continue
            handler = self._handlers.get(kind)
            if handler is None:
                continue
            is_vehicle = self.vehicle is not None and self.vehicle[:2] == (
                message.get_srcSystem(),
                message.get_srcComponent(),
            )
            if kind == "HEARTBEAT" or is_vehicle:
                answers += handler(received_ns, message)
            else:
                self.counters["other_sender" if self.vehicle else "before_heartbeat"] += 1
        return answers

    def on_frame(self, t_ns: int, lines: LineSet | None) -> FrameResult:
        """Process the lines of a picture stamped ``t_ns``; None if it could not be read."""
        if lines is None:
            return self.estimator.add_unreadable_frame(t_ns)
        return self.estimator.add_lines(t_ns, lines)

    def on_tick(self, now_ns: int) -> list[bytes]:
        """Estimate the present state, store it in ``estimate``, and return the packets to send."""
        e = self.estimate = self.estimator.estimate(now_ns, at_ns=now_ns)
        packets = self._upkeep(now_ns)
        if self.vehicle is None:
            return packets
        packets += self._texts(now_ns, e)
        if self.settings.plot_rate_hz and self._is_due(
            "plots", now_ns, round(1e9 / self.settings.plot_rate_hz)
        ):
            packets += self._writer.plots(e, self._boot_ms(now_ns))
        packets.append(self._writer.offset_vector(e))
        if e.status != Status.INITIALISING:
            packets.append(self._writer.odometry(e, self._pose.follow(e), self.config, self._with_position))
        return packets

    # Messages

    def _on_heartbeat(self, received_ns: int, message: Any) -> list[bytes]:
        if message.autopilot == NO_AUTOPILOT or message.type == GROUND_STATION:
            return []
        sender = Vehicle(message.get_srcSystem(), message.get_srcComponent(), message.autopilot)
        if self.vehicle is None and sender.component_id == AUTOPILOT_COMPONENT:
            self.vehicle = sender
            self._writer.set_system(sender.system_id)
            self.counters["vehicle_found"] += 1
        return []

    def _on_timesync(self, received_ns: int, message: Any) -> list[bytes]:
        if message.tc1 == 0:
            return [self._writer.timesync(received_ns, message.ts1)]
        restarts = self.clock.restarts
        if not self.clock.replied(message.ts1, message.tc1, received_ns):
            self.counters["timesync_not_ours"] += 1
        self._note_restart(restarts)
        return []

    def _on_imu(self, received_ns: int, message: Any) -> list[bytes]:
        assert self.vehicle is not None
        self._imu_since_asked += 1
        if self._is_best(IMUS, message.get_type(), received_ns):
            sample = imu_of(message, self.vehicle.autopilot)
            t_ns = self._host_ns(sample, received_ns)
            if sample is not None and t_ns is not None:
                self.estimator.add_imu(t_ns, sample.gyro_rad_s, sample.accel_m_s2)
                if self._sink is not None:
                    self._sink.imu(t_ns, sample)
        return []

    def _on_attitude(self, received_ns: int, message: Any) -> list[bytes]:
        if self._is_best(ATTITUDES, message.get_type(), received_ns):
            sample = attitude_of(message)
            t_ns = self._host_ns(sample, received_ns)
            if sample is not None and t_ns is not None:
                self._q_world_body = sample.q_world_body
                self.estimator.add_attitude(t_ns, sample.q_world_body)
                if self._sink is not None:
                    self._sink.attitude(t_ns, sample)
        return []

    def _on_range(self, received_ns: int, message: Any) -> list[bytes]:
        sample = range_of(message)
        t_ns = self._host_ns(sample, received_ns)
        if sample is not None and t_ns is not None:
            self.estimator.add_range(t_ns, sample.distance_m)
            if self._sink is not None:
                self._sink.distance(t_ns, sample)
        return []

    def _on_velocity(self, received_ns: int, message: Any) -> list[bytes]:
        if self.settings.use_velocity and self._q_world_body is not None:
            sample = velocity_of(message, self._q_world_body)
            t_ns = self._host_ns(sample, received_ns)
            if sample is not None and t_ns is not None:
                self.estimator.add_velocity(t_ns, sample.v_body_m_s)
                if self._sink is not None:
                    self._sink.velocity(t_ns, sample)
        return []

    def _is_best(self, ranking: tuple[str, ...], kind: str, received_ns: int) -> bool:
        """Whether no message of a higher rank carries the same quantity."""
        self._heard_ns[kind] = received_ns
        better = ranking[: ranking.index(kind)]
        return all(received_ns - self._heard_ns.get(name, -LONGEST_NS) > BETTER_MESSAGE_NS for name in better)

    def _host_ns(self, sample: Any, received_ns: int) -> int | None:
        """Time of a sample by the computer's clock; None, and counted, if the sample is unusable."""
        if sample is None:
            self.counters["not_used"] += 1
            return None
        restarts, was = self.clock.restarts, self.clock.state
        if UNIX_NS < sample.stamp_ns < LONGEST_NS:
            stamp_ns: int = sample.stamp_ns
            return stamp_ns + self._unix_clock.offset_ns(stamp_ns, received_ns)
        t_ns = self.clock.host_ns(sample.stamp_ns, received_ns) if sample.stamp_ns < LONGEST_NS else None
        self._note_restart(restarts)
        if t_ns is None:
            self.counters["before_sync" if was is SyncState.WAITING else "time_out_of_reach"] += 1
        return t_ns

    def _note_restart(self, before: int) -> None:
        if self.clock.restarts != before:
            self.counters["autopilot_restarts"] += 1
            self._due_ns["streams"] = self._due_ns["time"] = 0
            self._imu_since_asked = 0

    # Out

    @property
    def _with_position(self) -> bool:
        wanted = self.settings.send_position
        if wanted is SendPosition.AUTO:
            return self.vehicle is not None and self.vehicle.autopilot == ARDUPILOT
        return wanted is SendPosition.ALWAYS

    def _upkeep(self, now_ns: int) -> list[bytes]:
        """Heartbeat, time requests, and requests for messages that do not arrive."""
        packets = []
        if self._is_due("heartbeat", now_ns, HEARTBEAT_NS):
            packets.append(self._writer.heartbeat())
        if self.vehicle is None:
            return packets
        synchronised = self.clock.state is SyncState.SYNCHRONISED
        if self._is_due("time", now_ns, ASK_TIME_NS if synchronised else ASK_TIME_SOON_NS):
            packets.append(self._writer.timesync(0, now_ns))
        rate_hz = self.settings.imu_rate_hz
        if rate_hz and self._is_due("streams", now_ns, ASK_STREAMS_NS):
            if self._imu_since_asked < 0.5 * rate_hz * ASK_STREAMS_NS * 1e-9:
                packets += self._stream_requests(self.vehicle, rate_hz)
            self._imu_since_asked = 0
        return packets

    def _stream_requests(self, vehicle: Vehicle, imu_hz: float) -> list[bytes]:
        imu = "RAW_IMU" if vehicle.autopilot == ARDUPILOT else "HIGHRES_IMU"
        wanted = {imu: imu_hz, "ATTITUDE_QUATERNION": ATTITUDE_HZ, RANGE: RANGE_HZ}
        if vehicle.autopilot == ARDUPILOT:
            wanted["ATTITUDE"] = ATTITUDE_HZ  # the only one before version 4.1
        if self.settings.use_velocity:
            wanted[POSITION] = VELOCITY_HZ
        self.counters["streams_asked"] += 1
        return [
            self._writer.message_interval(vehicle[:2], MESSAGE_IDS[name], hz) for name, hz in wanted.items()
        ]

    def _texts(self, now_ns: int, e: Estimate) -> list[bytes]:
        """Text for the pilot on a change of state, at a limited rate."""
        state = (str(e.status), e.corridor_index, e.reason if e.status != Status.TRACKING else "")
        if state[:2] == self._told[:2] or not self._is_due("text", now_ns, TEXT_NS):
            return []
        text = f"corridor {e.corridor_index + 1}: {e.status}"
        if state[2]:
            text += f", {state[2]}"
        self._told = state
        return [self._writer.status_text(e, text)]

    def _boot_ms(self, now_ns: int) -> int:
        """Milliseconds since the first tick, for messages with times since boot."""
        if self._first_tick_ns is None:
            self._first_tick_ns = now_ns
        return (now_ns - self._first_tick_ns) // 1_000_000 % 2**32

    def _is_due(self, what: str, now_ns: int, interval_ns: int) -> bool:
        if now_ns < self._due_ns[what]:
            return False
        late_ns = now_ns - self._due_ns[what]
        self._due_ns[what] = (now_ns if late_ns > interval_ns else self._due_ns[what]) + interval_ns
        return True
