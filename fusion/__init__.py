"""Fuse corridor vision with an IMU: a streaming estimator, which also runs over logged flights.

Frames, signs and units are those of `vision.measurement`: body FRD, heading and lateral offset positive to the right,
SI and radians, time in integer nanoseconds. Importing the package loads nothing; each name is loaded at its first
use.

Each subpackage has one job, and imports only packages below it; ``make lint`` checks that. From the bottom:
`fusion.settings`, `fusion.flight`; `fusion.estimator`, `fusion.logs`, `fusion.simulate`; `fusion.result`,
`fusion.alignment`, `fusion.inspection`, `fusion.pictures`; `fusion.evaluation`; `fusion.offline`; `fusion.report`;
`fusion.outputs`; `fusion.fleet`, `fusion.live`; `fusion.cli`. Begin reading at `fusion.estimator.estimator`, or at
`fusion.offline.fuse` for whole flights.
"""

from __future__ import annotations

# `typing.TYPE_CHECKING` without `typing`: until the command line has installed its handler, Ctrl-C during an import
# ends in a traceback.
TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

    __version__: str
    from fusion.estimator.config import FusionConfig
    from fusion.estimator.estimate import Estimate
    from fusion.estimator.estimator import CorridorEstimator
    from fusion.estimator.faults import Fault
    from fusion.estimator.frame_update import FrameResult
    from fusion.estimator.notices import Status
    from fusion.evaluation.errors import evaluate
    from fusion.flight import Flight
    from fusion.logs import load_flight
    from fusion.offline.fuse import fuse_flight
    from fusion.outputs.folder import write_outputs
    from fusion.result.result import FusionResult

__all__ = [
    "CorridorEstimator",
    "Estimate",
    "Fault",
    "Flight",
    "FrameResult",
    "FusionConfig",
    "FusionResult",
    "Status",
    "evaluate",
    "fuse_flight",
    "load_flight",
    "write_outputs",
]

_MODULES = {
    "CorridorEstimator": "fusion.estimator.estimator",
    "Estimate": "fusion.estimator.estimate",
    "Fault": "fusion.estimator.faults",
    "Flight": "fusion.flight",
    "FrameResult": "fusion.estimator.frame_update",
    "FusionConfig": "fusion.estimator.config",
    "FusionResult": "fusion.result.result",
    "Status": "fusion.estimator.notices",
    "evaluate": "fusion.evaluation.errors",
    "fuse_flight": "fusion.offline.fuse",
    "load_flight": "fusion.logs",
    "write_outputs": "fusion.outputs.folder",
}


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        from importlib import import_module

        return getattr(import_module(_MODULES[name]), name)
    if name == "__version__":
        from importlib.metadata import version

        return version("corridor-fusion")  # defined only in pyproject.toml
    raise AttributeError(f"module 'fusion' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
