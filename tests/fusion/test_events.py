"""Rejections, steps, other corridors and changes of status, in the log and in the summary."""

from __future__ import annotations

import json
import logging
import subprocess
import sys
from dataclasses import replace
from itertools import pairwise
from math import radians
from pathlib import Path

import numpy as np
import pytest

from fusion import CorridorEstimator, FusionConfig, fuse_flight, load_flight
from fusion.estimator.events import Event, EventKind
from fusion.offline import summary
from fusion.result.summary_json import write_summary
from tests.files import OFFICE, ROOT
from tests.fusion.simulated import frame, turning
from tests.fusion.test_junctions import fly as fly_corridors
from tests.fusion.test_junctions import seen_as

MS = 1_000_000
DOWN = (0.0, 0.0, -9.80665)


def fly(estimator: CorridorEstimator, start_ms: int, end_ms: int, seen_rad: float | None) -> None:
    """Fly straight on; frames at 25 Hz show a heading, or nothing of use."""
    for ms in range(start_ms, end_ms, 10):
        estimator.add_imu(ms * MS, (0.0, 0.0, 0.0), DOWN)
        if ms % 40 == 0 and seen_rad is not None:
            estimator.add_measurement(ms * MS, frame(seen_rad, 0.005, 0.3, 0.02))
        elif ms % 40 == 0:
            estimator.add_unreadable_frame(ms * MS)


def logged(caplog: pytest.LogCaptureFixture) -> list[Event]:
    return [record.event for record in caplog.records]  # type: ignore[attr-defined]


def test_what_happens_is_logged_with_times_and_numbers(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, logger="fusion.estimator")
    estimator = CorridorEstimator(FusionConfig(corridor_width_m=2.0))
    fly(estimator, 0, 2000, 0.1)
    fly(estimator, 2000, 8000, None)
    fly(estimator, 8000, 12_000, 0.35)  # another heading: rejected, then believed
    estimator.finish()
    events = logged(caplog)
    assert [event.timestamp_ns for event in events] == sorted(event.timestamp_ns for event in events)
    status = [e for e in events if e.kind is EventKind.STATUS_CHANGED]
    words = [str(e.values["status"]) for e in status]
    assert words[:3] == ["initialising", "tracking", "coasting"]
    assert words[-1] == "tracking"
    assert all(new.values["before"] == old.values["status"] for old, new in pairwise(status))
    lost = next(e for e in status if e.values["status"] == "coasting")
    assert 2000 * MS < lost.timestamp_ns < 3000 * MS
    assert lost.values["reason"] == "frames are rejected"
    unreadable = [e for e in events if e.values.get("reason") == "unreadable"]
    assert len(unreadable) == 150
    gated = [e for e in events if e.values.get("reason") == "gate"]
    assert gated
    assert all(float(e.values["test_ratio"]) > 1.0 for e in gated)
    (step,) = [e for e in events if e.kind is EventKind.HEADING_RESET]
    assert float(step.values["step_rad"]) == pytest.approx(0.25, abs=0.05)
    assert estimator.estimate().reset_count == 1
    fly(estimator, 12_000, 30_000, None)
    fly(estimator, 30_000, 32_000, 0.45)  # the first frame after a gap is a step, too
    estimator.finish()
    steps = [e for e in logged(caplog) if e.kind is EventKind.HEADING_RESET]
    assert len(steps) == estimator.estimate().reset_count == 2
    assert steps[-1].values["step_rad"] == pytest.approx(estimator.estimate().reset_heading_rad)
    assert caplog.messages[0].startswith("t_ns=0 status_changed before= status=initialising reason=")


def test_late_samples_log_what_the_sorted_log_does(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, logger="fusion.estimator")
    rng = np.random.default_rng(5)
    found = []
    for late_ms in (0, 200):
        estimator = CorridorEstimator(FusionConfig(corridor_width_m=2.0))
        # When it comes, when it was taken, whether it is a frame.
        calls = [(ms, ms, False) for ms in range(0, 4000, 10)]
        calls += [(ms + int(rng.integers(0, late_ms + 1)), ms, True) for ms in range(0, 4000, 40)]
        caplog.clear()
        for _, ms, is_frame in sorted(calls):
            if is_frame:
                seen = 0.9 if 1000 < ms < 1400 else 0.1
                estimator.add_measurement(ms * MS, frame(seen, 0.005, 0.3, 0.02))
            else:
                estimator.add_imu(ms * MS, (0.0, 0.0, 0.0), DOWN)
        estimator.finish()
        found.append([str(event) for event in logged(caplog)])
    assert len(found[0]) > 5
    assert found[0] == found[1]


def test_a_turn_into_another_corridor_is_an_event(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, logger="fusion.estimator")
    flown, _ = fly_corridors(1, turning((7, 2, radians(90))), seen_as((8, 99, radians(90))))
    flown.estimator.finish()
    (change,) = [event for event in logged(caplog) if event.kind is EventKind.CORRIDOR_CHANGED]
    assert change.values["corridor_index"] == flown.corridor[-1] == 1
    assert float(change.values["corridor_turn_rad"]) == pytest.approx(flown.turn[-1], abs=0.1)


def test_it_is_quiet_by_default(tmp_path: Path) -> None:
    code = """
from fusion import CorridorEstimator, FusionConfig
estimator = CorridorEstimator(FusionConfig())
for k in range(600):
    estimator.add_imu(k * 5_000_000, (0, 0, 0), (0, 0, -9.8))
    estimator.add_unreadable_frame(k * 5_000_000)
estimator.finish()
assert estimator._events._finder is None
"""
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT)
    assert (run.returncode, run.stdout, run.stderr) == (0, "", "")


def test_the_summary_lists_them(tmp_path: Path) -> None:
    flight = load_flight(OFFICE)
    keep = flight.frames.t_ns < flight.frames.t_ns[0] + 3_000_000_000
    result = fuse_flight(replace(flight, frames=flight.frames.chosen(np.flatnonzero(keep))))
    write_summary(result.summary, tmp_path / "summary.json")
    events = json.loads((tmp_path / "summary.json").read_text())["events"]
    table = result.estimates
    changes = np.flatnonzero(table["status"][1:] != table["status"][:-1]) + 1
    status = [e for e in events if e["kind"] == "status_changed"]
    assert [e["status"] for e in status] == [table["status"][0], *table["status"][changes]]
    assert [e["timestamp_ns"] for e in status[1:]] == table["timestamp_ns"][changes].tolist()


def test_rejections_in_a_row_are_one_in_the_summary() -> None:
    def rejected(t_ns: int, reason: str) -> Event:
        return Event(t_ns, EventKind.FRAME_REJECTED, {"reason": reason})

    turn = Event(5, EventKind.CORRIDOR_CHANGED, {"corridor_index": 1, "corridor_turn_rad": 1.5})
    events = [rejected(1, "gate"), rejected(2, "gate"), rejected(3, "blur"), turn, rejected(6, "blur")]
    assert summary._summed_up(events) == (
        {"timestamp_ns": 1, "kind": "frame_rejected", "reason": "gate", "last_ns": 2, "frames": 2},
        {"timestamp_ns": 3, "kind": "frame_rejected", "reason": "blur", "last_ns": 3, "frames": 1},
        {"timestamp_ns": 5, "kind": "corridor_changed", "corridor_index": 1, "corridor_turn_rad": 1.5},
        {"timestamp_ns": 6, "kind": "frame_rejected", "reason": "blur", "last_ns": 6, "frames": 1},
    )
