"""Fixtures of the tests of `fusion`."""

from __future__ import annotations

import pytest

from fusion import load_flight
from fusion.flight import Flight
from tests.files import OFFICE


@pytest.fixture(scope="session")
def office() -> Flight:
    """The sample flight as it is read; no test changes it."""
    return load_flight(OFFICE)
