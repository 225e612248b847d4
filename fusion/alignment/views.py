"""Lines of the chosen frames, extracted once and measured again for each attitude and focal length."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from math import hypot, nan, radians

import numpy as np
import numpy.typing as npt

from fusion.alignment.turning import Turning, seconds
from fusion.flight import Flight
from fusion.progress import Progress
from vision.axis.field_of_view import lines_of
from vision.axis.level import level_from_verticals
from vision.cameras.camera import Camera
from vision.cameras.projection import is_distorted
from vision.errors import InputError
from vision.frame import UNKNOWN_ATTITUDE, measure_lines
from vision.lines.line_set import LineSet
from vision.lines.segments import extract_lines
from vision.measurement import Attitude, Prior

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]
IntArray = npt.NDArray[np.int64]

MAX_RATE_HZ = 32.0  # frames at a higher rate are redundant
MAX_FRAMES = 1000
N_BLOCKS = 5  # measured stretches of a longer flight
RATE_HALF_WIDTH_S = 0.1
SEARCH_STD_RAD = radians(3.0)  # of the axis's elevation, before it is measured
STD_FLOOR_RAD = radians(0.05)
N_COLUMNS = 8  # of a frame's measurement
INFORMED = 0.5  # of the attitude's standard deviation: below it, verticals contributed


@dataclass(frozen=True, slots=True, eq=False)
class Sightings:
    """Measurements of n frames; NaN if a frame was not accepted or a value was not measured.

    Parameters
    ----------
    t_s
        Frame times (n,) as the camera stamped them.
    heading_rad, heading_std_rad
        Corridor heading in (-pi/2, pi/2).
    elevation_rad, elevation_std_rad
        Of the corridor's axis above the given attitude's level.
    roll_rad, roll_std_rad
        Roll of the level by the picture's vertical lines, relative to the attitude's.
    level_body
        Rotation (n, 3, 3) from the body to that attitude's level.
    offset_norm, offset_std
        Lateral offset in half widths of the corridor.
    """

    t_s: FloatArray
    heading_rad: FloatArray
    heading_std_rad: FloatArray
    elevation_rad: FloatArray
    elevation_std_rad: FloatArray
    roll_rad: FloatArray
    roll_std_rad: FloatArray
    level_body: FloatArray
    offset_norm: FloatArray
    offset_std: FloatArray

    @classmethod
    def of_headings(cls, t_s: FloatArray, heading_rad: FloatArray, heading_std_rad: FloatArray) -> Sightings:
        """Make sightings of headings alone."""
        none = np.full(len(t_s), nan)
        std = np.maximum(np.where(np.isfinite(heading_std_rad), heading_std_rad, radians(1.0)), STD_FLOOR_RAD)
        level = np.tile(np.eye(3), (len(t_s), 1, 1))
        return cls(t_s, np.asarray(heading_rad, float), std, none, none, none, none, level, none, none)

    @property
    def seen(self) -> BoolArray:
        """Frames (n,) with a heading."""
        return np.isfinite(self.heading_rad)


@dataclass(frozen=True, slots=True, eq=False)
class Views:
    """Lines of the frames chosen from a flight, found with ``camera``."""

    t_s: FloatArray
    lines: tuple[LineSet, ...]
    camera: Camera
    n_unreadable: int

    def with_focal_scale(self, scale: float) -> Views:
        """Return the same lines for a camera of another focal length."""
        camera = scaled_focal(self.camera, scale)
        move = _undistorted_anew if is_distorted(self.camera) else lines_of
        return replace(self, lines=tuple(move(one, self.camera, camera) for one in self.lines), camera=camera)

    def at_skew(self, skew: float) -> Views:
        """Return the same views with time stamps corrected by a skew of the clocks."""
        return replace(self, t_s=self.t_s * (1.0 + skew)) if skew else self

    def turned(self, R: FloatArray) -> Views:
        """Return the same views of a camera rotated on the body by a rotation (3, 3)."""
        return replace(self, camera=replace(self.camera, R_body_camera=R @ self.camera.R_body_camera))

    def measure(
        self,
        turning: Turning | None = None,
        offset_s: float = 0.0,
        elevation_rad: float = 0.0,
        elevation_std_rad: float = SEARCH_STD_RAD,
    ) -> Sightings:
        """Measure all frames.

        Parameters
        ----------
        turning
            Source of each frame's attitude; None: measure without attitude.
        offset_s
            Added to the frames' stamps to give the time of their attitude.
        elevation_rad, elevation_std_rad
            Prior of the axis's elevation above level.
        """
        n = len(self.t_s)
        table = np.full((n, N_COLUMNS), nan)
        level_body = np.tile(np.eye(3), (n, 1, 1))
        for k, (t, lines) in enumerate(zip((self.t_s + offset_s).tolist(), self.lines, strict=True)):
            attitude = UNKNOWN_ATTITUDE if turning is None else turning.attitude_at(t)
            if attitude is not None:
                prior = Prior(elevation_rad=elevation_rad, elevation_std_rad=elevation_std_rad)
                level_body[k] = attitude.R_level_body()
                table[k] = _measured(lines, self.camera, attitude, prior)
        psi, psi_std, elevation, elevation_std, roll, roll_std, offset, offset_std = table.T
        return Sightings(
            self.t_s, psi, psi_std, elevation, elevation_std, roll, roll_std, level_body, offset, offset_std
        )


def _measured(lines: LineSet, camera: Camera, attitude: Attitude, prior: Prior) -> tuple[float, ...]:
    """Return the row of `Sightings` of one frame."""
    found = measure_lines(lines, camera, attitude, prior)
    if not found.accepted:
        return (nan,) * N_COLUMNS
    std_rad = hypot(attitude.std_rad, prior.elevation_std_rad)
    R_before = attitude.R_level_body() @ camera.R_body_camera
    level = level_from_verticals(lines, attitude.R_level_body(), camera.R_body_camera, std_rad, std_rad)
    down = R_before @ level.R_level_camera[2]  # the picture's down, seen from the attitude's level
    roll, roll_std = nan, nan
    if level.roll_std_rad < INFORMED * std_rad:
        roll, roll_std = float(np.arctan2(down[1], down[2])), level.roll_std_rad
    return (
        found.heading_rad,
        max(found.heading_std_rad, STD_FLOOR_RAD),
        found.elevation_rad,
        max(found.elevation_std_rad, STD_FLOOR_RAD),
        roll,
        roll_std,
        found.lateral_offset_norm,
        found.lateral_offset_norm_std,
    )


def scaled_focal(camera: Camera, scale: float) -> Camera:
    """Return a camera with its focal lengths times ``scale``."""
    return replace(camera, fx_px=camera.fx_px * scale, fy_px=camera.fy_px * scale)


def _undistorted_anew(lines: LineSet, camera: Camera, other: Camera) -> LineSet:
    """Return lines as `lines_of` does, for a lens whose distortion changes with the focal length."""
    focal, centre = np.array([camera.fx_px, camera.fy_px]), np.array([camera.cx_px, camera.cy_px])
    points = (lines.ends_px.reshape(-1, 2) - centre) / focal
    rays = np.column_stack([points, np.ones(len(points))])
    moved = other.undistort(camera.project(rays)) * [other.fx_px, other.fy_px] + [other.cx_px, other.cy_px]
    ends = moved.reshape(-1, 4)
    good = np.isfinite(ends).all(axis=1)
    per_line = {
        one.name: getattr(lines, one.name)[good]
        for one in fields(lines)
        if one.name != "ends_px" and isinstance(getattr(lines, one.name), np.ndarray)
    }
    return lines_of(replace(lines, ends_px=ends[good], **per_line), other, other)


def collect(flight: Flight, camera: Camera, chosen: IntArray, origin_ns: int, progress: Progress) -> Views:
    """Read frames and find their lines; those that cannot be decoded are counted and left out.

    Parameters
    ----------
    flight, camera
        Source of the pictures, and the camera to find their lines with.
    chosen
        Numbers (n,) of the frames.
    origin_ns
        Time that counts as zero.
    progress
        Called with (done, total) frames.
    """
    lines, kept = [], []
    for done, index in enumerate(chosen.tolist(), start=1):
        try:
            lines.append(extract_lines(flight.frames.read(index), camera, keep_picture=False))
            kept.append(index)
        except InputError:
            pass
        progress(done, len(chosen))
    t_s = seconds(flight.frames.t_ns[np.array(kept, np.int64)], origin_ns)
    return Views(t_s, tuple(lines), camera, len(chosen) - len(kept))


def choose_frames(t_s: FloatArray, turning: Turning, max_frames: int = MAX_FRAMES) -> IntArray:
    """Choose the frames to measure: all of a short flight, the stretches with most turning of a long one."""
    keep = [0]
    times = t_s.tolist()
    for k, t in enumerate(times):
        if t - times[keep[-1]] >= 1.0 / MAX_RATE_HZ:
            keep.append(k)
    index = np.array(keep, np.int64)
    if len(index) <= max_frames:
        return index
    block = np.arange(len(index)) // max(max_frames // N_BLOCKS, 1)
    rate = np.nan_to_num(turning.rate_at(t_s[index], RATE_HALF_WIDTH_S))
    power = np.bincount(block, rate * rate)
    return index[np.isin(block, np.argsort(-power, kind="stable")[:N_BLOCKS])]
