"""Ways to spoil a picture, or what is said about it, without changing what is right.

Each takes a `Case` and a random generator and returns another case. Those named ``*_picture`` work on the picture
alone. Strengths are in pixels of the picture given and in grey levels of 255.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from math import cos, pi, radians, sin, sqrt

import cv2
import numpy as np
import numpy.typing as npt

from vision import Attitude, Camera
from vision.images import GreyImage

from .cases import Case

FloatArray = npt.NDArray[np.float64]
Perturbation = Callable[[Case, np.random.Generator], Case]

GAMMA = 2.2
FULL_WELL_ELECTRONS = 12000.0
READ_NOISE_ELECTRONS = 6.0
COVERED_SHARE = 0.20
READOUT_S = 0.020  # from the first row to the last of a rolling shutter
TURN_RATE_RAD_S = radians(60.0)


def unchanged(case: Case, rng: np.random.Generator) -> Case:
    """Leave a case as it is."""
    return case


def with_noise(std: float) -> Perturbation:
    """Add white noise of so many grey levels."""
    return _on_picture(lambda image, rng: _as_grey(image + rng.normal(0.0, std, image.shape)))


def with_light(share: float) -> Perturbation:
    """Let in a share of the light: photons and read noise stay those of the sensor, then gamma 2.2."""
    return _on_picture(lambda image, rng: exposed_picture(image, share, rng))


def exposed_picture(image: GreyImage, share: float, rng: np.random.Generator) -> GreyImage:
    """Expose a picture anew with a share of the light, with a sensor's noise."""
    light = np.minimum((image / 255.0) ** GAMMA * share, 1.0)
    electrons = light * FULL_WELL_ELECTRONS
    if share < 1.0:  # with more light the picture's own noise outdoes what would be added
        sigma = np.sqrt(electrons + READ_NOISE_ELECTRONS**2)
        electrons = electrons + sigma * rng.standard_normal(image.shape)
    return _as_grey(255.0 * np.clip(electrons / FULL_WELL_ELECTRONS, 0.0, 1.0) ** (1.0 / GAMMA))


def with_grey_scaled(share: float, noise: float) -> Perturbation:
    """Scale the grey levels themselves, and add noise: far darker than that share of the light."""
    return _on_picture(lambda image, rng: _as_grey(image * share + rng.normal(0.0, noise, image.shape)))


def with_defocus(std_px: float) -> Perturbation:
    """Blur by a Gaussian."""
    return _on_picture(lambda image, _: np.asarray(cv2.GaussianBlur(image, (0, 0), std_px), np.uint8))


def with_motion_blur(length_px: float) -> Perturbation:
    """Smear along a line: level for even frames, as a yawing camera does, in any direction for odd ones."""

    def smear(case: Case, rng: np.random.Generator) -> Case:
        angle = 0.0 if case.index % 2 == 0 else float(rng.uniform(0.0, pi))
        kernel = motion_kernel(length_px, angle)
        blurred = cv2.filter2D(case.image, -1, kernel, borderType=cv2.BORDER_REPLICATE)
        return replace(case, image=np.asarray(blurred, np.uint8))

    return smear


def motion_kernel(length_px: float, angle_rad: float) -> npt.NDArray[np.float32]:
    """Weights (k, k), k odd, of a straight smear of this length, sampled finer than the pixels."""
    half = int(np.ceil(length_px / 2)) + 1
    kernel = np.zeros((2 * half + 1, 2 * half + 1))
    for t in (np.arange(round(20 * length_px)) + 0.5) / round(20 * length_px) - 0.5:
        x, y = half + t * length_px * cos(angle_rad), half + t * length_px * sin(angle_rad)
        i, j = int(np.floor(x)), int(np.floor(y))
        kernel[j : j + 2, i : i + 2] += np.outer([1 - (y - j), y - j], [1 - (x - i), x - i])
    return np.asarray(kernel / kernel.sum(), np.float32)


def with_jpeg(quality: int) -> Perturbation:
    """Return a perturbation that compresses pictures at a JPEG quality."""

    def compress(image: GreyImage, _: np.random.Generator) -> GreyImage:
        data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
        return np.asarray(cv2.imdecode(data, cv2.IMREAD_GRAYSCALE), np.uint8)

    return _on_picture(compress)


def with_cover(share: float = COVERED_SHARE) -> Perturbation:
    """Hide a part behind a plain rectangle of any grey: upright for even frames, askew for odd ones."""

    def cover(case: Case, rng: np.random.Generator) -> Case:
        hidden = cover_mask(case.image.shape[:2], share, case.index % 2 == 1, rng)
        image = case.image.copy()
        image[hidden] = rng.integers(0, 256)
        return replace(case, image=image)

    return cover


def cover_mask(
    shape: tuple[int, ...], share: float, askew: bool, rng: np.random.Generator
) -> npt.NDArray[np.bool_]:
    """Mask (h, w) of a rectangle, wholly inside the picture, that hides this share of it."""
    height, width = shape
    area = share * height * width
    while True:
        aspect = float(np.exp(rng.uniform(-0.5, 0.5)))
        a, b = sqrt(area * aspect), sqrt(area / aspect)
        turn = float(rng.uniform(0.0, pi)) if askew else 0.0
        c, s = cos(turn), sin(turn)
        reach_x, reach_y = (abs(a * c) + abs(b * s)) / 2, (abs(a * s) + abs(b * c)) / 2
        if 2 * reach_x < width and 2 * reach_y < height:
            break
    x0, y0 = rng.uniform(reach_x, width - reach_x), rng.uniform(reach_y, height - reach_y)
    y, x = np.mgrid[0:height, 0:width] + 0.5
    along, across = (x - x0) * c + (y - y0) * s, -(x - x0) * s + (y - y0) * c
    return np.asarray((np.abs(along) < a / 2) & (np.abs(across) < b / 2), np.bool_)


def with_rolling_shutter(case: Case, rng: np.random.Generator) -> Case:
    """Skew the picture as a rolling shutter does while the vehicle yaws, now right, now left.

    Rows shift in proportion to their distance from the middle row, whose moment the truth is of.
    """
    rate = TURN_RATE_RAD_S if case.index % 2 == 0 else -TURN_RATE_RAD_S
    return replace(case, image=skewed_picture(case.image, case.camera.fx_px * rate * READOUT_S))


def skewed_picture(image: GreyImage, total_px: float) -> GreyImage:
    """Shift the bottom row left of the top row by ``total_px``: the scene moves left while the camera turns right."""
    height, width = image.shape
    # Row y shows at x what the middle row's moment had at x + shift.
    slope = total_px / (height - 1)
    matrix = np.array([[1.0, slope, -slope * (height - 1) / 2], [0.0, 1.0, 0.0]])
    flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
    return np.asarray(
        cv2.warpAffine(image, matrix, (width, height), flags=flags, borderMode=cv2.BORDER_REPLICATE), np.uint8
    )


def with_roll(limit_rad: float) -> Perturbation:
    """Roll the vehicle, the picture with it; a narrower field keeps the picture's corners filled."""

    def roll(case: Case, rng: np.random.Generator) -> Case:
        angle = float(rng.uniform(-limit_rad, limit_rad))
        image, camera = rolled_picture(case.image, case.camera, angle)
        a = case.attitude
        attitude = None if a is None else Attitude(a.roll_rad + angle, a.pitch_rad, a.std_rad)
        return replace(case, image=image, camera=camera, attitude=attitude)

    return roll


def rolled_picture(image: GreyImage, camera: Camera, roll_rad: float) -> tuple[GreyImage, Camera]:
    """Picture that the same lens, its focal length made longer, takes when the body has rolled by an angle."""
    h, w = camera.height_px, camera.width_px
    longer = 1.05 * (cos(roll_rad) + max(w / h, h / w) * abs(sin(roll_rad)))
    zoomed = replace(camera, fx_px=camera.fx_px * longer, fy_px=camera.fy_px * longer)
    y, x = np.mgrid[0:h, 0:w].astype(float)
    rays = zoomed.rays(np.column_stack([x.ravel(), y.ravel()]))
    c, s = cos(roll_rad), sin(roll_rad)
    R_old_new = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])  # about the body's x axis
    R = camera.R_body_camera.T @ R_old_new @ camera.R_body_camera
    points = camera.project(rays @ R.T).reshape(h, w, 2).astype(np.float32)
    moved = cv2.remap(image, points[..., 0], points[..., 1], cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(moved, np.uint8), zoomed


def with_tilt_error(error_rad: float) -> Perturbation:
    """Give a roll and pitch that are off by an angle about any level axis, with the sigma left as it was."""

    def tilt(case: Case, rng: np.random.Generator) -> Case:
        a, way = case.attitude, float(rng.uniform(0.0, 2 * pi))
        if a is None:
            return case
        roll, pitch = a.roll_rad + error_rad * cos(way), a.pitch_rad + error_rad * sin(way)
        return replace(case, attitude=Attitude(roll, pitch, a.std_rad))

    return tilt


def with_focal_error(share: float) -> Perturbation:
    """Give a focal length that is off: too long for even frames, too short for odd ones."""

    def zoom(case: Case, rng: np.random.Generator) -> Case:
        factor = 1.0 + (share if case.index % 2 == 0 else -share)
        camera = replace(case.camera, fx_px=case.camera.fx_px * factor, fy_px=case.camera.fy_px * factor)
        return replace(case, camera=camera)

    return zoom


def _on_picture(change: Callable[[GreyImage, np.random.Generator], GreyImage]) -> Perturbation:
    return lambda case, rng: replace(case, image=change(case.image, rng))


def _as_grey(values: npt.NDArray[np.floating]) -> GreyImage:
    return np.clip(np.round(values), 0, 255).astype(np.uint8)


#: What is done to the pictures of flights and of the simulator alike, by name; the first leaves them alone.
ON_PICTURES: dict[str, Perturbation] = {
    "none": unchanged,
    "noise 5": with_noise(5.0),
    "noise 10": with_noise(10.0),
    "15 % of the light": with_light(0.15),
    "15 % of the grey": with_grey_scaled(0.15, 1.5),
    "over-exposed 4 times": with_light(4.0),
    "defocus 2 px": with_defocus(2.0),
    "defocus 4 px": with_defocus(4.0),
    "motion blur 6 px": with_motion_blur(6.0),
    "motion blur 15 px": with_motion_blur(15.0),
    "jpeg 30": with_jpeg(30),
    "20 % covered": with_cover(),
    "rolling shutter": with_rolling_shutter,
    "roll to 20 deg": with_roll(radians(20.0)),
    "tilt off by 3 deg": with_tilt_error(radians(3.0)),
    "focal off by 2 %": with_focal_error(0.02),
}
