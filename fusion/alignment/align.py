"""`align_flight`: the steps of an alignment, from a flight to its corrected camera."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from math import inf, nan, radians

import numpy as np

from fusion.alignment.clock import find_clock
from fusion.alignment.mount import mount_rotation
from fusion.alignment.result import Alignment, Quantity
from fusion.alignment.search import Found, search
from fusion.alignment.sentences import (
    Known,
    clock_quantity,
    focal_quantity,
    mount_quantities,
    rate_quantity,
)
from fusion.alignment.skew import SkewedClock, find_skewed_clock
from fusion.alignment.track import fit_track
from fusion.alignment.turning import Turning, seconds, turning_of
from fusion.alignment.views import MAX_FRAMES, Sightings, Views, choose_frames, collect, scaled_focal
from fusion.estimator.tilt import LEVEL_STD_RAD
from fusion.flight import Flight, FloatArray, TimeArray
from fusion.logs.samples import at_rate
from fusion.progress import Progress
from vision.cameras.camera import Camera
from vision.errors import InputError

MAX_OFFSET_S = 3.0
ATTITUDE_STD_RAD = radians(0.5)
UNKNOWN_SCALES = (1.0, 0.6, 1.6, 0.4)  # of an ordinary camera's focal length, likely ones first


def align_flight(
    flight: Flight,
    *,
    camera_known: bool = True,
    max_offset_s: float = MAX_OFFSET_S,
    max_frames: int = MAX_FRAMES,
    progress: Progress = lambda done, total: None,
) -> Alignment:
    """Find time offset, focal length and mounting of a flight's camera from the flight itself.

    Parameters
    ----------
    flight
        With a gyroscope or an attitude stream. In a long flight, the stretches with most turning are used.
    camera_known
        Whether the flight's camera is calibrated. Otherwise only its picture size is used, with no distortion and the
        principal point in the middle, and the focal length is estimated.
    max_offset_s
        Largest offset of the clocks.
    max_frames
        Largest number of frames to measure.
    progress
        Called with (done, total) frames.

    Raises
    ------
    InputError
        If the flight has no readable frames, or no inertial stream.
    """
    if not 0.0 < max_offset_s <= 60.0:
        raise InputError(f"max_offset_s = {max_offset_s:g}", remedy="give seconds, up to 60")
    if not len(flight.frames.t_ns):
        raise InputError(f"flight {flight.name} has no camera frames", remedy="align a flight with pictures")
    origin_ns = int(flight.frames.t_ns[0])
    turning = turning_of(flight, origin_ns, ATTITUDE_STD_RAD)
    chosen = choose_frames(seconds(flight.frames.t_ns, origin_ns), turning, max_frames)
    camera = flight.camera if camera_known else ordinary_camera(flight.camera)
    views = collect(flight, camera, chosen, origin_ns, progress)
    if not views.lines:
        raise InputError(f"none of {len(chosen)} frames can be read", remedy="check the pictures")
    found = search(views, turning, max_offset_s, (1.0,) if camera_known else UNKNOWN_SCALES)
    focal = focal_quantity(found, turning, camera, camera_known)
    if not camera_known and not focal.usable:
        focal = _focal_of_pictures(views)
    yaw, pitch, roll = _mounting(flight, found, turning, origin_ns, camera_known)
    return Alignment(
        clock_offset=clock_quantity(found, turning, max_offset_s),
        clock_rate=rate_quantity(found, turning),
        focal_scale=focal,
        mount_yaw=yaw,
        mount_pitch=pitch,
        mount_roll=roll,
        camera=_corrected(camera, camera_known, focal, yaw, pitch, roll),
        camera_known=camera_known,
        n_frames=len(views.lines),
        n_used=found.search.fit.n_frames if found.search.fit is not None else 0,
        notes=tuple(_notes_on_frames(views.n_unreadable, len(chosen), len(flight.frames.t_ns))),
        turns_opposite=found.search.reversed,
    )


def _mounting(
    flight: Flight, found: Found, turning: Turning, origin_ns: int, camera_known: bool
) -> tuple[Quantity, Quantity, Quantity]:
    """Mounting yaw, pitch and roll; yaw from the vehicle's track, if the flight has one."""
    tilt_known = turning.level_std_rad < LEVEL_STD_RAD
    track = None
    if found.clock is not None and found.sightings is not None:
        track = fit_track(flight, found.sightings, turning, found.clock, origin_ns, found.turned_yaw_rad)
    return mount_quantities(found.mount, track, tilt_known, Known.of(flight, camera_known))


def _notes_on_frames(n_unreadable: int, n_chosen: int, n_all: int) -> Iterator[str]:
    """Report which of the flight's frames the alignment could not use or did not measure."""
    if n_unreadable:
        yield f"{n_unreadable} of {n_chosen} frames cannot be read."
    if n_chosen < n_all:
        yield f"{n_chosen} of {n_all} frames were used, from where the vehicle turns most."


def clock_of_frames(
    flight: Flight,
    t_ns: TimeArray,
    heading_rad: FloatArray,
    heading_std_rad: FloatArray,
    max_offset_s: float = MAX_OFFSET_S,
) -> Quantity:
    """Find the time offset from existing headings, such as those of ``frames.csv``, without reading pictures.

    As good as `align_flight` if the offset is small. A large offset gives the headings a wrong attitude and may go
    undetected here.

    Parameters
    ----------
    flight, t_ns, heading_rad, heading_std_rad, max_offset_s
        As `turns_of_frames`.

    Raises
    ------
    InputError
        If the flight has no inertial stream or no frames.
    """
    turning, sightings = _turns(flight, t_ns, heading_rad, heading_std_rad)
    return clock_quantity(Found(find_clock(sightings, turning, max_offset_s), 1.0), turning, max_offset_s)


def turns_of_frames(
    flight: Flight,
    t_ns: TimeArray,
    heading_rad: FloatArray,
    heading_std_rad: FloatArray,
    max_offset_s: float = MAX_OFFSET_S,
) -> SkewedClock:
    """Compare the turns of existing headings with those of the inertial sensors: offset and skew.

    Parameters
    ----------
    flight
        With a gyroscope or an attitude stream.
    t_ns, heading_rad, heading_std_rad
        Of the frames (n,); NaN if nothing was measured.
    max_offset_s
        Largest offset of the clocks.

    Raises
    ------
    InputError
        If the flight has no inertial stream or no frames.
    """
    turning, sightings = _turns(flight, t_ns, heading_rad, heading_std_rad)
    return find_skewed_clock(sightings, turning, max_offset_s, thorough=False)


def _turns(
    flight: Flight, t_ns: TimeArray, heading_rad: FloatArray, heading_std_rad: FloatArray
) -> tuple[Turning, Sightings]:
    """Yaw by the inertial sensors, and the frames to compare with it; times are relative to the first frame."""
    if not len(t_ns):
        raise InputError(f"flight {flight.name} has no camera frames", remedy="align a flight with pictures")
    origin_ns = int(t_ns[0])
    turning = turning_of(flight, origin_ns, ATTITUDE_STD_RAD)
    t_s = seconds(t_ns, origin_ns)
    chosen = choose_frames(t_s, turning)
    return turning, Sightings.of_headings(t_s[chosen], heading_rad[chosen], heading_std_rad[chosen])


def apply_alignment(flight: Flight, alignment: Alignment) -> Flight:
    """Return the flight with its alignment's corrections, as if read with the new manifest."""
    frames = flight.frames
    if alignment.clock_rate.changes:
        frames = replace(frames, t_ns=at_rate(frames.t_ns, alignment.clock_rate.value))
    if alignment.clock_offset.changes:
        frames = replace(frames, t_ns=frames.t_ns + round(alignment.clock_offset.value * 1e9))
    return replace(flight, frames=frames, camera=alignment.camera)


def ordinary_camera(camera: Camera) -> Camera:
    """Return the camera to start from if only the size of its pictures is known."""
    from vision.axis.field_of_view import ordinary_field_of_view

    view = ordinary_field_of_view(camera.width_px, camera.height_px)
    return Camera.from_fov(camera.width_px, camera.height_px, view.horizontal_rad)


def _focal_of_pictures(views: Views) -> Quantity:
    """Estimate the focal length from right angles in the pictures, if the turns do not determine it."""
    from vision.axis.field_of_view import MAX_TRIED, field_of_view_of_lines

    step = max(1, len(views.lines) // MAX_TRIED)
    view = field_of_view_of_lines(views.lines[::step], views.camera)
    found = Camera.from_fov(views.camera.width_px, views.camera.height_px, view.horizontal_rad)
    scale = found.fx_px / views.camera.fx_px
    # d(f)/f = -d(fov) / sin(fov)
    sigma = scale * view.std_rad / float(np.sin(view.horizontal_rad))
    if not view.measured:
        sentence = "Neither turns nor pictures give the focal length: that of an ordinary camera is assumed."
        return Quantity("focal_scale", nan, inf, False, sentence, 1.0)
    sentence = f"From the right angles in {view.n_used} pictures, as the vehicle turns too little."
    return Quantity("focal_scale", scale, sigma, True, sentence, 1.0)


def _corrected(
    camera: Camera, known: bool, focal: Quantity, yaw: Quantity, pitch: Quantity, roll: Quantity
) -> Camera:
    """Apply quantities that are usable and significant; without a calibration, any focal length found."""
    if focal.changes or (focal.usable and not known):
        camera = scaled_focal(camera, focal.value)
    angle_rad = np.array([q.value if q.changes else 0.0 for q in (roll, pitch, yaw)])
    return replace(camera, R_body_camera=mount_rotation(angle_rad) @ camera.R_body_camera)
