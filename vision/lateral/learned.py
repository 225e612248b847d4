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
from math import exp, isfinite, nan, pi
from threading import local
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from vision.cameras.camera import Camera
from vision.cameras.projection import project_directions
from vision.compiled import compiled, compiled_inner
from vision.images import GreyImage
from vision.lateral.mixture import MAX_PEAKS, OffsetMixture, peaks_of_density
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

MIRRORED: IntArray = (N_ANGLES // 2 - 1 - np.arange(N_ANGLES)) % N_ANGLES  # angles, left and right exchanged
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
def is_left_brighter(polar: Polar) -> bool:
    """Tell whether a polar picture (2, N_RADII, N_ANGLES) is brighter on its left: the network sees it mirrored."""
    left = right = 0.0
    for r in range(polar.shape[1]):
        for a in range(2 * N_QUARTER):
            left += polar[0, r, N_QUARTER + a]
            right += polar[0, r, (3 * N_QUARTER + a) % N_ANGLES]
    return right < left


@compiled
def _darker_side_left(polar: Polar, is_left_brighter: bool) -> Polar:
    """Return a polar picture with left and right exchanged where its left is the brighter side."""
    if not is_left_brighter:  # a branch of its own would be compiled only in flight
        return polar
    out = np.empty_like(polar)
    for channel in range(polar.shape[0]):
        for r in range(polar.shape[1]):
            for a in range(N_ANGLES):
                out[channel, r, a] = polar[channel, r, (N_ANGLES // 2 - 1 - a) % N_ANGLES]
    return out


@compiled
def _read_scores(raw: npt.NDArray[np.float32], is_mirrored: bool) -> tuple[FloatArray, FloatArray]:
    """Return the fields of `CornerScores` of what the network says, mirrored back where it saw the mirrored picture.

    ``raw`` holds scores of the floor's and of the ceiling's corner at every angle, and the log-odds.
    """
    n = N_QUARTER
    corner, blind = np.empty((4, n)), np.empty(N_ODDS)
    for k in range(4):
        ceiling, seen_right = k // 2, (k % 2 == 1) != is_mirrored
        quarter = 3 * ceiling if seen_right else 1 + ceiling
        # From the horizontal: in every second quarter that is against the way in which angles are counted.
        first, step = (quarter * n, 1) if quarter % 2 == 0 else (quarter * n + n - 1, -1)
        largest, total = -np.inf, 0.0
        for a in range(n):
            corner[k, a] = raw[ceiling * N_ANGLES + first + step * a]
            largest = max(largest, corner[k, a])
        for a in range(n):
            corner[k, a] = exp(corner[k, a] - largest)
            total += corner[k, a]
        for a in range(n):
            corner[k, a] /= total
    for k in range(N_ODDS):
        blind[k] = 1.0 / (1.0 + exp(-np.float64(raw[len(raw) - N_ODDS + k])))
    return corner, blind


def corner_scores(polar: Polar) -> CornerScores:
    """Run the network on a polar picture (2, N_RADII, N_ANGLES), mirrored where its left side is the brighter one."""
    is_mirrored = is_left_brighter(polar)
    raw = _forward(_darker_side_left(polar, is_mirrored)[None])[0]
    return CornerScores(*_read_scores(raw, is_mirrored))


@compiled_inner
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


@compiled_inner
def _offset_density(corner: FloatArray, blind: FloatArray) -> tuple[FloatArray, float, FloatArray]:
    """Combine floor and ceiling; arguments are the fields of `CornerScores`.

    Returns
    -------
    density, level, width
        Posterior (N_BINS,) over chance of the offset, what of it is the same everywhere, and the width over the
        camera's height (N_BINS,) by the floor, NaN where the floor does not tell.
    """
    pairs = np.zeros((2, 2, N_BINS))
    for k in range(2):
        _add_pairs(corner[2 * k], corner[2 * k + 1], PAIR_OFFSET, COTANGENT, pairs[k])
    density, width = np.empty(N_BINS), np.empty(N_BINS)
    for b in range(N_BINS):
        floor, ceiling = (1.0 - blind[0]) * pairs[0, 0, b], (1.0 - blind[1]) * pairs[1, 0, b]
        density[b] = blind[2] + (1.0 - blind[2]) * ((blind[0] + floor) * (blind[1] + ceiling))
        width[b] = pairs[0, 1, b] / pairs[0, 0, b] if floor > blind[0] else nan
    level = blind[2] + (1.0 - blind[2]) * blind[0] * blind[1]
    scale = 0.0
    for b in range(N_BINS):
        scale += density[b] / N_BINS
    for b in range(N_BINS):
        density[b] /= scale
    return density, level / scale, width


@compiled
def _fields(corner: FloatArray, blind: FloatArray) -> FloatArray:
    """Return the fields (4, k) of the mixture that `mixture_of` makes of the fields of `CornerScores`."""
    density, level, width = _offset_density(corner, blind)
    above = np.empty(N_BINS)
    for b in range(N_BINS):
        above[b] = max(density[b] - level, 0.0) / N_BINS
    rows = np.empty((MAX_PEAKS, 5))
    count = peaks_of_density(above, BIN_CENTRES, rows)
    fields = np.empty((4, count))
    for k in range(count):
        fields[0, k], fields[1, k], fields[2, k], fields[3, k] = rows[k, 0], rows[k, 1], rows[k, 2], nan
        whole = told = moment = 0.0
        for b in range(int(rows[k, 3]), int(rows[k, 4])):
            whole += density[b]
            if isfinite(width[b]):
                told += density[b]
                moment += density[b] * width[b]
        if told > 0.5 * whole:
            fields[3, k] = moment / told
    return fields


def mixture_of(found: CornerScores) -> OffsetMixture:
    """Sum up the corners' probabilities as a mixture."""
    return OffsetMixture(*_fields(found.corner, found.blind))


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


@compiled
def corners_from_level(corner: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the likeliest corners' angles (4,) from the horizontal, all positive, and how sure they are (4,).

    That is the probability within two angles of each. ``corner`` (4, N_QUARTER) is that of `CornerScores`.
    """
    angle, sureness = np.empty(4), np.zeros(4)
    for k in range(4):
        best = int(np.argmax(corner[k]))
        angle[k] = ANGLES[best]
        for a in range(max(best - 2, 0), min(best + 3, N_QUARTER)):
            sureness[k] += corner[k, a]
    return angle, sureness


def likeliest_corners(found: CornerScores) -> FloatArray:
    """Angles (4,) about the axis, as `ANGLES` counts them, of the likeliest corners; order of `CornerScores`."""
    from_level, _ = corners_from_level(found.corner)
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
    angles = likeliest_corners(found)[corners_from_level(found.corner)[1] >= SURE_CORNER]
    rays = np.ones((len(angles), len(DRAWN_TAN), 3))
    rays[..., 1] = DRAWN_TAN * np.cos(angles)[:, None]
    rays[..., 2] = DRAWN_TAN * np.sin(angles)[:, None]
    points = project_directions(rays.reshape(-1, 3), R_corridor_camera, camera).reshape(*rays.shape[:2], 2)
    # NaN is not inside either.
    x, y = points[..., 0], points[..., 1]
    inside = (x > -0.5) & (x < camera.width_px) & (y > -0.5) & (y < camera.height_px)
    pieces = np.concatenate([points[:, :-1], points[:, 1:]], axis=-1)
    return pieces[inside[:, :-1] & inside[:, 1:]]
