"""Map of the columns of a CSV file to quantities and units, with predefined maps for common logs.

A map names columns by their header or by their number, starting at 1. Three columns are a vector, four a quaternion.
Columns that are not named are not read.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator

from fusion.logs.units import in_si, is_counts

Column = Annotated[int, Field(ge=1, strict=True)] | Annotated[str, Field(min_length=1, strict=True)]
Vector = tuple[Column, Column, Column]

TimeUnit = Literal["ns", "us", "100us", "ms", "s", "days", "iso"]
AngleUnit = Literal["rad", "deg", "mdeg"]


def _unit_or_counts(*units: str) -> AfterValidator:
    """Accept these units, and raw counts per the second of them, as in a sensor's data sheet."""

    def check(unit: str) -> str:
        if unit in units or (is_counts(unit) and unit.rpartition("/")[0] in units):
            return unit
        listed = ", ".join(units)
        raise ValueError(
            f"{unit!r} is not a known unit: give {listed}, or {units[1]}/N where N counts are one"
        )

    return AfterValidator(check)


RateUnit = Annotated[str, _unit_or_counts("rad/s", "deg/s", "mrad/s", "mdeg/s")]
AccelUnit = Annotated[str, _unit_or_counts("m/s2", "g", "mg", "cm/s2")]
SpeedUnit = Literal["m/s", "dm/s", "cm/s", "mm/s"]
LengthUnit = Literal["m", "dm", "cm", "mm"]
Separator = Literal[",", ";", "\t", " ", "|"]

Frame = Literal["frd", "flu", "ned", "enu"]
"""Axes of a stream: of the body ``frd`` or ``flu``, of the world ``ned`` or ``enu``.

An attitude takes ``frd`` (to a world with z down, the same as ``ned``), ``flu`` (to a world with x ahead, y left and
z up) or ``enu`` (FLU to east, north, up, as in ROS). An IMU's ``ned`` and ``enu`` mean ``frd`` and ``flu``; a
position's ``frd`` and ``flu`` are worlds with z down and z up; a velocity may be along either kind of axes.
"""


class ColumnMap(BaseModel):
    """Columns by name or number and their units; frozen, unknown names rejected."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    time: Column | None = Field(
        default=None, description="Column of the time stamps; else the usual names are tried."
    )
    time_unit: TimeUnit | None = Field(
        default=None, description="ns, us, 100us, ms, s, days, or iso for dates; else found from the values."
    )
    separator: Separator | None = Field(default=None, description="Between columns; else found.")
    header: bool | None = Field(
        default=None, description="Whether the first line names the columns; else found."
    )
    frame: Frame | None = Field(
        default=None, description="Axes of the vectors; a stream's own frame comes first."
    )
    velocity_frame: Frame | None = Field(
        default=None, description="Axes of the velocity, where they are others."
    )
    gyro: Vector | None = Field(default=None, description="Angular rate about x, y, z.")
    gyro_unit: RateUnit = "rad/s"
    accel: Vector | None = Field(default=None, description="Specific force along x, y, z.")
    accel_unit: AccelUnit = "m/s2"
    accel_sign: Literal[1, -1] = Field(
        default=1, description="-1 where the file gives gravity's pull, +1 g along z at rest in frd."
    )
    quaternion: tuple[Column, Column, Column, Column] | None = Field(
        default=None, description="Attitude, body to world, in the order w, x, y, z."
    )
    euler: Vector | None = Field(default=None, description="Attitude as roll, pitch, yaw.")
    euler_unit: AngleUnit = "rad"
    velocity: Vector | None = Field(default=None, description="Velocity along x, y, z.")
    velocity_unit: SpeedUnit = "m/s"
    position: Vector | None = Field(default=None, description="Position x, y, z.")
    position_unit: LengthUnit = "m"
    range: Column | None = Field(default=None, description="Distance to the floor along the body's z.")
    range_unit: LengthUnit = "m"
    range_limits: tuple[float, float] | None = Field(
        default=None, description="Between which the range sensor measures, in its unit; the rest is dropped."
    )
    picture: Column | None = Field(default=None, description="File names of pictures.")

    @model_validator(mode="after")
    def _one_attitude(self) -> ColumnMap:
        if self.quaternion is not None and self.euler is not None:
            raise ValueError("quaternion and euler say the same thing: give one of them")
        return self

    def columns_of(self, role: str) -> tuple[Column, ...]:
        """Return the columns named for a role such as ``gyro``; none if not set."""
        named: tuple[Column, ...] | Column | None = self._roles()[role][0]
        if named is None:
            return ()
        return named if isinstance(named, tuple) else (named,)

    def unit_of(self, role: str) -> str | None:
        """Return the unit of a role's columns; None if it has none."""
        return self._roles()[role][1]

    @property
    def units_taken(self) -> dict[str, float]:
        """Factors of an IMU's units to SI, by key."""
        return {"gyro_unit": in_si(self.gyro_unit), "accel_unit": in_si(self.accel_unit)}

    def _roles(self) -> dict[str, tuple[tuple[Column, ...] | Column | None, str | None]]:
        return {
            "gyro": (self.gyro, self.gyro_unit),
            "accel": (self.accel, self.accel_unit),
            "quaternion": (self.quaternion, None),
            "euler": (self.euler, self.euler_unit),
            "velocity": (self.velocity, self.velocity_unit),
            "position": (self.position, self.position_unit),
            "range": (self.range, self.range_unit),
        }


# DJI Tello, state packets of SDK 1.3 to 3.0, ten a second. Roll, pitch and yaw are whole degrees, yaw positive to
# the right. agx, agy, agz are thousandths of g, about -1000 along z at rest, which is FRD specific force. The manual
# names neither unit nor axes of vgx, vgy, vgz; flights show decimetres per second along the axes of yaw = 0
# (x forward at power-on, y right, z down). `time` counts whole seconds of motor time and cannot stamp samples: the
# recorder has to add a time of its own. tof is centimetres along the body's z: 30 to 1000 by the manual, 10 on
# the ground, and 6553 (0xFFFF millimetres) without an echo.
_TELLO = ColumnMap(
    frame="frd",
    velocity_frame="ned",
    accel=("agx", "agy", "agz"),
    accel_unit="mg",
    euler=("roll", "pitch", "yaw"),
    euler_unit="deg",
    velocity=("vgx", "vgy", "vgz"),
    velocity_unit="dm/s",
    range="tof",
    range_unit="cm",
    range_limits=(30.0, 1000.0),
)

# AR.Drone as ardrone_autonomy publishes it: FLU, degrees, millimetres per second, g; tm is microseconds since boot.
_ARDRONE_ROS = ColumnMap(
    frame="flu",
    time="tm",
    time_unit="us",
    accel=("ax", "ay", "az"),
    accel_unit="g",
    euler=("rotX", "rotY", "rotZ"),
    euler_unit="deg",
    velocity=("vx", "vy", "vz"),
    velocity_unit="mm/s",
)

# AR.Drone's own navdata_demo: thousandths of a degree, right-handed with z down, velocities along the body's axes.
_ARDRONE = ColumnMap(
    frame="frd",
    euler=("phi", "theta", "psi"),
    euler_unit="mdeg",
    velocity=("vx", "vy", "vz"),
    velocity_unit="mm/s",
)

# Crazyflie, variables of its log blocks under their own names: FLU, degrees/s, g; the state is of a world with z up.
# zrange looks down, millimetres; 32767 without an echo.
_CRAZYFLIE = ColumnMap(
    frame="flu",
    velocity_frame="enu",
    gyro=("gyro.x", "gyro.y", "gyro.z"),
    gyro_unit="deg/s",
    accel=("acc.x", "acc.y", "acc.z"),
    accel_unit="g",
    quaternion=("stateEstimate.qw", "stateEstimate.qx", "stateEstimate.qy", "stateEstimate.qz"),
    velocity=("stateEstimate.vx", "stateEstimate.vy", "stateEstimate.vz"),
    position=("stateEstimate.x", "stateEstimate.y", "stateEstimate.z"),
    range="range.zrange",
    range_unit="mm",
    range_limits=(20.0, 4000.0),
)

# Betaflight's blackbox as blackbox_decode and the Blackbox Explorer write it: microseconds since boot, degrees/s, and
# counts of the accelerometer, 2048 to a g on most boards. At rest it reads +1 g along z, with x ahead: FLU.
_BETAFLIGHT = ColumnMap(
    frame="flu",
    time="time",
    time_unit="us",
    gyro=("gyroADC[0]", "gyroADC[1]", "gyroADC[2]"),
    gyro_unit="deg/s",
    accel=("accSmooth[0]", "accSmooth[1]", "accSmooth[2]"),
    accel_unit="g/2048",
)

# PX4's topics sensor_combined and vehicle_attitude, as pyulog's ulog2csv writes them, a file per topic: microseconds
# since boot, FRD, attitude from the body to NED.
_PX4 = ColumnMap(
    frame="frd",
    time="timestamp",
    time_unit="us",
    gyro=("gyro_rad[0]", "gyro_rad[1]", "gyro_rad[2]"),
    accel=("accelerometer_m_s2[0]", "accelerometer_m_s2[1]", "accelerometer_m_s2[2]"),
    quaternion=("q[0]", "q[1]", "q[2]", "q[3]"),
)

READY_MAPS = {
    "px4": _PX4,
    "betaflight": _BETAFLIGHT,
    "tello": _TELLO,
    "crazyflie": _CRAZYFLIE,
    "ardrone": _ARDRONE,
    "ardrone_ros": _ARDRONE_ROS,
}

#: Names of time stamps, the clearest first; a unit may follow, as in ``time_ms``.
TIME_NAMES = (
    "timestamp",
    "time_stamp",
    "stamp",
    "%time",
    "t",
    "time",
    "elapsed",
    "elapsed_time",
    "datetime",
    "date",
    "__time",
    "ts",
    "epoch",
    "unix_time",
    "gps_time",
    "tow",
    "datenum",
    "sampletimefine",
    "seconds_elapsed",
    "zeit",
)
