"""The benchmark of faults: it judges rightly, puts in what it says, and what passes today goes on to pass."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from math import atan, atan2, degrees, inf, nan, radians, tan
from typing import Any

import faults
import numpy as np
import pytest

from fusion import Estimate
from support import fault_score, fault_table, injections, recording
from support.fault_score import Bound, Fault, Trace
from support.random_faults import DRAWS, random_faults
from tests.files import ROOT
from vision.types import FloatArray


@pytest.fixture(scope="module")
def clean() -> recording.Recording:
    return recording.simulated_recording(recording.base_scene(0, 10.0))


def trace_of(error_deg: FloatArray, told: np.ndarray | None = None, std_deg: float = 0.25) -> Trace:
    """Ten seconds of estimates every 20 ms."""
    n = len(error_deg)
    told = np.zeros(n, bool) if told is None else told
    reasons = tuple("coasting: test" if t else "tracking" for t in told)
    return Trace(
        np.arange(float(n)) * 0.02, error_deg, np.full(n, std_deg), ~told, told, reasons, 0, "", 0, 0
    )


def judged(trace: Trace, **bound: Any) -> fault_score.Outcome:
    return fault_score.judge(Fault("test", "-", None, Bound(**bound), start_s=2.0, end_s=4.0), trace)


def wrong_between(start_s: float, end_s: float, error_deg: float = 5.0) -> FloatArray:
    t = np.arange(500) * 0.02
    return np.where((t >= start_s) & (t < end_s), error_deg, 0.1)


# --- how it judges ---


def test_wrong_without_a_word_is_silent() -> None:
    outcome = judged(trace_of(wrong_between(2.0, 3.0)), within=10.0)
    assert outcome.silent_s == pytest.approx(1.0, abs=0.03)
    assert outcome.failures == ("silent",)
    assert outcome.told_s == inf
    assert (outcome.worst, outcome.worst_sigma) == (5.0, 20.0)


def test_wrong_and_told_at_once_is_no_fault() -> None:
    error = wrong_between(2.0, 3.0)
    outcome = judged(trace_of(error, error > 1.0), within=1.0, after=1.0, told_s=0.5)
    assert outcome.failures == ()
    assert outcome.told_s == pytest.approx(0.0, abs=0.03)


def test_a_wide_sigma_is_not_silent_but_an_error_all_the_same() -> None:
    outcome = judged(trace_of(wrong_between(2.0, 3.0), std_deg=2.0), within=1.5)
    assert outcome.silent_s == 0.0
    assert outcome.failures == ("error",)


def test_told_half_a_second_late_is_late_enough() -> None:
    error, t = wrong_between(2.0, 3.0), np.arange(500) * 0.02
    assert judged(trace_of(error, (t > 2.4) & (t < 3.0)), within=1.5).failures == ()
    assert "error" in judged(trace_of(error, (t > 2.7) & (t < 3.0)), within=1.5).failures
    assert "jolt" in judged(trace_of(error, (t > 2.4) & (t < 3.0)), at_once=3.0).failures
    assert "not told" in judged(trace_of(error, t > 2.7), told_s=0.5).failures


def test_recovery_is_of_the_error_and_of_the_status() -> None:
    still_wrong, t = wrong_between(2.0, 6.0, 0.9), np.arange(500) * 0.02
    assert judged(trace_of(still_wrong), after=0.5, recovery_s=1.0).failures == ("not recovered",)
    assert judged(trace_of(still_wrong), after=0.5, recovery_s=2.1).failures == ()
    assert judged(trace_of(still_wrong, t > 3.0), after=1.0).failures == ("not tracking again",)
    lost = np.where(t > 4.0, nan, 0.1)
    assert "not recovered" in judged(trace_of(lost, t > 4.0), after=1.0).failures


def test_crying_without_a_fault_fails() -> None:
    error, t = wrong_between(0.0, 0.0), np.arange(500) * 0.02
    assert judged(trace_of(error, t > 9.0), quiet=True).failures == ("false alarm",)
    assert judged(trace_of(error), quiet=True).failures == ()


def test_exceptions_numbers_and_counts_that_fall_are_told() -> None:
    trace = replace(trace_of(wrong_between(0.0, 0.0)), exceptions=2, not_finite=1, resets_taken_back=1)
    assert judged(trace).failures == ("2 exceptions", "1 not finite", "reset count falls")


def test_what_tells_of_the_heading() -> None:
    def told(status: str, reason: str) -> bool:
        return fault_score.is_told(Estimate(0, status=status, reason=reason), "heading")

    assert told("coasting", "")
    assert told("tracking", "gyroscope is silent")
    assert not told("tracking", "attitude is silent; frames show no lateral offset")
    assert fault_score.is_told(Estimate(0, status="tracking", reason="velocity is silent"), "lateral")


def test_numbers_that_are_none_are_found() -> None:
    known = Estimate(0, heading_rad=0.1, heading_std_rad=0.01, status="tracking")
    assert fault_score.is_sound(known)
    assert fault_score.is_sound(Estimate(0))
    assert not fault_score.is_sound(replace(known, heading_rad=nan))
    assert not fault_score.is_sound(replace(known, lateral_offset_m=inf))
    assert not fault_score.is_sound(replace(known, lateral_offset_norm_std=-0.1))


def test_the_plain_filter_is_what_the_steady_state_says(clean: recording.Recording) -> None:
    t = np.arange(4.0, 10.0, 0.02)
    error = fault_score.plain_kalman(clean, t) - np.interp(t, clean.t_s, clean.heading_rad)
    expected = np.sqrt(0.0075 * radians(0.5) * np.sqrt(1 / 30))
    assert np.sqrt((error**2).mean()) == pytest.approx(expected, rel=0.4)


# --- what it puts in ---


def test_every_fault_changes_something_and_has_a_name_of_its_own() -> None:
    names = [f.name for f in fault_table.FAULTS]
    assert len(names) == len(set(names)) >= 60
    assert sum(f.group == "pair" for f in fault_table.FAULTS) >= 10
    for fault in fault_table.FAULTS:
        assert fault.injection or fault.scene or fault.config or fault.group == "none", fault.name
        assert fault.bound != Bound(), fault.name


@pytest.mark.parametrize(
    "name",
    [
        "180 deg/s for 1 s",
        "camera clock jumps 0.1 s ahead",
        "velocities NaN",
        "gyro z stuck for 3 s",
        "gyro lags by 60 ms",
        "gyro samples held for 25 ms",
        "frame stamps twice as far apart",
        "frames show what was 0.17 s ago",
        "frames mirrored from 8 s on",
        "yaw frozen",
    ],
)
def test_a_fault_begins_when_it_says(name: str) -> None:
    before = recording.simulated_recording(recording.base_scene(0, 12.0))
    fault = fault_table.BY_NAME[name]
    assert fault.injection is not None
    after = fault.injection(before, np.random.default_rng(0))
    known = {(e.kind, e.true_ns): e for e in before.events}
    changed = [e.t_s for e in after.events if known.get((e.kind, e.true_ns)) is not e]
    assert min(changed) == pytest.approx(fault.start_s, abs=0.04)
    assert [e.arrival_ns for e in after.events] == sorted(e.arrival_ns for e in after.events)


def test_a_wrong_principal_point_moves_the_axis_as_a_pinhole_does() -> None:
    level = recording.simulated_recording(recording.base_scene(0, 1.0, tilt_rad=0.0))
    wrong = injections.calibration_wrong(right_px=50.0)(level, np.random.default_rng(0))
    short = injections.calibration_wrong(focal_factor=0.7)(level, np.random.default_rng(0))

    def headings(r: recording.Recording) -> list[float]:
        return [e.values[0].heading_rad for e in r.events if e.kind == "frame"]

    for true, off, scaled in zip(headings(level), headings(wrong), headings(short), strict=True):
        assert off == pytest.approx(atan(tan(true) - 50.0 / injections.FOCAL_LENGTH_PX), abs=1e-9)
        assert scaled == pytest.approx(atan(tan(true) / 0.7), abs=1e-9)


def test_an_attitude_upside_down_has_gravity_upwards() -> None:
    level = recording.simulated_recording(recording.base_scene(0, 1.0, tilt_rad=0.0, attitude_std_rad=1e-6))
    wrong = injections.attitude_upside_down()(level, np.random.default_rng(0))
    for event in wrong.events:
        if event.kind == "attitude":
            _, x, y, _ = event.values[0]
            assert 1 - 2 * (x * x + y * y) == pytest.approx(-1.0, abs=1e-6)
    turned = injections.yaw_off(radians(30), 0.0)(level, np.random.default_rng(0))
    pairs = [
        (a.values[0], b.values[0])
        for a, b in zip(level.events, turned.events, strict=True)
        if a.kind == "attitude"
    ]
    for q0, q1 in pairs:
        yaws = [atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)) for w, x, y, z in (q0, q1)]
        assert degrees(yaws[1] - yaws[0]) == pytest.approx(30.0, abs=1e-3)


def test_a_seed_is_a_flight() -> None:
    assert random_faults(3)[0] == random_faults(3)[0]
    assert faults.on_random(5, 8.0) == faults.on_random(5, 8.0)
    drawn = {name for seed in range(200) for name in random_faults(seed)[0].split(" + ")}
    assert drawn == set(DRAWS)


# --- what passes today ---


@pytest.mark.parametrize(
    "name",
    [
        "no fault, turns of 60 deg/s",
        "axis 30 deg off for 2 s",
        "axis 3 deg off for 2 s",
        "axis 10 deg off for 2 s, no attitude",
        "axis 3 deg off for 6 s",
        "axis 5 deg off for 5 s",
        "gyro bias steps 2 deg/s",
        "gyro bias steps 10 deg/s, noise 0.003",
        "gyro bias steps 10 deg/s, no attitude",
        "gyro bias grows 0.05 deg/s^2, noise 0.003",
        "bend of 2 deg/s for 10 s",
        "S-bend of 30 degrees",
        "180 deg/s for 1 s",
        "180 deg/s for 1 s, no attitude",
        "180 deg/s for 1 s + frames drop out for 5 s",
        "random axes for 10 s, gyro bias steps 10 deg/s",
        "frames of 120 Hz",
        "one IMU sample stamped 5 s ahead",
        "frame stamps jitter by 15 ms",
        "no axis found for 10 s, gyro bias steps 3 deg/s",
        "gyro NaN for 2 s",
        "gyro clipped at 250 deg/s, turns of 320 deg/s",
        "IMU dies at 5 of 15 s",
        "IMU dies at 5 of 15 s, no attitude",
        "attitude drops out for 5 s",
        "frames drop out for 5 s",
        "heading infinite",
        "velocities NaN",
        "one gyro sample of 300 rad/s, no attitude",
        "camera frozen for 3 s, no attitude",
        "attitude upside down",
        "gyro bias of 20 deg/s, no attitude",
        "IMU yaw jumps 180 deg",
        "exposure moves stamps by 0 to 40 ms",
        "frames show what was 0.17 s ago",
        "gyro y and z exchanged",
        "gyro z turns the wrong way",
        "frames mirrored from 8 s on",
        "axis 90 deg off for 3 s around a corner",
        "IMU drops out for 3 s + axis 10 deg off for 2 s",
        "IMU drops out for 3 s + frames drop out for 5 s",
        "camera clock jumps 0.1 s back + axis 5 deg off for 2 s",
    ],
)
def test_what_is_held_or_told_stays_so(name: str) -> None:
    fault = next(f for f in fault_table.FAULTS if f.name == name)
    outcome = faults.on_simulated(replace(fault, flights=1))
    assert outcome.failures == (), faults.row(fault, outcome)


def test_an_axis_that_turns_off_slowly_is_told_as_long_as_it_is_followed() -> None:
    # Had the bias taken up the bend's rate, the frames would seem to be well again: silent for 6 s.
    fault = fault_table.BY_NAME["axis turns off 1 deg/s for 10 s"]
    outcome = faults.on_simulated(replace(fault, flights=1))
    assert outcome.silent_s < 1.0, faults.row(fault, outcome)


def test_it_runs_and_prints_what_is_asked_beside_what_is_measured() -> None:
    command = [
        sys.executable,
        str(ROOT / "benchmarks" / "faults.py"),
        "--only",
        "F11",
        "--random",
        "2",
        "--seconds",
        "6",
    ]
    done = subprocess.run([*command, "--processes", "1"], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    for words in ("corner 0.4 half widths", "asked", "pass; silent beyond 0.5 s", "2 random flights of 6 s"):
        assert words in done.stdout
