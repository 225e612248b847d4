"""Configuration of a simulated flight; SI units and radians, with the unit in the name.

A TOML file holds one table per section: ``[scene]``, ``[camera]``, ``[imaging]``, ``[motion]``, ``[imu]``,
``[attitude]``, ``[range]``; missing settings keep their defaults. A flight has a range sensor only with a table
``[range]``.
"""

from __future__ import annotations

from math import cos, pi, radians, sin, tan
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from fusion.settings.model import Settings
from fusion.settings.toml import build, read_toml
from fusion.simulate.scene.config import NotNegative, Positive, SceneConfig, Share, Sides
from fusion.simulate.scene.random_scene import is_night
from vision import Camera
from vision.cameras.camera import COEFFICIENT_COUNTS, Distortion

Angle = Annotated[float, Field(ge=-pi, le=pi)]


class CameraConfig(Settings):
    """Lens, mount, shutter and clock of the camera."""

    width_px: int = Field(default=320, ge=16, le=4096)
    height_px: int = Field(default=240, ge=16, le=4096)
    horizontal_fov_rad: float = Field(
        default=radians(69), gt=0.1, lt=2 * pi, description="Sets the focal length where fx_px is not given."
    )
    fx_px: Positive | None = Field(
        default=None, description="Focal length; fy_px is the same where not given."
    )
    fy_px: Positive | None = None
    cx_px: float | None = Field(default=None, description="Principal point; the middle where not given.")
    cy_px: float | None = None
    distortion: Distortion = Field(default=Distortion.NONE, description="none, radtan or equidistant.")
    coefficients: tuple[float, ...] = Field(default=(), description="Of the lens model, in OpenCV's order.")
    mount_roll_rad: Angle = 0.0
    mount_pitch_rad: Angle = Field(default=0.0, description="Positive: the camera looks up.")
    mount_yaw_rad: Angle = Field(default=0.0, description="Positive: the camera looks right.")
    position_m: tuple[float, float, float] = Field(
        default=(0.06, 0.0, 0.0), description="On the body: forward, right, down."
    )
    rate_hz: float = Field(default=20.0, gt=0, le=500)
    exposure_s: float = Field(default=0.008, ge=0, le=0.5, description="Motion blur follows from it.")
    line_delay_s: float = Field(default=0.0, ge=0, le=2e-4, description="Rolling shutter, from row to row.")
    time_offset_s: float = Field(
        default=0.0, ge=-1, le=1, description="How much later than mid-exposure the frames are stamped."
    )
    lost_frames_share: float = Field(default=0.0, ge=0, lt=1)

    @model_validator(mode="after")
    def _check_lens(self) -> Self:
        counts = COEFFICIENT_COUNTS[self.distortion]
        if len(self.coefficients) not in counts:
            wanted = " or ".join(str(n) for n in counts)
            raise ValueError(
                f"distortion {self.distortion} takes {wanted} coefficients, not {len(self.coefficients)}"
            )
        if self.distortion is not Distortion.EQUIDISTANT and self.horizontal_fov_rad >= radians(170):
            raise ValueError("a field of view of 170 degrees or more needs distortion equidistant")
        return self

    @classmethod
    def random(cls, seed: int, **fixed: object) -> CameraConfig:
        """Draw a lens, its field of view, the mount and the shutter; keyword arguments stay as given."""
        from fusion.simulate.random_flight import draw_camera

        return build(cls, draw_camera(seed) | fixed)

    def camera(self) -> Camera:
        """Return the calibrated camera."""
        half = self.horizontal_fov_rad / 2
        if self.distortion is Distortion.EQUIDISTANT:
            k = self.coefficients
            radius = half * (1 + sum(c * half ** (2 * i + 2) for i, c in enumerate(k)))
        else:
            radius = tan(half)
        fx = self.fx_px or self.width_px / 2 / radius
        fy = self.fy_px or fx
        cx = (self.width_px - 1) / 2 if self.cx_px is None else self.cx_px
        cy = (self.height_px - 1) / 2 if self.cy_px is None else self.cy_px
        forward = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
        mount = rotation(self.mount_yaw_rad, self.mount_pitch_rad, self.mount_roll_rad)
        return Camera(
            self.width_px,
            self.height_px,
            fx,
            fy,
            cx,
            cy,
            distortion=self.distortion,
            coefficients=self.coefficients,
            R_body_camera=mount @ forward,
            exposure_s=self.exposure_s,
            p_body_camera_m=np.array(self.position_m),
            line_delay_s=self.line_delay_s,
        )


class ImagingConfig(Settings):
    """The camera's picture chain."""

    brightness: Positive = Field(
        default=0.2,
        description="Mean of the picture in linear light, of full scale: 0.2 is well exposed, 0.02 dark.",
    )
    noise: bool = True
    full_well_electrons: Positive = Field(default=12000.0, description="Full scale; sets the shot noise.")
    gain: Positive = Field(default=1.0, description="Full scale is the full well over the gain.")
    read_noise_electrons: NotNegative = 6.0
    row_noise_electrons: NotNegative = Field(
        default=0.0, description="Noise of whole rows, independent from picture to picture."
    )
    fixed_pattern_electrons: NotNegative = Field(
        default=0.0, description="Of pixels, the same in each picture."
    )
    response_std: Share = Field(default=0.0, description="How unequally pixels respond to light.")
    defocus_px: NotNegative = Field(default=0.6, description="Standard deviation of the lens blur.")
    vignetting: Share = Field(default=0.6, description="1 is the cosine's full fourth power.")
    bloom: Share = Field(default=0.04, description="Light that the lens spreads widely.")
    gamma: Positive = 2.2
    contrast: Positive = 1.0
    jpeg_quality: Annotated[int, Field(ge=1, le=100)] | None = Field(default=85, description="None: PNG.")

    @classmethod
    def random(cls, seed: int, **fixed: object) -> ImagingConfig:
        """Draw a camera between good and poor, by night with a high gain; keyword arguments stay as given."""
        rng = np.random.default_rng((seed, 15))
        drawn: dict[str, object] = cls.random_office(seed).model_dump()
        drawn["fixed_pattern_electrons"] = float(rng.uniform(0.0, 4.0))
        drawn["response_std"] = float(rng.uniform(0.0, 0.02))
        if is_night(seed):
            drawn |= {
                "brightness": float(np.exp(rng.uniform(np.log(0.02), np.log(0.15)))),
                "full_well_electrons": float(rng.uniform(5000, 12000)),
                "gain": float(np.exp(rng.uniform(np.log(2), np.log(20)))),
                "read_noise_electrons": float(rng.uniform(2, 8)),
                "row_noise_electrons": float(rng.uniform(0.0, 1.5)),
                "defocus_px": float(rng.uniform(0.5, 1.1)),
            }
        return build(cls, drawn | fixed)

    @classmethod
    def random_office(cls, seed: int, **fixed: object) -> ImagingConfig:
        """Draw a camera between good and poor in good light; keyword arguments stay as given."""
        rng = np.random.default_rng((seed, 3))
        drawn: dict[str, object] = {
            "brightness": float(np.exp(rng.uniform(np.log(0.08), np.log(0.35)))),
            "full_well_electrons": float(np.exp(rng.uniform(np.log(2000), np.log(20000)))),
            "read_noise_electrons": float(rng.uniform(2, 15)),
            "defocus_px": float(rng.uniform(0.35, 0.9)),
            "vignetting": float(rng.uniform(0.0, 1.0)),
            "bloom": float(rng.uniform(0.0, 0.10)),
            "jpeg_quality": int(rng.integers(70, 96)),
        }
        return build(cls, drawn | fixed)


class MotionConfig(Settings):
    """How the vehicle flies."""

    duration_s: float = Field(default=15.0, gt=0.2, le=3600)
    speed_m_s: float = Field(default=0.8, ge=0, le=20, description="Forward; it stops short of the end.")
    start_m: float = Field(default=3.0, ge=0.5, description="Along the first corridor.")
    height_m: Positive = Field(default=1.4, description="Above the floor.")
    height_amplitude_m: NotNegative = 0.08
    heading_amplitude_rad: float = Field(default=radians(15), ge=0, le=radians(80))
    heading_rate_rad_s: NotNegative = Field(default=radians(40), description="Greatest rate of the heading.")
    heading_mean_rad: Angle = Field(default=0.0, description="Heading that the vehicle swings about.")
    lateral_amplitude_m: NotNegative = 0.3
    lateral_rate_m_s: NotNegative = 0.3
    lateral_mean_m: float = Field(default=0.0, description="Right of the centre line.")
    tilt_rad: float = Field(default=radians(6), ge=0, le=radians(60), description="Greatest roll and pitch.")
    tilt_rate_rad_s: NotNegative = radians(30)
    end_margin_m: float = Field(default=2.0, ge=0.5, description="How far short of the end it stops.")
    turn_rate_rad_s: Positive = Field(default=radians(50), description="Mean rate in a junction.")
    turn_speed_m_s: Positive = Field(default=0.4, description="Forward speed in a junction.")
    route: tuple[int, ...] = Field(
        default=(), description="Numbers of the corridors to turn into, one after another; the first is 1."
    )


class ImuConfig(Settings):
    """Gyroscope and accelerometer; densities as sensor files declare them."""

    rate_hz: float = Field(default=200.0, ge=25, le=2000)
    gyro_noise_density: NotNegative = Field(default=0.005, description="rad/s/sqrt(Hz).")
    gyro_bias_std_rad_s: NotNegative = Field(default=0.01, description="Each axis, at the start.")
    gyro_random_walk: NotNegative = Field(default=1e-4, description="rad/s^2/sqrt(Hz).")
    accel_noise_density: NotNegative = Field(default=0.02, description="m/s^2/sqrt(Hz).")
    accel_bias_std_m_s2: NotNegative = 0.08
    accel_random_walk: NotNegative = Field(default=1e-3, description="m/s^3/sqrt(Hz).")
    gyro_scale_std: NotNegative = Field(default=0.0, description="Scale error, each axis.")
    accel_scale_std: NotNegative = Field(default=0.0, description="Scale error, each axis.")
    misalignment_std_rad: NotNegative = Field(default=0.0, description="Of each sensor's axes, one by one.")
    vibration_m_s2: NotNegative = Field(
        default=0.0,
        description="Root mean square of the rotors' vibration along x and y; along z twice that.",
    )
    rotor_hz: Positive = Field(default=140.0, description="Turns of a rotor in a second.")
    vibration_harmonics: int = Field(default=3, ge=1, le=10)

    @classmethod
    def random(cls, seed: int, **fixed: object) -> ImuConfig:
        """Draw sensors between good and poor, most shaken by the rotors; keyword arguments stay as given."""
        from fusion.simulate.random_flight import draw_imu

        return build(cls, draw_imu(seed) | fixed)


class AttitudeConfig(Settings):
    """The vehicle's own attitude filter; its yaw is off by a constant, drift and magnetic disturbance."""

    rate_hz: float = Field(default=50.0, gt=0, le=1000)
    tilt_std_rad: NotNegative = radians(0.5)
    tilt_time_s: Positive = Field(default=4.0, description="Correlation time of the tilt error.")
    yaw_offset_rad: Angle | None = Field(default=None, description="Constant; drawn where not given.")
    yaw_drift_rad_s: float = Field(default=radians(0.05), ge=-1, le=1)
    yaw_walk: NotNegative = Field(default=2e-3, description="Random walk of the yaw, rad/sqrt(s).")
    yaw_follows_gyro: bool = Field(
        default=False, description="The yaw is integrated from the IMU's gyroscope."
    )
    compass_time_s: Positive = Field(default=30.0, description="How slowly a compass pulls such a yaw back.")
    disturbance_rad: Angle = Field(default=radians(15), description="Magnetic disturbance of the yaw.")
    disturbance_start_s: NotNegative = 6.0
    disturbance_s: NotNegative = Field(default=0.0, description="How long it lasts; 0: there is none.")


class RangeConfig(Settings):
    """A range sensor beside the camera that looks down along the body's z."""

    rate_hz: float = Field(default=20.0, gt=0, le=1000)
    noise_std_m: NotNegative = 0.01


class SimulationConfig(Settings):
    """A simulated flight: the same configuration gives the same files, byte for byte."""

    seed: int = Field(default=1, ge=0)
    start_ns: int = Field(default=1_600_000_000_000_000_000, ge=0, description="Time of the first sample.")
    body_frame: Literal["flu", "frd"] = Field(default="flu", description="Body axes in the files.")
    scene: SceneConfig = SceneConfig()
    camera: CameraConfig = CameraConfig()
    imaging: ImagingConfig = ImagingConfig()
    motion: MotionConfig = MotionConfig()
    imu: ImuConfig | None = ImuConfig()
    attitude: AttitudeConfig | None = AttitudeConfig()
    range: RangeConfig | None = Field(default=None, description="Without it there is no range sensor.")
    light_cell_m: float = Field(default=0.15, ge=0.05, le=1, description="Grain of the lighting.")
    edge_samples: int = Field(default=4, ge=1, le=16, description="Across a pixel with an edge in it.")

    @model_validator(mode="after")
    def _check_route(self) -> Self:
        scene, motion = self.scene, self.motion
        flown = 1
        for number in motion.route:
            if not 2 <= number <= len(scene.junctions) + 1:
                raise ValueError(
                    f"route leads into corridor {number}, the scene has {len(scene.junctions) + 1}"
                )
            if scene.junctions[number - 2].from_corridor != flown:
                raise ValueError(f"route leads from corridor {flown} into {number}, which does not leave it")
            flown = number
        if motion.start_m > scene.length_m - 1:
            raise ValueError(
                f"start_m = {motion.start_m:g} leaves less than 1 m of length_m = {scene.length_m:g}"
            )
        if motion.height_m + motion.height_amplitude_m > scene.height_m - 0.15:
            raise ValueError(
                f"height_m = {motion.height_m:g} touches the ceiling, height_m = {scene.height_m:g}"
            )
        halves = [least_half_width_m(scene), *(scene.junctions[n - 2].width_m / 2 for n in motion.route)]
        reach = abs(motion.lateral_mean_m) + motion.lateral_amplitude_m
        if reach > min(halves) - 0.2:
            raise ValueError(f"lateral_amplitude_m and lateral_mean_m, {reach:g} together, touch a wall")
        if self.attitude is not None and self.attitude.yaw_follows_gyro and self.imu is None:
            raise ValueError("yaw_follows_gyro needs an imu")
        return self

    @classmethod
    def random(cls, seed: int, **fixed: Any) -> SimulationConfig:
        """Draw the corridor, the camera, the flight and the sensors.

        Keyword arguments stay as given; the rest of a section given as a dictionary is drawn.
        """
        from fusion.simulate.random_flight import draw_flight

        return build(cls, draw_flight(seed, fixed))

    @classmethod
    def random_office(cls, seed: int, **fixed: object) -> SimulationConfig:
        """Draw a plain office corridor and the camera's quality; keyword arguments stay as given."""
        scene, imaging = SceneConfig.random_office(seed), ImagingConfig.random_office(seed)
        return build(cls, {"seed": seed, "scene": scene, "imaging": imaging} | fixed)

    @classmethod
    def from_toml(cls, path: str | Path) -> SimulationConfig:
        """Read a TOML file.

        Raises
        ------
        InputError
            If the file is missing or invalid, or has an unknown setting or a value out of bounds.
        """
        return cls.from_values(read_toml(path), path)

    @classmethod
    def from_values(cls, values: dict[str, Any], file: str | Path | None = None) -> SimulationConfig:
        """Check a nested table; `InputError` names the setting, its value and the remedy."""
        return build(cls, values, file)


def least_half_width_m(scene: SceneConfig) -> float:
    """Distance from the first corridor's axis to its nearest wall, before or after a step in the width."""
    half, step = scene.width_m / 2, scene.width_step
    if step is None or step.width_m > scene.width_m:
        return half
    return step.width_m / 2 if step.moves is Sides.BOTH else step.width_m - half


def rotation(yaw_rad: float, pitch_rad: float, roll_rad: float) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Rotation (3, 3) of Z-Y-X angles: from the rotated frame to the fixed one (x forward, z down)."""
    cy, sy, cp, sp = cos(yaw_rad), sin(yaw_rad), cos(pitch_rad), sin(pitch_rad)
    cr, sr = cos(roll_rad), sin(roll_rad)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


__all__ = [
    "AttitudeConfig",
    "CameraConfig",
    "ImagingConfig",
    "ImuConfig",
    "MotionConfig",
    "RangeConfig",
    "SimulationConfig",
    "rotation",
]
