"""Settings of `corridor live` besides the estimator's; recorded with the flight, for the replay."""

from __future__ import annotations

from enum import StrEnum

from pydantic import Field

from fusion.settings.model import Settings


class SendPosition(StrEnum):
    """Whether ``ODOMETRY`` carries a position."""

    AUTO = "auto"  # to ArduPilot, which uses no yaw without one
    NEVER = "never"
    ALWAYS = "always"


class LiveSettings(Settings):
    """How estimates are sent, and which messages are requested from the autopilot."""

    rate_hz: float = Field(default=50.0, ge=1, le=200, description="Estimates a second.")
    plot_rate_hz: float = Field(
        default=10.0, ge=0, le=200, description="NAMED_VALUE_FLOAT messages of each name a second; 0: none."
    )
    imu_rate_hz: float = Field(
        default=100.0, ge=0, le=1000, description="IMU messages to ask for a second; 0: ask for nothing."
    )
    send_position: SendPosition = Field(
        default=SendPosition.AUTO, description="Whether ODOMETRY carries a position, see docs/live.md."
    )
    use_velocity: bool = Field(
        default=False,
        description="Whether the speed is taken from the autopilot's LOCAL_POSITION_NED; only where its own filter "
        "has optical flow or the like, not where it lives on these estimates.",
    )
