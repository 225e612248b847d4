"""Checks of frames, clocks and rates, and how the page orders and words them."""

from __future__ import annotations

import re
from dataclasses import replace
from math import radians

import numpy as np
import pytest

from fusion.estimator.config import FusionConfig
from fusion.estimator.tables import FRAME_DTYPE
from fusion.evaluation import checks_cause
from fusion.evaluation.checks import CHECKS, run_checks
from fusion.evaluation.checks_frames import REASON_ACTION
from fusion.evaluation.verdict import CheckRule, Finding, Limits, nothing_to_judge, worst_first, worst_of
from fusion.flight import Flight, FloatArray, FrameStream, GreyImage, ImuStream
from fusion.report.template import with_code
from fusion.result.result import FusionResult
from fusion.result.summary import Check, Level
from tests.fusion.fused import T0_NS, Fused, make_flight, table_with
from vision.measurement import REASON_MEANING, Reason


def turning(
    swing: Fused, late_s: float = 0.0, *, swing_rad: float = radians(15), delay_s: float = 0.0
) -> Fused:
    """Make a minute of turning to and fro, its frames stamped late, for a filter that knows of ``delay_s``."""
    result, flight = swing
    rng = np.random.default_rng(4)

    def heading(at: FloatArray) -> FloatArray:
        return swing_rad * (np.sin(1.3 * at) + 0.4 * np.sin(3.1 * at))

    t = np.arange(0.0, 60.0, 0.01)
    gyro = np.column_stack([0 * t, 0 * t, np.gradient(heading(t), t) + rng.normal(0, 0.02, len(t))])
    imu = ImuStream(T0_NS + np.round(t * 1e9).astype(np.int64), gyro, np.full((len(t), 3), [0, 0, -9.81]))
    frames = np.zeros(1200, FRAME_DTYPE)
    taken_s = 0.05 * np.arange(1200.0)
    frames["timestamp_ns"] = T0_NS + np.round((taken_s + late_s + delay_s) * 1e9).astype(np.int64)
    frames["accepted"], frames["reason"] = True, "ok"
    frames["heading_rad"] = heading(taken_s) + rng.normal(0, radians(0.2), 1200)
    frames["heading_std_rad"] = radians(0.2)
    config = FusionConfig(camera_delay_s=delay_s)
    return (
        replace(result, frames=frames, config=config),
        replace(flight, imu=imu, attitude=None, truth=None),
    )


@pytest.fixture(scope="module")
def swing(tmp_path_factory: pytest.TempPathFactory) -> Fused:
    return make_flight(tmp_path_factory.mktemp("swing"), pictures=False)


def check_of(name: str, result: FusionResult, flight: Flight) -> Check:
    return next(check for check in run_checks(result, flight) if check.name == name)


class SmallPictures:
    def read(self, index: int) -> GreyImage:
        return np.zeros((120, 160), np.uint8)


class TestFrames:
    def rejected(self, swing: Fused, **counts: int) -> Check:
        result, flight = swing
        frames, start = result.frames, 0
        for reason, count in counts.items():
            rows = slice(start, start + count)
            frames = table_with(frames, accepted=(rows, False), reason=(rows, reason))
            start += count
        return check_of("Rejected frames by reason", replace(result, frames=frames), flight)

    @pytest.mark.parametrize("name", ["Frames used", "Rejected frames by reason"])
    def test_pictures_of_another_size_are_not_called_damaged(self, swing: Fused, name: str) -> None:
        result, flight = swing
        frames = table_with(
            result.frames, accepted=(slice(0, 40), False), reason=(slice(0, 40), "unreadable")
        )
        flight = replace(flight, frames=FrameStream(flight.frames.t_ns, SmallPictures()))
        camera = flight.camera
        check = check_of(name, replace(result, frames=frames), flight)
        assert f"the camera's {camera.width_px}x{camera.height_px}" in check.meaning
        assert "calibration of these pictures" in check.action
        assert "decoded" not in check.meaning

    def at_a_junction(self, swing: Fused, *corridors: int) -> Fused:
        """A flight whose frames 40 to 59 saw another corridor, 65 degrees to the left."""
        result, flight = swing
        held, turn = slice(40, 60), -radians(65)
        frames = table_with(
            result.frames,
            accepted=(held, False),
            reason=(held, "gate"),
            innovation_rad=(held, -turn + radians(1)),
            test_ratio=(held, 900.0),
        )
        estimates = result.estimates.copy()
        for row, corridor in zip((299, 400), corridors, strict=False):
            estimates["corridor_index"][row:] = corridor
            estimates["corridor_turn_rad"][row:] = turn * corridor
        return replace(result, frames=frames, estimates=estimates), flight

    def test_frames_held_back_until_a_junction_was_confirmed_contradict_nothing(self, swing: Fused) -> None:
        result, flight = self.at_a_junction(swing, 1)
        rejections = check_of("Rejected frames by reason", result, flight)
        assert (rejections.level, rejections.number) == (Level.PASS, 0.0)
        assert rejections.value == "held back at a junction 16.7%"
        over = check_of("Innovations over the gate", result, flight)
        assert (over.level, over.value) == (Level.PASS, "0.0% of 100")

    @pytest.mark.parametrize("corridors", [(), (1, 0)])
    def test_without_a_confirmed_junction_they_do(self, swing: Fused, corridors: tuple[int, ...]) -> None:
        result, flight = self.at_a_junction(swing, *corridors)
        assert check_of("Rejected frames by reason", result, flight).value == "gate 16.7%"
        assert check_of("Innovations over the gate", result, flight).level is Level.WARN

    def test_frames_of_a_third_direction_do_too(self, swing: Fused) -> None:
        result, flight = self.at_a_junction(swing, 1)
        result = replace(result, frames=table_with(result.frames, innovation_rad=(slice(40, 50), 0.5)))
        assert "gate 8.3%" in check_of("Rejected frames by reason", result, flight).value
        assert check_of("Innovations over the gate", result, flight).value == "9.1% of 110"

    def test_the_worst_reason_sets_level_and_advice(self, swing: Fused) -> None:
        assert self.rejected(swing).value == "None"
        check = self.rejected(swing, gate=6, blur=5)
        assert (check.level, check.value) == (Level.PASS, "gate 5.0%, blur 4.2%")
        check = self.rejected(swing, gate=6, blur=20)
        assert check.level is Level.WARN
        assert check.value.startswith("blur 16.7%, gate")
        assert "exposure" in check.action
        assert self.rejected(swing, too_few_lines=60).level is Level.FAIL

    def test_a_single_damaged_picture_is_a_warning(self, swing: Fused) -> None:
        check = self.rejected(swing, unreadable=1, gate=4)
        assert check.level is Level.WARN
        assert "could not be decoded" in check.meaning
        assert "copy the flight again" in check.action
        assert "buffer_s" in self.rejected(swing, late=2).action

    @pytest.mark.parametrize(
        ("late_s", "level"),
        [(0.0, Level.PASS), (0.012, Level.PASS), (0.035, Level.WARN), (-0.09, Level.FAIL), (1.3, Level.FAIL)],
    )
    def test_the_time_offset_is_judged_and_sends_to_align(
        self, swing: Fused, late_s: float, level: Level
    ) -> None:
        check = check_of("Time offset of the camera", *turning(swing, late_s))
        assert check.level is level
        assert ("corridor align" in check.action) is (level is not Level.PASS)
        assert check.value.startswith(f"Frames stamped {1e3 * abs(late_s):.0f} ± ")
        if late_s:
            assert check.value.endswith("ms early" if late_s < 0 else "ms late")

    def test_the_offset_that_the_configuration_knows_is_none(self, swing: Fused) -> None:
        check = check_of("Time offset of the camera", *turning(swing, delay_s=0.08))
        assert check.level is Level.PASS
        assert "0.08" in check_of("Time offset of the camera", *turning(swing, 0.1, delay_s=0.08)).action

    def test_without_turns_or_frames_or_a_gyroscope_the_offset_is_not_judged(self, swing: Fused) -> None:
        name = "Time offset of the camera"
        assert check_of(name, *turning(swing, swing_rad=radians(0.01))).level is Level.NOT_JUDGED
        result, flight = turning(swing)
        blind = replace(result, frames=result.frames[:0])
        assert check_of(name, blind, flight).level is Level.NOT_JUDGED
        assert check_of(name, result, replace(flight, imu=None)).level is Level.NOT_JUDGED


class TestRates:
    def test_slow_streams_are_told(self, swing: Fused) -> None:
        result, flight = swing
        assert check_of("Rates of the streams", result, flight).level is Level.PASS
        imu, attitude = flight.imu, flight.attitude
        assert imu is not None
        assert attitude is not None

        def every(k: int) -> Flight:
            return replace(
                flight,
                imu=ImuStream(imu.t_ns[::k], imu.gyro_rad_s[::k], imu.accel_m_s2[::k]),
                attitude=type(attitude)(attitude.t_ns[::k], attitude.q_world_body[::k]),
            )

        check = check_of("Rates of the streams", result, every(5))
        assert (check.level, check.value) == (Level.WARN, "frames 10 Hz, IMU 10 Hz, attitude 10 Hz")
        assert "Inertial samples" in check.meaning
        assert check_of("Rates of the streams", result, every(60)).level is Level.FAIL

    def test_without_inertial_sensors_it_warns(self, swing: Fused) -> None:
        result, flight = swing
        check = check_of("Rates of the streams", result, replace(flight, imu=None, attitude=None))
        assert (check.level, check.value) == (Level.WARN, "frames 10 Hz")
        assert "Log the gyroscope" in check.action

    def test_slow_or_single_frames(self, swing: Fused) -> None:
        result, flight = swing
        frames = flight.frames
        slow = replace(flight, frames=FrameStream(frames.t_ns[::20], frames.source))
        assert check_of("Rates of the streams", result, slow).level is Level.FAIL
        one = replace(flight, frames=FrameStream(frames.t_ns[:1], frames.source))
        assert check_of("Rates of the streams", result, one).level is Level.NOT_JUDGED


def test_a_few_gross_errors_spoil_the_sigma(swing: Fused) -> None:
    result, flight = swing
    off = {"heading_rad": (slice(100, 130), radians(40))}
    check = check_of(
        "Errors against their sigma", replace(result, estimates=table_with(result.estimates, **off)), flight
    )
    assert check.level is Level.FAIL


def test_the_bias_names_its_side_not_a_sign(swing: Fused) -> None:
    result, flight = swing
    assert "°/s to the right at the end" in check_of("Gyro bias", result, flight).value
    left = table_with(result.smoothed, gyro_bias_rad_s=(slice(None), -0.01))
    assert check_of("Gyro bias", replace(result, smoothed=left), flight).value.startswith(
        "0.57°/s to the left"
    )


def test_every_check_says_what_it_means_and_what_to_do(swing: Fused) -> None:
    result, flight = swing
    bad = table_with(
        result.frames,
        accepted=(slice(0, 100), False),
        reason=(slice(0, 100), "gate"),
        test_ratio=(slice(0, 100), 9.0),
    )
    for check in run_checks(replace(result, frames=bad, problems=("torn",)), flight):
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
    assert with_code("Run `a <b>` & go.") == "Run <code>a &lt;b&gt;</code> &amp; go."


class TestRules:
    """How a rule of the table turns a finding into a line of the verdict."""

    def rule(self, finding: Finding) -> CheckRule:
        return CheckRule(
            name="Speed",
            measure=lambda result, flight, limits: finding,
            pass_fail=lambda limits: limits.coast_s,
            limit=lambda limits: f"pass to {limits.coast_s[0]:g}",
            good="Fine.",
            bad="Too much.",
            remedy="Less.",
        )

    @pytest.mark.parametrize(
        ("number", "level", "meaning", "action"),
        [
            (2.0, Level.PASS, "Fine.", ""),
            (2.1, Level.WARN, "Too much.", "Less."),
            (10.1, Level.FAIL, "Too much.", "Less."),
        ],
    )
    def test_a_number_is_compared_with_the_limits(
        self, swing: Fused, number: float, level: Level, meaning: str, action: str
    ) -> None:
        check = self.rule(Finding("n", number)).apply(*swing, Limits(coast_s=(2.0, 10.0)))
        assert check == Check("Speed", level, "n", "pass to 2", meaning, action, number)

    def test_a_finding_may_say_more_than_its_rule(self, swing: Fused) -> None:
        finding = Finding("n", level=Level.WARN, limit="other", meaning="Because.", action="Do.")
        check = self.rule(finding).apply(*swing, Limits())
        assert check == Check("Speed", Level.WARN, "n", "other", "Because.", "Do.")

    def test_nothing_to_judge_asks_for_nothing(self, swing: Fused) -> None:
        check = self.rule(nothing_to_judge("No data.")).apply(*swing, Limits())
        assert (check.level, check.meaning, check.action) == (Level.NOT_JUDGED, "No data.", "")

    def test_a_finding_without_outcome_is_refused(self, swing: Fused) -> None:
        with pytest.raises(ValueError, match="neither a level nor a number"):
            self.rule(Finding("n")).apply(*swing, Limits())

    def test_the_names_tell_the_checks_apart(self, swing: Fused) -> None:
        names = [check.name for check in run_checks(*swing)]
        assert names == [rule.name for rule in CHECKS]
        assert len(set(names)) == len(names)


class TestLikelyCause:
    """Half of the frames are rejected; the cause is told before that, with the setting to change."""

    def cause(self, fused: Fused, gyro: float = 1.0, *, accel: bool = True) -> list[Check]:
        result, flight = fused
        assert flight.imu is not None
        imu = replace(flight.imu, gyro_rad_s=gyro * flight.imu.gyro_rad_s)
        if not accel:
            imu = replace(imu, accel_m_s2=np.full_like(imu.accel_m_s2, np.nan))
        frames = table_with(result.frames, accepted=(slice(0, 700), False), reason=(slice(0, 700), "gate"))
        checks = run_checks(replace(result, frames=frames), replace(flight, imu=imu))
        assert checks[-len(CHECKS)].name == CHECKS[0].name
        return list(checks[: len(checks) - len(CHECKS)])

    @pytest.mark.parametrize("late_s", [0.3, -0.08])
    def test_another_clock(self, swing: Fused, late_s: float) -> None:
        (check,) = self.cause(turning(swing, late_s))
        assert (check.name, check.level) == (checks_cause.NAME, Level.FAIL)
        setting = re.search(r"Add (\S+) to clock_offset_s for \[camera\]", check.action)
        assert setting is not None
        assert float(setting[1]) == pytest.approx(-late_s, abs=0.005)

    def test_a_delay_that_is_not_there(self, swing: Fused) -> None:
        """The setting says 0.3 s, the frames are stamped rightly."""
        (check,) = self.cause(turning(swing, -0.3, delay_s=0.3))
        setting = re.search(r"Set camera_delay_s = (\S+) instead of 0.3", check.action)
        assert setting is not None
        assert float(setting[1]) == pytest.approx(0.0, abs=0.005)

    @pytest.mark.parametrize("accel", [True, False])
    def test_turns_the_other_way(self, swing: Fused, accel: bool) -> None:
        (check,) = self.cause(turning(swing), gyro=-1.0, accel=accel)
        assert "opposite" in check.value
        said = "By gravity the IMU is as told" if accel else "mount_rad = [3.1416, 0, 0] for [imu]"
        assert said in check.action

    @pytest.mark.parametrize(
        ("gyro", "said"), [(1 / 1.3, "focal_scale"), (2.5, "Multiply the gyroscope by 0.399")]
    )
    def test_turns_of_another_size(self, swing: Fused, gyro: float, said: str) -> None:
        (check,) = self.cause(turning(swing), gyro=gyro)
        assert said in check.action
        assert f"{1 / gyro:.1f}" in check.value

    def test_nothing_is_accused_where_all_fits_or_nothing_is_wrong(self, swing: Fused) -> None:
        assert self.cause(turning(swing)) == []
        assert checks_cause.likely_cause(*turning(swing, 0.3), ()) is None

    @pytest.mark.parametrize("contradicted", [True, False])
    def test_without_a_gyroscope_the_heading_follows_the_vehicles_yaw(
        self, swing: Fused, contradicted: bool
    ) -> None:
        result, flight = swing
        rows = slice(0, 60)
        frames = table_with(result.frames, accepted=(rows, False), reason=(rows, "too_few_lines"))
        if contradicted:
            frames = table_with(frames, reason=(rows, "gate"), test_ratio=(rows, 9.0))
        result = replace(result, frames=frames)
        first, *_ = run_checks(result, replace(flight, imu=None))
        assert (first.value == "no gyroscope") is contradicted
        assert (first.action == "Log the gyroscope.") is contradicted

    @pytest.mark.parametrize("gyroscope", [True, False])
    def test_the_heading_is_not_said_to_ignore_a_yaw_it_follows(self, swing: Fused, gyroscope: bool) -> None:
        result, flight = swing
        flight = flight if gyroscope else replace(flight, imu=None)
        steps = check_of("Steps of the IMU's yaw", result, flight)
        assert steps.level is Level.WARN
        assert ("the estimated heading did not" in steps.meaning) is gyroscope
        assert ("follows it" in steps.meaning) is not gyroscope

    def test_a_gyroscope_of_zeros_does_not_turn_the_other_way(self, swing: Fused) -> None:
        assert self.cause(turning(swing), gyro=0.0) == []


def test_every_reason_has_a_meaning_and_every_rejection_a_remedy() -> None:
    assert set(REASON_MEANING) == set(Reason)
    assert set(REASON_ACTION) == set(Reason) - {Reason.OK}
