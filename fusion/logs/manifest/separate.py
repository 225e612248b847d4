"""Manifest of a flight whose streams are named one by one, in place of a ``flight.toml``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from fusion.logs.manifest.file import find_manifest, make_manifest, read_manifest
from fusion.logs.manifest.manifest import Manifest

_OF_THE_OLD_FILE = ("topic", "columns", "frame", "times", "start_ns", "clock_offset_s")


def manifest_of_files(
    flight: Path | None,
    *,
    imu: Path | None,
    video: Path | None,
    attitude: Path | None,
    clock_offset_s: float | None,
) -> Manifest:
    """Return the manifest; arguments as in `fusion.logs.load_flight`.

    Raises
    ------
    InputError
        If the flight's own manifest cannot be used.
    """
    values = _values_of_flight(flight)
    if flight is None and video is not None:
        values["name"] = video.name if video.is_dir() else video.stem
    _put(values, "camera", video)
    if clock_offset_s is not None:
        values.setdefault("camera", {})["clock_offset_s"] = float(clock_offset_s)
    if flight is None and imu is not None:
        values["log"] = imu
    else:
        _put(values, "imu", imu)
    _put(values, "attitude", attitude)
    return make_manifest(values)


def _values_of_flight(flight: Path | None) -> dict[str, Any]:
    """Return the manifest's initial values: the flight's own, or its log's path; none without a flight."""
    if flight is None:
        return {}
    described = find_manifest(flight)
    if described is None:
        return {"log": flight}
    values = read_manifest(described).model_dump(exclude_unset=True)
    values.setdefault("name", described.absolute().parent.name)
    return values


def _put(values: dict[str, Any], table: str, file: Path | None) -> None:
    """Set a stream's new file; entries about the old one, such as topic and columns, are removed."""
    if file is None:
        return
    before = {key: value for key, value in values.get(table, {}).items() if key not in _OF_THE_OLD_FILE}
    values[table] = before | {"file": file.absolute()}
