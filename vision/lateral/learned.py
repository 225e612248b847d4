"""The lateral offset as a small network sees it in the polar picture, with an explicit "cannot tell".

The network (`training.offset_network` makes it, `offset_network.json` beside the weights says how good it is)
scores every angle about the axis as the corner of floor and wall, and as that of ceiling and wall. A softmax over
each quarter turn makes the scores the probability of where each of the four corners is. Distances w of the walls
over the camera's height follow from the angles, and ``(w_L - w_R) / (w_L + w_R)`` is the offset. So the product of
the probabilities of a left and a right corner, summed into a histogram, is the offset's density by the floor, f(y),
and by the ceiling, c(y), both over chance. The network also gives the probabilities e_f, e_c and e that floor,
ceiling and the whole frame cannot tell. The likelihood over chance is

    e + (1 - e) (e_f + (1 - e_f) f(y)) (e_c + (1 - e_c) c(y)).

Where floor and ceiling agree it is sharp; where they disagree it keeps a peak for each, and "cannot tell" gains.
They do err together: the training maximises this joint likelihood, not those of the corners alone, so that their
probabilities come out as wide as the product needs.

The network sees the picture with its darker side on the left, mirrored where need be: a mirrored picture gives the
mirrored answer, at half the cost of evaluating both.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from math import exp, nan, pi, sqrt
from threading import local
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from vision.cameras.camera import Camera
from vision.cameras.projection import project_directions
from vision.compiled import compiled
from vision.images import GreyImage
from vision.lateral.mixture import OffsetMixture
from vision.lateral.polar import ANGLES, N_ANGLES, Polar, polar_picture
from vision.types import FloatArray, IntArray

WEIGHTS_FILE = "offset_network.onnx"
N_QUARTER = N_ANGLES // 4
N_BINS = 80  # of the offset, in (-1, 1)
N_ODDS = 3  # log-odds that floor, ceiling and frame cannot tell
BIN_CENTRES: FloatArray = np.linspace(-1.0 + 1.0 / N_BINS, 1.0 - 1.0 / N_BINS, N_BINS)
COTANGENT: FloatArray = 1.0 / np.tan(
    ANGLES[:N_QUARTER]
)  # distance of a wall over height, by the angle from level
# Offset (N_QUARTER, N_QUARTER) by the angles of the left corner and of the right one
PAIR_OFFSET: FloatArray = (COTANGENT[:, None] - COTANGENT) / (COTANGENT[:, None] + COTANGENT)
MIN_PROBABILITY = 1e-4  # of a corner at an angle: below, it is left out of the pairs

SURE_CORNER = 0.5  # probability within two angles of the likeliest, from which on a corner is drawn
DRAWN_TAN: FloatArray = np.geomspace(0.05, 4.0, 16)
MAX_COMPONENTS = 5
MIN_WEIGHT = 0.01  # of a component; less is left to "cannot tell"
FOOT = 0.02  # a peak ends where the density has fallen to this share of it,
RISE = 1.2  # or rises so far above its lowest
MIN_STD = 0.005

MIRRORED: IntArray = (N_ANGLES // 2 - 1 - np.arange(N_ANGLES)) % N_ANGLES  # angles, left and right exchanged
_IS_RIGHT = np.cos(ANGLES) > 0.0
_PER_THREAD = local()  # cv2.dnn keeps its input within the network


@dataclass(frozen=True, slots=True, eq=False)
class CornerScores:
    """What the network says about one picture.

    Parameters
    ----------
    corner
        Probability (4, N_QUARTER) that the corner of floor and left wall, floor and right wall, ceiling and left
        wall, ceiling and right wall is at each angle below or above the horizontal, from 0 to 90 degrees.
    blind
        Probabilities (3,) that floor, ceiling and the whole frame cannot tell.
    """

    corner: FloatArray
    blind: FloatArray


@cache
def _weights() -> npt.NDArray[np.uint8]:
    return np.frombuffer(files("vision.lateral").joinpath(WEIGHTS_FILE).read_bytes(), np.uint8)


def _forward(batch: Polar) -> npt.NDArray[np.float32]:
    """Run the network; each thread has its own."""
    network: Any = getattr(_PER_THREAD, "network", None)
    if network is None:
        network = _PER_THREAD.network = cv2.dnn.readNetFromONNX(_weights())
    network.setInput(batch)
    return np.asarray(network.forward(), np.float32)


@compiled
def _softmax_quarters(scores: npt.NDArray[np.float32], corner: FloatArray) -> None:
    """Probabilities (4, n) of the corners from scores (2, 4 n) of the floor's and the ceiling's at every angle."""
    n = corner.shape[1]
    for k in range(4):
        largest = -np.inf
        for a in range(n):
            if k == 0:
                value = scores[0, 2 * n - 1 - a]
            elif k == 1:
                value = scores[0, a]
            elif k == 2:
                value = scores[1, 2 * n + a]
            else:
                value = scores[1, 4 * n - 1 - a]
            corner[k, a] = value
            largest = max(largest, value)
        total = 0.0
        for a in range(n):
            corner[k, a] = exp(corner[k, a] - largest)
            total += corner[k, a]
        for a in range(n):
            corner[k, a] /= total


def is_left_brighter(polar: Polar) -> bool:
    """Tell whether a polar picture (2, N_RADII, N_ANGLES) is brighter on its left: the network sees it mirrored."""
    return bool(polar[0][:, _IS_RIGHT].sum() < polar[0][:, ~_IS_RIGHT].sum())


def corner_scores(polar: Polar) -> CornerScores:
    """Run the network on a polar picture (2, N_RADII, N_ANGLES), mirrored where its left side is the brighter one."""
    is_mirrored = is_left_brighter(polar)
    seen = polar[:, :, MIRRORED] if is_mirrored else polar
    raw = _forward(np.ascontiguousarray(seen[None]))[0]
    scores = raw[: 2 * N_ANGLES].reshape(2, N_ANGLES)
    if is_mirrored:
        scores = np.ascontiguousarray(scores[:, MIRRORED])
    corner = np.empty((4, N_QUARTER))
    _softmax_quarters(scores, corner)
    return CornerScores(corner, 1.0 / (1.0 + np.exp(-raw[-N_ODDS:].astype(float))))


@compiled
def _add_pairs(
    left: FloatArray, right: FloatArray, offsets: FloatArray, cot: FloatArray, out: FloatArray
) -> None:
    """Sum pairs of corners into a histogram (2, bins) over chance of the offset, and of width times probability."""
    bins = out.shape[1]
    for i in range(len(left)):
        if left[i] < MIN_PROBABILITY:
            continue
        for j in range(len(right)):
            if right[j] < MIN_PROBABILITY:
                continue
            p = left[i] * right[j] * bins
            place = (offsets[i, j] + 1.0) * 0.5 * bins - 0.5
            low = min(max(int(np.floor(place)), 0), bins - 2)
            share = min(max(place - low, 0.0), 1.0)
            out[0, low] += p * (1.0 - share)
            out[0, low + 1] += p * share
            width = cot[i] + cot[j]
            out[1, low] += p * (1.0 - share) * width
            out[1, low + 1] += p * share * width


@compiled
def _components(density: FloatArray, centres: FloatArray, rows: FloatArray) -> int:
    """Take peak after peak out of a density, each down to where it rises again or ends.

    Fills rows (k, 5) with weight, mean, standard deviation, first bin and the one after the last, and returns how
    many; ``density`` is used up.
    """
    total, bins = density.sum(), len(density)
    count = 0
    while count < len(rows):
        peak = int(np.argmax(density))
        top = density[peak]
        if not top > 0.0:
            break
        first = last = peak
        low = top
        while first > 0 and FOOT * top < density[first - 1] <= RISE * low:
            first -= 1
            low = min(low, density[first])
        low = top
        while last + 1 < bins and FOOT * top < density[last + 1] <= RISE * low:
            last += 1
            low = min(low, density[last])
        weight = mean = square = 0.0
        for k in range(first, last + 1):
            weight += density[k]
            mean += density[k] * centres[k]
            square += density[k] * centres[k] ** 2
            density[k] = 0.0
        if weight < MIN_WEIGHT * total:
            break
        mean /= weight
        rows[count, 0], rows[count, 1] = weight, mean
        rows[count, 2] = sqrt(max(square / weight - mean * mean, MIN_STD**2))
        rows[count, 3], rows[count, 4] = first, last + 1
        count += 1
    return count


def offset_density(found: CornerScores) -> tuple[FloatArray, float, FloatArray]:
    """Combine floor and ceiling.

    Returns
    -------
    density, level, width
        Posterior (N_BINS,) over chance of the offset, what of it is the same everywhere, and the width over the
        camera's height (N_BINS,) by the floor, NaN where the floor does not tell.
    """
    pairs = np.zeros((2, 2, N_BINS))
    for k in range(2):
        _add_pairs(found.corner[2 * k], found.corner[2 * k + 1], PAIR_OFFSET, COTANGENT, pairs[k])
    blind = found.blind
    told = (1.0 - blind[:2, None]) * pairs[:, 0]
    joint = (blind[0] + told[0]) * (blind[1] + told[1])
    density = blind[2] + (1.0 - blind[2]) * joint
    level = blind[2] + (1.0 - blind[2]) * blind[0] * blind[1]
    scale = density.mean()
    with np.errstate(invalid="ignore", divide="ignore"):
        width = np.where(told[0] > blind[0], pairs[0, 1] / pairs[0, 0], nan)
    return density / scale, float(level / scale), width


def mixture_of(found: CornerScores) -> OffsetMixture:
    """Sum up the corners' probabilities as a mixture."""
    density, level, width = offset_density(found)
    rows = np.empty((MAX_COMPONENTS, 5))
    rows = rows[: _components(np.maximum(density - level, 0.0) / N_BINS, BIN_CENTRES, rows)]
    widths = np.full(len(rows), nan)
    for k, (first, last) in enumerate(rows[:, 3:].astype(int)):
        weight = np.where(np.isnan(width[first:last]), 0.0, density[first:last])
        if weight.sum() > 0.5 * density[first:last].sum():
            widths[k] = float(weight @ np.nan_to_num(width[first:last]) / weight.sum())
    return OffsetMixture(rows[:, 0].copy(), rows[:, 1].copy(), rows[:, 2].copy(), widths)


def learned_mixture(grey: GreyImage, camera: Camera, R_corridor_camera: FloatArray) -> OffsetMixture:
    """Measure the lateral offset in one picture by its regions about the corridor's axis.

    Parameters
    ----------
    grey
        Picture (h, w), uint8, as the camera took it.
    camera
        Its calibration; any lens model.
    R_corridor_camera
        Rotation (3, 3) from the optical frame to the corridor's axes, by
        `vision.axis.vanishing_point.corridor_frame` from the level frame and the axis that vision found.

    Returns
    -------
    OffsetMixture
        Equal input gives equal bits on one machine.
    """
    return mixture_of(corner_scores(polar_picture(grey, camera, R_corridor_camera)))


def corners_from_level(found: CornerScores) -> FloatArray:
    """Angles (4,) of the likeliest corners from the horizontal, all positive; order of `CornerScores`."""
    return np.asarray(ANGLES[found.corner.argmax(axis=1)])


def corner_sureness(found: CornerScores) -> FloatArray:
    """Probability (4,) within two angles of each likeliest corner."""
    best = found.corner.argmax(axis=1)
    return np.array(
        [p[max(0, b - 2) : b + 3].sum() for p, b in zip(found.corner, best.tolist(), strict=True)]
    )


def likeliest_corners(found: CornerScores) -> FloatArray:
    """Angles (4,) about the axis, as `ANGLES` counts them, of the likeliest corners; order of `CornerScores`."""
    from_level = corners_from_level(found)
    return np.array([pi - from_level[0], from_level[1], pi + from_level[2], 2.0 * pi - from_level[3]])


def corner_lines(found: CornerScores, camera: Camera, R_corridor_camera: FloatArray) -> FloatArray:
    """Draw the corners that the network is sure of: pieces of lines (k, 4), pixels of the picture.

    Parameters
    ----------
    found
        What the network says.
    camera, R_corridor_camera
        As in `learned_mixture`.
    """
    pieces = []
    for angle, sure in zip(likeliest_corners(found), corner_sureness(found), strict=True):
        if sure < SURE_CORNER:
            continue
        rays = np.stack(
            [np.ones_like(DRAWN_TAN), DRAWN_TAN * np.cos(angle), DRAWN_TAN * np.sin(angle)], axis=1
        )
        points = project_directions(rays, R_corridor_camera, camera)
        inside = np.isfinite(points).all(axis=1)
        inside &= (points > -0.5).all(axis=1) & (points < [camera.width_px, camera.height_px]).all(axis=1)
        points = points[inside]
        pieces.append(np.hstack([points[:-1], points[1:]]))
    return np.concatenate(pieces) if pieces else np.zeros((0, 4))
