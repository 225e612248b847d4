"""Conversion of picture files and arrays to grey 8-bit images, the input of all measurements."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from vision.errors import InputError
from vision.limits import MAX_PIXELS, check_is_file, check_pixels
from vision.types import GreyImage as GreyImage


def read_image(path: str | Path) -> GreyImage:
    """Read a picture file as grey uint8 (h, w).

    Colours are converted to luminance, 16 bits are scaled to 8, and EXIF's rotation is applied.

    Parameters
    ----------
    path
        A JPEG, PNG or other file that OpenCV decodes.

    Returns
    -------
    ndarray
        Grey uint8 (h, w), the upright picture.

    Raises
    ------
    InputError
        If the file is missing, empty, too large, or does not decode.
    """
    path = Path(path)
    try:
        check_is_file(path)
        data = np.fromfile(path, dtype=np.uint8)  # imread prints to stderr and cannot read some paths
    except OSError as error:
        reason = (
            "there is no such picture" if isinstance(error, FileNotFoundError) else f"cannot be read: {error}"
        )
        raise InputError(reason, file=path, remedy="check the path and its permissions") from error
    try:
        return decode_image(data)
    except InputError as error:
        raise InputError(error.problem, file=path, remedy=error.remedy) from error


def decode_image(data: npt.NDArray[np.uint8]) -> GreyImage:
    """Decode a picture file's bytes (n,) as grey uint8 (h, w).

    Raises
    ------
    InputError
        Where they do not decode.
    """
    return to_grey(decode_grey(data))


def decode_grey(data: npt.NDArray[np.uint8]) -> npt.NDArray[Any]:
    """Decode a picture file's bytes (n,) as grey (h, w), in its own bit depth.

    Raises
    ------
    InputError
        Where they do not decode, or the picture is too large.
    """
    import cv2

    image = None
    if data.size and not _is_cut_jpeg(data.tobytes()) and _has_size(data.tobytes()):
        try:
            image = cv2.imdecode(data, cv2.IMREAD_ANYDEPTH | cv2.IMREAD_GRAYSCALE)
        except cv2.error:
            image = None
    if image is None:
        if is_heic(data[:12].tobytes()):
            raise InputError("picture is HEIC, which is not supported", remedy="convert it to JPEG")
        raise InputError(
            f"picture does not decode ({data.size} bytes)", remedy="give a whole JPEG, PNG or similar"
        )
    return np.asarray(image)


def is_heic(head: bytes) -> bool:
    """Whether a file's first 12 bytes are those of a HEIC picture, as phones take them."""
    return head[4:8] == b"ftyp" and head[8:12] in (b"heic", b"heix", b"mif1")


def _has_size(data: bytes) -> bool:
    """Whether a picture's header contains its size; raise `InputError` where it is too large."""
    from PIL import Image

    try:
        size = Image.open(BytesIO(data)).size
    except Image.DecompressionBombError as error:
        problem = f"picture has too many pixels: at most {MAX_PIXELS // 1_000_000} million"
        raise InputError(problem, remedy="scale it down") from error
    except Exception:  # Pillow's readers raise many types
        return False
    check_pixels(*size)
    return True


def _is_cut_jpeg(data: bytes) -> bool:
    """Whether a JPEG lacks its end marker; OpenCV 4.10 fills the missing part with grey without a warning."""
    if not data.startswith(b"\xff\xd8"):
        return False
    # An embedded thumbnail has an end marker of its own, near the beginning.
    return data.rfind(b"\xff\xd9") < len(data) // 2


def to_grey(image: npt.NDArray[Any]) -> GreyImage:
    """Convert a grey, BGR or BGRA array, uint8 or uint16, to contiguous grey uint8 (h, w).

    16-bit values are divided by 256, even where only 10 or 12 bits are used.

    Raises
    ------
    InputError
        For any other type or shape.
    """
    image = np.asarray(image)
    shape_ok = image.ndim == 2 or (image.ndim == 3 and image.shape[2] in (1, 3, 4))
    if not shape_ok or 0 in image.shape:
        raise InputError(
            f"image has shape {image.shape}",
            remedy="give (height, width), or (height, width, 3 or 4) as BGR or BGRA",
        )
    if image.dtype == np.uint16:
        image = (image >> 8).astype(np.uint8)
    elif image.dtype != np.uint8:
        raise InputError(f"image is of type {image.dtype}", remedy="give uint8 or uint16")
    if image.ndim == 3:
        if image.shape[2] == 1:
            image = image[:, :, 0]
        else:
            import cv2

            code = cv2.COLOR_BGR2GRAY if image.shape[2] == 3 else cv2.COLOR_BGRA2GRAY
            image = cv2.cvtColor(np.ascontiguousarray(image), code)
    return np.ascontiguousarray(image)
