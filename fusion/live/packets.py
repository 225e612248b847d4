"""Estimates as MAVLink packets, and the other messages of a component on the network.

``ODOMETRY`` goes to the autopilot's filter; ``DEBUG_VECT`` and ``NAMED_VALUE_FLOAT`` are plotted by ground stations
and logged by autopilots without configuration, ``STATUSTEXT`` is read by the pilot.
https://mavlink.io/en/messages/common.html
"""

from __future__ import annotations

from math import isfinite, nan
from typing import Any

import numpy as np

from fusion.estimator.config import FusionConfig
from fusion.estimator.estimate import Estimate
from fusion.estimator.notices import Status
from fusion.live.pose import Pose
from fusion.logs.series import quaternions

COMPONENT_ID = 197  # MAV_COMP_ID_VISUAL_INERTIAL_ODOMETRY
ONBOARD_CONTROLLER, NO_AUTOPILOT = 18, 8  # of HEARTBEAT
LOCAL_FRD, BODY_FRD = 20, 12  # frames of ODOMETRY
VISION = 2  # MAV_ESTIMATOR_TYPE_VISION
SET_MESSAGE_INTERVAL = 511
FAILED_QUALITY = -1
HEIGHT_STD_M = 1.0  # of the z that is sent as zero
ROLL, PITCH, YAW = 15, 18, 20  # variances in a covariance of 21: the upper triangle, row by row
STATUS_NUMBERS = {
    Status.INITIALISING: 0.0,
    Status.TRACKING: 1.0,
    Status.COASTING: 2.0,
    Status.LOST: 3.0,
}
_SEVERITIES = {Status.TRACKING: 6, Status.INITIALISING: 6, Status.COASTING: 4, Status.LOST: 2}
MAX_TEXT = 50


class PacketWriter:
    """Encodes MAVLink 2 packets of one component, with consecutive sequence numbers.

    Parameters
    ----------
    system_id
        The vehicle's, once it is known.
    """

    def __init__(self, system_id: int = 1) -> None:
        from pymavlink.dialects.v20 import ardupilotmega

        self._mavlink = ardupilotmega.MAVLink(None, srcSystem=system_id, srcComponent=COMPONENT_ID)

    def set_system(self, system_id: int) -> None:
        """Set the system id."""
        self._mavlink.srcSystem = system_id

    def _pack(self, message: Any) -> bytes:
        data = bytes(message.pack(self._mavlink))
        self._mavlink.seq = (self._mavlink.seq + 1) % 256
        return data

    def heartbeat(self) -> bytes:
        """Heartbeat of this component."""
        return self._pack(self._mavlink.heartbeat_encode(ONBOARD_CONTROLLER, NO_AUTOPILOT, 0, 0, 4))

    def timesync(self, tc1_ns: int, ts1_ns: int) -> bytes:
        """Request the autopilot's time (``tc1_ns`` 0), or reply to its request."""
        return self._pack(self._mavlink.timesync_encode(tc1_ns, ts1_ns))

    def message_interval(self, vehicle: tuple[int, int], message_id: int, rate_hz: float) -> bytes:
        """Request a message from a vehicle (system, component) at a rate."""
        interval_us = 1e6 / rate_hz
        return self._pack(
            self._mavlink.command_long_encode(
                *vehicle, SET_MESSAGE_INTERVAL, 0, message_id, interval_us, 0, 0, 0, 0, 0
            )
        )

    def status_text(self, e: Estimate, text: str) -> bytes:
        """Text for the pilot; at most 50 characters are sent."""
        severity = _SEVERITIES[Status(e.status)]
        return self._pack(
            self._mavlink.statustext_encode(severity, text.encode("ascii", "replace")[:MAX_TEXT])
        )

    def plots(self, e: Estimate, boot_ms: int) -> list[bytes]:
        """Heading, offset and status by name, a message each."""
        values = {
            "cf_psi": e.heading_rad,
            "cf_psi_sd": e.heading_std_rad,
            "cf_y": e.lateral_offset_m,
            "cf_y_sd": e.lateral_offset_std_m,
            "cf_yn": e.lateral_offset_norm,
            "cf_yn_sd": e.lateral_offset_norm_std,
            "cf_status": STATUS_NUMBERS[Status(e.status)],
            "cf_corr": float(e.corridor_index),
        }
        encode = self._mavlink.named_value_float_encode
        return [self._pack(encode(boot_ms, name.encode(), value)) for name, value in values.items()]

    def offset_vector(self, e: Estimate) -> bytes:
        """Lateral offset, its sigma (in metres if the width is known, else in half widths) and heading."""
        in_metres = isfinite(e.lateral_offset_m)
        offset = e.lateral_offset_m if in_metres else e.lateral_offset_norm
        std = e.lateral_offset_std_m if in_metres else e.lateral_offset_norm_std
        name = b"corridor_m" if in_metres else b"corridor_n"
        return self._pack(
            self._mavlink.debug_vect_encode(name, e.timestamp_ns // 1000, offset, std, e.heading_rad)
        )

    def odometry(self, e: Estimate, pose: Pose, config: FusionConfig, with_position: bool) -> bytes:
        """Yaw and, if requested, position from the first corridor's axis; all unknown while lost."""
        quality = quality_of(e, config)
        q = [nan] * 4
        if quality != FAILED_QUALITY:
            tilt = [angle if isfinite(angle) else 0.0 for angle in (e.roll_rad, e.pitch_rad)]
            q = quaternions(*np.array([[*tilt, pose.yaw_rad]]).T)[0].tolist()
        covariance = [nan] + [0.0] * 20
        covariance[ROLL] = covariance[PITCH] = config.attitude_std_rad**2
        covariance[YAW] = pose.yaw_std_rad**2
        place = [nan, nan, nan]
        if with_position:
            place = [pose.x_m, pose.y_m, 0.0]
            covariance[0], covariance[6], covariance[11] = *pose.variance_m2, HEIGHT_STD_M**2
        return self._pack(
            self._mavlink.odometry_encode(
                e.timestamp_ns // 1000,
                LOCAL_FRD,
                BODY_FRD,
                *place,
                q,
                *[nan] * 6,
                covariance,
                [nan] + [0.0] * 20,
                pose.reset_counter,
                VISION,
                quality,
            )
        )


def quality_of(e: Estimate, config: FusionConfig) -> int:
    """Quality in per cent, 1 to 100: 100 for a heading known exactly and confirmed by frames; -1 if it is lost."""
    if e.status in (Status.LOST, Status.INITIALISING) or not isfinite(e.heading_std_rad):
        return FAILED_QUALITY
    share = 1.0 - e.heading_std_rad / config.lost_heading_std_rad
    best = 100.0 if e.status == Status.TRACKING else 50.0
    return min(max(round(best * share), 1), 100)
