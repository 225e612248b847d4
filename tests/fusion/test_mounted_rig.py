"""Camera and IMU that sit askew on a vehicle: told how, they give the vehicle's heading, as a vehicle turned as much.

What the rig measures is given to two estimators. One takes the rig for the vehicle; the other is told how the rig is
mounted. Their headings differ by the mount alone, whatever vision, tilt, filter and lateral offset do.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import isfinite, radians

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from fusion import CorridorEstimator, Estimate, FusionConfig
from fusion.flight import AttitudeStream, FloatArray, ImuStream
from fusion.logs.plausibility.mounting import mounted_attitude, mounted_imu, rotation
from tests.fusion.simulated import weaving
from tests.vision.corridor_lines import Corridor, lines_seen
from vision import Camera
from vision.lines.line_set import LineSet

CAMERA = replace(Camera(640, 480, 466.0, 466.0, 319.5, 239.5), p_body_camera_m=np.array([0.1, 0.05, 0.0]))
LENGTH_S, IMU_HZ, FRAME_HZ = 2.4, 100, 20
SETTLED_S = 1.0
CONFIG = FusionConfig(corridor_width_m=2.2)


@dataclass(frozen=True)
class Rig:
    """What an IMU and a camera that look the same way measure while a vehicle flies along a corridor."""

    imu: ImuStream
    attitude: AttitudeStream
    frames: list[tuple[int, LineSet]]


def rig_on_vehicle(seed: int, mount_rad: tuple[float, float, float], noise_px: float = 0.1) -> Rig:
    """Fly a vehicle that weaves and tilts; the rig sits on it as ``mount_rad`` says."""
    heading, offset = weaving(seed, radians(15), 3.0), weaving(seed + 1, 0.4, 4.0)
    pitch, roll = weaving(seed + 2, radians(6), 2.0), weaving(seed + 3, radians(6), 2.5)

    def pose(t_s: FloatArray) -> Rotation:
        vehicle = Rotation.from_euler("ZYX", np.stack([heading(t_s), pitch(t_s), roll(t_s)], axis=-1))
        return vehicle * Rotation.from_matrix(rotation(mount_rad))

    t_s = np.arange(0.0, LENGTH_S, 1 / IMU_HZ)
    t_ns = np.round(t_s * 1e9).astype(np.int64)
    h = 1e-4
    gyro = (pose(t_s - h).inv() * pose(t_s + h)).as_rotvec() / (2 * h)
    at = pose(t_s)
    frames = []
    for k, when in enumerate(np.arange(0.004, LENGTH_S, 1 / FRAME_HZ)):
        yaw_rad, pitch_rad, roll_rad = pose(np.array(when)).as_euler("ZYX").tolist()
        truth = Corridor(
            heading_rad=yaw_rad,
            pitch_rad=pitch_rad,
            roll_rad=roll_rad,
            offset_norm=float(offset(np.array(when))),
            noise_px=noise_px,
            n_random=10,
            seed=1000 * seed + k,
        )
        frames.append((round(when * 1e9), lines_seen(truth, CAMERA)))
    imu = ImuStream(t_ns, gyro, at.inv().apply([0.0, 0.0, -9.80665]))
    return Rig(imu, AttitudeStream(t_ns, at.as_quat(scalar_first=True)), frames)


def estimates(rig: Rig, camera: Camera, with_attitude: bool) -> list[Estimate]:
    """The estimates behind each frame once the start is settled."""
    estimator = CorridorEstimator(CONFIG, camera)
    frames, found = list(rig.frames), []
    for k, t_ns in enumerate(rig.imu.t_ns.tolist()):
        while frames and frames[0][0] < t_ns:
            estimator.add_lines(*frames.pop(0))
            if t_ns > SETTLED_S * 1e9:
                found.append(estimator.estimate())
        estimator.add_imu(t_ns, rig.imu.gyro_rad_s[k], rig.imu.accel_m_s2[k])
        if with_attitude and k % 4 == 0:
            estimator.add_attitude(t_ns, rig.attitude.q_world_body[k])
    return found


ANGLE = st.floats(-0.3, 0.3)


@settings(max_examples=6, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
@given(st.tuples(ANGLE, ANGLE, ANGLE), st.integers(0, 1000), st.booleans())
def test_a_turned_mount_is_like_a_turned_vehicle(
    mount_rad: tuple[float, float, float], seed: int, with_attitude: bool
) -> None:
    rig, R_body_rig = rig_on_vehicle(seed, mount_rad), rotation(mount_rad)
    told = replace(
        CAMERA,
        R_body_camera=R_body_rig @ CAMERA.R_body_camera,
        p_body_camera_m=R_body_rig @ CAMERA.p_body_camera_m,
    )
    on_body = replace(
        rig, imu=mounted_imu(rig.imu, mount_rad), attitude=mounted_attitude(rig.attitude, mount_rad)
    )
    by_mount, by_body = estimates(on_body, told, with_attitude), estimates(rig, CAMERA, with_attitude)
    assert len(by_mount) == len(by_body) > 25
    agreeing = []
    for here, there in zip(by_mount, by_body, strict=True):
        assert (here.status, here.reset_count) == (there.status, 0)
        rig_pose = Rotation.from_euler("ZYX", [there.heading_rad, there.pitch_rad, there.roll_rad])
        heading_rad = (rig_pose * Rotation.from_matrix(R_body_rig).inv()).as_euler("ZYX")[0]
        # The vote's bins lie elsewhere among the lines, so the two do not weigh each frame alike. A pitch error of
        # the mount is about the body's y axis, which differs, by up to 17 degrees here.
        limit_rad = 0.5 * there.heading_std_rad + radians(0.05)
        assert here.heading_rad == pytest.approx(heading_rad, abs=limit_rad)
        apart = here.lateral_offset_norm - there.lateral_offset_norm
        agreeing.append(isfinite(here.lateral_offset_norm) == isfinite(there.lateral_offset_norm))
        assert not abs(apart) > 0.3 * there.lateral_offset_norm_std  # NaN: one of them does not tell it yet
    assert np.mean(agreeing) > 0.8
