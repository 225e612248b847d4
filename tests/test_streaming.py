"""The benchmark of calls at 1 kHz: its calls come as it says, and what it measures is a flight that works."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import streaming
from offline import long_flight

from fusion import CorridorEstimator, FusionConfig


def test_calls_come_in_order_and_frames_late() -> None:
    flight = long_flight(1.0 / 3600.0, frame_step_s=1 / 15)
    calls = streaming.calls_of(flight, streaming.lines_of(flight))[:3000]
    assert all(a.at_ns <= b.at_ns for a, b in pairwise(calls))
    late_ns = {name: {c.at_ns - c.t_ns for c in calls if c.name == name} for name in {c.name for c in calls}}
    assert late_ns == {"add_imu": {0}, "add_attitude": {0}, "add_lines": {streaming.LATE_NS}}
    assert np.diff([c.t_ns for c in calls if c.name == "add_imu"]).tolist()[:5] == [1_000_000] * 5

    run = streaming.flown(calls, flight)
    assert run.in_cycles == 0
    assert {name: len(times) > 0 and bool((times > 0.0).all()) for name, times in run.calls_ms.items()} == {
        "add_imu": True,
        "add_attitude": True,
        "add_lines": True,
        "estimate": True,
    }
    estimator = CorridorEstimator(FusionConfig(buffer_s=0.5), flight.camera)
    for call in calls:
        getattr(estimator, call.name)(call.t_ns, *call.arguments)
    assert estimator.estimate().status == "tracking"
    assert estimator.counters["frame_ok"] > 0.9 * sum(c.name == "add_lines" for c in calls)
    assert estimator.counters["frame_late"] == 0
