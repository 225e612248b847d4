"""Calibrates a flight's camera from the flight itself: clock, focal length and mounting.

`align_flight` compares the turns that vision measures along a corridor with those of the inertial sensors. May import
`fusion.estimator`, `fusion.logs` and the packages below them; the check of the camera's time in `fusion.evaluation`
uses it. Begin reading at `fusion.alignment.align`, then `fusion.alignment.clock` and `fusion.alignment.mount`.
"""

from __future__ import annotations

from fusion.alignment.align import align_flight, apply_alignment, clock_of_frames, turns_of_frames
from fusion.alignment.result import Alignment, Quantity

__all__ = ["Alignment", "Quantity", "align_flight", "apply_alignment", "clock_of_frames", "turns_of_frames"]
