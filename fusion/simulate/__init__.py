"""Make corridor flights: pictures, inertial data and exact truth, from a configuration and a seed.

World axes: x along the first corridor, y right of it, z down, floor at z = 0. Body FRD. The pictures are rendered by
casting rays at a furnished, lit corridor; see `fusion.simulate.render`.
"""

from __future__ import annotations

from fusion.simulate.config import ImagingConfig, SimulationConfig
from fusion.simulate.scene_config import JunctionConfig, SceneConfig
from fusion.simulate.views import RandomView, random_views

__all__ = ["ImagingConfig", "JunctionConfig", "RandomView", "SceneConfig", "SimulationConfig", "random_views"]
