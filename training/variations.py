"""Data augmentation: many training samples from one rendered view.

The corridor's true geometry is a box. For another box, that is another offset, height and width, every ray of the
polar picture is intersected with it, the hit point is mapped linearly to the view's own box, and projected into the
picture (*box warp*). Further variations: the width steps ahead, boxes stand along the walls, stripes are painted
along the corridor, surfaces change their brightness, and the axis has an error as in flight.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import pi, radians, tan

import cv2
import numpy as np
import numpy.typing as npt

from fusion.simulate.config import rotation
from training.offset_views import Box, FloatArray, TrainingView
from vision.lateral.learned import MIRRORED, is_left_brighter
from vision.lateral.polar import ANGLES, DIRECTIONS, N_ANGLES, Polar, sample_points, standardise

MAX_MEASURED_ERROR_RAD = radians(3.0)  # a larger one is a false axis, or a slope taken as level
MAX_OFFSET_NORM = 0.85
UNKNOWN, FLOOR, CEILING, WALL = -1, 0, 1, 2  # classes of an angle
STEP_SHARE = 0.25  # of the box warps, with a step in the width ahead


def axis_error(view: TrainingView, rng: np.random.Generator) -> FloatArray:
    """Draw a rotation (3, 3) from the measured corridor axes to the true ones.

    Half of the draws are this picture's own error, the others a random heading error as persists over frames; one in
    twenty is a false axis.
    """
    kind = rng.random()
    small = rng.normal(0.0, radians(0.15), 3)
    if kind < 0.5 and view.R_measured is not None:
        error = view.R_true @ view.R_measured.T
        turned = float(np.arccos(np.clip((np.trace(error) - 1.0) / 2.0, -1.0, 1.0)))
        if turned < MAX_MEASURED_ERROR_RAD:
            return np.asarray(error @ rotation(*small), dtype=float)
    if kind < 0.95:
        std = radians(rng.uniform(0.0, 1.0)) * np.array([1.0, 0.7, 0.5])
    else:
        std = radians(rng.uniform(2.0, 12.0)) * np.array([1.0, 0.3, 0.3])
    return np.asarray(rotation(*(small + rng.normal(0.0, 1.0, 3) * std)), dtype=float)


def random_box_near(box: Box, rng: np.random.Generator) -> Box:
    """Draw another corridor and position, near enough that the warped picture is not too distorted."""
    width, height = box.left + box.right, box.floor + box.ceiling
    wide = width * float(np.exp(rng.uniform(-0.4, 0.4)))
    high = height * float(np.exp(rng.uniform(-0.2, 0.2)))
    offset = float(np.clip(box.offset_norm + rng.uniform(-0.6, 0.6), -MAX_OFFSET_NORM, MAX_OFFSET_NORM))
    level = float(np.clip(box.floor / height + rng.uniform(-0.2, 0.2), 0.12, 0.85))
    half = wide / 2.0
    ahead = box.ahead * float(np.exp(rng.uniform(-0.3, 0.3)))
    return Box(half * (1.0 + offset), half * (1.0 - offset), high * level, high * (1.0 - level), ahead)


@dataclass(frozen=True, slots=True)
class WidthStep:
    """Step in the corridor's width, ``at`` metres ahead of the camera; ``beyond`` it the corridor is another box."""

    at: float
    beyond: Box


def draw_step(box: Box, rng: np.random.Generator) -> WidthStep:
    """Draw a step in the width ahead, of one wall or of both; floor and ceiling continue."""
    left, right = box.left, box.right
    factor = float(rng.uniform(0.55, 0.85) if rng.random() < 0.65 else rng.uniform(1.15, 1.6))
    change = (factor - 1.0) * (left + right)
    share_left = float(rng.choice([0.0, 0.5, 1.0]))
    at = min(0.5 * (left + right), box.floor + box.ceiling) * float(np.exp(rng.uniform(-0.7, 1.9)))
    # The walls beyond stay on both sides of the vehicle's path.
    beyond = replace(
        box, left=max(left + share_left * change, 0.15), right=max(right + (1.0 - share_left) * change, 0.15)
    )
    return WidthStep(min(at, 0.8 * box.ahead), beyond)


@dataclass(frozen=True, slots=True, eq=False)
class Sample:
    """Training sample: input and targets.

    Parameters
    ----------
    polar
        (2, N_RADII, N_ANGLES).
    offset_norm
        True offset.
    corners_rad
        Angles (4,) of floor right, floor left, ceiling left, ceiling right; NaN where not visible.
    classes
        FLOOR, CEILING, WALL or UNKNOWN (N_ANGLES,).
    """

    polar: Polar
    offset_norm: float
    corners_rad: FloatArray
    classes: npt.NDArray[np.int64]


def _hits(direction: FloatArray, box: Box) -> FloatArray:
    """Return the distance factors (...,) at which directions (..., 3) hit the box from inside."""
    with np.errstate(divide="ignore"):
        across = np.where(direction[..., 1] > 0, box.right, -box.left) / direction[..., 1]
        down = np.where(direction[..., 2] > 0, box.floor, -box.ceiling) / direction[..., 2]
        along = np.where(direction[..., 0] > 1e-6, box.ahead / direction[..., 0], np.inf)
    return np.minimum(np.minimum(across, down), along)


def _hits_beyond(
    direction: FloatArray, reach: FloatArray, step: WidthStep
) -> tuple[FloatArray, npt.NDArray[np.bool_], npt.NDArray[np.bool_]]:
    """Follow rays past a step in the width.

    Returns
    -------
    reach, is_beyond, is_face
        Distance factors (...,), which rays end beyond the step, and which on a wall's face at the step.
    """
    passes = direction[..., 0] * reach > step.at
    with np.errstate(divide="ignore", invalid="ignore"):
        at_step = step.at / direction[..., 0]
    y = np.where(passes, at_step * direction[..., 1], 0.0)
    is_face = passes & ((y > step.beyond.right) | (y < -step.beyond.left))
    is_beyond = passes & ~is_face
    reach = np.where(is_face, at_step, np.where(is_beyond, _hits(direction, step.beyond), reach))
    return reach, is_beyond, is_face


def _shade_faces(
    grey: npt.NDArray[np.float32],
    direction: FloatArray,
    is_face: npt.NDArray[np.bool_],
    rng: np.random.Generator,
) -> None:
    """Give each wall face at a step a random brightness, in place."""
    spread = float(grey.std()) + 1.0
    for side in (direction[..., 1] > 0, direction[..., 1] <= 0):
        here = is_face & side
        shade = float(grey.mean()) + spread * rng.normal(0.0, 1.0)
        grey[here] = shade + rng.uniform(0.0, 0.2) * spread * rng.standard_normal(int(here.sum()))


def _add_boxes(
    grey: npt.NDArray[np.float32],
    direction: FloatArray,
    reach: FloatArray,
    box: Box,
    rng: np.random.Generator,
) -> None:
    """Draw boxes along the walls, on the floor or under the ceiling, in place: furniture, pipes, trays."""
    width, height = box.left + box.right, box.floor + box.ceiling
    spread = float(grey.std()) + 1.0
    for _ in range(int(rng.integers(1, 6))):
        deep = rng.uniform(0.02, 0.25) * width
        tall = float(rng.choice([0.05, 0.15, 0.4])) * rng.uniform(0.3, 1.6) * height
        side = rng.choice([-1.0, 1.0])
        gap = float(rng.choice([0.0, 0.0, 0.08])) * rng.uniform(0.0, 1.0) * width
        y = (
            (box.right - gap - deep, box.right - gap)
            if side > 0
            else (-box.left + gap, -box.left + gap + deep)
        )
        low = float(rng.choice([0.0, 1.0, rng.uniform(0.0, 1.0)])) * (height - min(tall, height))
        z = (box.floor - low - tall, box.floor - low)
        start = rng.uniform(0.5, 10.0)
        x = (start, start + float(rng.choice([0.5, 1.5, 30.0])) * rng.uniform(0.5, 2.0))
        enter = np.full(reach.shape, 1e-3)
        leave = reach.copy()
        face = np.zeros(reach.shape, np.int64)
        for k, span in enumerate((x, y, z)):
            with np.errstate(divide="ignore", invalid="ignore"):
                a, b = span[0] / direction[..., k], span[1] / direction[..., k]
            near, far = np.minimum(a, b), np.maximum(a, b)
            face[near > enter] = k
            enter = np.maximum(enter, near)
            leave = np.minimum(leave, far)
        hit = enter < leave
        if y[0] < 0.0 < y[1] and z[0] < 0.0 < z[1]:
            continue  # it would block the view along the corridor
        shade = float(grey.mean()) + spread * (rng.normal(0.0, 1.2) + rng.normal(0.0, 0.5, 3))
        grey[hit] = shade[face[hit]] + 0.15 * spread * rng.standard_normal(int(hit.sum()))


def _paint(
    grey: npt.NDArray[np.float32], place: FloatArray, surface: npt.NDArray[np.int64], rng: np.random.Generator
) -> None:
    """Paint stripes and patches on the surfaces (0 right, 1 left, 2 floor, 3 ceiling, 4 end), in place.

    ``place`` (..., 2) holds the distance along the corridor in metres and across the surface, 0 to 1.
    """
    spread = float(grey.std()) + 1.0
    for _ in range(int(rng.integers(1, 7))):
        on = int(rng.integers(0, 4))
        middle, wide = rng.uniform(0.0, 1.0), float(rng.choice([0.02, 0.06, 0.2])) * rng.uniform(0.4, 1.6)
        start = float(rng.choice([0.0, rng.uniform(0.0, 8.0)]))
        length = float(rng.choice([1.0, 4.0, 100.0])) * rng.uniform(0.4, 1.6)
        both = rng.random() < 0.4 and on < 2
        inside = (np.abs(place[..., 1] - middle) < wide / 2) & (place[..., 0] > start)
        inside &= (place[..., 0] < start + length) & ((surface < 2) if both else (surface == on))
        if rng.random() < 0.5:
            grey[inside] += spread * rng.normal(0.0, 1.0)
        else:
            grey[inside] = grey[inside] * 0.2 + 0.8 * (float(grey.mean()) + spread * rng.normal(0.0, 1.5))


def _shade(
    grey: npt.NDArray[np.float32], place: FloatArray, surface: npt.NDArray[np.int64], rng: np.random.Generator
) -> None:
    """Vary the brightness of each surface, and along and across it, in place."""
    gain = np.exp(rng.normal(0.0, 0.3, 5))
    gain[1] = gain[0] * np.exp(rng.normal(0.0, 0.15))
    along = np.exp(
        rng.normal(0.0, 0.3) * np.sin(place[..., 0] * rng.uniform(0.2, 2.0) + rng.uniform(0, 2 * pi))
    )
    across = np.exp(rng.normal(0.0, 0.25) * (place[..., 1] - 0.5))
    grey *= (gain[surface] * along * across).astype(np.float32)


def _degrade(image: npt.NDArray[np.uint8], rng: np.random.Generator) -> npt.NDArray[np.uint8]:
    """Blur a picture, and change its tone curve, each at random."""
    scale = image.shape[1] / 640.0
    if rng.random() < 0.25:
        sigma_px = float(rng.uniform(0.5, 4.0)) * scale + 0.1
        image = np.asarray(cv2.GaussianBlur(image, (0, 0), sigma_px), np.uint8)
    elif rng.random() < 0.15:
        length = 2 * round(float(rng.uniform(2.0, 25.0)) * scale) + 1
        size = (length, 1) if rng.random() < 0.7 else (1, length)
        image = np.asarray(cv2.blur(image, size), np.uint8)
    if rng.random() < 0.5:
        table = 255.0 * (np.arange(256) / 255.0) ** float(np.exp(rng.normal(0.0, 0.4)))
        image = np.asarray(cv2.LUT(image, np.clip(table + 0.5, 0, 255).astype(np.uint8)), np.uint8)
    return image


def corner_angles(box: Box) -> FloatArray:
    """Return the corners' angles (4,) about the axis: floor right, floor left, ceiling left, ceiling right."""
    across = np.array([box.right, -box.left, -box.left, box.right])
    down = np.array([box.floor, box.floor, -box.ceiling, -box.ceiling])
    return np.asarray(np.arctan2(down, across) % (2.0 * pi), dtype=float)


def _between(first_rad: float, last_rad: float) -> npt.NDArray[np.bool_]:
    return (first_rad < ANGLES) & (last_rad > ANGLES)


def classes_of(corners_rad: FloatArray) -> npt.NDArray[np.int64]:
    """Return the class (N_ANGLES,) of every angle."""
    classes = np.full(N_ANGLES, WALL, np.int64)
    classes[_between(corners_rad[0], corners_rad[1])] = FLOOR
    classes[_between(corners_rad[2], corners_rad[3])] = CEILING
    return classes


def darker_side_left(sample: Sample) -> Sample:
    """Mirror a sample whose left is the brighter side, as in flight: the angle a becomes pi - a."""
    if not is_left_brighter(sample.polar):
        return sample
    return Sample(
        np.ascontiguousarray(sample.polar[:, :, MIRRORED]),
        -sample.offset_norm,
        ((pi - sample.corners_rad) % (2.0 * pi))[[1, 0, 3, 2]],
        sample.classes[MIRRORED],
    )


def draw_sample(view: TrainingView, rng: np.random.Generator, vary: bool = True) -> Sample:
    """Draw one training sample of a view; without ``vary`` only with the measured error of the axis."""
    if vary:
        error = axis_error(view, rng)
    else:
        error = view.R_true @ (view.R_true if view.R_measured is None else view.R_measured).T
    direction = DIRECTIONS @ error.T
    box = view.box
    warp = vary and not view.is_hall and rng.random() < 0.75
    target = random_box_near(box, rng) if warp else box
    reach = _hits(direction, target)
    left, right = np.full(reach.shape, target.left), np.full(reach.shape, target.right)
    is_face = np.zeros(reach.shape, np.bool_)
    if warp and rng.random() < STEP_SHARE:
        step = draw_step(target, rng)
        reach, is_beyond, is_face = _hits_beyond(direction, reach, step)
        left[is_beyond], right[is_beyond] = step.beyond.left, step.beyond.right
    hit = direction * reach[..., None]
    height = target.floor + target.ceiling
    u, v = (hit[..., 1] + left) / (left + right), (hit[..., 2] + target.ceiling) / height
    source = hit
    if warp:
        source = np.stack(
            [
                hit[..., 0] * (box.ahead / target.ahead),
                u * (box.left + box.right) - box.left,
                v * (box.floor + box.ceiling) - box.ceiling,
            ],
            axis=-1,
        )
    points = view.camera.project(source.reshape(-1, 3) @ view.R_true).reshape(*reach.shape, 2)
    image = _degrade(view.image, rng) if vary else view.image
    polar = sample_points(image, points)
    grey = polar[0]
    _shade_faces(grey, direction, is_face, rng)
    if vary:
        edge = np.stack([1.0 - u, u, 1.0 - v, v], axis=-1)
        surface = np.where(hit[..., 0] > 0.999 * target.ahead, 4, edge.argmin(axis=-1))
        place = np.stack([hit[..., 0], np.where(surface < 2, v, u)], axis=-1)
        if rng.random() < 0.4:
            _shade(grey, place, surface, rng)
        if rng.random() < 0.6:
            _paint(grey, place, surface, rng)
        if rng.random() < 0.55 and not view.is_hall:
            _add_boxes(grey, direction, reach, target, rng)
        if rng.random() < 0.5:
            gap = np.hypot(*np.moveaxis(points - np.roll(points, 1, axis=1), -1, 0))
            sigma = float(np.exp(rng.uniform(np.log(0.01), np.log(0.5)))) * float(grey.std())
            grey += sigma / np.maximum(np.nan_to_num(gap, nan=1.0), 1.0) * rng.standard_normal(grey.shape)
        grey *= np.float32(np.exp(rng.uniform(np.log(0.08), 0.2)))
    grey *= polar[1]
    standardise(polar)
    turned = float(np.arccos(np.clip(error[0, 0], -1.0, 1.0)))
    corners = corner_angles(target)
    classes = classes_of(corners)
    if view.is_hall or turned > radians(5.0):
        corners, classes = np.full(4, np.nan), np.full(N_ANGLES, UNKNOWN)
    return darker_side_left(Sample(polar, target.offset_norm, corners, classes))


def draw_sample_without_corridor(rng: np.random.Generator) -> Sample:
    """Draw a sample without a corridor: uniform or noisy, with brightness ramps, random stripes and patches."""
    polar: Polar = np.ones((2, *DIRECTIONS.shape[:2]), np.float32)
    polar[1] = DIRECTIONS[..., 0] * np.hypot(DIRECTIONS[..., 1], DIRECTIONS[..., 2]) < tan(
        rng.uniform(0.4, 1.0)
    )
    shape = polar[0].shape
    grain = float(rng.choice([0.0, 1.0, 4.0, 12.0]))
    noise = rng.standard_normal(shape)
    if grain:
        noise = cv2.GaussianBlur(noise, (0, 0), grain, sigmaY=grain * float(rng.uniform(0.2, 2.0)))
    polar[0] = noise / (noise.std() + 1e-9) * float(rng.choice([0.3, 3.0, 40.0]))
    if rng.random() < 0.4:
        across, down = rng.normal(0.0, 40.0, 2)
        polar[0] += across * DIRECTIONS[..., 1] + down * DIRECTIONS[..., 2]
    for _ in range(int(rng.integers(0, 6))):
        a, n = int(rng.integers(N_ANGLES)), int(rng.integers(1, 50))
        r = int(rng.integers(0, shape[0]))
        rows = slice(None) if rng.random() < 0.5 else slice(r, r + int(rng.integers(2, 14)))
        polar[0][rows, np.arange(a, a + n) % N_ANGLES] += rng.normal(0.0, 30.0)
    polar[0] *= polar[1]
    standardise(polar)
    return darker_side_left(
        Sample(
            polar,
            float(rng.uniform(-MAX_OFFSET_NORM, MAX_OFFSET_NORM)),
            np.full(4, np.nan),
            np.full(N_ANGLES, UNKNOWN),
        )
    )
