"""Messages for Foxglove and Lichtblick, as JSON with their standard schemas.

Field names and meanings are those of Foxglove's message schemas CompressedImage, ImageAnnotations and Log; a
viewer recognises them by name. Its JSON reader accepts one plain type per field, so an unknown number is a
missing field, not null.
"""

from __future__ import annotations

import base64
from collections.abc import Mapping
from math import degrees
from typing import Any

import numpy as np
import numpy.typing as npt

from fusion.result.conventions import Frame, column_metadata
from vision.measurement import REASON_MEANING, FrameMeasurement, LineClass
from vision.overlay import CLASS_COLOUR, VANISHING_POINT, WALL, Colour

Schema = dict[str, Any]
Message = dict[str, Any]

POINTS, LINE_LOOP, LINE_LIST = 1, 2, 4
INFO, WARNING = 2, 3

_NUMBER: Schema = {"type": "number"}
_STRING: Schema = {"type": "string"}


def _object(title: str, **properties: Schema) -> Schema:
    return {"title": title, "type": "object", "properties": properties}


def _list(item: Schema) -> Schema:
    return {"type": "array", "items": item}


_TIME = _object("time", sec={"type": "integer", "minimum": 0}, nsec={"type": "integer", "minimum": 0})
_POINT = _object("foxglove.Point2", x=_NUMBER, y=_NUMBER)
_COLOR = _object("foxglove.Color", r=_NUMBER, g=_NUMBER, b=_NUMBER, a=_NUMBER)
_KINDS = ("UNKNOWN", "POINTS", "LINE_LOOP", "LINE_STRIP", "LINE_LIST")
_LEVELS = ("UNKNOWN", "DEBUG", "INFO", "WARNING", "ERROR", "FATAL")


def _one_of(words: tuple[str, ...]) -> Schema:
    return {"oneOf": [{"title": word, "const": number} for number, word in enumerate(words)]}


COMPRESSED_IMAGE = _object(
    "foxglove.CompressedImage",
    timestamp=_TIME,
    frame_id=_STRING,
    data={"type": "string", "contentEncoding": "base64"},
    format=_STRING,
)
IMAGE_ANNOTATIONS = _object(
    "foxglove.ImageAnnotations",
    circles=_list(
        _object(
            "foxglove.CircleAnnotation",
            timestamp=_TIME,
            position=_POINT,
            diameter=_NUMBER,
            thickness=_NUMBER,
            fill_color=_COLOR,
            outline_color=_COLOR,
        )
    ),
    points=_list(
        _object(
            "foxglove.PointsAnnotation",
            timestamp=_TIME,
            type=_one_of(_KINDS),
            points=_list(_POINT),
            outline_color=_COLOR,
            outline_colors=_list(_COLOR),
            fill_color=_COLOR,
            thickness=_NUMBER,
        )
    ),
    texts=_list(
        _object(
            "foxglove.TextAnnotation",
            timestamp=_TIME,
            position=_POINT,
            text=_STRING,
            font_size=_NUMBER,
            text_color=_COLOR,
            background_color=_COLOR,
        )
    ),
)
LOG = _object(
    "foxglove.Log",
    timestamp=_TIME,
    level=_one_of(_LEVELS),
    message=_STRING,
    name=_STRING,
    file=_STRING,
    line={"type": "integer", "minimum": 0},
)


def table_schema(title: str, dtype: np.dtype[Any], frame: Frame) -> Schema:
    """Return the schema of a table's row: its columns, plus headings and turns in degrees for plots."""
    properties: dict[str, Schema] = {"timestamp": _TIME}
    for name in dtype.names or ():
        if name == "timestamp_ns":
            continue
        kind = {"b": "boolean", "U": "string"}.get(dtype[name].kind, "number")
        properties[name] = {"type": kind, **_said(name, frame)}
        if name in IN_DEGREES:
            properties[IN_DEGREES[name]] = {"type": "number", "description": f"{name} in degrees"}
    return _object(title, **properties)


IN_DEGREES = {
    "heading_rad": "heading_deg",
    "heading_std_rad": "heading_std_deg",
    "corridor_turn_rad": "corridor_turn_deg",
    "innovation_rad": "innovation_deg",
}


def _said(name: str, frame: Frame) -> dict[str, str]:
    metadata = column_metadata(name, frame)
    words = metadata.get("description", "")
    return {"description": f"{words}; {metadata['unit']}" if "unit" in metadata else words}


def time_of(t_ns: int) -> Message:
    """Return a time as seconds and nanoseconds."""
    seconds, nanoseconds = divmod(t_ns, 1_000_000_000)
    return {"sec": seconds, "nsec": nanoseconds}


def row_message(names: tuple[str, ...], row: tuple[Any, ...]) -> Message:
    """Return a table's row of plain values without unknown ones."""
    message: Message = {}
    for name, value in zip(names, row, strict=True):
        if name == "timestamp_ns":
            message["timestamp"] = time_of(value)
        elif value == value and value != "":  # NaN differs from itself
            message[name] = float(f"{value:.9g}") if isinstance(value, float) else value
            if name in IN_DEGREES:
                message[IN_DEGREES[name]] = float(f"{degrees(value):.9g}")
    return message


def image_message(t_ns: int, image: npt.NDArray[np.uint8], quality: int) -> Message:
    """Return a picture as JPEG."""
    import cv2

    ok, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])
    if not ok:  # only an empty array cannot be encoded
        raise ValueError(f"a picture of shape {image.shape} cannot be encoded")
    text = base64.b64encode(data.tobytes()).decode("ascii")
    return {"timestamp": time_of(t_ns), "frame_id": "camera", "data": text, "format": "jpeg"}


def log_message(t_ns: int, text: str, level: int = INFO) -> Message:
    """Return a line of the log."""
    return {
        "timestamp": time_of(t_ns),
        "level": level,
        "message": text,
        "name": "corridor",
        "file": "",
        "line": 0,
    }


def overlay_message(t_ns: int, measurement: FrameMeasurement, width_px: int) -> Message:
    """Return the drawing of a measurement: lines by class, those on both walls, the vanishing point, the result.

    Coordinates refer to the picture in the file, with (0, 0) at the corner of pixel (0, 0), not at its centre.
    """
    time, unit = time_of(t_ns), width_px / 640.0
    points: list[Message] = []

    def add(kind: int, ends: npt.ArrayLike, colour: Colour, thickness: float) -> None:
        xy = np.asarray(ends, dtype=np.float64).reshape(-1, 2) + 0.5
        if len(xy) and np.isfinite(xy).all():
            points.append(
                {
                    "timestamp": time,
                    "type": kind,
                    "points": [{"x": round(x, 2), "y": round(y, 2)} for x, y in xy.tolist()],
                    "outline_color": _color(colour),
                    "outline_colors": [],
                    "fill_color": _color(colour, 0.0),
                    "thickness": thickness * unit,
                }
            )

    if measurement.lines_px is not None and measurement.line_class is not None:
        for kind in (LineClass.REJECTED, LineClass.VERTICAL, LineClass.TRANSVERSE, LineClass.CORRIDOR):
            add(LINE_LIST, measurement.lines_px[measurement.line_class == kind], CLASS_COLOUR[kind], 1.6)
    if measurement.wall_lines_px is not None:
        add(LINE_LIST, measurement.wall_lines_px, WALL, 3.4)
    add(LINE_LOOP, _ellipse(measurement), VANISHING_POINT, 1.2)
    add(
        LINE_LIST,
        np.array([[-9, 0], [9, 0], [0, -9], [0, 9]]) * unit + measurement.vp_px,
        VANISHING_POINT,
        2.0,
    )
    return {"circles": [], "points": points, "texts": [_verdict(time, measurement, unit)]}


def _verdict(time: Mapping[str, int], measurement: FrameMeasurement, unit: float) -> Message:
    words = REASON_MEANING[measurement.reason]
    return {
        "timestamp": time,
        "position": {"x": 8 * unit, "y": 24 * unit},
        "text": words if measurement.accepted else f"rejected: {words}",
        "font_size": 18 * unit,
        "text_color": _color((255, 255, 255)),
        "background_color": _color((20, 20, 20), 0.7),
    }


def _ellipse(measurement: FrameMeasurement) -> npt.NDArray[np.float64]:
    """Two-sigma ellipse (n, 2) of the vanishing point; NaN if unknown."""
    cov = np.asarray(measurement.vp_cov_px2, dtype=np.float64)
    if not np.isfinite(cov).all():
        return np.zeros((0, 2))
    values, vectors = np.linalg.eigh(cov)
    turn = np.linspace(0.0, 2.0 * np.pi, 36, endpoint=False)
    circle = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    return np.asarray(measurement.vp_px + 2.0 * (circle * np.sqrt(np.maximum(values, 0.0))) @ vectors.T)


def _color(bgr: Colour, alpha: float = 1.0) -> Message:
    b, g, r = (round(value / 255, 3) for value in bgr)
    return {"r": r, "g": g, "b": b, "a": alpha}
