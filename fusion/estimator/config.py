"""Everything that can be set, in one flat table; SI units and radians, as the names say.

A TOML file holds the same names: ``corridor_width_m = 2.2``. What is not named keeps its default.
"""

from __future__ import annotations

from math import radians
from pathlib import Path
from typing import Literal, Self

from pydantic import Field, model_validator

from fusion.settings.model import Settings
from fusion.settings.toml import build, read_toml

DEFAULT_GYRO_NOISE_DENSITY = 0.0075  # rad/s/sqrt(Hz): a consumer MEMS gyroscope on a vibrating frame
DEFAULT_GYRO_BIAS_WALK = 1e-4  # rad/s^2/sqrt(Hz)
IMU_YAW_WALK_OVER_GYRO = 1.2


class FusionConfig(Settings):
    """Settings of the estimator; frozen, unknown names refused.

    Densities are one-sided square roots of power spectral densities, as sensor files declare them.
    """

    corridor_width_m: float | None = Field(
        default=None,
        gt=0.2,
        le=100,
        description="Width between the walls; where nothing tells it, offsets stay scale-free.",
    )
    camera_height_m: float | None = Field(
        default=None,
        gt=0.01,
        le=100,
        description="Camera above the floor; gives the width where that is not given, before a range sensor.",
    )
    camera_delay_s: float = Field(
        default=0.0, ge=0, le=5, description="How much later than mid-exposure the frames are stamped."
    )
    camera_delay_std_s: float = Field(
        default=0.0,
        ge=0,
        le=0.05,
        description="Standard deviation of camera_delay_s; above 0, the delay is estimated in flight, from turns.",
    )
    buffer_s: float = Field(
        default=0.5,
        ge=0.01,
        le=30,
        description="How late a sample may arrive, behind the newest, and still count.",
    )
    fixed_lag_s: float | None = Field(
        default=None,
        ge=0.25,
        le=2,
        description="How far behind the newest sample a smoothed estimate is given in flight; None: not at all.",
    )

    gyro_noise_density: float | None = Field(
        default=None, gt=0, le=1, description="rad/s/sqrt(Hz); None: as the log declares, else 0.0075."
    )
    gyro_bias_walk: float | None = Field(
        default=None, gt=0, le=1, description="rad/s^2/sqrt(Hz); None: as the log declares, else 1e-4."
    )
    gyro_bias_std_rad_s: float = Field(
        default=0.02, gt=0, le=1, description="Bias of the yaw rate at the start."
    )
    gyro_scale_std: float = Field(
        default=0.01,
        ge=0,
        le=0.2,
        description="Relative error of the gyroscope's scale; data sheets say .5 to 3 %.",
    )
    gyro_gap_s: float = Field(
        default=0.1, gt=0, le=5, description="Silence after which the gyroscope counts as gone."
    )
    gyro_range_rad_s: float = Field(
        default=35.0,
        gt=0,
        le=200,
        description="Largest rate of any axis that the gyroscope can measure; 35 rad/s is 2000 degrees/s.",
    )
    yaw_acceleration_density: float = Field(
        default=1.0,
        gt=0,
        le=100,
        description="rad/s^2/sqrt(Hz); how the yaw rate wanders while nothing measures it.",
    )

    imu_yaw_use: Literal["auto", "always", "never"] = Field(
        default="auto",
        description="Whether the IMU's yaw corrects the heading. auto: once frames have shown that it does not "
        "stray together with the gyroscope; till then its offset is followed and changes nothing else.",
    )
    imu_yaw_std_rad: float = Field(
        default=radians(0.5), gt=0, le=1, description="White noise of the IMU's yaw."
    )
    imu_yaw_walk: float | None = Field(
        default=None,
        gt=0,
        le=10,
        description="rad/sqrt(s); wander of the IMU's yaw against the corridor. None: 1.2 times the gyroscope's.",
    )
    imu_yaw_gate_sigma: float = Field(default=5.0, ge=1, le=100, description="Gate of the IMU's yaw.")
    attitude_std_rad: float = Field(
        default=radians(0.5), gt=0, le=1, description="Roll and pitch of the attitude stream."
    )

    heading_gate_sigma: float = Field(default=4.0, ge=1, le=100, description="Gate of the frames' heading.")
    heading_std_floor_rad: float = Field(
        default=radians(0.05), gt=0, le=1, description="No frame's heading is believed better than this."
    )
    heading_correlation_s: float = Field(
        default=0.03,
        ge=0,
        le=10,
        description="Time over which errors of successive headings resemble each other; with a gyroscope, what is "
        "learned in flight starts from it.",
    )
    min_lines: int = Field(
        default=4, ge=2, le=1000, description="Lines that must meet for a frame to be used."
    )

    velocity_std_m_s: float = Field(
        default=0.1,
        gt=0,
        le=50,
        description="Sideways velocity left unexplained where a velocity stream is given.",
    )
    lateral_velocity_time_s: float = Field(default=1.0, gt=0, le=100, description="Its correlation time.")
    lateral_rate_hz: float | None = Field(
        default=None,
        gt=0,
        le=1000,
        description="How often at most a frame is searched for the lateral offset; None: every frame. Errors of "
        "frames near to each other are alike, so at 30 frames/s 15 Hz costs half and tells nearly as much.",
    )
    lateral_gate_sigma: float = Field(default=4.0, ge=1, le=100, description="Gate of the lateral offset.")
    lateral_std_floor_norm: float = Field(
        default=0.005,
        gt=0,
        le=1,
        description="No frame's offset is believed better than this, in half widths.",
    )
    position_dead_band_norm: float = Field(
        default=0.1, ge=0, lt=1, description="Offsets up to this, in half widths, are called centre."
    )

    start_frames: int = Field(
        default=5, ge=1, le=100, description="Agreeing frames whose median is the first heading."
    )
    recovery_frames: int = Field(
        default=10, ge=3, le=40, description="Rejected frames that, agreeing, are believed."
    )
    recovery_spread_rad: float = Field(
        default=radians(1.5), gt=0, le=0.5, description="How well they must agree."
    )
    axis_jump_hold_s: float = Field(
        default=10.0,
        ge=0,
        le=60,
        description="How long another direction must last that no turn of the vehicle explains.",
    )
    junction_min_turn_rad: float = Field(
        default=radians(20), gt=0, le=radians(60), description="Corridors that meet differ by more than this."
    )
    junction_frames: int = Field(
        default=5, ge=3, le=40, description="Agreeing frames that make a new corridor."
    )
    junction_time_s: float = Field(default=0.7, ge=0, le=60, description="Time over which they must agree.")
    junction_revert_s: float = Field(
        default=8.0, ge=0, le=60, description="Time in which a return to the old axis undoes a new corridor."
    )

    coasting_after_s: float = Field(
        default=0.2,
        gt=0,
        le=60,
        description="Age of vision at which status is coasting (or 2.5 frame intervals).",
    )
    lost_after_s: float = Field(
        default=10.0, gt=0, le=3600, description="Age of vision at which status is lost."
    )
    lost_heading_std_rad: float = Field(
        default=radians(10),
        gt=0,
        le=3,
        description="Heading sigma beyond which status is lost and frames start anew.",
    )

    @model_validator(mode="after")
    def _check_together(self) -> Self:
        if self.camera_delay_s >= self.buffer_s:
            raise ValueError(
                f"camera_delay_s = {self.camera_delay_s:g} must be less than buffer_s = {self.buffer_s:g}"
            )
        if self.lost_after_s < self.coasting_after_s:
            raise ValueError(
                f"lost_after_s = {self.lost_after_s:g} is less than coasting_after_s = {self.coasting_after_s:g}"
            )
        return self

    @property
    def gyro_noise(self) -> float:
        """Gyroscope noise density in use, rad/s/sqrt(Hz)."""
        return self.gyro_noise_density or DEFAULT_GYRO_NOISE_DENSITY

    @property
    def bias_walk(self) -> float:
        """Gyroscope bias walk in use, rad/s^2/sqrt(Hz)."""
        return self.gyro_bias_walk or DEFAULT_GYRO_BIAS_WALK

    @property
    def offset_walk(self) -> float:
        """Wander of the IMU's yaw offset in use, rad/sqrt(s)."""
        return self.imu_yaw_walk or IMU_YAW_WALK_OVER_GYRO * self.gyro_noise

    @classmethod
    def from_toml(cls, path: str | Path) -> FusionConfig:
        """Read a TOML file.

        Raises
        ------
        InputError
            Where the file is missing or torn, or names something unknown or out of bounds.
        """
        return build(cls, read_toml(path), path)
