"""From lines to time offset, focal length and mount: measure, fit, correct, and measure again."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf, radians

import numpy as np
import numpy.typing as npt

from fusion.alignment.clock import ClockFit, ClockSearch, find_clock
from fusion.alignment.mount import YAW, MountFit, fit_mount, mount_angles, mount_rotation
from fusion.alignment.skew import at_skew, find_skewed_clock
from fusion.alignment.turning import Turning
from fusion.alignment.views import Sightings, Views

FloatArray = npt.NDArray[np.float64]

MAX_ROUNDS = 7
LAST = 4
SETTLED_RATIO, SETTLED_S = 0.003, 0.0005
KNOWN_STD_RAD = radians(1.5)
FAR_STD_RAD = radians(5.0)
LARGE_MOUNT_RAD = radians(1.0)
SCALE_RANGE = (0.25, 4.0)


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """Result of the search.

    Parameters
    ----------
    search
        The last search for the time offset.
    scale
        Factor on the focal length.
    unrest_s, unrest
        Last change of offset and factor if the search did not converge; 0 if it did.
    mount
        None if no frame has an attitude.
    sightings
        The last measurements, by a camera already rotated to the right by ``turned_yaw_rad``.
    skew, skew_std
        Of the clocks, see `fusion.alignment.skew`; the times of search and sightings are corrected by it.
    """

    search: ClockSearch
    scale: float
    mount: MountFit | None = None
    unrest_s: float = 0.0
    unrest: float = 0.0
    sightings: Sightings | None = None
    turned_yaw_rad: float = 0.0
    skew: float = 0.0
    skew_std: float = inf

    @property
    def clock(self) -> ClockFit | None:
        """The fit, if the flight determines the offset."""
        return self.search.fit if self.search.determined else None


def search(views: Views, turning: Turning, reach_s: float, start_scales: tuple[float, ...] = (1.0,)) -> Found:
    """Estimate time offset, focal length and mount.

    A frame is measured with the attitude at its time. A wrong offset gives a wrong attitude, so the first estimate
    uses none. Then offset, focal length and the axis's elevation are improved alternately. If the mount is far off,
    this is repeated with the corrected camera, because lines are then measured better.

    Parameters
    ----------
    views
        Lines of the frames.
    turning
        Yaw and tilt by the inertial sensors.
    reach_s
        Largest time offset considered.
    start_scales
        Start values of the factor on the focal length; one of them must be near the true one.
    """
    for scale in start_scales:
        sightings = views.with_focal_scale(scale).measure()
        clock = find_skewed_clock(sightings, turning, reach_s)
        first = clock.search
        if first.determined:
            break
    if not first.determined or first.fit is None:
        sightings = views.measure(turning, 0.0, 0.0, FAR_STD_RAD)
        return Found(first, 1.0, fit_mount(sightings, turning.level_std_rad))
    start = Found(first, float(np.clip(scale * first.fit.ratio, *SCALE_RANGE)))
    elevation_rad = _elevation(at_skew(sightings, clock.skew), turning, first.fit.offset_s)
    found = _improved(views.at_skew(clock.skew), turning, reach_s, start, elevation_rad)
    return replace(found, skew=clock.skew, skew_std=clock.skew_std)


def _improved(views: Views, turning: Turning, reach_s: float, start: Found, elevation_rad: float) -> Found:
    """Improve first estimates of offset, focal length and the axis's elevation."""
    found, sightings = _settle(views, turning, reach_s, start, elevation_rad)
    mount = fit_mount(sightings, turning.level_std_rad)
    if found.clock is None or mount is None or np.abs(mount.angle_rad).max() < LARGE_MOUNT_RAD:
        return replace(found, mount=mount, sightings=sightings)
    R_first = mount_rotation(mount.angle_rad)
    found, sightings = _settle(views.turned(R_first), turning, reach_s, found, 0.0)
    found = replace(found, sightings=sightings, turned_yaw_rad=float(mount.angle_rad[YAW]))
    rest = fit_mount(sightings, turning.level_std_rad)
    if rest is None:
        return replace(found, mount=mount)
    angle_rad = mount_angles(mount_rotation(rest.angle_rad) @ R_first)
    return replace(found, mount=replace(rest, angle_rad=angle_rad))


def _settle(
    views: Views, turning: Turning, reach_s: float, found: Found, elevation_rad: float
) -> tuple[Found, Sightings]:
    """Measure with attitude and a corrected focal length, and fit anew, until neither changes."""
    std_rad = FAR_STD_RAD
    passed: list[Found] = []
    while True:
        before = found
        assert before.search.fit is not None
        offset_s = before.search.fit.offset_s
        sightings = views.with_focal_scale(before.scale).measure(turning, offset_s, elevation_rad, std_rad)
        search = find_clock(sightings, turning, reach_s)
        if search.fit is None:
            return Found(search, before.scale), sightings
        found = Found(search, float(np.clip(before.scale * search.fit.ratio, *SCALE_RANGE)))
        settled = abs(search.fit.ratio - 1.0) < SETTLED_RATIO
        if settled and abs(search.fit.offset_s - offset_s) < SETTLED_S and passed:
            return found, sightings
        passed.append(found)
        if len(passed) == MAX_ROUNDS:
            # The set of accepted frames depends on the focal length; the remaining change adds to the uncertainty.
            offsets = [one.search.fit.offset_s for one in passed[-LAST:] if one.search.fit is not None]
            scales = [one.scale for one in passed[-LAST:]]
            return replace(found, unrest_s=float(np.std(offsets)), unrest=float(np.std(scales))), sightings
        elevation_rad, std_rad = _median(sightings.elevation_rad), KNOWN_STD_RAD


def _elevation(sightings: Sightings, turning: Turning, offset_s: float) -> float:
    """Elevation of the axis above level, from frames measured without attitude; includes the body's pitch."""
    down_x = [
        0.0 if attitude is None else attitude.pitch_rad
        for attitude in (turning.attitude_at(t) for t in (sightings.t_s + offset_s).tolist())
    ]
    return _median(sightings.elevation_rad + np.array(down_x))


def _median(values: FloatArray) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else 0.0
