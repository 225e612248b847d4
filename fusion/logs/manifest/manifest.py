"""Contents of a manifest: the source of each stream of a flight; camera and IMU may be in different files.

`fusion.logs.manifest.file` reads and writes it, as ``flight.toml``.

Sign conventions for all readers and writers of a manifest:

- ``clock_offset_s`` is added: time of the flight = time in the file + ``clock_offset_s``. The flight's clock is that
  of the streams without an offset.
- ``body_from_imu_rad`` is roll, pitch and yaw of the IMU's own axes on the vehicle, as ``mount_rad``. It rotates the
  IMU together with the camera calibrated to it; if not set, it is found from gravity and the camera if they agree.
- ``mount_yaw_rad`` and ``mount_pitch_rad`` rotate the calibrated camera on the body: the true optical axis points
  further right and further up by these angles.
- ``focal_scale`` multiplies both focal lengths of the calibration.
- ``above_camera_m`` of a range sensor is subtracted from its distances, so that they count from the camera.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import radians
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import (
    BaseModel,
    ConfigDict,
    Discriminator,
    Field,
    Tag,
    field_validator,
    model_validator,
)

from fusion.logs.csv.column_map import READY_MAPS, ColumnMap, Frame
from fusion.logs.samples import Problems
from fusion.settings.sentences import did_you_mean
from vision import Camera
from vision.cameras.lens_check import lens_problem
from vision.rotations import rotation_from_angles

STREAMS = ("camera", "imu", "attitude", "velocity", "position", "range")

_STRICT = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


CameraAxis = Literal["x", "-x", "y", "-y", "z", "-z"]
MountAngle = Annotated[float, Field(ge=-6.2832, le=6.2832)]


def _kind_of_columns(value: object) -> str:
    return "name" if isinstance(value, str) else "map"


Columns = Annotated[
    Annotated[str, Tag("name")] | Annotated[ColumnMap, Tag("map")], Discriminator(_kind_of_columns)
]

#: Keys of the camera's table that state its mounting.
MOUNT_KEYS = ("mount_yaw_rad", "mount_pitch_rad", "mount_roll_rad")

#: Keys of a column map that apply to any format: units that differ from the format's own.
UNIT_KEYS = frozenset(
    {"gyro_unit", "accel_unit", "accel_sign", "velocity_unit", "position_unit", "range_unit"}
)


class StreamSource(BaseModel):
    """Source of one stream; unset fields are chosen from the log."""

    model_config = _STRICT

    file: Path | None = Field(default=None, description="The file or folder; without it, the manifest's log.")
    topic: str | None = Field(default=None, min_length=1, description="Which of the file's topics.")
    columns: Columns | None = Field(
        default=None,
        description="Columns of a CSV: a table of names and units, or " + " or ".join(READY_MAPS),
    )
    frame: Frame | None = Field(default=None, description="Axes of a CSV's vectors: frd, flu, ned or enu.")
    clock_offset_s: float = Field(
        default=0.0,
        strict=True,
        ge=-1e11,
        le=1e11,
        description="Added to the file's times to give the flight's.",
    )
    clock_rate: float = Field(
        default=1.0,
        strict=True,
        ge=0.5,
        le=2.0,
        description="Seconds of the flight in a second of the file's clock, counted from the stream's first sample.",
    )
    use: bool = Field(default=True, description="false leaves the stream out.")

    def units(self) -> ColumnMap | None:
        """Return the column map if it contains only units, which apply to any format; else None."""
        is_units = isinstance(self.columns, ColumnMap) and self.columns.model_fields_set <= UNIT_KEYS
        return self.columns if is_units and isinstance(self.columns, ColumnMap) else None

    def open_options(self) -> dict[str, Path | float | str | ColumnMap | None]:
        """Return the table's options for opening the file, by key; None if not set."""
        return {
            "columns": self.columns,
            "frame": self.frame,
            "times": None,
            "start_ns": None,
            "rate_hz": None,
        }

    @model_validator(mode="after")
    def _known_columns(self) -> Self:
        if isinstance(self.columns, str) and self.columns not in READY_MAPS:
            near = did_you_mean(self.columns, READY_MAPS, cutoff=0.3)
            remedy = near or f"did you mean {' or '.join(READY_MAPS)}?"
            raise ValueError(f"columns = {self.columns!r} is not a known map: {remedy}")
        return self


class SensorSource(StreamSource):
    """Source of a body-mounted sensor's samples, and its mounting."""

    mount_rad: tuple[MountAngle, MountAngle, MountAngle] | None = Field(
        default=None,
        description="Roll, pitch and yaw of the sensor on the body: right side down, nose up, to the right.",
    )


class ImuSource(SensorSource):
    """Source of the IMU's samples, its mounting and noise."""

    camera_axis: CameraAxis | None = Field(
        default=None,
        description="Which of the IMU's own axes the camera looks along, as -z of a phone; gravity gives the rest.",
    )
    noise: Path | None = Field(
        default=None, description="Kalibr's imu.yaml or EuRoC's sensor.yaml with the gyroscope's noise."
    )


class RangeSource(StreamSource):
    """Source of the distances to the floor, and the sensor's position."""

    above_camera_m: float = Field(
        default=0.0,
        strict=True,
        ge=-10.0,
        le=10.0,
        description="How much higher the sensor sits than the camera; negative below it.",
    )


class CameraSource(StreamSource):
    """Source of the pictures, and their camera."""

    calibration: Path | None = Field(default=None, description="Calibration file; without it, the log's own.")
    times: Path | None = Field(
        default=None,
        description="CSV with the time of each frame of a video or picture folder, a row per frame.",
    )
    start_ns: int | None = Field(
        default=None, strict=True, ge=-(2**62), le=2**62, description="Time of the first frame."
    )
    rate_hz: float | None = Field(
        default=None,
        strict=True,
        gt=0.0,
        le=2000.0,
        description="Frames a second of numbered pictures or of a video without times.",
    )
    mount_yaw_rad: float = Field(
        default=0.0,
        strict=True,
        ge=-radians(90),
        le=radians(90),
        description="How much further right the camera looks.",
    )
    mount_pitch_rad: float = Field(
        default=0.0,
        strict=True,
        ge=-radians(90),
        le=radians(90),
        description="How much further up the camera looks.",
    )
    mount_roll_rad: float = Field(
        default=0.0,
        strict=True,
        ge=-radians(180.1),
        le=radians(180.1),
        description="How much further its right side hangs down; 3.1416 where it is mounted upside down.",
    )
    rescale_calibration: bool = Field(
        default=False, description="true where the pictures are the calibration's, scaled to another size."
    )
    focal_scale: float = Field(
        default=1.0, strict=True, ge=0.2, le=5.0, description="Factor on the focal lengths."
    )

    def open_options(self) -> dict[str, Path | float | str | ColumnMap | None]:
        """Return the table's options for opening the file, by key; None if not set."""
        return super().open_options() | {
            "times": self.times,
            "start_ns": self.start_ns,
            "rate_hz": self.rate_hz,
        }

    @model_validator(mode="after")
    def _one_clock(self) -> Self:
        if self.times is not None and self.start_ns is not None:
            raise ValueError("times and start_ns both say when the frames were taken: give one of them")
        if self.times is not None and self.rate_hz is not None:
            raise ValueError("times and rate_hz both say when the frames were taken: give one of them")
        return self


class Manifest(BaseModel):
    """A flight put together from files; paths are absolute in memory, relative to the manifest in the file."""

    model_config = _STRICT

    name: str | None = Field(default=None, min_length=1, description="Of the flight.")
    vehicle: str | None = Field(
        default=None, min_length=1, description="Which vehicle flew: `corridor batch` compares them."
    )
    log: Path | None = Field(
        default=None, description="Log or flight folder from which everything comes that is not named below."
    )
    corridor_width_m: float | None = Field(
        default=None,
        strict=True,
        gt=0.2,
        le=100,
        description="Width between the walls, for offsets in metres.",
    )
    body_from_imu_rad: tuple[MountAngle, MountAngle, MountAngle] | None = Field(
        default=None,
        description="Roll, pitch and yaw of the IMU's axes on the vehicle; turns IMU and camera together.",
    )
    truth: Path | None = Field(
        default=None, description="corridor_truth.csv, if known: errors are then reported."
    )
    camera: CameraSource = Field(default_factory=CameraSource)
    imu: ImuSource = Field(default_factory=ImuSource)
    attitude: SensorSource = Field(default_factory=SensorSource)
    velocity: StreamSource = Field(default_factory=StreamSource)
    position: StreamSource = Field(default_factory=StreamSource)
    range: RangeSource = Field(default_factory=RangeSource)

    @field_validator("name")
    @classmethod
    def _plain_name(cls, name: str | None) -> str | None:
        if name is not None and (name in (".", "..") or set("/\\\0") & set(name)):
            raise ValueError(f"name = {name!r} names a place: give a plain name, without slashes")
        return name

    @model_validator(mode="after")
    def _some_pictures(self) -> Self:
        if self.log is None and self.camera.file is None:
            raise ValueError("neither log nor [camera] file says where the pictures are")
        if not self.camera.use:
            raise ValueError("[camera] use is false: a flight needs its pictures")
        return self

    def with_calibration(self, path: Path) -> Self:
        """Return the manifest with another calibration of the camera."""
        camera = self.camera.model_copy(update={"calibration": path.absolute()})
        return self.model_copy(update={"camera": camera})

    def streams(self) -> dict[str, StreamSource]:
        """Return the source of each of `STREAMS`, by name."""
        return {
            "camera": self.camera,
            "imu": self.imu,
            "attitude": self.attitude,
            "velocity": self.velocity,
            "position": self.position,
            "range": self.range,
        }

    def stream(self, name: str) -> StreamSource:
        """Return the source of one of `STREAMS`."""
        return self.streams()[name]


def corrected_camera(camera: Camera, source: CameraSource) -> Camera:
    """Apply a manifest's corrections to a calibration: mounting yaw, pitch, then roll, in the body; focal lengths.

    A mounting angle that is set, even to zero, states the mounting.
    """
    from dataclasses import replace

    angles_rad = (source.mount_yaw_rad, source.mount_pitch_rad, source.mount_roll_rad)
    is_stated = not source.model_fields_set.isdisjoint(MOUNT_KEYS)
    if not is_stated and source.focal_scale == 1.0:
        return camera
    return replace(
        camera,
        mount_assumed=camera.mount_assumed and not is_stated,
        fx_px=camera.fx_px * source.focal_scale,
        fy_px=camera.fy_px * source.focal_scale,
        R_body_camera=rotation_from_angles(*angles_rad) @ camera.R_body_camera,
    )


def camera_problems(camera: Camera) -> Problems:
    """Return what is assumed or implausible in a camera's mounting and lens, a sentence each."""
    texts = (
        camera.mount_problem(f"{' or '.join(MOUNT_KEYS)} under [camera] in flight.toml"),
        lens_problem(camera),
    )
    return tuple(text for text in texts if text is not None)


def files_of(manifest: Manifest) -> Iterator[tuple[str, Path]]:
    """Yield each file that a manifest names, with its key."""
    for key, value in manifest:
        if isinstance(value, Path):
            yield key, value
        elif isinstance(value, StreamSource):
            yield from ((f"{key}.{inner}", path) for inner, path in value if isinstance(path, Path))


def files_outside(manifest: Manifest, folder: Path) -> list[Path]:
    """Return the files outside this folder that a manifest in it names."""
    return [path for _, path in files_of(manifest) if not path.is_relative_to(folder.resolve())]
