"""Steps 1 to 7 of the article's chain: from a picture to straight lines (its sections 3.1 to 3.3).

Source: "Position and heading estimation for indoor navigation of a micro aerial vehicle using vanishing
point". The article names its steps and leaves most parameters to MATLAB. Where it gives none, this module uses
MATLAB's defaults and the usual MATLAB form of the line finder it builds on (Kosecka and Zhang, "Video
Compass", 2002). Each such choice is documented in the docstring of its step; none was tuned on any picture.

Pixels: (0, 0) is the centre of the top-left pixel, x to the right, y down.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, hypot, sqrt

import cv2
import numpy as np
import numpy.typing as npt

from vision.images import to_grey
from vision.types import FloatArray, GreyImage

KERNEL_45_DEGREES = np.array([[-1, -1, 2], [-1, 2, -1], [2, -1, -1]], dtype=np.float32)
SATURATED_FRACTION = 0.01  # imadjust, at each end
EQUALISED_BINS = 64
CANNY_SIGMA_PX = sqrt(2.0)
CANNY_NOT_EDGES = 0.7  # share of the pixels below the high threshold
CANNY_LOW_TO_HIGH = 0.4
CANNY_BINS = 64
ORIENTATION_SIGMA_PX = 1.5
ORIENTATION_BINS = 8  # over pi
MIN_PIXELS_TO_DIAGONAL = 0.025
MIN_EIGENVALUE_RATIO = 400.0
_USED = -1  # bin of a pixel that already belongs to a line


def grey(image: npt.NDArray[np.generic]) -> GreyImage:
    """Step 1, section 3.1: convert a picture (h, w, 3) BGR or (h, w) to luminance (h, w) uint8."""
    return to_grey(image)


def adjust_intensity(image: GreyImage, saturated: float = SATURATED_FRACTION) -> GreyImage:
    """Step 2, section 3.1 "intensity values are adjusted": MATLAB's ``imadjust``.

    The article gives no limits; ``imadjust`` stretches linearly so that 1 % of the pixels saturate at each
    end.

    Parameters
    ----------
    image
        Grey picture (h, w).
    saturated
        Fraction of the pixels to saturate at each end.
    """
    share = np.cumsum(np.bincount(image.ravel(), minlength=256)) / image.size
    low = int(np.argmax(share > saturated))
    high = int(np.argmax(share >= 1.0 - saturated))
    if low == high:  # MATLAB's stretchlim then keeps the full range
        return image.copy()
    stretched = np.clip((np.arange(256) - low) / (high - low), 0.0, 1.0)
    return _look_up(image, stretched)


def equalise_histogram(image: GreyImage, bins: int = EQUALISED_BINS) -> GreyImage:
    """Step 3, section 3 "64-bin image equalisation": MATLAB's ``histeq``.

    Each grey level is mapped to the first of ``bins`` evenly spaced levels whose share of a flat histogram reaches
    the share of pixels below it, with the level's own pixels counted by half (in full at the two extreme levels,
    as in ``histeq``).

    Parameters
    ----------
    image
        Grey picture (h, w).
    bins
        Number of grey levels in the result.
    """
    count = np.bincount(image.ravel(), minlength=256).astype(float)
    tolerance = count / 2
    tolerance[0] = tolerance[-1] = 0.0
    wanted = np.cumsum(count) - tolerance - image.size * sqrt(np.finfo(float).eps)
    flat = np.arange(1, bins + 1) * (image.size / bins)
    level = np.minimum(np.searchsorted(flat, wanted), bins - 1)
    return _look_up(image, level / (bins - 1))


def _look_up(image: GreyImage, share: FloatArray) -> GreyImage:
    """Replace each grey level by its entry in ``share`` (256,), scaled from 0..1 to 0..255."""
    return np.asarray(cv2.LUT(image, np.floor(share * 255.0 + 0.5).astype(np.uint8)), dtype=np.uint8)


def respond_45_degrees(image: GreyImage) -> GreyImage:
    """Step 4, section 3.1: convolve with the 45-degree line kernel.

    The article does not specify how this enters the next step. Its section 3 applies the kernel "before
    determining which pixels are the edges" and finds lines "with a 45-degree orientation", so here the response
    is the input of Canny. (In another reading of section 3.2 the input is the contrast-enhanced picture, which
    leaves the kernel without effect: ``find_lines(..., kernel_feeds_canny=False)``; ``benchmarks/article.py
    --flights`` prints both.) Negative responses become 0, as in MATLAB's ``imfilter`` of uint8, and the
    border is replicated, so that it is not an edge itself. Rows and columns of the kernel sum to zero, which
    removes horizontal and vertical edges.

    Parameters
    ----------
    image
        Contrast-enhanced grey picture (h, w).
    """
    response = cv2.filter2D(image, cv2.CV_8U, KERNEL_45_DEGREES, borderType=cv2.BORDER_REPLICATE)
    return np.asarray(response, dtype=np.uint8)


def detect_edges(image: GreyImage) -> npt.NDArray[np.bool_]:
    """Step 5, section 3.2: Canny's edges with the default thresholds of MATLAB's ``edge``.

    Derivative of a Gaussian with sigma sqrt(2); the high threshold is the 70th percentile of the gradient's
    magnitude by a 64-bin histogram, the low one 0.4 of it. Suppression and hysteresis are OpenCV's, which
    compares the nearest of eight neighbours where MATLAB interpolates between two.

    Parameters
    ----------
    image
        Picture (h, w).

    Returns
    -------
    Edge pixels (h, w).
    """
    gaussian, derivative = _canny_kernels()
    source = image.astype(np.float32)
    gx = cv2.sepFilter2D(source, cv2.CV_32F, derivative, gaussian, borderType=cv2.BORDER_REPLICATE)
    gy = cv2.sepFilter2D(source, cv2.CV_32F, gaussian, derivative, borderType=cv2.BORDER_REPLICATE)
    magnitude: npt.NDArray[np.float32] = np.hypot(gx, gy)
    peak = float(magnitude.max())
    if peak == 0.0:
        return np.zeros(image.shape, dtype=bool)
    high = canny_high_threshold(magnitude / peak)
    full_scale = 32000.0  # cv2.Canny takes gradients as 16-bit integers
    scaled = [np.rint(g * (full_scale / peak)).astype(np.int16) for g in (gx, gy)]
    edges = cv2.Canny(
        scaled[0], scaled[1], CANNY_LOW_TO_HIGH * high * full_scale, high * full_scale, L2gradient=True
    )
    found: npt.NDArray[np.bool_] = edges > 0
    return found


def _canny_kernels() -> tuple[FloatArray, FloatArray]:
    """Return a Gaussian and its derivative, each (17,); each half of the derivative sums to one in magnitude."""
    radius = 4 * ceil(CANNY_SIGMA_PX)
    x = np.arange(-radius, radius + 1)
    gaussian = np.exp(-(x**2) / (2 * CANNY_SIGMA_PX**2))
    gaussian /= gaussian.sum()
    derivative = -np.gradient(gaussian)
    derivative /= derivative[derivative > 0].sum()
    return gaussian, derivative


def canny_high_threshold(magnitude: npt.NDArray[np.floating]) -> float:
    """Part of step 5: 70th percentile of gradient magnitudes in [0, 1], in steps of 1/64, as MATLAB's `edge`."""
    bins = np.rint(magnitude.ravel() * (CANNY_BINS - 1)).astype(np.intp)
    counts = np.bincount(bins, minlength=CANNY_BINS)
    return float(np.argmax(np.cumsum(counts) > CANNY_NOT_EDGES * magnitude.size) + 1) / CANNY_BINS


def orientation_bin(
    image: GreyImage, x: npt.NDArray[np.intp], y: npt.NDArray[np.intp]
) -> npt.NDArray[np.int64]:
    """Part of step 6: direction of the gradient modulo pi at pixels (n,), as the nearest of 8 directions.

    Gradient as in the code of "Video Compass": Gaussian 7x7 with sigma 1.5, then central differences, in the
    picture in which the edges were detected.
    """
    smooth = cv2.GaussianBlur(
        image.astype(np.float32), (7, 7), ORIENTATION_SIGMA_PX, borderType=cv2.BORDER_REPLICATE
    )
    padded = np.pad(smooth, 1, mode="edge")
    gx = padded[y + 1, x + 2] - padded[y + 1, x]
    gy = padded[y + 2, x + 1] - padded[y, x + 1]
    nearest = np.rint(np.arctan2(gy, gx) * (ORIENTATION_BINS / np.pi)).astype(np.int64)
    return np.asarray(nearest % ORIENTATION_BINS, dtype=np.int64)


@dataclass(frozen=True, slots=True, eq=False)
class FittedLines:
    """Straight lines fitted to sets of pixels, every array of length n.

    Parameters
    ----------
    midpoint_px
        Means of the pixels, (n, 2).
    theta_rad
        Equation (3): direction of the line against the x axis, in (-pi/2, pi/2].
    rho_px
        Equation (4) as printed, see `fit_lines`.
    eigenvalue_ratio
        lambda1 / lambda2; infinite for an ideal line, NaN for a single point.
    ends_px
        Starting and ending point of each line, (n, 4) as x0, y0, x1, y1.
    """

    midpoint_px: FloatArray
    theta_rad: FloatArray
    rho_px: FloatArray
    eigenvalue_ratio: FloatArray
    ends_px: FloatArray


def fit_lines(x: npt.ArrayLike, y: npt.ArrayLike, member: npt.NDArray[np.intp], n: int) -> FittedLines:
    """Step 7, section 3.3, equations (1) to (4): fit a line to each of n sets of pixels by eigenvectors.

    Equation (1) is the scatter matrix D of a set about its mean; the eigenvector of its larger eigenvalue is
    the line's direction theta, equation (3). Equation (4) as printed, ``rho = mean_x cos(theta) + mean_y
    sin(theta)``, uses that same theta: it is then the midpoint's coordinate *along* the line, and not, as the
    text states, the line's distance from the origin (that needs theta + pi/2). It is kept as printed; later steps
    do not use it. The end points are the extreme pixels of the set, projected onto the line.

    Parameters
    ----------
    x, y
        Pixel coordinates (m,).
    member
        Number of the set that each pixel belongs to, (m,), in 0..n-1; every set has at least one.
    n
        Number of sets.
    """
    x, y = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
    size = np.bincount(member, minlength=n)
    mean_x = np.bincount(member, x, minlength=n) / size
    mean_y = np.bincount(member, y, minlength=n) / size
    x_tilde, y_tilde = x - mean_x[member], y - mean_y[member]
    scatter = np.empty((n, 2, 2))
    scatter[:, 0, 0] = np.bincount(member, x_tilde**2, minlength=n)
    scatter[:, 1, 1] = np.bincount(member, y_tilde**2, minlength=n)
    scatter[:, 0, 1] = scatter[:, 1, 0] = np.bincount(member, x_tilde * y_tilde, minlength=n)
    eigenvalues, eigenvectors = np.linalg.eigh(scatter)  # ascending
    cos_theta, sin_theta = eigenvectors[:, 0, 1], eigenvectors[:, 1, 1]
    # An eigenvector's sign is arbitrary: choose one half plane, so that theta is unique.
    sign = np.where((cos_theta < 0) | ((cos_theta == 0) & (sin_theta < 0)), -1.0, 1.0)
    cos_theta, sin_theta = sign * cos_theta, sign * sin_theta
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = eigenvalues[:, 1] / np.maximum(eigenvalues[:, 0], 0.0)
    along = x_tilde * cos_theta[member] + y_tilde * sin_theta[member]
    first, last = np.full(n, np.inf), np.full(n, -np.inf)
    np.minimum.at(first, member, along)
    np.maximum.at(last, member, along)
    ends = [mean_x + first * cos_theta, mean_y + first * sin_theta]
    ends += [mean_x + last * cos_theta, mean_y + last * sin_theta]
    return FittedLines(
        midpoint_px=np.column_stack((mean_x, mean_y)),
        theta_rad=np.arctan2(sin_theta, cos_theta),
        rho_px=mean_x * cos_theta + mean_y * sin_theta,
        eigenvalue_ratio=ratio,
        ends_px=np.column_stack(ends),
    )


def connect_edges(image: GreyImage, edges: npt.NDArray[np.bool_]) -> FloatArray:
    """Step 6, section 3.3: edge pixels of one gradient orientation, 8-connected, become lines.

    As in the MATLAB code of "Video Compass": directions in 8 bins over pi, one pass per bin over that bin and its
    two neighbours. A component is a line if its number of pixels is at least 0.025 of the image's diagonal and
    its eigenvalues have a ratio of at least 400; its pixels are removed from the following passes.

    Parameters
    ----------
    image
        The picture that the edges were found in, (h, w).
    edges
        Edge pixels (h, w).

    Returns
    -------
    Starting and ending points (n, 4) as x0, y0, x1, y1.
    """
    height, width = edges.shape
    min_pixels = MIN_PIXELS_TO_DIAGONAL * hypot(height, width)
    y, x = np.nonzero(edges)
    bins = orientation_bin(image, x, y)
    found = [np.empty((0, 4))]
    for k in range(ORIENTATION_BINS):
        in_pass = np.flatnonzero((bins != _USED) & ((bins - k + 1) % ORIENTATION_BINS <= 2))
        mask = np.zeros(edges.shape, dtype=np.uint8)
        mask[y[in_pass], x[in_pass]] = 1
        count, label_image = cv2.connectedComponents(mask, connectivity=8)
        label = label_image[y[in_pass], x[in_pass]]
        large = np.bincount(label, minlength=count) >= min_pixels
        large[0] = False  # the background
        n = int(large.sum())
        if n == 0:
            continue
        number = np.cumsum(large) - 1
        pixels, member = in_pass[large[label]], number[label[large[label]]]
        lines = fit_lines(x[pixels], y[pixels], member, n)
        straight = lines.eigenvalue_ratio >= MIN_EIGENVALUE_RATIO
        bins[pixels[straight[member]]] = _USED
        found.append(lines.ends_px[straight])
    return np.concatenate(found)


def find_lines(image: npt.NDArray[np.generic], kernel_feeds_canny: bool = True) -> FloatArray:
    """Run steps 1 to 7: from a picture to lines (n, 4) as x0, y0, x1, y1 in pixels.

    Parameters
    ----------
    image
        Picture (h, w), or (h, w, 3) BGR.
    kernel_feeds_canny
        False omits step 4, the other reading of the article, see `respond_45_degrees`.
    """
    enhanced = equalise_histogram(adjust_intensity(grey(image)))
    edge_source = respond_45_degrees(enhanced) if kernel_feeds_canny else enhanced
    return connect_edges(edge_source, detect_edges(edge_source))
