"""Parsers of camera files that are neither YAML nor JSON: OpenCV's XML and the ``.ini`` of ROS."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from vision.errors import InputError

_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
_MATRICES = {"camera matrix": ("camera_matrix", 9), "distortion": ("distortion_coefficients", 5)}


def is_ini(text: str) -> bool:
    """Whether a text is a calibration in the ``.ini`` format of ROS's ``camera_calibration_parsers``."""
    return re.search(r"^\[image\]\s*$", text, re.MULTILINE) is not None and "camera matrix" in text


def parse_ini(text: str, path: Path) -> dict[str, Any]:
    """Read size, matrix and distortion: each name is on a line of its own, its numbers on the following lines."""
    lines = [line.strip() for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    found: dict[str, Any] = {"distortion_model": "plumb_bob"}
    for place, line in enumerate(lines):
        if line in ("width", "height"):
            found[f"image_{line}"] = next(iter(_numbers_after(lines, place)), None)
        elif line in _MATRICES:
            name, count = _MATRICES[line]
            found[name] = _numbers_after(lines, place)[:count]
    missing = [name for name, _ in _MATRICES.values() if not found.get(name)]
    if missing:
        raise InputError(f"{missing[0]} is missing", file=path, remedy="give the whole file")
    return found


def _numbers_after(lines: list[str], place: int) -> list[float]:
    """Return the numbers on the lines that follow one, up to the next line with anything else."""
    found: list[float] = []
    for line in lines[place + 1 :]:
        fields = line.split()
        if not all(_NUMBER.fullmatch(field) for field in fields):
            break
        found += [float(field) for field in fields]
    return found


def parse_xml(text: str, path: Path) -> dict[str, Any]:
    """Read an XML file of OpenCV's FileStorage: matrices, numbers and texts under one root.

    Raises
    ------
    InputError
        Where it is not such a file, or declares entities, whose expansion may exhaust memory.
    """
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise InputError(
            "declares entities, which no calibration has", file=path, remedy="give OpenCV's own XML"
        )
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise InputError(f"is not valid XML: {error}", file=path, remedy="correct the file") from error
    if root.tag != "opencv_storage":
        raise InputError(
            f"is XML of another kind, {root.tag}", file=path, remedy="give OpenCV's XML, or YAML or JSON"
        )
    return {child.tag: _value(child) for child in root}


def _value(element: ElementTree.Element) -> Any:
    if element.get("type_id") in ("opencv-matrix", "opencv-nd-matrix"):
        return {child.tag: _value(child) for child in element}
    if len(element):
        return [_value(child) for child in element]
    fields = (element.text or "").split()
    if fields and all(_NUMBER.fullmatch(field) for field in fields):
        numbers = [float(field) for field in fields]
        return numbers[0] if len(numbers) == 1 and element.tag != "data" else numbers
    return (element.text or "").strip()
