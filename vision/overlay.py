"""Drawing of a measured frame: its lines, vanishing point and corners, and the result with the reason.

Lines are drawn in the original, distorted picture; the footer shows the corridor from above and the result in words.
The colours are those of Okabe and Ito, which colour-blind readers can distinguish, with dark outlines so that they
are visible on bright walls.
"""

from __future__ import annotations

from math import cos, degrees, hypot, isfinite, sin

import cv2
import numpy as np
import numpy.typing as npt

from vision.cameras.camera import Camera
from vision.errors import InputError
from vision.measurement import REASON_MEANING, FrameMeasurement, LineClass, Position, Reason
from vision.types import ColourImage, FloatArray

Colour = tuple[int, int, int]

OUTLINE: Colour = (20, 20, 20)
BACKGROUND: Colour = (32, 28, 26)
FOREGROUND: Colour = (238, 238, 238)
FAINT: Colour = (165, 160, 155)
YES: Colour = (233, 180, 86)
NO: Colour = (60, 130, 255)
WALL: Colour = (66, 228, 240)
VANISHING_POINT: Colour = (255, 255, 255)
CLASS_COLOUR: dict[LineClass, Colour] = {
    LineClass.REJECTED: (178, 178, 178),
    LineClass.CORRIDOR: (233, 180, 86),
    LineClass.TRANSVERSE: (0, 159, 230),
    LineClass.VERTICAL: (190, 130, 225),
}

_SHIFT = 4  # cv2 draws in sixteenths of a pixel
_SIGMAS = 2.0


def overlay_scale(width_px: int) -> int:
    """Return the factor by which `draw_overlay` enlarges a picture of this width: to about 640 pixels, at least 1.

    Pixel x is mapped to ``(x + 0.5) * scale - 0.5``.
    """
    return max(1, round(640 / width_px))


def draw_overlay(
    image: npt.NDArray[np.generic], camera: Camera, measurement: FrameMeasurement, *, footer: bool = True
) -> ColourImage:
    """Draw a measurement over its picture, with a footer below it.

    Parameters
    ----------
    image
        The frame, grey (h, w) or BGR or BGRA (h, w, 3 or 4), uint8 or uint16; it is not modified.
    camera
        The measurement's camera; for a picture of another size the drawing is scaled.
    measurement
        Its ``lines_px`` and ``wall_lines_px`` are drawn if present.
    footer
        Whether to add the footer: the corridor from above, and the result in words.

    Returns
    -------
    ndarray
        BGR uint8. The picture, enlarged by `overlay_scale`, fills the top.

    Raises
    ------
    InputError
        Where the array is not a picture.
    """
    canvas = _to_bgr(image)
    height, width = canvas.shape[:2]
    scale = overlay_scale(width)
    if scale > 1:
        size = (width * scale, height * scale)
        canvas = np.asarray(cv2.resize(canvas, size, interpolation=cv2.INTER_CUBIC), dtype=np.uint8)
    to_canvas = _Mapping(scale * width / camera.width_px, scale * height / camera.height_px)
    unit = canvas.shape[1] / 640.0  # stroke widths and font size grow with the picture
    _draw_lines(canvas, to_canvas, measurement, unit)
    _draw_principal_point(canvas, to_canvas.points([(camera.cx_px, camera.cy_px)])[0], unit)
    _draw_vanishing_point(canvas, to_canvas, measurement, unit)
    return np.vstack([canvas, _footer(canvas.shape[1], measurement)]) if footer else canvas


def _to_bgr(image: npt.NDArray[np.generic]) -> ColourImage:
    if image.dtype == np.uint16:
        top = max(int(image.max(initial=1)), 1)  # 10 and 12 bit cameras leave the upper bits empty
        image = (image.astype(np.float32) * (255.0 / top)).astype(np.uint8)
    if image.dtype != np.uint8 or image.ndim not in (2, 3) or 0 in image.shape:
        raise InputError(
            f"an array of shape {image.shape} and type {image.dtype} is not a picture",
            remedy="give grey (h, w), BGR (h, w, 3) or BGRA (h, w, 4) in uint8 or uint16",
        )
    planes = np.asarray(image, dtype=np.uint8).reshape(*image.shape[:2], -1)
    if planes.shape[2] not in (1, 3, 4):
        raise InputError(
            f"a picture of {planes.shape[2]} channels cannot be drawn", remedy="give 1, 3 or 4 channels"
        )
    return np.repeat(planes, 3, axis=2) if planes.shape[2] == 1 else planes[:, :, :3].copy()


class _Mapping:
    """Mapping from camera pixels to canvas pixels, both with (0, 0) at the centre of the top-left pixel."""

    def __init__(self, sx: float, sy: float) -> None:
        self.scale = np.array([sx, sy])

    def points(self, points_px: npt.ArrayLike) -> FloatArray:
        """Map points (..., 2)."""
        return np.asarray((np.asarray(points_px, dtype=np.float64) + 0.5) * self.scale - 0.5)

    def lines(self, lines_px: npt.NDArray[np.float32]) -> FloatArray:
        """Map lines (n, 4), x0, y0, x1, y1, to (n, 2, 2)."""
        return self.points(np.asarray(lines_px, dtype=np.float64).reshape(-1, 2, 2))


def _fixed_point(points: FloatArray) -> npt.NDArray[np.int32]:
    # Clip far points: cv2's fixed-point coordinates overflow beyond 2^27.
    return np.asarray(np.round(np.clip(points, -2e4, 2e4) * (1 << _SHIFT)), dtype=np.int32)


def _stroke(
    canvas: ColourImage, points: FloatArray, colour: Colour, width: float, *, closed: bool = False
) -> None:
    if np.all(np.isfinite(points)):
        cv2.polylines(
            canvas, [_fixed_point(points)], closed, colour, max(1, round(width)), cv2.LINE_AA, _SHIFT
        )


def _stroke_with_outline(
    canvas: ColourImage, points: FloatArray, colour: Colour, width: float, *, closed: bool = False
) -> None:
    _stroke(canvas, points, OUTLINE, max(round(1.8 * width), round(width) + 2), closed=closed)
    _stroke(canvas, points, colour, width, closed=closed)


def _draw_lines(canvas: ColourImage, to_canvas: _Mapping, measurement: FrameMeasurement, unit: float) -> None:
    if measurement.lines_px is not None:
        lines = to_canvas.lines(measurement.lines_px)
        classes = measurement.line_class
        if classes is None:
            classes = np.zeros(len(lines), dtype=np.int8)
        # The most important class is drawn last.
        for kind in (LineClass.REJECTED, LineClass.VERTICAL, LineClass.TRANSVERSE, LineClass.CORRIDOR):
            for line in lines[classes == kind]:
                if kind is LineClass.REJECTED:
                    _stroke(canvas, line, CLASS_COLOUR[kind], unit)
                else:
                    _stroke_with_outline(canvas, line, CLASS_COLOUR[kind], 1.6 * unit)
    if measurement.wall_lines_px is not None:
        for line in to_canvas.lines(measurement.wall_lines_px):
            _stroke_with_outline(canvas, line, WALL, 3.4 * unit)


def _draw_principal_point(canvas: ColourImage, centre: FloatArray, unit: float) -> None:
    for step in ((6.0 * unit, 0.0), (0.0, 6.0 * unit)):
        _stroke_with_outline(canvas, np.array([centre - step, centre + step]), FAINT, unit)


def _draw_vanishing_point(
    canvas: ColourImage, to_canvas: _Mapping, measurement: FrameMeasurement, unit: float
) -> None:
    height, width = canvas.shape[:2]
    middle = np.array([(width - 1) / 2.0, (height - 1) / 2.0])
    point = to_canvas.points(measurement.vp_px)
    if not np.all(np.isfinite(point)):
        if isfinite(measurement.heading_rad) and measurement.heading_rad != 0.0:
            # Outside the lens model's range only the side is known: left of the picture if turned right.
            _draw_border_arrow(canvas, np.array([-np.sign(measurement.heading_rad), 0.0]), unit)
        return
    cov = np.asarray(measurement.vp_cov_px2, dtype=np.float64) * np.outer(to_canvas.scale, to_canvas.scale)
    if np.all(np.isfinite(cov)):
        values, vectors = np.linalg.eigh(cov)
        turn = np.linspace(0.0, 2.0 * np.pi, 72, endpoint=False)
        circle = np.stack([np.cos(turn), np.sin(turn)], axis=1)
        ellipse = point + _SIGMAS * (circle * np.sqrt(np.maximum(values, 0.0))) @ vectors.T
        _stroke_with_outline(canvas, ellipse, VANISHING_POINT, 1.2 * unit, closed=True)
    if -0.5 <= point[0] <= width - 0.5 and -0.5 <= point[1] <= height - 0.5:
        for angle in np.radians((45.0, 135.0, 225.0, 315.0)):
            ray = np.array([cos(angle), sin(angle)])
            _stroke_with_outline(
                canvas, np.array([point + 5 * unit * ray, point + 14 * unit * ray]), VANISHING_POINT, 2 * unit
            )
        _stroke_with_outline(canvas, np.array([point, point]), VANISHING_POINT, 2 * unit)
    else:
        _draw_border_arrow(canvas, point - middle, unit)


def _draw_border_arrow(canvas: ColourImage, direction: FloatArray, unit: float) -> None:
    """Draw an arrow whose tip touches the picture's border in a direction (x, y) from its centre."""
    height, width = canvas.shape[:2]
    middle = np.array([(width - 1) / 2.0, (height - 1) / 2.0])
    reach = middle - 3.0 * unit
    ahead = direction / hypot(*direction)
    tip = middle + ahead * np.min(reach / np.maximum(np.abs(ahead), 1e-9))
    across = np.array([-ahead[1], ahead[0]])
    back = tip - 16.0 * unit * ahead
    _stroke_with_outline(canvas, np.array([tip - 44.0 * unit * ahead, tip]), VANISHING_POINT, 2.4 * unit)
    _stroke_with_outline(
        canvas,
        np.array([back + 8.0 * unit * across, tip, back - 8.0 * unit * across]),
        VANISHING_POINT,
        2.4 * unit,
    )


def _footer(width_px: int, measurement: FrameMeasurement) -> ColourImage:
    unit = width_px / 640.0
    height = round(112 * unit)
    footer = np.full((height, width_px, 3), BACKGROUND, dtype=np.uint8)
    _draw_from_above(footer, measurement, left=10 * unit, side=92 * unit, top=10 * unit, unit=unit)
    x, room = 122 * unit, width_px - 132 * unit
    used = measurement.accepted
    words = REASON_MEANING[measurement.reason]
    verdict = "accepted" if used and measurement.reason is Reason.OK else f"rejected: {words}"
    _text(footer, verdict, x, 29 * unit, 19 * unit, YES if used else NO, room)
    _text(footer, _heading_text(measurement), x, 53 * unit, 15.5 * unit, FOREGROUND, room)
    _text(footer, _offset_text(measurement), x, 74 * unit, 15.5 * unit, FOREGROUND, room)
    _legend(footer, measurement, x, 99 * unit, unit)
    return footer


def _heading_text(m: FrameMeasurement) -> str:
    if not isfinite(m.heading_rad):
        return "heading unknown"
    side = "right" if m.heading_rad >= 0 else "left"
    sigma = f", sigma {degrees(m.heading_std_rad):.2f}" if isfinite(m.heading_std_rad) else ""
    return f"heading {abs(degrees(m.heading_rad)):.2f} deg {side}{sigma}"


def _offset_text(m: FrameMeasurement) -> str:
    if not isfinite(m.lateral_offset_norm):
        return "offset unknown" if m.position is None else f"{m.position} of the corridor"
    side = "right" if m.lateral_offset_norm >= 0 else "left"
    sigma = f", sigma {m.lateral_offset_norm_std:.3f}" if isfinite(m.lateral_offset_norm_std) else ""
    place = "" if m.position in (None, Position(side)) else f" ({m.position})"
    return f"offset {abs(m.lateral_offset_norm):.3f} half widths {side}{place}{sigma}"


def _legend(footer: ColourImage, m: FrameMeasurement, x: float, y: float, unit: float) -> None:
    keys: list[tuple[str, Colour]] = []
    if m.lines_px is not None:
        keys = [
            (f"corridor ({m.n_inliers})", CLASS_COLOUR[LineClass.CORRIDOR]),
            ("across", CLASS_COLOUR[LineClass.TRANSVERSE]),
            ("upright", CLASS_COLOUR[LineClass.VERTICAL]),
            ("other", CLASS_COLOUR[LineClass.REJECTED]),
        ]
    if m.wall_lines_px is not None and len(m.wall_lines_px):
        keys.append(("both walls", WALL))
    for word, colour in keys:
        _stroke(footer, np.array([(x, y - 4 * unit), (x + 14 * unit, y - 4 * unit)]), colour, 3 * unit)
        x = _text(footer, word, x + 19 * unit, y, 13 * unit, FAINT, footer.shape[1] - x) + 13 * unit


def _text(
    footer: ColourImage, text: str, x: float, y: float, size: float, colour: Colour, room: float
) -> float:
    """Draw text on a base line, capitals ``0.7 * size`` high, smaller where there is no room; return its end x."""
    face, thickness = cv2.FONT_HERSHEY_SIMPLEX, max(1, round(size / 15))
    scale = 0.7 * size / cv2.getTextSize("H", face, 1.0, 1)[0][1]
    (length, _), _ = cv2.getTextSize(text, face, scale, thickness)
    if length > room:
        scale *= room / length
        (length, _), _ = cv2.getTextSize(text, face, scale, thickness)
    cv2.putText(footer, text, (round(x), round(y)), face, scale, colour, thickness, cv2.LINE_AA)
    return x + length


def _draw_from_above(
    footer: ColourImage, m: FrameMeasurement, *, left: float, side: float, top: float, unit: float
) -> None:
    """Draw the corridor from above, its axis upward, and the vehicle; hollow where its offset is unknown."""
    half = 0.40 * side
    centre, bottom = left + side / 2.0, top + side
    for x in (centre - half, centre + half):
        _stroke(footer, np.array([(x, top), (x, bottom)]), WALL, 2.4 * unit)
    for k in range(4):
        y = top + side * (k + 0.2) / 4.0
        _stroke(footer, np.array([(centre, y), (centre, y + 0.6 * side / 4.0)]), FAINT, unit)
    if not isfinite(m.heading_rad):
        return
    known = isfinite(m.lateral_offset_norm)
    place = np.array(
        [centre + (half * np.clip(m.lateral_offset_norm, -1, 1) if known else 0.0), top + 0.62 * side]
    )
    ahead = np.array([sin(m.heading_rad), -cos(m.heading_rad)])  # turned right: the nose goes right
    right = np.array([-ahead[1], ahead[0]])
    _stroke(footer, np.array([place, place + 46 * unit * ahead]), YES if m.accepted else NO, 1.4 * unit)
    body = place + unit * np.array(
        [17 * ahead, -11 * ahead + 10 * right, -6 * ahead, -11 * ahead - 10 * right]
    )
    if known:
        cv2.fillPoly(footer, [_fixed_point(body)], FOREGROUND, cv2.LINE_AA, _SHIFT)
    _stroke(footer, body, FOREGROUND, 1.4 * unit, closed=True)
