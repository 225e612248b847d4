"""Floor plans: a union of rectangles (corridors, halls) and the walls that bound it.

World axes: x along the first corridor, y right of it, z down, floor at z = 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import cos, sin

import numpy as np
import numpy.typing as npt

from fusion.simulate.scene.builder import Frame
from fusion.simulate.scene.config import SceneConfig, Sides

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Room:
    """A rectangle of floor: starts at (x, y), runs ``length_m`` in direction ``yaw_rad``, ``width_m`` across.

    ``yaw_rad`` is positive to the right; (x, y) is the middle of the near end. ``part_of`` is the number of the
    corridor that continues in this room with another width. The floor rises ahead by ``slope_rad``.
    """

    x_m: float
    y_m: float
    yaw_rad: float
    length_m: float
    width_m: float
    is_corridor: bool = True
    part_of: int | None = None
    slope_rad: float = 0.0

    @property
    def direction(self) -> FloatArray:
        """Unit vector (2,) along the room."""
        return np.array([cos(self.yaw_rad), sin(self.yaw_rad)])

    @property
    def right(self) -> FloatArray:
        """Unit vector (2,) to the right of it."""
        return np.array([-sin(self.yaw_rad), cos(self.yaw_rad)])

    def to_world(self, s: float, y: float) -> FloatArray:
        """World point (2,) at s along and y right of the centre line."""
        return np.array([self.x_m, self.y_m]) + s * self.direction + y * self.right

    def to_room(self, points: npt.ArrayLike) -> FloatArray:
        """Along and right coordinates (n, 2) of world points (n, 2)."""
        relative = np.asarray(points, float).reshape(-1, 2) - np.array([self.x_m, self.y_m])
        return np.stack([relative @ self.direction, relative @ self.right], axis=1)

    def contains(self, points: npt.ArrayLike, margin_m: float = 0.0) -> npt.NDArray[np.bool_]:
        """Whether world points (n, 2) lie inside, grown by the margin."""
        s, y = self.to_room(points).T
        half = self.width_m / 2 + margin_m
        return np.asarray((s > -margin_m) & (s < self.length_m + margin_m) & (np.abs(y) < half))


@dataclass(frozen=True, slots=True, eq=False)
class Wall:
    """A straight wall from start to end (2,), with the room's inside in direction ``inward`` (2,).

    ``room`` is the room's number; ``side`` is ``left``, ``right``, ``near`` (start of the room) or ``far``.
    ``s0_m`` is the position of ``start`` along the room for the left and right sides.
    """

    start: FloatArray
    end: FloatArray
    inward: FloatArray
    room: int
    side: str
    s0_m: float

    @property
    def length_m(self) -> float:
        """Length of the wall."""
        return float(np.linalg.norm(self.end - self.start))


def _inside_interval(room: Room, start: FloatArray, end: FloatArray) -> tuple[float, float] | None:
    """Fractions of a segment between which it runs strictly inside a room."""
    (s0, y0), (s1, y1) = room.to_room([start, end])
    low, high = 0.0, 1.0
    tolerance = 1e-6  # a wall that only touches the edge is kept
    half = room.width_m / 2 - tolerance
    for value, change, floor, roof in (
        (s0, s1 - s0, tolerance, room.length_m - tolerance),
        (y0, y1 - y0, -half, half),
    ):
        if abs(change) < 1e-12:
            if not floor < value < roof:
                return None
            continue
        a, b = sorted(((floor - value) / change, (roof - value) / change))
        low, high = max(low, a), min(high, b)
    return (low, high) if high - low > 1e-9 else None


def outline(rooms: list[Room], shortest_m: float = 0.02) -> list[Wall]:
    """Walls of the union of the rooms: each room's sides without the pieces inside another room."""
    walls: list[Wall] = []
    for number, room in enumerate(rooms):
        half, length = room.width_m / 2, room.length_m
        sides = (
            ("left", (0.0, -half), (length, -half), room.right),
            ("right", (0.0, half), (length, half), -room.right),
            ("near", (0.0, -half), (0.0, half), room.direction),
            ("far", (length, -half), (length, half), -room.direction),
        )
        for side, a, b, inward in sides:
            start, end = room.to_world(*a), room.to_world(*b)
            gaps = [
                gap
                for other, rival in enumerate(rooms)
                if other != number and (gap := _inside_interval(rival, start, end)) is not None
            ]
            position = 0.0
            for low, high in [*sorted(gaps), (1.0, 1.0)]:
                if (low - position) * np.linalg.norm(end - start) > shortest_m:
                    first, last = start + position * (end - start), start + low * (end - start)
                    s0 = position * length if side in ("left", "right") else 0.0
                    walls.append(Wall(first, last, inward, number, side, s0))
                position = max(position, high)
    return walls


@dataclass(frozen=True, slots=True)
class Meeting:
    """A junction of corridor ``child`` with corridor ``parent`` (room numbers): positions along both, and the angle.

    ``angle_rad`` is the child's direction from the parent's, positive right.
    """

    parent: int
    child: int
    parent_s_m: float
    child_s_m: float
    angle_rad: float


HALL_DEPTH_M = 8.0
OVERLAP_M = 0.01  # of adjoining rooms, so that there is no wall between them


def floor_plan(config: SceneConfig) -> tuple[list[Room], list[Meeting]]:
    """Rooms of a scene (corridors in the order of their numbers, hall, second part) and the junctions."""
    step = config.width_step
    first_m = config.length_m if step is None else step.at_m
    rooms = [Room(0.0, 0.0, 0.0, first_m, config.width_m, slope_rad=config.slope_rad)]
    begins, meetings = [0.0], []
    for child, junction in enumerate(config.junctions, start=1):
        parent = junction.from_corridor - 1
        place = begins[parent] + junction.at_m
        yaw = rooms[parent].yaw_rad + junction.angle_rad
        back = junction.length_m if junction.crossing else 0.0
        x, y = rooms[parent].to_world(place, 0.0) - back * np.array([cos(yaw), sin(yaw)])
        rooms.append(Room(float(x), float(y), yaw, back + junction.length_m, junction.width_m))
        begins.append(back)
        meetings.append(Meeting(parent, child, place, back, junction.angle_rad))
    if config.open_hall_m is not None:
        start, end = config.open_hall_m
        side = 1.0 if config.open_hall_right else -1.0
        y = side * (config.width_m / 2 + HALL_DEPTH_M / 2 - OVERLAP_M)
        rooms.append(Room(start, y, 0.0, end - start, HALL_DEPTH_M, is_corridor=False))
    if step is not None:
        moved = {Sides.LEFT: -1.0, Sides.RIGHT: 1.0, Sides.BOTH: 0.0}[step.moves]
        y = moved * (step.width_m - config.width_m) / 2
        begin = step.at_m - OVERLAP_M
        rooms.append(
            Room(begin, y, 0.0, config.length_m - begin, step.width_m, part_of=0, slope_rad=config.slope_rad)
        )
    return rooms, meetings


def room_frame(room: Room) -> Frame:
    """Frame on the floor at a room's start, d to the right."""
    along, right = np.array([*room.direction, 0.0]), np.array([*room.right, 0.0])
    return Frame(np.array([room.x_m, room.y_m, 0.0]), along, right)


def part_at(rooms: Sequence[Room], number: int, s_m: float) -> Room:
    """Return the room of corridor ``number`` at a position: its first part, or its continuation."""
    first = rooms[number]
    parts = [room for room in rooms if room.part_of == number and s_m >= first.length_m]
    return parts[0] if parts else first


def corridor_length_m(rooms: Sequence[Room], number: int) -> float:
    """Length of a corridor with its continuation."""
    first = rooms[number]
    return max(
        [first.length_m]
        + [float(first.to_room(r.to_world(r.length_m, 0.0))[0, 0]) for r in rooms if r.part_of == number]
    )


def in_junction(
    rooms: list[Room], meetings: list[Meeting], room: int, s_m: npt.NDArray[np.float64]
) -> npt.NDArray[np.bool_]:
    """Whether positions s (n,) along a corridor are in the opening of another one."""
    inside = np.zeros(np.shape(s_m), bool)
    for meeting in meetings:
        if room == meeting.parent:
            other, place = rooms[meeting.child], meeting.parent_s_m
        elif room == meeting.child:
            other, place = rooms[meeting.parent], meeting.child_s_m
        else:
            continue
        sine, cosine = abs(sin(meeting.angle_rad)), abs(cos(meeting.angle_rad))
        reach = (other.width_m + rooms[room].width_m * cosine) / (2 * sine)
        inside |= np.abs(s_m - place) < reach
    return inside
