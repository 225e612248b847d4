"""Checks of frames, clocks and rates, and how the page orders and words them."""

from __future__ import annotations

from math import radians
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from fusion.config import FusionConfig
from fusion.flight import FrameStream, ImuStream
from fusion.report.camera_time import frames_lateness
from fusion.report.checks import run_checks
from fusion.report.page import _with_code
from fusion.report.verdict import Check, Level, worst_first, worst_of
from fusion.tables import ESTIMATE_DTYPE, FRAME_DTYPE
from tests.fusion.test_report import change, make_flight, table_with

T0_NS = 1_600_000_000_000_000_000


def filtered(
    late_s: float, *, swing_rad: float = radians(15), noise_rad: float = radians(0.2), delay_s: float = 0.0
) -> Any:
    """Fuse headings by a filter of one number and fixed gain, frames stamped late; a minute at 20 Hz."""
    rng = np.random.default_rng(4)
    t = np.arange(0.0, 60.0, 0.01)
    gain, gate = 0.2, 4.0

    def heading(at: Any) -> Any:
        return swing_rad * (np.sin(1.3 * at) + 0.4 * np.sin(3.1 * at))

    frames = np.zeros(1200, FRAME_DTYPE)
    frames["timestamp_ns"] = T0_NS + np.arange(1200) * 50_000_000 + round(delay_s * 1e9)
    frames["accepted"] = True
    at = (
        np.arange(1200) * 0.05 - late_s
    )  # when the pictures were really taken, for a filter that knows delay_s
    seen = heading(at) + rng.normal(0, noise_rad, 1200)
    error, errors = 0.0, np.zeros(len(t))
    variance = noise_rad**2 / (1 - gain)
    for k in range(1200):
        innovation = seen[k] - heading(k * 0.05) - error
        frames["innovation_rad"][k] = innovation
        frames["test_ratio"][k] = innovation**2 / (gate**2 * variance)
        error += 0.85 * gain * innovation
        errors[5 * k : 5 * k + 5] = error
    table = np.zeros(len(t), ESTIMATE_DTYPE)
    table["timestamp_ns"] = T0_NS + np.round(t * 1e9).astype(np.int64)
    table["heading_rad"] = heading(t) + errors
    table["heading_std_rad"] = np.sqrt(gain * variance)
    config = FusionConfig(camera_delay_s=delay_s)
    return SimpleNamespace(frames=frames, estimates=table, smoothed=table, config=config)


class TestCameraTime:
    @pytest.mark.parametrize("late_s", [-0.04, -0.01, 0.0, 0.01, 0.04])
    def test_lateness_is_found_within_its_sigma(self, late_s: float) -> None:
        found = frames_lateness(filtered(late_s))
        assert found.std_s < 0.008
        assert abs(found.late_s - late_s) < 3 * found.std_s

    def test_what_the_configuration_knows_is_not_found_again(self) -> None:
        found = frames_lateness(filtered(0.0, delay_s=0.08))
        assert abs(found.late_s) < 3 * found.std_s
        assert found.std_s < 0.004

    def test_gross_errors_do_not_move_it(self) -> None:
        result = filtered(0.03)
        result.frames["innovation_rad"][::15] += radians(25)
        found = frames_lateness(result)
        assert found.late_s == pytest.approx(0.03, abs=0.006)

    def test_without_turns_it_is_not_known(self) -> None:
        assert np.isnan(frames_lateness(filtered(0.03, swing_rad=radians(0.01))).late_s)

    def test_few_frames_tell_nothing(self) -> None:
        result = filtered(0.03)
        result.frames = result.frames[:20]
        assert np.isnan(frames_lateness(result).late_s)
        result.frames = result.frames[:0]
        assert np.isnan(frames_lateness(result).std_s)


@pytest.fixture(scope="module")
def swing(tmp_path_factory: Any) -> Any:
    return make_flight(tmp_path_factory.mktemp("swing"), pictures=False)


def check_of(name: str, result: Any, flight: Any) -> Check:
    return next(check for check in run_checks(result, flight) if check.name == name)


class TestFrames:
    def rejected(self, swing: Any, **counts: int) -> Check:
        result, flight = swing
        frames, start = result.frames, 0
        for reason, count in counts.items():
            rows = slice(start, start + count)
            frames = table_with(frames, accepted=(rows, False), reason=(rows, reason))
            start += count
        return check_of("Rejected frames by reason", change(result, frames=frames), flight)

    def test_the_worst_reason_sets_level_and_advice(self, swing: Any) -> None:
        assert self.rejected(swing).value == "None"
        check = self.rejected(swing, gate=6, blur=5)
        assert (check.level, check.value) == (Level.PASS, "gate 5.0%, blur 4.2%")
        check = self.rejected(swing, gate=6, blur=20)
        assert check.level is Level.WARN
        assert check.value.startswith("blur 16.7%, gate")
        assert "exposure" in check.action
        assert self.rejected(swing, too_few_lines=60).level is Level.FAIL

    def test_a_single_damaged_picture_is_a_warning(self, swing: Any) -> None:
        check = self.rejected(swing, unreadable=1, gate=4)
        assert check.level is Level.WARN
        assert "does not decode" in check.meaning
        assert "copy the flight again" in check.action
        assert "buffer_s" in self.rejected(swing, late=2).action

    @pytest.mark.parametrize(
        ("late_s", "level"), [(0.0, Level.PASS), (0.035, Level.WARN), (-0.09, Level.FAIL)]
    )
    def test_the_time_offset_is_judged_and_sends_to_align(
        self, swing: Any, late_s: float, level: Level
    ) -> None:
        result, flight = swing
        other = filtered(late_s)
        parts = {
            "frames": other.frames,
            "estimates": other.estimates,
            "smoothed": other.smoothed,
            "config": other.config,
        }
        check = check_of("Time offset of the camera", change(result, **parts), change(flight, truth=None))
        assert check.level is level
        assert ("corridor align" in check.action) is (level is not Level.PASS)
        if level is Level.FAIL:
            assert check.value.endswith("ms early")


class TestRates:
    def test_slow_streams_are_told(self, swing: Any) -> None:
        result, flight = swing
        assert check_of("Rates of the streams", result, flight).level is Level.PASS
        imu, attitude = flight.imu, flight.attitude

        def every(k: int) -> Any:
            return change(
                flight,
                imu=ImuStream(imu.t_ns[::k], imu.gyro_rad_s[::k], imu.accel_m_s2[::k]),
                attitude=type(attitude)(attitude.t_ns[::k], attitude.q_world_body[::k]),
            )

        check = check_of("Rates of the streams", result, every(5))
        assert (check.level, check.value) == (Level.WARN, "frames 10 Hz, IMU 10 Hz, attitude 10 Hz")
        assert "Inertial samples" in check.meaning
        assert check_of("Rates of the streams", result, every(60)).level is Level.FAIL

    def test_without_inertial_sensors_it_warns(self, swing: Any) -> None:
        result, flight = swing
        check = check_of("Rates of the streams", result, change(flight, imu=None, attitude=None))
        assert (check.level, check.value) == (Level.WARN, "frames 10 Hz")
        assert "Log the gyroscope" in check.action

    def test_slow_or_single_frames(self, swing: Any) -> None:
        result, flight = swing
        frames = flight.frames
        slow = change(flight, frames=FrameStream(frames.t_ns[::20], frames.source))
        assert check_of("Rates of the streams", result, slow).level is Level.FAIL
        one = change(flight, frames=FrameStream(frames.t_ns[:1], frames.source))
        assert check_of("Rates of the streams", result, one).level is Level.NOT_JUDGED


def test_a_few_gross_errors_spoil_the_sigma(swing: Any) -> None:
    result, flight = swing
    off = {"heading_rad": (slice(100, 130), radians(40))}
    check = check_of(
        "Errors against their sigma", change(result, estimates=table_with(result.estimates, **off)), flight
    )
    assert check.level is Level.FAIL


def test_the_bias_names_its_side_not_a_sign(swing: Any) -> None:
    result, flight = swing
    assert "°/s to the right at the end" in check_of("Gyro bias", result, flight).value
    left = table_with(result.smoothed, gyro_bias_rad_s=(slice(None), -0.01))
    assert check_of("Gyro bias", change(result, smoothed=left), flight).value.startswith(
        "0.57°/s to the left"
    )


def test_every_check_says_what_it_means_and_what_to_do(swing: Any) -> None:
    result, flight = swing
    bad = table_with(
        result.frames,
        accepted=(slice(0, 100), False),
        reason=(slice(0, 100), "gate"),
        test_ratio=(slice(0, 100), 9.0),
    )
    for check in run_checks(change(result, frames=bad, problems=("torn",)), flight):
        assert check.limit
        assert check.meaning.endswith(".")
        assert check.value
        if check.level in (Level.WARN, Level.FAIL):
            assert check.action.endswith("."), check.name


def test_the_worst_comes_first_and_else_the_order_stays() -> None:
    levels = (Level.PASS, Level.NOT_JUDGED, Level.WARN, Level.FAIL, Level.WARN, Level.PASS)
    checks = [Check(str(k), level, "", "", "") for k, level in enumerate(levels)]
    assert [check.name for check in worst_first(checks)] == ["3", "2", "4", "0", "5", "1"]
    assert worst_of(Level.PASS, Level.NOT_JUDGED) is Level.PASS
    assert worst_of(Level.WARN, Level.FAIL, Level.PASS) is Level.FAIL


def test_commands_in_a_sentence_are_set_as_code_and_escaped() -> None:
    assert _with_code("Run `a <b>` & go.") == "Run <code>a &lt;b&gt;</code> &amp; go."
