"""A manifest as text: TOML with the meaning of each number beside it."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from pathlib import Path

from pydantic import BaseModel

from fusion.logs.csv.column_map import ColumnMap
from fusion.logs.manifest.manifest import Manifest, StreamSource
from fusion.settings.toml import toml_value

_HEAD = """\
# Where each stream of this flight comes from. `corridor fuse` reads this file, `corridor align` writes to it.
# Paths are relative to this file's folder. Times: flight = file + clock_offset_s.
"""

_MEANING = {
    "log": "everything that is not named below comes from here",
    "corridor_width_m": "between the walls",
    "body_from_imu_rad": "roll, pitch, yaw of the axes of IMU and camera on the vehicle",
    "camera.start_ns": "time of the first frame",
    "camera.rate_hz": "frames a second",
    "camera.times": "time of each frame, a row per frame",
    "camera.mount_yaw_rad": "the camera looks this much further right than its calibration says",
    "camera.mount_pitch_rad": "the camera looks this much further up than its calibration says",
    "camera.mount_roll_rad": "its right side hangs this much further down than its calibration says",
    "camera.rescale_calibration": "the pictures are the calibration's, scaled to another size",
    "camera.focal_scale": "factor on the calibration's focal lengths",
    "range.above_camera_m": "the sensor sits this much higher than the camera",
    "mount_rad": "roll, pitch, yaw of the sensor on the body",
    "clock_rate": "seconds of the flight in a second of this file's clock, counted from its first sample",
    "use": "false: left out",
    "clock_offset_s": "added to this file's times",
}


def manifest_text(manifest: Manifest, folder: Path, notes: Mapping[str, str]) -> str:
    """Return the TOML text; paths that share more than the root with ``folder`` (absolute) are relative to it."""
    lines = [_HEAD]
    lines += _lines(manifest, "", folder, notes)
    for name, source in manifest.streams().items():
        inside = list(_lines(source, f"{name}.", folder, notes))
        if inside:
            lines += ["", f"[{name}]", *inside]
        if isinstance(source.columns, ColumnMap):
            lines += ["", f"[{name}.columns]", *_lines(source.columns, f"{name}.columns.", folder, notes)]
    return "\n".join(lines) + "\n"


def _lines(model: BaseModel, prefix: str, folder: Path, notes: Mapping[str, str]) -> Iterator[str]:
    """Yield a line per value that is set, even to its default, or has a note."""
    for key, value in model:
        dotted = prefix + key
        is_written = key in model.model_fields_set or dotted in notes
        if value is None or isinstance(value, StreamSource | ColumnMap) or not is_written:
            continue
        remarks = [_MEANING.get(dotted) or _MEANING.get(key), notes.get(dotted)]
        remark = "; ".join(_in_one_line(text) for text in remarks if text)
        yield f"{key} = {toml_value(relative(value, folder) if isinstance(value, Path) else value)}" + (
            f"  # {remark}" if remark else ""
        )


def _in_one_line(text: str) -> str:
    """Remove line breaks and characters that TOML forbids from a comment."""
    return " ".join("".join(sign if sign.isprintable() else " " for sign in text).split())


def relative(path: Path, folder: Path) -> str:
    """Return a path relative to a folder; absolute if they share nothing but the root."""
    try:
        shared = os.path.commonpath([path, folder])
    except ValueError:  # on different drives
        return path.as_posix()
    if Path(shared) == Path(path.anchor):
        return path.as_posix()
    return Path(os.path.relpath(path, folder)).as_posix()
