"""What each call of the estimator costs, and an hour of flight beside a plain filterpy EKF.

    python benchmarks/step.py [--seconds 60] [--minutes 60] [--steps 10000000]

prints medians, 99th percentiles and ratios. Times are those the thread had the processor (where the system tells them
finely enough), so that other processes' turns do not count; what they leave behind in the caches does. Stamps jitter
by 20 microseconds, as real ones do: no two steps are of the same length.

The plain EKF is `filterpy.kalman.ExtendedKalmanFilter` with the estimator's five states, a prediction per IMU sample
and two scalar updates per frame, and nothing else: no tilt, no gates, no late samples, no status. Both fly the same
minutes turn by turn, so that what the machine does meanwhile touches both; the ratio is the median over minutes.

Last, the filter's covariance after ten million steps (half a day of IMU samples at 200 Hz) with updates of every
kind, very good and very poor ones, blind stretches and changes of the axis: whether it is still symmetric to the last
bit and positive, looked at every thousand steps.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from math import cos, inf, pi, radians, sin, sqrt
from typing import Any, NamedTuple

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter

from fusion import CorridorEstimator, FusionConfig
from fusion.estimator.ekf import CorridorEKF
from fusion.estimator.models import ProcessNoise, ScalarMeasurement
from support.clock import clock
from vision import FrameMeasurement, Reason

IMU_HZ, ATTITUDE_HZ, FRAME_HZ, FLOW_HZ = 200.0, 50.0, 30.0, 30.0
JITTER_NS = 20_000
GYRO_NOISE, ACCEL_NOISE = 0.0075, 0.02
HEADING_STD_RAD, OFFSET_STD = radians(0.5), 0.02
LATE_NS = 80_000_000
NAMES = {
    ", speed known": ("add_imu", "add_velocity"),
    ", 80 ms late": ("add_measurement",),
    ", stamps without jitter": ("add_imu",),
}
TARGETS_US = {"add_imu": (50.0, 150.0), "add_imu, speed known": (50.0, 150.0)}
HOUR_TARGET_S = 20.0
BLOCK = 1000


class Sample(NamedTuple):
    """A call of the estimator: when, its name, and its arguments."""

    at_ns: int
    name: str
    t_ns: int
    arguments: tuple[Any, ...]


def truth(t_s: float) -> tuple[float, float, float]:
    """Heading, yaw rate and lateral offset (half widths) of a weaving flight."""
    w = 2 * pi / 8.0
    return 0.2 * sin(w * t_s), 0.2 * w * cos(w * t_s), 0.3 * sin(0.5 * w * t_s)


def stamps(
    rng: np.random.Generator, start_s: float, seconds: float, rate_hz: float, jitter_ns: int = JITTER_NS
) -> list[int]:
    """Return the times of a sensor's samples, nanoseconds, with jitter."""
    regular = (start_s + (np.arange(round(seconds * rate_hz)) + 0.5) / rate_hz) * 1e9
    jitter = rng.uniform(-jitter_ns, jitter_ns, len(regular))
    return [int(t) for t in regular + jitter]


def imu(
    rng: np.random.Generator, start_s: float, seconds: float, jitter_ns: int = JITTER_NS
) -> Iterator[Sample]:
    """Yield IMU samples with noise and jitter of their stamps."""
    noise = rng.normal(0.0, 1.0, (round(seconds * IMU_HZ), 6))
    noise *= np.repeat([GYRO_NOISE * sqrt(IMU_HZ), ACCEL_NOISE * sqrt(IMU_HZ)], 3)
    for t_ns, row in zip(stamps(rng, start_s, seconds, IMU_HZ, jitter_ns), noise, strict=True):
        rate = truth(t_ns * 1e-9)[1]
        gyro, accel = np.array([0.0, 0.0, rate]) + row[:3], np.array([0.0, 0.0, -9.80665]) + row[3:]
        yield Sample(t_ns, "add_imu", t_ns, (gyro, accel))


def frames(rng: np.random.Generator, start_s: float, seconds: float, late_ns: int = 0) -> Iterator[Sample]:
    """Yield frames' measurements, ``late_ns`` after their stamps."""
    noise = rng.normal(0.0, 1.0, (round(seconds * FRAME_HZ), 2))
    for t_ns, (a, b) in zip(stamps(rng, start_s, seconds, FRAME_HZ), noise.tolist(), strict=True):
        heading, _, offset = truth(t_ns * 1e-9)
        found = FrameMeasurement(
            accepted=True,
            reason=Reason.OK,
            n_lines=60,
            n_inliers=30,
            heading_rad=heading + HEADING_STD_RAD * a,
            heading_std_rad=HEADING_STD_RAD,
            lateral_offset_norm=offset + OFFSET_STD * b,
            lateral_offset_norm_std=OFFSET_STD,
        )
        yield Sample(t_ns + late_ns, "add_measurement", t_ns, (found,))


def attitudes(rng: np.random.Generator, start_s: float, seconds: float) -> Iterator[Sample]:
    """Yield attitude samples."""
    for t_ns in stamps(rng, start_s, seconds, ATTITUDE_HZ):
        half = 0.5 * (truth(t_ns * 1e-9)[0] + 0.7 + rng.normal(0.0, radians(0.2)))
        yield Sample(t_ns, "add_attitude", t_ns, ((cos(half), 0.0, 0.0, sin(half)),))


def flows(rng: np.random.Generator, start_s: float, seconds: float) -> Iterator[Sample]:
    """Yield velocities of an optical flow sensor."""
    for t_ns in stamps(rng, start_s, seconds, FLOW_HZ):
        yield Sample(t_ns, "add_velocity", t_ns, (np.array([0.8, 0.0, 0.0]) + rng.normal(0.0, 0.05, 3),))


def call_times(samples: list[Sample], config: FusionConfig) -> dict[str, np.ndarray]:
    """Microseconds of every call; after each IMU sample the estimate is asked for, as a controller does."""
    estimator = CorridorEstimator(config)
    calls: dict[str, Callable[..., Any]] = {
        name: getattr(estimator, name) for name in {s.name for s in samples}
    }
    times: dict[str, list[float]] = {name: [] for name in [*calls, "estimate"]}
    for sample in samples:
        call, t_ns, arguments = calls[sample.name], sample.t_ns, sample.arguments
        before = clock()
        call(t_ns, *arguments)
        times[sample.name].append(clock() - before)
        if sample.name == "add_imu":
            before = clock()
            estimator.estimate(t_ns)
            times["estimate"].append(clock() - before)
    # What happens once (imports, caches) is over after a second.
    return {name: 1e6 * np.array(found[len(found) // 60 :]) for name, found in times.items()}


def print_calls(seconds: float) -> None:
    """Print what each call costs."""
    rng, config = np.random.default_rng(1), FusionConfig(corridor_width_m=2.2)
    common = [*imu(rng, 0.0, seconds), *attitudes(rng, 0.0, seconds)]
    on_time = [*common, *frames(rng, 0.0, seconds)]
    runs = {
        "": on_time,
        ", speed known": [*on_time, *flows(rng, 0.0, seconds)],
        ", 80 ms late": [*common, *frames(rng, 0.0, seconds, LATE_NS)],
        ", stamps without jitter": [*imu(rng, 0.0, seconds, 0), *frames(rng, 0.0, seconds)],
    }
    empty = []
    for _ in range(2000):
        before = clock()
        empty.append(clock() - before)
    print(f"IMU {IMU_HZ:g} Hz, attitude {ATTITUDE_HZ:g} Hz, frames {FRAME_HZ:g} Hz; microseconds per call")
    print(f"{'':34}{'calls':>8}{'median':>10}{'99 %':>10}{'target':>16}")
    print(
        f"{'the clock itself':34}{len(empty):8}{1e6 * np.median(empty):10.1f}{1e6 * np.percentile(empty, 99):10.1f}"
    )
    for suffix, samples in runs.items():
        times = call_times(sorted(samples, key=lambda s: s.at_ns), config)
        for name in NAMES.get(suffix, sorted(times)):
            found = times[name]
            goal = TARGETS_US.get(name + suffix)
            aim = f"{goal[0]:8.0f}{goal[1]:8.0f}" if goal else ""
            print(
                f"{name + suffix:34}{len(found):8}{np.median(found):10.1f}{np.percentile(found, 99):10.1f}{aim}"
            )


class PlainEkf(ExtendedKalmanFilter):  # type: ignore[misc]
    """The textbook's filter over psi, b, o, y, v."""

    def __init__(self) -> None:
        super().__init__(dim_x=5, dim_z=1)
        self.x, self.P = np.zeros(5), np.diag([1.0, 0.02**2, 10.0, 1.0, 0.1])
        self.F, self.B = np.eye(5), np.array([1.0, 0.0, 0.0, 0.0, 0.0])
        self.density = np.diag([GYRO_NOISE**2, 1e-8, 1e-4, 0.0, 0.15])
        self.last_ns: int | None = None
        self.H_heading, self.H_offset = np.eye(5)[[0]], np.eye(5)[[3]]

    def add_imu(self, t_ns: int, gyro: np.ndarray, accel: np.ndarray) -> None:
        """Predict; the vehicle is taken as level."""
        if self.last_ns is not None:
            dt = (t_ns - self.last_ns) * 1e-9
            self.F[0, 1], self.F[3, 4], self.F[4, 4] = -dt, dt, 1.0 - dt
            self.Q = self.density * dt
            self.predict(float(gyro[2]) * dt)
        self.last_ns = t_ns

    def add_measurement(self, t_ns: int, m: FrameMeasurement) -> None:
        """Update with heading and lateral offset."""
        self._take(m.heading_rad, m.heading_std_rad, self.H_heading)
        self._take(m.lateral_offset_norm, m.lateral_offset_norm_std, self.H_offset)

    def _take(self, value: float, std: float, H: np.ndarray) -> None:
        self.update(np.array([value]), lambda x: H, lambda x: H @ x, R=np.array([[std * std]]))


def print_hour(minutes: int) -> None:
    """Print what an hour of flight costs, beside a plain filter."""
    ours, plain = CorridorEstimator(FusionConfig(corridor_width_m=2.2)), PlainEkf()
    rng, seconds = np.random.default_rng(2), []
    for minute in range(minutes):
        samples = [*imu(rng, 60.0 * minute, 60.0), *frames(rng, 60.0 * minute, 60.0)]
        samples.sort(key=lambda s: s.at_ns)
        turn = [_minute(ours, samples), _minute(plain, samples)]
        seconds.append(turn)
    taken = np.array(seconds)
    total, ratio = taken.sum(axis=0), float(np.median(taken[:, 0] / taken[:, 1]))
    goal = HOUR_TARGET_S * minutes / 60
    print(f"\n{minutes} minutes of IMU at {IMU_HZ:g} Hz with measurements at {FRAME_HZ:g} Hz; seconds")
    print(
        f"{'corridor-fusion':34}{total[0]:8.2f}   target {goal:.2f}; {60 * minutes / total[0]:.0f} times real time"
    )
    print(f"{'plain filterpy EKF':34}{total[1]:8.2f}   corridor-fusion over it, median minute: {ratio:.2f}")
    end = truth(60.0 * minutes)[0]
    error = np.degrees([ours.estimate().heading_rad - end, float(plain.x[0]) - end])
    print(f"{'heading off at the end, degrees':34}{error[0]:8.2f} and {error[1]:.2f}")


def _minute(filter_: Any, samples: list[Sample]) -> float:
    add_imu, add_measurement = filter_.add_imu, filter_.add_measurement
    before = clock()
    for _, name, t_ns, arguments in samples:
        if name == "add_imu":
            add_imu(t_ns, *arguments)
        else:
            add_measurement(t_ns, *arguments)
    return clock() - before


class Health(NamedTuple):
    """Of covariances looked at: how many, greatest |P - P'|, smallest eigenvalue at unit variances, how many bad."""

    looked_at: int = 0
    asymmetry: float = 0.0
    smallest: float = inf
    bad: int = 0

    def with_covariance(self, P: np.ndarray) -> Health:
        """Look at one more."""
        std = np.sqrt(np.diagonal(P))
        finite = bool(np.isfinite(P).all()) and bool((std > 0).all())
        asymmetry = float(np.abs(P - P.T).max())
        least = float(np.linalg.eigvalsh(P / np.outer(std, std))[0]) if finite else -inf
        bad = self.bad + (asymmetry != 0.0 or not least > 0.0)
        return Health(self.looked_at + 1, max(self.asymmetry, asymmetry), min(self.smallest, least), bad)


def worn(steps: int, seed: int = 3) -> tuple[CorridorEKF, Health]:
    """Run the filter's arithmetic for so many propagation steps; its covariance is looked at on the way."""
    rng = np.random.default_rng(seed)
    noise = ProcessNoise(GYRO_NOISE, 1e-4, 1.2 * GYRO_NOISE)
    ekf, health = CorridorEKF(np.zeros(3), np.diag([1.0, 0.02**2, 100.0])), Health()
    H_all = [np.array(row, float) for row in ([1, 0, 0], [1, 0, 1], [0, 0, 1])]
    other_axis, unknown = np.diag([0.0, 1.0, 1.0]), np.diag([1e-4, 0.0, 1e-4])
    other_axis[2, 0] = 1.0
    unknown[0, 2] = unknown[2, 0] = -1e-4 * (1 - 1e-9)
    for start in range(0, steps, BLOCK):
        count = min(BLOCK, steps - start)
        dts, turns = rng.uniform(0.0002, 0.01, count).tolist(), rng.normal(0.0, 0.01, count).tolist()
        kinds = rng.integers(0, 18, count).tolist()
        residuals, decades = rng.normal(0, 1, count).tolist(), rng.uniform(-9, 1, count).tolist()
        ekf.nodes.clear()  # no smoother will ask for them
        blind = rng.uniform() < 0.1  # five seconds without any measurement
        for k in range(count):
            ekf.advance(dts[k], turns[k], noise)
            if kinds[k] < len(H_all) and not blind:
                H, R = H_all[kinds[k]], 10.0 ** decades[k]
                S = float(H @ ekf.P @ H) + R
                ekf.update(ScalarMeasurement(sqrt(S) * residuals[k], H, R))
        if rng.uniform() < 0.01:
            ekf.predict(other_axis @ ekf.x, other_axis, unknown)
        health = health.with_covariance(ekf.P)
    return ekf, health


def print_covariance(steps: int) -> None:
    """Print whether the covariance stays sound over so many steps."""
    before = clock()
    ekf, health = worn(steps)
    std = ", ".join(f"{value:.2g}" for value in np.sqrt(np.diagonal(ekf.P)))
    verdict = (
        "symmetric and positive" if health.bad == 0 else f"NOT symmetric and positive {health.bad} times"
    )
    print(f"\nCovariance over {steps} steps, looked at {health.looked_at} times: {verdict}")
    print(
        f"greatest |P - P'| {health.asymmetry:g}; smallest eigenvalue, at unit variances, {health.smallest:.2g}"
    )
    print(f"standard deviations at the end: {std}; took {clock() - before:.0f} s")


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--seconds", type=float, default=60.0, help="of flight, for the single calls (default: 60)"
    )
    parser.add_argument(
        "--minutes", type=int, default=60, help="of flight, beside filterpy's filter (default: 60)"
    )
    parser.add_argument(
        "--steps", type=int, default=10_000_000, help="of the covariance (default: ten million)"
    )
    options = parser.parse_args()
    print_calls(options.seconds)
    print_hour(options.minutes)
    print_covariance(options.steps)


if __name__ == "__main__":
    main()
