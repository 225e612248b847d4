"""Field of view of an uncalibrated camera, from pictures of corridors.

The directions to the vanishing points of corridor lines, transverse lines and door posts are orthogonal only at the
right focal length (`vision.axis.right_angles`), so each picture i gives a log-likelihood L_i of the focal length.
With the prior p of ordinary cameras and the share o of pictures with false right angles, the posterior of the field
of view is ``p prod_i ((1 - o) exp(L_i / T) / norm_i + o)``; the temperature T >= 1 grows if the pictures disagree.
There is no estimate where it is too wide or reaches the ends of the range.

Assumed throughout: square pixels, no distortion beyond the bend of `vision.lines.straightness`, and the optical axis
at the picture's centre to about one percent of its width.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import chain, islice, pairwise
from math import atan, exp, hypot, inf, radians, sin, sqrt, tan
from typing import Any

import numpy as np
import numpy.typing as npt

from vision.axis.level import level_from_verticals
from vision.axis.right_angles import CENTRE_STD_OF_SIDE, N_SLACK, RightAngles, fit_right_angles, slack_std
from vision.axis.vanishing_point import axis_direction, fit_axis
from vision.cameras.camera import Camera
from vision.errors import InputError
from vision.images import to_grey
from vision.lines.line_set import LineSet
from vision.lines.segments import extract_lines
from vision.lines.straightness import (
    MAX_PICTURES as MAX_BEND_PICTURES,
)
from vision.lines.straightness import NO_BEND, Bend, camera_of_bend, estimate_bend, straightening_camera
from vision.measurement import Attitude
from vision.types import FloatArray

PRIOR_RAD, PRIOR_STD_RAD = radians(65.0), radians(20.0)  # of ordinary cameras, along the longer side
RANGE_RAD = (radians(30.0), radians(120.0))
MAX_PICTURES = 30
MAX_TRIED = 60
MIN_LINES = 6
MIN_SCORE = 15.0  # log-likelihood ratio against stray lines; up to 300 stray lines reach 6
MIN_EVIDENCE = 2.0  # log-likelihood of a picture's best field of view over its median one
MAX_STD_RAD = radians(10.0)
EDGE_RAD, EDGE_SHARE = radians(3.0), 0.1  # largest share of the probability so near to the range's ends
OUTLIER_SHARE = 0.1  # of pictures whose lines form false right angles
MEDIAN_CHI2 = 0.455  # of one degree of freedom
MIN_INFORMATIVE_BEND_RAD = 0.8  # with a larger bend, F alone gives the focal length f,
FOCAL_STD_OF_BEND = 0.15  # to this relative error: F / f is 1.15 for stereographic, 0.94 for equisolid lenses

NOMINAL_RAD = radians(65.0)
SEED_FIELDS_RAD = tuple(radians(fov) for fov in (38.0, 50.0, 65.0, 85.0))
SEED_ATTITUDE = Attitude(0.0, 0.0, std_rad=radians(12.0))
SEED_STD_RAD = radians(2.0)
NEIGHBOUR_STD_RAD = radians(0.5)
COARSE_STEP, FINE_STEP, FINE_REACH = 0.1, 0.025, 0.1  # of the focal length's logarithm
GRID_STEP_RAD = radians(0.05)
_GRID_RAD = np.arange(RANGE_RAD[0], RANGE_RAD[1] + 0.5 * GRID_STEP_RAD, GRID_STEP_RAD)
_GRID_U = np.log(np.tan(0.5 * _GRID_RAD))
_LOW_U, _HIGH_U = float(_GRID_U[0]), float(_GRID_U[-1])
_COARSE_U = tuple(float(u) for u in np.linspace(_LOW_U, _HIGH_U, 1 + round((_HIGH_U - _LOW_U) / COARSE_STEP)))


@dataclass(frozen=True, slots=True)
class FieldOfView:
    """Estimated field of view of a camera.

    Parameters
    ----------
    horizontal_rad, std_rad
        Field of view across the picture, and its standard deviation.
    measured
        Whether it was measured; otherwise it is the prior of ordinary cameras.
    n_used
        Number of pictures it was measured from.
    n_tried
        Number of pictures examined.
    bend
        The lens's bending of straight lines.
    """

    horizontal_rad: float
    std_rad: float
    measured: bool
    n_used: int = 0
    n_tried: int = 0
    bend: Bend = NO_BEND

    @property
    def focal_std_share(self) -> float:
        """Standard deviation of the focal length over the focal length."""
        return self.std_rad / sin(self.horizontal_rad)

    def camera(self, width_px: int, height_px: int) -> Camera:
        """Return a camera with this field of view and lens, mounted straight ahead."""
        if self.bend.rad == 0.0:
            return Camera.from_fov(width_px, height_px, self.horizontal_rad)
        radius_px = self.bend.radius_px(width_px, height_px)
        focal_px = radius_px * tan(0.5 * width_px / radius_px) / tan(0.5 * self.horizontal_rad)
        return camera_of_bend(width_px, height_px, focal_px, self.bend)


def ordinary_field_of_view(width_px: int, height_px: int) -> FieldOfView:
    """Return the prior of an unknown camera's field of view: 65 +- 20 degrees along the longer side."""
    return _horizontal_fov(FieldOfView(PRIOR_RAD, PRIOR_STD_RAD, measured=False), width_px, height_px)


def estimate_field_of_view(images: Iterable[npt.NDArray[Any]]) -> FieldOfView:
    """Estimate the horizontal field of view of a camera from its pictures of corridors.

    Parameters
    ----------
    images
        Pictures of one size, grey (h, w), BGR or BGRA, uint8 or uint16, at least one. They are read one by one until
        `MAX_PICTURES` were informative or `MAX_TRIED` were examined. The first few should be of different views: they
        alone determine the bend of the lens.

    Returns
    -------
    FieldOfView
        `ordinary_field_of_view`, with ``measured`` False, where the pictures carry no information: level cameras that
        look straight along the corridor, blank walls, pictures cropped off their centre.

    Raises
    ------
    InputError
        Where there is no picture, an array is not a picture, or their sizes differ.
    """
    rest = iter(images)
    first = [to_grey(image) for image in islice(rest, MAX_BEND_PICTURES)]
    if not first:
        raise InputError("there are no pictures to find the field of view from", remedy="give at least one")
    height_px, width_px = first[0].shape
    camera = straightening_camera(width_px, height_px, 0.0)
    for image in first:
        camera.require_size(image.shape[1], image.shape[0])
    bend = estimate_bend(first)
    camera = straightening_camera(width_px, height_px, bend.rad)
    lines = (extract_lines(image, camera, keep_picture=False) for image in chain(first, rest))
    found = field_of_view_of_lines(lines, camera)
    return found if bend.rad == 0.0 else _fov_of_bent_picture(found, bend, camera)


def _fov_of_bent_picture(straight: FieldOfView, bend: Bend, camera: Camera) -> FieldOfView:
    """Convert the field of view of the straightened pictures, as of a lens without distortion, to the original ones.

    Where it was not measured, a large bend gives it: strongly bending lenses are nearly equidistant.
    """
    width_px = camera.width_px
    focal_px, share = bend.radius_px(width_px, camera.height_px), FOCAL_STD_OF_BEND
    if straight.measured:
        share = hypot(straight.focal_std_share, bend.std_rad / bend.rad)
        focal_px = 0.5 * width_px / tan(0.5 * straight.horizontal_rad)
    elif bend.rad < MIN_INFORMATIVE_BEND_RAD:
        return replace(straight, bend=bend)
    radius_px = bend.radius_px(width_px, camera.height_px)
    horizontal_rad = 2.0 * atan(radius_px * tan(0.5 * width_px / radius_px) / focal_px)
    return replace(
        straight,
        horizontal_rad=horizontal_rad,
        std_rad=share * sin(horizontal_rad),
        measured=True,
        n_used=straight.n_used or min(straight.n_tried, MAX_BEND_PICTURES),
        bend=bend,
    )


def field_of_view_of_lines(line_sets: Iterable[LineSet], camera: Camera) -> FieldOfView:
    """Estimate the horizontal field of view from lines, as `estimate_field_of_view`.

    Parameters
    ----------
    line_sets
        Lines of each picture.
    camera
        Camera that they were extracted with: optical axis at the centre, any focal length. The field of view is that
        of its rectified picture, without distortion.
    """
    nominal = _nominal_camera(camera.width_px, camera.height_px)
    pictures: list[_PictureLikelihood] = []
    tried = 0
    for lines in line_sets:
        tried += 1
        if len(lines) >= MIN_LINES:
            picture = _PictureLikelihood(lines_of(lines, camera, nominal), nominal)
            if picture.is_informative:
                pictures.append(picture)
        if len(pictures) >= MAX_PICTURES or tried >= MAX_TRIED:
            break
    return _horizontal_fov(replace(_combine(pictures), n_tried=tried), camera.width_px, camera.height_px)


def _horizontal_fov(along_longer_side: FieldOfView, width_px: int, height_px: int) -> FieldOfView:
    """Convert a field of view along the picture's longer side to the horizontal one."""
    rad = along_longer_side.horizontal_rad
    horizontal_rad = 2.0 * atan(width_px / max(width_px, height_px) * tan(0.5 * rad))
    std_rad = along_longer_side.std_rad * sin(horizontal_rad) / sin(rad)
    return replace(along_longer_side, horizontal_rad=horizontal_rad, std_rad=std_rad)


def _camera_of_fov(width_px: int, height_px: int, fov_rad: float) -> Camera:
    """Return the camera of a field of view along the longer side."""
    horizontal = _horizontal_fov(FieldOfView(fov_rad, 0.0, measured=False), width_px, height_px)
    return Camera.from_fov(width_px, height_px, horizontal.horizontal_rad)


@lru_cache(maxsize=8)
def _nominal_camera(width_px: int, height_px: int) -> Camera:
    return _camera_of_fov(width_px, height_px, NOMINAL_RAD)


class _PictureLikelihood:
    """Log-likelihood of a picture's lines at the focal lengths tried so far.

    A focal length f is given by u, the logarithm of half the picture's longer side over f.
    """

    def __init__(self, lines: LineSet, camera: Camera) -> None:
        self._lines = lines.geometry()
        self._direction_std = sqrt(12.0) * lines.sigma_rad / lines.arc_rad
        self._slack_std = slack_std(
            CENTRE_STD_OF_SIDE * max(camera.width_px, camera.height_px) / camera.fx_px
        )
        self._fits: dict[float, RightAngles] = {}
        for down, axis in _seeds(lines, camera):
            for u in _COARSE_U:
                start = RightAngles(-inf, _rotation(down, axis, _focal_ratio(u)), np.zeros(N_SLACK))
                self._improve(u, start, SEED_STD_RAD)
        if self._fits:
            self._sweep(_COARSE_U)

    @property
    def is_informative(self) -> bool:
        """Whether the picture shows right angles, and its score depends on the focal length."""
        scores = [self._fits[u].score for u in _COARSE_U if u in self._fits]
        if not scores or max(scores) < MIN_SCORE:
            return False
        return max(scores) - float(np.median(scores)) >= MIN_EVIDENCE

    def refine(self, u: float) -> None:
        """Evaluate more focal lengths, in small steps about u."""
        steps = round(FINE_REACH / FINE_STEP)
        nodes = [u + k * FINE_STEP for k in range(-steps, steps + 1)]
        around = [node for node in self._fits if abs(node - u) < FINE_REACH + COARSE_STEP]
        self._sweep(sorted({*around, *(node for node in nodes if _LOW_U <= node <= _HIGH_U)}))

    def curve(self, u: FloatArray) -> FloatArray:
        """Interpolate the scores to focal lengths (n,)."""
        from scipy.interpolate import Akima1DInterpolator  # slow to import, and seldom needed

        nodes = sorted(self._fits)
        scores = [self._fits[node].score for node in nodes]
        return np.asarray(Akima1DInterpolator(nodes, scores, method="makima")(u), np.float64)

    def centre_slack(self, u: float) -> FloatArray:
        """Return the fitted shift (2,) of the optical axis at a focal length, over its standard deviation."""
        nodes = np.array(sorted(self._fits))
        shifts = np.array([self._fits[node].slack[3:] / self._slack_std[3:] for node in nodes])
        return np.array([np.interp(u, nodes, shifts[:, 0]), np.interp(u, nodes, shifts[:, 1])])

    def _sweep(self, nodes: Sequence[float]) -> None:
        """Repeat each fit from its neighbours' solutions, in both directions."""
        for there in (nodes, nodes[::-1]):
            for neighbour, u in pairwise(there):
                if neighbour in self._fits:
                    self._improve(u, self._fits[neighbour], NEIGHBOUR_STD_RAD)

    def _improve(self, u: float, start: RightAngles, start_std_rad: float) -> None:
        fit = fit_right_angles(
            self._lines, self._direction_std, _focal_ratio(u), self._slack_std, start, start_std_rad
        )
        if u not in self._fits or fit.score > self._fits[u].score:
            self._fits[u] = fit


def _focal_ratio(u: float) -> float:
    return tan(0.5 * NOMINAL_RAD) / exp(u)


def _seeds(lines: LineSet, camera: Camera) -> list[tuple[FloatArray, FloatArray]]:
    """Return nominal rays down and along the corridor, as measured with several assumed fields of view."""
    seeds = []
    for fov_rad in SEED_FIELDS_RAD:
        tried = _camera_of_fov(camera.width_px, camera.height_px, fov_rad)
        seen = lines_of(lines, camera, tried)
        std_rad = SEED_ATTITUDE.std_rad
        level = level_from_verticals(
            seen, SEED_ATTITUDE.R_level_body(), tried.R_body_camera, std_rad, std_rad
        )
        fit = fit_axis(seen, level.R_level_camera)
        if fit is not None:
            to_nominal = np.array([tried.fx_px / camera.fx_px, tried.fx_px / camera.fx_px, 1.0])
            down = level.R_level_camera[2] * to_nominal
            axis = axis_direction(fit.heading_rad, fit.elevation_rad) @ level.R_level_camera * to_nominal
            seeds.append((down, axis))
    return seeds


def _rotation(down: FloatArray, axis: FloatArray, focal_ratio: float) -> FloatArray:
    """Return the rotation (3, 3), columns along, across, down, nearest to two nominal rays at a focal length."""
    from_nominal = np.array([1.0 / focal_ratio, 1.0 / focal_ratio, 1.0])
    down, axis = down * from_nominal, axis * from_nominal
    down, axis = down / np.linalg.norm(down), axis / np.linalg.norm(axis)
    off = 0.5 * float(down @ axis)
    down, axis = down - off * axis, axis - off * down
    down /= np.linalg.norm(down)
    axis -= (axis @ down) * down
    axis /= np.linalg.norm(axis)
    return np.ascontiguousarray(np.column_stack([axis, np.cross(down, axis), down]))


def lines_of(lines: LineSet, camera: Camera, other: Camera) -> LineSet:
    """Return the same lines for another camera without distortion.

    Parameters
    ----------
    lines
        Lines extracted with ``camera``.
    camera, other
        Two assumptions about the same pictures; only focal length and principal point differ.
    """

    def rays(of: Camera) -> tuple[FloatArray, FloatArray]:
        focal, centre = np.array([of.fx_px, of.fy_px] * 2), np.array([of.cx_px, of.cy_px] * 2)
        ends = (lines.ends_px - centre) / focal
        one = np.ones((len(ends), 1))
        return np.hstack([ends[:, :2], one]), np.hstack([ends[:, 2:], one])

    def off_plane(normal: FloatArray, p0: FloatArray, p1: FloatArray, of: Camera) -> FloatArray:
        """Return the angle of a line's middle off its plane per pixel across the line."""
        depth = np.linalg.norm(0.5 * (p0 + p1), axis=1)
        return np.asarray(np.hypot(normal[:, 0], normal[:, 1]) / (depth * of.fx_px), np.float64)

    p0, p1 = rays(other)
    spanned = lines.with_ends(p0, p1)
    sigma_px = lines.sigma_rad / off_plane(lines.normal, *rays(camera), camera)
    return replace(spanned, sigma_rad=sigma_px * off_plane(spanned.normal, p0, p1, other))


def _combine(pictures: Sequence[_PictureLikelihood]) -> FieldOfView:
    """Combine the pictures' likelihoods of the field of view along the longer side; return the prior if too vague."""
    unknown = FieldOfView(PRIOR_RAD, PRIOR_STD_RAD, measured=False)
    if not pictures:
        return unknown
    mode = int(np.argmax(_posterior(pictures)))
    for picture in pictures:
        picture.refine(float(_GRID_U[mode]))
    probability = _posterior(pictures)
    mode = int(np.argmax(probability))
    # Where the pictures disagree by more than chance, flatten each one's likelihood.
    curves = [picture.curve(_GRID_U) for picture in pictures]
    disagreement = np.median([2.0 * (curve.max() - curve[mode]) for curve in curves]) / MEDIAN_CHI2
    probability = _posterior(pictures, max(1.0, float(disagreement)))
    mode = int(np.argmax(probability))
    cumulative = np.cumsum(probability)
    low, high = np.interp([0.16, 0.84], cumulative, _GRID_RAD)
    std_rad = hypot(0.5 * (high - low), _centre_std(pictures, mode))
    at_edge = np.abs(_GRID_RAD - np.array(RANGE_RAD)[:, None]).min(axis=0) < EDGE_RAD
    if std_rad > MAX_STD_RAD or probability[at_edge].sum() > EDGE_SHARE:
        return unknown
    return FieldOfView(float(_GRID_RAD[mode]), std_rad, measured=True, n_used=len(pictures))


def _posterior(pictures: Sequence[_PictureLikelihood], temperature: float = 1.0) -> FloatArray:
    """Return the posterior probability (n,) of each field of view of the grid."""
    prior = np.exp(-0.5 * ((_GRID_RAD - PRIOR_RAD) / PRIOR_STD_RAD) ** 2)
    prior /= prior.sum()
    log_posterior = np.log(prior)
    for picture in pictures:
        curve = picture.curve(_GRID_U) / temperature
        likelihood = np.exp(curve - curve.max())
        likelihood /= likelihood @ prior
        log_posterior += np.log((1.0 - OUTLIER_SHARE) * likelihood + OUTLIER_SHARE)
    posterior = np.exp(log_posterior - log_posterior.max())
    return np.asarray(posterior / posterior.sum(), np.float64)


def _centre_std(pictures: Sequence[_PictureLikelihood], mode: int) -> float:
    """Return the standard deviation due to the optical axis's position, an error common to all pictures.

    By the envelope theorem the derivative of a picture's score with respect to the prior position is its fitted
    slack, so the derivative of the slacks with respect to u gives the shift of the best focal length.
    """
    u = float(np.clip(_GRID_U[mode], _LOW_U + FINE_STEP, _HIGH_U - FINE_STEP))
    below, here, above = (
        sum(picture.curve(np.array([x]))[0] for picture in pictures)
        for x in (u - FINE_STEP, u, u + FINE_STEP)
    )
    curvature = (2.0 * here - below - above) / FINE_STEP**2
    if not curvature > 0.0:
        return PRIOR_STD_RAD
    mixed = sum(
        picture.centre_slack(u + FINE_STEP) - picture.centre_slack(u - FINE_STEP) for picture in pictures
    ) / (2.0 * FINE_STEP)
    shift = np.linalg.norm(mixed) / curvature * sqrt(1.0 - 1.0 / len(pictures))
    return float(shift * np.sin(_GRID_RAD[mode]))
