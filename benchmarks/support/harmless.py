"""Changes of a picture that leave the corridor as it was: what is measured should not change either.

Each takes a `Case` and returns it with the picture changed, and with the camera, the attitude and what is right
changed to match.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np

from vision import Attitude, Camera
from vision.cameras.camera import Distortion
from vision.images import GreyImage

from .cases import Case
from .perturb import exposed_picture

JPEG_QUALITY = 92
SHIFT_PX = 0.5
SCALE = 0.9
LIGHT = 0.25

Change = Callable[[Case], Case]


def encoded_again(case: Case) -> Case:
    """Compress the picture as JPEG of quality 92."""
    data = cv2.imencode(".jpg", case.image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1]
    return replace(case, image=np.asarray(cv2.imdecode(data, cv2.IMREAD_GRAYSCALE), np.uint8))


def shifted(case: Case) -> Case:
    """Move the picture half a pixel right and down, and the principal point with it."""
    matrix = np.array([[1.0, 0.0, SHIFT_PX], [0.0, 1.0, SHIFT_PX]])
    size = (case.camera.width_px, case.camera.height_px)
    image = cv2.warpAffine(case.image, matrix, size, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    camera = replace(case.camera, cx_px=case.camera.cx_px + SHIFT_PX, cy_px=case.camera.cy_px + SHIFT_PX)
    return replace(case, image=np.asarray(image, np.uint8), camera=camera)


def mirrored(case: Case) -> Case:
    """Swap left and right: heading, offset and roll change their sign."""
    a = case.attitude
    return replace(
        case,
        image=np.ascontiguousarray(case.image[:, ::-1]),
        camera=mirrored_camera(case.camera),
        attitude=None if a is None else Attitude(-a.roll_rad, a.pitch_rad, a.std_rad),
        headings_rad=tuple(-h for h in case.headings_rad),
        offset_norm=-case.offset_norm,
    )


def mirrored_camera(camera: Camera) -> Camera:
    """Return the camera that takes another's pictures with left and right swapped."""
    coefficients = list(camera.coefficients)
    if camera.distortion is Distortion.RADTAN and len(coefficients) > 3:
        coefficients[3] = -coefficients[3]  # p2, the tangential coefficient that is odd in x
    # Mirrored are both the optical frame's x and the body's y.
    R_body_camera = np.diag([1.0, -1.0, 1.0]) @ camera.R_body_camera @ np.diag([-1.0, 1.0, 1.0])
    return replace(
        camera,
        cx_px=camera.width_px - 1 - camera.cx_px,
        coefficients=tuple(coefficients),
        R_body_camera=R_body_camera,
    )


def scaled_down(case: Case) -> Case:
    """Scale the picture, and the camera with it, to nine tenths of its size."""
    size = (round(SCALE * case.camera.width_px), round(SCALE * case.camera.height_px))
    image = cv2.resize(case.image, size, interpolation=cv2.INTER_AREA)
    return replace(case, image=np.asarray(image, np.uint8), camera=case.camera.resized(*size))


def darkened(case: Case) -> Case:
    """Leave a quarter of the light, with the noise of the sensor's photons and of reading it."""
    return replace(case, image=dark_picture(case.image, case.index))


def dark_picture(image: GreyImage, seed: int) -> GreyImage:
    """Darken a picture as with little light, noise and all."""
    return exposed_picture(image, LIGHT, np.random.default_rng((seed, 92)))


#: By name, with the sign that heading and offset take.
HARMLESS: dict[str, tuple[Change, float]] = {
    "JPEG 92": (encoded_again, 1.0),
    "half a pixel": (shifted, 1.0),
    "mirrored": (mirrored, -1.0),
    "scaled by 0.9": (scaled_down, 1.0),
    "a quarter of the light": (darkened, 1.0),
}
