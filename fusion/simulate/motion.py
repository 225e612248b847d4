"""Flights as smooth curves: quintic splines of position and attitude, with exact derivatives.

The nominal path follows the centre lines of the corridors on the route, slows down before a junction, turns
smoothly and continues on the next centre line. Sideways motion, swings of the heading, height and tilt are added as
sums of three sines, scaled to the configured amplitude and rate. The values on a time grid are then interpolated by
splines, and the splines are the ground truth.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.interpolate import BSpline, make_interp_spline
from scipy.ndimage import gaussian_filter1d

from fusion.simulate.config import MotionConfig
from fusion.simulate.scene.plan import Meeting, Room, corridor_length_m, in_junction, part_at

FloatArray = npt.NDArray[np.float64]

GRAVITY_M_S2 = 9.80665
STEP_S = 0.02
MARGIN_S = 1.0  # of spline before the first and after the last sample
BRAKING_S = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """Exact state at times (n,); world z down, body FRD.

    Parameters
    ----------
    p_world_m, v_world_m_s
        Position and velocity of the body (n, 3).
    R_world_body
        (n, 3, 3).
    rate_rad_s, specific_force_m_s2
        Readings of a perfect gyroscope and accelerometer at the body's origin, (n, 3).
    heading_rad, lateral_offset_m, corridor_width_m, corridor_id, in_junction
        As in ``corridor_truth.csv``, (n,).
    """

    t_s: FloatArray
    p_world_m: FloatArray
    v_world_m_s: FloatArray
    R_world_body: FloatArray
    rate_rad_s: FloatArray
    specific_force_m_s2: FloatArray
    heading_rad: FloatArray
    lateral_offset_m: FloatArray
    corridor_width_m: FloatArray
    corridor_id: npt.NDArray[np.int64]
    in_junction: npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class _Turn:
    """Passage of a junction between two times, from one room into another."""

    start_s: float
    end_s: float
    room: int
    next_room: int


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """A flight through rooms; ``duration_s`` long, and defined ``MARGIN_S`` beyond both ends."""

    rooms: tuple[Room, ...]
    meetings: tuple[Meeting, ...]
    duration_s: float
    position: BSpline
    angles: BSpline
    turns: tuple[_Turn, ...]

    def rotations(self, t_s: npt.ArrayLike) -> FloatArray:
        """R_world_body (n, 3, 3)."""
        return rotations(self.angles(np.atleast_1d(np.asarray(t_s, float))))

    def truth(self, t_s: npt.ArrayLike) -> Truth:
        """Evaluate the flight at times (n,), seconds from its start."""
        t = np.atleast_1d(np.asarray(t_s, float))
        angles, slopes = self.angles(t), self.angles(t, 1)
        R = rotations(angles)
        p, v, a = self.position(t), self.position(t, 1), self.position(t, 2)
        force = np.einsum("nji,nj->ni", R, a - np.array([0.0, 0.0, GRAVITY_M_S2]))
        room = self._rooms_at(t)
        heading, offset, width = np.empty(len(t)), np.empty(len(t)), np.empty(len(t))
        junction = np.zeros(len(t), bool)
        for number in np.unique(room).tolist():
            flown = self.rooms[number]
            here = room == number
            s, y = flown.to_room(p[here, :2]).T
            turned = angles[here, 2] - flown.yaw_rad
            heading[here] = np.arctan2(np.sin(turned), np.cos(turned))
            behind = part_at(self.rooms, number, np.inf)  # continuation of the corridor with another width
            y_behind = behind.to_room(p[here, :2])[:, 1]
            offset[here] = np.where(s < flown.length_m, y, y_behind)
            width[here] = np.where(s < flown.length_m, flown.width_m, behind.width_m)
            junction[here] = in_junction(list(self.rooms), list(self.meetings), number, s)
        for turn in self.turns:
            junction |= (t > turn.start_s) & (t < turn.end_s)
        return Truth(
            t, p, v, R, _body_rates(angles, slopes), force, heading, offset, width, room + 1, junction
        )

    def _rooms_at(self, t: FloatArray) -> npt.NDArray[np.int64]:
        """Return the room being flown; in a turn it changes halfway."""
        room = np.zeros(len(t), np.int64)
        for turn in self.turns:
            room[t >= (turn.start_s + turn.end_s) / 2] = turn.next_room
        return room


def rotations(angles: FloatArray) -> FloatArray:
    """R_world_body (n, 3, 3) of roll, pitch, yaw (n, 3)."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(angles).T, np.sin(angles).T
    rows = (
        (cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr),
        (sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr),
        (-sp, cp * sr, cp * cr),
    )
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def _body_rates(angles: FloatArray, slopes: FloatArray) -> FloatArray:
    """Angular velocity (n, 3) in the body from roll, pitch, yaw (n, 3) and their derivatives."""
    roll, pitch = angles[:, 0], angles[:, 1]
    roll_dot, pitch_dot, yaw_dot = slopes.T
    return np.stack(
        [
            roll_dot - yaw_dot * np.sin(pitch),
            pitch_dot * np.cos(roll) + yaw_dot * np.sin(roll) * np.cos(pitch),
            -pitch_dot * np.sin(roll) + yaw_dot * np.cos(roll) * np.cos(pitch),
        ],
        axis=1,
    )


def smooth_step(x: FloatArray) -> FloatArray:
    """Rise from 0 to 1 over x from 0 to 1 with three continuous derivatives; symmetric about the middle."""
    x = np.clip(x, 0.0, 1.0)
    return x**4 * (35 - 84 * x + 70 * x**2 - 20 * x**3)


def oscillation(rng: np.random.Generator, t: FloatArray, amplitude: float, rate: float) -> FloatArray:
    """Sum of three sines with the maximum ``amplitude`` over t and the maximum rate of change ``rate``."""
    ratios, phases = rng.uniform(0.9, 1.1, 3) * (0.5, 0.85, 1.3), rng.uniform(0, 2 * np.pi, 3)
    weights = rng.uniform(0.6, 1.0, 3)
    if amplitude <= 0 or rate <= 0:
        return np.zeros(len(t))
    centre, best, best_miss = rate / amplitude, np.zeros(len(t)), np.inf
    # scaling the time changes the visible part of the wave, so the rate is found by a search
    for factors in (np.geomspace(0.4, 2.5, 40), np.linspace(0.96, 1.04, 17)):
        bases = (centre * factors).tolist()
        for base in bases:
            wave = weights @ np.sin(base * ratios[:, None] * t + phases[:, None])
            wave *= amplitude / np.abs(wave).max()
            miss = abs(float(np.abs(np.gradient(wave, t)).max()) / rate - 1)
            if miss < best_miss:
                best, best_miss, centre = wave, miss, base
    return best


@dataclass(frozen=True, slots=True)
class _Timeline:
    """Course over ground and speed on the time grid, with the turns."""

    course_rad: FloatArray
    speed_m_s: FloatArray
    turns: tuple[_Turn, ...]


def _braked_m(speed: float, slower: float) -> float:
    return (speed + slower) / 2 * BRAKING_S  # the step is symmetric


def _change(t: FloatArray, speeds: FloatArray, start_s: float, from_speed: float, to_speed: float) -> None:
    """Change the speed from one value to another, starting at ``start_s``."""
    later = t >= start_s
    speeds[later] = from_speed + (to_speed - from_speed) * smooth_step((t[later] - start_s) / BRAKING_S)


def _timeline(config: MotionConfig, rooms: list[Room], meetings: list[Meeting], t: FloatArray) -> _Timeline:
    """Schedule the route: cruise, brake, turn, accelerate, and stop before the end."""
    cruise, slow = config.speed_m_s, min(config.turn_speed_m_s, config.speed_m_s)
    course, speeds = np.full(len(t), rooms[0].yaw_rad), np.full(len(t), cruise)
    turns: list[_Turn] = []
    clock, place, room, yaw, speed = 0.0, config.start_m, 0, rooms[0].yaw_rad, cruise
    for number in config.route:
        meeting = next(m for m in meetings if m.child == number - 1)
        angle = meeting.angle_rad
        lasts = max(abs(angle) / config.turn_rate_rad_s, 0.2)
        fine = np.linspace(0, 1, 2001)
        turned = angle * smooth_step(fine)
        ahead, aside = (float(np.trapezoid(f(turned), fine)) * lasts * slow for f in (np.cos, np.sin))
        # entering here, the arc ends on the next centre line
        enter = meeting.parent_s_m - ahead + aside * np.cos(angle) / np.sin(angle)
        free = enter - place - _braked_m(speed, slow)
        if free < 0 or cruise <= 0:  # no space to cruise first: fly slowly all the way
            speeds[t >= clock] = speed = slow
            clock += max(0.0, enter - place) / max(slow, 1e-3)
        else:
            clock += free / cruise
            _change(t, speeds, clock, speed, slow)
            clock += BRAKING_S
        course += angle * smooth_step((t - clock) / lasts)
        turns.append(_Turn(clock, clock + lasts, room, number - 1))
        clock += lasts
        left = np.array([enter + ahead - meeting.parent_s_m, aside])
        room, yaw = number - 1, yaw + angle
        place = meeting.child_s_m + float(left @ [np.cos(angle), np.sin(angle)])
        _change(t, speeds, clock, slow, cruise)
        clock, place, speed = clock + BRAKING_S, place + _braked_m(slow, cruise), cruise
    free = corridor_length_m(rooms, room) - config.end_margin_m - place - _braked_m(cruise, 0.0)
    if cruise > 0:
        _change(t, speeds, clock + max(0.0, free) / cruise, cruise, 0.0)
    return _Timeline(course, speeds, tuple(turns))


def plan_flight(config: MotionConfig, rooms: list[Room], meetings: list[Meeting], seed: int) -> Trajectory:
    """Make a flight along the route; the same arguments give the same flight."""
    rng = np.random.default_rng((seed, 5))
    t = np.arange(-MARGIN_S, config.duration_s + MARGIN_S + STEP_S, STEP_S)
    line = _timeline(config, rooms, meetings, t)
    velocity = line.speed_m_s[:, None] * np.stack([np.cos(line.course_rad), np.sin(line.course_rad)], axis=1)
    moved = np.concatenate([np.zeros((1, 2)), np.cumsum((velocity[1:] + velocity[:-1]) / 2 * STEP_S, axis=0)])
    start = int(np.argmin(np.abs(t)))
    path = rooms[0].to_world(config.start_m, 0.0) + moved - moved[start]
    aside = config.lateral_mean_m + oscillation(rng, t, config.lateral_amplitude_m, config.lateral_rate_m_s)
    path += aside[:, None] * np.stack([-np.sin(line.course_rad), np.cos(line.course_rad)], axis=1)
    height = config.height_m + oscillation(rng, t, config.height_amplitude_m, 1.2 * config.height_amplitude_m)
    swing = oscillation(rng, t, config.heading_amplitude_rad, config.heading_rate_rad_s)
    yaw = line.course_rad + config.heading_mean_rad + swing
    roll, pitch = _tilt(rng, config, t, path, yaw)
    floor = -np.tan(rooms[0].slope_rad) * path[:, 0]
    position = make_interp_spline(t, np.column_stack([path, floor - height]), k=5)
    angles = make_interp_spline(t, np.column_stack([roll, pitch, yaw]), k=5)
    return Trajectory(tuple(rooms), tuple(meetings), config.duration_s, position, angles, line.turns)


def _tilt(
    rng: np.random.Generator, config: MotionConfig, t: FloatArray, path: FloatArray, yaw: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Roll and pitch for the accelerations of the path, limited to the largest tilt, plus swings."""
    acceleration = gaussian_filter1d(np.gradient(np.gradient(path, t, axis=0), t, axis=0), 8, axis=0)
    forward = np.sum(acceleration * np.stack([np.cos(yaw), np.sin(yaw)], axis=1), axis=1)
    right = np.sum(acceleration * np.stack([-np.sin(yaw), np.cos(yaw)], axis=1), axis=1)
    tilts: list[FloatArray] = []
    for coupled in (np.arctan2(right, GRAVITY_M_S2), -np.arctan2(forward, GRAVITY_M_S2)):
        greatest = float(np.abs(coupled).max())
        scale = min(1.0, 0.7 * config.tilt_rad / max(greatest, 1e-12))
        swing = oscillation(rng, t, config.tilt_rad - scale * greatest, config.tilt_rate_rad_s)
        tilts.append(scale * coupled + swing)
    return tilts[0], tilts[1]
