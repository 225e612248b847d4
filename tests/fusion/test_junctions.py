"""Turns into other corridors, and what only looks like one."""

from __future__ import annotations

from math import degrees, radians
from typing import Any

import numpy as np
import pytest

from tests.fusion.simulated import (
    Function,
    Run,
    Scene,
    heading_error,
    plus,
    run,
    simulate,
    turning,
    weaving,
    wrap,
)

COMMON: dict[str, Any] = {
    "gyro_hz": 100.0,
    "frame_hz": 20.0,
    "gross": 0.05,
    "delay_s": 0.08,
    "duration_s": 18.0,
}


def seen_as(*pieces: tuple[float, float, float]) -> Function:
    """Direction of the axis that frames see: zero but for (from s, to s, angle rad)."""

    def axis(t: np.ndarray) -> np.ndarray:
        t = np.asarray(t, float)
        angle = np.zeros_like(t)
        for start, end, value in pieces:
            angle = np.where((t >= start) & (t < end), value, angle)
        return angle

    return axis


def fly(seed: int, heading: Function, axis: Function, **changes: Any) -> tuple[Run, Any]:
    simulated = simulate(
        Scene(seed=seed, heading=plus(heading, weaving(seed, radians(6))), axis=axis, **(COMMON | changes))
    )
    return run(simulated, every=5), simulated


def check(result: Run, simulated: Any, corridor: int, turn_rad: float) -> None:
    """The last corridor, its direction, and the heading in it."""
    late = result.t_s > simulated.scene.duration_s - 3
    assert (result.corridor[late] == corridor).all()
    assert degrees(abs(result.turn[-1] - turn_rad)) < 3
    error = heading_error(result, simulated, result.turn)
    # The new axis is as well known as the turn was followed; relative to it the heading is as good as ever.
    assert degrees(np.abs(error[late] - np.median(error[late])).max()) < 1.5
    truth = np.interp(result.t_s, simulated.t_s, simulated.heading) - turn_rad
    assert degrees(np.abs(wrap(result.heading - truth))[late].max()) < 1.5


@pytest.mark.parametrize("angle_deg", [30, -45, -65, 90, -90, 120, -150])
@pytest.mark.parametrize("gap_s", [0.0, 1.5])
def test_turn_into_another_corridor(angle_deg: float, gap_s: float) -> None:
    """At any angle, with and without a stretch in which no frame is of use."""
    angle = radians(angle_deg)
    gap = [(8.0 - gap_s / 2, 8.0 + gap_s / 2)] if gap_s else ()
    result, simulated = fly(1, turning((7, 2, angle)), seen_as((8, 99, angle)), dropouts=gap)
    check(result, simulated, 1, angle)
    switched = result.t_s[np.argmax(result.corridor)]
    assert 8.0 < switched < 11.0
    before = (result.t_s > 1) & (result.corridor == 0)
    assert (
        degrees(np.abs(heading_error(result, simulated)[before]).max()) < 1.5
    )  # carried on through the turn
    estimate = result.estimator.estimate()
    assert estimate.reset_count == 1
    assert degrees(abs(estimate.reset_heading_rad + angle)) < 3


@pytest.mark.parametrize("angle_deg", [450, -450])
def test_a_spin_before_the_other_corridor_does_not_count_into_its_angle(angle_deg: float) -> None:
    angle = radians(angle_deg)
    corner = float(np.copysign(radians(90), angle))
    turned = turning((7, 4, angle))
    result, simulated = fly(1, turned, seen_as((9, 99, corner)), dropouts=[(7.0, 11.0)])
    assert degrees(abs(result.turn[-1] - corner)) < 5
    assert result.corridor[-1] == 1
    assert degrees(np.abs(heading_error(result, simulated, result.turn)[result.t_s > 15]).max()) < 5


def test_two_turns_and_a_corridor_parallel_to_the_first() -> None:
    result, simulated = fly(
        2, turning((5, 1.5, radians(90)), (11, 1.5, radians(-90))), seen_as((5.75, 11.75, radians(90)))
    )
    check(result, simulated, 2, 0.0)


def test_turn_of_half_a_circle_stays_in_the_corridor() -> None:
    result, simulated = fly(3, turning((7, 2, radians(180))), seen_as())
    check(result, simulated, 0, 0.0)


@pytest.mark.parametrize("direction_deg", [90, 60, -40])
def test_side_corridor_passed_without_turning(direction_deg: float) -> None:
    result, simulated = fly(4, turning(), seen_as((8, 10, radians(direction_deg))))
    check(result, simulated, 0, 0.0)
    assert (result.corridor == 0).all()
    assert degrees(np.abs(heading_error(result, simulated)[result.t_s > 1]).max()) < 1.5


def test_wall_looked_at_in_passing() -> None:
    """Sixty degrees to the side and back, while frames see the direction across the corridor."""
    look = turning((7, 1, radians(60)), (11, 1, radians(-60)))
    result, simulated = fly(5, look, seen_as((8, 9.8, radians(90))))
    check(result, simulated, 0, 0.0)
    assert (result.corridor == 0).all()


def test_look_into_a_side_corridor_and_back() -> None:
    look = turning((6, 1, radians(90)), (8.5, 1, radians(-90)))
    result, simulated = fly(6, look, seen_as((6.6, 9.0, radians(90))))
    check(result, simulated, 0, 0.0)


def test_walls_of_the_old_corridor_seen_while_turning() -> None:
    result, simulated = fly(
        7, turning((7, 3, radians(65))), seen_as((7.5, 10, radians(-25)), (10, 99, radians(65)))
    )
    check(result, simulated, 1, radians(65))


def test_first_guess_of_the_new_axis_is_corrected() -> None:
    """After the turn a wall across is seen for two seconds, then the corridor."""
    angle = radians(65)
    result, simulated = fly(8, turning((7, 2, angle)), seen_as((8, 10, radians(90)), (10, 99, angle)))
    check(result, simulated, 1, angle)


def test_junction_without_a_gyroscope() -> None:
    """Five frames a second with the attitude of an autopilot: no gyroscope stream."""
    angle = radians(-65)
    scene = {
        "attitude_hz": 5.0,
        "frame_hz": 5.0,
        "delay_s": 0.0,
        "yaw_std_rad": radians(0.1),
        "duration_s": 22.0,
    }
    simulated = simulate(
        Scene(seed=9, heading=turning((9, 2, angle)), axis=seen_as((10, 99, angle)), **(COMMON | scene))
    )
    result = run(simulated, kinds=("attitude", "frame"), every=1)
    check(result, simulated, 1, angle)


def test_lateral_offset_starts_anew_in_the_new_corridor() -> None:
    def lateral(t: np.ndarray) -> np.ndarray:
        return np.where(np.asarray(t, float) < 8, 0.5, -0.4)

    result, _ = fly(10, turning((7, 2, radians(90))), seen_as((8, 99, radians(90))), lateral=lateral)
    first = int(np.argmax(result.corridor))
    old, new = result.lateral[(result.t_s > 1) & (result.t_s < 7)], result.lateral[first:]
    assert np.isfinite(old).mean() > 0.8
    assert old[np.isfinite(old)] == pytest.approx(0.5, abs=0.1)
    assert new[np.isfinite(new)] == pytest.approx(-0.4, abs=0.1)
