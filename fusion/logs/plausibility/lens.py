"""Checks a calibration's distortion by a flight's pictures: straight edges of a building must be straight."""

from __future__ import annotations

import numpy as np

from fusion.flight import FrameStream, GreyImage
from fusion.logs.plausibility.findings import Finding, Severity
from vision import Camera, InputError

N_PICTURES = 8  # spread over the flight


def examine_lens(frames: FrameStream, camera: Camera) -> Finding | None:
    """Return what a few pictures show of a wrong distortion; None if they show none.

    Parameters
    ----------
    frames
        The flight's pictures; those that cannot be decoded, or are not of the calibration's size, are left out.
    camera
        Their calibration.
    """
    from vision.lines.straightness import check_distortion  # loads the compiled line finder

    count = len(frames.t_ns)
    images: list[GreyImage] = []
    for index in np.unique(np.linspace(0, count - 1, min(N_PICTURES, count)).astype(int)):
        try:
            image = frames.read(int(index))
        except InputError:
            continue
        if image.shape == (camera.height_px, camera.width_px):
            images.append(image)
    error = check_distortion(images, camera) if images else None
    if error is None:
        return None
    direction = "outwards" if error.corner_share > 0.0 else "inwards"
    return Finding(
        Severity.WARNING,
        "camera",
        "distortion",
        "straight edges are not straight with the calibration's distortion: the picture's corners should be "
        f"{100.0 * abs(error.corner_share):.0f} +- {100.0 * max(error.std, 0.01):.0f} % further {direction}",
        "check the distortion model and its coefficients, and that both pictures and calibration are of the raw "
        "pictures, or both of the rectified ones",
    )
