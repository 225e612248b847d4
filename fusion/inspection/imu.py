"""Statistics of an IMU: still periods, noise and biases in them, gravity, and turn rates.

White noise follows from the Allan deviation at a short averaging time tau, ``N = sigma(tau) sqrt(tau)``: within still
periods at a tenth of a second, with the motors off. In flight, second differences of averages over a 25th of a second
remove most of the motion; vibration and the rest of the motion remain, so it is an upper bound. Single samples are
not used, because most IMUs smooth them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fusion.flight import FloatArray, ImuStream, TimeArray

ALLAN_TAU_S = 0.1
FLIGHT_TAU_S = 0.04
BIN_S = 0.1
WINDOW_S = 1.0
MIN_STILL_S = 2.0
STILL_GYRO_RAD_S = 0.02  # scatter of 0.1 s averages within a second
STILL_ACCEL_M_S2 = 0.15
MAX_STEP_S = 0.05  # slower streams do not show vibration
STILL_RATE_RAD_S = 0.1  # mean: larger than a gyroscope's bias
SHAKING_ACCEL_M_S2 = 0.7  # scatter of single samples: propellers run
LISTED = 10


@dataclass(frozen=True, slots=True)
class StillPeriod:
    """A stretch without turning, shaking or acceleration: at rest, or in smooth straight flight."""

    start_ns: int
    end_ns: int

    @property
    def length_s(self) -> float:
        """Length in seconds."""
        return (self.end_ns - self.start_ns) * 1e-9


@dataclass(frozen=True, slots=True)
class Noise:
    """Continuous-time white noise: rad/s/sqrt(Hz), m/s^2/sqrt(Hz); None if it could not be measured."""

    gyro: float | None
    accel: float | None


@dataclass(frozen=True, slots=True)
class ImuFindings:
    """Statistics of an IMU's samples; None if unknown.

    Parameters
    ----------
    still
        Still periods, the first ten; ``still_total_s`` is of all.
    at_rest
        Noise within them.
    in_flight
        Noise over the whole log without the motion, but with vibration.
    gyro_bias_rad_s
        Mean rate at rest.
    gravity_m_s2
        Length of the mean specific force at rest.
    usual_accel_m_s2
        Median specific force over the whole log, body FRD.
    fastest_rad_s
        99th percentile of the turn rate.
    declared_gyro_noise
        As declared in the log, rad/s/sqrt(Hz).
    """

    still: tuple[StillPeriod, ...]
    still_total_s: float
    at_rest: Noise | None
    in_flight: Noise
    gyro_bias_rad_s: tuple[float, float, float] | None
    gravity_m_s2: float | None
    usual_accel_m_s2: tuple[float, float, float] | None
    fastest_rad_s: float
    declared_gyro_noise: float | None


def inspect_imu(imu: ImuStream) -> ImuFindings | None:
    """Describe an IMU; None if it has too few samples."""
    if len(imu.t_ns) < 10:
        return None
    step_s = float(np.median(np.diff(imu.t_ns))) * 1e-9
    accel = imu.accel_m_s2 if np.isfinite(imu.accel_m_s2).any() else None
    in_flight = Noise(
        _from_differences(imu.gyro_rad_s, step_s), None if accel is None else _from_differences(accel, step_s)
    )
    still = find_still_periods(imu, in_flight)
    inside = [_slice(imu.t_ns, period) for period in still]
    at_rest, bias, gravity = None, None, None
    if inside:
        at_rest = Noise(
            _from_averages([imu.gyro_rad_s[part] for part in inside], step_s),
            None if accel is None else _from_averages([accel[part] for part in inside], step_s),
        )
        bias = _triple(np.concatenate([imu.gyro_rad_s[part] for part in inside]).mean(axis=0))
        if accel is not None:
            force = np.concatenate([accel[part] for part in inside])
            gravity = float(np.linalg.norm(np.nanmean(force, axis=0))) if np.isfinite(force).any() else None
    return ImuFindings(
        still[:LISTED],
        sum(period.length_s for period in still),
        at_rest,
        in_flight,
        bias,
        gravity,
        None if accel is None else _triple(np.nanmedian(accel, axis=0)),
        float(np.percentile(np.linalg.norm(imu.gyro_rad_s, axis=1), 99.0)),
        imu.gyro_noise_density,
    )


def find_still_periods(imu: ImuStream, noise: Noise) -> tuple[StillPeriod, ...]:
    """Find stretches of at least two seconds without turning, shaking or acceleration.

    Parameters
    ----------
    imu
        With or without accelerations.
    noise
        Of single samples, as measured by `inspect_imu`: the scatter of a noisy IMU at rest.
    """
    t_s = (imu.t_ns - imu.t_ns[0]) * 1e-9
    if t_s[-1] < MIN_STILL_S or float(np.median(np.diff(t_s))) > MAX_STEP_S:
        return ()
    accel = imu.accel_m_s2
    has_accel = bool(np.isfinite(accel).all())
    values = np.hstack([imu.gyro_rad_s, accel]) if has_accel else imu.gyro_rad_s
    bins = np.floor(t_s / BIN_S).astype(np.int64)
    starts = np.flatnonzero(np.diff(bins, prepend=-1))
    count = np.diff(np.append(starts, len(bins)))[:, None]
    mean = np.add.reduceat(values, starts) / count
    rough = np.sqrt(np.maximum(np.add.reduceat(values**2, starts) / count - mean**2, 0.0))
    window = np.floor(bins[starts] * BIN_S / WINDOW_S + 1e-9).astype(np.int64)
    firsts = np.flatnonzero(np.diff(window, prepend=-1))
    size = np.diff(np.append(firsts, len(window)))[:, None]
    level = np.add.reduceat(mean, firsts) / size
    scatter = np.sqrt(np.maximum(np.add.reduceat(mean**2, firsts) / size - level**2, 0.0))
    calm = np.linalg.norm(level[:, :3], axis=1) < STILL_RATE_RAD_S
    calm &= scatter[:, :3].max(axis=1) < _allowed(STILL_GYRO_RAD_S, noise.gyro)
    if has_accel:
        calm &= scatter[:, 3:].max(axis=1) < _allowed(STILL_ACCEL_M_S2, noise.accel)
        calm &= np.add.reduceat(rough[:, 3:], firsts).max(axis=1) / size[:, 0] < SHAKING_ACCEL_M_S2
    calm &= size[:, 0] >= 0.5 * WINDOW_S / max(BIN_S, float(np.median(np.diff(t_s))))  # not in a gap
    return _runs(window[firsts][calm], int(imu.t_ns[0]), int(imu.t_ns[-1]))


def _allowed(scatter: float, noise: float | None) -> float:
    """Largest scatter of averages over a still bin, larger for a noisy IMU."""
    own = 2.0 * (noise or 0.0) / float(np.sqrt(BIN_S))
    return max(scatter, min(own, 3.0 * scatter))


def _runs(windows: npt.NDArray[np.int64], start_ns: int, end_ns: int) -> tuple[StillPeriod, ...]:
    """Join consecutive windows, by their numbers (n,)."""
    found: list[StillPeriod] = []
    width_ns = int(WINDOW_S * 1e9)
    for number in windows:
        begin = start_ns + int(number) * width_ns
        end = min(begin + width_ns, end_ns)
        if found and found[-1].end_ns == begin:
            found[-1] = StillPeriod(found[-1].start_ns, end)
        else:
            found.append(StillPeriod(begin, end))
    return tuple(period for period in found if period.length_s >= MIN_STILL_S)


def _slice(t_ns: TimeArray, period: StillPeriod) -> slice:
    first, last = np.searchsorted(t_ns, [period.start_ns, period.end_ns])
    return slice(int(first), int(last))


def _from_averages(parts: list[FloatArray], step_s: float) -> float | None:
    """White noise density by the Allan deviation of averages over a tenth of a second, mean of the three axes."""
    width = max(1, round(ALLAN_TAU_S / step_s))
    steps: list[FloatArray] = []
    for values in parts:
        whole = len(values) // width
        if whole >= 3:
            averages = values[: whole * width].reshape(whole, width, -1).mean(axis=1)
            steps.append(np.abs(np.diff(averages, axis=0)))
    if not steps:
        return None
    sigma = 1.4826 * np.nanmedian(np.concatenate(steps), axis=0) / np.sqrt(2.0)  # robust against disturbances
    density = float(np.sqrt(np.nanmean(sigma**2) * width * step_s))
    return density if np.isfinite(density) else None


def _from_differences(values: FloatArray, step_s: float) -> float | None:
    """White noise density by second differences (variance 6 sigma^2) of averages, robust, mean of the axes."""
    width = max(1, round(FLIGHT_TAU_S / step_s))
    values = values[: len(values) // width * width].reshape(-1, width, 3).mean(axis=1)
    second = np.abs(values[2:] - 2.0 * values[1:-1] + values[:-2])
    if len(second) < 20 or not np.isfinite(second).any():
        return None
    sigma = 1.4826 * np.nanmedian(second, axis=0) / np.sqrt(6.0)
    return float(np.sqrt(np.nanmean(sigma**2) * width * step_s))


def _triple(values: FloatArray) -> tuple[float, float, float]:
    return float(values[0]), float(values[1]), float(values[2])
