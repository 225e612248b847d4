"""Checks the declared units, axes, clocks and sensors of a flight by its data.

Readers convert a log as declared; these checks compare the declaration with the numbers. Faults that would make the
result silently wrong are rejected; likely or minor ones are listed in the flight's ``problems``. A stream that never
changes is left out, because it carries no information.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from math import degrees
from pathlib import Path

import numpy as np

from fusion.flight import AttitudeStream, Flight, FloatArray, ImuStream, RangeStream, TimeArray, VectorStream
from fusion.logs.plausibility.clocks import examine_clocks
from fusion.logs.plausibility.findings import Advice, Finding, Severity
from fusion.logs.plausibility.imu import MIN_SAMPLES, examine_imu
from vision import InputError

MIN_DEAD_NS = 2_000_000_000  # a stream without change for this long is dead
MAX_SPEED_M_S = 60.0
MAX_HEIGHT_M = 20.0


@dataclass(frozen=True, slots=True, eq=False)
class Streams:
    """The streams of a flight that are checked; None if the flight lacks one."""

    frames_t_ns: TimeArray | None = None
    imu: ImuStream | None = None
    attitude: AttitudeStream | None = None
    velocity: VectorStream | None = None
    position: VectorStream | None = None
    range: RangeStream | None = None

    def times(self) -> dict[str, TimeArray]:
        """Return the times of each existing stream, by its name in a manifest."""
        streams = {
            "imu": self.imu,
            "attitude": self.attitude,
            "velocity": self.velocity,
            "position": self.position,
            "range": self.range,
        }
        found = {} if self.frames_t_ns is None else {"camera": self.frames_t_ns}
        return found | {name: stream.t_ns for name, stream in streams.items() if stream is not None}


def check_flight(
    flight: Flight,
    path: Path | None = None,
    files: Mapping[str, Path] | None = None,
    advice: Advice = Advice(),  # noqa: B008  # frozen
) -> Flight:
    """Return the flight without dead streams, with implausible properties among its problems.

    Parameters
    ----------
    flight
        From a reader.
    path
        The path that the user gave, for messages.
    files
        Separate files of streams, by the stream's name in a manifest.
    advice
        Remedies, by the medium of each stream.

    Raises
    ------
    InputError
        If the result would be wrong: units, axes or clocks are certainly not as assumed.
    """
    alive, findings = examine_streams(_streams(flight), advice)
    for finding in findings:
        if finding.severity is Severity.ERROR:
            raise InputError(
                f"{finding.stream}: {finding.text}",
                file=(files or {}).get(finding.stream, path),
                remedy=finding.remedy,
            )
    problems = (*flight.problems, *(finding.sentence for finding in findings))
    return replace(
        flight,
        imu=alive.imu,
        attitude=alive.attitude,
        velocity=alive.velocity,
        range=alive.range,
        problems=problems,
    )


def examine_flight(flight: Flight, advice: Advice) -> list[Finding]:
    """Return all implausible properties of a flight."""
    return examine_streams(_streams(flight), advice)[1]


def examine_streams(streams: Streams, advice: Advice) -> tuple[Streams, list[Finding]]:
    """Return the streams without dead ones, and their implausible properties, clocks first."""
    streams, found = without_dead_streams(streams)
    found += examine_clocks(streams.times(), advice)
    if any(finding.kind == "time_unit" for finding in found):
        return streams, found  # rates mean nothing without their times
    if streams.imu is not None:
        found += examine_imu(streams.imu, streams.attitude, advice)
    if streams.attitude is not None and not any(finding.kind == "quaternion_order" for finding in found):
        found += examine_attitude(streams.attitude, advice)
    if streams.velocity is not None:
        found += _speeds(streams.velocity)
    return streams, found


def without_dead_streams(streams: Streams) -> tuple[Streams, list[Finding]]:
    """Remove streams that never change or are impossible, and a velocity of zeros.

    An accelerometer that never changes becomes NaN.
    """
    found: list[Finding] = []

    def is_dead(name: str, t_ns: TimeArray, values: FloatArray, what: str) -> bool:
        if len(values) < MIN_SAMPLES or t_ns[-1] - t_ns[0] < MIN_DEAD_NS or np.any(values != values[0]):
            return False
        text = f"{what} is {_vector(values[0])} in all of its {len(values)} rows: it was never measured, left out"
        found.append(Finding(Severity.WARNING, name, "constant", text, "check the logger"))
        return True

    imu, attitude, velocity = streams.imu, streams.attitude, streams.velocity
    if imu is not None and is_dead("imu", imu.t_ns, imu.gyro_rad_s, "the gyroscope"):
        imu = None
    if imu is not None and is_dead("imu", imu.t_ns, imu.accel_m_s2, "the accelerometer"):
        imu = replace(imu, accel_m_s2=np.full_like(imu.accel_m_s2, np.nan))
    if attitude is not None and is_dead("attitude", attitude.t_ns, attitude.q_world_body, "the quaternion"):
        attitude = None
    if (
        velocity is not None
        and not velocity.xyz.any()
        and is_dead("velocity", velocity.t_ns, velocity.xyz, "it")
    ):
        velocity = None
    distance = streams.range
    if distance is not None and float(np.median(distance.distance_m)) > MAX_HEIGHT_M:
        text = f"most of it is more than {MAX_HEIGHT_M:.0f} m: no corridor is that high, left out"
        remedy = 'give metres, or set range_unit = "cm" or "mm" in [range.columns] of flight.toml'
        found.append(Finding(Severity.WARNING, "range", "range_unit", text, remedy))
        distance = None
    return replace(streams, imu=imu, attitude=attitude, velocity=velocity, range=distance), found


def examine_attitude(attitude: AttitudeStream, advice: Advice) -> Iterator[Finding]:
    """Yield implausible attitudes: a vehicle that flies upside down, or on its side."""
    q = attitude.q_world_body
    if len(q) < MIN_SAMPLES:
        return
    tilt_rad = np.arccos(np.clip(1.0 - 2.0 * (q[:, 1] ** 2 + q[:, 2] ** 2), -1.0, 1.0))
    tilt_deg = degrees(float(np.median(tilt_rad)))
    if tilt_deg > 135.0:
        text = (
            f"the vehicle is upside down most of the time, by {tilt_deg:.0f} degrees: its axes are not as taken, "
            "z of the body or of the world points the other way"
        )
        yield Finding(Severity.ERROR, "attitude", "attitude_axes", text, advice.frame("attitude", "flu"))
    elif tilt_deg > 45.0:
        text = f"the vehicle lies on its side most of the time, by {tilt_deg:.0f} degrees"
        up = -np.median(down_in_body(q), axis=0)
        severity = Severity.ERROR if tilt_deg > 65.0 else Severity.WARNING
        yield Finding(severity, "attitude", "attitude_axes", text, advice.mounting("attitude", up))


def down_in_body(q_world_body: FloatArray) -> FloatArray:
    """Return the world's down (n, 3) in the body's axes."""
    w, x, y, z = q_world_body.T
    return np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], axis=1)


def _speeds(velocity: VectorStream) -> Iterator[Finding]:
    if len(velocity.t_ns) < MIN_SAMPLES:
        return
    speed = float(np.percentile(np.linalg.norm(velocity.xyz, axis=1), 90.0))
    if speed > MAX_SPEED_M_S:
        yield Finding(
            Severity.ERROR,
            "velocity",
            "velocity_unit",
            f"one sample in ten is faster than {speed:.0f} m/s: it is in another unit",
            'give metres per second, or set velocity_unit = "cm/s" or "mm/s" in [velocity.columns] of flight.toml',
        )


def _streams(flight: Flight) -> Streams:
    return Streams(
        flight.frames.t_ns, flight.imu, flight.attitude, flight.velocity, flight.position, flight.range
    )


def _vector(values: FloatArray) -> str:
    return "(" + ", ".join(f"{value + 0.0:g}" for value in values) + ")"
