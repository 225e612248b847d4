"""Make corridor flights: pictures, inertial data and exact truth, from a configuration and a seed.

World axes: x along the first corridor, y right of it, z down, floor at z = 0. Body FRD. The pictures are made by
casting rays in a furnished, lit corridor: `fusion.simulate.scene` builds it, `fusion.simulate.render` draws it.
`SimulationConfig.random` draws corridors of all kinds, lenses, flights and inertial sensors; ``random_office`` draws
plain offices in good light. Each name is loaded at its first use.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fusion.simulate.config import CameraConfig, ImagingConfig, ImuConfig, SimulationConfig
    from fusion.simulate.exposure import SimulatedFrame, simulate_frames
    from fusion.simulate.flight import simulate_flight
    from fusion.simulate.scene.config import JunctionConfig, SceneConfig
    from fusion.simulate.single_views import RandomView, office_views, random_views

__all__ = [
    "CameraConfig",
    "ImagingConfig",
    "ImuConfig",
    "JunctionConfig",
    "RandomView",
    "SceneConfig",
    "SimulatedFrame",
    "SimulationConfig",
    "office_views",
    "random_views",
    "simulate_flight",
    "simulate_frames",
]

_MODULES = {
    "CameraConfig": "config",
    "ImagingConfig": "config",
    "ImuConfig": "config",
    "JunctionConfig": "scene.config",
    "RandomView": "single_views",
    "SceneConfig": "scene.config",
    "SimulatedFrame": "exposure",
    "SimulationConfig": "config",
    "office_views": "single_views",
    "random_views": "single_views",
    "simulate_flight": "flight",
    "simulate_frames": "exposure",
}


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        return getattr(import_module(f"fusion.simulate.{_MODULES[name]}"), name)
    raise AttributeError(f"module 'fusion.simulate' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
