"""IMU noise as declared in a calibration: Kalibr's ``imu.yaml`` and EuRoC's ``sensor.yaml``."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from vision.cameras.fields import positive, read_yaml
from vision.errors import InputError

_DENSITIES = {
    "gyroscope_noise_density": "gyro_noise_density",
    "gyroscope_random_walk": "gyro_random_walk",
    "accelerometer_noise_density": "accel_noise_density",
    "accelerometer_random_walk": "accel_random_walk",
}
_RATES = ("update_rate", "rate_hz")


@dataclass(frozen=True, slots=True)
class ImuNoise:
    """Continuous-time noise of an IMU; None where the calibration does not declare it.

    Parameters
    ----------
    gyro_noise_density, gyro_random_walk
        rad/s/sqrt(Hz) and rad/s^2/sqrt(Hz).
    accel_noise_density, accel_random_walk
        m/s^2/sqrt(Hz) and m/s^3/sqrt(Hz).
    rate_hz
        Samples per second.
    """

    gyro_noise_density: float | None = None
    gyro_random_walk: float | None = None
    accel_noise_density: float | None = None
    accel_random_walk: float | None = None
    rate_hz: float | None = None


def read_imu_noise(path: str | Path) -> ImuNoise:
    """Read the noise of an IMU from Kalibr's ``imu.yaml`` (flat, or its output under ``imu0``) or EuRoC's.

    Raises
    ------
    InputError
        Where the file cannot be read, declares no noise, or has a value that is not a positive number.
    """
    path = Path(path)
    content: Mapping[str, Any] = read_yaml(path)
    prefix = ""
    for key, value in content.items():
        if re.fullmatch(r"imu\d+", str(key)) and isinstance(value, Mapping):
            content, prefix = value, f"{key}."
            break
    if not any(key in content for key in _DENSITIES):
        found = ", ".join(str(key) for key in list(content)[:8]) or "nothing"
        raise InputError(
            f"declares no IMU noise: it contains {found}",
            file=path,
            remedy="give Kalibr's imu.yaml or EuRoC's sensor.yaml, with gyroscope_noise_density in rad/s/sqrt(Hz)",
        )
    try:
        found_noise = {
            name: positive(content, key, "give a positive number, or leave the line out", prefix)
            for key, name in _DENSITIES.items()
        }
        rates = [positive(content, key, "give samples a second", prefix) for key in _RATES]
    except InputError as error:
        raise InputError(error.problem, file=path, remedy=error.remedy) from error
    return ImuNoise(**found_noise, rate_hz=next((rate for rate in rates if rate is not None), None))
