"""The camera's mounting yaw from the vehicle's track, for vehicles that hardly tilt but measure their velocity.

A vehicle with heading ``psi``, forward speed u and rightward speed w drifts to the right at
``u sin(psi) + w cos(psi)``. The camera measures the drift as lateral offset in units of the half width h, and a
heading that is the vehicle's plus the mounting yaw m. To first order in m

    offset = (A - m B) / h + constant,    A = integral(u sin + w cos),  B = integral(u cos - w sin)

with the measured heading in both integrals. Without a velocity, h and m cannot be separated from the vehicle's crab
angle.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot, radians

import numpy as np
import numpy.typing as npt

from fusion.alignment.clock import ClockFit
from fusion.alignment.markov import Process, fit_lines
from fusion.alignment.turning import Turning, seconds
from fusion.alignment.views import Sightings
from fusion.flight import AttitudeStream, Flight, VectorStream

FloatArray = npt.NDArray[np.float64]

DIRECTION_STD_RAD = radians(1.0)  # of a velocity's direction in the body
ORDINARY_HALF_WIDTH_M, HALF_WIDTH_LOG_STD = 1.0, 0.5
GIVEN_WIDTH_LOG_STD = 0.05
MAX_GAP_S = 0.6
MIN_TRACK_FRAMES = 30
MIN_DISTANCE_M = 2.0
START_DENSITY = 0.05  # half widths per square root of a second
OFFSET_STD_FLOOR = 0.01
SLOPE_SPAN_S = 0.4  # for the slope of positions


@dataclass(frozen=True, slots=True)
class TrackFit:
    """Mounting yaw by the track, and the distance flown."""

    yaw_rad: float
    std_rad: float
    distance_m: float


def fit_track(
    flight: Flight,
    sightings: Sightings,
    turning: Turning,
    clock: ClockFit,
    origin_ns: int,
    turned_yaw_rad: float = 0.0,
) -> TrackFit | None:
    """Fit the mounting yaw to drift and velocity; None if the flight has no velocity or hardly moves.

    Parameters
    ----------
    flight
        With velocities, or positions and attitude.
    sightings, turning, clock
        Of the same flight; the frames of the clock's fit are used.
    origin_ns
        Time that the others count from.
    turned_yaw_rad
        Mounting yaw already corrected in the sightings' camera.
    """
    velocity = _velocity(flight)
    if velocity is None or len(velocity.t_ns) < 2:
        return None
    used = np.isin(sightings.t_s, clock.samples.t_s) & np.isfinite(sightings.offset_norm)
    t = sightings.t_s[used]
    if len(t) < MIN_TRACK_FRAMES:
        return None
    corridor = clock.samples.corridor[np.searchsorted(clock.samples.t_s, t)]
    psi, offset, std = sightings.heading_rad[used], sightings.offset_norm[used], sightings.offset_std[used]
    ahead, aside = _level_velocity(velocity, turning, t + clock.offset_s, origin_ns)
    drift = ahead * np.sin(psi) + aside * np.cos(psi)
    along = ahead * np.cos(psi) - aside * np.sin(psi)
    step_s = np.diff(t, prepend=t[0])
    breaks = (step_s > MAX_GAP_S) | (np.diff(corridor, prepend=corridor[0]) != 0) | ~np.isfinite(drift)
    chain = np.cumsum(breaks)
    known = np.isfinite(drift)
    t, chain, offset, std, step_s = t[known], chain[known], offset[known], std[known], step_s[known]
    A, B = (_integral(values[known], step_s, chain) for values in (drift, along))
    distance_m = float(np.abs(np.diff(B)[np.diff(chain) == 0]).sum())
    if len(t) < MIN_TRACK_FRAMES or distance_m < MIN_DISTANCE_M:
        return None
    half_m, log_std = ORDINARY_HALF_WIDTH_M, HALF_WIDTH_LOG_STD
    if flight.corridor_width_m is not None:
        half_m, log_std = 0.5 * flight.corridor_width_m, GIVEN_WIDTH_LOG_STD
    rows = np.append(t, 0.0), np.append(chain, -1)
    fit = fit_lines(
        np.vstack([np.stack([A, B], axis=1), [half_m, 0.0]]),
        np.append(offset, 1.0),
        np.append(np.maximum(std, OFFSET_STD_FLOOR) ** 2, log_std**2),
        lambda density: _walk(*rows, density),
        START_DENSITY,
    )
    per_m, minus_yaw = float(fit.values[0]), float(fit.values[1])
    if not per_m > 0.1 / half_m:
        return None
    yaw = -minus_yaw / per_m
    gradient = np.array([yaw, 1.0]) / per_m
    std_rad = float(np.sqrt(gradient @ fit.covariance @ gradient))
    return TrackFit(turned_yaw_rad + yaw, hypot(std_rad, DIRECTION_STD_RAD), distance_m)


def _walk(t_s: FloatArray, chain: npt.NDArray[np.int64], density: float) -> Process:
    """Random walk; the last row, the prior of the width, is excluded."""
    walk = Process.walk(t_s, chain, density)
    variance = walk.variance.copy()
    variance[-1] = 1e-12
    return Process(walk.phi, variance)


def _integral(rate: FloatArray, step_s: FloatArray, chain: npt.NDArray[np.int64]) -> FloatArray:
    """Integrate a rate (n,) over time by the trapezoid rule, from zero in each chain."""
    goes_on = np.diff(chain, prepend=-1) == 0
    total = np.cumsum(np.where(goes_on, 0.5 * (rate + np.roll(rate, 1)) * step_s, 0.0))
    start = np.maximum.accumulate(np.where(goes_on, 0, np.arange(len(rate))))
    return np.asarray(total - total[start])


def _level_velocity(
    velocity: VectorStream, turning: Turning, t_s: FloatArray, origin_ns: int
) -> tuple[FloatArray, FloatArray]:
    """Forward and rightward speed (n,) in the level frame, at times; NaN outside the stream."""
    at = seconds(velocity.t_ns, origin_ns)
    index = np.clip(np.searchsorted(at, t_s), 1, len(at) - 1)
    far = (t_s < at[0]) | (t_s > at[-1]) | (at[index] - at[index - 1] > MAX_GAP_S)
    v = np.stack([np.interp(t_s, at, velocity.xyz[:, k]) for k in range(3)], axis=1)
    down = np.stack([np.interp(t_s, turning.t_s, turning.down[:, k]) for k in range(3)], axis=1)
    level = np.hypot(down[:, 1], down[:, 2])
    aside = (down[:, 2] * v[:, 1] - down[:, 1] * v[:, 2]) / level
    ahead = v[:, 0] * level - down[:, 0] * (down[:, 1] * v[:, 1] + down[:, 2] * v[:, 2]) / level
    return np.where(far, np.nan, ahead), np.where(far, np.nan, aside)


def _velocity(flight: Flight) -> VectorStream | None:
    """Velocity in the body: the flight's own, or the slope of its positions rotated by its attitude."""
    if flight.velocity is not None:
        return flight.velocity
    position, attitude = flight.position, flight.attitude
    if position is None or attitude is None or len(position.t_ns) < 3 or len(attitude.t_ns) < 2:
        return None
    t = seconds(position.t_ns, int(position.t_ns[0]))
    half = 0.5 * SLOPE_SPAN_S

    def at(times: FloatArray) -> FloatArray:
        return np.stack([np.interp(times, t, position.xyz[:, k]) for k in range(3)], axis=1)

    before, after = np.maximum(t - half, t[0]), np.minimum(t + half, t[-1])
    v_world = (at(after) - at(before)) / (after - before)[:, None]
    return VectorStream(position.t_ns, _in_body(v_world, position, attitude))


def _in_body(v_world: FloatArray, position: VectorStream, attitude: AttitudeStream) -> FloatArray:
    """Rotate vectors (n, 3) from the world into the body by the nearest attitude."""
    index = np.clip(np.searchsorted(attitude.t_ns, position.t_ns), 1, len(attitude.t_ns) - 1)
    nearer = position.t_ns - attitude.t_ns[index - 1] < attitude.t_ns[index] - position.t_ns
    w, *xyz = attitude.q_world_body[index - nearer].T
    axis = -np.stack(xyz, axis=1)  # of the inverse rotation
    cross = 2.0 * np.cross(axis, v_world)
    return np.asarray(v_world + w[:, None] * cross + np.cross(axis, cross))
