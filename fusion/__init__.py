"""Fuse corridor vision with an IMU: a streaming estimator, and the same over logged flights.

Frames, signs and units are those of `vision.measurement`: body FRD, heading and lateral offset positive to the right,
SI and radians, time in integer nanoseconds. Importing the package is light; each name loads at its first use.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fusion.estimator.config import FusionConfig
    from fusion.estimator.estimate import Estimate
    from fusion.estimator.estimator import CorridorEstimator
    from fusion.flight import Flight
    from fusion.logs import load_flight
    from fusion.offline.fuse import FusionResult, fuse_flight

__all__ = [
    "CorridorEstimator",
    "Estimate",
    "Flight",
    "FusionConfig",
    "FusionResult",
    "fuse_flight",
    "load_flight",
]

_MODULES = {
    "CorridorEstimator": "fusion.estimator.estimator",
    "Estimate": "fusion.estimator.estimate",
    "Flight": "fusion.flight",
    "FusionConfig": "fusion.estimator.config",
    "FusionResult": "fusion.offline.fuse",
    "fuse_flight": "fusion.offline.fuse",
    "load_flight": "fusion.logs",
}


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        return getattr(import_module(_MODULES[name]), name)
    raise AttributeError(f"module 'fusion' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
