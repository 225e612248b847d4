"""From radiance to a camera's 8-bit picture: lens, exposure, noise, tone curve, JPEG."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from fusion.simulate.config import ImagingConfig
from fusion.simulate.render.view import Image, View

Picture = npt.NDArray[np.uint8]


@dataclass(frozen=True, slots=True, eq=False)
class Sensor:
    """A camera's picture chain for one scene.

    Parameters
    ----------
    gain
        Factor on radiance, so that 1 is white.
    vignette
        Share of light that reaches each pixel, (h, w), including the pixels' unequal response.
    offsets
        Fixed offset of each pixel, electrons (h, w).
    """

    config: ImagingConfig
    gain: float
    vignette: Image
    offsets: Image

    @classmethod
    def of(cls, config: ImagingConfig, view: View, mean_radiance: float, seed: int = 0) -> Sensor:
        """Set the gain so that ``mean_radiance`` gets the configured brightness; ``seed`` draws the fixed pattern."""
        axis = view.camera.R_body_camera[:, 2]
        cosine = np.nan_to_num(np.clip(view.corner_rays[:-1, :-1] @ axis, 0.0, 1.0))
        vignette = (1 - config.vignetting) + config.vignetting * cosine**4
        gain = config.brightness / max(mean_radiance, 1e-6)
        rng = np.random.default_rng((seed, 14))
        response, offsets = rng.standard_normal((2, *vignette.shape), dtype=np.float32)
        vignette *= 1 + config.response_std * response
        return cls(config, gain, vignette.astype(np.float32), config.fixed_pattern_electrons * offsets)

    def develop(self, radiance: Image, rng: np.random.Generator) -> Picture:
        """Convert radiance (h, w) to a grey picture, with noise from ``rng``."""
        c = self.config
        light = radiance * (self.gain * self.vignette)
        if c.defocus_px > 0:
            light = cv2.GaussianBlur(light, (0, 0), c.defocus_px)
        if c.bloom > 0:
            light = _bloom(light, c.bloom)
        light = np.minimum(light, 1.0, dtype=np.float32)  # the pixel's well is full
        full_scale = c.full_well_electrons / c.gain
        electrons = light * full_scale
        if c.noise:
            sigma = np.sqrt(electrons + c.read_noise_electrons**2)
            electrons = electrons + sigma * rng.standard_normal(light.shape, dtype=np.float32) + self.offsets
            if c.row_noise_electrons > 0:
                rows = rng.standard_normal((len(light), 1), dtype=np.float32)
                electrons += np.float32(c.row_noise_electrons) * rows
        tone = np.clip(electrons / full_scale, 0.0, 1.0) ** np.float32(1 / c.gamma)
        return np.asarray(np.clip(255.0 * tone * c.contrast + 0.5, 0, 255), np.uint8)


def _bloom(light: Image, share: float) -> Image:
    """Spread a share of the light widely, like the glare of lenses and covers around lamps and windows."""
    h, w = light.shape
    small = cv2.resize(light, (max(8, w // 8), max(8, h // 8)), interpolation=cv2.INTER_AREA)
    wide = cv2.GaussianBlur(small, (0, 0), max(1.0, small.shape[1] / 20))
    return np.asarray((1 - share) * light + share * cv2.resize(wide, (w, h)), np.float32)


def encode_jpeg(picture: Picture, quality: int) -> bytes:
    """JPEG bytes of a picture."""
    return bytes(cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes())


def through_jpeg(picture: Picture, quality: int | None) -> Picture:
    """Return the picture after JPEG compression; None: unchanged."""
    if quality is None:
        return picture
    data = np.frombuffer(encode_jpeg(picture, quality), np.uint8)
    return np.asarray(cv2.imdecode(data, cv2.IMREAD_GRAYSCALE), np.uint8)


def mean_radiance(radiance: Image) -> float:
    """Brightness for automatic exposure: the mean, with lamps and windows limited to four times the median."""
    return float(np.minimum(radiance, 4 * np.median(radiance) + 1e-6).mean())
