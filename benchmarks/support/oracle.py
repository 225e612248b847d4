"""A Kalman filter that knows the truth about its sensors: what any filter could reach at best.

It is told the noise of gyroscope and frames, the correlation of the frames' errors, and which frames are gross; it
sees no attitude. It must wait for delayed frames like everyone.
"""

from __future__ import annotations

from math import pi

import numpy as np
import numpy.typing as npt

from tests.fusion.simulated import Simulated

FloatArray = npt.NDArray[np.float64]


def level_turn(simulated: Simulated) -> FloatArray:
    """Return the turn (n,) that the gyroscope has measured about the vertical up to each of its samples."""
    rate, dt = simulated.level_rate, 1 / simulated.scene.gyro_hz
    return np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * dt)])


def oracle(simulated: Simulated, times_s: FloatArray) -> FloatArray:
    """Return the heading (n,) at the given times; the state is psi, bias, and the frames' error over sigma."""
    scene = simulated.scene
    frames = simulated.frames[simulated.frames[:, 3] == 0]
    asked = np.unique(np.concatenate([frames[:, 0], times_s]))
    turned = dict(zip(asked.tolist(), np.interp(asked, simulated.t_s, level_turn(simulated)), strict=True))
    x, P = np.zeros(3), np.diag([1.0, 0.02**2, 1.0])
    now, k = 0.0, 0

    def step(x: FloatArray, P: FloatArray, t0: float, t1: float) -> tuple[FloatArray, FloatArray]:
        h = t1 - t0
        rho = scene.frame_correlation ** (h * scene.frame_hz) if scene.frame_correlation else 0.0
        F = np.array([[1, -h, 0], [0, 1, 0], [0, 0, rho]])
        n2, b2 = scene.gyro_noise**2, scene.gyro_bias_walk**2
        half = -b2 * h * h / 2
        Q = np.array([[n2 * h + b2 * h**3 / 3, half, 0], [half, b2 * h, 0], [0, 0, 1 - rho**2]])
        x = F @ x
        x[0] += turned[t1] - turned.get(t0, 0.0)
        return x, F @ P @ F.T + Q

    found = np.empty(len(times_s))
    for i, t in enumerate(times_s.tolist()):
        while k < len(frames) and frames[k, 0] <= t - scene.delay_s:
            when, seen, sigma, _ = frames[k].tolist()
            if when > now:
                x, P = step(x, P, now, when)
                now = when
            H = np.array([1.0, 0.0, sigma])
            S = H @ P @ H + 1e-12
            K = P @ H / S
            x, P = x + K * ((seen - H @ x + pi / 2) % pi - pi / 2), P - np.outer(K, K) * S
            k += 1
        found[i] = x[0] - (t - now) * x[1] + turned[t] - turned.get(now, 0.0)
    return found
