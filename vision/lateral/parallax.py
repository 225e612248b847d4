r"""Lateral offset and lateral displacement from the motion parallax of both walls between two pictures.

A wall point at the distance w beside the camera and z ahead is seen at the angle b off the corridor's axis with
``cot b = u = z / w``. After the camera has moved forward by f, and sideways towards that wall by d, it is seen at

    u' = k u - a,    k = w / (w - d),    a = f / (w - d),

at any height, on nearly the same ray about the axis. So the brightness along these rays, sampled uniformly in u, is
scaled by k and shifted by a. With distances in half widths and the camera at y from the centre line in the later
picture, the right wall is at ``w - d = 1 - y`` and the left wall at ``1 + y``, so

    a_right = f / (1 - y),    k_right = 1 + d / (1 - y),
    a_left  = f / (1 + y),    k_left  = 1 - d / (1 + y),

and y follows from the ratio of the shifts, d from the scales; f need not be known. Corners need not be visible: any
texture carries information. Lines along the corridor, which may be mistaken for corners, are constant in u and have
no effect here.

The log-likelihood of k and a for one wall is that of Gaussian residuals of unknown variance, relative to unrelated
profiles::

    L = max(0, -n / 2 log(mean squared difference / variance of the brightness))

with n the number of independent samples; both variances have a noise floor. The likelihood of y and d is the sum over
f, and that of y the sum over d as well.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, log, nan, sqrt
from typing import Any

import numpy as np
import numpy.typing as npt

from vision.cameras.camera import Camera
from vision.cameras.projection import project_directions
from vision.compiled import compiled, compiled_inner
from vision.images import GreyImage
from vision.lateral.mixture import MAX_PEAKS, MIN_STD, OffsetMixture, peaks_of_density
from vision.lateral.polar import Pyramid, sample_points
from vision.types import FloatArray

Profiles = npt.NDArray[np.float32]

N_BANDS, RAYS_PER_BAND = 4, 6
MAX_SLOPE = 0.5  # of a ray: height over distance to the wall
FIRST_COTANGENT, COTANGENT_STEP, N_ALONG = 0.8, 0.05, 65
PROFILES_SHAPE = (2, N_ALONG, N_BANDS)
MAX_RELATIVE = 256.0  # of brightness to its mean
SMOOTH_SAMPLES = 25  # half the window whose mean is subtracted, to remove slow changes of illumination
PIVOT = 2.0  # cotangent at which the search defines shifts: there they hardly depend on the scale
SHIFTS: FloatArray = np.arange(-0.2, 1.425, 0.05)
SCALES: FloatArray = np.arange(-0.28, 0.3, 0.04)  # k - 1
FORWARD_NORM: FloatArray = np.arange(-0.1, 1.025, 0.05)
DISPLACEMENT_NORM: FloatArray = np.arange(-0.21, 0.215, 0.014)
N_OFFSETS = 24
OFFSETS: FloatArray = np.linspace(-1.0 + 1.0 / N_OFFSETS, 1.0 - 1.0 / N_OFFSETS, N_OFFSETS)
INDEPENDENT = 0.05  # share of the samples
NOISE_FLOOR = 1e-4  # mean square, relative to a mean brightness of 1
MIN_OVERLAP = 60  # samples
MIN_DISPLACEMENT_STD, MAX_DISPLACEMENT_STD = 0.006, 0.05  # half widths; with a larger one it is not measured
MIN_OFFSET_STD = 0.04  # half widths: the grid's spacing is 0.083, and the axis has errors
NEGLIGIBLE = 12.0  # log-likelihood below the best

_RIGHT_LEFT = (1.0, -1.0)
_SLOPES: npt.NDArray[Any] = np.linspace(-MAX_SLOPE, MAX_SLOPE, N_BANDS * RAYS_PER_BAND + 1)
_COTANGENTS: npt.NDArray[Any] = FIRST_COTANGENT + COTANGENT_STEP * np.arange(N_ALONG)
# Directions (2 N_ALONG, rays, 3), right wall first; one extra ray, as `sample_points` looks at the next column
DIRECTIONS: npt.NDArray[Any] = np.concatenate(
    [
        np.stack(
            np.broadcast_arrays(_COTANGENTS[:, None], np.full((N_ALONG, 1), side), _SLOPES[None]), axis=-1
        )
        for side in _RIGHT_LEFT
    ]
)


@dataclass(frozen=True, slots=True, eq=False)
class Parallax:
    """Offset and displacement from two pictures.

    Parameters
    ----------
    offset
        Likelihood of the offset at the later picture.
    displacement_norm, displacement_per_offset, displacement_std_norm
        Lateral displacement between them, half widths, positive right. Given the offset y it is Gaussian with mean
        ``displacement_norm + displacement_per_offset y`` and this standard deviation; NaN where it was not measured.
    """

    offset: OffsetMixture
    displacement_norm: float
    displacement_per_offset: float
    displacement_std_norm: float


@compiled
def _banded(samples: Profiles) -> Profiles:
    """Average rays (2, 2 N_ALONG, rays) into bands (2, N_ALONG, N_BANDS), and subtract the moving average."""
    out = np.full((2, N_ALONG, N_BANDS), np.nan, np.float32)
    total, n_total = 0.0, 0
    for side in range(2):
        for band in range(N_BANDS):
            for i in range(N_ALONG):
                value, n = 0.0, 0
                for ray in range(band * RAYS_PER_BAND, (band + 1) * RAYS_PER_BAND):
                    if samples[1, side * N_ALONG + i, ray] > 0.0:
                        value += samples[0, side * N_ALONG + i, ray]
                        n += 1
                if n == RAYS_PER_BAND:
                    out[side, i, band] = value / n
                    total += value / n
                    n_total += 1
    scale = n_total / max(total, 1.0 * n_total) if n_total else 0.0
    for side in range(2):
        for band in range(N_BANDS):
            row = out[side, :, band].copy()
            for i in range(N_ALONG):
                value, n = 0.0, 0
                for j in range(max(i - SMOOTH_SAMPLES, 0), min(i + SMOOTH_SAMPLES + 1, N_ALONG)):
                    if row[j] == row[j]:
                        value += row[j]
                        n += 1
                if n:
                    out[side, i, band] = (row[i] - value / n) * scale
    return out


def wall_profiles(picture: GreyImage | Pyramid, camera: Camera, R_corridor_camera: FloatArray) -> Profiles:
    """Sample the brightness along both walls.

    Parameters
    ----------
    picture, camera, R_corridor_camera
        As in `vision.lateral.polar.polar_picture`.

    Returns
    -------
    Profiles
        Brightness (2, N_ALONG, N_BANDS) of the right and the left wall, less its moving average along the wall, over
        the mean brightness of all samples. Bands run from rays above the horizontal to rays below it, samples along
        the wall at cotangents in steps of `COTANGENT_STEP`; NaN outside the picture.
    """
    points = project_directions(DIRECTIONS.reshape(-1, 3), R_corridor_camera, camera)
    return _banded(sample_points(picture, points.reshape(*DIRECTIONS.shape[:2], 2)))


def are_profiles(values: object) -> bool:
    """Whether an array has the shape, type and range of `wall_profiles`."""
    if not isinstance(values, np.ndarray) or values.shape != PROFILES_SHAPE or values.dtype != np.float32:
        return False
    return not bool((np.abs(values) > MAX_RELATIVE).any())  # NaN is allowed


@compiled_inner
def _wall_likelihood(before: Profiles, now: Profiles) -> FloatArray:
    """Return the log-likelihood (SCALES, SHIFTS) of scale and shift between one wall's profiles (N_ALONG, N_BANDS).

    It is 0 where the profiles do not match or do not overlap.
    """
    out, place = np.zeros((len(SCALES), len(SHIFTS))), np.empty(N_ALONG)
    for m in range(len(SCALES)):
        k = 1.0 + SCALES[m]
        for a in range(len(SHIFTS)):
            shift = SHIFTS[a] + SCALES[m] * PIVOT
            for i in range(N_ALONG):  # a separate loop, so that the divisions vectorise
                place[i] = ((_COTANGENTS[i] + shift) / k - FIRST_COTANGENT) / COTANGENT_STEP
            squares, power, n = np.float32(0.0), np.float32(0.0), 0
            for i in range(N_ALONG):
                if not 0.0 <= place[i] < N_ALONG - 1:
                    continue
                j = int(place[i])
                share = np.float32(place[i] - j)
                for band in range(N_BANDS):
                    first = before[j, band] + share * (before[j + 1, band] - before[j, band])
                    second = now[i, band]
                    if first == first and second == second:
                        squares += (second - first) * (second - first)
                        power += first * first + second * second
                        n += 1
            if n >= MIN_OVERLAP:
                relative = (squares + n * NOISE_FLOOR) / (0.5 * power + n * NOISE_FLOOR)
                out[m, a] = max(-0.5 * INDEPENDENT * N_BANDS * N_ALONG * log(relative), 0.0)
    return out


@compiled_inner
def _add_along(table: FloatArray, scale: float, distance: float, column: FloatArray, out: FloatArray) -> None:
    """Add one wall's log-likelihood, interpolated linearly, to the sum (FORWARD_NORM,) over both walls.

    ``column`` (SHIFTS,) is working memory.
    """
    y = (scale - SCALES[0]) / (SCALES[1] - SCALES[0])
    if not 0.0 <= y <= len(SCALES) - 1:
        return
    j = min(max(int(y), 0), len(SCALES) - 2)
    y -= j
    for k in range(len(SHIFTS)):
        column[k] = table[j, k] + y * (table[j + 1, k] - table[j, k])
    for f in range(len(out)):
        x = (FORWARD_NORM[f] / distance - scale * PIVOT - SHIFTS[0]) / (SHIFTS[1] - SHIFTS[0])
        if 0.0 <= x < len(SHIFTS) - 1:
            k = int(x)
            out[f] += column[k] + (x - k) * (column[k + 1] - column[k])


@compiled
def motion_likelihood(before: Profiles, now: Profiles) -> FloatArray:
    """Likelihood (offsets, displacements) of two frames' profiles (2, N_ALONG, N_BANDS), summed over advances."""
    right = _wall_likelihood(before[0], now[0])
    left = _wall_likelihood(before[1], now[1])
    most = right.max() + left.max()
    out = np.zeros((N_OFFSETS, len(DISPLACEMENT_NORM)))
    both, column = np.empty(len(FORWARD_NORM)), np.empty(len(SHIFTS))
    for b in range(N_OFFSETS):
        to_right, to_left = 1.0 - OFFSETS[b], 1.0 + OFFSETS[b]
        for c in range(len(DISPLACEMENT_NORM)):
            both[:] = -most
            _add_along(right, DISPLACEMENT_NORM[c] / to_right, to_right, column, both)
            _add_along(left, -DISPLACEMENT_NORM[c] / to_left, to_left, column, both)
            for f in range(len(both)):
                if both[f] > -NEGLIGIBLE:
                    out[b, c] += exp(both[f])
    return out


@compiled
def _summary(likelihood: FloatArray) -> tuple[FloatArray, float, float, float]:
    """Return the fields (4, k) of the offset's mixture, and the numbers of a `Parallax`."""
    of_offset = np.zeros(N_OFFSETS)
    total = y = d = yy = yd = dd = 0.0
    for b in range(N_OFFSETS):
        for c in range(len(DISPLACEMENT_NORM)):
            p = likelihood[b, c]
            of_offset[b] += p
            total += p
            y += p * OFFSETS[b]
            d += p * DISPLACEMENT_NORM[c]
            yy += p * OFFSETS[b] ** 2
            yd += p * OFFSETS[b] * DISPLACEMENT_NORM[c]
            dd += p * DISPLACEMENT_NORM[c] ** 2
    y /= total
    d /= total
    yy, yd, dd = yy / total - y * y, yd / total - y * d, dd / total - d * d
    slope = yd / max(yy, MIN_STD**2)
    level = of_offset.min()
    for b in range(N_OFFSETS):
        of_offset[b] -= level  # a constant part carries no information
    rows = np.empty((MAX_PEAKS, 5))
    count = peaks_of_density(of_offset, OFFSETS, rows)
    fields = np.empty((4, count))
    for k in range(count):
        fields[0, k], fields[1, k], fields[3, k] = rows[k, 0] / total, rows[k, 1], nan
        fields[2, k] = sqrt(rows[k, 2] ** 2 + MIN_OFFSET_STD**2)
    return fields, d - slope * y, slope, sqrt(max(dd - slope * yd, MIN_DISPLACEMENT_STD**2))


def compare(before: Profiles, now: Profiles) -> Parallax:
    """Estimate offset and displacement from the wall profiles of two frames.

    Parameters
    ----------
    before, now
        Results of `wall_profiles`, some tenths of a second apart.
    """
    fields, displacement, slope, std = _summary(motion_likelihood(before, now))
    if not std < MAX_DISPLACEMENT_STD:
        displacement = std = nan
    return Parallax(OffsetMixture(*fields), displacement, slope, std)
