"""Fixtures of the tests of `vision`."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from tests.vision.corridor_lines import Corridor, lines_seen
from vision import Camera
from vision.lines.line_set import LineSet

Seen = Callable[[Corridor, Camera], LineSet]


@pytest.fixture(scope="session")
def corridor() -> type[Corridor]:
    """Give the description of a corridor of lines."""
    return Corridor


@pytest.fixture(scope="session")
def seen() -> Seen:
    """Give the function that turns a corridor into the lines a camera sees, without any picture."""
    return lines_seen
