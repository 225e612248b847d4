"""Attachments at the beginning of a recording of `corridor live`: calibration and settings."""

from __future__ import annotations

import tempfile
from pathlib import Path

from vision import Camera, InputError

MARK, CAMERA, CONFIG, SETTINGS = "corridor_live", "camera.yaml", "config.toml", "live.json"
_MAGIC = b"\x89MCAP0\r\n"


def attachments(path: Path) -> dict[str, str]:
    """Text files attached before the first message of an MCAP file; none if it is not such a recording."""
    if not path.is_file():
        return {}
    with path.open("rb") as file:
        if file.read(len(_MAGIC)) != _MAGIC:
            return {}
        try:
            from mcap.records import Attachment, Chunk, Message
            from mcap.stream_reader import StreamReader
        except ImportError:
            return {}
        file.seek(0)
        found = {}
        try:
            for record in StreamReader(file, emit_chunks=True, record_size_limit=2**30).records:
                if isinstance(record, Chunk | Message):
                    break
                if isinstance(record, Attachment):
                    found[record.name] = record.data.decode()
        except Exception:  # of a truncated or damaged file, reported when its messages are read
            return {}
    return found if MARK in found else {}


def is_recording(path: Path) -> bool:
    """Whether a file is a recording of `corridor live`."""
    return MARK in attachments(path)


def attached_camera(path: Path) -> Camera | None:
    """Calibration of a recording; None if it has none."""
    text = attachments(path).get(CAMERA)
    if text is None:
        return None
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, CAMERA)
        file.write_text(text, encoding="utf-8")
        try:
            return Camera.from_yaml(file, body_frame="frd")
        except InputError as error:
            raise InputError(f"{CAMERA} in it: {error.problem}", file=path, remedy=error.remedy) from error
