"""How much a lens bends straight lines, from pictures of a building: what is straight there tells.

The lens is that of Devernay and Faugeras (Straight lines have to be straight, 2001), of one parameter: a point at
distance r from the optical axis in the picture lies at ``F tan(r / F)`` in one without distortion. A fisheye of
equidistant projection with focal length f has F = f; others have their own F, the less they bend the larger. The
parameter here is the **bend**, half the picture's diagonal over F, radians; 0 is a lens that does not bend lines.

Edge pixels are joined to components by their gradient, which is done in the picture as it is. Only how far the pixels
scatter about a straight line then depends on F: the likelihood of all components' scatter tells it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import hypot, nan, sqrt

import numpy as np

from vision.cameras.camera import Camera, Distortion
from vision.lines.segments import edge_components
from vision.types import FloatArray, GreyImage

MIN_PIXELS = 20  # of a component
MAX_PIXELS = 100  # longer ones count no more: a person's outline can be long, too
PIXELS_PER_INDEPENDENT = 20.0
SCATTER_PX = 0.25  # of edge pixels about a straight edge
MAX_BEND_RAD = 1.7  # twice the angle of the picture's corner for an equidistant lens: 195 degrees
COARSE_STEP, FINE_STEP = 0.2, 0.05
N_COARSE = 5  # pictures that the search starts with
MAX_PICTURES = 10
MIN_GAIN = 12.0  # log-likelihood over no bend
MIN_SIGMA = 4.0
MAX_FITTED = 1.48  # of the distance from the axis over F: towards a quarter turn the tangent has no bounds
NOMINAL_FOCAL_OF_DIAGONAL = 0.75


@dataclass(frozen=True, slots=True)
class Bend:
    """How much a lens bends straight lines.

    Parameters
    ----------
    rad, std_rad
        Half the picture's diagonal over F, and its standard deviation; 0 and NaN where pictures show no bend.
    """

    rad: float = 0.0
    std_rad: float = nan

    def radius_px(self, width_px: int, height_px: int) -> float:
        """Return F for pictures of a size, pixels; it must bend lines at all."""
        return 0.5 * hypot(width_px, height_px) / self.rad


NO_BEND = Bend()


def straightening_camera(width_px: int, height_px: int, bend_rad: float) -> Camera:
    """Return a camera that straightens lines: its rectified pixels are those of a lens without distortion.

    Its focal length is F, or a nominal one for no bend: only that straight lines become straight is meant.
    """
    centre = (0.5 * (width_px - 1), 0.5 * (height_px - 1))
    if bend_rad == 0.0:
        focal_px = NOMINAL_FOCAL_OF_DIAGONAL * hypot(width_px, height_px)
        return Camera(width_px, height_px, focal_px, focal_px, *centre)
    focal_px = Bend(bend_rad).radius_px(width_px, height_px)
    return Camera(width_px, height_px, focal_px, focal_px, *centre, Distortion.EQUIDISTANT, (0.0,) * 4)


def camera_of_bend(width_px: int, height_px: int, focal_px: float, bend: Bend) -> Camera:
    """Return a camera of a focal length whose lens bends lines.

    A ray at the angle a from the optical axis is seen at ``F atan(f tan(a) / F)``; the polynomial of `Camera`'s
    equidistant model is fitted to that as far as the picture's corners.
    """
    radius_px = bend.radius_px(width_px, height_px)
    seen = np.linspace(0.0, min(bend.rad, MAX_FITTED), 200)[1:]
    angle = np.arctan(np.tan(seen) * radius_px / focal_px)
    powers = angle[:, None] ** np.array([3, 5, 7, 9])
    k, *_ = np.linalg.lstsq(powers, seen * radius_px / focal_px - angle, rcond=None)
    centre = (0.5 * (width_px - 1), 0.5 * (height_px - 1))
    return Camera(width_px, height_px, focal_px, focal_px, *centre, Distortion.EQUIDISTANT, tuple(k.tolist()))


def _straightness(grey: GreyImage, camera: Camera) -> float:
    """Return the log-likelihood of how edge pixels scatter about straight lines."""
    sums = edge_components(grey, camera)
    sums = sums[sums["n"] >= MIN_PIXELS]
    n = sums["n"]
    x, y = sums["x"] / n, sums["y"] / n
    xx, xy, yy = sums["xx"] / n - x * x, sums["xy"] / n - x * y, sums["yy"] / n - y * y
    mean, half = 0.5 * (xx + yy), np.sqrt(0.25 * (xx - yy) ** 2 + xy * xy)
    # Rectified coordinates are stretched: over the length the scatter is not, and n is the length in the picture.
    share = np.sqrt(np.maximum(mean - half, 0.0) / (12.0 * (mean + half)))
    weight = np.minimum(n, MAX_PIXELS) / PIXELS_PER_INDEPENDENT
    return float(-0.5 * (weight * np.log1p((share * n / SCATTER_PX) ** 2)).sum())


def _scores(images: Sequence[GreyImage], bends: FloatArray) -> FloatArray:
    """Return the straightness (pictures, bends) of every picture."""
    height_px, width_px = images[0].shape
    scores = np.empty((len(images), len(bends)))
    for k, bend in enumerate(bends.tolist()):
        camera = straightening_camera(width_px, height_px, bend)
        scores[:, k] = [_straightness(image, camera) for image in images]
    return scores


def estimate_bend(images: Sequence[GreyImage]) -> Bend:
    """Find how much a lens bends straight lines from pictures of one camera.

    Parameters
    ----------
    images
        Grey pictures (h, w) of one size, at least one; the first `MAX_PICTURES` are used.

    Returns
    -------
    Bend
        Zero where the pictures do not show clearly that lines are bent.
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
    curvature = -float(np.array([1.0, -2.0, 1.0]) @ total[around]) / FINE_STEP**2
    slopes = (scores[:, best + 1] - scores[:, best - 1]) / (2.0 * FINE_STEP)
    if not curvature > 0.0:
        return NO_BEND
    bend_rad = float(fine[best] + np.clip(slopes.sum() / curvature, -FINE_STEP, FINE_STEP))
    # The pictures' own slopes at the common best tell by how much they disagree.
    own = slopes - slopes.mean()
    std_rad = sqrt(float(own @ own) * len(images) / max(len(images) - 1, 1) + curvature) / curvature
    return Bend(bend_rad, std_rad) if bend_rad > MIN_SIGMA * std_rad else Bend()
