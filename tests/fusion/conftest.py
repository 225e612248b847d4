"""The sample flight, read once."""

from __future__ import annotations

from pathlib import Path

import pytest

from fusion.flight import Flight
from fusion.logs import load_flight

OFFICE = Path(__file__).resolve().parents[2] / "data" / "office"


@pytest.fixture(scope="session")
def office() -> Flight:
    """Return the sample flight."""
    return load_flight(OFFICE)
