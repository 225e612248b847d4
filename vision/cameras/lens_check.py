"""Plausibility of a lens model's coefficients: mistaken models, polynomials that are not monotonic in the picture."""

from __future__ import annotations

from math import atan, degrees, hypot, radians

import numpy as np

from vision.cameras.camera import Camera, Distortion
from vision.errors import InputError

MAX_TANGENTIAL = 0.02  # p1 and p2 of real lenses are far smaller
WIDE_RAD = radians(90)  # horizontal field of view above which a lens may be a fisheye
_BORDER = 24  # points along each side of the picture


def lens_problem(camera: Camera) -> str | None:
    """Return one sentence if the distortion is implausible, else None."""
    inverted = _share_inverted(camera)
    if inverted < 1.0:
        return (
            f"the {camera.distortion} distortion turns back within the picture: {1.0 - inverted:.0%} of its border "
            "belongs to no ray (calibrate again, with views that reach the corners, or with the fisheye model)"
        )
    if _tangential(camera) > MAX_TANGENTIAL:
        return (
            f"the tangential distortion p1, p2 of {_tangential(camera):.3g} is far from that of any lens: are "
            f"these numbers of another model (known are radtan and equidistant), or of another order?"
        )
    return None


def refuse_fisheye_numbers(camera: Camera) -> None:
    """Reject four fisheye coefficients declared as radial-tangential.

    Some stereo cameras' drivers publish Kannala-Brandt coefficients as ``plumb_bob``; k3 and k4 are then in the place
    of p1 and p2. Eight coefficients cannot be a fisheye's and are always accepted.

    Raises
    ------
    InputError
        Where the field of view is wide and the coefficients are implausible for the declared model.
    """
    coefficients = camera.coefficients
    if camera.distortion is not Distortion.RADTAN or len(coefficients) > 5 or any(coefficients[4:]):
        return
    view_rad = 2.0 * atan(0.5 * camera.width_px / camera.fx_px)
    if view_rad <= WIDE_RAD or _tangential(camera) <= MAX_TANGENTIAL:
        return
    k = ", ".join(f"{c:g}" for c in coefficients[:4])
    raise InputError(
        f"distortion plumb_bob with p1 = {coefficients[2]:g}, p2 = {coefficients[3]:g} and a view of "
        f"{degrees(view_rad):.0f} degrees cannot be a lens's: these look like k1 to k4 of a fisheye",
        remedy=f"give a camera file with `distortion_model: equidistant` and these coefficients [{k}]; if they are "
        "plumb_bob's, give all eight, k3 to k6 zero",
    )


def _tangential(camera: Camera) -> float:
    is_radtan = camera.distortion is Distortion.RADTAN and len(camera.coefficients) >= 4
    return hypot(*camera.coefficients[2:4]) if is_radtan else 0.0


def _share_inverted(camera: Camera) -> float:
    """Return the share of the picture's border whose pixels have a ray."""
    along = np.linspace(0.0, 1.0, _BORDER)
    x, y = along * (camera.width_px - 1), along * (camera.height_px - 1)
    right, bottom = np.full(_BORDER, x[-1]), np.full(_BORDER, y[-1])
    zeros = np.zeros(_BORDER)
    border = np.concatenate(
        [np.stack(side, axis=1) for side in ((x, zeros), (x, bottom), (zeros, y), (right, y))]
    )
    return float(np.mean(np.isfinite(camera.rays(border)).all(axis=1)))
