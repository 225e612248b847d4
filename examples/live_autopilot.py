"""The autopilot's side of a MAVLink link to `corridor live`, with pymavlink.

`Autopilot` sends what PX4 or ArduPilot send: a heartbeat, and IMU and attitude with times since boot; and it replies
to TIMESYNC. `Heard` stores the messages from `corridor live`, and makes of them the estimate for the pilot.
"""

from __future__ import annotations

import os
import sys
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from math import atan2, nan, pi, sqrt
from typing import Any

import numpy as np
import numpy.typing as npt

from fusion import Estimate
from fusion.estimator.notices import Status

os.environ["MAVLINK20"] = "1"  # ODOMETRY is a message of MAVLink 2
try:
    from pymavlink import mavutil
    from pymavlink.dialects.v20 import ardupilotmega as mavlink
except ModuleNotFoundError:
    print("error: pymavlink is not installed (pip install 'corridor-fusion[live]')", file=sys.stderr)
    raise SystemExit(2) from None

HEARTBEAT_NS = 1_000_000_000
STATUSES = (Status.INITIALISING, Status.TRACKING, Status.COASTING, Status.LOST)
YAW_VARIANCE = 20  # in a covariance of 21


@dataclass
class Heard:
    """What was heard last, and all that was said in words."""

    counts: Counter[str] = field(default_factory=Counter)
    texts: list[str] = field(default_factory=list)
    intervals: dict[int, float] = field(default_factory=dict)  # asked for: message number and Hz
    named: dict[str, float] = field(default_factory=dict)
    odometry: Any = None
    offset: Any = None

    def estimate(self) -> Estimate:
        """Make an estimate of the messages alone."""
        named, offset, odometry = self.named, self.offset, self.odometry
        if odometry is None or offset is None or not named:
            return Estimate(0)
        in_metres = offset.name == "corridor_m"
        w, x, y, z = odometry.q
        yaw = atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))  # NaN while lost
        return replace(
            Estimate(odometry.time_usec * 1000),
            heading_rad=offset.z,
            heading_std_rad=sqrt(odometry.pose_covariance[YAW_VARIANCE]),
            lateral_offset_m=offset.x if in_metres else nan,
            lateral_offset_std_m=offset.y if in_metres else nan,
            status=str(STATUSES[int(named["cf_status"])] if odometry.quality >= 0 else Status.LOST),
            corridor_index=int(named["cf_corr"]),
            corridor_turn_rad=(yaw - offset.z + pi) % (2 * pi) - pi,
        )


class Autopilot:
    """The autopilot's end of a link.

    Parameters
    ----------
    address
        As pymavlink names it: ``udpout:127.0.0.1:14540``.
    now_ns
        The true time; its own clock is that of since its boot.
    kind
        ``MAV_AUTOPILOT_PX4`` or ``MAV_AUTOPILOT_ARDUPILOTMEGA``.
    answers_timesync
        Whether it does.
    """

    def __init__(
        self,
        address: str,
        now_ns: Callable[[], int],
        kind: int = mavlink.MAV_AUTOPILOT_PX4,
        answers_timesync: bool = True,
    ) -> None:
        self.heard = Heard()
        self._link: Any = mavutil.mavlink_connection(address, source_system=1, source_component=1)
        self._send: Any = self._link.mav
        self._now_ns, self._kind, self._answers = now_ns, kind, answers_timesync
        self._booted_ns = now_ns() - 5_000_000_000
        self._heartbeat_ns = 0

    def reboot(self) -> None:
        """Begin to count the time anew, a second ago."""
        self._booted_ns = self._now_ns() - 1_000_000_000

    def close(self) -> None:
        """End the link."""
        self._link.close()

    def boot_ns(self, t_ns: int) -> int:
        """Return a time by its own clock."""
        return max(t_ns - self._booted_ns, 0)

    def send_imu(self, t_ns: int, gyro_rad_s: npt.ArrayLike, accel_m_s2: npt.ArrayLike) -> None:
        """Send an IMU sample, body FRD."""
        values = [*np.asarray(accel_m_s2, float).tolist(), *np.asarray(gyro_rad_s, float).tolist()]
        self._send.highres_imu_send(self.boot_ns(t_ns) // 1000, *values, 0, 0, 0, 0, 0, 0, 0, 0x3F)

    def send_attitude(self, t_ns: int, q_world_body: npt.ArrayLike) -> None:
        """Send an attitude, w x y z, body FRD to NED."""
        q = np.asarray(q_world_body, float).tolist()
        self._send.attitude_quaternion_send(self.boot_ns(t_ns) // 1_000_000, *q, 0, 0, 0)

    def send_distance(self, t_ns: int, distance_m: float) -> None:
        """Send a distance to the floor."""
        self._send.distance_sensor_send(
            self.boot_ns(t_ns) // 1_000_000, 10, 1000, round(100 * distance_m), 0, 0, 25, 0
        )

    def poll(self) -> None:
        """Take what has come, and answer what asks for it."""
        now_ns = self._now_ns()
        if now_ns - self._heartbeat_ns > HEARTBEAT_NS:
            self._heartbeat_ns = now_ns
            self._send.heartbeat_send(mavlink.MAV_TYPE_QUADROTOR, self._kind, 0, 0, 4)
        while (message := self._link.recv_msg()) is not None:
            self._take(message)

    def _take(self, message: Any) -> None:
        heard, kind = self.heard, message.get_type()
        heard.counts[kind] += 1
        if kind == "TIMESYNC" and message.tc1 == 0 and self._answers:
            self._send.timesync_send(self.boot_ns(self._now_ns()), message.ts1)
        elif kind == "COMMAND_LONG" and message.command == mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
            heard.intervals[int(message.param1)] = 1e6 / message.param2
        elif kind == "ODOMETRY":
            heard.odometry = message
        elif kind == "DEBUG_VECT":
            heard.offset = message
        elif kind == "NAMED_VALUE_FLOAT":
            heard.named[message.name] = message.value
        elif kind == "STATUSTEXT":
            heard.texts.append(message.text)
