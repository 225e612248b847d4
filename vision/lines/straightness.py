"""How much a lens bends straight lines, from pictures of a building, where most edges are straight.

The lens model is the one-parameter model of Devernay and Faugeras ("Straight lines have to be straight", 2001): a
point at the distance r from the optical axis in the picture is at ``F tan(r / F)`` in a picture without distortion.
An equidistant fisheye with focal length f has F = f; lenses that bend less have a larger F. The parameter here is the
**bend**, half the picture's diagonal over F, radians; 0 for a lens that does not bend lines.

Edge pixels are connected to components by their gradient in the original picture, independent of F. Only their
scatter s about a straight line depends on F. The log-likelihood of F is, summed over components with the weight w
(number of independent pixels, limited),

    -1/2 sum w log(1 + (s / SCATTER_PX)^2),

which is robust to edges that are curved in reality. It is maximised by a coarse and a fine grid search. The bend is
zero unless the gain over no bend, and the bend over its standard deviation, are significant.

`check_distortion` finds out in the same way whether a calibration's distortion is wrong: whether the edges are
straighter if the rectified pixels are moved towards the optical axis or away from it, by a share that grows with the
square of their distance from it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import hypot, nan, sqrt

import numpy as np

from vision.cameras.camera import Camera, Distortion
from vision.lines.segments import edge_components
from vision.types import FloatArray, GreyImage

MIN_PIXELS = 20  # of a component
MAX_PIXELS = 100  # longer ones get no more weight: a person's outline can be long, too
PIXELS_PER_INDEPENDENT = 20.0
SCATTER_PX = 0.25  # of edge pixels about a straight edge
MAX_BEND_RAD = 1.7  # twice the angle of the picture's corner for an equidistant lens: 195 degrees
COARSE_STEP, FINE_STEP = 0.2, 0.05
N_COARSE = 5  # pictures in the coarse search
MAX_PICTURES = 10
MIN_GAIN = 12.0  # log-likelihood ratio against no bend
MIN_SIGMA = 4.0
MAX_FITTED = 1.48  # of r / F, below pi / 2, where the tangent diverges
NOMINAL_FOCAL_OF_DIAGONAL = 0.75
_SHARES = (0.03, 0.06, 0.1, 0.14, 0.2, 0.28, 0.36, 0.45, 0.6, 0.8, 1.1, 1.5, 2.0)
# Errors of a distortion to try. 0.8: a fisheye lens of 120 degrees that is taken for a pinhole
RADIAL_SHARES = (*(-share for share in _SHARES[7::-1]), 0.0, *_SHARES)
FIRST_SHARES = (-0.14, -0.03, 0.0, 0.03, 0.14, 0.45)  # the others only if one of these is better than zero
SHARE_STEP = 0.02
MIN_CHECK_GAIN = 20.0  # log-likelihood ratio; 55 correct calibrations of simulated lenses reach 0.3


@dataclass(frozen=True, slots=True)
class Bend:
    """How much a lens bends straight lines.

    Parameters
    ----------
    rad, std_rad
        Half the picture's diagonal over F, and its standard deviation; 0 and NaN where no bend was found.
    """

    rad: float = 0.0
    std_rad: float = nan

    def radius_px(self, width_px: int, height_px: int) -> float:
        """Return F for pictures of a size, pixels; the bend must not be zero."""
        return 0.5 * hypot(width_px, height_px) / self.rad


NO_BEND = Bend()


@dataclass(frozen=True, slots=True)
class DistortionError:
    """Error of a calibration's distortion.

    Parameters
    ----------
    corner_share, std
        By how much of its value the distance of the picture's corners from the optical axis, rectified, has to grow
        for straight edges to become straight, and its standard deviation. Positive: the lens has more barrel
        distortion than its calibration.
    """

    corner_share: float
    std: float


def straightening_camera(width_px: int, height_px: int, bend_rad: float) -> Camera:
    """Return a camera in whose rectified pixels straight lines are straight.

    Its focal length is F, or a nominal one without bend; it is no estimate of the real one.
    """
    centre = (0.5 * (width_px - 1), 0.5 * (height_px - 1))
    if bend_rad == 0.0:
        focal_px = NOMINAL_FOCAL_OF_DIAGONAL * hypot(width_px, height_px)
        return Camera(width_px, height_px, focal_px, focal_px, *centre)
    focal_px = Bend(bend_rad).radius_px(width_px, height_px)
    return Camera(width_px, height_px, focal_px, focal_px, *centre, Distortion.EQUIDISTANT, (0.0,) * 4)


def camera_of_bend(width_px: int, height_px: int, focal_px: float, bend: Bend) -> Camera:
    """Return a camera with a focal length f and a bend.

    A ray at the angle a from the optical axis is seen at ``F atan(f tan(a) / F)``; the polynomial of `Camera`'s
    equidistant model is fitted to that up to the picture's corners.
    """
    radius_px = bend.radius_px(width_px, height_px)
    seen = np.linspace(0.0, min(bend.rad, MAX_FITTED), 200)[1:]
    angle = np.arctan(np.tan(seen) * radius_px / focal_px)
    powers = angle[:, None] ** np.array([3, 5, 7, 9])
    k, *_ = np.linalg.lstsq(powers, seen * radius_px / focal_px - angle, rcond=None)
    centre = (0.5 * (width_px - 1), 0.5 * (height_px - 1))
    return Camera(width_px, height_px, focal_px, focal_px, *centre, Distortion.EQUIDISTANT, tuple(k.tolist()))


def _straightness(grey: GreyImage, camera: Camera, radial_share: float = 0.0) -> float:
    """Return the log-likelihood of the scatter of edge pixels about straight lines."""
    sums = edge_components(grey, camera, radial_share)
    sums = sums[sums["n"] >= MIN_PIXELS]
    n = sums["n"]
    x, y = sums["x"] / n, sums["y"] / n
    xx, xy, yy = sums["xx"] / n - x * x, sums["xy"] / n - x * y, sums["yy"] / n - y * y
    mean, half = 0.5 * (xx + yy), np.sqrt(0.25 * (xx - yy) ** 2 + xy * xy)
    # Rectification stretches lengths. Scatter over length is not affected, and n is the length in the picture.
    share = np.sqrt(np.maximum(mean - half, 0.0) / (12.0 * (mean + half)))
    weight = np.minimum(n, MAX_PIXELS) / PIXELS_PER_INDEPENDENT
    return float(-0.5 * (weight * np.log1p((share * n / SCATTER_PX) ** 2)).sum())


def _scores(images: Sequence[GreyImage], bends: FloatArray) -> FloatArray:
    """Return the log-likelihood (pictures, bends) of every bend by every picture."""
    height_px, width_px = images[0].shape
    scores = np.empty((len(images), len(bends)))
    for k, bend in enumerate(bends.tolist()):
        camera = straightening_camera(width_px, height_px, bend)
        scores[:, k] = [_straightness(image, camera) for image in images]
    return scores


def estimate_bend(images: Sequence[GreyImage]) -> Bend:
    """Estimate how much a lens bends straight lines, from pictures of one camera.

    Parameters
    ----------
    images
        Grey pictures (h, w) of one size, at least one; the first `MAX_PICTURES` are used.

    Returns
    -------
    Bend
        Zero where a bend is not significant.
    """
    images = images[:MAX_PICTURES]
    coarse = np.arange(0.0, MAX_BEND_RAD + 1e-9, COARSE_STEP)
    middle = coarse[_scores(images[:N_COARSE], coarse).sum(axis=0).argmax()]
    fine = np.arange(-4, 5) * FINE_STEP + middle
    fine = np.concatenate([[0.0], fine[(fine > 0.01) & (fine <= MAX_BEND_RAD)]])
    scores = _scores(images, fine)
    total = scores.sum(axis=0)
    best = int(total.argmax())
    if best == 0 or total[best] - total[0] < MIN_GAIN:
        return NO_BEND
    best = min(max(best, 2), len(fine) - 2)
    around = slice(best - 1, best + 2)
    found = _maximum(scores[:, around], FINE_STEP)
    if found is None:
        return NO_BEND
    bend_rad, std_rad = float(fine[best]) + found[0], found[1]
    return Bend(bend_rad, std_rad) if bend_rad > MIN_SIGMA * std_rad else Bend()


def _maximum(scores: FloatArray, step: float) -> tuple[float, float] | None:
    """Return the maximum of the pictures' summed scores (pictures, 3), from the middle one, and its deviation.

    None if the sum has no maximum. The scatter of the pictures' slopes at the common maximum is added to the
    curvature (sandwich estimate).
    """
    below, middle, above = scores.sum(axis=0)
    curvature = -float(below - 2.0 * middle + above) / step**2
    if not curvature > 0.0:
        return None
    slopes = (scores[:, 2] - scores[:, 0]) / (2.0 * step)
    own = slopes - slopes.mean()
    std = sqrt(float(own @ own) * len(scores) / max(len(scores) - 1, 1) + curvature) / curvature
    return float(np.clip(slopes.sum() / curvature, -step, step)), std


def check_distortion(images: Sequence[GreyImage], camera: Camera) -> DistortionError | None:
    """Check a calibration's distortion by whether straight edges are straight; None if no error is significant.

    Parameters
    ----------
    images
        Grey pictures (h, w) of the camera, at least one; the first `MAX_PICTURES` are used.
    camera
        Its calibration.

    Returns
    -------
    DistortionError or None
        None too if the edges would be straightest with an error larger than any in `RADIAL_SHARES`: they are curved
        in reality, as in a tunnel.
    """
    images = images[:MAX_PICTURES]

    def scores(shares: Iterable[float]) -> FloatArray:
        return np.array([[_straightness(image, camera, s) for image in images] for s in shares]).T

    first = scores(FIRST_SHARES)
    if first.sum(axis=0).argmax() == FIRST_SHARES.index(0.0):
        return None
    every = scores(RADIAL_SHARES)
    none, best = RADIAL_SHARES.index(0.0), int(every.sum(axis=0).argmax())
    gain = every[:, best] - every[:, none]
    if (
        gain.sum() < MIN_CHECK_GAIN
        or 2 * np.count_nonzero(gain > 0.0) < len(images)
        or best == len(RADIAL_SHARES) - 1
    ):
        return None
    share = RADIAL_SHARES[best]
    found = _maximum(scores((share - SHARE_STEP, share, share + SHARE_STEP)), SHARE_STEP)
    if found is None or abs(share + found[0]) < MIN_SIGMA * found[1]:
        return None
    return DistortionError(share + found[0], found[1])
