"""The benchmark of junctions: its flights are what they say, and what is wrong is counted as wrong."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from math import degrees, pi, radians
from pathlib import Path

import junctions
import numpy as np
import pytest

BENCHMARKS = Path(__file__).resolve().parent.parent / "benchmarks"

TURNS = [name for name in junctions.KINDS if name.startswith("turn, ")]


@pytest.mark.parametrize("name", TURNS)
def test_turns_end_in_the_corridor_that_frames_then_see(name: str) -> None:
    angles = []
    for seed in range(40):
        case = junctions.KINDS[name](seed)
        end = np.array(case.scene.duration_s)
        assert case.scene.axis(np.array(0.0)) == 0
        assert case.scene.axis(end) == pytest.approx(case.turn_rad)
        assert abs(case.scene.heading(end) - case.turn_rad) < radians(8.1)  # but for the weaving
        angles.append(degrees(case.turn_rad))
    assert 30 <= np.abs(angles).min() < 45
    assert 135 < np.abs(angles).max() <= 150
    assert min(angles) < 0 < max(angles)


def test_camera_sees_neither_corridor_far_to_the_side() -> None:
    for seed in range(40):
        scene = junctions.turned(seed, "seen as by a camera").scene
        case = junctions.turned(seed, "seen as by a camera")
        t = np.arange(5.0, scene.duration_s - junctions.END_S, 0.02)
        lost = np.any([(t >= a) & (t < b) for a, b in scene.dropouts], axis=0) if scene.dropouts else t < 0
        seen = scene.axis(t)
        corridor = np.isclose(seen, 0.0) | np.isclose(seen, case.turn_rad)
        off = np.abs(scene.heading(t) - seen)
        assert (off[corridor & ~lost] < junctions.VIEW_RAD + radians(12)).all()


def test_what_does_not_end_in_a_corridor_ends_in_the_first() -> None:
    passed, about = junctions.passed(1), junctions.about(2)
    for case in (passed, about):
        assert (case.corridor, case.turn_rad) == (0, 0.0)
        assert case.scene.axis(np.array(case.scene.duration_s)) == 0.0
    assert abs(about.scene.heading(np.array(about.scene.duration_s))) == pytest.approx(pi, abs=radians(8.1))


def test_wrong_corridor_and_wrong_turn_are_counted() -> None:
    case = junctions.turned(0, "always")
    assert junctions.fly(case).right
    assert not junctions.fly(replace(case, corridor=0)).right
    assert not junctions.fly(replace(case, turn_rad=case.turn_rad + radians(11))).right


def test_it_runs() -> None:
    done = subprocess.run(
        [sys.executable, str(BENCHMARKS / "junctions.py"), "--count", "6"], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert "of 8 wrong" in done.stdout
