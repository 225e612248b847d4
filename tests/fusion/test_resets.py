"""What a controller needs that must not be jolted: every jump of the estimate is counted, with its size."""

from __future__ import annotations

from math import degrees, isnan, radians
from typing import Any

import numpy as np
import pytest

from fusion.estimator.config import FusionConfig
from fusion.estimator.estimator import CorridorEstimator
from fusion.estimator.tables import ESTIMATE_DTYPE
from tests.fusion.simulated import Scene, frame, give, plus, simulate, turning, weaving, wrap

MS = 1_000_000


class Continuous:
    """Adds up the estimate less its announced steps, as a controller would, and notes the largest jolt."""

    def __init__(self, estimator: CorridorEstimator) -> None:
        self.estimator = estimator
        self.last = estimator.estimate()
        self.offset, self.heading_jolt, self.offset_jolt = float("nan"), 0.0, 0.0

    def look(self) -> None:
        now, last = self.estimator.estimate(), self.last
        if not isnan(last.heading_rad) and last.status != "initialising":
            step = now.reset_heading_rad if now.reset_count > last.reset_count else 0.0
            jolt = abs(float(wrap(now.heading_rad - last.heading_rad - step)))
            self.heading_jolt = max(self.heading_jolt, jolt)
        if not isnan(now.lateral_offset_norm):
            if not isnan(self.offset):
                step = now.reset_lateral_norm if now.lateral_reset_count > last.lateral_reset_count else 0.0
                self.offset_jolt = max(self.offset_jolt, abs(now.lateral_offset_norm - self.offset - step))
            self.offset = now.lateral_offset_norm
        self.last = now


def fly(
    watched: Continuous,
    t: int,
    seconds: float,
    heading: float | None,
    lateral: float = 0.3,
) -> int:
    for i in range(int(seconds * 100)):
        t += 10 * MS
        watched.estimator.add_imu(t, (0.0, 0.0, 0.0), (0.0, 0.0, -9.80665))
        watched.look()
        if heading is not None and i % 4 == 0:
            watched.estimator.add_measurement(t, frame(heading, lateral=lateral, lateral_std=0.02))
            watched.look()
    return t


def started(**config: Any) -> tuple[Continuous, int]:
    watched = Continuous(CorridorEstimator(FusionConfig(**config)))
    return watched, fly(watched, 0, 4.0, 0.2)


def test_nothing_is_counted_at_the_start() -> None:
    watched, _ = started()
    now = watched.last
    assert (now.reset_count, now.lateral_reset_count) == (0, 0)
    assert (now.reset_heading_rad, now.reset_lateral_norm, now.reset_lateral_m) == (0.0, 0.0, 0.0)


def test_a_turn_into_another_corridor_is_one_step_of_each() -> None:
    angle = radians(70)
    simulated = simulate(
        Scene(
            seed=4,
            duration_s=12,
            heading=plus(weaving(4, radians(6)), turning((5, 1.5, angle))),
            axis=lambda t: np.where(np.asarray(t) < 5.75, 0.0, angle),
            lateral=lambda t: np.where(np.asarray(t) < 5.75, 0.4, -0.3),
            gyro_hz=100,
            frame_hz=20,
            tilt_rad=radians(3),
        )
    )
    watched = Continuous(CorridorEstimator(FusionConfig(corridor_width_m=2.0)))
    for sample in simulated.samples:
        give(watched.estimator, sample)
        watched.look()
    now = watched.last
    assert now.corridor_index == now.reset_count == now.lateral_reset_count == 1
    assert now.reset_heading_rad == pytest.approx(-angle, abs=radians(2))
    assert now.reset_lateral_norm == pytest.approx(-0.7, abs=0.1)
    assert now.lateral_offset_norm == pytest.approx(-0.3, abs=0.1)
    assert now.reset_lateral_m == pytest.approx(now.reset_lateral_norm)  # half a width is one metre
    assert degrees(watched.heading_jolt) < 1.5
    assert watched.offset_jolt < 0.05


def test_found_again_after_loss_the_heading_steps() -> None:
    watched, t = started()
    t = fly(watched, t, 12.0, None)
    t += 600_000 * MS  # ten minutes of nothing: gyroscope too
    watched.estimator.add_imu(t, (0, 0, 0))
    watched.look()
    assert watched.last.status == "lost"
    fly(watched, t, 2.0, -0.5)
    now = watched.last
    assert now.status == "tracking"
    assert now.reset_count == 1
    assert now.reset_heading_rad == pytest.approx(-0.7, abs=0.05)
    assert now.lateral_reset_count == 1
    assert now.reset_lateral_norm == pytest.approx(0.0, abs=0.1)
    assert degrees(watched.heading_jolt) < 1.0


def test_a_recovery_steps() -> None:
    watched, t = started()
    timeline = watched.estimator._timeline
    x = timeline.state.x + np.array([radians(40), 0, 0])
    timeline.state = timeline.state._replace(x=x)
    watched.last = watched.estimator.estimate()  # the fault itself is no step of the estimator's
    fly(watched, t, 1.0, 0.2)
    assert watched.last.reset_count == 1
    assert degrees(watched.last.reset_heading_rad) == pytest.approx(-40, abs=1)
    assert degrees(watched.heading_jolt) < 0.5


def test_offsets_that_win_by_agreeing_are_a_step_of_the_offset_alone() -> None:
    watched, t = started()
    fly(watched, t, 1.5, 0.2, lateral=-0.2)
    assert (watched.last.lateral_status, watched.last.lateral_reset_count) == ("unknown", 0)
    fly(watched, t + 1500 * MS, 4.0, 0.2, lateral=-0.2)
    now = watched.last
    assert (now.reset_count, now.lateral_reset_count) == (0, 1)
    assert now.reset_lateral_norm == pytest.approx(-0.5, abs=0.03)
    assert isnan(now.reset_lateral_m)  # no width is known
    assert watched.offset_jolt < 0.05


def test_a_clock_that_is_set_back_hides_no_step() -> None:
    watched, t = started()
    watched.last = watched.estimator.estimate()
    fly(watched, t - 3_600_000 * MS, 2.0, 0.9, lateral=0.0)
    now = watched.last
    assert now.status == "tracking"
    assert now.reset_count == now.lateral_reset_count == 1
    assert now.reset_heading_rad == pytest.approx(0.7, abs=0.05)
    assert now.reset_lateral_norm == pytest.approx(-0.3, abs=0.1)


def test_the_contract_columns_stay_as_they_are() -> None:
    assert not any("reset" in name for name in ESTIMATE_DTYPE.names or ())


def test_the_first_frame_after_a_gap_makes_a_step() -> None:
    """Inside the gate, so that no recovery is needed; without a count a controller would be jolted by it."""
    watched, t = started()
    for _ in range(800):
        t += 10 * MS
        watched.estimator.add_imu(t, (0.0, 0.0, 0.01), (0.0, 0.0, -9.80665))
        watched.look()
    assert watched.last.reset_count == 0
    watched.estimator.add_measurement(t, frame(0.2))
    watched.look()
    assert watched.last.status == "tracking"
    assert watched.last.reset_count == 1
    assert watched.last.reset_heading_total_rad == watched.last.reset_heading_rad
    assert watched.last.reset_heading_rad == pytest.approx(-0.08, abs=0.02)
    assert degrees(watched.heading_jolt) < 0.5


def test_increments_that_a_held_rate_got_wrong_are_a_step() -> None:
    """A frame has 2 rad/s held for 85 ms; the next sample tells that the vehicle turned back meanwhile."""
    watched, t = started()
    watched.estimator.add_imu(t + 10 * MS, (0.0, 0.0, 2.0), (0.0, 0.0, -9.80665))
    watched.look()
    watched.estimator.add_unreadable_frame(t + 95 * MS)
    watched.look()
    watched.estimator.add_imu(t + 100 * MS, (0.0, 0.0, -2.0), (0.0, 0.0, -9.80665))
    watched.look()
    assert watched.last.reset_count == 1
    assert watched.last.reset_heading_rad == pytest.approx(-2.0 * 0.085, abs=0.01)
