"""Put a flight's camera right by the flight itself: its clock, its focal length and how it is mounted.

`align_flight` compares the turns that vision sees along a corridor with those of the inertial sensors; see
`fusion.alignment.clock` and `fusion.alignment.mount` for how.
"""

from __future__ import annotations

from fusion.alignment.align import align_flight, apply_alignment, clock_of_frames
from fusion.alignment.result import Alignment, Quantity

__all__ = ["Alignment", "Quantity", "align_flight", "apply_alignment", "clock_of_frames"]
