"""Quantities of an alignment in words."""

from __future__ import annotations

from math import atan, degrees, hypot, inf, nan, radians
from typing import NamedTuple

import numpy as np

from fusion.alignment.clock import ClockSearch
from fusion.alignment.mount import PITCH, ROLL, YAW, MountFit
from fusion.alignment.result import SIGNIFICANT_SIGMA, Quantity
from fusion.alignment.search import Found
from fusion.alignment.track import TrackFit
from fusion.alignment.turning import Turning
from fusion.flight import Flight
from vision.cameras.camera import Camera

USABLE_FOCAL = 0.03
USABLE_SKEW = 0.005
USABLE_YAW_RAD = radians(1.5)
CONTRADICTION_SIGMA = 4.0
USABLE_TILT_RAD = radians(2.0)


def clock_quantity(found: Found, turning: Turning, reach_s: float) -> Quantity:
    """Time offset."""
    search, fit = found.search, found.search.fit
    name = "clock_offset_s"
    if found.clock is None or fit is None:
        return Quantity(name, nan, inf, False, _reason_not_determined(search, turning, reach_s))
    # The offset holds at the first frame; a skew changes it about the middle.
    by_skew_s = found.skew_std * float(np.mean(fit.samples.t_s)) if found.skew else 0.0
    sigma = hypot(fit.offset_std_s, found.unrest_s, by_skew_s)
    value, source = fit.offset_s, _source(turning)
    seen = f"{fit.n_frames} frames, turned by {degrees(fit.turned_rad):.0f} degrees rms"
    if abs(value) <= SIGNIFICANT_SIGMA * sigma:
        text = f"There is no time offset between camera and {source} ({seen})."
    else:
        way = "early" if value > 0 else "late"
        text = (
            f"The frames are stamped {1e3 * abs(value):.1f} ms too {way} relative to the {source} ({seen})."
        )
    return Quantity(name, value, sigma, True, text)


def rate_quantity(found: Found, turning: Turning) -> Quantity:
    """Rate of the frames' clock against that of the inertial sensors."""
    name, source = "clock_rate", _source(turning)
    if found.clock is None:
        return Quantity(
            name, nan, inf, False, "There are no turns to compare: equal clock rates are assumed.", 1.0
        )
    if not found.skew:
        is_usable = found.skew_std < USABLE_SKEW
        text = (
            f"The clocks of camera and {source} run at the same rate."
            if is_usable
            else "The flight is too short to tell: equal clock rates are assumed."
        )
        return Quantity(name, 1.0, found.skew_std, is_usable, text, 1.0)
    way = "slower" if found.skew > 0.0 else "faster"
    text = (
        f"The frames' clock runs {100.0 * abs(found.skew):.2f} % {way} than the {source}'s, which an offset alone "
        "does not correct."
    )
    return Quantity(name, 1.0 + found.skew, found.skew_std, True, text, 1.0)


def _source(turning: Turning) -> str:
    return "gyroscope" if turning.by_gyro else "attitude"


def _reason_not_determined(search: ClockSearch, turning: Turning, reach_s: float) -> str:
    source, fit = _source(turning), search.fit
    if search.reversed:
        return (
            f"Vision and the {source} show turns in opposite directions: the axes of the IMU, or the mounting of the "
            "camera, are not as assumed."
        )
    if fit is None and search.compared:
        return (
            f"The turns seen by vision and by the {source} have nothing in common: the vehicle hardly turns, the "
            "axes of the IMU are not as assumed (`corridor inspect` checks them), or one of the two is not of this "
            "flight."
        )
    if fit is None:
        return "Too few frames show the corridor to compare their turns with those of the inertial sensors."
    if search.at_edge:
        return f"No time offset within {reach_s:g} s explains the turns: the clocks are further apart."
    if search.rival_s is not None and fit.ratio > 8.0 * fit.ratio_std:
        return (
            f"{fit.offset_s:.2f} s and {search.rival_s:.2f} s explain the turns equally well: the motion repeats "
            "itself, or too few frames show the corridor."
        )
    return "The time offset cannot be estimated without turns: turn left and right by 10 degrees or more."


def focal_quantity(found: Found, turning: Turning, camera: Camera, camera_known: bool) -> Quantity:
    """Factor on the focal length of a known or assumed camera, from the ratio of turns."""
    name, fit = "focal_scale", found.search.fit
    if found.clock is None or fit is None:
        return Quantity(
            name, nan, inf, False, "There are no turns to compare: the focal length is left as it is.", 1.0
        )
    value, source = found.scale, _source(turning)
    sigma = hypot(value * fit.ratio_std / fit.ratio, found.unrest)
    if sigma > USABLE_FOCAL:
        text = f"The turns give the focal length only within {100.0 * sigma / value:.0f} %."
        return Quantity(name, value, sigma, False, text, 1.0)
    trust = f"this assumes a correct scale of the {source}"
    focal_px = camera.fx_px * value
    if not camera_known:
        across = degrees(2.0 * atan(0.5 * camera.width_px / focal_px))
        text = (
            f"From the turns, the focal length is {focal_px:.1f} +- {camera.fx_px * sigma:.1f} px, a field of "
            f"view of {across:.0f} degrees, for a lens without distortion; {trust}."
        )
    elif abs(value - 1.0) <= SIGNIFICANT_SIGMA * sigma:
        text = f"The focal length is correct: pictures and {source} show the same turns; {trust}."
    else:
        way = "long" if value > 1.0 else "short"
        text = (
            f"From the turns, the focal length should be {100.0 * abs(value - 1.0):.1f} % {way}er, {focal_px:.1f} px "
            f"instead of {camera.fx_px:.1f} px; {trust}."
        )
    return Quantity(name, value, sigma, True, text, 1.0)


class Known(NamedTuple):
    """Words for the references of the mounting: the source of level, and of the mounting assumed so far."""

    level: str
    mounted: str  # "calibrated" or "assumed"

    @classmethod
    def of(cls, flight: Flight, camera_known: bool) -> Known:
        """Return the words for a flight."""
        level = "gyroscope and accelerometer" if flight.attitude is None else "the flight's attitude"
        return cls(level, "calibrated" if camera_known and not flight.camera.mount_assumed else "assumed")


def mount_quantities(
    mount: MountFit | None, track: TrackFit | None, tilt_known: bool, known: Known
) -> tuple[Quantity, Quantity, Quantity]:
    """Yaw, pitch and roll of the mounting."""
    names = ("mount_yaw_rad", "mount_pitch_rad", "mount_roll_rad")
    if mount is None:
        text = "Too few frames show the corridor at a known attitude."
        yaw, pitch, roll = (Quantity(name, nan, inf, False, text) for name in names)
        return yaw if track is None else _yaw(names[0], None, track, known), pitch, roll
    return (
        _yaw(names[0], mount if tilt_known else None, track, known),
        _tilt(names[1], mount, PITCH, tilt_known, known),
        _tilt(names[2], mount, ROLL, tilt_known, known),
    )


def _yaw(name: str, mount: MountFit | None, track: TrackFit | None, known: Known) -> Quantity:
    """Yaw by tilting, by the track, or both, weighted by their variances."""
    ways: list[tuple[float, float, str]] = []
    tilted = 0.0
    if mount is not None:
        tilted = degrees(float(np.hypot(*mount.tilted_rad)))
        by = f"from rolling and pitching by {tilted:.1f} degrees rms, as seen in the pictures"
        ways.append((float(mount.angle_rad[YAW]), float(mount.std_rad[YAW]), by))
    if track is not None:
        by = f"from the lateral drift over {track.distance_m:.0f} m, compared with the velocity"
        ways.append((track.yaw_rad, track.std_rad, by))
    if not ways:
        text = "Cannot be separated from the vehicle's heading without attitude or velocity."
        return Quantity(name, nan, inf, False, text)
    values, sigmas = np.array([way[0] for way in ways]), np.array([way[1] for way in ways])
    sigma = float(1.0 / np.sqrt((1.0 / sigmas**2).sum()))
    value = float((values / sigmas**2).sum() * sigma**2)
    if len(ways) > 1 and abs(values[0] - values[1]) > CONTRADICTION_SIGMA * float(np.hypot(*sigmas)):
        first, second = (f"{degrees(v):.1f}" for v in values)
        text = f"Two estimates disagree: {first} degrees {ways[0][2]}, {second} degrees {ways[1][2]}."
        return Quantity(name, value, float(0.5 * abs(values[0] - values[1])), False, text)
    if sigma > USABLE_YAW_RAD:
        text = (
            "Cannot be separated from the vehicle's heading: this needs more rolling and pitching than "
            f"{tilted:.1f} degrees rms, or a velocity in the log, over some metres."
        )
        return Quantity(name, value, sigma, False, text)
    by = " and ".join(way[2] for way in ways)
    if abs(value) <= SIGNIFICANT_SIGMA * sigma:
        return Quantity(name, value, sigma, True, f"As {known.mounted}, {by}.")
    side = "right" if value > 0 else "left"
    text = f"The camera looks {degrees(abs(value)):.1f} degrees further {side} than {known.mounted}, {by}."
    return Quantity(name, value, sigma, True, text)


def _tilt(name: str, mount: MountFit, axis: int, tilt_known: bool, known: Known) -> Quantity:
    value, sigma = float(mount.angle_rad[axis]), float(mount.std_rad[axis])
    if not tilt_known:
        text = "The log does not show which way is down."
        return Quantity(name, value, inf, False, text)
    usable = sigma < USABLE_TILT_RAD
    against = f"relative to level by {known.level}, whose error is included in sigma"
    if abs(value) <= SIGNIFICANT_SIGMA * sigma:
        return Quantity(name, value, sigma, usable, f"As {known.mounted}, {against}.")
    ways = ("up", "down") if axis == PITCH else ("over to the right", "over to the left")
    way = ways[0] if value > 0 else ways[1]
    text = f"The camera {'looks' if axis == PITCH else 'leans'} {degrees(abs(value)):.1f} degrees {way}, {against}."
    return Quantity(name, value, sigma, usable, text)
