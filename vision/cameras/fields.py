"""Calibration files as mappings, and checks of their fields; every error message names the field."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from math import isfinite, nan
from pathlib import Path
from typing import Any

import numpy as np

from vision.cameras.camera import nearest_rotation
from vision.cameras.text_files import is_ini, parse_ini, parse_xml
from vision.errors import InputError
from vision.limits import MAX_SIDE_PX, check_values, check_yaml, read_text
from vision.types import FloatArray

R_FRD_FLU: FloatArray = np.diag([1.0, -1.0, -1.0])


def read_yaml(path: Path) -> dict[str, Any]:
    """Read a mapping from YAML, also as OpenCV writes it (``%YAML:1.0``, its tags), from JSON, XML or INI.

    Raises
    ------
    InputError
        Where the file is missing, unreadable, in none of these formats, or not a mapping.
    """
    try:
        text = read_text(path, "a calibration")
    except FileNotFoundError:
        raise InputError("there is no such file", file=path, remedy="check the path") from None
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"cannot be read as text: {error}", file=path, remedy="give a YAML file") from error
    if text.lstrip().startswith("<"):
        return parse_xml(text, path)
    if is_ini(text):
        return parse_ini(text, path)
    is_json = path.suffix.lower() == ".json" or text.lstrip().startswith("{")
    content = _parse_json(text, path) if is_json else _parse_yaml(text, path)
    if not isinstance(content, dict):
        kind = "JSON object" if is_json else "YAML mapping"
        raise InputError(
            f"does not contain a {kind}", file=path, remedy="give lines such as `resolution: [640, 480]`"
        )
    return content


def _parse_json(text: str, path: Path) -> object:
    try:
        content = json.loads(text)
        check_values(content)
        return content
    except (ValueError, RecursionError) as error:
        where = (
            f" in line {error.lineno}: {error.msg}"
            if isinstance(error, json.JSONDecodeError)
            else f": {error}"
        )
        raise InputError(f"is not valid JSON{where}", file=path, remedy="correct the file") from error


def _parse_yaml(text: str, path: Path) -> object:
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    text = re.sub(r"\A%YAML:[^\n]*\n(---[^\n]*\n)?", "", text)
    text = re.sub("!!opencv-(nd-)?matrix", "", text)
    text = re.sub(r"\n(---|\.\.\.)\s*\Z", "\n", text)  # `rostopic echo` ends each message with it
    try:
        check_yaml(text)
        content = YAML(typ="safe", pure=True).load(text)
        check_values(content)
        return content
    except (YAMLError, ValueError, RecursionError) as error:
        mark = getattr(error, "problem_mark", None)
        where = f" in line {mark.line + 1}" if mark is not None else ""
        what = getattr(error, "problem", None) or (error if type(error) is ValueError else "syntax error")
        raise InputError(f"is not valid YAML{where}: {what}", file=path, remedy="correct the file") from error


def require(content: Mapping[str, Any], key: str, file: Path | None, remedy: str, prefix: str = "") -> Any:
    """Return a required field.

    Parameters
    ----------
    content
        The file's content, or a part of it.
    key, prefix
        Name of the field, and its prefix in an error message, such as ``cam0.``.
    file, remedy
        For the error message.

    Raises
    ------
    InputError
        Where the field is missing or empty.
    """
    if content.get(key) is None:
        raise InputError(f"{prefix}{key} is missing", file=file, remedy=remedy)
    return content[key]


def numbers(
    content: Mapping[str, Any], key: str, prefix: str, counts: tuple[int, ...] | None, remedy: str
) -> tuple[float, ...]:
    """Return a field of finite numbers, given flat, nested or as a mapping with ``data``.

    Parameters
    ----------
    content, key, prefix, remedy
        As in `require`.
    counts
        Allowed counts of numbers; None: any.

    Raises
    ------
    InputError
        Where the field is missing, is not a list of finite numbers, or has another count.
    """
    value = require(content, key, None, remedy, prefix=prefix)
    if isinstance(value, Mapping):
        value = require(value, "data", None, remedy, prefix=f"{prefix}{key}.")
    if isinstance(value, list) and any(isinstance(row, list) for row in value):
        value = [v for row in value for v in (row if isinstance(row, list) else [row])]
    try:
        found = tuple(float(v) for v in value)
    except (TypeError, ValueError):
        raise InputError(f"{prefix}{key} is {value!r}, not a list of numbers", remedy=remedy) from None
    if counts is not None and len(found) not in counts:
        wanted = " or ".join(str(c) for c in counts)
        raise InputError(f"{prefix}{key} has {len(found)} numbers instead of {wanted}", remedy=remedy)
    if not all(isfinite(v) for v in found):
        raise InputError(f"{prefix}{key} is {list(found)}", remedy="every number must be finite")
    return found


def positive(content: Mapping[str, Any], key: str, remedy: str, prefix: str = "") -> float | None:
    """Return a positive number, None where the field is absent.

    Parameters
    ----------
    content, key, prefix, remedy
        As in `require`.

    Raises
    ------
    InputError
        Where its value is anything else.
    """
    value = content.get(key)
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float) or not (isfinite(value) and value > 0.0):
        raise InputError(f"{prefix}{key} is {value!r}", remedy=remedy)
    return float(value)


def exposure_s(content: Mapping[str, Any], prefix: str) -> float:
    """Return the exposure time in seconds, NaN where the file does not declare it."""
    remedy = "give seconds, or leave it out"
    value = positive(content, "exposure_s", remedy, prefix)
    if value is not None and value >= 10.0:
        raise InputError(f"{prefix}exposure_s is {value!r}", remedy=remedy)
    return nan if value is None else value


def line_delay_s(content: Mapping[str, Any], prefix: str) -> float:
    """Return a rolling shutter's time from row to row in seconds (``line_delay``), 0 where it is not declared."""
    value = content.get("line_delay")
    if value is None:
        return 0.0
    if isinstance(value, bool) or not isinstance(value, int | float) or not isfinite(value):
        remedy = "give seconds from row to row, or leave it out for a global shutter"
        raise InputError(f"{prefix}line_delay is {value!r}", remedy=remedy)
    return float(value)


def parts_of_transform(value: object, name: str) -> tuple[FloatArray, FloatArray]:
    """Return rotation (3, 3) and translation (3,) of a 4x4 transform: flat, nested, or a mapping with ``data``."""
    if isinstance(value, Mapping):
        value = require(value, "data", None, "give 16 numbers, row by row", prefix=f"{name}.")
    try:
        matrix = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        matrix = np.empty(0)
    if matrix.size != 16:
        raise InputError(f"{name} does not contain 16 numbers", remedy="give a 4x4 transform, row by row")
    matrix = matrix.reshape(4, 4)
    if not np.allclose(matrix[3], [0.0, 0.0, 0.0, 1.0]):
        raise InputError(f"{name} has the last row {matrix[3].tolist()}", remedy="it must be [0, 0, 0, 1]")
    if not np.isfinite(matrix).all():
        raise InputError(f"{name} contains numbers that are not finite", remedy="give a 4x4 transform")
    return nearest_rotation(matrix[:3, :3], f"{name}'s rotation"), matrix[:3, 3].copy()


def check_size(width_px: float, height_px: float, what: str) -> tuple[int, int]:
    """Return a picture's size in whole pixels; raise `InputError` where it is not one."""
    if not all(isfinite(v) and v == int(v) and 1 <= v <= MAX_SIDE_PX for v in (width_px, height_px)):
        raise InputError(f"{what} is {[width_px, height_px]}", remedy="write [width, height] in whole pixels")
    return int(width_px), int(height_px)


def check_pinhole(size: tuple[int, int], pinhole: tuple[float, float, float, float], what: str) -> None:
    """Raise `InputError` where fx, fy, cx, cy are impossible for pictures of this size."""
    fx_px, fy_px, cx_px, cy_px = pinhole
    for name, focal_px in (("fu", fx_px), ("fv", fy_px)):
        if focal_px <= 0.0:
            raise InputError(
                f"{what} has the focal length {name} = {focal_px:g}", remedy="it must be positive"
            )
    if not (0.0 <= cx_px <= size[0] and 0.0 <= cy_px <= size[1]):
        raise InputError(
            f"{what} has the principal point ({cx_px:g}, {cy_px:g}) outside the resolution {size[0]}x{size[1]}",
            remedy=f"{what} and resolution must belong to the same picture size",
        )
