"""The camera's mounting angles, from the corridor's axis, the picture's vertical lines and the vehicle's tilting.

Let the camera be rotated from its calibration by small angles, roll, pitch and yaw about the body's axes. In the
level frame of the attitude, the rotation raises or lowers the corridor's axis and tilts the door posts:

    elevation = -(sin(heading), cos(heading), 0) . R_level_body (roll, pitch, yaw)
    lean      =  (1, 0, 0) . R_level_body (roll, pitch, yaw)

While the body is level, the yaw affects neither: it only adds to the heading and cannot be separated from the
vehicle's own. But a camera that looks to the right of the roll axis measures part of a roll as pitch, and part of a
pitch as roll, in proportion to the sine of the yaw. Errors of the attitude, which are correlated over seconds, are
modelled as a Markov process.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import asin, atan2, radians

import numpy as np
import numpy.typing as npt

from fusion.alignment.markov import LineFit, Process, fit_lines
from fusion.alignment.views import Sightings
from vision.rotations import rotation_from_angles

FloatArray = npt.NDArray[np.float64]

MIN_MOUNT_FRAMES = 12
WANDER_STD_RAD, WANDER_TIME_S = radians(0.4), 4.0  # of an attitude filter's roll and pitch
MAX_SURPLUS = 0.9
ROLL, PITCH, YAW = range(3)
PRIOR_STD_RAD = radians(15.0)  # of a mount: keeps unobserved angles finite


@dataclass(frozen=True, slots=True, eq=False)
class MountFit:
    """Rotation of the camera against its calibration, about the body's axes: roll, pitch, yaw (3,).

    Parameters
    ----------
    angle_rad, std_rad
        The fit; roll and pitch are relative to the attitude's level, whose error is part of the standard deviation.
    tilted_rad
        Standard deviations of the body's roll and pitch over the frames (2,).
    """

    angle_rad: FloatArray
    std_rad: FloatArray
    tilted_rad: FloatArray
    n_frames: int


def fit_mount(sightings: Sightings, level_std_rad: float) -> MountFit | None:
    """Fit the mount; None if too few frames were measured with an attitude.

    Parameters
    ----------
    sightings
        Measurements of the frames.
    level_std_rad
        Standard deviation of roll and pitch by the inertial sensors. An error of this size may last for the whole
        flight (a bias of the accelerometer or, until it is estimated, of the gyroscope), so no number of frames
        averages it out.
    """
    seen = np.isfinite(sightings.elevation_rad)
    if seen.sum() < MIN_MOUNT_FRAMES:
        return None
    R = sightings.level_body
    # If the verticals in the picture gave the level, the elevation contains no roll.
    level = np.isfinite(sightings.roll_rad)[:, None]
    psi = sightings.heading_rad
    toward = np.stack([np.sin(psi), np.cos(psi)], axis=1)
    toward = np.where(level, [0.0, 1.0], toward)
    along = -np.einsum("ni,nij->nj", toward, R[:, :2, :])
    t_s = sightings.t_s
    parts = [
        _Part(t_s, along, sightings.elevation_rad, sightings.elevation_std_rad),
        _Part(t_s, R[:, 0, :], sightings.roll_rad, sightings.roll_std_rad),
    ]
    parts = [part for part in (part.known() for part in parts) if len(part.t_s) >= MIN_MOUNT_FRAMES]
    normal, right = np.eye(3) / PRIOR_STD_RAD**2, np.zeros(3)
    for part in parts:
        fit = part.fit()
        whitened = fit.noise.whiten(part.design)
        normal += part.design.T @ whitened
        right += whitened.T @ part.target
        # The measured tilting contains attitude errors, too; their share carries no information.
        normal[YAW, YAW] -= min(fit.noise.process_trace(), MAX_SURPLUS * normal[YAW, YAW])
    covariance = np.linalg.inv(normal)
    std = np.sqrt(np.diag(covariance) + np.array([level_std_rad, level_std_rad, 0.0]) ** 2)
    tilt = np.stack([R[seen, 2, 1], -R[seen, 2, 0]], axis=1)
    return MountFit(covariance @ right, std, tilt.std(axis=0), int(seen.sum()))


def mount_rotation(angle_rad: FloatArray) -> FloatArray:
    """Rotation (3, 3) from the assumed camera to the true one: roll, pitch, yaw (3,), Z-Y-X about the body."""
    roll, pitch, yaw = angle_rad.tolist()
    return rotation_from_angles(yaw, pitch, roll)


def mount_angles(R: FloatArray) -> FloatArray:
    """Roll, pitch, yaw (3,) of a `mount_rotation`."""
    return np.array([atan2(R[2, 1], R[2, 2]), -asin(max(-1.0, min(1.0, R[2, 0]))), atan2(R[1, 0], R[0, 0])])


@dataclass(frozen=True, slots=True, eq=False)
class _Part:
    """One kind of residual: times (n,), design (n, 3), target (n,), standard deviation (n,)."""

    t_s: FloatArray
    design: FloatArray
    target: FloatArray
    std: FloatArray

    def known(self) -> _Part:
        """Return the residuals whose target is known."""
        keep = np.isfinite(self.target)
        return _Part(self.t_s[keep], self.design[keep], self.target[keep], self.std[keep])

    def fit(self) -> LineFit:
        """Fit these residuals alone, to estimate their noise."""
        chain = np.zeros(len(self.t_s), np.int64)

        def wander(std: float) -> Process:
            return Process.stationary(self.t_s, chain, std, WANDER_TIME_S)

        return fit_lines(self.design, self.target, self.std**2, wander, WANDER_STD_RAD)
