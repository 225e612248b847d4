"""All settings of the estimator in one flat table; SI units and radians, with the unit in the name.

A TOML file uses the same names: ``corridor_width_m = 2.2``. Settings that it does not name keep their defaults.
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
    """Settings of the estimator; frozen, unknown names rejected.

    Densities are one-sided square roots of power spectral densities, as sensor files declare them.
    """

    corridor_width_m: float | None = Field(
        default=None,
        ge=0.2,
        le=100,
        description="Corridor width, wall to wall. If neither it, camera_height_m nor a range sensor is given, "
        "offsets are in half widths.",
    )
    camera_height_m: float | None = Field(
        default=None,
        gt=0.01,
        le=100,
        description="Height of the camera above the floor. If corridor_width_m is not set, the width is computed "
        "from this height; it has priority over a range sensor.",
    )
    camera_delay_s: float = Field(
        default=0.0, ge=0, le=5, description="Time stamps of the frames less mid-exposure."
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
        description="How far a late sample may be behind the newest and still be used.",
    )
    fixed_lag_s: float | None = Field(
        default=None,
        ge=0.25,
        le=2,
        description="Lag of the smoothed estimate in flight behind the newest sample. None: no such estimate.",
    )

    gyro_noise_density: float | None = Field(
        default=None,
        gt=0,
        le=1,
        description="rad/s/sqrt(Hz); noise density of the gyroscope. None: as declared in the log, else 0.0075.",
    )
    gyro_bias_walk: float | None = Field(
        default=None,
        gt=0,
        le=1,
        description="rad/s^2/sqrt(Hz); random walk of the gyroscope's bias. None: as declared in the log, else 1e-4.",
    )
    gyro_bias_std_rad_s: float = Field(
        default=0.02, gt=0, le=1, description="Initial standard deviation of the yaw rate's bias."
    )
    gyro_scale_std: float = Field(
        default=0.01,
        ge=0,
        le=0.2,
        description="Standard deviation of the gyroscope's relative scale error, unit 1; 0.5 to 3 % in data sheets.",
    )
    gyro_gap_s: float = Field(
        default=0.1,
        gt=0,
        le=5,
        description="Time without samples after which the gyroscope is taken to be lost.",
    )
    gyro_range_rad_s: float = Field(
        default=35.0,
        gt=0,
        le=200,
        description="Measuring range of the gyroscope, on each axis; 35 rad/s is 2000 degrees/s.",
    )
    yaw_acceleration_density: float = Field(
        default=1.0,
        gt=0,
        le=100,
        description="rad/s^2/sqrt(Hz); random walk of the yaw rate while no sensor measures it.",
    )

    imu_yaw_use: Literal["auto", "always", "never"] = Field(
        default="auto",
        description="Whether the IMU's yaw corrects the heading. auto: only after the frames have shown that it does "
        "not drift with the gyroscope; until then only its offset is estimated.",
    )
    imu_yaw_std_rad: float = Field(
        default=radians(0.5), gt=0, le=1, description="Standard deviation of the IMU yaw's white noise."
    )
    imu_yaw_walk: float | None = Field(
        default=None,
        gt=0,
        le=10,
        description="rad/sqrt(s); random walk of the IMU yaw's offset. None: 1.2 times the gyroscope's noise.",
    )
    imu_yaw_gate_sigma: float = Field(
        default=5.0,
        ge=1,
        le=100,
        description="Gate of the IMU's yaw, in standard deviations of the innovation.",
    )
    attitude_std_rad: float = Field(
        default=radians(0.5),
        gt=0,
        le=1,
        description="Standard deviation of roll and pitch in the attitude stream.",
    )

    heading_gate_sigma: float = Field(
        default=4.0,
        ge=1,
        le=100,
        description="Gate of the frames' heading, in standard deviations of the innovation.",
    )
    heading_std_floor_rad: float = Field(
        default=radians(0.05), gt=0, le=1, description="Lower bound of a frame's heading standard deviation."
    )
    heading_correlation_s: float = Field(
        default=0.03,
        ge=0,
        le=10,
        description="Correlation time of the errors of successive frames; with a gyroscope, the initial value of the "
        "one estimated in flight.",
    )
    min_lines: int = Field(
        default=4,
        ge=2,
        le=1000,
        description="Number of lines that must meet for a frame to be used. Values below 4 have no effect on "
        "pictures, which always need 4; they apply to measurements made elsewhere.",
    )

    velocity_std_m_s: float = Field(
        default=0.1,
        gt=0,
        le=50,
        description="Standard deviation of the velocity stream's error across the corridor.",
    )
    lateral_velocity_time_s: float = Field(
        default=1.0, gt=0, le=100, description="Correlation time of the velocity stream's error."
    )
    lateral_rate_hz: float | None = Field(
        default=None,
        gt=0,
        le=1000,
        description="Highest rate at which frames are searched for the lateral offset; None: every frame. Errors of "
        "successive frames are correlated: at 30 frames/s, 15 Hz costs half and is nearly as accurate.",
    )
    lateral_gate_sigma: float = Field(
        default=4.0,
        ge=1,
        le=100,
        description="Scales the lateral offset's test ratio: a ratio of 1 is this many standard deviations of the "
        "innovation. Nothing is rejected.",
    )
    lateral_std_floor_norm: float = Field(
        default=0.005,
        gt=0,
        le=1,
        description="Lower bound of a frame's offset standard deviation, in half widths; only for measurements made "
        "elsewhere that have no offset evidence.",
    )
    position_dead_band_norm: float = Field(
        default=0.1,
        ge=0,
        lt=1,
        description="Largest offset, in half widths, for which the position is centre.",
    )

    start_frames: int = Field(
        default=5, ge=1, le=100, description="Number of agreeing frames whose median is the initial heading."
    )
    recovery_frames: int = Field(
        default=10,
        ge=3,
        le=40,
        description="Number of consistent rejected frames after which the filter resets its heading to them.",
    )
    recovery_spread_rad: float = Field(
        default=radians(1.5), gt=0, le=0.5, description="Largest spread of frames that agree."
    )
    axis_jump_hold_s: float = Field(
        default=10.0,
        ge=0,
        le=60,
        description="If the frames show a new direction although the vehicle did not turn: time for which they must "
        "keep showing it before it is accepted.",
    )
    junction_min_turn_rad: float = Field(
        default=radians(20),
        gt=0,
        le=radians(60),
        description="Smallest angle between two corridors at a junction.",
    )
    junction_frames: int = Field(
        default=5, ge=3, le=40, description="Number of agreeing frames that start a new corridor."
    )
    junction_time_s: float = Field(
        default=0.7, ge=0, le=60, description="Time over which these frames must agree."
    )
    junction_revert_s: float = Field(
        default=8.0,
        ge=0,
        le=60,
        description="Time within which a return to the old axis cancels a new corridor.",
    )

    coasting_after_s: float = Field(
        default=0.2,
        gt=0,
        le=60,
        description="Time without a used frame after which the status is coasting (at least 2.5 frame intervals).",
    )
    lost_after_s: float = Field(
        default=10.0, gt=0, le=3600, description="Time without a used frame after which the status is lost."
    )
    lost_heading_std_rad: float = Field(
        default=radians(10),
        gt=0,
        le=3,
        description="Heading sigma beyond which the status is lost and the filter starts again.",
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
        """Random walk of the IMU's yaw offset in use, rad/sqrt(s)."""
        return self.imu_yaw_walk or IMU_YAW_WALK_OVER_GYRO * self.gyro_noise

    @classmethod
    def from_toml(cls, path: str | Path) -> FusionConfig:
        """Read a TOML file.

        Raises
        ------
        InputError
            If the file is missing or malformed, or a setting is unknown or out of bounds.
        """
        return build(cls, read_toml(path), path)
