"""Print the lowest versions that ``pyproject.toml`` allows of what the tests use, as constraints for pip."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

PROJECT = Path(__file__).resolve().parents[1] / "pyproject.toml"
EXTRAS = ("test", "px4", "ros", "ardupilot", "video", "parquet", "mcap")


def lowest() -> list[str]:
    """Return ``name==version`` of each dependency that has a lower bound."""
    project = tomllib.loads(PROJECT.read_text(encoding="utf-8"))["project"]
    extras = (dependency for extra in EXTRAS for dependency in project["optional-dependencies"][extra])
    found = (
        re.fullmatch(r"([\w.-]+)>=([\w.]+)(?:,.*)?", dependency)
        for dependency in (*project["dependencies"], *extras)
    )
    return sorted({f"{match[1]}=={match[2]}" for match in found if match})


if __name__ == "__main__":
    print("\n".join(lowest()))
