"""Where the tests find what they read, and how they write what they give to read."""

from __future__ import annotations

from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
OFFICE = ROOT / "data" / "office"  # the sample flight
SHARED = ROOT.parent / "shared"  # real logs, pictures and flights that are not part of the repository
HALLWAY = SHARED / "flights" / "mononav_hallway"


def written(path: Path, text: str) -> Path:
    """Write a text file, its folder too; returns its path."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8", newline="")
    return path
