"""Comparison of gyroscope and attitude: the scale of the rates, their axes, and the direction of the quaternions.

Both are reduced to the mean rate over windows of a quarter of a second. The attitude's rates are compared with the
gyroscope's under every permutation of axes; correlation does not depend on units or bias, so the scale comes last.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations, product

import numpy as np
import numpy.typing as npt

from fusion.flight import AttitudeStream, FloatArray, ImuStream

WINDOW_S = 0.25
MIN_WINDOWS = 20
MIN_RATE_RAD_S = 0.02  # rms of the attitude's rates; below it the vehicle does not turn
MAX_RATE_RAD_S = 20.0  # a reset of the attitude, not a turn
RESETS = 0.02  # share of windows that may disagree completely because the attitude jumps

FLU = np.diag([1.0, -1.0, -1.0])


@dataclass(frozen=True, slots=True, eq=False)
class Reading:
    """One interpretation of the two streams: ``body rate = axes @ gyro``, with or without conjugated quaternions."""

    axes: FloatArray
    conjugated: bool
    correlation: float
    scale: float  # attitude's rate over the gyroscope's

    @property
    def is_unchanged(self) -> bool:
        """Whether nothing needs to be changed."""
        return not self.conjugated and np.array_equal(self.axes, np.eye(3))


@dataclass(frozen=True, slots=True, eq=False)
class TurnComparison:
    """Agreement of gyroscope and attitude.

    Parameters
    ----------
    as_taken
        The interpretation without any change.
    others
        The interpretations that explain the rates about as well as the best one, the likeliest mistake first; empty
        if the assumed one is among the best.
    rate_rad_s
        Root mean square of the attitude's rate.
    windows
        Number of windows compared.
    """

    as_taken: Reading
    others: tuple[Reading, ...]
    rate_rad_s: float
    windows: int


def compare_turns(imu: ImuStream, attitude: AttitudeStream) -> TurnComparison | None:
    """Compare gyroscope and attitude; None if they have too little time or motion in common."""
    windows = _window_rates(imu, attitude)
    if windows is None:
        return None
    gyro, attitude_rates = windows
    rate = float(
        np.sqrt(np.mean(np.sum((attitude_rates[False] - attitude_rates[False].mean(0)) ** 2, axis=1)))
    )
    if rate < MIN_RATE_RAD_S or not np.any(np.ptp(gyro, axis=0) > 0.0):
        return None
    best = max(_readings(gyro, attitude_rates), key=_correlation)
    error = np.linalg.norm(attitude_rates[best.conjugated] - best.scale * gyro @ best.axes.T, axis=1)
    calm = error <= np.percentile(error, 100.0 * (1.0 - RESETS))
    readings = _readings(gyro[calm], {key: rates[calm] for key, rates in attitude_rates.items()})
    as_taken = readings[0]
    best = max(readings, key=_correlation)
    close = [reading for reading in readings if reading.correlation > best.correlation - 0.05]
    others = () if as_taken in close else tuple(sorted(close, key=_plausibility_rank))
    return TurnComparison(as_taken, others, rate, len(gyro))


def _readings(gyro: FloatArray, rates: dict[bool, FloatArray]) -> list[Reading]:
    """Return every interpretation of windows of rates (n, 3), first the one without any change."""
    return [
        _reading(gyro, rates[conjugated], axes, conjugated)
        for conjugated in (False, True)
        for axes in _axes()
    ]


def _correlation(reading: Reading) -> float:
    return reading.correlation


def _axes() -> list[FloatArray]:
    """Return the 24 right-handed permutations of axes, the identity first, FLU for FRD second."""
    found = [np.eye(3), FLU]
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            matrix = np.zeros((3, 3))
            matrix[range(3), order] = signs
            if np.linalg.det(matrix) > 0.0 and not any(np.array_equal(matrix, known) for known in found):
                found.append(matrix)
    return found


def _plausibility_rank(reading: Reading) -> tuple[int, float]:
    known = (np.array_equal(reading.axes, FLU) and not reading.conjugated) or (
        reading.conjugated and np.array_equal(reading.axes, np.eye(3))
    )
    return (0 if known else 1, -reading.correlation)


def _reading(gyro: FloatArray, rates: FloatArray, axes: FloatArray, conjugated: bool) -> Reading:
    turned = (gyro @ axes.T) - (gyro @ axes.T).mean(axis=0)
    centred = rates - rates.mean(axis=0)
    both = float(np.sum(turned * centred))
    power = float(np.sum(turned**2))
    scale = float(np.sqrt(power * np.sum(centred**2)))
    if scale == 0.0:
        return Reading(axes, conjugated, 0.0, 0.0)
    return Reading(axes, conjugated, both / scale, both / power)


def _window_rates(
    imu: ImuStream, attitude: AttitudeStream
) -> tuple[FloatArray, dict[bool, FloatArray]] | None:
    """Mean rates (n, 3) over windows, of the gyroscope and the attitude, unchanged (False) and conjugated (True)."""
    first = max(int(imu.t_ns[0]), int(attitude.t_ns[0]))
    last = min(int(imu.t_ns[-1]), int(attitude.t_ns[-1]))
    t_imu_s: FloatArray = (imu.t_ns - first).astype(np.float64) * 1e-9
    t_s: FloatArray = (attitude.t_ns - first).astype(np.float64) * 1e-9
    if last - first < MIN_WINDOWS * WINDOW_S * 1e9:
        return None
    edges = np.unique(np.searchsorted(t_s, np.arange(0.0, (last - first) * 1e-9, WINDOW_S)))
    edges = edges[(edges < len(t_s)) & (t_s[np.minimum(edges, len(t_s) - 1)] <= t_imu_s[-1])]
    start, end = edges[:-1], edges[1:]
    duration_s = t_s[end] - t_s[start]
    inside = np.searchsorted(t_imu_s, t_s[end]) - np.searchsorted(t_imu_s, t_s[start])
    whole = 0.5 * duration_s / float(np.median(np.diff(t_imu_s)))  # at least half of the samples are present
    good = (duration_s < 4.0 * WINDOW_S) & (inside >= np.maximum(1.0, whole))
    start, end, duration_s = start[good], end[good], duration_s[good]
    gyro = (_integral(t_imu_s, imu.gyro_rad_s, t_s[end]) - _integral(t_imu_s, imu.gyro_rad_s, t_s[start])) / (
        duration_s[:, None]
    )
    q = attitude.q_world_body
    q_inverse = q * np.array([1.0, -1.0, -1.0, -1.0])
    rates = {
        False: turn_between(q[start], q[end]) / duration_s[:, None],
        True: turn_between(q_inverse[start], q_inverse[end]) / duration_s[:, None],
    }
    keep = np.linalg.norm(rates[False], axis=1) < MAX_RATE_RAD_S
    if np.count_nonzero(keep) < MIN_WINDOWS:
        return None
    return gyro[keep], {conjugated: values[keep] for conjugated, values in rates.items()}


def _integral(t_s: FloatArray, values: FloatArray, at_s: FloatArray) -> FloatArray:
    """Integral (m, 3) of samples (n, 3) from their first time to given ones (m,)."""
    steps = np.diff(t_s)[:, None] * (values[1:] + values[:-1]) / 2.0
    total = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
    return np.stack([np.interp(at_s, t_s, total[:, axis]) for axis in range(3)], axis=1)


def turn_between(q_first: FloatArray, q_second: FloatArray) -> FloatArray:
    """Rotation vector (n, 3), radians in the first one's body, from one quaternion (n, 4) to another, w x y z."""
    w0, v0, w1, v1 = q_first[:, :1], q_first[:, 1:], q_second[:, :1], q_second[:, 1:]
    w = w0 * w1 + np.sum(v0 * v1, axis=1, keepdims=True)
    v = w0 * v1 - w1 * v0 - np.cross(v0, v1)
    v = np.where(w < 0.0, -v, v)
    length: npt.NDArray[np.float64] = np.linalg.norm(v, axis=1, keepdims=True)
    angle = 2.0 * np.arctan2(length, np.abs(w))
    return v * np.where(length > 1e-12, angle / np.maximum(length, 1e-12), 2.0)
