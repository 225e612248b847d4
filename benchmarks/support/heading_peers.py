"""Other ways to a heading from the same samples, to stand beside the estimator.

All are given the true tilt or find it themselves from clean accelerometers, and start from the median of the first
second's frames, so that only what they do with the heading differs. Those that know no corridor (gyroscope, IMU yaw,
magnetometer) are turned into its frame by that same start.

The magnetometer sees the earth's field turned by the same steel as the IMU's yaw, with 1 % noise.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib.util import find_spec
from math import atan2, degrees, pi

import numpy as np
import numpy.typing as npt
from filterpy.kalman import ExtendedKalmanFilter

from tests.fusion.simulated import Simulated, weaving, wrap, wrap_half
from vision.rotations import yaw_of

from .oracle import level_turn

FloatArray = npt.NDArray[np.float64]
Peer = Callable[[Simulated, FloatArray], FloatArray]

START_S = 1.0
COMPLEMENTARY_GAIN = 0.1  # per frame; the best of 0.03, 0.05, 0.1 and 0.2 for this setting
FIELD_UT = (20.0, 0.0, 44.0)  # central Europe: horizontal part and down
FIELD_NOISE_UT = 0.5
MAGNETIC_REJECTION_DEG, REJECTION_S = 10.0, 5.0
GRAVITY_M_S2 = 9.80665


def _aligned(simulated: Simulated, t_s: FloatArray, yaw: FloatArray, times_s: FloatArray) -> FloatArray:
    """Turn a yaw (n,) of its own reference into the corridor's by the first frames, and read it at times (m,)."""
    frames = simulated.frames[simulated.frames[:, 0] < START_S]
    yaw = np.unwrap(yaw)
    offset = np.median(wrap_half(frames[:, 1] - np.interp(frames[:, 0], t_s, yaw)))
    return np.asarray(yaw[np.searchsorted(t_s, times_s, side="right") - 1] + offset)


def gyro_only(simulated: Simulated, times_s: FloatArray) -> FloatArray:
    """Integrate the gyroscope."""
    return _aligned(simulated, simulated.t_s, level_turn(simulated), times_s)


def imu_yaw_only(simulated: Simulated, times_s: FloatArray) -> FloatArray:
    """Believe the attitude filter's yaw."""
    samples = [s for s in simulated.samples if s.kind == "attitude"]
    q = np.array([s.values[0] for s in samples])
    return _aligned(simulated, np.array([s.t_ns for s in samples]) * 1e-9, yaw_of(q), times_s)


def vision_held(simulated: Simulated, times_s: FloatArray) -> FloatArray:
    """Hold the last frame's heading until the next arrives."""
    frames = simulated.frames
    last = np.searchsorted(frames[:, 0] + simulated.scene.delay_s, times_s, side="right") - 1
    return np.asarray(frames[np.maximum(last, 0), 1])


def _streamed(
    simulated: Simulated,
    times_s: FloatArray,
    predict: Callable[[float, float], None],
    correct: Callable[[float, float], None],
    heading: Callable[[], float],
) -> FloatArray:
    """Run a filter: the turn of each gyroscope sample, each frame when it arrives, its heading at times (m,)."""
    turned, delay, frames = level_turn(simulated), simulated.scene.delay_s, simulated.frames
    found, k, i = np.empty(len(times_s)), 0, 0
    dt = 1 / simulated.scene.gyro_hz
    for step, t in enumerate(simulated.t_s.tolist()):
        if step:
            predict(float(turned[step] - turned[step - 1]), dt)
        while k < len(frames) and frames[k, 0] + delay <= t:
            correct(float(frames[k, 1]), float(frames[k, 2]))
            k += 1
        while i < len(times_s) and times_s[i] <= t + 1e-9:
            found[i] = heading()
            i += 1
    found[i:] = heading()
    return found


def _first_heading(simulated: Simulated) -> float:
    return float(_aligned(simulated, simulated.t_s, level_turn(simulated), np.zeros(1))[0])


def complementary(simulated: Simulated, times_s: FloatArray) -> FloatArray:
    """Integrate the gyroscope, and move a tenth of the way to each frame."""
    psi = [_first_heading(simulated)]

    def predict(turn: float, _: float) -> None:
        psi[0] += turn

    def correct(seen: float, _: float) -> None:
        psi[0] += COMPLEMENTARY_GAIN * float(wrap_half(seen - psi[0]))

    return _streamed(simulated, times_s, predict, correct, lambda: psi[0])


def plain_ekf(simulated: Simulated, times_s: FloatArray) -> FloatArray:
    """Run filterpy's extended Kalman filter of heading and bias with the true noises, and nothing else."""
    scene = simulated.scene
    ekf = ExtendedKalmanFilter(dim_x=2, dim_z=1)
    ekf.x, ekf.P = np.array([_first_heading(simulated), 0.0]), np.diag([0.01**2, 0.02**2])
    ekf.F, ekf.B = np.eye(2), np.array([1.0, 0.0])
    H = np.array([[1.0, 0.0]])

    def predict(turn: float, dt: float) -> None:
        ekf.F[0, 1] = -dt
        ekf.Q = np.diag([scene.gyro_noise**2 * dt, scene.gyro_bias_walk**2 * dt])
        ekf.predict(turn)

    def correct(seen: float, sigma: float) -> None:
        R = np.array([[sigma * sigma]])
        ekf.update(np.array([seen]), lambda _: H, lambda x: x[:1], R, residual=lambda a, b: wrap_half(a - b))

    return _streamed(simulated, times_s, predict, correct, lambda: float(ekf.x[0]))


def _senses(simulated: Simulated) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Gyroscope (rad/s), specific force (m/s^2) and magnetic field (microtesla), each (n, 3), body FRD."""
    scene, t = simulated.scene, simulated.t_s
    rng = np.random.default_rng(scene.seed + 4000)
    roll, pitch = (
        weaving(scene.seed + 1, scene.tilt_rad, 3.0)(t),
        weaving(scene.seed + 2, scene.tilt_rad, 4.0)(t),
    )
    yaw = simulated.heading + scene.yaw_offset(t)
    sr, cr, sp, cp, sy, cy = (
        np.sin(roll),
        np.cos(roll),
        np.sin(pitch),
        np.cos(pitch),
        np.sin(yaw),
        np.cos(yaw),
    )
    north = np.stack([cp * cy, sr * sp * cy - cr * sy, cr * sp * cy + sr * sy], axis=1)
    down = np.stack([-sp, sr * cp, cr * cp], axis=1)
    gyro = np.array([s.values[0] for s in simulated.samples if s.kind == "imu"])
    force = -GRAVITY_M_S2 * down + rng.normal(0, 0.05, down.shape)
    field = FIELD_UT[0] * north + FIELD_UT[2] * down + rng.normal(0, FIELD_NOISE_UT, down.shape)
    return gyro, force, field


_FLU = np.array([1.0, -1.0, -1.0])


def imufusion_ahrs(simulated: Simulated, times_s: FloatArray) -> FloatArray:
    """Run imufusion with its magnetic rejection on."""
    import imufusion

    scene = simulated.scene
    gyro, force, field = _senses(simulated)
    settings = imufusion.AhrsSettings()
    settings.convention = imufusion.CONVENTION_NWU
    settings.sample_rate = scene.gyro_hz
    settings.gain = 0.5
    settings.gyroscope_range = 2000.0
    settings.acceleration_rejection = 10.0
    settings.magnetic_rejection = MAGNETIC_REJECTION_DEG
    settings.rejection_timeout = round(REJECTION_S * scene.gyro_hz)
    ahrs = imufusion.Ahrs()
    ahrs.set_settings(settings)
    yaw = np.empty(len(gyro))
    for i, (g, a, m) in enumerate(
        zip(np.degrees(gyro) * _FLU, force / GRAVITY_M_S2 * _FLU, field * _FLU, strict=True)
    ):
        ahrs.update(g, a, m)
        yaw[i] = -float(yaw_of(ahrs.get_quaternion()))
    return _aligned(simulated, simulated.t_s, yaw, times_s)


def _ahrs(name: str) -> Peer:
    def run(simulated: Simulated, times_s: FloatArray) -> FloatArray:
        from ahrs.filters import EKF, Madgwick, Mahony

        gyro, force, field = _senses(simulated)
        hz = simulated.scene.gyro_hz
        yaw0 = float(simulated.heading[0] + simulated.scene.yaw_offset(np.zeros(1))[0])
        yaw = np.empty(len(gyro))
        if name == "EKF":  # its accelerometer points down at rest, world north, east, down
            dip = degrees(atan2(FIELD_UT[2], FIELD_UT[0]))
            ekf = EKF(frequency=hz, frame="NED", magnetic_ref=dip)
            ekf.mag = field  # else it expects no field
            q = np.array([np.cos(yaw0 / 2), 0.0, 0.0, np.sin(yaw0 / 2)])
            for i in range(len(gyro)):
                q = ekf.update(q, gyro[i], -force[i], field[i])
                yaw[i] = float(yaw_of(q))
        else:  # its accelerometer points up at rest, as ours seen from a body forward, left, up
            filter_ = Madgwick(frequency=hz) if name == "Madgwick" else Mahony(frequency=hz)
            start = -yaw0 + (pi / 2 if name == "Mahony" else 0.0)  # world x east, or north
            q = np.array([np.cos(start / 2), 0.0, 0.0, np.sin(start / 2)])
            for i in range(len(gyro)):
                q = filter_.updateMARG(q, gyro[i] * _FLU, force[i] * _FLU, field[i] * _FLU)
                yaw[i] = -float(yaw_of(q))
        return _aligned(simulated, simulated.t_s, yaw, times_s)

    return run


PEERS: dict[str, Peer] = {
    "gyroscope only": gyro_only,
    "IMU yaw only": imu_yaw_only,
    "vision held": vision_held,
    "complementary filter": complementary,
    "filterpy EKF without gates": plain_ekf,
}
SLOW_PEERS: dict[str, tuple[str, Peer]] = {
    "imufusion, magnetometer": ("imufusion", imufusion_ahrs),
    "ahrs Mahony, magnetometer": ("ahrs", _ahrs("Mahony")),
    "ahrs Madgwick, magnetometer": ("ahrs", _ahrs("Madgwick")),
    "ahrs EKF, magnetometer": ("ahrs", _ahrs("EKF")),
}


def installed(package: str) -> bool:
    """Whether a package can be imported."""
    return find_spec(package) is not None


def heading_error(simulated: Simulated, times_s: FloatArray, heading: FloatArray) -> FloatArray:
    """Heading (n,) minus truth, wrapped."""
    return np.asarray(wrap(heading - np.interp(times_s, simulated.t_s, simulated.heading)))
