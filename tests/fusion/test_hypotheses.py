"""Who is wrong: known answers for the decision, and for the slopes and means it is taken from."""

from __future__ import annotations

from math import nan, pi, radians

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from fusion.estimator.corridor_axis import CorridorAxis, FrameAxis, _is_linked
from fusion.estimator.ekf import CorridorEKF
from fusion.estimator.frame_drift import (
    MIN_POINTS,
    Drift,
    Evidence,
    HeadingComparison,
    Slope,
    add_comparison,
    gyro_jump_between_frames,
    slope_of,
    walk_slope_variance,
)
from fusion.estimator.hypotheses import Diagnosis, Hypothesis, Innovations, Verdict, judge
from fusion.estimator.imu_yaw_check import GyroAndYaw, InertialNoise, YawProbabilities

QUIET = InertialNoise(gyro_walk=0.003, yaw_walk=0.003, yaw_std=0.001)
OWN_VARIANCE = radians(0.2) ** 2  # of a rate, by gyroscope or IMU yaw


def slope(deg_per_s: float, std_deg_per_s: float = 0.3, misfit: float = 1.0) -> Slope:
    return Slope(radians(deg_per_s), radians(std_deg_per_s), 0.0, 0.01, misfit, 30)


def verdict_of(gyro: Slope, yaw: Slope | None, before: Hypothesis = Hypothesis.WELL) -> Hypothesis:
    return judge(Evidence(gyro, yaw, OWN_VARIANCE, 0.0, OWN_VARIANCE), before).most_probable


def comparisons(
    seconds: float, drift: float = 0.0, turn: float = 0.0, yaw_follows: bool = True
) -> tuple[HeadingComparison, ...]:
    """Thirty frames a second of 0.5 degree; the gyroscope has a drift (rad/s), the vehicle turns (rad/s)."""
    rng = np.random.default_rng(1)
    made = []
    for k in range(round(30 * seconds) + 1):
        t = k / 30
        heading = turn * t + rng.normal(0.0, radians(0.5))
        yaw = 0.7 + (turn if yaw_follows else turn + drift) * t
        made.append(HeadingComparison(round(t * 1e9), heading, radians(0.5), (turn + drift) * t, yaw, True))
    return tuple(made)


@pytest.mark.parametrize(
    ("gyro", "yaw", "who"),
    [
        (slope(0.1), slope(0.1), Hypothesis.WELL),
        (slope(0.1), None, Hypothesis.WELL),
        (slope(5.0), slope(0.1), Hypothesis.GYRO),
        (slope(5.0), None, Hypothesis.GYRO),
        (slope(-5.0), slope(-5.0), Hypothesis.BEND),
        (slope(0.1), slope(8.0), Hypothesis.WELL),  # steel pulls the IMU's yaw away
        (slope(180.0), slope(0.1), Hypothesis.SPIKE),
        (slope(5.0, misfit=6.0), None, Hypothesis.SPIKE),  # on no line
    ],
)
def test_known_answers(gyro: Slope, yaw: Slope | None, who: Hypothesis) -> None:
    assert verdict_of(gyro, yaw) is who
    mirrored = gyro._replace(rate_rad_s=-gyro.rate_rad_s)
    assert verdict_of(mirrored, yaw and yaw._replace(rate_rad_s=-yaw.rate_rad_s)) is who


def test_probabilities_add_up_to_one() -> None:
    for rate in (0.0, 0.5, 1.0, 3.0, 300.0, 1e4):
        verdict = judge(Evidence(slope(rate), slope(0.5 * rate), OWN_VARIANCE, 0.0, OWN_VARIANCE))
        assert sum(verdict.probabilities) == pytest.approx(1.0)
        assert all(0.0 <= p <= 1.0 for p in verdict.probabilities)


def test_frames_that_jump_show_another_axis_and_too_few_show_nothing() -> None:
    assert judge(Evidence(jumped=True)).probability_of(Hypothesis.AXIS) == 1.0
    assert judge(Evidence()).probability_of(Hypothesis.WELL) == 1.0


def test_what_was_found_goes_on_by_weaker_evidence_and_ends_without() -> None:
    weak, none = slope(1.0), slope(0.0)
    assert verdict_of(weak, None) is Hypothesis.WELL
    assert verdict_of(weak, None, Hypothesis.GYRO) is Hypothesis.GYRO
    assert verdict_of(none, None, Hypothesis.GYRO) is Hypothesis.WELL


def test_the_slope_is_the_drift_whatever_the_vehicle_turns() -> None:
    drift = radians(4.0)
    for turn in (0.0, radians(30.0)):
        seen = comparisons(1.0, drift, turn)
        gyro, yaw = Drift(seen, turn, QUIET).over(1.0)[:2]
        assert gyro is not None
        assert yaw is not None
        assert gyro.rate_rad_s == pytest.approx(-drift, abs=3 * gyro.rate_std)
        assert yaw.rate_rad_s == pytest.approx(0.0, abs=3 * yaw.rate_std)
        assert gyro.rate_std < radians(0.6)


def weaving_sights(late_s: float, drift: float = 0.0) -> tuple[HeadingComparison, ...]:
    """Three seconds of frames that show the heading of a little before their stamps, while the vehicle weaves."""
    rng = np.random.default_rng(2)

    def heading(t_s: float) -> float:
        return radians(20.0) * float(np.sin(2.0 * t_s))

    made = []
    for t_s in np.arange(0.0, 3.0, 1 / 30).tolist():
        seen = heading(t_s - late_s) + drift * t_s + rng.normal(0.0, radians(0.5))
        made.append(
            HeadingComparison(round(t_s * 1e9), seen, radians(0.5), heading(t_s), 0.7 + heading(t_s), True)
        )
    return tuple(made)


@pytest.mark.parametrize("late_s", [-0.04, 0.0, 0.04])
def test_frames_stamped_wrongly_are_found_and_their_slope_is_none(late_s: float) -> None:
    seen = weaving_sights(late_s)
    evidence = Drift(seen, seen[-1].raw_theta_rad, QUIET).over(3.0)
    gyro = evidence.gyro
    assert gyro is not None
    assert gyro.stamp_s == pytest.approx(-late_s, abs=3 * gyro.stamp_variance**0.5)
    assert gyro.stamp_variance**0.5 < 0.006
    assert gyro.rate_rad_s == pytest.approx(0.0, abs=3 * gyro.rate_std)
    assert judge(evidence).most_probable is (Hypothesis.STAMPS if late_s else Hypothesis.WELL)


@pytest.mark.parametrize("late_s", [0.0, 0.02])
def test_a_slow_drift_shows_while_the_vehicle_turns_to_and_fro(late_s: float) -> None:
    drift = radians(1.0)
    seen = weaving_sights(late_s, drift)
    gyro = Drift(seen, seen[-1].raw_theta_rad, QUIET).over(3.0).gyro
    assert gyro is not None
    assert gyro.rate_rad_s == pytest.approx(drift, abs=3 * gyro.rate_std)
    assert gyro.rate_std < radians(0.15)


@pytest.mark.parametrize("hz", [5, 10, 30])
@pytest.mark.parametrize("seconds", [1.7, 6.0])
@pytest.mark.parametrize("turn_rad_s", [0.0, 0.3, 1.0])
def test_slopes_and_their_ends_are_as_sure_as_they_say(hz: int, seconds: float, turn_rad_s: float) -> None:
    """The gyroscope wanders by far more than frames of a twentieth of a degree err, whatever the vehicle turns."""
    std, walk, flights = radians(0.05), 0.0075, 200
    rng = np.random.default_rng(3)
    t = np.arange(-round(seconds * hz), 1) / hz
    ratios = []
    for _ in range(flights):
        rates, phases = rng.uniform(1.0, 4.0, 3), rng.uniform(0.0, 2 * pi, 3)
        turn = turn_rad_s / 1.2 * np.sin(np.outer(t, rates) + phases).sum(axis=1)
        wander = np.cumsum(rng.normal(0.0, walk / np.sqrt(hz), len(t)))
        found = slope_of(
            t, wander - wander[-1] + rng.normal(0.0, std, len(t)), np.full(len(t), std), turn, 0.0, walk
        )
        assert found is not None
        rate_std = np.hypot(found.rate_std, np.sqrt(walk_slope_variance(walk, seconds)))
        ratios.append((found.rate_rad_s / rate_std, found.now_rad / found.now_std))
    rate, now = np.sqrt(np.mean(np.square(ratios), axis=0))
    assert 0.8 < rate < 1.2
    assert 0.5 < now < 1.1  # what frames and stamps add is counted as if apart


@given(
    st.integers(0, 14),
    st.floats(5.0, 30.0),
    st.floats(0.0, 200.0),
    st.sampled_from(["steady", "growing", "shrinking"]),
    st.floats(0.0, 0.2),
)
@example(14, 10.0, 25.0, "steady", 0.17)  # behind a gap, in a turn, it drew the line to itself
def test_one_gross_frame_is_no_drift(
    at: int, off_deg: float, turn_deg_s: float, turn: str, gap_s: float
) -> None:
    t, std = np.append(np.linspace(-0.5, -0.03 - gap_s, 14), 0.0), np.full(15, radians(0.5))
    rate = {"steady": np.ones(15), "growing": t + 0.7, "shrinking": 0.2 - t}[turn] * radians(turn_deg_s)
    difference = np.zeros(15)
    difference[at] = radians(off_deg)
    found = slope_of(t, difference, std, rate, 0.0, 0.003)
    assert found is not None
    assert abs(found.rate_rad_s) < radians(0.1)


def test_the_heading_now_is_that_of_the_frames_as_they_are_stamped() -> None:
    """Though they are late: the filter takes the next frames at their stamps too."""
    seen = weaving_sights(0.04)
    gyro = Drift(seen, seen[-1].raw_theta_rad, QUIET).over(3.0).gyro
    assert gyro is not None
    late = seen[-1].heading_rad - seen[-1].raw_theta_rad
    assert abs(late) > radians(1.0)
    assert gyro.now_rad == pytest.approx(late, abs=3 * radians(0.5))
    assert gyro.now_rad == pytest.approx(-0.04 * radians(40.0) * np.cos(2.0 * 2.97), abs=4 * gyro.now_std)


def test_without_a_turn_nothing_shows_whether_stamps_are_right() -> None:
    gyro = Drift(comparisons(3.0), 0.0, QUIET).over(3.0).gyro
    assert gyro is not None
    assert gyro.stamp_variance > 1.0
    assert judge(Evidence(gyro, None, OWN_VARIANCE)).probability_of(Hypothesis.STAMPS) < 0.01


def test_a_known_bias_is_no_slope() -> None:
    drift = radians(4.0)
    known = tuple(s._replace(bias_rad_s=drift) for s in comparisons(1.0, drift))
    gyro = Drift(known, 0.0, QUIET).over(1.0).gyro
    assert gyro is not None
    assert gyro.rate_rad_s == pytest.approx(0.0, abs=3 * gyro.rate_std)


def test_no_slope_without_frames_that_follow_each_other() -> None:
    seen = comparisons(1.0)
    assert Drift(seen[: MIN_POINTS - 1], 0.0, QUIET).over(1.0) == Evidence()
    half = tuple(s._replace(linked=k % 2 == 0) for k, s in enumerate(seen))
    assert Drift(half, 0.0, QUIET).over(1.0) == Evidence()
    assert Drift(tuple(s._replace(yaw_rad=nan) for s in seen), 0.0, QUIET).over(1.0).yaw is None


def test_the_bias_from_before_a_drift_shows_it_though_the_filter_has_taken_it_up_since() -> None:
    drift = radians(2.0)
    seen = tuple(
        s._replace(bias_rad_s=drift * min(k / 45, 1.0)) for k, s in enumerate(comparisons(3.0, drift))
    )
    found = Drift(seen, 0.0, QUIET).over(3.0)
    assert found.gyro is not None
    assert found.bias_rad_s == 0.0
    assert found.gyro.rate_rad_s == pytest.approx(-drift, abs=3 * found.gyro.rate_std)


def test_headings_from_before_a_turn_that_was_not_measured_are_let_go() -> None:
    seen = comparisons(1.0)
    axis = CorridorAxis(diagnosis=Diagnosis(Innovations(3.0, 3.0, 1.0, 1.0), seen))
    assert axis.without_frames_before(None) is axis
    assert axis.without_frames_before(seen[0].t_ns - 1) is axis
    later = axis.without_frames_before(seen[10].t_ns).diagnosis
    assert later.comparisons == seen[11:]
    assert later.innovations == Innovations()


def test_an_uncertain_bias_and_a_fast_turn_make_a_slope_less_sure() -> None:
    still, bias = comparisons(1.0), tuple(s._replace(bias_variance=0.01) for s in comparisons(1.0))
    known = Drift(still, 0.0, QUIET).over(1.0)
    assert Drift(bias, 0.0, QUIET).over(1.0).bias_variance - known.bias_variance == pytest.approx(0.01)
    scale = QUIET._replace(gyro_scale_std=0.02)
    turned = Drift(comparisons(1.0, turn=radians(100.0)), radians(100.0), scale).over(1.0)
    assert turned.gyro_variance - known.gyro_variance == pytest.approx(radians(2.0) ** 2, rel=0.01)


def test_a_yaw_that_repeats_the_gyroscope_is_no_second_witness_against_the_frames() -> None:
    """The gyroscope is 2.5 sigma off; a yaw that agrees with it says nothing more, or all."""
    gyro, yaw, noisy = slope(1.0, 0.1), slope(1.0, 0.1), radians(0.4) ** 2
    evidence = Evidence(gyro, yaw, noisy, 0.0, radians(0.05) ** 2)
    of_its_own = evidence._replace(yaw_probabilities=YawProbabilities(disturbed=0.01, repeating=0.01))
    repeating = evidence._replace(yaw_probabilities=YawProbabilities(disturbed=0.01, repeating=0.9))
    assert judge(repeating).probability_of(Hypothesis.WELL) > 0.95
    assert judge(of_its_own).probability_of(Hypothesis.BEND) > 10.0 * judge(repeating).probability_of(
        Hypothesis.BEND
    )


def test_whether_the_yaw_repeats_the_gyroscope_is_learned_in_seconds() -> None:
    noise = InertialNoise(gyro_walk=0.0075, yaw_walk=0.002, yaw_std=radians(0.2))
    step_s = 1 / 30
    for repeats in (False, True):
        rng = np.random.default_rng(4)
        doubt, raw, own = YawProbabilities(), 0.0, 0.0
        for k in range(300):
            raw += rng.normal(0.0, noise.gyro_walk * np.sqrt(step_s))
            own += rng.normal(0.0, noise.yaw_walk * np.sqrt(step_s))
            yaw = 0.7 + own + repeats * raw + rng.normal(0.0, noise.yaw_std)
            doubt = doubt.compared(GyroAndYaw(round(k * step_s * 1e9), raw, yaw, 0.0, 0.0), noise)
        assert (doubt.repeating > 0.5) is repeats


def test_a_fault_is_reported_before_it_is_followed_and_for_longer() -> None:
    def reported_after(well: float, before: Diagnosis) -> Diagnosis:
        return before.with_verdict(0, Verdict((well, 1.0 - well, 0.0, 0.0, 0.0)), judgement_due=True)

    quiet = Diagnosis()
    assert reported_after(0.97, quiet).reported is None
    doubted = reported_after(0.8, quiet)
    assert doubted.found is Hypothesis.WELL
    assert doubted.reported is not None
    assert doubted.reported.hypothesis is Hypothesis.GYRO
    later = doubted.with_verdict(900_000_000, Verdict((0.97, 0.03, 0.0, 0.0, 0.0)), judgement_due=True)
    assert later.reported is not None
    assert later.reported.t_ns == 900_000_000


def test_sights_are_spaced_and_let_go() -> None:
    kept: tuple[HeadingComparison, ...] = ()
    for s in comparisons(8.0):
        kept = add_comparison(kept, s, 30_000_000)
    assert kept[-1].t_ns - kept[0].t_ns <= 6_000_000_000
    assert add_comparison(kept, kept[-1]._replace(t_ns=kept[-1].t_ns + 1000), 30_000_000) == kept


@pytest.mark.parametrize("rho", [0.0, 0.5])
def test_one_sided_innovations_are_systematic_and_white_ones_are_not(rho: float) -> None:
    rng = np.random.default_rng(0)
    white, one_sided, z = Innovations(), Innovations(), 0.0
    sigmas, found = [], 0
    for _ in range(3000):
        z = rho * z + np.sqrt(1 - rho * rho) * rng.normal()
        white = white.with_innovation(z, 1 / 30, rho)
        found += white.systematic
        sigmas.append((white.short_sigmas, white.long_sigmas))
    assert found < 10
    assert np.std(np.array(sigmas)[300:], axis=0) == pytest.approx([1.0, 1.0], rel=0.35)
    for k in range(30):
        one_sided = one_sided.with_innovation(2.0, 1 / 30, rho)
        assert not (one_sided.systematic and k < 2)
    assert one_sided.systematic


def test_a_gross_error_is_not_systematic() -> None:
    assert not Innovations().with_innovation(1000.0, 1 / 30, 0.0).with_innovation(0.0, 1 / 30, 0.0).systematic


@pytest.mark.parametrize(
    ("gyro", "yaw", "gap_s", "jump"),
    [
        (pi, 0.0, 5.0, pi),  # the gyroscope spun, the IMU's yaw did not
        (-pi, 0.1, 5.0, -pi - 0.1 + 2 * pi),
        (pi, pi - 0.2, 5.0, 0.0),  # a turn, seen by both
        (0.0, pi, 5.0, 0.0),  # the IMU's yaw was reset
        (pi, 0.0, 0.1, 0.0),  # between two frames: the frames show it
        (pi, nan, 5.0, 0.0),
    ],
)
def test_a_half_turn_that_no_frame_saw_is_the_gyroscope_s_where_the_imu_yaw_stood_still(
    gyro: float, yaw: float, gap_s: float, jump: float
) -> None:
    last = HeadingComparison(0, 0.1, 0.01, 2.0, 0.7, True)
    new = HeadingComparison(round(gap_s * 1e9), 0.1, 0.01, 2.0 + gyro, 0.7 + yaw, True)
    assert gyro_jump_between_frames((last,), new, 0.0) == pytest.approx(jump)
    assert gyro_jump_between_frames((), new, 0.0) == 0.0


@pytest.mark.parametrize("stamp_std_s", [0.0, 0.1])
def test_a_suspected_step_of_the_camera_s_clock_is_no_drift(stamp_std_s: float) -> None:
    """A step of 0.1 s in the middle of a turn looks like a drift of all frames, for as long as nobody suspects it."""
    turn, late_s = radians(20.0), 0.1
    stepped = tuple(
        s._replace(heading_rad=s.heading_rad - turn * late_s * (k > 45), stamp_std_s=stamp_std_s * (k > 45))
        for k, s in enumerate(comparisons(3.0, turn=turn))
    )
    evidence = Drift(stepped, stepped[-1].heading_rad, InertialNoise(0.003, 0.003, radians(0.5))).over(3.0)
    assert evidence.gyro is not None
    assert abs(evidence.gyro.rate_rad_s) > radians(0.5)
    seen_sigmas = abs(evidence.gyro.rate_rad_s) / evidence.gyro.rate_std
    assert seen_sigmas < 2.0 if stamp_std_s else seen_sigmas > 3.0


@pytest.mark.parametrize("frame_std", [radians(0.02), radians(0.5)])
@pytest.mark.parametrize(
    ("frames", "gyro", "yaw", "linked"),
    [
        (0.0, 0.0, 0.3, True),
        (5.0, 0.0, 0.3, False),  # IMU yaw and gyroscope stood still: another axis
        (5.0, 5.0, 5.3, True),  # a turn, seen by all
        (0.0, 5.0, 0.3, True),  # the gyroscope jumped
        (5.0, 0.0, nan, False),
        (1.0, 6.0, 6.3, False),  # the frames fall behind a turn that both others saw
        (1.0, 6.0, nan, True),  # or the gyroscope jumped
    ],
)
def test_frames_that_part_from_a_turn_that_the_imu_yaw_confirms_jump(
    frames: float, gyro: float, yaw: float, linked: bool, frame_std: float
) -> None:
    """However sure the frames are of themselves: what the IMU's yaw confirms is by its own noise."""
    near = [FrameAxis(k * 33_000_000, 0.0, frame_std, True, 0.0, 0.0) for k in range(3)]
    new = FrameAxis(99_000_000, radians(frames), frame_std, False, radians(gyro), radians(yaw))
    assert _is_linked(near, new, radians(0.5)) is linked


def test_frames_whose_stamps_are_in_doubt_move_no_anchor() -> None:
    """A turn seen late may be another axis: where frames agree with the anchor again, the filter goes back to it."""
    ekf = CorridorEKF(np.array([0.1, 0.0, 0.0]), np.eye(3))
    axis = CorridorAxis().confirmed(ekf, 1_000_000_000, 0.3)
    doubted = axis._replace(stamps_suspect=True).confirmed(ekf, 2_000_000_000, 0.5)
    assert (doubted.anchor_rad, doubted.anchor_ns) == (axis.anchor_rad, axis.anchor_ns)
    assert doubted.t_vision_ns == 2_000_000_000
    sure = doubted._replace(stamps_suspect=False).confirmed(ekf, 3_000_000_000, 0.5)
    assert sure.anchor_rad == pytest.approx(0.4)
    assert sure.anchor_ns == 3_000_000_000
