"""A result's summary as JSON."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from vision.limits import check_is_file

MAX_BYTES = 16_000_000


def write_summary(summary: Mapping[str, Any], path: str | Path) -> None:
    """Write a summary as standard JSON: unknown numbers are null, never ``NaN``."""
    Path(path).write_text(summary_json(summary), encoding="utf-8")


def read_summary(path: str | Path) -> dict[str, Any]:
    """Read a summary back.

    Raises
    ------
    OSError, ValueError
        If the file cannot be read, is too large, or has other contents.
    """
    check_is_file(Path(path))
    with Path(path).open("rb") as file:
        data = file.read(MAX_BYTES + 1)
    if len(data) > MAX_BYTES:
        raise ValueError(f"more than {MAX_BYTES} bytes")
    try:
        found = json.loads(data)
    except RecursionError as error:
        raise ValueError("nested too deeply") from error
    if not isinstance(found, dict):
        raise ValueError("no summary")
    return found


def summary_json(summary: Mapping[str, Any]) -> str:
    """Return a summary as JSON text."""
    text = json.dumps(_plain(summary), indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    # JSON allows some control characters of terminals; they occur only in texts and can be escaped.
    return "".join(sign if sign.isprintable() or sign == "\n" else _escaped(sign) for sign in text)


def _escaped(sign: str) -> str:
    return f"\\u{ord(sign):04x}" if ord(sign) < 1 << 16 else json.dumps(sign)[1:-1]


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, np.generic | np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, Path):
        return str(value)
    return value
