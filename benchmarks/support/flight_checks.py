"""Faults of a `Flight` made by hand, and of a program that calls the estimator: refused in a line, or survived."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from fusion import CorridorEstimator, Flight, FusionConfig, FusionResult, fuse_flight
from fusion.flight import ImuStream, VectorStream
from tests.fusion.simulated import frame
from vision import InputError

EVERY_FRAME = 5  # pictures take most of the time
DIES_S = 5.0


class Check(NamedTuple):
    """What came of a check: whether it is as asked, and what happened in a few words."""

    passed: bool
    said: str


def _imu(flight: Flight) -> ImuStream:
    if flight.imu is None:
        raise InputError("the flight has no IMU", remedy="use one that has")
    return flight.imu


def _fused(flight: Flight) -> FusionResult | str:
    """Fuse with a few frames; the sentence where the flight is refused, the error where it is not in a line."""
    thinned = replace(flight, frames=flight.frames.chosen(np.arange(0, len(flight.frames.t_ns), EVERY_FRAME)))
    try:
        with np.errstate(all="ignore"):
            return fuse_flight(thinned)
    except InputError as error:
        return f"refused: {error}"
    except Exception as error:  # any kind is what is looked for
        return f"{type(error).__name__}: {error}"


def _sound(flight: Flight) -> Check:
    """Whether the flight is refused in a line, or fused into numbers that are some."""
    result = _fused(flight)
    if isinstance(result, str):
        return Check(result.startswith("refused") and "\n" not in result, result)
    rows = result.estimates[result.estimates["status"] != "initialising"]
    heading = rows["heading_rad"]
    infinite = sum(bool(np.isinf(rows[n]).any()) for n in rows.dtype.names or () if rows[n].dtype.kind == "f")
    finite = bool(np.isfinite(heading).all()) and len(heading) > 0 and not infinite
    ordered = bool((np.diff(result.estimates["timestamp_ns"]) > 0).all())
    text = f"{len(rows)} rows, {'finite' if finite else 'not finite'}, {'in order' if ordered else 'not in order'}"
    return Check(finite and ordered, text)


def imu_dies(flight: Flight) -> Check:
    """Lose the IMU: rows and status must go on with what is left."""
    imu = _imu(flight)
    keep = imu.t_ns < imu.t_ns[0] + round(DIES_S * 1e9)
    cut = replace(imu, t_ns=imu.t_ns[keep], gyro_rad_s=imu.gyro_rad_s[keep], accel_m_s2=imu.accel_m_s2[keep])
    result = _fused(replace(flight, imu=cut))
    if isinstance(result, str):
        return Check(False, result)
    missing_s = float(flight.frames.t_ns[-1] - result.estimates["timestamp_ns"][-1]) * 1e-9
    verdict = result.summary.get("verdict", "")
    return Check(missing_s < 0.5, f"rows end {missing_s:.1f} s before the frames, verdict {verdict}")


def imu_unsorted(flight: Flight) -> Check:
    """Mix up the times of a stream."""
    imu = _imu(flight)
    order = np.random.default_rng(0).permutation(len(imu.t_ns))
    mixed = replace(
        imu, t_ns=imu.t_ns[order], gyro_rad_s=imu.gyro_rad_s[order], accel_m_s2=imu.accel_m_s2[order]
    )
    return _sound(replace(flight, imu=mixed))


def frames_unsorted(flight: Flight) -> Check:
    """Let the pictures' times go back."""
    frames = replace(flight.frames, t_ns=flight.frames.t_ns[::-1].copy())
    return _sound(replace(flight, frames=frames))


def _with_velocity(flight: Flight, value_m_s: float) -> Check:
    t_ns = _imu(flight).t_ns[::5]
    return _sound(replace(flight, velocity=VectorStream(t_ns, np.full((len(t_ns), 3), value_m_s))))


def seconds_as_time(_: Flight) -> Check:
    """Give times in seconds, as floats, where whole nanoseconds are meant."""
    estimator: Any = CorridorEstimator(FusionConfig())  # its times are typed as whole numbers
    try:
        for i in range(1000):
            estimator.add_imu(1000 + 0.005 * i, (0.0, 0.0, 0.0), (0.0, 0.0, -9.8))
            if i % 7 == 0:
                estimator.add_measurement(1000 + 0.005 * i, frame(0.0))
    except (InputError, TypeError, ValueError) as error:
        return Check(True, f"refused: {error}")
    e = estimator.estimate()
    return Check(False, f"{e.status}: {e.reason}; counted: {dict(estimator.counters)}")


def wrong_shape(_: Flight) -> Check:
    """Give a gyroscope of two axes: the error must name the argument."""
    try:
        CorridorEstimator(FusionConfig()).add_imu(0, np.zeros(2))
    except Exception as error:  # any kind is what is looked for
        return Check("gyro" in str(error), f"{type(error).__name__}: {error}")
    return Check(False, "taken")


FLIGHT_CHECKS: dict[str, Callable[[Flight], Check]] = {
    "IMU dies at 5 s, fused offline": imu_dies,
    "IMU times unsorted": imu_unsorted,
    "frame times unsorted": frames_unsorted,
    "velocities NaN, fused offline": lambda flight: _with_velocity(flight, np.nan),
    "velocities of 1e300, fused offline": lambda flight: _with_velocity(flight, 1e300),
    "times in seconds": seconds_as_time,
    "gyroscope of two axes": wrong_shape,
}
