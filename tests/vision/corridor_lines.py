"""A corridor made of lines, seen exactly: the ground truth of the geometry's tests, and the lines of a picture."""

from __future__ import annotations

import time
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from vision import Camera
from vision.lines.fitting import FITTED_LINE
from vision.lines.line_set import LineSet
from vision.lines.segments import POSITION_FLOOR_PX, _describe_lines, _line_set, _view
from vision.types import FloatArray


@dataclass(frozen=True)
class Corridor:
    """Width, heights and what runs along, across and up; x along the axis, y right, z down from the camera."""

    width_m: float = 2.2
    below_m: float = 1.4
    above_m: float = 1.3
    heading_rad: float = 0.0
    offset_norm: float = 0.0
    roll_rad: float = 0.0
    pitch_rad: float = 0.0
    noise_px: float = 0.0
    n_random: int = 0
    seed: int = 0
    along: bool = True
    posts: bool = True
    rails_m: tuple[float, ...] = field(default=(-0.7, 0.2))  # height (down) of rails on both walls
    walls: tuple[int, ...] = (-1, 1)  # left, right
    joints: tuple[float, ...] = ()  # lines along the floor, where between left and right wall (-1 to 1)
    left_rails_m: tuple[float, ...] = ()
    slope_rad: float = 0.0  # climbs ahead by so much; posts stay upright
    right_wall_turn_rad: float = 0.0  # away from the left wall, about the vertical at the camera
    bend_1_m: float = 0.0  # curvature, to the right

    def segments(self) -> FloatArray:
        """World segments (n, 6)."""
        left = -self.width_m / 2 * (1 + self.offset_norm)
        right = self.width_m / 2 * (1 - self.offset_norm)
        out: list[tuple[float, ...]] = []
        for joint in self.joints:
            y = 0.5 * (left + right) + 0.5 * self.width_m * joint
            out += [(x, y, self.below_m, x + 3.5, y, self.below_m) for x in (1.5, 4.0, 8.0)]
        for y in (left, right):
            if (-1 if y == left else 1) not in self.walls:
                continue
            if self.along:
                rails = self.rails_m + (self.left_rails_m if y == left else ())
                for z in (self.below_m, self.below_m - 0.1, -self.above_m, *rails):
                    # far to near on the right wall: the same side is bright on both
                    near, far = (0.0, 1.5) if y == left else (1.5, 0.0)
                    out += [(x + near, y, z, x + far, y, z) for x in (1.5, 4.0, 8.0)]
            if self.posts:
                out += [(x, y, -0.7, x, y, self.below_m) for x in (2.0, 2.9, 5.0, 5.9, 9.0)]
        segments = np.array(out).reshape(-1, 6)
        segments[:, [2, 5]] -= np.tan(self.slope_rad) * segments[:, [0, 3]]
        x, on_right = segments[:, [0, 3]], segments[:, [1, 4]] == right
        segments[:, [1, 4]] += np.tan(self.right_wall_turn_rad) * x * on_right + 0.5 * self.bend_1_m * x**2
        return segments

    def rotation(self) -> FloatArray:
        """Rotation body to corridor frame."""
        angles = [self.heading_rad, self.pitch_rad, self.roll_rad]
        return np.asarray(Rotation.from_euler("ZYX", angles).as_matrix())


def lines_between(px: FloatArray, camera: Camera) -> LineSet:
    """Lines between points (n, 4) of a picture, as if found in one; those up to 10 pixels long are left out."""
    rows = np.zeros(len(px), FITTED_LINE)
    rows["x0"], rows["y0"], rows["x1"], rows["y1"] = px.T
    rows["length"] = np.hypot(px[:, 2] - px[:, 0], px[:, 3] - px[:, 1])
    rows["rms"], rows["n_pixels"], rows["contrast"] = 0.2, np.maximum(rows["length"], 5.0), 100.0
    long = rows[rows["length"] > 10.0]
    found = _describe_lines(long, _view(camera, camera), POSITION_FLOOR_PX)
    return _line_set(found, camera, 20.0, time.perf_counter(), None)


def lines_seen(corridor: Corridor, camera: Camera) -> LineSet:
    """Lines that a camera sees of a corridor, without any picture."""
    rng = np.random.default_rng(corridor.seed)
    ends = corridor.segments().reshape(-1, 3) @ corridor.rotation() @ camera.R_body_camera
    depth = ends.reshape(-1, 2, 3)[:, :, 2]
    in_front = (depth > 0.2).all(axis=1)
    focal, centre = (camera.fx_px, camera.fy_px), (camera.cx_px, camera.cy_px)
    px = (ends[:, :2] / ends[:, 2:] * focal + centre).reshape(-1, 4)[in_front]
    size = np.array([camera.width_px, camera.height_px] * 2)
    px = px[((px > -0.2 * size) & (px < 1.2 * size)).all(axis=1)]
    random = rng.uniform(0, 1, (corridor.n_random, 4)) * size
    px = np.vstack([px, random]) + rng.normal(0.0, corridor.noise_px, (len(px) + len(random), 4))
    return lines_between(px, camera)
