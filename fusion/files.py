"""Files that appear whole: an error while writing leaves what was there before."""

from __future__ import annotations

import secrets
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Give a temporary name beside ``path`` to write to; it takes the name ``path`` if the block succeeds."""
    beside = temporary_beside(path)
    try:
        yield beside
        beside.replace(path)
    finally:
        with suppress(OSError):
            beside.unlink(missing_ok=True)


def temporary_beside(path: Path) -> Path:
    """Return a hidden name in the same folder that nothing else uses."""
    return path.with_name(f".{path.name}.{secrets.token_hex(4)}.partial")


def error_text(error: Exception) -> str:
    """Return what the system says of an error, without its number and path."""
    return (error.strerror or str(error)) if isinstance(error, OSError) else str(error)
