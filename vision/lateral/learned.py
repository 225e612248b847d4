"""Likelihood of the lateral offset by a small convolutional network, with an explicit "cannot tell" share.

The input is the log-polar picture about the corridor's axis (`vision.lateral.polar`). The network is trained by
`training.offset_network`; `offset_network.json` beside the weights documents its accuracy. It scores every angle
about the axis as the corner of floor and wall, and as the corner of ceiling and wall. A softmax over each quarter
turn turns the scores into the probability of each of the four corners' angles. The angle a of a corner below (above)
the horizontal gives the wall's distance over the camera's height, ``w = cot a``, and two corners give the offset
``y = (w_L - w_R) / (w_L + w_R)``. The products of the probabilities of a left and a right corner, summed into a
histogram over y, are the offset's density by the floor, f(y), and by the ceiling, c(y), both relative to the uniform
density. The network also outputs the probabilities e_f, e_c and e that floor, ceiling and the whole frame cannot
tell. The likelihood relative to the uniform density is

    e + (1 - e) (e_f + (1 - e_f) f(y)) (e_c + (1 - e_c) c(y)).

Where floor and ceiling agree it is sharp; where they disagree it keeps both peaks, and "cannot tell" gains weight.
Their errors are correlated, so the training maximises this joint likelihood instead of the corners' own, which makes
the corners' probabilities wide enough for the product.

The picture is mirrored where necessary so that its darker side is on the left: the network's output is then symmetric
under reflection, at half the cost of evaluating both pictures.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from math import exp, isfinite, log, nan, pi, sqrt
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
# Distance of a wall over the camera's height, by the corner's angle from the horizontal
COTANGENT: FloatArray = 1.0 / np.tan(ANGLES[:N_QUARTER])
# Offset (N_QUARTER, N_QUARTER) by the angles of the left and the right corner
PAIR_OFFSET: FloatArray = (COTANGENT[:, None] - COTANGENT) / (COTANGENT[:, None] + COTANGENT)
MIN_PROBABILITY = 1e-4  # corners less probable at an angle are left out of the pairs

ASPECT_REACH_NORM = 0.08  # half widths; corners at offsets closer than this belong to one cross-section
MIN_ASPECT_PROBABILITY = 0.02  # of such corners; with less they contradict the offset

MIN_DRAWN_CERTAINTY = 0.5  # see `corners_from_level`; less certain corners are not drawn
DRAWN_TAN: FloatArray = np.geomspace(0.05, 4.0, 16)

# Indices of the angles with left and right exchanged
MIRRORED: IntArray = (N_ANGLES // 2 - 1 - np.arange(N_ANGLES)) % N_ANGLES
_PER_THREAD = local()  # cv2.dnn stores the input in the network


@dataclass(frozen=True, slots=True, eq=False)
class CornerScores:
    """Output of the network for one picture, as probabilities.

    Parameters
    ----------
    corner
        Probability (4, N_QUARTER) of each corner's angle below or above the horizontal, 0 to 90 degrees. Rows: floor
        and left wall, floor and right wall, ceiling and left wall, ceiling and right wall.
    cannot_tell
        Probabilities (3,) that floor, ceiling and the whole frame cannot tell.
    """

    corner: FloatArray
    cannot_tell: FloatArray


@cache
def _weights() -> npt.NDArray[np.uint8]:
    return np.frombuffer(files("vision.lateral").joinpath(WEIGHTS_FILE).read_bytes(), np.uint8)


def _forward(batch: Polar) -> npt.NDArray[np.float32]:
    """Run the network; each thread has its own instance."""
    network: Any = getattr(_PER_THREAD, "network", None)
    if network is None:
        network = _PER_THREAD.network = cv2.dnn.readNetFromONNX(_weights())
    network.setInput(batch)
    return np.asarray(network.forward(), np.float32)


@compiled
def is_left_brighter(polar: Polar) -> bool:
    """Decide whether a polar picture (2, N_RADII, N_ANGLES) is brighter on its left, and so must be mirrored."""
    left = right = 0.0
    for r in range(polar.shape[1]):
        for a in range(2 * N_QUARTER):
            left += polar[0, r, N_QUARTER + a]
            right += polar[0, r, (3 * N_QUARTER + a) % N_ANGLES]
    return right < left


@compiled
def _darker_side_left(polar: Polar, is_left_brighter: bool) -> Polar:
    """Return the polar picture, mirrored where its left is the brighter side."""
    if not is_left_brighter:  # tested here, not by the caller, so that `warm_up` compiles this function
        return polar
    out = np.empty_like(polar)
    for channel in range(polar.shape[0]):
        for r in range(polar.shape[1]):
            for a in range(N_ANGLES):
                out[channel, r, a] = polar[channel, r, (N_ANGLES // 2 - 1 - a) % N_ANGLES]
    return out


@compiled
def _read_scores(raw: npt.NDArray[np.float32], is_mirrored: bool) -> tuple[FloatArray, FloatArray]:
    """Turn the network's output into the fields of `CornerScores`, mirrored back where the picture was mirrored.

    ``raw`` holds the scores of the floor's and the ceiling's corner at every angle, and the log-odds.
    """
    n = N_QUARTER
    corner, cannot_tell = np.empty((4, n)), np.empty(N_ODDS)
    for k in range(4):
        ceiling, seen_right = k // 2, (k % 2 == 1) != is_mirrored
        quarter = 3 * ceiling if seen_right else 1 + ceiling
        # Angles from the horizontal: in every second quarter they run against the polar picture's columns.
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
        cannot_tell[k] = 1.0 / (1.0 + exp(-np.float64(raw[len(raw) - N_ODDS + k])))
    return corner, cannot_tell


def corner_scores(polar: Polar) -> CornerScores:
    """Run the network on a polar picture (2, N_RADII, N_ANGLES)."""
    is_mirrored = is_left_brighter(polar)
    raw = _forward(_darker_side_left(polar, is_mirrored)[None])[0]
    return CornerScores(*_read_scores(raw, is_mirrored))


@compiled_inner
def _add_pairs(
    left: FloatArray, right: FloatArray, offsets: FloatArray, cot: FloatArray, out: FloatArray
) -> None:
    """Sum pairs of corners into a histogram over the offset (2, bins): density over uniform, and that times width."""
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
def _offset_density(corner: FloatArray, cannot_tell: FloatArray) -> tuple[FloatArray, float, FloatArray]:
    """Combine floor and ceiling; arguments are the fields of `CornerScores`.

    Returns
    -------
    density, uniform_part, width
        Density (N_BINS,) of the offset relative to the uniform one, its constant part, and the width over the
        camera's height (N_BINS,) by the floor, NaN where the floor cannot tell.
    """
    pairs = np.zeros((2, 2, N_BINS))
    for k in range(2):
        _add_pairs(corner[2 * k], corner[2 * k + 1], PAIR_OFFSET, COTANGENT, pairs[k])
    density, width = np.empty(N_BINS), np.empty(N_BINS)
    for b in range(N_BINS):
        floor, ceiling = (1.0 - cannot_tell[0]) * pairs[0, 0, b], (1.0 - cannot_tell[1]) * pairs[1, 0, b]
        density[b] = cannot_tell[2] + (1.0 - cannot_tell[2]) * (
            (cannot_tell[0] + floor) * (cannot_tell[1] + ceiling)
        )
        width[b] = pairs[0, 1, b] / pairs[0, 0, b] if floor > cannot_tell[0] else nan
    uniform_part = cannot_tell[2] + (1.0 - cannot_tell[2]) * cannot_tell[0] * cannot_tell[1]
    scale = 0.0
    for b in range(N_BINS):
        scale += density[b] / N_BINS
    for b in range(N_BINS):
        density[b] /= scale
    return density, uniform_part / scale, width


@compiled
def _mixture_fields(corner: FloatArray, cannot_tell: FloatArray) -> FloatArray:
    """Return the fields (4, k) of the mixture of `mixture_of`, from the fields of `CornerScores`."""
    density, uniform_part, width = _offset_density(corner, cannot_tell)
    above = np.empty(N_BINS)
    for b in range(N_BINS):
        above[b] = max(density[b] - uniform_part, 0.0) / N_BINS
    rows = np.empty((MAX_PEAKS, 5))
    count = peaks_of_density(above, BIN_CENTRES, rows)
    fields = np.empty((4, count))
    for k in range(count):
        fields[0, k], fields[1, k], fields[2, k], fields[3, k] = rows[k, 0], rows[k, 1], rows[k, 2], nan
        total_weight = width_weight = moment = 0.0
        for b in range(int(rows[k, 3]), int(rows[k, 4])):
            total_weight += density[b]
            if isfinite(width[b]):
                width_weight += density[b]
                moment += density[b] * width[b]
        if width_weight > 0.5 * total_weight:
            fields[3, k] = moment / width_weight
    return fields


def mixture_of(found: CornerScores) -> OffsetMixture:
    """Return the offset's likelihood as a mixture, one component for each peak of its density."""
    return OffsetMixture(*_mixture_fields(found.corner, found.cannot_tell))


@compiled
def _aspect_at(corner: FloatArray, offset_norm: float) -> tuple[float, float]:
    """Return height over width of the corridor at an offset, and its sigma; see `aspect_at`."""
    aspect = variance = 0.0
    for k in range(2):
        left, right = corner[2 * k], corner[2 * k + 1]
        total = mean = square = 0.0
        for i in range(N_QUARTER):
            if left[i] < MIN_PROBABILITY:
                continue
            for j in range(N_QUARTER):
                if right[j] < MIN_PROBABILITY or abs(PAIR_OFFSET[i, j] - offset_norm) > ASPECT_REACH_NORM:
                    continue
                p, log_width = left[i] * right[j], log(COTANGENT[i] + COTANGENT[j])
                total += p
                mean += p * log_width
                square += p * log_width * log_width
        if total < MIN_ASPECT_PROBABILITY:
            return nan, nan
        mean /= total
        part = exp(-mean)  # distance of the floor or the ceiling over the width
        aspect += part
        variance += part * part * max(square / total - mean * mean, 0.0)
    return aspect, sqrt(variance)


def aspect_at(found: CornerScores, offset_norm: float) -> tuple[float, float]:
    """Return the corridor's height over its width by the corners that agree with a lateral offset.

    With the corners' angles a from the horizontal it is ``1 / (cot a_FL + cot a_FR) + 1 / (cot a_CL + cot a_CR)``
    (F floor, C ceiling, L left, R right). The camera's position cancels out.

    Parameters
    ----------
    found
        The network's output.
    offset_norm
        Offset of the camera, half widths.

    Returns
    -------
    aspect, std
        Mean and standard deviation; NaN where floor or ceiling do not agree with the offset.
    """
    return _aspect_at(found.corner, offset_norm)


def learned_mixture(grey: GreyImage, camera: Camera, R_corridor_camera: FloatArray) -> OffsetMixture:
    """Return the likelihood of the lateral offset by the network for one picture.

    Parameters
    ----------
    grey
        Original picture (h, w), uint8, not undistorted.
    camera
        Its calibration; any lens model.
    R_corridor_camera
        Rotation (3, 3) from the optical frame to the corridor's axes, by
        `vision.axis.vanishing_point.corridor_frame` from the level frame and the fitted axis.

    Returns
    -------
    OffsetMixture
        Bit-identical for equal input on one machine.
    """
    return mixture_of(corner_scores(polar_picture(grey, camera, R_corridor_camera)))


@compiled
def corners_from_level(corner: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the likeliest corners' angles (4,) from the horizontal, all positive, and their certainty (4,).

    The certainty is the probability within two angles of the likeliest. ``corner`` (4, N_QUARTER) as in
    `CornerScores`.
    """
    angle, certainty = np.empty(4), np.zeros(4)
    for k in range(4):
        best = int(np.argmax(corner[k]))
        angle[k] = ANGLES[best]
        for a in range(max(best - 2, 0), min(best + 3, N_QUARTER)):
            certainty[k] += corner[k, a]
    return angle, certainty


def likeliest_corners(found: CornerScores) -> FloatArray:
    """Return the likeliest corners' angles (4,) about the axis, counted as `ANGLES`, ordered as `CornerScores`."""
    from_level, _ = corners_from_level(found.corner)
    return np.array([pi - from_level[0], from_level[1], pi + from_level[2], 2.0 * pi - from_level[3]])


def corner_lines(found: CornerScores, camera: Camera, R_corridor_camera: FloatArray) -> FloatArray:
    """Return line pieces (k, 4), in pixels of the picture, for drawing the corners the network is certain of.

    Parameters
    ----------
    found
        The network's output.
    camera, R_corridor_camera
        As in `learned_mixture`.
    """
    angles = likeliest_corners(found)[corners_from_level(found.corner)[1] >= MIN_DRAWN_CERTAINTY]
    rays = np.ones((len(angles), len(DRAWN_TAN), 3))
    rays[..., 1] = DRAWN_TAN * np.cos(angles)[:, None]
    rays[..., 2] = DRAWN_TAN * np.sin(angles)[:, None]
    points = project_directions(rays.reshape(-1, 3), R_corridor_camera, camera).reshape(*rays.shape[:2], 2)
    x, y = points[..., 0], points[..., 1]  # NaN counts as outside
    inside = (x > -0.5) & (x < camera.width_px) & (y > -0.5) & (y < camera.height_px)
    pieces = np.concatenate([points[:, :-1], points[:, 1:]], axis=-1)
    return pieces[inside[:, :-1] & inside[:, 1:]]
